"""End of an adjustment in parts: the summed reduced system, and the cofactors it gives.

Images follow from the summed system, points from it and their own rays: no part is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised
from fg_orient.adjustment.schur_cofactors import Gain, ReducedCofactors
from fg_orient.adjustment.schur_reduced import Reduced

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True)
class SummedSystem:
    """The undamped reduced system at the solution, priors included.

    Parameters
    ----------
    state : State
    reduced : callable
        Factorises the system; raises ``Singular`` if it is not positive definite.
    """

    state: State
    reduced: Callable[[], Reduced]


class SummedCofactors(ReducedCofactors):
    """Joint cofactors at the solution.

    Parameters
    ----------
    problem : Problem
    summed : SummedSystem

    Raises
    ------
    RuntimeError
        The normal equations are too close to singular.
    """

    def __init__(self, problem: Problem, summed: SummedSystem) -> None:
        self._order = np.argsort(problem.observations.point, kind="stable")
        sorted_points = problem.observations.point[self._order]
        self._first = np.searchsorted(sorted_points, np.arange(len(problem.active) + 1))
        super().__init__(problem, summed.state, summed.reduced(), self._gain_of)
        self._of((0,))  # an ill-conditioned system is found when first asked, not when made

    def _gain_of(self, j: int) -> Gain:
        """See ``fg_orient.adjustment.schur_cofactors.Gain``."""
        problem, rows = self._problem, self._order[self._first[j] : self._first[j + 1]]
        normal, sums = np.zeros((3, 3)), dict[int, Array]()
        if problem.observed[j]:
            w = problem.control_weights(j)
            normal += w.T @ w
        rows = rows[np.argsort(problem.observations.image[rows], kind="stable")]
        _, d_image, d_ground = linearised(problem, self._state, rows)
        for k, by_image, by_point in zip(problem.observations.image[rows].tolist(), d_image, d_ground, strict=True):
            normal += by_point.T @ by_point
            sums[k] = sums.get(k, 0.0) + by_point.T @ by_image[:, : len(problem.parameters[k])]
        inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        return tuple(sums), inverse, inverse @ np.hstack(list(sums.values()))
