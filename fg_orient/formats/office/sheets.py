"""Read the sheets of files with tables: text with any encoding and separator, workbooks, and GIS layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fg_orient.formats.gdal import plain_case
from fg_orient.formats.load import foreign_bytes, open_sqlite, require_plain
from fg_orient.formats.office.decisions import Assumption
from fg_orient.formats.office.texts import rows_of
from fg_orient.formats.office.workbook import Cell, Rows, read_workbook
from fg_orient.formats.registry import read_bytes
from fg_orient.model.errors import InputError

#: Text files with these suffixes may contain tables.
TEXTS: Final = (".csv", ".txt", ".tsv", ".dat", ".xyz", ".asc", ".prn", ".gcp")
WORKBOOKS: Final = (".xlsx", ".xlsm", ".ods")
LAYERS: Final = (".gpkg", ".shp")
#: A Shapefile begins with these bytes.
SHAPEFILE_MARK: Final = b"\x00\x00\x27\x0a"


@dataclass(frozen=True, eq=False)
class Sheet:
    """Table as the file contains it.

    Parameters
    ----------
    path : Path
    name : str
        Name of the sheet or layer; "" for a text file.
    rows : list of lists of text or float
        Cells. Numbers of workbooks and layers are floats; everything else is text.
    lines : list of int
        Line or row number in the file for each row, from 1.
    crs : str
        CRS that the file states for all its data; "" if it does not state one.
    assumed : tuple of Assumption
    """

    path: Path
    name: str
    rows: Rows
    lines: Sequence[int]
    crs: str = ""
    assumed: tuple[Assumption, ...] = ()
    unit: str = "line"

    @property
    def title(self) -> str:
        """Return the name of the file, and of the sheet or layer."""
        return f"{self.path.name}, {self.name}" if self.name else self.path.name

    def place(self, k: int, header: str = "") -> str:
        """Return the place of row k for messages."""
        where = f"sheet {self.name}, " if self.name else ""
        return f"{where}{self.unit} {self.lines[k]}" + (f", column {header}" if header else "")


def read_sheets(path: Path) -> list[Sheet]:
    """Read all sheets of a file that are not empty.

    Raises
    ------
    InputError
        The file cannot be read, or it contains no table.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        raise InputError.of("table.missing_file", file=path)
    if suffix == ".xls":
        raise InputError.of("office.old_workbook", file=path)
    if suffix in WORKBOOKS:
        sheets = [
            Sheet(path, name, rows, range(1, len(rows) + 1), unit="row") for name, rows in read_workbook(path).items()
        ]
    elif suffix in LAYERS:
        sheets = _layers(path)
    else:
        rows, lines, crs, assumed = rows_of(path)
        sheets = [Sheet(path, "", rows, lines, crs, assumed)]
    sheets = [sheet for sheet in sheets if any(map(any, sheet.rows))]
    if not sheets:
        raise InputError.of("interchange.empty", file=path)
    return sheets


# --- layers ---------------------------------------------------------------------------------------


def _layers(path: Path) -> list[Sheet]:
    """Read the layers of a GeoPackage or Shapefile.

    Columns are the attributes, then the coordinates of the points.
    """
    from fg_orient.formats.exchange.gis import libraries

    pyogrio, shapely = libraries(path)
    sheets = []
    with foreign_bytes("office.layer", path), plain_case():
        _require_plain(path)
        for name, kind in pyogrio.list_layers(path):
            sheets.append(_layer(path, str(name), kind, pyogrio, shapely))
    return sheets


def _require_plain(path: Path) -> None:
    """Refuse a file whose content does not fit its suffix, or whose layers are views.

    GDAL would read other files that the content names.
    """
    if path.suffix.lower() == ".shp":
        if read_bytes(path, 4) != SHAPEFILE_MARK:
            raise ValueError("it is not a Shapefile")
        return
    with open_sqlite(path, (), "office.layer") as opened:
        names = [str(name) for (name,) in opened.execute("SELECT table_name FROM gpkg_contents")]
        require_plain(opened, names)


def _layer(path: Path, name: str, kind: str | None, pyogrio: Any, shapely: Any) -> Sheet:
    meta, _, geometry, columns = pyogrio.raw.read(path, layer=name)
    cells = [[_plain(value) for value in column] for column in columns]
    names = [str(field) for field in meta["fields"]]
    crs = ""
    if kind is not None and geometry is not None:
        points = shapely.from_wkb(geometry)
        wrong = next((p.geom_type for p in points if p is not None and not p.is_empty and p.geom_type != "Point"), "")
        if wrong:
            raise InputError.of("office.layer", file=path, place=f"layer {name}", value=f"{wrong} instead of points")
        xyz = shapely.get_coordinates(points, include_z=True) if len(points) else np.empty((0, 3))
        crs = meta["crs"] or ""
        if len(xyz) == len(points):
            given = "Z" in kind or bool(np.isfinite(xyz[:, 2]).any())
            names += ["geometry east", "geometry north"] + ["geometry height"] * given
            cells += [[_plain(v) for v in column] for column in xyz.T[: 2 + given]]
    rows: Rows = [list(names), *([column[k] for column in cells] for k in range(len(cells[0]) if cells else 0))]
    return Sheet(path, name, rows, [0, *range(1, len(rows))], crs, unit="feature")


def _plain(value: Any) -> Cell:
    if value is None or (isinstance(value, (float, np.floating)) and np.isnan(value)):
        return ""
    return (
        float(value)
        if isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
        else str(value).strip()
    )
