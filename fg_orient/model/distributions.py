"""Probability distributions, and control of many tests at once: one function each for all floors above.

``..._probability`` is the probability of values up to x, ``..._tail`` that of values beyond it, ``..._quantile`` the
value that is not exceeded with a probability, ``..._limit`` the value that is exceeded with it. Degrees of freedom
come first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import special

from factors.arrays import Array


def _of_arrays(function: Callable[..., Any]) -> Callable[..., Array]:
    """Function of values and arrays that become float64, in the order of the arguments; its result likewise."""
    return lambda *given: np.asarray(function(*(np.asarray(one, np.float64) for one in given)), np.float64)


#: Standard normal: arguments x; probability.
normal_probability = _of_arrays(special.ndtr)
normal_quantile = _of_arrays(special.ndtri)
#: Student's t: arguments degrees of freedom, probability.
t_quantile = _of_arrays(special.stdtrit)
#: Fisher's F: the arguments are the two degrees of freedom and the probability; the result is F.
f_quantile = _of_arrays(special.fdtri)
f_tail = _of_arrays(special.fdtrc)
#: Beta distribution: arguments a, b, probability. The limit is accurate for small probabilities.
beta_quantile = _of_arrays(special.betaincinv)
beta_limit = _of_arrays(special.betainccinv)
#: Chi-square: arguments degrees of freedom, x or probability. Quantile and limit are accurate for small probabilities.
chi_square_probability = _of_arrays(special.chdtr)
chi_square_quantile = _of_arrays(lambda freedom, probability: 2.0 * special.gammaincinv(0.5 * freedom, probability))
chi_square_limit = _of_arrays(special.chdtri)
#: Probability of an amount of Student's t beyond that of t: arguments degrees of freedom, t > 0.
t_two_sided = _of_arrays(lambda freedom, t: 2.0 * special.stdtr(freedom, -t))


def chi_square_tail(freedom: npt.ArrayLike, x: npt.ArrayLike) -> Array:
    """Tail of chi-square; for two degrees of freedom, those of image points, ``exp(-x / 2)``: a tenth of the time."""
    freedom, x = np.broadcast_arrays(np.asarray(freedom, np.float64), np.asarray(x, np.float64))
    out, other = np.asarray(np.exp(-0.5 * np.maximum(x, 0.0))), freedom != 2.0
    out[other] = special.chdtrc(freedom[other], x[other])
    return out


def beta_probability(a: npt.ArrayLike, b: npt.ArrayLike, x: npt.ArrayLike) -> Array:
    """Probability of the beta distribution; for b = 1, that of image points, ``x^a``."""
    a, b, x = np.broadcast_arrays(*(np.asarray(one, np.float64) for one in (a, b, x)))
    out, other = np.asarray(np.power(x, a)), b != 1.0
    out[other] = special.betainc(a[other], b[other], x[other])
    return out


def normal_within(x: npt.ArrayLike, sigma: float) -> Array:
    """Probability of a normal value of mean 0 and this sigma between -x and x."""
    return np.asarray(special.erf(np.asarray(x, np.float64) / (np.sqrt(2.0) * sigma)), np.float64)


def chi_square_noncentrality(freedom: float, limit: npt.ArrayLike, power: float) -> float:
    """Noncentrality with which chi-square exceeds a limit with the probability ``power``."""
    return float(special.chndtrinc(np.asarray(limit, np.float64), freedom, 1.0 - power))


def chi_square_interval(freedom: float, level: float) -> tuple[float, float]:
    """Interval that chi-square leaves with probability ``level``, half of it on each side."""
    return float(chi_square_quantile(freedom, 0.5 * level)), float(chi_square_limit(freedom, 0.5 * level))


def chi_square_median(freedom: npt.ArrayLike) -> Array:
    """Median of chi-square with this many degrees of freedom."""
    return chi_square_quantile(freedom, 0.5)


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
