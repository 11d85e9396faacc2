"""Conditions with unknowns agree with total least squares, scipy.odr, Gauss-Markov and simulation."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

import fg_orient as fg
from fg_orient.adjustment.gauss_helmert import gauss_helmert, gauss_markov

N = 12


def line(l_: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return value and derivatives of ``y - a - b t = 0`` with L = (t, y), both observed.

    It is bilinear in observations and unknowns.
    """
    t, y = l_[:N], l_[N:]
    a = np.stack([-np.ones(N), -t], axis=1)
    return y - x[0] - x[1] * t, a, np.hstack([-x[1] * np.eye(N), np.eye(N)])


def points(rng: np.random.Generator, sigma: np.ndarray) -> np.ndarray:
    t = np.linspace(-2.0, 4.0, N)
    return np.concatenate([t, 1.0 + 0.7 * t]) + sigma * rng.normal(size=2 * N)


@pytest.mark.oracle
def test_equals_total_least_squares(rng: np.random.Generator) -> None:
    """With equal sigmas in t and y the line is that of the singular value decomposition, with its squares and m0."""
    observed = points(rng, np.full(2 * N, 0.3))
    found = gauss_helmert(line, observed, np.array([0.0, 0.0]))
    centred = np.stack([observed[:N], observed[N:]], axis=1)
    mean = centred.mean(axis=0)
    _, s, vt = np.linalg.svd(centred - mean)
    slope = vt[0, 1] / vt[0, 0]
    assert found.converged
    assert found.x == pytest.approx([mean[1] - slope * mean[0], slope], rel=1e-8)
    assert found.weighted_squares == pytest.approx(s[1] ** 2, rel=1e-12)
    assert found.m0 == pytest.approx(s[1] / np.sqrt(N - 2), rel=1e-12)


