"""Ground control files ``gcp_list.txt`` of OpenDroneMap; each line is an image point with its ground point.

The first line states the CRS: ``EPSG:32632``, a PROJ string, or ``WGS84 UTM 32N``. If it
is missing, the user must give the CRS. The other lines contain ``geo_x geo_y geo_z im_x
im_y image``, separated by blanks. The name of the point may follow; further words are
ignored. geo_x is longitude or easting; the height ``NaN`` is unknown. It is assumed that
(0, 0) is the centre of the first pixel.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.columns import finite
from fg_orient.formats.exchange.survey import Gathering, Survey
from fg_orient.formats.exchange.text import cells_of, digits, named, numbers, require_plain
from fg_orient.formats.faults import Faults
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import Row
from fg_orient.model.errors import InputError, finding
from fg_orient.model.names import Role

_ODM: Final = ("geo_x", "geo_y", "geo_z", "im_x", "im_y", "image", "name")
_ODM_FEWEST: Final = 6
#: OpenDroneMap does not read a geographic CRS with heights. It is replaced by its horizontal CRS.
_ODM_FLAT: Final = {"EPSG:4979": "EPSG:4326"}


def read_odm(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read a ``gcp_list.txt``.

    Points without names are distinguished by their coordinates and get numbers.
    """
    path = paths[0]
    faults = Faults(str(path))
    lines = cells_of(path, faults, "blank")
    faults.raise_if_any()
    if not lines:
        raise InputError.of("interchange.empty", file=path)
    # if the first line is an image point, the file does not state its CRS
    headless = len(lines[0][1]) >= _ODM_FEWEST and finite(lines[0][1][:2]) is not None
    gathered = Gathering(path, settings.crs, "" if headless else " ".join(lines[0][1]))
    faults = gathered.faults
    placed: dict[str, tuple[tuple[str, ...], int]] = {}
    numbered: dict[tuple[str, ...], str] = {}
    for n, cells in lines if headless else lines[1:]:
        if len(cells) < _ODM_FEWEST:
            faults.add("interchange.cell_count", place=f"line {n}", value=f"{len(cells)} cells", expected="6 or 7")
            continue
        row = named(n, cells[: len(_ODM)], _ODM)
        place = tuple(cells[:3])
        name = row.cells["name"] or numbered.setdefault(place, str(len(numbered) + 1))
        before = placed.setdefault(name, (place, n))
        if before[0] != place:
            faults.add("interchange.two_places", place=f"line {n}", value=name, first=before[1])
        elif before[1] == n:
            gathered.point(name, Role.CONTROL, _coordinates(row, faults), line=n)
        x, y = numbers(row, ("im_x", "im_y"), faults)
        gathered.measure(row.cells["image"], name, y, x, line=n)
    gathered.notes += (finding("points.numbered", n=len(numbered)),) if numbered else ()
    return gathered.finished()


def _coordinates(row: Row, faults: Faults) -> tuple[float, ...]:
    """Read the coordinates of a line; the height may be nan."""
    if row.cells["geo_z"].lower() == "nan":
        return (*numbers(row, ("geo_x", "geo_y"), faults), np.nan)
    return numbers(row, ("geo_x", "geo_y", "geo_z"), faults)


def write_odm(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write the image points of all ground points that have coordinates."""
    path, o = paths[0], survey.observed
    require_plain((*survey.ids, *survey.images), "name", path)
    flat = survey.crs.partition("+")[0].upper()
    lines, known = [_ODM_FLAT.get(flat, flat)], survey.located
    for i, p, line, sample in zip(o.image, o.point, o.line, o.sample, strict=True):
        if known[p]:
            east, north, height = survey.coordinates[p]
            ground = [digits(east), digits(north), "NaN" if np.isnan(height) else digits(height)]
            lines.append(" ".join([*ground, digits(sample), digits(line), survey.images[i], survey.ids[p]]))
    write_lines(path, lines)


ODM = Format(
    name="odm",
    title="OpenDroneMap gcp_list.txt",
    suffixes=("gcp_list.txt",),
    first_pixel=(0.0, 0.0),
    pixel_axes="x, y (pixels)",
    ground_axes="longitude or easting, latitude or northing, height (m)",
    holds=frozenset({Holds.GROUND, Holds.IMAGE, Holds.IDS, Holds.IMAGES, Holds.HEIGHTS, Holds.CRS}),
    read=read_odm,
    write=write_odm,
)
