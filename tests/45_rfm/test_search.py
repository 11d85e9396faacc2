"""Genetic and particle-swarm searches find the best of all subsets; the tests check refits, seeds and budgets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from fg_orient.rpc.estimate import linear_system
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.points import ControlPoints, Scaling
from fg_orient.rpc.search import genetic, left_out_squares, particle_swarm
from fg_orient.rpc.select import Reduced, Selection, fit_selected

Make = Callable[..., ControlPoints]
Search = Callable[[Reduced], Selection]
SEARCHES = [genetic, particle_swarm]


@pytest.mark.oracle
def test_errors_at_points_left_out_are_those_of_refits(make: Make) -> None:
    """``left_out_squares`` equals numpy's refits of the linear system without both rows of each point."""
    points, form = make(40, noise_px=0.5), RfmForm(2)
    reduced, chosen = Reduced.of(points, form), np.array([1, 4, 7])
    a, observed = linear_system(points, form, Scaling.of(points)).require_design("test")
    columns = np.sort(np.concatenate([reduced.always, reduced.unknowns[chosen]]))
    total, n = 0.0, len(points)
    for k in range(n):
        out = np.isin(np.arange(2 * n), (k, k + n))
        x = np.linalg.lstsq(a[~out][:, columns], observed[~out], rcond=None)[0]
        total += float(np.sum((observed[out] - a[out][:, columns] @ x) ** 2))
    assert left_out_squares(reduced, chosen) == pytest.approx(total, rel=1e-7)


@pytest.mark.oracle
@pytest.mark.parametrize("search", SEARCHES)
def test_the_best_of_all_subsets_is_found(make: Make, search: Search) -> None:
    """Each search finds the best of 4096 subsets with 1500 trials, for five seeds."""
    reduced = Reduced.of(make(30, noise_px=20.0, seed=4), RfmForm(2, "one"))
    size = reduced.design.shape[1]
    every = [left_out_squares(reduced, np.flatnonzero(bits)) for bits in product((False, True), repeat=size)]
    assert size == 12 and np.partition(every, 1)[1] > min(every)
    for seed in range(5):
        found = search(replace(reduced, seed=seed, evaluations=1500)).chosen
        assert left_out_squares(reduced, found) == min(every)


@pytest.mark.behaviour
@pytest.mark.parametrize("search", SEARCHES)
def test_a_seed_repeats_a_search_and_the_budget_bounds_it(
    make: Make, search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    reduced = Reduced.of(make(40, noise_px=5.0), RfmForm(3))
    few = replace(reduced, evaluations=300)
    one, two = search(few), search(few)
    assert one.chosen.tolist() == two.chosen.tolist()
    calls = []

    def counted(*given: object) -> float:
        calls.append(given)
        return left_out_squares(*given)

    monkeypatch.setattr("fg_orient.rpc.search.left_out_squares", counted)
    search(few)
    assert len(calls) == 300


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["genetic", "particle_swarm"])
def test_few_points_leave_freedom(make: Make, name: str) -> None:
    """With 16 points a search keeps at most 14 coefficients beyond the affine part, and 10 degrees of freedom.

    Degree 3 has 70 such coefficients.
    """
    fit = fit_selected(make(16, noise_px=0.5), RfmForm(3), name, evaluations=400)
    assert len(fit.form) <= 8 + 14 and fit.redundancy >= 10 - 1e-9
