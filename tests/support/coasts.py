"""The module makes synthetic coasts and counts simulated areas in pixels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fg_orient.rectification.projections import count_pixels, outline, perimeter_m, pixel_area_m2, planar_area_m2

Array = npt.NDArray[np.float64]


def simulate_pixel_areas_m2(
    vertices: npt.ArrayLike, pixel_m: float, n_placements: int, seed: int, *, turn: bool = True
) -> Array:
    """Return the pixel-count areas (n_placements,) on grids at random positions and, with ``turn``, orientations, m2.

    The formula of ``pixel_area_sigma_m2`` holds for all orientations. With a single orientation the standard
    deviation for the coast of an island is 0.8 to 1.25 times that value.
    """
    given, rng = outline(vertices), np.random.default_rng(seed)
    angles = rng.uniform(0.0, 2.0 * np.pi, n_placements) if turn else np.zeros(n_placements)
    offsets = rng.uniform(0.0, pixel_m, (n_placements, 2))
    turns = np.stack([np.cos(angles), np.sin(angles), -np.sin(angles), np.cos(angles)], axis=1).reshape(-1, 2, 2)
    counts = [count_pixels(given @ r, pixel_m, o) for r, o in zip(turns, offsets, strict=True)]
    return np.array([pixel_area_m2(n, pixel_m) for n in counts])


def synthetic_outline(area_m2: float, perimeter: float, n_vertices: int, seed: int) -> Array:
    """Return a random coast (n_vertices, 2) of a given area and perimeter in m.

    It is a circle whose radius has random harmonics.
    """
    rng, angle = np.random.default_rng(seed), np.linspace(0.0, 2.0 * np.pi, n_vertices, endpoint=False)
    order = np.arange(2, 24)
    waves = np.cos(np.outer(angle, order) + rng.uniform(0.0, 2.0 * np.pi, len(order))) @ (
        rng.normal(size=len(order)) / order
    )
    waves /= np.abs(waves).max()

    def shape(size: float) -> Array:
        plane = (1.0 + size * waves)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return np.asarray(plane * np.sqrt(area_m2 / planar_area_m2(plane)))

    low, high = 0.0, 0.95
    assert perimeter_m(shape(low)) < perimeter < perimeter_m(shape(high))
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if perimeter_m(shape(middle)) < perimeter else (low, middle)
    return shape(0.5 * (low + high))
