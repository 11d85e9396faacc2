"""The L-curve and the places of all rules on it are compared with solutions that are computed one by one."""

from __future__ import annotations

import numpy as np
import pytest

from fg_orient.adjustment.linear.kappa import choose_kappa, kappa_rules
from fg_orient.adjustment.linear.l_curve import CURVE_POINTS, l_curve_of
from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.system import Array, Breakdown, LinearSystem
from fg_orient.model.errors import InputError
from tests.support.systems import design_system


@pytest.fixture
def system(rng: np.random.Generator) -> LinearSystem:
    return design_system(rng, 30, 6, 3.0)


def norms(system: LinearSystem, kappa: float) -> tuple[float, float]:
    """Return the residual and solution by the stacked system [A; sqrt(kappa) I]."""
    design, observed = system.require_design("test")
    stacked = np.vstack([design, np.sqrt(kappa) * np.eye(len(system))])
    x: Array = np.linalg.lstsq(stacked, np.append(observed, np.zeros(len(system))), rcond=None)[0]
    return float(np.linalg.norm(design @ x - observed)), float(np.linalg.norm(x))


@pytest.mark.oracle
def test_every_point_is_a_tikhonov_solution(system: LinearSystem) -> None:
    curve = l_curve_of(system)
    assert len(curve.kappa) == CURVE_POINTS and np.all(np.diff(curve.kappa) > 0.0)
    assert np.all(np.diff(curve.residual_norm) > 0.0) and np.all(np.diff(curve.solution_norm) < 0.0)
    for k in range(0, CURVE_POINTS, 20):
        wanted = norms(system, curve.kappa[k])
        assert (curve.residual_norm[k], curve.solution_norm[k]) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.oracle
def test_rules_have_their_places(system: LinearSystem) -> None:
    """Each rule that needs only the system has its own kappa or its own failure, and its norms lie on the L-curve."""
    curve = l_curve_of(system)
    assert {c.rule for c in curve.choices} == {name for name, rule in kappa_rules().items() if not rule.needs}
    found = {c.rule: c for c in curve.choices if not c.failure}
    assert set(found) == {"hkb", "lw", "od", "l_curve", "gcv", "maximum"}  # the curves of the others have no maximum
    for name in ("hkb", "lw", "od", "l_curve", "gcv"):
        own = solve(f"tikhonov_{name}", system)
        assert (own.rule, own.kappa) == (name, found[name].kappa)
    assert choose_kappa("maximum", system).kappa == found["maximum"].kappa
    for choice in curve.choices:
        if choice.failure:
            with pytest.raises(Breakdown, match=choice.failure):
                choose_kappa(choice.rule, system)
    for choice in found.values():
        assert (choice.residual_norm, choice.solution_norm) == pytest.approx(norms(system, choice.kappa), rel=1e-9)
        assert choice.kappa == 0.0 or curve.kappa[0] <= choice.kappa * (1 + 1e-12) <= curve.kappa[-1] * (1 + 2e-12)


@pytest.mark.oracle
def test_any_kappa_has_its_place(system: LinearSystem) -> None:
    curve = l_curve_of(system)
    gcv = next(c for c in curve.choices if c.rule == "gcv")
    assert curve.place(gcv.kappa) == (gcv.residual_norm, gcv.solution_norm)
    between = float(np.sqrt(curve.kappa[40] * curve.kappa[41]))
    assert curve.place(between) == pytest.approx(norms(system, between), rel=1e-3)
    assert np.isnan(curve.place(2.0 * curve.kappa[-1])).all() and np.isnan(curve.place(float("nan"))).all()


@pytest.mark.oracle
def test_the_corner_bends_most(system: LinearSystem) -> None:
    """The L-curve rule chooses the kappa of largest curvature, which equals differences of the curve within 2 %."""
    curve = l_curve_of(system)
    at, x, y = np.log(curve.kappa), np.log(curve.residual_norm), np.log(curve.solution_norm)
    dx, dy = np.gradient(x, at), np.gradient(y, at)
    ddx, ddy = np.gradient(dx, at), np.gradient(dy, at)
    bend = (dx * ddy - ddx * dy) / (dx**2 + dy**2) ** 1.5
    inner = slice(3, -3)
    assert np.abs(bend - curve.curvature)[inner].max() <= 0.02 * np.abs(curve.curvature).max()  # of differences
    corner = next(c for c in curve.choices if c.rule == "l_curve")
    assert abs(np.searchsorted(curve.kappa, corner.kappa) - int(np.argmax(curve.curvature))) <= 1


@pytest.mark.behaviour
def test_a_rule_that_finds_nothing_says_why_and_the_others_stay() -> None:
    """Without redundancy HKB fails with its reason, and GCV and the curve are still computed."""
    curve = l_curve_of(LinearSystem.from_design(np.diag([3.0, 0.1]), np.array([1.0, 1.0])))
    found = {c.rule: c for c in curve.choices}
    assert np.isnan(found["hkb"].kappa) and "more observations than unknowns" in found["hkb"].failure
    assert found["gcv"].failure == "" and np.isfinite(curve.kappa).all()


@pytest.mark.behaviour
def test_kappa_zero_of_a_singular_system_has_no_place() -> None:
    design = np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    curve = l_curve_of(LinearSystem.from_design(design, np.array([1.0, 2.0, 4.0])))
    (zero,) = (choice for choice in curve.choices if choice.kappa == 0.0)
    assert zero.rule == "od" and np.isnan([zero.residual_norm, zero.solution_norm]).all()
    assert np.isfinite([choice.solution_norm for choice in curve.choices if choice.kappa > 0.0]).all()
    assert np.isfinite(curve.residual_norm).all()


@pytest.mark.behaviour
def test_the_design_must_be_known(system: LinearSystem) -> None:
    with pytest.raises(InputError, match="design"):
        l_curve_of(LinearSystem(system.normal, system.rhs))
    assert choose_kappa("od", LinearSystem(system.normal, system.rhs)).rule == "od"
