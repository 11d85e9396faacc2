"""Expected errors of ground points after a regularised adjustment: noise of the observations and bias together.

With the rows A of the image unknowns, ground points eliminated, the error of a regularised estimate x is ``(K - I) t +
G e`` (``fg_orient.quality.resolution``). t is the true deviation from the metadata, e the noise; ``G = Q A^T`` and
``K = G A``. A ground point with the Jacobians B of its rays to the images and C to the point follows the images by
``-(C^T C)^-1 C^T B``. The noise of its own rays is independent of e, because A is orthogonal to C. For t ~ N(0, 1) in
prior sigmas the products of the errors of points have the expectation

    H ((K - I) (K - I)^T + G G^T) H^T + diag (C^T C)^-1,   H = -(C^T C)^-1 C^T B

A covariance contains only the terms of the noise, ``G G^T`` and ``(C^T C)^-1``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from factors.arrays import Array, Index
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import Rows, linearised
from fg_orient.quality.elimination import image_columns
from fg_orient.quality.resolution import Resolution, resolution


class ExpectedErrors(NamedTuple):
    """Expected products (3k, 3k) of the errors of points, m^2, ECEF axes: of all errors, and of the bias alone."""

    total: Array
    bias: Array


def expected_errors(problem: Problem, state: State, points: Index) -> ExpectedErrors | None:
    """Return expected products of the errors of adjusted points, for true deviations of one prior sigma.

    Parameters
    ----------
    problem : Problem
        Regularised; under a loss with its weights.
    state : State
        The solution.
    points : (k,) int array
        Rows in the block's ground points: unknown points with rays only, not control points.

    Returns
    -------
    ExpectedErrors or None
        None for a block of more than 2000 image unknowns, and for points that are not unknowns, are observed or are
        named by extra observations.
    """
    chosen, named = problem.regularisation, problem.named_points()
    plain = problem.active[points] & ~problem.observed[points] & ~np.isin(points, named)
    if chosen is None or chosen.standard is None or not len(points) or not plain.all():
        return None
    found, rows = resolution(problem, state), linearised(problem, state)
    followed, own = zip(*(_of_point(problem, rows, int(j)) for j in points), strict=True)
    follow = np.vstack(followed)
    bias = follow @ _bias(found) @ follow.T
    return ExpectedErrors(bias + follow @ found.gain @ found.gain.T @ follow.T + block_diag(*own), bias)


def _bias(found: Resolution) -> Array:
    """Return the expected products (z, z) of the biases of the image unknowns, in prior sigmas."""
    missing = found.matrix - np.eye(len(found.matrix))
    return np.asarray(missing @ missing.T)


def _of_point(problem: Problem, rows: Rows, point: int) -> tuple[Array, Array]:
    """Return a point's movement (3, z) per unit of each free image unknown, and its cofactors with fixed images."""
    own = np.flatnonzero(problem.observations.point == point)
    columns = image_columns(problem, problem.observations.image[own])
    design = np.zeros((len(own), 2, problem.n_free_unknowns))
    for k, row in enumerate(own.tolist()):
        np.add.at(design[k].T, columns[k], rows.image[row].T)  # columns that only fill up the array contain zeros
    ground = rows.ground[own].reshape(-1, 3)
    inverse = np.linalg.inv(ground.T @ ground)
    return -inverse @ ground.T @ design.reshape(len(ground), -1), np.asarray(inverse, np.float64)
