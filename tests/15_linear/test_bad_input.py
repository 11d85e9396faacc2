"""Bad input is refused in words; user-defined solvers and rules work; solvers may not return certain results."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fg_orient.adjustment.linear import kappa as kappa_module
from fg_orient.adjustment.linear import registry
from fg_orient.adjustment.linear.kappa import (
    Given,
    KappaChoice,
    choose_kappa,
    kappa_rules,
    register_kappa_rule,
    unit_variance,
)
from fg_orient.adjustment.linear.registry import attempt, register_solver, solve, solver, solvers
from fg_orient.adjustment.linear.ridge import regularised, tikhonov
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS, Breakdown, LinearSolution, LinearSystem, diagnose
from fg_orient.model.errors import InputError

EYE = LinearSystem(np.eye(2), np.ones(2))
SQUARE = LinearSystem.from_design(np.eye(2), np.ones(2))

CASES: dict[str, tuple[Callable[[], object], str, str]] = {
    "not square": (lambda: LinearSystem(np.ones((2, 3)), np.ones(2)), "linear.not_square", "(2, 3)"),
    "empty": (lambda: LinearSystem(np.ones((0, 0)), np.ones(0)), "linear.not_square", "(0, 0)"),
    "not symmetric": (
        lambda: LinearSystem(np.array([[1.0, 2.0], [2.1, 5.0]]), np.ones(2)),
        "linear.not_symmetric",
        "0.1",
    ),
    "nan": (lambda: LinearSystem(np.diag([1.0, np.nan]), np.ones(2)), "linear.not_finite", "nan"),
    "infinite": (lambda: LinearSystem(np.diag([np.inf, 1.0]), np.ones(2)), "linear.not_finite", "inf"),
    "nan in b": (lambda: LinearSystem(np.eye(2), np.array([1.0, np.nan])), "linear.rhs", "(2,)"),
    "short b": (lambda: LinearSystem(np.eye(2), np.ones(3)), "linear.rhs", "(3,)"),
    "short l": (lambda: LinearSystem(np.eye(2), np.ones(2), np.eye(2), np.ones(3)), "linear.design", "(2, 2)"),
    "A without l": (lambda: LinearSystem(np.eye(2), np.ones(2), np.eye(2)), "linear.design", "(2, 2)"),
    "nan in A": (lambda: diagnose(np.array([[1.0, np.nan]])), "linear.design", "nan"),
    "A no matrix": (lambda: diagnose(np.ones(3)), "linear.design", "(3,)"),
    "from_design no matrix": (lambda: LinearSystem.from_design(np.ones(3), np.ones(3)), "linear.design", "(3,)"),
    "from_design sizes": (lambda: LinearSystem.from_design(np.eye(3), np.ones(2)), "linear.design", "(3, 3)"),
    "from_design nan": (
        lambda: LinearSystem.from_design(np.eye(2), np.array([1.0, np.inf])),
        "linear.design",
        "inf",
    ),
    "too large": (
        lambda: LinearSystem.from_design(np.ones((1, MAX_UNKNOWNS + 1)), np.ones(1)),
        "linear.too_large",
        "2001",
    ),
    "too large N": (
        lambda: LinearSystem(np.zeros((MAX_UNKNOWNS + 1, MAX_UNKNOWNS + 1)), np.zeros(MAX_UNKNOWNS + 1)),
        "linear.too_large",
        "2001",
    ),
    "no redundancy for s0": (lambda: unit_variance(SQUARE, np.ones(2)), "linear.redundancy", "2 rows, 2 unknowns"),
    "no redundancy for HKB": (lambda: solve("tikhonov_hkb", SQUARE), "linear.redundancy", "2 rows, 2 unknowns"),
    "complex N": (lambda: LinearSystem(np.eye(2) * 1j, np.ones(2)), "linear.not_real", "complex128"),
    "complex A": (lambda: LinearSystem.from_design(np.eye(2) * 1j, np.ones(2)), "linear.not_real", "complex128"),
    "words in b": (lambda: LinearSystem(np.eye(2), np.array(["1", "2"])), "linear.not_real", "<U1"),
    "squares overflow": (lambda: LinearSystem.from_design(np.eye(2) * 1e200, np.ones(2)), "linear.not_finite", "inf"),
    "truth does not fit": (lambda: choose_kappa("cc", SQUARE, Given(truth=np.ones(3))), "linear.truth", "(3,)"),
    "Bayes of no sigma": (
        lambda: choose_kappa("bayes", SQUARE, Given(sigma_observed=-1.0, sigma_unknown=1.0)),
        "linear.sigmas",
        "-1",
    ),
    "no design": (lambda: solve("qr", EYE), "linear.no_design", ""),
    "no design for a curve": (lambda: tikhonov(EYE, "gcv"), "linear.no_design", ""),
    "unknown solver": (lambda: solver("cramer"), "linear.solver", "cramer"),
    "unknown rule": (lambda: choose_kappa("best", EYE), "linear.kappa_rule", "best"),
    "rule lacks noise": (lambda: choose_kappa("discrepancy", SQUARE), "linear.kappa_needs", ""),
    "negative kappa": (lambda: regularised(EYE, -1.0), "linear.kappa_value", "-1.0"),
    "kappa nan": (lambda: regularised(EYE, np.nan), "linear.kappa_value", "nan"),
    "penalty shape": (lambda: regularised(EYE, 1.0, np.ones((2, 3))), "linear.penalty", "(2, 3)"),
}


@pytest.mark.behaviour
@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_refused_in_words(case: str) -> None:
    call, code, value = CASES[case]
    with pytest.raises(InputError) as caught:
        call()
    (fault,) = caught.value.problems
    assert fault.code == code
    assert value in fault.value
    assert fault.remedy


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "normal", [np.eye(MAX_UNKNOWNS), np.array([[2.0, 1.0], [1.0 + 1e-13, 3.0]])], ids=["size", "rounding"]
)
def test_the_limit_itself_and_rounding_are_allowed(normal: np.ndarray) -> None:
    assert MAX_UNKNOWNS == 2000
    assert len(LinearSystem(normal, np.ones(len(normal)))) == len(normal)


@pytest.mark.consistency
@pytest.mark.parametrize("name", solvers())
def test_whole_numbers_are_numbers(name: str) -> None:
    design, observed = np.array([[2, 0], [0, 3], [1, 1], [2, 5]]), np.array([1, 2, 3, 4])
    whole = attempt(name, LinearSystem.from_design(design, observed))
    real = attempt(name, LinearSystem.from_design(design.astype(float), observed.astype(float)))
    assert np.array_equal(whole.x, real.x, equal_nan=True)


@pytest.fixture
def open_registries(monkeypatch: pytest.MonkeyPatch) -> None:
    solvers(), kappa_rules()  # load all before the copies
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))
    monkeypatch.setattr(kappa_module, "_REGISTRY", dict(kappa_module._REGISTRY))


@pytest.mark.behaviour
@pytest.mark.usefixtures("open_registries")
def test_solver_from_outside() -> None:
    @register_solver("ours", "Ours", "modern", source="test")
    def ours(system: LinearSystem, as_run: bool) -> LinearSolution:
        return LinearSolution(np.linalg.solve(system.normal, system.rhs), notes=(f"as_run {as_run}",))

    assert list(solvers())[-1] == "ours"
    found = solve("ours", EYE, as_run=True)
    assert found.x.tolist() == [1.0, 1.0]
    assert found.notes == ("as_run True",)
    with pytest.raises(Breakdown, match=r"ours: the linear algebra library stopped \(found Singular matrix\)"):
        solve("ours", LinearSystem(np.zeros((2, 2)), np.ones(2)))
    assert "Singular" in attempt("ours", LinearSystem(np.zeros((2, 2)), np.ones(2))).failure
    regular = LinearSystem.from_design(np.vstack([np.eye(2), np.eye(2)]), np.ones(4))
    assert regularised(regular, 2.0, solver="ours").x == pytest.approx([0.5, 0.5], rel=1e-12)


@pytest.mark.behaviour
@pytest.mark.usefixtures("open_registries")
@pytest.mark.parametrize(
    ("x", "error", "code"),
    [
        (np.array([np.nan, 1.0]), Breakdown, "linear.result_not_finite"),
        (np.array([np.inf, 1.0]), Breakdown, "linear.result_not_finite"),
        (np.ones(3), InputError, "linear.result_shape"),
        (np.ones(2) + 1j, InputError, "linear.result_shape"),
    ],
)
def test_a_solver_may_not_give_nonsense(x: np.ndarray, error: type[Exception], code: str) -> None:
    @register_solver("nonsense", "Nonsense", "modern", source="test")
    def nonsense(system: LinearSystem, as_run: bool) -> LinearSolution:
        return LinearSolution(x)

    with pytest.raises(error) as caught:
        solve("nonsense", EYE)
    assert caught.value.problems[0].code == code  # type: ignore[attr-defined]


@pytest.mark.behaviour
@pytest.mark.usefixtures("open_registries")
def test_names_are_unique() -> None:
    with pytest.raises(ValueError, match="'qr' is registered already"):

        @register_solver("qr", "Another", "modern", source="test")
        def another(system: LinearSystem, as_run: bool) -> LinearSolution:
            return LinearSolution(system.rhs)

    with pytest.raises(ValueError, match="'gcv' is registered already"):

        @register_kappa_rule("gcv", "Another", source="test")
        def another_rule(system: LinearSystem, given: Given) -> KappaChoice:
            return KappaChoice(0.0, "gcv")


@pytest.mark.behaviour
@pytest.mark.usefixtures("open_registries")
def test_kappa_rule_from_outside() -> None:
    @register_kappa_rule("trace", "Trace", source="test", needs=("sigma_observed",))
    def trace(system: LinearSystem, given: Given) -> KappaChoice:
        return KappaChoice(float(np.trace(system.normal)), "trace")

    assert "trace" in kappa_rules()
    assert choose_kappa("trace", EYE, Given(sigma_observed=1.0)).kappa == 2.0
    assert choose_kappa("trace", EYE, Given(sigma_observed=1.0), clamp=True).kappa == 1.0
    with pytest.raises(InputError, match="sigma_observed"):
        choose_kappa("trace", EYE)
