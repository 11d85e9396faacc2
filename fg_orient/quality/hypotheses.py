"""Distributions of the outlier tests, control of multiple tests, and the global test.

T is the decrease of the weighted sum of squares v^T v (f degrees of freedom) when d parameters of a gross error are
added. Three tests use T. Their distributions without gross errors are:

- **Baarda** (1968), sigmas a priori: ``T ~ chi2(d)``; d = 1: ``w = sqrt(T) ~ N(0, 1)``;
- **Pope** (1976), scale ``m0^2 = v^T v / f`` with the suspect: ``T / v^T v ~ Beta(d/2, (f - d)/2)``; d = 1:
  ``tau = sqrt(T) / m0``;
- **t** or F, scale without the suspect: ``F = (T/d) / ((v^T v - T)/(f - d)) ~ F(d, f - d)``; d = 1: ``t = sqrt(F)``.

Pope's statistic is a monotone function of t or F, so both give the same decision and probability. They require correct
ratios of the sigmas only; Baarda's test requires correct sigmas.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, get_args

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.model.distributions import (
    beta_limit,
    beta_probability,
    beta_quantile,
    chi_square_interval,
    chi_square_limit,
    chi_square_probability,
    chi_square_tail,
    holm,
    sidak,
)
from fg_orient.model.errors import InputError
from fg_orient.model.options import MultipleTesting, OutlierTest

#: Names of the statistic for one degree of freedom, and for more.
SYMBOLS: Final[dict[str, tuple[str, str]]] = {"baarda": ("w", "T"), "pope": ("tau", "T/m0^2"), "t": ("t", "F")}
#: A direction is checked by the other observations if its eigenvalue of the cofactors is above this.
CHECKED: Final = 1e-6
_TINY: Final = float(np.finfo(float).tiny)
#: Relative rounding error of the remaining v^T v. It is the least value used, even if one suspect explains
#: all residuals.
_ROUNDING: Final = float(np.finfo(float).eps)


def require_names(test: str, control: str, level: float) -> None:
    """Raise InputError for an unknown test or control of multiple tests, or an invalid level."""
    for option, value, known in (
        ("test", test, get_args(OutlierTest)),
        ("control", control, get_args(MultipleTesting)),
    ):
        if value not in known:
            raise InputError.of("options.value", option=option, value=repr(value), expected=", ".join(known))
    if not 0.0 < level < 1.0:
        raise InputError.of("options.value", option="level", value=level, expected="a number above 0 and below 1")


def can_be_tested(d: npt.ArrayLike, redundancy: float | Array, test: str) -> Mask:
    """Return whether an error with d parameters (n,) can be tested.

    If the scale is estimated, redundancy must remain.
    """
    d = np.asarray(d)
    return np.asarray((d > 0) & ((d <= redundancy) if test == "baarda" else (d < redundancy)))


def eigen(q: Array) -> tuple[Array, Array]:
    """Return ascending eigenvalues (..., k) and eigenvectors (..., k, k), in columns, of symmetric matrices.

    Matrices with two rows are decomposed in closed form (a Jacobi rotation), because LAPACK takes 0.5 us for
    each.
    """
    if q.shape[-1] != 2:
        return np.linalg.eigh(q)
    a, b, c = q[..., 0, 0], q[..., 0, 1], q[..., 1, 1]
    middle, apart = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    angle = 0.5 * np.arctan2(2.0 * b, a - c)  # angle of the eigenvector of the larger eigenvalue
    x, y = np.cos(angle), np.sin(angle)
    axes = np.empty(q.shape)
    axes[..., 0, 0], axes[..., 1, 0], axes[..., 0, 1], axes[..., 1, 1] = -y, x, x, y
    return np.stack([middle - apart, middle + apart], axis=-1), axes


def quadratic(v: Array, q: Array) -> tuple[Array, Index, Array]:
    """Compute ``v^T Q^+ v`` (n,), rank d of Q (n,) and ``Q^+ v`` (n, k) for v (n, k) with cofactors Q (n, k, k)."""
    size, axes = eigen(q)
    checked = size > CHECKED
    along = np.einsum("...ka,...k->...a", axes, v)
    share = np.where(checked, along / np.where(checked, size, 1.0), 0.0)
    return (
        np.sum(along * share, axis=-1),
        np.asarray(np.sum(checked, axis=-1), np.intp),
        np.einsum("...ka,...a->...k", axes, share),
    )


def statistics(t: Array, d: Index, chi2: npt.ArrayLike, redundancy: float | Array, test: str) -> Array:
    """Compute the reported statistic: w, tau, t for d = 1; T, T/m0^2, F for more.

    Parameters
    ----------
    t : (n,) array
        Decrease T of the weighted sum of squares; any shape that broadcasts with the other arguments.
    d : (n,) int array
        Degrees of freedom of T, which must be testable.
    chi2 : float or array
        v^T v including the suspects.
    redundancy : int
        f, without the parameters of the suspects.
    test : str
    """
    chi2 = np.asarray(chi2, dtype=np.float64)
    if test == "baarda":
        value = t
    elif test == "pope":
        value = t * redundancy / np.maximum(chi2, _TINY)
    else:
        value = f_statistics(t, d, chi2, redundancy)
    return np.where(np.asarray(d) == 1, np.sqrt(value), value)


def f_statistics(t: npt.ArrayLike, d: npt.ArrayLike, chi2: npt.ArrayLike, redundancy: float | Array) -> Array:
    """Compute F for any d, with the scale estimated without the suspect; arguments as in :func:`statistics`."""
    t, chi2 = np.asarray(t, np.float64), np.asarray(chi2, np.float64)
    left = np.maximum(np.maximum(chi2 - t, _ROUNDING * chi2), _TINY)
    return np.asarray(t / d / (left / (redundancy - np.asarray(d))))


def probabilities(t: Array, d: Index, chi2: npt.ArrayLike, redundancy: float | Array, test: str) -> Array:
    """Return the probability of a larger statistic if there is no gross error; arguments as in :func:`statistics`."""
    if test == "baarda":
        return chi_square_tail(d, t)
    chi2 = np.asarray(chi2, dtype=np.float64)
    rest = np.clip((chi2 - t) / np.maximum(chi2, _TINY), 0.0, 1.0)
    return beta_probability(0.5 * (redundancy - d), 0.5 * d, rest)


def limits(level: npt.ArrayLike, d: Index, redundancy: float | Array, test: str) -> Array:
    """Return the limits of the statistics of :func:`statistics`; each has a false alarm with probability ``level``.

    For d = 1 Pope's limit is ``sqrt(f) t / sqrt(f - 1 + t^2)``, t Student's quantile of f - 1 degrees of freedom.
    """
    if np.ndim(level) == np.ndim(redundancy) == 0 and np.size(d):
        return _limits(level, np.arange(1, np.max(d) + 1), redundancy, test)[np.asarray(d) - 1]
    return _limits(level, d, redundancy, test)


def _limits(level: npt.ArrayLike, d: Index, redundancy: float | Array, test: str) -> Array:
    if test == "baarda":
        value: Array = chi_square_limit(d, level)
    else:
        share = beta_limit(0.5 * d, 0.5 * (redundancy - d), level)
        rest = beta_quantile(0.5 * (redundancy - d), 0.5 * d, level)  # computed as 1 - share, without loss of digits
        ratio = redundancy * share if test == "pope" else share / rest * (redundancy - d) / d
        value = np.asarray(ratio, dtype=np.float64)
    return np.where(np.asarray(d) == 1, np.sqrt(value), value)


def level_of_each(p: Array, level: float, control: str) -> float:
    """Return the level of single hypotheses that controls the false alarms of all.

    Parameters
    ----------
    p : (n,) array
        Probabilities of all tested hypotheses.
    level : float
        alpha.
    control : str
        "none": each test has the level alpha. "bonferroni", alpha/n, "sidak", 1 - (1 - alpha)^(1/n), and "holm" (1979):
        alpha bounds the probability of any false alarm. "benjamini_hochberg" (1995): alpha bounds the expected share of
        false alarms among the alarms.

    For the last two (step-wise) controls the result is the level of the last rejected hypothesis: all with
    ``p <= level`` are rejected.
    """
    n = len(p)
    if control == "none" or n == 0:
        return level
    if control == "sidak":
        return sidak(level, n)
    if control == "bonferroni":
        return level / n
    if control == "holm":
        rejected = int(np.count_nonzero(holm(p) <= level))
        return level / (n - max(rejected, 1) + 1)
    i, ordered = np.arange(1, n + 1), np.sort(p)
    below = np.flatnonzero(ordered <= level * i / n)
    return level * float(i[below[-1]] if len(below) else 1) / n


@dataclass(frozen=True)
class GlobalTest:
    """Test of the whole model by the agreement of the weighted sum of squares with sigmas and redundancy.

    Parameters
    ----------
    statistic : float
        v^T v.
    redundancy : int
        f; ``v^T v ~ chi2(f)`` if model and weights are correct.
    level : float
        Probability of a false alarm, for both sides together.
    limits : (float, float)
        Lower and upper limit of the statistic; the model is accepted between them.
    probability : float
        Twice the smaller tail probability.
    """

    statistic: float
    redundancy: float
    level: float
    limits: tuple[float, float]
    probability: float

    @property
    def accepted(self) -> bool:
        """True if the statistic is within its limits."""
        return self.limits[0] <= self.statistic <= self.limits[1]


def global_test(chi2: float, redundancy: float, level: float = 0.001) -> GlobalTest | None:
    """Test the variance factor by a two-sided chi-square test with a priori sigmas; None without redundancy.

    ``chi2`` is the weighted sum of squares of all residuals. InputError: the level is not between 0 and 1.
    """
    require_names("baarda", "none", level)
    if redundancy <= 0:
        return None
    tail = float(min(chi_square_probability(redundancy, chi2), chi_square_tail(redundancy, chi2)))
    limits = chi_square_interval(redundancy, level)
    return GlobalTest(float(chi2), redundancy, level, limits, min(1.0, 2.0 * tail))
