"""Solvers of today beside the published ones: QR, SVD, truncated SVD, LAPACK, and their column-scaled versions.

QR and SVD work on A and so on cond(A), not its square.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import lapack, qr

from fg_orient.adjustment.linear.inverses import moore_penrose_inverse
from fg_orient.adjustment.linear.registry import register_solver
from fg_orient.adjustment.linear.scaling import scaled
from fg_orient.adjustment.linear.system import Array, Breakdown, LinearSolution, LinearSystem
from fg_orient.adjustment.linear.triangular import back_substitution

#: Singular values of A below this share of the largest are truncated: 1e-9 separates the directions of the
#: column-scaled SPOT-5 designs that observations determine from those that only rounding fills.
TRUNCATION = 1e-9


def solve_qr(design: Array, observed: Array, method: str = "qr") -> Array:
    """Least squares by Householder QR without pivoting.

    Parameters
    ----------
    design : (r, u) array
    observed : (r,) array
    method : str
        Named in the report of a breakdown.

    Returns
    -------
    (u,) array

    Raises
    ------
    Breakdown
        A column depends on those before it within rounding: |r_ii| <= max(r, u) eps |a_i|.
    """
    rows, u = design.shape
    if rows < u:
        raise Breakdown.of("linear.dependent_column", place=f"{method}, column {rows + 1} of {u}", value=f"{rows} rows")
    q, upper = qr(design, mode="economic")
    limit = max(rows, u) * np.finfo(np.float64).eps * np.linalg.norm(design, axis=0)
    dependent = np.flatnonzero(np.abs(upper.diagonal()) <= limit)
    if len(dependent):
        column = int(dependent[0])
        place = f"{method}, column {column + 1} of {u}"
        raise Breakdown.of("linear.dependent_column", place=place, value=f"r = {upper[column, column]:.3g}")
    solution: Array = back_substitution(upper, q.T @ observed)
    return solution


def solve_svd(design: Array, observed: Array, relative: float | None = None) -> tuple[Array, int]:
    """Minimum-norm least squares by SVD: x = V D^-1 U^T l over the singular values kept.

    Parameters
    ----------
    design : (r, u) array
    observed : (r,) array
    relative : float, optional
        Share of the largest singular value below which directions are dropped; default max(r, u) eps.

    Returns
    -------
    x : (u,) array
    rank : int
    """
    left, values, right = np.linalg.svd(design, full_matrices=False)
    share = max(design.shape) * np.finfo(np.float64).eps if relative is None else relative
    rank = int(np.count_nonzero(values > share * values[0]))
    return right[:rank].T @ ((left[:, :rank].T @ observed) / values[:rank]), rank


def _by_svd(system: LinearSystem, method: str, relative: float | None) -> LinearSolution:
    """SVD solution with the number of directions dropped."""
    x, rank = solve_svd(*system.require_design(method), relative)
    u = len(system)
    return LinearSolution(x, rank=rank, notes=(f"{u - rank} of {u} singular values set to zero",) if rank < u else ())


def _in_scaled_units(function: Callable[[LinearSystem], LinearSolution], system: LinearSystem) -> LinearSolution:
    """Solve in unknowns of unit-length columns and go back."""
    inner, lengths = scaled(system)
    found = function(inner)
    inverse = None if found.inverse is None else found.inverse / np.outer(lengths, lengths)
    return LinearSolution(found.x / lengths, inverse=inverse, rank=found.rank, notes=found.notes)


def _qr(system: LinearSystem) -> LinearSolution:
    return LinearSolution(solve_qr(*system.require_design("qr")), rank=len(system))


def _svd(system: LinearSystem) -> LinearSolution:
    return _by_svd(system, "svd", None)


def _truncated_svd(system: LinearSystem) -> LinearSolution:
    return _by_svd(system, "truncated_svd", TRUNCATION)


def _lapack_cholesky(system: LinearSystem) -> LinearSolution:
    _, x, info = lapack.dposv(system.normal, system.rhs)
    if info > 0:
        raise Breakdown.of("linear.radicand", place=f"lapack_cholesky, row {info} of {len(system)}")
    return LinearSolution(x)


@register_solver("qr", "QR", "modern", source="Householder 1958; Golub 1965", needs_design=True)
def qr_solver(system: LinearSystem, as_run: bool) -> LinearSolution:
    """QR of A."""
    return _qr(system)


@register_solver("qr_scaled", "QR, scaled columns", "modern", source="van der Sluis 1969", needs_design=True)
def qr_scaled(system: LinearSystem, as_run: bool) -> LinearSolution:
    """QR of A with unit-length columns; the same up to rounding, for QR does not see the units."""
    return _in_scaled_units(_qr, system)


@register_solver("svd", "SVD", "modern", source="Golub, Kahan 1965", needs_design=True)
def svd(system: LinearSystem, as_run: bool) -> LinearSolution:
    """SVD of A; singular values that are rounding are dropped."""
    return _svd(system)


@register_solver("svd_scaled", "SVD, scaled columns", "modern", source="Golub, Kahan 1965", needs_design=True)
def svd_scaled(system: LinearSystem, as_run: bool) -> LinearSolution:
    """SVD of A with unit-length columns."""
    return _in_scaled_units(_svd, system)


@register_solver("truncated_svd", "Truncated SVD", "modern", source="Hansen 1987", needs_design=True)
def truncated_svd(system: LinearSystem, as_run: bool) -> LinearSolution:
    """SVD of A, directions below 1e-9 of the largest singular value dropped."""
    return _truncated_svd(system)


@register_solver(
    "truncated_svd_scaled", "Truncated SVD, scaled columns", "modern", source="Hansen 1987", needs_design=True
)
def truncated_svd_scaled(system: LinearSystem, as_run: bool) -> LinearSolution:
    """SVD of A with unit-length columns, directions below 1e-9 dropped."""
    return _in_scaled_units(_truncated_svd, system)


@register_solver("lapack_cholesky", "LAPACK Cholesky", "modern", source="LAPACK dposv")
def lapack_cholesky(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Cholesky of N by LAPACK."""
    return _lapack_cholesky(system)


@register_solver("lapack_cholesky_scaled", "LAPACK Cholesky, scaled columns", "modern", source="LAPACK dposv")
def lapack_cholesky_scaled(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Cholesky by LAPACK of N with unit diagonal."""
    return _in_scaled_units(_lapack_cholesky, system)


@register_solver("lapack_lu", "LAPACK LU", "modern", source="LAPACK dgesv")
def lapack_lu(system: LinearSystem, as_run: bool) -> LinearSolution:
    """LU with partial pivoting of N by LAPACK."""
    _, _, x, info = lapack.dgesv(system.normal, system.rhs)
    if info > 0:
        raise Breakdown.of("linear.zero_pivot", place=f"lapack_lu, step {info} of {len(system)}", value=0.0)
    return LinearSolution(x)


@register_solver("moore_penrose_scaled", "Moore-Penrose, scaled columns", "modern", source="Penrose 1955, scaled")
def moore_penrose_scaled(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Pseudo-inverse of N with unit diagonal."""
    return _in_scaled_units(lambda inner: moore_penrose_inverse(inner, False), system)
