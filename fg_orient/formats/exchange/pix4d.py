"""Ground control of Pix4D: a table of points and one of their marks in images, both without header.

Points: ``label, coordinate 1, coordinate 2, z`` and, if given, ``horizontal accuracy, vertical accuracy``. The two
coordinates have the order of the definition of the CRS (latitude first for EPSG:4326). Marks: ``image, label, x, y``
and, if given, a scale, which is ignored. Pixels count from the corner of the first pixel: its centre is (0.5, 0.5).
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import read_tables, write_tables
from fg_orient.formats.registry import POINTS_AND_MARKS, Format, Holds, Settings

POINT: Final = ("label", "coordinate 1", "coordinate 2", "z", "horizontal accuracy", "vertical accuracy")
MARK: Final = ("image", "label", "x", "y", "scale")
#: Coordinate of the centre of the first pixel.
CENTRE_PX: Final = 0.5


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the points and, if given, their marks."""
    counts = ((4, 5, 6), (4, 5))
    return read_tables(paths, settings.crs, "comma", POINT, MARK, counts, CENTRE_PX, in_crs_order=True)


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write both tables; the second only if there are image points."""
    write_tables(survey, paths, "comma", POINT, MARK, CENTRE_PX, in_crs_order=True)


FORMAT = Format(
    name="pix4d",
    title="Pix4D ground control points and marks (CSV)",
    suffixes=(".csv",),
    files=("points", "marks"),
    first_pixel=(CENTRE_PX, CENTRE_PX),
    pixel_axes="x, y (pixels)",
    ground_axes="in the order of the definition of the CRS, then height (m)",
    holds=POINTS_AND_MARKS,
    needs=frozenset({Holds.HEIGHTS}),
    read=read,
    write=write,
)
