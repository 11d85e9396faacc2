"""Points located after the adjustment: check points that took no part in it.

The whitened conditions of all rays of the point are minimised over its three coordinates
with the adjusted orientation held, so that images of different sigma and pixel size weigh
as in the adjustment. The same Jacobians propagate image noise and orientation cofactors
to the point: ``G = (A^T A)^-1 A^T``, ``Q = G (I + B Q_ee B^T) G^T``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.point_cofactors import cofactors_of_points
from fg_orient.adjustment.problem import Problem, State, whitened_records
from fg_orient.adjustment.rows import image_rows, rows_by_image

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

MAX_STEPS = 10
STEP_M = 1e-6


@dataclass(frozen=True)
class LocatedPoints:
    """Points located with the orientation of a state held.

    Parameters
    ----------
    problem : Problem
        All rays of these points, which are its only unknown ground points.
    state : State
    index : (n,) int array
        Ground points.
    lost : (m,) int array
        Those wanted whose steps did not end: their rays hardly meet, so they have no coordinates.
    """

    problem: Problem
    state: State
    index: Index
    lost: Index

    @property
    def ground_m(self) -> Array:
        """Coordinates (n, 3), ECEF m."""
        return np.asarray(self.state.ground[self.index] + self.problem.origin_m)

    def cofactors(self, blocks: Callable[[Index], Array]) -> Array:
        """Cofactors (n, 3, 3) m^2 from joint ones of the images; see ``cofactors_of_points``."""
        return cofactors_of_points(self.problem, self.state, self.index, blocks)


def locate_points(problem: Problem, state: State, start_m: Array, index: Index) -> LocatedPoints:
    """Locate ground points from all their rays, each by Gauss-Newton steps of its own.

    Parameters
    ----------
    problem : Problem
    state : State
        Its image unknowns count.
    start_m : (N, 3) array
        ECEF m, near the points wanted; the weights are those of the start. Other rows are not looked at.
    index : (n,) int array
        Ground points, each seen twice or more.
    """
    wanted = np.zeros(len(problem.active), bool)
    wanted[index] = True
    seen = problem.block.observations.take(wanted[problem.block.observations.point])
    records = whitened_records(problem.models, seen, start_m, problem.origin_m)
    own = replace(problem, observations=seen, records=records, active=wanted, observed=np.zeros_like(wanted))
    place = np.cumsum(wanted)[seen.point] - 1
    ground, ascending, rows = start_m - problem.origin_m, np.flatnonzero(wanted), rows_by_image(own)
    moving = np.ones(len(ascending), bool)
    for _ in range(MAX_STEPS):
        step = _steps(own, State(state.image, ground), rows, place, len(ascending))
        ground[ascending[moving]] -= step[moving]
        moving &= np.abs(step).max(axis=1) >= STEP_M
        if not moving.any():
            break
    lost = ascending[moving]
    wanted[lost] = False
    keep = wanted[seen.point]
    own = replace(own, observations=seen.take(keep), records=records[keep], active=wanted)
    return LocatedPoints(own, State(state.image, ground), index[wanted[index]], lost)


def _steps(problem: Problem, state: State, rows: list[Index], place: Index, n: int) -> Array:
    """Gauss-Newton steps (n, 3) of the points; ``place`` is that of the point of each ray among them."""
    normal, right = np.zeros((n, 3, 3)), np.zeros((n, 3))
    for k, own in enumerate(rows):
        value, _, d_ground = image_rows(problem, state, k, own, jacobian=True)
        np.add.at(normal, place[own], np.einsum("nri,nrj->nij", d_ground, d_ground))
        np.add.at(right, place[own], np.einsum("nri,nr->ni", d_ground, value))
    return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, :, 0])
