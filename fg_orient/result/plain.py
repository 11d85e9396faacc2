"""Write and read plain values: strict JSON, and tables that are stored by columns.

A number has the fewest digits from which the same double can be read again. A value that
is not finite is null in JSON and an empty cell in a table. The warnings of the record
state the reason (``fg_orient.result.summary``).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from factors.arrays import Array, Index
from fg_orient.formats.faults import Faults
from fg_orient.formats.table_write import WORDS, Column, csv_table, write_table
from fg_orient.formats.tables import note_repeated, read_columns
from fg_orient.model.errors import InputError


def plain(value: Any) -> Any:
    """Convert a value to JSON types; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, str) or value is None or isinstance(value, bool):
        return str(value) if isinstance(value, str) else value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, Sequence):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def dumps(value: Any, indent: int | None = None) -> str:
    """Return a value as JSON text: doubles have all their digits, and nan does not occur."""
    return json.dumps(plain(value), allow_nan=False, ensure_ascii=False, indent=indent)


@dataclass(frozen=True, repr=False)
class Table:
    """Table of a result, stored by columns.

    Parameters
    ----------
    columns : dict
        Values by the name of the column, in the order of the file. All columns have the same
        length. Text is a list of str. Numbers are an array; missing numbers are nan.
    """

    columns: dict[str, Column]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __repr__(self) -> str:
        names = ", ".join(self.columns)
        return f"<Table of {len(self)} rows: {names if len(names) < 200 else names[:200] + ' ...'}>"

    @cached_property
    def words(self) -> dict[str, list[str]]:
        """Return the columns of text."""
        return {name: list(values) for name, values in self.columns.items() if name in WORDS}

    @cached_property
    def figures(self) -> dict[str, Array]:
        """Return the columns of numbers."""
        return {name: np.asarray(values, float) for name, values in self.columns.items() if name not in WORDS}

    @cached_property
    def values(self) -> dict[str, list[str] | Array]:
        """Return all columns in the order of the file."""
        both: dict[str, list[str] | Array] = {**self.words, **self.figures}
        return {name: both[name] for name in self.columns}

    def numbers(self, *names: str, rows: Index | slice = slice(None)) -> Array:
        """Return some columns of numbers as an array (n, k), for all rows or some.

        Missing columns are nan.
        """
        missing = np.broadcast_to(np.nan, len(self))
        return np.stack([self.figures.get(name, missing)[rows] for name in names], axis=1)

    def codes(self, name: str, words: Sequence[str]) -> Index:
        """Return the position of each cell of a text column in a list of possible values.

        InputError: a cell has another value, because the table does not belong to the record.
        """
        place = {word: k for k, word in enumerate(words)}
        try:
            return np.fromiter(map(place.__getitem__, self.words[name]), np.intp, len(self))
        except KeyError as error:
            raise InputError.of("report.damaged", place=f"column {name}", value=error.args[0]) from None

    def write(self, path: Path) -> None:
        """Write the table in the format of the file name's suffix."""
        write_table(path, self.columns)


def table_of_rows(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """Make a table of rows with the columns ``names``."""
    return Table(dict(zip(names, list(zip(*rows, strict=True)) or [()] * len(names), strict=True)))


def of_axes(name: str, axes: Iterable[str], values: Array) -> dict[str, Array]:
    """Split an array (n, k) into columns.

    The name of the axis replaces ``{}`` in the column names.
    """
    return {name.format(axis): column for axis, column in zip(axes, values.T, strict=True)}


def rows_of(columns: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Convert columns of n values to n records.

    If a name contains "{}", its value is an array (n, k), and the axes x, y, z replace "{}".
    """
    flat: dict[str, Any] = {}
    for name, values in columns.items():
        flat |= of_axes(name, "xyz"[: values.shape[1]], values) if "{}" in name else {name: values}
    return [dict(zip(flat, row, strict=True)) for row in zip(*flat.values(), strict=True)]


def write_rows(path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table of rows."""
    table_of_rows(names, rows).write(path)


def csv_of_records(records: Sequence[Mapping[str, Any]]) -> bytes:
    """Return a CSV table of records with the same keys; "" if there are no records."""
    if not records:
        return b""
    return csv_table(table_of_rows(tuple(records[0]), (tuple(record.values()) for record in records)).columns)


def write_records(path: Path, records: Sequence[Mapping[str, Any]]) -> None:
    """Write a table of records with the same keys."""
    write_rows(path, tuple(records[0]), (tuple(record.values()) for record in records))


def read_table(path: Path, *required: str, code: str = "report.damaged") -> Table:
    """Read a table that this program has written.

    Parameters
    ----------
    path : Path
    *required : str
        Names of columns that the table must have.
    code : str
        Code of the message if the table cannot be read.

    Raises
    ------
    InputError
        The file is missing or damaged, a column is missing, or a cell is not a number.
        Only the first fault is named.
    """

    def check(place: str, names: Sequence[str]) -> None:
        note_repeated(place, names, faults)
        for name in sorted(set(required) - set(names)):
            faults.add("table.column_missing", place=place, value=", ".join(names), missing=name,
                       columns=", ".join(required))  # fmt: skip

    faults, columns = Faults(str(path)), dict[str, Column]()
    table = read_columns(path, faults, check, required)
    if table is not None and not faults:
        for name, cells in table.cells.items():
            columns[name] = list(cells) if name in WORDS else table.numbers(name, rows=~cells.are(""))[:, 0]
        table.report(faults)
    for one in faults.problems[:1]:
        value = " ".join(filter(None, (one.message, one.value)))
        raise InputError.of(code, file=path, place=one.place, value=value)
    return Table(columns)
