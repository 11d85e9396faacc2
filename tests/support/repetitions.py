"""The first repetitions of a test run with every change, the others with ``make test-slow``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def some_slow(values: Iterable[Any], fast: int = 1) -> list[Any]:
    """Return the values of a parameter (tuples: of several), all but the first ones marked slow."""
    out: list[Any] = []
    for k, value in enumerate(values):
        given = value if isinstance(value, tuple) else (value,)
        out.append(pytest.param(*given, marks=() if k < fast else pytest.mark.slow))
    return out
