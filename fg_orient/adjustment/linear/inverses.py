"""The five published inverses, written out: Cramer, exchange step, Gauss, Moore-Penrose, Cholesky.

Sources: Terlemezoğlu 2019, sections 3.6.1.1-3.6.1.5, with the misprints corrected. Each inverse is formed
explicitly and then multiplied with b.
"""

from __future__ import annotations

import numpy as np

from fg_orient.adjustment.linear.registry import register_solver
from fg_orient.adjustment.linear.system import Array, Breakdown, LinearSolution, LinearSystem
from fg_orient.adjustment.linear.triangular import LOST, Numbers, check_pivot, cholesky_rows, lu_factors, upper_inverse


def invert_cramer(normal: Array) -> Array:
    """Invert by cofactors: N^-1 = adj(N)/det(N), T(3.9).

    Determinants are kept as sign and logarithm and only differences of logarithms are exponentiated, so that no
    determinant overflows. The cost grows with u^5: 1 s at u = 84.

    Parameters
    ----------
    normal : (u, u) array

    Returns
    -------
    (u, u) array

    Raises
    ------
    Breakdown
        The determinant is zero, or the inverse is not finite.
    """
    u = len(normal)
    sign, log_det = np.linalg.slogdet(normal)
    if sign == 0:
        raise Breakdown.of("linear.zero_determinant", place="cramer_inverse", value=0.0)
    inverse = np.empty((u, u))
    others = np.array([np.delete(np.arange(u), i) for i in range(u)])  # (u, u - 1): every index but i
    checkerboard = 1.0 - 2.0 * (np.arange(u) % 2)
    with np.errstate(all="ignore"):
        for i in range(u):  # minors without row i: they give column i of the inverse
            minors = normal[others[i]][:, others].transpose(1, 0, 2)
            signs, logs = np.linalg.slogdet(minors)
            inverse[:, i] = checkerboard * checkerboard[i] * signs * sign * np.exp(logs - log_det)
    return _finite(inverse, "cramer_inverse")


def invert_pivot(matrix: Array) -> Array:
    """Invert by exchange steps with complete pivoting, T(3.17)-(3.21); also for non-symmetric matrices.

    Parameters
    ----------
    matrix : (u, u) array

    Returns
    -------
    (u, u) array

    Raises
    ------
    Breakdown
        All elements left are zero, or the inverse is not finite.
    """
    u = len(matrix)
    work = np.array(matrix, dtype=np.float64)
    rows, columns = np.arange(u), np.arange(u)  # not yet used
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


def invert_gauss(matrix: Array) -> Array:
    """Invert by LU without pivoting (Doolittle): N = C B, N^-1 = B^-1 C^-1, T(3.22)-(3.29).

    Parameters
    ----------
    matrix : (u, u) array

    Returns
    -------
    (u, u) array

    Raises
    ------
    Breakdown
        A pivot is zero, or the inverse is not finite.
    """
    lower, upper = lu_factors(matrix)
    with np.errstate(all="ignore"):
        inverse = upper_inverse(upper) @ upper_inverse(lower.T).T
    return _finite(inverse, "gauss_inverse")


def pseudo_inverse(matrix: Array, tolerance: float | None = None) -> tuple[Array, int]:
    """Moore-Penrose inverse N^+ = V D^-1 U^T of the singular values kept, and their number; T(3.30)-(3.33).

    Parameters
    ----------
    matrix : (u, v) array
    tolerance : float, optional
        Singular values above it are kept; default max(u, v) times the spacing of doubles at the largest one
        (the rule of MATLAB's pinv and rank).

    Returns
    -------
    inverse : (v, u) array
    rank : int
    """
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    limit = max(matrix.shape) * np.spacing(values[0]) if tolerance is None else tolerance
    rank = int(np.count_nonzero(values > limit))
    with np.errstate(all="ignore"):
        inverse = (right[:rank].T / values[:rank]) @ left[:, :rank].T
    return _finite(inverse, "moore_penrose_inverse"), rank


def invert_moore_penrose(matrix: Array, tolerance: float | None = None) -> Array:
    """Moore-Penrose inverse alone; see :func:`pseudo_inverse`."""
    return pseudo_inverse(matrix, tolerance)[0]


