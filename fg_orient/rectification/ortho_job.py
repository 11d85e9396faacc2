"""``rectify ortho``: files in, a map raster out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from fg_orient.formats.gdal import rasterio_of
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from fg_orient.model.names import Progress
from fg_orient.rectification.adjusted import read_correction
from fg_orient.rectification.grid import Bounds
from fg_orient.rectification.lattice import LevelSurface, Surface
from fg_orient.rectification.ortho import OrthoOptions, orthorectify
from fg_orient.rectification.ortho_models import SensorModel, point_model
from fg_orient.rectification.transformation import read_transformation
from fg_orient.sensors.surface import RasterDem

#: First bytes of TIFF and BigTIFF files in both byte orders.
TIFF_MARKS: Final = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")


def rectify_image(
    image: Path, model: Path, out: Path, *, dem: Path | None = None, height_m: float | None = None,
    result: Path | None = None, image_id: str = "", crs: str = "", resolution: float | None = None,
    bounds: Bounds | None = None, options: OrthoOptions | None = None, overwrite: bool = False,
    progress: Progress | None = None, extrapolate_attitude_s: float = 0.0,
) -> dict[str, Any]:  # fmt: skip
    """Orthorectify an image.

    Parameters
    ----------
    image : Path
        Raster in sensor geometry.
    model : Path
        Metadata file of its sensor; or ``transformation.json`` of ``rectify fit``, or the folder.
    out : Path
        GeoTIFF.
    dem : Path, optional
        Ellipsoidal heights; or ``height_m``, one height. Plane transformations need neither.
    result : Path, optional
        Result folder of ``adjust`` whose orientation is taken; ``image_id``: the image in it.
    crs : str
        Of the map; default that of the transformation or of the DEM.
    resolution, bounds, options, overwrite, progress
        See :func:`fg_orient.rectification.ortho.orthorectify`.
    extrapolate_attitude_s : float
        See :func:`fg_orient.formats.sensor.read_sensor`.

    Returns
    -------
    dict
        See :func:`fg_orient.rectification.ortho.orthorectify`; of a sensor also its ``notes``, extrapolation among
        them.

    Raises
    ------
    InputError
        Unusable files, no coordinate system, no heights, no common ground, holes of the DEM.
    """
    _require_other(out, image, model, *([] if dem is None else [dem]))
    surface: Surface | None = RasterDem(dem) if dem is not None else None
    if height_m is not None:
        surface = LevelSurface(height_m)
    if model.is_dir() or model.suffix.lower() == ".json":
        if result is not None:
            raise InputError.of("ortho.points_and_result", option="result")
        return _by_points(image, model, out, surface, crs, resolution, bounds, options, overwrite, progress)
    if surface is None:
        raise InputError.of("ortho.no_heights", file=model, option="dem")
    chosen = _system(crs or (surface.crs if isinstance(surface, RasterDem) else ""), image)
    sensor = read_sensor(model, extrapolate_attitude_s=extrapolate_attitude_s)
    correction = None if result is None else read_correction(result, sensor, image_id)
    bound = SensorModel(sensor, correction, chosen, surface.range_m[1])
    record = orthorectify(image, bound, surface, out, crs=chosen, resolution=resolution, bounds=bounds, options=options,
                          overwrite=overwrite, progress=progress)  # fmt: skip
    return {**record, "notes": list(map(str, sensor.notes))}


def _require_other(out: Path, *inputs: Path) -> None:
    """Refuse to write over what is read, or over a file that is no raster, whatever ``overwrite`` says."""
    if any(path.resolve() == out.resolve() for path in inputs):
        raise InputError.of("ortho.over_input", file=out, option="out")
    if out.is_file():
        with out.open("rb") as stream:
            mark = stream.read(4)
        if mark not in TIFF_MARKS:
            raise InputError.of("ortho.foreign", file=out, option="out")


def _by_points(
    image: Path, model: Path, out: Path, surface: Surface | None, crs: str, resolution: float | None,
    bounds: Bounds | None, options: OrthoOptions | None, overwrite: bool, progress: Progress | None,
) -> dict[str, Any]:  # fmt: skip
    found = read_transformation(model)
    chosen = _system(crs or found.crs, image)
    bound = point_model(found, chosen)
    if bound.needs_heights and surface is None:
        raise InputError.of("ortho.no_heights", file=model, option="dem")
    # a plane transformation knows no heights: a DEM would only cut the map
    over = surface if bound.needs_heights and surface is not None else LevelSurface(0.0)
    return orthorectify(image, bound, over, out, crs=chosen, resolution=resolution, bounds=bounds, options=options,
                        overwrite=overwrite, progress=progress)  # fmt: skip


def _system(crs: str, image: Path) -> str:
    """Coordinate system of the map as WKT.

    Raises
    ------
    InputError
        None is given, or rasterio does not know it.
    """
    if not crs:
        raise InputError.of("ortho.no_crs", option="crs")
    rasterio = rasterio_of(image)
    try:
        return str(rasterio.crs.CRS.from_user_input(crs).to_wkt())
    except rasterio.errors.CRSError:
        raise InputError.of("geodesy.unknown_crs", option="crs", value=crs) from None
