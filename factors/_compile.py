"""Compilation with numba, and cached code that knows what it was made of.

numba keeps compiled code beside the source and uses it as long as that one file is unchanged. What a function calls is
compiled into it, so that a change in another file would go unnoticed, and numbers would be those of the old one: after
an update, or while somebody works on a kernel. Here the stamp of a function is that of its file and of all files of
this package that it imports, directly or not.

Whether products and sums may fuse, and whether a function is put into its caller, is said for each one: numba lets a
function that says nothing take it from whatever caller is compiled first, and its last bits would depend on that.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final, TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])

_HERE: Final = Path(__file__).parent
#: ``from factors import a, b``, also over several lines, and ``from factors.a import ...``.
_IMPORT: Final = re.compile(rf"^from {_HERE.name}(?:\.([\w.]+) import|\s+import\s+(\([^)]*\)|[^\n]*))", re.MULTILINE)


def compiled(function: F) -> F:
    """Compile with numba: cached, no fast-math, division by zero gives inf (then refused)."""
    return _stamped(njit(cache=True, error_model="numpy", fastmath=False, forceinline=False)(function), function)


def inlined(function: F) -> F:
    """As :func:`compiled`, and always put into its caller: a loop that calls it can become vector instructions."""
    return _stamped(njit(cache=True, error_model="numpy", fastmath=False, forceinline=True)(function), function)


def exact(function: F) -> F:
    """Compile so that threads run side by side; no products and sums are fused."""
    options = njit(cache=True, error_model="numpy", nogil=True, fastmath=False, forceinline=False)
    return _stamped(options(function), function)


def threaded(function: F) -> F:
    """Compile so that threads run side by side; products and sums may fuse, sums keep their order."""
    options = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"}, forceinline=False)
    return _stamped(options(function), function)


def stamp(file: Path) -> bytes:
    """Digest of a source file and of all files of this package that it imports, directly or not."""
    seen, waiting = {file}, [file]
    while waiting:
        new = _imported(waiting.pop()) - seen
        seen |= new
        waiting += new
    return hashlib.sha256(b"".join(_digest(path) for path in sorted(seen))).digest()


@cache
def _digest(file: Path) -> bytes:
    return hashlib.sha256(file.read_bytes()).digest()


@cache
def _imported(file: Path) -> frozenset[Path]:
    """Files of this package that one file imports by name."""
    found: set[Path] = set()
    for module, names in _IMPORT.findall(file.read_text(encoding="utf-8")):
        for name in [module] if module else re.findall(r"\w+", names):
            path = _HERE.joinpath(*name.split(".")).with_suffix(".py")
            found |= {path} if path.is_file() else set()
    return frozenset(found)


def _stamped(dispatcher: Any, function: F) -> F:
    """Let cached code of the function be valid for :func:`stamp` of its file."""
    file = Path(function.__code__.co_filename)
    kept: Any = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)  # numba has no public way
    if file.is_file() and hasattr(kept, "_source_stamp"):
        kept._source_stamp = stamp(file)
    return cast(F, dispatcher)
