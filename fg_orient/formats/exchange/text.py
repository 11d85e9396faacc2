"""Shared parts of text formats: lines to cells, cells to numbers, numbers of bundles, output paths.

Numbers are written with the fewest digits that read back to the same double.
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
from fg_orient.formats.atomic import writing
from fg_orient.formats.columns import finite
from fg_orient.formats.faults import Faults
from fg_orient.formats.load import foreign_bytes
from fg_orient.formats.table_write import quoted
from fg_orient.formats.tables import Row, number
from fg_orient.formats.text_files import delimited, read_text, require_lines
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.limits import within_memory

Separator = Literal["comma", "blank", "either"]
#: Bytes that are unpacked at once, and memory for each of them with the numbers read from it.
_CHUNK: Final = 1 << 20
_UNPACKED: Final = 5


def cells_of(path: Path, faults: Faults, separator: Separator) -> list[tuple[int, list[str]]]:
    """Line numbers and cells of all lines that are neither blank nor begin with ``#``.

    Parameters
    ----------
    path : Path
        UTF-8 text, with or without byte order mark, any line ends.
    faults : Faults
        Collects the faults of the file; the list is then empty or lacks the faulty lines.
    separator : str
        "comma" (or semicolon or tab, if the first line contains one), "blank", or "either": commas in a line that
        contains one, else blanks.
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
    """Separator of a delimited file from one of its lines: semicolon and tab come before decimal commas."""
    return next((mark for mark in ("\t", ";") if mark in line), ",")


def read_rows(
    path: Path, faults: Faults, separator: Separator, columns: Sequence[str], counts: Sequence[int]
) -> Iterator[Row]:
    """Records of a file without header; the order of the cells is fixed.

    Parameters
    ----------
    path, faults, separator
        See :func:`cells_of`.
    columns : sequence of str
        Names of the cells, in their order.
    counts : sequence of int
        Allowed numbers of cells; other records are left out, and noted.
    """
    expected = f"{counts[0]} to {counts[-1]}" if len(counts) > 2 else " or ".join(map(str, counts))
    for n, cells in cells_of(path, faults, separator):
        if len(cells) in counts:
            yield named(n, cells, columns)
        else:
            faults.add("interchange.cell_count", place=f"line {n}", value=f"{len(cells)} cells", expected=expected)


def stated_in(path: Path, pattern: re.Pattern[str], text: str | None = None) -> str:
    """First group of the first match of a pattern in a text file, "" without a match; InputError if unreadable.

    ``text`` replaces the text of the file.
    """
    faults = Faults(str(path))
    match = pattern.search((read_text(path, faults) if text is None else text) or "")
    faults.raise_if_any()
    return match[1] if match else ""


def named(n: int, cells: Sequence[str], names: Sequence[str]) -> Row:
    """Record of cells in the order of their names; missing cells are empty."""
    padded = [*cells, *[""] * (len(names) - len(cells))]
    return Row(n, dict(zip(names, padded, strict=False)))


def numbers(row: Row, columns: Sequence[str], faults: Faults) -> tuple[float, ...]:
    """Convert cells to finite numbers; a cell that is not a number gives nan and a noted error."""
    return tuple(number(row, column, faults) for column in columns)


def sigma(row: Row, column: str, unit: str, faults: Faults) -> float:
    """Standard deviation of a cell; nan (unknown) if it is empty or 0, with the fault noted if below 0."""
    if not row.cells[column]:
        return np.nan
    value = number(row, column, faults)
    if value < 0.0:
        faults.add("interchange.sigma", place=row.place(column), value=row.cells[column], unit=unit)
    return value if value > 0.0 else np.nan


def digits(value: float) -> str:
    """Shortest text that reads back to the same double; whole numbers without ``.0``."""
    text = repr(float(value))
    return text.removesuffix(".0")


def row_of(cells: Iterable[str]) -> str:
    """Line of a file with commas; cells that a reader or a spreadsheet would misread are quoted."""
    return ",".join(map(quoted, cells))


