"""Constraints between unknowns of a general adjustment: a published circle, scipy, the whole matrix, a datum."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

import fg_orient as fg

#: Points of Gander, Golub, Strebel (1994), section 5, and their circle of least squared distances.
POINTS = np.array([[1.0, 7.0], [2.0, 6.0], [5.0, 8.0], [7.0, 7.0], [9.0, 5.0], [3.0, 7.0]])
CENTRE, RADIUS = (4.7398, 2.9835), 4.7142


def conic(l_: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return value and derivatives of ``a x^2 + b x y + c y^2 + d x + e y + f = 0`` for L = (x, y)."""
    x, y = l_.reshape(2, -1)
    a = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=1)
    return a @ p, a, np.hstack([np.diag(2 * p[0] * x + p[1] * y + p[3]), np.diag(p[1] * x + 2 * p[2] * y + p[4])])


def circle(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return constraints that make a conic a circle, and one that fixes the free factor.

    a = c, b = 0 and a + c = 2.
    """
    rows = np.array([[1.0, 0.0, -1.0, 0, 0, 0], [0, 1.0, 0, 0, 0, 0], [1.0, 0, 1.0, 0, 0, 0]])
    return rows @ p - [0.0, 0.0, 2.0], rows


@pytest.mark.truth
def test_circle_as_a_constrained_conic() -> None:
    """A conic with three constraints has the centre and radius of the published circle within 5e-5.

    It has six unknowns and six points; the normal matrix without constraints is singular.
    """
    found = fg.gauss_helmert(conic, POINTS.T.ravel(), np.array([1, 0, 1, -10.0, -6.0, 10.0]), constraints=circle)
    centre = -0.5 * found.x[3:5]
    assert found.converged and found.redundancy == 3
    assert centre == pytest.approx(CENTRE, abs=5e-5)
    assert np.sqrt(centre @ centre - found.x[5]) == pytest.approx(RADIUS, abs=5e-5)


def mixed(l_: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the conditions of eight points (t, y), both observed, on a curve of four unknowns."""
    t, y = l_.reshape(2, -1)
    a = np.stack([np.ones_like(t), t, t**2, np.sin(x[3] * t)], axis=1)
    slope = x[1] + 2.0 * x[2] * t + x[3] * np.cos(x[3] * t)
    value = a @ [*x[:3], 1.0] - y
    a[:, 3] = t * np.cos(x[3] * t)
    return value, a, np.hstack([np.diag(slope), -np.eye(len(t))])


def bound(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.array([x[1] ** 2 + x[3] ** 2 - 2.0, x[0] * x[2] - 0.5]), np.array(
        [[0.0, 2 * x[1], 0.0, 2 * x[3]], [x[2], 0.0, x[0], 0.0]]
    )


@pytest.mark.oracle
def test_curved_conditions_and_constraints_equal_scipy(rng: np.random.Generator) -> None:
    """Curved conditions with constraints have unknowns, residuals and squares of scipy's SLSQP.

    SLSQP minimises v^T W v over (v, x) under all conditions.
    """
    n, true = 16, np.array([1.0, 1.0, 0.5, 1.0])
    t, root = np.linspace(-2.0, 2.0, 8), rng.normal(size=(n, n))
    q = 0.01 * (root @ root.T / n + np.eye(n))
    observed = np.concatenate([t, mixed(np.concatenate([t, 0.0 * t]), true)[0]])
    observed = observed + np.linalg.cholesky(q) @ rng.normal(size=n)
    weight, start = np.linalg.inv(q), true + np.array([0.1, -0.1, 0.1, -0.1])
    found = fg.gauss_helmert(mixed, observed, start, cofactors=q, constraints=bound)
    expected = minimize(
        lambda z: z[:n] @ weight @ z[:n], np.concatenate([np.zeros(n), start]), method="SLSQP",
        jac=lambda z: np.concatenate([2.0 * weight @ z[:n], np.zeros(4)]), options={"ftol": 1e-15, "maxiter": 500},
        constraints=[
            {"type": "eq", "fun": lambda z: mixed(observed + z[:n], z[n:])[0],
             "jac": lambda z: np.hstack(mixed(observed + z[:n], z[n:])[:0:-1])},
            {"type": "eq", "fun": lambda z: bound(z[n:])[0],
             "jac": lambda z: np.hstack([np.zeros((2, n)), bound(z[n:])[1]])},
        ],
    )  # fmt: skip
    assert found.converged and np.abs(bound(found.x)[0]).max() < 1e-12
    assert found.weighted_squares == pytest.approx(expected.fun, rel=1e-6)
    assert np.abs(found.x - expected.x[n:]).max() < 1e-5 and np.abs(found.v - expected.x[:n]).max() < 1e-5
    free = fg.gauss_helmert(mixed, observed, found.x, cofactors=q)
    assert np.abs(free.x - found.x).max() > 0.01 and free.weighted_squares < found.weighted_squares
    assert free.redundancy == found.redundancy - 2


@pytest.mark.oracle
def test_cofactors_equal_those_of_the_whole_matrix(rng: np.random.Generator) -> None:
    """Cofactors of unknowns and residuals equal those of the whole matrix with all multipliers.

    The matrix is [[W, 0, B^T, 0], [0, 0, A^T, C^T], [B, A, 0, 0], [0, C, 0, 0]]. Its inverse maps L linearly to
    unknowns and residuals, and Q = map Q_ll map^T.
    """
    n, r, u, q = 9, 7, 4, 2
    a, b, c = rng.normal(size=(r, u)) * [1.0, 1e3, 1.0, 1e-3], rng.normal(size=(r, n)), rng.normal(size=(q, u))
    d, root = rng.normal(size=q), rng.normal(size=(n, n))
    q_ll, observed = root @ root.T + np.eye(n), rng.normal(size=n)
    whole = np.zeros((n + u + r + q, n + u + r + q))
    whole[:n, :n], whole[n + u : n + u + r, :n], whole[n + u : n + u + r, n : n + u] = np.linalg.inv(q_ll), b, a
    whole[n + u + r :, n : n + u] = c
    whole = np.tril(whole) + np.tril(whole, -1).T
    inverse = np.linalg.inv(whole)
    of_observed = -inverse[: n + u, n + u : n + u + r] @ b
    expected = of_observed @ observed + inverse[: n + u, n + u + r :] @ d
    found = fg.gauss_helmert(
        lambda l_, x: (a @ x + b @ l_, a, b), observed, np.zeros(u), cofactors=q_ll,
        constraints=lambda x: (c @ x - d, c),
    )  # fmt: skip
    v, x = of_observed[:n], of_observed[n:]
    assert found.v == pytest.approx(expected[:n], abs=1e-10) and found.x == pytest.approx(expected[n:], rel=1e-8)
    units = np.sqrt(np.diag(x @ q_ll @ x.T))
    assert np.abs((found.cofactors_x - x @ q_ll @ x.T) / np.outer(units, units)).max() < 1e-9
    assert np.abs(found.cofactors_v - v @ q_ll @ v.T).max() < 1e-10
    assert np.abs((found.cofactors_adjusted_x - (np.eye(n) + v) @ q_ll @ x.T) / units).max() < 1e-9
    assert np.trace(found.cofactors_v @ np.linalg.inv(q_ll)) == pytest.approx(found.redundancy) == r - u + q


@pytest.mark.truth
def test_inner_constraint_is_the_datum_of_levelling() -> None:
    """With the sum of heights 0 as constraint, levelling gives the least-norm solution and its cofactors.

    Height differences alone leave the level open.
    """
    lines = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2)])
    design = np.zeros((5, 4))
    design[np.arange(5), lines[:, 1]], design[np.arange(5), lines[:, 0]] = 1.0, -1.0
    observed = np.array([1.02, -0.53, 2.01, -2.46, 0.51])
    found = fg.gauss_markov(
        lambda x: (design @ x, design),
        observed,
        np.zeros(4),
        constraints=lambda x: (np.array([x.sum()]), np.ones((1, 4))),
    )
    inverse = np.linalg.pinv(design)
    assert found.x == pytest.approx(inverse @ observed, abs=1e-14) and found.redundancy == 2
    assert np.abs(found.cofactors_x - inverse @ inverse.T).max() < 1e-14


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("rows", "error"), [(np.ones((2, 4)), fg.NoSolutionError), (np.zeros((1, 4)), fg.NoSolutionError),
                        (np.eye(5, 4), fg.NoSolutionError), (np.ones((1, 3)), fg.InputError)]
)  # fmt: skip
def test_constraints_that_depend_on_each_other_are_refused(rows: np.ndarray, error: type[Exception]) -> None:
    with pytest.raises(error, match=r"constraints|function"):
        fg.gauss_markov(
            lambda x: (x, np.eye(4)), np.arange(4.0), np.zeros(4), constraints=lambda x: (np.zeros(len(rows)), rows)
        )
