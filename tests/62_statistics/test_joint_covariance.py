"""The joint covariance of any named quantities agrees with full matrices on every backend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.orientation.solution import Solution
from tests.support.full_statistics import Full, measured_twice


def tie_name(solution: Solution) -> tuple[str, str]:
    """Return the image and point of a measurement of a tie point in the second image."""
    o, block = solution.problem.observations, solution.block
    ties = np.isin(o.point, block.points.where(Role.TIE)) & (o.image == 1)
    return block.images[1].id, block.points.ids[int(o.point[np.flatnonzero(ties)[0]])]


def names_of(solution: Solution) -> tuple[str, ...]:
    image, tie = tie_name(solution)
    first = solution.block.images[0].id
    return (f"image:{image}.roll_0", f"point:{tie}", f"image:{first}", f"observation:{image}/{tie}",
            f"residual:{image}/{tie}", f"point:{tie}.z")  # fmt: skip


def expected(solution: Solution) -> np.ndarray:
    """Return the joint covariance from the full design matrix.

    Its rows are unknowns, adjusted observations and residuals.
    """
    problem, (_, tie) = solution.problem, tie_name(solution)
    full, o = Full.of(problem, solution.state), solution.problem.observations
    j, columns = problem.block.points.ids.index(tie), np.eye(len(full.unknowns))
    row = int(np.flatnonzero((o.image == 1) & (o.point == j))[0])
    sigma = np.array([o.sigma_line_px[row], o.sigma_sample_px[row]])
    p, at, n = problem.parameters, problem, len(full.v)
    roll = p[1].names.index("roll_0")
    unknowns = np.vstack([
        columns[at.image_slice(1)][roll] * p[1].sigma[roll], columns[at.point_slice(j)],
        columns[at.image_slice(0)] * p[0].sigma[:, None], columns[at.point_slice(j)][2],
    ])  # fmt: skip
    # residual = adjusted minus observed, so an error e of the rows gives x = -N^-1 A^T e, the adjusted observation A x
    # and the residual e + A x
    of_errors = -full.unknowns @ full.design.T
    to_x = unknowns @ of_errors
    pick = np.zeros((2, n))
    pick[[0, 1], [2 * row, 2 * row + 1]] = sigma
    to_adjusted = pick @ full.design @ of_errors
    to_residual = pick @ (np.eye(n) + full.design @ of_errors)
    k = len(p[0])
    maps = np.vstack([to_x[:4], to_x[4 : 4 + k], to_adjusted, to_residual, to_x[-1:]])
    return np.asarray(maps @ maps.T)


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "graph", "schur"])
def test_joint_cofactors_by_name(grid: Block, backend: str) -> None:
    solution = fg.adjust(grid, backend=backend)
    found, wanted = solution.cofactor_matrix(*names_of(solution)), expected(solution)
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.abs((found.values - wanted) / scale).max() < 1e-8
    assert found.names[0] == "image2.roll_0"
    assert found.units[:2] == ("rad", "m")
    image, tie = tie_name(solution)
    assert found.names[-5:-3] == (f"{image}/{tie}.line", f"{image}/{tie}.sample")
    assert found.names[-3] == f"{image}/{tie}.v_line"
    covariance = solution.covariance(*names_of(solution))
    assert covariance.values == pytest.approx(found.values * solution.scale**2, rel=1e-12, abs=0.0)
    r = covariance.correlations
    assert np.diag(r) == pytest.approx(1.0)
    assert np.abs(r).max() < 1.0 + 1e-9


@pytest.mark.oracle
def test_residuals_go_with_nothing_that_is_adjusted(grid: Block) -> None:
    """Residuals have no covariance with unknowns and adjusted observations. This is the corrected form of T(2.76)."""
    solution = fg.adjust(grid)
    wanted, found = expected(solution), solution.cofactor_matrix(*names_of(solution)).values
    residual = slice(-3, -1)
    rest = np.delete(np.arange(len(found)), [len(found) - 3, len(found) - 2])
    assert (found[residual][:, rest] == 0.0).all()
    size = np.sqrt(np.outer(np.diag(wanted)[residual], np.diag(wanted)[rest]))
    assert np.abs(wanted[residual][:, rest] / size).max() < 1e-8
    image, tie = tie_name(solution)
    o = solution.problem.observations
    both = solution.cofactor_matrix(f"observation:{image}/{tie}").values
    rest_of = solution.cofactor_matrix(f"residual:{image}/{tie}").values
    row = int(np.flatnonzero((o.image == 1) & (o.point == solution.block.points.ids.index(tie)))[0])
    assert both + rest_of == pytest.approx(np.diag([o.sigma_line_px[row], o.sigma_sample_px[row]]) ** 2, abs=1e-9)


@pytest.mark.oracle
def test_wrong_weight_is_seen(grid: Block) -> None:
    """A sigma that is wrong by 20 % changes the covariance by over 10 %, so that the test above can fail."""
    solution = fg.adjust(grid)
    o = solution.problem.observations
    wrong = replace(solution.problem, observations=replace(o, sigma_line_px=1.2 * o.sigma_line_px))
    changed = replace(solution, problem=wrong)
    wanted, found = expected(solution), changed.cofactor_matrix(*names_of(solution)).values
    assert np.abs(found / wanted - 1.0)[-3, -3] > 0.1


@pytest.mark.oracle
def test_measured_twice(grid: Block) -> None:
    """Two measurements of a point in one image have the joint residual covariance of the full matrix."""
    solution = fg.adjust(measured_twice(grid, 1))
    o, block = solution.problem.observations, solution.block
    name = f"residual:{block.images[o.image[0]].id}/{block.points.ids[o.point[0]]}"
    found = solution.cofactor_matrix(name)
    assert found.values.shape == (4, 4)
    full = Full.of(solution.problem, solution.state)
    rows = np.flatnonzero((o.image == o.image[0]) & (o.point == o.point[0]))
    index = np.ravel([[2 * r, 2 * r + 1] for r in rows])
    sigma = np.ravel([[o.sigma_line_px[r], o.sigma_sample_px[r]] for r in rows])
    assert found.values == pytest.approx(full.residuals[np.ix_(index, index)] * np.outer(sigma, sigma), abs=1e-9)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "name", ["image:image1.speed", "image:nowhere", "point:nowhere.x", "observation:image1/nowhere", "residual:", "x"]
)
def test_unknown_names_are_refused(grid: Block, name: str) -> None:
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(grid).cofactor_matrix(name)
    assert caught.value.problems[0].code == "covariance.no_such"
