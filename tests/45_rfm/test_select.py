"""Selections fulfil their definitions: conditions of optimality, refits of all subsets, known terms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize

from fg_orient.model.errors import InputError
from fg_orient.rpc import select
from fg_orient.rpc.estimate import fit_linear, linear_system
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.points import ControlPoints, Scaling
from fg_orient.rpc.select import _REGISTRY, Reduced, Selection, fit_selected, lasso_solution, press_of

Make = Callable[..., ControlPoints]
TERMS = {"b100", "b001", "a110", "a002", "c200", "d010"}


@pytest.fixture
def reduced(make: Make) -> Reduced:
    return Reduced.of(make(60, noise_px=0.5), RfmForm(2))


@pytest.mark.oracle
def test_reduced_system_gives_the_solution_of_the_whole(make: Make, reduced: Reduced) -> None:
    whole = fit_linear(make(60, noise_px=0.5), RfmForm(2))
    x, square, cofactors = reduced.fit(np.arange(reduced.design.shape[1]))
    np.testing.assert_allclose(x, whole.x[reduced.unknowns], rtol=1e-6, atol=1e-9)
    v = whole.linear_residuals_px / whole.scaling.scales[:2]
    assert square == pytest.approx(np.sum(v**2), rel=1e-8, abs=0.0)
    assert whole.cofactors is not None
    np.testing.assert_allclose(cofactors, np.diag(whole.cofactors)[reduced.unknowns], rtol=1e-6)
    points, form = make(60, noise_px=0.5), RfmForm(2)
    a, observed = linear_system(points, form, Scaling.of(points)).require_design("test")
    length = np.linalg.norm(a, axis=0)
    numpys = np.linalg.lstsq(a / length, observed, rcond=None)[0] / length
    np.testing.assert_allclose(x, numpys[reduced.unknowns], rtol=1e-6, atol=1e-9)
    inverse = np.linalg.pinv(a / length)
    np.testing.assert_allclose(cofactors, (np.sum(inverse**2, axis=1) / length**2)[reduced.unknowns], rtol=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize("name", sorted(_REGISTRY))
def test_every_selection_predicts_better_than_the_affine_model(make: Make, name: str) -> None:
    points, form = make(60, noise_px=0.5), RfmForm(2)
    found, fresh = fit_selected(points, form, name), make(60, seed=5)
    assert (found.choice.keys() & {"kappa", "terms"}) != set()
    affine = fit_linear(points, RfmForm(1, "one"))
    error, without = np.sqrt(np.mean(found.residuals_px(fresh) ** 2)), np.sqrt(np.mean(affine.residuals_px(fresh) ** 2))
    assert error < 0.7 < 0.02 * without


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["lasso", "nested", "uss", "scatter"])
def test_selection_explains_the_points_with_few_terms(make: Make, name: str) -> None:
    found = fit_selected(make(80, noise_px=0.3, seed=3), RfmForm(2), name)
    assert 6 <= len(found.choice["terms"].split()) <= 20
    assert found.m0_px == pytest.approx(0.3, rel=0.25)


@pytest.mark.truth
def test_nested_and_scatter_find_the_terms_of_a_regression(rng: np.random.Generator) -> None:
    design, truth = rng.standard_normal((80, 12)), np.zeros(12)
    truth[[1, 4, 7]] = 3.0, -2.0, 1.0
    observed = design @ truth + 0.1 * rng.standard_normal(80)
    made = Reduced(design, observed, np.arange(12), np.zeros(0, dtype=np.intp), np.zeros((80, 0)))
    for name in ("nested", "uss", "lasso", "scatter"):
        chosen = set(_REGISTRY[name].function(made).chosen.tolist())
        assert {1, 4, 7} <= chosen, name
        assert len(chosen) <= 6, name


@pytest.mark.oracle
def test_lasso_meets_its_optimality_conditions(rng: np.random.Generator) -> None:
    design = rng.standard_normal((40, 15)) + 0.8 * rng.standard_normal((40, 1))
    design /= np.linalg.norm(design, axis=0)
    observed = design @ np.r_[2.0, -1.0, np.zeros(13)] + 0.1 * rng.standard_normal(40)
    x = lasso_solution(design, observed, 0.2)
    gradient = design.T @ (observed - design @ x)
    np.testing.assert_allclose(gradient[x != 0.0], 0.2 * np.sign(x[x != 0.0]), atol=1e-6)
    assert (np.abs(gradient) <= 0.2 + 1e-6).all()

    def cost(z: np.ndarray) -> float:
        return float(0.5 * np.sum((design @ (z[:15] - z[15:]) - observed) ** 2) + 0.2 * z.sum())

    peer = minimize(cost, np.zeros(30), bounds=[(0.0, None)] * 30, method="L-BFGS-B", options={"ftol": 1e-14})
    assert cost(np.r_[np.maximum(x, 0.0), np.maximum(-x, 0.0)]) <= peer.fun * (1.0 + 1e-6)


@pytest.mark.oracle
def test_press_is_that_of_refits(make: Make) -> None:
    """PRESS equals refits of the penalised system without each point, the affine basis unpenalised."""
    reduced, kappa = Reduced.of(make(25, noise_px=0.5), RfmForm(1)), 0.05
    design = np.hstack([reduced.affine, reduced.design])
    penalty = np.r_[np.zeros(reduced.affine.shape[1]), np.full(reduced.design.shape[1], kappa)]
    n, total = len(design) // 2, 0.0
    for i in range(n):
        keep = np.ones(2 * n, dtype=bool)
        keep[[i, n + i]] = False
        a, b = design[keep], reduced.observed[keep]
        x = np.linalg.solve(a.T @ a + np.diag(penalty), a.T @ b)
        total += float(np.sum((design[~keep] @ x - reduced.observed[~keep]) ** 2))
    assert press_of(reduced, kappa) == pytest.approx(total, rel=1e-8)


@pytest.mark.consistency
def test_ridge_rules_are_those_of_the_registry(make: Make) -> None:
    from fg_orient.adjustment.linear.kappa import choose_kappa

    reduced = Reduced.of(make(60, noise_px=0.5), RfmForm(2))
    for name, rule in (("ridge_gcv", "gcv"), ("ridge_l_curve", "l_curve")):
        assert _REGISTRY[name].function(reduced).kappa == choose_kappa(rule, reduced.system).kappa


@pytest.mark.behaviour
def test_a_selection_of_ones_own(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(select, "_REGISTRY", dict(select._REGISTRY))

    @select.register_selection("none", "affine only", source="here")
    def none(reduced: Reduced) -> Selection:
        return Selection(np.zeros(0, dtype=np.intp))

    found = fit_selected(make(30), RfmForm(2), "none")
    assert len(found.x) == 8
    with pytest.raises(ValueError, match="already"):
        select.register_selection("none", "other", source="")(select.lasso)
    with pytest.raises(InputError, match="unknown selection"):
        fit_selected(make(30), RfmForm(2), "best")
