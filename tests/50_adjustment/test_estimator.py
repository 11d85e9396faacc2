"""The estimator is compared with dense least squares, scipy and GTSAM's own optimisers."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import fg_orient as fg
from factors.conditions.control import CONTROL_POINT, POINT
from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.names import Role
from tests.support.full_statistics import Full, step_of_numpy
from tests.support.published_rays import misses_m
from tests.support.scalar_rows import scalar_rows

OWN = ("gauss-newton", "levenberg-marquardt", "dogleg")


def residual_vector(problem: Problem, state: State) -> np.ndarray:
    """Return all whitened residuals written out: image points, control points, priors."""
    image, _, _ = scalar_rows(problem, state)
    parts = [image.ravel()]
    for j in np.flatnonzero(problem.observed):
        w = problem.control_records[j, POINT.whitening].reshape(3, 3)
        parts.append(w @ (state.ground[j] - problem.control_records[j, POINT.place]))
    if problem.block.options.priors:
        parts.append(state.image.ravel())
    return np.concatenate(parts)


def dense_jacobian(problem: Problem, state: State) -> np.ndarray:
    """Return the same rows as a full matrix: image unknowns first, then unknown points."""
    m, k = state.image.shape
    points = np.flatnonzero(problem.active)
    column = {int(j): m * k + 3 * c for c, j in enumerate(points)}
    _, j_image, j_ground = scalar_rows(problem, state)
    rows = []
    for r in range(len(problem.observations)):
        a = np.zeros((2, m * k + 3 * len(points)))
        i, j = int(problem.observations.image[r]), int(problem.observations.point[r])
        a[:, i * k : (i + 1) * k] = j_image[r]
        if j in column:
            a[:, column[j] : column[j] + 3] = j_ground[r]
        rows.append(a)
    for j in np.flatnonzero(problem.observed):
        a = np.zeros((3, m * k + 3 * len(points)))
        a[:, column[int(j)] : column[int(j)] + 3] = problem.control_records[j, POINT.whitening].reshape(3, 3)
        rows.append(a)
    if problem.block.options.priors:
        rows.append(np.hstack([np.eye(m * k), np.zeros((m * k, 3 * len(points)))]))
    return np.vstack(rows)


def flat(problem: Problem, state: State) -> np.ndarray:
    return np.concatenate([state.image.ravel(), state.ground[problem.active].ravel()])


def unflat(problem: Problem, x: np.ndarray) -> State:
    size = problem.start.image.size
    ground = problem.start.ground.copy()
    ground[problem.active] = x[size:].reshape(-1, 3)
    return State(x[:size].reshape(problem.start.image.shape), ground)


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", [2, 15, 20])
def test_graph_equals_dense_normal_equations(twin: Block, eop_set: int) -> None:
    """One step of the graph equals numpy's least squares of the stacked rows within 1e-9 of the step."""
    problem = compile_problem(replace(twin, options=replace(twin.options, eop_set=eop_set)))
    backend = ExplicitBackend(problem)
    system = backend.linearise(backend.initial())
    a, r = dense_jacobian(problem, problem.start), residual_vector(problem, problem.start)
    assert 2.0 * system.error == pytest.approx(r @ r, rel=1e-12)
    expected = flat(problem, problem.start) - np.linalg.lstsq(a, r, rcond=None)[0]
    found = flat(problem, backend.state(backend.retract(backend.initial(), system.solve(0.0))))
    assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected - flat(problem, problem.start)).max()


