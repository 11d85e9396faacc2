"""Condition of the normal equations at the solution, the same measure whichever backend solved."""

from __future__ import annotations

from typing import Final

import numpy as np

from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.adjustment.problem import Problem, schur_possible
from fg_orient.adjustment.solve import Estimate
from fg_orient.model.errors import Finding, finding

#: Beyond this condition solutions of different solvers agree to 5 or 6 digits only (eps times condition is 2e-6).
ILL_CONDITIONED: Final = 1e10
#: Image points up to which the points are eliminated once more for a solution of the graph or the dense backend.
ELIMINATED_AGAIN: Final = 20_000


def condition(problem: Problem, estimate: Estimate) -> float | None:
    """Condition (1-norm) of the reduced normal equations of the images, scaled to a unit diagonal.

    Ground points are eliminated in compiled kernels, whatever backend solved. None where they do not apply: own
    observations, a free datum, parts, a loss without the Schur backend, systems that are left to GTSAM. Infinite for a
    singular system.
    """
    from fg_orient.adjustment.schur import SchurBackend, SchurSystem
    from fg_orient.adjustment.schur_reduced import LapackReduced, Singular

    linear = estimate.linear
    if problem.least_damping > 0.0:
        return None
    if not isinstance(linear, SchurSystem):
        small = len(problem.observations) <= ELIMINATED_AGAIN and estimate.backend in ("graph", "dense")
        if not small or estimate.weights is not None or not schur_possible(problem.block):
            return None
        linear = SchurBackend(problem, threads=1).linearise(estimate.state)
    try:
        with one_blas_thread():
            reduced = linear.reduced(0.0)
            return reduced.condition() if isinstance(reduced, LapackReduced) else None
    except Singular:
        return float("inf")


def findings(problem: Problem, estimate: Estimate) -> list[Finding]:
    """Tell that the normal equations are ill-conditioned, and how many digits are left; nothing if they are not."""
    found = condition(problem, estimate)
    if found is None or found <= ILL_CONDITIONED:
        return []
    if not np.isfinite(found):
        return [finding("solution.singular")]
    digits = max(0, int(-np.log10(np.finfo(float).eps * found)))
    return [finding("solution.ill_conditioned", condition=found, limit=ILL_CONDITIONED, digits=digits)]
