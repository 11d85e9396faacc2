"""Cost of a block in parts: in one piece, in parts in this process, on workers of this machine.

    OPENBLAS_NUM_THREADS=1 python benchmarks/parallel_cost.py [--image-points 100000] [--parts N] [--workers 1 2 4]

Seconds per Gauss-Newton iteration (least and median, the first one apart: workers compile and open their parts in
it), kB of partial normal equations and arguments per iteration, and whether all runs in parts have the same bits.
"""

from __future__ import annotations

import argparse
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fg_orient.adjustment.loop import OPTIMIZERS
from fg_orient.adjustment.parts.backend import PartedBackend
from fg_orient.adjustment.parts.execution import Execution, opened, work_folder
from fg_orient.adjustment.parts.parts import default_parts
from fg_orient.adjustment.parts.pool import Pool
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.cli.doctor import self_test
from fg_orient.simulate.block import BlockOptions, grid_block


class Counting(Pool):
    """Counts what would travel: arguments and results, pickled."""

    def __init__(self) -> None:
        self.kilobytes: list[float] = []

    def total(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
        """Sum without a tree."""
        found = [task(*argument) for argument in arguments]
        self.kilobytes.append(sum(len(pickle.dumps(x, 5)) for x in (*found, *arguments)) / 1e3)
        return sum(found[1:], start=found[0])


def run(problem: Problem, make: Callable[[], Any], name: str) -> tuple[bytes, bytes]:
    """Adjust, print the times, give the bits of the solution."""
    start = time.perf_counter()
    backend = make()
    marks = [time.perf_counter()]
    with one_blas_thread():
        result = OPTIMIZERS["gauss-newton"](
            backend, backend.initial(), 50, lambda record: marks.append(time.perf_counter())
        )
    state, each = State(result.state.image, result.state.ground), np.diff(marks)
    later = each[1:-1]  # the last one is not linearised again
    print(
        f"{name:24s} structure {marks[0] - start:5.2f} s   first {each[0]:5.2f} s   then least {later.min():6.3f}, "
        f"median {np.median(later):6.3f} s   loop {marks[-1] - marks[0]:5.2f} s, {len(each)} iterations",
        flush=True,
    )
    return state.image.tobytes(), state.ground.tobytes()


def in_parts(problem: Problem, pool: Pool, parts: int, name: str) -> tuple[bytes, bytes]:
    """Adjust on a pool."""
    with work_folder(Execution(), pool) as folder:
        return run(problem, lambda: PartedBackend(problem, pool, folder, parts), name)


def travel(problem: Problem, parts: int) -> float:
    """KB per iteration."""
    pool = Counting()
    with work_folder(Execution(), pool) as folder:
        backend = PartedBackend(problem, pool, folder, parts)
        backend.linearise(backend.initial()).solve(0.0)
    return sum(pool.kilobytes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--image-points", type=float, default=1e5)
    parser.add_argument("--parts", type=int)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    arguments = parser.parse_args()
    self_test()
    side = 4 if arguments.image_points < 5e4 else 6 if arguments.image_points < 5e5 else 10
    block, _ = grid_block(BlockOptions(rows=side, columns=side, points=round(arguments.image_points / 3.6)))
    problem = compile_problem(replace(block, options=replace(block.options, eop_set=20)))
    parts = arguments.parts or default_parts(problem)
    print(f"{len(problem.observations)} image points, {side**2} images, {problem.n_image_unknowns} image unknowns, "
          f"{parts} parts, {travel(problem, parts):.0f} kB per iteration")  # fmt: skip
    for threads in (1, 2):
        run(problem, lambda t=threads: SchurBackend(problem, threads=t), f"one piece, {threads} threads")
    bits = [in_parts(problem, Pool(), parts, "parts in this process")]
    for workers in arguments.workers:
        start = time.perf_counter()
        with opened(Execution(workers=max(workers, 2))) as pool:
            pool.client.run(self_test)
            print(f"{'':24s} {max(workers, 2)} processes ready after {time.perf_counter() - start:.1f} s")
            if workers == 1:
                first = pool.workers()[0]
                pool.workers = lambda only=first: [only]
            bits.append(in_parts(problem, pool, parts, f"parts, {workers} worker(s)"))
    print("same bits:", all(b == bits[0] for b in bits))


if __name__ == "__main__":
    main()
