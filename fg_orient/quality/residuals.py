"""Cofactors of the residuals, ``Q_vv = I - A N^-1 A^T``, of all observations; their traces are redundancy numbers.

Everything is whitened: residuals are divided by their a priori sigmas, so that without unknowns Q_vv = I. Formed point
by point from the cofactors of the images (``fg_orient.adjustment.cofactors``); where own observations name a
ground point, from joint cofactors. The sum of all redundancy numbers is the redundancy (Baarda 1968).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.cofactors import RayCofactors, blocks_of_images, cofactors_of_rays, inverse_roots
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows
from fg_orient.model.block import ExtraObservation
from fg_orient.quality.covariance import Cofactors

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ResidualCofactors:
    """Cofactors of the residuals, whitened; prior scale.

    Parameters
    ----------
    image : (n, 2, 2) array
        Blocks of the image points, in the order of ``problem.observations``.
    control : (m, 3, 3) array
        Blocks of the control points ``np.flatnonzero(problem.observed)``, in the rows of their factor
        ``W (G - G_0)``.
    prior : (u,) array
        Redundancy numbers of the prior observations, in the order of ``problem.image_vector``: one for an unknown that
        images have in common; empty without priors.
    extra : tuple of (m_e,) arrays
        Redundancy numbers of the rows of each own observation.
    rays : RayCofactors
        What they were made of: cofactors of adjusted image points, points and images.
    """

    image: Array
    control: Array
    prior: Array
    extra: tuple[Array, ...]
    rays: RayCofactors

    @property
    def redundancy_sum(self) -> float:
        """Sum of all redundancy numbers; but for rounding ``problem.redundancy``."""
        blocks = sum(float(np.einsum("nii->", block)) for block in (self.image, self.control))
        return blocks + sum(float(np.sum(numbers)) for numbers in (self.prior, *self.extra))


def residual_cofactors(problem: Problem, state: State, cofactors: Cofactors) -> ResidualCofactors:
    """Cofactors of all residuals at a solution.

    Parameters
    ----------
    problem : Problem
        Under a loss the one with the weights at the solution (``fg_orient.adjustment.robust.weighted_problem``).
    state : State
        The solution.
    cofactors : Cofactors
        Of any backend.

    Returns
    -------
    ResidualCofactors
    """
    rays = cofactors_of_rays(
        problem, state, lambda pairs: blocks_of_images(problem, lambda images: cofactors.joint(images, ()), pairs)
    )
    if problem.block.extra:
        _through_own_observations(problem, state, cofactors, rays)
    w = problem.control_weights(problem.observed)
    return ResidualCofactors(
        np.eye(2) - rays.fitted,
        np.eye(3) - w @ rays.points[problem.observed] @ np.swapaxes(w, 1, 2),
        1.0 - _variances(problem, rays) if problem.block.options.priors else np.zeros(0),
        tuple(_of_extra(problem, state, cofactors, extra) for extra in problem.block.extra),
        rays,
    )


def _variances(problem: Problem, rays: RayCofactors) -> Array:
    """Cofactors (u,) of the image unknowns, those in common once."""
    sizes = np.diff(problem.first).tolist()
    wide = np.concatenate([np.diag(q)[:size] for q, size in zip(rays.images, sizes, strict=True)])
    return wide if problem.ties is None else wide[problem.ties.place]


def _through_own_observations(problem: Problem, state: State, cofactors: Cofactors, rays: RayCofactors) -> None:
    """Replace what concerns ground points that own observations name: more than their rays determines them."""
    arguments = (a for extra in problem.block.extra for a in problem.extra_arguments(extra))
    named = sorted({a.index for a in arguments if not a.is_image and a.constant is None})
    o, rays_of = problem.observations, dict(problem.rows_by_point())
    for j in named:
        images = tuple(np.unique(o.image[rays_of[j]]).tolist())
        q = cofactors.joint(images, (j,))
        first = np.concatenate([[0], np.cumsum([len(problem.parameters[k]) for k in images])])
        rays.points[j] = q[-3:, -3:]
        for at, k in enumerate(images):
            rows = rays_of[j][o.image[rays_of[j]] == k]
            _, d_image, d_ground = image_rows(problem, state, k, rows, jacobian=True)
            columns = np.r_[first[at] : first[at + 1], first[-1] : first[-1] + 3]
            design = np.concatenate([d_image, d_ground], axis=2)
            effect = q[:, columns] @ np.swapaxes(design, 1, 2)
            rays.fitted[rows] = design @ effect[:, columns]
            rays.response[rows] = effect[:, -3:]
            root = inverse_roots(rays.images[k : k + 1], np.diff(first[at : at + 2]))[0, : first[at + 1] - first[at]]
            own = root[:, : len(root)] @ effect[:, first[at] : first[at + 1]]
            rays.on_image[rows] = np.linalg.norm(own, axis=1)


def _of_extra(problem: Problem, state: State, cofactors: Cofactors, extra: ExtraObservation) -> Array:
    """Redundancy numbers of the rows of an own observation."""
    _, blocks = extra_blocks(problem, extra, state, jacobian=True)
    parts: dict[tuple[bool, int], Array] = {}
    for a, block in blocks:
        parts[a.is_image, a.index] = parts.get((a.is_image, a.index), 0.0) + block
    images, points = (tuple(index for is_image, index in parts if is_image is kind) for kind in (True, False))
    q = cofactors.joint(images, points)
    design = np.hstack([parts[True, k] for k in images] + [parts[False, j] for j in points])
    return np.asarray(1.0 - np.einsum("ri,ij,rj->r", design, q, design))
