"""Profiles of weighted squares: how much worse a fit becomes when one unknown is held at quite another value.

Cofactors describe a minimum by its curvature. Where noise makes a narrow minimum of its own, beside a valley that leads
far away on nearly the same level, they say nothing of the valley; the profile does.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import fdtri

from fg_orient.closerange.fitting import UNDETERMINED, Rows, adjust
from fg_orient.distributions import chi_square_limit
from fg_orient.errors import NoSolutionError

Array = npt.NDArray[np.float64]

#: Error probability of an interval; where squares grow as a parabola the judgement does not depend on it.
LEVEL: Final = 1e-3
#: Sigmas of points may be too small by this factor (a real surface is no spheroid) without changing the judgement. Six
#: points on two levels gain up to 20 from noise, those on three 1200 and more, with the sigmas of Ayhan's points.
OPTIMISTIC: Final = 5.0
#: Parts of the way on which the fit is followed.
_WAY: Final = (1 / 64, 1 / 8, 1.0)


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
        scale, limit = OPTIMISTIC**2 * max(1.0, own), float(chi_square_limit(1.0, LEVEL))
    elif redundancy > 0:
        scale, limit = own, float(fdtri(1, redundancy, 1.0 - LEVEL))
    else:
        return None
    return UNDETERMINED * sigma * float(np.sqrt(scale * limit)), scale * limit


def held(rows: Rows, state: Array, k: int, value: float, what: str) -> tuple[Array, float]:
    """State with the least weighted squares among those with one unknown held, and these squares.

    Raises
    ------
    NoSolutionError
        The iteration does not converge.
    """
    free = np.arange(len(state)) != k

    def full(part: Array) -> Array:
        return np.insert(part, k, value)

    def some(part: Array, want: bool) -> tuple[Array, Array]:
        residual, design = rows(full(part), want)
        return residual, design[:, free]

    found = adjust(some, state[free], what)
    return full(found.state), float(found.residual @ found.residual)


def followed(rows: Rows, state: Array, k: int, to: float, what: str) -> tuple[Array, float] | None:
    """The fit with an unknown held at ``to``, far from a state; each step begins on the line through the two before.

    Returns
    -------
    tuple of (state (u,), weighted squares) or None
        State after the first step, where directions are still those near by, and the squares at the end; None where
        no such fit exists.
    """
    path, squares = [state, state], np.inf
    for part in _WAY:
        value = float(state[k] + part * (to - state[k]))
        before, now = path[-2:]
        run = now[k] - before[k]
        begin = now + (now - before) * ((value - now[k]) / run if run else 0.0)
        for first in (begin, now):
            try:
                found, squares = held(rows, first, k, value, what)
                break
            except NoSolutionError:
                continue
        else:
            return None
        path.append(found)
    return path[2], squares
