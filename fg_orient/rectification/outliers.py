"""Each point tested for a gross error, and the pruning of İpbüker 1994.

A control point is tested against all others, a check point against the fit.

With the whitened residuals v of a point and their cofactors Q: ``T = v^T Q^-1 v`` and
``F = (T/d)/((S - T)/(f - d))``, S the sum of all squares, f the redundancy, d the rank of Q: F(d, f - d) without a
gross error, the scale estimated without the suspect (as in ``fg_orient.quality.outliers``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from fg_orient.distributions import f_quantile, f_tail
from fg_orient.errors import NoSolutionError
from fg_orient.rectification.arguments import positive
from fg_orient.rectification.fit import CHECKED, Fit, Observations, fit
from fg_orient.rectification.models import Model

Array = npt.NDArray[np.float64]
Rule = Literal["residual", "test"]

#: Probability of a false alarm of each test, that of the bundle adjustment.
LEVEL: Final = 0.001


@dataclass(frozen=True)
class PointTests:
    """Test of every point; nan where the others do not check it.

    Parameters
    ----------
    dimension : (n,) int array
        d; 0 where nothing is checked.
    statistic, critical, probability : (n,) array
        F, its limit, and the probability of such an F without a gross error.
    error : (n, 2) array
        Estimated gross error of the target coordinates (given minus true), in their unit.
    """

    dimension: npt.NDArray[np.intp]
    statistic: Array
    critical: Array
    probability: Array
    error: Array

    @property
    def suspicious(self) -> npt.NDArray[np.bool_]:
        """Which points (n,) are beyond the limit."""
        return np.asarray(self.statistic > self.critical)


def point_tests(found: Fit, *, level: float = LEVEL) -> PointTests:
    """Test every control point.

    Parameters
    ----------
    found : Fit
    level : float
        Probability of a false alarm, each.
    """
    size, axes = np.linalg.eigh(found.residual_cofactors)
    checked = size > CHECKED
    along = np.einsum("nji,nj->ni", axes, found.whitened)
    share = np.where(checked, along / np.where(checked, size, 1.0), 0.0)
    t, d, f = np.sum(along * share, axis=1), checked.sum(axis=1), found.redundancy
    error = -np.einsum("nij,nj->ni", axes, share) * found.points.sigma
    free = f - d
    usable = (d > 0) & (free > 0)
    rest = np.maximum(found.weighted_squares - t, np.finfo(float).tiny)
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic = np.where(usable, t / d / (rest / free), np.nan)
        critical = np.where(usable, f_quantile(d, free, 1.0 - level), np.nan)
        probability = np.where(usable, f_tail(d, free, statistic), np.nan)
    error[~usable] = np.nan
    return PointTests(np.where(usable, d, 0), statistic, critical, probability, error)


def check_tests(found: Fit, check: Observations, residuals: Array, *, level: float = LEVEL) -> PointTests:
    """Test every check point against what the control points predict.

    With the residuals v of a point, its sigmas and the cofactors P of the prediction, ``C = diag(sigma^2) + P``:
    ``F = v^T C^-1 v/(2 m0^2)`` is F(2, f) without a gross error.

    Parameters
    ----------
    found : Fit
    check : Observations
    residuals : (n, 2) array
        Computed minus given, of the check points.
    level : float
        Probability of a false alarm, each.
    """
    n, f = len(check), found.redundancy
    cofactors = found.prediction_cofactors(check.source[:, : found.model.dimension])
    cofactors[:, [0, 1], [0, 1]] += check.sigma**2
    squares = np.einsum("ni,ni->n", residuals, np.linalg.solve(cofactors, residuals[:, :, None])[:, :, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic = squares / (2.0 * found.m0**2)
    critical = np.full(n, float(f_quantile(2, f, 1.0 - level)))
    return PointTests(np.full(n, 2), statistic, critical, f_tail(2, f, statistic), -residuals)


@dataclass(frozen=True)
class Pruning:
    """Result of :func:`prune`.

    Parameters
    ----------
    fit : Fit
        Of the points that are left.
    dropped : tuple of str
        Ids in the order in which they were left out.
    history : tuple of float
        RMS before each drop and at the end: one more than ``dropped``.
    """

    fit: Fit
    dropped: tuple[str, ...]
    history: tuple[float, ...]


def prune(
    points: Observations, model: Model, target_rms: float, *, rule: Rule = "residual",
    refit: Callable[[Observations], Fit] | None = None,
) -> Pruning:  # fmt: skip
    """Drop the worst point and fit again until the radial RMSE is small enough (İpbüker 1994, section 4.2.1).

    The RMSE that is left is no measure of accuracy: the points were chosen for it.

    Parameters
    ----------
    points : Observations
    model : Model
    target_rms : float
        Radial RMSE to reach, in the unit of the target.
    rule : "residual" or "test"
        Worst by length of residual, or by its probability in the F test.
    refit : callable, optional
        Instead of :func:`fg_orient.rectification.fit.fit` with the model.

    Raises
    ------
    InputError
        A target that is not above 0; see :func:`fg_orient.rectification.fit.fit`, also of a later fit, if the points
        left do not determine it.
    NoSolutionError
        The target is not reached with the fewest points that have redundancy, or a fit does not converge.
    """
    positive("RMSE to reach", target_rms, "the target's unit")
    again = refit or (lambda some: fit(some, model))
    found, dropped, history = again(points), list[str](), list[float]()
    while True:
        history.append(found.rmse[2])
        if history[-1] <= target_rms:
            return Pruning(found, tuple(dropped), tuple(history))
        left = found.points
        if len(left) <= model.least_points:
            raise NoSolutionError.of("rectify.prune", place=model.title, value=target_rms, reached=history[-1],
                                     points=len(left))  # fmt: skip
        worst = _worst(found, rule)
        dropped.append(left.ids[worst])
        found = again(left.take(np.arange(len(left)) != worst))


def _worst(found: Fit, rule: Rule) -> int:
    """Index of the worst point; without redundancy for the test, that of the largest residual."""
    lengths = np.linalg.norm(found.residuals, axis=1)
    if rule == "residual":
        return int(np.argmax(lengths))
    tests = point_tests(found)
    if np.isnan(tests.statistic).all():
        return int(np.argmax(lengths))
    smallest = np.nanmin(tests.probability)
    return int(np.nanargmax(np.where(tests.probability <= smallest, tests.statistic, np.nan)))
