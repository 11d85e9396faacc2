"""Linear system ``N x = b``, its solution, its conditioning, and the exception of a solver that fails.

If the design matrix is known, ``N = A^T A`` and ``b = A^T l``: A (r, u) and l (r,) are
whitened, so that a Gauss-Helmert adjustment gives ``A = M^-1/2 A'`` and ``l = -M^-1/2
w``. QR and SVD require A; the published methods use N and b only. In scaled units every
column of A has length 1.

Conditioning: determinant, rank, and the three published condition numbers of N
(Terlemezoğlu 2019, sections 3.3-3.4, T(3.9)-(3.14)). Determinants are stored as sign and
logarithm, so that they neither overflow nor underflow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.model.errors import InputError, NoSolutionError

#: Maximum number of unknowns of dense matrices by default; the graph backend is made for larger systems.
MAX_UNKNOWNS = 2000
#: N is not symmetric if |N - N^T| exceeds this share of the largest element; smaller differences are rounding.
SYMMETRY_TOLERANCE = 1e-10


class Breakdown(NoSolutionError):
    """Error: a solver failed (pivot 0, radicand not positive ...); ``problems[0]`` contains place and reason."""


class Rest(NamedTuple):
    """Rows that are zero in A after an elimination: their number, and the sum of squares of their l."""

    rows: int = 0
    squares: float = 0.0


NO_REST: Final = Rest()


@dataclass(frozen=True)
class LinearSystem:
    """Normal equations whose matrices have been checked.

    Parameters
    ----------
    normal : (u, u) array
        Symmetric N.
    rhs : (u,) array
        b.
    design : (r, u) array, optional
        Whitened A with ``N = A^T A``.
    observed : (r,) array, optional
        Whitened l with ``b = A^T l``.
    rest : Rest
        Further rows, without unknowns; A is then the square root of a reduced system.
    limit : int
        Maximum number of unknowns.

    Integers are converted to float64.

    Raises
    ------
    InputError
        A matrix is not square, symmetric, real or finite; sizes do not agree; there are too many unknowns.
    """

    normal: Array
    rhs: Array
    design: Array | None = None
    observed: Array | None = None
    rest: Rest = NO_REST
    limit: int = MAX_UNKNOWNS

    def __post_init__(self) -> None:
        for name, place in (("normal", "N"), ("rhs", "b"), ("design", "A"), ("observed", "l")):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, real_numbers(values, place))  # this is a frozen dataclass
        check_normal(self.normal, self.limit)
        u = len(self.normal)
        if self.rhs.shape != (u,) or not np.isfinite(self.rhs).all():
            raise InputError.of("linear.rhs", place="b", value=f"shape {self.rhs.shape}", unknowns=u)
        if self.design is not None:
            check_design(self.design, self.observed, u)

    @classmethod
    def from_design(
        cls, design: Array, observed: Array, rest: Rest = NO_REST, limit: int = MAX_UNKNOWNS
    ) -> LinearSystem:
        """Return normal equations of ``A x = l`` with unit weights.

        Unusable matrices are refused before N is formed.
        """
        design, observed = real_numbers(design, "A"), real_numbers(observed, "l")
        if design.ndim == 2 and design.shape[1] > limit:
            raise InputError.of("linear.too_large", place="N", value=design.shape[1], limit=limit)
        check_design(design, observed, design.shape[-1] if design.ndim else 0)
        with np.errstate(over="ignore", invalid="ignore"):  # squares that overflow are refused as not finite
            normal, rhs = design.T @ design, design.T @ observed
        return cls(normal, rhs, design, observed, rest, limit)

    def __len__(self) -> int:
        return len(self.rhs)

    @property
    def redundancy(self) -> int:
        """Observations minus unknowns; InputError if A is not known."""
        return len(self.require_design("redundancy")[0]) + self.rest.rows - len(self)

    def require_design(self, what: str) -> tuple[Array, Array]:
        """Return A and l; InputError if only N and b are known, with ``what`` as place."""
        if self.design is None or self.observed is None:
            raise InputError.of("linear.no_design", place=what)
        return self.design, self.observed

    @cached_property
    def decomposition(self) -> tuple[Array, Array, Array]:
        """Singular value decomposition ``A = U S V^T``: U (r, p), S (p,) descending, V^T (p, u).

        It is computed at first use and kept for all kappa rules. InputError if A is not known.
        """
        design, _ = self.require_design("singular value decomposition")
        left, values, right = np.linalg.svd(design, full_matrices=False)
        return left, values, right


def real_numbers(values: npt.ArrayLike, place: str) -> Array:
    """Convert values to an array of float64; raise InputError for complex numbers and texts."""
    given = np.asarray(values)
    if given.dtype.kind not in "fiu":
        raise InputError.of("linear.not_real", place=place, value=given.dtype)
    return np.asarray(given, dtype=np.float64)


def check_design(design: Array, observed: Array | None, unknowns: int) -> None:
    """Raise InputError if the sizes of A, l and unknowns do not agree, or A or l is not finite."""
    fits = design.ndim == 2 and design.shape[1] == unknowns and design.size > 0
    fits = fits and observed is not None and observed.shape == (len(design),)
    if not fits:
        raise InputError.of("linear.design", place="A, l", value=f"shape {design.shape}", unknowns=unknowns)
    for name, values in (("A", design), ("l", np.asarray(observed))):
        if not np.isfinite(values).all():
            at = np.argwhere(~np.isfinite(values))[0]
            place = f"{name}[{', '.join(map(str, at))}]"
            raise InputError.of("linear.design", place=place, value=values[tuple(at)], unknowns=unknowns)


def check_normal(normal: Array, limit: int) -> None:
    """Raise InputError for a matrix that is not square, finite and symmetric, that is empty or too large."""
    if normal.ndim != 2 or normal.shape[0] != normal.shape[1] or not len(normal):
        raise InputError.of("linear.not_square", place="N", value=f"shape {normal.shape}")
    if len(normal) > limit:
        raise InputError.of("linear.too_large", place="N", value=len(normal), limit=limit)
    if not np.isfinite(normal).all():
        row, column = np.argwhere(~np.isfinite(normal))[0]
        raise InputError.of("linear.not_finite", place=f"N[{row}, {column}]", value=normal[row, column])
    skew = np.abs(normal - normal.T)
    if skew.max() > SYMMETRY_TOLERANCE * np.abs(normal).max():
        row, column = np.unravel_index(int(skew.argmax()), skew.shape)
        raise InputError.of("linear.not_symmetric", place=f"N[{row}, {column}]", value=f"{skew.max():.3g}")


@dataclass(frozen=True)
class LinearSolution:
    """Solution of a linear system.

    Parameters
    ----------
    x : (u,) array
        Unknowns; nan if the solver failed.
    inverse : (u, u) array, optional
        Inverse of N, if the solver forms it.
    rank : int, optional
        Number of singular values used.
    kappa : float, optional
        Regularisation parameter of Tikhonov solvers.
    rule : str
        Rule that chose kappa (``fg_orient.adjustment.linear.kappa``); "" without a rule.
    notes : tuple of str
        Remarks: negative radicands, violated check sums, clamped parameters.
    failure : str
        Reason why the solver failed; "" otherwise.
    """

    x: Array
    inverse: Array | None = None
    rank: int | None = None
    kappa: float | None = None
    rule: str = ""
    notes: tuple[str, ...] = ()
    failure: str = ""


def column_lengths(system: LinearSystem) -> Array:
    """Return the lengths (u,) of the columns of A, or sqrt(n_ii) if A is not known; 1 for a column of zeros."""
    if system.design is not None:
        return _lengths(system.design)
    lengths = np.sqrt(np.abs(system.normal.diagonal()))
    return np.where(lengths > 0.0, lengths, 1.0)


def _lengths(design: Array) -> Array:
    largest = np.abs(design).max(axis=0, initial=0.0)
    safe = np.where(largest > 0.0, largest, 1.0)  # squares of raw polynomial columns may overflow
    lengths = safe * np.sqrt(((design / safe) ** 2).sum(axis=0))
    return np.where(lengths > 0.0, lengths, 1.0)


def unit_columns(design: Array) -> Array:
    """Return the matrix (r, u) with columns of length 1; a column of zeros is not changed."""
    return np.asarray(design / _lengths(design))


def scaled(system: LinearSystem) -> tuple[LinearSystem, Array]:
    """Return the system in unknowns z_i = d_i x_i, whose columns have length 1, and the lengths d (u,)."""
    lengths = column_lengths(system)
    if system.design is not None and system.observed is not None:
        design = system.design / lengths
        return LinearSystem.from_design(design, system.observed, system.rest, system.limit), lengths
    normal = system.normal / np.outer(lengths, lengths)
    return LinearSystem(normal, system.rhs / lengths, limit=system.limit), lengths


#: Limits of the condition numbers in the publication. A system is unstable if one of the
#: first two numbers is above its limit, or the third is below its limit.
NORM_LIMIT: Final = 1e16
SPECTRAL_LIMIT: Final = 1e3
HADAMARD_LIMIT: Final = 1e-2


def singular_values(matrix: Array) -> Array:
    """Return the singular values (u,) of a matrix (r, u), descending; u - r zeros are appended if r < u.

    These zeros are singular values of N = A^T A: without the zeros, a system with too few
    observations would look regular.
    """
    rows, u = matrix.shape
    return np.append(np.linalg.svd(matrix, compute_uv=False), np.zeros(max(u - rows, 0)))


def numerical_rank(values: Array, size: int) -> int:
    """Count the singular values above size * eps(largest). eps(x) is the spacing of doubles at x (MATLAB's rank).

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
    """Rank, determinant and condition numbers of N.

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
        The design matrix cannot be used.
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
            u,
            numerical_rank(values, u),
            numerical_rank(singular_values(columns), max(columns.shape)),
            float(sign),
            float(log_det / ten),
            _ratio(values[0], values[-1]),
            _ratio(eigenvalues[-1], eigenvalues[0]),
            float(hadamard),
        )


def _ratio(largest: float, least: float) -> float:
    """Return the quotient; inf for a divisor of zero."""
    return float(largest / least) if least else float("inf")
