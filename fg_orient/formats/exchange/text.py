"""Common functions of text formats: split lines into cells, read numbers, and prepare output files.

Numbers are written with the fewest digits from which the same double can be read again.
"""

from __future__ import annotations

import bz2
import gzip
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Final, Literal, NoReturn

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.formats.columns import finite
from fg_orient.formats.faults import Faults
from fg_orient.formats.load import foreign_bytes
from fg_orient.formats.table_write import quoted
from fg_orient.formats.tables import Row, number
from fg_orient.formats.text_files import delimited, read_text, require_lines
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.limits import open_input, within_memory

Separator = Literal["comma", "blank", "either"]
#: Number of bytes that are unpacked together.
_CHUNK: Final = 1 << 20
#: Memory for each byte and the numbers that are read from it, bytes.
_UNPACKED: Final = 5


def cells_of(path: Path, faults: Faults, separator: Separator) -> list[tuple[int, list[str]]]:
    """Return the line numbers and cells of all lines that are not blank and do not begin with ``#``.

    Parameters
    ----------
    path : Path
        UTF-8 text with any line ends; a byte order mark is allowed.
    faults : Faults
        Collects the faults of the file. Faulty lines are not returned.
    separator : str
        "comma", "blank" or "either". With "comma", semicolon or tab are the separator if
        the first line contains one. With "either", commas separate the cells of a line
        that contains a comma; blanks separate the cells of others.
    """
    text = read_text(path, faults)
    if text is None:
        return []
    kept = [(n, line) for n, line in enumerate(text.split("\n"), start=1) if line.strip() and line[:1] != "#"]
    mark = separator_of(kept[0][1]) if kept else ","
    out = []
    for n, line in kept:
        if separator == "blank" or (separator == "either" and "," not in line):
            out.append((n, line.split()))
        else:
            cells = delimited(n, line, faults, mark=mark if separator == "comma" else ",")
            out += [] if cells is None else [(n, cells)]
    return out


def separator_of(line: str) -> str:
    """Find the separator of a file in one of its lines.

    Semicolon and tab have priority, as a comma may be decimal.
    """
    return next((mark for mark in ("\t", ";") if mark in line), ",")


def read_rows(
    path: Path, faults: Faults, separator: Separator, columns: Sequence[str], counts: Sequence[int]
) -> Iterator[Row]:
    """Read the records of a file without header; the order of the cells is fixed.

    Parameters
    ----------
    path, faults, separator
        See :func:`cells_of`.
    columns : sequence of str
        Names of the cells in their order.
    counts : sequence of int
        Allowed numbers of cells. Other records are noted and left out.
    """
    expected = f"{counts[0]} to {counts[-1]}" if len(counts) > 2 else " or ".join(map(str, counts))
    for n, cells in cells_of(path, faults, separator):
        if len(cells) in counts:
            yield named(n, cells, columns)
        else:
            faults.add("interchange.cell_count", place=f"line {n}", value=f"{len(cells)} cells", expected=expected)


def stated_in(path: Path, pattern: re.Pattern[str], text: str | None = None) -> str:
    """Search a text file for a pattern and return the first group of the first match; "" if there is no match.

    If ``text`` is given, it is searched instead of the file. InputError: the file cannot be read.
    """
    faults = Faults(str(path))
    match = pattern.search((read_text(path, faults) if text is None else text) or "")
    faults.raise_if_any()
    return match[1] if match else ""


def named(n: int, cells: Sequence[str], names: Sequence[str]) -> Row:
    """Make a record from cells in the order of their names; missing cells are empty."""
    padded = [*cells, *[""] * (len(names) - len(cells))]
    return Row(n, dict(zip(names, padded, strict=False)))


def numbers(row: Row, columns: Sequence[str], faults: Faults) -> tuple[float, ...]:
    """Convert cells to finite numbers; if a cell is not a number, note the fault and give nan."""
    return tuple(number(row, column, faults) for column in columns)


def sigma(row: Row, column: str, unit: str, faults: Faults) -> float:
    """Read a standard deviation.

    An empty cell or 0 gives nan (unknown). A negative value is noted as a fault.
    """
    if not row.cells[column]:
        return np.nan
    value = number(row, column, faults)
    if value < 0.0:
        faults.add("interchange.sigma", place=row.place(column), value=row.cells[column], unit=unit)
    return value if value > 0.0 else np.nan


def digits(value: float) -> str:
    """Return the shortest text from which the same double can be read.

    Whole numbers have no ``.0``.
    """
    text = repr(float(value))
    return text.removesuffix(".0")


def row_of(cells: Iterable[str]) -> str:
    """Join cells with commas; quote cells that a reader or a spreadsheet would misinterpret."""
    return ",".join(map(quoted, cells))


