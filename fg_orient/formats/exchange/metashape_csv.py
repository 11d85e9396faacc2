"""Reference table of Metashape's markers: comma-separated, the user chooses the columns.

The writer uses the columns ``#Label,Enable,X,Y,Z,Accuracy_X_(m),Accuracy_Y_(m),Accuracy_Z_(m)`` below a line
``# CoordinateSystem:``. The reader accepts any header with known names. The accuracy may also be one column, ``0.02``
or ``0.02/0.05`` (horizontal and vertical). X is longitude or easting. An enabled marker is a control point, a disabled
one a check point; a marker without coordinates is a tie point.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.survey import UNKNOWN, Gathering, Survey
from fg_orient.formats.exchange.text import delimited, digits, named, numbers, row_of, separator_of, sigma, stated_in
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import Row, read_text
from fg_orient.geodesy.crs import wkt
from fg_orient.model.errors import InputError, finding
from fg_orient.model.names import Role

#: Names of the columns, without capitals, units, blanks and underscores.
_NAMES: Final = {
    "label": ("label", "name", "marker", "markers", "point"),
    "x": ("x", "x/longitude", "x/easting", "longitude", "easting"),
    "y": ("y", "y/latitude", "y/northing", "latitude", "northing"),
    "z": ("z", "z/altitude", "z/elevation", "z/height", "altitude", "elevation", "height"),
    "enabled": ("enable", "enabled"),
    "accuracy": ("accuracy",),
    "sx": ("accuracyx", "xaccuracy", "accuracyx/longitude", "accuracyx/easting"),
    "sy": ("accuracyy", "yaccuracy", "accuracyy/latitude", "accuracyy/northing"),
    "sz": ("accuracyz", "zaccuracy", "accuracyz/altitude"),
}
_COLUMN: Final = {name: column for column, names in _NAMES.items() for name in names}
_NEEDED: Final = ("label", "x", "y", "z")
_SIGMAS: Final = ("sx", "sy", "sz")
_ASIDE: Final = re.compile(r"\([^)]*\)|[\s_]")
_CRS: Final = re.compile(r"^#\s*CoordinateSystem:\s*(.+)$", re.MULTILINE)
_HEADER: Final = (
    "#Label", "Enable", "X", "Y", "Z", "Accuracy_X_(m)", "Accuracy_Y_(m)", "Accuracy_Z_(m)",
)  # fmt: skip
_OFF: Final = ("0", "false", "no")


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read a reference table."""
    path = paths[0]
    gathered = Gathering(path, settings.crs, stated_in(path, _CRS))
    faults = gathered.faults
    text = read_text(path, faults) or ""
    lines = list(enumerate(text.split("\n"), start=1))
    start, mark, columns, ignored = _header(lines, path)
    for n, line in lines[start:]:
        cells = None if not line.strip() or line.startswith("#") else delimited(line, n, mark, faults)
        if cells and len(cells) > len(columns):
            value = f"{len(cells)} cells"
            faults.add("interchange.cell_count", place=f"line {n}", value=value, expected=f"up to {len(columns)}")
        elif cells:
            _take(gathered, named(n, cells, columns))
    gathered.notes += (finding("points.columns_ignored", columns=ignored),) if ignored else ()
    return gathered.finished()


def _header(lines: list[tuple[int, str]], path: Path) -> tuple[int, str, list[str], list[str]]:
    """Number of the header line, separator, columns, and names of columns that are not read."""
    first = "an empty file"
    for n, line in lines:
        mark = separator_of(line)
        given = [cell.strip().strip('"') for cell in line.lstrip("#").split(mark)]
        columns = [_COLUMN.get(_ASIDE.sub("", cell.lower()), f"unread {k}") for k, cell in enumerate(given)]
        if "label" in columns and len(given) > 1:
            for column in _NEEDED:
                if columns.count(column) != 1:
                    raise InputError.of(
                        "interchange.columns", file=path, place=f"line {n}", value=line.strip(), column=column
                    )
            return n, mark, columns, [name for name, column in zip(given, columns, strict=True) if " " in column]
        if line.strip() and not line.startswith("#"):
            first = line.strip()
            break
    raise InputError.of("interchange.columns", file=path, place="header", value=first, column="label")


def _take(gathered: Gathering, row: Row) -> None:
    """Take one marker."""
    faults = gathered.faults
    if not any(row.cells[column] for column in ("x", "y", "z")):
        gathered.point(row.cells["label"], Role.TIE, UNKNOWN, line=row.line)
        return
    role = Role.CHECK if row.cells.get("enabled", "").lower() in _OFF else Role.CONTROL
    if all(column in row.cells for column in _SIGMAS):
        sigmas = tuple(sigma(row, column, "m", faults) for column in _SIGMAS)
    else:
        across, _, up = row.cells.get("accuracy", "").partition("/")
        both = Row(row.line, {"accuracy": across.strip(), "accuracy z": (up or across).strip()})
        horizontal = sigma(both, "accuracy", "m", faults)
        sigmas = horizontal, horizontal, sigma(both, "accuracy z", "m", faults)
    gathered.point(row.cells["label"], role, numbers(row, ("x", "y", "z"), faults), sigmas, line=row.line)


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write all markers."""
    lines = [f"# CoordinateSystem: {wkt(survey.crs)}", ",".join(_HEADER)]
    for name, role, xyz, sigmas, located in zip(
        survey.ids, survey.roles, survey.coordinates, survey.sigma_enu_m, survey.located, strict=True
    ):
        cells = [digits(v) if located and np.isfinite(v) else "" for v in (*xyz, *sigmas)]
        lines.append(row_of([name, "0" if role is Role.CHECK else "1", *cells]))
    write_lines(paths[0], lines)


FORMAT = Format(
    name="metashape-csv",
    title="Metashape reference table of markers (CSV)",
    suffixes=(".csv",),
    files=("markers",),
    ground_axes="longitude or easting, latitude or northing, height (m), by column name",
    holds=frozenset(Holds) - {Holds.IMAGE, Holds.IMAGES, Holds.SIGMA_IMAGE, Holds.FIXED},
    needs=frozenset({Holds.HEIGHTS}),
    read=read,
    write=write,
)
