"""Read the text of a table with unknown encoding and separator."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Final

from fg_orient.formats.faults import Faults
from fg_orient.formats.office.decisions import Assumption
from fg_orient.formats.office.numbers import is_number
from fg_orient.formats.office.workbook import Cell, Rows
from fg_orient.formats.table_write import cell_text
from fg_orient.formats.text_files import read_data
from fg_orient.model.errors import InputError

#: Maximum size of a text file, bytes.
MAX_TEXT: Final = 256_000_000
#: Number of cells that are examined to choose a separator.
_LOOKED_AT: Final = 2000
#: Bytes of Turkish letters in Windows-1254; they are other letters in Windows-1252.
_TURKISH: Final = re.compile(rb"[\xd0\xdd\xde\xf0\xfd\xfe]")
_SEPARATORS: Final = {
    ";": "semicolon",
    "\t": "tab",
    "|": "bar",
    ",": "comma",
    "  ": "two blanks or more",
    " ": "blanks",
}
_CRS: Final = re.compile(
    r"^[# \t\"]*+crs[ \t]*+[:=][ \t]*+(EPSG:[^\s\";,]++)[ \t\r\";,]*+$", re.IGNORECASE | re.MULTILINE
)  # fmt: skip


def decoded(path: Path) -> tuple[str, str]:
    """Read a text file of unknown encoding.

    Returns
    -------
    text : str
        Text whose lines end with LF.
    encoding : str
        Name of the encoding.

    Raises
    ------
    InputError
        The file cannot be read, is too large, or is not text.
    """
    faults = Faults(str(path))
    data = read_data(path, faults, MAX_TEXT + 1)
    faults.raise_if_any()
    assert data is not None  # otherwise an error was raised
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


def rows_of(path: Path) -> tuple[Rows, list[int], str, tuple[Assumption, ...]]:
    """Read a text table with unknown separator.

    Returns
    -------
    rows : list of lists of cells
    lines : list of int
        Line number in the file for each row, from 1.
    crs : str
        CRS that a comment states; "" if there is no such comment.
    assumptions : tuple of Assumption
        Assumed separator and encoding.

    Raises
    ------
    InputError
        The file is not text, or it has no lines.
    """
    text, encoding = decoded(path)
    stated = _CRS.search(text)
    lines = [(n, line) for n, line in enumerate(text.split("\n"), start=1) if line.strip() and line[:1] != "#"]
    if not lines:
        raise InputError.of("interchange.empty", file=path)
    mark, rows = _split([line for _, line in lines])
    reason = "most lines then have the same number of cells"
    assumed = [Assumption(f"separator of {path.name}", _SEPARATORS[mark], reason)]
    if encoding not in ("utf-8", "utf-8-sig") and not text.isascii():
        assumed.insert(0, Assumption(f"encoding of {path.name}", encoding, "it is not UTF-8"))
    return rows, [n for n, _ in lines], stated[1] if stated else "", tuple(assumed)


def _split(lines: Sequence[str]) -> tuple[str, Rows]:
    """Choose the separator and return it with the cells.

    With this separator, most lines have the same number of cells, and most cells are numbers.
    """
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
        if score > best[0] + 1e-9:  # if two separators are equally good, the earlier one is kept
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
    out = [cell_text(cell.strip()) for cell in cells]
    while len(out) > 1 and out[-1] == "":
        out.pop()
    return [*out]
