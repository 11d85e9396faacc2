"""Map rasters: their grid and files, and the image pixels of map pixels by interpolation between knots.

At every ``step``-th map pixel, the model is evaluated at three heights of the surface.
Interpolation between these knots is bilinear in the map and quadratic in the height. As a
test, the model is evaluated half-way between knots and at intermediate heights. If the
largest difference inside the image exceeds the limit, the step is halved. The positions
of the knots in the map are fixed. Therefore the pixels do not depend on the size of the
windows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.geodesy import to_geographic
from fg_orient.kernels.resampling import KNOT, SCALING
from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite, number, positive
from fg_orient.rectification.ortho_models import MapModel
from fg_orient.sensors.dem import RasterDem, range_below

Bounds = tuple[float, float, float, float]

#: Maximum number of pixels along an axis. With more pixels the resolution probably has the wrong unit.
LARGEST: Final = 1_000_000
#: Edge of the tiles inside a file.
TILE: Final = 512
#: Size of GDAL's cache for blocks of files, bytes; GDAL's default is 5 % of the memory.
CACHE_BYTES: Final = 64 * 2**20


@dataclass(frozen=True)
class MapGrid:
    """North-up raster of square pixels.

    Parameters
    ----------
    crs : str
        WKT of the coordinate system.
    left, top : float
        Corner of the first pixel (not its centre), units of the CRS.
    resolution : float
        Size of a pixel.
    rows, columns : int
    """

    crs: str
    left: float
    top: float
    resolution: float
    rows: int
    columns: int

    @classmethod
    def over(cls, bounds: Bounds, resolution: float, crs: str) -> MapGrid:
        """Return the grid over bounds (left, bottom, right, top), widened to whole multiples of the resolution.

        Raises
        ------
        InputError
            Bounds without area, a resolution that is not above 0, or more than a million pixels along an axis.
        """
        if finite("<bounds>", bounds).shape != (4,):
            raise InputError.of("rectify.numbers", option="bounds", value=f"{len(bounds)} numbers")
        left, bottom, right, top = bounds
        positive("<resolution>", resolution, "units of the map")
        sides = right - left, top - bottom
        if not all(math.isfinite(side) and 0.0 < side <= LARGEST * resolution for side in sides):
            raise InputError.of(
                "ortho.grid",
                option="bounds, resolution",
                value=f"{sides[0]:g} x {sides[1]:g}",
                resolution=resolution,
                most=LARGEST,
            )
        # if the bounds are multiples of the resolution, rounding must not add a pixel
        west, south = (math.floor(v / resolution + 1e-6) for v in (left, bottom))
        east, north = (math.ceil(v / resolution - 1e-6) for v in (right, top))
        return cls(crs, west * resolution, north * resolution, resolution, north - south, east - west)

    def centres(self, row: npt.ArrayLike, column: npt.ArrayLike) -> tuple[Array, Array]:
        """Return map coordinates x, y of pixel centres; fractions are allowed."""
        x = self.left + (np.asarray(column, float) + 0.5) * self.resolution
        return np.asarray(x), np.asarray(self.top - (np.asarray(row, float) + 0.5) * self.resolution)

    @property
    def bounds(self) -> Bounds:
        """Left, bottom, right, top."""
        bottom, right = self.top - self.rows * self.resolution, self.left + self.columns * self.resolution
        return self.left, bottom, right, self.top

    def profile(self, *, bands: int, dtype: str, nodata: float | None, compress: str) -> dict[str, Any]:
        """Return the creation options of a tiled GeoTIFF on this grid."""
        from rasterio import Affine

        corners = Affine(self.resolution, 0.0, self.left, 0.0, -self.resolution, self.top)
        return {
            "driver": "GTiff",
            "width": self.columns,
            "height": self.rows,
            "count": bands,
            "dtype": dtype,
            "crs": self.crs,
            "transform": corners,
            "nodata": nodata,
            "tiled": True,
            "blockxsize": TILE,
            "blockysize": TILE,
            "compress": compress,
            "interleave": "band",
            "BIGTIFF": "IF_SAFER",
        }


#: Number of points along a side of a map; they give the part of the DEM that the map needs.
SIDE: Final = 9
#: Largest allowed difference from the model, pixels of the image and cells of the DEM.
ERROR_PX: Final = 0.01
FIRST_STEP: Final = 64
LEAST_STEP: Final = 4
#: The model is evaluated over at least this range of heights, m.
LEAST_RANGE_M: Final = 1.0
#: Scaled heights between the knots. There a cubic term causes the largest errors of a
#: quadratic through three equidistant heights.
BETWEEN: Final = (-0.57735, 0.57735)


class LevelSurface:
    """Surface of constant height; InputError if the height is not finite."""

    def __init__(self, height_m: float) -> None:
        number("height", height_m, "m")
        self.range_m = float(height_m), float(height_m)
        self.shape = 2, 2
        self.path = f"height {height_m:g} m"

    def window(self, row: int, column: int, rows: int, columns: int) -> Array:
        """Return heights (rows, columns)."""
        return np.full((rows, columns), self.range_m[0])


Surface = RasterDem | LevelSurface


@dataclass(frozen=True)
class Lattice:
    """Knots over a map grid.

    Parameters
    ----------
    step : int
        Map pixels between knots.
    knots : (M, N, 8) array
        See ``fg_orient.kernels.resampling``.
    scaling : (2,) array
        Offset and scale of heights.
    error_px : float
        Largest error of the interpolation inside the image, pixels of the image or cells
        of the DEM. nan if the image contains no middle of four knots.
    """

    step: int
    knots: Array
    scaling: Array
    error_px: float

    def extent(self, axis: int, first: tuple[int, int], shape: tuple[int, int]) -> tuple[float, float]:
        """Return the lowest and highest value of a knots' component around a map window; nan if there are none."""
        (i, m), (j, n) = (
            (at // self.step, (at + size - 1) // self.step + 2) for at, size in zip(first, shape, strict=True)
        )
        values = self.knots[i:m, j:n, axis]
        return float(np.fmin.reduce(values, axis=None)), float(np.fmax.reduce(values, axis=None))

    def density(self) -> tuple[float, float]:
        """Return the largest number of DEM cells, and of image pixels, per map pixel along an axis."""
        found = []
        for axes in ((KNOT.row, KNOT.column), (KNOT.line_0, KNOT.sample_0)):
            sides = [
                sum(float(np.nanmax(np.abs(np.diff(self.knots[..., k], axis=along)), initial=0.0)) for along in (0, 1))
                for k in axes
            ]
            found.append(max(sides) / self.step)
        return found[0], found[1]


def height_range(
    surface: Surface, crs: str, bounds: Bounds | None, outline: Callable[[float], tuple[Array, Array]], start_m: float
) -> tuple[float, float]:
    """Return the lowest and highest height of a surface on a map; nan if there are no heights.

    Parameters
    ----------
    surface : RasterDem or LevelSurface
    crs : str
        Coordinate system of the map.
    bounds : left, bottom, right, top, optional
        Bounds of the map. Without them, the image bounds the map.
    outline : callable
        Function of a height; it returns map coordinates (N,) of the border of the image.
        ``start_m`` is an approximate height.
    """
    if isinstance(surface, LevelSurface):
        return surface.range_m
    if bounds is None:
        return range_below(surface, lambda height: to_geographic(crs, *outline(height)), start_m)
    sides = np.linspace(bounds[0], bounds[2], SIDE), np.linspace(bounds[1], bounds[3], SIDE)
    x, y = (a.ravel() for a in np.meshgrid(*sides))
    return surface.range_over(*to_geographic(crs, x, y))


def lattice(
    grid: MapGrid, model: MapModel, surface: Surface, limits: Array, heights_m: tuple[float, float]
) -> Lattice | None:
    """Return knots whose interpolation error is at most ``ERROR_PX``.

    Parameters
    ----------
    grid : MapGrid
    model : MapModel
    surface : RasterDem or LevelSurface
    limits : (4,) array
        First and last line, first and last sample inside the image.
    heights_m : (float, float)
        Lowest and highest height of the map.

    Returns
    -------
    Lattice or None
        With a step of ``LEAST_STEP`` the error may be larger. None if no knot is near the image.
    """
    low, high = heights_m
    scaling = SCALING.pack(offset=0.5 * (low + high), scale=0.5 * max(high - low, LEAST_RANGE_M))
    step = FIRST_STEP
    while True:
        knots = _knots(grid, model, surface, scaling, step)
        if not _meets(knots, limits):
            return None
        error = _error(grid, model, surface, scaling, step, knots, limits)
        if error <= ERROR_PX or step <= LEAST_STEP:
            return Lattice(step, knots, scaling, error)
        step //= 2


def _knots(grid: MapGrid, model: MapModel, surface: Surface, scaling: Array, step: int) -> Array:
    rows, columns = (np.arange(n // step + 2.0) * step for n in (grid.rows, grid.columns))
    r, c = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
    x, y = grid.centres(r, c)
    out = np.empty((len(r), KNOT.size))
    out[:, KNOT.row], out[:, KNOT.column] = _cells(grid, surface, x, y).T
    heights = (scaling[SCALING.offset] + t * scaling[SCALING.scale] for t in (-1.0, 0.0, 1.0))
    below, middle, above = (model.pixels(x, y, np.full(len(x), height)) for height in heights)
    for axis, a, b, c_ in zip((KNOT.line, KNOT.sample), below.T, middle.T, above.T, strict=True):
        out[:, axis] = np.stack([b, 0.5 * (c_ - a), 0.5 * (a + c_) - b], axis=1)
    return np.ascontiguousarray(out.reshape(len(rows), len(columns), KNOT.size))


def _meets(knots: Array, limits: Array) -> bool:
    """Return whether the pixels between the outermost knots, at all heights, overlap the image."""
    for (low, high), axis in zip(limits.reshape(2, 2), (KNOT.line, KNOT.sample), strict=True):
        middle, linear, square = np.moveaxis(knots[..., axis], -1, 0)
        reach = np.abs(linear) + np.abs(square)
        first, last = (middle - reach)[np.isfinite(middle)], (middle + reach)[np.isfinite(middle)]
        if not len(first) or first.min() > high or last.max() < low:
            return False
    return True


def _cells(grid: MapGrid, surface: Surface, x: Array, y: Array) -> Array:
    """Return the row and column (n, 2) of the surface's raster."""
    if isinstance(surface, LevelSurface):
        return np.full((len(x), 2), 0.5)
    lon, lat = to_geographic(grid.crs, x, y)
    return np.stack(surface.cell(lon, lat), axis=1)


def _error(
    grid: MapGrid, model: MapModel, surface: Surface, scaling: Array, step: int, knots: Array, limits: Array
) -> float:
    """Return the largest difference at the middles of cells inside the image; nan if there are no such cells."""
    rows, columns = ((np.arange(n - 1.0) + 0.5) * step for n in knots.shape[:2])
    r, c = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
    x, y = grid.centres(r, c)
    t = np.take(BETWEEN, (np.arange(len(r)) + np.repeat(np.arange(len(rows)), len(columns))) % 2)
    k = 0.25 * (knots[:-1, :-1] + knots[1:, :-1] + knots[:-1, 1:] + knots[1:, 1:]).reshape(-1, KNOT.size)
    polynomials = (k[:, axis].T for axis in (KNOT.line, KNOT.sample))
    pixels = np.stack([middle + t * (linear + t * square) for middle, linear, square in polynomials], axis=1)
    first, last = limits.reshape(2, 2).T
    some = np.flatnonzero(((pixels >= first) & (pixels <= last)).all(axis=1))
    if not len(some):
        return np.nan
    x, y = x[some], y[some]
    exact = model.pixels(x, y, scaling[SCALING.offset] + t[some] * scaling[SCALING.scale])
    cells = k[some][:, [KNOT.row, KNOT.column]] - _cells(grid, surface, x, y)
    return float(np.nanmax(np.abs(np.hstack([pixels[some] - exact, cells])), initial=0.0))
