"""Read and write frame images in TOML: a file of each image with its exterior orientation, and camera files.

docs/frame-cameras.md describes both kinds of files. A camera file states the direction of
its distortion polynomial. The coefficients have the form in which other programs print
them. The model ``brown_ideal_to_measured`` has OpenCV's p1 and p2, without unit. The
model ``brown_measured_to_ideal`` has the photogrammetric P1 and P2 (y up), in the unit of
length of the file. A camera file may instead use the convention of another program
(``fg_orient.sensors.conventions``). It can then contain a covariance matrix.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import numpy as np
from pydantic import Field

from factors.arrays import Array
from fg_orient.formats.atomic import write_lines
from fg_orient.formats.registry import Format
from fg_orient.formats.schema import FilePath, Number, Positive, Table, Text, read_toml, validate
from fg_orient.formats.toml import entries, parse_toml
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, to_ecef
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import MEASURED_TO_IDEAL, FrameSensor, rotation_of_opk
from fg_orient.sensors.interior import Interior

if TYPE_CHECKING:
    from fg_orient.sensors.camera_conversion import ConvertedCamera

Three = tuple[Number, Number, Number]
Count = Annotated[int, Field(strict=True, gt=0)]
_KIND: Final = re.compile(r"""^[^\S\n]*+kind\s*=\s*["']frame["']""", re.MULTILINE)


class CameraFile(Table):
    """Whole camera file."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    name: Text = Field(description='a name in quotes, such as "Olympus C4040Z"')
    model: Literal["brown_ideal_to_measured", "brown_measured_to_ideal"] = Field(
        description='"brown_ideal_to_measured" (OpenCV, COLMAP, BAL, Metashape) or "brown_measured_to_ideal" (DBAT)'
    )
    lines: Count = Field(description="number of lines of the image")
    samples: Count = Field(description="number of samples of the image")
    pixel_mm: Positive | None = Field(
        default=None, description="size of a pixel, mm: focal length, principal point and coefficients are then in mm"
    )
    focal: Positive = Field(description="focal length in pixels, or in mm with pixel_mm")
    principal: tuple[Number, Number] = Field(description="x (right) and y (down) of the principal point")
    first_pixel: Number = Field(default=0.0, description="coordinates of the first pixel's centre, px: 0, 0.5 or 1")
    k1: Number = Field(default=0.0, description="a number")
    k2: Number = Field(default=0.0, description="a number")
    k3: Number = Field(default=0.0, description="a number")
    p1: Number = Field(default=0.0, description="a number")
    p2: Number = Field(default=0.0, description="a number")
    aspect: Number = Field(default=0.0, description="a number")
    fisheye: bool = Field(default=False, description="true or false")
    further: dict[str, Number] = Field(default_factory=dict, description="a table [further] of coefficients by name")


class ConventionFile(Table):
    """Whole camera file in the convention of another program."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    name: Text = Field(description='a name in quotes, such as "Olympus C4040Z"')
    convention: Text = Field(description='the name of a convention, such as "metashape" (docs/frame-cameras.md)')
    lines: Count = Field(description="number of lines of the image")
    samples: Count = Field(description="number of samples of the image")
    pixel_mm: Positive | None = Field(default=None, description="size of a pixel, mm")
    r0_mm: Positive | None = Field(default=None, description="radius of balanced radial terms, mm")
    values: dict[str, Number] = Field(description="a table [values] of numbers by the names of the convention")
    covariance: tuple[tuple[Number, ...], ...] | None = Field(
        default=None, description="rows of numbers in the order of [values]"
    )

    def converted(self, file: str | Path, convention: str = "") -> ConvertedCamera:
        """Convert a camera to another convention, or to its own.

        Impossible values raise InputError.
        """
        from fg_orient.sensors.camera_conversion import convert_camera  # imported here, because it loads scipy.optimize

        try:
            out = convert_camera(
                self.values, self.convention, convention or self.convention, covariance=self.covariance,
                image_size=(self.lines, self.samples), pixel_mm=self.pixel_mm, r0_mm=self.r0_mm,
            )  # fmt: skip
        except InputError as error:
            raise InputError(*(replace(p, file=str(file)) for p in error.problems)) from None
        return replace(out, interior=replace(out.interior, name=self.name))


def read_convention(path: str | Path) -> ConventionFile | None:
    """Read a camera file in the convention of a program, or one from Metashape; None if the file has a ``model``."""
    if Path(path).suffix.lower() == ".xml":
        # imported here, because it loads lxml
        from fg_orient.formats.metadata.metashape_camera import read_metashape_camera

        return validate(read_metashape_camera(path), str(path), ConventionFile)
    content = parse_toml(Path(path))
    return validate(content, str(path), ConventionFile) if "convention" in content else None


def write_convention(path: str | Path, camera: ConvertedCamera, pixel_mm: float | None, r0_mm: float | None) -> None:
    """Write a camera file in the convention of another program, with all digits."""
    own = camera.interior
    rows = None if camera.covariance is None else tuple(map(tuple, camera.covariance.tolist()))
    values = {
        "schema": 1, "name": own.name or camera.convention, "convention": camera.convention, "lines": own.n_lines,
        "samples": own.n_samples, "pixel_mm": pixel_mm, "r0_mm": r0_mm, "covariance": rows,
    }  # fmt: skip
    write_lines(path, [*entries(values), "", "[values]", *entries(camera.values)])


def read_camera(path: str | Path) -> Interior:
    """Read a camera file.

    Raise InputError if it cannot be read or has faults, which are all listed.
    """
    theirs = read_convention(path)
    if theirs is not None:
        return theirs.converted(path).interior
    file = read_toml(path, CameraFile)
    px = 1.0 if file.pixel_mm is None else 1.0 / file.pixel_mm
    x, y = file.principal
    corrects = file.model == MEASURED_TO_IDEAL
    # with y up, x has P1 (r^2 + 2 x^2) + 2 P2 x y; with y down, it has 2 p1 x y + p2 (r^2 + 2 x^2)
    p = (-file.p2, file.p1) if corrects else (file.p1, file.p2)
    return Interior(
        file.lines, file.samples, file.focal * px, np.array([y, x]) * px - file.first_pixel,
        np.array([file.k1, file.k2, file.k3, *p]), file.model, px if corrects else None, file.aspect, file.name,
        file.further, file.fisheye,
    )  # fmt: skip


def write_camera(path: str | Path, interior: Interior) -> None:
    """Write a camera file in pixels; (0, 0) is the centre of the first pixel.

    The unit of the polynomial is written as 1 mm. Numbers have all digits, so that
    reading gives the same camera.
    """
    corrects = interior.model == MEASURED_TO_IDEAL
    px = float(interior.unit_px or interior.focal_px) if corrects else 1.0
    line, sample = interior.principal_px.tolist()
    k1, k2, k3, p1, p2 = interior.distortion.tolist()
    p = (p2, -p1) if corrects else (p1, p2)
    values = {
        "schema": 1, "name": interior.name, "model": interior.model, "lines": interior.n_lines,
        "samples": interior.n_samples, "pixel_mm": 1.0 / px if corrects else None,
        "focal": float(interior.focal_px) / px, "principal": (sample / px, line / px), "first_pixel": 0.0,
        "k1": k1, "k2": k2, "k3": k3, "p1": p[0], "p2": p[1], "aspect": interior.aspect,
        "fisheye": True if interior.is_fisheye else None,
    }  # fmt: skip
    further = ["", "[further]", *entries(dict(interior.further))] if interior.further else []
    write_lines(path, [*entries(values), *further])


# --- images --------------------------------------------------------------------------------------


class FrameFile(Table):
    """Whole file of a frame image."""

    schema_: Literal[1] = Field(alias="schema", description="schema = 1")
    kind: Literal["frame"] = Field(description='kind = "frame"')
    camera: FilePath = Field(description="the path of the camera file in quotes")
    crs: Text = Field(description='an EPSG code in quotes, such as "EPSG:4979"')
    centre: Three = Field(description="three numbers: the projection centre in the order of a point table of this CRS")
    omega_phi_kappa_deg: Three | None = Field(default=None, description="three numbers, degrees")
    rotation: tuple[Three, Three, Three] | None = Field(default=None, description="three rows of three numbers")
    sigma: dict[str, Annotated[Positive, Field(description="a number above zero")]] = Field(
        default_factory=dict, description="a table [sigma] of unknowns with their prior sigmas"
    )
    shared: dict[str, Text] = Field(default_factory=dict, description="a table [shared] of unknowns with a name each")


def read_frame_file(path: str | Path) -> FrameSensor:
    """Read a frame image in TOML, and its camera file; the path of the camera is relative to the image file.

    Raises
    ------
    InputError
        One of the files cannot be read, or a value is missing or impossible.
    """
    path = Path(path)
    read = read_toml(path, FrameFile)
    if (read.omega_phi_kappa_deg is None) == (read.rotation is None):
        raise InputError.of("frame.angles", file=path, place="omega_phi_kappa_deg, rotation")
    interior = read_camera(path.parent / read.camera)
    try:
        centre = to_ecef(read.crs, *(np.array([value]) for value in read.centre))[0]
        camera = interior.camera(_rotation(read, centre), centre, read.sigma, read.shared)
    except InputError as error:
        raise InputError(*(replace(p, file=str(path)) for p in error.problems)) from None
    return FrameSensor(camera, interior.n_lines, interior.n_samples, file=str(path))


def _rotation(read: FrameFile, centre_m: Array) -> Array:
    """Return the rotation from Earth-fixed axes to camera axes.

    Angles refer to East, North, Up at the camera.
    """
    if read.rotation is not None:
        return np.array(read.rotation)
    lon, lat, _ = ecef_to_geodetic(centre_m[None])
    assert read.omega_phi_kappa_deg is not None  # the file has either angles or a rotation matrix
    return np.asarray(rotation_of_opk(*np.radians(read.omega_phi_kappa_deg)) @ enu_from_ecef(lon, lat)[0])


def write_frame_file(path: str | Path, sensor: FrameSensor, camera: str) -> None:
    """Write a georeferenced frame image in Earth-fixed coordinates with all digits; its first pixel is (0, 0).

    ``camera`` is the path of the camera file, relative to ``path`` (:func:`write_camera`).
    """
    own = sensor.camera
    head = {
        "schema": 1, "kind": "frame", "camera": camera, "crs": "EPSG:4978", "centre": tuple(own.centre_m.tolist()),
        "rotation": tuple(map(tuple, own.rotation.tolist())),
    }  # fmt: skip
    sigma = {name: float(value) for name, value in own.sigma.items()}
    lines = [*entries(head), "", "[sigma]", *entries(sigma), "", "[shared]", *entries(own.shared)]
    write_lines(path, lines)


FORMAT = Format(
    name="frame", title='frame image (TOML, kind = "frame")', suffixes=(".toml",),
    sniff=lambda path, head: path.suffix.lower() == ".toml" and _KIND.search(head) is not None,
    read_image=read_frame_file,
)  # fmt: skip
