"""Compilation with numba at the first call, with a cache on disk that is checked against all sources.

numba alone reuses compiled code from disk as long as the function's own file is unchanged. This is not
sufficient, because a kernel also contains code from other files. Here compiled code is reused only if all
sources compiled into it are unchanged (``factors._sources``). If no folder is writable, kernels are compiled
again in each run.

Each function states whether products and sums may fuse and whether it is inlined into its caller. A
function without these options would take the options of the caller that is compiled first. The last
bits of its result would then depend on that caller.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba.core import config

from factors._kernel import Kernel

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile with numba: cached, without fast-math; division by zero gives inf, which is refused later."""
    return _kernel(function, fastmath=False, forceinline=False)


def inlined(function: F) -> F:
    """Compile as :func:`compiled`, and always inline.

    A loop that calls the function can then become vector instructions.
    """
    return _kernel(function, fastmath=False, forceinline=True)


def exact(function: F) -> F:
    """Compile for parallel threads; loops over equations become vector instructions, no operations are fused."""
    return _kernel(function, nogil=True, fastmath=False, forceinline=False, vectorised=True)


def threaded(function: F) -> F:
    """Compile for parallel threads; products and sums may fuse, but sums keep their order."""
    return _kernel(function, nogil=True, fastmath={"contract"}, forceinline=False)


def cache_folder() -> Path | None:
    """Return the folder of this package's compiled kernels; None if no folder is writable."""
    opened = _nothing.open_cache() if isinstance(_nothing, Kernel) else None
    return None if opened is None else Path(opened.cache_path)


def _kernel(function: F, *, fastmath: Any, forceinline: bool, nogil: bool = False, vectorised: bool = False) -> F:
    if config.DISABLE_JIT:  # with NUMBA_DISABLE_JIT kernels are plain Python
        return function
    options = {"nopython": True, "error_model": "numpy", "boundscheck": None, "fastmath": fastmath,
               "forceinline": forceinline, "nogil": nogil}  # fmt: skip
    return cast(F, Kernel(function, vectorised, targetoptions=options))


@compiled
def _nothing() -> None:
    """Do nothing. :func:`cache_folder` asks this kernel for its folder."""
