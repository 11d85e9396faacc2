"""Prior, rows, likelihood and estimate of the linear model of jitter agree with independent computations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

import fg_orient as fg
from factors.geometry import polynomials
from fg_orient.adjustment.problem import State
from fg_orient.adjustment.rows import linearised
from fg_orient.model import jitter
from fg_orient.model.block import Block
from fg_orient.model.jitter import JitterCurve
from fg_orient.orientation.solution import Solution
from fg_orient.quality.deficiency import compiled_problem
from fg_orient.quality.elimination import control_residuals, control_rows
from fg_orient.quality.jitter_system import JitterSystem, Strength, without_quadratic
from fg_orient.simulate.simulation import Truth

TAU = np.linspace(-1.0, 1.0, 201)
CHOSEN = (Strength(1, 8, 1.1), Strength(2, 12, 0.4))


@pytest.mark.oracle
@pytest.mark.parametrize("n", [2, 9, 32])
def test_the_prior_is_that_of_independent_coefficients(n: int) -> None:
    """The prior of jitter curves is that of scipy's splines with independent coefficients, without quadratics.

    The quadratics are computed by a fit of polynomials.
    """
    knots = -1.0 + 2.0 / n * np.arange(-3, n + 4)
    tau = np.linspace(-1.0, 1.0, 40 * n + 1)
    values = BSpline(knots, np.eye(n + 3), 3)(tau)
    values /= np.sqrt(np.mean(np.sum(values**2, axis=1)))  # mean square of the process: 1
    quadratics = np.linalg.lstsq(values, tau[:, None] ** np.arange(3), rcond=None)[0]  # coefficients of 1, tau, tau^2
    onto = quadratics @ np.linalg.pinv(quadratics)  # covariance of the coefficients of quadratics
    expected = values @ (np.eye(n + 3) - onto) @ values.T
    curves = polynomials.jitter_curves(tau, n)
    assert np.abs(curves @ curves.T - expected).max() < 1e-10
    powers = np.linalg.pinv(tau[:, None] ** np.arange(3)) @ values @ onto  # of unit coefficients, to c0, c1, c2
    np.testing.assert_allclose(polynomials.jitter_quadratic(n), np.linalg.norm(powers, axis=1), rtol=1e-9)
    assert (polynomials.FEWEST, polynomials.MOST) == (jitter.FEWEST, jitter.MOST)
    same = polynomials.curves(tau, n) @ polynomials.curves_from_jitter(n)
    assert np.abs(same - curves).max() < 1e-10


def dense(
    block: Block, plain: Solution, chosen: tuple[Strength, ...], system: JitterSystem
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
    """Return the whitened rows of image and control points by numpy, from the equations with curves as unknowns.

    They are the design of the ground points, the design of the orientation and curves in prior sigmas, the residuals,
    the means of the latter, and the first column of the curves of the left image.
    """
    names = []
    for strength in chosen:
        angle = system.angles[strength.angle]
        sigma = strength.px / angle.px_per_rad
        names.append(str(JitterCurve(block.images[angle.image].id, angle.name, strength.intervals, sigma)))
    problem = compiled_problem(replace(block, options=replace(block.options, jitter_curves=tuple(names))))
    image = np.zeros((2, max(map(len, problem.parameters))))
    for k, parameters in enumerate(problem.parameters):
        own = plain.problem.parameters[k]
        image[k, : len(own)] = plain.state.image[k, : len(own)] * own.sigma / parameters.sigma[: len(own)]
    state = State(image, plain.state.ground)
    rows, o = linearised(problem, state), problem.observations
    n_points, u = len(problem.active), problem.n_image_unknowns
    ground, random = np.zeros((2 * len(o), 3 * n_points)), np.zeros((2 * len(o), u))
    for k in range(len(o)):
        ground[2 * k : 2 * k + 2, 3 * o.point[k] : 3 * o.point[k] + 3] = rows.ground[k]
        part = problem.image_slice(int(o.image[k]))
        random[2 * k : 2 * k + 2, part] = rows.image[k, :, : part.stop - part.start]
    points = np.flatnonzero(problem.observed)
    control = np.zeros((3 * len(points), 3 * n_points))
    for row, (j, block_of) in enumerate(zip(points, control_rows(problem, points), strict=True)):
        control[3 * row : 3 * row + 3, 3 * j : 3 * j + 3] = block_of
    residual = np.concatenate([rows.residual.ravel(), control_residuals(problem, state).ravel()])
    random = np.vstack([random, np.zeros((len(control), u))])
    mean = problem.image_columns(state)
    return np.vstack([ground, control]), random, -residual, mean, len(plain.problem.parameters[0])


@pytest.mark.oracle
def test_likelihood_and_curve_are_those_of_all_rows(
    made: tuple[Block, Truth], plain: Solution, system: JitterSystem
) -> None:
    """Likelihood and curve equal those from the covariance of all observations, with ground points as fixed effects.

    Differences of log L between choices do not depend on constants. Quadratics of jitter enlarge the prior variances of
    the degree-2 coefficients, where the linear model has own columns: both are the same process.
    """

    def log_likelihood(chosen: tuple[Strength, ...]) -> tuple[float, np.ndarray]:
        fixed, random, y, mean, begin = dense(made[0], plain, chosen, system)
        total = y + random @ mean  # observations as function of the total unknowns, whose prior means are zero
        covariance = np.eye(len(y)) + random @ random.T
        inverse = np.linalg.inv(covariance)
        normal = fixed.T @ inverse @ fixed
        p = inverse - inverse @ fixed @ np.linalg.solve(normal, fixed.T @ inverse)
        log = -0.5 * (np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1])
        log -= 0.5 * system.freedom * np.log(total @ p @ total)
        return float(log), (random.T @ p @ total)[begin:]

    fits = [system.fit(chosen) for chosen in ((), CHOSEN[:1], CHOSEN)]
    logs = np.array([log_likelihood(chosen)[0] for chosen in ((), CHOSEN[:1], CHOSEN)])
    # the priors of strongly determined unknowns give condition numbers of 1e8 to the covariance
    np.testing.assert_allclose(np.diff([fit.log for fit in fits]), np.diff(logs), atol=1e-4)
    unknowns = log_likelihood(CHOSEN[:1])[1][:8]
    expected = without_quadratic(TAU, polynomials.jitter_curves(TAU, 8)) @ unknowns * CHOSEN[0].px
    np.testing.assert_allclose(fits[1].curve(0, TAU)[0], expected, atol=1e-5)


@pytest.mark.consistency
@pytest.mark.parametrize("backend", ["graph", "schur", "dense"])
def test_adjustments_with_these_curves_give_the_curve(
    made: tuple[Block, Truth], system: JitterSystem, backend: str
) -> None:
    """An adjustment with the chosen curves has the linear model's curve within 1e-3 px, and its variance.

    The equations are linear to the square of 1e-5 rad, 1e-4 px.
    """
    names = []
    for strength in CHOSEN:
        angle = system.angles[strength.angle]
        image, sigma = made[0].images[angle.image].id, strength.px / angle.px_per_rad
        names.append(str(JitterCurve(image, angle.name, strength.intervals, sigma)))
    solution = fg.adjust(made[0], jitter_curves=tuple(names), backend=backend)
    fit = system.fit(CHOSEN)
    for number, strength in enumerate(CHOSEN):
        angle = system.angles[strength.angle]
        correction = solution.correction(made[0].images[angle.image].id)
        of_angle = correction.eop_at(TAU)[:, 6 + (angle.name == "pitch")] * angle.px_per_rad
        assert np.abs(without_quadratic(TAU, of_angle) - fit.curve(number, TAU)[0]).max() < 1e-3
    variance = solution.sigma0**2
    assert fit.rss / system.freedom == pytest.approx(variance, rel=1e-4)


@pytest.mark.oracle
@pytest.mark.parametrize("angle", [0, 1, 2, 3])
def test_absorbed_shares_are_those_of_projections(
    made: tuple[Block, Truth], plain: Solution, system: JitterSystem, angle: int
) -> None:
    """The shares that points and orientation absorb equal numpy's projections of the curves' columns.

    numpy projects onto the ground points first, then onto orientation and priors.
    """
    fixed, random, _, _, begin = dense(made[0], plain, (Strength(angle, 8, 1.0),), system)
    ends = [begin, begin + 8] if angle < 2 else [2 * begin, 2 * begin + 8]
    curves, orientation = random[:, ends[0] : ends[1]], np.delete(random, np.s_[ends[0] : ends[1]], axis=1)
    places = [names.index(f"{system.angles[angle].name}_{d}") for d in range(3) for names in [names_of(plain, angle)]]
    sigma = plain.problem.parameters[angle // 2].sigma[places]
    wider = np.hypot(1.0, polynomials.jitter_quadratic(8) / system.angles[angle].px_per_rad / sigma)
    orientation[:, np.array(places) + (begin if angle >= 2 else 0)] /= wider  # the prior without jitter
    rest = curves - fixed @ np.linalg.lstsq(fixed, curves, rcond=None)[0]
    whole = np.vstack([orientation - fixed @ np.linalg.lstsq(fixed, orientation, rcond=None)[0],
                       np.eye(orientation.shape[1])])  # fmt: skip
    wide = np.vstack([rest, np.zeros((orientation.shape[1], 8))])
    end = wide - whole @ np.linalg.lstsq(whole, wide, rcond=None)[0]
    raw, points, left = (float(np.sum(one**2)) for one in (curves, rest, end))
    eigenvalues, by_points, by_orientation = system.information(angle, 8)
    np.testing.assert_allclose([by_points, by_orientation], [1 - points / raw, (points - left) / raw], atol=1e-6)
    np.testing.assert_allclose(eigenvalues, np.linalg.eigvalsh(end.T @ end), atol=1e-6 * eigenvalues.max())


def names_of(plain: Solution, angle: int) -> tuple[str, ...]:
    """Return the unknowns of the image of an angle."""
    return plain.problem.parameters[angle // 2].names
