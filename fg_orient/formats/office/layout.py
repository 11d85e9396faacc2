"""Find the header, the data and the columns of a sheet of unknown form."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from fg_orient.formats.faults import Faults, did_you_mean
from fg_orient.formats.office.decisions import Choice, Decisions, Question
from fg_orient.formats.office.numbers import Style, is_number, possible_styles, value_of, values
from fg_orient.formats.office.sheets import Sheet
from fg_orient.formats.office.table import Table
from fg_orient.formats.office.words import ANGLES, LENGTHS, NAMES, PIXELS, Named, named, plain, role_of
from fg_orient.formats.office.workbook import Cell
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

#: Keys that the option ``columns`` may contain.
KEYS: Final = (
    *(key for key in NAMES if key not in ("x", "y")),
    "X",
    "Y",
    "Z",
    "sE",
    "sN",
    "sH",
    "sEN",
    "sline",
    "ssample",
    "spx",
)
#: If the last row contains one of these words, it is a summary and not a point.
_SUMMARY: Final = frozenset(
    "mean average total sum std ortalama toplam summe mittel mittelwert moyenne somme media suma min max".split()
)
#: Maximum height, m (30 000 ft, read as m), and maximum pixel coordinates.
_LARGEST: Final = {"H": 30_000.0, "line": 300_000.0, "sample": 300_000.0}
#: Number of rows in which a header is searched for.
_LOOKED_AT: Final = 30
#: Maximum number of rows of a header.
_HEADERS: Final = 3


def table_of(sheet: Sheet, decisions: Decisions, columns: Mapping[str, str]) -> Table | None:
    """Find header, data and columns of a sheet; None if it has no rows with numbers.

    Raises
    ------
    InputError
        A row does not fit the others, or the decimal sign cannot be determined.
    """
    counts = [sum(map(is_number, row)) for row in sheet.rows]
    filled = [sum(cell != "" for cell in row) for row in sheet.rows]
    n = len(counts)
    enough = next((k for k in range(n) if counts[k] >= 2 and (k + 1 >= n or max(counts[k + 1 : k + 3]) >= 2)), None)
    if enough is None:
        return None
    start, headers, titles = _header(sheet, counts, filled, enough)
    rows = [k for k in range(start, n) if filled[k]]
    while rows and (not counts[rows[-1]] or plain(str(_first(sheet.rows[rows[-1]]))) in _SUMMARY):
        last = rows.pop()
        decisions.note(
            f"{sheet.place(last)} of {sheet.path.name}", "left out", "it is no record: " + _joined(sheet.rows[last])
        )
    width = max([len(headers), *(len(sheet.rows[k]) for k in rows)] if not headers else [len(headers)])
    _require_width(sheet, rows, width)
    cells = [[(sheet.rows[k][j] if j < len(sheet.rows[k]) else "") for k in rows] for j in range(width)]
    shown = [headers[j] if j < len(headers) and headers[j] else f"#{j + 1}" for j in range(width)]
    used = [j for j in range(width) if any(cell != "" for cell in cells[j]) or (j < len(headers) and headers[j])]
    shown, cells = [shown[j] for j in used], [cells[j] for j in used]
    names = [Named("") if header.startswith("#") else named(header) for header in shown]
    stated = _stated(shown, names, columns)
    if not any(one.key == "role" for one in names):
        _find_roles(cells, names)
    table = Table(sheet, shown, names, cells, rows, titles, stated=stated)
    return replace(table, style=_style(table, decisions))


def names_columns(sheet: Sheet) -> bool:
    """Return whether a row of a sheet contains at least two usual column names."""
    return any(sum(bool(named(str(cell)).key) for cell in row if cell != "") > 1 for row in sheet.rows[:_LOOKED_AT])


def names_ties(sheet: Sheet) -> bool:
    """Return whether a sheet has rows of tie points; such rows contain no numbers."""
    return any(isinstance(cell, str) and role_of(cell) is Role.TIE for row in sheet.rows for cell in row)


def _first(row: list[Cell]) -> Cell:
    return next((cell for cell in row if cell != ""), "")


def _joined(row: list[Cell]) -> str:
    return " ".join(str(cell) for cell in row if cell != "")[:60]


def _header(sheet: Sheet, counts: list[int], filled: list[int], enough: int) -> tuple[int, list[str], str]:
    """Return the first row of the data, the header of each column, and the text above the header."""
    block: list[int] = []
    k = enough - 1
    while k >= 0 and len(block) < _HEADERS + 2:
        if filled[k] and not counts[k] and filled[k] >= 2:
            block.insert(0, k)
        elif block and filled[k]:
            break
        k -= 1
    scores = {k: sum(bool(named(str(cell)).key) for cell in sheet.rows[k] if cell != "") for k in block}
    if not block or not max(scores.values()):
        base = block[-1] if block else -1
        if base < 0:
            begin = next(k for k in range(len(counts)) if counts[k] >= 1 and filled[k] >= 2)
            return begin, [], _titles(sheet, begin)
    else:
        base = max(block, key=lambda k: (scores[k], k))
    width = max(len(sheet.rows[k]) for k in block)
    headers = [str(cell) for cell in _padded(sheet.rows[base], width)]
    start = base + 1
    for k in (k for k in block if k > base):
        if k != start or not _is_units(sheet.rows[k]):
            break
        units = _padded(sheet.rows[k], width)
        headers = [f"{h} [{str(u).strip('[]()')}]" if h and u != "" else h for h, u in zip(headers, units, strict=True)]
        start = k + 1
    above = [k for k in block if k < base][-(_HEADERS - 1) :]
    for k in reversed(above):
        last = ""
        row = _padded(sheet.rows[k], width)
        for j in range(width):
            last = str(row[j]) if row[j] != "" else last
            headers[j] = f"{last} {headers[j]}".strip() if headers[j] or row[j] != "" else ""
    return start, headers, _titles(sheet, above[0] if above else base)


def _padded(row: list[Cell], width: int) -> list[Cell]:
    return [*row, *[""] * (width - len(row))]


def _titles(sheet: Sheet, end: int) -> str:
    return " | ".join(_joined(row) for row in sheet.rows[:end] if any(cell != "" for cell in row))


def _is_units(row: list[Cell]) -> bool:
    """Return whether a row contains the names of units."""
    words = [plain(str(cell).strip("[]() ")) for cell in row if str(cell).strip("-– ") != ""]
    known = [word for word in words if word in LENGTHS or word in ANGLES or word in PIXELS or word in ("", "°")]
    return bool(words) and 2 * len(known) >= len(words)


def _require_width(sheet: Sheet, rows: list[int], width: int) -> None:
    """Refuse rows with more cells than the header, and rows without numbers between rows with numbers."""
    faults = Faults(str(sheet.path))
    usual = Counter(len(sheet.rows[k]) for k in rows).most_common(1)
    for k in rows:
        row = sheet.rows[k]
        if len(row) > width:
            faults.add("office.row_width", place=sheet.place(k), value=f"{len(row)} cells", width=width)
        elif not any(map(is_number, row)):
            faults.add("office.no_record", place=sheet.place(k), value=_joined(row))
    if faults and usual and usual[0][0] > width:
        raise InputError(*faults.problems[:1])
    faults.raise_if_any()


def _stated(headers: list[str], names: list[Named], columns: Mapping[str, str]) -> frozenset[int]:
    """Assign keys to the columns that the user names; other columns lose these keys."""
    stated = set()
    for key, header in columns.items():
        at = next((k for k, own in enumerate(headers) if header == own or plain(header) == plain(own)), None)
        if at is None:
            continue
        own = {"X": "X", "Y": "Y", "Z": "Z"}.get(key, key)
        for k, one in enumerate(names):
            if one.key == own:
                names[k] = Named("")
        names[at] = Named(own, names[at].unit or named(headers[at]).unit, "", names[at].heights)
        stated.add(at)
    return frozenset(stated)


def _find_roles(cells: list[list[Cell]], names: list[Named]) -> None:
    """Assign the key of roles to a column of unknown name if all its cells are words for roles."""
    told = [any(own) and all(c == "" or (isinstance(c, str) and role_of(c)) for c in own) for own in cells]
    found = [k for k, one in enumerate(names) if told[k] and not one.key]
    if len(found) == 1:
        names[found[0]] = Named("role")


def require_known(columns: Mapping[str, str], tables: list[Table]) -> None:
    """Refuse column names that no table contains, and keys that do not exist."""
    headers = [header for table in tables for header in table.headers]
    for key, header in columns.items():
        if key not in KEYS:
            raise InputError.of("office.key", option="columns", value=key, hint=did_you_mean(key, list(KEYS)))
        known = {plain(own) for own in headers}
        if plain(header) not in known and header not in headers:
            raise InputError.of("office.no_column", option="columns", value=header, hint=did_you_mean(header, headers))


def _style(table: Table, decisions: Decisions) -> Style:
    """Determine how the numbers of a table are written; ids are ignored."""
    columns = [table.columns[k] for k in table.numeric if table.names[k].key != "id" and table.angles(k) is None]
    possible = possible_styles(columns)
    given = decisions.given.get("decimal", "")
    if given:
        sign = {"comma": ",", "point": "."}[given]
        return next((style for style in possible if style.decimal == sign), Style(sign))
    subject = f"decimal sign of {table.sheet.title}"
    if len(possible) == 2:
        possible = tuple(style for style in possible if _plausible(table, style)) or possible
    if len(possible) == 1:
        if possible[0].decimal == ",":
            decisions.note(subject, "comma", "its numbers cannot be read otherwise", "decimal")
        if possible[0].grouped and any(value_of(c, possible[0]._replace(grouped=False)) != value_of(c, possible[0])
                                       and is_number(c) for cells in columns for c in cells):  # fmt: skip
            decisions.note(
                f"groups of thousands in {table.sheet.title}", "read", "no number above 999 is without", "decimal"
            )
        return possible[0]
    comma, point = sorted(possible)
    example = next(
        str(c) for cells in columns for c in cells if is_number(c) and value_of(c, comma) != value_of(c, point)
    )
    choices = [Choice(word, f"{example} is {value_of(example, style):.10g}")
               for word, style in (("comma", comma), ("point", point))]  # fmt: skip
    choice = decisions.settle(
        Question("decimal", subject, choices, reason="its numbers can be read with both"), table.file
    )
    return comma if choice is not None and choice.value == "comma" else point


def _plausible(table: Table, style: Style) -> bool:
    """Return whether heights and pixels of a table are possible if numbers are read in this style."""
    for key, limit in _LARGEST.items():
        for k in table.having(key):
            found = np.abs(values(table.columns[k], style)) * LENGTHS.get(table.names[k].unit, 1.0)
            known = found[np.isfinite(found)]
            if len(known) and float(np.median(known)) > limit:
                return False
    return True
