"""The first hit is found inside a cell of a DEM, a saddle that a ray can enter and leave between edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from factors.geometry import ellipsoid
from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.sensors import surface
from fg_orient.sensors.surface import on_surface

pytestmark = pytest.mark.oracle

#: Cells of 0.001 degrees near the equator, 111 m.
STEP = 1e-3


class Saddles:
    """Bilinear cells of random heights."""

    path = "saddles"

    def __init__(self, seed: int) -> None:
        self.z = np.random.default_rng(seed).uniform(0.0, 120.0, (12, 12))

    @property
    def range_m(self) -> tuple[float, float]:
        return float(self.z.min()), float(self.z.max())

    def cell(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return lat_deg / STEP + 5.5, lon_deg / STEP + 5.5

    def height_m(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
        row, column = self.cell(lon_deg, lat_deg)
        inside = (row >= 0) & (row <= 11) & (column >= 0) & (column <= 11)
        row, column = np.where(inside, row, 0.0), np.where(inside, column, 0.0)
        r, c = np.minimum(row.astype(int), 10), np.minimum(column.astype(int), 10)
        y, x = row - r, column - c
        south = self.z[r, c] * (1 - x) + self.z[r, c + 1] * x
        north = self.z[r + 1, c] * (1 - x) + self.z[r + 1, c + 1] * x
        return np.where(inside, south * (1 - y) + north * y, np.nan)


@pytest.fixture(scope="module")
def rays() -> tuple[np.ndarray, np.ndarray]:
    """Return the slant rays from all sides, so that saddles are grazed."""
    rng, n = np.random.default_rng(100), 400
    target = geodetic_to_ecef(rng.uniform(-1e-3, 1e-3, n), rng.uniform(-1e-3, 1e-3, n), rng.uniform(20.0, 100.0, n))
    azimuth, zenith = rng.uniform(0.0, 2.0 * np.pi, n), np.radians(rng.uniform(55.0, 66.0, n))
    up, east, north = np.eye(3)
    across = np.cos(azimuth)[:, None] * east + np.sin(azimuth)[:, None] * north
    back = np.cos(zenith)[:, None] * up + np.sin(zenith)[:, None] * across
    return np.ascontiguousarray(target + 7e5 * back), np.ascontiguousarray(-back)


def marched(dem: Saddles, p: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the distances of the first hits, by steps of 20 cm."""
    s = 7e5 + np.arange(-320.0, 320.0, 0.2)
    found = np.empty(len(p))
    for k in range(len(p)):
        lon, lat, h = ellipsoid.geodetic_array(p[k] + s[:, None] * u[k]).T
        found[k] = s[np.argmax(dem.height_m(np.degrees(lon), np.degrees(lat)) >= h)]
    return found


def test_no_crossing_between_edges_is_missed(rays: tuple[np.ndarray, np.ndarray], monkeypatch: Any) -> None:
    dem = Saddles(0)
    steps = marched(dem, *rays)
    late = np.linalg.norm(on_surface(*rays, dem, "rays") - rays[0], axis=1) - steps
    # a ray that grazes a saddle for less than a step is seen by the parabola alone
    assert late.max() <= 1e-3 and np.sum(late < -0.2 - 1e-3) <= 2
    monkeypatch.setattr(surface, "_peak", lambda start, middle, end: np.full(len(start), np.nan))
    edges_only = np.linalg.norm(on_surface(*rays, dem, "rays") - rays[0], axis=1)
    assert (edges_only - steps).max() > 1.0