@pytest.mark.oracle
def test_equals_odr(rng: np.random.Generator) -> None:
    """With different sigmas in t and y the line has the unknowns, squares and adjusted values of ODRPACK."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # scipy.odr goes in scipy 1.19
        from scipy import odr

    sigma = rng.uniform(0.05, 0.5, 2 * N)
    observed = points(rng, sigma)
    found = gauss_helmert(line, observed, np.array([1.0, 1.0]), cofactors=sigma**2)
    data = odr.RealData(observed[:N], observed[N:], sx=sigma[:N], sy=sigma[N:])
    run = odr.ODR(data, odr.Model(lambda b, t: b[0] + b[1] * t), beta0=[1.0, 1.0], sstol=1e-15, partol=1e-15)
    run.set_job(deriv=1)
    expected = run.run()
    assert found.x == pytest.approx(expected.beta, rel=1e-7)
    assert found.weighted_squares == pytest.approx(expected.sum_square, rel=1e-10)
    assert found.adjusted[:N] == pytest.approx(expected.xplus, rel=1e-5, abs=1e-7)


@pytest.mark.oracle
def test_conditions_hold_and_the_optimum_is_stationary(rng: np.random.Generator) -> None:
    """The solution meets F(L + v, P) = 0 and the normal equations, with cofactors or weights.

    W v lies in the span of B^T, and A^T of its multipliers is zero.
    """
    m = rng.normal(size=(2 * N, 2 * N))
    q = 0.05 * (m @ m.T / N + 0.2 * np.eye(2 * N))
    observed = points(rng, np.full(2 * N, 0.2))
    found = gauss_helmert(line, observed, np.array([0.0, 1.0]), cofactors=q)
    w = np.linalg.inv(q)
    value, a, b = line(found.adjusted, found.x)
    assert found.converged
    assert np.abs(value).max() < 1e-12
    multipliers = np.linalg.lstsq(b.T, w @ found.v, rcond=None)[0]
    assert np.abs(b.T @ multipliers - w @ found.v).max() < 1e-6
    assert np.abs(a.T @ multipliers).max() < 1e-6
    assert found.weighted_squares == pytest.approx(found.v @ w @ found.v, rel=1e-8)
    weights = gauss_helmert(line, observed, np.array([0.0, 1.0]), weights=w)
    assert np.allclose(weights.x, found.x, rtol=1e-7)
    assert np.trace(found.cofactors_v @ w) == pytest.approx(found.redundancy, rel=1e-9)
    assert np.allclose(found.cofactors_adjusted, q - found.cofactors_v)


@pytest.mark.oracle
@pytest.mark.parametrize("solver", ["qr", "gauss_inverse", "cholesky_inverse"])
def test_gauss_markov_is_the_case_b_equals_minus_one(rng: np.random.Generator, solver: str) -> None:
    """Gauss-Helmert with f(x) - L = 0 has unknowns, residuals and all four cofactor matrices of Gauss-Markov."""
    t = np.linspace(0.0, 2.0, N)

    def function(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        e = np.exp(x[1] * t)
        return x[0] * e, np.stack([e, x[0] * t * e], axis=1)

    def conditions(l_: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        value, a = function(x)
        return value - l_, a, -np.eye(N)

    m = rng.normal(size=(N, N))
    q = 0.01 * (m @ m.T / N + 0.2 * np.eye(N))
    observed = function(np.array([2.0, 0.5]))[0] + 0.1 * rng.normal(size=N)
    a = gauss_markov(function, observed, np.array([1.0, 0.0]), cofactors=q, solver=solver)
    b = gauss_helmert(conditions, observed, np.array([1.0, 0.0]), cofactors=q, solver=solver)
    assert a.converged
    assert b.converged
    assert (a.redundancy, b.redundancy) == (N - 2, N - 2)
    half = np.linalg.cholesky(np.linalg.inv(q)).T
    scipys = least_squares(lambda x: half @ (function(x)[0] - observed), [1.0, 0.0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert a.x == pytest.approx(scipys.x, rel=1e-7)
    assert a.cofactors_x == pytest.approx(np.linalg.inv(scipys.jac.T @ scipys.jac), rel=1e-5)
    for name in ("x", "v", "adjusted", "cofactors_x", "cofactors_v", "cofactors_adjusted", "cofactors_adjusted_x"):
        assert np.allclose(getattr(a, name), getattr(b, name), rtol=1e-7, atol=1e-9), name
    assert a.weighted_squares == pytest.approx(b.weighted_squares, rel=1e-10)
    assert np.allclose(a.correlations_adjusted_x, b.correlations_adjusted_x, atol=1e-7)


@pytest.mark.truth
def test_conditions_only() -> None:
    """The angles of a triangle, with one condition and no unknowns, share the misclosure by their cofactors."""

    def closed(l_: np.ndarray, _: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.array([l_.sum() - 180.0]), np.zeros((1, 0)), np.ones((1, 3))

    q = np.array([1.0, 2.0, 3.0])
    found = gauss_helmert(closed, np.array([60.0, 60.0, 60.6]), np.zeros(0), cofactors=q)
    assert found.x.shape == (0,)
    assert found.v == pytest.approx(-0.6 * q / 6.0, rel=1e-12)
    assert found.adjusted.sum() == pytest.approx(180.0, abs=1e-12)
    assert (found.redundancy, found.m0) == (1, pytest.approx(0.6 / np.sqrt(6.0), rel=1e-12))
    assert np.allclose(found.cofactors_v, np.outer(q, q) / 6.0)
    assert found.cofactors_x.shape == (0, 0)
    assert found.cofactors_adjusted_x.shape == (3, 0)


@pytest.mark.truth
def test_an_observation_of_cofactor_zero_is_a_constant() -> None:
    """An observation of cofactor zero keeps its value, and all cofactors zero are refused. Q_ll may be singular."""

    def closed(l_: np.ndarray, _: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.array([l_.sum() - 180.0]), np.zeros((1, 0)), np.ones((1, 3))

    found = gauss_helmert(closed, np.array([60.0, 60.0, 60.6]), np.zeros(0), cofactors=np.array([0.0, 1.0, 1.0]))
    assert np.allclose(found.v, [0.0, -0.3, -0.3])
    with pytest.raises(fg.NoSolutionError, match="conditions depend on each other"):
        gauss_helmert(closed, np.array([60.0, 60.0, 60.6]), np.zeros(0), cofactors=np.zeros(3))


@pytest.mark.behaviour
def test_dependent_and_too_few_conditions_are_refused() -> None:
    def twice(l_: np.ndarray, _: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.full(2, l_.sum()), np.zeros((2, 0)), np.ones((2, 3))

    def one(l_: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return l_[:1] + x.sum(), np.ones((1, 2)), np.array([[1.0, 0.0]])

    with pytest.raises(fg.NoSolutionError) as caught:
        gauss_helmert(twice, np.ones(3), np.zeros(0))
    assert caught.value.problems[0].code == "classical.dependent_conditions"
    with pytest.raises(fg.InputError, match="too few for 2 unknowns"):
        gauss_helmert(one, np.ones(2), np.zeros(2))


@pytest.mark.oracle
def test_original_observations_count_not_adjusted_ones(rng: np.random.Generator) -> None:
    """A circle has the least sum of squared distances from the original points, as by scipy.

    Repeating with adjusted values as new observations would end elsewhere.
    """
    angle = np.linspace(0.0, 1.5, N)
    observed = np.concatenate([3.0 + 2.0 * np.cos(angle), -1.0 + 2.0 * np.sin(angle)]) + 0.15 * rng.normal(size=2 * N)

    def circle(l_: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        d = np.stack([l_[:N] - x[0], l_[N:] - x[1]])
        a = np.stack([-2.0 * d[0], -2.0 * d[1], np.full(N, -2.0 * x[2])], axis=1)
        return (d**2).sum(axis=0) - x[2] ** 2, a, 2.0 * np.hstack([np.diag(d[0]), np.diag(d[1])])

    def distances(x: np.ndarray) -> np.ndarray:
        return np.hypot(observed[:N] - x[0], observed[N:] - x[1]) - x[2]

    from scipy.optimize import least_squares

    start = np.array([3.0, -1.0, 2.0])
    found = gauss_helmert(circle, observed, start)
    expected = least_squares(distances, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert found.converged
    assert found.weighted_squares == pytest.approx(2.0 * expected.cost, rel=1e-9)
    assert np.allclose(found.x, expected.x, rtol=1e-5)


@pytest.mark.oracle
def test_cofactors_by_monte_carlo() -> None:
    """All cofactor matrices equal those of 5000 repetitions, and wrong forms of Q_lP do not.

    Each empirical covariance has variance (q_ij^2 + q_ii q_jj)/(k - 1); the largest of all m elements lies within the
    Bonferroni bound of a normal variable at 1e-3. The wrong forms of Q_lP are A A^T M^-1 A for A N^-1, and the other
    sign. Sigmas are 1e-3 of the coordinates: the condition is linear to 1e-6.
    """
    rng = np.random.default_rng(7)
    m = rng.normal(size=(2 * N, 2 * N))
    q = 1e-6 * (m @ m.T / (2 * N) + 0.3 * np.eye(2 * N))
    root, true = np.linalg.cholesky(q), points(rng, np.zeros(2 * N))
    at = gauss_helmert(line, true, np.array([1.0, 0.7]), cofactors=q)
    repetitions = 5000
    draws = []
    value, a, b = line(true, np.array([1.0, 0.7]))
    weight = np.linalg.inv(b @ q @ b.T)
    gain_x = -np.linalg.solve(a.T @ weight @ a, a.T @ weight)
    for error in (root @ rng.normal(size=(2 * N, repetitions))).T:
        dx = gain_x @ (value + b @ error)
        v = -q @ b.T @ weight @ (a @ dx + b @ error)
        draws.append(np.concatenate([dx, error + v, v]))
    for sample in (3, 40):  # the linear formulas are those of the adjustment itself
        error = draws[sample][2 : 2 + 2 * N] - draws[sample][2 + 2 * N :]
        found = gauss_helmert(line, true + error, np.array([1.0, 0.7]), cofactors=q)
        assert np.allclose(found.x - [1.0, 0.7], draws[sample][:2], atol=1e-5)
        assert np.allclose(found.v, draws[sample][2 + 2 * N :], atol=1e-5)
    empirical = np.cov(np.array(draws).T)
    u, n = 2, 2 * N
    parts = [
        (at.cofactors_x, slice(0, u), slice(0, u)),
        (at.cofactors_adjusted_x, slice(u, u + n), slice(0, u)),
        (at.cofactors_adjusted, slice(u, u + n), slice(u, u + n)),
        (at.cofactors_v, slice(u + n, u + 2 * n), slice(u + n, u + 2 * n)),
    ]
    bound = np.sqrt(chi2.ppf(1.0 - 1e-3 / sum(p.size for p, _, _ in parts), 1))
    variance = np.concatenate([np.diag(at.cofactors_x), np.diag(at.cofactors_adjusted), np.diag(at.cofactors_v)])
    for computed, rows, columns in parts:
        spread = np.sqrt((computed**2 + np.outer(variance[rows], variance[columns])) / (repetitions - 1))
        assert (np.abs(empirical[rows, columns] - computed) / spread).max() < bound
    printed = -q @ b.T @ weight @ a @ a.T @ weight @ a  # eq. 2.76 as printed
    spread = np.sqrt(np.outer(variance[u : u + n], variance[:u]) / repetitions)
    for wrong in (printed, -at.cofactors_adjusted_x):
        assert (np.abs(empirical[u : u + n, :u] - wrong) / spread).max() > 2.0 * bound
    assert np.trace(at.cofactors_v @ np.linalg.inv(q)) == pytest.approx(N - 2, rel=1e-9)


@pytest.mark.truth
def test_without_redundancy_there_is_no_m0_and_a_reason() -> None:
    def exact(l_: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.array([l_[0] * x[0] - 6.0]), np.array([[l_[0]]]), np.array([[x[0]]])

    found = gauss_helmert(exact, np.array([2.0]), np.array([1.0]))
    assert found.converged
    assert (found.x[0], found.v[0]) == (pytest.approx(3.0, rel=1e-12), 0.0)
    assert (found.redundancy, found.m0) == (0, None)
    assert "no redundancy" in found.m0_missing


@pytest.mark.behaviour
def test_no_convergence_is_said(rng: np.random.Generator) -> None:
    observed = points(rng, np.full(2 * N, 0.3))
    found = gauss_helmert(line, observed, np.zeros(2), max_iterations=1)
    assert not found.converged
    assert "no convergence within 1 iteration" in found.reason


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"start": np.zeros(3)}, "classical.function"),
        ({"observed": np.ones(2 * N + 1)}, "classical.function"),
        ({"weights": np.zeros(2 * N)}, "classical.not_definite"),
        ({"weights": np.full(2 * N, 1e-320)}, "classical.not_definite"),
        ({"cofactors": np.full(2 * N, -1.0)}, "classical.not_definite"),
        ({"cofactors": -np.eye(2 * N)}, "classical.not_definite"),
        ({"cofactors": 2.0 - np.eye(2 * N)}, "classical.not_definite"),
        ({"weights": np.ones(3)}, "classical.weights"),
        ({"start": np.full(2, np.nan)}, "classical.vector"),
        ({"solver": "none_such"}, "linear.solver"),
        ({"max_iterations": -1}, "options.value"),
    ],
)
def test_bad_input_is_refused(change: dict[str, object], code: str) -> None:
    given: dict[str, object] = {"observed": np.arange(2.0 * N), "start": np.zeros(2), **change}
    with pytest.raises(fg.InputError) as caught:
        gauss_helmert(lambda l_, x: line(l_[: 2 * N], x[:2]), **given)
    assert [p.code for p in caught.value.problems] == [code]
