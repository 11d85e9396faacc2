"""Control points of MicMac: two text files, ``name X Y Z precXY precZ`` and ``name image x y``, blanks between them.

X is longitude or easting. The CRS is not in the files. Bilinear interpolation at whole coordinates gives the pixel
itself there, so (0, 0) is taken as the centre of the first pixel.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.ground import decided_crs
from fg_orient.formats.exchange.survey import Gathering, Survey
from fg_orient.formats.exchange.text import (
    digits,
    horizontal_sigma,
    numbers,
    read_marks,
    read_rows,
    require_plain,
    sigma,
)
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import Faults
from fg_orient.model.names import Role

POINT: Final = ("name", "X", "Y", "Z", "precXY", "precZ")
MARK: Final = ("name", "image", "x", "y")


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the points and, if given, their image points."""
    crs, _ = decided_crs("", settings.crs, paths[0])
    faults = Faults(str(paths[0]))
    gathered = Gathering(faults)
    for row in read_rows(paths[0], faults, "blank", POINT, (4, 6)):
        across, up = (sigma(row, column, "m", faults) for column in POINT[4:])
        xyz = numbers(row, POINT[1:4], faults)
        gathered.point(row.cells["name"], Role.CONTROL, xyz, (across, across, up), line=row.line)
    faults.raise_if_any()
    if len(paths) > 1:
        read_marks(paths[1], gathered, "blank", MARK, (4,))
    return gathered.finished(crs)


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write both files; the second only if there are image points."""
    require_plain((*survey.ids, *survey.images), "name", paths[0])
    lines = [f"# {' '.join(POINT)}"]
    for k in np.flatnonzero(survey.located).tolist():
        east, north, up = survey.sigma_enu_m[k].tolist()
        values = (*survey.coordinates[k], horizontal_sigma(east, north), up)
        lines.append(" ".join([survey.ids[k], *map(digits, values)]))
    write_lines(paths[0], lines)
    o = survey.observed
    if len(o):
        marks = [
            f"{survey.ids[p]} {survey.images[i]} {digits(sample)} {digits(line)}"
            for i, p, line, sample in zip(o.image, o.point, o.line, o.sample, strict=True)
        ]
        write_lines(paths[1], [f"# {' '.join(MARK)}", *marks])


FORMAT = Format(
    name="micmac",
    title="MicMac control points (two text files)",
    suffixes=(".txt",),
    files=("points", "images"),
    first_pixel=(0.0, 0.0),
    pixel_axes="x, y (pixels)",
    ground_axes="longitude or easting, latitude or northing, height (m)",
    holds=frozenset(
        {Holds.GROUND, Holds.IMAGE, Holds.IDS, Holds.IMAGES, Holds.UNMEASURED, Holds.TIES, Holds.HEIGHTS,
         Holds.SIGMA_GROUND, Holds.SIGMA_UP}
    ),
    needs=frozenset({Holds.HEIGHTS, Holds.SIGMA_GROUND}),
    read=read,
    write=write,
)  # fmt: skip
