"""Sheets of workbooks (.xlsx, .ods) as rows of cells, read row by row; size and cells are limited.

A workbook is a zip archive: a small file may unpack to any size, and one cell in the last row and column makes a sheet
of 1.7e10 cells. Both are counted before anything is kept.
"""

from __future__ import annotations

import copy
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final

from lxml import etree

from fg_orient.model.errors import InputError

#: Largest unpacked workbook, bytes; most cells and rows of a sheet, blank ones between others included.
MAX_BYTES: Final = 256_000_000
MAX_CELLS: Final = 5_000_000
_CHUNK: Final = 1 << 20
_OFFICE: Final = "{urn:oasis:names:tc:opendocument:xmlns:office:1.0}"
_TABLE: Final = "{urn:oasis:names:tc:opendocument:xmlns:table:1.0}"
_TEXT: Final = "{urn:oasis:names:tc:opendocument:xmlns:text:1.0}"
#: A cell: text, or a number of the workbook.
Cell = str | float
Rows = list[list[Cell]]


def read_workbook(path: Path) -> dict[str, Rows]:
    """Rows of each sheet by its name; formulas have the value that was saved.

    Raises
    ------
    InputError
        The file is damaged, encrypted or too large, or openpyxl (extra ``office``) is missing.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            _require_small(archive, path)
            if "content.xml" in archive.namelist():
                with archive.open("content.xml") as stream:
                    return {name: _trimmed(rows, path, name) for name, rows in _ods_sheets(stream)}
        return _xlsx(path)
    except OSError as error:
        raise InputError.of("table.unreadable", file=path, value=error.strerror or error) from None
    except (zipfile.BadZipFile, zlib.error, etree.LxmlError, KeyError, ValueError, TypeError, AttributeError,
            IndexError, EOFError, RuntimeError, NotImplementedError, SyntaxError) as error:  # fmt: skip
        raise InputError.of("office.workbook", file=path, value=error or type(error).__name__) from None


def _require_small(archive: zipfile.ZipFile, path: Path) -> None:
    """Unpack all parts, ignore their stated sizes, and stop above the limit; refuse document types."""
    total = 0
    for info in archive.infolist():
        real = copy.copy(info)
        real.file_size = MAX_BYTES + 1
        real.CRC = None  # type: ignore[assignment]  # the size that the archive states is not believed
        with archive.open(real) as stream:
            head = True
            while data := stream.read(_CHUNK):
                total += len(data)
                if total > MAX_BYTES:
                    raise InputError.of("office.too_large", file=path, value=f"more than {MAX_BYTES} bytes")
                if head and b"<!DOCTYPE" in data[:4096] and info.filename.lower().endswith(".xml"):
                    raise InputError.of("office.workbook", file=path, value="a document type in its XML")
                head = False


def _xlsx(path: Path) -> dict[str, Rows]:
    """Sheets of an Excel workbook."""
    try:
        import openpyxl
    except ImportError as error:
        raise InputError.of("office.no_openpyxl", file=path) from error
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # styles and extensions that openpyxl does not support
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            sheets = {}
            for sheet in book.worksheets:
                if hasattr(sheet, "reset_dimensions"):
                    sheet.reset_dimensions()  # the size that the sheet states is not believed
                sheets[str(sheet.title)] = _trimmed(sheet.iter_rows(values_only=True), path, str(sheet.title))
            return sheets
        finally:
            book.close()


def _trimmed(rows: Iterator[Any], path: Path, name: str) -> Rows:
    """Rows without empty cells at their ends and empty rows at the end."""
    out: Rows = []
    cells = kept = 0
    for row in rows:
        own = [_cell(value) for value in row]
        cells += max(len(own), 1)
        if cells > MAX_CELLS:
            raise InputError.of(
                "office.too_large", file=path, place=f"sheet {name}", value=f"more than {MAX_CELLS} cells"
            )
        while own and own[-1] == "":
            own.pop()
        out.append(own)
        kept = len(out) if own else kept
    return out[:kept]


def _cell(value: Any) -> Cell:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value)
    return float(value) if isinstance(value, (int, float)) else str(value).strip()


def _ods_sheets(stream: IO[bytes]) -> Iterator[tuple[str, Iterator[list[Any]]]]:
    """Sheets of an OpenDocument workbook; each has to be read before the next."""
    parse = etree.iterparse(stream, events=("start", "end"), resolve_entities=False, no_network=True, huge_tree=False)
    for event, node in parse:
        if event == "start" and node.tag == f"{_TABLE}table":
            yield node.get(f"{_TABLE}name", ""), _ods_rows(parse)


def _ods_rows(parse: Any) -> Iterator[list[Any]]:
    """Rows of a sheet. Repeated blank rows and cells count only if others follow."""
    blank = 0
    for event, node in parse:
        if event == "end" and node.tag == f"{_TABLE}table":
            return
        if event != "end" or node.tag != f"{_TABLE}table-row":
            continue
        times, cells = _repeated(node, "rows"), _ods_cells(node)
        node.clear()
        if not cells:
            blank += times
            continue
        for _ in range(blank):
            yield []
        blank = 0
        for _ in range(times):
            yield cells


def _repeated(node: Any, what: str) -> int:
    return int(node.get(f"{_TABLE}number-{what}-repeated", "1"))


def _ods_cells(row: Any) -> list[Any]:
    cells: list[Any] = []
    blank = 0
    for node in row:
        if node.tag not in (f"{_TABLE}table-cell", f"{_TABLE}covered-table-cell"):
            continue
        times, value = _repeated(node, "columns"), _ods_value(node)
        if value == "":
            blank += times
            continue
        if len(cells) + blank + times > MAX_CELLS:
            raise ValueError(f"more than {MAX_CELLS} cells in a row")
        cells += [""] * blank + [value] * times
        blank = 0
    return cells


def _ods_value(node: Any) -> Any:
    kind = node.get(f"{_OFFICE}value-type")
    if kind in ("float", "percentage", "currency"):
        return float(node.get(f"{_OFFICE}value"))
    return "\n".join("".join(p.itertext()) for p in node.iterfind(f"{_TEXT}p")).strip()
