"""Read text files, split lines into cells, and compute the SHA-256 of files."""

from __future__ import annotations

import csv
import hashlib
from pathlib import Path

from fg_orient.formats.faults import Faults
from fg_orient.model.errors import InputError
from fg_orient.model.limits import open_input, within_memory

#: Memory that a line and its cells need, bytes.
LINE_BYTES = 250


def read_data(path: Path, faults: Faults, size: int = -1) -> bytes | None:
    """Read all bytes or the first bytes of a file.

    If it cannot be read, note the error and return None.
    """
    try:
        with open_input(path) as stream:
            return stream.read(size)
    except FileNotFoundError:
        faults.add("table.missing_file")
    except OSError as error:
        faults.add("table.unreadable", value=error.strerror or type(error).__name__)
    return None


def read_text(path: Path, faults: Faults) -> str | None:
    """Read a UTF-8 file; the text has no byte order mark, and its lines end with LF.

    If the file cannot be used, note the fault and return None.
    """
    data = read_data(path, faults)
    if data is None:
        return None
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        faults.add("table.utf16", place="line 1")
        return None
    if data.startswith((b"PAR1", b"ARROW1")):
        faults.add("table.other_form", value="Parquet or Arrow")
        return None
    if b"\0" in data:
        faults.add("table.nul", place=f"line {data[: data.index(0)].count(10) + 1}")
        return None
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
        require_lines(text, faults.file)
        return text
    except InputError as error:
        faults.take(*error.problems)
        return None
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        faults.add("table.not_utf8", place=f"line {line}", value=f"byte 0x{data[error.start]:02x}")
        return None


def require_lines(text: str, file: object) -> None:
    """Raise InputError if the cells of a text need too much memory because it has very many short lines."""
    within_memory(LINE_BYTES * text.count("\n"), len(text), file=file)


def sha256_of(*paths: Path) -> str:
    """Compute the SHA-256 of a file.

    For a folder or several files, it includes their names and contents.
    """
    files = [f for p in paths for f in (sorted(q for q in p.rglob("*") if q.is_file()) if p.is_dir() else [p])]
    if len(files) == 1 and not paths[0].is_dir():
        return _digest(files[0]).hex()
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + _digest(file))
    return digest.hexdigest()


def _digest(file: Path) -> bytes:
    with open_input(file) as stream:
        return hashlib.file_digest(stream, "sha256").digest()


def delimited(number: int, line: str, faults: Faults, width: int | None = None, *, mark: str = ",") -> list[str] | None:
    """Split a line into cells without outer blanks.

    If the quotes or the number of cells are wrong, note the error and return None. Empty
    cells after the last column are left out.
    """
    try:
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=mark, strict=True))]
    except csv.Error as error:
        faults.add("table.quotes", place=f"line {number}", value=str(error))
        return None
    while cells and not cells[-1] and (width is None or len(cells) > width):
        cells.pop()
    if width not in (None, len(cells)):
        faults.add("table.cell_count", place=f"line {number}", value=f"{len(cells)} cells", count=width)
        return None
    return cells
