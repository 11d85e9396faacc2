"""Load untrusted files with limits on size and memory: JSON, NPZ archives and SQLite databases.

For any content, a reader of this package either returns a value or raises
:class:`~fg_orient.model.errors.FgOrientError`. The size of a file is checked before it is
read. The needed memory is checked before it is parsed, because a small file may state a
very large size. :mod:`fg_orient.model.limits` contains the limits. TOML and XML have
their own modules, which call :func:`load_bytes`.
"""

from __future__ import annotations

import io
import os
import sqlite3
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import IO, Any, Final
from urllib.parse import quote

import numpy as np
import numpy.typing as npt
import orjson

from fg_orient.formats.registry import read_bytes
from fg_orient.model.errors import FgOrientError, InputError
from fg_orient.model.limits import exceeded, limit, open_input, within, within_memory

#: Maximum number of bytes of Python objects for each of these characters in JSON. The
#: characters begin a table, a list, a further value, or the value of a name.
_OBJECTS: Final = {b"{": 260, b"[": 90, b",": 80, b":": 80}
#: Kinds of numpy arrays that can be read: truth values, numbers, text.
KINDS: Final = "biufcU"
#: A SQLite database begins with these bytes.
SQLITE_MARK: Final = b"SQLite format 3\0"
#: Number of steps of SQLite's virtual machine between two checks of the limit.
_STEPS: Final = 10_000
#: SQLite marks a column with one of these numbers if its values are computed when they are read.
_GENERATED: Final = (2, 3)


@contextmanager
def foreign_bytes(code: str, file: object, place: object = "") -> Iterator[None]:
    """Convert any exception of a block into an InputError with this code; the message states the reason.

    The block calls a parser of another project, which does not document its exceptions for damaged content.
    """
    try:
        yield
    except FgOrientError:
        raise
    except Exception as error:
        value = type(error).__name__ if isinstance(error, LookupError | TypeError | AttributeError) else ""
        value = ": ".join(filter(None, (value, str(error)))) or type(error).__name__
        raise InputError.of(code, file=file, place=place, value=value) from error


def load_bytes(path: str | os.PathLike[str], name: str, code: str = "table.unreadable") -> bytes:
    """Return the bytes of a file; its size is limited.

    Parameters
    ----------
    path : path
    name : str
        Name of the size limit in :mod:`fg_orient.model.limits`.
    code : str
        Code of the message if the file cannot be read.

    Raises
    ------
    InputError
        The file is missing, unreadable or larger than the limit.
    """
    most = int(limit(name))
    data = read_bytes(path, most + 1, code)
    if len(data) > most:
        raise exceeded(name, f"{Path(path).stat().st_size} bytes", file=os.fspath(path))
    return data


# --- JSON ------------------------------------------------------------------------------------------


def load_json(path: str | os.PathLike[str], code: str) -> Any:
    """Return the content of a JSON file; see :func:`parse_json`."""
    return parse_json(load_bytes(path, "json_bytes", code), os.fspath(path), code)


def parse_json(data: bytes, file: object, code: str, place: object = "") -> Any:
    """Parse JSON (RFC 8259) in UTF-8, with or without a byte order mark; nan and infinity are refused.

    Parameters
    ----------
    data : bytes
    file, place : object
        File, and place in it; used in messages.
    code : str
        Code of the message if the content is not JSON.

    Raises
    ------
    InputError
        The content is not JSON, is nested too deeply, or needs too much memory.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    need = sum(data.count(mark) * n_bytes for mark, n_bytes in _OBJECTS.items())
    within_memory(need, len(data), file=file, place=place)
    try:
        content = orjson.loads(data)
    except (orjson.JSONDecodeError, RecursionError) as error:
        raise InputError.of(code, file=file, place=place, value=error) from None
    level, most = [content], int(limit("json_depth"))
    for _ in range(most):
        level = [
            item for one in level if isinstance(one, (dict, list))
            for item in (one.values() if isinstance(one, dict) else one) if isinstance(item, (dict, list))
        ]  # fmt: skip
        if not level:
            return content
    raise exceeded("json_depth", f"more than {most} levels", file=file, place=place, unit="levels")


# --- NPZ -------------------------------------------------------------------------------------------


def load_npz(source: Path | bytes, code: str, file: object = "", kinds: str = KINDS) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an ``.npz`` archive. They may contain numbers and text, but no pickled objects.

    Parameters
    ----------
    source : Path or bytes
        The file or its bytes.
    code : str
        Code of the message if the archive is damaged.
    file : object
        Name of the archive in messages.
    kinds : str
        Kinds of arrays (``numpy.dtype.kind``).

    Raises
    ------
    InputError
        The archive cannot be read, is damaged, contains other kinds of arrays, or needs too much memory.
    """
    file = file or (source if isinstance(source, Path) else "")
    with foreign_bytes(code, file), _stream(source) as stream:
        size = stream.seek(0, os.SEEK_END)
        within("npz_bytes", size, file=file)
        with zipfile.ZipFile(stream) as archive:
            members = archive.infolist()
            within_memory(sum(one.file_size for one in members), size, file=file)
            return {one.filename.removesuffix(".npy"): _array(archive, one, kinds) for one in members}


