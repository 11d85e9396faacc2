"""Intersect rays with digital elevation models.

The intersection is the first hit from above (docs/equations.md 5). An iteration between
height and DEM value could converge behind a ridge. Therefore every ray is followed
downwards from the highest DEM value. It is tested at each line between cell centres,
because a bilinear surface has its edges there, and at the peak of a cell. The interval of
the first change of sign is bisected. The highest DEM value is taken from the squares below the ray
(:mod:`fg_orient.sensors.dem`). Therefore a large DEM is not read completely, and a ray does not depend
on other rays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from factors.geometry import ellipsoid
from fg_orient.model.errors import InputError
from fg_orient.sensors.correction import HeightSurface
from fg_orient.sensors.dem import EDGE, PLAUSIBLE_M, UNDULATION_RANGE_M, RasterDem
from fg_orient.sensors.dem_cells import groups

if TYPE_CHECKING:
    from fg_orient.geodesy.bodies import Body

__all__ = ["RasterDem"]

#: Maximum height difference between a hit and the DEM, m.
TOLERANCE_M = 1e-4
#: Rays are followed from this height above all DEM values to this height below them, m (10 times the tolerance).
MARGIN_M = 1e-3
#: Rays whose paths begin in the same square with this edge, cells, are followed together.
GROUP_CELLS = 4 * EDGE


def _lon_lat(p: Array, u: Array, level_m: Array) -> tuple[Array, Array, Array]:
    """Return the points (N, 3) of the rays at heights ``level_m``, and their longitudes and latitudes, degrees."""
    ground = ellipsoid.intersect(p, u, np.ascontiguousarray(level_m))
    lon, lat, _ = ellipsoid.geodetic_array(ground).T
    return ground, np.degrees(lon), np.degrees(lat)


def _depth(p: Array, u: Array, level_m: Array, dem: HeightSurface) -> tuple[Array, Array]:
    """Return the points of the rays at heights ``level_m``, and their depths below the DEM; nan without a DEM value."""
    ground, lon, lat = _lon_lat(p, u, level_m)
    return ground, dem.height_m(lon, lat) - level_m


def on_surface(position_m: Array, direction: Array, dem: HeightSurface, file: str) -> Array:
    """Return the first hits (N, 3), ECEF m, of N rays with a DEM.

    A ray is refused if it meets nodata before its first hit. It is also refused if it enters the DEM
    from outside, below the highest DEM value of the squares under the ray. Unknown ground there could
    be the first hit. Two crossings within half a cell, between edges of the surface, are not separated.

    Parameters
    ----------
    position_m, direction : (N, 3) arrays
        Rays in ECEF that start above the DEM.
    dem : HeightSurface
    file : str
        Metadata file of the rays; used in messages.

    Raises
    ------
    InputError
        A ray meets nodata or leaves the DEM before it hits the surface.
    """
    levels = levels_below(position_m, direction, dem)
    ground, depth = np.empty(position_m.shape), np.empty(len(position_m))
    for rays in _groups(position_m, direction, levels[1], dem):
        p, u = (np.ascontiguousarray(part[rays]) for part in (position_m, direction))
        above, below = _bracket(p, u, levels[0][rays] - MARGIN_M, levels[1][rays] + MARGIN_M, dem)
        ground[rays], depth[rays] = _bisect(p, u, above, below, dem)
    bad = np.flatnonzero(~np.isfinite(depth))
    if len(bad):
        raise InputError.of("dem.not_covered", file=dem.path, place=f"ray {bad[0] + 1} of {file}",
                            value=f"{len(bad)} of {len(depth)} rays")  # fmt: skip
    return ground


def landed(
    position_m: Array, direction: Array, height_m: npt.ArrayLike | None, dem: HeightSurface | None,
    pixels: tuple[Array, Array], file: str, body: Body | None = None,
) -> Array:  # fmt: skip
    """Return the points (N, 3), ECEF m, of N rays on a DEM (:func:`on_surface`) or at ellipsoidal heights (default 0).

    ``pixels`` are two arrays (N,) with line and sample of the rays. They and ``file`` are
    used in messages. Points on another ``body`` than the Earth have coordinates in its
    body-fixed axes.

    Raises
    ------
    InputError
        A ray does not reach its height or the DEM.
    """
    if dem is not None and body is not None:
        raise InputError.of("body.dem", file=file, place=dem.path, value=body.name)
    if dem is not None:
        return on_surface(position_m, direction, dem, file)
    # one height for all rays gives a read-only array; without a copy, the kernel would be compiled again for it
    h = np.array(np.broadcast_to(np.asarray(0.0 if height_m is None else height_m, float), pixels[0].shape))
    ground = (ellipsoid if body is None else body).intersect(position_m, direction, h)
    bad = np.flatnonzero(~np.isfinite(ground).all(axis=1))
    if len(bad):
        line, sample = (values[bad[0]] for values in pixels)
        raise InputError.of("sensor.ray_misses", file=file, place=f"line {line:g}, sample {sample:g}",
                            value=f"height {h[bad[0]]:g} m")  # fmt: skip
    return np.asarray(ground)


def levels_below(position_m: Array, direction: Array, dem: HeightSurface) -> tuple[Array, Array]:
    """Return the lowest and highest DEM value (N,) below each ray; nan if the ray does not pass over the DEM.

    The highest value is limited to the height of the ray's start, because a camera may be in a valley.
    """
    n = len(position_m)
    if not isinstance(dem, RasterDem):
        low, high = dem.range_m
        return np.full(n, low), np.full(n, high)
    start_m = ellipsoid.geodetic_array(np.ascontiguousarray(position_m))[:, 2] - 2.0 * MARGIN_M
    bottom, top = (a + b for a, b in zip(PLAUSIBLE_M, UNDULATION_RANGE_M, strict=True))
    ends = [_cells(position_m, direction, level, dem) for level in (np.minimum(top, start_m), np.full(n, bottom))]
    lows, highs = dem.range_along(*ends)
    return lows, np.minimum(highs, start_m)


def _groups(p: Array, u: Array, level_m: Array, dem: HeightSurface) -> list[Index]:
    """Group rays over neighbouring squares of a DEM, so that each square is read once.

    Rays of nan are left out.
    """
    good = np.flatnonzero(np.isfinite(level_m))
    if not isinstance(dem, RasterDem) or len(good) < 2:
        return [np.arange(len(p))]
    row, column = np.nan_to_num(_cells(p, u, level_m, dem)).T
    return groups(row, column, GROUP_CELLS)


def _bracket(p: Array, u: Array, bottom: Array, top: Array, dem: HeightSurface) -> tuple[Array, Array]:
    """Return heights just above and below the first hit of each ray between two levels (N,); nan without a hit."""
    lines = _GridLines(*(_cells(p, u, level, dem) for level in (top, bottom)))
    above, below = np.full(len(p), np.nan), np.full(len(p), np.nan)
    going, last, t = np.arange(len(p)), top.copy(), np.zeros(len(p))  # no cell reaches the upper level
    depth = _depth(p, u, last, dem)[1]
    while len(going):
        # along a ray, the surface of a cell is a parabola: three depths determine its peak
        start, ahead = t[going], lines.after(going)
        level = top[going] + (bottom - top)[going] * (start + np.array([[0.5], [1.0]]) * (ahead - start))
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
        # other rays end here: they have a hit, left the path, or reached nodata
        going = going[free & (end < 0.0) & (ahead < 1.0)]
    return above, below


def _peak(start: Array, middle: Array, end: Array) -> Array:
    """Return the position (0 to 1) of the peak of parabolas through three values.

    The position is nan unless the peak is inside and reaches 0.
    """
    curve, slope = 2.0 * (start - 2.0 * middle + end), 4.0 * middle - 3.0 * start - end
    with np.errstate(divide="ignore", invalid="ignore"):
        x = -0.5 * slope / curve
        # if the peak is within a centimetre of 0, the caller computes the depth from the surface
        return np.where((curve < 0.0) & (x > 0.0) & (x < 1.0) & (start + 0.5 * slope * x > -0.01), x, np.nan)


def _cells(p: Array, u: Array, level_m: Array, dem: HeightSurface) -> Array:
    """Return row and column (N, 2) of N rays at heights (N,)."""
    _, lon, lat = _lon_lat(p, u, level_m)
    return np.stack(dem.cell(lon, lat), axis=1)


class _GridLines:
    """Successive crossings of N straight paths with the lines between cell centres.

    A path runs from ``start`` to ``end`` (N, 2), rows and columns; t increases from 0 to
    1 (Amanatides & Woo 1987). Over some kilometres, a ray deviates from its straight path
    by centimetres.
    """

    def __init__(self, start: Array, end: Array) -> None:
        self._start, self._travel = start, end - start
        sign = np.sign(self._travel)
        self._line = np.where(sign > 0.0, np.floor(start) + 1.0, np.ceil(start) - 1.0)
        self._sign = sign

    def after(self, path: Index) -> Array:
        """Return the parameter t of the next crossing of these paths.

        The parameter is 1 if there is no further crossing or if the path is nan.
        """
        travel = self._travel[path]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (self._line[path] - self._start[path]) / travel
        t = np.where(travel == 0.0, np.inf, np.nan_to_num(t, nan=np.inf))
        nearest = t.min(axis=1)
        self._line[path] += np.where(t == nearest[:, None], self._sign[path], 0.0)
        return np.asarray(np.minimum(nearest, 1.0))


def _bisect(p: Array, u: Array, above: Array, below: Array, dem: HeightSurface) -> tuple[Array, Array]:
    """Find the points of the rays on the DEM between two heights by bisection; also return the remaining depths.

    The result is nan for nan heights.
    """
    widest = float(np.nan_to_num(above - below).max(initial=TOLERANCE_M))
    for _ in range(int(np.ceil(np.log2(widest / TOLERANCE_M)))):
        middle = 0.5 * (above + below)
        depth = _depth(p, u, middle, dem)[1]
        above = np.where(np.isnan(depth), np.nan, np.where(depth < 0.0, middle, above))
        below = np.where(depth < 0.0, below, middle)
    return _depth(p, u, 0.5 * (above + below), dem)
