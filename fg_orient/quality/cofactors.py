"""Joint cofactors from three sources: one matrix, the border of the normal equations, or images eliminated first.

Unknowns are in prior sigmas (images) and metres (points); cofactors are in prior scale. Sources of cofactors:
``fg_orient.quality.covariance``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.border import Border, ImagesBorder
from fg_orient.adjustment.border_matrix import BorderMatrix
from fg_orient.adjustment.cofactors import (
    DenseUnknowns,
    RayCofactors,
    SpreadUnknowns,
    Star,
    UnknownCofactors,
    blocks_of_images,
    cofactors_of_points,
    cofactors_of_rays,
    rays_of_star,
)
from fg_orient.adjustment.problem import Problem, State


class PointCofactors(Protocol):
    """Cofactors of points and images, in prior scale; images in prior sigmas, points in m, ECEF axes."""

    def point(self, j: int) -> Array:
        """Return the cofactors (3, 3) of a ground point; zero for a fixed point."""
        ...

    def points(self, index: Index) -> Array:
        """Return the cofactors (n, 3, 3) of many ground points."""
        ...

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """Return the joint cofactors of images, then unknown points, in the given order."""
        ...

    def blocks(self, pairs: Index) -> Array:
        """Return the joint blocks (B, k, k) of pairs of images (B, 2), row <= column.

        Shorter blocks are filled with zeros.
        """
        ...


class Cofactors(PointCofactors, Protocol):
    """Joint cofactors at the solution."""

    def image(self, k: int) -> Array:
        """Return the cofactors (u, u) of an image's unknowns."""
        ...

    def unknowns(self, places: Index) -> UnknownCofactors:
        """Return the joint cofactors of image unknowns by their places (d,) in ``Problem.image_columns``, ascending."""
        ...

    def star(self) -> Star | None:
        """Return cofactors of images and points if images are eliminated first; else None."""
        ...

    def rays(self, problem: Problem, state: State) -> RayCofactors:
        """Return the cofactors of the image points of a problem.

        If :meth:`star` is None, they are not valid for points that extra observations name.
        """
        ...


