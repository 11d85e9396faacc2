"""Orthorectification: a map raster filled from an image through a model, window by window.

Each map pixel takes its height from the surface (bilinear), its position in the image from the
model (:class:`fg_orient.rectification.grid.Lattice`, with a stated error) and its grey value from
the image by the chosen resampling. Hidden ground is not detected: behind a ridge the map shows
the image of the ridge. Source: İpbüker 1994, sec. 5 (indirect method).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from factors.arrays import Array
from fg_orient.formats.atomic import require_free_files, staged_file
from fg_orient.formats.gdal import rasterio_of
from fg_orient.geodesy import from_geographic
from fg_orient.kernels.resampling import LIMITS
from fg_orient.model.errors import InputError
from fg_orient.model.names import Progress
from fg_orient.rectification.grid import CACHE_BYTES, TILE, Bounds, MapGrid, Surface, lattice
from fg_orient.rectification.options import OrthoOptions
from fg_orient.rectification.ortho_models import BORDER, MapModel
from fg_orient.rectification.ortho_windows import fill
from fg_orient.sensors.surface import RasterDem


def orthorectify(
    image: str | Path, model: MapModel, surface: Surface, out: str | Path, *, crs: str,
    resolution: float | None = None, bounds: Bounds | None = None, nodata: float | None = None,
    options: OrthoOptions | None = None, overwrite: bool = False, progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Rectify an image to a GeoTIFF.

    Parameters
    ----------
    image : path
        Raster in sensor geometry, all its bands.
    model : MapModel
        Gives pixels of map coordinates in ``crs`` and heights.
    surface : RasterDem or LevelSurface
    out : path
        GeoTIFF to write.
    crs : str
        Coordinate system of the map: WKT or code; projected or geographic.
    resolution : float, optional
        Size of a map pixel, units of the CRS; default about one pixel of the image.
    bounds : left, bottom, right, top, optional
        Default: common ground of image and surface.
    nodata : float, optional
        Value of empty pixels, which the type of the image must be able to store; default the nodata value of the image
        if it can be stored, else 0 (whole numbers; grey values equal to it become the next value) or nan.
    options : OrthoOptions, optional
    overwrite : bool
        Replace an existing file once the new one is complete.
    progress : callable, optional
        Called with the number of finished windows, the number of all windows, and a text.

    Returns
    -------
    dict
        rows, columns, resolution, bounds, filled (share of map pixels), knots (distance in map pixels), error_px (of
        interpolated positions), resampling, nodata, out.

    Raises
    ------
    InputError
        An image that cannot be read completely, another size than the model's, a value of empty pixels that its type
        cannot store, no common ground, holes of the DEM, an output that cannot be written.
    """
    chosen, rasterio = options or OrthoOptions(), rasterio_of(image)
    with rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES), _opened(rasterio, image) as source:
        size = (source.height, source.width)
        _require_fitting(source, model, image)
        empty = _nodata(source, nodata, image)
        grid = _grid(model, surface, size, crs, resolution, bounds)
        limits = LIMITS.pack(
            first_line=-0.5, last_line=source.height - 0.5, first_sample=-0.5, last_sample=source.width - 0.5
        )
        knots = lattice(grid, model, surface, limits)
        if knots is None:
            raise InputError.of("ortho.no_overlap", file=image, what=surface.path)
        _require_writable(Path(out), overwrite=overwrite)
        with staged_file(Path(out), place="<out>", suffix=".tif") as staged:
            target = staged.with_suffix(".work.tif") if chosen.cog else staged
            try:
                seen, filled = fill(rasterio, source, target, grid, knots, surface, limits, empty, chosen, progress)
                if not seen:
                    raise InputError.of("ortho.no_overlap", file=image, what=surface.path)
                if chosen.cog:
                    from rasterio.shutil import copy

                    copy(target, staged, driver="COG", compress=chosen.compress, blocksize=TILE, overviews="AUTO")
            finally:
                if chosen.cog:
                    target.unlink(missing_ok=True)
    return {
        "out": str(out), "crs": grid.crs, "rows": grid.rows, "columns": grid.columns, "resolution": grid.resolution,
        "bounds": list(grid.bounds), "filled": filled / (grid.rows * grid.columns), "knots": knots.step,
        "error_px": knots.error_px, "resampling": chosen.resampling, "nodata": empty,
    }  # fmt: skip


