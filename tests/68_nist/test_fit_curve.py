"""``fit_curve`` agrees with scipy and numpy; the tests check its invariances and refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import curve_fit

import fg_orient as fg
from fg_orient.adjustment.loop import IterationRecord
from fg_orient.adjustment.regression import fit_curve
from fg_orient.model.errors import InputError, NoSolutionError

X = np.linspace(0.0, 10.0, 25)
START = (4.0, 0.3, 1.0)


def decay(x: Any, height: Any, rate: Any, level: Any) -> Any:
    return height * np.exp(-rate * x) + level


def decay_derivatives(x: Any, height: Any, rate: Any, level: Any) -> Any:
    e = np.exp(-rate * x)
    return np.stack([e, -height * x * e, np.ones_like(x)], axis=1)


@pytest.fixture
def observed(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the observations of unequal weight, and their standard deviations."""
    sigma = rng.uniform(0.02, 0.2, len(X))
    return decay(X, 5.0, 0.7, 2.0) + sigma * rng.standard_normal(len(X)), sigma


@pytest.mark.oracle
def test_equals_scipy(observed: tuple[np.ndarray, np.ndarray]) -> None:
    y, sigma = observed
    fit = fit_curve(decay, X, y, START, sigma=sigma)
    expected, covariance = curve_fit(decay, X, y, START, sigma, ftol=1e-15, xtol=1e-15, gtol=1e-15)
    assert fit.covariance is not None
    assert np.allclose(fit.parameters, expected, rtol=1e-7)
    assert np.allclose(fit.covariance, covariance, rtol=1e-5)
    assert fit.chi2 == pytest.approx(np.sum((fit.residuals / sigma) ** 2), rel=1e-12)


@pytest.mark.oracle
def test_redundancy_numbers_and_correlations(observed: tuple[np.ndarray, np.ndarray]) -> None:
    """Redundancy numbers of a curve are those of the hat matrix and add up; those without weights are others."""
    y, sigma = observed
    fit = fit_curve(decay, X, y, START, sigma=sigma)
    design = decay_derivatives(X, *fit.parameters) / sigma[:, None]
    hat = design @ np.linalg.inv(design.T @ design) @ design.T
    assert fit.redundancy_numbers is not None and fit.correlations is not None
    assert np.allclose(fit.redundancy_numbers, 1.0 - hat.diagonal(), atol=1e-10)
    assert fit.redundancy_numbers.sum() == pytest.approx(fit.redundancy, abs=1e-10)
    assert np.allclose(fit.correlations.diagonal(), 1.0)
    unweighted = fit_curve(decay, X, y, START)
    assert not np.allclose(unweighted.redundancy_numbers, 1.0 - hat.diagonal(), atol=1e-2)


@pytest.mark.oracle
def test_complex_steps_equal_given_derivatives(observed: tuple[np.ndarray, np.ndarray]) -> None:
    y, _ = observed
    a, b = (fit_curve(decay, X, y, START, jacobian=j) for j in (None, decay_derivatives))
    assert np.allclose(a.parameters, b.parameters, rtol=1e-12)


