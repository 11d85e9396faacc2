"""Read the sheets of workbooks (.xlsx, .ods) row by row, with limits on size and number of cells.

A workbook is a zip archive. A small file may therefore unpack to any size. A single cell
in the last row and column makes a sheet of 1.7e10 cells. Both numbers are checked before
data are kept in memory.
"""

from __future__ import annotations

import copy
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final

from lxml import etree

from fg_orient.formats.load import foreign_bytes
from fg_orient.model.errors import InputError
from fg_orient.model.limits import limit, memory_for, within, within_memory

_CHUNK: Final = 1 << 20
#: Maximum memory for a cell, bytes.
_CELL: Final = 100
#: Maximum memory for an unpacked byte, bytes.
_BYTE: Final = 2
_OFFICE: Final = "{urn:oasis:names:tc:opendocument:xmlns:office:1.0}"
_TABLE: Final = "{urn:oasis:names:tc:opendocument:xmlns:table:1.0}"
_TEXT: Final = "{urn:oasis:names:tc:opendocument:xmlns:text:1.0}"
#: Type of a cell: text, or a number of the workbook.
Cell = str | float
Rows = list[list[Cell]]


def read_workbook(path: Path) -> dict[str, Rows]:
    """Read the rows of each sheet, by the name of the sheet; formulas have their saved values.

    Raises
    ------
    InputError
        The file is damaged, encrypted or too large, or openpyxl (extra ``office``) is not installed.
    """
    with foreign_bytes("office.workbook", path):
        with zipfile.ZipFile(path) as archive:
            _require_small(archive, path)
            if "content.xml" in archive.namelist():
                with archive.open("content.xml") as stream:
                    return {name: _trimmed(rows, path, name) for name, rows in _ods_sheets(stream)}
        return _xlsx(path)


def _require_small(archive: zipfile.ZipFile, path: Path) -> None:
    """Unpack all parts and stop above the limit.

    Their stated sizes are ignored. Refuse document types.
    """
    total, size = 0, path.stat().st_size
    most = int(limit("workbook_bytes"))
    for info in archive.infolist():
        real = copy.copy(info)
        real.file_size = most + 1
        real.CRC = None  # type: ignore[assignment]  # the stated size may be wrong: the archive is read to its end
        with archive.open(real) as stream:
            head = True
            while data := stream.read(_CHUNK):
                total += len(data)
                within("workbook_bytes", total, file=path)
                within_memory(_BYTE * total, size, file=path)
                if head and b"<!DOCTYPE" in data[:4096] and info.filename.lower().endswith(".xml"):
                    raise InputError.of("office.workbook", file=path, value="a document type in its XML")
                head = False


def _xlsx(path: Path) -> dict[str, Rows]:
    """Read the sheets of an Excel workbook."""
    try:
        import openpyxl
    except ImportError as error:
        raise InputError.of("office.no_openpyxl", file=path) from error
    import warnings

    with warnings.catch_warnings(), path.open("rb") as stream:  # openpyxl does not close a damaged file
        warnings.simplefilter("ignore")  # for styles and extensions that openpyxl does not support
        book = openpyxl.load_workbook(stream, read_only=True, data_only=True)
        try:
            sheets = {}
            for sheet in book.worksheets:
                if hasattr(sheet, "reset_dimensions"):
                    sheet.reset_dimensions()  # the stated size of the sheet may be wrong
                sheets[str(sheet.title)] = _trimmed(sheet.iter_rows(values_only=True), path, str(sheet.title))
            return sheets
        finally:
            book.close()


def _trimmed(rows: Iterator[Any], path: Path, name: str) -> Rows:
    """Remove empty cells at the ends of rows, and empty rows at the end."""
    out: Rows = []
    cells, kept, size = 0, 0, path.stat().st_size
    most = min(limit("workbook_cells"), memory_for(size) / _CELL)
    for row in rows:
        own = [_cell(value) for value in row]
        cells += max(len(own), 1)
        if cells > most:
            within("workbook_cells", cells, file=path, place=f"sheet {name}", unit="cells")
            within_memory(_CELL * cells, size, file=path, place=f"sheet {name}")
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
    """Yield the sheets of an OpenDocument workbook; each sheet must be read before the next one."""
    parse = etree.iterparse(stream, events=("start", "end"), resolve_entities=False, no_network=True, huge_tree=False)
    for event, node in parse:
        if event == "start" and node.tag == f"{_TABLE}table":
            yield node.get(f"{_TABLE}name", ""), _ods_rows(parse)


def _ods_rows(parse: Any) -> Iterator[list[Any]]:
    """Yield the rows of a sheet. Repeated blank rows and cells count only if other cells follow."""
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
        within("workbook_cells", len(cells) + blank + times, unit="cells in a row")
        cells += [""] * blank + [value] * times
        blank = 0
    return cells


def _ods_value(node: Any) -> Any:
    kind = node.get(f"{_OFFICE}value-type")
    if kind in ("float", "percentage", "currency"):
        return float(node.get(f"{_OFFICE}value"))
    return "\n".join("".join(p.itertext()) for p in node.iterfind(f"{_TEXT}p")).strip()