def _require_writable(out: Path, *, overwrite: bool) -> None:
    """Refuse an existing file (without ``overwrite``), a folder, or a file in a missing folder."""
    require_free_files(out, overwrite=overwrite)
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise InputError.of("output.unwritable", file=out, option="out")


def _opened(rasterio: Any, image: str | Path) -> Any:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)  # an image in sensor geometry
        try:
            return rasterio.open(image)
        except rasterio.RasterioIOError as error:
            raise InputError.of("ortho.image", file=image, value=error) from error


def _require_fitting(source: Any, model: MapModel, image: str | Path) -> None:
    if any(np.dtype(name).kind not in "iuf" for name in source.dtypes):
        raise InputError.of("ortho.kind", file=image, value=", ".join(source.dtypes))
    if model.size is not None and model.size != (source.height, source.width):
        raise InputError.of("ortho.size", file=image, value=f"{source.height} x {source.width}",
                            lines=model.size[0], samples=model.size[1])  # fmt: skip


def _nodata(source: Any, wanted: float | None, image: str | Path) -> float:
    """Value of empty pixels."""
    kind = np.dtype(source.dtypes[0])
    if wanted is not None and not _holds(kind, wanted):
        limits = np.iinfo(kind) if kind.kind in "iu" else np.finfo(kind)
        raise InputError.of("options.value", file=image, place="nodata", value=wanted,
                            expected=f"a value of {kind}, {limits.min} to {limits.max}")  # fmt: skip
    for value in (wanted, source.nodata):
        if value is not None and _holds(kind, value):
            return float(value)
    return 0.0 if kind.kind in "iu" else math.nan


def _holds(kind: np.dtype[Any], value: float) -> bool:
    """Whether a type can store a value; floating point also rounds."""
    if kind.kind in "iu":
        return math.isfinite(value) and float(value).is_integer() and np.iinfo(kind).min <= value <= np.iinfo(kind).max
    return not math.isfinite(value) or abs(value) <= float(np.finfo(kind).max)


def _grid(
    model: MapModel, surface: Surface, size: tuple[int, int], crs: str, resolution: float | None, bounds: Bounds | None
) -> MapGrid:
    """Grid over the common ground of image and surface, or over the bounds."""
    if resolution is not None and bounds is not None:
        return MapGrid.over(bounds, resolution, crs)
    x, y = model.outline(size, surface.range_m)
    if resolution is None:
        resolution = _pixel_size(x, y, size)
    if bounds is not None:
        return MapGrid.over(bounds, resolution, crs)
    left, bottom, right, top = _box(x, y)
    if isinstance(surface, RasterDem):
        west, south, east, north = _box(*from_geographic(crs, *surface.outline()))
        left, bottom, right, top = max(left, west), max(bottom, south), min(right, east), min(top, north)
    if not (left < right and bottom < top):
        raise InputError.of("ortho.no_overlap", place="DEM", what=surface.path)
    return MapGrid.over((left, bottom, right, top), resolution, crs)


def _box(x: Array, y: Array) -> Bounds:
    return float(np.nanmin(x)), float(np.nanmin(y)), float(np.nanmax(x)), float(np.nanmax(y))


def _pixel_size(x: Array, y: Array, size: tuple[int, int]) -> float:
    """Root of the area of a pixel on the map at the lower height, rounded to two digits."""
    a, b = (v[: BORDER * BORDER].reshape(BORDER, BORDER) for v in (x, y))
    (down_x, across_x), (down_y, across_y) = ((v[-1, 0] - v[0, 0], v[-1, -1] - v[-1, 0]) for v in (a, b))
    area = abs(down_x * across_y - across_x * down_y)
    return float(f"{math.sqrt(area / (size[0] * size[1])):.2g}")
