"""Rectify an image by points from Python: which degree, which points are bad, which map scale.

A made-up TM scene of 30 km: 30 control points with 15 m of noise, one of them off by 150 m, and 20 check points.

    python examples/rectify_by_points.py
"""

from __future__ import annotations

import numpy as np

from fg_orient.rectification.fit import Observations, fit, plain_rmse
from fg_orient.rectification.outliers import point_tests
from fg_orient.rectification.standards import check_accuracy
from fg_orient.rectification.transformation import find_model


def scene(n: int, rng: np.random.Generator) -> Observations:
    """Sample and line to UTM metres: turned, scaled, slightly curved."""
    x, y = rng.uniform(0.0, 1023.0, (2, n))
    east = 660_000.0 + 28.4 * x + 4.1 * y + 1e-4 * x * x
    north = 4_550_000.0 - 28.4 * y + 4.1 * x
    return Observations.of(np.stack([x, y], 1), np.stack([east, north], 1) + rng.normal(0.0, 15.0, (n, 2)))


def main() -> None:
    """Fit three degrees, leave out what is suspected, judge the best."""
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
