"""Cells of a large table, stored by columns without a Python string for each cell.

The module also converts rows of numbers to text. A CSV table is called regular if

- it is ASCII without quotes, apostrophes and blanks,
- all its comments are before the header, and
- every record has as many cells as the header.

The cells of a regular table are slices of its bytes between separators. Their numbers are
read by orjson, which is ten times faster than ``float``. Any other table is read line by
line (``fg_orient.formats.tables``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import compress
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import orjson

from factors.arrays import Array, Index, Mask

#: Sizes of the parts in which a table is processed: cells (about 2 MB), bytes that are searched, rows to text.
CHUNK: Final = 200_000
BLOCK: Final = 2_000_000
ROWS: Final = 2_000
#: Texts of up to this number of bytes are compared as numbers. ``_ODD`` is the multiplier
#: of the hash for texts of more than 8 bytes.
WIDEST: Final = 64
_ODD: Final = np.uint64(0x9E3779B97F4A7C15)
#: Characters that make a table irregular: quotes, apostrophes, and what ``strip`` removes from ASCII text.
IRREGULAR: Final = "\"'\t\v\f\x1c\x1d\x1e\x1f "
_COMMA, _LINE_END, _COMMENT = b",\n#"
#: If a text consists of these characters only, ``float`` accepts it exactly if our tables accept it as a number.
OF_NUMBERS: Final = b"0123456789eE+.-"


class Cells(Sequence[str]):
    """Cells of a column as texts."""

    def __init__(self, texts: Sequence[str]) -> None:
        self._given = texts

    @cached_property
    def _texts(self) -> Sequence[str]:
        return self._given

    def __len__(self) -> int:
        return len(self._texts)

    def __getitem__(self, k: Any) -> Any:
        return self._texts[k]

    def __iter__(self) -> Iterator[str]:
        return iter(self._texts)

    def are(self, text: str) -> Mask:
        """Return a mask (n,) of the cells that are equal to this text."""
        return np.fromiter((cell == text for cell in self), bool, len(self))

    def finite(self, rows: Mask | None = None) -> Array | None:
        """Return all cells, or the cells of the ``rows`` (n,), as finite numbers; None if any cell is not a number."""
        return finite(self._texts if rows is None else list(compress(self, rows.tolist())))

    def positions(self, place: Mapping[str, int]) -> Index:
        """Look up each cell in a dictionary and return the values (n,).

        Raise KeyError if a cell is not in it.
        """
        return np.fromiter(map(place.__getitem__, self), np.intp, len(self))


def finite(cells: Sequence[str]) -> Array | None:
    """Convert all texts to finite numbers (n,); None if a text is not a number."""
    if "".join(cells).encode().translate(None, OF_NUMBERS):
        return None
    try:
        values = np.fromiter(map(float, cells), np.float64, len(cells))
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


class SlicedCells(Cells):
    """Cells of a regular table: the bytes of ``data`` between the separators at ``before`` (n,) and ``last`` (n,)."""

    def __init__(self, data: npt.NDArray[np.uint8], before: npt.NDArray[Any], last: npt.NDArray[Any]) -> None:
        self._data, self._before, self._last = data, before, last

    def __len__(self) -> int:
        return len(self._last)

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return self._texts[k]
        return self._data[self._before[k] + 1 : self._last[k]].tobytes().decode("ascii")

    @cached_property
    def _texts(self) -> list[str]:
        return b"".join(self._joined(None)).decode("ascii")[:-1].split(",") if len(self) else []

    def _joined(self, rows: Mask | None) -> Iterator[bytes]:
        """Yield the bytes of many cells at a time; each cell is followed by a comma."""
        before, last = (self._before, self._last) if rows is None else (self._before[rows], self._last[rows])
        for begin in range(0, len(last), CHUNK):
            low, high = before[begin : begin + CHUNK], last[begin : begin + CHUNK]
            size = high - low  # with the separator
            end = np.cumsum(size)
            out = self._data[np.repeat(low + 1 - (end - size), size) + np.arange(end[-1])]
            out[end - 1] = _COMMA
            yield out.tobytes()

    def positions(self, place: Mapping[str, int]) -> Index:
        """See :class:`Cells`.

        The bytes of the cells are compared as whole numbers, so no strings are made.
        """
        size, n = np.asarray(self._last - self._before - 1), len(self)
        names = [name.encode() for name in place]
        known = np.array(names or [b"\0"], np.bytes_)
        width = known.itemsize
        if (
            size.max(initial=0) > width
            or width > WIDEST
            or sum(map(len, names)) != np.count_nonzero(known.view(np.uint8))
        ):
            # rare cases: a cell is longer than all names, or a name contains a zero byte
            return super().positions(place)
        cells = np.zeros((n, width), np.uint8)
        for k in range(width):
            rows = np.flatnonzero(size > k)
            cells[rows, k] = self._data[self._before[rows] + 1 + k]
        given = known.view(np.uint8).reshape(len(known), width)
        order, at = _found(_words(given), _words(cells))
        if (given[order[at]] != cells).any():
            return super().positions(place)
        return np.fromiter(place.values(), np.intp, len(known))[order][at]

    def are(self, text: str) -> Mask:
        """See :class:`Cells`."""
        out = self._last - self._before == len(text) + 1
        at = np.flatnonzero(out)
        wanted = np.frombuffer(text.encode("utf-8"), np.uint8)
        out[at] = (self._data[self._before[at][:, None] + 1 + np.arange(len(text))] == wanted).all(axis=1)
        return np.asarray(out)

    def finite(self, rows: Mask | None = None) -> Array | None:
        """See :class:`Cells`."""
        # columns of equal cells are common, for example standard deviations: only one cell is
        # converted
        if rows is None and len(self) and self[0] == self[-1] and self.are(self[0]).all():
            one = finite([self[0]])
            return None if one is None else np.full(len(self), one[0])
        parts = [np.zeros(0)]
        for text in self._joined(rows):
            if text.translate(None, OF_NUMBERS + b","):
                return None
            try:
                parts.append(np.array(orjson.loads(b"[" + text[:-1] + b"]"), np.float64))
            except (orjson.JSONDecodeError, OverflowError):  # float accepts more forms of numbers than JSON
                return super().finite(rows)
            if len(parts[-1]) != text.count(b","):  # an empty cell: JSON gives fewer numbers
                return None
        values = np.concatenate(parts)
        return values if np.isfinite(values).all() else None


def _words(texts: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint64]:
    """Convert each row of bytes (n, w) to one whole number (n,).

    Up to 8 bytes are the number itself. Longer rows are mixed to a hash.
    """
    padded = np.zeros((len(texts), -(-texts.shape[1] // 8) * 8), np.uint8)
    padded[:, : texts.shape[1]] = texts
    words = padded.view(">u8").astype(np.uint64)
    out = words[:, 0].copy()
    for word in words[:, 1:].T:
        out = (out ^ (out >> np.uint64(29))) * _ODD + word
    return out


def _found(known: npt.NDArray[np.uint64], wanted: npt.NDArray[np.uint64]) -> tuple[Index, Index]:
    """Return the order (n,) that sorts the known numbers, and the places (m,) of the wanted numbers in this order."""
    order = np.argsort(known, kind="stable")
    return order, np.minimum(np.searchsorted(known[order], wanted), len(known) - 1)


class CodedCells(Cells):
    """Cells stored as positions ``codes`` (n,) in the list of the ``distinct`` texts."""

    def __init__(self, distinct: Sequence[str], codes: npt.NDArray[Any]) -> None:
        self._distinct, self._codes = distinct, codes

    def __len__(self) -> int:
        return len(self._codes)

    def __getitem__(self, k: Any) -> Any:
        return self._texts[k] if isinstance(k, slice) else self._distinct[self._codes[k]]

    @cached_property
    def _texts(self) -> list[str]:
        return list(map(self._distinct.__getitem__, self._codes.tolist()))

    def are(self, text: str) -> Mask:
        """See :class:`Cells`."""
        return np.asarray(np.array([one == text for one in self._distinct], bool)[self._codes])

    def finite(self, rows: Mask | None = None) -> Array | None:
        """See :class:`Cells`."""
        codes = self._codes if rows is None else self._codes[rows]
        used = self._used(codes)
        values = finite(list(map(self._distinct.__getitem__, used.tolist())))
        return None if values is None else np.asarray(self._spread(used, values)[codes])

    def positions(self, place: Mapping[str, int]) -> Index:
        """See :class:`Cells`."""
        used = self._used(self._codes)
        texts = map(self._distinct.__getitem__, used.tolist())
        return np.asarray(
            self._spread(used, np.fromiter(map(place.__getitem__, texts), np.intp, len(used)))[self._codes]
        )

    def _used(self, codes: npt.NDArray[Any]) -> Index:
        """Return the positions of those distinct texts that occur among the codes."""
        return np.flatnonzero(np.bincount(codes, minlength=len(self._distinct)))

    def _spread(self, used: Index, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Expand the values of the used texts to an array over all distinct texts."""
        out = np.zeros(len(self._distinct), values.dtype)
        out[used] = values
        return out


