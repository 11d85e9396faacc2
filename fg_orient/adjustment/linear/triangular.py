"""Triangular factors in the published form: Doolittle LU, Cholesky (real, or complex as published), inverses.

Row and column operations are numpy expressions in the order of the formulas. Sums over k are dot products.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.adjustment.linear.system import Breakdown

# Real, or complex after a negative radicand. (No '#:': autodoc cannot format this alias.)
Numbers = npt.NDArray[Any]

#: If a pivot is below this share of its matrix element, it has lost 12 of 16 digits, and the method fails.
LOST = 1e-12


def check_pivot(pivot: Any, method: str, step: int, of: int) -> None:
    """Raise Breakdown for a pivot that is zero or not finite; ``step`` counts from 0."""
    if pivot == 0 or not np.isfinite(pivot):
        raise Breakdown.of("linear.zero_pivot", place=f"{method}, step {step + 1} of {of}", value=pivot)


def lost_digits(pivots: Numbers, elements: Numbers) -> tuple[str, ...]:
    """Return a remark on the pivot with the largest cancellation against its matrix element.

    The remark is only an indication. If there are several small pivots, rounding can make
    a zero pivot larger than the limit.
    """
    with np.errstate(divide="ignore"):  # an element of 0 cannot lose digits
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
    """Factor N = C^T C row by row, C upper, and reduce the columns appended to N in the same way; T(3.34)-(3.36).

    c_ii = sqrt(a_ii - sum_k c_ki^2), c_ij = (a_ij - sum_k c_ki c_kj)/c_ii, k < i. No
    element is conjugated, so C^T C = N holds for complex C too.

    Parameters
    ----------
    matrix : (u, u + m) array
        N and m further columns.
    method : str
        Name of the solver, for messages.
    as_run : bool
        The square root of a negative radicand is complex, as in MATLAB; C is then complex from that row on.

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