def require_plain(names: Iterable[str], what: str, path: Path) -> None:
    """Raise InputError if a name is empty, contains a blank or a comma, or begins with ``#``."""
    for name in names:
        if not name or name[:1] == "#" or any(c.isspace() or c in ',"' for c in name):
            raise InputError.of("interchange.name", file=path, place=what, value=name)


# --- files of bundle programs --------------------------------------------------------------------


class TextLines:
    """Lines of a UTF-8 file without their line ends.

    Parameters
    ----------
    path : Path
    text : str, optional
        Content of the file, if it has already been read.
    latin1 : bool, optional
        If the file is not UTF-8, read it as Latin-1 and add a note to ``notes``.

    Raises
    ------
    InputError
        The file does not exist, cannot be read, or is not text.
    """

    def __init__(self, path: Path, text: str | None = None, *, latin1: bool = False) -> None:
        faults = Faults(path.name)
        text = read_text(path, faults) if text is None else text
        self.notes: tuple[Finding, ...] = ()
        if latin1 and faults.codes == {"table.not_utf8"}:
            self.notes = (finding("points.latin1", file=path.name, place=faults.problems[0].place),)
            text = path.read_text("latin-1")
        else:
            faults.raise_if_any()
        text = text or ""
        require_lines(text, path.name)
        self.path, self.lines = path, text.split("\n")

    def content(self) -> list[tuple[int, str]]:
        """Return numbers (from 1) and texts of all lines that are neither blank nor comments."""
        return [(n, line) for n, line in enumerate(self.lines, start=1) if line.strip() and line[0] != "#"]

    def numbers(self, rows: Sequence[tuple[int, Sequence[str]]], width: int, needed: str) -> Array:
        """Convert the cells of numbered lines to finite numbers (n, width).

        Raises
        ------
        InputError
            A line has another number of cells, or a cell is not a number. The message
            names the first such line.
        """
        cells = [row for _, row in rows]
        values = finite(list(chain.from_iterable(cells))) if {*map(len, cells)} <= {width} else None
        if values is None:
            self.refuse(next(n for n, row in rows if len(row) != width or finite(row) is None), needed)
        return values.reshape(-1, width)

    def refuse(self, number: int, needed: str, value: object = None) -> NoReturn:
        """Raise InputError for a line; the message shows ``value``, or the text of the line."""
        line = repr(self.lines[number - 1]) if number <= len(self.lines) else "the end of the file"
        raise InputError.of("interchange.cells", file=self.path.name, place=f"line {number}",
                            value=line if value is None else value, needed=needed)  # fmt: skip


def whole(cell: str) -> int | None:
    """Read a whole number above zero that consists of ASCII digits; else None (``int`` would also accept 1_0)."""
    return int(cell) if cell.isascii() and cell.isdigit() and 0 < len(cell) < 19 and int(cell) > 0 else None


def require_once(
    values: npt.NDArray[Any] | Sequence[object], kind: str, file: str, at: Callable[[int], tuple[str, object]]
) -> None:
    """Refuse values (n,) that occur twice; ``at`` returns place and value of a row for the message.

    Texts must be given as a list: in an array, each text needs as much memory as the longest text.

    Raises
    ------
    InputError
        A value occurs twice; the message names the first repetition.
    """
    if not isinstance(values, np.ndarray):
        number: dict[object, int] = {}
        values = np.array([number.setdefault(value, len(number)) for value in values], np.intp)
    _, first = np.unique(values, return_index=True)
    if len(first) < len(values):
        place, value = at(int(np.setdiff1d(np.arange(len(values)), first)[0]))
        raise InputError.of("interchange.twice", file=file, place=place, value=value, kind=kind)


def positions(ids: Array, wanted: Array) -> Index:
    """Return the position of each wanted id (n,) among the ids (m,); -1 if it is missing."""
    if not len(ids):
        return np.full(len(wanted), -1)
    order = np.argsort(ids)
    at = order[np.minimum(np.searchsorted(ids, wanted, sorter=order), len(ids) - 1)]
    return np.where(ids[at] == wanted, at, -1)


def read_packed(path: Path, code: str) -> bytes:
    """Return the content of a file; decompress it if it begins with the signature of gzip or bzip2.

    InputError with this ``code``: the file cannot be read.
    """
    if not path.is_file():
        raise InputError.of(code, file=path.name, value="no such file")
    with foreign_bytes(code, path.name), open_input(path) as stream:
        head, size = stream.read(3), path.stat().st_size
        stream.seek(0)
        if head[:2] != b"\x1f\x8b" and head != b"BZh":
            return stream.read()
        parts, total = [], 0
        with (bz2.open if head == b"BZh" else gzip.open)(stream, "rb") as packed:
            while data := packed.read(_CHUNK):
                total += len(data)
                within_memory(_UNPACKED * total, size, file=path.name)
                parts.append(data)
        return b"".join(parts)
