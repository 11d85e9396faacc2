"""The five published methods of matrix inversion: Cramer, exchange step, Gauss, Moore-Penrose, Cholesky.

Sources: Terlemezoğlu 2019, sections 3.6.1.1-3.6.1.5, with the misprints corrected. Each
inverse is formed explicitly and then multiplied with b.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.registry import register_published
from fg_orient.adjustment.linear.system import Breakdown, LinearSolution, LinearSystem
from fg_orient.adjustment.linear.triangular import LOST, check_pivot, cholesky_rows, lu_factors, upper_inverse

Inverse = Callable[[Array], Array]


_published = partial(register_published, "inverse")


def _solver(name: str, label: str, equations: str) -> Callable[[Inverse], Inverse]:
    """Register the solver that multiplies the inverse of a decorated function with b."""

    def add(invert: Inverse) -> Inverse:
        def multiplied(system: LinearSystem, as_run: bool) -> LinearSolution:
            inverse = invert(system.normal)
            return LinearSolution(inverse @ system.rhs, inverse=inverse, notes=_inflation(system, inverse))

        _published(name, label, equations)(multiplied)
        return invert

    return add


def _finite(inverse: Array, method: str) -> Array:
    """Raise Breakdown if the inverse contains values that are not finite, because of an overflow."""
    if not np.isfinite(inverse).all():
        raise Breakdown.of("linear.result_not_finite", place=method)
    return inverse


def _inflation(system: LinearSystem, inverse: Array) -> tuple[str, ...]:
    """Return a remark if digits are lost.

    n_ii (N^-1)_ii has no unit. Its reciprocal is the share of n_ii that remains after the
    elimination of all other unknowns, the same measure as for a lost pivot. (N N^-1 is
    close to the identity even for a singular N.)
    """
    inflation = float(np.abs(system.normal.diagonal() * inverse.diagonal()).max())
    if inflation <= 1.0 / LOST:
        return ()
    return (f"an element n_ii times its inverse's is {inflation:.1e}: the matrix is near singular",)


@_solver("cramer_inverse", "Cramer inverse", "T(3.9)")
def invert_cramer(normal: Array) -> Array:
    """Invert (u, u) by cofactors: N^-1 = adj(N)/det(N), T(3.9); Breakdown if the determinant is zero.

    Determinants are stored as sign and logarithm, and only differences of logarithms are
    exponentiated: no determinant overflows. The cost grows with u^5: 1 s at u = 84.
    """
    u = len(normal)
    sign, log_det = np.linalg.slogdet(normal)
    if sign == 0:
        raise Breakdown.of("linear.zero_determinant", place="cramer_inverse", value=0.0)
    inverse = np.empty((u, u))
    others = np.array([np.delete(np.arange(u), i) for i in range(u)])  # (u, u - 1): all indices except i
    checkerboard = 1.0 - 2.0 * (np.arange(u) % 2)
    with np.errstate(all="ignore"):
        for i in range(u):  # minors without row i give column i of the inverse
            minors = normal[others[i]][:, others].transpose(1, 0, 2)
            signs, logs = np.linalg.slogdet(minors)
            inverse[:, i] = checkerboard * checkerboard[i] * signs * sign * np.exp(logs - log_det)
    return _finite(inverse, "cramer_inverse")


@_solver("pivot_inverse", "Pivot inverse", "T(3.17)-(3.21)")
def invert_pivot(matrix: Array) -> Array:
    """Invert a matrix (u, u), also a non-symmetric one, by exchange steps with complete pivoting, T(3.17)-(3.21).

    Raise Breakdown if all remaining elements are zero.
    """
    u = len(matrix)
    work = np.array(matrix, dtype=np.float64)
    rows, columns = np.arange(u), np.arange(u)  # rows and columns that are not used yet
    pairs = np.empty((u, 2), dtype=np.intp)
    with np.errstate(all="ignore"):
        for step in range(u):
            open_part = np.abs(work[np.ix_(rows, columns)])
            at_row, at_column = np.unravel_index(int(open_part.argmax()), open_part.shape)
            i, j = rows[at_row], columns[at_column]
            pivot = work[i, j]
            check_pivot(pivot, "pivot_inverse", step, u)
            column, row = work[:, j].copy(), work[i].copy()
            work -= np.outer(column, row / pivot)
            work[:, j], work[i] = column / pivot, -row / pivot
            work[i, j] = 1.0 / pivot
            pairs[step] = i, j
            rows, columns = np.delete(rows, at_row), np.delete(columns, at_column)
    inverse = np.empty((u, u))
    inverse[np.ix_(pairs[:, 1], pairs[:, 0])] = work[np.ix_(pairs[:, 0], pairs[:, 1])]
    return _finite(inverse, "pivot_inverse")


@_solver("gauss_inverse", "Gauss inverse", "T(3.22)-(3.29)")
def invert_gauss(matrix: Array) -> Array:
    """Invert (u, u) by LU without pivoting (Doolittle): N = C B, N^-1 = B^-1 C^-1, T(3.22)-(3.29).

    Breakdown if a pivot is zero.
    """
    lower, upper = lu_factors(matrix)
    with np.errstate(all="ignore"):
        inverse = upper_inverse(upper) @ upper_inverse(lower.T).T
    return _finite(inverse, "gauss_inverse")


def pseudo_inverse(matrix: Array) -> tuple[Array, int]:
    """Return the Moore-Penrose inverse N^+ = V D^-1 U^T of the singular values kept, and their number; T(3.30)-(3.33).

    Singular values are kept if they exceed max(u, v) times the spacing of doubles at the
    largest one (the rule of MATLAB's pinv and rank).

    Parameters
    ----------
    matrix : (u, v) array

    Returns
    -------
    inverse : (v, u) array
    rank : int
    """
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    limit = max(matrix.shape) * np.spacing(values[0])
    rank = int(np.count_nonzero(values > limit))
    with np.errstate(all="ignore"):
        inverse = (right[:rank].T / values[:rank]) @ left[:, :rank].T
    return _finite(inverse, "moore_penrose_inverse"), rank


@_published("moore_penrose_inverse", "Moore-Penrose", "T(3.30)-(3.33)")
def moore_penrose_inverse(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Return the pseudo-inverse of N."""
    inverse, rank = pseudo_inverse(system.normal)
    notes = (f"{len(system) - rank} of {len(system)} singular values set to zero",) if rank < len(system) else ()
    return LinearSolution(inverse @ system.rhs, inverse=inverse, rank=rank, notes=notes)


@_published("cholesky_inverse", "Cholesky inverse", "T(3.34)-(3.39)")
def cholesky_inverse(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Invert by Cholesky: N = C^T C, N^-1 = C^-1 C^-T; raise Breakdown if a radicand is not positive.

    With ``as_run`` negative radicands have complex roots, as in MATLAB, and x is the real
    part of the product with b.
    """
    factor, notes = cholesky_rows(system.normal, "cholesky_inverse", as_run=as_run)
    with np.errstate(all="ignore"):
        root = upper_inverse(factor)
        inverse = root @ root.T
    real = _finite(np.ascontiguousarray(inverse.real), "cholesky_inverse")
    return LinearSolution((inverse @ system.rhs).real, inverse=real, notes=notes or _inflation(system, real))
