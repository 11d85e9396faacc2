"""Files ``.points`` of QGIS's georeferencer; they contain the points of one image without names and heights.

A file has a line ``#CRS: WKT``, a header
``mapX,mapY,sourceX,sourceY,enable,dX,dY,residual``, and one line for each point. Older
versions write pixelX, pixelY instead of sourceX, sourceY. sourceX is the column, and
**sourceY is minus the row**. Both count from the corner of the first pixel, so that its
centre is (0.5, -0.5). If the image was georeferenced before, QGIS writes map coordinates
instead. The reader recognises such a file only if a sourceY is above zero.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.survey import Gathering, Survey
from fg_orient.formats.exchange.text import cells_of, digits, named, numbers, row_of, stated_in
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import Row
from fg_orient.geodesy.crs import wkt
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

_QGIS: Final = ("mapX", "mapY", "sourceX", "sourceY", "enable", "dX", "dY", "residual")
_QGIS_OLDER: Final = {"pixelX": "sourceX", "pixelY": "sourceY"}
_QGIS_NEEDED: Final = _QGIS[:4]
#: Column of the first pixel's centre; also minus its row.
CENTRE_PX: Final = 0.5
_QGIS_CRS: Final = re.compile(r"^#\s*CRS:\s*(.+)$", re.MULTILINE)


def read_qgis(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the points of one image and number them in their order.

    Enabled points are control points, the others are check points.
    """
    path = paths[0]
    gathered = Gathering(path, settings.crs, stated_in(path, _QGIS_CRS))
    faults = gathered.faults
    lines = cells_of(path, faults, "comma")
    faults.raise_if_any()
    image = settings.image or path.name.removesuffix(".points")
    names = _header(lines, path)
    for k, (n, cells) in enumerate(lines[1:], start=1):
        if not len(_QGIS_NEEDED) <= len(cells) <= len(names):
            value = f"{len(cells)} cells"
            faults.add("interchange.cell_count", place=f"line {n}", value=value, expected=f"4 to {len(names)}")
            continue
        _take(gathered, named(n, cells, names), str(k), image)
    return gathered.finished()


def _header(lines: list[tuple[int, list[str]]], path: Path) -> list[str]:
    """Return the names of the columns; names of older versions are replaced by the new ones."""
    names = [_QGIS_OLDER.get(cell, cell) for cell in lines[0][1]] if lines else []
    for column in _QGIS_NEEDED:
        if column not in names:
            raise InputError.of("interchange.columns", file=path, place="header", value=",".join(names), column=column)
    return names


def _take(gathered: Gathering, row: Row, name: str, image: str) -> None:
    east, north, x, y = numbers(row, _QGIS_NEEDED, gathered.faults)
    if y > 0.0:
        gathered.faults.add("interchange.rows_positive", place=row.place("sourceY"), value=row.cells["sourceY"])
    role = Role.CHECK if row.cells.get("enable", "1") == "0" else Role.CONTROL
    gathered.point(name, role, (east, north, np.nan), line=row.line)
    gathered.measure(image, name, -y - CENTRE_PX, x - CENTRE_PX, line=row.line)


def write_qgis(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> tuple[Finding, ...]:
    """Write the points of one image; if there are several images, the settings name it."""
    o, image = survey.observed, settings.image
    if not image and len(survey.images) == 1:
        image = survey.images[0]
    if image not in survey.images:
        raise InputError.of(
            "interchange.which_image", file=paths[0], option="image", value=image, count=len(survey.images)
        )
    lines, mine = [f"#CRS: {wkt(survey.crs.partition('+')[0])}", ",".join(_QGIS)], survey.images.index(image)
    known = survey.located
    for i, p, line, sample in zip(o.image, o.point, o.line, o.sample, strict=True):
        if i == mine and known[p]:
            pixel = digits(sample + CENTRE_PX), digits(-(line + CENTRE_PX))
            enable = "0" if survey.roles[p] is Role.CHECK else "1"
            lines.append(row_of([*map(digits, survey.coordinates[p, :2]), *pixel, enable, "0", "0", "0"]))
    write_lines(paths[0], lines)
    others = int((o.image != mine).sum())
    return (finding("lost.images", file=paths[0], value=f"{others} points", format=QGIS.name),) if others else ()


QGIS = Format(
    name="qgis-points",
    title="QGIS georeferencer .points",
    suffixes=(".points",),
    first_pixel=(-CENTRE_PX, CENTRE_PX),
    pixel_axes="sourceX (column), sourceY (minus the row), pixels",
    ground_axes="longitude or easting, latitude or northing; no height",
    holds=frozenset({Holds.GROUND, Holds.IMAGE, Holds.ROLES, Holds.CRS}),
    read=read_qgis,
    write=write_qgis,
)
