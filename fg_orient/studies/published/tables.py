"""Reader of the published tables: CSV files with one number per record, listed in an index.

The index (``index.csv``) is always the index of the package. The tables may be in another folder, such as a copy with
one changed value.
"""

from __future__ import annotations

import csv
import hashlib
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fg_orient.model.errors import InputError
from fg_orient.model.names import CellKey

#: Publications whose tables are in this package.
SOURCES: Final = ("terlemezoglu2019", "topan2010", "ipbuker1994", "ayhan1996")
_HERE: Final = Path(__file__).parent
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?|nan|[+-]?inf")
#: CSV columns for the fields of a CellKey, in the order of the fields; a field without a column is empty.
_ADDRESS: Final = (
    "table",
    "eop_set_no",
    "stage",
    "pre_adjustment_type",
    "point_role",
    "quantity",
    "method",
    "parameter",
    "point_set",
)
_REQUIRED: Final = ("table", "quantity", "value", "unit")


@dataclass(frozen=True)
class PublishedCell:
    """One published number.

    Parameters
    ----------
    key : CellKey
        Address of the number.
    value : float
        The value; nan if "NaN", words or nothing is printed.
    text : str
        Printed digits of the value ("0.510"); "" if no number is printed.
    printed : str
        Complete printed text.
    unit, note : str
        Unit as printed; doubts about the number.
    """

    key: CellKey
    value: float
    text: str
    printed: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class PublishedTables:
    """Tables of one publication.

    Parameters
    ----------
    source : str
        One of ``SOURCES``.
    titles : dict
        Title of each table, in the order of the publication.
    cells : tuple of PublishedCell
    sha256 : dict
        SHA-256 of each file that was read.
    """

    source: str
    titles: dict[str, str]
    cells: tuple[PublishedCell, ...]
    sha256: dict[str, str]


def load(source: str, folder: Path | None = None) -> PublishedTables:
    """Read the tables of a publication.

    Parameters
    ----------
    source : str
        One of ``SOURCES``.
    folder : Path, optional
        Folder that contains the CSV files, or contains them in a subfolder named after the source; default: the
        package's own folder.

    Raises
    ------
    InputError
        The source is unknown, or a file is missing, damaged or incomplete; the error then names file, line and reason.
    """
    require_source(source)
    where = _HERE / source if folder is None else folder / source if (folder / source).is_dir() else folder
    if not where.is_dir():
        raise InputError.of("published.folder", file=folder, option="published")
    with (_HERE / source / "index.csv").open(encoding="utf-8", newline="") as stream:
        index = list(csv.DictReader(stream))
    places: dict[CellKey, tuple[Path, str]] = {}
    cells: list[PublishedCell] = []
    sha256: dict[str, str] = {}
    for name in dict.fromkeys(entry["file"] for entry in index):
        counts = {entry["table"]: int(entry["cells"]) for entry in index if entry["file"] == name}
        of_file, sha256[name] = _read(where / name, counts, places)
        cells += of_file
    if folder is not None:  # a copy of the tables may change values, but not addresses
        own = {cell.key for cell in load(source).cells}
        for key, (file, place) in ((key, at) for key, at in places.items() if key not in own):
            raise InputError.of("published.unknown_cell", file=file, place=place, value=f"table {key.table} {key}")
    titles = {entry["table"]: entry["title"] for entry in index}
    order = list(titles)
    return PublishedTables(source, titles, tuple(sorted(cells, key=lambda c: order.index(c.key.table))), sha256)


def require_source(source: str) -> None:
    """Refuse the name of a publication that has no tables here.

    Raises
    ------
    InputError
        The source is unknown.
    """
    if source not in SOURCES:
        raise InputError.of("published.source", place="SOURCE", value=source, known=", ".join(SOURCES))


def _read(
    path: Path, counts: dict[str, int], places: dict[CellKey, tuple[Path, str]]
) -> tuple[list[PublishedCell], str]:
    """Return the cells of a file and its SHA-256.

    Each cell must belong to a table of ``counts``; no cell may be missing or occur twice. The new cells are added to
    ``places`` (file and line of each address).
    """
    try:
        data = path.read_bytes()
        lines = csv.reader(data.decode("utf-8-sig").splitlines(), strict=True)
        header = next(lines, [])
        rows = [(f"line {lines.line_num}", [cell.strip() for cell in row]) for row in lines]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError.of("published.unreadable", file=path, value=reason) from None
    lacking = [name for name in _REQUIRED if name not in header]
    if lacking:
        raise InputError.of("published.column", file=path, place="line 1", value=", ".join(lacking))
    cells = []
    for place, row in rows:
        if len(row) != len(header):
            raise InputError.of("published.row", file=path, place=place, value=f"{len(row)} cells", count=len(header))
        cell = _cell(dict(zip(header, row, strict=True)), path, place)
        if cell.key.table not in counts:
            known = ", ".join(counts)
            raise InputError.of("published.table", file=path, place=place, value=cell.key.table, known=known)
        if cell.key in places:
            file, line = places[cell.key]
            first = f"{file.name}, {line}"
            raise InputError.of("published.twice", file=path, place=place, value=str(cell.key), first=first)
        places[cell.key] = path, place
        cells.append(cell)
    present = Counter(cell.key.table for cell in cells)
    for table, count in counts.items():
        if present[table] != count:
            value = f"{present[table]} cells"
            raise InputError.of("published.count", file=path, place=f"table {table}", value=value, count=count)
    return cells, hashlib.sha256(data).hexdigest()


def _cell(record: dict[str, str], path: Path, place: str) -> PublishedCell:
    """Return the cell of a record.

    If the file has no column "printed", the value may contain words, dates, lists and ranges.
    """
    text, printed = record["value"], record.get("printed")
    if text and not _NUMBER.fullmatch(text):
        if printed is not None:
            raise InputError.of("published.not_a_number", file=path, place=f"{place}, column value", value=repr(text))
        text = ""
    key = CellKey(*(record.get(column, "") for column in _ADDRESS))
    shown = printed or record["value"]
    return PublishedCell(key, float(text or "nan"), text, shown, record["unit"], record.get("note", ""))
