"""Work is measured in calls of functions, which does not depend on the speed of the machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Calls:
    """The number of functions, of Python or compiled, that this thread has called so far."""

    def __init__(self) -> None:
        self.count = 0

    def tick(self, frame: Any, event: str, argument: Any) -> None:
        """Count, as the interpreter's profiler; calls only, not their ends."""
        if event in ("call", "c_call"):
            self.count += 1


@contextmanager
def counted() -> Iterator[Calls]:
    """Count the calls inside."""
    calls, before = Calls(), sys.getprofile()
    sys.setprofile(calls.tick)
    try:
        yield calls
    finally:
        sys.setprofile(before)
