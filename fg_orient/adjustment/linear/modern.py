"""Modern solvers in addition to the published ones: QR, SVD, truncated SVD, LAPACK, and their column-scaled versions.

QR and SVD work on A and so on cond(A), not its square.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.linalg import lapack, qr

from fg_orient.adjustment.linear.inverses import moore_penrose_inverse
from fg_orient.adjustment.linear.registry import Function, register_solver
from fg_orient.adjustment.linear.system import Array, Breakdown, LinearSolution, LinearSystem, scaled
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


def _scaled(function: Callable[[LinearSystem], LinearSolution]) -> Callable[[LinearSystem], LinearSolution]:
    """Solve in unknowns of unit-length columns and transform back."""

    def solve_scaled(system: LinearSystem) -> LinearSolution:
        inner, lengths = scaled(system)
        found = function(inner)
        inverse = None if found.inverse is None else found.inverse / np.outer(lengths, lengths)
        return LinearSolution(found.x / lengths, inverse=inverse, rank=found.rank, notes=found.notes)

    return solve_scaled


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


def _lapack_lu(system: LinearSystem) -> LinearSolution:
    _, _, x, info = lapack.dgesv(system.normal, system.rhs)
    if info > 0:
        raise Breakdown.of("linear.zero_pivot", place=f"lapack_lu, step {info} of {len(system)}", value=0.0)
    return LinearSolution(x)


def _moore_penrose(system: LinearSystem) -> LinearSolution:
    return moore_penrose_inverse(system, False)


#: Name, label, source, solver, and whether it works on A. QR does not depend on the units, but for rounding.
_SOLVERS: Final[tuple[tuple[str, str, str, Callable[[LinearSystem], LinearSolution], bool], ...]] = (
    ("qr", "QR", "Householder 1958; Golub 1965", _qr, True),
    ("qr_scaled", "QR, scaled columns", "van der Sluis 1969", _scaled(_qr), True),
    ("svd", "SVD", "Golub, Kahan 1965", _svd, True),
    ("svd_scaled", "SVD, scaled columns", "Golub, Kahan 1965", _scaled(_svd), True),
    ("truncated_svd", "Truncated SVD", "Hansen 1987", _truncated_svd, True),
    ("truncated_svd_scaled", "Truncated SVD, scaled columns", "Hansen 1987", _scaled(_truncated_svd), True),
    ("lapack_cholesky", "LAPACK Cholesky", "LAPACK dposv", _lapack_cholesky, False),
    ("lapack_cholesky_scaled", "LAPACK Cholesky, scaled columns", "LAPACK dposv", _scaled(_lapack_cholesky), False),
    ("lapack_lu", "LAPACK LU", "LAPACK dgesv", _lapack_lu, False),
    ("moore_penrose_scaled", "Moore-Penrose, scaled columns", "Penrose 1955, scaled", _scaled(_moore_penrose), False),
)


def _function(function: Callable[[LinearSystem], LinearSolution]) -> Function:
    return lambda system, as_run: function(system)


for _name, _label, _source, _solver, _on_design in _SOLVERS:
    register_solver(_name, _label, "modern", source=_source, needs_design=_on_design)(_function(_solver))
