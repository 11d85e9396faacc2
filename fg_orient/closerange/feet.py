"""Feet of points on quadrics: the nearest point that fulfils a condition of the second degree, weights included.

A condition ``l^T S l + 2 u^T l + c = 0`` between the observations of one point (a surface in space, the coplanarity of
two rays) with ``v^T Q^-1 v`` minimal has v in closed form but for one number: along the eigenvectors of the whitened
S, v_i = -t w_i/(1 + t d_i), and the condition is a decreasing function of t. So the foot is exact and the nearest one,
where iterated linearisation (Pope) may end on the far side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_STEPS: Final = 200
#: What is left of the condition, by its largest term: a few roundings.
_ROUNDING: Final = 1e-15


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
        """Condition (n,) at points (n, d)."""
        return np.asarray(np.einsum("ni,ni->n", points, self._half_slope(points) + self.linear) + self.constant)

    def slope(self, points: Array) -> Array:
        """Derivatives (n, d) of the condition."""
        return np.asarray(2.0 * self._half_slope(points))

    def _half_slope(self, points: Array) -> Array:
        return np.asarray(np.einsum("...ij,...j->...i", self.square, points) + self.linear)


def feet(conditions: Conditions, points: Array, sigma: Array) -> Array:
    """Points (n, d) that fulfil the conditions, nearest to given ones in units of their sigmas.

    Parameters
    ----------
    conditions : Conditions
    points, sigma : (n, d) arrays
        Observations and their standard deviations.

    Returns
    -------
    (n, d) array
        nan where no point of the surface is nearest (the centre of a sphere) or none exists.
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
    """Distances (n,) of points from the conditions in sigmas, above 0 where they are positive, and the feet (n, d)."""
    foot = feet(conditions, points, sigma)
    side = np.sign(conditions.value(points))
    return np.asarray(side * np.linalg.norm((points - foot) / sigma, axis=1)), foot


def distance_rows(by_unknown: Array, slope: Array, sigma: Array) -> Array:
    """Derivatives (n, u) of weighted distances: those of the conditions at the feet by the length of their slopes."""
    return np.asarray(by_unknown / np.linalg.norm(slope * sigma, axis=1)[:, None])


def _multiplier(d: Array, w: Array, c: Array) -> Array:
    """Root t (n,) of c - sum w^2 t (2 + t d)/(1 + t d)^2 between the poles -1/d, by Newton kept in a bracket."""
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
