"""A contradictory point gets the position with the least truncated cost of all subsets of its rays."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

import fg_orient as fg
from fg_orient.adjustment.best_rays import MOST, with_best_rays
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.robust import CONTROL, IMAGE, inlier_limit
from fg_orient.adjustment.rows import residuals
from fg_orient.model.block import Block
from fg_orient.simulate.block import BlockOptions, grid_block

Array = np.ndarray[Any, np.dtype[np.float64]]
LIMITS = (inlier_limit(0.99, IMAGE), inlier_limit(0.99, CONTROL))


def solved(seed: int) -> tuple[Block, Problem, State, Array]:
    """Return the clean block and its solution, and a problem.

    The problem is the block with errors of 5 to 50 px in a tenth of all rays as a problem.
    """
    block, _ = grid_block(BlockOptions(rows=2, columns=3, points=150, control_share=0.2, check_share=0.0, seed=seed))
    clean, o, rng = fg.adjust(block), block.observations, np.random.default_rng(seed)
    bad = rng.random(len(o)) < 0.1
    size, angle = np.where(bad, rng.uniform(5.0, 50.0, len(o)), 0.0), rng.uniform(0.0, 2.0 * np.pi, len(o))
    moved = replace(o, line=o.line + size * np.cos(angle), sample=o.sample + size * np.sin(angle))
    wrong = replace(block, observations=moved)
    return wrong, compile_problem(wrong), clean.state, bad


def cost(problem: Problem, state: State, j: int) -> float:
    """Return the truncated cost of a point, from all residuals."""
    rows = problem.observations.point == j
    total = float(np.minimum(np.sum(residuals(problem, state)[rows] ** 2, axis=1), LIMITS[0] ** 2).sum())
    if problem.observed[j]:
        total += min(float(np.sum(problem.control_residuals(state, np.array([j])) ** 2)), LIMITS[1] ** 2)
    return total


def at(problem: Problem, state: State, j: int, place: Array) -> State:
    ground = state.ground.copy()
    ground[j] = place
    return State(state.image, ground)


@pytest.mark.slow
@pytest.mark.oracle
def test_no_subset_of_rays_gives_a_smaller_cost() -> None:
    """No subset of two or more rays gives a doubtful point a smaller cost, by scipy.

    Each subset has its least-squares position.
    """
    _, problem, state, _ = solved(1)
    o = problem.observations
    rays = np.bincount(o.point, minlength=len(problem.active))
    far = np.sum(residuals(problem, state) ** 2, axis=1) > LIMITS[0] ** 2
    doubtful = [j for j in np.unique(o.point[far]).tolist() if problem.active[j] and 3 <= rays[j] <= MOST]
    assert len(doubtful) > 20
    start = replace(state, ground=state.ground + np.array([3.0, -2.0, 8.0]))  # positions that no ray supports
    found = with_best_rays(problem, start, LIMITS)
    for j in doubtful[:6]:
        rows = np.flatnonzero(o.point == j)
        best = np.inf
        for size in range(2, len(rows) + 1):
            for some in combinations(rows.tolist(), size):
                end = least_squares(
                    lambda x, j=j, some=some: residuals(problem, at(problem, state, j, x))[list(some)].ravel(),
                    state.ground[j], method="lm",
                )  # fmt: skip
                best = min(best, cost(problem, at(problem, state, j, end.x), j))
        assert cost(problem, found, j) <= best + 0.05 * LIMITS[0] ** 2


@pytest.mark.behaviour
def test_points_without_contradiction_stay() -> None:
    """Only points with a ray beyond the limit move: most of the third that is 9 m off, and no image."""
    _, problem, state, _ = solved(2)
    off = np.arange(len(state.ground)) % 3 == 0
    start = replace(state, ground=state.ground + np.where(off[:, None], [3.0, -2.0, 8.0], 0.0))
    found = with_best_rays(problem, start, LIMITS)
    moved = np.flatnonzero(np.abs(found.ground - start.ground).max(axis=1) > 0.0)
    far = np.sum(residuals(problem, start) ** 2, axis=1) > LIMITS[0] ** 2
    contradicted = np.unique(problem.observations.point[far])
    assert np.isin(moved, contradicted).all() and np.isin(moved, np.flatnonzero(problem.active)).all()
    assert np.sum(off[moved]) > 25 and len(contradicted) < 100 < len(start.ground)
    assert np.array_equal(found.image, start.image)


@pytest.mark.truth
@pytest.mark.parametrize("options", [{"loss": "tls", "gnc": True}])
def test_right_rays_outlive_wrong_ones(options: dict[str, Any]) -> None:
    """97 % of the points with at least three right rays keep all of these, or all but one."""
    kept = points = 0
    for seed in range(4):
        block, _, _, bad = solved(seed)
        solution = fg.adjust(block, **options)
        o = solution.problem.observations
        assert solution.weights is not None
        right, wrong = (np.bincount(o.point[m], minlength=len(solution.problem.active)) for m in (~bad, bad))
        of_many = solution.problem.active & (right >= 3) & (wrong > 0)
        full = np.bincount(o.point[~bad & (solution.weights.image > 0.5)], minlength=len(of_many))
        points, kept = points + int(of_many.sum()), kept + int((of_many & (full >= right - 1)).sum())
    assert points > 40 and kept >= 0.97 * points, (kept, points)
