"""The fixture has control points of a known rational function."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fg_orient.rpc.points import ControlPoints

CENTRE, SPREAD = np.array([31.8, 41.4, 450.0]), np.array([0.3, 0.2, 430.0])
Make = Callable[..., ControlPoints]


def known_image(unit: np.ndarray) -> np.ndarray:
    """Return the lines and samples (n, 2) of the known model in normalised ground coordinates, written out."""
    x, y, z = unit.T
    sample = (0.01 + 0.9 * x + 0.2 * y - 0.03 * z + 0.015 * x * y - 0.008 * z**2) / (1.0 + 0.02 * x - 0.01 * z)
    line = (-0.02 - 0.15 * x - 0.95 * y + 0.02 * z + 0.02 * x**2) / (1.0 - 0.015 * y)
    return 6000.0 * np.stack([line, sample], axis=1) + 6000.0


@pytest.fixture
def make() -> Make:
    """Return the points of the known model: count, noise in pixels, seed."""

    def points(count: int = 60, noise_px: float = 0.0, seed: int = 1) -> ControlPoints:
        rng = np.random.default_rng(seed)
        unit = np.vstack(
            [rng.uniform(-1.0, 1.0, (count - 8, 3)), np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), -1).reshape(-1, 3)]
        )
        image = known_image(unit)
        line, sample = (image + noise_px * rng.standard_normal(image.shape)).T
        return ControlPoints(line, sample, CENTRE + SPREAD * unit)

    return points
