"""Work of ``rectify ortho``: a map raster from files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from fg_orient.formats.gdal import rasterio_of
from fg_orient.formats.sensor import read_sensor
from fg_orient.geodesy import same_crs
from fg_orient.model.errors import InputError, as_record
from fg_orient.model.names import Progress
from fg_orient.rectification.adjusted import read_correction
from fg_orient.rectification.grid import Bounds, LevelSurface, Surface
from fg_orient.rectification.options import OrthoOptions
from fg_orient.rectification.ortho import orthorectify
from fg_orient.rectification.ortho_models import MapModel, PointModel, SensorModel
from fg_orient.rectification.transformation import read_transformation
from fg_orient.sensors.base import Sensor
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
        Metadata file of its sensor, or ``transformation.json`` of ``rectify fit`` or its folder.
    out : Path
        GeoTIFF.
    dem : Path, optional
        Ellipsoidal heights; or ``height_m``, one height. Plane transformations need neither.
    result : Path, optional
        Result folder of ``adjust`` whose orientation is used; ``image_id``: the image in it.
    crs : str
        Coordinate system of the map; default that of the transformation or of the DEM.
    resolution, bounds, options, overwrite, progress
        See :func:`fg_orient.rectification.ortho.orthorectify`.
    extrapolate_attitude_s : float
        See :func:`fg_orient.formats.sensor.read_sensor`.

    Returns
    -------
    dict
        See :func:`fg_orient.rectification.ortho.orthorectify`; ``findings`` of the DEM; for a sensor also its
        ``notes``, for example on extrapolation.

    Raises
    ------
    InputError
        Unusable files, no coordinate system, no heights, no common ground, holes of the DEM.
    """
    _require_other(out, image, model, *([] if dem is None else [dem]))
    surface: Surface | None = RasterDem(dem) if dem is not None else None
    if height_m is not None:
        surface = LevelSurface(height_m)
    sensor: Sensor | None = None
    geometry: MapModel | None = None
    if model.is_dir() or model.suffix.lower() == ".json":
        if result is not None:
            raise InputError.of("ortho.points_and_result", option="result")
        transformation = read_transformation(model)
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
        sensor = read_sensor(model, extrapolate_attitude_s=extrapolate_attitude_s)
        correction = None if result is None else read_correction(result, sensor, image_id)
        geometry = SensorModel(sensor, correction, chosen, surface.range_m[1])
    record = orthorectify(image, geometry, surface, out, crs=chosen, resolution=resolution, bounds=bounds,
                          options=options, overwrite=overwrite, progress=progress)  # fmt: skip
    record |= as_record(surface.notes if isinstance(surface, RasterDem) else ())
    return record if sensor is None else record | {"notes": list(map(str, sensor.notes))}


def _require_other(out: Path, *inputs: Path) -> None:
    """Refuse to replace an input, or a file that is not a raster, even with ``overwrite``."""
    if any(path.resolve() == out.resolve() for path in inputs):
        raise InputError.of("ortho.over_input", file=out, option="out")
    if out.is_file():
        with out.open("rb") as stream:
            mark = stream.read(4)
        if mark not in TIFF_MARKS:
            raise InputError.of("ortho.foreign", file=out, option="out")


def _system(crs: str, image: Path) -> str:
    """Coordinate system of the map as WKT; InputError if it is missing or unknown to rasterio."""
    if not crs:
        raise InputError.of("ortho.no_crs", option="crs")
    rasterio = rasterio_of(image)
    try:
        return str(rasterio.crs.CRS.from_user_input(crs).to_wkt())
    except rasterio.errors.CRSError:
        raise InputError.of("geodesy.unknown_crs", option="crs", value=crs) from None
