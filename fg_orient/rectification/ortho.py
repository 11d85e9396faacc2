"""Orthorectify an image: fill a map raster through a sensor model or a transformation, window by window.

The surface gives the height of each map pixel by bilinear interpolation. The model gives its position in the image
(:class:`fg_orient.rectification.grid.Lattice`, with a stated error). The image gives its grey value by the chosen
resampling. Hidden ground is not detected: behind a ridge, the map shows the image of the ridge.
Sources: İpbüker 1994, sec. 5 (indirect method); Keys 1981 (cubic convolution).
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.formats.atomic import outputs, require_free_files, staged_file
from fg_orient.formats.gdal import TIFF_MARKS, Written, copy_as_cog, opened, rasterio_of
from fg_orient.formats.sensor import read_sensor
from fg_orient.geodesy import ecef_to_geodetic, from_geographic, same_crs
from fg_orient.kernels.resampling import (
    BILINEAR,
    CUBIC,
    KNOT,
    LIMITS,
    NEAREST,
    PART,
    REACH,
    pixel_positions,
    resample,
)
from fg_orient.model.errors import InputError, judged
from fg_orient.model.names import Progress
from fg_orient.rectification.folder import doubts_on_fit
from fg_orient.rectification.grid import (
    CACHE_BYTES,
    TILE,
    Bounds,
    Lattice,
    LevelSurface,
    MapGrid,
    Surface,
    height_range,
    lattice,
)
from fg_orient.rectification.options import OrthoOptions
from fg_orient.rectification.ortho_models import BORDER, MapModel, PointModel, SensorModel, read_orientation
from fg_orient.rectification.transformation import read_transformation
from fg_orient.sensors.base import Sensor
from fg_orient.sensors.dem import RasterDem


def orthorectify(
    image: str | Path,
    model: MapModel,
    surface: Surface,
    out: str | Path,
    *,
    crs: str,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    nodata: float | None = None,
    options: OrthoOptions | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Rectify an image to a GeoTIFF.

    Parameters
    ----------
    image : path
        Raster in sensor geometry, all its bands.
    model : MapModel
        Model that returns the pixels of map coordinates in ``crs`` and heights.
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
        Value of empty pixels, which the type of the image must be able to store; default: the nodata
        value of the image if it can be stored. Otherwise nan, or for whole numbers 0; grey values equal
        to 0 then become the next value.
    options : OrthoOptions, optional
    overwrite : bool
        Replace an existing file once the new one is complete.
    progress : callable, optional
        Function that receives the number of finished windows, the number of all windows, and a text.

    Returns
    -------
    dict
        rows, columns, resolution, bounds, filled (share of map pixels), knots (distance in map pixels), error_px (of
        interpolated positions), resampling, nodata, out.

    Raises
    ------
    InputError
        The image cannot be read completely or has another size than the model; its type cannot store the value of empty
        pixels; image and surface have no common ground; the DEM has holes; or the output cannot be written.
    """
    chosen, rasterio = options or OrthoOptions(), rasterio_of(image)
    with rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES, CPL_LOG=os.devnull), _opened(rasterio, image) as source:
        size = (source.height, source.width)
        _require_fitting(source, model, image)
        empty = _nodata(source, nodata, image)

        def outline(height_m: float) -> tuple[Array, Array]:
            return model.outline(size, (height_m, height_m))

        if bounds is not None and resolution is not None:
            MapGrid.over(bounds, resolution, crs)  # called here so that its errors come first
        heights = height_range(surface, crs, bounds, outline, model.mean_height_m)
        if not math.isfinite(heights[0]):
            raise InputError.of("ortho.no_overlap", file=image, what=surface.path)
        grid = _grid(model, surface, size, crs, resolution, bounds, heights)
        last_line, last_sample = (n - 0.5 for n in size)
        limits = LIMITS.pack(first_line=-0.5, last_line=last_line, first_sample=-0.5, last_sample=last_sample)
        knots = lattice(grid, model, surface, limits, heights)
        if knots is None:
            raise InputError.of("ortho.no_overlap", file=image, what=surface.path)
        _require_writable(Path(out), overwrite=overwrite)
        with outputs(Path(out), overwrite=overwrite), staged_file(Path(out), place="<out>", suffix=".tif") as staged:
            target = staged.with_suffix(".work.tif") if chosen.cog else staged
            try:
                seen, filled, written = fill(
                    rasterio, source, target, grid, knots, surface, limits, empty, chosen, progress
                )
                if not seen:
                    raise InputError.of("ortho.no_overlap", file=image, what=surface.path)
                written.require(target)
                if chosen.cog:
                    settings = {"compress": chosen.compress, "blocksize": TILE, "overviews": "AUTO"}
                    copy_as_cog(rasterio, target, staged, written, **settings)
            finally:
                if chosen.cog:
                    target.unlink(missing_ok=True)
    return {
        "out": str(out),
        "crs": grid.crs,
        "rows": grid.rows,
        "columns": grid.columns,
        "resolution": grid.resolution,
        "bounds": list(grid.bounds),
        "filled": filled / (grid.rows * grid.columns),
        "knots": knots.step,
        "error_px": knots.error_px,
        "resampling": chosen.resampling,
        "nodata": empty,
    }


