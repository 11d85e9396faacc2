"""Read and write tables in Parquet files and Arrow files (Feather version 2).

The package pyarrow does the work (the extra "arrow"). The columns are converted to the same
cells as the columns of a CSV file. Therefore both kinds of files pass the same checks. A null
becomes an empty cell. Text may be encoded by a dictionary. Numbers may be integers,
floating-point or decimal numbers.

The footer of a file states the numbers of rows and bytes. They are checked before the file is
read. Then the file is read in groups of rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import Mask
from fg_orient.formats.arrow_sizes import decoded_sizes
from fg_orient.formats.columns import Cells, CodedCells, NumberCells
from fg_orient.formats.faults import BREAKS, LONGEST, Faults
from fg_orient.formats.parquet_sizes import largest_group_bytes
from fg_orient.formats.table_write import WHOLE, WORDS, Column, are_numbers, comment_lines, texts
from fg_orient.formats.text_files import read_data
from fg_orient.model.errors import InputError
from fg_orient.model.limits import within, within_memory
from fg_orient.model.machine import allowed_bytes, in_gb

#: Function that checks the names of columns and notes their faults. Its first argument is their place in the file.
Check = Callable[[str, Sequence[str]], None]
#: Messages give this as the place of a wrong column name.
HEADER: Final = "the columns"
#: A file with this suffix must begin with these bytes.
MARKS: Final = {".parquet": b"PAR1", ".feather": b"ARROW1", ".arrow": b"ARROW1"}
#: Names of two entries in the metadata of a file: the version of the columns, and the comments as lines of CSV.
SCHEMA: Final = b"fg_orient.schema"
COMMENTS: Final = b"fg_orient.comments"
VERSION: Final = b"1"
#: Number of rows that are compressed together. A reader can read such a group alone.
ROW_GROUP: Final = 250_000
#: Each different text of a row group is written only once, if these texts need at most this number of bytes.
DICTIONARY: Final = 16_000_000
#: Minimum number of bytes that a cell needs in memory.
PER_CELL: Final = 16
#: Kinds of columns that are converted to arrays of numbers.
NUMBERS: Final = ("whole", "number")


class _Opened(NamedTuple):
    """Open file: its schema, number of rows, decoded bytes of the largest row group, and its row groups."""

    schema: Any
    n_rows: int
    largest_bytes: int
    n_groups: int
    read: Callable[[Sequence[int]], Any]


class _Part(NamedTuple):
    """Some cells of a column.

    Cells of numbers have their values, and a mask of the empty cells. Cells of text have
    positions in ``distinct``.
    """

    values: npt.NDArray[Any]
    empty: Mask
    distinct: dict[str, int] | None


@dataclass
class _Known:
    """All different texts of a column and their positions.

    Several row groups may share a dictionary of pyarrow. Therefore the last dictionary is kept.
    """

    texts: dict[str, int]
    _dictionary: Any = None
    _positions: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def positions(self, dictionary: Any) -> npt.NDArray[np.int64]:
        """Return the positions of the texts of a dictionary.

        The last position belongs to an empty cell.
        """
        if self._dictionary is None or not dictionary.equals(self._dictionary):
            found = [(text or "").strip() for text in dictionary.to_pylist()]
            self._dictionary = dictionary
            self._positions = np.array([self.texts.setdefault(text, len(self.texts)) for text in (*found, "")])
        return self._positions


def library(file: object) -> Any:
    """Import pyarrow.

    Raise InputError if it is not installed; the message names the ``file`` that needs it.
    """
    try:
        import pyarrow
        import pyarrow.ipc
        import pyarrow.parquet
    except ImportError as error:
        raise InputError.of("table.no_pyarrow", file=file) from error
    return pyarrow


# --- reading ----------------------------------------------------------------------------------------


def read_binary(path: Path, faults: Faults, check: Check) -> dict[str, Cells] | None:
    """Read all columns as cells.

    Parameters
    ----------
    path, faults, check
        See :func:`fg_orient.formats.tables.read_columns`.

    Returns
    -------
    dict or None
        None if the file cannot be used; the faults are then noted.
    """
    parts = list(_parts(path, faults, check))
    return None if faults else {name: _cells([part.pop(name) for part in parts]) for name in list(parts[0])}


def comments_of(path: Path, faults: Faults) -> str:
    """Return the comments of a file as lines of CSV.

    If the file cannot be used, note the fault and return "".
    """
    if _begins_well(path, faults):
        with _noting(path, faults) as pa:
            return str((_opened(pa, path).schema.metadata or {}).get(COMMENTS, b"").decode("utf-8"))
    return ""


def _begins_well(path: Path, faults: Faults) -> bool:
    """Return whether the file begins with the signature of its format; if not, note the fault."""
    mark = MARKS[path.suffix.lower()]
    found = read_data(path, faults, len(mark))
    if found not in (mark, None):
        faults.add("table.other_form", value=f"it does not begin with {mark.decode()}")
    return found == mark


@contextmanager
def _noting(path: Path, faults: Faults) -> Iterator[Any]:
    """Import pyarrow for a block of code.

    Errors of pyarrow in this block are noted as faults of the file.
    """
    pa = library(path)
    try:
        yield pa
    except InputError as error:  # a limit
        faults.take(*error.problems)
    except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
        faults.add("table.damaged", value=str(error) or type(error).__name__)


def _opened(pa: Any, path: Path) -> _Opened:
    """Open a file. Text of Parquet stays encoded by a dictionary, to limit the memory."""
    if path.suffix.lower() == ".parquet":
        meta = pa.parquet.read_metadata(path)
        schema = meta.schema.to_arrow_schema()
        names = [one.name for one in schema if _kind(pa, one.type) == "text"]
        file = pa.parquet.ParquetFile(
            path, metadata=meta, read_dictionary=names, pre_buffer=False, page_checksum_verification=True
        )  # fmt: skip
        groups = [meta.row_group(k) for k in range(meta.num_row_groups)]
        rows = [group.num_rows for group in groups]
        if min(rows, default=0) < 0 or sum(rows) != meta.num_rows:
            raise ValueError("the numbers of rows are wrong")
        largest = largest_group_bytes(path)
        read = partial(file.read_row_groups, use_threads=False)
        return _Opened(schema, meta.num_rows, largest, len(rows), read)
    sizes = decoded_sizes(path)
    within_memory(sum(sizes), path.stat().st_size, file=path)  # dictionaries are decoded when the file is opened
    reader = pa.ipc.open_file(pa.OSFile(str(path)), options=pa.ipc.IpcReadOptions(use_threads=False))
    return _Opened(
        reader.schema, reader.count_rows(), sum(sizes), reader.num_record_batches,
        lambda groups: pa.Table.from_batches(map(reader.get_batch, groups), reader.schema),
    )  # fmt: skip


def _parts(path: Path, faults: Faults, check: Check) -> Iterator[dict[str, _Part]]:
    """Yield the columns of each row group. A file without rows yields one empty group.

    Only one group at a time is in memory as a table of pyarrow.
    """
    if not _begins_well(path, faults):
        return
    with _noting(path, faults) as pa:
        file = _opened(pa, path)
        within("table_columns", len(file.schema), file=path, unit="columns")
        kinds = [(one.name, _kind(pa, one.type)) for one in file.schema]
        _check_schema(file, kinds, check, faults)
        need = file.largest_bytes + file.n_rows * len(kinds) * PER_CELL
        within_memory(need, path.stat().st_size, file=path, place=f"{file.n_rows} rows of {len(kinds)} columns")
        allowed = allowed_bytes(None)
        if allowed is not None and need > allowed:
            faults.add("table.memory", value=in_gb(need), rows=file.n_rows, columns=len(kinds),
                       allowed=in_gb(allowed))  # fmt: skip
        known = {name: _Known({}) for name, _ in kinds}
        first = 1
        for groups in [[k] for k in range(file.n_groups)] or [[]]:
            if faults:
                return
            group = file.read(groups).unify_dictionaries() if groups else file.schema.empty_table()
            group.validate(full=True)
            part = dict[str, _Part]()
            for (name, kind), column in zip(kinds, group.columns, strict=True):
                before = len(known[name].texts)
                part[name] = _numbers(pa, column) if kind in NUMBERS else _texts(pa, column, known[name])
                _check_texts(name, part[name], before, first, faults)
            first += group.num_rows
            yield part


def _check_schema(file: _Opened, kinds: Sequence[tuple[str, str]], check: Check, faults: Faults) -> None:
    """Note an unknown version, wrong column names, and columns that contain neither text nor numbers."""
    version = (file.schema.metadata or {}).get(SCHEMA, VERSION)
    if version != VERSION:
        faults.add("table.version", value=version.decode("utf-8", "replace"), version=VERSION.decode())
    check(HEADER, [name for name, _ in kinds])
    for one, (name, kind) in zip(file.schema, kinds, strict=True):
        if not kind or (name in WORDS and kind in ("number", "decimal")):
            expected = "text or whole numbers" if name in WORDS else "numbers, floating-point, whole or decimal"
            faults.add("table.column_type", place=f"column {name}", value=one.type, expected=expected)


def _kind(pa: Any, type_: Any) -> str:
    """Return the kind of a column: text, whole, number, decimal, none (all cells are null) or "" (not supported)."""
    types = pa.types
    if types.is_dictionary(type_):
        type_ = type_.value_type
    tests = {
        "text": (types.is_string, types.is_large_string, types.is_string_view), "whole": (types.is_integer,),
        "number": (types.is_floating,), "decimal": (types.is_decimal,), "none": (types.is_null,),
    }  # fmt: skip
    return next((kind for kind, own in tests.items() if any(test(type_) for test in own)), "")


def _numbers(pa: Any, column: Any) -> _Part:
    """Convert a column of numbers from pyarrow."""
    values, empty = [np.zeros(0, np.int64)], [np.zeros(0, bool)]
    for one in column.chunks:
        plain = one.dictionary_decode() if pa.types.is_dictionary(one.type) else one
        empty.append(plain.is_null().to_numpy(zero_copy_only=False))
        numbers = plain.fill_null(0).to_numpy(zero_copy_only=False)
        values.append(numbers.astype(np.float64) if numbers.dtype.kind == "f" else numbers)
    return _Part(np.concatenate(values[1:] or values), np.concatenate(empty), None)


def _texts(pa: Any, column: Any, known: _Known) -> _Part:
    """Convert a column of text from pyarrow; new texts are added to ``known``, the texts read so far.

    A decimal number is converted to text first. Its later conversion to a double then rounds it only once.
    """
    codes = [np.zeros(0, np.int64)]
    for one in column.chunks:
        if pa.types.is_dictionary(one.type) and pa.types.is_decimal(one.type.value_type):
            one = one.dictionary_decode()
        coded = one if pa.types.is_dictionary(one.type) else one.cast(pa.string()).dictionary_encode()
        place = known.positions(coded.dictionary)
        codes.append(place[coded.indices.fill_null(len(place) - 1).to_numpy(zero_copy_only=False)])
    return _Part(np.concatenate(codes), np.zeros(0, bool), known.texts)


def _check_texts(name: str, part: _Part, before: int, first: int, faults: Faults) -> None:
    """Note the first new text that a CSV cell cannot contain.

    ``before`` is the number of texts that were known before this part. ``first`` is the row
    number of its first row.
    """
    new = list(islice(part.distinct or (), before, None))
    joined = "".join(new)
    if max(map(len, new), default=0) <= LONGEST and not any(mark in joined for mark in BREAKS):
        return
    wrong = [k for k, text in enumerate(new) if len(text) > LONGEST or any(mark in text for mark in BREAKS)]
    for k in np.flatnonzero(np.isin(part.values - before, wrong))[:1].tolist():
        value = repr(new[part.values[k] - before])
        faults.add("table.text", place=f"row {first + k}, column {name}", value=value, limit=LONGEST)


def _cells(parts: Sequence[_Part]) -> Cells:
    """Join the cells of a column from all row groups."""
    values, empty = (np.concatenate([getattr(part, name) for part in parts]) for name in ("values", "empty"))
    distinct = parts[0].distinct
    return NumberCells(values, empty) if distinct is None else CodedCells(list(distinct), values)


# --- writing ----------------------------------------------------------------------------------------


def write_binary(path: Path, columns: Mapping[str, Column], comments: Sequence[str]) -> None:
    """Write a table as Parquet or Arrow.

    The suffix of the file name decides. See ``table_write.write_table``.
    """
    pa = library(path)
    arrays = {name: _array(pa, name, values) for name, values in columns.items()}
    metadata = {SCHEMA: VERSION, COMMENTS: "\n".join(comment_lines(comments)).encode("utf-8")}
    table = pa.table(arrays).replace_schema_metadata(metadata)
    if path.suffix.lower() == ".parquet":
        words = [name for name, one in arrays.items() if pa.types.is_string(one.type)]
        pa.parquet.write_table(
            table, path, compression="zstd", row_group_size=ROW_GROUP, use_dictionary=words,
            dictionary_pagesize_limit=DICTIONARY, write_page_checksum=True,
        )  # fmt: skip
        return
    for k, one in enumerate(arrays.values()):
        if pa.types.is_string(one.type):
            table = table.set_column(k, table.schema[k].name, one.dictionary_encode())
    options = pa.ipc.IpcWriteOptions(compression="zstd", use_threads=False)
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_file(sink, table.schema, options=options) as writer:
        writer.write_table(table, max_chunksize=ROW_GROUP)


def _array(pa: Any, name: str, values: Column) -> Any:
    """Convert a column to an array of pyarrow (float64, int64, bool or text).

    An empty cell of CSV becomes null.
    """
    if name not in WORDS and name not in WHOLE and are_numbers(values):
        numbers = np.asarray(values, np.float64)
        return pa.array(numbers, mask=~np.isfinite(numbers))
    if name in WORDS:
        return pa.array([item or None for item in texts(values)], pa.string())
    items = values.tolist() if isinstance(values, np.ndarray) else values
    given = [None if item == "" or (isinstance(item, float) and not math.isfinite(item)) else item for item in items]
    types = {type(item) for item in given} - {type(None)}
    if name in WHOLE or types == {int}:
        return pa.array([None if item is None else int(item) for item in given], pa.int64())
    if types == {bool}:
        return pa.array(given, pa.bool_())
    return pa.array([item or None for item in texts(values)], pa.string())
