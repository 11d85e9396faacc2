"""Frame images: TOML files that stand for one image, with its exterior orientation, and name the file of its camera.

docs/frame-cameras.md describes the format.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError

from fg_orient.formats.atomic import write_text
from fg_orient.formats.camera import Number, read_camera
from fg_orient.formats.project import parse_toml
from fg_orient.formats.schema import Positive, Text, problems_of
from fg_orient.formats.schema import _Table as Table
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, to_ecef
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import FrameSensor, rotation_of_opk

Array = npt.NDArray[np.float64]
Three = tuple[Number, Number, Number]


class FrameFile(Table):
    """A whole frame image."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    kind: Literal["frame"] = Field(description='kind = "frame"')
    camera: Text = Field(description="the path of the camera file in quotes")
    crs: Text = Field(description='an EPSG code in quotes, such as "EPSG:4979"')
    centre: Three = Field(description="three numbers: the projection centre in the order of a point table of this CRS")
    omega_phi_kappa_deg: Three | None = Field(default=None, description="three numbers, degrees")
    rotation: tuple[Three, Three, Three] | None = Field(default=None, description="three rows of three numbers")
    sigma: dict[str, Annotated[Positive, Field(description="a number above zero")]] = Field(
        default_factory=dict, description="a table [sigma] of unknowns with their prior sigmas"
    )
    shared: dict[str, Text] = Field(default_factory=dict, description="a table [shared] of unknowns with a name each")


def read_frame_file(path: str | Path) -> FrameSensor:
    """Read a frame image and its camera.

    Parameters
    ----------
    path : str or Path
        The TOML file; the path of the camera is relative to it.

    Raises
    ------
    InputError
        One of the files cannot be read, or a value is missing or not possible.
    """
    path = Path(path)
    try:
        found = FrameFile.model_validate(parse_toml(path))
    except ValidationError as error:
        raise InputError(*problems_of(error, str(path), FrameFile)) from None
    if (found.omega_phi_kappa_deg is None) == (found.rotation is None):
        raise InputError.of("frame.angles", file=path, place="omega_phi_kappa_deg, rotation")
    interior = read_camera(path.parent / found.camera)
    try:
        centre = to_ecef(found.crs, *(np.array([value]) for value in found.centre))[0]
        camera = interior.camera(_rotation(found, centre), centre, found.sigma, found.shared)
    except InputError as error:
        raise InputError(*(replace(p, file=str(path)) for p in error.problems)) from None
    return FrameSensor(camera, interior.n_lines, interior.n_samples, file=str(path))


def _rotation(found: FrameFile, centre_m: Array) -> Array:
    """Camera axes from Earth-fixed ones; angles turn East, North, Up at the projection centre."""
    if found.rotation is not None:
        return np.array(found.rotation)
    lon, lat, _ = ecef_to_geodetic(centre_m[None])
    assert found.omega_phi_kappa_deg is not None  # or the rotation
    return np.asarray(rotation_of_opk(*np.radians(found.omega_phi_kappa_deg)) @ enu_from_ecef(lon, lat)[0])


def write_frame_file(path: str | Path, sensor: FrameSensor, camera: str) -> None:
    """Write a frame image in Earth-fixed coordinates, with all digits of its orientation.

    Parameters
    ----------
    path : str or Path
    sensor : FrameSensor
        Georeferenced, its first pixel being (0, 0).
    camera : str
        Path of its camera file, relative to ``path`` (:func:`fg_orient.formats.camera.write_camera`).
    """
    own = sensor.camera
    rows = ", ".join(str(row) for row in own.rotation.tolist())
    text = [
        "schema = 1", 'kind = "frame"', f'camera = "{camera}"', 'crs = "EPSG:4978"',
        f"centre = {own.centre_m.tolist()}", f"rotation = [{rows}]", "",
        "[sigma]", *(f"{name} = {float(value)!r}" for name, value in own.sigma.items()), "",
        "[shared]", *(f'{name} = "{with_whom}"' for name, with_whom in own.shared.items()), "",
    ]  # fmt: skip
    write_text(path, "\n".join(text))
