"""Heights above a zero level: vertical CRS of PROJ, geoid files, constants.

The undulation of a zero level is its height above the WGS84 ellipsoid. A geoid file is any raster of undulations that
GDAL reads: GTX, GeoTIFF, ISG, BYN. It is interpolated bilinearly between the centres of its cells, as PROJ does.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.geodesy import (
    Kind,
    ecef_to_geodetic,
    from_geographic,
    grid_folders,
    horizontal_part,
    known_crs,
    longitude_latitude,
    offline_pyproj,
    operation_to_ecef,
    require_finite,
    to_geographic,
)
from fg_orient.geodesy.world_geoid import mistake
from fg_orient.model.errors import InputError

#: Ends of the names of geoid files.
GRID_SUFFIXES: Final = (".gtx", ".tif", ".tiff", ".byn", ".isg")
#: Most cells that are read around the points.
MAX_CELLS: Final = 2**25
#: Cells beyond the outermost centres that are rounding.
_EDGE: Final = 1e-6
_METRES: Final = ("", "m", "metre", "metres", "meter", "meters")
#: Undulations of N points of WGS84 longitude and latitude in degrees, m.
Undulation = Callable[[Array, Array], Array]


def vertical_reference(crs: str) -> tuple[str, str]:
    """Name of the vertical CRS of heights in ``crs`` (WKT or EPSG code), and the unit of its height axis.

    The name of ellipsoidal heights is ``""``; so is the unit if the CRS has no height axis.
    """
    whole = known_crs(crs)
    names = [part.name for part in (whole, *whole.sub_crs_list) if part.is_vertical and not part.is_compound]
    units = [axis.unit_name for axis in whole.axis_info if axis.direction in ("up", "down")]
    return (names[0] if names else ""), (units[0] if units else "")


def with_vertical(crs: str, vertical: str) -> tuple[str, str]:
    """Horizontal part of a CRS, and its compound with a vertical CRS ("": its own), as WKT.

    Raises
    ------
    InputError
        A CRS is unknown, or ``vertical`` is not a vertical CRS.
    """
    whole = known_crs(crs)
    flat = horizontal_part(whole)
    if not vertical:
        return str(flat.to_wkt()), str(whole.to_wkt())
    heights = known_crs(vertical)
    if not heights.is_vertical or heights.is_compound:
        raise InputError.of("geodesy.not_vertical", place="vertical crs", value=f"{vertical}, {heights.name}")
    both = offline_pyproj().crs.CompoundCRS(f"{flat.name} + {heights.name}", [flat, heights])
    return str(flat.to_wkt()), str(both.to_wkt())


def undulation_m(crs: str, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
    """Height of the zero level of a compound CRS above the WGS84 ellipsoid.

    Parameters
    ----------
    crs : str
    x, y : (N,) array_like
        Easting and northing, or longitude and latitude, in units of the CRS.

    Returns
    -------
    (N,) array
        m.

    Raises
    ------
    InputError
        The grid of the geoid is missing, or does not cover a point.
    """
    source = known_crs(crs)
    given = np.stack([np.asarray(x, float), np.asarray(y, float), np.zeros(np.shape(x))], axis=1)
    kind: Kind = "projected" if source.sub_crs_list[0].is_projected else "geographic"
    lonlat = longitude_latitude(source.name, source, kind, given, None)
    try:
        transformer = operation_to_ecef(source.name, source, lonlat)[0]
    except InputError as error:
        grid = found_grid(error)
        if grid is None:
            raise
        return grid.undulation_m(*to_geographic(horizontal_part(source).to_wkt(), *given[:, :2].T))
    xyz = np.stack(transformer.transform(*given.T), axis=1)
    require_finite(source.name, xyz, given, None)
    return ecef_to_geodetic(xyz)[2]


class GeoidFile:
    """Undulations of a raster that GDAL reads; only the cells around the points are read.

    Parameters
    ----------
    path : path
        Its horizontal CRS is that of the file, or geographic degrees if it states none.

    Raises
    ------
    InputError
        rasterio is missing, the file cannot be read, or its unit is not metres.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        with self._opened() as source:
            if source.transform.is_degenerate:
                raise InputError.of("geoid.unreadable", file=self.path, value="size of a cell")
            self._to_cell, (self._rows, self._columns) = ~source.transform, source.shape
            self._crs = source.crs.to_wkt() if source.crs else "EPSG:4326"
            unit = source.units[0] or ""
        if unit.strip().lower() not in _METRES:
            raise InputError.of("geoid.unit", file=self.path, value=unit)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open the raster; GDAL's errors while it is open become InputError."""
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
                source = rasterio.open(self.path)
            with source:
                yield source
        except (rasterio.errors.RasterioError, no_place, ValueError) as error:  # the last one: damaged text
            raise InputError.of("geoid.unreadable", file=self.path, value=error) from error

    def undulation_m(self, lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike) -> Array:
        """Undulations of N points (N,), degrees.

        Raises
        ------
        InputError
            A point lies outside the grid or has no value; the values are not undulations in metres: wrong sign or
            unit, or another kind of raster.
        """
        lon, lat = (np.atleast_1d(np.asarray(a, float)) for a in (lon_deg, lat_deg))
        x, y = (lon, lat) if known_crs(self._crs).is_geographic else from_geographic(self._crs, lon, lat)
        t = self._to_cell
        row, column = t.d * x + t.e * y + t.f - 0.5, t.a * x + t.b * y + t.c - 0.5
        turn = 360.0 * abs(t.a) if known_crs(self._crs).is_geographic else np.inf  # columns around the Earth
        if np.isfinite(turn):
            column = np.mod(column + _EDGE, turn) - _EDGE
        closed = self._columns >= turn - _EDGE  # no gap between the last column and the first one
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
            raise InputError.of(code, file=self.path, place=f"longitude {lon[k]:.6f}, latitude {lat[k]:.6f}",
                                value=f"{int(rows.sum())} of {len(rows)} points")  # fmt: skip

    def _interpolated(self, row: Array, column: Array) -> Array:
        """Values between the centres of cells; nan where a cell with a weight has no value."""
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
            (r, c, (1.0 - (row - r)) * (1.0 - (column - c))), (r, right, (1.0 - (row - r)) * (column - c)),
            (below, c, (row - r) * (1.0 - (column - c))), (below, right, (row - r) * (column - c)),
        ):  # fmt: skip
            out += np.where(weight > 0.0, values[i - top, j - left] * weight, 0.0)
        return out


def found_grid(error: InputError) -> GeoidFile | None:
    """Geoid file in PROJ's folders under another name or format than the one that a missing operation needs.

    None if ``error`` has another reason, or there is no such file.
    """
    stems = {_stem(name) for name in str(error.problems[0].data.get("grids", "")).split(", ")}
    for folder in map(Path, grid_folders()):
        for path in sorted(folder.glob("*")) if folder.is_dir() else ():
            if path.suffix.lower() in GRID_SUFFIXES and _stem(path.name) in stems:
                return GeoidFile(path)
    return None


def _stem(name: str) -> str:
    """Name of a grid without suffix, country and agency (``us_nga_``), and with - for _."""
    parts = Path(name.lower()).stem.split("_", 2)
    return (parts[2] if len(parts) == 3 and len(parts[0]) == 2 else "_".join(parts)).replace("_", "-")
