"""Read digital elevation models from rasters, in squares of cells; only the squares that are used are read.

If a raster has no vertical CRS, its heights are ellipsoidal. Heights with a vertical CRS are converted to ellipsoidal
heights when their square is read. PROJ and its geoid grids do this, or a geoid file. A missing grid and units other
than metres are refused. The squares divide the rows and columns of the raster, independently of the blocks of the file.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.geodesy import from_geographic, to_geographic
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.raster_limits import invertible, open_bounded
from fg_orient.sensors.cliffs import cliff_of
from fg_orient.sensors.dem_cells import bilinear, groups, share

#: Range of plausible heights of a DEM, m. The lowest land is at -430 m, the highest at 8849 m. Other values are
#: undeclared nodata values.
PLAUSIBLE_M: Final = (-500.0, 9000.0)
#: Range of the undulations of all geoids, m.
UNDULATION_RANGE_M: Final = (-120.0, 100.0)
#: The undulation is interpolated between knots: maximum distance of knots, cells, and maximum interpolation error, m.
KNOT_STEP, UNDULATION_M = 32, 1e-3
METRES: Final = ("", "m", "metre", "metres", "meter", "meters")
#: Edge of a square, cells.
EDGE: Final = 256
#: Number of squares that are read together.
SPAN: Final = 16
#: Bytes of squares that are kept.
KEPT_BYTES: Final = 32_000_000
#: Maximum number of cells of a part of the raster that is copied to one array.
PART_CELLS: Final = 4_000_000
#: Size of GDAL's cache for blocks of the file, bytes.
GDAL_BYTES: Final = 64_000_000
#: Minimum size of GDAL's cache. GDAL would interpret a smaller number as megabytes.
GDAL_LEAST: Final = 1_000_000
#: Number of pieces into which a path is divided. For each piece, the squares of its bounding box are used.
PIECES: Final = 32
_DEGREE_M: Final = 111e3


class RasterDem:
    """DEM that rasterio reads; heights are interpolated bilinearly between pixel centres.

    Parameters
    ----------
    path : path
        Raster with a geographic or projected CRS and heights in m.
    vertical_crs : str, optional
        CRS of the heights if the file does not state it: a code such as ``EPSG:5773``, a name such as ``EGM96``, or a
        geoid file. Heights without a vertical CRS are ellipsoidal.
    warn : callable, optional
        Function that receives a Finding when implausible heights are read for the first time.
    memory_limit_gb : float, optional
        Memory limit of the run, GB; default 80 % of the available memory. The squares that are kept, the part in one
        array and the cache of GDAL have at most 128 MB, and at most one eighth of this limit.

    Attributes
    ----------
    shape : (int, int)
        Numbers of rows and columns.
    crs : str
        Horizontal coordinate system as WKT.

    Raises
    ------
    InputError
        The file cannot be read, has no CRS or names another vertical CRS; its heights are not in metres; or the grid of
        the geoid is missing. The methods also raise it if a part of the file is damaged.
    """

    def __init__(
        self, path: str | Path, *, vertical_crs: str = "", warn: Callable[[Finding], None] | None = None,
        memory_limit_gb: float | None = None,
    ) -> None:  # fmt: skip
        try:
            import rasterio
        except ImportError as error:
            raise InputError.of("dem.no_rasterio", file=path) from error
        if not Path(path).is_file():
            raise InputError.of("dem.missing", file=path)
        self.path, self.vertical_crs = str(path), vertical_crs
        self._rasterio: Any = rasterio
        self._warn = warn or (lambda one: None)
        self._share = share(memory_limit_gb, KEPT_BYTES + GDAL_BYTES + 8 * PART_CELLS)
        with self._reading():
            source = self._source = open_bounded(rasterio, path)
            if source.crs is None:
                raise InputError.of("dem.no_crs", file=path)
            self.crs, unit = str(source.crs.to_wkt()), source.units[0] or ""
        has_cells = invertible(source.transform)
        if not has_cells or not source.dtypes[0].startswith(("int", "uint", "float")):
            wrong = f"values of type {source.dtypes[0]}" if has_cells else "size of a cell"
            raise InputError.of("dem.unreadable", file=path, value=wrong)
        self.shape: tuple[int, int] = (source.height, source.width)
        self._pixel_from_crs, self._from_values = ~source.transform, (source.scales[0], source.offsets[0])
        self._across = -(-self.shape[1] // EDGE)  # number of squares in a row of squares
        self._kept: OrderedDict[int, Array] = OrderedDict()
        self._ranges: dict[int, tuple[float, float]] = {}
        self._part: tuple[int, int, Array] = (0, 0, np.empty((0, 0)))
        self._implausible: list[tuple[int, float, float]] = []
        self._cliffs: list[tuple[float, float, int, int]] = []
        self._undulation_of = self._zero_level(unit, vertical_crs)
        if self._undulation_of is not None:  # a missing grid is refused at the beginning
            self._undulations(self.shape[0] // 2, self.shape[1] // 2, (1, 1))

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Convert errors of GDAL to InputError, and limit GDAL's cache."""
        try:
            with self._rasterio.Env(GDAL_CACHEMAX=max(int(self._share * GDAL_BYTES), GDAL_LEAST)):
                yield
        except (self._rasterio.errors.RasterioError, self._rasterio.errors.CRSError) as error:
            raise InputError.of("dem.unreadable", file=self.path, value=error.__cause__ or error) from error

    def _zero_level(self, unit: str, given: str) -> Callable[[Array, Array], Array] | None:
        """Return a function that gives the undulation of the heights' zero level; None for ellipsoidal heights.

        The vertical part of the raster's CRS is removed.
        """
        from fg_orient.geodesy.bodies import require_on_earth
        from fg_orient.geodesy.crs import vertical_code
        from fg_orient.geodesy.geoid import GRID_SUFFIXES, GeoidFile
        from fg_orient.geodesy.heights import undulation_m, vertical_reference, with_vertical

        require_on_earth(self.crs, self.path)
        stated, axis_unit = vertical_reference(self.crs)
        wrong = [u for u in (axis_unit, unit) if u.strip().lower() not in METRES]
        if wrong:
            raise InputError.of("dem.vertical_unit", file=self.path, value=wrong[0])
        if not (stated or given):
            return None
        if given.lower().endswith(GRID_SUFFIXES):
            grid = GeoidFile(given)
            flat = self.crs = with_vertical(self.crs, "")[0]
            return lambda x, y: grid.undulation_m(*to_geographic(flat, x, y))
        self.crs, both = with_vertical(self.crs, vertical_code(given))
        if stated and given and vertical_reference(both)[0] != stated:
            raise InputError.of("dem.vertical_crs", file=self.path, value=f"{stated}, not {given}")
        return lambda x, y: undulation_m(both, x, y)

    # --- squares ---------------------------------------------------------------------------------

    def _squares(self, numbers: Iterable[int]) -> Iterator[tuple[int, Array]]:
        """Yield numbers and heights of squares in order; neighbours in a row are read together."""
        wanted, done = sorted(numbers), 0
        while done < len(wanted):
            first, count = wanted[done], 1
            if first in self._kept:
                self._kept.move_to_end(first)
                yield first, self._kept[first]
            else:
                for next_one in wanted[done + 1 : done + SPAN]:
                    if next_one != first + count or next_one % self._across == 0 or next_one in self._kept:
                        break
                    count += 1
                for number, square in self._read(first, count):
                    self._kept[number] = square
                    yield number, square
            done += count
            while len(self._kept) > max(self._share * KEPT_BYTES // (8 * EDGE**2), 1):
                self._kept.popitem(last=False)

    def _read(self, first: int, count: int) -> Iterator[tuple[int, Array]]:
        """Read neighbouring squares of one row of squares."""
        row, column = (EDGE * k for k in divmod(first, self._across))
        rows, columns = min(EDGE, self.shape[0] - row), min(count * EDGE, self.shape[1] - column)
        with self._reading():
            window = self._rasterio.windows.Window(column, row, columns, rows)
            values = self._source.read(1, window=window, masked=True)
        scale, offset = self._from_values
        heights = values.astype(float).filled(np.nan)
        if (scale, offset) != (1.0, 0.0):
            heights = heights * scale + offset
        for k in range(count):
            square, left = np.ascontiguousarray(heights[:, k * EDGE : (k + 1) * EDGE]), column + k * EDGE
            if first + k not in self._ranges:
                self._examine(square, row, left)
            low, high = PLAUSIBLE_M
            square[(square < low) | (square > high)] = np.nan
            known = np.isfinite(square).any()
            if known and self._undulation_of is not None:
                square += self._undulations(row, left, (square.shape[0], square.shape[1]))
            self._ranges[first + k] = (float(np.nanmin(square)), float(np.nanmax(square))) if known else (np.nan,) * 2
            yield first + k, square

    def _numbers(self, rows: tuple[int, int], columns: tuple[int, int]) -> list[int]:
        """Return the numbers of the squares that contain a range of rows and columns, including the last ones."""
        (top, bottom), (left, right) = ((low // EDGE, high // EDGE) for low, high in (rows, columns))
        return [i * self._across + j for i in range(top, bottom + 1) for j in range(left, right + 1)]

    def _undulations(self, row: int, column: int, shape: tuple[int, int]) -> Array:
        """Return the undulation at the cell centres of a part; it is exact at knots and bilinear between them.

        The distance of the knots is halved until the error between them is at most ``UNDULATION_M``.
        """
        t, undulation_of = ~self._pixel_from_crs, self._undulation_of
        assert undulation_of is not None

        def exact(rows: Array, columns: Array) -> Array:
            r, c = (a.ravel() + 0.5 for a in np.meshgrid(row + rows, column + columns, indexing="ij"))
            try:
                undulation = undulation_of(t.a * c + t.b * r + t.c, t.d * c + t.e * r + t.f)
            except InputError as error:
                raise InputError.of("dem.geoid", file=self.path, reason=error.problems[0].message,
                                    value=error.problems[0].value) from None  # fmt: skip
            return undulation.reshape(len(rows), len(columns))

        step = KNOT_STEP
        while True:
            knots = [np.unique(np.append(np.arange(0.0, n, step), n - 1.0)) for n in shape]
            if step == 1:
                return exact(*knots)
            fine = [np.interp(np.arange(2 * len(k) - 1) / 2.0, np.arange(len(k)), k) for k in knots]
            values = exact(*fine)
            error = np.abs(values - bilinear(knots, values[::2, ::2], fine))
            # if the undulation bends between two knots, its error is at most twice the error in their middle
            if 2.0 * (error[1::2, ::2].max(initial=0.0) + error[::2, 1::2].max(initial=0.0)) <= UNDULATION_M:
                return bilinear(knots, values[::2, ::2], [np.arange(float(n)) for n in shape])
            step //= 2

    # --- undeclared nodata -----------------------------------------------------------------------

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Return warnings of heights outside ``PLAUSIBLE_M`` and of cliffs in the squares that were read."""
        found, (low, high) = [], PLAUSIBLE_M
        if self._implausible:
            counts, least, most = zip(*self._implausible, strict=True)
            found.append(finding("dem.implausible", file=self.path, count=sum(counts), low=low, high=high,
                                 least=min(least), most=max(most)))  # fmt: skip
        if self._cliffs:
            value, step, row, column = max(self._cliffs, key=lambda one: one[1])
            found.append(finding("dem.cliffs", file=self.path, height=value, step=step, row=row, column=column))
        return tuple(found)

    def _examine(self, square: Array, row: int, column: int) -> None:
        """Record heights that are impossible on land; the first ones are reported immediately."""
        before = {one.code for one in self.notes}
        wrong = (square < PLAUSIBLE_M[0]) | (square > PLAUSIBLE_M[1])
        if wrong.any():  # a height of -9999 m would falsify every hit near it
            values = square[wrong]
            self._implausible.append((int(wrong.sum()), float(values.min()), float(values.max())))
        cliff = cliff_of(np.where(wrong, np.nan, square), self._cell_m)
        if cliff is not None:
            value, step, (r, c) = cliff
            self._cliffs.append((value, step, row + r, column + c))
        for one in self.notes:
            if one.code not in before:
                self._warn(one)

    @cached_property
    def _cell_m(self) -> tuple[float, float]:
        """Return the distances between neighbouring cell centres in the middle of the raster, down and across, m."""
        r, c = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) + 0.5 * np.array([self.shape]).T
        t = ~self._pixel_from_crs
        lon, lat = to_geographic(self.crs, t.a * c + t.b * r + t.c, t.d * c + t.e * r + t.f)
        east, north = (lon[1:] - lon[0]) * np.cos(np.radians(lat[0])), lat[1:] - lat[0]
        down, across = np.nan_to_num(np.hypot(east, north), nan=np.inf) * _DEGREE_M
        return float(down), float(across)

    # --- positions and heights -------------------------------------------------------------------

    @property
    def heights_m(self) -> Array:
        """Read all ellipsoidal heights (rows, columns), m; nodata and implausible heights are nan.

        Each use reads the file again.
        """
        return self.window(0, 0, *self.shape)

    def window(self, row: int, column: int, rows: int, columns: int) -> Array:
        """Return the ellipsoidal heights (rows, columns), m, of a part inside the raster; nodata is nan."""
        out = np.empty((rows, columns))
        if not out.size:
            return out
        for number, square in self._squares(self._numbers((row, row + rows - 1), (column, column + columns - 1))):
            top, left = (EDGE * k for k in divmod(number, self._across))
            (r, end_r), (c, end_c) = ((max(a, b), min(a + EDGE, b + n)) for a, b, n in (
                (top, row, rows), (left, column, columns)))  # fmt: skip
            part = square[r - top : end_r - top, c - left : end_c - left]
            out[r - row : end_r - row, c - column : end_c - column] = part
        return out

    def outline(self) -> tuple[Array, Array]:
        """Return longitude and latitude (degrees) of points along the outermost cell centres of the raster."""
        r, c = (a.ravel() for a in np.meshgrid(*(np.linspace(0.5, n - 0.5, 9) for n in self.shape), indexing="ij"))
        t = ~self._pixel_from_crs
        return to_geographic(self.crs, t.a * c + t.b * r + t.c, t.d * c + t.e * r + t.f)

    @cached_property
    def range_m(self) -> tuple[float, float]:
        """Return the lowest and highest height, m; the whole raster is read. nan if there are no heights."""
        return self._range_of(self._numbers((0, self.shape[0] - 1), (0, self.shape[1] - 1)))

    def range_over(self, lon_deg: Array, lat_deg: Array) -> tuple[float, float]:
        """Return the lowest and highest height, m, of the squares that enclose points (N,), degrees.

        The result is nan if there are no heights.
        """
        boxes = []
        for values, n in zip(self.cell(lon_deg, lat_deg), self.shape, strict=True):
            low, high = (float(f(values, initial=start)) for f, start in ((np.nanmin, np.inf), (np.nanmax, -np.inf)))
            if not (low <= n and high >= -1.0):
                return np.nan, np.nan
            boxes.append((max(int(low) - 1, 0), int(min(high + 2.0, n - 1.0))))
        return self._range_of(self._numbers(*boxes))

    def range_along(self, start: Array, end: Array) -> tuple[Array, Array]:
        """Return the lowest and highest heights (N,), m, of the squares below straight paths; nan if there are none.

        Parameters
        ----------
        start, end : (N, 2) arrays
            Row and column of the ends of the paths (:meth:`cell`). A row of nan means that there is no path.
        """
        low, high = np.full(len(start), np.nan), np.full(len(start), np.nan)
        last_square = (np.array(self.shape) - 1) // EDGE
        paths = np.flatnonzero(np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1))
        if not len(paths):
            return low, high
        a, travel = start[paths], end[paths] - start[paths]
        pieces = int(min(np.ceil(np.abs(travel).max() / EDGE) + 1, PIECES))
        which, numbers = [], []
        for k in range(pieces):
            ends = np.stack([a + travel * (k / pieces), a + travel * ((k + 1) / pieces)])
            first, last = (np.floor(f / EDGE) for f in (ends.min(axis=0) - 1.0, ends.max(axis=0) + 1.0))
            over = ((last >= 0) & (first <= last_square)).all(axis=1)
            first, last = (np.clip(part, 0, last_square).astype(int) for part in (first, last))
            for i in range(int((last - first)[over, 0].max(initial=-1)) + 1):
                for j in range(int((last - first)[over, 1].max(initial=-1)) + 1):
                    there = np.flatnonzero(over & (first + np.array([i, j]) <= last).all(axis=1))
                    which.append(paths[there])
                    numbers.append((first[there, 0] + i) * self._across + first[there, 1] + j)
        if not which:
            return low, high
        squares, place = np.unique(np.concatenate(numbers), return_inverse=True)
        ranges = np.array(self._ranges_of(squares.tolist())).reshape(-1, 2)[place]
        np.fmin.at(low, np.concatenate(which), ranges[:, 0])
        np.fmax.at(high, np.concatenate(which), ranges[:, 1])
        return low, high

    def _ranges_of(self, numbers: list[int]) -> list[tuple[float, float]]:
        for _ in self._squares(number for number in numbers if number not in self._ranges):
            pass
        return [self._ranges[number] for number in numbers]

    def _range_of(self, numbers: list[int]) -> tuple[float, float]:
        lows, highs = np.array(self._ranges_of(numbers)).reshape(-1, 2).T
        return float(np.fmin.reduce(lows, initial=np.nan)), float(np.fmax.reduce(highs, initial=np.nan))

    def cell(self, lon_deg: Array, lat_deg: Array) -> tuple[Array, Array]:
        """Return row and column of N points, whole numbers at cell centres; nan outside the domain of the CRS.

        Parameters
        ----------
        lon_deg, lat_deg : (N,) array_like
            WGS84.
        """
        x, y = from_geographic(self.crs, lon_deg, lat_deg)
        t = self._pixel_from_crs
        return np.asarray(t.d * x + t.e * y + t.f - 0.5), np.asarray(t.a * x + t.b * y + t.c - 0.5)

    def height_m(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Return the heights, m, of N points by bilinear interpolation; nan outside the raster or at nodata.

        Parameters
        ----------
        lon_deg, lat_deg : (N,) array_like
            WGS84.
        """
        row, column = self.cell(lon_deg, lat_deg)
        shape, (rows, columns) = np.shape(row), self.shape
        row, column = np.ravel(row), np.ravel(column)
        inside = np.flatnonzero((row >= 0) & (row <= rows - 1) & (column >= 0) & (column <= columns - 1))
        out = np.full(len(row), np.nan)
        if len(inside):
            out[inside] = self._interpolated(row[inside], column[inside])
        return out.reshape(shape)

    def _interpolated(self, row: Array, column: Array) -> Array:
        """Interpolate heights at positions inside the raster.

        Positions far from each other are read in groups.
        """
        sides = [float(np.ptp(part)) + 2.0 * EDGE for part in (row, column)]
        if sides[0] * sides[1] <= self._share * PART_CELLS:
            return self._within(row, column)
        out = np.empty(len(row))
        for group in groups(row, column, 4 * EDGE):
            out[group] = self._within(row[group], column[group])
        return out

    def _within(self, row: Array, column: Array) -> Array:
        """Interpolate heights at positions in a part of the raster that is one array."""
        rows, columns = self.shape
        r, c = np.minimum(row.astype(int), max(rows - 2, 0)), np.minimum(column.astype(int), max(columns - 2, 0))
        top, left, z = self._around(int(r.min()), int(r.max()) + 1, int(c.min()), int(c.max()) + 1)
        r0, c0 = r - top, c - left
        r1, c1 = np.minimum(r + 1, rows - 1) - top, np.minimum(c + 1, columns - 1) - left
        fr, fc = row - r, column - c
        above = z[r0, c0] * (1 - fc) + z[r0, c1] * fc
        below = z[r1, c0] * (1 - fc) + z[r1, c1] * fc
        return np.asarray(above * (1 - fr) + below * fr)

    def _around(self, top: int, bottom: int, left: int, right: int) -> tuple[int, int, Array]:
        """Return the first row, the first column and the heights of the squares that contain these rows and columns.

        The last result is kept.
        """
        row, column, z = self._part
        bottom, right = min(bottom, self.shape[0] - 1), min(right, self.shape[1] - 1)
        if not (row <= top and column <= left and bottom < row + z.shape[0] and right < column + z.shape[1]):
            row, column = top // EDGE * EDGE, left // EDGE * EDGE
            ends = min((bottom // EDGE + 1) * EDGE, self.shape[0]), min((right // EDGE + 1) * EDGE, self.shape[1])
            self._part = (0, 0, np.empty((0, 0)))
            self._part = row, column, self.window(row, column, ends[0] - row, ends[1] - column)
        return self._part


def range_below(dem: RasterDem, outline: Callable[[float], tuple[Array, Array]], start_m: float) -> tuple[float, float]:
    """Return the lowest and highest height of a DEM in the area that images show, m; nan if there are no heights.

    Parameters
    ----------
    dem : RasterDem
    outline : callable
        Function of a height. It returns longitudes and latitudes (N,), degrees, of the border of the area.
    start_m : float
        Approximate height. The border is computed again at the resulting heights until the area no longer grows.
    """
    low, high = np.inf, -np.inf
    while True:
        levels = sorted({start_m, *(h for h in (low, high) if np.isfinite(h))})
        least, most = dem.range_over(*np.hstack([outline(h) for h in levels]))
        if not np.isfinite(least) or (least >= low and most <= high):
            return least, most
        low, high = min(low, least), max(high, most)
