"""The contributions of groups to cofactors agree with full matrices of all rows, point by point."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.block import Block
from fg_orient.orientation.solution import Solution
from fg_orient.quality import elimination
from fg_orient.quality.observation_groups import GroupedResiduals, groups_of
from fg_orient.quality.suspects import KINDS, suspects
from tests.support.frame_above import with_frame_above
from tests.support.full_statistics import fixed, measured_twice, options, own_observations, turned_design

#: Rounding of Q from normal equations whose scaled condition is some 1e4.
TOLERANCE = 1e-9
GROUPS = ("image_by_image", "position", "height", "priors")


@dataclass(frozen=True)
class Full:
    """R of all rows and ``H = N^-1 A^T`` of the image unknowns, control points in East, North, Up."""

    residuals: np.ndarray
    unknowns: np.ndarray

    @classmethod
    def of(cls, solution: Solution) -> Full:
        a = turned_design(solution.problem, solution.state)
        length = np.linalg.norm(a, axis=0)
        u, s, vt = np.linalg.svd(a / length, full_matrices=False)
        effect = vt.T / s @ u.T / length[:, None]
        return cls(np.eye(len(a)) - u @ u.T, effect[: solution.problem.n_free_unknowns])


def residuals_of(solution: Solution, groups: tuple[str, ...] = GROUPS) -> GroupedResiduals:
    return GroupedResiduals(solution.residual_cofactors, groups_of(solution.problem, groups))


def assert_equal_to_full_matrix(solution: Solution, groups: tuple[str, ...] = GROUPS) -> None:
    residuals, full = residuals_of(solution, groups), Full.of(solution)
    parts = residuals.parts
    assert parts is not None and len(residuals.labels) == len(full.residuals)
    r, select = full.residuals, np.eye(len(residuals.groups.names) + 1)[residuals.labels]
    assert select[:, :-1].any(axis=0).all()
    s = select.T @ r**2 @ select
    assert parts.shared == pytest.approx(s, abs=TOLERANCE * s.max())
    q = full.unknowns @ full.unknowns.T
    scale = np.sqrt(np.outer(np.diag(q), np.diag(q)))
    for j, own in enumerate(parts.parts):
        mine = full.unknowns * select[:, j] @ full.unknowns.T
        assert np.abs((own - mine) / scale).max() < TOLERANCE
    for kind in KINDS:
        for s in suspects(solution.residual_cofactors, kind):
            found = parts.shares(s.point, s.rows, s.columns)
            assert found.sum(axis=1)[s.quadratic()[1] > 0] == pytest.approx(1.0, abs=TOLERANCE)
            for k in range(0, len(found), 7):
                assert found[k] == pytest.approx(share(r, select, s.rows[k], s.columns[k]), abs=1e-7)


def share(r: np.ndarray, select: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the shares of all groups for one suspect."""
    effect = r[:, rows] @ columns
    own = np.linalg.pinv(columns.T @ effect[rows], rcond=1e-6, hermitian=True)
    rank = np.linalg.matrix_rank(own, tol=1e-9 * np.abs(own).max(), hermitian=True)
    return np.einsum("na,ab,nb,ng->g", effect, own, effect, select, optimize=True) / max(rank, 1)


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "graph", "schur"])
def test_every_backend(grid: Block, backend: str) -> None:
    assert_equal_to_full_matrix(fg.adjust(measured_twice(fixed(grid, 3), 9), backend=backend))


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "graph"])
def test_points_that_own_observations_name(grid: Block, backend: str) -> None:
    assert_equal_to_full_matrix(fg.adjust(own_observations(fixed(grid, 3)), backend=backend))


@pytest.mark.oracle
def test_without_priors_and_a_group_of_its_own(grid: Block) -> None:
    """Without priors, and with image points in no group, contributions to cofactors equal the full matrix."""
    assert_equal_to_full_matrix(fg.adjust(options(grid, eop_set=2), priors=False), ("control",))


@pytest.mark.oracle
def test_images_of_different_kinds(twin: Block) -> None:
    """With a frame camera above a pushbroom pair, contributions to cofactors equal the full matrix.

    The images have 6 and 12 unknowns.
    """
    solution = fg.adjust(with_frame_above(options(twin, eop_set=16)), backend="schur")
    assert_equal_to_full_matrix(solution, ("image_by_sensor", "control"))


@pytest.mark.oracle
def test_unknowns_in_common(twin: Block) -> None:
    block = options(twin, eop_set=4, look_polynomial=1, look_shared=True)
    solution = fg.adjust(block, backend="schur")
    assert solution.problem.ties is not None
    assert_equal_to_full_matrix(solution)


@pytest.mark.oracle
def test_any_division_gives_the_full_matrix(grid: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    solution = fg.adjust(grid, backend="schur")
    found = suspects(solution.residual_cofactors)[0]
    whole = residuals_of(solution)
    given = found.point, found.rows, found.columns
    assert whole.parts is not None
    shared, shares = whole.parts.shared, whole.parts.shares(*given)
    monkeypatch.setattr(elimination, "CHUNK", 3000)  # a few points at once
    assert_equal_to_full_matrix(solution)
    parts = residuals_of(solution)
    assert parts.parts is not None
    assert np.abs(parts.parts.shared - shared).max() < 1e-10
    assert np.abs(parts.parts.shares(*given) - shares).max() < 1e-10


@pytest.mark.oracle
def test_rows_of_S_add_up_to_the_redundancies(grid: Block) -> None:
    """The rows of S add up to the redundancies, and with one wrong weight they do not.

    R is idempotent only with the weights of the cofactors.
    """
    solution = fg.adjust(grid, backend="schur")
    residuals = residuals_of(solution)
    assert residuals.parts is not None
    _, r, _ = residuals.sums()
    assert residuals.parts.shared[:-1].sum(axis=1) == pytest.approx(r, abs=1e-9 * r.max())
    records = solution.problem.records.copy()
    records[:5] *= 1.2
    wrong = residuals_of(replace(solution, problem=replace(solution.problem, records=records)))
    _, r, _ = wrong.sums()
    assert wrong.parts is not None
    assert np.abs(wrong.parts.shared[:-1].sum(axis=1) - r).max() > 1e-3
