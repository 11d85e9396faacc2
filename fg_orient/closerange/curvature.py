"""How far standard deviations reach as an ellipsoid: the curvature of the unknowns at a minimum.

Cofactors describe a minimum by its tangent. Where two unknowns are strongly correlated and badly known (the centre of a
far camera and its turns), the set of states that fit is a bent band: each standard deviation is right, but a
combination of unknowns that the tangent calls well known is moved by the error of another one, in its square. That is
the parameter-effects curvature of Bates and Watts (1980), here as the way it leads to at one standard deviation.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.fitting import Rows

Array = npt.NDArray[np.float64]

#: Bend from which an error of two standard deviations, one of 20, moves another combination by one of its own.
BENT: Final = 0.25


def bend(rows: Rows, state: Array, m0: float | None) -> float:
    """How many standard deviations of its own a combination of unknowns is moved by errors of one in the others.

    Errors by the covariance have squares that are larger than the number of unknowns by about ``3 bend**2``, the mean
    of the squares of what second derivatives add within the tangent. Above ``BENT`` use the standard deviations one by
    one; the covariance as a whole is optimistic.

    Parameters
    ----------
    rows : callable
        Whitened residuals and their derivatives.
    state : (u,) array
        The minimum; its unknowns have to be determined.
    m0 : float or None
        Standard deviations are those of the given sigmas times this; None or 0: without.

    Returns
    -------
    float
        With the error e in one combination alone, others are moved by ``bend e**2``.
    """
    residual, design = rows(state, True)
    length = np.linalg.norm(design, axis=0)
    left, values, right = np.linalg.svd(design / length, full_matrices=False)
    unit, u = m0 or 1.0, len(state)
    steps = unit * (right.T / values / length[:, None]).T  # in its rows steps of one standard deviation

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
