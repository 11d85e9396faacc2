"""Blocks with too many image unknowns for a decomposition give the same numbers without it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.normal_equations import NormalEquations
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.parameters import with_options
from fg_orient.quality import regularisation
from fg_orient.quality.deficiency import compiled_problem
from fg_orient.simulate.block import BlockOptions, grid_block
from tests.support.dense_reduced import dense_of

OPTIONS: dict[str, Any] = {"eop_set": 20, "priors": False, "regularisation": "tikhonov"}


@pytest.fixture(scope="module")
def block() -> Block:
    """Return four images with control and tie points."""
    return grid_block(BlockOptions(rows=2, columns=2, points=150, seed=5))[0]


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Forbid decompositions of more than ten unknowns."""
    monkeypatch.setattr(regularisation, "MAX_UNKNOWNS", 10)
    return monkeypatch


@pytest.mark.oracle
@pytest.mark.parametrize("more", [{}, {"look_polynomial": 1, "look_shared": True}], ids=["own", "shared"])
def test_normal_equations_are_those_of_numpy(block: Block, more: dict[str, Any]) -> None:
    """The reduced normal equations of a large block equal numpy's: right-hand side, squares, products and factor.

    Shared unknowns count once.
    """
    problem = compiled_problem(with_options(block, "test", **{**OPTIONS, "eop_set": 1, "priors": True, **more}))
    plain = compiled_problem(with_options(block, "test", **{**OPTIONS, "eop_set": 1, **more}))
    found, (a, right) = NormalEquations.of(problem, problem.start), dense_of(plain)[:2]
    normal = a.T @ a
    size = np.linalg.norm(normal, 2)
    np.testing.assert_allclose(found.rhs, a.T @ right, rtol=0.0, atol=1e-9 * np.linalg.norm(a.T @ right))
    assert found.squares == pytest.approx(float(right @ right), rel=1e-9)
    assert 0.5 * size < found.largest() <= size * (1.0 + 1e-9)
    x = np.random.default_rng(0).standard_normal((len(normal), 3))
    np.testing.assert_allclose(found.product(x[:, 0]), normal @ x[:, 0], rtol=0.0, atol=1e-9 * size)
    solved = np.linalg.solve(normal + 0.1 * size * np.eye(len(normal)), x)
    np.testing.assert_allclose(found.factor(0.1 * size)(x), solved, rtol=0.0, atol=1e-9 * np.abs(solved).max())


@pytest.mark.consistency
@pytest.mark.parametrize("rule", ["l_curve", "discrepancy", "quasi_optimality", "gcv"])
def test_sampled_rules_are_those_of_the_decomposition(block: Block, rule: str, large: pytest.MonkeyPatch) -> None:
    """Each kappa rule with sampled traces chooses the kappa of the decomposition within 1e-3.

    For GCV the exact kappa lies in its interval, widened five times; the other rules have no sampled trace.
    """
    problem = compiled_problem(with_options(block, "test", **OPTIONS, kappa_rule=rule))
    sampled = regularisation.with_regularisation(problem).regularisation
    large.undo()
    exact = regularisation.with_regularisation(problem).regularisation
    assert sampled is not None and exact is not None and sampled.choice is not None and exact.kappa is not None
    notes = " ".join(sampled.choice.notes)
    assert "standard error of the trace" in notes
    if rule != "gcv":
        assert sampled.kappa == pytest.approx(exact.kappa, rel=1e-3)
        return
    low, high = (float(word) for word in notes.split("kappa ")[1].split(" at")[0].split(" to "))
    assert low / (high / low) ** 2 <= exact.kappa <= high * (high / low) ** 2


@pytest.mark.consistency
@pytest.mark.parametrize("priors", [False, True])
def test_solution_and_resolution_are_those_of_the_decomposition(
    block: Block, priors: bool, large: pytest.MonkeyPatch
) -> None:
    options = {**OPTIONS, "priors": priors, "kappa": 0.5}
    one = fg.adjust(block, **options)
    first = one.regularisation
    large.undo()
    other = fg.adjust(block, **options)
    second = other.regularisation
    assert first is not None and second is not None and first["rank"] is None
    np.testing.assert_allclose(one.state.image, other.state.image, rtol=0.0, atol=1e-9)
    for key in ("resolution", "sd_posterior", "bias_plug_in"):
        np.testing.assert_allclose(
            [u[key] for u in first["unknowns"]], [u[key] for u in second["unknowns"]], rtol=0.0, atol=1e-7
        )
    assert first["effective_unknowns"] == pytest.approx(second["effective_unknowns"], rel=1e-6)


@pytest.mark.behaviour
@pytest.mark.parametrize(("code", "options"), [
    ("regularise.rule_large", {"kappa_rule": "hkb"}),
    ("linear.too_large", {"regularisation": "minimum_norm"}),
    ("linear.too_large", {"penalty": "laplace", "penalty_deviation": True}),
])  # fmt: skip
def test_what_needs_a_decomposition_is_refused(
    block: Block, code: str, options: dict[str, Any], large: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError) as error:
        fg.adjust(block, **{**OPTIONS, **options})
    assert [one.code for one in error.value.problems] == [code]


@pytest.mark.consistency
def test_small_kappa_that_gtsam_refuses_is_solved(block: Block) -> None:
    """With a small kappa the Schur backend is used and agrees with dense within 1e-5 m.

    GTSAM's Cholesky refuses pivots of very different size.
    """
    small = fg.adjust(block, **OPTIONS, kappa=1e-5)
    assert small.backend == "schur"
    dense = fg.adjust(block, **OPTIONS, kappa=1e-5, backend="dense")
    np.testing.assert_allclose(small.ground_m, dense.ground_m, rtol=0.0, atol=1e-5)
