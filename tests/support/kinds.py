"""The kind of a test states where its expected value comes from; README.md of the tests defines the kinds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import pytest

KINDS = ("truth", "oracle", "consistency", "behaviour", "repository")
#: These kinds find an error that is common to all code of this project.
OUTSIDE = ("truth", "oracle")


def counted(items: Iterable[pytest.Item]) -> dict[str, int]:
    """Count the test functions of each kind; the parameters of a function count once.

    Raises
    ------
    pytest.UsageError
        A test has no kind, or more than one.
    """
    kinds = dict[str, str]()
    for item in items:
        found = [mark.name for mark in item.iter_markers() if mark.name in KINDS]
        if len(found) != 1:
            has = " and ".join(found) or "none"
            raise pytest.UsageError(f"{item.nodeid} needs one marker of {', '.join(KINDS)}; it has {has}")
        kinds[item.nodeid.partition("[")[0]] = found[0]
    numbers = Counter(kinds.values())
    return {kind: numbers[kind] for kind in KINDS}


def sentence(numbers: dict[str, int]) -> str:
    """Return the shares in one line."""
    total = sum(numbers.values())
    shares = ", ".join(f"{kind} {100 * n / total:.1f} %" for kind, n in numbers.items())
    outside = 100 * sum(numbers[kind] for kind in OUTSIDE) / total
    return f"{total} test functions: {shares}; truth or oracle {outside:.1f} %"
