"""The published solvers, written out: five inverses and three eliminations, with their triangular factors.

Sources: Terlemezoğlu 2019, sections 3.6.1.1-3.6.2.3 and Table 3.1, with the misprints corrected. Inverses: Cramer,
exchange step, Gauss, Moore-Penrose, Cholesky; each is formed explicitly and then multiplied with b. Eliminations:
Gauss, Gauss with partial pivoting, Cholesky with check sums. Row and column operations are numpy expressions. They
follow the order of the formulas; sums over k are dot products.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.linear.registry import Family, Function, register_solver
from fg_orient.adjustment.linear.system import Array, Breakdown, LinearSolution, LinearSystem

# Real, or complex after a negative radicand. (No '#:': autodoc cannot format this alias.)
Numbers = npt.NDArray[Any]

Inverse = Callable[[Array], Array]

#: A pivot below this share of its matrix element has lost 12 of 16 digits: the matrix is singular for the method.
LOST = 1e-12


def _published(name: str, label: str, family: Family, equations: str) -> Callable[[Function], Function]:
    """Register a solver of the publication."""
    return register_solver(name, label, family, source=f"Terlemezoğlu 2019, {equations}", published=True)


def check_pivot(pivot: Any, method: str, step: int, of: int) -> None:
    """Raise Breakdown for a pivot that is zero or not finite; ``step`` counts from 0."""
    if pivot == 0 or not np.isfinite(pivot):
        raise Breakdown.of("linear.zero_pivot", place=f"{method}, step {step + 1} of {of}", value=pivot)


def lost_digits(pivots: Numbers, elements: Numbers) -> tuple[str, ...]:
    """Remark on the pivot with the largest cancellation against its matrix element.

    It is only an indication: with several small pivots, rounding can lift a pivot that should vanish above the limit.
    """
    with np.errstate(divide="ignore"):  # an element 0 cannot lose digits
        share = np.abs(pivots) / np.abs(elements)
    worst = int(share.argmin())
    if share[worst] >= LOST:
        return ()
    return (f"pivot {worst + 1} of {len(share)} kept {share[worst]:.1e} of its element: the matrix is near singular",)


def lu_factors(matrix: Array) -> tuple[Array, Array]:
    """Factor N = C B without pivoting (Doolittle): C unit lower, B upper; T(3.22)-(3.26), ranges corrected.

    Breakdown for a zero pivot.
    """
    u = len(matrix)
    lower, upper = np.eye(u), np.zeros((u, u))
    with np.errstate(all="ignore"):  # overflow shows as a pivot or a result that is not finite
        for i in range(u):
            upper[i, i:] = matrix[i, i:] - lower[i, :i] @ upper[:i, i:]
            check_pivot(upper[i, i], "gauss_inverse", i, u)
            lower[i + 1 :, i] = (matrix[i + 1 :, i] - lower[i + 1 :, :i] @ upper[:i, i]) / upper[i, i]
    return lower, upper


def cholesky_rows(matrix: Array, method: str, *, as_run: bool = False) -> tuple[Numbers, tuple[str, ...]]:
    """Factor N = C^T C row by row, C upper, and reduce columns appended to N alike; T(3.34)-(3.36).

    c_ii = sqrt(a_ii - sum_k c_ki^2), c_ij = (a_ij - sum_k c_ki c_kj)/c_ii, k < i. No element is conjugated,
    so C^T C = N holds for complex C too.

    Parameters
    ----------
    matrix : (u, u + m) array
        N and m further columns.
    method : str
        Name of the solver, for messages.
    as_run : bool
        The square root of a negative radicand is complex, as in MATLAB; from that row on C is complex.

    Returns
    -------
    factor : (u, u + m) array
        C and C^-T times the further columns.
    notes : tuple of str
        Negative radicands and lost digits.

    Raises
    ------
    Breakdown
        A radicand is zero or not finite, or negative without ``as_run``.
    """
    u = len(matrix)
    factor: Numbers = np.zeros(matrix.shape)
    radicands: list[Any] = []
    notes: list[str] = []
    with np.errstate(all="ignore"):
        for i in range(u):
            radicand = matrix[i, i] - factor[:i, i] @ factor[:i, i]
            place = f"{method}, row {i + 1} of {u}"
            if radicand == 0 or not np.isfinite(radicand) or (radicand.real < 0 and not as_run):
                raise Breakdown.of("linear.radicand", place=place, value=f"{radicand.real:.6g}")
            if radicand.real < 0:
                notes.append(f"row {i + 1}: negative radicand {radicand.real:.6g}, complex root taken")
                factor = factor.astype(np.complex128)
                radicand = complex(radicand)
            radicands.append(radicand)
            factor[i, i] = np.sqrt(radicand)
            factor[i, i + 1 :] = (matrix[i, i + 1 :] - factor[:i, i] @ factor[:i, i + 1 :]) / factor[i, i]
    return factor, (*notes, *lost_digits(np.array(radicands), matrix.diagonal()))


def upper_inverse(upper: Numbers) -> Numbers:
    """Invert an upper triangular matrix column by column: x_jj = 1/r_jj, x_ij = -(sum_k x_ik r_kj) x_jj."""
    inverse = np.zeros_like(upper)
    for j in range(len(upper)):
        inverse[j, j] = 1.0 / upper[j, j]
        inverse[:j, j] = -(inverse[:j, :j] @ upper[:j, j]) * inverse[j, j]
    return inverse


def back_substitution(upper: Numbers, rhs: Numbers) -> Numbers:
    """Solve R x = y from the last row up: x_i = (y_i - sum_{j>i} r_ij x_j)/r_ii."""
    x = np.zeros_like(rhs)
    for i in range(len(rhs) - 1, -1, -1):
        x[i] = (rhs[i] - upper[i, i + 1 :] @ x[i + 1 :]) / upper[i, i]
    return x


def eliminate(matrix: Array, rhs: Array, *, pivoting: bool) -> tuple[Array, tuple[str, ...]]:
    """Solve N x = b by Gauss elimination and back substitution, T(3.40)-(3.44); Breakdown for a zero pivot.

    With ``pivoting`` rows are exchanged before each step so that the largest element of the column is the pivot. The
    notes name pivots that lost their digits.
    """
    u = len(rhs)
    method = "gauss_partial_pivot_elimination" if pivoting else "gauss_elimination"
    work = np.column_stack([matrix, rhs]).astype(np.float64)
    with np.errstate(all="ignore"):  # overflow shows as a pivot or a result that is not finite
        for k in range(u):
            if pivoting:
                largest = k + int(np.abs(work[k:, k]).argmax())
                work[[k, largest]] = work[[largest, k]]
            check_pivot(work[k, k], method, k, u)
            work[k + 1 :, k:] -= np.outer(work[k + 1 :, k] / work[k, k], work[k, k:])
        x = back_substitution(work[:, :u], work[:, u])
    return x, lost_digits(work.diagonal(), np.abs(matrix).max(axis=0))


class CheckedElimination(NamedTuple):
    """Cholesky elimination with check sums; see :func:`checked_cholesky`."""

    x: Numbers
    checks: Array
    violated: tuple[int, ...]
    notes: tuple[str, ...]


def checked_cholesky(
    normal: Array, rhs: Array, sums: Array | None = None, *, as_run: bool = False
) -> CheckedElimination:
    """Solve N x = b by Cholesky with a check-sum column, T-Table 3.1, T(3.45)-(3.50).

    The columns b and s are appended to N: C^T C = N, y = C^-T b, s_red = C^-T s. Each row is checked by
    s_red,i = sum_j c_ij + y_i. Then C x = y is solved.

    Parameters
    ----------
    normal : (u, u) array
        Symmetric.
    rhs : (u,) array
    sums : (u,) array, optional
        s_i = sum_j n_ij + b_i, updated since N was formed; default: computed here.
    as_run : bool
        Negative radicands have complex roots.

    Returns
    -------
    x : (u,) array
        Solution; complex with ``as_run`` after a negative radicand.
    checks : (u,) array
        |s_red,i - (sum_j c_ij + y_i)|: zero except for rounding.
    violated : tuple of int
        Rows (from 0) whose check sum differs by more than rounding.
    notes : tuple of str
        Negative radicands, lost digits, violated check sums.

    Raises
    ------
    Breakdown
        A radicand is not positive (with ``as_run``: zero).
    """
    u = len(rhs)
    given = normal.sum(axis=1) + rhs if sums is None else sums
    table = np.column_stack([normal, rhs, given])
    factor, notes = cholesky_rows(table, "cholesky_elimination", as_run=as_run)
    with np.errstate(all="ignore"):
        off = factor[:, u + 1] - factor[:, : u + 1].sum(axis=1)
        violated = _violated(table, factor, off)
        x = back_substitution(factor[:, :u], factor[:, u])
    checks = np.abs(off)
    notes = (*notes, *(f"row {i + 1}: check sum off by {checks[i]:.3g}" for i in violated))
    return CheckedElimination(x, checks, violated, notes)


def _violated(table: Array, factor: Numbers, off: Numbers) -> tuple[int, ...]:
    """Rows whose own part of the check-sum difference exceeds rounding.

    The differences e of the rows above enter row i as -sum_k c_ki e_k/c_ii (the same recursion that reduces s). The
    remainder c_ii e_i + sum_k c_ki e_k arises in row i. It is a sum of at most (u + 2)(i + 2) products. To first order
    their rounding is (u + i + 4) eps times the sum of their absolute values.
    """
    u = len(table)
    size, diagonal = np.abs(factor), factor.diagonal()
    above = np.triu(factor[:, :u], 1)
    own = np.abs(diagonal * off + above.T @ off)
    rows = size.sum(axis=1)
    amount = np.abs(table[:, u:]).sum(axis=1) + np.abs(table[:, :u]).sum(axis=1)
    amount += np.abs(above).T @ rows + np.abs(diagonal) * rows
    limit = (u + np.arange(u) + 4) * np.finfo(np.float64).eps * amount
    return tuple(int(i) for i in np.flatnonzero(own > limit))


@_published("gauss_elimination", "Gauss elimination", "elimination", "T(3.40)-(3.44)")
def gauss_elimination(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Elimination without pivoting."""
    x, notes = eliminate(system.normal, system.rhs, pivoting=False)
    return LinearSolution(x, notes=notes)


