"""Options and inputs that several commands share."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from fg_orient.cli.command import Several, argument, option
from fg_orient.cli.output import tell
from fg_orient.model.declaration import declared
from fg_orient.model.errors import InputError
from fg_orient.model.options import MAX_EXTRAPOLATION_S, Reading

if TYPE_CHECKING:
    from fg_orient.model.block import Block
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


class Sensors(NamedTuple):
    """Reading of sensors with the options ``--model``, ``--extrapolate-attitude`` and ``--result``."""

    model: str
    extrapolate_attitude: float
    result: Path | None

    def read(self, path: Path) -> Any:
        """Read a sensor."""
        from fg_orient.formats.sensor import read_sensor

        return self._oriented(read_sensor(path, model=self.model, extrapolate_attitude_s=self.extrapolate_attitude))

    def project(self, path: Path) -> Block:
        """Read a project."""
        from fg_orient.formats.project import read_project

        block = read_project(path, extrapolate_attitude_s=self.extrapolate_attitude or None)
        return replace(block, images=tuple(replace(i, sensor=self._oriented(i.sensor, i.id)) for i in block.images))

    def _oriented(self, sensor: Any, image_id: str = "") -> Any:
        """Sensor with the orientation of the result folder, if one is given."""
        if self.result is None:
            return sensor
        from fg_orient.rectification.adjusted import read_correction
        from fg_orient.sensors.base import OrientedSensor

        return OrientedSensor(sensor, read_correction(self.result, sensor, image_id))


#: Options of sensors, in place of the parameter ``sensors`` of a command.
SENSORS = {"sensors": Several(
    {"model": (ModelOf, "auto"), "extrapolate_attitude": (Extrapolate, 0.0), "result": (Result, None)}, Sensors
)}  # fmt: skip


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
