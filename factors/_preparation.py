"""Compilation and loading of kernels during a run: callbacks and times.

This module does not import numba, so that a command can register a callback before any import.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_LISTENERS: list[Callable[[str], None]] = []


class _Spent:
    """Seconds spent by this process, and depth of nested preparations."""

    seconds: float = 0.0
    depth: int = 0


def report_compilation(name: str) -> None:
    """Call all registered listeners: this kernel is compiled now, because it is not on disk."""
    for listener in _LISTENERS:
        listener(name)


@contextmanager
def on_compilation(listener: Callable[[str], None]) -> Iterator[None]:
    """Call ``listener`` with the name of each kernel compiled inside the context."""
    _LISTENERS.append(listener)
    try:
        yield
    finally:
        _LISTENERS.remove(listener)


@contextmanager
def preparing() -> Iterator[None]:
    """Measure the time of the context; one thread at a time.

    The garbage collector is disabled, because the compiler makes a million permanent objects. Garbage
    collections would visit all of them again and again, which takes a fifth of the time.
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
    """Return the seconds that this process has spent on compiling and loading kernels."""
    return _Spent.seconds


def working_clock() -> float:
    """Return the seconds of a clock that stops while kernels are compiled or loaded."""
    return time.perf_counter() - _Spent.seconds
