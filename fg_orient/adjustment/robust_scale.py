"""Scale of the residuals of an adjustment, not affected by gross errors.

The scale is the ratio of residuals to sigmas from their median. A residual is smaller than its error, because the
unknowns absorb a part. With ground points free and the orientation of each image free (the others held fixed), image
point i keeps ``Q_i = Q_g - Q_g B N_k^-1 B^T Q_g``, ``Q_g = I - C M_j^-1 C^T`` (B, C: whitened Jacobians of image and
point; M_j, N_k: their normal matrices). Without gross errors ``T_i = v^T Q_i^+ v`` is nearly
chi-square of rank d, and::

    scale^2 = median over i of T_i / median(chi2_d)

For d = 1 this is the square of 1.4826 median|v| (Hampel 1974); for two dimensions the factor is 0.8493, for three
0.6501. Image points and control points have one scale each.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows, rows_by_image
from fg_orient.model.distributions import chi_square_median

#: Directions with a smaller share of their error in the residual are excluded from the scale: it is approximate.
CHECKED: Final = 0.1
#: With fewer residuals the scale is 1.
LEAST: Final = 10
#: Lower bound of the scale: residuals of zero would down-weight every other observation.
LOWEST: Final = 0.01


def robust_scale(problem: Problem, state: State) -> tuple[float, float]:
    """Scales of image points and of control points at a state, in sigmas; 1 with fewer than :data:`LEAST` ratios."""
    blocks = [
        (rows, *image_rows(problem, state, k, rows, jacobian=True)) for k, rows in enumerate(rows_by_image(problem))
    ]
    ground = _ground_cofactors(problem, [(rows, c) for rows, _, _, c in blocks])
    squares = [_of_image(problem, ground, *block) for block in blocks if len(block[0])]
    return _scale(np.concatenate(squares)), _scale(_of_control(problem, state, ground))


def _ground_cofactors(problem: Problem, blocks: list[tuple[npt.NDArray[np.intp], Array]]) -> Array:
    """Cofactors (N, 3, 3) of the unknown ground points, orientation held fixed; zero for all others."""
    rows, c = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    normal = problem.point_normals(problem.observations.point[rows], c)
    out = np.zeros_like(normal)
    out[problem.active] = np.linalg.pinv(normal[problem.active], rcond=1e-14, hermitian=True)
    return out


def _of_image(problem: Problem, ground: Array, rows: npt.NDArray[np.intp], v: Array, b: Array, c: Array) -> Array:
    """Ratios of T to the median of its chi-square, of the image points of one image."""
    q = np.eye(2) - np.einsum("nri,nij,nsj->nrs", c, ground[problem.observations.point[rows]], c)
    kept = np.einsum("nrs,nsu->nru", q, b)
    prior = np.eye(b.shape[2]) if problem.block.options.priors else 0.0
    orientation = np.linalg.pinv(np.einsum("nru,nrw->uw", b, kept) + prior, rcond=1e-14, hermitian=True)
    return _ratios(v, q - np.einsum("nru,uw,nsw->nrs", kept, orientation, kept))


def _of_control(problem: Problem, state: State, ground: Array) -> Array:
    """Ratios of the control points."""
    rows = np.flatnonzero(problem.observed)
    w, v = problem.control_weights(rows), problem.control_residuals(state, rows)
    return _ratios(v, np.eye(3) - np.einsum("nij,njk,nlk->nil", w, ground[rows], w))


def _ratios(v: Array, q: Array) -> Array:
    """Ratios of ``v^T Q^+ v`` to the median of chi-square of the rank of Q, where the rank is not zero."""
    size, axes = np.linalg.eigh(q)
    checked = size > CHECKED
    part = np.einsum("nij,ni->nj", axes, v)
    t = np.sum(np.where(checked, part**2 / np.where(checked, size, 1.0), 0.0), axis=1)
    d = checked.sum(axis=1)
    return np.asarray(t[d > 0] / chi_square_median(d[d > 0]))


def _scale(ratios: Array) -> float:
    return 1.0 if len(ratios) < LEAST else max(float(np.sqrt(np.median(ratios))), LOWEST)
