"""The general adjustment of indirect observations is compared with numpy and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

import fg_orient as fg
from fg_orient.adjustment.gauss_helmert import gauss_markov

TIMES = np.linspace(0.0, 3.0, 14)


def line(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a = np.stack([np.ones_like(TIMES), TIMES], axis=1)
    return a @ x, a


def decay(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the amplitude, rate and offset of an exponential: not linear."""
    e = np.exp(-x[1] * TIMES)
    return x[0] * e + x[2], np.stack([e, -x[0] * TIMES * e, np.ones_like(TIMES)], axis=1)


def positive_definite(rng: np.random.Generator, n: int) -> np.ndarray:
    a = rng.normal(size=(n, n))
    return a @ a.T / n + 0.1 * np.eye(n)


@pytest.fixture
def observed(rng: np.random.Generator) -> np.ndarray:
    return decay(np.array([5.0, 0.8, 1.0]))[0] + 0.05 * rng.normal(size=len(TIMES))


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["weights", "cofactors"])
@pytest.mark.parametrize("full", [False, True])
def test_linear_equals_numpy_in_one_step(rng: np.random.Generator, kind: str, full: bool) -> None:
    """A linear problem with weights or cofactors has numpy's solution and cofactors after at most two iterations.

    numpy solves the rows multiplied by a root of W.
    """
    n = len(TIMES)
    given = positive_definite(rng, n) if full else rng.uniform(0.2, 4.0, n)
    matrix = given if full else np.diag(given)
    w = matrix if kind == "weights" else np.linalg.inv(matrix)
    observed = rng.normal(size=n)
    found = gauss_markov(line, observed, np.array([7.0, -3.0]), **{kind: given})
    root = np.linalg.cholesky(w).T
    a = line(np.zeros(2))[1]
    expected, squares, _, _ = np.linalg.lstsq(root @ a, root @ observed, rcond=None)
    assert np.allclose(found.x, expected, rtol=1e-11, atol=1e-12)
    assert found.converged
    assert found.iterations <= 2
    assert found.weighted_squares == pytest.approx(float(squares[0]), rel=1e-11)
    assert found.m0 == pytest.approx(np.sqrt(squares[0] / (n - 2)), rel=1e-11)
    assert np.abs(a.T @ w @ found.v).max() < 1e-10  # the residuals are orthogonal
    q_x, q_l = np.linalg.inv(a.T @ w @ a), np.linalg.inv(w)
    assert np.allclose(found.cofactors_x, q_x, rtol=1e-9, atol=1e-13)
    assert np.allclose(found.cofactors_adjusted, a @ q_x @ a.T, rtol=1e-9, atol=1e-12)
    assert np.allclose(found.cofactors_v, q_l - a @ q_x @ a.T, rtol=1e-9, atol=1e-11)
    assert np.allclose(found.cofactors_adjusted_x, a @ q_x, rtol=1e-9, atol=1e-12)
    assert np.trace(found.cofactors_v @ w) == pytest.approx(found.redundancy, rel=1e-10)
    assert found.correlations[0, 1] == pytest.approx(q_x[0, 1] / np.sqrt(q_x[0, 0] * q_x[1, 1]), rel=1e-9)
    assert np.allclose(np.diag(found.correlations), 1.0)
    sigma = np.sqrt(np.outer(np.diag(a @ q_x @ a.T), np.diag(q_x)))
    assert np.allclose(found.correlations_adjusted_x, a @ q_x / sigma, atol=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("solver", ["qr", "cholesky_elimination", "moore_penrose_inverse", "svd_scaled"])
def test_not_linear_equals_scipy(rng: np.random.Generator, observed: np.ndarray, solver: str) -> None:
    sigma = rng.uniform(0.02, 0.08, len(TIMES))
    found = gauss_markov(decay, observed, np.array([4.0, 0.5, 0.0]), cofactors=sigma**2, solver=solver)
    expected = least_squares(
        lambda x: (decay(x)[0] - observed) / sigma, [4.0, 0.5, 0.0], jac=lambda x: decay(x)[1] / sigma[:, None],
        xtol=1e-15, ftol=1e-15, gtol=1e-14,
    )  # fmt: skip
    assert found.converged
    assert np.allclose(found.x, expected.x, rtol=1e-7)  # scipy stops at sqrt(eps) in the parameters
    assert found.weighted_squares == pytest.approx(2.0 * expected.cost, rel=1e-12)
    gradient = decay(found.x)[1].T @ (found.v / sigma**2)
    assert np.abs(gradient * np.sqrt(np.diag(found.cofactors_x))).max() < 1e-7
    assert np.allclose(found.adjusted, decay(found.x)[0], rtol=1e-15)
    assert np.allclose(found.adjusted - observed, found.v)


@pytest.mark.consistency
def test_the_stop_does_not_depend_on_units(observed: np.ndarray) -> None:
    """Observations in another unit have the same number of iterations and the same solution.

    The unit is a power of two (0.9e-9), which multiplies without rounding.
    """
    unit = 2.0**-30

    def nano(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, jacobian = decay(x)
        return unit * value, unit * jacobian

    start = np.array([4.0, 0.5, 0.0])
    a, b = gauss_markov(decay, observed, start), gauss_markov(nano, unit * observed, start)
    assert a.iterations == b.iterations
    assert np.allclose(a.x, b.x, rtol=1e-12)
    assert b.m0 == pytest.approx(unit * a.m0, rel=1e-10, abs=0.0)


@pytest.mark.oracle
def test_weights_of_one_variance_change_nothing_but_the_scale(observed: np.ndarray) -> None:
    start = np.array([4.0, 0.5, 0.0])
    a, b = gauss_markov(decay, observed, start), gauss_markov(decay, observed, start, weights=np.full(14, 25.0))
    scipys = least_squares(lambda x: decay(x)[0] - observed, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert a.x == pytest.approx(scipys.x, rel=1e-7)
    assert a.m0 == pytest.approx(np.sqrt(2.0 * scipys.cost / 11), rel=1e-9)
    assert np.allclose(a.x, b.x, rtol=1e-10)
    assert b.m0 == pytest.approx(5.0 * a.m0, rel=1e-10)
    assert np.allclose(b.cofactors_x, a.cofactors_x / 25.0, rtol=1e-9)


@pytest.mark.truth
def test_without_redundancy_there_is_no_m0_and_a_reason() -> None:
    found = gauss_markov(lambda x: (x**3, np.diag(3.0 * x**2)), np.array([8.0, 27.0]), np.array([1.5, 4.0]))
    assert found.converged
    assert np.allclose(found.x, [2.0, 3.0], rtol=1e-14)
    assert (found.redundancy, found.m0) == (0, None)
    assert "no redundancy" in found.m0_missing
    assert np.abs(found.cofactors_v).max() < 1e-15


@pytest.mark.oracle
def test_a_singular_design_is_solved_by_svd_with_a_note() -> None:
    """For two unknowns with one effect QR refuses, and SVD gives their sum, the redundancy and a note on the rank."""

    def doubled(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, a = line(np.array([x[0] + x[1], x[2]]))
        return value, a[:, [0, 0, 1]]

    observed = line(np.array([2.0, 1.0]))[0] + np.sin(np.arange(14.0))
    with pytest.raises(fg.NoSolutionError, match="qr, column 2"):
        gauss_markov(doubled, observed, np.zeros(3))
    found, plain = gauss_markov(doubled, observed, np.zeros(3), solver="svd"), gauss_markov(line, observed, np.zeros(2))
    assert found.redundancy == plain.redundancy == 12
    assert found.x[0] + found.x[1] == pytest.approx(plain.x[0], rel=1e-12)
    assert found.x == pytest.approx(np.linalg.lstsq(doubled(np.zeros(3))[1], observed, rcond=None)[0], rel=1e-10)
    a = line(np.zeros(2))[1]
    assert np.allclose(found.cofactors_adjusted, a @ np.linalg.inv(a.T @ a) @ a.T, atol=1e-13)
    assert "rank 2 of 3" in found.notes[-1]
    assert np.allclose(found.cofactors_adjusted, plain.cofactors_adjusted, atol=1e-14)
    assert plain.notes == ()


@pytest.mark.behaviour
def test_no_convergence_is_said(observed: np.ndarray) -> None:
    found = gauss_markov(decay, observed, np.array([4.0, 0.5, 0.0]), max_iterations=1)
    assert not found.converged
    assert "no convergence within 1 iteration" in found.reason
    assert gauss_markov(decay, observed, np.array([4.0, 0.5, 0.0])).reason == "the step is below the tolerance"


@pytest.mark.behaviour
def test_start_and_observations_are_left_alone(observed: np.ndarray) -> None:
    start, copy = np.array([4.0, 0.5, 0.0]), observed.copy()

    def spoiling(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        out = decay(x)
        x[:] = np.nan
        return out

    gauss_markov(spoiling, observed, start)
    assert np.array_equal(start, [4.0, 0.5, 0.0])
    assert np.array_equal(observed, copy)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"weights": np.ones(14), "cofactors": np.ones(14)}, "classical.weights_twice"),
        ({"weights": np.ones(13)}, "classical.weights"),
        ({"weights": np.full(14, np.nan)}, "classical.weights"),
        ({"weights": np.zeros(14)}, "classical.not_definite"),
        ({"weights": -np.eye(14)}, "classical.not_definite"),
        ({"weights": np.ones((14, 14))}, "classical.not_definite"),
        ({"cofactors": np.tri(14)}, "classical.not_definite"),
        ({"cofactors": np.zeros(14)}, "classical.not_definite"),
        ({"cofactors": np.ones((14, 14))}, "classical.not_definite"),
        ({"observed": np.full(14, np.inf)}, "classical.vector"),
        ({"observed": np.ones((14, 1))}, "classical.vector"),
        ({"start": np.array([np.nan, 0.0])}, "classical.vector"),
        ({"start": np.zeros(0)}, "classical.redundancy"),
        ({"start": np.zeros(3)}, "classical.function"),
        ({"observed": np.ones(1)}, "classical.redundancy"),
        ({"solver": "none_such"}, "linear.solver"),
        ({"max_iterations": 0}, "options.value"),
    ],
)
def test_bad_input_is_refused(change: dict[str, object], code: str) -> None:
    given: dict[str, object] = {"observed": np.ones(14), "start": np.zeros(2), **change}
    with pytest.raises(fg.InputError) as caught:
        gauss_markov(lambda x: line(x[:2]), **given)
    assert [p.code for p in caught.value.problems] == [code]


@pytest.mark.behaviour
def test_values_that_are_not_finite_are_no_solution() -> None:
    with pytest.raises(fg.NoSolutionError, match="not finite"):
        gauss_markov(lambda x: (np.full(3, np.nan), np.ones((3, 1))), np.ones(3), np.zeros(1))
