"""Free networks of photos with scale bars agree with numpy's pseudo-inverse and the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from benchmarks.frames import SIZES, Size, network
from factors._contract import Array
from fg_orient.adjustment.dense import assemble

#: A tenth of the network of 110 photos: ten camera parameters, two scale bars.
TENTH = Size(11, 200, 5, 10, 2, 0.0)


def motions(points: Array) -> Array:
    """Return the shifts and rotations (3 n, 6) of points; scale bars hold the scale."""
    away = points - points.mean(axis=0)
    turns = np.stack([np.cross(axis, away) for axis in np.eye(3)], axis=2)
    return np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), turns], axis=2).reshape(-1, 6)


@pytest.mark.oracle
def test_cofactors_are_those_of_the_pseudo_inverse() -> None:
    """Cofactors and redundancy numbers of a free network with scale bars equal numpy's pseudo-inverse.

    They are compared after an S-transformation.
    """
    block, _ = network(TENTH)
    solution = fg.adjust(block)
    assert solution.status is fg.Status.CONVERGED
    problem = replace(solution.problem, block=replace(solution.problem.block, extra=()))
    _, design = assemble(problem, solution.state)
    design = problem.ties.columns(design)  # type: ignore[union-attr]
    bars = []
    for bar in block.extra:
        i, j = (block.points.ids.index(name) for name in bar.members)  # type: ignore[attr-defined]
        along = solution.state.ground[j] - solution.state.ground[i]
        row = np.zeros(design.shape[1])
        first = problem.n_free_unknowns
        row[first + 3 * j : first + 3 * j + 3] = along / np.linalg.norm(along) / bar.sigma  # type: ignore[attr-defined]
        row[first + 3 * i : first + 3 * i + 3] = -row[first + 3 * j : first + 3 * j + 3]
        bars.append(row)
    rows = np.vstack([design, *bars])
    scale = 1.0 / np.linalg.norm(rows, axis=0)
    _, values, vt = np.linalg.svd(rows * scale, full_matrices=False)
    kept = values > 1e-9 * values[0]
    assert (~kept).sum() == 6
    q = (vt[kept].T / values[kept] ** 2 @ vt[kept]) * np.outer(scale, scale)
    first = problem.n_free_unknowns
    e = motions(solution.state.ground)
    s = np.eye(len(e)) - e @ np.linalg.solve(e.T @ e, e.T)  # datum of all points
    expected = s @ q[first:, first:] @ s.T
    found = solution.cofactors.points(np.arange(len(block.points.ids)))  # type: ignore[union-attr]
    blocks = np.einsum("ninj->nij", expected.reshape(len(found), 3, len(found), 3))
    size = np.sqrt(np.einsum("nii->", blocks) / len(blocks))
    assert np.abs(found - blocks).max() <= 1e-8 * size**2
    hat = np.einsum("ni,ij,nj->n", rows, q, rows)
    numbers = np.concatenate([np.einsum("nii->ni", solution.residual_cofactors.image).ravel(),
                              *solution.residual_cofactors.extra[:2]])  # fmt: skip
    assert numbers == pytest.approx(1.0 - hat, abs=1e-8)
    assert numbers.sum() == pytest.approx(solution.redundancy, abs=1e-5)


@pytest.mark.truth
@pytest.mark.parametrize(("size", "seeds"), [
    (TENTH, 8), pytest.param(replace(SIZES["110 photos"], points=1000), 50, marks=pytest.mark.slow),
])  # fmt: skip
def test_errors_of_points_are_those_of_their_covariance(size: Size, seeds: int) -> None:
    """The mean NEES of 60 points over seeds lies in the 99 % interval of draws from their covariance.

    Errors are compared after an S-transformation to the truth.
    """
    found, drawn = [], []
    some = np.arange(0, size.points, size.points // 60)[:60]
    for seed in range(seeds):
        block, true = network(size, seed)
        solution = fg.adjust(block)
        e = motions(true)
        error = (solution.ground_m - true).ravel()
        error -= e @ np.linalg.solve(e.T @ e, e.T @ error)
        q = solution.cofactors.joint((), tuple(some.tolist()))  # type: ignore[union-attr]
        own = np.linalg.inv(np.einsum("ninj->nij", q.reshape(60, 3, 60, 3)))
        mine = error.reshape(-1, 3)[some]
        found.append(np.einsum("ni,nij,nj->", mine, own, mine) / 180.0)
        draws = (
            np.random.default_rng(seed).multivariate_normal(np.zeros(180), q, 1000, method="eigh").reshape(-1, 60, 3)
        )
        drawn.append(np.einsum("dni,nij,dnj->d", draws, own, draws) / 180.0)
    low, high = np.quantile(np.mean(drawn, axis=0), [0.005, 0.995])
    assert low <= np.mean(found) <= high
