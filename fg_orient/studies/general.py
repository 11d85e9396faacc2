"""What the two general adjustments share: cofactors of the observations, checks, the result.

Notation of Terlemezoğlu 2019, sections 2.6 and 2.7: ``Q_ll = W^-1``, ``Q_xx = N^-1``, ``m0`` the standard
deviation of unit weight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from fg_orient.model.declaration import declared
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.model.options import Options

Array = npt.NDArray[np.float64]

EPS = float(np.finfo(np.float64).eps)
#: A change that no longer shrinks is rounding if it is below so many times the rounding of the misclosure.
ROUNDING = 1e3


@dataclass(frozen=True)
class Adjustment:
    """Result of :func:`~fg_orient.studies.gauss_markov.gauss_markov` or ``gauss_helmert``.

    Parameters
    ----------
    x : (u,) array
        Adjusted unknowns.
    v : (n,) array
        Residuals, adjusted minus observed.
    adjusted : (n,) array
        Adjusted observations.
    weighted_squares : float
        v^T W v.
    redundancy : int
        Observations (conditions) minus the rank of the design matrix.
    cofactors_x : (u, u) array
        Q_xx; where N is singular the pseudo-inverse in columns of unit length, and ``notes`` say so.
    cofactors_v, cofactors_adjusted : (n, n) arrays
        Q_vv and ``Q_ll - Q_vv``.
    cofactors_adjusted_x : (n, u) array
        Between adjusted observations and unknowns.
    iterations : int
    converged : bool
    reason : str
        Why the iteration ended.
    notes : tuple of str
        Remarks of the solver and on rank.
    """

    x: Array
    v: Array
    adjusted: Array
    weighted_squares: float
    redundancy: int
    cofactors_x: Array
    cofactors_v: Array
    cofactors_adjusted: Array
    cofactors_adjusted_x: Array
    iterations: int
    converged: bool
    reason: str
    notes: tuple[str, ...] = ()

    @property
    def m0(self) -> float | None:
        """``sqrt(v^T W v / f)``; None without redundancy, see :attr:`m0_missing`."""
        return float(np.sqrt(self.weighted_squares / self.redundancy)) if self.redundancy else None

    @property
    def m0_missing(self) -> str:
        """Why there is no m0; "" if there is one."""
        return "" if self.redundancy else "no redundancy: residuals are zero whatever the observations are"

    @property
    def correlations(self) -> Array:
        """Correlations (u, u) of the unknowns, ``q_ij / sqrt(q_ii q_jj)``; nan where a variance is 0."""
        sigma = np.sqrt(np.diag(self.cofactors_x))
        return _correlations(self.cofactors_x, sigma, sigma)

    @property
    def correlations_adjusted_x(self) -> Array:
        """Correlations (n, u) of adjusted observations with unknowns; nan where a variance is 0."""
        sigma_l = np.sqrt(np.maximum(np.diag(self.cofactors_adjusted), 0.0))
        return _correlations(self.cofactors_adjusted_x, sigma_l, np.sqrt(np.diag(self.cofactors_x)))


def _correlations(cofactors: Array, rows: Array, columns: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(cofactors / np.outer(rows, columns))


def cofactor_matrix(n: int, weights: Array | None, cofactors: Array | None) -> Array:
    """Q_ll (n, n) from weights or cofactors, each (n,) or (n, n); unit weights if neither is given.

    Raises
    ------
    InputError
        Both given, wrong shape, not finite, not symmetric; weights not positive definite, cofactors
        with a negative eigenvalue.
    """
    if weights is not None and cofactors is not None:
        raise InputError.of("classical.weights_twice", place="weights, cofactors")
    name = "weights" if weights is not None else "cofactors"
    given = next((np.asarray(a, dtype=np.float64) for a in (weights, cofactors) if a is not None), np.ones(n))
    if given.shape not in ((n,), (n, n)) or not np.isfinite(given).all():
        raise InputError.of("classical.weights", place=name, value=f"shape {given.shape}", count=n)
    if given.ndim == 1:
        least = np.finfo(np.float64).tiny if weights is not None else 0.0  # 1/W of a smaller weight overflows
        if (given < least).any():
            raise InputError.of("classical.not_definite", place=name, value=float(given.min()))
        return np.diag(1.0 / given if weights is not None else given)
    scale = np.abs(given).max()
    if np.abs(given - given.T).max() > 1e-12 * scale:
        raise InputError.of("classical.not_definite", place=name, value="not symmetric")
    if weights is not None:
        return np.asarray(cho_solve(_factor(given, name), np.eye(n)))
    lowest = float(np.linalg.eigvalsh(given)[0])
    if lowest < -n * EPS * scale:
        raise InputError.of("classical.not_definite", place=name, value=f"eigenvalue {lowest:.3g}")
    return given


def _factor(matrix: Array, name: str) -> tuple[Array, bool]:
    try:
        lower, is_lower = cho_factor(matrix, lower=True)
    except np.linalg.LinAlgError:
        raise InputError.of("classical.not_definite", place=name, value="no Cholesky factor") from None
    return lower, bool(is_lower)


def as_vector(values: Array, name: str) -> Array:
    """A finite vector (copied), or an error that names it.

    Raises
    ------
    InputError
        Not one-dimensional, or not finite.
    """
    vector: Array = np.array(values, dtype=np.float64)
    if vector.ndim != 1 or not np.isfinite(vector).all():
        raise InputError.of("classical.vector", place=name, value=f"shape {vector.shape}")
    return vector


def called(
    function: Callable[..., tuple[Array, ...]], arguments: tuple[Array, ...], wanted: tuple[int, ...]
) -> list[Array]:
    """Value and Jacobians of the user's function, checked.

    ``wanted`` are the lengths (n or -1 = any for the value), then the widths of the Jacobians.

    Raises
    ------
    InputError
        Arrays of wrong number or shape.
    NoSolutionError
        A value is not finite.
    """
    found = [np.asarray(a, dtype=np.float64) for a in function(*(a.copy() for a in arguments))]
    rows = found[0].size if wanted[0] < 0 else wanted[0]
    shapes = [(rows,), *((rows, width) for width in wanted[1:])]
    if [a.shape for a in found] != shapes:
        seen = ", ".join(str(a.shape) for a in found)
        raise InputError.of("classical.function", place="function", value=seen, expected=", ".join(map(str, shapes)))
    if not all(np.isfinite(a).all() for a in found):
        raise NoSolutionError.of("classical.function_not_finite", place="function")
    return found


@dataclass(frozen=True)
class Spectrum:
    """Whitened design ``A' = U S V^T D`` with columns scaled by D: rank, cofactors of x, and U of the rank."""

    rank: int
    cofactors: Array
    left: Array
    notes: tuple[str, ...]

    @classmethod
    def of(cls, design: Array) -> Spectrum:
        """Decompose a whitened design matrix (r, u); u may be 0."""
        rows, u = design.shape
        if not u:
            return cls(0, np.zeros((0, 0)), np.zeros((rows, 0)), ())
        length = np.linalg.norm(design, axis=0)
        scale = np.where(length > 0.0, length, 1.0)
        left, values, right = np.linalg.svd(design / scale, full_matrices=False)
        rank = int((values > max(rows, u) * EPS * values[0]).sum()) if values[0] > 0.0 else 0
        half = (right[:rank].T / values[:rank]) / scale[:, None]
        note = f"the normal matrix has rank {rank} of {u}: cofactors by pseudo-inverse of the column-scaled design"
        return cls(rank, half @ half.T, left[:, :rank], () if rank == u else (note,))


def judge(change: float, previous: float, size: float, rounding: float, tolerance: float) -> bool:
    """Judge convergence: the change is below ``tolerance`` of the residuals' norm, or is rounding.

    All in whitened units, so that neither the unit of the observations nor that of the unknowns matters.
    ``rounding`` is that of the misclosure.
    """
    if change <= tolerance * size + 8.0 * rounding:
        return True
    return change > 0.5 * previous and change <= 1e2 * tolerance * size + ROUNDING * rounding


@dataclass(frozen=True)
class End:
    """How an iteration ended: count, success, largest whitened change of the last step, remarks of the solver."""

    iterations: int
    converged: bool
    change: float
    notes: tuple[str, ...]

    @property
    def reason(self) -> str:
        """The end in words."""
        if self.converged:
            return "the step is below the tolerance"
        return f"no convergence within {self.iterations} iterations: the last whitened step is {self.change:.1e}"


def require_iterations(count: int) -> None:
    """Refuse a number of iterations that is none.

    Raises
    ------
    InputError
        It is outside the range that options of adjustments have.
    """
    option = declared(Options)["max_iterations"]
    if not option.allows(count):
        raise InputError.of("options.value", place=option.name, value=count, expected=option.expected)
