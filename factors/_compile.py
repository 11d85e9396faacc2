"""Compilation with numba: at the first call, with a cache on disk that is checked against all sources.

numba uses compiled code on disk as long as the file of the function is unchanged. Here it is used only while everything
that was compiled into it is unchanged (``factors._sources``). If no folder can be written, kernels are compiled for the
run only.

Each function states whether products and sums may fuse and whether it is inlined into its caller. A function without
these options would take them from the caller that is compiled first, and its last bits would depend on that caller.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba.core import config

from factors._kernel import Kernel

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile with numba: cached, no fast-math, division by zero gives inf (then refused)."""
    return _kernel(function, fastmath=False, forceinline=False)


def inlined(function: F) -> F:
    """As :func:`compiled`, and always inlined into its caller: a loop that calls it can become vector instructions."""
    return _kernel(function, fastmath=False, forceinline=True)


def exact(function: F) -> F:
    """Compile for parallel threads; loops over equations become vector instructions, nothing is fused."""
    return _kernel(function, nogil=True, fastmath=False, forceinline=False, vectorised=True)


def threaded(function: F) -> F:
    """Compile for parallel threads; products and sums may fuse, sums keep their order."""
    return _kernel(function, nogil=True, fastmath={"contract"}, forceinline=False)


def cache_folder() -> Path | None:
    """Folder of the compiled kernels of this package, or None if no folder is writable."""
    opened = _nothing.open_cache() if isinstance(_nothing, Kernel) else None
    return None if opened is None else Path(opened.cache_path)


def _kernel(function: F, *, fastmath: Any, forceinline: bool, nogil: bool = False, vectorised: bool = False) -> F:
    if config.DISABLE_JIT:  # NUMBA_DISABLE_JIT: plain Python
        return function
    options = {"nopython": True, "error_model": "numpy", "boundscheck": None, "fastmath": fastmath,
               "forceinline": forceinline, "nogil": nogil}  # fmt: skip
    return cast(F, Kernel(function, vectorised, targetoptions=options))


@compiled
def _nothing() -> None:
    """Empty kernel, from which :func:`cache_folder` gets the folder."""
