"""Each point tested for a gross error, and the pruning of İpbüker 1994.

A control point is tested against all others, a check point against the fit.

With the whitened residuals v of a point and their cofactors Q: ``T = v^T Q^-1 v`` and
``F = (T/d)/((S - T)/(f - d))``, S the sum of all squares, f the redundancy, d the rank of Q: F(d, f - d) without a
gross error, the scale estimated without the suspect (``fg_orient.quality.hypotheses``, test "t"). A table of points has
one column for it, so it is F for d = 1, too, where the bundle adjustment gives its root t.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from fg_orient.model.distributions import f_quantile, f_tail
from fg_orient.model.errors import NoSolutionError
from fg_orient.quality.hypotheses import can_be_tested, f_statistics
from fg_orient.quality.rejection import reject
from fg_orient.quality.suspects import quadratic
from fg_orient.rectification.arguments import positive
from fg_orient.rectification.fit import Fit, Observations, fit
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
    t, d, whitened = quadratic(found.whitened, found.residual_cofactors)
    error, free = -whitened * found.points.sigma, found.redundancy - d
    usable = can_be_tested(d, found.redundancy, "t")
    with np.errstate(divide="ignore", invalid="ignore"):
        statistic = np.where(usable, f_statistics(t, d, found.weighted_squares, found.redundancy), np.nan)
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
    n, history = len(points), list[float]()

    def left(out: Sequence[int]) -> npt.NDArray[np.intp]:
        return np.setdiff1d(np.arange(n), np.array(out, np.intp))

    def worst(found: Fit, out: Sequence[int]) -> int | None:
        history.append(found.rmse[2])
        return None if history[-1] <= target_rms else int(left(out)[_worst(found, rule)])

    end = reject(again(points), lambda out, _: again(points.take(left(out))), worst, n - model.least_points)
    if end.worst is not None:
        raise NoSolutionError.of("rectify.prune", place=model.title, value=target_rms, reached=history[-1],
                                 points=len(end.fit.points))  # fmt: skip
    return Pruning(end.fit, tuple(points.ids[k] for k in end.out), tuple(history))


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