@pytest.mark.oracle
def test_units_change_nothing(observed: tuple[np.ndarray, np.ndarray]) -> None:
    """A curve fitted in other units has the same number of steps and the same parameters.

    The units are powers of two, which multiply without rounding.
    """
    y, _ = observed
    fit = fit_curve(decay, X, y, START)
    scipys, _ = curve_fit(decay, X, y, START, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.allclose(fit.parameters, scipys, rtol=1e-6)
    for unit in (2.0**-30, 2.0**20):

        def other(x: Any, height: Any, rate: Any, level: Any, unit: float = unit) -> Any:
            return decay(x, height * unit, rate / unit, level) * unit

        moved = fit_curve(other, X, y * unit, (START[0] / unit, START[1] * unit, START[2]))
        assert len(moved.log) == len(fit.log)
        assert np.allclose(moved.parameters * [unit, 1.0 / unit, 1.0], fit.parameters, rtol=1e-9)
        assert moved.chi2 == pytest.approx(fit.chi2 * unit**2, rel=1e-9)


@pytest.mark.oracle
def test_monte_carlo_covariance_of_the_parameters() -> None:
    """Errors of 40 fits lie in the 99.9 % interval of their covariance, and with sigmas halved outside."""
    from scipy.stats import chi2

    truth, runs, means = np.array([5.0, 0.7, 2.0]), 40, {}
    for scale in (1.0, 0.5):
        total = 0.0
        for seed in range(runs):
            y = decay(X, *truth) + 0.01 * np.random.default_rng(seed).standard_normal(len(X))
            choice = {"jacobian": decay_derivatives, "optimizer": "gauss-newton"}
            fit = fit_curve(decay, X, y, truth, sigma=0.01 * scale, **choice)
            error = fit.parameters - truth
            total += float(error @ np.linalg.solve(fit.cofactors, error))
        means[scale] = total
    low, high = chi2.ppf([0.0005, 0.9995], 3 * runs)
    assert low < means[1.0] < high
    assert not low < means[0.5] < high


@pytest.mark.truth
def test_without_redundancy_there_is_no_sigma0() -> None:
    fit = fit_curve(lambda x, a, b: a + b * x, np.array([0.0, 2.0]), [1.0, 5.0], [0.0, 0.0])
    assert np.allclose(fit.parameters, [1.0, 2.0])
    assert fit.sigma0 is None and fit.covariance is None and fit.standard_deviations is None
    assert fit.cofactors is not None


@pytest.mark.behaviour
def test_a_parameter_that_acts_on_nothing_of_its_own_is_named() -> None:
    fit = fit_curve(lambda x, a, b: (a + b) * x, X, 3.0 * X + 0.1 * np.sin(X), [1.0, 1.0])
    assert fit.cofactors is None and fit.correlations is None and fit.redundancy_numbers is None
    assert "parameter 2" in fit.unavailable


@pytest.mark.truth
def test_far_starts_are_named_by_gauss_newton_and_met_by_damping() -> None:
    """From a far start Gauss-Newton refuses with the reason, and the damped default finds the parameters.

    An exponent diverges at the first full step.
    """
    y = 200.0 * (1.0 - np.exp(-0.5 * X[1:])) + np.sin(7.0 * X[1:])

    def saturation(x: Any, b1: Any, b2: Any) -> Any:
        return b1 * (1.0 - np.exp(-b2 * x))

    with pytest.raises(NoSolutionError, match="not finite or does not depend"):
        fit_curve(saturation, X[1:], y, [1.0, 1.0], optimizer="gauss-newton")
    assert np.allclose(fit_curve(saturation, X[1:], y, [1.0, 1.0]).parameters, [200.0, 0.5], rtol=0.02)


@pytest.mark.behaviour
def test_callback_and_public_name() -> None:
    seen: list[IterationRecord] = []
    fit = fg.fit_curve(decay, X, decay(X, 5.0, 0.7, 2.0), START, callback=seen.append)
    assert tuple(seen) == fit.log and fit.iterations == len(seen)
    assert fit.chi2 < 1e-25


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": [1.0, np.nan, 1.0]}, "start: these values must be finite"),
        ({"y": np.ones((5, 5))}, "y: these values must be finite"),
        ({"sigma": 0.0}, "standard deviations above zero"),
        ({"sigma": [1.0, 2.0]}, "standard deviations above zero"),
        ({"y": [1.0, 2.0], "x": np.ones(2)}, "2 observations do not determine 3 unknowns"),
        ({"model": lambda x, a, b, c: a}, "one finite number per observation"),
        ({"model": lambda x, a, b, c: a * np.log(-b * x)}, "one finite number per observation"),
        ({"model": lambda x, a, b, c: np.abs(a) * x + b * x**2 + c}, "parameter 1: the derivatives do not agree"),
        ({"jacobian": lambda x, *b: 2.0 * decay_derivatives(x, *b)}, "parameter 1: the derivatives do not agree"),
        ({"jacobian": lambda x, *b: decay_derivatives(x, *b).T}, "jacobian: the derivatives do not agree"),
        ({"model": lambda x, a, b, c: a * np.array([float(b)] * 25) + c}, "the derivatives do not agree"),
        ({"optimizer": "dogleg"}, "unknown optimiser"),
    ],
)  # fmt: skip
def test_refusals(change: dict[str, Any], message: str) -> None:
    given = {"model": decay, "x": X, "y": decay(X, 5.0, 0.7, 2.0), "start": START} | change
    with pytest.raises(InputError, match=message):
        fit_curve(**given)
