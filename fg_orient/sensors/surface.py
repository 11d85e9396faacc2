"""Digital elevation models and the intersection of rays with them.

Ray and DEM are intersected by iterating height -> ellipsoid -> DEM height
(docs/equations.md 5); rays that do not settle are marched from the highest DEM value down
and bisected, taking the first hit. Heights of the raster are used as they are
(ellipsoidal); a vertical CRS in the file is refused until geoid grids are supported.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from factors import ellipsoid
from fg_orient.errors import InputError
from fg_orient.sensors.correction import HeightSurface

Array = npt.NDArray[np.float64]

TOLERANCE_M = 1e-4
MAX_ITERATIONS = 25
MARCH_STEPS = 400


class RasterDem:
    """A DEM read through rasterio, bilinear between pixel centres.

    Parameters
    ----------
    path : path of any raster that rasterio reads, geographic or projected CRS, heights in m.

    Raises
    ------
    InputError
        The file cannot be read or has no CRS.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            import rasterio
        except ImportError as error:
            raise InputError.of("dem.no_rasterio", file=path) from error
        if not Path(path).is_file():
            raise InputError.of("dem.missing", file=path)
        try:
            with rasterio.open(path) as source:
                if source.crs is None:
                    raise InputError.of("dem.no_crs", file=path)
                self._heights = source.read(1, masked=True).astype(float).filled(np.nan)
                self._pixel_from_crs = ~source.transform
                self._crs = source.crs.to_wkt()
        except rasterio.RasterioIOError as error:
            raise InputError.of("dem.unreadable", file=path, value=error) from error
        self.path = str(path)

    @property
    def range_m(self) -> tuple[float, float]:
        """Lowest and highest height of the raster."""
        return float(np.nanmin(self._heights)), float(np.nanmax(self._heights))

    def height_m(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Heights of N points, bilinear; nan outside the raster or at nodata."""
        from fg_orient.geodesy import from_geographic

        x, y = from_geographic(self._crs, lon_deg, lat_deg)
        t = self._pixel_from_crs
        column, row = t.a * x + t.b * y + t.c - 0.5, t.d * x + t.e * y + t.f - 0.5
        rows, columns = self._heights.shape
        inside = (row >= 0) & (row <= rows - 1) & (column >= 0) & (column <= columns - 1)
        r = np.clip(np.floor(np.where(inside, row, 0)).astype(int), 0, max(rows - 2, 0))
        c = np.clip(np.floor(np.where(inside, column, 0)).astype(int), 0, max(columns - 2, 0))
        fr, fc = np.where(inside, row - r, 0.0), np.where(inside, column - c, 0.0)
        r1, c1 = np.minimum(r + 1, rows - 1), np.minimum(c + 1, columns - 1)
        z = self._heights
        top = z[r, c] * (1 - fc) + z[r, c1] * fc
        bottom = z[r1, c] * (1 - fc) + z[r1, c1] * fc
        return np.asarray(np.where(inside, top * (1 - fr) + bottom * fr, np.nan))


def _surface_error(p: Array, u: Array, aim: Array, dem: HeightSurface) -> tuple[Array, Array]:
    """Points of the rays at heights ``aim`` and DEM height minus aim there."""
    ground = ellipsoid.intersect(p, u, np.ascontiguousarray(aim))
    lon, lat, _ = ellipsoid.geodetic_array(ground).T
    return ground, dem.height_m(np.degrees(lon), np.degrees(lat)) - aim


def on_surface(position_m: Array, direction: Array, dem: HeightSurface, file: str) -> Array:
    """First hits of N rays with a DEM: (N, 3) ECEF m.

    Raises
    ------
    InputError
        A ray leaves the DEM or meets nodata.
    """
    low, high = dem.range_m
    aim = np.full(len(position_m), 0.5 * (low + high))
    ground = np.full_like(position_m, np.nan)
    settled = np.zeros(len(position_m), bool)
    for _ in range(MAX_ITERATIONS):
        ground, error = _surface_error(position_m, direction, aim, dem)
        settled = np.abs(error) < TOLERANCE_M
        if settled.all():
            return ground
        aim = np.where(np.isfinite(error) & ~settled, aim + error, aim)
    rest = np.flatnonzero(~settled)
    ground[rest] = [_march(position_m[i : i + 1], direction[i : i + 1], dem, low, high) for i in rest]
    if not np.isfinite(ground).all():
        bad = int(np.flatnonzero(~np.isfinite(ground).all(axis=1))[0])
        raise InputError.of("dem.not_covered", file=dem.path, place=f"ray {bad + 1} of {file}")
    return ground


def _march(p: Array, u: Array, dem: HeightSurface, low: float, high: float) -> Array:
    """First crossing of one ray from above, by marching and bisection; nan if there is none."""
    levels = np.linspace(high + 1.0, low - 1.0, MARCH_STEPS)
    _, errors = _surface_error(np.repeat(p, MARCH_STEPS, 0), np.repeat(u, MARCH_STEPS, 0), levels, dem)
    hits = np.flatnonzero((errors[:-1] < 0.0) & (errors[1:] >= 0.0))
    if not len(hits):
        return np.full(3, np.nan)
    above, below = levels[hits[0]], levels[hits[0] + 1]
    for _ in range(60):
        middle = 0.5 * (above + below)
        ground, error = _surface_error(p, u, np.array([middle]), dem)
        if error[0] < 0.0:
            above = middle
        else:
            below = middle
        if above - below < TOLERANCE_M:
            break
    return np.asarray(ground[0])
