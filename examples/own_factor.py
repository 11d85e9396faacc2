"""A user's observation equation: a measured distance between two ground points.

    python examples/own_factor.py

The file contains a compiled kernel with analytic Jacobians, the same residual for complex-step
checks, and the registration. The script checks the Jacobians as the project's tests check every
registered equation. Then it adjusts the distance together with image and control points.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import fg_orient as fg
from fg_orient import (
    Argument,
    Equation,
    ExtraObservation,
    Record,
    Role,
    compiled,
    register_equation,
)
from fg_orient.simulate import ZonguldakOptions, zonguldak_block

#: Constants of an observation, m.
TAPE = Record(distance=1, sigma=1)


@compiled
def residual(record, setup, a, b):  # type: ignore[no-untyped-def]
    """``(|b - a| - measured) / sigma``."""
    d = b - a
    length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return np.array([(length - record[TAPE.distance]) / record[TAPE.sigma]])


@compiled
def kernel(record, setup, a, b, want):  # type: ignore[no-untyped-def]
    """Residual (1,) and Jacobians (1, 3) with respect to both points."""
    value = residual(record, setup, a, b)
    if not want:
        return value, np.empty((0, 0)), np.empty((0, 0))
    d = b - a
    unit = (d / np.sqrt(d @ d) / record[TAPE.sigma]).reshape((1, 3))
    return value, -unit, unit


DISTANCE = register_equation(Equation(
    "my_distance", kernel, residual,
    (Argument("from", "m", is_point=True), Argument("to", "m", is_point=True)), "this example",
    n_constants=TAPE.size,
))  # fmt: skip


def worst_jacobian_error(equation: Equation, draws: int = 20) -> float:
    """Largest difference between analytic and complex-step Jacobian, relative to the row."""
    rng, worst = np.random.default_rng(0), 0.0
    for _ in range(draws):
        record, setup, points = rng.uniform(1.0, 9.0, 2), np.zeros((2, 0)), rng.normal(size=(2, 3))
        _, *jacobians = equation.kernel(record, setup, *points, True)
        for k, jacobian in enumerate(jacobians):
            for c in range(jacobian.shape[1]):
                z = [point.astype(complex) for point in points]
                z[k][c] += 1e-30j
                numeric = np.asarray(equation.residual(record, setup, *z).imag / 1e-30)
                worst = max(worst, float(np.abs(jacobian[:, c] - numeric).max() / np.abs(jacobian).max()))
    return worst


def main() -> None:
    """Check the Jacobians, then add one measured distance between two check points of the synthetic block."""
    print(f"Jacobians agree with complex step to {worst_jacobian_error(DISTANCE):.1e}")
    block, truth = zonguldak_block(ZonguldakOptions(seed=1))
    first, second = block.points.where(Role.CHECK)[:2]
    before = fg.adjust(block)
    distance_m = float(np.linalg.norm(truth.ecef_m[second] - truth.ecef_m[first]))
    names = tuple(f"point:{block.points.ids[j]}" for j in (first, second))
    record = TAPE.pack(distance=distance_m, sigma=0.01)
    tape = ExtraObservation(DISTANCE, names, record, np.zeros((2, 0)), 1, "distance of two check points")
    after = fg.adjust(replace(block, extra=(tape,)))

    def error_m(solution: fg.Solution) -> float:
        return float(np.linalg.norm(solution.ground_m[second] - solution.ground_m[first])) - distance_m

    print(f"redundancy {before.redundancy} -> {after.redundancy}")
    print(f"error of the adjusted distance: {error_m(before):+.3f} m -> {error_m(after):+.4f} m")


if __name__ == "__main__":
    main()
