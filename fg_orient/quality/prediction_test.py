"""Is the predicted accuracy honest? Differences at check points against their predicted covariance.

With e the differences of n check points (adjusted minus measured) and C the joint covariance of both, in prior scale,
``T = e^T C^-1 e`` is chi2(3n) distributed where model and sigmas hold (normalised estimation error squared: Bar-Shalom
et al. 2001, 5.4). Check points share the errors of the orientation, so C is no block diagonal: the sum of their single
normalised errors has the mean 3n, too, but a larger variance, and testing it like chi2(3n) would blame good
predictions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, State
from fg_orient.model.distributions import chi_square_interval, normal_probability, sidak, t_quantile
from fg_orient.model.errors import NoSolutionError
from fg_orient.quality.accuracy import AXES, PointDifferences
from fg_orient.quality.covariance import Cofactors

Array = npt.NDArray[np.float64]

#: Probability of the interval of T, and of the bias test.
CONFIDENCE: Final = 0.95
#: Of more check points so many, evenly taken, are tested jointly.
MAX_JOINT: Final = 60


@dataclass(frozen=True)
class PredictionTest:
    """Result of :func:`prediction_test`.

    Parameters
    ----------
    n : int
        Check points.
    n_joint : int
        Those tested jointly.
    within : (3, 3) int array
        Differences East, North, Up (rows) within 1, 2, 3 standard deviations.
    statistic : float
        T.
    interval : (float, float)
        95 % of T where the prediction holds.
    """

    n: int
    n_joint: int
    within: npt.NDArray[np.intp]
    statistic: float
    interval: tuple[float, float]

    @property
    def degrees(self) -> int:
        """Degrees of freedom of T."""
        return 3 * self.n_joint

    @property
    def factor(self) -> float:
        """How many times as large as predicted the errors are."""
        return float(np.sqrt(self.statistic / self.degrees))

    @property
    def honest(self) -> bool:
        """Whether T lies in its interval."""
        return self.interval[0] <= self.statistic <= self.interval[1]

    def sentence(self) -> str:
        """The verdict in words."""
        size = f"errors at check points are {self.factor:.2f} times as large as predicted"
        if self.honest:
            return f"the predicted accuracy holds: {size}"
        return f"the predicted accuracy is too {'optimistic' if self.factor > 1.0 else 'pessimistic'}: {size}"

    def as_dict(self) -> dict[str, Any]:
        """Give the record as plain values."""
        names = ("within_1_sigma", "within_2_sigma", "within_3_sigma")
        counts = {axis: dict(zip(names, row.tolist(), strict=True))
                  for axis, row in zip(AXES[:3], self.within, strict=True)}  # fmt: skip
        expected = dict(zip(names, (2.0 * normal_probability([1.0, 2.0, 3.0]) - 1.0).tolist(), strict=True))
        return {
            "n": self.n, "n_joint": self.n_joint, **counts, "expected_share": expected, "nees": self.statistic,
            "degrees_of_freedom": self.degrees, "interval_95": list(self.interval), "factor": self.factor,
            "honest": self.honest, "sentence": self.sentence(),
        }  # fmt: skip


def prediction_test(problem: Problem, state: State, cofactors: Cofactors, check: PointDifferences) -> PredictionTest:
    """Test the predicted covariance of the check points.

    Parameters
    ----------
    problem : Problem
    state : State
        The solution.
    cofactors : Cofactors
        Prior scale.
    check : PointDifferences

    Raises
    ------
    NoSolutionError
        There are no check points, or they are no unknowns of the adjustment (``check_points = "exclude"``): their joint
        covariance is not formed.
    """
    if not len(check):
        raise NoSolutionError.of("accuracy.no_check")
    if not problem.active[check.index].all():
        raise NoSolutionError.of("accuracy.check_excluded")
    rows = np.unique(np.linspace(0, len(check) - 1, min(len(check), MAX_JOINT)).astype(int))
    index = check.index[rows]
    turn = problem.axes(np.ascontiguousarray(state.ground[index] + problem.origin_m))
    q = cofactors.joint((), tuple(index.tolist())).reshape(len(rows), 3, len(rows), 3)
    q = np.einsum("aij,ajbk,blk->aibl", turn, q, turn).reshape(3 * len(rows), -1)
    c = q + np.diag(check.own_sigma_enu_m[rows].ravel() ** 2)
    e = check.enu_m[rows].ravel()
    within = np.stack([(check.ratio <= k).sum(axis=0) for k in (1.0, 2.0, 3.0)], axis=1)
    return PredictionTest(len(check), len(rows), within, float(e @ np.linalg.solve(c, e)),
                          chi_square_interval(len(e), 1.0 - CONFIDENCE))  # fmt: skip


def bias_test(points: PointDifferences) -> dict[str, dict[str, float | bool]]:
    """Student's test of the mean difference per axis: mean, t, limit, biased; 5 % over the three axes (Sidak).

    Whether the mean stands out of the scatter of these points; it cannot tell a systematic error from what the errors
    of the orientation have in common at all of them. Empty below two points or without scatter.
    """
    out: dict[str, dict[str, float | bool]] = {}
    n = len(points)
    if n < 2:
        return out
    limit = float(t_quantile(n - 1, 1.0 - 0.5 * sidak(1.0 - CONFIDENCE, 3)))
    for axis, d in zip(AXES[:3], points.enu_m.T, strict=False):
        sd = float(d.std(ddof=1))
        if sd > 0.0:
            t = float(d.mean()) / (sd / np.sqrt(n))
            out[axis] = {"mean_m": float(d.mean()), "t": float(t), "limit": limit, "biased": bool(abs(t) > limit)}
    return out
