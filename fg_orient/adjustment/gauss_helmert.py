"""General adjustments: indirect observations (Gauss-Markov) and conditions with unknowns (Gauss-Helmert).

Both accept constraints between the unknowns.

Notation of Terlemezoğlu 2019, sections 2.6 and 2.7: ``Q_ll = W^-1``, ``Q_xx = N^-1``,
``m0`` the standard deviation of unit weight. Both minimise v^T W v by iterated
linearisation. The sources give no stopping rule; the rule here is our own.

:func:`gauss_markov`, ``L + v = f(x)`` (eqs. 2.58-2.63, 2.74, 2.75): ``dx = (A^T W A)^-1 A^T W (L - f(x))``.

:func:`gauss_helmert`, ``F(L + v, P) = 0``: linearised at the current point (l_k, P_k) as
``A dP + B v + w_k = 0`` with the **original** observations, ``w_k = F(l_k, P_k) + B (L -
l_k)`` (Pope's iteration)::

    M = B Q_ll B^T,  dP = -(A^T M^-1 A)^-1 A^T M^-1 w,  v = -Q_ll B^T M^-1 (A dP + w)

Source: Terlemezoğlu 2019, eqs. 2.68-2.70, 2.74-2.77, and Topan & Maktav 2010, eqs. 14-18.
Signs and the cofactors ``Q_lP = -Q_ll B^T M^-1 A N^-1`` are corrected, and a Monte Carlo
simulation confirms them: eq. 2.69 lacks the minus, 2.70 has a plus, 2.76 has ``A A^T M^-1
A`` in place of ``A N^-1``. Without unknowns this is the adjustment of conditions only.
The sources use the adjusted values as new observations in the next iteration. This does
not minimise v^T W v of the original observations.

The Gauss-Markov model is computed as the Gauss-Helmert model ``f(x) - l = 0``, B = -I.

Constraints ``c(x) = 0`` are fulfilled exactly. Each step is ``dP = dP_0 + Z y``: dP_0 is
the shortest step with ``C dP_0 = -c``, and the columns of Z are a basis of ``C Z = 0``
(null-space method: Björck 1996, section 5.1.3), with columns of A of unit length. y is an
unconstrained unknown, so ``Q_xx = Z (Z^T A^T M^-1 A Z)^-1 Z^T``. Constraints may be the
datum of a design with rank defect.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from factors.arrays import Array
from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.model.declaration import declared
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.model.options import Options

Constraints = Callable[[Array], tuple[Array, Array]]

EPS = float(np.finfo(np.float64).eps)
#: If a change no longer shrinks and is below this multiple of the misclosure's rounding, it is rounding.
ROUNDING = 1e3


@dataclass(frozen=True)
class GeneralAdjustment:
    """Result of :func:`~fg_orient.adjustment.gauss_helmert.gauss_markov` or ``gauss_helmert``.

    Parameters
    ----------
    x : (u,) array
        Adjusted unknowns.
    v : (n,) array
        Residuals, adjusted minus observed.
    adjusted : (n,) array
        Adjusted observations.
    weighted_squares : float
        v^T W v.
    redundancy : int
        Observations (conditions) minus the rank of the design matrix; each constraint adds 1.
    cofactors_x : (u, u) array
        Q_xx. For a singular N it is the pseudo-inverse of the design with columns of unit
        length, and ``notes`` has a remark.
    cofactors_v, cofactors_adjusted : (n, n) arrays
        Q_vv and ``Q_ll - Q_vv``.
    cofactors_adjusted_x : (n, u) array
        Q_lx of adjusted observations and unknowns.
    iterations : int
    converged : bool
    reason : str
        Reason for the end of the iteration.
    notes : tuple of str
        Remarks of the solver and on rank.
    """

    x: Array
    v: Array
    adjusted: Array
    weighted_squares: float
    redundancy: int
    cofactors_x: Array
    cofactors_v: Array
    cofactors_adjusted: Array
    cofactors_adjusted_x: Array
    iterations: int
    converged: bool
    reason: str
    notes: tuple[str, ...] = ()

    @property
    def m0(self) -> float | None:
        """``sqrt(v^T W v / f)``; None without redundancy, see :attr:`m0_missing`."""
        return float(np.sqrt(self.weighted_squares / self.redundancy)) if self.redundancy else None

    @property
    def m0_missing(self) -> str:
        """Reason why there is no m0; "" if m0 exists."""
        return "" if self.redundancy else "no redundancy: residuals are zero for any observations"

    @property
    def correlations(self) -> Array:
        """Correlations (u, u) of the unknowns, ``q_ij / sqrt(q_ii q_jj)``; nan where a variance is 0."""
        sigma = np.sqrt(np.diag(self.cofactors_x))
        return _correlations(self.cofactors_x, sigma, sigma)

    @property
    def correlations_adjusted_x(self) -> Array:
        """Correlations (n, u) of adjusted observations with unknowns; nan where a variance is 0."""
        sigma_l = np.sqrt(np.maximum(np.diag(self.cofactors_adjusted), 0.0))
        return _correlations(self.cofactors_adjusted_x, sigma_l, np.sqrt(np.diag(self.cofactors_x)))


def _correlations(cofactors: Array, rows: Array, columns: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(cofactors / np.outer(rows, columns))


def _cofactor_matrix(n: int, weights: Array | None, cofactors: Array | None) -> Array:
    """Return Q_ll (n, n) from weights or cofactors, each (n,) or (n, n); unit weights if neither is given.

    Raises
    ------
    InputError
        Both are given; a shape is wrong; a value is not finite; a matrix is not
        symmetric; weights are not positive definite; cofactors have a negative
        eigenvalue.
    """
    if weights is not None and cofactors is not None:
        raise InputError.of("classical.weights_twice", place="weights, cofactors")
    name = "weights" if weights is not None else "cofactors"
    given = next((np.asarray(a, dtype=np.float64) for a in (weights, cofactors) if a is not None), np.ones(n))
    if given.shape not in ((n,), (n, n)) or not np.isfinite(given).all():
        raise InputError.of("classical.weights", place=name, value=f"shape {given.shape}", count=n)
    if given.ndim == 1:
        least = np.finfo(np.float64).tiny if weights is not None else 0.0  # 1/W of a smaller weight overflows
        if (given < least).any():
            raise InputError.of("classical.not_definite", place=name, value=float(given.min()))
        return np.diag(1.0 / given if weights is not None else given)
    scale = np.abs(given).max()
    if np.abs(given - given.T).max() > 1e-12 * scale:
        raise InputError.of("classical.not_definite", place=name, value="not symmetric")
    if weights is not None:
        try:
            return np.asarray(cho_solve(cho_factor(given, lower=True), np.eye(n)))
        except np.linalg.LinAlgError:
            raise InputError.of("classical.not_definite", place=name, value="no Cholesky factor") from None
    lowest = float(np.linalg.eigvalsh(given)[0])
    if lowest < -n * EPS * scale:
        raise InputError.of("classical.not_definite", place=name, value=f"eigenvalue {lowest:.3g}")
    return given


def _as_vector(values: Array, name: str) -> Array:
    """Copy a vector; raise InputError unless it is one-dimensional and finite."""
    vector: Array = np.array(values, dtype=np.float64)
    if vector.ndim != 1 or not np.isfinite(vector).all():
        raise InputError.of("classical.vector", place=name, value=f"shape {vector.shape}")
    return vector


def _called(
    function: Callable[..., tuple[Array, ...]], arguments: tuple[Array, ...], wanted: tuple[int, ...]
) -> list[Array]:
    """Call the user's function; check the number, shapes and values of its results.

    ``wanted`` contains the length of the value (-1: any), then the number of columns of each Jacobian.
    """
    arrays = [np.asarray(a, dtype=np.float64) for a in function(*(a.copy() for a in arguments))]
    rows = arrays[0].size if wanted[0] < 0 else wanted[0]
    shapes = [(rows,), *((rows, width) for width in wanted[1:])]
    if [a.shape for a in arrays] != shapes:
        seen = ", ".join(str(a.shape) for a in arrays)
        raise InputError.of("classical.function", place="function", value=seen, expected=", ".join(map(str, shapes)))
    if not all(np.isfinite(a).all() for a in arrays):
        raise NoSolutionError.of("classical.function_not_finite", place="function")
    return arrays


def _spectrum(design: Array) -> tuple[int, Array, Array, tuple[str, ...]]:
    """Return the singular value decomposition ``U S V^T D`` of a whitened design (r, u), columns scaled by D.

    u may be 0.

    Returns
    -------
    int, (u, u) array, (r, rank) array, tuple of str
        Rank, cofactors of the unknowns, the columns of U up to the rank, and a remark if the rank is below u.
    """
    rows, u = design.shape
    if not u:
        return 0, np.zeros((0, 0)), np.zeros((rows, 0)), ()
    length = np.linalg.norm(design, axis=0)
    scale = np.where(length > 0.0, length, 1.0)
    left, values, right = np.linalg.svd(design / scale, full_matrices=False)
    rank = int((values > max(rows, u) * EPS * values[0]).sum()) if values[0] > 0.0 else 0
    half = (right[:rank].T / values[:rank]) / scale[:, None]
    note = f"the normal matrix has rank {rank} of {u}: cofactors by pseudo-inverse of the column-scaled design"
    return rank, half @ half.T, left[:, :rank], () if rank == u else (note,)


def _has_converged(change: float, previous: float, size: float, rounding: float, tolerance: float) -> bool:
    """Return whether the change is below ``tolerance`` of the residuals' norm, or is rounding; in whitened units."""
    if change <= tolerance * size + 8.0 * rounding:
        return True
    return change > 0.5 * previous and change <= 1e2 * tolerance * size + ROUNDING * rounding


