"""Resolution, bias and variance of regularised estimates agree with numpy with the points as unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.block import Block
from fg_orient.quality.resolution import DRAWS, resolution
from tests.support.dense_reduced import Array, dense_of, regularised, twin

CASES: list[dict[str, Any]] = [
    {"kappa": 0.5},
    {"kappa": 0.5, "priors": True},
    {"kappa": 0.1, "penalty": "gradient", "penalty_deviation": True},
]


@pytest.fixture(scope="module")
def block() -> Block:
    return twin()


def estimate(rows: Array, held: Array, right: Array) -> Array:
    """Return the least squares of all unknowns with rows ``held x = 0``, in columns of unit length."""
    whole = np.vstack([rows, held])
    scale = np.linalg.norm(whole, axis=0)
    right = np.concatenate([right, np.zeros((len(held), right.shape[1]))])
    return np.linalg.lstsq(whole / scale, right, rcond=None)[0] / scale[:, None]


@pytest.mark.oracle
@pytest.mark.parametrize("options", CASES, ids=["ridge", "priors", "gradient"])
def test_resolution_is_the_response_to_the_true_value(block: Block, options: dict[str, Any]) -> None:
    """Each column of the resolution matrix is the estimate for one true deviation of 1 without noise.

    numpy estimates all unknowns of the linear model; the column is that of Q N.
    """
    plain, problem = regularised(block, 19, regularisation="tikhonov", **options)
    j, z = dense_of(plain).j, plain.n_free_unknowns
    n = j.shape[0] - (z if plain.block.options.priors else 0)
    held = np.zeros((z, j.shape[1]))
    assert problem.regularisation is not None
    rows = problem.regularisation.rows
    held = np.vstack([np.pad(rows, ((0, 0), (0, j.shape[1] - z))), j[n:]])
    response = estimate(j[:n], held, j[:n, :z])[:z]
    found = resolution(problem, problem.start)
    np.testing.assert_allclose(found.matrix, response, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(found.eigenvalues, np.sort(np.linalg.eigvals(response).real)[::-1], rtol=0.0, atol=1e-6)


@pytest.mark.oracle
def test_noise_and_posterior_are_those_of_the_estimator(block: Block) -> None:
    """Noise and posterior sigmas equal numpy's estimator and inverse of the whole normal matrix."""
    plain, problem = regularised(block, 19, regularisation="tikhonov", kappa=0.5)
    j, z = dense_of(plain).j, plain.n_free_unknowns
    held = np.pad(np.sqrt(0.5) * np.eye(z), ((0, 0), (0, j.shape[1] - z)))
    found = resolution(problem, problem.start)
    gain = estimate(j, held, np.eye(len(j)))[:z]
    np.testing.assert_allclose(found.noise, np.linalg.norm(gain, axis=1), rtol=1e-8)
    whole = np.vstack([j, held])
    scale = np.linalg.norm(whole, axis=0)
    inverse = np.linalg.inv(np.linalg.qr(whole / scale).R) / scale[:, None]
    np.testing.assert_allclose(found.posterior, np.linalg.norm(inverse, axis=1)[:z], rtol=1e-8)


@pytest.mark.truth
def test_simulated_error_is_noise_and_bias(block: Block) -> None:
    """The simulated error for true deviations N(0, 1) is that of noise and bias within 5 standard errors.

    The bias is I - Q N.
    """
    _, problem = regularised(block, 19, regularisation="tikhonov", kappa=0.5)
    found = resolution(problem, problem.start)
    bias = np.linalg.norm(np.eye(len(found.bias)) - found.matrix, axis=1)
    expected = np.hypot(found.noise, bias)
    np.testing.assert_allclose(found.rmse, expected, rtol=5.0 / np.sqrt(2.0 * DRAWS))


@pytest.mark.truth
@pytest.mark.parametrize("method", ["truncated", "minimum_norm"])
def test_held_directions_have_no_resolution_and_their_own_bias(block: Block, method: str) -> None:
    """A held direction has the resolution 0 and a bias of one prior sigma for a deviation of one."""
    _, problem = regularised(block, 19, regularisation=method, rank_cut=1e-5)
    found, chosen = resolution(problem, problem.start), problem.regularisation
    assert chosen is not None and chosen.held > 0
    free = len(found.bias) - chosen.held
    np.testing.assert_allclose(found.eigenvalues[:free], 1.0, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(found.eigenvalues[free:], 0.0, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(found.bias_bound, np.linalg.norm(chosen.null, axis=1), rtol=0.0, atol=1e-5)


@pytest.mark.consistency
def test_record_lists_each_unknown(block: Block) -> None:
    solution = fg.adjust(block, eop_set=20, priors=False, regularisation="tikhonov", kappa_rule="gcv")
    record = solution.regularisation
    assert record is not None
    assert [(u["image"], u["unknown"]) for u in record["unknowns"]] == [
        (image.id, name) for image, p in zip(block.images, solution.problem.parameters, strict=True) for name in p.names
    ]
    # yaw and velocity across track are one direction: the data determine only their sum
    by_name = {u["unknown"]: u for u in record["unknowns"] if u["image"] == "left"}
    assert by_name["roll_0"]["determined_by"] == "observations"
    assert by_name["vx_0"]["determined_by"] == "metadata"
    assert record["effective_unknowns"] == pytest.approx(sum(u["resolution"] for u in record["unknowns"]))
    (choice,) = [rule for rule in record["rules"] if rule["rule"] == "gcv"]
    assert choice["kappa"] == record["kappa"]
