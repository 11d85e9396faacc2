"""Compiling and loading of kernels, as a run sees it: who is told of it, and how long it takes.

A module without numba, so that a command can ask to be told before anything is imported.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_LISTENERS: list[Callable[[str], None]] = []


class _Spent:
    """Seconds of this process, and how many kernels are being prepared inside each other."""

    seconds: float = 0.0
    depth: int = 0


def tell(name: str) -> None:
    """A kernel is not on disk and is being compiled."""
    for listener in _LISTENERS:
        listener(name)


@contextmanager
def told_of_compilation(listener: Callable[[str], None]) -> Iterator[None]:
    """Call ``listener`` with the name of each kernel that is compiled inside the block."""
    _LISTENERS.append(listener)
    try:
        yield
    finally:
        _LISTENERS.remove(listener)


@contextmanager
def preparing() -> Iterator[None]:
    """Count the time of a block; one thread at a time.

    The garbage collector rests: the compiler makes a million objects that live on, and walking over them again and
    again takes a fifth of its time.
    """
    begin, collects = time.perf_counter(), gc.isenabled()
    _Spent.depth += 1
    gc.disable()
    try:
        yield
    finally:
        _Spent.depth -= 1
        if _Spent.depth == 0:
            _Spent.seconds += time.perf_counter() - begin
        if collects:
            gc.enable()


def preparing_seconds() -> float:
    """Seconds that this process has spent on compiling and loading kernels."""
    return _Spent.seconds


def working_clock() -> float:
    """Seconds on a clock that stands still while kernels are compiled or loaded."""
    return time.perf_counter() - _Spent.seconds
