"""The benchmark measures a block in one piece, in parts in this process, and in parts on workers of this machine.

    OPENBLAS_NUM_THREADS=1 python benchmarks/parallel_cost.py [--image-points 100000] [--parts N] [--workers 1 2 4]
    OPENBLAS_NUM_THREADS=1 python benchmarks/parallel_cost.py --fronts [--parts N]

It prints the seconds per Gauss-Newton iteration (least and median), the kB of partial normal
equations and arguments per iteration, and whether all runs in parts have the same bits. The
first iteration is listed separately, because workers compile and open their parts in it.

``--fronts`` compares the sum of all parts with the fronts of a dissected block: a strip of
400 frame images, and a grid of 200 satellite images. For one iteration it prints the data
transferred and written, the largest memory of the main process with two workers
(tracemalloc), and the processor seconds without workers.
"""

from __future__ import annotations

import argparse
import pickle
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fg_orient.adjustment.loop import OPTIMIZERS
from fg_orient.adjustment.memory import default_parts
from fg_orient.adjustment.parts import dissection
from fg_orient.adjustment.parts.backend import PartedBackend
from fg_orient.adjustment.parts.execution import Execution, opened, work_folder
from fg_orient.adjustment.parts.pool import Pool
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.cli.checks import self_test
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.strips import StripOptions, strip_block


class Counting(Pool):
    """The pool counts the bytes of pickled arguments and results that workers would receive and send."""

    def __init__(self) -> None:
        self.kilobytes: list[float] = []

    def total(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
        """Return the sum, added one by one."""
        found = [task(*argument) for argument in arguments]
        self._count(found, arguments)
        return sum(found[1:], start=found[0])

    def each(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
        """Run one after the other."""
        found = [task(*argument) for argument in arguments]
        self._count(found, arguments)
        yield from enumerate(found)

    def _count(self, found: Sequence[Any], arguments: Sequence[tuple[Any, ...]]) -> None:
        self.kilobytes.append(sum(len(pickle.dumps(x, 5)) for x in (*found, *arguments)) / 1e3)


def run(problem: Problem, make: Callable[[], Any], name: str) -> tuple[bytes, bytes]:
    """Adjust, print the times, and return the bits of the solution."""
    start = time.perf_counter()
    backend = make()
    marks = [time.perf_counter()]
    with one_blas_thread():
        result = OPTIMIZERS["gauss-newton"](
            backend, backend.initial(), 50, lambda record: marks.append(time.perf_counter())
        )
    state, each = State(result.state.image, result.state.ground), np.diff(marks)
    later = each[1:-1]  # the last state is not linearised again
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
    """Return the kB per iteration."""
    pool = Counting()
    with work_folder(Execution(), pool) as folder:
        backend = PartedBackend(problem, pool, folder, parts)
        backend.linearise(backend.initial()).solve(0.0)
    return sum(pool.kilobytes)


def fronts(problem: Problem, parts: int) -> None:
    """Print the cost of one iteration with the sum of all parts and with fronts."""
    print(f"{problem.n_images} images, {problem.n_image_unknowns} image unknowns, "
          f"{len(problem.observations)} image points, {parts} parts")  # fmt: skip
    for name, held in (("sum", np.inf), ("fronts", 0.0)):
        dissection.HELD, dissection.SMALLER = held, 0.0
        pool = Counting()
        with work_folder(Execution(), pool) as folder, one_blas_thread():
            backend = PartedBackend(problem, pool, folder, parts)
            backend.linearise(backend.initial()).solve(0.0)
            kilobytes, backend = sum(pool.kilobytes), PartedBackend(problem, Pool(), folder, parts)
            files = [file.stat().st_size / 1e3 for file in folder.glob("front-*")] or [0.0]
            start = time.process_time()
            backend.linearise(backend.initial()).solve(0.0)
            seconds = time.process_time() - start
        with opened(Execution(workers=2)) as cluster, work_folder(Execution(), cluster) as folder:
            backend = PartedBackend(problem, cluster, folder, parts)
            backend.linearise(backend.initial()).solve(0.0)
            system = backend.linearise(backend.initial())
            tracemalloc.start()
            system.solve(0.0)
            peak = tracemalloc.get_traced_memory()[1] / 1e6
            tracemalloc.stop()
        choice = backend.choice
        assert choice is not None
        print(
            f"{name:7s} {choice.kind:7s} predicted {choice.memory / 1e6:6.1f} MB   largest front {choice.front:5d}   "
            f"transferred {kilobytes / 1e3:6.1f} MB   files {sum(files) / 1e3:6.1f}, largest {max(files) / 1e3:5.1f} MB"
            f"   main process {peak:6.1f} MB   processor {seconds:5.2f} s",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--image-points", type=float, default=1e5)
    parser.add_argument("--parts", type=int)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--fronts", action="store_true")
    arguments = parser.parse_args()
    self_test()
    if arguments.fronts:
        strip, _ = strip_block(StripOptions(strips=2, images=200, points=4000, control=20, navigation=False))
        fronts(compile_problem(strip), arguments.parts or 16)
        grid, _ = grid_block(BlockOptions(rows=10, columns=20, points=4000))
        fronts(compile_problem(replace(grid, options=replace(grid.options, eop_set=20))), arguments.parts or 16)
        return
    side = 4 if arguments.image_points < 5e4 else 6 if arguments.image_points < 5e5 else 10
    block, _ = grid_block(BlockOptions(rows=side, columns=side, points=round(arguments.image_points / 3.6)))
    problem = compile_problem(replace(block, options=replace(block.options, eop_set=20)))
    parts = arguments.parts or default_parts(len(problem.observations))
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