class CommonCofactors(ABC):
    """Methods of :class:`Cofactors` that need only ``joint``, or ``points`` and ``blocks``."""

    problem: Problem

    @abstractmethod
    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`."""

    def image(self, k: int) -> Array:
        """See :class:`Cofactors`."""
        return self.joint((k,), ())

    def point(self, j: int) -> Array:
        """See :class:`Cofactors`."""
        return np.asarray(self.points(np.array([j]))[0])

    def points(self, index: Index) -> Array:
        """See :class:`Cofactors`."""
        out = np.zeros((len(index), 3, 3))
        for q, j in zip(out, index.tolist(), strict=True):
            if self.problem.active[j]:
                q[:] = self.joint((), (j,))
        return out

    def blocks(self, pairs: Index) -> Array:
        """See :class:`Cofactors`."""
        return blocks_of_images(self.problem, lambda images: self.joint(images, ()), pairs)

    def star(self) -> Star | None:
        """See :class:`Cofactors`."""
        return None

    def rays(self, problem: Problem, state: State) -> RayCofactors:
        """See :class:`Cofactors`."""
        return cofactors_of_rays(problem, state, self.blocks)


def places_of(problem: Problem, images: tuple[int, ...], points: tuple[int, ...]) -> Index:
    """Return the positions of images, then of unknown points, in ``Problem.vector``."""
    parts = [problem.image_slice(k) for k in images]
    parts += [problem.point_slice(j) for j in points if problem.active[j]]
    return np.concatenate([np.arange(part.start, part.stop) for part in parts])


@dataclass(frozen=True, eq=False)
class MatrixCofactors(CommonCofactors):
    """Cofactors of all unknowns as one matrix.

    Parameters
    ----------
    problem : Problem
    cofactors : (n, n) array
        In prior scale, columns as in ``Problem.vector``.
    """

    problem: Problem
    cofactors: Array

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`."""
        index = places_of(self.problem, images, points)
        return np.asarray(self.cofactors[np.ix_(index, index)])

    def unknowns(self, places: Index) -> DenseUnknowns:
        """See :class:`Cofactors`."""
        return DenseUnknowns(self.cofactors[np.ix_(places, places)])

    def times(self, columns: Array) -> Array:
        """Return the cofactors times columns (n, d)."""
        return np.asarray(self.cofactors @ columns)


class BorderCofactors(CommonCofactors):
    """Cofactors from the inverse of the border; see :class:`Cofactors`.

    Parameters
    ----------
    problem : Problem
    border : Border
        Border at the solution.

    Raises
    ------
    RuntimeError
        RuntimeError :: The normal equations are too close to singular.
    """

    def __init__(self, problem: Problem, border: Border) -> None:
        self.problem, self.border, self._q = problem, border, border.inverse
        self._columns = [border.free_columns[problem.image_slice(k)] for k in range(problem.n_images)]

    def points(self, index: Index) -> Array:
        """See :class:`Cofactors`."""
        border = self.border
        out = cofactors_of_points(border.eliminated, border.state, index, self.blocks)
        for place in np.flatnonzero(np.isin(index, border.named)).tolist():
            at = border.columns_of(int(index[place]))
            out[place] = self._q[np.ix_(at, at)]
        return out

    def blocks(self, pairs: Index) -> Array:
        """See :class:`Cofactors`."""
        widest = max(len(columns) for columns in self._columns)
        place = np.full((len(self._columns), widest), len(self._q))
        for row, columns in zip(place, self._columns, strict=True):
            row[: len(columns)] = columns
        padded = np.pad(self._q, (0, 1))
        return np.asarray(padded[place[pairs[:, 0]][:, :, None], place[pairs[:, 1]][:, None, :]])

    def unknowns(self, places: Index) -> DenseUnknowns:
        """See :class:`Cofactors`."""
        at = self.border.free_columns[places]
        return DenseUnknowns(self._q[np.ix_(at, at)])

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See :class:`Cofactors`."""
        border, unknown = self.border, [j for j in points if self.problem.active[j]]
        at = np.concatenate([np.zeros(0, np.intp), *(self._columns[k] for k in images)])
        if not unknown:
            return np.asarray(self._q[np.ix_(at, at)])
        if np.isin(unknown, border.named).all():
            at = np.concatenate([at, *(border.columns_of(j) for j in unknown)])
            return np.asarray(self._q[np.ix_(at, at)])
        n = len(at)
        effect, own = np.zeros((n + 3 * len(unknown), len(self._q))), np.zeros((n + 3 * len(unknown),) * 2)
        effect[np.arange(n), at] = 1.0
        gain, inverse = border.gains(np.array(unknown))
        effect[n:] = gain.reshape(-1, len(self._q))
        for a, (j, block) in enumerate(zip(unknown, inverse, strict=True)):
            for b in np.flatnonzero(np.equal(unknown, j)):
                own[n + 3 * a : n + 3 * a + 3, n + 3 * b : n + 3 * b + 3] = block
        out = effect @ self._q @ effect.T + own
        return np.asarray(0.5 * (out + out.T))

    def times(self, columns: Array) -> Array:
        """Return the cofactors times columns (n, d), as in ``Problem.vector``."""
        problem, d = self.problem, columns.shape[1]
        w, z = problem.n_image_unknowns, problem.n_free_unknowns
        right = np.zeros((len(self._q), d))
        np.add.at(right[:z], np.concatenate(self._columns), columns[:w])
        ground = np.zeros((len(problem.active), 3, d))
        ground[problem.active] = columns[w:].reshape(-1, 3, d)
        image, ground = self.border.times(right, ground)
        return np.vstack([image[np.concatenate(self._columns)], ground[problem.active].reshape(-1, d)])


class StarCofactors(CommonCofactors):
    """Cofactors if the images are eliminated first (:mod:`fg_orient.adjustment.images_first`).

    Q are the cofactors of the border and the points. The unknowns of an image depend on the border by
    ``x_i = T_i x_b``. Then ``Q_ib = T_i Q`` and ``Q_ij = T_i Q T_j^T + delta_ij N_i^-1``: the cofactors of an
    image and of its points need no matrix of all images.

    Parameters
    ----------
    problem : Problem
    border : ImagesBorder
        Border at the solution.

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
        # for each image: derivatives (k, b) of its unknowns by the border, and inverse of its normal
        # matrix, padded with zeros
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
        """Return the cofactors times columns (n, d), as in ``Problem.vector``."""
        problem, s, d = self.problem, len(self.border.places.shared), columns.shape[1]
        padded = np.vstack([columns[: problem.n_image_unknowns], np.zeros((1, d))])[problem.columns]
        right = np.einsum("mkb,mkd->bd", self._follow, padded)
        right[s:] += columns[problem.n_image_unknowns :]
        solved = self._q @ right
        image = self._follow @ solved + self._own @ padded
        wide = image[problem.columns < problem.n_image_unknowns]
        return np.vstack([wide, solved[s:]])


def of_border(problem: Problem, border: BorderMatrix) -> BorderCofactors | StarCofactors:
    """Return the cofactors from a border; RuntimeError if the normal equations are too close to singular."""
    if isinstance(border, ImagesBorder):
        return StarCofactors(problem, border)
    assert isinstance(border, Border)
    return BorderCofactors(problem, border)
