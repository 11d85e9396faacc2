"""Plain values as files: strict JSON, and CSV tables that are written and read column by column.

Numbers have the fewest digits that read back to the same double. What is not finite is null in JSON and an empty cell
in a table; the warnings of a record say why (``fg_orient.result.summary``).
"""

from __future__ import annotations

import csv
import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.formats.columns import ROWS
from fg_orient.formats.table_write import Column, write_table

#: Columns of text; all others hold numbers.
WORDS: Final = frozenset((
    "id", "role", "image", "parameter", "component", "unit", "sigma_scale", "per_line_unit", "shared", "quantity",
    "part", "test", "inseparable", "left_out_with_it",
))  # fmt: skip


def plain(value: Any) -> Any:
    """Turn a value into what JSON can hold; numbers that are not finite become None."""
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
    """Write JSON with every double to its last digit and without nan."""
    return json.dumps(plain(value), allow_nan=False, ensure_ascii=False, indent=indent)


@dataclass(frozen=True, repr=False)
class Table:
    """Table of a result.

    Parameters
    ----------
    columns : dict
        Name to the values of a column, all of one length, in the order of the file. Text is a list of str; numbers are
        an array, nan where there is none.
    """

    columns: dict[str, Column]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __repr__(self) -> str:
        names = ", ".join(self.columns)
        return f"<Table of {len(self)} rows: {names if len(names) < 200 else names[:200] + ' ...'}>"

    @cached_property
    def words(self) -> dict[str, list[str]]:
        """Columns of text."""
        return {name: list(values) for name, values in self.columns.items() if name in WORDS}

    @cached_property
    def figures(self) -> dict[str, Array]:
        """Columns of numbers."""
        return {name: np.asarray(values, float) for name, values in self.columns.items() if name not in WORDS}

    @cached_property
    def values(self) -> dict[str, list[str] | Array]:
        """All columns, in the order of the file."""
        both: dict[str, list[str] | Array] = {**self.words, **self.figures}
        return {name: both[name] for name in self.columns}

    def numbers(self, *names: str) -> Array:
        """Some columns of numbers, (n, k); nan where the table does not have them."""
        return np.stack([self.figures.get(name, np.full(len(self), np.nan)) for name in names], axis=1)

    def codes(self, name: str, words: Sequence[str]) -> Index:
        """Index of each cell of a column of text in a list of its values."""
        place = {word: k for k, word in enumerate(words)}
        return np.fromiter(map(place.__getitem__, self.words[name]), np.intp, len(self))

    def write(self, path: Path) -> None:
        """Write the table in the form that the end of the file name says."""
        write_table(path, self.columns)


def table_of_rows(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """Make a table of rows with the columns ``names``."""
    return Table(dict(zip(names, list(zip(*rows, strict=True)) or [()] * len(names), strict=True)))


def of_axes(name: str, axes: Iterable[str], values: Array) -> dict[str, Array]:
    """Columns of an array (n, k) by names that contain the axis in place of ``{}``."""
    return {name.format(axis): column for axis, column in zip(axes, values.T, strict=True)}


def write_rows(path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table of rows."""
    table_of_rows(names, rows).write(path)


def write_records(path: Path, records: Sequence[Mapping[str, Any]]) -> None:
    """Write a table of records with the same keys."""
    write_rows(path, tuple(records[0]), (tuple(record.values()) for record in records))


def read_table(path: Path, *required: str) -> Table:
    """Read a CSV table of ours; lines that start with # are comments.

    Parameters
    ----------
    path : Path
    *required : str
        Columns that the table must have.

    Raises
    ------
    ValueError
        Rows of different lengths, a cell that is not a number, or a missing column.
    """
    with path.open(encoding="utf-8", newline="") as stream:
        rows = csv.reader(line for line in stream if not line.startswith("#"))
        names = next(rows, [])
        if missing := set(required) - set(names):
            raise ValueError(f"no column {min(missing)}")
        parts: list[list[Column]] = [[[] if name in WORDS else np.zeros(0)] for name in names]
        while part := list(itertools.islice(rows, ROWS)):
            if any(len(row) != len(names) for row in part):
                raise ValueError(f"a line without {len(names)} cells")
            for name, column, cells in zip(names, parts, zip(*part, strict=True), strict=True):
                column.append(cells if name in WORDS else np.array([float(c) if c else math.nan for c in cells]))
    return Table({
        name: list(itertools.chain(*column)) if name in WORDS else np.concatenate(column)
        for name, column in zip(names, parts, strict=True)
    })  # fmt: skip
