"""Control points of a known rational function."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fg_orient.rfm.form import RfmForm
from fg_orient.rfm.points import ControlPoints

#: Terms beyond the affine ones that the known model has.
TERMS = ("b100", "b001", "a110", "a002", "c200", "d010")
CENTRE, SPREAD = np.array([31.8, 41.4, 450.0]), np.array([0.3, 0.2, 430.0])
Make = Callable[..., ControlPoints]


def known_unknowns(form: RfmForm) -> np.ndarray:
    """Unknowns of the known model in a complete form of degree 2 or 3 with separate denominators."""
    x = np.zeros(len(form))
    values = {"a000": 0.01, "a100": 0.9, "a010": 0.2, "a001": -0.03, "c000": -0.02, "c100": -0.15, "c010": -0.95,
              "c001": 0.02, "b100": 0.02, "b001": -0.01, "a110": 0.015, "a002": -0.008, "c200": 0.02,
              "d010": -0.015}  # fmt: skip
    for name, value in values.items():
        x[form.names.index(name)] = value
    return x


@pytest.fixture
def make() -> Make:
    """Points of the known model: count, noise in pixels, seed."""

    def points(count: int = 60, noise_px: float = 0.0, seed: int = 1) -> ControlPoints:
        rng = np.random.default_rng(seed)
        unit = np.vstack(
            [rng.uniform(-1.0, 1.0, (count - 8, 3)), np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), -1).reshape(-1, 3)]
        )
        form = RfmForm(2)
        image = form.image(known_unknowns(form), form.monomials(unit)) * 6000.0 + 6000.0
        line, sample = (image + noise_px * rng.standard_normal(image.shape)).T
        return ControlPoints(line, sample, CENTRE + SPREAD * unit)

    return points