def gauss_markov(
    function: Callable[[Array], tuple[Array, Array]],
    observed: Array,
    start: Array,
    *,
    weights: Array | None = None,
    cofactors: Array | None = None,
    constraints: Constraints | None = None,
    solver: str = "qr",
    max_iterations: int = 50,
    tolerance: float = 1e-8,
) -> GeneralAdjustment:
    """Adjust observations that are functions of the unknowns.

    Parameters
    ----------
    function : callable
        ``function(x) -> (f (n,), A (n, u))``: computed observations and their derivatives.
    observed : (n,) array
        L.
    start : (u,) array
        Approximate unknowns, any finite values if f is linear.
    weights, cofactors : (n,) or (n, n) array, optional
        W or Q_ll = W^-1 (not both; unit weights if neither); positive definite.
    constraints, solver, max_iterations, tolerance
        See :func:`gauss_helmert`.

    Raises
    ------
    InputError
        The shapes of the arrays do not fit, there are fewer observations than unknowns,
        or the solver is unknown.
    NoSolutionError
        The function gives values that are not finite, or the solver breaks down.
    """
    observed, start = _as_vector(observed, "observed"), _as_vector(start, "start")
    n, u = len(observed), len(start)
    if not u or (n < u and constraints is None):
        raise InputError.of("classical.redundancy", place="observed", value=n, unknowns=u)
    q_ll = _cofactor_matrix(n, weights, cofactors)
    try:
        np.linalg.cholesky(q_ll)
    except np.linalg.LinAlgError:
        raise InputError.of("classical.not_definite", place="cofactors", value="no Cholesky factor") from None

    def conditions(at: Array, x: Array) -> tuple[Array, Array, Array]:
        value, jacobian = _called(function, (x,), (n, u))
        return value - at, jacobian, -np.eye(n)

    return gauss_helmert(
        conditions,
        observed,
        start,
        cofactors=q_ll,
        constraints=constraints,
        solver=solver,
        max_iterations=max_iterations,
        tolerance=tolerance,
    )


