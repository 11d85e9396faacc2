"""Memory of this machine: available memory, freed memory, and garbage collection during an adjustment.

Effort is measured as processor time and rise of the resident memory (:func:`measured`).

Two properties of memory slow an adjustment. First, a graph of thousands of factors produces no garbage, but
each garbage collection takes 7 us per factor. Second, each elimination of a graph frees megabytes of small
blocks. By default glibc returns memory to the system as soon as 128 KiB at the end of its heap are
free. In the next iteration it requests this memory again, page by page. Without :func:`calm_memory` an
elimination of 3 000 image points takes twice as long, and the cost per image point differs between
small and large blocks (measured with benchmarks/graph_cost.py).
"""

from __future__ import annotations

import ctypes
import errno
import gc
import math
import mmap
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final

#: Default limit as a share of the available memory.
SHARE: Final = 0.8
GB: Final = 1e9
#: A control group is unlimited if its limit is a word, or a number above this one.
_UNLIMITED: Final = 2**62
_MEMINFO: Final = Path("/proc/meminfo")
_GROUPS: Final = Path("/sys/fs/cgroup")
_OWN_GROUPS: Final = Path("/proc/self/cgroup")


def in_gb(n_bytes: float) -> str:
    """Return the text of a number of bytes, in GB."""
    return f"{n_bytes / GB:.3g} GB"


def allowed_bytes(limit_gb: float | None) -> int | None:
    """Return the given limit, or 80 % of the available memory; None if that is unknown."""
    if limit_gb is not None:
        return int(limit_gb * GB)
    available = available_bytes()
    return None if available is None else int(SHARE * available)


def available_bytes() -> int | None:
    """Return the memory that this process can still allocate, by system, control groups and limit of addresses."""
    return min([*_of_system(), *_of_group(), *_of_addresses()], default=None)


def is_out_of_memory(error: BaseException | None) -> bool:
    """Return whether an exception, or one of its causes, reports that memory could not be allocated."""
    while error is not None:
        words = str(error)
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
            return True
        if any(sign in words for sign in ("annot allocate memory", "bad_alloc", "can't start new thread",
                                          "failed to map segment")):  # fmt: skip
            return True
        # in a process with limited memory, compiled code that gets no memory may return NULL without an exception
        if isinstance(error, SystemError) and _has_address_limit():
            return True
        error = error.__cause__ or error.__context__
    return False


def _has_address_limit() -> bool:
    """Return whether the system limits the address space of this process (``ulimit -v``)."""
    if find_spec("resource") is None:  # Windows
        return False
    import resource

    return resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY


#: Address space that OpenBLAS takes for the work of a thread, bytes: 32 MiB and two pages (strace, 0.3.30).
BLAS_BYTES: Final = 40_000_000
#: Minimum address space that a run needs at its beginning for libraries and the compilation of kernels, bytes. LLVM
#: ends the process if it does not get memory.
START_BYTES: Final = 200_000_000
#: Number of rows of a product for which OpenBLAS needs this address space.
_BLAS_ROWS: Final = 160


@cache
def reserve_blas() -> None:
    """Let numpy's and scipy's OpenBLAS take their work space now, in a process whose address space is limited.

    OpenBLAS keeps this space. If OpenBLAS needs the space later and none is available, it repeats its
    request without end (``blas_memory_alloc``). For example, a run with 600 MB did not end its Cholesky
    factorisation of the normal equations.

    Raises
    ------
    MemoryError
        There is no such work space, or less than ``START_BYTES``.
    """
    if not _has_address_limit():
        return
    import numpy as np
    from scipy.linalg import blas

    square = np.zeros((_BLAS_ROWS, _BLAS_ROWS), order="F")
    products: tuple[Callable[[], object], ...] = (lambda: square @ square, lambda: blas.dgemm(1.0, square, square))
    for product, needed in zip(products, (START_BYTES, BLAS_BYTES), strict=True):
        try:
            mmap.mmap(-1, needed).close()
        except OSError as error:
            raise MemoryError("no address space for linear algebra and compilation") from error
        product()