def require_plain(names: Iterable[str], what: str, path: Path) -> None:
    """Raise InputError if a name is empty, contains blanks or commas, or begins with ``#``."""
    for name in names:
        if not name or name[:1] == "#" or any(c.isspace() or c in ',"' for c in name):
            raise InputError.of("interchange.name", file=path, place=what, value=name)


# --- files of bundle programs --------------------------------------------------------------------


class TextLines:
    """Lines of a UTF-8 file, without their ends.

    Parameters
    ----------
    path : Path
    text : str, optional
        Content of the file, if it was read before.
    latin1 : bool, optional
        Read a file that is not UTF-8 as Latin-1, with a note in ``notes``.

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
        """Numbers (from 1) and text of the lines that are neither blank nor a comment."""
        return [(n, line) for n, line in enumerate(self.lines, start=1) if line.strip() and line[0] != "#"]

    def numbers(self, rows: Sequence[tuple[int, Sequence[str]]], width: int, needed: str) -> Array:
        """Cells of lines, given with the number of each line, as finite numbers (n, width).

        Raises
        ------
        InputError
            A line has another number of cells, or a cell is not a number: names the first such line.
        """
        cells = [row for _, row in rows]
        values = finite(list(chain.from_iterable(cells))) if {*map(len, cells)} <= {width} else None
        if values is None:
            self.refuse(next(n for n, row in rows if len(row) != width or finite(row) is None), needed)
        return values.reshape(-1, width)

    def refuse(self, number: int, needed: str, value: object = None) -> NoReturn:
        """Raise InputError for a line; ``value`` replaces the text of the line in the message."""
        line = repr(self.lines[number - 1]) if number <= len(self.lines) else "the end of the file"
        raise InputError.of("interchange.cells", file=self.path.name, place=f"line {number}",
                            value=line if value is None else value, needed=needed)  # fmt: skip


def whole(cell: str) -> int | None:
    """Whole number above zero of ASCII digits alone; None for others (``int`` would accept 1_0)."""
    return int(cell) if cell.isascii() and cell.isdigit() and 0 < len(cell) < 19 and int(cell) > 0 else None


def require_once(
    values: npt.NDArray[Any] | Sequence[object], kind: str, file: str, at: Callable[[int], tuple[str, object]]
) -> None:
    """Refuse values (n,) that occur twice; ``at`` gives place and value of a row for the message.

    Texts are a list: each text of an array takes the memory of the longest one.

    Raises
    ------
    InputError
        Names the first repetition.
    """
    if not isinstance(values, np.ndarray):
        number: dict[object, int] = {}
        values = np.array([number.setdefault(value, len(number)) for value in values], np.intp)
    _, first = np.unique(values, return_index=True)
    if len(first) < len(values):
        place, value = at(int(np.setdiff1d(np.arange(len(values)), first)[0]))
        raise InputError.of("interchange.twice", file=file, place=place, value=value, kind=kind)


def positions(ids: Array, wanted: Array) -> Index:
    """Position of each wanted id (n,) among the ids (m,), -1 where it is missing."""
    if not len(ids):
        return np.full(len(wanted), -1)
    order = np.argsort(ids)
    at = order[np.minimum(np.searchsorted(ids, wanted, sorter=order), len(ids) - 1)]
    return np.where(ids[at] == wanted, at, -1)


def make_folder(folder: Path) -> None:
    """Make a folder that may exist; raise InputError if that fails."""
    with writing(folder, option=""):
        folder.mkdir(parents=True, exist_ok=True)


def read_packed(path: Path, code: str) -> bytes:
    """Return the content of a file, decompressed if its first bytes are the signature of gzip or bzip2.

    InputError with this ``code`` if it cannot be read.
    """
    if not path.is_file():
        raise InputError.of(code, file=path.name, value="no such file")
    with foreign_bytes(code, path.name), path.open("rb") as stream:
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