@pytest.mark.oracle
def test_solution_equals_scipy(twin: Block) -> None:
    """The solution has the chi2 and the unknowns of scipy's trust-region solver with our residuals and Jacobian."""
    solution = fg.adjust(twin, eop_set=16)
    problem = solution.problem
    result = least_squares(
        lambda x: residual_vector(problem, unflat(problem, x)),
        flat(problem, problem.start),
        jac=lambda x: dense_jacobian(problem, unflat(problem, x)),
        xtol=1e-15, ftol=1e-15, gtol=1e-12,
    )  # fmt: skip
    assert 2.0 * result.cost == pytest.approx(solution.chi2, rel=1e-10)
    assert np.abs(result.x - flat(problem, solution.state)).max() < 1e-6  # scipy's own stopping, not ours


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", [1, 10, 15, 20])
@pytest.mark.parametrize("look", [None, 2])
def test_own_optimisers_and_those_of_gtsam_agree(twin: Block, eop_set: int, look: int | None) -> None:
    """GTSAM's optimisers (graph) and our own (Schur) end at one solution, within 1e-9 prior sigma and 1e-7 m."""
    base = fg.adjust(twin, eop_set=eop_set, look_polynomial=look)
    for optimizer, backend in itertools.product(OWN, ("graph", "schur")):
        other = fg.adjust(twin, eop_set=eop_set, look_polynomial=look, optimizer=optimizer, backend=backend)
        assert other.status is base.status
        assert np.abs(other.state.image - base.state.image).max() <= 1e-9, optimizer
        assert np.abs(other.ground_m - base.ground_m).max() <= 1e-7, optimizer


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["graph", "schur"])
def test_cofactors_equal_the_dense_inverse(twin: Block, backend: str) -> None:
    """Joint cofactors of images and points, and of each point, equal inv(A^T A); names and units are right."""
    solution = fg.adjust(twin, eop_set=20, backend=backend)
    problem = solution.problem
    a = dense_jacobian(problem, solution.state)
    q = np.linalg.inv(a.T @ a)
    m, k = solution.state.image.shape
    points = np.flatnonzero(problem.active)[[0, 7, 20]]
    column = {int(j): m * k + 3 * c for c, j in enumerate(np.flatnonzero(problem.active))}
    index = np.concatenate([np.arange(m * k), *[np.arange(column[int(j)], column[int(j)] + 3) for j in points]])
    expected = q[np.ix_(index, index)]
    found = solution.cofactors.joint((0, 1), tuple(int(j) for j in points))
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((found - expected) / scale).max() < 1e-8
    for j, c in column.items():  # by back-substitution, all of them
        block, ours = q[c : c + 3, c : c + 3], solution.cofactors.point(j)
        assert np.abs((ours - block) / np.sqrt(np.outer(np.diag(block), np.diag(block)))).max() < 1e-8
    named = solution.cofactor_matrix("image:left", f"point:{twin.points.ids[points[0]]}")
    sigma = np.concatenate([problem.parameters[0].sigma, np.ones(3)])
    index = np.concatenate([np.arange(k), np.arange(column[int(points[0])], column[int(points[0])] + 3)])
    assert np.allclose(named.values, q[np.ix_(index, index)] * np.outer(sigma, sigma), rtol=1e-6)
    assert named.units[0] == "m"
    assert named.units[-1] == "m"
    assert named.names[0] == "left.x_0"
    posterior = solution.covariance("image:left")
    assert np.allclose(posterior.values, solution.cofactor_matrix("image:left").values * solution.sigma0**2)


@pytest.mark.oracle
def test_points_one_by_one_equal_the_dense_inverse(twin: Block) -> None:
    """Cofactors of each point and of an image equal those of numpy's full matrix."""
    solution = fg.adjust(twin, eop_set=15)
    full = Full.of(solution.problem, solution.state)
    parts = [(solution.cofactors.point(j), full.problem.point_slice(j)) for j in range(len(twin.points.ids))]
    for found, columns in [*parts, (solution.cofactors.image(1), full.problem.image_slice(1))]:
        assert np.allclose(found, full.unknowns[columns, columns], rtol=1e-8, atol=1e-12)


@pytest.mark.behaviour
@pytest.mark.parametrize("named", [False, True], ids=["", "extra observation of a point"])
def test_indeterminate_covariance_is_unavailable_with_a_reason(twin: Block, named: bool) -> None:
    """If GTSAM's Cholesky gives no covariance, the result states the reason and is not trustworthy.

    One control and two check points without priors are solvable, but indeterminate for it.
    """
    keep = [int(twin.points.where(Role.CONTROL)[0]), *(int(j) for j in twin.points.where(Role.CHECK)[:2])]
    small = replace(twin, observations=twin.observations.take(np.isin(twin.observations.point, keep)))
    if named:
        record = np.concatenate([1e-3 * np.eye(3).ravel(), np.zeros(3)])
        place = (f"point:{twin.points.ids[keep[1]]}",)
        small = replace(small, extra=(ExtraObservation(CONTROL_POINT, place, record, np.zeros((2, 0)), 3, "own"),))
    solution = fg.adjust(small, eop_set=2, priors=False)
    assert solution.cofactors is None
    assert "no covariance" in str(solution.unavailable[0])
    assert solution.status is fg.Status.NOT_TRUSTWORTHY
    with pytest.raises(fg.NoSolutionError, match="no covariance was computed"):
        solution.covariance("image:left")


@pytest.mark.truth
def test_counts_and_redundancy(twin: Block) -> None:
    """Numbers of observations and unknowns are right, and the redundancy follows from them for each option.

    Observations: 2 x 94 image, 3 x 37 control, 54 priors; unknowns: 54 and 3 x 47.
    """
    solution = fg.adjust(twin, eop_set=20)
    assert solution.problem.n_observations == 188 + 111 + 54
    assert solution.problem.n_unknowns == 54 + 141
    assert solution.redundancy == 158
    excluded = fg.adjust(twin, eop_set=20, check_points="exclude")
    assert excluded.redundancy == 158 - 10
    without = fg.adjust(twin, eop_set=2, priors=False)
    assert without.redundancy == 158 - 6


