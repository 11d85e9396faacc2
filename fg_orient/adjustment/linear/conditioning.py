"""Conditioning of a linear system: determinant, rank, the three published condition numbers, scale-free versions.

Sources: Terlemezoğlu 2019, sections 3.3-3.4, T(3.9)-(3.14), who applies all of them to N = A^T A. Determinants are
kept as sign and logarithm, so that none of them over- or underflows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from fg_orient.adjustment.linear.system import Array, LinearSolution, LinearSystem, scaled
from fg_orient.model.errors import InputError

Verdict = Literal["stable", "unstable"]

#: Limits of the publication: above, above, below them a system counts as unstable.
NORM_LIMIT: Final = 1e16
SPECTRAL_LIMIT: Final = 1e3
HADAMARD_LIMIT: Final = 1e-2


def singular_values(matrix: Array) -> Array:
    """Singular values (u,) of a matrix (r, u), descending; zeros where it has fewer rows than columns.

    Those zeros are singular values of N = A^T A, too: without them a system with too few observations looks regular.
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

    Returns
    -------
    int
    """
    return int(np.count_nonzero(values > size * np.spacing(values[0])))


def condition_text(value: float) -> str:
    """Condition number for tables: beyond 1e16, or negative, it says only that rounding hides the least eigenvalue."""
    return f"{value:.2g}" if 0.0 < value < NORM_LIMIT else ">= 1e16"


@dataclass(frozen=True)
class Conditioning:
    """Diagnostics of N; names with ``scaled`` belong to unknowns of unit-length columns of A.

    Parameters
    ----------
    order : int
        u.
    rank, rank_scaled : int
        Of N, tolerance u eps(sigma_max), T(3.10); of the column-scaled A.
    det_sign, det_sign_scaled : float
        Sign of det N as computed: -1, 0 or 1.
    log10_det, log10_det_scaled : float
        log10|det N|; -inf for 0.
    cond_norm, cond_norm_scaled : float
        |N|_2 |N^-1|_2 from the singular values of N, T(3.11); inf if the smallest is 0.
    cond_spectral, cond_spectral_scaled : float
        lambda_max/lambda_min (Todd), T(3.12), as computed: negative where rounding makes lambda_min negative.
    log10_hadamard, log10_hadamard_scaled : float
        log10 of |det N|/prod_i alpha_i, alpha_i the row norms, T(3.13)-(3.14).
    singular_values, singular_values_scaled : (u,) array
        Of A and of A with unit-length columns, descending; roots of those of N where A is not known.
    """

    order: int
    rank: int
    det_sign: float
    log10_det: float
    cond_norm: float
    cond_spectral: float
    log10_hadamard: float
    singular_values: Array
    rank_scaled: int
    det_sign_scaled: float
    log10_det_scaled: float
    cond_norm_scaled: float
    cond_spectral_scaled: float
    log10_hadamard_scaled: float
    singular_values_scaled: Array

    @property
    def defect(self) -> int:
        """Rank defect u - rank(N)."""
        return self.order - self.rank

    @property
    def defect_scaled(self) -> int:
        """Rank defect of the column-scaled A."""
        return self.order - self.rank_scaled

    @property
    def cond_hadamard(self) -> float:
        """Hadamard number in [0, 1]; 0 where it underflows."""
        return _power(self.log10_hadamard)

    @property
    def cond_hadamard_scaled(self) -> float:
        """Hadamard number of the scaled N."""
        return _power(self.log10_hadamard_scaled)

    @property
    def cond_design(self) -> float:
        """Condition number of A: no square is taken, so it is right up to 1e16."""
        return _ratio(self.singular_values)

    @property
    def cond_design_scaled(self) -> float:
        """Condition number of A with unit-length columns: what is left when the units are taken out."""
        return _ratio(self.singular_values_scaled)

    @property
    def verdict_norm(self) -> Verdict:
        """Published limit 1e16."""
        return "unstable" if not self.cond_norm <= NORM_LIMIT else "stable"

    @property
    def verdict_spectral(self) -> Verdict:
        """Published limit 1e3; a negative number means that lambda_min drowned in rounding."""
        return "unstable" if not 0.0 < self.cond_spectral <= SPECTRAL_LIMIT else "stable"

    @property
    def verdict_hadamard(self) -> Verdict:
        """Published limit 1e-2; the number shrinks with u whatever the conditioning."""
        return "unstable" if not self.cond_hadamard >= HADAMARD_LIMIT else "stable"


def diagnose(subject: LinearSystem | Array) -> Conditioning:
    """Diagnose normal equations.

    Parameters
    ----------
    subject : LinearSystem or (r, u) array
        A system, or a design matrix A.

    Returns
    -------
    Conditioning

    Raises
    ------
    InputError
        The design matrix is unusable.
    """
    system = subject
    if not isinstance(system, LinearSystem):
        system = LinearSystem.from_design(system, np.zeros(len(system)))
    unit, _ = scaled(system)
    raw, same = _Numbers.of(system), _Numbers.of(unit)
    rank_scaled = same.rank  # of N where A is not known
    if unit.design is not None:
        rank_scaled = numerical_rank(same.values, max(unit.design.shape))
    return Conditioning(
        order=len(system),
        rank=raw.rank,
        det_sign=raw.sign,
        log10_det=raw.log10_det,
        cond_norm=raw.norm,
        cond_spectral=raw.spectral,
        log10_hadamard=raw.log10_hadamard,
        singular_values=raw.values,
        rank_scaled=rank_scaled,
        det_sign_scaled=same.sign,
        log10_det_scaled=same.log10_det,
        cond_norm_scaled=same.norm,
        cond_spectral_scaled=same.spectral,
        log10_hadamard_scaled=same.log10_hadamard,
        singular_values_scaled=same.values,
    )


@dataclass(frozen=True)
class _Numbers:
    """Diagnostics in one system of units; ``values`` are the singular values of A, or roots of those of N."""

    rank: int
    sign: float
    log10_det: float
    norm: float
    spectral: float
    log10_hadamard: float
    values: Array

    @classmethod
    def of(cls, system: LinearSystem) -> _Numbers:
        normal, ten = system.normal, np.log(10.0)
        values = singular_values(normal)
        sign, log_det = np.linalg.slogdet(normal)
        eigenvalues = np.linalg.eigvalsh(normal)
        with np.errstate(divide="ignore", over="ignore"):
            rows = np.log(np.linalg.norm(normal, axis=1)).sum()
            spectral = float(eigenvalues[-1] / eigenvalues[0]) if eigenvalues[0] else float("inf")
        hadamard = float(log_det - rows) / ten if sign else -float("inf")
        of_design = np.sqrt(values) if system.design is None else singular_values(system.design)
        rank = numerical_rank(values, len(system))
        return cls(rank, float(sign), float(log_det / ten), _ratio(values), spectral, float(hadamard), of_design)


def _ratio(values: Array) -> float:
    """Largest over smallest singular value."""
    with np.errstate(over="ignore"):
        return float(values[0] / values[-1]) if values[-1] > 0.0 else float("inf")


def _power(log10: float) -> float:
    """10 to a power that may underflow to 0."""
    with np.errstate(under="ignore", over="ignore"):
        return float(np.float64(10.0) ** log10)


@dataclass(frozen=True)
class Spread:
    """Agreement of solvers with a reference.

    Parameters
    ----------
    reference : str
    elementwise : dict of str to (u,) array
        |x_i - ref_i|/|ref_i| of each solver that gave a solution; 0 where both are 0.
    normwise : dict of str to float
        |x - ref|/|ref|.
    failures : dict of str to str
        Solvers without solution and their reasons.
    """

    reference: str
    elementwise: dict[str, Array]
    normwise: dict[str, float]
    failures: dict[str, str]

    @property
    def largest_elementwise(self) -> float:
        """Largest element-wise difference of all solvers; 0 if the reference stands alone."""
        return max((float(values.max()) for values in self.elementwise.values()), default=0.0)

    @property
    def largest_normwise(self) -> float:
        """Largest norm-wise difference of all solvers."""
        return max(self.normwise.values(), default=0.0)


def cross_solver_spread(
    results: Mapping[str, LinearSolution], reference: str = "gauss_partial_pivot_elimination"
) -> Spread:
    """Compare solutions of one system; what differs marks an ill-conditioned subset.

    Parameters
    ----------
    results : mapping of str to LinearSolution
        By solver, as :func:`fg_orient.adjustment.linear.registry.attempt` gives them.
    reference : str
        The solver to compare with.

    Returns
    -------
    Spread

    Raises
    ------
    InputError
        The reference is missing or has no solution.
    """
    found = results.get(reference)
    if found is None or found.failure:
        value = f"{reference}: {found.failure if found else 'not among the results'}"
        raise InputError.of("linear.reference", place="reference", value=value)
    others = {name: one.x for name, one in results.items() if not one.failure and name != reference}
    failures = {name: one.failure for name, one in results.items() if one.failure}
    elementwise = {name: _relative(np.abs(x - found.x), np.abs(found.x)) for name, x in others.items()}
    length = np.linalg.norm(found.x)
    normwise = {name: float(_relative(np.linalg.norm(x - found.x), length)) for name, x in others.items()}
    return Spread(reference, elementwise, normwise, failures)


def _relative(difference: Array | np.floating[Any], size: Array | np.floating[Any]) -> Array:
    """Quotient with 0/0 = 0."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(np.equal(difference, 0.0), 0.0, np.divide(difference, size))
