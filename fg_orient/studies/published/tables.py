"""Reads the published tables: CSV files listed in an index, one number per record.

The index (``index.csv``) is always the package's own; the tables may come from another folder,
for instance a copy in which one value was changed to see what follows from it.
"""

from __future__ import annotations

import csv
import hashlib
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from fg_orient.model.cells import CellKey
from fg_orient.model.errors import InputError

#: Publications with tables in this package.
SOURCES: Final = ("terlemezoglu2019", "topan2010", "ipbuker1994", "ayhan1996")
_HERE: Final = Path(__file__).parent
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?|nan|[+-]?inf")


@dataclass(frozen=True)
class PublishedCell:
    """One published number.

    Parameters
    ----------
    key : CellKey
        Its address.
    value : float
        nan where "NaN", words or nothing is printed.
    text : str
        The value with its printed digits ("0.510"); "" where no number is printed.
    printed : str
        As printed.
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
    """The tables of one publication.

    Parameters
    ----------
    source : str
        One of ``SOURCES``.
    titles : dict
        Title of each table, in the order of the publication.
    cells : tuple of PublishedCell
    sha256 : dict
        Of each file read.
    """

    source: str
    titles: dict[str, str]
    cells: tuple[PublishedCell, ...]
    sha256: dict[str, str]


class _Entry(NamedTuple):
    """A line of the index."""

    table: str
    file: str
    kind: str
    cells: int
    title: str


class _Record(NamedTuple):
    """A record of a file: its line number and its cells by column."""

    file: str
    line: int
    of: dict[str, str]

    def number(self, column: str) -> float:
        """Read a cell as a number; nan for an empty one."""
        text = self.of[column]
        if text and not _NUMBER.fullmatch(text):
            place = f"line {self.line}, column {column}"
            raise InputError.of("published.not_a_number", file=self.file, place=place, value=repr(text))
        return float(text or "nan")


def load(source: str, folder: Path | None = None) -> PublishedTables:
    """Read the tables of a publication.

    Parameters
    ----------
    source : str
        One of ``SOURCES``.
    folder : Path, optional
        Folder with the CSV files, or with a folder of the source's name that holds them; default
        the package's own.

    Raises
    ------
    InputError
        No such source; a file is missing, damaged or incomplete: file, line and reason are named.
    """
    require_source(source)
    where = _HERE / source if folder is None else _folder_of(source, folder)
    entries = titles_and_files(source)
    titles: dict[str, str] = {}
    files: dict[str, list[_Entry]] = {}
    for entry in entries:
        titles.setdefault(entry.table, entry.title)
        files.setdefault(entry.file, []).append(entry)
    cells: list[PublishedCell] = []
    sha256: dict[str, str] = {}
    lines: dict[CellKey, str] = {}
    for name, of_file in files.items():
        records, sha256[name] = _records(where / name, _KINDS[of_file[0].kind].columns)
        cells += _cells_of(records, of_file, lines)
    if folder is not None:
        _refuse_unknown(cells, lines, source)
    order = {table: k for k, table in enumerate(titles)}
    return PublishedTables(source, titles, tuple(sorted(cells, key=lambda c: order[c.key.table])), sha256)


def require_source(source: str) -> None:
    """Refuse the name of a publication without tables here.

    Raises
    ------
    InputError
        No such source.
    """
    if source not in SOURCES:
        raise InputError.of("published.source", place="SOURCE", value=source, known=", ".join(SOURCES))


def titles_and_files(source: str) -> list[_Entry]:
    """Lines of the package's index of a source."""
    with (_HERE / source / "index.csv").open(encoding="utf-8", newline="") as stream:
        rows = csv.DictReader(stream)
        return [_Entry(r["table"], r["file"], r["kind"], int(r["cells"]), r["title"]) for r in rows]


def _folder_of(source: str, folder: Path) -> Path:
    inner = folder / source
    found = inner if inner.is_dir() else folder
    if not found.is_dir():
        raise InputError.of("published.folder", file=folder, option="published")
    return found


def _records(path: Path, columns: tuple[str, ...]) -> tuple[list[_Record], str]:
    """Records of a file with these columns, and its SHA-256."""
    try:
        data = path.read_bytes()
        lines = csv.reader(data.decode("utf-8-sig").splitlines(), strict=True)
        header = next(lines, [])
        lacking = [name for name in columns if name not in header]
        if lacking:
            raise InputError.of("published.column", file=path, place="line 1", value=", ".join(lacking))
        records = []
        for row in lines:
            if len(row) != len(header):
                place, value = f"line {lines.line_num}", f"{len(row)} cells"
                raise InputError.of("published.row", file=path, place=place, value=value, count=len(header))
            records.append(_Record(str(path), lines.line_num, dict(zip(header, map(str.strip, row), strict=True))))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError.of("published.unreadable", file=path, value=reason) from None
    return records, hashlib.sha256(data).hexdigest()


def _cells_of(records: list[_Record], entries: list[_Entry], seen: dict[CellKey, str]) -> list[PublishedCell]:
    """Cells of one file. Each must belong to a known table; none may occur twice or be missing."""
    wanted = {entry.table: entry.cells for entry in entries}
    read = _KINDS[entries[0].kind].read
    out = []
    for record in records:
        cell = read(record, entries[0].table)
        file, place, table = record.file, f"line {record.line}", cell.key.table
        if table not in wanted:
            raise InputError.of("published.table", file=file, place=place, value=table, known=", ".join(wanted))
        if cell.key in seen:
            raise InputError.of("published.twice", file=file, place=place, value=str(cell.key), first=seen[cell.key])
        seen[cell.key] = f"{Path(file).name}, {place}"
        out.append(cell)
    counts = Counter(cell.key.table for cell in out)
    for table, count in wanted.items():
        if counts[table] != count:
            file, value = records[0].file if records else entries[0].file, f"{counts[table]} cells"
            raise InputError.of("published.count", file=file, place=f"table {table}", value=value, count=count)
    return out