@pytest.mark.oracle
def test_sigma0_is_the_root_of_all_weighted_squares(twin: Block) -> None:
    solution = fg.adjust(twin, eop_set=15)
    r = residual_vector(solution.problem, solution.state)
    assert solution.chi2 == pytest.approx(r @ r, rel=1e-12)
    assert solution.sigma0 == pytest.approx(np.sqrt(r @ r / 158), rel=1e-12)
    low, high = solution.sigma0_interval
    assert low < 1.0 < high


@pytest.mark.oracle
def test_gradient_vanishes_at_the_solution(twin: Block) -> None:
    """The gradient A^T r in scaled unknowns vanishes at the solution, so that it is a minimum."""
    solution = fg.adjust(twin, eop_set=20, look_polynomial=1)
    a = dense_jacobian(solution.problem, solution.state)
    r = residual_vector(solution.problem, solution.state)
    assert np.abs(a.T @ r).max() < 1e-6 * np.abs(a).max()


@pytest.mark.oracle
def test_pixel_residuals_are_adjusted_minus_observed(twin: Block) -> None:
    """Residuals are projected minus observed pixels within 1e-3 px, the second-order terms."""
    solution = fg.adjust(twin, eop_set=15)
    o = solution.problem.observations
    for k, image in enumerate(twin.images):
        rows = np.flatnonzero(o.image == k)
        line, sample = image.sensor.project(solution.ground_m[o.point[rows]], solution.correction(image.id))
        there = o.line[rows] + solution.residuals_px[rows, 0], o.sample[rows] + solution.residuals_px[rows, 1]
        ground, correction = solution.ground_m[o.point[rows]], solution.correction(image.id)
        assert misses_m(image.sensor.metadata, *there, ground, correction).max() < 5e-3  # a pixel is 5 m
        assert np.abs(line - o.line[rows] - solution.residuals_px[rows, 0]).max() < 1e-3
        assert np.abs(sample - o.sample[rows] - solution.residuals_px[rows, 1]).max() < 1e-3


@pytest.mark.oracle
def test_fixed_control_points_are_constants(twin: Block) -> None:
    """Fixed control points are not unknowns and keep their coordinates; very small sigmas give the same answer."""
    control = twin.points.where(Role.CONTROL)
    fixed = twin.points.known.fixed.copy()
    fixed[control] = True
    hard = replace(twin, points=replace(twin.points, known=replace(twin.points.known, fixed=fixed)))
    sigma = np.where(np.isnan(twin.points.known.sigma_enu_m), np.nan, 1e-4)
    tight = replace(twin, points=replace(twin.points, known=replace(twin.points.known, sigma_enu_m=sigma)))
    a, b = fg.adjust(hard, eop_set=10), fg.adjust(tight, eop_set=10)
    assert (len(a.accuracy.control), a.accuracy.control.n_fixed) == (0, 37)  # constants have no differences
    assert (len(b.accuracy.control), b.accuracy.control.n_fixed) == (37, 0)
    assert a.problem.n_unknowns == 2 * 3 + 30
    assert max(step_of_numpy(a.problem, a.state)) < 1e-7
    assert np.abs(a.state.image - b.state.image).max() < 1e-4
    assert np.array_equal(a.ground_m[control], twin.points.known.ecef_m[control])
    assert a.redundancy == b.redundancy


@pytest.mark.consistency
def test_excluded_check_points_are_intersected_afterwards(twin: Block) -> None:
    """Excluded check points still have differences and predicted sigmas, 0.9 to 2 times those of used ones."""
    used, excluded = (fg.adjust(twin, eop_set=15, check_points=c) for c in ("use", "exclude"))
    assert len(excluded.accuracy.check) == len(used.accuracy.check) == 10
    a, b = used.accuracy.check.predicted_sigma_enu_m, excluded.accuracy.check.predicted_sigma_enu_m
    assert np.all(b > 0.9 * a)  # with fewer observations the prediction cannot be much better
    assert np.all(b < 2.0 * a)
    d = np.linalg.norm(used.accuracy.check.enu_m - excluded.accuracy.check.enu_m, axis=1)
    assert 0.0 < d.max() < 3.0


@pytest.mark.behaviour
def test_more_iterations_change_nothing(twin: Block) -> None:
    a = fg.adjust(twin, eop_set=20)
    assert a.iterations <= 5
    assert a.log[-1].step < 1e-6
    short = fg.adjust(twin, eop_set=20, max_iterations=1)
    assert short.status is fg.Status.NOT_CONVERGED
    assert "no convergence within 1 iteration" in short.reason


@pytest.mark.behaviour
def test_callback_sees_every_iteration(twin: Block) -> None:
    seen = []
    solution = fg.adjust(twin, eop_set=10, callback=seen.append)
    assert tuple(seen) == solution.log
    assert [record.iteration for record in seen] == list(range(1, len(seen) + 1))
    assert seen[0].chi2 > seen[-1].chi2_after
