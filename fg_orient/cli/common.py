"""Options and inputs that several commands share."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fg_orient.cli.command import argument, option
from fg_orient.cli.output import tell
from fg_orient.model.declaration import declared
from fg_orient.model.errors import InputError
from fg_orient.model.options import MAX_EXTRAPOLATION_S, Reading

if TYPE_CHECKING:
    from fg_orient.model.block import Image
    from fg_orient.sensors.surface import RasterDem

EXTRAPOLATE = declared(Reading)["extrapolate_attitude_s"]
ModelOf = Annotated[str, option("Model to use if the file contains both.", "auto|rigorous|rpc")]
Result = Annotated[Path | None, option("Result folder of adjust: its orientation of the image.", "DIR")]
Dem = Annotated[Path | None, option("DEM, any raster GDAL reads; ellipsoidal unless it says otherwise.")]
VerticalCrs = Annotated[str, option("Vertical CRS of a DEM without one; EPSG:5773: EGM96.", "EPSG:N")]
Extrapolate = Annotated[
    float,
    option(EXTRAPOLATE.short_help, EXTRAPOLATE.metavar, flag=EXTRAPOLATE.flag, min=0.0, max=MAX_EXTRAPOLATION_S),
]
Project = Annotated[Path, argument("PROJECT.toml", "Project file.")]
Scheduler = Annotated[str | None, option("Scheduler of a running dask cluster, instead of processes.", "ADDRESS")]
ImageSize = Annotated[
    list[str] | None, option("Size of an image, for formats that need it; may be repeated.", "NAME=LINES,SAMPLES")
]
Overwrite = Annotated[bool, option("Replace an existing output once the new one is complete.", flag="--overwrite")]


def command_line() -> list[str]:
    """Words of this command line, for the record of a result."""
    return ["fg-orient", *sys.argv[1:]]


def image_sizes(words: list[str] | None) -> dict[str, tuple[int, int]]:
    """Sizes of images by name: lines, samples; InputError for other words."""
    sizes = {}
    for word in words or []:
        name, _, size = word.rpartition("=")
        parts = size.split(",")
        if not name or len(parts) != 2 or not all(part.isdecimal() and int(part) > 0 for part in parts):
            raise InputError.of("interchange.image_size", option="image_size", value=word)
        sizes[name] = int(parts[0]), int(parts[1])
    return sizes


def require_project(path: Path) -> None:
    """Raise InputError if the project file does not exist or is a folder, before large modules are loaded."""
    if not path.is_file():
        from fg_orient.formats.toml import no_project_file

        raise no_project_file(path)


def read_image(path: Path, model: str, extrapolate_s: float, result: Path | None = None) -> Any:
    """Read a sensor with the options ``--model``, ``--extrapolate-attitude`` and ``--result``."""
    from fg_orient.formats.sensor import read_sensor

    sensor = read_sensor(path, model=model, extrapolate_attitude_s=extrapolate_s)
    return sensor if result is None else _with_result(sensor, result)


def oriented(images: tuple[Image, ...], result: Path | None) -> tuple[Image, ...]:
    """Images of a project with the orientation of a result folder, if one is given."""
    from fg_orient.model.block import Image

    return images if result is None else tuple(Image(i.id, _with_result(i.sensor, result, i.id)) for i in images)


def _with_result(sensor: Any, result: Path, image_id: str = "") -> Any:
    from fg_orient.rectification.adjusted import read_correction
    from fg_orient.sensors.base import OrientedSensor

    return OrientedSensor(sensor, read_correction(result, sensor, image_id))


def read_dem(path: Path | None, vertical_crs: str) -> RasterDem | None:
    """Read a DEM with the options ``--dem`` and ``--dem-vertical-crs``."""
    if path is None:
        if vertical_crs:
            raise InputError.of("dem.missing", option="dem", value="none given")
        return None
    return open_dem(path, vertical_crs)


def open_dem(path: Path, vertical_crs: str = "") -> RasterDem:
    """Read a DEM; warn of heights that no land has."""
    from fg_orient.sensors.surface import RasterDem

    surface = RasterDem(path, vertical_crs=vertical_crs)
    for one in surface.notes:
        tell("warning", one)
    return surface