def _refuse_unknown(cells: list[PublishedCell], lines: dict[CellKey, str], source: str) -> None:
    """Refuse addresses that the package's own tables do not have: only values of a copy may be altered."""
    own = {cell.key for cell in load(source).cells}
    for cell in cells:
        if cell.key not in own:
            file, _, place = lines[cell.key].partition(", ")
            value = f"table {cell.key.table} {cell.key}"
            raise InputError.of("published.unknown_cell", file=file, place=place, value=value)


# --- kinds of files ------------------------------------------------------------------------------


class _Kind(NamedTuple):
    """Columns that a kind of file must have, and the reader of a record."""

    columns: tuple[str, ...]
    read: Callable[[_Record, str], PublishedCell]


def _reader(
    address: Callable[[dict[str, str], str], CellKey], value: str = "value", printed: str = "", unit: str = "",
    *, words: bool = False,
) -> Callable[[_Record, str], PublishedCell]:  # fmt: skip
    """Reader of a record.

    Parameters
    ----------
    address : callable
        Gives the address of the cell from the record's cells and the table.
    value, printed : str
        Columns of the value and of the print; without ``printed`` the value is as printed.
    unit : str
        Unit of all numbers; without it that of the column "unit".
    words : bool
        Words, dates, lists and ranges have the value nan and no text; else they are refused.
    """

    def read(record: _Record, table: str) -> PublishedCell:
        of = record.of
        text = "" if words and not _NUMBER.fullmatch(of[value]) else of[value]
        number = float(text or "nan") if words else record.number(value)
        shown = of[printed or value] or text
        return PublishedCell(address(of, table), number, text, shown, unit or of["unit"], of.get("note", ""))

    return read


def _count_key(of: dict[str, str], table: str) -> CellKey:
    number = re.search(r"eop_set_no=(\d+)", of["inputs"])
    return CellKey(f"eq{of['equation']}", number.group(1) if number else "", of["stage"], quantity=of["quantity"])


def _polynomial(record: _Record, table: str) -> PublishedCell:
    """Degree of the polynomial of one EOP component."""
    of = record.of
    key = CellKey(of["table"], quantity="degree", parameter=of["component"])
    degree = max(k for k in range(3) if k == 0 or of[f"c{k}"])
    return PublishedCell(key, float(degree), str(degree), of["polynomial"], "1", of["note"])


_KINDS: Final[dict[str, _Kind]] = {
    "cells": _Kind(
        ("table", "eop_set_no", "stage", "pre_adjustment_type", "point_role", "quantity", "method", "value", "unit",
         "note", "printed"),
        _reader(lambda of, _: CellKey(
            of["table"], of["eop_set_no"], of["stage"], of["pre_adjustment_type"], of["point_role"], of["quantity"],
            of["method"], of.get("parameter", ""), of.get("point_set", ""),
        ), printed="printed"),
    ),
    # of a rational function model the degree is the stage, an image axis a parameter
    "rfm_cells": _Kind(
        ("table", "quantity", "unit", "method", "value", "note", "rfm_degree", "normalised", "printed"),
        _reader(lambda of, _: CellKey(
            of["table"], stage=f"rfm degree {of['rfm_degree']}", quantity=of["quantity"], method=of["method"],
            parameter=of.get("parameter") or of.get("image_axis", ""),
        ), printed="printed"),
    ),
    "polynomials": _Kind(("table", "component", "c0", "c1", "c2", "polynomial", "note"), _polynomial),
    "eop_sets": _Kind(
        ("table", "eop_set_no", "u"),
        _reader(lambda of, _: CellKey(of["table"], of["eop_set_no"], quantity="n_unknowns"), "u", unit="1"),
    ),
    # place of a coefficient in its set, from 1
    "eop_members": _Kind(
        ("table", "eop_set_no", "order", "parameter"),
        _reader(lambda of, _: CellKey(of["table"], of["eop_set_no"], quantity="order", parameter=of["parameter"]),
                "order", "parameter", "1"),
    ),
    "counts": _Kind(
        ("equation", "stage", "quantity", "inputs", "value_printed"), _reader(_count_key, "value_printed", unit="1"),
    ),
    "correlations": _Kind(
        ("section", "eop_set_no", "stage", "quantity", "parameter_1", "parameter_2", "value"),
        _reader(lambda of, _: CellKey(
            f"s{of['section']}", of["eop_set_no"], of["stage"], quantity=of["quantity"],
            parameter=f"{of['parameter_1']} {of['parameter_2']}",
        ), unit="1"),
    ),
    "entries": _Kind(
        ("table", "row", "quantity", "value", "unit", "note"),
        _reader(lambda of, _: CellKey(of["table"], quantity=of["quantity"], parameter=of["row"]), words=True),
    ),
    "facts": _Kind(
        ("key", "value", "unit", "note"),
        _reader(lambda of, table: CellKey(table, quantity=of["key"]), words=True),
    ),
}  # fmt: skip
