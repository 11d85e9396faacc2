"""CSV tables, read strictly.

A table is UTF-8 (a byte order mark is fine) with commas, one header line that names the
columns, and one record per line. Lines starting with ``#`` and blank lines are skipped.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.faults import Faults, did_you_mean
from fg_orient.formats.tables import Table
from fg_orient.formats.text_files import delimited, read_text

#: A longer line than this is not a record of ours.
MAX_LINE: Final = 100_000
#: Characters that ``strip`` removes from ASCII text, except line ends.
_SPACES: Final = "\t\v\f\x1c\x1d\x1e\x1f "
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
    """Line numbers and cells by column of the records; those with a wrong number of cells are left out, and noted.

    A table without quotes and with the right number of commas everywhere is split at once.
    """
    width, text = len(names), ",".join(lines)
    if '"' not in text and all(line.count(",") == width - 1 for line in lines):
        flat = text.split(",") if lines else []
        if not text.isascii() or any(space in text for space in _SPACES):
            flat = [cell.strip() for cell in flat]
        return numbers, {name: flat[k::width] for k, name in enumerate(names)}
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
