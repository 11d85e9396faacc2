"""Points located after the adjustment: check points that took no part in it.

The whitened conditions of all rays of the point are minimised over its three coordinates
with the adjusted orientation held, so that images of different sigma and pixel size weigh
as in the adjustment. The same Jacobians propagate image noise and orientation cofactors
to the point: ``G = (A^T A)^-1 A^T``, ``Q = G (I + B Q_ee B^T) G^T``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, State, whitened_records

Array = npt.NDArray[np.float64]

MAX_STEPS = 10
STEP_M = 1e-6


@dataclass(frozen=True)
class LocatedPoint:
    """One point: ECEF (3,) m, images that see it, whitened Jacobians (2v, 3) and (2v, u)."""

    ground_m: Array
    images: tuple[int, ...]
    d_ground: Array
    d_images: Array

    def cofactors(self, q_images: Array) -> Array:
        """Cofactors (3, 3) m^2 from the joint cofactors of ``images`` (prior sigmas)."""
        gain = np.linalg.pinv(self.d_ground)
        noise = np.eye(len(self.d_ground)) + self.d_images @ q_images @ self.d_images.T
        return np.asarray(gain @ noise @ gain.T)


def locate_point(problem: Problem, state: State, start_m: Array, j: int) -> LocatedPoint:
    """Locate point ``j`` from all its rays, from a start near it (ECEF m).

    The weights are those of the start; it comes from the nearest point of the rays.
    """
    block, models = problem.block, problem.models
    seen = block.observations.take(np.flatnonzero(block.observations.point == j))
    everywhere = np.repeat(start_m[None], len(block.points.ids), axis=0)
    records = whitened_records(models, seen, everywhere, problem.origin_m)
    x = [problem.unknowns(state, int(k)) for k in seen.image]
    own = [models[int(k)] for k in seen.image]
    ground = start_m - problem.origin_m
    for _ in range(MAX_STEPS):
        rows = [
            model.equation.kernel(records[r], model.parameters.setup, x[r], ground, True) for r, model in enumerate(own)
        ]
        value, d_ground = np.concatenate([row[0] for row in rows]), np.vstack([row[2] for row in rows])
        step = np.linalg.lstsq(d_ground, value, rcond=None)[0]
        ground = ground - step
        if np.abs(step).max() < STEP_M:
            break
    images = tuple(dict.fromkeys(int(k) for k in seen.image))
    first = np.concatenate([[0], np.cumsum([len(problem.parameters[k]) for k in images])])
    d_images = np.zeros((2 * len(seen), first[-1]))
    for r, k in enumerate(seen.image):
        at = images.index(int(k))
        d_images[2 * r : 2 * r + 2, first[at] : first[at + 1]] = rows[r][1]
    return LocatedPoint(ground + problem.origin_m, images, d_ground, d_images)
