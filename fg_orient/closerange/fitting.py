"""Adjust small problems with the loop of the bundle adjustment; compute foot points on quadrics.

Unknowns should have a size of about 1, because the loop compares the largest element of a step with its limit.

A condition ``l^T S l + 2 u^T l + c = 0`` between the observations of one point (a surface
in space, the coplanarity of two rays) with ``v^T Q^-1 v`` minimal has v in closed form
except for one number t. Along the eigenvectors of the whitened S, v_i = -t w_i/(1 + t
d_i), and the condition is a decreasing function of t. So the foot point is exact and is
the nearest one, whereas iterated linearisation (Pope) may converge to the far side.
:func:`compare_points` compares adjusted points with a reference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.adjustment.dense import DenseRows, RowsBackend
from fg_orient.adjustment.dense import equation_rows as equation_rows
from fg_orient.adjustment.loop import OPTIMIZERS, IterationRecord
from fg_orient.model.arrays import array, require_positions, wrong
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.model.names import LARGEST, SMALLEST

Rows = DenseRows

MAX_ITERATIONS: Final = 100
#: There is a covariance only if the ratio of the smallest to the largest singular value
#: (columns of unit length) is above this.
RANK_LIMIT: Final = 1e-12
#: The points do not determine a parameter if its standard deviation exceeds this multiple of
#: a point's standard deviation.
UNDETERMINED: Final = 1e3
_STEPS: Final = 200
#: A remainder of a condition below this, relative to its largest term, is a rounding error.
_ROUNDING: Final = 1e-15


@dataclass(frozen=True)
class Minimum:
    """Result of :func:`adjust`: state (u,), whitened residuals (n,), their derivatives (n, u) and log."""

    state: Array
    residual: Array
    design: Array
    log: tuple[IterationRecord, ...]

    @property
    def squares(self) -> float:
        """Weighted sum of squares."""
        return float(self.residual @ self.residual)


def unit_weight(weighted_squares: float, redundancy: int) -> float | None:
    """Return the standard deviation of unit weight; None without redundancy."""
    return float(np.sqrt(weighted_squares / redundancy)) if redundancy > 0 else None


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Statistics of a fit; derived classes add the fitted object and state the parameters.

    Parameters
    ----------
    cofactors : (u, u) array
        Cofactors of the parameters, for the given sigmas; times m0 squared they are the covariance.
    m0 : float or None
        Standard deviation of unit weight; None without redundancy.
    redundancy : int
    condition : float
        Condition number of the design with columns of unit length.
    iterations : int
    redundancy_numbers : (n,) array
        Redundancy number of each residual, in the order of the residuals.
    """

    cofactors: Array
    m0: float | None
    redundancy: int
    condition: float
    iterations: int
    redundancy_numbers: Array

    @property
    def sigma(self) -> Array | None:
        """Standard deviations (u,) in the order and units of the cofactors; None without redundancy."""
        return None if self.m0 is None else np.asarray(self.m0 * np.sqrt(np.diag(self.cofactors)))


def statistics(whitened: Array, assessed: Determination, iterations: int, away: Array) -> dict[str, Any]:
    """Return keyword arguments of a :class:`Fit` from whitened residuals."""
    assert assessed.cofactors is not None
    redundancy = whitened.size - len(assessed.cofactors)
    return {
        "cofactors": away @ assessed.cofactors @ away.T,
        "m0": unit_weight(float(whitened @ whitened), redundancy),
        "redundancy": redundancy,
        "condition": assessed.condition,
        "iterations": iterations,
        "redundancy_numbers": 1.0 - assessed.leverage[: len(whitened)],
    }


def finite_rows(rows: Rows, what: str = "") -> Rows:
    """Return rows that raise NoSolutionError with the name ``what`` if a derivative is not finite.

    For example, the centre of a sphere has no nearest point on it.
    """

    def checked(state: Array, with_jacobian: bool) -> tuple[Array, Array]:
        residual, design = rows(state, with_jacobian)
        if with_jacobian and not (np.isfinite(residual).all() and np.isfinite(design).all()):
            raise NoSolutionError.of("closerange.not_converged", place=what, reason="an equation has no finite value")
        return residual, design

    return checked


