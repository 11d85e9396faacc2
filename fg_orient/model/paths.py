"""Paths that no file can have, or that no record can contain."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from fg_orient.model.errors import Finding, InputError, finding

#: Longest name of a file or folder on the usual file systems, and longest path of Linux, bytes.
LONGEST_NAME: Final = 255
LONGEST_PATH: Final = 4095


def path_fault(path: str | os.PathLike[str]) -> Finding | None:
    """Return the reason why a path cannot be used; None if it can be used or is only missing.

    For such a path, functions of ``pathlib`` raise ValueError or OSError instead of reporting
    that the file is missing. Records and messages are UTF-8, which cannot contain other bytes.
    """
    text = os.fspath(path)
    if "\0" in text:
        return finding("path.nul", file=text)
    try:
        whole = len(text.encode("utf-8"))
    except UnicodeEncodeError:
        return finding("path.encoding", file=text)
    size = max((len(part.encode("utf-8")) for part in Path(text).parts), default=0)
    if size > LONGEST_NAME:
        return finding("path.long_name", file=text, value=f"{size} bytes", limit=LONGEST_NAME)
    if whole > LONGEST_PATH:
        return finding("path.long", file=text, value=f"{whole} bytes", limit=LONGEST_PATH)
    return None


def require_path(path: str | os.PathLike[str]) -> None:
    """Raise InputError for a path that no file can have; see :func:`path_fault`."""
    fault = path_fault(path)
    if fault is not None:
        raise InputError(fault)
