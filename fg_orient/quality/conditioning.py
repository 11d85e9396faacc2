"""Condition of the normal equations at the solution, and regularisation by a Tikhonov solver.

The condition number is defined in the same way for all backends. A Tikhonov solver of the dense backend
shortens each step and chooses kappa for each step. The L-curve is computed from the equations at the
approximate values, where the step is longest; at the solution all steps are zero. Sigmas and (under a loss)
weights are taken from the result. Without a loss these are the equations of the first Gauss-Newton
step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from fg_orient.adjustment.loop import IterationRecord
from fg_orient.adjustment.problem import Problem, no_point_is_named
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.solve import Estimate
from fg_orient.model.errors import Finding, finding

#: Above this condition number, solutions of different solvers agree to 5 or 6 digits only (eps times
#: condition is 2e-6).
ILL_CONDITIONED: Final = 1e10
#: Maximum number of image points for which the points of a graph or dense solution are eliminated once more.
ELIMINATED_AGAIN: Final = 20_000


def condition(problem: Problem, estimate: Estimate) -> float | None:
    """Return the condition (1-norm) of the reduced normal equations of the images, scaled to a unit diagonal.

    Compiled kernels eliminate the ground points for every backend. None if the kernels do not support the problem:
    extra observations, a free datum, parts, a loss without the Schur backend, systems that GTSAM solves. Infinite for a
    singular system.
    """
    from fg_orient.adjustment.border_matrix import BorderMatrix
    from fg_orient.adjustment.schur import SchurBackend, SchurSystem
    from fg_orient.adjustment.schur_reduced import LapackReduced, Singular

    linear = estimate.linear
    if problem.least_damping > 0.0:
        return None
    if isinstance(linear, BorderMatrix):
        return linear.condition()
    if not isinstance(linear, SchurSystem):
        small = len(problem.observations) <= ELIMINATED_AGAIN and estimate.backend in ("graph", "dense")
        if not small or estimate.weights is not None or not no_point_is_named(problem.block):
            return None
        linear = SchurBackend(problem, threads=1).linearise(estimate.state)
    try:
        with one_blas_thread():
            reduced = linear.reduced(0.0)
            return reduced.condition() if isinstance(reduced, LapackReduced) else None
    except Singular:
        return float("inf")


def findings(problem: Problem, estimate: Estimate) -> list[Finding]:
    """Report ill-conditioned normal equations with the number of correct digits; empty if well-conditioned."""
    number = condition(problem, estimate)
    if number is None or number <= ILL_CONDITIONED:
        return []
    if not np.isfinite(number):
        return [finding("solution.singular")]
    digits = max(0, int(-np.log10(np.finfo(float).eps * number)))
    return [finding("solution.ill_conditioned", condition=number, limit=ILL_CONDITIONED, digits=digits)]


# --- regularised solvers --------------------------------------------------------------------------


def regularisation(weighted: Problem, name: str, log: Sequence[IterationRecord]) -> dict[str, Any] | None:
    """Return the section ``regularisation`` of a record; None for a solver that does not regularise.

    Parameters
    ----------
    weighted : Problem
        Problem that was solved; under a loss it has the weights at the solution.
    name : str
        Solver of the dense backend; "" for the other backends.
    log : sequence of IterationRecord

    Returns
    -------
    dict or None
        Keys ``solver`` and ``label``; ``rule``: kappa rule of the solver, None without a rule; ``kappa`` at the start
        values, None if ``failure`` gives a reason; ``curve``: norms of residuals (sigmas) and of the solution (prior
        sigmas of images, metres of ground points) at the start values; ``rules``: kappa of each rule; ``steps``:
        iteration and kappa of each step.
    """
    if not name:  # returns early, so that the kappa rules are not loaded
        return None
    from fg_orient.adjustment.dense import DenseBackend
    from fg_orient.adjustment.linear.l_curve import l_curve_of
    from fg_orient.adjustment.linear.registry import attempt, solver

    if solver(name).family != "tikhonov":
        return None
    system = DenseBackend(weighted, name).linearise(weighted.start).equations()
    solved, curve = attempt(name, system), asdict(l_curve_of(system))
    return {
        "solver": name,
        "label": solver(name).label,
        "rule": solved.rule or None,
        "kappa": solved.kappa,
        "failure": solved.failure,
        "rules": curve.pop("choices"),
        "curve": curve,
        "steps": [{"iteration": record.iteration, "kappa": record.kappa} for record in log if record.accepted],
    }
