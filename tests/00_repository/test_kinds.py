"""Each test states its kind once, and the shares are counted by function."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from tests.support import kinds

pytestmark = pytest.mark.repository


def item(nodeid: str, *names: str) -> Any:
    return SimpleNamespace(nodeid=nodeid, iter_markers=lambda: [SimpleNamespace(name=name) for name in names])


def test_parameters_of_a_function_count_once() -> None:
    numbers = kinds.counted([
        item("a.py::test_x[1]", "parametrize", "oracle"), item("a.py::test_x[2]", "parametrize", "oracle"),
        item("a.py::test_y", "truth", "slow"), item("b.py::test_x", "behaviour"), item("b.py::test_z", "behaviour"),
    ])  # fmt: skip
    assert kinds.sentence(numbers) == (
        "4 test functions: truth 25.0 %, oracle 25.0 %, consistency 0.0 %, behaviour 50.0 %, repository 0.0 %; "
        "truth or oracle 50.0 %"
    )


@pytest.mark.parametrize(("names", "has"), [(("slow",), "none"), (("truth", "oracle"), "truth and oracle")])
def test_a_test_without_its_kind_is_refused(names: tuple[str, ...], has: str) -> None:
    with pytest.raises(pytest.UsageError, match=f"a.py::test_x needs one marker of .*; it has {has}"):
        kinds.counted([item("a.py::test_x", *names)])
