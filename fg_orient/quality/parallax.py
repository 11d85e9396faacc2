"""y-parallax: by how much the rays of a point in two images miss each other, in pixels.

Four pixel coordinates determine three ground coordinates; what is left is one number. It is the whole result of a
relative adjustment: without control points nothing says where the block lies, so there is no accuracy to speak of.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.resection import locate_points

Array = npt.NDArray[np.float64]


def y_parallaxes(problem: Problem, state: State) -> tuple[npt.NDArray[np.intp], Array]:
    """Parallaxes of the tie and check points seen in exactly two images, with the orientation of a state held.

    Each point is located anew from its two rays: coordinates play no part.

    Parameters
    ----------
    problem : Problem
    state : State
        Its image unknowns count; ``problem.start`` is the metadata orientation.

    Returns
    -------
    points : (n,) int array
        Ground points.
    parallax_px : (n,) array, not negative
        Mismatch in one image if the other one is held: root of twice the squares of the four residuals.
    """
    o = problem.observations
    rays = np.bincount(o.point, minlength=len(problem.active))
    wanted = np.flatnonzero((rays == 2) & problem.active & ~problem.observed)
    ground = state.ground.copy()
    if len(wanted):
        located = locate_points(problem, state, problem.start.ground + problem.origin_m, wanted)
        ground[wanted] = located.state.ground[wanted]
    v = problem.pixel_residuals(State(state.image, ground))
    squares = np.bincount(o.point, (v**2).sum(axis=1), minlength=len(problem.active))
    return wanted, np.sqrt(2.0 * squares[wanted])


def rms_px(parallax_px: Array) -> float:
    """Root mean square of parallaxes; nan without any."""
    return float(np.sqrt(np.mean(parallax_px**2))) if len(parallax_px) else float("nan")
