"""Generalised ridge, Stein and combined estimators are compared with their definitions in other formulas."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.system import LinearSystem

Array = npt.NDArray[np.float64]


@pytest.fixture(params=range(5))
def system(request: pytest.FixtureRequest) -> LinearSystem:
    """Return the ill-conditioned equations with noise: singular values 10 .. 0.01."""
    rng = np.random.default_rng(request.param)
    u, _ = np.linalg.qr(rng.standard_normal((40, 8)))
    v, _ = np.linalg.qr(rng.standard_normal((8, 8)))
    design = u * np.geomspace(10.0, 0.01, 8) @ v.T
    return LinearSystem.from_design(design, design @ rng.standard_normal(8) * 3.0 + rng.standard_normal(40))


def least_squares(system: LinearSystem) -> tuple[Array, float, int]:
    """Return the solution, variance of unit weight and degrees of freedom."""
    design, observed = system.require_design("test")
    x, squares = np.linalg.lstsq(design, observed, rcond=None)[:2]
    f = len(observed) - len(x)
    return x, float(squares[0]) / f, f


@pytest.mark.oracle
def test_generalised_ridge_is_the_limit_of_its_iteration(system: LinearSystem) -> None:
    """Generalised ridge equals the limit of the iteration of Hoerl & Kennard (1970).

    The iteration starts at least squares and computes k_i = s0^2 / alpha_i^2 in each step.
    """
    x, variance, _ = least_squares(system)
    size, axes = np.linalg.eigh(system.normal)
    first = axes.T @ x
    alpha = first.copy()
    for _ in range(20_000):
        with np.errstate(divide="ignore", over="ignore"):
            alpha = first * size / (size + variance / alpha**2)
    expected = axes @ alpha
    np.testing.assert_allclose(solve("generalised_ridge", system).x, expected, rtol=0.0, atol=1e-6 * np.abs(x).max())


@pytest.mark.oracle
def test_stein_shrinks_least_squares(system: LinearSystem) -> None:
    x, variance, f = least_squares(system)
    quadratic = float(x @ system.normal @ x)
    factor = max(0.0, 1.0 - (len(x) - 2) / (f + 2) * f * variance / quadratic)
    np.testing.assert_allclose(solve("stein", system).x, factor * x, rtol=0.0, atol=1e-6 * np.abs(x).max())


@pytest.mark.oracle
def test_combined_estimator_shrinks_a_partial_ridge(system: LinearSystem) -> None:
    x, variance, f = least_squares(system)
    kappa = len(x) * variance / float(x @ x)
    size, axes = np.linalg.eigh(system.normal)
    small = axes[:, size < kappa]
    ridge = np.linalg.solve(system.normal + kappa * small @ small.T, system.rhs)
    factor = max(0.0, 1.0 - (len(x) - 2) / (f + 2) * f * variance / float(ridge @ system.normal @ ridge))
    assert 0 < small.shape[1] < len(x)
    np.testing.assert_allclose(solve("ridge_stein", system).x, factor * ridge, rtol=0.0, atol=1e-8 * np.abs(x).max())


@pytest.mark.truth
def test_stein_has_less_mean_square_error_than_least_squares() -> None:
    """Stein's estimate has less than 0.8 of the mean square error of least squares over 4000 draws.

    James & Stein (1961) prove less error for every truth with three unknowns or more; here the truth has the size of
    the noise.
    """
    rng = np.random.default_rng(1)
    design = np.linalg.qr(rng.standard_normal((30, 8)))[0]
    truth, errors = np.full(8, 0.7), np.zeros(2)
    for _ in range(4000):
        system = LinearSystem.from_design(design, design @ truth + rng.standard_normal(30))
        x = least_squares(system)[0]
        errors += [np.sum((solve("stein", system).x - truth) ** 2), np.sum((x - truth) ** 2)]
    assert errors[0] < 0.8 * errors[1]
