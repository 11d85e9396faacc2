"""The benchmark compares the Schur backend with the graph backend per image point and iteration in one run.

    OPENBLAS_NUM_THREADS=1 python benchmarks/schur_cost.py [--sizes 1000 10000] [--repeats 5] [--json FILE]

The blocks have 2 x 2, 4 x 4 and 6 x 6 scenes with set 20 (27 unknowns per image). An
iteration consists of the steps of the Gauss-Newton loop: linearise, solve, retract.
Compilation, the structure (arrays, pairs, factors of the graph) and the first iteration are
not included; the structure has its own column. The runs alternate, and the table has the
medians. The JSON file also has the least seconds, which vary less on a shared machine.
``bytes`` are the arrays of the backend per image point without the records of the problem.
``--reduced`` also times both solvers of the reduced camera system.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.loop import Backend
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.cli.checks import self_test
from fg_orient.simulate.block import BlockOptions, grid_block

#: Above this size the graph does not run, because it needs 12 kB per image point.
GRAPH_LIMIT = 200_000
#: From the first number of image points a block has the second number of scenes along each
#: side, and the third number of image points per ground point.
GRIDS = ((0, 2, 2.6), (3_000, 4, 3.3), (50_000, 6, 3.6), (500_000, 10, 4.0))


def problem_of(image_points: int) -> Problem:
    """Return a block with about this number of image points."""
    side, rays = next((side, rays) for least, side, rays in reversed(GRIDS) if image_points >= least)
    block, _ = grid_block(BlockOptions(rows=side, columns=side, points=round(image_points / rays)))
    return compile_problem(replace(block, options=replace(block.options, eop_set=20)))


def iteration_seconds(backend: Backend) -> float:
    """Return the seconds of one iteration at the start values: linearise, solve, retract."""
    state = backend.initial()
    start = time.perf_counter()
    backend.retract(state, backend.linearise(state).solve(0.0))
    return time.perf_counter() - start


def n_bytes(backend: SchurBackend) -> int:
    """Return the bytes of the arrays of a backend."""
    structure = [getattr(backend.structure, f.name) for f in fields(backend.structure)]
    arrays = [a for a in [*structure, *vars(backend.buffers).values()] if isinstance(a, np.ndarray)]
    rows = [array for pair in (backend.buffers._kept, backend.buffers._again) for array in pair]
    members = [g.members for g in backend.structure.groups if g.members is not None]
    return sum(a.nbytes for a in [*arrays, *rows, *members])


class Case:
    """A case is one size with its backends and the seconds measured so far."""

    def __init__(self, image_points: int, reduced: bool) -> None:
        problem = problem_of(image_points)
        self.n, self.unknowns = len(problem.observations), problem.n_image_unknowns
        start = time.perf_counter()
        one = SchurBackend(problem, threads=1)
        self.structure = time.perf_counter() - start
        self.bytes = n_bytes(one)
        self.backends: dict[str, Backend] = {"schur_1": one, "schur_2": SchurBackend(problem, threads=2)}
        if reduced:
            for name in ("dense", "graph"):
                self.backends[f"reduced_{name}"] = SchurBackend(problem, threads=2, reduced=name)
        if self.n <= GRAPH_LIMIT:
            self.backends["graph"] = ExplicitBackend(problem)
        self.seconds: dict[str, list[float]] = {name: [] for name in self.backends}

    def run(self, count: bool = True) -> None:
        """Measure one iteration of each backend."""
        for name, backend in self.backends.items():
            seconds = iteration_seconds(backend)
            if count:
                self.seconds[name].append(seconds)

    def row(self) -> dict[str, object]:
        """Return the microseconds per image point and iteration: medians, least, and all."""
        micro = {name: np.array(values) / self.n * 1e6 for name, values in self.seconds.items()}
        return {
            "image_points": self.n, "image_unknowns": self.unknowns,
            "structure_us": self.structure / self.n * 1e6, "bytes": self.bytes / self.n,
            "median_us": {name: float(np.median(values)) for name, values in micro.items()},
            "least_us": {name: float(values.min()) for name, values in micro.items()},
            "all_us": {name: values.tolist() for name, values in micro.items()},
        }  # fmt: skip


def table(rows: list[dict], names: list[str]) -> None:
    """Print the medians, and the ratio of the graph to the Schur backend with two threads."""
    print(f"{'image points':>12} {'unknowns':>8} {'structure':>9} {'bytes':>6}", *(f"{n:>13}" for n in names), " ratio")
    for row in rows:
        median = row["median_us"]
        cells = [f"{median[n]:>13.2f}" if n in median else f"{'-':>13}" for n in names]
        ratio = f"{median['graph'] / median['schur_2']:>6.1f}" if "graph" in median else f"{'-':>6}"
        head = f"{row['image_points']:>12} {row['image_unknowns']:>8} {row['structure_us']:>9.2f} {row['bytes']:>6.0f}"
        print(head, *cells, ratio)


def exponent(rows: list[dict]) -> float:
    """Return the slope of log(time per iteration) over log(image points) for two threads."""
    n = np.array([row["image_points"] for row in rows], dtype=float)
    seconds = n * np.array([row["median_us"]["schur_2"] for row in rows])
    return float(np.polyfit(np.log(n), np.log(seconds), 1)[0])


def main() -> int:
    """Print the table. The exit code is always 0, because a benchmark only reports."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--reduced", action="store_true")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    self_test()  # compiles or loads the kernels
    cases = [Case(size, given.reduced) for size in given.sizes]
    with one_blas_thread():
        for case in cases:
            case.run(count=False)
        gc.collect()
        gc.freeze()
        gc.disable()  # the adjustment does the same while it solves
        # all sizes run in each round, so that other work on the machine delays all alike
        for _ in range(given.repeats):
            for case in cases:
                case.run()
    rows = [case.row() for case in cases]
    print("microseconds per image point and iteration (medians)")
    table(rows, list(dict.fromkeys(name for case in cases for name in case.backends)))
    if len(rows) > 1:
        print(f"scaling exponent of the Schur backend: {exponent(rows):.2f}")
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
