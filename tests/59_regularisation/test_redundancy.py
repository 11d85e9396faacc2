"""Sigma0 and redundancy of a regularised adjustment count only observations; predicted errors include the bias."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.penalty import without_penalties
from fg_orient.adjustment.problem import Problem
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.quality.regularised_points import expected_errors
from tests.support.dense_reduced import Array, regularised, twin

CASES: list[dict[str, Any]] = [
    {"regularisation": "tikhonov", "kappa": 0.03},
    {"regularisation": "tikhonov", "kappa": 5.0, "priors": True},
    {"regularisation": "tikhonov", "penalty": "laplace", "penalty_deviation": True},
    {"regularisation": "tikhonov", "kappa": 1e-8, "regularised_units": "raw"},
    {"regularisation": "generalised_ridge", "rank_cut": 1e-5},
    {"regularisation": "truncated", "kappa": 1.0},
]
IDS = ["ridge", "priors", "laplace", "raw", "each", "truncated"]


@pytest.fixture(scope="module")
def block() -> Block:
    return twin()


def inverse_rows(problem: Problem, state: Any) -> tuple[Array, Array]:
    """Return all rows J (n, u) without the penalty, and numpy's estimator M (u, n) with it.

    Columns have unit length in the inversion.
    """
    design = assemble(without_penalties(problem), state)[1]
    held = np.zeros((len(problem.regularisation.rows), design.shape[1]))  # type: ignore[union-attr]
    held[:, : problem.n_free_unknowns] = problem.regularisation.rows  # type: ignore[union-attr]
    both = np.vstack([design, held])
    scale = np.linalg.norm(both, axis=0)
    return design, (np.linalg.pinv(both / scale, rcond=1e-14) / scale[:, None])[:, : len(design)]


@pytest.mark.oracle
@pytest.mark.parametrize("options", CASES, ids=IDS)
def test_redundancy_is_that_of_the_hat_matrix(block: Block, options: dict[str, Any]) -> None:
    """The redundancy is the number of observations and priors minus the trace of their hat matrix."""
    _, problem = regularised(block, 19, **options)
    design, estimator = inverse_rows(problem, problem.start)
    trace = float(np.einsum("nu,un->", design, estimator))
    assert problem.redundancy == pytest.approx(len(design) - trace, abs=1e-5)
    assert problem.regularisation is not None
    determined = problem.n_free_unknowns - (trace - 3 * int(problem.active.sum()))
    assert problem.regularisation.determined == pytest.approx(determined, abs=1e-5)


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["dense", "schur", "graph"])
def test_sigma0_has_no_rows_of_the_penalty(block: Block, backend: str) -> None:
    """chi2 and sigma0 count residuals of image points and control points only, without the penalty."""
    solution = fg.adjust(block, eop_set=20, priors=False, regularisation="tikhonov", kappa=30.0, backend=backend)
    plain = without_penalties(solution.problem)
    residual = assemble(plain, solution.state, jacobian=False)[0]
    n = 2 * len(plain.observations) + 3 * int(plain.observed.sum())
    assert len(residual) == n and solution.chi2 == pytest.approx(float(residual @ residual), rel=1e-9)
    x = solution.problem.image_vector(solution.state)
    assert 30.0 * float(x @ x) > 1e-3 * solution.chi2  # the test would find the penalty
    assert solution.sigma0 == pytest.approx(np.sqrt(float(residual @ residual) / solution.redundancy), rel=1e-9)


@pytest.mark.oracle
def test_sigma0_of_simulated_blocks_is_one() -> None:
    """Squares over redundancy of simulated blocks have the mean 1, unlike with the penalty counted as priors.

    True deviations are N(0, 1 / kappa) and the noise is 1 in the block's linear model.
    """
    kappa, draws = 4.0, 4000
    _, problem = regularised(twin(), 15, regularisation="tikhonov", kappa=kappa)
    design, estimator = inverse_rows(problem, problem.start)
    rng, z = np.random.default_rng(3), problem.n_free_unknowns
    truth = np.zeros((design.shape[1], draws))
    truth[:z] = rng.standard_normal((z, draws)) / np.sqrt(kappa)
    observed = design @ truth + rng.standard_normal((len(design), draws))
    left = observed - design @ (estimator @ observed)
    ratio = np.sum(left**2, axis=0) / problem.redundancy
    assert np.mean(ratio) == pytest.approx(1.0, abs=5.0 * np.std(ratio) / np.sqrt(draws))
    counted_as_priors = problem.n_observations - problem.n_unknowns
    assert counted_as_priors - problem.redundancy > 1.0  # another number: the mean would be seen to differ
    assert abs(np.mean(ratio) * problem.redundancy / counted_as_priors - 1.0) > 10.0 * np.std(ratio) / np.sqrt(draws)


@pytest.mark.oracle
@pytest.mark.parametrize("options", [CASES[0], CASES[1], CASES[5]], ids=["ridge", "priors", "truncated"])
def test_expected_errors_of_check_points_are_those_of_simulated_blocks(block: Block, options: dict[str, Any]) -> None:
    """Expected errors and biases of check points equal those of 20 000 simulated blocks.

    True deviations of the images are N(0, 1), the noise is 1, and numpy estimates all unknowns.
    """
    options = {"priors": False, **options}
    solution = fg.adjust(block, eop_set=19, **options)
    points = solution.problem.block.points.where(Role.CHECK)[:3]
    found = expected_errors(solution.problem, solution.state, points)
    assert found is not None
    problem = solution.problem
    design, estimator = inverse_rows(problem, solution.state)
    rng, z, draws = np.random.default_rng(5), problem.n_free_unknowns, 20_000
    truth = np.zeros((design.shape[1], draws))
    truth[:z] = rng.standard_normal((z, draws))
    n = 2 * len(problem.observations) + 3 * int(problem.observed.sum())
    signal, noise = design[:n] @ truth, rng.standard_normal((n, draws))
    places = np.concatenate([np.arange(problem.point_columns[j], problem.point_columns[j] + 3) for j in points])
    gain = estimator[:, :n]  # a prior observes zero
    error, bias = (gain @ own - truth for own in (signal + noise, signal))
    for want, drawn in ((found.total, error[places]), (found.bias, bias[places])):
        products = drawn @ drawn.T / draws
        size = np.sqrt(np.outer(np.diag(want), np.diag(want)))
        assert np.abs(products - want).max() <= 5.0 * np.sqrt(2.0 / draws) * size.max()
        np.testing.assert_allclose(np.diag(products), np.diag(want), rtol=5.0 * np.sqrt(2.0 / draws))


@pytest.mark.truth
def test_expected_errors_of_a_true_prior_are_its_covariance(block: Block) -> None:
    """With kappa 1 the expected errors of check points are the posterior covariance of the adjustment with priors.

    Kappa 1 for deviations of one prior sigma is Bayes' estimate.
    """
    prior = fg.adjust(block, eop_set=20)
    ridge = fg.adjust(block, eop_set=20, priors=False, regularisation="tikhonov", kappa=1.0)
    points = block.points.where(Role.CHECK)
    found = expected_errors(ridge.problem, ridge.state, points)
    assert found is not None and prior.cofactors is not None
    want = prior.cofactors.joint((), tuple(points.tolist()))
    np.testing.assert_allclose(found.total, want, rtol=0.0, atol=1e-6 * np.abs(want).max())
    assert 0.0 < np.trace(found.bias) < np.trace(found.total)


@pytest.mark.behaviour
def test_expected_errors_of_observed_points_are_not_stated(block: Block) -> None:
    ridge = fg.adjust(block, eop_set=20, priors=False, regularisation="tikhonov", kappa=1.0)
    assert expected_errors(ridge.problem, ridge.state, block.points.where(Role.CONTROL)) is None
