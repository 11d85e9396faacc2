"""Tests of differences at check points with their joint covariance C: trend, and number of large differences.

The errors of the orientation are common to all check points, so their differences are correlated.
Therefore two usual tests give false alarms in too many blocks. They are Student's test of the mean
against the scatter, and the test of the number of large differences by the binomial distribution. Bias,
drift and tilt are estimated by generalised least squares instead, and the number is compared with
numbers simulated from C.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array

#: Check coordinates are listed if their difference exceeds this number of its standard deviations.
RATIO_LIMIT: Final = 3.0
#: Number of random draws of the number of coordinates beyond the limit.
DRAWS: Final = 20_000
#: Check points do not determine a trend if its relative singular value is below this.
RANK: Final = 1e-8
#: Columns of the trend parameters: 3 k + axis. k = 0 is the constant, k = 1 the slope to East, k = 2 the
#: slope to North.
TRENDS: Final = {"bias": (0, 1, 2), "drift": (3, 4, 6, 7), "tilt": (5, 8)}


def number_statistic(ratio: Array) -> Array:
    """Return the number of ratios (..., n) above the limit, plus a fraction.

    The fraction increases with the largest ratio and orders equal numbers.
    """
    largest = ratio.max(axis=-1)
    return np.asarray((ratio > RATIO_LIMIT).sum(axis=-1) + largest / (1.0 + largest))


def numbers_by_chance(c: Array, draws: int = DRAWS) -> Array:
    """Simulate :func:`number_statistic` (draws,) of normal differences with the joint covariance c; sort ascending."""
    sigma = np.sqrt(np.diag(c))
    root = np.linalg.cholesky(c / np.outer(sigma, sigma))
    rng, size = np.random.default_rng(0), 1000
    return np.sort(np.concatenate([
        number_statistic(np.abs(rng.standard_normal((min(size, draws - k), len(c))) @ root.T))
        for k in range(0, draws, size)
    ]))  # fmt: skip


def probability_of_number(statistic: npt.ArrayLike, null: Array) -> Array:
    """Return the probability of this :func:`number_statistic` or more, from simulated values in ascending order."""
    return np.asarray((1.0 + len(null) - np.searchsorted(null, statistic)) / (1.0 + len(null)))


def trend_squares(c: Array, place_km: Array, e: Array) -> tuple[Array, tuple[int, ...]]:
    """Compute the decrease of the squares by bias, drift and tilt of the differences, in this order.

    Each is computed after the effects before it are removed. Without a trend they are independent and have
    chi-square distributions. The model ``e = bias + slopes place`` is estimated by generalised least squares
    with the covariance c. Drift: slopes of East and North; tilt: slopes of Up.

    Parameters
    ----------
    c : (3n, 3n) array
        Joint covariance, m^2.
    place_km : (n, 2) array
        East, North of the points.
    e : (3n, s) array
        Differences of s samples, m.

    Returns
    -------
    squares : (3, s) array
    degrees : tuple of int
        Degrees of freedom of each; 0 if these points cannot show it.
    """
    design, whitened = _whitened_trend(c, place_km, e)
    before, rank, squares, degrees = np.zeros(e.shape[1]), 0, list[Array](), list[int]()
    for k in range(len(TRENDS)):
        u, s, _ = np.linalg.svd(design[:, [j for group in list(TRENDS.values())[: k + 1] for j in group]], False)
        axes = u[:, s > RANK * s[0]]
        after = ((axes.T @ whitened) ** 2).sum(axis=0)
        squares.append(np.maximum(after - before, 0.0))
        degrees.append(axes.shape[1] - rank)
        before, rank = after, axes.shape[1]
    return np.array(squares), tuple(degrees)


def _whitened_trend(c: Array, place_km: Array, e: Array) -> tuple[Array, Array]:
    """Return the design (3n, 9) with columns of length 1, and the samples, in rows of unit weight."""
    centred = place_km - place_km.mean(axis=0)
    design = np.kron(np.column_stack([np.ones(len(centred)), centred]), np.eye(3))
    root = np.linalg.cholesky(c)
    white = np.linalg.solve(root, design)
    return white / np.maximum(np.linalg.norm(white, axis=0), np.finfo(float).tiny), np.linalg.solve(root, e)
