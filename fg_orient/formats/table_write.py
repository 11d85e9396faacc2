"""The writer of tables: columns of text and numbers to the form of the end of the file name.

In CSV, numbers have the fewest digits that read back to the same double. A value that is not finite is an empty cell.
Texts that a spreadsheet would interpret as a formula begin with an apostrophe, which our readers remove.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.formats.atomic import in_all_forms, staged_file
from fg_orient.formats.columns import ROWS, rows_of_numbers

#: Values of a column: an array of numbers, or a sequence of text, numbers, truth values and None.
Column = npt.NDArray[Any] | Sequence[Any]
#: Ends of the names of binary files.
BINARY: Final = (".parquet", ".feather", ".arrow")
#: Columns of text; all others contain numbers.
WORDS: Final = frozenset((
    "id", "role", "image", "photo", "strip", "parameter", "component", "unit", "sigma_scale", "per_line_unit", "shared",
    "quantity", "part", "test", "inseparable", "left_out_with_it",
))  # fmt: skip
#: Columns of whole numbers, with empty cells.
WHOLE: Final = frozenset(("degree", "n_rays", "round", "dimension", "readmitted"))
#: Marks of cells, each after a NUL, that may need quotes or an apostrophe.
_ODD: Final = (*',"#\r\n', "\0=", "\0+", "\0@", "\0-", "\0\t", "\0'")
#: Begin of a text that spreadsheets interpret as a formula, after any apostrophes; not of signed numbers.
_FORMULA: Final = re.compile(r"'*(?:[=@\t]|[+-](?![0-9.]+(?:e[+-]?[0-9]+)?\Z))")


def write_table(path: Path, columns: Mapping[str, Column], comments: Sequence[str] = ()) -> None:
    """Write a table.

    Parameters
    ----------
    path : Path
    columns : mapping
        Name to values, in the order of the file, all of one length.
    comments : sequence of str
        Lines before the header, after ``#``.

    Raises
    ------
    ValueError
        Columns of different lengths, or a comment of several lines.
    """
    if len(set(map(len, columns.values()))) > 1:
        raise ValueError("the columns have different lengths")
    if is_binary(path):
        from fg_orient.formats.arrow import write_binary

        write_binary(path, columns, comments)
        return
    head = "".join(f"{line}\n" for line in comment_lines(comments))
    with path.open("wb") as stream:
        stream.write(head.encode())
        stream.writelines(_csv(columns))


def is_binary(path: Path) -> bool:
    """Return whether the file name has the suffix of Parquet or Arrow files."""
    return path.suffix.lower() in BINARY


def require_writer(path: Path) -> None:
    """Raise InputError if the package that writes files with this name is not installed; call it before computing."""
    if is_binary(path):
        from fg_orient.formats.arrow import library

        library(path)


def table_file(folder: Path, table: str) -> Path:
    """Return the file of a table in a folder, in any form; the CSV file if there is no file."""
    files = [folder / name for name in in_all_forms(table)]
    return next((file for file in files if file.is_file()), files[0])


def save_table(path: str | Path, columns: Mapping[str, Column], comments: Sequence[str] = ()) -> None:
    """Write a table as :func:`write_table` does, whole or not at all; InputError if the file cannot be written."""
    with staged_file(path, suffix=Path(path).suffix, durable=True) as temporary:
        write_table(temporary, columns, comments)


def csv_table(columns: Mapping[str, Column]) -> bytes:
    """Text of a CSV table as :func:`write_table` writes it."""
    return b"".join(_csv(columns))


def comment_lines(comments: Sequence[str]) -> list[str]:
    """Comments as lines of a text file; ValueError for a comment of several lines."""
    if any("\n" in line or "\r" in line for line in comments):
        raise ValueError("a comment must fit one line")
    return [f"# {line}" for line in comments]


def _csv(columns: Mapping[str, Column]) -> Iterator[bytes]:
    """Parts of the UTF-8 text: header and rows."""
    yield (",".join(map(quoted, columns)) + "\n").encode()
    for start in range(0, len(next(iter(columns.values()))), ROWS):
        cells = list(_cells(columns, slice(start, start + ROWS)))
        row = b",".join([b"%b"] * len(cells)) + b"\n"  # in less than half of the time of a join of each row
        yield b"".join(map(row.__mod__, zip(*cells, strict=True)))


def _cells(columns: Mapping[str, Column], part: slice) -> Iterator[Sequence[bytes]]:
    """Texts of some rows: of each column, or of neighbouring columns of numbers together."""
    run = list[Array]()
    for name, values in columns.items():
        cells = values[part]
        if name not in WHOLE and are_numbers(cells):
            run.append(np.asarray(cells, np.float64))
            continue
        if run:
            yield rows_of_numbers(np.stack(run, axis=1))
            run = []
        yield _quoted(texts(cells, name in WHOLE))
    if run:
        yield rows_of_numbers(np.stack(run, axis=1))


def are_numbers(cells: Column) -> bool:
    """Whether all cells are floating-point numbers."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind != "O":
        return cells.dtype.kind == "f"
    return all(isinstance(cell, float) for cell in cells)


def texts(values: Column, whole: bool = False) -> list[str]:
    """Texts of the values of a column of text, whole numbers or truth values."""
    items = values.tolist() if isinstance(values, np.ndarray) else values
    return [item if isinstance(item, str) else _text(item, whole) for item in items]


def _text(value: Any, whole: bool = False) -> str:
    """Return the text of one value; empty for None, words of JSON for truth values."""
    if not isinstance(value, float):
        return "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
    return "" if not math.isfinite(value) else str(int(value)) if whole else repr(float(value))


def _quoted(cells: list[str]) -> list[bytes]:
    joined = "\0".join(cells)
    together = [] if _is_odd(joined) else joined.encode().split(b"\0")
    return together if len(together) == len(cells) else [own_cell(cell).encode() for cell in cells]


def _is_odd(cells: str) -> bool:
    """Whether one of these cells, with a NUL between them, may need quotes; a hundredth of the time of a pattern."""
    text = f"\0{cells}"
    return any(mark in text for mark in _ODD)


def quoted(cell: str) -> str:
    """Text of a cell of CSV; in quotes if a reader would misinterpret it."""
    return '"' + cell.replace('"', '""') + '"' if any(mark in cell for mark in ',"#\r\n') else cell


def own_cell(cell: str) -> str:
    """Text of a cell of our own tables, which no spreadsheet takes for a formula; see :func:`cell_text`."""
    return quoted(f"'{cell}" if _FORMULA.match(cell) else cell)


def cell_text(cell: str) -> str:
    """Inverse of :func:`own_cell`, quotes aside: the text without the apostrophe before what looks like a formula."""
    return cell[1:] if cell[:1] == "'" and _FORMULA.match(cell, 1) else cell
