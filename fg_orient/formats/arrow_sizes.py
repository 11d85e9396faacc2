"""Read the sizes that an Arrow file states: bytes of its record batches and dictionaries after decompression.

pyarrow allocates the stated size of each compressed buffer, and does not report the sizes
before. They are therefore read from the file's FlatBuffers: the footer, then the message
of each block (Arrow columnar format 1.5, "IPC file format").
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from struct import Struct
from typing import Any, Final, NamedTuple

_SHORT, _INT, _LONG, _OFFSET = (Struct(form) for form in ("<H", "<i", "<q", "<I"))
#: A block of the footer has position, bytes of the message and bytes of the body; a buffer has position and bytes.
_BLOCK, _BUFFER = Struct("<qi4xq"), Struct("<qq")
#: Mark before the length of a message; versions before 0.15 write the length only.
_MARK: Final = b"\xff\xff\xff\xff"
_END: Final = b"ARROW1"
#: Numbers of the fields in the tables of the format.
_DICTIONARIES, _BATCHES, _KIND, _HEADER, _DATA, _BUFFERS, _COMPRESSION = 2, 3, 1, 2, 1, 2, 3
_IS_DICTIONARY: Final = 2


class Sizes(NamedTuple):
    """Bytes after decompression: of the dictionaries, and of the largest record batch."""

    dictionaries: int
    largest: int


def decoded_sizes(path: Path) -> Sizes:
    """Return the sizes that a file states.

    Raises
    ------
    ValueError
        The file is damaged: a position or a size is outside the file, or negative.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        try:
            return _of_footer(data)
        except (IndexError, struct.error) as error:
            raise ValueError(f"a position in the footer or in a message is wrong: {error}") from None


def _of_footer(data: Any) -> Sizes:
    size = len(data)
    if size < 18 or data[size - 6 :] != _END:
        raise ValueError("it does not end with ARROW1")
    begin = size - 10 - _INT.unpack_from(data, size - 10)[0]
    footer = _within(begin + _at(_OFFSET, data, begin), data)
    groups = []
    for field in (_DICTIONARIES, _BATCHES):
        place, count = _vector(data, footer, field, _BLOCK.size)
        groups.append([_of_block(data, *_BLOCK.unpack_from(data, place + k * _BLOCK.size)) for k in range(count)])
    return Sizes(sum(groups[0]), max(groups[1], default=0))


def _of_block(data: Any, position: int, message_bytes: int, body_bytes: int) -> int:
    """Return the number of bytes of a message's buffers after decompression."""
    message = _within(position, data)
    message += 8 if data[message : message + 4] == _MARK else 4
    table = _within(message + _at(_OFFSET, data, message), data)
    batch = _table(data, table, _HEADER)
    kind = _field(data, table, _KIND)
    if kind and data[kind] == _IS_DICTIONARY and batch:
        batch = _table(data, batch, _DATA)
    if not batch:
        return 0
    place, count = _vector(data, batch, _BUFFERS, _BUFFER.size)
    body, total, is_compressed = position + message_bytes, 0, _table(data, batch, _COMPRESSION) > 0
    for k in range(count):
        offset, length = _BUFFER.unpack_from(data, place + k * _BUFFER.size)
        stated = _at(_LONG, data, body + offset) if is_compressed and length > 0 else length
        stated = length if stated == -1 else stated  # this buffer is not compressed
        if stated < 0 or length < 0:
            raise ValueError(f"a buffer has {stated} bytes")
        total += stated
    return total


# --- FlatBuffers ----------------------------------------------------------------------------------------


def _within(position: int, data: Any) -> int:
    if not 0 <= position < len(data):
        raise IndexError(position)
    return position


def _at(form: Struct, data: Any, position: int) -> int:
    return int(form.unpack_from(data, _within(position, data))[0])


def _field(data: Any, table: int, number: int) -> int:
    """Return the position of a field of a table; 0 if the table does not have it."""
    names = _within(table - _at(_INT, data, table), data)
    place = 4 + 2 * number
    if place + 2 > _at(_SHORT, data, names):
        return 0
    offset = _at(_SHORT, data, names + place)
    return _within(table + offset, data) if offset else 0


def _table(data: Any, table: int, number: int) -> int:
    """Return the position of the table in a field; 0 if the field is missing."""
    place = _field(data, table, number)
    return _within(place + _at(_OFFSET, data, place), data) if place else 0


def _vector(data: Any, table: int, number: int, each: int) -> tuple[int, int]:
    """Return the position of the first element of a vector, and the number of its elements."""
    place = _table(data, table, number)
    if not place:
        return 0, 0
    count = _at(_OFFSET, data, place)
    if place + 4 + count * each > len(data):
        raise IndexError(count)
    return place + 4, count
