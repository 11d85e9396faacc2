"""CSV tables as read: every cell is text until a number is read from it.

Ids stay text: ``01`` is not ``1``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from itertools import compress
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.formats.faults import MAX_FAULTS, Faults, did_you_mean

#: Texts that are read as numbers, and numbers with a decimal comma.
NUMBER: Final = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
DECIMAL_COMMA: Final = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
#: Of texts that consist of these characters, ``float`` accepts exactly those that match :data:`NUMBER`.
_OF_NUMBERS: Final = b"0123456789eE+.-"


@dataclass(frozen=True)
class Row:
    """One record: its line number in the file (1-based) and the text of its cells by column."""

    line: int
    cells: dict[str, str]

    def place(self, column: str = "") -> str:
        """Place of this record, or of one of its cells, for messages."""
        return f"line {self.line}, column {column}" if column else f"line {self.line}"


@dataclass(frozen=True, eq=False)
class Table:
    """A table as read.

    Parameters
    ----------
    columns : tuple of str
    cells : dict of str to sequence of str
        Text of the records in file order, by column.
    lines : (n,) int array
        Line number of each record in the file, from 1.
    file : str
        Name of the file, for messages.
    """

    columns: tuple[str, ...]
    cells: dict[str, Sequence[str]]
    lines: npt.NDArray[np.int64]
    file: str
    _refused: list[tuple[Index, str, str, dict[str, Any]]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.lines)

    def row(self, k: int) -> Row:
        """One record."""
        return Row(int(self.lines[k]), {name: self.cells[name][k] for name in self.columns})

    def where(self, column: str, text: str) -> Mask:
        """Records (n,) whose cell is this text."""
        return np.fromiter((cell == text for cell in self.cells[column]), bool, len(self))

    def numbers(self, *columns: str, rows: Mask | None = None) -> Array:
        """Columns as finite numbers (n, k); nan where a cell, then refused, is not a number, and in other ``rows``."""
        out = np.full((len(self), len(columns)), np.nan)
        wanted = np.ones(len(self), bool) if rows is None else rows
        for j, name in enumerate(columns):
            cells = self.cells[name] if rows is None else list(compress(self.cells[name], rows.tolist()))
            values = finite(cells)
            if values is None:
                codes = np.array([_number_fault(cell) for cell in self.cells[name]])
                for code in sorted(set(codes[wanted].tolist()) - {""}):
                    self.refuse(
                        wanted & (codes == code), code, name, value=lambda row, name=name: repr(row.cells[name])
                    )
                values = np.array([np.nan if _number_fault(cell) else float(cell) for cell in cells])
            out[wanted, j] = values
        return out

    def positions(self, column: str, known: Sequence[str] | None, code: str) -> Index:
        """Position (n,) of each cell in ``known``; other cells get positions beyond it, and are refused.

        Nothing is refused if ``known`` is None.
        """
        cells, place = self.cells[column], {name: k for k, name in enumerate(known or ())}
        try:
            return np.fromiter(map(place.__getitem__, cells), np.intp, len(cells))
        except KeyError:
            out = np.array([place.setdefault(cell, len(place)) for cell in cells], np.intp)
        if known is not None:
            self.refuse(
                out >= len(known), code, column, value=lambda row: repr(row.cells[column]),
                hint=lambda row: did_you_mean(row.cells[column], list(known)),
            )  # fmt: skip
        return out

    def refuse(self, wrong: npt.ArrayLike, code: str, column: str, **fields: Any) -> None:
        """Refuse records (n,) for the text of a cell, which is the value of the message by default.

        ``fields`` of the message are constants, arrays (n,), or functions of the :class:`Row`.
        """
        rows = np.flatnonzero(np.asarray(wrong, bool))
        if len(rows):
            self._refused.append((rows, code, column, {"value": lambda row: row.cells[column], **fields}))

    def refuse_repeated(self, keys: Sequence[Hashable] | Index, code: str, column: str, **fields: Any) -> None:
        """Refuse records whose key an earlier record has; field ``first`` is the line of that record."""
        distinct = np.diff(np.sort(keys)).all() if isinstance(keys, np.ndarray) else len(set(keys)) == len(keys)
        if not distinct:
            place: dict[Hashable, int] = {}
            first = np.array([place.setdefault(key, k) for k, key in enumerate(keys)])
            self.refuse(first < np.arange(len(keys)), code, column, first=self.lines[first], **fields)

    def report(self, faults: Faults) -> None:
        """Note the refused records in the order of their lines."""
        for k, n in sorted((k, n) for n, (rows, *_) in enumerate(self._refused) for k in rows[:MAX_FAULTS].tolist()):
            (_, code, column, fields), row = self._refused[n], self.row(k)
            made = {
                name: value(row) if callable(value) else value[k] if isinstance(value, np.ndarray) else value
                for name, value in fields.items()
            }
            faults.add(code, place=row.place(column), **made)
        for rows, code, *_ in self._refused:
            faults.count(code, max(0, len(rows) - MAX_FAULTS))
        self._refused.clear()

    def require_valid(self) -> None:
        """Raise InputError with the refused records, if there are any."""
        faults = Faults(self.file)
        self.report(faults)
        faults.raise_if_any()


def number(row: Row, column: str, faults: Faults) -> float:
    """Read a cell as a finite number; nan, with the fault noted, if it is not a number."""
    text = row.cells[column]
    code = _number_fault(text)
    if code:
        faults.add(code, place=row.place(column), value=repr(text))
        return float("nan")
    return float(text)


def _number_fault(text: str) -> str:
    """Message code of a text that is not a finite number, "" if it is one."""
    if not text:
        return "table.cell_empty"
    if not NUMBER.fullmatch(text):
        return "table.decimal_comma" if DECIMAL_COMMA.fullmatch(text) else "table.not_a_number"
    return "table.number_too_large" if math.isinf(float(text)) else ""


def finite(cells: Sequence[str]) -> Array | None:
    """All texts as finite numbers (n,); None if one is not a number."""
    if "".join(cells).encode().translate(None, _OF_NUMBERS):
        return None
    try:
        values = np.fromiter(map(float, cells), np.float64, len(cells))
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None
