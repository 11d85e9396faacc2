"""Cofactors where the images are eliminated first (:mod:`fg_orient.adjustment.images_first`).

With the cofactors Q of the border and the movements ``x_i = T_i x_b`` of the images that follow it,

    Q_ib = T_i Q,    Q_ij = T_i Q T_j^T + delta_ij N_i^-1

so that the cofactors of an image and of its points need no matrix of all images.
"""

from __future__ import annotations

import numpy as np

from fg_orient.adjustment.cofactors import RayCofactors, Star, rays_of_star
from fg_orient.adjustment.images_border import ImagesBorder
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.unknown_cofactors import SpreadUnknowns
from fg_orient.model.arrays import Array, Index


class StarCofactors:
    """Cofactors from the inverse of a border of points; see ``fg_orient.quality.covariance.Cofactors``.

    Parameters
    ----------
    problem : Problem
    border : ImagesBorder
        At the solution.

    Raises
    ------
    RuntimeError
        The normal equations are too close to singular.
    """

    def __init__(self, problem: Problem, border: ImagesBorder) -> None:
        self.problem, self.border, self._q = problem, border, border.inverse
        places, images = border.places, border.images
        m, width = problem.columns.shape
        own = images.followed(np.eye(len(border)))
        # movements (M, k, b) of all unknowns of each image, and the inverse of its own normal matrix in their places
        self._follow, self._own = np.zeros((m, width + 1, len(border))), np.zeros((m, width + 1, width + 1))
        image, at = np.arange(m)[:, None], np.where(places.exists, places.own, width)
        self._follow[image, at] = own
        self._own[image[:, :, None], at[:, :, None], at[:, None]] = images.inverse
        self._follow, self._own = self._follow[:, :width], self._own[:, :width, :width]
        shared = np.argwhere(places.in_border >= 0)
        self._follow[shared[:, 0], shared[:, 1], places.in_border[places.in_border >= 0]] = 1.0
        self._across = self._follow @ self._q

    def image(self, k: int) -> Array:
        """See :class:`Cofactors`."""
        size = len(self.problem.parameters[k])
        return np.asarray(self.blocks(np.array([[k, k]]))[0, :size, :size])

    def point(self, j: int) -> Array:
        """See :class:`Cofactors`."""
        return np.asarray(self.points(np.array([j]))[0])

    def points(self, index: Index) -> Array:
        """See :class:`Cofactors`."""
        at = self.border.places.of_point[index][:, None] + np.arange(3)
        at = np.where(self.problem.active[index][:, None], at, 0)
        q = self._q[at[:, :, None], at[:, None]]
        return np.where(self.problem.active[index][:, None, None], q, 0.0)

    def blocks(self, pairs: Index) -> Array:
        """See :class:`Cofactors`."""
        row, column = pairs.T
        out = self._across[row] @ np.swapaxes(self._follow[column], 1, 2)
        same = row == column
        out[same] += self._own[row[same]]
        return np.asarray(out)

    def unknowns(self, places: Index) -> SpreadUnknowns:
        """See :class:`Cofactors`."""
        image = np.searchsorted(self.problem.first, places, side="right") - 1
        at = places - self.problem.first[image]
        return SpreadUnknowns(self._own, image, at, self._follow[image, at], self._q)

    def star(self) -> Star:
        """See :class:`Cofactors`."""
        images = self.blocks(np.tile(np.arange(self.problem.n_images)[:, None], 2))
        across = self._across[:, :, len(self.border.places.shared) :]
        return Star(images, across, self.points(np.flatnonzero(self.problem.active)))

    def rays(self, problem: Problem, state: State) -> RayCofactors:
        """See :class:`Cofactors`."""
        return rays_of_star(problem, state, self.star())

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`."""
        problem, b = self.problem, len(self.border)
        sizes = np.diff(problem.first)[list(images)] if images else np.zeros(0, np.intp)
        rows = [self._follow[k, :size] for k, size in zip(images, sizes.tolist(), strict=True)]
        at = self.border.places.of_point
        rows += [np.eye(3, b, int(at[j])) for j in points if problem.active[j]]
        effect = np.vstack([np.zeros((0, b)), *rows])
        out = effect @ self._q @ effect.T
        first = np.concatenate([[0], np.cumsum(sizes)])
        for a, i in enumerate(images):
            for c in np.flatnonzero(np.equal(images, i)).tolist():
                size = int(sizes[a])
                out[first[a] : first[a] + size, first[c] : first[c] + size] += self._own[i, :size, :size]
        return np.asarray(0.5 * (out + out.T))

    def times(self, columns: Array) -> Array:
        """Cofactors times columns (n, d), as in ``Problem.vector``."""
        problem, s, d = self.problem, len(self.border.places.shared), columns.shape[1]
        padded = np.vstack([columns[: problem.n_image_unknowns], np.zeros((1, d))])[problem.columns]
        right = np.einsum("mkb,mkd->bd", self._follow, padded)
        right[s:] += columns[problem.n_image_unknowns :]
        solved = self._q @ right
        image = self._follow @ solved + self._own @ padded
        wide = image[problem.columns < problem.n_image_unknowns]
        return np.vstack([wide, solved[s:]])
