"""Large tables as columns: text of whole columns, written part by part.

The bytes are those of ``csv.writer`` row by row: numbers with the digits that read back to the same double, nan as
empty cell, quotes where a cell needs them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

#: Rows whose text is held at once.
CHUNK: Final = 20_000
_QUOTED: Final = re.compile('[,"\r\n]')

Index = npt.NDArray[np.intp]


class Named:
    """A column of names, given by their places in a list.

    Parameters
    ----------
    names : sequence of str
    place : (n,) int array
    """

    def __init__(self, names: Sequence[str], place: Index) -> None:
        self._names, self._place = names, place

    def __len__(self) -> int:
        return len(self._place)

    def __getitem__(self, rows: slice) -> list[str]:
        return list(map(self._names.__getitem__, self._place[rows].tolist()))


Column = npt.NDArray[Any] | Sequence[str] | Named


def write_columns(path: Path, columns: dict[str, Column]) -> None:
    """Write a table by columns of the same length; see the module docstring."""
    n = len(next(iter(columns.values())))
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(",".join(_texts(list(columns))) + "\n")
        for start in range(0, n, CHUNK):
            part = slice(start, start + CHUNK)
            cells = [_texts(column[part]) for column in columns.values()]
            stream.write("\n".join(map(",".join, zip(*cells, strict=True))) + "\n")


def _texts(values: npt.NDArray[Any] | Sequence[str]) -> Sequence[str]:
    """Cells of a column."""
    if not isinstance(values, np.ndarray):
        needed = _QUOTED.search("".join(values))
        return [_quoted(text) for text in values] if needed else values
    if values.dtype.kind != "f":
        return list(map(str, values.tolist()))
    finite = np.isfinite(values)
    bits = np.ascontiguousarray(values, np.float64).view(np.int64)
    if finite[:1].all() and (bits == bits[:1]).all():
        return [repr(float(value)) for value in values[:1]] * len(values)
    if finite.all():
        return list(map(repr, values.tolist()))
    out = [""] * len(values)
    for k, text in zip(np.flatnonzero(finite).tolist(), map(repr, values[finite].tolist()), strict=True):
        out[k] = text
    return out


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if _QUOTED.search(text) else text