class NumberCells(Cells):
    """Cells stored as numbers (n,) with a mask ``empty`` (n,) of the empty cells."""

    def __init__(self, values: npt.NDArray[Any], empty: Mask) -> None:
        self._values, self._empty = values, empty

    def __len__(self) -> int:
        return len(self._values)

    def __getitem__(self, k: Any) -> Any:
        return self._texts[k] if isinstance(k, slice) else "" if self._empty[k] else repr(self._values[k].item())

    @cached_property
    def _texts(self) -> list[str]:
        pairs = zip(self._values.tolist(), self._empty.tolist(), strict=True)
        return ["" if empty else repr(value) for value, empty in pairs]

    def are(self, text: str) -> Mask:
        """See :class:`Cells`."""
        if not text:
            return self._empty
        return np.zeros(len(self), bool) if finite([text]) is None else super().are(text)

    def finite(self, rows: Mask | None = None) -> Array | None:
        """See :class:`Cells`."""
        values, empty = (self._values, self._empty) if rows is None else (self._values[rows], self._empty[rows])
        values = values.astype(np.float64)
        return None if empty.any() or not np.isfinite(values).all() else values


class Regular(NamedTuple):
    """Regular table: line number (from 1) and cells of its header, and the columns of its records."""

    line: int
    header: list[str]
    columns: list[SlicedCells]


