"""CSV tables, read strictly: every cell is text until a number is read from it.

A table is UTF-8 (a byte order mark is fine) with commas, one header line that names the columns, and one record per
line. Lines starting with ``#`` and blank lines are skipped. Ids stay text: ``01`` is not ``1``.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from itertools import compress
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.formats.columns import OF_NUMBERS, Cells, regular
from fg_orient.formats.faults import MAX_FAULTS, Faults, did_you_mean
from fg_orient.formats.text_files import delimited, read_text

#: Texts that are read as numbers, and numbers with a decimal comma.
NUMBER: Final = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
DECIMAL_COMMA: Final = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Row:
    """One record: its line number in the file (1-based) and the text of its cells by column."""

    line: int
    cells: dict[str, str]

    def place(self, column: str = "") -> str:
        """Place of this record, or of one of its cells, for messages."""
        return f"line {self.line}, column {column}" if column else f"line {self.line}"


@dataclass(frozen=True, eq=False)
class Table:
    """A table as read.

    Parameters
    ----------
    columns : tuple of str
    cells : dict of str to sequence of str
        Text of the records in file order, by column.
    lines : (n,) int array
        Line number of each record in the file, from 1.
    file : str
        Name of the file, for messages.
    """

    columns: tuple[str, ...]
    cells: dict[str, Sequence[str]]
    lines: npt.NDArray[np.int64]
    file: str
    _refused: list[tuple[Index, str, str, dict[str, Any]]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.lines)

    def row(self, k: int) -> Row:
        """One record."""
        return Row(int(self.lines[k]), {name: self.cells[name][k] for name in self.columns})

    def where(self, column: str, text: str) -> Mask:
        """Records (n,) whose cell is this text."""
        cells = self.cells[column]
        if isinstance(cells, Cells):
            return cells.are(text)
        return np.fromiter((cell == text for cell in cells), bool, len(self))

    def numbers(self, *columns: str, rows: Mask | None = None) -> Array:
        """Columns as finite numbers (n, k); nan where a cell, then refused, is not a number, and in other ``rows``."""
        out = np.full((len(self), len(columns)), np.nan)
        wanted = np.ones(len(self), bool) if rows is None else rows
        for j, name in enumerate(columns):
            of_column = self.cells[name]
            values = of_column.finite(rows) if isinstance(of_column, Cells) else None
            if values is None:
                cells = of_column if rows is None else list(compress(of_column, rows.tolist()))
                values = finite(cells)
            if values is None:
                codes = np.array([_number_fault(cell) for cell in self.cells[name]])
                for code in sorted(set(codes[wanted].tolist()) - {""}):
                    self.refuse(
                        wanted & (codes == code), code, name, value=lambda row, name=name: repr(row.cells[name])
                    )
                values = np.array([np.nan if _number_fault(cell) else float(cell) for cell in cells])
            out[wanted, j] = values
        return out

    def positions(self, column: str, known: Sequence[str] | None, code: str) -> Index:
        """Position (n,) of each cell in ``known``; other cells get positions beyond it, and are refused.

        Nothing is refused if ``known`` is None.
        """
        cells, place = self.cells[column], {name: k for k, name in enumerate(known or ())}
        try:
            return np.fromiter(map(place.__getitem__, cells), np.intp, len(cells))
        except KeyError:
            out = np.array([place.setdefault(cell, len(place)) for cell in cells], np.intp)
        if known is not None:
            self.refuse(
                out >= len(known), code, column, value=lambda row: repr(row.cells[column]),
                hint=lambda row: did_you_mean(row.cells[column], list(known)),
            )  # fmt: skip
        return out

    def refuse(self, wrong: npt.ArrayLike, code: str, column: str, **fields: Any) -> None:
        """Refuse records (n,) for the text of a cell, which is the value of the message by default.

        ``fields`` of the message are constants, arrays (n,), or functions of the :class:`Row`.
        """
        rows = np.flatnonzero(np.asarray(wrong, bool))
        if len(rows):
            self._refused.append((rows, code, column, {"value": lambda row: row.cells[column], **fields}))

    def refuse_repeated(self, keys: Sequence[Hashable] | Index, code: str, column: str, **fields: Any) -> None:
        """Refuse records whose key an earlier record has; field ``first`` is the line of that record."""
        distinct = np.diff(np.sort(keys)).all() if isinstance(keys, np.ndarray) else len(set(keys)) == len(keys)
        if not distinct:
            place: dict[Hashable, int] = {}
            first = np.array([place.setdefault(key, k) for k, key in enumerate(keys)])
            self.refuse(first < np.arange(len(keys)), code, column, first=self.lines[first], **fields)

    def report(self, faults: Faults) -> None:
        """Note the refused records in the order of their lines."""
        for k, n in sorted((k, n) for n, (rows, *_) in enumerate(self._refused) for k in rows[:MAX_FAULTS].tolist()):
            (_, code, column, fields), row = self._refused[n], self.row(k)
            made = {
                name: value(row) if callable(value) else value[k] if isinstance(value, np.ndarray) else value
                for name, value in fields.items()
            }
            faults.add(code, place=row.place(column), **made)
        for rows, code, *_ in self._refused:
            faults.count(code, max(0, len(rows) - MAX_FAULTS))
        self._refused.clear()

    def require_valid(self) -> None:
        """Raise InputError with the refused records, if there are any."""
        faults = Faults(self.file)
        self.report(faults)
        faults.raise_if_any()


def number(row: Row, column: str, faults: Faults) -> float:
    """Read a cell as a finite number; nan, with the fault noted, if it is not a number."""
    text = row.cells[column]
    code = _number_fault(text)
    if code:
        faults.add(code, place=row.place(column), value=repr(text))
        return float("nan")
    return float(text)


def _number_fault(text: str) -> str:
    """Message code of a text that is not a finite number, "" if it is one."""
    if not text:
        return "table.cell_empty"
    if not NUMBER.fullmatch(text):
        return "table.decimal_comma" if DECIMAL_COMMA.fullmatch(text) else "table.not_a_number"
    return "table.number_too_large" if math.isinf(float(text)) else ""


def finite(cells: Sequence[str]) -> Array | None:
    """All texts as finite numbers (n,); None if one is not a number."""
    if "".join(cells).encode().translate(None, OF_NUMBERS):
        return None
    try:
        values = np.fromiter(map(float, cells), np.float64, len(cells))
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


# --- files ------------------------------------------------------------------------------------------

#: A longer line than this is not a record of ours.
MAX_LINE: Final = 100_000
#: Lines that start otherwise are neither blank nor a comment.
_ODD_STARTS: Final = frozenset(("", "#", " ", "\t", ","))


def read_table(path: Path, columns: Sequence[Sequence[str]], faults: Faults) -> Table | None:
    """Read a CSV file that has the columns of one of several layouts.

    Parameters
    ----------
    path : Path
        The file.
    columns : sequence of sequences of str
        The allowed layouts, each a complete set of column names; their order in the file is free.
    faults : Faults
        Receives the faults.

    Returns
    -------
    Table or None
        None if the file as a whole is unusable. Records with a wrong number of cells are left out, and noted.
    """
    text = read_text(path, faults)
    if text is None:
        return None
    table = regular(text, MAX_LINE)
    if table is not None:
        names = _header(table.line, table.header, columns, faults)
        if names is None:
            return None
        lines_of = table.line + 1 + np.arange(len(table.columns[0]))
        return Table(names, dict(zip(names, table.columns, strict=True)), lines_of, str(path))
    numbers, lines = _lines(text, faults)
    headers = ((n, delimited(n, line, faults)) for n, line in zip(numbers, lines, strict=True))
    first, cells = next(((n, cells) for n, cells in headers if cells is not None), (0, None))
    if cells is None:
        faults.add("table.empty", place="line 1", columns=", ".join(columns[0]))
        return None
    names = _header(first, cells, columns, faults)
    if names is None:
        return None
    start = numbers.index(first) + 1
    kept, by_column = _records(numbers[start:], lines[start:], names, faults)
    if not kept and not faults:
        faults.add("table.no_records", place=f"line {first}")
    return Table(names, by_column, np.array(kept, np.int64), str(path))


def require_table(path: Path, layouts: Sequence[Sequence[str]]) -> Table:
    """Read a CSV file as :func:`read_table` does; InputError with its faults if it is unusable."""
    faults = Faults(str(path))
    table = read_table(path, layouts, faults)
    faults.raise_if_any()
    assert table is not None  # else there is a fault
    return table


def read_numbers(path: Path, layouts: Sequence[Sequence[str]], words: Sequence[str] = ()) -> tuple[Array, Table]:
    """Read numbers of a CSV file.

    Parameters
    ----------
    path : Path
    layouts : sequence of sequences of str
        As in :func:`read_table`.
    words : sequence of str
        Columns of text.

    Returns
    -------
    (n, k) array
        The other columns in the order of the layout.
    Table

    Raises
    ------
    InputError
        All faults of the file.
    """
    table = require_table(path, layouts)
    layout = next(one for one in layouts if set(one) == set(table.columns))
    values = table.numbers(*(name for name in layout if name not in words))
    table.require_valid()
    return values, table


def _lines(text: str, faults: Faults) -> tuple[list[int], list[str]]:
    """Numbers and text of the lines that are neither blank nor a comment."""
    lines = text.split("\n")
    kept = [
        n for n, line in enumerate(lines, start=1)
        if line[:1] not in _ODD_STARTS or (not line.startswith("#") and line.strip(" \t,"))
    ]  # fmt: skip
    long = [n for n in kept if len(lines[n - 1]) > MAX_LINE]
    for n in long:
        faults.add("table.long_line", place=f"line {n}", value=f"{len(lines[n - 1])} characters", limit=MAX_LINE)
    if long:
        kept = sorted(set(kept) - set(long))
    return kept, [lines[n - 1] for n in kept]


def _records(
    numbers: list[int], lines: list[str], names: tuple[str, ...], faults: Faults
) -> tuple[list[int], dict[str, Sequence[str]]]:
    """Line numbers and cells by column of the records; those with a wrong number of cells are left out, and noted."""
    width = len(names)
    split = {n: delimited(n, line, faults, width) for n, line in zip(numbers, lines, strict=True)}
    rows = {n: cells for n, cells in split.items() if cells is not None}
    return list(rows), {name: [cells[k] for cells in rows.values()] for k, name in enumerate(names)}


def _header(line: int, cells: list[str], layouts: Sequence[Sequence[str]], faults: Faults) -> tuple[str, ...] | None:
    """Column names, checked against the layouts; None if they fit none of them."""
    place = f"line {line}"
    if len(cells) == 1 and any(mark in cells[0] for mark in ";\t|"):
        faults.add("table.delimiter", place=place, value=cells[0])
        return None
    before = len(faults.problems)
    for name in sorted({name for name in cells if cells.count(name) > 1}):
        faults.add("table.column_twice", place=place, value=name or "an unnamed column")
    layout = max(layouts, key=lambda one: len(set(one) & set(cells)))
    everything = sorted({name for one in layouts for name in one})
    for name in dict.fromkeys(cells):
        if name and name not in everything:
            faults.add("table.column_unknown", place=place, value=name, hint=did_you_mean(name, everything))
        elif name and name not in layout:
            faults.add("table.column_foreign", place=place, value=name, columns=", ".join(layout))
    misspelt = [match for name in cells for match in difflib.get_close_matches(name, layout, n=1)]
    for name in layout:
        if name not in cells and name not in misspelt:
            faults.add("table.column_missing", place=place, value=name, columns=", ".join(layout))
    return None if len(faults.problems) > before else tuple(cells)
