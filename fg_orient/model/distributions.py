"""Probability distributions, and corrections for many simultaneous tests, used by all other packages.

``..._probability`` is the probability of values up to x, ``..._tail`` the probability of values beyond x.
``..._quantile`` is the value that is not exceeded with a given probability, ``..._limit`` the value that is exceeded
with a given probability. Degrees of freedom are the first arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy import special

from factors.arrays import Array

#: Standard deviation of a normal distribution in median absolute deviations.
MAD: Final = 1.4826
#: Half width of the interval that contains 95 % of a normal distribution, in standard deviations.
INSIDE_95: Final = 1.959964


def _of_arrays(function: Callable[..., Any]) -> Callable[..., Array]:
    """Return a function that converts its arguments, in order, and its result to float64."""
    return lambda *given: np.asarray(function(*(np.asarray(one, np.float64) for one in given)), np.float64)


#: Standard normal distribution: the argument is x or the probability.
normal_probability = _of_arrays(special.ndtr)
normal_quantile = _of_arrays(special.ndtri)
#: Student's t: the arguments are the degrees of freedom and the probability.
t_quantile = _of_arrays(special.stdtrit)
#: Fisher's F: the arguments are the two degrees of freedom and the probability; the result is F.
f_quantile = _of_arrays(special.fdtri)
f_tail = _of_arrays(special.fdtrc)
#: Beta distribution: the arguments are a, b and the probability. The limit is accurate for small probabilities.
beta_quantile = _of_arrays(special.betaincinv)
beta_limit = _of_arrays(special.betainccinv)
#: Chi-square: the arguments are the degrees of freedom and x or the probability. Quantile and limit are accurate for
#: small probabilities.
chi_square_probability = _of_arrays(special.chdtr)
chi_square_quantile = _of_arrays(lambda freedom, probability: 2.0 * special.gammaincinv(0.5 * freedom, probability))
chi_square_limit = _of_arrays(special.chdtri)
#: Probability that the absolute value of Student's t exceeds t: the arguments are the degrees of freedom and t > 0.
t_two_sided = _of_arrays(lambda freedom, t: 2.0 * special.stdtr(freedom, -t))


def chi_square_tail(freedom: npt.ArrayLike, x: npt.ArrayLike) -> Array:
    """Return the tail of chi-square.

    For two degrees of freedom (image points) it is ``exp(-x / 2)``, ten times faster.
    """
    freedom, x = np.broadcast_arrays(np.asarray(freedom, np.float64), np.asarray(x, np.float64))
    out, other = np.asarray(np.exp(-0.5 * np.maximum(x, 0.0))), freedom != 2.0
    out[other] = special.chdtrc(freedom[other], x[other])
    return out


def beta_probability(a: npt.ArrayLike, b: npt.ArrayLike, x: npt.ArrayLike) -> Array:
    """Return the probability of the beta distribution. For b = 1 (image points) it is ``x^a``."""
    a, b, x = np.broadcast_arrays(*(np.asarray(one, np.float64) for one in (a, b, x)))
    out, other = np.asarray(np.power(x, a)), b != 1.0
    out[other] = special.betainc(a[other], b[other], x[other])
    return out


def normal_within(x: npt.ArrayLike, sigma: float) -> Array:
    """Return the probability that a normal value of mean 0 and this sigma lies between -x and x."""
    return np.asarray(special.erf(np.asarray(x, np.float64) / (np.sqrt(2.0) * sigma)), np.float64)


def chi_square_noncentrality(freedom: float, limit: npt.ArrayLike, power: float) -> float:
    """Return the noncentrality for which chi-square exceeds a limit with probability ``power``."""
    return float(special.chndtrinc(np.asarray(limit, np.float64), freedom, 1.0 - power))


def chi_square_interval(freedom: float, level: float) -> tuple[float, float]:
    """Return the interval outside which chi-square lies with probability ``level``, half of it on each side."""
    return float(chi_square_quantile(freedom, 0.5 * level)), float(chi_square_limit(freedom, 0.5 * level))


def chi_square_median(freedom: npt.ArrayLike) -> Array:
    """Return the median of chi-square with this many degrees of freedom."""
    return chi_square_quantile(freedom, 0.5)


def sidak(level: float, n: int) -> float:
    """Return the level of each of n independent tests so that any false alarm has the probability ``level`` (Sidak)."""
    return float(-np.expm1(np.log1p(-level) / n))


def holm(p: Array) -> Array:
    """Return adjusted p-values: rejecting where ``adjusted <= alpha`` limits any false alarm to alpha (Holm 1979)."""
    order = np.argsort(p)
    raised = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    out = np.empty(len(p))
    out[order] = np.minimum(raised, 1.0)
    return out
