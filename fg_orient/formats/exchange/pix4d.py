"""Ground control of Pix4D: a table of points and one of their marks in images, both without header.

Points: ``label, coordinate 1, coordinate 2, z`` and, if given, ``horizontal accuracy, vertical accuracy``; the order of
the two coordinates is that of the definition of the CRS (latitude first for EPSG:4326). Marks: ``image, label, x, y``
and, if given, a scale, which is ignored. Pixels count from the corner of the first one: its centre is (0.5, 0.5).
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
    row_of,
    sigma,
)
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import Faults
from fg_orient.geodesy.crs import north_first
from fg_orient.model.names import Role

POINT: Final = ("label", "coordinate 1", "coordinate 2", "z", "horizontal accuracy", "vertical accuracy")
MARK: Final = ("image", "label", "x", "y", "scale")
#: Coordinate of the centre of the first pixel.
CENTRE_PX: Final = 0.5


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the points and, if given, their marks."""
    crs, _ = decided_crs("", settings.crs, paths[0])
    faults = Faults(str(paths[0]))
    gathered = Gathering(faults)
    backwards = north_first(crs)
    for row in read_rows(paths[0], faults, "comma", POINT, (4, 5, 6)):
        first, second, height = numbers(row, POINT[1:4], faults)
        across, up = (sigma(row, column, "m", faults) for column in POINT[4:])
        east, north = (second, first) if backwards else (first, second)
        gathered.point(row.cells["label"], Role.CONTROL, (east, north, height), (across, across, up), line=row.line)
    faults.raise_if_any()
    if len(paths) > 1:
        read_marks(paths[1], gathered, "comma", MARK, (4, 5), CENTRE_PX)
    return gathered.finished(crs)


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write both tables; the second only if there are image points."""
    order = [1, 0, 2] if north_first(survey.crs) else [0, 1, 2]
    lines = []
    for k in np.flatnonzero(survey.located).tolist():
        east, north, up = survey.sigma_enu_m[k].tolist()
        accuracy = [] if np.isnan(up) else [digits(horizontal_sigma(east, north))]
        accuracy += [digits(up)] if accuracy else []
        lines.append(row_of([survey.ids[k], *map(digits, survey.coordinates[k, order]), *accuracy]))
    write_lines(paths[0], lines)
    o = survey.observed
    if len(o):
        marks = [
            row_of([survey.images[i], survey.ids[p], digits(sample + CENTRE_PX), digits(line + CENTRE_PX)])
            for i, p, line, sample in zip(o.image, o.point, o.line, o.sample, strict=True)
        ]
        write_lines(paths[1], [*marks])


FORMAT = Format(
    name="pix4d",
    title="Pix4D ground control points and marks (CSV)",
    suffixes=(".csv",),
    files=("points", "marks"),
    first_pixel=(CENTRE_PX, CENTRE_PX),
    pixel_axes="x, y (pixels)",
    ground_axes="in the order of the definition of the CRS, then height (m)",
    holds=frozenset(
        {Holds.GROUND, Holds.IMAGE, Holds.IDS, Holds.IMAGES, Holds.UNMEASURED, Holds.TIES, Holds.HEIGHTS,
         Holds.SIGMA_GROUND, Holds.SIGMA_UP}
    ),
    needs=frozenset({Holds.HEIGHTS}),
    read=read,
    write=write,
)  # fmt: skip
