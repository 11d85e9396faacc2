"""Read the sizes of the pages of a Parquet file after decompression.

pyarrow allocates the size that the header of each page states. The footer of the file
states a sum of these sizes, which can be wrong. Therefore the headers are read (Parquet
format 2.11, "FileMetaData", "PageHeader", in Thrift's compact protocol): a header is
followed by its compressed page, and the page by the next header. The positions of the
pages are read from the footer, too, because pyarrow ends the process if one of its
columns is damaged.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

#: Numbers of fields. Footer: row groups; row group: columns; column: its metadata.
_GROUPS, _COLUMNS, _COLUMN = 4, 1, 3
#: Fields of the metadata of a column: bytes in the file, position of the first data page and of the dictionary.
_LENGTH, _DATA, _DICTIONARY = 7, 9, 11
#: Fields of the header of a page: bytes after decompression and in the file.
_DECODED, _STORED = 2, 3
#: Types of the compact protocol.
_BOOLEANS, _BYTE, _INTEGERS, _DOUBLE, _BINARY, _SEQUENCES, _MAP, _STRUCT = (1, 2), 3, (4, 5, 6), 7, 8, (9, 10), 11, 12
#: Longest number, bytes; deepest nesting (real footers: 6).
_LONGEST: Final = 10
_DEEPEST: Final = 12
_MARK: Final = b"PAR1"

Inner = Mapping[int, Callable[[], object]]


def largest_group_bytes(path: Path) -> int:
    """Return the number of bytes of the largest row group after decompression.

    Raises
    ------
    ValueError
        The footer or a header is damaged, a size is negative, or the columns do not lie side by side in the file.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        length = int.from_bytes(data[-8:-4], "little")
        if len(data) < 12 + length or data[-4:] != _MARK:
            raise ValueError("it does not end with the length of the footer and PAR1")
        return _Groups(data, _Fields(data, len(data) - 8 - length)).largest


class _Groups:
    """Sizes of the row groups, read from the footer."""

    def __init__(self, data: Any, footer: _Fields) -> None:
        self._data, self._footer = data, footer
        self.largest, self._decoded, self._stored = 0, 0, 0
        footer.struct(inner={_GROUPS: self._group})

    def _group(self) -> None:
        self._decoded = 0
        self._footer.struct(inner={_COLUMNS: self._column})
        self.largest = max(self.largest, self._decoded)

    def _column(self) -> None:
        self._footer.struct(inner={_COLUMN: self._pages})

    def _pages(self) -> None:
        """Add the sizes of the pages of a column."""
        found = self._footer.struct((_LENGTH, _DATA, _DICTIONARY))
        length = found.get(_LENGTH, 0)
        at = min(filter(None, (found.get(_DICTIONARY), found.get(_DATA))), default=0)  # 0: there is no such page
        end = at + length
        self._stored += length
        if not 0 <= at <= end <= len(self._data) or self._stored > len(self._data):
            raise ValueError("a column is outside the file, or columns overlap")
        while at < end:
            page = _Fields(self._data, at)
            sizes = page.struct((_DECODED, _STORED))
            decoded, stored = sizes.get(_DECODED, -1), sizes.get(_STORED, -1)
            if min(decoded, stored) < 0:
                raise ValueError("the size of a page is missing or negative")
            self._decoded += decoded
            at = page.at + stored


class _Fields:
    """Data in Thrift's compact protocol; ``at`` is the position behind what has been read."""

    def __init__(self, data: Any, at: int) -> None:
        self._data, self.at = data, at

    def struct(self, integers: tuple[int, ...] = (), inner: Inner | None = None, depth: int = 0) -> dict[int, int]:
        """Read a struct.

        Parameters
        ----------
        integers : tuple of int
            Numbers of the fields to return.
        inner : mapping, optional
            By the number of a field, the function that reads its struct, or each struct of its list.
        depth : int
            Number of values around this one.
        """
        found, number = dict[int, int](), 0
        while (head := self._byte()) != 0:
            kind, step = head & 15, head >> 4
            number = number + step if step else self._signed()
            if kind in _INTEGERS and number in integers:
                found[number] = self._signed()
            else:
                self._value(kind, depth, (inner or {}).get(number))
        return found

    def _value(self, kind: int, depth: int, read: Callable[[], object] | None = None) -> None:
        """Read a value and forget it, or leave its structs to a function."""
        if depth > _DEEPEST:
            raise ValueError("it is nested too deeply")
        if kind in _INTEGERS:
            self._signed()
        elif kind == _BYTE:
            self._byte()
        elif kind == _DOUBLE:
            self.at += 8
        elif kind == _BINARY:
            length = self._unsigned()
            self.at += length
        elif kind in _SEQUENCES:
            head = self._byte()
            count, each = head >> 4, head & 15
            self._values(self._unsigned() if count == 15 else count, (each,), depth, read)
        elif kind == _MAP:
            count = self._unsigned()
            kinds = self._byte() if count else 0
            self._values(count, (kinds >> 4, kinds & 15), depth)
        elif kind == _STRUCT:
            read() if read is not None else self.struct(depth=depth + 1)
        elif kind not in _BOOLEANS:
            raise ValueError("a field has an unknown type")

    def _values(self, count: int, kinds: tuple[int, ...], depth: int, read: Callable[[], object] | None = None) -> None:
        """Read the elements of a list or map. A boolean takes a byte here, but none as a field."""
        if count > len(self._data) - self.at:
            raise ValueError("a list is longer than the file")
        for _ in range(count):
            for kind in kinds:
                self._value(_BYTE if kind in _BOOLEANS else kind, depth + 1, read)

    def _signed(self) -> int:
        value = self._unsigned()
        return (value >> 1) ^ -(value & 1)

    def _unsigned(self) -> int:
        value = 0
        for k in range(_LONGEST):
            byte = self._byte()
            value |= (byte & 127) << 7 * k
            if byte < 128:
                return value
        raise ValueError("a number is too long")

    def _byte(self) -> int:
        if not 0 <= self.at < len(self._data):
            raise ValueError("it leaves the file")
        self.at += 1
        return int(self._data[self.at - 1])
