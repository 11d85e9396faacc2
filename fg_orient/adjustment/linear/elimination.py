"""The three published eliminations: Gauss, Gauss with partial pivoting, Cholesky with check sums.

Sources: Terlemezoğlu 2019, sections 3.6.2.1-3.6.2.3 and Table 3.1, with the misprints corrected.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.registry import register_published
from fg_orient.adjustment.linear.system import LinearSolution, LinearSystem
from fg_orient.adjustment.linear.triangular import Numbers, back_substitution, check_pivot, cholesky_rows, lost_digits

_published = partial(register_published, "elimination")


def eliminate(matrix: Array, rhs: Array, *, pivoting: bool) -> tuple[Array, tuple[str, ...]]:
    """Solve N x = b by Gauss elimination and back substitution, T(3.40)-(3.44); Breakdown for a zero pivot.

    With ``pivoting`` rows are exchanged before each step so that the largest element of
    the column is the pivot. The notes name pivots that lost their digits.
    """
    u = len(rhs)
    method = "gauss_partial_pivot_elimination" if pivoting else "gauss_elimination"
    work = np.column_stack([matrix, rhs]).astype(np.float64)
    with np.errstate(all="ignore"):  # after an overflow, a pivot or the result is not finite, which is checked
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

    The columns b and s are appended to N: C^T C = N, y = C^-T b, s_red = C^-T s. A row
    i is correct if s_red,i = sum_j c_ij + y_i. Then C x = y is solved.

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
    """Return the rows whose own contribution to the check-sum difference exceeds rounding.

    The differences e of the rows above contribute -sum_k c_ki e_k/c_ii to row i, by the
    same recursion that reduces s. The remainder c_ii e_i + sum_k c_ki e_k is the own
    contribution of row i. It is a sum of at most (u + 2)(i + 2) products. To first order,
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


@_published("gauss_elimination", "Gauss elimination", "T(3.40)-(3.44)")
def gauss_elimination(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Solve by elimination without pivoting."""
    x, notes = eliminate(system.normal, system.rhs, pivoting=False)
    return LinearSolution(x, notes=notes)


@_published("gauss_partial_pivot_elimination", "Gauss elimination, partial pivoting", "section 3.6.2.2")
def gauss_partial_pivot_elimination(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Solve by elimination with exchange of rows."""
    x, notes = eliminate(system.normal, system.rhs, pivoting=True)
    return LinearSolution(x, notes=notes)


@_published("cholesky_elimination", "Cholesky elimination", "Table 3.1, T(3.45)-(3.50)")
def cholesky_elimination(system: LinearSystem, as_run: bool) -> LinearSolution:
    """Solve by Cholesky elimination with check sums; with ``as_run`` take the real part of x."""
    solved = checked_cholesky(system.normal, system.rhs, as_run=as_run)
    return LinearSolution(np.ascontiguousarray(solved.x.real), notes=solved.notes)
