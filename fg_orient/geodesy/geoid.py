"""Reading of geoid files. A coarse world geoid reveals wrong files: wrong sign, wrong unit, or no geoid.

A geoid file is any raster that GDAL reads (GTX, GeoTIFF, ISG, BYN) with undulations: heights above the WGS84 ellipsoid.
As in PROJ, values are interpolated bilinearly between the centres of cells.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.geodesy import from_geographic, known_crs
from fg_orient.model.errors import InputError
from fg_orient.model.raster_limits import invertible, open_bounded

#: File suffixes of geoid files.
GRID_SUFFIXES: Final = (".gtx", ".tif", ".tiff", ".byn", ".isg")
#: Largest number of cells that are read around the points.
MAX_CELLS: Final = 2**25
#: Tolerance for rounding, in cells, beyond the outermost centres.
_EDGE: Final = 1e-6
_METRES: Final = ("", "m", "metre", "metres", "meter", "meters")
#: Largest difference, m, of the coarse geoid from EGM96 (28.5 m; RMS 3.4 m) and from other geoids and zero levels.
LIMIT_M: Final = 30.0
STEP_DEG: Final = 10
#: Undulations of EGM96 (NGA, public domain) in whole metres: rows from latitude 90 to -90, columns from longitude -180
#: to 170.
_EGM96_M: Final = """
14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 14 4 3 1 0 -2
-3 -1 4 3 11 15 7 18 28 34 36 32 32 34 35 30 24 18 13 9 4 2 2 2 0 -1 -1 0 3 1 2 3 1 -1 -1 -3 -8 -15 -25 -28 -26 -18 3
23 30 46 57 60 56 49 42 30 20 11 3 -3 -9 -13 -13 -15 -9 -9 -6 -1 2 3 4 0 9 15 13 11 0 -16 -31 -42 -47 -42 -23 5 29 49
64 61 55 48 40 19 16 11 6 -4 -21 -31 -34 -34 -28 -17 1 12 16 14 9 -6 5 7 0 -12 -18 -16 -17 -24 -35 -40 -26 -13 24 45
62 62 58 45 48 40 27 11 -12 -19 -33 -45 -42 -42 -30 -5 15 22 20 6 3 -13 -11 -13 -21 -31 -37 -23 -18 -25 -33 -34 -35
-27 1 32 59 52 49 51 46 34 39 29 -16 -28 -41 -56 -67 -55 -29 3 23 38 17 -2 -11 -8 -5 -9 -16 -28 -40 -42 -30 -23 -27
-32 -52 -41 -18 16 30 34 43 35 28 26 16 10 -18 -15 -39 -35 -34 -32 -24 7 30 42 19 3 -7 4 9 8 -7 -23 -39 -48 -34 -7 -11
-19 -47 -47 -33 -10 17 25 30 31 27 14 10 2 -31 -43 -61 -68 -60 -37 -13 21 38 49 41 22 9 13 12 10 1 -11 -29 -39 -29 -12
1 1 -11 -42 -43 -16 3 17 33 23 22 2 -5 -10 -32 -58 -91 -96 -63 -25 11 52 59 61 45 35 25 21 15 16 13 1 -13 -23 -20 -14
-4 14 14 -13 -26 -19 2 13 19 17 9 -17 -10 -27 -49 -63 -89 -103 -63 -7 34 58 77 72 63 49 32 35 21 11 5 -3 -9 -11 -8 -12
-9 -1 27 3 -19 -12 -10 4 13 11 13 6 -13 -27 -32 -38 -61 -76 -65 -27 -2 36 52 69 78 63 51 50 26 9 -1 -9 -11 -6 -2 -4 -1
8 34 20 -8 -7 -6 -1 12 16 23 22 7 -10 -11 -10 -21 -40 -48 -46 -26 4 24 46 57 57 64 48 23 6 -1 -9 -13 -10 -8 -4 1 8 37
18 3 -9 3 10 15 21 26 34 30 14 14 15 6 -9 -25 -38 -40 -23 -14 13 32 33 44 21 6 1 -7 -12 -13 -13 -10 -7 -1 7 23 14 -3
-7 6 21 23 17 25 29 33 38 40 29 23 13 -2 -21 -33 -34 -27 -15 -2 5 19 -17 -19 -18 -16 -17 -16 -10 -11 -9 -3 5 11 12 2 3
11 20 27 25 25 33 38 45 45 38 40 27 13 -2 -15 -23 -22 -19 -17 -14 -10 -46 -43 -37 -32 -30 -27 -24 -23 -17 -11 -4 9 20
20 22 24 21 17 15 20 25 29 34 33 33 29 25 9 -3 -14 -25 -31 -33 -30 -35 -44 -62 -63 -61 -57 -52 -44 -37 -33 -26 -21 -10
4 5 0 3 1 2 9 14 14 16 21 21 27 26 17 16 8 -6 -18 -29 -37 -44 -55 -56 -59 -53 -53 -52 -51 -48 -42 -39 -37 -28 -22 -25
-22 -21 -20 -18 -17 -13 -10 -7 -3 1 4 4 6 8 5 4 -2 -14 -24 -34 -41 -49 -50 -54 -51 -30 -30 -30 -30 -30 -30 -30 -30 -30
-30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30 -30
"""
#: Factors that correct possible wrong units and signs of undulations.
MISTAKES: Final = {
    "has the opposite sign": -1.0, "is in feet": 0.3048, "is in centimetres": 0.01, "is in millimetres": 0.001,
}  # fmt: skip


def world_undulation_m(lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike) -> Array:
    """Return the undulation of N points (N,), degrees, above the WGS84 ellipsoid, m, accurate to ``LIMIT_M``."""
    grid = np.array(_EGM96_M.split(), float).reshape(180 // STEP_DEG + 1, 360 // STEP_DEG)
    column = np.mod(np.asarray(lon_deg, float) + 180.0, 360.0) / STEP_DEG
    row = (90.0 - np.asarray(lat_deg, float)) / STEP_DEG
    c, r = np.minimum(column.astype(int), grid.shape[1] - 1), np.clip(row.astype(int), 0, len(grid) - 2)
    right, x, y = (c + 1) % grid.shape[1], column - c, row - r
    above = grid[r, c] * (1.0 - x) + grid[r, right] * x
    below = grid[r + 1, c] * (1.0 - x) + grid[r + 1, right] * x
    return np.asarray(above * (1.0 - y) + below * y)


def mistake(undulation_m: Array, lon_deg: Array, lat_deg: Array) -> tuple[str, float]:
    """Describe the error of undulations (N,), m, and give their median; "" if a geoid can have these undulations."""
    world, median = world_undulation_m(lon_deg, lat_deg), float(np.median(undulation_m))
    apart = {what: float(np.median(np.abs(factor * undulation_m - world))) for what, factor in MISTAKES.items()}
    if np.abs(undulation_m - world).max() <= LIMIT_M:
        return "", median
    best = min(apart, key=apart.__getitem__)
    return (best if apart[best] <= LIMIT_M / 2.0 else "is no geoid in metres"), median


class GeoidFile:
    """Undulations of a raster that GDAL reads; only the cells around the points are read.

    Parameters
    ----------
    path : path
        If the file has no horizontal CRS, its coordinates are geographic degrees.

    Raises
    ------
    InputError
        rasterio is missing, the file cannot be read, or its unit is not metres.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        with self._opened() as source:
            if not invertible(source.transform):
                raise InputError.of("geoid.unreadable", file=self.path, value="size of a cell")
            self._to_cell, (self._rows, self._columns) = ~source.transform, source.shape
            self._crs = source.crs.to_wkt() if source.crs else "EPSG:4326"
            unit = source.units[0] or ""
        if unit.strip().lower() not in _METRES:
            raise InputError.of("geoid.unit", file=self.path, value=unit)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open the raster; convert GDAL's errors inside the context to InputError."""
        try:
            import rasterio
        except ImportError as error:
            raise InputError.of("geoid.no_rasterio", file=self.path) from error
        if not self.path.is_file():
            raise InputError.of("geoid.missing", file=self.path)
        no_place = rasterio.errors.NotGeoreferencedWarning
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", no_place)
                source = open_bounded(rasterio, self.path)
            with source:
                yield source
        # GDAL's reader raises ValueError for damaged text
        except (rasterio.errors.RasterioError, no_place, ValueError) as error:
            raise InputError.of("geoid.unreadable", file=self.path, value=error) from error

    def undulation_m(self, lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike) -> Array:
        """Return the undulations (N,), m, at N points given in degrees.

        Raises
        ------
        InputError
            A point lies outside the grid or has no value; or the values are not undulations in metres (wrong sign,
            wrong unit, another kind of raster).
        """
        lon, lat = (np.atleast_1d(np.asarray(a, float)) for a in (lon_deg, lat_deg))
        x, y = (lon, lat) if known_crs(self._crs).is_geographic else from_geographic(self._crs, lon, lat)
        t = self._to_cell
        row, column = t.d * x + t.e * y + t.f - 0.5, t.a * x + t.b * y + t.c - 0.5
        turn = 360.0 * abs(t.a) if known_crs(self._crs).is_geographic else np.inf  # number of columns around the Earth
        if np.isfinite(turn):
            column = np.mod(column + _EDGE, turn) - _EDGE
        # a grid around the Earth has no gap between the last column and the first one
        closed = self._columns >= turn - _EDGE
        outside = ~((row >= -_EDGE) & (row <= self._rows - 1 + _EDGE))
        outside |= ~((column >= -_EDGE) & (closed | (column <= self._columns - 1 + _EDGE)))
        self._refuse("geoid.outside", outside, lon, lat)
        last = np.inf if closed else self._columns - 1.0
        out = self._interpolated(np.clip(row, 0.0, self._rows - 1.0), np.clip(column, 0.0, last))
        self._refuse("geoid.no_value", np.isnan(out), lon, lat)
        wrong, median = mistake(out, lon, lat)
        if wrong:
            raise InputError.of("geoid.wrong", file=self.path, value=f"{median:.6g}", what=wrong)
        return out

    def _refuse(self, code: str, rows: npt.NDArray[np.bool_], lon: Array, lat: Array) -> None:
        if rows.any():
            k = int(np.argmax(rows))
            raise InputError.of(
                code,
                file=self.path,
                place=f"longitude {lon[k]:.6f}, latitude {lat[k]:.6f}",
                value=f"{int(rows.sum())} of {len(rows)} points",
            )

    def _interpolated(self, row: Array, column: Array) -> Array:
        """Return the values between the centres of cells; nan if a cell with a weight has no value."""
        r, c = row.astype(int), column.astype(int)
        below, right = np.minimum(r + 1, self._rows - 1), (c + 1) % self._columns
        top, left = int(r.min()), 0 if (right < c).any() else int(c.min())
        bottom, end = int(below.max()) + 1, self._columns if (right < c).any() else int(right.max()) + 1
        if (bottom - top) * (end - left) > MAX_CELLS:
            raise InputError.of("geoid.too_large", file=self.path, value=f"{bottom - top} x {end - left} cells")
        with self._opened() as source:
            cells = source.read(1, window=((top, bottom), (left, end)), masked=True)
            values = cells.astype(float).filled(np.nan) * source.scales[0] + source.offsets[0]
        out = np.zeros(len(row))
        for i, j, weight in (
            (r, c, (1.0 - (row - r)) * (1.0 - (column - c))),
            (r, right, (1.0 - (row - r)) * (column - c)),
            (below, c, (row - r) * (1.0 - (column - c))),
            (below, right, (row - r) * (column - c)),
        ):
            out += np.where(weight > 0.0, values[i - top, j - left] * weight, 0.0)
        return out
