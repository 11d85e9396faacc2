"""Further solvers: QR, SVD, truncated SVD, LAPACK, their column-scaled versions, and Tikhonov regularisation.

QR and SVD use A, so their errors grow with cond(A), not with its square. Tikhonov
regularisation (Tikhonov 1963; Terlemezoğlu 2019, section 3.2, T(3.2)-(3.8) with the sign
of l corrected): x = (A^T A + kappa L^T L)^-1 A^T l.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from scipy.linalg import lapack, qr

from fg_orient.adjustment.linear.inverses import moore_penrose_inverse
from fg_orient.adjustment.linear.registry import Function, register_solver
from fg_orient.adjustment.linear.ridge import MODERN_SOLVER, tikhonov
from fg_orient.adjustment.linear.system import Breakdown, LinearSolution, LinearSystem, scaled
from fg_orient.adjustment.linear.triangular import back_substitution

#: Singular values of A below this share of the largest are truncated. In the
#: column-scaled SPOT-5 designs 1e-9 separates the directions that observations determine
#: from directions that contain only rounding.
TRUNCATION = 1e-9

Solve = Callable[[LinearSystem], LinearSolution]


def _scaled(function: Solve) -> Solve:
    """Make a solver that first scales the columns of A to unit length and then transforms the solution back."""

    def solve_scaled(system: LinearSystem) -> LinearSolution:
        inner, lengths = scaled(system)
        solution = function(inner)
        inverse = None if solution.inverse is None else solution.inverse / np.outer(lengths, lengths)
        return LinearSolution(solution.x / lengths, inverse=inverse, rank=solution.rank, notes=solution.notes)

    return solve_scaled


def _qr(system: LinearSystem) -> LinearSolution:
    """Solve by Householder QR of A without pivoting.

    Breakdown if, within rounding, a column depends on the columns before it: |r_ii| <= max(r, u) eps |a_i|.
    """
    design, observed = system.require_design("qr")
    rows, u = design.shape
    if rows < u:
        raise Breakdown.of("linear.dependent_column", place=f"qr, column {rows + 1} of {u}", value=f"{rows} rows")
    q, upper = qr(design, mode="economic")
    limit = max(rows, u) * np.finfo(np.float64).eps * np.linalg.norm(design, axis=0)
    dependent = np.flatnonzero(np.abs(upper.diagonal()) <= limit)
    if len(dependent):
        column = int(dependent[0])
        place = f"qr, column {column + 1} of {u}"
        raise Breakdown.of("linear.dependent_column", place=place, value=f"r = {upper[column, column]:.3g}")
    return LinearSolution(back_substitution(upper, q.T @ observed), rank=u)


def _svd(system: LinearSystem, relative: float | None = None) -> LinearSolution:
    """Solve with minimum norm, x = V D^-1 U^T l, from singular values above a share of the largest (max(r, u) eps)."""
    design, observed = system.require_design("svd")
    left, values, right = np.linalg.svd(design, full_matrices=False)
    share = max(design.shape) * np.finfo(np.float64).eps if relative is None else relative
    rank, u = int(np.count_nonzero(values > share * values[0])), len(system)
    x = right[:rank].T @ ((left[:, :rank].T @ observed) / values[:rank])
    return LinearSolution(x, rank=rank, notes=(f"{u - rank} of {u} singular values set to zero",) if rank < u else ())


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


_truncated_svd: Final = partial(_svd, relative=TRUNCATION)


def _moore_penrose(system: LinearSystem) -> LinearSolution:
    return moore_penrose_inverse(system, False)


#: Name, label, source and function. Units change the result of QR only by rounding.
_SOLVERS: Final[tuple[tuple[str, str, str, Solve], ...]] = (
    ("qr", "QR", "Householder 1958; Golub 1965", _qr),
    ("qr_scaled", "QR, scaled columns", "van der Sluis 1969", _scaled(_qr)),
    ("svd", "SVD", "Golub, Kahan 1965", _svd),
    ("svd_scaled", "SVD, scaled columns", "Golub, Kahan 1965", _scaled(_svd)),
    ("truncated_svd", "Truncated SVD", "Hansen 1987", _truncated_svd),
    ("truncated_svd_scaled", "Truncated SVD, scaled columns", "Hansen 1987", _scaled(_truncated_svd)),
    ("lapack_cholesky", "LAPACK Cholesky", "LAPACK dposv", _lapack_cholesky),
    ("lapack_cholesky_scaled", "LAPACK Cholesky, scaled columns", "LAPACK dposv", _scaled(_lapack_cholesky)),
    ("lapack_lu", "LAPACK LU", "LAPACK dgesv", _lapack_lu),
    ("moore_penrose_scaled", "Moore-Penrose, scaled columns", "Penrose 1955, scaled", _scaled(_moore_penrose)),
)


def _without_as_run(function: Solve) -> Function:
    return lambda system, as_run: function(system)


for _name, _label, _source, _solver in _SOLVERS:
    register_solver(_name, _label, "modern", source=_source)(_without_as_run(_solver))


#: Solver of the regularised normal equations of the published rules.
PUBLISHED_SOLVER = "gauss_partial_pivot_elimination"

#: Rule, label and source of the solvers ``tikhonov_...``; the published ones clamp kappa.
_RULES: Final = (
    ("hkb", "HKB", "T(3.5)", True),
    ("lw", "LW", "T(3.6)", True),
    ("od", "OD", "T(3.8)", True),
    ("l_curve", "L-curve", "Hansen, O'Leary 1993", False),
    ("gcv", "GCV", "Golub, Heath, Wahba 1979", False),
    ("creso", "CRESO", "Colli-Franzone 1985", False),
)


def _tikhonov(rule: str, published: bool) -> Function:
    solver = PUBLISHED_SOLVER if published else MODERN_SOLVER
    return lambda system, as_run: tikhonov(system, rule, clamp=published, solver=solver)


for _rule, _label, _source, _published in _RULES:
    register = register_solver(
        f"tikhonov_{_rule}", f"Tikhonov {_label}", "tikhonov", source=_source, published=_published
    )
    register(_tikhonov(_rule, _published))
