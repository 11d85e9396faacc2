"""Cofactors of images and ground points from the reduced camera system.

The inverse of the reduced system contains the cofactors Q of the images. The images that
see a point have ``K = H^-1 sum G^T J``. Cofactors of the point are ``H^-1 + K Q K^T``,
and its joint cofactors with the images are ``-K Q``. Joint cofactors of some unknowns are
a matrix, or the sum of blocks of the images and few columns (:class:`UnknownCofactors`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple, Protocol

import numpy as np
from scipy.linalg import lapack

from factors.arrays import Array, Index
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised, rows_by_image, summed
from fg_orient.kernels.batch_cofactors import ray_cofactors
from fg_orient.model.options import Options

#: Number of image points whose Jacobians are in memory at the same time.
CHUNK: Final = 8_000
#: Maximum number of image unknowns for which one matrix of all their cofactors is formed: 0.3 GB.
WHOLE_LIMIT: Final = 6000
#: Maximum number of image points for which "auto" gives statistics of every observation.
AUTO_LIMIT: Final = 2_000_000


def full_statistics(options: Options, n_image_points: int, n_image_unknowns: int) -> bool:
    """Return whether a run computes statistics of every observation; "auto" omits them if they would take too long."""
    if options.statistics != "auto":
        return options.statistics == "full"
    return n_image_points <= AUTO_LIMIT and n_image_unknowns <= WHOLE_LIMIT


def cofactors_of_points(problem: Problem, state: State, index: Index, blocks: Callable[[Index], Array]) -> Array:
    """Return cofactors (n, 3, 3) m^2 of ground points from cofactors of images; zero for points that are not unknowns.

    Parameters
    ----------
    problem : Problem
    state : State
        The solution.
    index : (n,) int array
        Ground points.
    blocks : callable
        Joint cofactors (B, k, k) in prior sigmas of pairs of images (B, 2), row <=
        column; shorter blocks end with zeros.
    """
    out = np.zeros((len(index), 3, 3))
    wanted = np.flatnonzero(problem.active[index])
    if not len(wanted):
        return out
    order = order_by_point(problem)
    pairs, block = pairs_of_images(problem, order)
    q, size = blocks(pairs), np.diff(problem.first)
    turned = np.ascontiguousarray(np.swapaxes(q, 1, 2))
    for part in parts_of(problem, state, index[wanted], order):
        q_points, free = np.empty((len(part.points), 3, 3)), np.ones(len(part.points), np.int64)
        ray_cofactors(
            0,
            len(q_points),
            part.first,
            part.image,
            size,
            free,
            part.d_image,
            part.d_ground,
            part.inverse,
            block,
            q,
            turned,
            None,
            q_points,
            None,
            None,
            None,
        )
        out[wanted[part.places]] = q_points
    return out


@dataclass(frozen=True)
class RayCofactors:
    """Cofactors of all image points and their ground points; prior scale, whitened rows.

    Parameters
    ----------
    points : (N, 3, 3) array
        Cofactors of the ground points, m^2; zero for points that are not unknowns.
    residual : (n, 2, 2) array
        Cofactors of the residuals, ``I - A N^-1 A^T``.
    response : (n, 3, 2) array
        Effect of an error of an image point on its ground point, m: rows of ``N^-1 A^T``.
    on_image : (n, 2) array
        Effect of a unit error of line and of sample (whitened) on the unknowns of the
        image, in their sigmas: root of ``u^T Q^-1 u``. nan if Q of the image is not
        positive definite.
    images : (M, k, k) array
        Cofactors of the images, prior sigmas.
    """

    points: Array
    residual: Array
    response: Array
    on_image: Array
    images: Array


class Datum(NamedTuple):
    """S-transformation ``S Q S^T = Q - E W^T - W E^T + E C E^T`` of cofactors Q to another datum.

    ``motions`` E and ``along`` W (n + 1, d) have a row for each column of
    ``Problem.vector`` and a last row of zeros; ``core`` C is (d, d). Motions have no
    effect on an observation with the row A, so ``S Q A^T = Q A^T - E (A W)^T``.
    """

    motions: Array
    along: Array
    core: Array

    def elements(self, q: Array, rows: Index, columns: Index) -> Array:
        """Return elements Q (..., r, c) in datum, of unknowns ``rows`` (..., r) and ``columns`` (..., c); -1: zero."""
        e, w = self.motions, self.along
        left, right = e[rows], np.swapaxes(e[columns], -1, -2)
        out = q - left @ np.swapaxes(w[columns], -1, -2)  # in place: q is the largest array of a large network
        out -= w[rows] @ right
        out += (left @ self.core) @ right
        return np.asarray(out)


def places_of_points(problem: Problem, points: Index) -> Index:
    """Return the columns (n, 3) of ground points in ``Problem.vector``; -1 for points that are not unknowns."""
    at = problem.point_columns[points, None] + np.arange(3)
    return np.where(problem.active[points, None], at, -1)


def places_of_images(problem: Problem) -> Index:
    """Return the columns (M, k) of the unknowns of images in ``Problem.vector``.

    Shorter rows end with -1.
    """
    return np.where(problem.columns < problem.n_image_unknowns, problem.columns, -1)


def cofactors_of_rays(
    problem: Problem, state: State, blocks: Callable[[Index], Array], datum: Datum | None = None
) -> RayCofactors:
    """Return the cofactors of adjusted image points, of ground points, and of images.

    See :func:`cofactors_of_points`.
    The result is not valid for ground points with extra observations, because they also
    depend on these. ``datum``: all cofactors are transformed to it.
    """
    n, order = len(problem.observations), order_by_point(problem)
    pairs, block = pairs_of_images(problem, order)
    q, size = blocks(pairs), np.diff(problem.first)
    images, place = q[np.diagonal(block)], places_of_images(problem)
    images = images if datum is None else datum.elements(images, place, place)
    out = RayCofactors(
        np.zeros((len(problem.active), 3, 3)), np.empty((n, 2, 2)), np.zeros((n, 3, 2)), np.empty((n, 2)), images
    )
    roots = inverse_roots(images, size)
    turned, turned_roots = (np.ascontiguousarray(np.swapaxes(each, 1, 2)) for each in (q, roots))
    for part in parts_of(problem, state, order=order):
        rays = len(part.rows)
        q_points, effect = np.empty((len(part.points), 3, 3)), np.empty((rays, 2, q.shape[1]))
        fitted, response = np.empty((rays, 2, 2)), np.empty((rays, 3, 2))
        ray_cofactors(
            0,
            len(q_points),
            part.first,
            part.image,
            size,
            problem.active[part.points].astype(np.int64),
            part.d_image,
            part.d_ground,
            part.inverse,
            block,
            q,
            turned,
            turned_roots,
            q_points,
            fitted,
            response,
            effect,
        )
        if datum is not None:
            at = places_of_points(problem, part.points)
            of_ray = np.repeat(at, np.diff(part.first), axis=0)
            moved = part.d_image @ datum.along[place[part.image]] + part.d_ground @ datum.along[of_ray]
            q_points = datum.elements(q_points, at, at)
            response -= datum.motions[of_ray] @ np.swapaxes(moved, 1, 2)
            effect -= moved @ np.swapaxes((roots @ datum.motions[place])[part.image], 1, 2)
        out.points[part.points], out.response[part.rows] = q_points, response
        out.residual[part.rows] = np.eye(2) - fitted
        out.on_image[part.rows] = np.linalg.norm(effect, axis=2)
    return out


class Star(NamedTuple):
    """Cofactors of images and unknown points, without cofactors between images or between points.

    ``images`` (M, k, k), ``across`` (M, k, 3P) and ``points`` (P, 3, 3); shorter blocks end with zeros.
    """

    images: Array
    across: Array
    points: Array


def rays_of_star(problem: Problem, state: State, star: Star) -> RayCofactors:
    """Return the cofactors of all adjusted image points from cofactors of images and points, also for named points."""
    o, n = problem.observations, len(problem.observations)
    rank, points = np.cumsum(problem.active) - 1, np.zeros((len(problem.active), 3, 3))
    points[problem.active] = star.points
    fitted, response, on_image = np.empty((n, 2, 2)), np.zeros((n, 3, 2)), np.empty((n, 2))
    roots = inverse_roots(star.images, np.diff(problem.first))
    _, d_image, d_ground = linearised(problem, state)
    for k, rows in enumerate(rows_by_image(problem)):
        size, point, m = len(problem.parameters[k]), o.point[rows], len(rows)
        by_image, by_ground = d_image[rows, :, :size].reshape(2 * m, size), d_ground[rows]
        at = 3 * np.maximum(rank[point], 0)[:, None] + np.arange(3)
        across = star.across[k, :size, at] * problem.active[point][:, None, None]  # (m, 3, k)
        on_image_unknowns = by_image @ star.images[k, :size, :size]
        on_image_unknowns += (by_ground @ across).reshape(2 * m, size)
        on_ground = across @ by_image.reshape(m, 2, size).transpose(0, 2, 1)
        on_ground += points[point] @ by_ground.transpose(0, 2, 1)
        response[rows] = on_ground
        fitted[rows] = by_image.reshape(m, 2, size) @ on_image_unknowns.reshape(m, 2, size).transpose(0, 2, 1)
        fitted[rows] += by_ground @ on_ground
        on_image[rows] = np.linalg.norm(on_image_unknowns @ roots[k, :size, :size].T, axis=1).reshape(m, 2)
    return RayCofactors(points, np.eye(2) - fitted, response, on_image, star.images)


def inverse_roots(q: Array, size: Index) -> Array:
    """Return L^-1 of ``Q = L L^T`` (M, k, k) of matrices of these sizes; nan if a matrix is not positive definite."""
    out = np.zeros_like(q)
    for k, n in enumerate(size.tolist()):
        try:
            out[k, :n, :n] = np.linalg.inv(np.linalg.cholesky(q[k, :n, :n]))
        except np.linalg.LinAlgError:
            out[k, :n, :n] = np.nan
    return out


class Part(NamedTuple):
    """Some ground points with all their rays, about :data:`CHUNK` rows in the order of points and images."""

    places: slice  # positions in the list of requested points
    points: Index  # (P,)
    first: Index  # (P + 1,) first ray of each point
    rows: Index  # (n,) of ``problem.observations``
    image: Index  # (n,)
    d_image: Array  # (n, 2, k) whitened
    d_ground: Array  # (n, 2, 3)
    inverse: Array  # (P, 3, 3) H^-1; zero for points that are not unknowns


def order_by_point(problem: Problem) -> Index:
    """Return the image points by ground point, then by image."""
    return np.lexsort((problem.observations.image, problem.observations.point)).astype(np.intp)


def parts_of(problem: Problem, state: State, points: Index | None = None, order: Index | None = None) -> Iterator[Part]:
    """Yield ground points in parts, by default all measured points, with their rays, linearised at a state."""
    order = order_by_point(problem) if order is None else order
    points = np.flatnonzero(np.bincount(problem.observations.point)) if points is None else points
    if not len(points):
        return
    begin = np.concatenate([[0], np.cumsum(np.bincount(problem.observations.point, minlength=len(problem.active)))])
    rays = begin[points + 1] - begin[points]
    cuts = np.searchsorted(np.cumsum(rays), np.arange(CHUNK, rays.sum() + CHUNK, CHUNK), side="left") + 1
    cuts = np.minimum(cuts, len(points))
    for lo, hi in zip([0, *cuts[:-1].tolist()], cuts.tolist(), strict=True):
        first = np.concatenate([[0], np.cumsum(rays[lo:hi])])
        rows = order[np.repeat(begin[points[lo:hi]] - first[:-1], rays[lo:hi]) + np.arange(first[-1])]
        if len(rows):
            yield _part(problem, state, slice(lo, hi), points[lo:hi], first, rows)


def _part(problem: Problem, state: State, places: slice, points: Index, first: Index, rows: Index) -> Part:
    """Return the Jacobians and H^-1 of some points."""
    image, (_, d_image, d_ground) = problem.observations.image[rows], linearised(problem, state, rows)
    normal = summed(np.swapaxes(d_ground, 1, 2) @ d_ground, first)
    known = np.flatnonzero(problem.observed[points])
    w = problem.control_weights(points[known])
    normal[known] += np.swapaxes(w, 1, 2) @ w
    inverse, free = np.zeros_like(normal), problem.active[points]
    inverse[free] = _inverses(normal[free])
    return Part(places, points, first, rows, image, d_image, d_ground, inverse)


def _inverses(normal: Array) -> Array:
    """Invert matrices (n, 3, 3).

    A singular matrix gives nan, for example if only an extra observation determines the point.
    """
    try:
        return np.asarray(np.linalg.inv(normal))
    except np.linalg.LinAlgError:
        out = np.full_like(normal, np.nan)
        for one, inverse in zip(normal, out, strict=True):
            with contextlib.suppress(np.linalg.LinAlgError):
                inverse[:] = np.linalg.inv(one)
        return out


def blocks_of_images(problem: Problem, joint: Callable[[tuple[int, ...]], Array], pairs: Index) -> Array:
    """Return joint blocks (B, k, k) of pairs of images; up to WHOLE_LIMIT unknowns from one matrix of all images.

    Parameters
    ----------
    problem : Problem
    joint : callable
        Joint cofactors of images in ascending order.
    pairs : (B, 2) int array
        Row <= column.
    """
    first, place = problem.first, problem.columns
    if first[-1] <= WHOLE_LIMIT:
        whole = np.pad(joint(tuple(range(problem.n_images))), (0, 1))  # the last row and column, zeros, mean "unused"
        return np.asarray(whole[place[pairs[:, 0]][:, :, None], place[pairs[:, 1]][:, None, :]])
    out = np.zeros((len(pairs), place.shape[1], place.shape[1]))
    for b, (i, j) in enumerate(pairs.tolist()):
        n, m = first[i + 1] - first[i], first[j + 1] - first[j]
        out[b, :n, :m] = joint((i,) if i == j else (i, j))[:n, -m:]
    return out


def pairs_of_images(problem: Problem, order: Index) -> tuple[Index, Index]:
    """Return pairs of images (B, 2) with a common unknown point, row <= column, also of equal images.

    Places (M, M).
    """
    order = order[problem.active[problem.observations.point[order]]]
    image, point = problem.observations.image[order], problem.observations.point[order]
    together = np.eye(problem.n_images, dtype=bool)
    for apart in range(1, int(np.bincount(point).max(initial=0))):
        first, second = slice(0, len(point) - apart), slice(apart, None)
        same = point[first] == point[second]
        together[image[first][same], image[second][same]] = True
    block = np.full(together.shape, -1, np.int64)
    block[together] = np.arange(together.sum())
    return np.argwhere(together), block


class UnknownCofactors(Protocol):
    """Joint cofactor matrix Q (d, d) of d unknowns."""

    @property
    def matrix(self) -> Array:
        """Return Q."""
        ...

    def square(self, x: Array) -> float:
        """Return ``x^T Q^-1 x``."""
        ...


@dataclass(frozen=True)
class DenseUnknowns:
    """Joint cofactors that are stored as one matrix."""

    matrix: Array

    def square(self, x: Array) -> float:
        """See :class:`UnknownCofactors`.

        The matrix is scaled to correlations, because unknowns have very different sizes.
        """
        length = np.sqrt(np.diag(self.matrix))
        scaled = self.matrix / np.outer(length, length)
        _, solved, info = lapack.dposv(scaled, x / length, lower=1)
        return float((x / length) @ (np.linalg.solve(scaled, x / length) if info else solved))


@dataclass(frozen=True)
class SpreadUnknowns:
    """Cofactors ``D + G K G^T``: D has a block for each image, G few columns.

    Parameters
    ----------
    own : (M, k, k) array
        Blocks of D, including blocks of unknowns that are not requested.
    image, place : (d,) int arrays
        Image of each unknown, ascending, and its place in the block.
    factor : (d, c) array
        G.
    core : (c, c) array
        K, symmetric; it need not be definite.
    """

    own: Array
    image: Index
    place: Index
    factor: Array
    core: Array

    @cached_property
    def matrix(self) -> Array:
        """See :class:`UnknownCofactors`."""
        out = self.factor @ self.core @ self.factor.T
        row, column = np.nonzero(self.image[:, None] == self.image)
        out[row, column] += self.own[self.image[row], self.place[row], self.place[column]]
        return np.asarray(0.5 * (out + out.T))

    def square(self, x: Array) -> float:
        """See :class:`UnknownCofactors`.

        With ``M = G^T D^-1 G`` and ``u = G^T D^-1 x`` the result is ``x^T D^-1 x - u^T (I
        + K M)^-1 K u`` (Woodbury 1950).
        """
        if not (self.own[self.image, self.place, self.place] > 0.0).all():
            return DenseUnknowns(self.matrix).square(x)
        wide = np.column_stack([x, self.factor])
        solved = self._by_blocks(wide)
        products = wide.T @ solved
        scale = 1.0 / np.sqrt(np.maximum(np.diag(products)[1:], np.finfo(float).tiny))
        m, k = products[1:, 1:] * np.outer(scale, scale), self.core / np.outer(scale, scale)
        u = products[1:, 0] * scale
        return float(products[0, 0] - u @ np.linalg.solve(np.eye(len(k)) + k @ m, k @ u))

    def _by_blocks(self, right: Array) -> Array:
        """Return ``D^-1`` times columns (d, c)."""
        images, first, count = np.unique(self.image, return_index=True, return_counts=True)
        rank = np.arange(len(self.image)) - np.repeat(first, count)
        number, most = np.repeat(np.arange(len(images)), count), int(count.max())
        places, exists = np.zeros((len(images), most), np.intp), np.zeros((len(images), most), bool)
        places[number, rank], exists[number, rank] = self.place, True
        blocks = self.own[images[:, None, None], places[:, :, None], places[:, None]]
        blocks = np.where(exists[:, :, None] & exists[:, None], blocks, np.eye(most))
        columns = np.zeros((len(images), most, right.shape[1]))
        columns[number, rank] = right
        return np.asarray(np.linalg.solve(blocks, columns)[number, rank])

    def changed(self, factor: Array, core: Array) -> SpreadUnknowns:
        """Return the cofactors with ``F C F^T`` added."""
        c = len(self.core)
        joined = np.zeros((c + len(core),) * 2)
        joined[:c, :c], joined[c:, c:] = self.core, core
        return SpreadUnknowns(self.own, self.image, self.place, np.hstack([self.factor, factor]), joined)