def _of_system() -> Iterator[int]:
    """Yield the available memory, bytes: ``MemAvailable`` on Linux, free pages on other systems."""
    try:
        rows = dict(line.split(":", 1) for line in _MEMINFO.read_text("ascii").splitlines() if ":" in line)
        yield 1024 * int(rows["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        names = getattr(os, "sysconf_names", {})
        if "SC_AVPHYS_PAGES" in names and "SC_PAGE_SIZE" in names:
            yield os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _of_group() -> Iterator[int]:
    """Yield the free memory, bytes, of each control group of this process, including reclaimable file memory."""
    for limit, usage, reclaimable, folder in _group_files():
        try:
            most, used = (int((folder / name).read_text("ascii")) for name in (limit, usage))
        except (OSError, ValueError):
            continue
        free = 0
        with suppress(OSError, ValueError):
            lines = (folder / "memory.stat").read_text("ascii").splitlines()
            free = sum(int(line.split()[1]) for line in lines if line.startswith(f"{reclaimable} "))
        if most < _UNLIMITED:
            yield max(most - used + free, 0)


def _of_addresses() -> Iterator[int]:
    """Yield the free address space of a process with a limit (``ulimit -v``)."""
    if _has_address_limit():
        import resource

        with suppress(OSError, StopIteration):
            yield max(resource.getrlimit(resource.RLIMIT_AS)[0] - status_bytes("VmSize"), 0)


def _group_files() -> Iterator[tuple[str, str, str, Path]]:
    """Yield file names (limit, use, reclaimable part) and folder of this process's control group and its parents."""
    two = ("memory.max", "memory.current", "inactive_file")
    one = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
    try:
        groups = _OWN_GROUPS.read_text("ascii").split()
    except (OSError, ValueError):
        groups = []
    for group in [*groups, "0::/", "1:memory:/"]:
        _, controllers, place = group.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        root = _GROUPS / "memory" if controllers else _GROUPS
        own = root / place.lstrip("/")
        for folder in (own, *own.parents):
            if folder.is_relative_to(root):
                yield (*(one if controllers else two), folder)


# --- freed memory ---------------------------------------------------------------------------------

#: Parameters of glibc's ``mallopt`` (malloc.h).
M_TRIM_THRESHOLD: Final = -1
M_MMAP_THRESHOLD: Final = -3
#: Free bytes that glibc keeps at the end of its heap. Without this setting the limit is 64
#: MiB for a process with large arrays.
KEPT_BYTES: Final = 256 << 20
#: Memory is returned to the system only after work on more rows than this; for fewer rows it takes too much time.
MANY_ROWS: Final = 100_000
VERY_MANY_ROWS: Final = 500_000
#: Blocks of this size and above come directly from the system. It is the upper limit of glibc's adaptive
#: rule; setting any value disables this rule.
OWN_MAPPING_BYTES: Final = 32 << 20


@cache
def keep_freed_memory() -> bool:
    """Let glibc keep up to `KEPT_BYTES` of freed memory until the process ends.

    Return whether the allocator accepts it; False for other C libraries (musl, macOS, Windows).
    """
    if not sys.platform.startswith("linux"):
        return False
    library = ctypes.CDLL(None)
    if not (hasattr(library, "gnu_get_libc_version") and hasattr(library, "mallopt")):
        return False
    kept = library.mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
    return bool(kept and library.mallopt(M_MMAP_THRESHOLD, OWN_MAPPING_BYTES))


def return_memory(rows: int) -> None:
    """Return freed memory to the system after work on many rows.

    After very many rows, also free objects that refer to each other, which takes 0.1 s.
    """
    if rows < MANY_ROWS:
        return
    if rows >= VERY_MANY_ROWS:
        gc.collect()
    _trim()


def _trim() -> None:
    if sys.platform.startswith("linux") and hasattr(ctypes.CDLL(None), "malloc_trim"):  # glibc
        ctypes.CDLL(None).malloc_trim(0)


@contextmanager
def calm_memory() -> Iterator[None]:
    """Prevent garbage collection inside the context, and keep freed memory for the next iteration."""
    keep_freed_memory()
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


# --- effort ---------------------------------------------------------------------------------------

_STATUS: Final = Path("/proc/self/status")
_CLEAR: Final = Path("/proc/self/clear_refs")


def status_bytes(name: str) -> int:
    """Return a value of /proc/self/status in bytes (VmRSS, VmHWM); raise OSError if the system has no such file."""
    line = next(line for line in _STATUS.read_text("ascii").splitlines() if line.startswith(f"{name}:"))
    return int(line.split()[1]) * 1024


def reset_peak() -> None:
    """Reset VmHWM to the present size; raise OSError if this is not possible."""
    _CLEAR.write_text("5", "ascii")


def release() -> None:
    """Collect garbage and return freed memory to the system."""
    gc.collect()
    _trim()


@dataclass
class Effort:
    """Effort of a piece of work: processor seconds of all threads, and rise of the resident memory, bytes.

    ``peak_bytes`` is nan if the system does not report it. A rise of less than a few pages is noise.
    """

    processor_s: float = math.nan
    peak_bytes: float = math.nan


@contextmanager
def measured() -> Iterator[Effort]:
    """Measure the work inside the context; the values are available at its end.

    Garbage is not collected, because that takes 0.1 s.
    """
    effort, before = Effort(), math.nan
    _trim()
    with suppress(OSError, StopIteration):
        reset_peak()
        before = float(status_bytes("VmRSS"))
    start = time.process_time()
    yield effort
    effort.processor_s = time.process_time() - start
    with suppress(OSError, StopIteration):
        effort.peak_bytes = max(status_bytes("VmHWM") - before, 0.0)


def processor_name() -> str:
    """Return the name of the processor, as the system reports it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        lines = []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()
