"""Profiles of weighted squares: how much worse a fit becomes when one unknown is held at quite another value.

Cofactors describe a minimum by its curvature. Where noise makes a narrow minimum of its own, beside a valley that leads
far away on nearly the same level, they say nothing of the valley; the profile does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.dense import RowsBackend
from fg_orient.adjustment.loop import OPTIMIZERS
from fg_orient.closerange.fitting import MAX_ITERATIONS, UNDETERMINED, Rows, finite_rows
from fg_orient.model.distributions import chi_square_limit, f_quantile
from fg_orient.model.errors import NoSolutionError

Array = npt.NDArray[np.float64]

#: Error probability of an interval; where squares grow as a parabola the judgement does not depend on it.
LEVEL: Final = 1e-3
#: Sigmas of points may be too small by this factor (a real surface is no spheroid) without changing the judgement; by
#: more where the residuals say so. Noise of f sigmas gains f^2 times a chi-square of one degree of freedom, no more,
#: where points leave a semi-axis open; m0 of a redundancy of one or two says too little to go before the given sigmas.
OPTIMISTIC: Final = 5.0
#: Parts of the way on which the fit is followed.
_WAY: Final = (1 / 64, 1 / 8, 1.0)
#: Steps of normalised unknowns off a state where derivatives have no value.
ASIDE: Final = 1e-5
#: Iterations after which a fit far away is looked at, and how often it goes on if it still falls towards the limit.
_ROUND: Final = 50
_ROUNDS: Final = 8


def reach(sigma: float, squares: float, redundancy: int, *, known: bool) -> tuple[float, float] | None:
    """How far away to hold an unknown, and the growth of the weighted squares that a determined one shows there.

    Parameters
    ----------
    sigma : float
        Of a point, in the unit of the unknown.
    squares : float
        Least weighted squares.
    redundancy : int
    known : bool
        Whether sigmas have a known size; if not it is m0, and the limit that of F.

    Returns
    -------
    tuple of float or None
        None if nothing tells the size of the noise. If squares grow as a parabola, a standard deviation of
        ``UNDETERMINED`` sigmas is exactly what has this growth at this distance.
    """
    own = squares / redundancy if redundancy > 0 else 1.0
    if known:
        scale, limit = max(OPTIMISTIC**2, own), float(chi_square_limit(1.0, LEVEL))
    elif redundancy > 0:
        scale, limit = own, float(f_quantile(1, redundancy, 1.0 - LEVEL))
    else:
        return None
    return UNDETERMINED * sigma * float(np.sqrt(scale * limit)), scale * limit


@dataclass(frozen=True)
class Held:
    """Fit with one unknown held.

    Parameters
    ----------
    state : (u,) array
    squares : float
        Least weighted squares found.
    converged : bool
        False: they are below the limit, or their fall in half of the iterations would not lead there if it went on.
    """

    state: Array
    squares: float
    converged: bool


def held(rows: Rows, state: Array, k: int, value: float, limit: float = np.inf) -> Held | None:
    """State with the least weighted squares among those with one unknown held.

    Far from the points' own shape the iteration may creep for hundreds of steps at squares that are thousands of times
    the limit. So it need not end: squares that stay above the limit suffice.

    Parameters
    ----------
    limit : float
        Weighted squares that matter: whether the least ones lie below is asked. Default: the iteration has to converge.

    Returns
    -------
    Held or None
        None: neither converged nor below the limit nor clearly above it.
    """
    free = np.arange(len(state)) != k

    def full(part: Array) -> Array:
        return np.insert(part, k, value)

    def some(part: Array, want: bool) -> tuple[Array, Array]:
        residual, design = rows(full(part), want)
        return residual, design[:, free]

    start, far = _off_ridge(some, state[free]), np.isfinite(limit)
    backend = RowsBackend(finite_rows(some))
    for _ in range(_ROUNDS if far else 1):
        try:
            found = OPTIMIZERS["levenberg-marquardt"](backend, start, _ROUND if far else MAX_ITERATIONS)
        except NoSolutionError:
            return None
        squares, start = 2.0 * found.error, found.state
        if found.converged and np.isfinite(squares):
            return Held(full(start), squares, True)
        above = squares - limit > found.log[len(found.log) // 2].chi2 - squares
        if far and (squares < limit or above):
            return Held(full(start), squares, False)
    return None


def _off_ridge(rows: Rows, state: Array) -> Array:
    """The state, or one beside it where a point has no single nearest point, as one on the axis of a long spheroid.

    To both sides of it the squares fall, so no minimum is there.
    """
    if np.isfinite(rows(state, True)[1]).all():
        return state
    return np.asarray(state + ASIDE * np.cos(np.arange(len(state))))  # no two unknowns by the same


def followed(rows: Rows, state: Array, k: int, to: float, limit: float) -> tuple[Array, float] | None:
    """The fit with an unknown held at ``to``, far from a state; each step begins on the line through the two before.

    Returns
    -------
    tuple of (state (u,), weighted squares) or None
        State after the first step, where directions are still those near by, and the squares at the end; None where
        they may lie on either side of the limit (:func:`held`).
    """
    path, squares = [state, state], np.inf
    for part in _WAY:
        value = float(state[k] + part * (to - state[k]))
        before, now = path[-2:]
        run = now[k] - before[k]
        begin = now + (now - before) * ((value - now[k]) / run if run else 0.0)
        fits = list[Held]()
        for first in (begin, now):
            found = held(rows, first, k, value, limit)
            fits += [] if found is None else [found]
            if found is not None and found.converged:
                break
        if not fits:
            return None
        best = min(fits, key=lambda one: one.squares)
        path.append(best.state)
        squares = best.squares
    return path[2], squares
