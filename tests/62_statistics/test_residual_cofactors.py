"""Cofactors of the residuals of every kind of observation agree with I - A N^-1 A^T as a full matrix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from factors.conditions.control import POINT
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.robust import weighted_problem
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.orientation.solution import Solution
from fg_orient.quality.covariance import gives_statistics
from fg_orient.quality.observation_groups import GroupedResiduals, groups_of
from fg_orient.quality.residuals import ResidualCofactors
from tests.support.frame_above import with_frame_above
from tests.support.full_statistics import Full, fixed, measured_twice, options, own_observations

#: Rounding of Q from normal equations whose scaled condition is some 1e4.
TOLERANCE = 1e-9


def assert_equal_to_full_matrix(solution: Solution) -> None:
    problem = solution.problem if solution.weights is None else weighted_problem(solution.problem, solution.weights)
    found = ResidualCofactors(problem, solution.state, solution.cofactors)
    full = Full.of(problem, solution.state)
    n, m = len(problem.observations), int(problem.observed.sum())
    for k in range(n):
        part = slice(2 * k, 2 * k + 2)
        assert found.image[k] == pytest.approx(full.residuals[part, part], abs=TOLERANCE)
    observed = np.flatnonzero(problem.observed)
    axes = problem.axes(problem.control_records[observed, POINT.place] + problem.origin_m)
    for k in range(m):
        part = slice(2 * n + 3 * k, 2 * n + 3 * k + 3)
        columns = problem.control_weights(observed[k]) @ axes[k].T  # errors of 1 m East, North, Up in whitened rows
        turn = columns / np.linalg.norm(columns, axis=0)
        assert found.control[k] == pytest.approx(turn.T @ full.residuals[part, part] @ turn, abs=TOLERANCE)
    rest = np.diag(full.residuals)[2 * n + 3 * m :]
    numbers = np.concatenate([found.prior, *found.extra])
    assert numbers == pytest.approx(rest, abs=TOLERANCE)
    assert found.redundancy_sum == pytest.approx(problem.redundancy, abs=1e-8 * len(full.v))
    effect = full.unknowns @ full.design.T
    for k, j in enumerate(problem.observations.point):
        expected = effect[full.problem.point_slice(j), 2 * k : 2 * k + 2] if problem.active[j] else np.zeros((3, 2))
        assert found.rays.response[k] == pytest.approx(expected, abs=TOLERANCE * 100.0)
        own = full.problem.image_slice(int(problem.observations.image[k]))
        moved = effect[own, 2 * k : 2 * k + 2]
        sizes = np.sqrt(np.einsum("ij,ij->j", moved, np.linalg.solve(full.unknowns[own, own], moved)))
        assert found.rays.on_image[k] == pytest.approx(sizes, abs=1e-7)


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "graph", "schur"])
def test_every_backend(grid: Block, backend: str) -> None:
    assert_equal_to_full_matrix(fg.adjust(measured_twice(fixed(grid, 3), 9), backend=backend))


@pytest.mark.oracle
def test_summed_system(grid: Block) -> None:
    assert_equal_to_full_matrix(fg.adjust(fixed(grid, 3), parts=2))


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "graph"])
def test_own_observations(grid: Block, backend: str) -> None:
    assert_equal_to_full_matrix(fg.adjust(own_observations(fixed(grid, 3)), backend=backend))


@pytest.mark.oracle
@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_weights_of_a_loss(grid: Block, loss: str) -> None:
    assert_equal_to_full_matrix(fg.adjust(grid, loss=loss))


@pytest.mark.oracle
def test_without_priors(grid: Block) -> None:
    assert_equal_to_full_matrix(fg.adjust(options(grid, eop_set=2), priors=False))


@pytest.mark.oracle
def test_fixed_points_only(grid: Block) -> None:
    control = np.isin(grid.observations.point, grid.points.where(Role.CONTROL))
    only = replace(fixed(grid, 100), observations=grid.observations.take(control))
    assert_equal_to_full_matrix(fg.adjust(only))


@pytest.mark.oracle
def test_images_of_different_kinds(twin: Block) -> None:
    """With a frame camera above a pushbroom pair, cofactors of residuals equal the full matrix.

    It has another equation, and 6 unknowns instead of 12.
    """
    assert_equal_to_full_matrix(fg.adjust(with_frame_above(options(twin, eop_set=16))))


@pytest.mark.oracle
def test_shared_priors_and_their_variance_component(twin: Block) -> None:
    """A look polynomial of both images has one prior in redundancy numbers and variance component.

    The full matrices contain its columns and prior rows once.
    """
    block = options(twin, eop_set=4, look_polynomial=1, look_shared=True, variance_components=())
    solution = fg.adjust(block, backend="schur")
    problem, n = solution.problem, 2 * len(solution.problem.observations)
    assert problem.ties is not None
    v, wide = assemble(problem, solution.state)
    design = problem.ties.columns(wide)
    u, _, _ = np.linalg.svd(design / np.linalg.norm(design, axis=0), full_matrices=False)
    full = np.eye(len(v)) - u @ u.T
    found = ResidualCofactors(problem, solution.state, solution.cofactors)
    at = n + 3 * int(problem.observed.sum())
    assert found.prior == pytest.approx(np.diag(full)[at:], abs=TOLERANCE)
    assert found.redundancy_sum == pytest.approx(problem.redundancy, abs=1e-8 * len(v))
    names = np.array([name for p in problem.parameters for name in p.names])[problem.ties.place]
    look = at + np.flatnonzero(np.char.startswith(names, "psi"))
    assert len(look) == 4
    groups = groups_of(problem, ("image", "priors"))
    place = groups.names.index("prior look angles")
    q, r, count = GroupedResiduals(solution.residual_cofactors, groups).sums()
    assert (int(count[place]), r[place]) == (4, pytest.approx(np.diag(full)[look].sum(), abs=TOLERANCE))
    assert q[place] == pytest.approx(float(np.sum(v[look] ** 2)), rel=1e-12)
    parts = GroupedResiduals(solution.residual_cofactors, groups).parts
    assert parts is not None
    assert parts.shared[place, place] == pytest.approx(float(np.sum(full[np.ix_(look, look)] ** 2)), abs=TOLERANCE)


@pytest.mark.behaviour
def test_more_images_than_one_matrix_holds_have_statistics_by_default(
    grid: Block, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A block above the limit of one matrix has statistics by default if a factor gives the blocks of the inverse.

    GTSAM's marginals of each pair of images would take too long.
    """
    monkeypatch.setattr("fg_orient.adjustment.cofactors.WHOLE_LIMIT", 1)
    for solution, given in ((fg.adjust(grid), True), (fg.adjust(grid, priors=False, eop_set=1), False)):
        assert solution.cofactors is not None
        assert gives_statistics(solution.problem, solution.cofactors) is given


@pytest.mark.oracle
def test_any_division_gives_the_full_matrix(grid: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    solution = fg.adjust(grid, backend="schur")
    for chunk, limit in ((7, 6000), (1000, 1)):
        monkeypatch.setattr("fg_orient.adjustment.cofactors.CHUNK", chunk)
        monkeypatch.setattr("fg_orient.adjustment.cofactors.WHOLE_LIMIT", limit)
        assert_equal_to_full_matrix(solution)
