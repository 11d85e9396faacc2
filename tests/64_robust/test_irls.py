"""Least absolute values agree with linear programming, the original Danish method with its rule."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import linprog

import fg_orient as fg
from fg_orient.adjustment.irls import EPSILON, Rule, danish_limit, danish_original, least_absolute, norms_at, reweight
from fg_orient.adjustment.robust import FLOOR
from fg_orient.model.errors import InputError

from .conftest import adjusted, problem_of, spoiled, twin

Array = npt.NDArray[np.float64]


def line(seed: int, n: int = 40, bad: int = 8) -> tuple[Array, Array]:
    """Return a straight line with some observations far off."""
    rng = np.random.default_rng(seed)
    a = np.column_stack([np.ones(n), np.linspace(-1.0, 1.0, n)])
    b = a @ [2.0, -1.0] + rng.standard_normal(n)
    b[rng.choice(n, bad, replace=False)] += rng.uniform(20.0, 60.0, bad)
    return a, b


def fitted(a: Array, b: Array, dimension: int, rule: Rule = least_absolute) -> Array:
    """Return the unknowns by reweighting; rows of one observation follow one another."""

    def fit(groups: tuple[Array, ...], last: Array | None) -> Array:
        root = np.sqrt(np.repeat(groups[0], dimension)) if groups else np.ones(len(b))
        return np.linalg.lstsq(a * root[:, None], b * root, rcond=None)[0]

    def norms(x: Array) -> tuple[Array, ...]:
        return (np.linalg.norm((b - a @ x).reshape(-1, dimension), axis=1),)

    return reweight(fit, norms, lambda x: 1.0, rule, (dimension,)).fit


@pytest.mark.oracle
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_one_dimension_against_linear_programming(seed: int) -> None:
    """Least absolute values of a line have the cost of linear programming within 2e-4.

    The program is min sum s, -s <= b - a x <= s.
    """
    a, b = line(seed)
    n = len(b)
    found = linprog(
        np.concatenate([np.zeros(2), np.ones(n)]), A_ub=np.block([[-a, -np.eye(n)], [a, -np.eye(n)]]),
        b_ub=np.concatenate([-b, b]), bounds=[(None, None)] * 2 + [(0.0, None)] * n,
    )  # fmt: skip
    x = fitted(a, b, 1)
    # cycles end when no residual moves by 0.01, and count residuals below 0.001 as 0.001
    assert np.abs(b - a @ x).sum() == pytest.approx(found.fun, rel=2e-4)
    assert np.abs(b - a @ np.linalg.lstsq(a, b, rcond=None)[0]).sum() > 1.1 * found.fun


@pytest.mark.oracle
@pytest.mark.parametrize("seed", [1, 2])
def test_two_dimensions_between_bounds_of_a_polygon(seed: int) -> None:
    """Least norms in two dimensions lie between bounds of linear programming, 0.12 % apart.

    |r| is at least its projections on 64 directions, and at most 1 / cos(pi / 64) of the largest.
    """
    rng, n, k = np.random.default_rng(seed), 20, 64
    a, x = rng.standard_normal((2 * n, 3)), np.array([1.0, -2.0, 0.5])
    b = a @ x + rng.standard_normal(2 * n)
    b[: 2 * 4] += rng.uniform(20.0, 50.0, 8)
    angle = 2.0 * np.pi * np.arange(k) / k
    u = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    turned = np.einsum("kr,nrj->nkj", u, a.reshape(n, 2, 3)).reshape(n * k, 3)
    right = np.einsum("kr,nr->nk", u, b.reshape(n, 2)).ravel()
    found = linprog(
        np.concatenate([np.zeros(3), np.ones(n)]), A_ub=np.hstack([-turned, -np.repeat(np.eye(n), k, axis=0)]),
        b_ub=-right, bounds=[(None, None)] * 3 + [(0.0, None)] * n,
    )  # fmt: skip
    cost = np.linalg.norm((b - a @ fitted(a, b, 2)).reshape(n, 2), axis=1).sum()
    assert found.fun * (1.0 - 1e-9) <= cost <= found.fun / np.cos(np.pi / k) * (1.0 + 2e-4)


@pytest.mark.oracle
def test_another_weight_misses_the_bound() -> None:
    """With the weight 1 / t^2 instead of 1 / t the cost misses the limit of the test above."""
    a, b = line(1)
    x = fitted(a, b, 1, lambda last, norm, cycle, dimension, sigma0: 1.0 / np.maximum(norm, 0.3) ** 2)
    assert np.abs(b - a @ x).sum() > np.abs(b - a @ fitted(a, b, 1)).sum() * (1.0 + 2e-4)


@pytest.mark.oracle
def test_rules() -> None:
    norm, one = np.array([0.0, 2.9, 3.0, 4.0, 1e4]), np.ones(5)
    assert danish_limit(1) == pytest.approx(2.5, rel=1e-12)
    assert danish_limit(2) == pytest.approx(2.9626, abs=1e-4)
    early, late = danish_original(one, norm, 3, 2, 1.0), danish_original(one, norm, 4, 2, 0.5)
    assert early[:2].tolist() == late[:2].tolist() == [1.0, 1.0]
    assert early[2] == pytest.approx(np.exp(-0.05 * 3.0**4.4), rel=1e-12)
    assert late[2:4] == pytest.approx(np.exp(-0.05 * np.array([27.0, 64.0])), rel=1e-12)
    assert early[4] == late[4] == FLOOR
    # in units of sigma0 a posteriori where it is above 1; multiplied to the last weight
    assert danish_original(0.5 * one, norm, 4, 2, 2.0)[3] == 0.5
    assert danish_original(0.5 * one, norm, 4, 2, 1.0)[3] == pytest.approx(0.5 * late[3], rel=1e-12)
    assert least_absolute(one, norm, 1, 2, 1.0)[0] == 1.0 / EPSILON


@pytest.mark.oracle
def test_least_absolute_values_of_a_block() -> None:
    """The solution for ``lad`` has a smaller sum of norms than states around it and than least squares.

    Priors count as half squares.
    """
    block, bad = spoiled(twin(), 0.1, 3)
    end = adjusted(block, loss="lad")
    assert end.converged, end.reason
    problem = problem_of(block)

    def cost(image: Array, ground: Array) -> float:
        parts = norms_at(problem, fg.adjustment.problem.State(image, ground))
        return float(sum(p.sum() for p in parts)) + 0.5 * float(np.sum(image**2))

    least, rng = cost(end.state.image, end.state.ground), np.random.default_rng(1)
    for scale in (1e-2, 1e-1, 1.0):
        for _ in range(5):
            image = end.state.image + scale * rng.normal(scale=0.1, size=end.state.image.shape)
            ground = end.state.ground + scale * rng.normal(scale=1.0, size=end.state.ground.shape)
            assert cost(image, ground) > least
    plain = adjusted(block).state
    assert cost(plain.image, plain.ground) > 1.2 * least
    assert end.weights is not None
    assert (end.weights.image[bad] < 0.5).all()


@pytest.mark.oracle
def test_the_danish_method_on_a_block() -> None:
    block, bad = spoiled(twin(), 0.2, 3)
    solution = fg.adjust(block, loss="danish_original")
    assert solution.status is fg.Status.CONVERGED, solution.reason
    assert solution.weights is not None
    assert (solution.weights.image[bad] <= 1e-3).all()
    good = np.setdiff1d(np.arange(len(block.observations)), bad)
    assert np.mean(solution.weights.image[good] == 1.0) >= 0.95
    assert [r.iteration for r in solution.log] == list(range(1, solution.iterations + 1))
    assert solution.cofactors is not None


@pytest.mark.consistency
def test_rows_weighted_in_place_and_problems_weighted_anew_end_alike() -> None:
    """Schur, which weights its arrays, and dense, which makes new problems, have the same end and weights."""
    block, _ = spoiled(twin(), 0.1, 3)
    arrays, matrices = (adjusted(block, loss="danish_original", backend=name) for name in ("schur", "dense"))
    assert (arrays.backend, matrices.backend) == ("schur", "dense")
    assert arrays.weights is not None and matrices.weights is not None
    assert (arrays.weights.control < 1.0).any() or (arrays.weights.image < 1.0).any()
    np.testing.assert_allclose(arrays.state.image, matrices.state.image, rtol=0, atol=1e-7)
    np.testing.assert_allclose(arrays.weights.image, matrices.weights.image, rtol=1e-6)
    np.testing.assert_allclose(arrays.weights.control, matrices.weights.control, rtol=1e-6)
    assert arrays.chi2 == pytest.approx(matrices.chi2, rel=1e-9)


@pytest.mark.behaviour
def test_cycles_that_do_not_settle_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fg_orient.adjustment.irls.TOLERANCE", 0.0)
    found = reweight(
        lambda w, last: 0.0 if last is None else last + 1.0, lambda x: (np.array([x]),), lambda x: 1.0,
        least_absolute, (1,), max_cycles=3,
    )  # fmt: skip
    assert (found.cycles, found.settled, found.fit) == (3, False, 3.0)


@pytest.mark.behaviour
def test_no_loss_of_theirs() -> None:
    for options in ({"gnc": True}, {"robust_scale": "mad"}, {"robust_start": "lms"}):
        with pytest.raises(InputError, match=r"no cost function|needs a bounded loss"):
            adjusted(twin(), loss="lad", **options)
    with pytest.raises(InputError, match="no cost function"):
        fg.adjust(twin(), loss="lad", parts=2)
