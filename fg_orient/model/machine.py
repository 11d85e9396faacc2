"""Memory of this machine that a process can still allocate."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

#: Default limit as share of the available memory.
SHARE: Final = 0.8
GB: Final = 1e9
#: Limits of unlimited control groups are a word or above this.
_UNLIMITED: Final = 2**62
_MEMINFO: Final = Path("/proc/meminfo")
_GROUPS: Final = Path("/sys/fs/cgroup")
_OWN_GROUPS: Final = Path("/proc/self/cgroup")


def in_gb(n_bytes: float) -> str:
    """Text of a number of bytes in GB."""
    return f"{n_bytes / GB:.3g} GB"


def allowed_bytes(limit_gb: float | None) -> int | None:
    """The given limit, or 80 % of the available memory; None if unknown."""
    if limit_gb is not None:
        return int(limit_gb * GB)
    available = available_bytes()
    return None if available is None else int(SHARE * available)


def available_bytes() -> int | None:
    """Memory that this process can still allocate, by the system and the control groups."""
    return min([*_of_system(), *_of_group()], default=None)


def _of_system() -> Iterator[int]:
    """``MemAvailable`` of Linux; for other systems the free pages."""
    try:
        rows = dict(line.split(":", 1) for line in _MEMINFO.read_text("ascii").splitlines() if ":" in line)
        yield 1024 * int(rows["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        names = getattr(os, "sysconf_names", {})
        if "SC_AVPHYS_PAGES" in names and "SC_PAGE_SIZE" in names:
            yield os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _of_group() -> Iterator[int]:
    """Free memory in the control groups of this process (versions 2 and 1), including reclaimable file memory."""
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


def _group_files() -> Iterator[tuple[str, str, str, Path]]:
    """Names of limit, use and reclaimable part, and folder, from the group of this process up to the root."""
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
