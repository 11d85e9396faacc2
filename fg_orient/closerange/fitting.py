"""The adjustment of a small problem: rows of any kind, driven by the loop of the bundle adjustment.

Unknowns should be of size 1: the loop judges a step by its largest element.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.dense import DenseRows, RowsBackend
from fg_orient.adjustment.dense import equation_rows as equation_rows
from fg_orient.adjustment.loop import OPTIMIZERS, IterationRecord
from fg_orient.formats.closerange import LARGEST, SMALLEST
from fg_orient.model.errors import InputError, NoSolutionError

Array = npt.NDArray[np.float64]
Rows = DenseRows

MAX_ITERATIONS: Final = 100
#: Smallest by largest singular value of a design with columns of unit length, below which there is no covariance.
RANK_LIMIT: Final = 1e-12
#: Standard deviation by that of a point, beyond which a parameter is not determined by the points.
UNDETERMINED: Final = 1e3


@dataclass(frozen=True)
class Adjusted:
    """A minimum found.

    Parameters
    ----------
    state : (u,) array
    residual : (n,) array
        Whitened.
    design : (n, u) array
        Its derivatives.
    log : tuple of IterationRecord
    """

    state: Array
    residual: Array
    design: Array
    log: tuple[IterationRecord, ...]

    @property
    def redundancy(self) -> int:
        """Rows minus unknowns."""
        return int(len(self.residual) - self.design.shape[1])

    @property
    def m0(self) -> float | None:
        """Standard deviation of unit weight; None without redundancy."""
        return unit_weight(float(self.residual @ self.residual), self.redundancy)


def unit_weight(weighted_squares: float, redundancy: int) -> float | None:
    """Standard deviation of unit weight; None without redundancy: it then follows from nothing."""
    return float(np.sqrt(weighted_squares / redundancy)) if redundancy > 0 else None


class Deviations:
    """Standard deviations a posteriori of what was adjusted.

    Attributes
    ----------
    cofactors : (u, u) array
        Times m0 squared their covariance.
    m0 : float or None
        None without redundancy.
    """

    cofactors: Array
    m0: float | None

    @property
    def sigma(self) -> Array | None:
        """Standard deviations (u,) in the order and units of the cofactors; None without redundancy."""
        return None if self.m0 is None else np.asarray(self.m0 * np.sqrt(np.diag(self.cofactors)))


def finite_rows(rows: Rows, what: str = "") -> Rows:
    """The same rows, which refuse derivatives that are not finite: the centre of a sphere has no nearest point on it.

    They raise NoSolutionError, which names ``what``.
    """

    def checked(state: Array, want: bool) -> tuple[Array, Array]:
        residual, design = rows(state, want)
        if want and not (np.isfinite(residual).all() and np.isfinite(design).all()):
            raise NoSolutionError.of("closerange.not_converged", place=what, reason="an equation has no finite value")
        return residual, design

    return checked


def adjust(rows: Rows, start: Array, what: str, *, moved: Callable[[Array, Array], Array] | None = None) -> Adjusted:
    """Find the minimum of the squares of some rows by Levenberg-Marquardt.

    Parameters
    ----------
    rows : callable
        See ``fg_orient.adjustment.dense.DenseRows``.
    start : (u,) array
    what : str
        Named in the error.
    moved : callable, optional
        State after a step; default their sum.

    Raises
    ------
    NoSolutionError
        The iteration does not converge, or an equation has no finite value.
    """
    checked = finite_rows(rows, what)
    found = OPTIMIZERS["levenberg-marquardt"](RowsBackend(checked, moved or np.add), start, MAX_ITERATIONS)
    if not found.converged:
        raise NoSolutionError.of("closerange.not_converged", place=what, reason=found.end.message)
    return Adjusted(found.state, *checked(found.state, True), found.log)


@dataclass(frozen=True)
class Determination:
    """How well rows determine their unknowns.

    Parameters
    ----------
    condition : float
        Largest by smallest singular value of the design, its columns of unit length; inf if singular.
    cofactors : (u, u) array or None
        None if the design is singular.
    weakest : (u,) array
        Change of the unknowns that the rows see least, of unit length in scaled unknowns.
    """

    condition: float
    cofactors: Array | None
    weakest: Array


def determination(design: Array) -> Determination:
    """Singular values of a design whose columns have unit length, and the cofactors from them."""
    length = np.linalg.norm(design, axis=0)
    # a column of rounding noise must not become one of unit length
    length = np.where(length > RANK_LIMIT * length.max(), length, np.inf)
    none = np.isinf(length)
    _, values, right = np.linalg.svd(design / length, full_matrices=len(design) < design.shape[1])
    values = np.concatenate([values, np.zeros(design.shape[1] - len(values))])
    length = np.where(none, 1.0, length)
    weakest = np.asarray(right[-1] / length)
    if values[-1] <= RANK_LIMIT * values[0]:
        return Determination(float("inf"), None, weakest)
    root = right.T / values / length[:, None]
    return Determination(float(values[0] / values[-1]), np.asarray(root @ root.T), weakest)


def plain_rms(values: Array) -> list[float | None]:
    """Root mean square of each column; None without rows."""
    return list[float | None](np.sqrt(np.mean(values**2, axis=0)).tolist()) if len(values) else [None] * values.shape[1]


def as_points(values: npt.ArrayLike, width: int, place: str, error: Callable[..., Any]) -> Array:
    """Finite numbers (n, width), at most ``LARGEST`` in size.

    Raises
    ------
    FgOrientError
        What ``error`` builds, if they are not.
    """
    out = np.atleast_2d(np.ascontiguousarray(values, dtype=float))
    if out.ndim != 2 or out.shape[1] != width or not len(out) or not np.isfinite(out).all():
        raise error("closerange.points", place=place, value=f"shape {out.shape}", width=width)
    if np.abs(out).max() > LARGEST:
        raise error("closerange.range", place=place, value=float(out.flat[np.abs(out).argmax()]), limit=LARGEST)
    return out


def require_sigmas(sigma: npt.ArrayLike, place: str = "sigma") -> None:
    """Refuse standard deviations that are not finite and above zero, or of a size that nothing here has.

    Raises
    ------
    InputError
        Names the first one.
    """
    values = np.asarray(sigma, float)
    possible = np.isfinite(values) & (values > 0.0)
    if not possible.all():
        raise InputError.of("closerange.sigma", place=place, value=float(values[~possible][0]))
    within = (values >= SMALLEST) & (values <= LARGEST)
    if not within.all():
        raise InputError.of("closerange.sigma_range", place=place, value=float(values[~within][0]), least=SMALLEST,
                            limit=LARGEST)  # fmt: skip
