"""Test points for gross errors; prune points as in İpbüker 1994.

A control point is tested against all others, a check point against the fit.

v are the whitened residuals of a point, Q their cofactors, S the sum of all squares, f
the redundancy, d the rank of Q. ``T = v^T Q^-1 v`` and ``F = (T/d)/((S - T)/(f - d))``.
Without a gross error F has the distribution F(d, f - d); the scale is estimated without
the suspect (``fg_orient.quality.hypotheses``, test "t"). The table of points has one
column for the statistic. Therefore it is F also for d = 1, for which the bundle
adjustment gives its root t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.model.distributions import f_quantile, f_tail
from fg_orient.model.errors import NoSolutionError
from fg_orient.quality.hypotheses import can_be_tested, f_statistics, quadratic
from fg_orient.quality.rejection import reject
from fg_orient.rectification.arguments import positive
from fg_orient.rectification.fit import Observations, TransformationFit, fit

Rule = Literal["residual", "test"]

#: Probability of a false alarm of each test, as in the bundle adjustment.
LEVEL: Final = 0.001
#: Rounding errors are below this number of spacings of floating-point numbers of the size of the coordinates.
ROUNDING: Final = 64.0


@dataclass(frozen=True)
class PointTests:
    """Test of every point; nan for points that the other points do not check.

    Parameters
    ----------
    dimension : (n,) int array
        d; 0 for points that the others do not check.
    statistic, critical, probability : (n,) array
        F, its limit, and the probability of such an F without a gross error.
    error : (n, 2) array
        Estimated gross error of the target coordinates (given minus true), in their unit.
    rounding : float
        Smaller errors are rounding errors of exact coordinates, not gross errors.
    """

    dimension: Index
    statistic: Array
    critical: Array
    probability: Array
    error: Array
    rounding: float

    @property
    def suspicious(self) -> Mask:
        """True for each point that exceeds its limit (n,)."""
        return np.asarray((self.statistic > self.critical) & (np.hypot(*self.error.T) > self.rounding))


def rounding_of(points: Observations) -> float:
    """Return the size of rounding errors of the target coordinates, in their unit."""
    return float(ROUNDING * np.finfo(float).eps * np.abs(points.target).max(initial=0.0))


def point_tests(fitted: TransformationFit) -> PointTests:
    """Test every control point against all others.

    Parameters
    ----------
    fitted : TransformationFit
        Adjusted transformation of n control points.

    Returns
    -------
    PointTests
        Arrays (n,), estimated gross errors (n, 2) in the unit of the target.
    """
    t, d, whitened = quadratic(fitted.whitened, fitted.residual_cofactors)
    error, free = -whitened * fitted.points.sigma, fitted.redundancy - d
    usable = can_be_tested(d, fitted.redundancy, "t")
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic = np.where(usable, f_statistics(t, d, fitted.weighted_squares, fitted.redundancy), np.nan)
        critical = np.where(usable, f_quantile(d, free, 1.0 - LEVEL), np.nan)
        probability = np.where(usable, f_tail(d, free, statistic), np.nan)
    error[~usable] = np.nan
    return PointTests(np.where(usable, d, 0), statistic, critical, probability, error, rounding_of(fitted.points))


def check_tests(fitted: TransformationFit, check: Observations, residuals: Array) -> PointTests:
    """Test every check point against its prediction from the control points.

    With the residuals v of a point, its sigmas and the cofactors P of the prediction, ``C
    = diag(sigma^2) + P``: ``F = v^T C^-1 v/(2 m0^2)`` is F(2, f) without a gross error.

    Parameters
    ----------
    fitted : TransformationFit
    check : Observations
    residuals : (n, 2) array
        Residuals of the check points, computed minus given.
    """
    n, f = len(check), fitted.redundancy
    cofactors = fitted.prediction_cofactors(check.source[:, : fitted.model.dimension])
    cofactors[:, [0, 1], [0, 1]] += check.sigma**2
    squares = np.einsum("ni,ni->n", residuals, np.linalg.solve(cofactors, residuals[:, :, None])[:, :, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic = squares / (2.0 * fitted.m0**2)
    critical = np.full(n, float(f_quantile(2, f, 1.0 - LEVEL)))
    return PointTests(np.full(n, 2), statistic, critical, f_tail(2, f, statistic), -residuals, rounding_of(check))


class Pruning(NamedTuple):
    """Fit of the remaining points, ids of the excluded points in order, and radial RMSE before each and at the end."""

    fit: TransformationFit
    dropped: tuple[str, ...]
    history: tuple[float, ...]


def prune(first: TransformationFit, target_rms: float, *, rule: Rule = "residual") -> Pruning:
    """Leave out the worst point and fit again until the radial RMSE is small enough (İpbüker 1994, section 4.2.1).

    The remaining RMSE does not measure accuracy, because the points were selected by it.

    Parameters
    ----------
    first : TransformationFit
        Fit of all points.
    target_rms : float
        Radial RMSE to reach, in the unit of the target.
    rule : "residual" or "test"
        The worst point has the longest residual, or the smallest probability in the F test.

    Raises
    ------
    InputError
        The target is not above 0, or the remaining points do not determine the
        transformation; see :func:`fg_orient.rectification.fit.fit`.
    NoSolutionError
        The target is not reached with the smallest number of points that has redundancy,
        or a fit does not converge.
    """
    positive("RMSE to reach", target_rms, "the target's unit")
    points, t, history = first.points, first.transformation, list[float]()

    def left(out: Sequence[int]) -> Index:
        return np.setdiff1d(np.arange(len(points)), np.array(out, np.intp))

    def worst(fitted: TransformationFit, out: Sequence[int]) -> list[int]:
        history.append(fitted.rmse[2])
        return [] if history[-1] <= target_rms else [int(left(out)[_worst(fitted, rule)])]

    def again(out: Sequence[int], _: object) -> TransformationFit:
        some = points.take(left(out))
        return fit(some, t.model, source_names=t.source_names, target_names=t.target_names, crs=t.crs)

    end = reject(first, again, worst, len(points) - t.model.least_points)
    if end.worst is not None:
        raise NoSolutionError.of(
            "rectify.prune", place=t.model.title, value=target_rms, reached=history[-1], points=len(end.fit.points)
        )
    return Pruning(end.fit, tuple(points.ids[k] for k in end.out), tuple(history))


def _worst(fitted: TransformationFit, rule: Rule) -> int:
    """Return the index of the worst point. Without redundancy, it is the point with the longest residual."""
    tests = point_tests(fitted) if rule == "test" else None
    if tests is None or np.isnan(tests.statistic).all():
        return int(np.argmax(np.linalg.norm(fitted.residuals, axis=1)))
    smallest = np.nanmin(tests.probability)
    return int(np.nanargmax(np.where(tests.probability <= smallest, tests.statistic, np.nan)))
