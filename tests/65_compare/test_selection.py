"""The tests check the words and lists that select EOP sets, solvers, backends and types."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import fg_orient as fg
from fg_orient.adjustment.linear.registry import solvers
from fg_orient.model.block import Block
from fg_orient.studies.comparison import selections as selection

pytestmark = pytest.mark.behaviour


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("1-20", tuple(range(1, 21))),
        ("5,13,PUA", (5, 13, 15)),
        (" pua , 2-4,3", (15, 2, 3, 4)),
        (range(1, 4), (1, 2, 3)),
        (["V", 20], (5, 20)),
        (7, (7,)),
    ],
)
def test_eop_sets(given: Any, expected: tuple[int, ...]) -> None:
    assert selection.eop_sets(given) == expected


def test_solvers() -> None:
    known = tuple(solvers())
    published = tuple(n for n, s in solvers().items() if s.published)
    assert selection.solver_names("all") == known
    assert selection.solver_names("published") == published
    assert set(published) < set(known)
    assert selection.solver_names("qr, svd,qr") == ("qr", "svd")
    assert selection.solver_names(["svd", "published"]) == ("svd", *published)


def test_backends_and_types_come_in_our_order() -> None:
    assert selection.backend_names("graph, faithful") == ("faithful", "graph")
    assert selection.types("2,1") == (1, 2)
    assert selection.types(2) == (2,)


@pytest.mark.parametrize(
    ("select", "given", "code"),
    [
        (selection.eop_sets, "21", "parameters.eop_set"),
        (selection.eop_sets, "0-3", "parameters.eop_set"),
        (selection.eop_sets, "XYZ", "parameters.eop_set"),
        (selection.eop_sets, "", "parameters.eop_set"),
        (selection.eop_sets, "5-3", "compare.nothing"),
        (selection.eop_sets, [], "compare.nothing"),
        (selection.solver_names, "gauss", "linear.solver"),
        (selection.solver_names, [], "compare.nothing"),
        (selection.backend_names, "sparse", "adjust.backend"),
        (selection.backend_names, [], "compare.nothing"),
        (selection.types, "3", "compare.type"),
        (selection.types, [], "compare.nothing"),
    ],
)
def test_what_does_not_exist_is_refused(select: Callable[[Any], Any], given: Any, code: str) -> None:
    with pytest.raises(fg.InputError) as caught:
        select(given)
    assert [p.code for p in caught.value.problems] == [code]


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_time_limit_is_a_time(twin: Block, limit: float) -> None:
    with pytest.raises(fg.InputError) as caught:
        fg.compare(twin, time_limit_s=limit)
    assert caught.value.problems[0].code == "compare.time_limit"


@pytest.mark.parametrize("target", [0.0, -1.0, float("nan"), float("inf")])
def test_target_is_a_length(twin: Block, target: float) -> None:
    with pytest.raises(fg.InputError) as caught:
        fg.compare(twin, target_m=target)
    assert caught.value.problems[0].code == "compare.target"