def invert_cholesky(normal: Array, *, as_run: bool = False) -> Array:
    """Invert by Cholesky: N = C^T C, N^-1 = C^-1 C^-T, T(3.34)-(3.39).

    Parameters
    ----------
    normal : (u, u) array
        Symmetric.
    as_run : bool
        Negative radicands have complex roots, as in MATLAB, and the real part of N^-1 is given.

    Returns
    -------
    (u, u) array

    Raises
    ------
    Breakdown
        A radicand is not positive (with ``as_run``: zero), or the inverse is not finite.
    """
    inverse, _ = _cholesky_inverse(normal, as_run)
    return _finite(np.ascontiguousarray(inverse.real), "cholesky_inverse")


def _cholesky_inverse(normal: Array, as_run: bool) -> tuple[Numbers, tuple[str, ...]]:
    """N^-1, complex where a radicand was negative, with the notes."""
    factor, notes = cholesky_rows(normal, "cholesky_inverse", as_run=as_run)
    with np.errstate(all="ignore"):
        root = upper_inverse(factor)
        return root @ root.T, notes


def _finite(inverse: Array, method: str) -> Array:
    """Refuse an inverse that overflowed."""
    if not np.isfinite(inverse).all():
        raise Breakdown.of("linear.result_not_finite", place=method)
    return inverse


def _multiplied(system: LinearSystem, inverse: Array, notes: tuple[str, ...] = ()) -> LinearSolution:
    """Solution N^-1 b, with a remark where digits are lost.

    n_ii (N^-1)_ii carries no units and is the share of n_ii that is left when all other unknowns are eliminated,
    inverted: the same measure as a lost pivot. (N N^-1 is close to the identity even for a singular N.)
    """
    inflation = float(np.abs(system.normal.diagonal() * inverse.diagonal()).max())
    if inflation > 1.0 / LOST and not notes:
        notes = (f"an element n_ii times its inverse's is {inflation:.1e}: the matrix is near singular",)
    return LinearSolution(inverse @ system.rhs, inverse=inverse, notes=notes)


@register_solver("cramer_inverse", "Cramer inverse", "inverse", source="Terlemezoğlu 2019, T(3.9)", published=True)
def cramer_inverse(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Cofactors over the determinant."""
    return _multiplied(system, invert_cramer(system.normal))


@register_solver(
    "pivot_inverse", "Pivot inverse", "inverse", source="Terlemezoğlu 2019, T(3.17)-(3.21)", published=True
)
def pivot_inverse(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Exchange steps with complete pivoting."""
    return _multiplied(system, invert_pivot(system.normal))


@register_solver(
    "gauss_inverse", "Gauss inverse", "inverse", source="Terlemezoğlu 2019, T(3.22)-(3.29)", published=True
)
def gauss_inverse(system: LinearSystem, as_run: bool) -> LinearSolution:
    """LU without pivoting."""
    return _multiplied(system, invert_gauss(system.normal))


@register_solver(
    "moore_penrose_inverse", "Moore-Penrose", "inverse", source="Terlemezoğlu 2019, T(3.30)-(3.33)", published=True
)
def moore_penrose_inverse(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Pseudo-inverse of N with the default tolerance."""
    inverse, rank = pseudo_inverse(system.normal)
    notes = (f"{len(system) - rank} of {len(system)} singular values set to zero",) if rank < len(system) else ()
    return LinearSolution(inverse @ system.rhs, inverse=inverse, rank=rank, notes=notes)


@register_solver(
    "cholesky_inverse", "Cholesky inverse", "inverse", source="Terlemezoğlu 2019, T(3.34)-(3.39)", published=True
)
def cholesky_inverse(system: LinearSystem, as_run: bool) -> LinearSolution:
    """C^-1 C^-T; under ``as_run`` the real part of the complex product with b."""
    inverse, notes = _cholesky_inverse(system.normal, as_run)
    x = (inverse @ system.rhs).real
    real = _finite(np.ascontiguousarray(inverse.real), "cholesky_inverse")
    return LinearSolution(x, inverse=real, notes=_multiplied(system, real, notes).notes)