@dataclass(frozen=True)
class _Linearised:
    """Conditions whitened with the Cholesky factor of M: value F, A, B, and ``spread`` = Q_ll B^T M^-T/2.

    ``basis`` (u, u - q): Z; ``onto`` (u,): dP_0.
    """

    root: Array
    value: Array
    design: Array
    d_observed: Array
    spread: Array
    basis: Array
    onto: Array
    rounding: float


def gauss_helmert(
    function: Callable[[Array, Array], tuple[Array, Array, Array]],
    observed: Array,
    start: Array,
    *,
    weights: Array | None = None,
    cofactors: Array | None = None,
    constraints: Constraints | None = None,
    solver: str = "qr",
    max_iterations: int = 50,
    tolerance: float = 1e-8,
) -> GeneralAdjustment:
    """Adjust conditions between observations and unknowns.

    Parameters
    ----------
    function : callable
        ``function(l, x) -> (F (r,), A (r, u), B (r, n))``: conditions and their
        derivatives with respect to unknowns and observations.
    observed : (n,) array
        L.
    start : (u,) array
        Approximate unknowns; empty for conditions only.
    weights, cofactors : (n,) or (n, n) array, optional
        W or Q_ll, not both; if neither is given, weights are 1. Q_ll may be singular if
        ``B Q_ll B^T`` is regular. An observation with cofactor 0 keeps its value.
    constraints : callable, optional
        ``constraints(x) -> (c (q,), C (q, u))``: constraints ``c(x) = 0`` between
        unknowns and their derivatives.
    solver : str
        Name in the registry of linear solvers; its design matrix is ``M^-1/2 A``, or
        ``M^-1/2 A Z`` with constraints.
    max_iterations : int
    tolerance : float
        Share of the norm of the whitened residuals. The iteration stops when steps of the
        unknowns, changes of the residuals and the values of F, all whitened, are below it
        (or are rounding).

    Raises
    ------
    InputError
        Arrays do not fit; there are fewer conditions and constraints than unknowns; the solver is unknown.
    NoSolutionError
        Conditions or constraints depend on each other; values are not finite; the solver breaks down.
    """
    observed, x = _as_vector(observed, "observed"), _as_vector(start, "start")
    q_ll = _cofactor_matrix(len(observed), weights, cofactors)
    option = declared(Options)["max_iterations"]
    if not option.allows(max_iterations):
        raise InputError.of("options.value", place=option.name, value=max_iterations, expected=option.expected)
    sigma = np.sqrt(np.diag(q_ll))
    varies = sigma > 0.0
    change, converged, notes, v = math.inf, False, tuple[str, ...](), np.zeros(len(observed))
    at = _linearise(function, constraints, observed, v, x, q_ll)
    residual = at.value
    for iteration in range(1, max_iterations + 1):  # noqa: B007
        misclosure = at.value - solve_triangular(at.root, at.d_observed @ v, lower=True)
        step = at.onto
        if at.basis.shape[1]:
            right = -misclosure - at.design @ at.onto
            solution = solve(solver, LinearSystem.from_design(at.design @ at.basis, right))
            step, notes = at.onto + at.basis @ solution.x, solution.notes
        residual = at.design @ step + misclosure
        x, before, v = x + step, v, -at.spread @ residual
        moved = [np.abs(step * np.linalg.norm(at.design, axis=0)), np.abs(v - before)[varies] / sigma[varies]]
        at = _linearise(function, constraints, observed, v, x, q_ll)
        previous, change = change, float(np.concatenate([*moved, np.abs(at.value)]).max())
        if converged := _has_converged(change, previous, float(np.linalg.norm(residual)), at.rounding, tolerance):
            break
    reason = "the step is below the tolerance"
    if not converged:
        reason = f"no convergence within {iteration} iterations: the last whitened step is {change:.1e}"
    # Q_vv = G (I - U U^T) G^T with G = Q_ll B^T M^-T/2; U spans the design at the last point
    rank, q_y, left, rank_notes = _spectrum(at.design @ at.basis)
    q_x = at.basis @ q_y @ at.basis.T
    across = at.spread @ left
    q_v = at.spread @ at.spread.T - across @ across.T
    return GeneralAdjustment(
        x,
        v,
        observed + v,
        float(residual @ residual),
        len(at.value) - rank,
        q_x,
        q_v,
        q_ll - q_v,
        -at.spread @ at.design @ q_x,
        iteration,
        converged,
        reason,
        notes + rank_notes,
    )


