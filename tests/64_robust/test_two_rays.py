"""If the data cannot show which of two rays is wrong, both have one weight under a loss."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm

import fg_orient as fg
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import DOWN, FLOOR, squares, together, two_ray_rows
from fg_orient.adjustment.rows import linearised
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.stages import Graduated
from fg_orient.model.block import Block
from fg_orient.simulate.block import BlockOptions, grid_block

Array = np.ndarray[Any, np.dtype[np.float64]]


def spoiled(seed: int, share: float) -> tuple[Block, Array, Array]:
    """Return a block with errors of 5 to 50 px in a share of all rays, the truth, and which rays are wrong."""
    block, truth = grid_block(BlockOptions(points=200, control_share=0.1, check_share=0.0, seed=seed))
    o, rng = block.observations, np.random.default_rng(seed)
    bad = rng.random(len(o)) < share
    size, angle = np.where(bad, rng.uniform(5.0, 50.0, len(o)), 0.0), rng.uniform(0.0, 2.0 * np.pi, len(o))
    moved = replace(o, line=o.line + size * np.cos(angle), sample=o.sample + size * np.sin(angle))
    return replace(block, observations=moved), truth.ecef_m, bad


def across(problem: Problem, state: State, pairs: Array) -> Array:
    """Return the directions (p, 3) across the plane of both rays of each point."""
    rays = [np.linalg.svd(linearised(problem, state, pairs[:, k]).ground)[2][:, 2] for k in (0, 1)]
    normal = np.cross(*rays)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


@pytest.mark.truth
@pytest.mark.parametrize("options", [{"loss": "tls", "gnc": True}, {"loss": "tukey", "max_iterations": 200}])
@pytest.mark.parametrize("share", [0.05, pytest.param(0.1, marks=pytest.mark.slow)])
def test_regions_of_points_with_two_rays_hold(options: dict[str, Any], share: float) -> None:
    """Confidence regions of points with two rays contain 95 %: across the rays of all, in space of good points.

    An error along the plane of the rays is not seen by any other observation.
    """
    beyond, n, outside, good = 0, 0, 0, 0
    for seed in range(6):
        block, true, bad = spoiled(seed, share)
        solution = fg.adjust(block, **options)
        problem = solution.problem
        pairs = two_ray_rows(problem)
        points = problem.observations.point[pairs[:, 0]]
        assert solution.cofactors is not None and solution.weights is not None
        assert np.array_equal(*solution.weights.image[pairs].T)
        q, away = solution.cofactors.points(points), solution.ground_m[points] - true[points]
        normal = across(problem, solution.state, pairs)
        own = np.einsum("pi,pi->p", normal, away) / np.sqrt(np.einsum("pi,pij,pj->p", normal, q, normal))
        beyond, n = beyond + int(np.sum(np.abs(own) > norm.ppf(0.975))), n + len(own)
        clean = ~bad[pairs].any(axis=1)
        nees = np.einsum("pi,pij,pj->p", away[clean], np.linalg.inv(q[clean]), away[clean])
        outside, good = outside + int(np.sum(nees > chi2.ppf(0.95, 3))), good + int(clean.sum())
    assert binom.ppf(0.001, n, 0.035) <= beyond <= binom.ppf(0.999, n, 0.065)
    assert binom.ppf(0.001, good, 0.035) <= outside <= binom.ppf(0.999, good, 0.065)


@pytest.mark.oracle
def test_pairs_are_those_of_a_count() -> None:
    """The pairs are those of all unknown points with two rays, in the order of problem and arrays."""
    block, _, _ = spoiled(1, 0.05)
    solution = fg.adjust(block, max_iterations=3)
    problem, backend = solution.problem, SchurBackend(solution.problem)
    expected = {
        tuple(rows) for j in np.flatnonzero(problem.active & ~problem.observed)
        if len(rows := np.flatnonzero(problem.observations.point == j).tolist()) == 2
    }  # fmt: skip
    assert expected and set(map(tuple, two_ray_rows(problem).tolist())) == expected
    in_arrays = backend.structure.row[backend.pairs]
    assert {tuple(sorted(pair)) for pair in in_arrays.tolist()} == expected
    assert together(np.array([1.0, 5.0, 3.0]), np.array([[0, 2]])).tolist() == [2.0, 5.0, 2.0]


@pytest.mark.truth
def test_an_error_along_the_plane_of_parallel_rays_costs_both() -> None:
    """Of two parallel rays an error across their plane rejects one, and an error along it rejects both.

    The point has two parallel pairs of rays.
    """
    block, _ = grid_block(BlockOptions(points=80, control_share=0.1, seed=4))
    clean, o = fg.adjust(block), block.observations
    lines = np.linalg.svd(linearised(clean.problem, clean.state).ground)[2][:, 2]
    point = int(np.flatnonzero(clean.problem.active & ~clean.problem.observed & (np.bincount(o.point) == 4))[0])
    rows = np.flatnonzero(o.point == point)
    parallel = np.abs(lines[rows] @ lines[rows[0]])
    pair, others = rows[parallel > 0.99], rows[parallel <= 0.99]
    assert len(pair) == 2
    along = linearised(clean.problem, clean.state, rows[:1]).ground[0] @ lines[others[0]]
    along /= np.linalg.norm(along)
    for direction, lost in ((along, pair), (np.array([-along[1], along[0]]), rows[:1])):
        line, sample = o.line.copy(), o.sample.copy()
        line[rows[0]], sample[rows[0]] = np.array([line[rows[0]], sample[rows[0]]]) + 6.0 * direction
        moved = fg.adjust(replace(block, observations=replace(o, line=line, sample=sample)), loss="tls", gnc=True)
        assert moved.weights is not None
        assert set(rows[moved.weights.image[rows] < DOWN].tolist()) == set(lost.tolist())
        assert moved.weights.image[lost] == pytest.approx(FLOOR, rel=1e-6)


@pytest.mark.slow
@pytest.mark.consistency
def test_rivals_are_the_same_on_all_backends() -> None:
    block, _, _ = spoiled(1, 0.1)
    options: dict[str, Any] = {"loss": "tls", "gnc": True}
    first = fg.adjust(block, backend="schur", **options)
    assert first.weights is not None
    image, control = squares(first.problem, first.state)
    assert np.any(first.weights.image < Graduated.of(first.block.options).robust(np.inf).weigh(image, control)[0] - 0.5)
    for more in ({"backend": "graph"}, {"backend": "dense"}, {"parts": 3, "workers": 1}):
        other = fg.adjust(block, **options, **more)
        assert other.weights is not None and np.array_equal(other.weights.image, first.weights.image)
        assert other.chi2 == pytest.approx(first.chi2, rel=1e-8)
        assert other.ground_m == pytest.approx(first.ground_m, abs=1e-3)
