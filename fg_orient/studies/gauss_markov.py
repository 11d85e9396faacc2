"""General adjustment of indirect observations (Gauss-Markov): ``L + v = f(x)``, v^T W v minimal.

Linearised and iterated: ``dx = (A^T W A)^-1 A^T W (L - f(x))``. Source: Terlemezoğlu 2019, eqs. 2.58-2.63,
2.74, 2.75; the stop is ours (the sources name none).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_triangular

from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.model.errors import InputError
from fg_orient.studies.general import (
    EPS,
    Adjustment,
    Array,
    End,
    Spectrum,
    as_vector,
    called,
    cofactor_matrix,
    judge,
    require_iterations,
)


def gauss_markov(
    function: Callable[[Array], tuple[Array, Array]],
    observed: Array,
    start: Array,
    *,
    weights: Array | None = None,
    cofactors: Array | None = None,
    solver: str = "qr",
    max_iterations: int = 50,
    tolerance: float = 1e-8,
) -> Adjustment:
    """Adjust observations that are functions of the unknowns.

    Parameters
    ----------
    function : callable
        ``function(x) -> (f (n,), A (n, u))``: computed observations and their derivatives.
    observed : (n,) array
        L.
    start : (u,) array
        Approximate unknowns, any finite ones if f is linear.
    weights, cofactors : (n,) or (n, n) array, optional
        W or Q_ll = W^-1 (not both; unit weights if neither); positive definite.
    solver : str
        Name in the registry of linear solvers; it gets the whitened design matrix.
    max_iterations : int
    tolerance : float
        Stop when the largest step, each unknown times the norm of its whitened column, is below this
        share of the norm of the whitened residuals (or is rounding).

    Returns
    -------
    Adjustment
        ``converged`` says whether the stop was reached.

    Raises
    ------
    InputError
        Arrays that do not fit; fewer observations than unknowns; no such solver.
    NoSolutionError
        The function gives values that are not finite, or the solver breaks down.
    """
    observed, x = as_vector(observed, "observed"), as_vector(start, "start")
    n, u = len(observed), len(x)
    if not u or n < u:
        raise InputError.of("classical.redundancy", place="observed", value=n, unknowns=u)
    q_ll = cofactor_matrix(n, weights, cofactors)
    try:
        root: Array = np.asarray(np.linalg.cholesky(q_ll), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise InputError.of("classical.not_definite", place="cofactors", value="no Cholesky factor") from None
    require_iterations(max_iterations)
    change, converged, notes = math.inf, False, tuple[str, ...]()
    for iteration in range(1, max_iterations + 1):  # noqa: B007
        value, jacobian = called(function, (x,), (n, u))
        design, misclosure = (solve_triangular(root, a, lower=True) for a in (jacobian, observed - value))
        found = solve(solver, LinearSystem.from_design(design, misclosure))
        length = np.linalg.norm(design, axis=0)
        rounding = EPS * (np.linalg.norm(solve_triangular(root, observed, lower=True)) + np.linalg.norm(length * x))
        x, notes = x + found.x, found.notes
        previous, change = change, float(np.abs(found.x * length).max())
        if converged := judge(change, previous, float(np.linalg.norm(misclosure)), float(rounding), tolerance):
            break
    return _result(function, observed, x, q_ll, root, End(iteration, converged, change, notes))


def _result(
    function: Callable[[Array], tuple[Array, Array]], observed: Array, x: Array, q_ll: Array, root: Array, end: End
) -> Adjustment:
    """Residuals and cofactors at the last unknowns; ``A N^-1 A^T = S U U^T S^T`` with Q_ll = S S^T."""
    value, jacobian = called(function, (x,), (len(observed), len(x)))
    design, residual = (solve_triangular(root, a, lower=True) for a in (jacobian, value - observed))
    spectrum = Spectrum.of(design)
    half = root @ spectrum.left
    q_adjusted = half @ half.T
    return Adjustment(
        x, value - observed, value, float(residual @ residual), len(observed) - spectrum.rank, spectrum.cofactors,
        q_ll - q_adjusted, q_adjusted, jacobian @ spectrum.cofactors, end.iterations, end.converged, end.reason,
        end.notes + spectrum.notes,
    )  # fmt: skip
