"""Test a minimum of weighted squares: other minima, curvature of the unknowns, profiles along one unknown.

Cofactors describe only the linear approximation at a minimum. They do not show three properties:

- other minima of nearly the same height. An F test of equal redundancies compares them.
- curvature. If two unknowns are strongly correlated and badly determined (centre and rotations of a far camera), the
  states that fit form a curved band. Each standard deviation is correct, but the error of
  one unknown also moves a well-determined combination of unknowns, by its square. This is
  the parameter-effects curvature of Bates and Watts (1980), here as the displacement at
  one standard deviation.
- profiles. Noise can make a narrow minimum near a long valley of nearly the same height. The profile shows how much the
  weighted squares grow if one unknown is held fixed at a very different value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.dense import RowsBackend
from fg_orient.adjustment.loop import OPTIMIZERS
from fg_orient.closerange.fitting import MAX_ITERATIONS, UNDETERMINED, Rows, finite_rows
from fg_orient.model.distributions import chi_square_limit, f_quantile
from fg_orient.model.errors import Finding, NoSolutionError, finding

#: Level of the test that distinguishes two minima.
RIVAL_LEVEL: Final = 0.05
#: Two minima are equal if their directions differ by less than this, rad, and their
#: centres by less than this share of the object's distance.
SAME: Final = 1e-5
#: Limit of the curvature (see above). At this limit, an error of two standard deviations in one
#: unknown moves a well-determined combination of unknowns by one standard deviation. One error in 20 is
#: larger than two standard deviations.
BENT: Final = 0.25
#: Error probability of an interval. The decision does not depend on it if the squares grow as a parabola.
LEVEL: Final = 1e-3
#: The decision stays the same if the sigmas of the points are too small by up to this factor,
#: because a real surface is not exactly a spheroid. If m0 is larger than the factor, m0 is used
#: instead. With a redundancy of one or two, m0 alone is too uncertain. If points do not determine a
#: semi-axis, noise of f sigmas reduces the squares by at most f^2 times a chi-square of one.
OPTIMISTIC: Final = 5.0
#: The fit is repeated at these fractions of the distance.
_WAY: Final = (1 / 64, 1 / 8, 1.0)
#: If the start has no derivatives, the normalised unknowns are changed by this.
ASIDE: Final = 1e-5
#: Maximum number of iterations of one fit far from the solution. The fit is repeated at most
#: ``_ROUNDS`` times while its squares still decrease towards the limit.
_ROUND: Final = 50
_ROUNDS: Final = 8


@dataclass(frozen=True)
class Rival:
    """Second orientation that fits the points as well as the result does.

    Parameters
    ----------
    rotation : (3, 3) array
    place : (3,) array
        Projection centre, m, or the direction of the base of a relative orientation.
    ratio : float
        Weighted squares divided by the weighted squares of the result.
    limit : float
        Ratio at which the test distinguishes them (:func:`rival_of`).
    """

    rotation: Array
    place: Array
    ratio: float
    limit: float

    def warning(self, code: str, name: str, place: str = "") -> Finding:
        """Return the warning of this orientation; ``name`` is the name of its place in the message."""
        return finding(code, place=place, ratio=self.ratio, limit=self.limit, **{name: self.place.tolist()})


def ratio_limit(redundancy: int) -> float:
    """Return the ratio of weighted squares at which an F test of equal redundancies distinguishes two minima."""
    return float(f_quantile(redundancy, redundancy, 1.0 - RIVAL_LEVEL))


def rival_of(
    own: float, other: float, redundancy: int, rotation: Array, place: Array, *, known: bool = False
) -> Rival | None:
    """Return another minimum if the test does not distinguish it from the result.

    Parameters
    ----------
    own, other : float
        Weighted squares of the result and of the other minimum.
    redundancy : int
    rotation, place : arrays
        See :class:`Rival`.
    known : bool
        True if sigmas are given. The difference of the squares must then also exceed
        chi-square of one (a ratio of likelihoods): two minima that both fit far better
        than the sigmas are both possible.
    """
    limit = ratio_limit(redundancy)
    if known and own > 0.0:
        limit = max(limit, 1.0 + float(chi_square_limit(1.0, RIVAL_LEVEL)) / own)
    return None if other > limit * own else Rival(rotation, place, other / own if own > 0.0 else 1.0, limit)


def bend(rows: Rows, state: Array, m0: float | None) -> float:
    """Return how far errors of one standard deviation in some unknowns displace a combination of others, in its sigmas.

    The squares of the errors, weighted by the covariance, exceed the number of unknowns
    by about ``3 bend**2``, the mean square of second-derivative terms within the tangent.
    Above ``BENT`` each single standard deviation is correct, but the covariance as a
    whole is optimistic.

    Parameters
    ----------
    rows : callable
        Whitened residuals and their derivatives.
    state : (u,) array
        Minimum; its unknowns must be determined.
    m0 : float or None
        Factor of the given sigmas; None or 0: 1.

    Returns
    -------
    float
        Bend. An error e in only one combination of unknowns moves others by ``bend e**2``.
    """
    residual, design = rows(state, True)
    length = np.linalg.norm(design, axis=0)
    left, values, right = np.linalg.svd(design / length, full_matrices=False)
    unit, u = m0 or 1.0, len(state)
    steps = unit * (right.T / values / length[:, None]).T  # each row is a step of one standard deviation

    def moved(step: Array) -> Array:
        return np.asarray(left.T @ (rows(state + step, False)[0] - residual))

    ahead, back = ([moved(sign * step) for step in steps] for sign in (1.0, -1.0))
    second = np.zeros((u, u, u))
    for i in range(u):
        second[:, i, i] = ahead[i] + back[i]
        for j in range(i):
            second[:, i, j] = second[:, j, i] = moved(steps[i] + steps[j]) - ahead[i] - ahead[j]
    half = second / (2.0 * unit)
    # mean of (e^T A e)^2 for e of unit variance: 2 tr(A^2) + tr(A)^2
    square = 2.0 * float(np.sum(half**2)) + float(np.sum(np.einsum("kii->k", half) ** 2))
    return float(np.sqrt(square / 3.0))


def reach(sigma: float, squares: float, redundancy: int, *, known: bool) -> tuple[float, float] | None:
    """Return a distance at which to hold an unknown, and the growth of the weighted squares there if it is determined.

    Parameters
    ----------
    sigma : float
        Standard deviation of a point, in the unit of the unknown.
    squares : float
        Least weighted squares.
    redundancy : int
    known : bool
        True if sigmas are given. Otherwise m0 replaces them, and the limit is a quantile of F.

    Returns
    -------
    tuple of float or None
        None if the size of the noise is unknown. If squares grow as a parabola, an
        unknown with a standard deviation of ``UNDETERMINED`` sigmas has exactly this
        growth at this distance.
    """
    own = squares / redundancy if redundancy > 0 else 1.0
    if known:
        scale, limit = max(OPTIMISTIC**2, own), float(chi_square_limit(1.0, LEVEL))
    elif redundancy > 0:
        scale, limit = own, float(f_quantile(1, redundancy, 1.0 - LEVEL))
    else:
        return None
    return UNDETERMINED * sigma * float(np.sqrt(scale * limit)), scale * limit


class Held(NamedTuple):
    """Fit with one unknown held fixed: state (u,) and least weighted squares.

    If not converged, the squares are below the limit, or too far above to reach it at their rate of decrease.
    """

    state: Array
    squares: float
    converged: bool


def held(rows: Rows, state: Array, k: int, value: float, limit: float = np.inf) -> Held | None:
    """Return the state with the least weighted squares while one unknown is held fixed.

    Far from the shape of the points, the iteration may need hundreds of steps, with
    squares that are thousands of times the limit. Therefore convergence is not required
    if the squares fall below the ``limit`` or remain far above it. Without a limit, the
    iteration must converge.

    Parameters
    ----------
    rows : callable
        Whitened residuals and their derivatives.
    state : (u,) array
        Start.
    k : int
        Number of the unknown that is held fixed.
    value : float
        Its value.
    limit : float
        Limit of the weighted squares.

    Returns
    -------
    Held or None
        Fit; None if it neither converged nor is below the limit nor clearly above it.
    """
    free = np.arange(len(state)) != k

    def full(part: Array) -> Array:
        return np.insert(part, k, value)

    def some(part: Array, with_jacobian: bool) -> tuple[Array, Array]:
        residual, design = rows(full(part), with_jacobian)
        return residual, design[:, free]

    start, far = state[free], np.isfinite(limit)
    if not np.isfinite(some(start, True)[1]).all():
        # the nearest point is not unique, as on the axis of a long spheroid; the squares decrease to both sides
        start = start + ASIDE * np.cos(np.arange(len(start)))  # a different step for each unknown
    backend = RowsBackend(finite_rows(some))
    for _ in range(_ROUNDS if far else 1):
        try:
            run = OPTIMIZERS["levenberg-marquardt"](backend, start, _ROUND if far else MAX_ITERATIONS)
        except NoSolutionError:
            return None
        squares, start = 2.0 * run.error, run.state
        if run.converged and np.isfinite(squares):
            return Held(full(start), squares, True)
        above = squares - limit > run.log[len(run.log) // 2].chi2 - squares
        if far and (squares < limit or above):
            return Held(full(start), squares, False)
    return None


def followed(rows: Rows, state: Array, k: int, to: float, limit: float) -> tuple[Array, float] | None:
    """Fit with an unknown held at ``to``, far from a state; each step starts on the line through the last two.

    Parameters
    ----------
    rows, state, k, limit
        See :func:`held`.
    to : float
        Last value of the unknown.

    Returns
    -------
    tuple of ((u,) array, float) or None
        State after the first step, which still has the directions near the start, and
        weighted squares at the end. None if the squares may lie on either side of the
        limit.
    """
    path, squares = [state, state], np.inf
    for part in _WAY:
        value = float(state[k] + part * (to - state[k]))
        before, now = path[-2:]
        run = now[k] - before[k]
        begin = now + (now - before) * ((value - now[k]) / run if run else 0.0)
        fits = [held(rows, begin, k, value, limit)]
        if fits[0] is None or not fits[0].converged:
            fits.append(held(rows, now, k, value, limit))
        best = min((fit for fit in fits if fit is not None), key=lambda one: one.squares, default=None)
        if best is None:
            return None
        path.append(best.state)
        squares = best.squares
    return path[2], squares
