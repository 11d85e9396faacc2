"""Camera files: the interior orientation of a frame camera in TOML, which says in what direction its polynomial leads.

docs/frame-cameras.md describes it. Coefficients stand as their programs print them: ``brown_ideal_to_measured`` with
OpenCV's p1 and p2 and no unit, ``brown_measured_to_ideal`` with the photogrammetric P1 and P2 (y up) in the file's
unit of length.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError

from fg_orient.formats.atomic import write_text
from fg_orient.formats.project import parse_toml
from fg_orient.formats.schema import Text, problems_of
from fg_orient.formats.schema import _Table as Table
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import MEASURED_TO_IDEAL
from fg_orient.sensors.interior import Interior

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0.0, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, gt=0)]


class CameraFile(Table):
    """A whole camera file."""

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
    focal: Positive = Field(description="focal length in pixels, or in mm beside pixel_mm")
    principal: tuple[Number, Number] = Field(description="x (right) and y (down) of the principal point")
    first_pixel: Number = Field(default=0.0, description="coordinates of the first pixel's centre, px: 0, 0.5 or 1")
    k1: Number = Field(default=0.0, description="a number")
    k2: Number = Field(default=0.0, description="a number")
    k3: Number = Field(default=0.0, description="a number")
    p1: Number = Field(default=0.0, description="a number")
    p2: Number = Field(default=0.0, description="a number")
    aspect: Number = Field(default=0.0, description="a number; 0 with brown_ideal_to_measured")


def read_camera(path: str | Path) -> Interior:
    """Read a camera file.

    Raises
    ------
    InputError
        The file cannot be read, or a value is missing or not possible: all faults at once.
    """
    path = Path(path)
    try:
        found = CameraFile.model_validate(parse_toml(path))
    except ValidationError as error:
        raise InputError(*problems_of(error, path.name, CameraFile)) from None
    return _interior(found)


def _interior(file: CameraFile) -> Interior:
    px = 1.0 if file.pixel_mm is None else 1.0 / file.pixel_mm
    x, y = file.principal
    corrects = file.model == MEASURED_TO_IDEAL
    # y up, x: P1 (r^2 + 2 x^2) + 2 P2 x y becomes y down, x: 2 p1 x y + p2 (r^2 + 2 x^2)
    p = (-file.p2, file.p1) if corrects else (file.p1, file.p2)
    return Interior(
        file.lines, file.samples, file.focal * px, np.array([y, x]) * px - file.first_pixel,
        np.array([file.k1, file.k2, file.k3, *p]), file.model, px if corrects else None, file.aspect, file.name,
    )  # fmt: skip


def write_camera(path: str | Path, interior: Interior) -> None:
    """Write a camera file in pixels, the first pixel's centre being 0; with the polynomial's unit as 1 mm.

    Every number is written with all its digits: reading gives the same camera.
    """
    corrects = interior.model == MEASURED_TO_IDEAL
    px = float(interior.unit_px or interior.focal_px) if corrects else 1.0
    line, sample = interior.principal_px.tolist()
    k1, k2, k3, p1, p2 = interior.distortion.tolist()
    p = (p2, -p1) if corrects else (p1, p2)
    unit = [f"pixel_mm = {1.0 / px!r}"] if corrects else []
    name = interior.name.replace("\\", "\\\\").replace('"', '\\"')
    text = [
        "schema = 1", f'name = "{name}"', f'model = "{interior.model}"', f"lines = {interior.n_lines}",
        f"samples = {interior.n_samples}", *unit, f"focal = {float(interior.focal_px) / px!r}",
        f"principal = [{sample / px!r}, {line / px!r}]", "first_pixel = 0.0",
        *(f"{key} = {value!r}" for key, value in zip(("k1", "k2", "k3", "p1", "p2"), (k1, k2, k3, *p), strict=True)),
        f"aspect = {interior.aspect!r}", "",
    ]  # fmt: skip
    write_text(path, "\n".join(text))
