"""Conditioning of a linear system: determinant, rank, and the three published condition numbers of N.

Sources: Terlemezoğlu 2019, sections 3.3-3.4, T(3.9)-(3.14), who applies all of them to N = A^T A. Determinants are
stored as sign and logarithm, so that they neither overflow nor underflow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from fg_orient.adjustment.linear.system import Array, LinearSystem, scaled

#: Limits of the publication. A system is unstable if the number is above, above, below its limit.
NORM_LIMIT: Final = 1e16
SPECTRAL_LIMIT: Final = 1e3
HADAMARD_LIMIT: Final = 1e-2


def singular_values(matrix: Array) -> Array:
    """Singular values (u,) of a matrix (r, u), descending; u - r zeros are appended if r < u.

    These zeros are singular values of N = A^T A. Without them a system with too few observations looks regular.
    """
    rows, u = matrix.shape
    return np.append(np.linalg.svd(matrix, compute_uv=False), np.zeros(max(u - rows, 0)))


def numerical_rank(values: Array, size: int) -> int:
    """Number of singular values above size * eps(largest), eps(x) the spacing of doubles at x (MATLAB's rank).

    Parameters
    ----------
    values : (u,) array
        Singular values, descending.
    size : int
        Larger side of the matrix.
    """
    return int(np.count_nonzero(values > size * np.spacing(values[0])))


@dataclass(frozen=True)
class Conditioning:
    """Diagnostics of N.

    Parameters
    ----------
    order : int
        u.
    rank : int
        Rank of N, tolerance u eps(sigma_max), T(3.10).
    rank_scaled : int
        Rank of A with columns of length 1; of the scaled N if A is not known.
    det_sign : float
        Computed sign of det N: -1, 0 or 1.
    log10_det : float
        log10|det N|; -inf for 0.
    cond_norm : float
        |N|_2 |N^-1|_2 from the singular values of N, T(3.11); inf if the smallest value is 0.
    cond_spectral : float
        lambda_max/lambda_min (Todd), T(3.12), as computed: negative if rounding makes lambda_min negative.
    cond_hadamard : float
        |det N|/prod_i alpha_i in [0, 1], alpha_i the row norms, T(3.13)-(3.14); 0 if it underflows.
    """

    order: int
    rank: int
    rank_scaled: int
    det_sign: float
    log10_det: float
    cond_norm: float
    cond_spectral: float
    cond_hadamard: float

    @property
    def defect(self) -> int:
        """Rank defect u - rank(N)."""
        return self.order - self.rank


def diagnose(subject: LinearSystem | Array) -> Conditioning:
    """Diagnose normal equations.

    Parameters
    ----------
    subject : LinearSystem or (r, u) array
        A system, or a design matrix A.

    Raises
    ------
    InputError
        The design matrix is unusable.
    """
    system = subject
    if not isinstance(system, LinearSystem):
        system = LinearSystem.from_design(system, np.zeros(len(system)))
    normal, u, ten = system.normal, len(system), np.log(10.0)
    unit = scaled(system)[0]
    columns = unit.normal if unit.design is None else unit.design
    values = singular_values(normal)
    sign, log_det = np.linalg.slogdet(normal)
    eigenvalues = np.linalg.eigvalsh(normal)
    with np.errstate(all="ignore"):
        rows = np.log(np.linalg.norm(normal, axis=1)).sum()
        hadamard = np.float64(10.0) ** (float(log_det - rows) / ten) if sign else 0.0
        return Conditioning(
            u, numerical_rank(values, u), numerical_rank(singular_values(columns), max(columns.shape)),
            float(sign), float(log_det / ten), _ratio(values[0], values[-1]),
            _ratio(eigenvalues[-1], eigenvalues[0]), float(hadamard),
        )  # fmt: skip


def _ratio(largest: float, least: float) -> float:
    """Quotient; inf for a divisor of zero."""
    return float(largest / least) if least else float("inf")
