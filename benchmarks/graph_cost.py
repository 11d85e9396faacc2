"""The benchmark measures the graph backend per image point and iteration, and compares it with empty Python factors.

    OPENBLAS_NUM_THREADS=1 python benchmarks/graph_cost.py [--sizes 1000 3000 10000] [--repeats 5] [--json FILE]

One block (3 x 3 scenes, set 20, 27 unknowns per image) is measured with several numbers of
image points. An iteration consists of the steps of the Gauss-Newton loop: linearise, error,
eliminate, retract. The same graph with *empty* Python factors (constant Jacobians, no
arithmetic) takes the time of GTSAM and its Python callbacks. The ratio therefore shows the
time of the equation. Runs of both alternate, and the medians are compared. Targets: the
largest cost per image point is at most 1.3 times the smallest, and the ratio is at most 1.5.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np

from fg_orient.adjustment.explicit import ExplicitBackend, image_key, point_key
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.rows import linearised
from fg_orient.model.block import Block
from fg_orient.model.machine import calm_memory
from fg_orient.simulate.block import BlockOptions, grid_block

IMAGE_POINTS_PER_POINT = 3.0  # first estimate for a 3 x 3 block


def block_of(image_points: int) -> Block:
    """Return a 3 x 3 block with about this number of image points."""
    guess = round(image_points / IMAGE_POINTS_PER_POINT)
    block, _ = grid_block(BlockOptions(rows=3, columns=3, points=guess))
    second = round(guess * image_points / len(block.observations))
    block, _ = grid_block(BlockOptions(rows=3, columns=3, points=second))
    return replace(block, options=replace(block.options, eop_set=20))


def empty_graph(problem: Problem, backend: ExplicitBackend) -> gtsam.NonlinearFactorGraph:
    """Return the same graph with constant Jacobians, whose callbacks compute nothing."""
    _, j_image, j_ground = linearised(problem, problem.start)
    graph, unit, zero = gtsam.NonlinearFactorGraph(), gtsam.noiseModel.Unit.Create(2), np.zeros(2)
    j_image_mean, j_ground_mean = np.mean(j_image, axis=0), np.mean(j_ground, axis=0)

    def empty(_this: object, _values: object, jacobians: list | None) -> np.ndarray:
        if jacobians is not None:
            jacobians[0], jacobians[1] = j_image_mean, j_ground_mean
        return zero

    o = problem.observations
    for row in np.argsort(o.point, kind="stable"):  # the same order as in the graph of fg_orient
        keys = [image_key(int(o.image[row])), point_key(int(o.point[row]))]
        graph.add(gtsam.CustomFactor(unit, keys, empty))
    for k in range(len(o), backend.graph.size()):
        graph.add(backend.graph.at(k))
    # a strong prior on every point makes the system of averaged Jacobians solvable
    for j in np.flatnonzero(problem.active):
        graph.addPriorPoint3(point_key(int(j)), problem.start.ground[j], gtsam.noiseModel.Isotropic.Sigma(3, 1.0))
    return graph


def iteration_seconds(backend: ExplicitBackend, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> float:
    """Return the seconds of one iteration: linearise, error, eliminate, retract."""
    start = time.perf_counter()
    linear = graph.linearize(values)
    linear.error(backend.zero)
    values.retract(linear.optimize(backend.ordering))
    return time.perf_counter() - start


class Case:
    """A case is one size with its problem, its graph, the empty graph, and the seconds measured so far."""

    def __init__(self, image_points: int) -> None:
        problem = compile_problem(block_of(image_points))
        self.n = len(problem.observations)
        self.backend = ExplicitBackend(problem)
        self.values = self.backend.initial()
        self.empty = empty_graph(problem, self.backend)
        self.seconds: list[tuple[float, float]] = []

    def run(self) -> tuple[float, float]:
        """Measure the seconds of one iteration of the graph and of the empty graph."""
        # both graphs allocate their memory before they are timed
        iteration_seconds(self.backend, self.empty, self.values)
        ours = iteration_seconds(self.backend, self.backend.graph, self.values)
        return ours, iteration_seconds(self.backend, self.empty, self.values)

    def row(self) -> dict[str, float]:
        """Return the medians in microseconds per image point and iteration.

        The ratio is computed for each pair of runs.
        """
        pairs = np.array(self.seconds)
        ours, nothing = np.median(pairs, axis=0) / self.n * 1e6
        ratio = float(np.median(pairs[:, 0] / pairs[:, 1]))
        return {"image_points": self.n, "us_per_point": ours, "us_per_point_empty": nothing, "ratio": ratio}


def main() -> int:
    """Print the table. The exit code is always 0, because a benchmark only reports."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[1000, 3000, 10000])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    cases = [Case(size) for size in given.sizes]
    for case in cases:
        case.run()  # warms up
    gc.collect()
    gc.freeze()
    with calm_memory():  # the adjustment does the same while it solves
        # all sizes run in each round, so that other work on the machine delays all alike
        for _ in range(given.repeats):
            for case in cases:
                case.seconds.append(case.run())
    rows = [case.row() for case in cases]
    print(f"{'image points':>12} {'us/point/iteration':>19} {'empty factors':>14} {'ratio':>6}")
    for row in rows:
        ours, nothing = row["us_per_point"], row["us_per_point_empty"]
        print(f"{row['image_points']:>12} {ours:>19.1f} {nothing:>14.1f} {row['ratio']:>6.2f}")
    costs = [row["us_per_point"] for row in rows]
    print(f"largest to smallest cost per image point: {max(costs) / min(costs):.2f}")
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
