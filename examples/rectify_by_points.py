"""Rectify an image by points from Python: outlier test, choice of the degree, admissible map scale.

A synthetic TM scene of 30 km has 30 control points with 15 m of noise, one gross error of 150 m, and 20 check points.

    python examples/rectify_by_points.py
"""

from __future__ import annotations

import numpy as np

from fg_orient.rectification.fit import Observations, fit, plain_rmse
from fg_orient.rectification.outliers import point_tests
from fg_orient.rectification.standards import check_accuracy
from fg_orient.rectification.transformation import find_model


def scene(n: int, rng: np.random.Generator) -> Observations:
    """Sample and line to UTM metres: rotated, scaled, slightly curved."""
    x, y = rng.uniform(0.0, 1023.0, (2, n))
    east = 660_000.0 + 28.4 * x + 4.1 * y + 1e-4 * x * x
    north = 4_550_000.0 - 28.4 * y + 4.1 * x
    return Observations.of(np.stack([x, y], 1), np.stack([east, north], 1) + rng.normal(0.0, 15.0, (n, 2)))


def main() -> None:
    """Remove suspected points, fit three degrees, assess the map accuracy."""
    rng = np.random.default_rng(1)
    control, check = scene(30, rng), scene(20, rng)
    control.target[11] += (150.0, 0.0)

    found = fit(control, find_model("affine"))
    suspected = point_tests(found).suspicious
    print("suspected:", ", ".join(np.array(control.ids)[suspected]))
    control = control.take(~suspected)

    for degree in (1, 2, 3):
        found = fit(control, find_model("polynomial", degree))
        errors = found.transformation.apply(check.source) - check.target
        print(f"degree {degree}: m0 {found.m0:.1f} m, check points {plain_rmse(errors)[2]:.1f} m radial")

    found = fit(control, find_model("polynomial", 2))
    errors = found.transformation.apply(check.source) - check.target
    for verdict in check_accuracy(errors, scale=100_000, standards=("NMAS", "CMAS")):
        word = "passed" if verdict.passed else "failed"
        print(f"{verdict.standard}: 1:100000 {word}, at best 1:{verdict.largest_scale:.0f}")


if __name__ == "__main__":
    main()
