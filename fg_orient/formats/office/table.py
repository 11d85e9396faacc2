"""Table of unknown form after its columns have keys; its cells can be read as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from factors.arrays import Array
from fg_orient.formats.faults import Faults
from fg_orient.formats.office.numbers import USUAL, Style, angles, is_number, values
from fg_orient.formats.office.sheets import Sheet
from fg_orient.formats.office.words import Named, heights_of
from fg_orient.formats.office.workbook import Cell
from fg_orient.model.errors import InputError


@dataclass(frozen=True, eq=False)
class Table:
    """Sheet with its columns.

    Parameters
    ----------
    sheet : Sheet
    headers : list of str
        Header of each column as shown to the user; a column without header has a name such as ``#2``.
    names : list of Named
    columns : list of lists
        Cells of each column, without its header.
    rows : list of int
        Row number in the sheet for each record.
    titles : str
        Text above the header.
    style : Style
        Style in which its numbers are written.
    stated : frozenset of int
        Numbers of the columns that the user has named.
    """

    sheet: Sheet
    headers: list[str]
    names: list[Named]
    columns: list[list[Cell]]
    rows: list[int]
    titles: str = ""
    style: Style = USUAL
    stated: frozenset[int] = frozenset()

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def file(self) -> str:
        """Return the name of the file for messages."""
        return str(self.sheet.path)

    def place(self, k: int, column: int | None = None) -> str:
        """Return the place of a record for messages."""
        return self.sheet.place(self.rows[k], "" if column is None else self.headers[column])

    def having(self, key: str) -> list[int]:
        """Return all columns with a key."""
        return [k for k, one in enumerate(self.names) if one.key == key]

    def one(self, key: str) -> int | None:
        """Return the column with a key; None if no column has it.

        InputError: several columns have it.
        """
        found = self.having(key)
        if len(found) > 1:
            stated = [k for k in found if k in self.stated]
            if len(stated) == 1:
                return stated[0]
            names = [self.headers[k] for k in found]
            raise InputError.of("office.columns_alike", file=self.file, place=self.sheet.name, option="columns",
                                key=key, value=", ".join(names), example=f"{key}={names[0]}")  # fmt: skip
        return found[0] if found else None

    def filled(self, column: int) -> Array:
        """Return a mask (n,) of the records whose cell in this column is not empty."""
        return np.array([cell != "" for cell in self.columns[column]], bool)

    @cached_property
    def numeric(self) -> list[int]:
        """Return the columns that contain numbers or angles."""
        out = []
        for k, cells in enumerate(self.columns):
            filled = [cell for cell in cells if cell != ""]
            if filled and np.mean([is_number(cell) for cell in filled]) > 0.5:
                out.append(k)
        return out

    def texts(self, column: int) -> list[str]:
        """Return cells as ids; whole numbers of a workbook have no decimals."""
        return [str(int(c)) if isinstance(c, float) and c.is_integer() else str(c) for c in self.columns[column]]

    def numbers(self, column: int) -> Array:
        """Return the cells as numbers (n,); nan if a cell is not a number."""
        return values(self.columns[column], self.style)

    def angles(self, column: int) -> Array | None:
        """Return degrees (n,) if the cells have minutes and seconds or a hemisphere; else None."""
        return angles(self.columns[column])

    def require_numbers(self, column: int, found: Array, faults: Faults, *, blank: bool = False) -> None:
        """Note the cells of a column that are not finite numbers; with ``blank``, empty cells are allowed."""
        for k in np.flatnonzero(~np.isfinite(found)).tolist():
            cell = self.columns[column][k]
            if cell == "" and not blank:
                faults.add("table.cell_empty", place=self.place(k, column))
            elif cell != "":
                faults.add("office.not_a_number", place=self.place(k, column), value=repr(cell))


def id_column(table: Table) -> int:
    """Find the column with the ids of the points.

    If no column has a usual name, it is the first column. In a table of ground points, it
    is the first column with unique cells.

    Raises
    ------
    InputError
        No column can contain ids.
    """
    named = table.one("id")
    if named is not None:
        return named
    free = [k for k, one in enumerate(table.names) if not one.key]
    if not table.having("image") and not table.having("line"):
        free = [k for k in free if _are_ids(table, k)]
    if not free:
        raise InputError.of("office.no_ids", file=table.file, place=table.sheet.name, option="columns",
                            value=", ".join(table.headers))  # fmt: skip
    return free[0]


def _are_ids(table: Table, column: int) -> bool:
    """Return whether the cells of a column are unique, and are texts or whole numbers."""
    cells = table.texts(column)
    whole = all(not isinstance(c, float) or c.is_integer() for c in table.columns[column])
    return whole and "" not in cells and len(set(cells)) == len(cells)


def stated_heights(table: Table, column: int | None) -> str:
    """Return the kind of heights that the header or the text above it names: "ellipsoidal", "orthometric" or ""."""
    own = table.names[column].heights if column is not None else ""
    return own or heights_of(table.titles)
