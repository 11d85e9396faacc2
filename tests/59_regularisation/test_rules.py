"""Rules of kappa on the reduced system agree with the dense form and with their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from fg_orient.adjustment.linear.kappa import choose_kappa
from fg_orient.adjustment.linear.system import Breakdown, LinearSystem
from fg_orient.model.block import Block
from fg_orient.quality.regularisation import given_inputs
from tests.support.dense_reduced import DEFICIENT, dense_of, regularised, twin

RULES = ("l_curve", "gcv", "discrepancy", "quasi_optimality", "hkb", "bayes", "maximum")


@pytest.fixture(scope="module")
def block() -> Block:
    return twin()


def kappa_of(rule: str, system: LinearSystem) -> float:
    try:
        return choose_kappa(rule, system, given_inputs(system)).kappa
    except Breakdown:
        return float("nan")


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", DEFICIENT)
def test_reduced_rules_are_those_of_the_dense_form(block: Block, eop_set: int) -> None:
    """Each kappa rule on the reduced system chooses the kappa of the dense form within 1e-6.

    numpy projects the points out of all rows; HKB there starts from the minimum norm with u = rank.
    """
    plain, problem = regularised(block, eop_set, regularisation="tikhonov")
    assert problem.regularisation is not None
    reduced, oracle = problem.regularisation.standard, dense_of(plain)
    _, s, vt = np.linalg.svd(oracle.a, full_matrices=False)
    basis = vt[s > 1e-9 * s[0]].T
    dense = LinearSystem.from_design(oracle.a @ basis, oracle.right)
    for rule in RULES:
        one, other = (kappa_of(rule, system) for system in (reduced, dense))
        assert one == pytest.approx(other, rel=1e-6, nan_ok=True), rule
        assert np.isfinite(one) or (rule, eop_set) == ("discrepancy", 5)  # velocity alone leaves residuals of 8 sigmas


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", DEFICIENT)
def test_gcv_is_least_with_the_hat_matrix_of_all_observations(block: Block, eop_set: int) -> None:
    """GCV chooses the kappa that minimises GCV with the hat matrix of all observations.

    Ground points are unknowns there; rows are all whitened image and control observations.
    """
    plain, problem = regularised(block, eop_set, regularisation="tikhonov", kappa_rule="gcv")
    chosen, oracle = problem.regularisation, dense_of(plain)
    assert chosen is not None and chosen.kappa is not None
    z, (n, u) = plain.n_free_unknowns, oracle.j.shape

    def gcv(kappa: float) -> float:
        rows = np.vstack([oracle.j, np.hstack([np.sqrt(kappa) * np.eye(z), np.zeros((z, u - z))])])
        q = np.linalg.qr(rows / np.linalg.norm(rows, axis=0)).Q[:n]
        left = oracle.residual - q @ (q.T @ oracle.residual)
        return float(n * left @ left / (n - np.sum(q**2)) ** 2)

    least = gcv(chosen.kappa)
    assert least < min(gcv(chosen.kappa * f) for f in (0.9, 1.1, 0.1, 10.0))
    assert least == pytest.approx(min(gcv(chosen.kappa * f) for f in np.geomspace(0.99, 1.01, 21)), rel=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", DEFICIENT)
def test_hkb_and_lw_by_their_formulas(block: Block, eop_set: int) -> None:
    """HKB and LW choose kappa by T(3.5) and T(3.6) with the minimum-norm solution and u = rank.

    LW has |A x|^2 as denominator; its form with eigenvalues of N = A^T A loses five digits in the dense form.
    """
    plain, problem = regularised(block, eop_set, regularisation="tikhonov")
    assert problem.regularisation is not None
    a, right = dense_of(plain)[:2]
    rank = problem.regularisation.rank
    x = np.linalg.pinv(a, rcond=1e-9) @ right
    s2 = float(np.sum((a @ x - right) ** 2)) / (len(right) - rank)
    system = problem.regularisation.standard
    # rel: x is known to eps cond = 1e-7 at this rank
    hkb = choose_kappa("hkb", system, given_inputs(system)).kappa
    assert hkb == pytest.approx(rank * s2 / (x @ x), rel=1e-5, abs=0.0)
    assert choose_kappa("lw", system, given_inputs(system)).kappa == pytest.approx(rank * s2 / np.sum((a @ x) ** 2))


@pytest.mark.truth
def test_discrepancy_leaves_residuals_of_the_size_of_the_noise(block: Block) -> None:
    plain, problem = regularised(block, 20, regularisation="tikhonov", kappa_rule="discrepancy")
    a, right = dense_of(plain)[:2]
    assert problem.regularisation is not None
    kappa, z = problem.regularisation.kappa, a.shape[1]
    assert kappa is not None
    x = np.linalg.solve(a.T @ a + kappa * np.eye(z), a.T @ right)
    assert np.sum((a @ x - right) ** 2) == pytest.approx(len(right), rel=1e-6)