def _stream(source: Path | bytes) -> IO[bytes]:
    return io.BytesIO(source) if isinstance(source, bytes) else open_input(source)


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, kinds: str) -> npt.NDArray[Any]:
    """Read the array of an archive member.

    Raise ValueError if the member has another size than its header states.
    """
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"{member.filename} has version {version}")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, is_fortran, dtype = read(stream)
        size = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
        if dtype.kind not in kinds or dtype.fields or min(shape, default=0) < 0 or size > member.file_size:
            raise ValueError(f"{member.filename} is {dtype} {shape} in {member.file_size} bytes")
        data = bytearray(stream.read(size))
        if len(data) != size or stream.read(1):  # read(1) at the end makes zipfile compare the checksum
            raise ValueError(f"{member.filename} has another size than it states")
    found: npt.NDArray[Any] = np.ndarray(shape, dtype, data, order="F" if is_fortran else "C")
    if (
        dtype.kind == "U"
        and found.size
        and int(found.reshape(-1).view("u4" if dtype.isnative else ">u4").max()) > 0x10FFFF
    ):
        raise ValueError(f"{member.filename} is not text")
    return found


# --- SQLite ----------------------------------------------------------------------------------------


@contextmanager
def open_sqlite(path: Path, tables: Sequence[str], code: str) -> Iterator[sqlite3.Connection]:
    """Open a SQLite database to read some of its tables.

    Views, virtual tables and computed columns are refused. They run code of the file's
    author, which may need any time and memory. The number of steps of a query and the
    size of its values are limited.

    Parameters
    ----------
    path : Path
    tables : sequence of str
    code : str
        Code of the message if the database is damaged.

    Raises
    ------
    InputError
        The database cannot be opened, is damaged or is too large, or a table is not a plain
        table. Errors of SQLite and wrong types in the ``with`` block are converted to
        InputError, too.
    """
    steps = 0

    def count() -> int:
        nonlocal steps
        steps += _STEPS
        return int(steps > most)

    with foreign_bytes(code, path.name):
        size = path.stat().st_size
        within("sqlite_bytes", size, file=path.name)
        most = limit("sqlite_steps") + limit("sqlite_steps_per_byte") * size
        with open_input(path) as stream:
            if stream.read(len(SQLITE_MARK)) != SQLITE_MARK:
                raise ValueError("it is not a database of SQLite")
        with closing(sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro", uri=True)) as opened:
            opened.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(min(size, 2**31 - 1), 10_000))
            opened.set_progress_handler(count, _STEPS)
            opened.execute("PRAGMA trusted_schema = OFF")
            opened.execute("PRAGMA cell_size_check = ON")
            try:
                require_plain(opened, tables)
                yield opened
            except sqlite3.OperationalError:
                if steps > most:
                    raise exceeded("sqlite_steps", f"{steps} steps", file=path.name, unit="steps") from None
                raise


def require_plain(opened: sqlite3.Connection, tables: Sequence[str]) -> None:
    """Raise ValueError if a table is a view, is virtual or has computed columns.

    A missing table is allowed.
    """
    for table in tables:
        found = opened.execute("SELECT type, sql FROM sqlite_master WHERE lower(name) = lower(?)", (table,)).fetchall()
        if any(kind not in ("table", "index") or "virtual" in str(text)[:30].lower() for kind, text in found):
            raise ValueError(f"{table} is not a plain table")
        columns = opened.execute("SELECT hidden FROM pragma_table_xinfo(?)", (table,)).fetchall()
        if any(hidden in _GENERATED for (hidden,) in columns):
            raise ValueError(f"{table} has computed columns")