def adjust(rows: Rows, start: Array, what: str, *, moved: Callable[[Array, Array], Array] = np.add) -> Minimum:
    """Minimise the squares of some rows from a start (u,), by Levenberg-Marquardt.

    Parameters
    ----------
    rows : callable
        Function that returns whitened residuals (n,) and their derivatives (n, u) at a state.
    start : (u,) array
    what : str
        Name of the fit, for the error.
    moved : callable
        Function that returns the state after a step, from state and step.

    Raises
    ------
    NoSolutionError
        The iteration does not converge, or an equation has no finite value.
    """
    checked = finite_rows(rows, what)
    run = OPTIMIZERS["levenberg-marquardt"](RowsBackend(checked, moved), start, MAX_ITERATIONS)
    if not run.converged:
        raise NoSolutionError.of("closerange.not_converged", place=what, reason=run.end.message)
    return Minimum(run.state, *checked(run.state, True), run.log)


@dataclass(frozen=True)
class Determination:
    """Result of :func:`determination`: how well rows determine their unknowns.

    ``condition``: condition number of the design with columns of unit length, inf if
    singular; ``cofactors`` (u, u): None if the unknowns are not determined; ``weakest``
    (u,): change of the unknowns with the smallest effect on the rows, of unit length in
    scaled unknowns; ``leverage`` (n,): share of each row's variance that the unknowns take.
    """

    condition: float
    cofactors: Array | None
    weakest: Array
    leverage: Array


def determination(design: Array, sigma: Array | None = None) -> Determination:
    """Assess unknowns from the singular values of a design with columns of unit length; also return cofactors.

    ``sigma``: standard deviations of points; unknowns with standard deviations above
    ``UNDETERMINED`` times their root mean square are not determined.
    """
    length = np.linalg.norm(design, axis=0)
    # a column of rounding noise must not be scaled to unit length
    length = np.where(length > RANK_LIMIT * length.max(), length, np.inf)
    none = np.isinf(length)
    left, values, right = np.linalg.svd(design / length, full_matrices=len(design) < design.shape[1])
    values = np.concatenate([values, np.zeros(design.shape[1] - len(values))])
    length = np.where(none, 1.0, length)
    weakest = np.asarray(right[-1] / length)
    leverage = np.asarray(np.sum(left[:, : len(right)] ** 2, axis=1))
    if values[-1] <= RANK_LIMIT * values[0]:
        return Determination(float("inf"), None, weakest, leverage)
    root = right.T / values / length[:, None]
    condition, cofactors = float(values[0] / values[-1]), np.asarray(root @ root.T)
    if sigma is not None and np.sqrt(np.diag(cofactors).max()) > UNDETERMINED * float(np.sqrt(np.mean(sigma**2))):
        return Determination(condition, None, weakest, leverage)
    return Determination(condition, cofactors, weakest, leverage)


def determined(design: Array, sigma: Array, code: str, place: str) -> Determination:
    """Determine all unknowns; ``sigma`` as in :func:`determination`.

    Raises
    ------
    InputError
        Error with this code: the rows do not determine all unknowns.
    """
    assessed = determination(design, sigma)
    if assessed.cofactors is None:
        raise InputError.of(code, place=place, value=f"condition {assessed.condition:.2g}")
    return assessed


def plain_rms(values: Array) -> list[float | None]:
    """Return the root mean square of each column; None without rows."""
    return list[float | None](np.sqrt(np.mean(values**2, axis=0)).tolist()) if len(values) else [None] * values.shape[1]


def as_points(values: npt.ArrayLike, width: int, place: str) -> Array:
    """Return finite numbers (n, width) up to ``LARGEST`` in size.

    Raise InputError for other values.
    """
    out = np.atleast_2d(array(values, place))
    if out.ndim != 2 or out.shape[1] != width or not len(out):
        raise InputError.of("closerange.points", place=place, value=f"shape {out.shape}", width=width)
    for bad, code, more in (
        (~np.isfinite(out), "closerange.points", {"width": width}),
        (np.abs(out) > LARGEST, "closerange.range", {"limit": LARGEST}),
    ):
        if bad.any():
            k = int(bad.any(axis=1).argmax())
            raise InputError.of(code, place=f"{place}, row {k}", value=float(out[k][bad[k]][0]), **more)
    return out


