"""Digital elevation models and the intersection of rays with them.

The intersection is the first hit from above (docs/equations.md 5). Iterating height -> ellipsoid -> DEM height could
converge behind a ridge. Every ray is therefore followed from the highest DEM value downwards, from one line between
cell centres to the next, because a bilinear surface has its edges there. The first change of sign, at an edge or at
the peak of a cell, is bisected. Heights of a raster without vertical CRS are ellipsoidal. Heights with a vertical CRS
are converted once to ellipsoidal heights, by PROJ and its geoid grids or by a geoid file. A missing
grid is refused, and so are units other than the metre.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from factors.geometry import ellipsoid
from fg_orient.geodesy import from_geographic, to_geographic
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.correction import HeightSurface

__all__ = ["RasterDem"]

#: Largest height difference of a hit and the DEM.
TOLERANCE_M = 1e-4
#: Rays are followed from this far above to this far below all DEM values (10 times the tolerance).
MARGIN_M = 1e-3
#: Plausible heights of a DEM, m: the lowest land is at -430, the highest at 8849. Others are undeclared nodata.
PLAUSIBLE_M: Final = (-500.0, 9000.0)
#: Knots of the undulation in a DEM: largest step, cells, and largest interpolation error.
KNOT_STEP, UNDULATION_M = 32, 1e-3
METRES = ("", "m", "metre", "metres", "meter", "meters")


class RasterDem:
    """A DEM read through rasterio, bilinear between pixel centres.

    Parameters
    ----------
    path : path
        Raster that rasterio reads, with a geographic or projected CRS and heights in m.
    vertical_crs : str, optional
        CRS of the heights, such as ``EPSG:5773`` or its name, ``EGM96``, if the file has none; or a geoid file. Heights
        without a vertical CRS are ellipsoidal.

    Attributes
    ----------
    heights_m : (rows, columns) array
        Ellipsoidal heights, nan at nodata, and at heights outside ``PLAUSIBLE_M``.
    notes : tuple of Finding
        Warning of heights outside ``PLAUSIBLE_M``, with the number of cells.
    crs : str
        Horizontal coordinate system as WKT.

    Raises
    ------
    InputError
        The file cannot be read or has no CRS, its heights are not in metres, the geoid's grid is missing, or
        the file names another vertical CRS.
    """

    def __init__(self, path: str | Path, *, vertical_crs: str = "") -> None:
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
                self.heights_m = source.read(1, masked=True).astype(float).filled(np.nan)
                self._pixel_from_crs = ~source.transform
                self.crs = str(source.crs.to_wkt())
                unit = source.units[0] or ""
        except rasterio.RasterioIOError as error:
            raise InputError.of("dem.unreadable", file=path, value=error) from error
        self.path, self.vertical_crs = str(path), vertical_crs
        self.notes = self._without_implausible()
        self._to_ellipsoid(unit, vertical_crs)

    def _without_implausible(self) -> tuple[Finding, ...]:
        """Treat implausible heights as nodata; a height of -9999 m would bend every ray that passes near it."""
        low, high = PLAUSIBLE_M
        wrong = (self.heights_m < low) | (self.heights_m > high)
        if not wrong.any():
            return ()
        values = self.heights_m[wrong]
        found = finding("dem.implausible", file=self.path, count=int(wrong.sum()), low=low, high=high,
                        least=float(values.min()), most=float(values.max()))  # fmt: skip
        self.heights_m[wrong] = np.nan
        return (found,)

    def _to_ellipsoid(self, unit: str, given: str) -> None:
        """Add the undulation of a vertical CRS or geoid file; keep the horizontal CRS."""
        from fg_orient.geodesy.crs import vertical_code
        from fg_orient.geodesy.geoid import GRID_SUFFIXES, GeoidFile
        from fg_orient.geodesy.heights import undulation_m, vertical_reference, with_vertical

        stated, axis_unit = vertical_reference(self.crs)
        wrong = [u for u in (axis_unit, unit) if u.strip().lower() not in METRES]
        if wrong:
            raise InputError.of("dem.vertical_unit", file=self.path, value=wrong[0])
        if not (stated or given):
            return
        if given.lower().endswith(GRID_SUFFIXES):
            grid = GeoidFile(given)
            flat = self.crs = with_vertical(self.crs, "")[0]
            self.heights_m += self._undulations(lambda x, y: grid.undulation_m(*to_geographic(flat, x, y)))
            return
        self.crs, both = with_vertical(self.crs, vertical_code(given))
        if stated and given and vertical_reference(both)[0] != stated:
            raise InputError.of("dem.vertical_crs", file=self.path, value=f"{stated}, not {given}")
        self.heights_m += self._undulations(lambda x, y: undulation_m(both, x, y))

    def _undulations(self, undulation_of: Callable[[Array, Array], Array]) -> Array:
        """Undulation at the centres of all cells (rows, columns): exact at knots, bilinear between them.

        The step of the knots is halved until the error at the middles between them is at most ``UNDULATION_M``.
        """
        t, shape = ~self._pixel_from_crs, self.heights_m.shape

        def exact(row: Array, column: Array) -> Array:
            r, c = (a.ravel() + 0.5 for a in np.meshgrid(row, column, indexing="ij"))
            try:
                undulation = undulation_of(t.a * c + t.b * r + t.c, t.d * c + t.e * r + t.f)
            except InputError as error:
                raise InputError.of("dem.geoid", file=self.path, reason=error.problems[0].message,
                                    value=error.problems[0].value) from None  # fmt: skip
            return undulation.reshape(len(row), len(column))

        step = KNOT_STEP
        while True:
            knots = [np.unique(np.append(np.arange(0.0, n, step), n - 1.0)) for n in shape]
            values = exact(*knots)
            if step == 1:
                return values
            middles = [0.5 * (k[:-1] + k[1:]) if len(k) > 1 else k for k in knots]
            if np.abs(_bilinear(knots, values, middles) - exact(*middles)).max() <= UNDULATION_M:
                return _bilinear(knots, values, [np.arange(float(n)) for n in shape])
            step //= 2

    def outline(self) -> tuple[Array, Array]:
        """Longitude and latitude (degrees) of points along the border of the raster's cell centres."""
        rows, columns = self.heights_m.shape
        r, c = (a.ravel() for a in np.meshgrid(*(np.linspace(0.5, n - 0.5, 9) for n in (rows, columns)), indexing="ij"))
        t = ~self._pixel_from_crs
        return to_geographic(self.crs, t.a * c + t.b * r + t.c, t.d * c + t.e * r + t.f)

    @cached_property
    def range_m(self) -> tuple[float, float]:
        """Lowest and highest height of the raster."""
        return float(np.nanmin(self.heights_m)), float(np.nanmax(self.heights_m))

    def cell(self, lon_deg: Array, lat_deg: Array) -> tuple[Array, Array]:
        """Row and column of N points, whole at the centres of cells; nan outside the domain of the CRS.

        Parameters
        ----------
        lon_deg, lat_deg : (N,) array_like
            WGS84.
        """
        x, y = from_geographic(self.crs, lon_deg, lat_deg)
        t = self._pixel_from_crs
        return np.asarray(t.d * x + t.e * y + t.f - 0.5), np.asarray(t.a * x + t.b * y + t.c - 0.5)

    def height_m(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Heights of N points, bilinear; nan outside the raster or at nodata.

        Parameters
        ----------
        lon_deg, lat_deg : (N,) array_like
            WGS84.
        """
        row, column = self.cell(lon_deg, lat_deg)
        rows, columns = self.heights_m.shape
        inside = (row >= 0) & (row <= rows - 1) & (column >= 0) & (column <= columns - 1)
        r = np.clip(np.floor(np.where(inside, row, 0)).astype(int), 0, max(rows - 2, 0))
        c = np.clip(np.floor(np.where(inside, column, 0)).astype(int), 0, max(columns - 2, 0))
        fr, fc = np.where(inside, row - r, 0.0), np.where(inside, column - c, 0.0)
        r1, c1 = np.minimum(r + 1, rows - 1), np.minimum(c + 1, columns - 1)
        z = self.heights_m
        top = z[r, c] * (1 - fc) + z[r, c1] * fc
        bottom = z[r1, c] * (1 - fc) + z[r1, c1] * fc
        return np.asarray(np.where(inside, top * (1 - fr) + bottom * fr, np.nan))


def _bilinear(knots: list[Array], values: Array, at: list[Array]) -> Array:
    """Values on the grid ``at``, interpolated from the grid of ``knots``."""
    rows = np.stack([np.interp(at[1], knots[1], row) for row in values])
    return np.stack([np.interp(at[0], knots[0], column) for column in rows.T], axis=1)


def _lon_lat(p: Array, u: Array, level_m: Array) -> tuple[Array, Array, Array]:
    """Points (N, 3) of the rays at heights ``level_m``, their longitudes and latitudes in degrees."""
    ground = ellipsoid.intersect(p, u, np.ascontiguousarray(level_m))
    lon, lat, _ = ellipsoid.geodetic_array(ground).T
    return ground, np.degrees(lon), np.degrees(lat)


def _depth(p: Array, u: Array, level_m: Array, dem: HeightSurface) -> tuple[Array, Array]:
    """Points of the rays at heights ``level_m``, and their depths below the DEM (nan: no DEM)."""
    ground, lon, lat = _lon_lat(p, u, level_m)
    return ground, dem.height_m(lon, lat) - level_m


def on_surface(position_m: Array, direction: Array, dem: HeightSurface, file: str) -> Array:
    """First hits of N rays with a DEM: (N, 3) ECEF m.

    A ray that meets nodata, or comes from outside the DEM, before its first hit and below the highest DEM value is
    refused: unknown ground there could hide the hit. Two crossings within half a cell, between edges of the surface,
    are not separated.

    Parameters
    ----------
    position_m, direction : (N, 3) arrays
        Rays, ECEF, from above the DEM.
    dem : HeightSurface
    file : str
        Metadata file of the rays, for messages.

    Raises
    ------
    InputError
        A ray meets nodata or leaves the DEM before it hits the surface.
    """
    above, below = _bracket(position_m, direction, dem)
    ground, depth = _bisect(position_m, direction, above, below, dem)
    bad = np.flatnonzero(~np.isfinite(depth))
    if len(bad):
        raise InputError.of("dem.not_covered", file=dem.path, place=f"ray {bad[0] + 1} of {file}",
                            value=f"{len(bad)} of {len(depth)} rays")  # fmt: skip
    return ground


def landed(
    position_m: Array, direction: Array, height_m: npt.ArrayLike | None, dem: HeightSurface | None,
    pixels: tuple[Array, Array], file: str,
) -> Array:  # fmt: skip
    """Points (N, 3) ECEF m of N rays on a DEM (:func:`on_surface`), or at ellipsoidal heights (default 0).

    ``pixels`` are two (N,) arrays, line and sample of the rays; they and ``file`` are for messages.

    Raises
    ------
    InputError
        A ray does not reach its height or the DEM.
    """
    if dem is not None:
        return on_surface(position_m, direction, dem, file)
    # a copy: the kernel would be compiled again for a read-only array, which one height for all rays gives
    h = np.array(np.broadcast_to(np.asarray(0.0 if height_m is None else height_m, float), pixels[0].shape))
    ground = ellipsoid.intersect(position_m, direction, h)
    bad = np.flatnonzero(~np.isfinite(ground).all(axis=1))
    if len(bad):
        line, sample = (values[bad[0]] for values in pixels)
        raise InputError.of("sensor.ray_misses", file=file, place=f"line {line:g}, sample {sample:g}",
                            value=f"height {h[bad[0]]:g} m")  # fmt: skip
    return np.asarray(ground)


def _bracket(p: Array, u: Array, dem: HeightSurface) -> tuple[Array, Array]:
    """Heights just above and below the first hit of each ray; nan without a hit."""
    top, bottom = dem.range_m[1] + MARGIN_M, dem.range_m[0] - MARGIN_M
    lines = _GridLines(*(_cells(p, u, level, dem) for level in (top, bottom)))
    above, below = np.full(len(p), np.nan), np.full(len(p), np.nan)
    going, last, t = np.arange(len(p)), np.full(len(p), top), np.zeros(len(p))  # no cell reaches the top
    depth = _depth(p, u, last, dem)[1]
    while len(going):
        # along a ray the surface of one cell is a parabola: three depths determine its peak
        start, ahead = t[going], lines.after(going)
        level = top + (bottom - top) * (start + np.array([[0.5], [1.0]]) * (ahead - start))
        middle, end = (_depth(p[going], u[going], h, dem)[1] for h in level)
        peak = _peak(depth[going], middle, end)
        risen = np.flatnonzero(np.isfinite(peak) & (middle < 0.0))
        peak_level = last[going] + peak * (level[1] - last[going])
        up = _depth(p[going[risen]], u[going[risen]], peak_level[risen], dem)[1] >= 0.0
        for rays, low in ((middle >= 0.0, level[0]), (np.isin(np.arange(len(going)), risen[up]), peak_level)):
            above[going[rays]], below[going[rays]] = last[going[rays]], low[rays]
        free = (middle < 0.0) & np.isnan(below[going])
        hit = free & (end >= 0.0)
        above[going[hit]], below[going[hit]] = level[0][hit], level[1][hit]
        last[going], t[going], depth[going] = level[1], ahead, end
        going = going[free & (end < 0.0) & (ahead < 1.0)]  # neither hit nor free: nodata
    return above, below


def _peak(start: Array, middle: Array, end: Array) -> Array:
    """Position (0 to 1) of the peak of parabolas through three values, nan unless it is inside and reaches 0."""
    curve, slope = 2.0 * (start - 2.0 * middle + end), 4.0 * middle - 3.0 * start - end
    with np.errstate(divide="ignore", invalid="ignore"):
        x = -0.5 * slope / curve
        # within a centimetre of 0 the depth is computed from the surface
        return np.where((curve < 0.0) & (x > 0.0) & (x < 1.0) & (start + 0.5 * slope * x > -0.01), x, np.nan)


def _cells(p: Array, u: Array, level_m: float, dem: HeightSurface) -> Array:
    """Row and column of N rays at one height: (N, 2)."""
    _, lon, lat = _lon_lat(p, u, np.full(len(p), level_m))
    return np.stack(dem.cell(lon, lat), axis=1)


class _GridLines:
    """Successive crossings of N straight paths with the lines between cell centres.

    Paths run from ``start`` to ``end`` (N, 2) rows and columns, t = 0 to 1 (Amanatides & Woo 1987).
    A ray deviates from its straight path by centimetres over some kilometres.
    """

    def __init__(self, start: Array, end: Array) -> None:
        self._start, self._travel = start, end - start
        sign = np.sign(self._travel)
        self._line = np.where(sign > 0.0, np.floor(start) + 1.0, np.ceil(start) - 1.0)
        self._sign = sign

    def after(self, path: Index) -> Array:
        """Parameter t of the next crossing of these paths, 1 if there is no further crossing or the path is nan."""
        travel = self._travel[path]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (self._line[path] - self._start[path]) / travel
        t = np.where(travel == 0.0, np.inf, np.nan_to_num(t, nan=np.inf))
        nearest = t.min(axis=1)
        self._line[path] += np.where(t == nearest[:, None], self._sign[path], 0.0)
        return np.asarray(np.minimum(nearest, 1.0))


def _bisect(p: Array, u: Array, above: Array, below: Array, dem: HeightSurface) -> tuple[Array, Array]:
    """Points of the rays on the DEM between two heights, and the remaining depths; nan for nan heights."""
    widest = float(np.nan_to_num(above - below).max(initial=TOLERANCE_M))
    for _ in range(int(np.ceil(np.log2(widest / TOLERANCE_M)))):
        middle = 0.5 * (above + below)
        depth = _depth(p, u, middle, dem)[1]
        above = np.where(np.isnan(depth), np.nan, np.where(depth < 0.0, middle, above))
        below = np.where(depth < 0.0, below, middle)
    return _depth(p, u, 0.5 * (above + below), dem)
