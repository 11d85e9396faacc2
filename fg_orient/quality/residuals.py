"""Residuals of a solution with their cofactors: common input of reliability, outlier tests and variance components.

Cofactors of the residuals are ``Q_vv = I - A N^-1 A^T``; the traces are redundancy numbers, and their sum is the
redundancy (Baarda 1968). Residuals are whitened (divided by their a priori sigmas), adjusted minus observed. The
cofactors are formed point by point from those of the images (``fg_orient.adjustment.cofactors``), for ground points
that extra observations name from joint cofactors.

Order of all rows: image points (line, sample), weighted control points ``np.flatnonzero(problem.observed)`` (East,
North, Up; X, Y, Z in a local system), priors, extra observations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.cofactors import RayCofactors, blocks_of_images, cofactors_of_rays, inverse_roots
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows, residuals
from fg_orient.model.block import ExtraObservation
from fg_orient.quality.covariance import Cofactors
from fg_orient.quality.elimination import control_residuals, control_rows

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ResidualCofactors:
    """Residuals of a solution and their cofactors, whitened, prior scale; each is computed at first use.

    Parameters
    ----------
    problem : Problem
        Under a loss the problem with the weights at the solution (``fg_orient.adjustment.robust.weighted_problem``).
    state : State
        The solution.
    cofactors : Cofactors
        Of any backend.
    """

    problem: Problem
    state: State
    cofactors: Cofactors

    @cached_property
    def v_image(self) -> Array:
        """Residuals (n, 2) of the image points, in the order of ``problem.observations``."""
        return residuals(self.problem, self.state)

    @cached_property
    def v_control(self) -> Array:
        """Residuals (m, 3) of the control points."""
        return control_residuals(self.problem, self.state)

    @cached_property
    def v_prior(self) -> Array:
        """Residuals (u,) of the priors, in the order of ``problem.image_vector``; empty without priors."""
        return self.problem.image_vector(self.state) if self.problem.block.options.priors else np.zeros(0)

    @cached_property
    def control_rows(self) -> Array:
        """Derivatives (m, 3, 3) of the residuals of control points with respect to the point, per metre."""
        return control_rows(self.problem, np.flatnonzero(self.problem.observed))

    @property
    def image(self) -> Array:
        """Cofactors (n, 2, 2) of the residuals of each image point."""
        return np.asarray(np.eye(2) - self.rays.fitted)

    @property
    def control(self) -> Array:
        """Cofactors (m, 3, 3) of the residuals of each control point."""
        w, points = self.control_rows, self.rays.points[self.problem.observed]
        return np.asarray(np.eye(3) - w @ points @ np.swapaxes(w, 1, 2))

    @property
    def prior(self) -> Array:
        """Redundancy numbers (u,) of the priors, shared unknowns once; empty without priors."""
        problem = self.problem
        if not problem.block.options.priors:
            return np.zeros(0)
        sizes = np.diff(problem.first).tolist()
        wide = np.concatenate([np.diag(q)[:size] for q, size in zip(self.rays.images, sizes, strict=True)])
        return np.asarray(1.0 - (wide if problem.ties is None else wide[problem.ties.place]))

    @cached_property
    def extra(self) -> tuple[Array, ...]:
        """Redundancy numbers (m_e,) of the rows of each extra observation."""
        return tuple(self._of_extra(extra) for extra in self.problem.block.extra)

    @property
    def redundancy_sum(self) -> float:
        """Sum of all redundancy numbers; apart from rounding ``problem.redundancy``."""
        blocks = sum(float(np.einsum("nii->", block)) for block in (self.image, self.control))
        return blocks + sum(float(np.sum(numbers)) for numbers in (self.prior, *self.extra))

    @cached_property
    def rays(self) -> RayCofactors:
        """Cofactors of adjusted image points, points and images."""

        def joint(images: tuple[int, ...]) -> Array:
            return self.cofactors.joint(images, ())

        rays = cofactors_of_rays(self.problem, self.state, lambda pairs: blocks_of_images(self.problem, joint, pairs))
        if named := self.problem.named_points():
            self._correct_named_points(rays, named)
        return rays

    def _correct_named_points(self, rays: RayCofactors, named: list[int]) -> None:
        """Replace the cofactors of ground points that extra observations name: more than their rays determines them."""
        problem, o = self.problem, self.problem.observations
        for j in named:
            own_rays = np.flatnonzero(o.point == j)
            images = tuple(np.unique(o.image[own_rays]).tolist())
            q = self.cofactors.joint(images, (j,))
            first = np.concatenate([[0], np.cumsum([len(problem.parameters[k]) for k in images])])
            rays.points[j] = q[-3:, -3:]
            for at, k in enumerate(images):
                rows = own_rays[o.image[own_rays] == k]
                _, d_image, d_ground = image_rows(problem, self.state, k, rows, jacobian=True)
                columns = np.r_[first[at] : first[at + 1], first[-1] : first[-1] + 3]
                design = np.concatenate([d_image, d_ground], axis=2)
                effect = q[:, columns] @ np.swapaxes(design, 1, 2)
                rays.fitted[rows] = design @ effect[:, columns]
                rays.response[rows] = effect[:, -3:]
                root = inverse_roots(rays.images[k : k + 1], np.diff(first[at : at + 2]))[0, : d_image.shape[2]]
                own = root[:, : len(root)] @ effect[:, first[at] : first[at + 1]]
                rays.on_image[rows] = np.linalg.norm(own, axis=1)

    def _of_extra(self, extra: ExtraObservation) -> Array:
        """Redundancy numbers of the rows of an extra observation."""
        _, blocks = extra_blocks(self.problem, extra, self.state, jacobian=True)
        parts: dict[tuple[bool, int], Array] = {}
        for a, block in blocks:
            parts[a.is_image, a.index] = parts.get((a.is_image, a.index), 0.0) + block
        images, points = (tuple(index for is_image, index in parts if is_image is kind) for kind in (True, False))
        q = self.cofactors.joint(images, points)
        design = np.hstack([parts[True, k] for k in images] + [parts[False, j] for j in points])
        return np.asarray(1.0 - np.einsum("ri,ij,rj->r", design, q, design))
