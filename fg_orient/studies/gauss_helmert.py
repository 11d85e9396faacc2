"""General adjustment of conditions with unknowns (Gauss-Helmert): ``F(L + v, P) = 0``, v^T W v minimal.

Linearised at the current point (l_k, P_k) as ``A dP + B v + w_k = 0`` with the **original** observations,
``w_k = F(l_k, P_k) + B (L - l_k)`` (Pope's iteration)::

    M = B Q_ll B^T,  dP = -(A^T M^-1 A)^-1 A^T M^-1 w,  v = -Q_ll B^T M^-1 (A dP + w)

Source: Terlemezoğlu 2019, eqs. 2.68-2.70, 2.74-2.77, and Topan & Maktav 2010, eqs. 14-18, with the signs and
the cofactors ``Q_lP = -Q_ll B^T M^-1 A N^-1`` that a Monte Carlo simulation confirms: eq. 2.69 lacks the minus,
2.70 has a plus, 2.76 has ``A A^T M^-1 A`` in place of ``A N^-1``. Without unknowns it is the adjustment of
conditions only. The sources repeat the adjustment with adjusted values as new observations instead, which
does not minimise v^T W v of the originals.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.model.errors import InputError, NoSolutionError
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


@dataclass(frozen=True)
class _Linearised:
    """Conditions whitened with the Cholesky factor of M: value F, A, B, and ``spread`` = Q_ll B^T M^-T/2."""

    root: Array
    value: Array
    design: Array
    d_observed: Array
    spread: Array
    rounding: float


def gauss_helmert(
    function: Callable[[Array, Array], tuple[Array, Array, Array]],
    observed: Array,
    start: Array,
    *,
    weights: Array | None = None,
    cofactors: Array | None = None,
    solver: str = "qr",
    max_iterations: int = 50,
    tolerance: float = 1e-8,
) -> Adjustment:
    """Adjust conditions between observations and unknowns.

    Parameters
    ----------
    function : callable
        ``function(l, x) -> (F (r,), A (r, u), B (r, n))``: conditions and their derivatives with respect
        to unknowns and observations.
    observed : (n,) array
        L.
    start : (u,) array
        Approximate unknowns; empty for conditions only.
    weights, cofactors : (n,) or (n, n) array, optional
        W or Q_ll (not both; unit weights if neither). Q_ll may be singular, an observation of
        cofactor 0 stays as it is, as long as ``B Q_ll B^T`` is regular.
    solver : str
        Name in the registry of linear solvers; it gets ``M^-1/2 A``.
    max_iterations : int
    tolerance : float
        Stop when steps of the unknowns, changes of residuals and what is left of F, all whitened, are
        below this share of the norm of the whitened residuals (or are rounding).

    Returns
    -------
    Adjustment
        ``converged`` says whether the stop was reached.

    Raises
    ------
    InputError
        Arrays that do not fit; fewer conditions than unknowns; no such solver.
    NoSolutionError
        Conditions that depend on each other; values that are not finite; the solver breaks down.
    """
    observed, x = as_vector(observed, "observed"), as_vector(start, "start")
    q_ll = cofactor_matrix(len(observed), weights, cofactors)
    require_iterations(max_iterations)
    sigma = np.sqrt(np.diag(q_ll))
    change, converged, notes, v = math.inf, False, tuple[str, ...](), np.zeros(len(observed))
    at = _linearise(function, observed, v, x, q_ll)
    residual = at.value
    for iteration in range(1, max_iterations + 1):  # noqa: B007
        misclosure = at.value - solve_triangular(at.root, at.d_observed @ v, lower=True)
        step, notes = _step(solver, at.design, misclosure)
        residual = at.design @ step + misclosure
        x, before, v = x + step, v, -at.spread @ residual
        moved = [np.abs(step * np.linalg.norm(at.design, axis=0)), _in_sigmas(v - before, sigma)]
        at = _linearise(function, observed, v, x, q_ll)
        previous, change = change, float(np.concatenate([*moved, np.abs(at.value)]).max())
        if converged := judge(change, previous, float(np.linalg.norm(residual)), at.rounding, tolerance):
            break
    return _result(at, observed, x, v, residual, q_ll, End(iteration, converged, change, notes))


def _in_sigmas(values: Array, sigma: Array) -> Array:
    """Values over sigmas; constants (sigma 0) do not move."""
    return np.asarray(np.abs(values[sigma > 0.0]) / sigma[sigma > 0.0])


def _linearise(
    function: Callable[[Array, Array], tuple[Array, Array, Array]], observed: Array, v: Array, x: Array, q_ll: Array
) -> _Linearised:
    """Evaluate the conditions at the adjusted observations and whiten them."""
    adjusted = observed + v
    value, design, d_observed = called(function, (adjusted, x), (-1, len(x), len(observed)))
    if len(value) < max(len(x), 1):
        raise InputError.of("classical.redundancy", place="conditions", value=len(value), unknowns=len(x))
    spread = q_ll @ d_observed.T
    m = d_observed @ spread
    scale = np.sqrt(np.diag(m))
    # a correlation of 1 - eps between conditions has no Cholesky factor worth the name
    if not scale.all() or np.linalg.eigvalsh(m / np.outer(scale, scale))[0] <= len(m) * EPS:
        raise NoSolutionError.of("classical.dependent_conditions", place="conditions", value=len(m))
    root: Array = np.asarray(np.linalg.cholesky(m), dtype=np.float64)
    size = (np.abs(d_observed) @ np.abs(adjusted) + np.abs(design) @ np.abs(x)) / scale
    white = [solve_triangular(root, a, lower=True) for a in (value, design, spread.T)]
    return _Linearised(root, white[0], white[1], d_observed, white[2].T, EPS * float(np.linalg.norm(size)))


def _step(solver: str, design: Array, misclosure: Array) -> tuple[Array, tuple[str, ...]]:
    """Step of the unknowns; nothing to solve without any."""
    if not design.shape[1]:
        return np.zeros(0), ()
    found = solve(solver, LinearSystem.from_design(design, -misclosure))
    return found.x, found.notes


def _result(at: _Linearised, observed: Array, x: Array, v: Array, residual: Array, q_ll: Array, end: End) -> Adjustment:
    """Cofactors at the last point: ``Q_vv = G (I - U U^T) G^T`` with G = Q_ll B^T M^-T/2, U of the design."""
    spectrum = Spectrum.of(at.design)
    across = at.spread @ spectrum.left
    q_v = at.spread @ at.spread.T - across @ across.T
    return Adjustment(
        x, v, observed + v, float(residual @ residual), len(at.value) - spectrum.rank, spectrum.cofactors,
        q_v, q_ll - q_v, -at.spread @ at.design @ spectrum.cofactors, end.iterations, end.converged, end.reason,
        end.notes + spectrum.notes,
    )  # fmt: skip
