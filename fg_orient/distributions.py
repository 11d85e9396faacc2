"""Quantiles of chi-square and of counts, control of many tests at once: one function each for all floors above."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import bdtr, chdtri, gammaincinv

Array = npt.NDArray[np.float64]


def chi_square_quantile(freedom: npt.ArrayLike, probability: npt.ArrayLike) -> Array:
    """Value that chi-square does not exceed with this probability, accurate for small ones."""
    half, p = 0.5 * np.asarray(freedom, np.float64), np.asarray(probability, np.float64)
    return np.asarray(2.0 * gammaincinv(half, p), np.float64)


def chi_square_limit(freedom: npt.ArrayLike, level: npt.ArrayLike) -> Array:
    """Value that chi-square exceeds with this probability, accurate for small ones."""
    return np.asarray(chdtri(np.asarray(freedom, np.float64), np.asarray(level, np.float64)), np.float64)


def chi_square_interval(freedom: float, level: float) -> tuple[float, float]:
    """Interval that chi-square leaves with probability ``level``, half of it on each side."""
    return float(chi_square_quantile(freedom, 0.5 * level)), float(chi_square_limit(freedom, 0.5 * level))


def chi_square_median(freedom: npt.ArrayLike) -> Array:
    """Median of chi-square with this many degrees of freedom."""
    return chi_square_quantile(freedom, 0.5)


def binomial_limit(n: int, probability: float, level: float) -> int:
    """Least count that n independent events of this probability exceed with probability ``level`` at most."""
    spread = np.sqrt(n * probability * (1.0 - probability))
    reach = min(n, int(np.ceil(n * probability + (spread + 1.0) / np.sqrt(level))))  # Cantelli's inequality, and more
    counts = np.arange(reach + 1)
    return int(counts[bdtr(counts, n, probability) >= 1.0 - level][0])


def sidak(level: float, n: int) -> float:
    """Level of each of n independent tests with ``level`` for any false alarm: Sidak's ``1 - (1 - level)^(1/n)``."""
    return float(-np.expm1(np.log1p(-level) / n))


def holm(p: Array) -> Array:
    """Probabilities adjusted for as many tests, so that ``adjusted <= alpha`` bounds any false alarm (Holm 1979)."""
    order = np.argsort(p)
    raised = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    out = np.empty(len(p))
    out[order] = np.minimum(raised, 1.0)
    return out
