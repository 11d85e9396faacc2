"""Minimum norm, truncation and Tikhonov on each backend agree with numpy after elimination of the points."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.dense import DenseBackend
from fg_orient.adjustment.penalty import Penalty
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError, NoSolutionError, RankDeficientError
from fg_orient.model.parameters import with_options
from fg_orient.quality import regularisation
from tests.support.dense_reduced import DEFICIENT, Array, dense_of, explicit_step, regularised, twin

EPS = float(np.finfo(float).eps)


@pytest.fixture(scope="module")
def block() -> Block:
    return twin()


def dense_step(problem: Problem) -> Array:
    step = DenseBackend(problem).linearise(problem.start).solve(0.0)
    return problem.image_vector(DenseBackend(problem).retract(problem.start, step))


def schur_step(problem: Problem) -> Array:
    return SchurBackend(problem, threads=1).linearise(problem.start).solve(0.0).image


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", DEFICIENT)
@pytest.mark.parametrize("kappa", [1.0, 1e-2])
def test_tikhonov_is_ridge_of_numpy(block: Block, eop_set: int, kappa: float) -> None:
    plain, problem = regularised(block, eop_set, regularisation="tikhonov", kappa=kappa)
    oracle = dense_of(plain)
    z = oracle.a.shape[1]
    rows, right = np.vstack([oracle.a, np.sqrt(kappa) * np.eye(z)]), np.append(oracle.right, np.zeros(z))
    x = np.linalg.lstsq(rows, right, rcond=None)[0]
    for step in (dense_step, schur_step, explicit_step):
        np.testing.assert_allclose(step(problem), x, rtol=0.0, atol=1e-8)


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", DEFICIENT)
def test_minimum_norm_is_pinv_of_numpy(block: Block, eop_set: int) -> None:
    """The minimum-norm step equals numpy's pseudo-inverse with the rank of the cut at 1e-9, where each set has a gap.

    The weakest direction has 1e9 as condition. A solution of size |x| is then known to some eps cond |x| in double
    precision (Wedin 1973), which is 1e-4 to 2 prior sigmas here: 1e-8 is impossible for any solver. Twenty times that
    is allowed.
    """
    plain, problem = regularised(block, eop_set, regularisation="minimum_norm")
    chosen, oracle = problem.regularisation, dense_of(plain)
    assert chosen is not None and chosen.gap >= regularisation.GAP
    s = np.linalg.svd(oracle.a, compute_uv=False)
    assert chosen.rank == int((s > 1e-9 * s[0]).sum()) == chosen.singular_values.size - chosen.held
    x = np.linalg.pinv(oracle.a, rcond=1e-9) @ oracle.right
    known = EPS * s[0] / s[chosen.rank - 1] * np.linalg.norm(x)
    for step in (dense_step, explicit_step):
        np.testing.assert_allclose(step(problem), x, rtol=0.0, atol=20.0 * known)


@pytest.mark.oracle
@pytest.mark.parametrize(("eop_set", "cut"), [(5, 1e-6), (17, 1e-6), (19, 1e-5)])
def test_minimum_norm_of_a_usable_rank_is_pinv_of_numpy(block: Block, eop_set: int, cut: float) -> None:
    plain, problem = regularised(block, eop_set, regularisation="minimum_norm", rank_cut=cut)
    chosen, oracle = problem.regularisation, dense_of(plain)
    assert chosen is not None and chosen.gap >= regularisation.GAP
    x = np.linalg.pinv(oracle.a, rcond=cut) @ oracle.right
    for step in (dense_step, explicit_step):
        np.testing.assert_allclose(step(problem), x, rtol=0.0, atol=1e-8)
    square = EPS * chosen.condition**2 * np.abs(x).max()  # normal equations square the condition
    np.testing.assert_allclose(schur_step(problem), x, rtol=0.0, atol=max(1e-8, square))


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", DEFICIENT)
def test_truncation_removes_small_singular_values(block: Block, eop_set: int) -> None:
    plain, problem = regularised(block, eop_set, regularisation="truncated", kappa=1.0)
    oracle = dense_of(plain)
    u, s, vt = np.linalg.svd(oracle.a, full_matrices=False)
    keep = s >= 1.0
    x = vt[keep].T @ ((u[:, keep].T @ oracle.right) / s[keep])
    assert problem.regularisation is not None and problem.regularisation.held == int((~keep).sum()) > 0
    for step in (dense_step, explicit_step):
        np.testing.assert_allclose(step(problem), x, rtol=0.0, atol=2e-8)


@pytest.mark.oracle
@pytest.mark.parametrize("eop_set", [17, 19])
def test_stein_is_a_multiple_of_the_minimum_norm(block: Block, eop_set: int) -> None:
    plain, problem = regularised(block, eop_set, regularisation="stein", rank_cut=1e-5)
    oracle, chosen = dense_of(plain), problem.regularisation
    assert chosen is not None
    x = np.linalg.pinv(oracle.a, rcond=1e-5) @ oracle.right
    fitted, f = oracle.a @ x, len(oracle.right) - chosen.rank
    squares = float(np.sum((fitted - oracle.right) ** 2))
    factor = 1.0 - (chosen.rank - 2) / (f + 2) * squares / float(fitted @ fitted)
    for step in (dense_step, explicit_step):
        np.testing.assert_allclose(step(problem), factor * x, rtol=0.0, atol=1e-8)


CASES: list[dict[str, Any]] = [
    {"regularisation": "tikhonov", "kappa_rule": "gcv"},
    {"regularisation": "truncated"},
    {"regularisation": "minimum_norm", "rank_cut": 1e-5},
    {"regularisation": "generalised_ridge", "rank_cut": 1e-5},
    {"regularisation": "ridge_stein", "rank_cut": 1e-5},
    {"regularisation": "tikhonov", "penalty": "laplace", "penalty_deviation": True},
]


@pytest.mark.consistency
@pytest.mark.parametrize("options", CASES, ids=lambda o: "-".join(map(str, o.values())))
@pytest.mark.parametrize("eop_set", [5, 19])
def test_backends_end_at_the_same_place(block: Block, eop_set: int, options: dict[str, Any]) -> None:
    solutions = [fg.adjust(block, eop_set=eop_set, priors=False, backend=b, **options)
                 for b in ("dense", "schur", "graph")]  # fmt: skip
    first = solutions[0]
    assert first.iterations < 20
    for other in solutions[1:]:
        np.testing.assert_allclose(other.state.image, first.state.image, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(other.ground_m, first.ground_m, rtol=0.0, atol=1e-6)
        assert other.chi2 == pytest.approx(first.chi2, rel=1e-9)
        assert other.status == first.status


@pytest.mark.consistency
def test_kappa_1_is_the_priors(block: Block) -> None:
    """In prior sigmas kappa 1 gives the solution with priors, and priors plus kappa 3 that of kappa 4."""
    prior = fg.adjust(block, eop_set=20)
    ridge = fg.adjust(block, eop_set=20, priors=False, regularisation="tikhonov")
    np.testing.assert_allclose(ridge.state.image, prior.state.image, rtol=0.0, atol=1e-9)
    assert ridge.status == prior.status
    # priors are observations, with their redundancy numbers; a penalty is none (determined at the start: 1e-3)
    assert ridge.redundancy == pytest.approx(prior.redundancy - np.sum(prior.residual_cofactors.prior), rel=1e-4)
    both = fg.adjust(block, eop_set=20, regularisation="tikhonov", kappa=3.0)
    four = fg.adjust(block, eop_set=20, priors=False, regularisation="tikhonov", kappa=4.0)
    np.testing.assert_allclose(both.state.image, four.state.image, rtol=0.0, atol=1e-9)


@pytest.mark.truth
def test_minimum_norm_counts_the_rank(block: Block) -> None:
    """With minimum norm the redundancy is the number of observations minus ground unknowns and rank."""
    solution = fg.adjust(block, eop_set=17, priors=False, regularisation="minimum_norm", rank_cut=1e-6)
    problem = solution.problem
    assert problem.regularisation is not None
    n = 2 * len(problem.observations) + 3 * int(problem.observed.sum())
    assert solution.redundancy == n - 3 * int(problem.active.sum()) - problem.regularisation.rank


@pytest.mark.behaviour
def test_without_a_regularisation_the_block_is_refused_and_told_of_it(block: Block) -> None:
    with pytest.raises(RankDeficientError, match="regularisation tikhonov"):
        fg.adjust(block, eop_set=20, priors=False)


@pytest.mark.behaviour
def test_ambiguous_rank_and_unusable_rank_are_doubts(block: Block) -> None:
    cut = fg.adjust(block, eop_set=20, priors=False, regularisation="minimum_norm", rank_cut=1e-4)
    assert cut.verdict.code == "regularise.rank_ambiguous"
    assert str(cut.status) == "not_trustworthy"
    weak = fg.adjust(block, eop_set=5, priors=False, regularisation="minimum_norm", max_iterations=2)
    assert "regularise.weak" in [f.code for f in weak.findings]


@pytest.mark.behaviour
@pytest.mark.parametrize(("code", "options"), [
    ("regularise.penalty", {"regularisation": "truncated", "penalty": "laplace"}),
    ("regularise.datum", {"regularisation": "tikhonov", "datum": "free"}),
    ("regularise.common_null", {"regularisation": "tikhonov", "penalty": "laplace"}),
    ("regularise.condition", {"regularisation": "minimum_norm", "backend": "schur"}),
    ("regularise.rule_priors", {"regularisation": "tikhonov", "kappa_rule": "lw", "priors": True}),
    ("linear.kappa_rule", {"regularisation": "tikhonov", "kappa_rule": "best"}),
    ("linear.kappa_needs", {"regularisation": "tikhonov", "kappa_rule": "cc"}),
])  # fmt: skip
def test_impossible_options_are_refused(block: Block, code: str, options: dict[str, Any]) -> None:
    with pytest.raises(InputError) as error:
        fg.adjust(block, **{"eop_set": 20, "priors": False, **options})
    assert [one.code for one in error.value.problems] == [code]


@pytest.mark.consistency
def test_a_problem_is_regularised_once(block: Block) -> None:
    _, problem = regularised(block, 20, regularisation="tikhonov")
    again = regularisation.with_regularisation(problem)
    assert sum(isinstance(e, Penalty) for e in again.block.extra) == problem.n_images


@pytest.mark.behaviour
def test_a_penalty_that_contradicts_the_observations_is_named(block: Block) -> None:
    """If a large kappa contradicts the observations, the verdict names the penalty as cause of sigma0.

    Kappa 1e4 expects deviations of 0.01 prior sigmas.
    """
    solution = fg.adjust(block, eop_set=15, priors=False, regularisation="tikhonov", kappa=1e4)
    assert solution.verdict.code == "verdict.sigma0_regularised"
    assert 0.0 < solution.verdict.data["share"] < 1.0


@pytest.mark.behaviour
def test_tests_of_unknowns_refuse_a_biased_estimate(block: Block) -> None:
    solution = fg.adjust(block, eop_set=15, priors=False, regularisation="tikhonov")
    with pytest.raises(NoSolutionError) as error:
        solution.significance()
    assert [one.code for one in error.value.problems] == ["statistics.significance_regularised"]


@pytest.mark.consistency
def test_factor_graph_of_a_block_has_the_penalties(block: Block) -> None:
    """GTSAM's optimiser on the graph of a regularised block ends at the solution of ``adjust``."""
    options: dict[str, Any] = {"eop_set": 19, "priors": False, "regularisation": "tikhonov", "kappa": 0.5}
    graph = fg.factor_graph(with_options(block, "test", **options))
    found = gtsam.GaussNewtonOptimizer(graph.graph, graph.values).optimize()
    ours, own = fg.adjust(block, **options), graph.solution(found)
    np.testing.assert_allclose(own.state.image, ours.state.image, rtol=0.0, atol=1e-6)
