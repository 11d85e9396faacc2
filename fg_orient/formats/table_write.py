"""Write tables of text and numbers; the suffix of the file name determines the format.

In CSV, a number has the fewest digits from which the same double can be read again. A
value that is not finite becomes an empty cell. If a spreadsheet would interpret a text as
a formula, an apostrophe is written before it. Our readers remove this apostrophe. The user
may let a spreadsheet split at semicolons, tabs or line breaks, too. Therefore each part of
a text is treated like this.
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
from fg_orient.model.errors import InputError

#: Type of a column's values: an array of numbers, or a sequence of texts, numbers, truth values and None.
Column = npt.NDArray[Any] | Sequence[Any]
#: Suffixes of binary tables.
BINARY: Final = (".parquet", ".feather", ".arrow")
#: Names of columns that contain text; all other columns contain numbers.
WORDS: Final = frozenset((
    "id", "role", "image", "photo", "strip", "parameter", "component", "unit", "sigma_scale", "per_line_unit", "shared",
    "quantity", "part", "test", "inseparable", "left_out_with_it",
))  # fmt: skip
#: Names of columns that contain whole numbers and may have empty cells.
WHOLE: Final = frozenset(("degree", "n_rays", "round", "dimension", "readmitted"))
#: Cells are joined with NUL between them. If the result contains one of these marks, a
#: cell may need quotes or an apostrophe.
_ODD: Final = (*',;"#\r\n\t', "\0=", "\0+", "\0@", "\0-", "\0 ", "\0'")
#: Spreadsheets interpret a text as a formula if it begins like this. Signed numbers are excluded. Blanks and quotes
#: are included, because spreadsheets remove them depending on the separator.
_BEGIN: Final = r"""[ "']*(?:[=@\t]|[+-](?![0-9.]+(?:e[+-]?[0-9]+)?\Z))"""
#: Beginnings of a text and of its parts.
_PART: Final = r"(?:\A|(?<=[;\t\r\n]))"
_FORMULA: Final = re.compile(f"{_PART}(?={_BEGIN})")
_ESCAPED: Final = re.compile(f"{_PART}'(?={_BEGIN})")


def write_table(path: Path, columns: Mapping[str, Column], comments: Sequence[str] = ()) -> None:
    """Write a table.

    Parameters
    ----------
    path : Path
    columns : mapping
        Values by the name of the column, in the order of the file; all columns have the same length.
    comments : sequence of str
        Texts of comment lines before the header.

    Raises
    ------
    ValueError
        Columns have different lengths, or a comment has several lines.
    InputError
        A text of a CSV table contains NUL, which spreadsheets remove.
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
    """Return whether the file name has a suffix of Parquet or Arrow files."""
    return path.suffix.lower() in BINARY


def require_writer(path: Path) -> None:
    """Raise InputError if the package that writes this kind of file is not installed.

    Call this before computing.
    """
    if is_binary(path):
        from fg_orient.formats.arrow import library

        library(path)


def table_file(folder: Path, table: str) -> Path:
    """Return the file of a table in a folder, in any format.

    If there is no file, return the name of a CSV file.
    """
    files = [folder / name for name in in_all_forms(table)]
    return next((file for file in files if file.is_file()), files[0])


def save_table(path: str | Path, columns: Mapping[str, Column], comments: Sequence[str] = ()) -> None:
    """Write a table completely or not at all; raise InputError if the file cannot be written."""
    with staged_file(path, suffix=Path(path).suffix, durable=True) as temporary:
        write_table(temporary, columns, comments)


def csv_table(columns: Mapping[str, Column]) -> bytes:
    """Return the text of a CSV table as :func:`write_table` writes it."""
    return b"".join(_csv(columns))


def comment_lines(comments: Sequence[str]) -> list[str]:
    """Convert comments to lines of a text file; raise ValueError if a comment has several lines."""
    if any("\n" in line or "\r" in line for line in comments):
        raise ValueError("a comment must fit one line")
    return [f"# {line}" for line in comments]


def _csv(columns: Mapping[str, Column]) -> Iterator[bytes]:
    """Yield the parts of the UTF-8 text: the header, then groups of rows."""
    yield (",".join(map(quoted, columns)) + "\n").encode()
    for start in range(0, len(next(iter(columns.values()))), ROWS):
        cells = list(_cells(columns, slice(start, start + ROWS)))
        row = b",".join([b"%b"] * len(cells)) + b"\n"  # twice as fast as joining each row
        yield b"".join(map(row.__mod__, zip(*cells, strict=True)))


def _cells(columns: Mapping[str, Column], part: slice) -> Iterator[Sequence[bytes]]:
    """Convert some rows to texts; neighbouring columns of numbers are converted together."""
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
    """Return whether all cells are floating-point numbers."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind != "O":
        return cells.dtype.kind == "f"
    return all(isinstance(cell, float) for cell in cells)


def texts(values: Column, whole: bool = False) -> list[str]:
    """Convert the values of a column of text, whole numbers or truth values to texts."""
    items = values.tolist() if isinstance(values, np.ndarray) else values
    return [item if isinstance(item, str) else _text(item, whole) for item in items]


def _text(value: Any, whole: bool = False) -> str:
    """Convert one value to text: "" for None, ``true`` or ``false`` for truth values."""
    if not isinstance(value, float):
        return "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
    return "" if not math.isfinite(value) else str(int(value)) if whole else repr(float(value))


def _quoted(cells: list[str]) -> list[bytes]:
    joined = "\0".join(cells)
    together = [] if _is_odd(joined) else joined.encode().split(b"\0")
    if joined.count("\0") >= max(len(cells), 1):
        raise InputError.of("table.nul_in_text", value=repr(next(cell for cell in cells if "\0" in cell)))
    return together or [own_cell(cell).encode() for cell in cells]


def _is_odd(cells: str) -> bool:
    """Return whether one of these cells, joined by NUL, may need quotes; 100 times faster than a pattern."""
    text = f"\0{cells}"
    return any(mark in text for mark in _ODD)


def quoted(cell: str) -> str:
    """Return a CSV cell; it is in quotes if a reader would otherwise misinterpret it."""
    return '"' + cell.replace('"', '""') + '"' if any(mark in cell for mark in ',"#\r\n') else cell


def own_cell(cell: str) -> str:
    """Return a cell of our own tables that no spreadsheet interprets as a formula.

    See :func:`cell_text`.
    """
    return quoted(_FORMULA.sub("'", cell))


def cell_text(cell: str) -> str:
    """Remove the apostrophes that :func:`own_cell` adds before formulas; quotes are not changed."""
    return _ESCAPED.sub("", cell) if "'" in cell else cell
