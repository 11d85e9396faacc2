"""Read tables with strict checks. Cells are text until a number is read from them.

A CSV table is UTF-8 text with commas; a byte order mark is allowed. One header line names the
columns, and each further line is a record. Blank lines and lines that begin with ``#`` are
skipped. Ids remain text: ``01`` is not ``1``. The columns of Parquet and Arrow files
(``fg_orient.formats.arrow``) pass the same checks.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.formats.columns import Cells, regular
from fg_orient.formats.faults import MAX_FAULTS, Faults, did_you_mean
from fg_orient.formats.table_write import cell_text, is_binary
from fg_orient.formats.text_files import delimited, read_text
from fg_orient.model.digits import NUMBER

#: Pattern of numbers with a decimal comma.
DECIMAL_COMMA: Final = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Row:
    """One record: its line or row in the file, counted from 1, and the text of its cells by column."""

    line: int
    cells: dict[str, str]
    unit: str = "line"

    def place(self, column: str = "") -> str:
        """Return the place of this record or of one of its cells, for messages."""
        return f"{self.unit} {self.line}, column {column}" if column else f"{self.unit} {self.line}"


@dataclass(frozen=True, eq=False)
class Table:
    """Table that was read from a file; its cells are still text.

    Parameters
    ----------
    columns : tuple of str
    cells : dict of str to Cells
        Texts of the records in the order of the file, by column.
    lines : (n,) int array
        Line of each record in the file, counted from 1.
    file : str
        Name of the file in messages.
    header : str
        Place of the column names in messages.
    unit : str
        "line", or "row" if the file has no lines.
    """

    columns: tuple[str, ...]
    cells: dict[str, Cells]
    lines: npt.NDArray[np.int64]
    file: str
    header: str = "line 1"
    unit: str = "line"
    _refused: list[tuple[Index, str, str, dict[str, Any]]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.lines)

    def row(self, k: int) -> Row:
        """Return one record."""
        return Row(int(self.lines[k]), {name: self.cells[name][k] for name in self.columns}, self.unit)

    def where(self, column: str, text: str) -> Mask:
        """Return a mask (n,) of the records whose cell is equal to this text."""
        return self.cells[column].are(text)

    def numbers(self, *columns: str, rows: Mask | None = None) -> Array:
        """Return columns as finite numbers (n, k).

        If a cell is not a number, it is refused, and its value is nan. Rows that are not in ``rows`` are nan.
        """
        out = np.full((len(self), len(columns)), np.nan)
        wanted = np.ones(len(self), bool) if rows is None else rows
        for j, name in enumerate(columns):
            values = self.cells[name].finite(rows)
            if values is None:
                codes = np.array([_number_fault(cell) for cell in self.cells[name]])
                for code in sorted(set(codes[wanted].tolist()) - {""}):
                    self.refuse(
                        wanted & (codes == code), code, name, value=lambda row, name=name: repr(row.cells[name])
                    )
                values = np.array([
                    np.nan if code else float(cell) for cell, code in zip(self.cells[name], codes, strict=True)
                ])[wanted]  # fmt: skip
            out[wanted, j] = values
        return out

    def positions(self, column: str, known: Sequence[str] | None, code: str) -> Index:
        """Return the position (n,) of each cell in the list ``known``.

        Other cells get larger positions, and each of them is refused once. If ``known`` is
        None, no cell is refused.
        """
        cells, place = self.cells[column], {name: k for k, name in enumerate(known or ())}
        try:
            return cells.positions(place)
        except KeyError:
            out = np.array([place.setdefault(cell, len(place)) for cell in cells], np.intp)
        if known is not None:
            _, first, counts = np.unique(out, return_index=True, return_counts=True)
            once, times = np.zeros(len(out), bool), np.full(len(out), "", dtype=object)
            once[first] = out[first] >= len(known)
            times[first] = [f" in {n} {self.unit}s" if n > 1 else "" for n in counts.tolist()]
            self.refuse(
                once, code, column, value=lambda row: repr(row.cells[column]), times=times,
                hint=lambda row: did_you_mean(row.cells[column], list(known)),
            )  # fmt: skip
        return out

    def completed(self, *columns: str) -> Table:
        """Return the table with all these columns; missing columns get empty cells."""
        empty = Cells([""] * len(self))
        lacking = tuple(name for name in columns if name not in self.columns)
        return replace(self, columns=self.columns + lacking, cells=self.cells | dict.fromkeys(lacking, empty))

    def refuse(self, wrong: npt.ArrayLike, code: str, column: str, **fields: Any) -> None:
        """Refuse the records of a mask (n,) because of one of their cells.

        By default, the text of the cell is the value of the message. The other ``fields`` of
        the message are constants, arrays (n,), or functions of the :class:`Row`.
        """
        rows = np.flatnonzero(np.asarray(wrong, bool))
        if len(rows):
            self._refused.append((rows, code, column, {"value": lambda row: row.cells[column], **fields}))

    def refuse_repeated(self, keys: Sequence[Hashable] | Index, code: str, column: str, **fields: Any) -> None:
        """Refuse records with the key of an earlier record.

        The field ``first`` of the message names its place.
        """
        distinct = np.diff(np.sort(keys)).all() if isinstance(keys, np.ndarray) else len(set(keys)) == len(keys)
        if not distinct:
            place: dict[Hashable, int] = {}
            first = np.array([place.setdefault(key, k) for k, key in enumerate(keys)])
            places = np.array([f"{self.unit} {line}" for line in self.lines[first].tolist()])
            self.refuse(first < np.arange(len(keys)), code, column, first=places, **fields)

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
        """Raise InputError if records were refused."""
        faults = Faults(self.file)
        self.report(faults)
        faults.raise_if_any()


def number(row: Row, column: str, faults: Faults) -> float:
    """Read a cell as a finite number; if it is not a number, note the fault and return nan."""
    text = row.cells[column]
    code = _number_fault(text)
    if code:
        faults.add(code, place=row.place(column), value=repr(text))
        return float("nan")
    return float(text)


def _number_fault(text: str) -> str:
    """Return the message code for a text that is not a finite number; "" for a finite number."""
    if not text:
        return "table.cell_empty"
    if not NUMBER.fullmatch(text):
        return "table.decimal_comma" if DECIMAL_COMMA.fullmatch(text) else "table.not_a_number"
    return "table.number_too_large" if math.isinf(float(text)) else ""


# --- files ------------------------------------------------------------------------------------------

#: Maximum number of characters of a line.
MAX_LINE: Final = 100_000
#: A line that begins with another character is neither blank nor a comment.
_ODD_STARTS: Final = frozenset(("", "#", " ", "\t", ","))


def read_table(path: Path, columns: Sequence[Sequence[str]], faults: Faults) -> Table | None:
    """Read a table that has the columns of one of several layouts.

    Parameters
    ----------
    path : Path
        The file. It is read as CSV, unless its suffix is .parquet, .feather or .arrow.
    columns : sequence of sequences of str
        The allowed layouts. Each is a complete set of column names; the file may have them in any order.
    faults : Faults
        Collects the faults.

    Returns
    -------
    Table or None
        None if the file cannot be used at all. Records with a wrong number of cells are noted and left out.
    """
    extra = "leave it out" if is_binary(path) else "put remarks into lines that begin with #"

    def check(place: str, names: Sequence[str]) -> None:
        _check_names(place, names, columns, extra, faults)

    table = read_columns(path, faults, check, columns[0])
    if table is not None and not len(table) and not faults:
        faults.add("table.no_records", place=table.header)
    return table


def read_columns(
    path: Path, faults: Faults, check: Callable[[str, Sequence[str]], None], wanted: Sequence[str]
) -> Table | None:
    """Read a table whose columns pass a check.

    Parameters
    ----------
    path, faults
        See :func:`read_table`; the table may have no records.
    check : callable
        Function that checks the column names and notes faults. It is called with their place
        and the names before the records are read.
    wanted : sequence of str
        Names of the columns for the message about an empty file.

    Returns
    -------
    Table or None
        See :func:`read_table`.
    """
    if is_binary(path):
        from fg_orient.formats.arrow import HEADER, read_binary

        found = read_binary(path, faults, check)
        if found is None:
            return None
        n = len(next(iter(found.values()), ()))
        return Table(tuple(found), found, np.arange(1, n + 1), str(path), HEADER, "row")
    text = read_text(path, faults)
    if text is None:
        return None
    table = regular(text, MAX_LINE)
    if table is not None:
        del text  # the columns contain its bytes
        if _refused(table.line, table.header, check, faults):
            return None
        lines_of = table.line + 1 + np.arange(len(table.columns[0]))
        cells: dict[str, Cells] = dict(zip(table.header, table.columns, strict=True))
        return Table(tuple(cells), cells, lines_of, str(path), f"line {table.line}")
    numbers, lines = _lines(text, faults)
    headers = ((n, delimited(n, line, faults)) for n, line in zip(numbers, lines, strict=True))
    first, names = next(((n, cells) for n, cells in headers if cells is not None), (0, None))
    if names is None:
        faults.add("table.empty", place="line 1", columns=", ".join(wanted))
        return None
    if _refused(first, names, check, faults):
        return None
    start = numbers.index(first) + 1
    kept, by_column = _records(numbers[start:], lines[start:], names, faults)
    return Table(tuple(names), by_column, np.array(kept, np.int64), str(path), f"line {first}")


def _refused(
    line: int, names: Sequence[str], check: Callable[[str, Sequence[str]], None], faults: Faults
) -> bool:  # fmt: skip
    """Return whether the header of a CSV file has faults; they are noted."""
    before = len(faults.problems)
    if len(names) == 1 and any(mark in names[0] for mark in ";\t|"):
        faults.add("table.delimiter", place=f"line {line}", value=names[0])
    else:
        check(f"line {line}", names)
    return len(faults.problems) > before


def require_table(path: Path, layouts: Sequence[Sequence[str]]) -> Table:
    """Read a table as :func:`read_table` does; raise InputError with all faults."""
    faults = Faults(str(path))
    table = read_table(path, layouts, faults)
    faults.raise_if_any()
    assert table is not None  # otherwise an error was raised
    return table


def read_numbers(path: Path, layouts: Sequence[Sequence[str]], words: Sequence[str] = ()) -> tuple[Array, Table]:
    """Read the numbers of a table.

    Parameters
    ----------
    path : Path
    layouts : sequence of sequences of str
        As in :func:`read_table`.
    words : sequence of str
        Names of the columns that contain text.

    Returns
    -------
    (n, k) array
        Numbers of the other columns in the order of the layout.
    Table

    Raises
    ------
    InputError
        The file has faults; all are listed.
    """
    table = require_table(path, layouts)
    layout = next(one for one in layouts if set(one) == set(table.columns))
    values = table.numbers(*(name for name in layout if name not in words))
    table.require_valid()
    return values, table


def _lines(text: str, faults: Faults) -> tuple[list[int], list[str]]:
    """Return the numbers and texts of all lines that are neither blank nor comments."""
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
    numbers: list[int], lines: list[str], names: Sequence[str], faults: Faults
) -> tuple[list[int], dict[str, Cells]]:
    """Return the line numbers of the records, and their cells by column.

    Records with a wrong number of cells are noted and left out.
    """
    width = len(names)
    split = {n: delimited(n, line, faults, width) for n, line in zip(numbers, lines, strict=True)}
    rows = {n: list(map(cell_text, cells)) for n, cells in split.items() if cells is not None}
    return list(rows), {name: Cells([cells[k] for cells in rows.values()]) for k, name in enumerate(names)}


def _check_names(
    place: str, names: Sequence[str], layouts: Sequence[Sequence[str]], extra: str, faults: Faults
) -> None:
    """Note column names that do not fit the layouts; ``extra`` is the remedy for an unknown column."""
    note_repeated(place, names, faults)
    layout = max(layouts, key=lambda one: len(set(one) & set(names)))
    everything = sorted({name for one in layouts for name in one})
    for name in dict.fromkeys(names):
        if name and name not in everything:
            hint = f"{did_you_mean(name, everything)}; {extra}"
            faults.add("table.column_unknown", place=place, value=name, hint=hint)
        elif name and name not in layout:
            faults.add("table.column_foreign", place=place, value=name, columns=", ".join(layout))
    misspelt = [match for name in names for match in difflib.get_close_matches(name, layout, n=1)]
    for name in layout:
        if name not in names and name not in misspelt:
            faults.add(
                "table.column_missing", place=place, value=", ".join(names), missing=name, columns=", ".join(layout)
            )


def note_repeated(place: str, names: Sequence[str], faults: Faults) -> None:
    """Note each name that more than one column has."""
    for name in sorted({name for name in names if names.count(name) > 1}):
        faults.add("table.column_twice", place=place, value=name or "an unnamed column")
