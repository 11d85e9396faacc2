"""Limits of inputs: sizes, depths and memory above which a file is refused before its content is used.

Real files are far below all limits. ``FG_ORIENT_LIMITS`` of the environment changes them,
for files that the user trusts: ``FG_ORIENT_LIMITS="xml_bytes=500e6 memory_factor=100"``.
Each message names the limit that was exceeded.
"""

from __future__ import annotations

import errno
import os
import re
import stat
from functools import cache
from io import BufferedReader
from typing import Final

from fg_orient.model.digits import decimal
from fg_orient.model.errors import InputError
from fg_orient.model.machine import in_gb

#: Environment variable with other limits: NAME=NUMBER, separated by blanks or commas.
VARIABLE: Final = "FG_ORIENT_LIMITS"
#: Limits by name.
LIMITS: Final = {
    # Largest memory to read a file: memory_factor times its size plus memory_bytes. Files that need more are refused.
    "memory_factor": 20.0,
    "memory_bytes": 200e6,
    # Sizes of files, bytes.
    "toml_bytes": 16e6,
    "json_bytes": 1e9,
    "pvl_bytes": 1e9,
    "xml_bytes": 64.0 * 2**20,
    "rpc_bytes": 16.0 * 2**20,
    "sqlite_bytes": 8e9,
    "npz_bytes": 8e9,
    # Depth of nested tables, lists and elements; parts of a dotted key.
    "toml_depth": 64.0,
    "json_depth": 64.0,
    # Characters of a CRS: its code, PROJ string, WKT or PROJJSON.
    "crs_characters": 100e3,
    # Unpacked size, bytes, and cells of a workbook.
    "workbook_bytes": 256e6,
    "workbook_cells": 5e6,
    # Pixels of a raster; directories of a TIFF file: images, masks, overviews.
    "raster_pixels": 1e13,
    "tiff_directories": 10e3,
    # Columns of a Parquet or Arrow table.
    "table_columns": 10e3,
    # Steps of SQLite's virtual machine: for each query, and for each byte of the file.
    "sqlite_steps": 50e6,
    "sqlite_steps_per_byte": 50.0,
}


@cache
def _given(text: str) -> dict[str, float]:
    """Return the limits in the environment variable.

    Raise InputError for an unknown name or a value <= 0.
    """
    found = {}
    for word in re.split(r"[\s,]+", text.strip()):
        name, _, number = word.partition("=")
        if not word:
            continue
        try:
            value = decimal(number)
        except ValueError:
            value = 0.0
        if name not in LIMITS or not value > 0.0:
            raise InputError.of("limits.variable", place=VARIABLE, value=word, known=", ".join(LIMITS))
        found[name] = value
    return found


def open_input(path: str | os.PathLike[str]) -> BufferedReader:
    """Open a regular file for reading. A pipe or a device could give endless data, or no data.

    Raises
    ------
    OSError
        The file is missing, cannot be read, or is no regular file.
    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "it is a pipe, a device or a folder", os.fspath(path))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def limit(name: str) -> float:
    """Return the value of a limit, from the environment or from :data:`LIMITS`."""
    return _given(os.environ.get(VARIABLE, "")).get(name, LIMITS[name])


def within(name: str, value: float, *, file: object = "", place: object = "", unit: str = "bytes") -> None:
    """Raise InputError if a value exceeds a limit."""
    most = limit(name)
    if value > most:
        raise exceeded(name, f"{value:.0f} {unit}", file=file, place=place, unit=unit)


def exceeded(name: str, value: object, *, file: object = "", place: object = "", unit: str = "bytes") -> InputError:
    """Return the error for a value that exceeds a limit."""
    return InputError.of(
        "limits.exceeded", file=file, place=place, value=value, limit=f"{limit(name):.0f} {unit}", name=name
    )


def memory_for(size: float) -> float:
    """Return the memory, bytes, that reading a file of this size may use."""
    return limit("memory_factor") * size + limit("memory_bytes")


def within_memory(need: float, size: float, *, file: object, place: object = "") -> None:
    """Raise InputError if the memory to read a file of ``size`` bytes is too large for it."""
    allowed = memory_for(size)
    if need > allowed:
        raise InputError.of(
            "limits.memory",
            file=file,
            place=place,
            value=in_gb(need),
            allowed=in_gb(allowed),
            factor=limit("memory_factor"),
            more=in_gb(limit("memory_bytes")),
        )
