"""Tikhonov regularisation x = (A^T A + kappa L^T L)^-1 A^T l, with a prior in general form, and its solvers.

Sources: Tikhonov 1963; Terlemezoğlu 2019, section 3.2, T(3.2)-(3.8) with the sign of l corrected.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, Literal

import numpy as np
from scipy.linalg import solve_triangular

from fg_orient.adjustment.linear.kappa import Given, choose_kappa
from fg_orient.adjustment.linear.registry import Function, register_solver, solve
from fg_orient.adjustment.linear.system import Array, LinearSolution, LinearSystem
from fg_orient.model.errors import InputError

Penalty = Literal["identity", "first_difference", "second_difference"]

#: Solver of the regularised normal equations of the published rules.
PUBLISHED_SOLVER = "gauss_partial_pivot_elimination"
#: Solver of the regularised system elsewhere: it works on [A; sqrt(kappa) L], whose condition number is the root.
MODERN_SOLVER = "svd"


def penalty_matrix(penalty: Penalty | Array, unknowns: int) -> Array:
    """Matrix L of the penalty |L x|.

    Parameters
    ----------
    penalty : "identity", "first_difference", "second_difference" or (k, u) array
        Differences of neighbouring unknowns stand for gradient and Laplace operator.
    unknowns : int
        u.

    Returns
    -------
    (k, u) array

    Raises
    ------
    InputError
        The matrix does not fit, or there are too few unknowns for differences.
    """
    if isinstance(penalty, str):
        order = {"identity": 0, "first_difference": 1, "second_difference": 2}.get(penalty, -1)
        if order < 0 or order >= unknowns:
            raise InputError.of("linear.penalty", place="L", value=penalty, unknowns=unknowns)
        return np.diff(np.eye(unknowns), n=order, axis=0)
    if penalty.ndim != 2 or penalty.shape[1] != unknowns or not np.isfinite(penalty).all():
        raise InputError.of("linear.penalty", place="L", value=f"shape {penalty.shape}", unknowns=unknowns)
    return penalty


def regularised_system(system: LinearSystem, kappa: float, penalty: Penalty | Array = "identity") -> LinearSystem:
    """System N + kappa L^T L, and [A; sqrt(kappa) L], [l; 0] where A is known.

    Parameters
    ----------
    system : LinearSystem
    kappa : float
    penalty : name or (k, u) array
        See :func:`penalty_matrix`.

    Returns
    -------
    LinearSystem

    Raises
    ------
    InputError
        Kappa is negative or not finite, or L does not fit.
    """
    if not (np.isfinite(kappa) and kappa >= 0.0):
        raise InputError.of("linear.kappa_value", place="kappa", value=kappa)
    matrix = penalty_matrix(penalty, len(system))
    if kappa == 0.0:
        return system
    normal = system.normal + kappa * (matrix.T @ matrix)
    if system.design is None or system.observed is None:
        return LinearSystem(normal, system.rhs)
    design = np.vstack([system.design, np.sqrt(kappa) * matrix])
    observed = np.concatenate([system.observed, np.zeros(len(matrix))])
    return LinearSystem(normal, system.rhs, design, observed)


def regularised(
    system: LinearSystem, kappa: float, penalty: Penalty | Array = "identity", *, solver: str = MODERN_SOLVER
) -> LinearSolution:
    """Tikhonov solution: the x that minimises |A x - l|^2 + kappa |L x|^2.

    Parameters
    ----------
    system : LinearSystem
    kappa : float
        0 gives least squares.
    penalty : name or (k, u) array
        See :func:`penalty_matrix`.
    solver : str
        Of the registry, for the regularised system.

    Returns
    -------
    LinearSolution

    Raises
    ------
    InputError
        Kappa or L is unusable.
    Breakdown
        The solver cannot go on.
    """
    found = solve(solver, regularised_system(system, kappa, penalty))
    return LinearSolution(found.x, inverse=found.inverse, rank=found.rank, kappa=kappa, notes=found.notes)


def generalised(
    system: LinearSystem, prior_mean: Array, prior_covariance: Array, *, sigma: float = 1.0, solver: str = MODERN_SOLVER
) -> LinearSolution:
    """Posterior mean under a normal prior: minimises |A x - l|^2/sigma^2 + (x - x0)^T Q^-1 (x - x0).

    With x0 = 0 and Q = s^2 I this is Tikhonov with the Bayes kappa sigma^2/s^2; in the graph the same prior is
    a factor on the unknowns.

    Parameters
    ----------
    system : LinearSystem
    prior_mean : (u,) array
        x0.
    prior_covariance : (u, u) array
        Q, positive definite.
    sigma : float
        Standard deviation of one whitened observation.
    solver : str
        Of the registry.

    Returns
    -------
    LinearSolution

    Raises
    ------
    InputError
        The prior does not fit, or Q is not positive definite.
    Breakdown
        The solver cannot go on.
    """
    u = len(system)
    whitener = _whitener(prior_covariance, u)
    if prior_mean.shape != (u,) or not np.isfinite(prior_mean).all() or not (np.isfinite(sigma) and sigma > 0.0):
        raise InputError.of("linear.prior", place="x0, sigma", value=f"shape {prior_mean.shape}", unknowns=u)
    rows = sigma * whitener
    normal, rhs = system.normal + rows.T @ rows, system.rhs + rows.T @ (rows @ prior_mean)
    if system.design is None or system.observed is None:
        return solve(solver, LinearSystem(normal, rhs))
    design = np.vstack([system.design, rows])
    observed = np.concatenate([system.observed, rows @ prior_mean])
    return solve(solver, LinearSystem(normal, rhs, design, observed))


def _whitener(covariance: Array, unknowns: int) -> Array:
    """G^-1 with Q = G G^T."""
    try:
        if covariance.shape != (unknowns, unknowns) or not np.allclose(covariance, covariance.T, rtol=1e-10, atol=0.0):
            raise np.linalg.LinAlgError
        root = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as error:
        place, value = "Q", f"shape {covariance.shape}"
        raise InputError.of("linear.prior", place=place, value=value, unknowns=unknowns) from error
    inverse: Array = solve_triangular(root, np.eye(unknowns), lower=True)
    return inverse


def tikhonov(
    system: LinearSystem, rule: str, given: Given | None = None, *, clamp: bool = False, solver: str = MODERN_SOLVER
) -> LinearSolution:
    """Tikhonov solution with the kappa of a rule.

    Parameters
    ----------
    system : LinearSystem
    rule : str
        Of :func:`fg_orient.adjustment.linear.kappa.kappa_rules`.
    given : Given, optional
        What the rule needs; its start solver.
    clamp : bool
        Clamp kappa to [0, 1] as published.
    solver : str
        Of the registry, for the regularised system.

    Returns
    -------
    LinearSolution
        With ``kappa`` and ``rule``.

    Raises
    ------
    InputError
        The rule is unknown or lacks something.
    Breakdown
        The rule finds no kappa or a solver cannot go on.
    """
    choice = choose_kappa(rule, system, given, clamp=clamp)
    found = regularised(system, choice.kappa, solver=solver)
    return replace(found, rule=rule, notes=(*choice.notes, *found.notes))


#: Rule, label and source of the solvers ``tikhonov_...``; the published ones clamp kappa, and "od" works on N alone.
_RULES: Final = (
    ("hkb", "HKB", "T(3.5)", True), ("lw", "LW", "T(3.6)", True), ("od", "OD", "T(3.8)", True),
    ("l_curve", "L-curve", "Hansen, O'Leary 1993", False), ("gcv", "GCV", "Golub, Heath, Wahba 1979", False),
    ("creso", "CRESO", "Colli-Franzone 1985", False),
)  # fmt: skip


def _function(rule: str, published: bool) -> Function:
    solver = PUBLISHED_SOLVER if published else MODERN_SOLVER
    return lambda system, as_run: tikhonov(system, rule, clamp=published, solver=solver)


for _rule, _label, _source, _published in _RULES:
    register_solver(
        f"tikhonov_{_rule}", f"Tikhonov {_label}", "tikhonov", source=_source, published=_published,
        needs_design=_rule != "od",
    )(_function(_rule, _published))  # fmt: skip