def as_positions(values: npt.ArrayLike, place: str, like: Array, count: int | None = None) -> Index:
    """Return positions of photos or points, one for each row of ``like`` (n, k), below ``count`` if it is given."""
    out = array(values, place, (len(like),), np.intp)
    require_positions(out, place, f"{place}s", count)
    return out


def as_sigmas(values: npt.ArrayLike, like: Array, place: str = "sigma") -> Array:
    """Return standard deviations of each element of ``like`` (n, k), from an array that fits it.

    Others are refused.
    """
    given = array(values, place)
    try:
        out = np.broadcast_to(given, like.shape)
    except ValueError:
        raise wrong(place, f"shape {given.shape}", f"one number, or an array that fits {like.shape}") from None
    require_sigmas(out, place)
    return out


def require_sigmas(sigma: npt.ArrayLike, place: str = "sigma") -> None:
    """Refuse standard deviations that are not finite, not above zero, or of an impossible size."""
    values = np.asarray(sigma, float)
    possible = np.isfinite(values) & (values > 0.0)
    if not possible.all():
        raise InputError.of("closerange.sigma", place=place, value=float(values[~possible][0]))
    within = (values >= SMALLEST) & (values <= LARGEST)
    if not within.all():
        raise InputError.of(
            "closerange.sigma_range", place=place, value=float(values[~within][0]), least=SMALLEST, limit=LARGEST
        )


# --- conditions of the second degree ---------------------------------------------------------------


@dataclass(frozen=True)
class Conditions:
    """Conditions of the second degree, one per point.

    Parameters
    ----------
    square : (d, d) or (n, d, d) array
        S, symmetric.
    linear : (d,) or (n, d) array
        u.
    constant : float or (n,) array
        c.
    """

    square: Array
    linear: Array
    constant: Array | float

    def value(self, points: Array) -> Array:
        """Return the condition (n,) at points (n, d)."""
        return np.asarray(np.einsum("ni,ni->n", points, self._half_slope(points) + self.linear) + self.constant)

    def slope(self, points: Array) -> Array:
        """Return the derivatives (n, d) of the condition."""
        return np.asarray(2.0 * self._half_slope(points))

    def central(self, least: float = 1e-9) -> tuple[Array, Array, Array] | None:
        """Return the centre (d,), squared semi-axes (d,), negative for imaginary ones, and their directions as columns.

        The result is None if there is no centre: a curvature is below ``least`` times the largest. The
        method is valid for a single condition only.
        """
        curvatures, axes = np.linalg.eigh(self.square)
        if np.abs(curvatures).min() <= least * np.abs(curvatures).max():
            return None
        centre = -np.linalg.solve(self.square, self.linear)
        squares = np.asarray(-(self.constant + self.linear @ centre) / curvatures, float)
        return np.asarray(centre, float), squares, np.asarray(axes, float)

    def _half_slope(self, points: Array) -> Array:
        return np.asarray(np.einsum("...ij,...j->...i", self.square, points) + self.linear)


def foot_points(conditions: Conditions, points: Array, sigma: Array) -> Array:
    """Return the points that fulfil the conditions and are nearest to given points in units of their sigmas.

    Parameters
    ----------
    conditions : Conditions
    points, sigma : (n, d) arrays

    Returns
    -------
    (n, d) array
        Foot points; nan without a unique nearest point (the centre of a sphere), or if
        the surface has no point.
    """
    square = sigma[:, :, None] * np.broadcast_to(conditions.square, (len(points), *conditions.square.shape[-2:]))
    square = square * sigma[:, None, :]
    d, axes = np.linalg.eigh(square)
    w = np.einsum("nij,ni->nj", axes, 0.5 * sigma * conditions.slope(points))
    c = conditions.value(points)
    t = _multiplier(d, w, c)
    with np.errstate(all="ignore"):
        v = -t[:, None] * w / (1.0 + t[:, None] * d)
    return np.asarray(points + sigma * np.einsum("nij,nj->ni", axes, v))


