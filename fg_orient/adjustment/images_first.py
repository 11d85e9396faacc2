"""Eliminate the images before the points, for long sequences of images with few ground points.

The *own* unknowns of an image are those that it does not share with another image. No
observation contains own unknowns of two images. The *border* consists of the shared
unknowns of the images (prior sigmas) and three unknowns of each ground point (m). A
contains the derivatives of the rows of an image by its own unknowns, and C those by the
border. Then

    A^T A = L L^T,    W = L^-1 A^T C,    S = sum (C^T C - W^T W),    x_i = -L^-T (L^-1 g_i + W x_b)

with the gradient g_i of the image and the step x_b of the border. S has the unknowns of
the border only, for any number of images. An elimination of points would leave the unknowns of all
images (:mod:`fg_orient.adjustment.border`). If few points are seen in many images, the elimination of
images needs much less work.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised, refuse
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.kernels.batch_images import border_sums, own_sums
from fg_orient.model.block import ExtraObservation

if TYPE_CHECKING:
    from scipy import sparse


#: Images are eliminated first if the ratio of the predicted work (points first over
#: images first) and the number of saved multiplications exceed these values.
GAIN: Final = 4.0
SAVED: Final = 1e7
#: Maximum number of elements of W of all images: 0.2 GB.
LARGEST: Final = 25_000_000
#: The points of an image do not determine it if the ratio of a squared pivot to its diagonal element is below this.
PIVOT: Final = 1e-11


@dataclass(frozen=True)
class Sizes:
    """Sizes that decide between the two eliminations.

    Parameters
    ----------
    own, border, widest : int
        Own unknowns of all images, unknowns of the border, and the largest number of unknowns of an image.
    rays : (N,) int array
        Image points of each ground point.
    named : (N,) bool array
        Points named by extra observations: an elimination of points keeps them as unknowns.
    """

    own: int
    border: int
    widest: int
    rays: Index
    named: Mask

    @property
    def images_first(self) -> bool:
        """True if an elimination of images is predicted to take much less work."""
        if self.own * self.border > LARGEST:
            return False
        rays, points = self.rays[~self.named].astype(float), 3 * int(self.named.sum())
        left = self.own + self.border - 3 * int((self.rays > 0).sum()) + points
        of_points = 0.5 * float(rays @ rays) * self.widest**2 + left**3 / 6.0
        of_images = 0.5 * self.own * self.border**2 + self.border**3 / 6.0
        return of_points > GAIN * of_images and of_points - of_images > SAVED


def each_of_one_image(extra: Sequence[ExtraObservation]) -> bool:
    """Return whether no extra observation has two images."""
    return all(sum(name.startswith("image:") for name in one.unknowns) <= 1 for one in extra)


def images_first(problem: Problem) -> bool:
    """Return whether images are eliminated first: it is possible, and predicted to take much less work.

    No observation may have own unknowns of two images, and the datum must be fixed by more than damping.
    """
    ties, o, z = problem.ties, problem.observations, problem.n_free_unknowns
    if problem.least_damping > 0.0 or not each_of_one_image(problem.block.extra):
        return False
    if not np.bincount(o.image, minlength=problem.n_images).all():
        return False
    own = z if ties is None else int(ties.part[problem.n_images])
    named = np.zeros(len(problem.active), bool)
    named[problem.named_points()] = True
    rays, widest = np.bincount(o.point, minlength=len(named)), int(np.diff(problem.first).max())
    return Sizes(own, z - own + 3 * int(problem.active.sum()), widest, rays, named).images_first


class Places:
    """Positions of the unknowns, and the image points in the order of their images; they are the same at all states.

    Parameters
    ----------
    problem : Problem
        Problem; see :func:`images_first`.
    """

    def __init__(self, problem: Problem) -> None:
        o, ties = problem.observations, problem.ties
        self.problem, m = problem, problem.n_images
        #: Rows of ``problem.observations`` in the order of the images, and the first row of each image (M + 1,).
        self.order = np.argsort(o.image, kind="stable").astype(np.intp)
        self.first = np.concatenate([[0], np.cumsum(np.bincount(o.image, minlength=m))])
        #: The problem with its image points in this order.
        self.rays = replace(problem, observations=o.take(self.order), records=problem.records[self.order])
        self.image, self.point = self.rays.observations.image, self.rays.observations.point
        z, columns = problem.n_free_unknowns, problem.columns
        n_own = z if ties is None else int(ties.part[m])
        free = np.append(np.arange(z) if ties is None else ties.of, z)[columns]
        own = free < n_own
        most = max(int(own.sum(axis=1).max()), 1)
        place = np.argsort(~own, axis=1, kind="stable")[:, :most]
        #: (M, k), True if the image has a first, second, ... own unknown; ``own`` is its position in
        #: the image, or -1.
        self.exists = np.take_along_axis(own, place, axis=1)
        self.own = np.where(self.exists, place, -1).astype(np.int64)
        #: Number (M, k) of each own unknown among the free unknowns; z if there is no unknown.
        self.free = np.where(self.exists, np.take_along_axis(free, place, axis=1), z)
        #: Free unknowns (s,) that images share. ``in_border`` (M, w) is the position of each unknown
        #: of an image in the border, or -1 for an own unknown.
        self.shared = np.arange(n_own, z)
        self.in_border = np.where((columns < problem.n_image_unknowns) & ~own, free - n_own, -1).astype(np.int64)
        #: First position (N,) of each unknown point in the border; other elements are not used.
        self.of_point = problem.point_columns - problem.n_image_unknowns + len(self.shared)
        #: For each image point (n,), the first position of its ground point in the border; -1 for a
        #: constant ground point.
        self.of_ray = np.where(problem.active[self.point], self.of_point[self.point], -1).astype(np.int64)
        self._alike = bool((self.own == self.own[0]).all() and (self.in_border == self.in_border[0]).all())

    def __len__(self) -> int:
        return len(self.shared) + 3 * int(self.problem.active.sum())

    def by_rows(self, rows: Array, moves: Array) -> Array:
        """Multiply rows (n, 2, k) of the images by movements (M, k, d) of each image: (2n, d)."""
        m, (k, d) = self.problem.n_images, moves.shape[1:]
        a = rows.reshape(-1, k)
        if (np.diff(self.first) == self.first[1]).all():
            return np.asarray(a.reshape(m, -1, k) @ moves).reshape(len(a), d)
        out = np.empty((len(a), d))
        for lo, hi, own in zip(2 * self.first[:-1], 2 * self.first[1:], moves, strict=True):
            out[lo:hi] = a[lo:hi] @ own
        return out

    def own_columns(self, d_image: Array) -> Array:
        """Select columns (n, 2, k) of the own unknowns from the columns of all unknowns of the images."""
        if self._alike:
            return np.where(self.exists[0], d_image[:, :, self.own[0]], 0.0)
        picked = np.take_along_axis(d_image, self.own[self.image][:, None], axis=2)
        return np.where(self.exists[self.image][:, None], picked, 0.0)

    def shared_columns(self, d_image: Array) -> Array:
        """Return the columns (n, 2, s) of the shared unknowns."""
        out = np.zeros((*d_image.shape[:2], len(self.shared)))
        for j, place in enumerate(self.in_border.T):
            if self._alike:
                if place[0] >= 0:
                    out[:, :, place[0]] = d_image[:, :, j]
                continue
            rows = np.flatnonzero(place[self.image] >= 0)
            out[rows, :, place[self.image[rows]]] = d_image[rows, :, j]
        return out

    # --- vectors ----------------------------------------------------------------------------------

    def own_of(self, state: State) -> Array:
        """Return the own unknowns (M, k) of each image at a state, with zeros where an image has fewer than k."""
        return np.where(self.exists, np.take_along_axis(state.image, np.maximum(self.own, 0), axis=1), 0.0)

    def border_of(self, state: State) -> Array:
        """Return the unknowns (b,) of the border at a state."""
        shared = self.problem.image_vector(state)[self.shared]
        return np.concatenate([shared, state.ground[self.problem.active].ravel()])

    def state(self, own: Array, border: Array) -> State:
        """Return the state of own unknowns (M, k) and border (b,)."""
        problem, s = self.problem, len(self.shared)
        ground = problem.start.ground.copy()
        ground[problem.active] = border[s:].reshape(-1, 3)
        return State(problem.image_matrix(self.joined(own, border[:s])), ground)

    def joined(self, own: Array, shared: Array) -> Array:
        """Return free unknowns (z, ...) of the images from own ones (M, k, ...) and shared ones (s, ...)."""
        out = np.zeros((self.problem.n_free_unknowns + 1, *own.shape[2:]))
        out[self.free] = own
        out[self.shared] = shared
        return out[:-1]


@dataclass(frozen=True)
class ExtraRow:
    """Rows of an extra observation: image (-1: no image), residuals (r,), Jacobians (r, k) and (r, b)."""

    image: int
    value: Array
    own: Array
    border: Array


class Images:
    """Elimination of the images at a state: their normal equations, and the steps that they take with the border.

    Parameters
    ----------
    places : Places
    state : State
    root : (n,) array, optional
        Roots of the weights of the image points in the order of the images.
    control : (N, 12) array, optional
        Records of the control points, with weights.

    Raises
    ------
    Singular
        Singular :: Its points do not determine an image.
    """

    def __init__(self, places: Places, state: State, root: Array | None = None, control: Array | None = None) -> None:
        problem = places.problem
        self.places, self.state = places, state
        self._rows = linearised(places.rays, state)
        finite = np.isfinite(self._rows.residual).all(axis=1)
        if not finite.all():
            refuse(places.rays, state, int(np.argmin(finite)))
        if root is not None:
            for array in self._rows:
                array *= root.reshape(-1, *(1,) * (array.ndim - 1))
        self.extras = [self._extra(k) for k in range(len(problem.block.extra))]
        self._control = problem.control_records if control is None else control
        self._own_normal()

    def _extra(self, number: int) -> ExtraRow:
        """Return the rows of an extra observation."""
        places, problem = self.places, self.places.problem
        value, blocks = extra_blocks(problem, problem.block.extra[number], self.state, jacobian=True)
        own, border, image = np.zeros((len(value), places.own.shape[1])), np.zeros((len(value), len(places))), -1
        for argument, block in blocks:
            if not argument.is_image:
                border[:, places.of_point[argument.index] + np.arange(3)] += block
                continue
            image = argument.index
            own += np.where(places.exists[image], block[:, places.own[image]], 0.0)
            at = places.in_border[image, : block.shape[1]]
            border[:, at[at >= 0]] += block[:, at >= 0]
        return ExtraRow(image, value, own, border)

    def _own_normal(self) -> None:
        """Factorise the normal matrix of the own unknowns of each image, and compute its gradient."""
        places, rows = self.places, self._rows
        m, k = places.own.shape
        normal, gradient, squares = np.zeros((m, k, k)), np.zeros((m, k)), np.zeros(m)
        own_sums(places.first, places.own, rows.residual, rows.image, normal, gradient, squares)
        for extra in self.extras:
            if extra.image >= 0:
                normal[extra.image] += extra.own.T @ extra.own
                gradient[extra.image] += extra.own.T @ extra.value
                squares[extra.image] += float(extra.value @ extra.value)
        diagonal = np.arange(k)
        normal[:, diagonal, diagonal] += np.where(places.exists, float(self._has_priors), 1.0)
        gradient += float(self._has_priors) * places.own_of(self.state)
        try:
            root = np.linalg.cholesky(normal)
        except np.linalg.LinAlgError:
            raise Singular("an image is not determined by its ground points") from None
        weakest = (root[:, diagonal, diagonal] ** 2 / normal[:, diagonal, diagonal]).min(axis=1)
        if not weakest.min() > PIVOT:
            name = places.problem.block.images[int(weakest.argmin())].id
            raise Singular(f"image {name} is not determined by its ground points")
        #: ``L^-1`` (M, k, k) and ``L^-1 g`` (M, k) of each image.
        self.inverse_root = np.tril(np.linalg.inv(root))
        self.gradient = np.einsum("mij,mj->mi", self.inverse_root, gradient)
        #: Weighted sum of squares (M,) of the observations of each image.
        self.own_squares = squares + float(self._has_priors) * np.sum(places.own_of(self.state) ** 2, axis=1)

    @property
    def _has_priors(self) -> bool:
        return self.places.problem.block.options.priors

    @cached_property
    def squares(self) -> float:
        """Weighted sum of squares of all observations."""
        problem, state = self.places.problem, self.state
        control = np.flatnonzero(problem.observed)
        w = replace(problem, control_records=self._control).control_residuals(state, control)
        extra = sum(float(extra.value @ extra.value) for extra in self.extras)
        prior = problem.prior_squares(state) if self._has_priors else 0.0
        value = self._rows.residual
        return float(np.vdot(value, value)) + float(np.vdot(w, w)) + extra + prior

    @property
    def decrements(self) -> Array:
        """Newton decrements (M,) of the images in sigmas, with the border held fixed."""
        return np.asarray(np.linalg.norm(self.gradient, axis=1))

    @property
    def own_step(self) -> Array:
        """Newton step (M, k) of the images, with the border held fixed."""
        return np.asarray(-np.einsum("mji,mj->mi", self.inverse_root, self.gradient))

    @cached_property
    def inverse(self) -> Array:
        """Inverse (M, k, k) of the normal matrix of the own unknowns of each image.

        Zero for missing unknowns.
        """
        out = np.swapaxes(self.inverse_root, 1, 2) @ self.inverse_root
        return np.where(self.places.exists[:, :, None] & self.places.exists[:, None], out, 0.0)

    @cached_property
    def _reduced(self) -> tuple[Array, Array, Array]:
        """W (M, k, b), S (b, b) and the gradient (b,) of the border."""
        places, rows, problem = self.places, self._rows, self.places.problem
        b, s = len(places), len(places.shared)
        across = np.zeros((len(self.gradient), b, self.gradient.shape[1]))
        matrix, gradient = np.zeros((b, b)), np.zeros(b)
        border_sums(
            places.first,
            places.own,
            places.in_border,
            places.of_ray,
            rows.residual,
            rows.image,
            rows.ground,
            across,
            matrix,
            gradient,
        )
        matrix += np.tril(matrix, -1).T
        observed = np.flatnonzero(problem.observed)
        if len(observed):
            weighted = replace(problem, control_records=self._control)
            w, residual = weighted.control_weights(observed), weighted.control_residuals(self.state, observed)
            at = places.of_point[observed][:, None] + np.arange(3)
            matrix[at[:, :, None], at[:, None]] += np.swapaxes(w, 1, 2) @ w
            gradient[at] += np.einsum("nji,nj->ni", w, residual)
        for extra in self.extras:
            matrix += extra.border.T @ extra.border
            gradient += extra.border.T @ extra.value
            if extra.image >= 0:
                across[extra.image] += extra.border.T @ extra.own
        if self._has_priors:
            matrix[np.arange(s), np.arange(s)] += 1.0
            gradient[:s] += problem.image_vector(self.state)[places.shared]
        w = self.inverse_root @ np.swapaxes(across, 1, 2)
        flat = w.reshape(-1, b)
        matrix -= flat.T @ flat
        gradient -= flat.T @ self.gradient.ravel()
        return w, matrix, gradient

    @property
    def matrix(self) -> Array:
        """S (b, b)."""
        return np.asarray(self._reduced[1])

    @property
    def border_gradient(self) -> Array:
        """Gradient (b,) of the border, with the images at the end of their own steps."""
        return np.asarray(self._reduced[2])

    @cached_property
    def _columns(self) -> tuple[Array, Array, sparse.csr_array]:
        """Derivatives of the image points by own unknowns (n, 2, k), shared ones (2n, s) and points (2n, 3P)."""
        from scipy import sparse

        places, rows = self.places, self._rows
        n, s, at = len(places.point), len(places.shared), np.maximum(places.of_ray - len(places.shared), 0)
        ground = rows.ground * (places.of_ray >= 0)[:, None, None]
        columns = np.repeat(at[:, None] + np.arange(3), 2, axis=0).ravel()
        by_points = sparse.csr_array(
            (ground.reshape(-1), columns, np.arange(0, 6 * n + 1, 3)), shape=(2 * n, len(places) - s)
        )
        return places.own_columns(rows.image), places.shared_columns(rows.image).reshape(2 * n, s), by_points

    def along(self, own: Array, moves: Array) -> Array:
        """Return the change (2n, d) of image points by movements (M, k, d) of the images and (b, d) of the border."""
        s, (by_own, by_shared, by_points) = len(self.places.shared), self._columns
        return np.asarray(self.places.by_rows(by_own, own) + by_shared @ moves[:s] + by_points @ moves[s:])

    def to_border(self, flat: Array) -> Array:
        """Return the sums (b, d) of rows (2n, d) of the image points, multiplied by their derivatives by the border."""
        _, by_shared, by_points = self._columns
        return np.vstack([by_shared.T @ flat, by_points.T @ flat])

    def followed(self, moves: Array) -> Array:
        """Return the best movements (M, k, d) of the images for movements (b, d) of the border."""
        seen = (self._reduced[0].reshape(-1, len(moves)) @ moves).reshape(*self.gradient.shape, moves.shape[1])
        return -np.asarray(np.swapaxes(self.inverse_root, 1, 2) @ seen)