def _require_writable(out: Path, *, overwrite: bool) -> None:
    """Refuse an existing file (without ``overwrite``), a folder, or a file in a missing folder."""
    require_free_files(out, overwrite=overwrite)
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise InputError.of("output.unwritable", file=out, option="out")


def _opened(rasterio: Any, image: str | Path) -> Any:
    try:
        return opened(rasterio, image)
    except rasterio.RasterioIOError as error:
        raise InputError.of("ortho.image", file=image, value=error) from error


def _require_fitting(source: Any, model: MapModel, image: str | Path) -> None:
    if any(np.dtype(name).kind not in "iuf" for name in source.dtypes):
        raise InputError.of("ortho.kind", file=image, value=", ".join(source.dtypes))
    if model.size is not None and model.size != (source.height, source.width):
        raise InputError.of("ortho.size", file=image, value=f"{source.height} x {source.width}",
                            lines=model.size[0], samples=model.size[1])  # fmt: skip


def _nodata(source: Any, wanted: float | None, image: str | Path) -> float:
    """Return the value of empty pixels."""
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
    """Return whether a type can store a value; floating-point types may round it."""
    if kind.kind in "iu":
        return math.isfinite(value) and float(value).is_integer() and np.iinfo(kind).min <= value <= np.iinfo(kind).max
    return not math.isfinite(value) or abs(value) <= float(np.finfo(kind).max)


def _grid(
    model: MapModel, surface: Surface, size: tuple[int, int], crs: str, resolution: float | None,
    bounds: Bounds | None, heights_m: tuple[float, float],
) -> MapGrid:  # fmt: skip
    """Return the grid over the common ground of image and surface, or over the bounds."""
    if resolution is not None and bounds is not None:
        return MapGrid.over(bounds, resolution, crs)
    x, y = model.outline(size, heights_m)
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
    """Return the root of the area of a pixel on the map at the lower height, rounded to two digits."""
    a, b = (v[: BORDER * BORDER].reshape(BORDER, BORDER) for v in (x, y))
    (down_x, across_x), (down_y, across_y) = ((v[-1, 0] - v[0, 0], v[-1, -1] - v[-1, 0]) for v in (a, b))
    area = abs(down_x * across_y - across_x * down_y)
    return float(f"{math.sqrt(area / (size[0] * size[1])):.2g}")


# --- windows ----------------------------------------------------------------------------------------

#: Maximum numbers of DEM cells and of image pixels for a window of the map.
WINDOW_CELLS: Final = 2_000_000
#: Kernel and its slope a, by name.
RESAMPLING: Final = {
    "nearest": (NEAREST, 0.0), "bilinear": (BILINEAR, 0.0), "cubic": (CUBIC, -0.5), "cubic-sharp": (CUBIC, -1.0),
}  # fmt: skip


