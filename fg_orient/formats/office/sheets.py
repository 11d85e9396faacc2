"""Sheets of any file with a table: text of any encoding and separator, workbooks, layers of geographic systems."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from fg_orient.formats.faults import Faults
from fg_orient.formats.gdal import plain_case
from fg_orient.formats.office.decisions import Assumption
from fg_orient.formats.office.numbers import is_number
from fg_orient.formats.office.workbook import Cell, Rows, read_workbook
from fg_orient.formats.text_files import read_data
from fg_orient.model.errors import InputError

#: Ends of the names of files that may hold tables.
TEXTS: Final = (".csv", ".txt", ".tsv", ".dat", ".xyz", ".asc", ".prn", ".gcp")
WORKBOOKS: Final = (".xlsx", ".xlsm", ".ods")
LAYERS: Final = (".gpkg", ".shp")
#: Largest text, bytes.
MAX_TEXT: Final = 256_000_000
#: Cells by which a separator is judged.
_LOOKED_AT: Final = 2000
#: Letters of Windows-1254 (Turkish) that are others in Windows-1252.
_TURKISH: Final = re.compile(rb"[\xd0\xdd\xde\xf0\xfd\xfe]")
_SEPARATORS: Final = {
    ";": "semicolon",
    "\t": "tab",
    "|": "bar",
    ",": "comma",
    "  ": "two blanks or more",
    " ": "blanks",
}
_CRS: Final = re.compile(r"^[#\s\"]*crs\s*[:=]\s*(EPSG:\S+?)[\s\";,]*$", re.IGNORECASE | re.MULTILINE)


@dataclass(frozen=True, eq=False)
class Sheet:
    """A table as it stands in a file.

    Parameters
    ----------
    path : Path
    name : str
        Sheet or layer; "" of a text.
    rows : list of lists of text or float
        Numbers of workbooks and layers are floats, everything else is text.
    lines : list of int
        Line or row of each row in the file, from 1.
    crs : str
        CRS that the file states as a whole; "" if it states none.
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
        """File, and sheet or layer."""
        return f"{self.path.name}, {self.name}" if self.name else self.path.name

    def place(self, k: int, header: str = "") -> str:
        """Place of row k for messages."""
        where = f"sheet {self.name}, " if self.name else ""
        return f"{where}{self.unit} {self.lines[k]}" + (f", column {header}" if header else "")


def read_sheets(path: Path) -> list[Sheet]:
    """Sheets of a file that are not empty.

    Raises
    ------
    InputError
        The file cannot be read, or holds no table.
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
        sheets = [_text(path)]
    sheets = [sheet for sheet in sheets if any(map(any, sheet.rows))]
    if not sheets:
        raise InputError.of("interchange.empty", file=path)
    return sheets


# --- text -----------------------------------------------------------------------------------------


def decoded(path: Path) -> tuple[str, str]:
    """Text of a file of unknown encoding, with LF as line end, and the name of the encoding."""
    faults = Faults(str(path))
    data = read_data(path, faults, MAX_TEXT + 1)
    faults.raise_if_any()
    assert data is not None  # else there is a fault
    if len(data) > MAX_TEXT:
        raise InputError.of("office.too_large", file=path, value=f"more than {MAX_TEXT} bytes")
    name = _encoding(data)
    try:
        text = data.decode(name)
    except UnicodeDecodeError as error:
        raise InputError.of("office.not_text", file=path, value=error.reason) from None
    odd = re.search(r"[\x00-\x08\x0e-\x1f]", text)
    if odd:
        raise InputError.of("office.not_text", file=path, place=f"line {text.count(chr(10), 0, odd.start()) + 1}",
                            value=f"character {ord(odd[0])}")  # fmt: skip
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n"), name


def _encoding(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    head = data[:4000]
    if len(head) > 3 and 4 * head.count(0) > len(head):
        return "utf-16-le" if head[1::2].count(0) > head[0::2].count(0) else "utf-16-be"
    try:
        data.decode("utf-8-sig")
        return "utf-8-sig" if data.startswith(codecs.BOM_UTF8) else "utf-8"
    except UnicodeDecodeError:
        return "cp1254" if _TURKISH.search(data) else "cp1252"


def _text(path: Path) -> Sheet:
    text, encoding = decoded(path)
    stated = _CRS.search(text)
    lines = [(n, line) for n, line in enumerate(text.split("\n"), start=1) if line.strip() and line[:1] != "#"]
    if not lines:
        raise InputError.of("interchange.empty", file=path)
    mark, rows = _split([line for _, line in lines])
    assumed = [
        Assumption(f"separator of {path.name}", _SEPARATORS[mark], "most lines then have the same number of cells")
    ]
    if encoding not in ("utf-8", "utf-8-sig") and not text.isascii():
        assumed.insert(0, Assumption(f"encoding of {path.name}", encoding, "it is not UTF-8"))
    crs = stated[1] if stated else ""
    return Sheet(path, "", rows, [n for n, _ in lines], crs, tuple(assumed))


def _split(lines: Sequence[str]) -> tuple[str, Rows]:
    """Separator by which most lines have the same number of cells, and most cells are numbers; and the cells."""
    best: tuple[float, str, Rows] = (0.0, ";", [[line.strip()] for line in lines])
    for mark in _SEPARATORS:
        rows: Rows = [_cells(line, mark) for line in lines]
        widths = Counter(len(row) for row in rows if len(row) > 1)
        if not widths:
            continue
        width, count = max(widths.items(), key=lambda item: (item[1], item[0]))
        records = (row for row in rows if len(row) == width and any(map(is_number, row)))
        cells = list(islice((cell for row in records for cell in row if cell != ""), _LOOKED_AT))
        score = count / len(lines) + sum(map(is_number, cells)) / max(len(cells), 1)
        if score > best[0] + 1e-9:  # an earlier separator is kept if both are as good
            best = (score, mark, rows)
    return best[1], best[2]


def _cells(line: str, mark: str) -> list[Cell]:
    if mark == " ":
        return list(line.split())
    if mark == "  ":
        return [*re.split(r" {2,}|\t", line.strip())]
    try:
        cells = next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
    except csv.Error:
        cells = line.split(mark)
    out = [cell.strip() for cell in cells]
    while len(out) > 1 and out[-1] == "":
        out.pop()
    return [*out]


# --- layers ---------------------------------------------------------------------------------------


def _layers(path: Path) -> list[Sheet]:
    """Layers of a GeoPackage or Shapefile: attributes, then coordinates of the points."""
    from fg_orient.formats.exchange.gis import libraries

    pyogrio, shapely = libraries(path)
    sheets = []
    try:
        with plain_case():
            for name, kind in pyogrio.list_layers(path):
                sheets.append(_layer(path, str(name), kind, pyogrio, shapely))
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, pyogrio.errors.FeatureError) as error:
        raise InputError.of("office.layer", file=path, value=str(error).split(";")[0]) from None
    return sheets


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