def regular(text: str, longest: int) -> Regular | None:
    """Read the text of a table.

    Return None if it is not regular or has a line longer than ``longest``.
    """
    begin, line = 0, 0
    while True:  # skip comments and blank lines before the header
        line, end = line + 1, text.find("\n", begin)
        if end < 0:
            return None
        header = text[begin:end]
        begin = end + 1
        if header.strip(" \t,") and not header.startswith("#"):
            break
    stop = len(text)
    while stop > begin and text[stop - 1] == "\n":
        stop -= 1
    odd = any(mark in header or text.find(mark, begin) >= 0 for mark in IRREGULAR)
    if stop == begin or odd or header.endswith(",") or not text.isascii():
        return None
    whole = text.encode("ascii")
    data = np.frombuffer(whole if stop < len(whole) else whole + b"\n", np.uint8)[begin : stop + 1]
    width, ends = header.count(",") + 1, _ends(data)
    if len(ends) % width:
        return None
    last = ends.reshape(-1, width)
    of_line = np.concatenate([[-1], last[:, -1]])
    starts = data[of_line[:-1] + 1]
    # a line that begins with a comma may be a blank line of a spreadsheet: such a table is not regular
    if ((data[last[:, -1]] != _LINE_END).any() or (data[last[:, :-1]] == _LINE_END).any()
            or np.isin(starts, (_COMMENT, _COMMA, _LINE_END)).any() or np.diff(of_line).max() > longest):  # fmt: skip
        return None
    before = [of_line[:-1].astype(last.dtype), *last.T]
    return Regular(line, header.split(","), [SlicedCells(data, before[k], last[:, k]) for k in range(width)])


def _ends(data: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
    """Return the places of all commas and line ends."""
    kind = np.int32 if len(data) < np.iinfo(np.int32).max else np.int64
    places = [np.zeros(0, kind)]
    for k in range(0, len(data), BLOCK):
        part = data[k : k + BLOCK]
        places.append((np.flatnonzero((part == _COMMA) | (part == _LINE_END)) + k).astype(kind))
    return np.concatenate(places)


def rows_of_numbers(values: Array) -> list[bytes]:
    """Convert rows of numbers (n, k) to lines of text, with the fewest digits that give the same double again.

    A number that is not finite becomes an empty cell. The package orjson is fifteen times faster than ``repr``.
    """
    if not values.size:
        return [b"," * max(values.shape[1] - 1, 0)] * len(values)
    out = list[bytes]()
    for begin in range(0, len(values), ROWS):
        rows = np.ascontiguousarray(values[begin : begin + ROWS], np.float64)
        out += orjson.dumps(rows, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2].replace(b"null", b"").split(b"],[")
    return out