def fill(
    rasterio: Any, source: Any, target: Path, grid: MapGrid, knots: Lattice, surface: Surface, limits: Array,
    nodata: float, options: OrthoOptions, progress: Progress | None,
) -> tuple[int, int, Written]:  # fmt: skip
    """Write all windows; return the numbers of map pixels in the image and with a value in band 1, and checksums."""
    settings = grid.profile(bands=source.count, dtype=source.dtypes[0], nodata=nodata, compress=options.compress)
    edge = window_edge(options.window, knots)
    corners = [(r, c) for r in range(0, grid.rows, edge) for c in range(0, grid.columns, edge)]
    seen = filled = 0
    with rasterio.open(target, "w", **settings) as opened_sink:
        sink = Written(rasterio, opened_sink)
        for done, (row, column) in enumerate(corners):
            if progress is not None:
                progress(done, len(corners), "windows")
            shape = min(edge, grid.rows - row), min(edge, grid.columns - column)
            line, sample = np.empty(shape), np.empty(shape)
            heights, part = _heights(surface, knots, (row, column), shape)
            holes, hole_row, hole_column = pixel_positions(
                row, column, knots.step, knots.knots, heights, part, knots.scaling, limits, line, sample
            )
            if holes and not options.allow_holes:
                raise InputError.of("ortho.hole", file=surface.path, row=hole_row, column=hole_column)
            seen += int(np.count_nonzero(~np.isnan(line)))
            place = rasterio.windows.Window(column, row, shape[1], shape[0])
            filled += _window(rasterio, source, sink, place, line, sample, nodata, options.resampling)
    if progress is not None:
        progress(len(corners), len(corners), "windows")
    return seen, filled, sink