def weighted_distances(conditions: Conditions, points: Array, sigma: Array) -> tuple[Array, Array]:
    """Return the distances of points from the conditions in sigmas.

    Parameters
    ----------
    conditions : Conditions
    points, sigma : (n, d) arrays

    Returns
    -------
    distances : (n,) array
        Distances; positive where the condition is positive.
    foot_points : (n, d) array
    """
    foot = foot_points(conditions, points, sigma)
    side = np.sign(conditions.value(points))
    return np.asarray(side * np.linalg.norm((points - foot) / sigma, axis=1)), foot


def distance_rows(by_unknown: Array, slope: Array, sigma: Array) -> Array:
    """Compute derivatives (n, u) of weighted distances from derivatives and slopes of the conditions at foot points."""
    return np.asarray(by_unknown / np.linalg.norm(slope * sigma, axis=1)[:, None])


def _multiplier(d: Array, w: Array, c: Array) -> Array:
    """Find the root t (n,) of c - sum w^2 t (2 + t d)/(1 + t d)^2 between the poles -1/d, by bracketed Newton steps."""
    with np.errstate(all="ignore"):
        poles = np.where(np.abs(w) > 0.0, -1.0 / d, np.nan)
        low = np.fmax.reduce(np.where(poles < 0.0, poles, -np.inf), axis=1)
        high = np.fmin.reduce(np.where(poles > 0.0, poles, np.inf), axis=1)
        low, high = np.where(c > 0.0, 0.0, low), np.where(c > 0.0, high, 0.0)
        t, scale, square = np.zeros(len(c)), np.abs(c), w**2
        for _ in range(_STEPS):
            run = t[:, None] * d
            below = 1.0 + run
            terms = square * t[:, None] * (2.0 + run) / below**2
            left = c - terms.sum(axis=1)
            done = np.abs(left) <= _ROUNDING * (scale + np.abs(terms).sum(axis=1))
            if done.all():
                break
            low, high = np.where(left > 0.0, t, low), np.where(left > 0.0, high, t)
            newton = t + left / (2.0 * (square / below**3).sum(axis=1))
            inside = (newton > low) & (newton < high)
            middle = np.where(np.isfinite(low) & np.isfinite(high), 0.5 * (low + high), 2.0 * t + np.sign(c))
            t = np.where(done, t, np.where(inside, newton, middle))
    left_over = np.abs(left) <= 1e-9 * (scale + np.abs(terms).sum(axis=1))
    return np.asarray(np.where(left_over, t, np.nan))


@dataclass(frozen=True)
class Measures:
    """Differences of some points from their reference.

    Parameters
    ----------
    n : int
    sums_cm2 : (4,) list
        [Fxx], [Fyy], [Fzz] and their sum [Fpp], cm^2 (Ayhan 1996, eqs. 187-188).
    rms_mm : (4,) list
        sqrt([F]/n), mm; None without points.
    worst_mm : (3,) list
        Largest difference per axis; None without points.
    """

    n: int
    sums_cm2: list[float]
    rms_mm: list[float | None]
    worst_mm: list[float | None]


@dataclass(frozen=True)
class Comparison:
    """Differences of all points, of control points, and of the other points.

    Only the other points measure the accuracy of a method, because the method uses the control points.
    """

    every: Measures
    control: Measures
    other: Measures


def compare_points(reference_m: npt.ArrayLike, points_m: npt.ArrayLike, control: npt.ArrayLike) -> Comparison:
    """Compare points with their reference, ``F = reference - points``.

    Parameters
    ----------
    reference_m, points_m : (n, 3) arrays
    control : (n,) bool array
        Points used by the compared method.

    Raises
    ------
    InputError
        An array has another shape.
    """
    reference = as_points(reference_m, 3, "reference")
    difference = reference - as_points(points_m, 3, "points")
    used = np.asarray(control, bool)
    return Comparison(*(_measures(difference[rows]) for rows in (used | True, used, ~used)))


def _measures(difference: Array) -> Measures:
    axes, n = (1e4 * np.sum(difference**2, axis=0)).tolist(), len(difference)
    radial = float(np.sqrt(100.0 * sum(axes) / n)) if n else None
    worst = np.abs(1e3 * difference).max(axis=0).tolist() if n else [None] * 3
    return Measures(n, [*axes, sum(axes)], [*plain_rms(1e3 * difference), radial], worst)
