"""Plain values as files: strict JSON, and CSV tables that are written and read column by column.

Numbers have the fewest digits that read back to the same double. What is not finite is null in JSON and an empty cell
in a table; the warnings of a record say why (``fg_orient.result.summary``).
"""

from __future__ import annotations

import csv
import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.formats.columns import ROWS, rows_of_numbers

#: Values of a column: an array of numbers, or a sequence of text.
Column = npt.NDArray[Any] | Sequence[Any]

#: Columns of text; all others hold numbers.
WORDS: Final = frozenset((
    "id", "role", "image", "parameter", "component", "unit", "sigma_scale", "per_line_unit", "shared", "quantity",
    "part", "test", "inseparable", "left_out_with_it",
))  # fmt: skip
#: Columns of whole numbers, with empty cells.
WHOLE: Final = frozenset(("degree", "n_rays", "round", "dimension", "readmitted"))
_QUOTED: Final = re.compile('[,"\r\n]')


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

    def text(self) -> Iterator[str]:
        """Parts of the text of a CSV file."""
        yield ",".join(map(_quoted, self.columns)) + "\n"
        for start in range(0, len(self), ROWS):
            cells = list(self._cells(slice(start, start + ROWS)))
            yield "\n".join(map(",".join, zip(*cells, strict=True))) + "\n"

    def _cells(self, part: slice) -> Iterator[Sequence[str]]:
        """Texts of some rows: of each column, or of neighbouring columns of numbers together."""
        run = list[Array]()
        for name, values in self.columns.items():
            cells = values[part]
            if name not in WHOLE and _are_numbers(cells):
                run.append(np.asarray(cells, np.float64))
                continue
            if run:
                yield rows_of_numbers(np.stack(run, axis=1))
                run = []
            yield _texts(cells, name in WHOLE)
        if run:
            yield rows_of_numbers(np.stack(run, axis=1))

    def write(self, path: Path) -> None:
        """Write a CSV file."""
        with path.open("w", encoding="utf-8", newline="") as stream:
            stream.writelines(self.text())


def table_of_rows(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """Make a table of rows with the columns ``names``."""
    return Table(dict(zip(names, list(zip(*rows, strict=True)) or [()] * len(names), strict=True)))


def of_axes(name: str, axes: Iterable[str], values: Array) -> dict[str, Array]:
    """Columns of an array (n, k) by names that contain the axis in place of ``{}``."""
    return {name.format(axis): column for axis, column in zip(axes, values.T, strict=True)}


def write_rows(path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write rows as a CSV file."""
    table_of_rows(names, rows).write(path)


def _are_numbers(cells: Column) -> bool:
    """Whether all cells are floating-point numbers."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind != "O":
        return cells.dtype.kind == "f"
    return all(isinstance(cell, float) for cell in cells)


def _texts(values: Column, whole: bool = False) -> Sequence[str]:
    """Cells of a column of text, whole numbers or truth values."""
    items = values.tolist() if isinstance(values, np.ndarray) else values
    texts = [item if isinstance(item, str) else _cell(item, whole) for item in items]
    return list(map(_quoted, texts)) if _QUOTED.search("".join(texts)) else texts


def _cell(value: Any, whole: bool = False) -> str:
    """Text of one value; empty for none, words of JSON for truth values."""
    if not isinstance(value, float):
        return "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
    return "" if not math.isfinite(value) else str(int(value)) if whole else repr(float(value))


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if _QUOTED.search(text) else text


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
