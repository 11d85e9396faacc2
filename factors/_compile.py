"""Compilation with numba: each function when it is called, and kept on disk with what it was made of.

numba trusts compiled code on disk as long as the one file of a function is unchanged; here it is trusted as long as
nothing changed that was compiled into it (``factors._sources``). Where no folder can be written, kernels are compiled
for the run alone.

Whether products and sums may fuse, and whether a function is put into its caller, is said for each one: numba lets a
function that says nothing take it from whatever caller is compiled first, and its last bits would depend on that.
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
    """As :func:`compiled`, and always put into its caller: a loop that calls it can become vector instructions."""
    return _kernel(function, fastmath=False, forceinline=True)


def exact(function: F) -> F:
    """Compile so that threads run side by side and loops over equations become vectors; nothing is fused."""
    return _kernel(function, nogil=True, fastmath=False, forceinline=False, vectorised=True)


def threaded(function: F) -> F:
    """Compile so that threads run side by side; products and sums may fuse, sums keep their order."""
    return _kernel(function, nogil=True, fastmath={"contract"}, forceinline=False)


def cache_folder() -> Path | None:
    """Folder where compiled kernels of this package are kept, or None where no place is writable."""
    opened = _nothing.open_cache() if isinstance(_nothing, Kernel) else None
    return None if opened is None else Path(opened.cache_path)


def _kernel(
    function: F, *, fastmath: Any, forceinline: bool, nogil: bool = False, vectorised: bool = False
) -> F:  # fmt: skip
    if config.DISABLE_JIT:  # NUMBA_DISABLE_JIT: plain Python
        return function
    options = {"nopython": True, "error_model": "numpy", "boundscheck": None, "fastmath": fastmath,
               "forceinline": forceinline, "nogil": nogil}  # fmt: skip
    return cast(F, Kernel(function, vectorised, targetoptions=options))


@compiled
def _nothing() -> None:
    """Stands for all kernels of this package."""
