"""Windows of a map raster: positions in the image, resampled and written.

Source: Keys 1981 (cubic convolution).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.kernels.resampling import BILINEAR, CUBIC, NEAREST, REACH, pixel_positions, resample
from fg_orient.model.errors import InputError
from fg_orient.model.names import Progress
from fg_orient.rectification.grid import Lattice, MapGrid, Surface
from fg_orient.rectification.options import OrthoOptions

#: Kernel and its slope a, by name.
RESAMPLING: Final = {
    "nearest": (NEAREST, 0.0), "bilinear": (BILINEAR, 0.0), "cubic": (CUBIC, -0.5), "cubic-sharp": (CUBIC, -1.0),
}  # fmt: skip


def fill(
    rasterio: Any, source: Any, target: Path, grid: MapGrid, knots: Lattice, surface: Surface, limits: Array,
    nodata: float, options: OrthoOptions, progress: Progress | None,
) -> tuple[int, int]:  # fmt: skip
    """Write all windows; number of map pixels inside the image, and of those with a value in its first band."""
    settings = grid.profile(bands=source.count, dtype=source.dtypes[0], nodata=nodata, compress=options.compress)
    heights = np.ascontiguousarray(surface.heights_m)
    corners = [(r, c) for r in range(0, grid.rows, options.window) for c in range(0, grid.columns, options.window)]
    seen = filled = 0
    with rasterio.open(target, "w", **settings) as sink:
        for done, (row, column) in enumerate(corners):
            if progress is not None:
                progress(done, len(corners), "windows")
            shape = min(options.window, grid.rows - row), min(options.window, grid.columns - column)
            line, sample = np.empty(shape), np.empty(shape)
            holes, hole_row, hole_column = pixel_positions(
                row, column, knots.step, knots.knots, heights, knots.scaling, limits, line, sample
            )
            if holes and not options.allow_holes:
                raise InputError.of("ortho.hole", file=surface.path, row=hole_row, column=hole_column)
            seen += int(np.count_nonzero(~np.isnan(line)))
            place = rasterio.windows.Window(column, row, shape[1], shape[0])
            filled += _window(rasterio, source, sink, place, line, sample, nodata, options.resampling)
    if progress is not None:
        progress(len(corners), len(corners), "windows")
    return seen, filled


def _window(
    rasterio: Any, source: Any, sink: Any, place: Any, line: Array, sample: Array, nodata: float, resampling: str
) -> int:
    """Resample all bands into one window; number of pixels of the first band that have a value."""
    if np.isnan(line).all():
        empty = np.full(line.shape, nodata).astype(source.dtypes[0])
        for band in source.indexes:
            sink.write(empty, band, window=place)
        return 0
    first_l, last_l = _needed(line, source.height)
    first_s, last_s = _needed(sample, source.width)
    part = rasterio.windows.Window(first_s, first_l, last_s - first_s, last_l - first_l)
    kind, a = RESAMPLING[resampling]
    out, count = np.empty(line.shape), 0
    for band in source.indexes:
        grey = _read(rasterio, source, band, part)
        n = resample(grey, first_l, first_s, line, sample, kind, a, out)
        count = n if band == source.indexes[0] else count
        sink.write(_stored(out, source.dtypes[0], nodata), band, window=place)
    return count


def _needed(positions: Array, n: int) -> tuple[int, int]:
    """First line that a kernel may use, and the line after the last one."""
    low, high = math.floor(np.nanmin(positions)), math.floor(np.nanmax(positions))
    return min(max(low - REACH, 0), n - 1), max(min(high + REACH + 1, n), 1)


def _read(rasterio: Any, source: Any, band: int, part: Any) -> Array:
    try:
        grey = source.read(band, window=part).astype(float)
    except rasterio.RasterioIOError as error:  # as an OSError it would be reported as one of the output
        raise InputError.of("ortho.image", file=source.name, place=f"band {band}, from line {part.row_off}",
                            value=error.__cause__ or error) from error  # fmt: skip
    nodata = source.nodatavals[band - 1]
    if nodata is not None and not math.isnan(nodata):
        grey[grey == nodata] = np.nan
    return np.ascontiguousarray(grey)


def _stored(values: Array, dtype: str, nodata: float) -> npt.NDArray[Any]:
    """Values rounded and limited to the type of the file; values equal to nodata become the next one."""
    kind, empty = np.dtype(dtype), np.isnan(values)
    if kind.kind == "f":
        out = values.astype(kind)
        out[empty] = nodata
        return out
    limits = np.iinfo(kind)
    whole = np.clip(np.rint(np.where(empty, 0.0, values)), limits.min, limits.max)
    whole[whole == nodata] += 1.0 if nodata < limits.max else -1.0
    out = whole.astype(kind)
    out[empty] = kind.type(nodata)
    return out
