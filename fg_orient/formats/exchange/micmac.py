"""Control points of MicMac: two text files, ``name X Y Z precXY precZ`` and ``name image x y``, blanks between them.

X is longitude or easting. The files do not state the CRS. Bilinear interpolation in MicMac gives the value of a pixel
at whole coordinates; (0, 0) is therefore assumed to be the centre of the first pixel.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import read_tables, require_plain, write_tables
from fg_orient.formats.registry import POINTS_AND_MARKS, Format, Holds, Settings

POINT: Final = ("name", "X", "Y", "Z", "precXY", "precZ")
MARK: Final = ("name", "image", "x", "y")


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the points and, if given, their image points."""
    return read_tables(paths, settings.crs, "blank", POINT, MARK, ((4, 6), (4,)))


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write both files; the second only if there are image points."""
    require_plain((*survey.ids, *survey.images), "name", paths[0])
    write_tables(survey, paths, "blank", POINT, MARK)


FORMAT = Format(
    name="micmac",
    title="MicMac control points (two text files)",
    suffixes=(".txt",),
    files=("points", "images"),
    first_pixel=(0.0, 0.0),
    pixel_axes="x, y (pixels)",
    ground_axes="longitude or easting, latitude or northing, height (m)",
    holds=POINTS_AND_MARKS,
    needs=frozenset({Holds.HEIGHTS, Holds.SIGMA_GROUND}),
    read=read,
    write=write,
)