@_published("gauss_partial_pivot_elimination", "Gauss elimination, partial pivoting", "elimination", "section 3.6.2.2")
def gauss_partial_pivot_elimination(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Elimination with exchange of rows."""
    x, notes = eliminate(system.normal, system.rhs, pivoting=True)
    return LinearSolution(x, notes=notes)


@_published("cholesky_elimination", "Cholesky elimination", "elimination", "Table 3.1, T(3.45)-(3.50)")
def cholesky_elimination(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Cholesky with check sums; with ``as_run`` the real part of x."""
    solved = checked_cholesky(system.normal, system.rhs, as_run=as_run)
    return LinearSolution(np.ascontiguousarray(solved.x.real), notes=solved.notes)


def _solver(name: str, label: str, equations: str) -> Callable[[Inverse], Inverse]:
    """Register the solver that multiplies the inverse of a decorated function with b."""

    def add(invert: Inverse) -> Inverse:
        def multiplied(system: LinearSystem, as_run: bool) -> LinearSolution:
            inverse = invert(system.normal)
            return LinearSolution(inverse @ system.rhs, inverse=inverse, notes=_inflation(system, inverse))

        _published(name, label, "inverse", equations)(multiplied)
        return invert

    return add


def _finite(inverse: Array, method: str) -> Array:
    """Raise Breakdown for an inverse that overflowed."""
    if not np.isfinite(inverse).all():
        raise Breakdown.of("linear.result_not_finite", place=method)
    return inverse


def _inflation(system: LinearSystem, inverse: Array) -> tuple[str, ...]:
    """Remark if digits are lost.

    n_ii (N^-1)_ii has no unit. Its reciprocal is the share of n_ii that remains after the elimination of all other
    unknowns: the same measure as a lost pivot. (N N^-1 is close to the identity even for a singular N.)
    """
    inflation = float(np.abs(system.normal.diagonal() * inverse.diagonal()).max())
    if inflation <= 1.0 / LOST:
        return ()
    return (f"an element n_ii times its inverse's is {inflation:.1e}: the matrix is near singular",)


@_solver("cramer_inverse", "Cramer inverse", "T(3.9)")
def invert_cramer(normal: Array) -> Array:
    """Invert (u, u) by cofactors: N^-1 = adj(N)/det(N), T(3.9); Breakdown if the determinant is zero.

    Determinants are stored as sign and logarithm, and only differences of logarithms are exponentiated: no
    determinant overflows. The cost grows with u^5: 1 s at u = 84.
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


@_solver("pivot_inverse", "Pivot inverse", "T(3.17)-(3.21)")
def invert_pivot(matrix: Array) -> Array:
    """Invert (u, u) by exchange steps with complete pivoting, T(3.17)-(3.21); also non-symmetric matrices.

    Breakdown if all remaining elements are zero.
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
    """Moore-Penrose inverse N^+ = V D^-1 U^T of the singular values kept, and their number; T(3.30)-(3.33).

    Singular values above max(u, v) times the spacing of doubles at the largest one are kept (the rule of MATLAB's pinv
    and rank).

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


@_published("moore_penrose_inverse", "Moore-Penrose", "inverse", "T(3.30)-(3.33)")
def moore_penrose_inverse(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Pseudo-inverse of N."""
    inverse, rank = pseudo_inverse(system.normal)
    notes = (f"{len(system) - rank} of {len(system)} singular values set to zero",) if rank < len(system) else ()
    return LinearSolution(inverse @ system.rhs, inverse=inverse, rank=rank, notes=notes)


@_published("cholesky_inverse", "Cholesky inverse", "inverse", "T(3.34)-(3.39)")
def cholesky_inverse(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Cholesky N = C^T C, N^-1 = C^-1 C^-T; Breakdown if a radicand is not positive.

    With ``as_run`` negative radicands have complex roots, as in MATLAB, and x is the real part of the product with b.
    """
    factor, notes = cholesky_rows(system.normal, "cholesky_inverse", as_run=as_run)
    with np.errstate(all="ignore"):
        root = upper_inverse(factor)
        inverse = root @ root.T
    real = _finite(np.ascontiguousarray(inverse.real), "cholesky_inverse")
    return LinearSolution((inverse @ system.rhs).real, inverse=real, notes=notes or _inflation(system, real))
