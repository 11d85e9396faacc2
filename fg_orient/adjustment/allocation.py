"""What Python's garbage collector and the C allocator need not do while an adjustment runs.

A graph of thousands of factors makes no garbage, but searching it costs 7 us for each factor at every turn of the
collector. And each elimination of a graph frees megabytes of small blocks: glibc gives the top of its heap back to
the system as soon as 128 KiB of it are free and takes it again, page by page, in the next iteration. Both measured
(benchmarks/graph_cost.py): without this module an elimination of 3 000 image points takes twice as long, and the
cost for each image point is not the same in small and large blocks.
"""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Final

#: Parameters of glibc's ``mallopt`` (malloc.h).
M_TRIM_THRESHOLD: Final = -1
M_MMAP_THRESHOLD: Final = -3
#: Free bytes at the top of the heap that are kept. glibc's own rule ends at 64 MiB for a process with large arrays.
KEPT_BYTES: Final = 256 << 20
#: Blocks from this size on come from the system itself: the end of glibc's own rule, which a fixed value switches off.
OWN_MAPPING_BYTES: Final = 32 << 20


@cache
def keep_freed_memory() -> bool:
    """Let glibc keep up to `KEPT_BYTES` of freed memory for the next iteration, for the rest of the process.

    Returns
    -------
    bool
        Whether the allocator took it; False where the C library is another one (musl, macOS, Windows).
    """
    if not sys.platform.startswith("linux"):
        return False
    library = ctypes.CDLL(None)
    if not (hasattr(library, "gnu_get_libc_version") and hasattr(library, "mallopt")):
        return False
    kept = library.mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
    return bool(kept and library.mallopt(M_MMAP_THRESHOLD, OWN_MAPPING_BYTES))


@contextmanager
def calm_memory() -> Iterator[None]:
    """No garbage collection inside, and freed memory is kept for the next iteration."""
    keep_freed_memory()
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
