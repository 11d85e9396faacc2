"""Probability distributions, and control of many tests at once: one function each for all floors above.

``..._probability`` is the probability of values up to x, ``..._tail`` that of values beyond it, ``..._quantile`` the
value that is not exceeded with a probability, ``..._limit`` the value that is exceeded with it. Degrees of freedom
come first.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import (
    bdtr,
    betainc,
    betainccinv,
    betaincinv,
    chdtr,
    chdtrc,
    chdtri,
    chndtrinc,
    erf,
    fdtrc,
    fdtri,
    gammaincinv,
    ndtr,
    ndtri,
    stdtr,
    stdtrit,
)

Array = npt.NDArray[np.float64]


def _real(values: npt.ArrayLike) -> Array:
    return np.asarray(values, np.float64)


def normal_probability(x: npt.ArrayLike) -> Array:
    """Probability of a standard normal value up to x."""
    return _real(ndtr(_real(x)))


def normal_quantile(probability: npt.ArrayLike) -> Array:
    """Value that a standard normal one does not exceed with this probability."""
    return _real(ndtri(_real(probability)))


def normal_within(x: npt.ArrayLike, sigma: float) -> Array:
    """Probability of a normal value of mean 0 and this sigma between -x and x."""
    return _real(erf(_real(x) / (np.sqrt(2.0) * sigma)))


def t_quantile(freedom: npt.ArrayLike, probability: npt.ArrayLike) -> Array:
    """Value that Student's t does not exceed with this probability."""
    return _real(stdtrit(_real(freedom), _real(probability)))


def t_two_sided(freedom: npt.ArrayLike, t: npt.ArrayLike) -> Array:
    """Probability of an amount of Student's t beyond that of ``t``, which is positive."""
    return _real(2.0 * stdtr(_real(freedom), -_real(t)))


def f_quantile(freedom: npt.ArrayLike, freedom_below: npt.ArrayLike, probability: npt.ArrayLike) -> Array:
    """Value that Fisher's F does not exceed with this probability."""
    return _real(fdtri(_real(freedom), _real(freedom_below), _real(probability)))


def f_tail(freedom: npt.ArrayLike, freedom_below: npt.ArrayLike, f: npt.ArrayLike) -> Array:
    """Probability of Fisher's F beyond ``f``."""
    return _real(fdtrc(_real(freedom), _real(freedom_below), _real(f)))


def beta_probability(a: npt.ArrayLike, b: npt.ArrayLike, x: npt.ArrayLike) -> Array:
    """Probability of a value of the beta distribution up to x."""
    return _real(betainc(_real(a), _real(b), _real(x)))


def beta_quantile(a: npt.ArrayLike, b: npt.ArrayLike, probability: npt.ArrayLike) -> Array:
    """Value that the beta distribution does not exceed with this probability."""
    return _real(betaincinv(_real(a), _real(b), _real(probability)))


def beta_limit(a: npt.ArrayLike, b: npt.ArrayLike, level: npt.ArrayLike) -> Array:
    """Value that the beta distribution exceeds with this probability, accurate for small ones."""
    return _real(betainccinv(_real(a), _real(b), _real(level)))


def chi_square_probability(freedom: npt.ArrayLike, x: npt.ArrayLike) -> Array:
    """Probability of chi-square up to x."""
    return _real(chdtr(_real(freedom), _real(x)))


def chi_square_tail(freedom: npt.ArrayLike, x: npt.ArrayLike) -> Array:
    """Probability of chi-square beyond x."""
    return _real(chdtrc(_real(freedom), _real(x)))


def chi_square_noncentrality(freedom: float, limit: npt.ArrayLike, power: float) -> float:
    """Noncentrality with which chi-square exceeds a limit with the probability ``power``."""
    return float(chndtrinc(_real(limit), freedom, 1.0 - power))


def chi_square_quantile(freedom: npt.ArrayLike, probability: npt.ArrayLike) -> Array:
    """Value that chi-square does not exceed with this probability, accurate for small ones."""
    return _real(2.0 * gammaincinv(0.5 * _real(freedom), _real(probability)))


def chi_square_limit(freedom: npt.ArrayLike, level: npt.ArrayLike) -> Array:
    """Value that chi-square exceeds with this probability, accurate for small ones."""
    return _real(chdtri(_real(freedom), _real(level)))


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