def _linearise(
    function: Callable[[Array, Array], tuple[Array, Array, Array]],
    constraints: Constraints | None,
    observed: Array,
    v: Array,
    x: Array,
    q_ll: Array,
) -> _Linearised:
    """Evaluate the conditions at the adjusted observations and whiten them."""
    adjusted = observed + v
    value, design, d_observed = _called(function, (adjusted, x), (-1, len(x), len(observed)))
    c, by_x = np.zeros(0), np.zeros((0, len(x)))
    if constraints is not None:
        c, by_x = _called(constraints, (x,), (-1, len(x)))
    if len(value) < max(len(x) - len(c), 1):
        raise InputError.of("classical.redundancy", place="conditions", value=len(value), unknowns=len(x) - len(c))
    spread = q_ll @ d_observed.T
    m = d_observed @ spread
    scale = np.sqrt(np.diag(m))
    # with a correlation of 1 - eps between conditions, rounding dominates their Cholesky factor
    if not scale.all() or np.linalg.eigvalsh(m / np.outer(scale, scale))[0] <= len(m) * EPS:
        raise NoSolutionError.of("classical.dependent_conditions", place="conditions", value=len(m))
    root: Array = np.asarray(np.linalg.cholesky(m), dtype=np.float64)
    size = (np.abs(d_observed) @ np.abs(adjusted) + np.abs(design) @ np.abs(x)) / scale
    white = [solve_triangular(root, a, lower=True) for a in (value, design, spread.T)]
    basis, onto = _constrained(c, by_x, np.linalg.norm(white[1], axis=0))
    rounding = EPS * float(np.linalg.norm(size))
    return _Linearised(root, white[0], white[1], d_observed, white[2].T, basis, onto, rounding)


def _constrained(value: Array, by_x: Array, length: Array) -> tuple[Array, Array]:
    """Return a basis Z (u, u - q) and the shortest step (u,) onto the constraints, in units of 1/length."""
    q, u = by_x.shape
    if not q:
        return np.eye(u), np.zeros(u)
    scale = 1.0 / np.where(length > 0.0, length, 1.0)
    rows = by_x * scale
    size = np.linalg.norm(rows, axis=1)
    left, values, right = np.linalg.svd(rows / np.where(size > 0.0, size, 1.0)[:, None])
    if q > u or values[-1] <= u * EPS or not size.all():
        raise NoSolutionError.of("classical.dependent_conditions", place="constraints", value=q)
    onto = right[:q].T @ (left.T @ (value / size) / values)
    return scale[:, None] * right[q:].T, -scale * onto