def window_edge(wanted: int, knots: Lattice) -> int:
    """Return the edge of windows, map pixels; it is smaller than requested if windows would need too many cells."""
    most = max(1, int(math.sqrt(WINDOW_CELLS) / max(1.0, *knots.density())))
    return min(wanted, most if most < TILE else most // TILE * TILE)


def _heights(surface: Surface, knots: Lattice, first: tuple[int, int], shape: tuple[int, int]) -> tuple[Array, Array]:
    """Return the surface heights that a window of the map needs, and their first row and column."""
    box = []
    for axis, n in zip((KNOT.row, KNOT.column), surface.shape, strict=True):
        low, high = knots.extent(axis, first, shape)
        if not (low <= n - 1.0 and high >= 0.0):
            return np.empty((0, 0)), PART.pack(row=0.0, column=0.0)
        begin = min(max(math.floor(low), 0), max(n - 2, 0))
        box.append((begin, max(min(math.floor(high) + 2, n), begin + 1)))
    (top, bottom), (left, right) = box
    return surface.window(top, left, bottom - top, right - left), PART.pack(row=float(top), column=float(left))


def _window(
    rasterio: Any, source: Any, sink: Written, place: Any, line: Array, sample: Array, nodata: float, resampling: str
) -> int:
    """Resample all bands into one window; return the number of pixels of the first band with a value."""
    if np.isnan(line).all():
        empty = np.full(line.shape, nodata).astype(source.dtypes[0])
        for band in source.indexes:
            sink.write(empty, band, place)
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
        sink.write(_stored(out, source.dtypes[0], nodata), band, place)
    return count


def _needed(positions: Array, n: int) -> tuple[int, int]:
    """Return the range of lines that a kernel may use: the first line, and the line after the last one."""
    low, high = math.floor(np.nanmin(positions)), math.floor(np.nanmax(positions))
    return min(max(low - REACH, 0), n - 1), max(min(high + REACH + 1, n), 1)


def _read(rasterio: Any, source: Any, band: int, part: Any) -> Array:
    try:
        grey = source.read(band, window=part).astype(float)
    # rasterio's error is an OSError, which would otherwise be reported as an error of the output
    except rasterio.RasterioIOError as error:
        raise InputError.of("ortho.image", file=source.name, place=f"band {band}, from line {part.row_off}",
                            value=error.__cause__ or error) from error  # fmt: skip
    nodata = source.nodatavals[band - 1]
    if nodata is not None and not math.isnan(nodata):
        grey[grey == nodata] = np.nan
    return np.ascontiguousarray(grey)


def _stored(values: Array, dtype: str, nodata: float) -> npt.NDArray[Any]:
    """Return the values rounded and limited to the type of the file; values equal to nodata become the next one."""
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


# --- work of the command ----------------------------------------------------------------------------


def rectify_image(
    image: Path, model: Path, out: Path, *, dem: Path | None = None, height_m: float | None = None,
    result: Path | None = None, image_id: str = "", crs: str = "", resolution: float | None = None,
    bounds: Bounds | None = None, options: OrthoOptions | None = None, overwrite: bool = False,
    progress: Progress | None = None, extrapolate_attitude_s: float = 0.0,
    light: tuple[str, ...] = (),
) -> dict[str, Any]:  # fmt: skip
    """Orthorectify an image.

    Parameters
    ----------
    image : Path
        Raster in sensor geometry.
    model : Path
        Metadata file of its sensor, or ``transformation.json`` of ``rectify fit`` or its folder.
    out : Path
        GeoTIFF.
    dem : Path, optional
        Ellipsoidal heights; or ``height_m``, one height. Plane transformations need neither.
    result : Path, optional
        Result folder of ``adjust`` whose orientation is used; ``image_id``: the image in it.
    crs : str
        Coordinate system of the map; default: the system of the transformation or of the DEM.
    resolution, bounds, options, overwrite, progress
        See :func:`fg_orient.rectification.ortho.orthorectify`.
    extrapolate_attitude_s, light
        See :func:`fg_orient.formats.sensor.read_sensor`.

    Returns
    -------
    dict
        See :func:`fg_orient.rectification.ortho.orthorectify`; ``findings`` of the DEM; for a sensor
        also its ``notes``, for example on extrapolation.

    Raises
    ------
    InputError
        A file cannot be used; there is no coordinate system, no height or no common ground; or the DEM has holes.
    """
    _require_other(out, image, model, *([] if dem is None else [dem]))
    given = None if dem is None else RasterDem(dem)
    surface: Surface | None = given if height_m is None else LevelSurface(height_m)
    sensor: Sensor | None = None
    geometry: MapModel | None = None
    if model.is_dir() or model.suffix.lower() == ".json":
        if result is not None:
            raise InputError.of("ortho.points_and_result", option="result")
        transformation = read_transformation(model)
        found = doubts_on_fit(model)
        chosen = _system(crs or transformation.crs, image)
        if transformation.crs and not same_crs(transformation.crs, chosen):
            raise InputError.of("ortho.other_crs", option="crs", fitted=transformation.crs)
        geometry = PointModel(transformation)
        if not geometry.needs_heights:  # a DEM would only limit the extent of the map
            surface = LevelSurface(0.0)
    if surface is None:
        raise InputError.of("ortho.no_heights", file=model, option="dem")
    if geometry is None:
        chosen = _system(crs or (surface.crs if isinstance(surface, RasterDem) else ""), image)
        sensor = read_sensor(model, extrapolate_attitude_s=extrapolate_attitude_s, light=light)
        adjusted = read_orientation(result, sensor, image_id)
        found = adjusted.doubts
        geometry = SensorModel(sensor, adjusted.correction, chosen, _top(surface, sensor, chosen, bounds))
    record = orthorectify(image, geometry, surface, out, crs=chosen, resolution=resolution, bounds=bounds,
                          options=options, overwrite=overwrite, progress=progress)  # fmt: skip
    record |= judged((*found, *(surface.notes if isinstance(surface, RasterDem) else ())))
    return record if sensor is None else record | {"notes": list(map(str, sensor.notes))}


def _top(surface: Surface, sensor: Sensor, crs: str, bounds: Bounds | None) -> float:
    """Return the largest height of the map; 0 if there is none."""

    def outline(height_m: float) -> tuple[Array, Array]:
        lon, lat, _ = ecef_to_geodetic(sensor.locate(*sensor.corners(), height_m=height_m))
        return from_geographic(crs, lon, lat)

    return max(float(np.nan_to_num(height_range(surface, crs, bounds, outline, sensor.mean_height_m)[1])), 0.0)


def _require_other(out: Path, *inputs: Path) -> None:
    """Refuse to replace an input, or a file that is not a raster, even with ``overwrite``."""
    if any(path.resolve() == out.resolve() for path in inputs):
        raise InputError.of("ortho.over_input", file=out, option="out")
    if out.is_file():
        with out.open("rb") as stream:
            if stream.read(4) not in TIFF_MARKS:
                raise InputError.of("ortho.foreign", file=out, option="out")


def _system(crs: str, image: Path) -> str:
    """Return the coordinate system of the map as WKT; InputError if it is missing or unknown to rasterio."""
    if not crs:
        raise InputError.of("ortho.no_crs", option="crs")
    rasterio = rasterio_of(image)
    try:
        return str(rasterio.crs.CRS.from_user_input(crs).to_wkt())
    except rasterio.errors.CRSError:
        raise InputError.of("geodesy.unknown_crs", option="crs", value=crs) from None
