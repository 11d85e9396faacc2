"""Verdicts of a table as a grid: addresses down, solvers across (or EOP sets, where no solver is named)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fg_orient.model.cells import CellKey
from fg_orient.studies.reproduce.reproduction import Row


@dataclass(frozen=True)
class Grid:
    """Verdicts of one table.

    Parameters
    ----------
    columns : tuple of str
        Solvers or EOP sets, in the order of the table; ("",) where neither tells cells apart.
    rows : tuple
        Address without the column, and a Row or None per column.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Row | None, ...]], ...]


def grid(rows: Sequence[Row], keys: Mapping[tuple[str, str], CellKey]) -> Grid | None:
    """Arrange the cells of a table; None where it would be a single column.

    Parameters
    ----------
    rows : sequence of Row
        Of one table.
    keys : mapping
        (table, address) to the key.
    """
    found = [(row, keys.get((row.table, row.cell), CellKey(row.table))) for row in rows]
    for field in ("method", "eop_set"):
        columns = tuple(dict.fromkeys(getattr(key, field) for _, key in found if getattr(key, field)))
        if len(columns) > 1:
            return _arranged(found, field, columns)
    return None


def _arranged(found: list[tuple[Row, CellKey]], field: str, columns: tuple[str, ...]) -> Grid:
    """Cells without a column of their own stand in the first one, of a row of their own where that is taken."""
    lines: dict[str, dict[str, Row]] = {}
    for row, key in found:
        column = getattr(key, field) or columns[0]
        line = lines.setdefault(str(key._replace(**{field: ""})) or row.cell, {})
        if column in line:
            line = lines.setdefault(row.cell, {})
        line[column] = row
    words = [name.replace("_", " ") if field == "method" else f"set {name}" for name in columns]
    return Grid(tuple(words), tuple((name, tuple(map(line.get, columns))) for name, line in lines.items()))
