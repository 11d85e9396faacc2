"""Tests of matches: agreement with the heights of neighbours and with the y-parallax of the orientation.

The y-parallaxes of wrong matches are uniformly distributed in the band, and their heights differ from
the heights of neighbours. The shift and the slow change of the y-parallax over an image (the error of
the orientation) form a polynomial, which is estimated robustly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import spatial

from factors.arrays import Array, Mask
from fg_orient.model.distributions import MAD

#: Number of neighbours of a match; limit of its deviation in standard deviations of the neighbours.
NEIGHBOURS: Final = 10
LOCAL_LIMIT: Final = 4.0
#: Number of rounds of the robust fit of the y-parallax polynomial, and its limit in standard deviations.
ROUNDS: Final = 8
LIMIT: Final = 4.0


def fits_neighbours(pixel: Array, along_px: Array, floor_px: float) -> Mask:
    """Test whether the parallax along the curve agrees with the neighbours (median and MAD, with a lower bound).

    Parameters
    ----------
    pixel : (n, 2) array
        Pixel in image a.
    along_px : (n,) array
        Position along the epipolar curve, px.
    floor_px : float
        Least standard deviation: relief between neighbours.
    """
    n = len(pixel)
    if n < 4:
        return np.zeros(n, bool)
    k = min(NEIGHBOURS, n - 1)
    nearest = np.asarray(spatial.cKDTree(pixel).query(pixel, k + 1)[1], np.intp)
    around = along_px[nearest[:, 1:]]
    middle = np.median(around, axis=1)
    spread = MAD * np.median(np.abs(around - middle[:, None]), axis=1)
    # on a slope the deviations of neighbours grow with their distance
    return np.asarray(np.abs(along_px - middle) <= LOCAL_LIMIT * np.hypot(spread, floor_px))


@dataclass(frozen=True, eq=False)
class Trend:
    """Polynomial of the y-parallax over an image, in pixels.

    Parameters
    ----------
    origin, scale : (2,) arrays
        Normalisation of (line, sample).
    coefficients : (k,) array
        Coefficients of 1, l, s, and, with k = 6, l l, l s, s s.
    scatter_px : float
        Robust standard deviation of the residuals.
    """

    origin: Array
    scale: Array
    coefficients: Array
    scatter_px: float

    def at(self, pixel: Array) -> Array:
        """Return the y-parallaxes (n,) at pixels (n, 2) of image a."""
        return np.asarray(_terms((pixel - self.origin) / self.scale, len(self.coefficients)) @ self.coefficients)


def _terms(x: Array, count: int) -> Array:
    line, sample = x.T
    all_terms = [np.ones(len(x)), line, sample, line * line, line * sample, sample * sample]
    return np.stack(all_terms[:count], axis=1)


def trend_of(pixel: Array, parallax_px: Array, half_width_px: float) -> Trend | None:
    """Fit a robust polynomial to y-parallaxes.

    Start at the mode of their histogram; then use least squares within 4 robust standard deviations.

    Parameters
    ----------
    pixel : (n, 2) array
        Pixels of a.
    parallax_px : (n,) array
        Y-parallaxes, px of b.
    half_width_px : float
        Half width of the band in which the matches were searched, px.

    Returns
    -------
    Trend or None
        Trend; None with fewer than 12 matches, or if no more matches agree than a uniform distribution would give.
    """
    n = len(pixel)
    if n < 12:
        return None
    origin = 0.5 * (pixel.min(axis=0) + pixel.max(axis=0))
    scale = np.maximum(0.5 * np.ptp(pixel, axis=0), 1.0)
    # the mode is the middle of the window with the most values
    width = max(half_width_px / 50.0, 1.0)
    ordered = np.sort(parallax_px)
    ends = np.searchsorted(ordered, ordered + 2.0 * width, side="right")
    most = ends - np.arange(n)
    k = int(np.argmax(most))
    expected = n * width / max(half_width_px, width)
    if most[k] < expected + 5.0 * np.sqrt(expected) + 6.0:
        return None
    middle = 0.5 * (ordered[k] + ordered[ends[k] - 1])
    good = np.abs(parallax_px - middle) <= 2.0 * width
    coefficients, scatter = np.array([middle]), width
    for count in (1, 3, 3, 3, *(6,) * ROUNDS):
        if good.sum() < 5 * count:
            break
        terms = _terms((pixel - origin) / scale, count)
        coefficients = np.linalg.lstsq(terms[good], parallax_px[good], rcond=None)[0]
        residual = parallax_px - terms @ coefficients
        near = np.abs(residual[good])
        scatter = max(MAD * float(np.median(near)), 0.02)
        good = np.abs(residual) <= LIMIT * scatter
    return Trend(origin, scale, coefficients, scatter)


# --- sigmas -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Calibration:
    """Standard deviations of least-squares matching compared with the y-parallaxes.

    The variance of a y-parallax is ``factor^2 v + floor_px^2``; v is the variance of least-squares matching.
    """

    factor: float
    floor_px: float
    formal_rms_px: float
    n: int

    def variance(self, formal: Array) -> Array:
        """Return the variances px^2 from the variances of least-squares matching."""
        return np.asarray(self.factor**2 * formal + self.floor_px**2)


def calibrate(residual_px: Array, formal: Array) -> Calibration:
    """Estimate factor and floor from y-parallaxes without trend, by maximum likelihood of two variance components.

    Parameters
    ----------
    residual_px : (n,) array
    formal : (n,) array
        Variances of the y-parallaxes by least-squares matching, px^2.
    """
    n = len(residual_px)
    scale = float(np.median(residual_px**2) * MAD**2)
    fixed = max(float(np.median(formal)), 1e-12)
    x = np.array([0.5 * scale / fixed, 0.5 * scale])  # start values of the squares of factor and floor
    square = residual_px**2
    for _ in range(100):  # Fisher scoring: each step is a weighted least-squares fit of the squares
        variance = x[0] * formal + x[1]
        good = square <= LIMIT**2 * variance
        weight = good / variance**2
        design = np.stack([formal, np.ones(n)], axis=1)
        normal = design.T @ (weight[:, None] * design)
        right = design.T @ (weight * square)
        step = np.linalg.lstsq(normal, right, rcond=None)[0]
        if step[0] <= 0.0:
            step = np.array([0.0, right[1] / normal[1, 1]])
        elif step[1] <= 0.0:
            step = np.array([right[0] / normal[0, 0], 0.0])
        if np.allclose(step, x, rtol=1e-4, atol=1e-9):
            break
        x = 0.5 * (x + step)
    return Calibration(float(np.sqrt(x[0])), float(np.sqrt(x[1])), float(np.sqrt(formal.mean())), n)
