"""Tikhonov regularisation x = (A^T A + kappa L^T L)^-1 A^T l and its solvers.

Sources: Tikhonov 1963; Terlemezoğlu 2019, section 3.2, T(3.2)-(3.8) with the sign of l corrected.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from fg_orient.adjustment.linear.kappa import Given, choose_kappa
from fg_orient.adjustment.linear.registry import Function, register_solver, solve
from fg_orient.adjustment.linear.system import Array, LinearSolution, LinearSystem
from fg_orient.model.errors import InputError

#: Solver of the regularised normal equations of the published rules.
PUBLISHED_SOLVER = "gauss_partial_pivot_elimination"
#: Default solver. It uses [A; sqrt(kappa) L], whose condition number is the root of that of the normal matrix.
MODERN_SOLVER = "svd"


def regularised_system(system: LinearSystem, kappa: float, penalty: Array | None = None) -> LinearSystem:
    """System N + kappa L^T L, and [A; sqrt(kappa) L], [l; 0] where A is known.

    Parameters
    ----------
    system : LinearSystem
    kappa : float
    penalty : (k, u) array, optional
        L; default: identity.

    Raises
    ------
    InputError
        Kappa is negative or not finite, or L does not fit.
    """
    if not (np.isfinite(kappa) and kappa >= 0.0):
        raise InputError.of("linear.kappa_value", place="kappa", value=kappa)
    matrix = np.eye(len(system)) if penalty is None else penalty
    if matrix.ndim != 2 or matrix.shape[1] != len(system) or not np.isfinite(matrix).all():
        raise InputError.of("linear.penalty", place="L", value=f"shape {matrix.shape}", unknowns=len(system))
    if kappa == 0.0:
        return system
    normal = system.normal + kappa * (matrix.T @ matrix)
    if system.design is None or system.observed is None:
        return LinearSystem(normal, system.rhs)
    design = np.vstack([system.design, np.sqrt(kappa) * matrix])
    observed = np.concatenate([system.observed, np.zeros(len(matrix))])
    return LinearSystem(normal, system.rhs, design, observed)


def regularised(
    system: LinearSystem, kappa: float, penalty: Array | None = None, *, solver: str = MODERN_SOLVER
) -> LinearSolution:
    """Tikhonov solution: the x that minimises |A x - l|^2 + kappa |L x|^2.

    ``solver`` solves the :func:`regularised_system`; kappa 0 gives least squares. Breakdown if the solver fails.
    """
    solution = solve(solver, regularised_system(system, kappa, penalty))
    return LinearSolution(solution.x, inverse=solution.inverse, rank=solution.rank, kappa=kappa, notes=solution.notes)


def tikhonov(
    system: LinearSystem, rule: str, given: Given | None = None, *, clamp: bool = False, solver: str = MODERN_SOLVER
) -> LinearSolution:
    """Tikhonov solution with the kappa of a rule.

    ``rule``, ``given`` and ``clamp``: see :func:`choose_kappa`; ``solver`` solves the :func:`regularised_system`.

    Returns
    -------
    LinearSolution
        With ``kappa`` and ``rule``.

    Raises
    ------
    InputError
        The rule is unknown or an input is missing.
    Breakdown
        The rule finds no kappa, or a solver fails.
    """
    choice = choose_kappa(rule, system, given, clamp=clamp)
    solution = regularised(system, choice.kappa, solver=solver)
    return replace(solution, rule=rule, notes=(*choice.notes, *solution.notes))


#: Rule, label and source of the solvers ``tikhonov_...``; the published ones clamp kappa.
_RULES: Final = (
    ("hkb", "HKB", "T(3.5)", True), ("lw", "LW", "T(3.6)", True), ("od", "OD", "T(3.8)", True),
    ("l_curve", "L-curve", "Hansen, O'Leary 1993", False), ("gcv", "GCV", "Golub, Heath, Wahba 1979", False),
    ("creso", "CRESO", "Colli-Franzone 1985", False),
)  # fmt: skip


def _function(rule: str, published: bool) -> Function:
    solver = PUBLISHED_SOLVER if published else MODERN_SOLVER
    return lambda system, as_run: tikhonov(system, rule, clamp=published, solver=solver)


for _rule, _label, _source, _published in _RULES:
    register = register_solver(
        f"tikhonov_{_rule}", f"Tikhonov {_label}", "tikhonov", source=_source, published=_published
    )
    register(_function(_rule, _published))
