"""What each group of observations gives to the cofactors, point by point: no matrix of all rows is formed.

Rows of a ground point p have Jacobians B_p to the unknowns of the images and G_p to the point. Without the point,

    F_p = I - G_p (G_p^T G_p)^-1 G_p^T,   A_p = F_p B_p,   R_pq = delta_pq F_p - A_p Q A_q^T

with Q, the cofactors of the image unknowns, so R is a block for each point and a matrix of low rank. E_j selects the
rows of group j::

    M_j = sum_p A_p^T E_j A_p                     its normal equations of the images
    W_j = Q M_j Q,  sum_j W_j = Q                 its part of Q
    (R E_j R)_pp = F E_j F - F E_j H - H E_j F + A_p W_j A_p^T,   H = A_p Q A_p^T
    S_ij = tr(E_i R E_j R) = tr(Q M_i Q M_j) + sum_p sum_(k in i, l in j) (F_kl^2 - 2 F_kl H_kl)

All of it is exact. Priors and own observations are rows without a point; a point that own observations name is not
eliminated, its coordinates stand behind the unknowns of the images.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.conditions.control import POINT
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised
from fg_orient.quality.covariance import Cofactors

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Elements of the matrices W_j of all groups up to which they are formed: 0.5 GB each kind; 4 groups, 4000 unknowns.
LARGEST: Final = 2**26
#: Elements of arrays of many points that are held at once.
CHUNK: Final = 2**21
#: Directions of an error below this share of the best one are not checked by the others.
CHECKED: Final = 1e-6


@dataclass(frozen=True)
class _Rows:
    """Ground points with as many rows each, or rows without a point (one each).

    Parameters
    ----------
    point : (P,) int array
        -1: none.
    rows : (P, r) int array
        Among all rows.
    columns : (P, c) int array
        Among all unknowns of the images.
    free : (P, r, r) array
        F.
    design : (P, r, c) array
        A.
    """

    point: Index
    rows: Index
    columns: Index
    free: Array
    design: Array

    def quadratic(self, q: Array) -> Array:
        """``A q A^T`` (P, r, r)."""
        mine = q[self.columns[:, :, None], self.columns[:, None, :]]
        return np.asarray(self.design @ mine @ np.swapaxes(self.design, 1, 2))


def cost(problem: Problem, n_groups: int) -> int:
    """Elements of the matrices that :class:`GroupCofactors` forms, one per group and one of what belongs to none."""
    return (n_groups + 1) * (problem.n_free_unknowns + 3 * len(_named(problem))) ** 2


def _named(problem: Problem) -> list[int]:
    """Unknown ground points that own observations name."""
    arguments = (a for extra in problem.block.extra for a in problem.extra_arguments(extra))
    return sorted({a.index for a in arguments if not a.is_image and a.constant is None})


class GroupCofactors:
    """Parts of the groups in the cofactors of unknowns and residuals of a solution.

    Parameters
    ----------
    problem, state, cofactors
        Of a solution by any backend.
    labels : (n,) int array
        Group of every row: image points, control points in East, North, Up, priors, own observations; -1: none.
    n_groups : int
    """

    def __init__(self, problem: Problem, state: State, cofactors: Cofactors, labels: Index, n_groups: int) -> None:
        self._problem, self._state = problem, state
        self._labels, self._size = np.where(labels < 0, n_groups, labels), n_groups + 1
        self._named, self._observed = _named(problem), np.flatnonzero(problem.observed)
        self._q = self._cofactors(cofactors)
        self._jacobians = linearised(problem, state)[1:]

    def _cofactors(self, cofactors: Cofactors) -> Array:
        """Q of the image unknowns, shared ones once, then the named points."""
        problem = self._problem
        q = cofactors.joint(tuple(range(problem.n_images)), tuple(self._named))
        if problem.ties is not None:
            points = np.arange(problem.n_image_unknowns, len(q))
            place = np.concatenate([problem.ties.place, points])
            q = q[np.ix_(place, place)]
        return q

    def _image_columns(self, images: Index) -> Index:
        """Columns (n, k) of the unknowns of images, filled up with the first, where Jacobians are zero."""
        columns = self._problem.columns[images]
        wide = np.where(columns < self._problem.n_image_unknowns, columns, 0)
        return wide if self._problem.ties is None else self._problem.ties.of[wide]

    def _point_columns(self, point: int) -> Index:
        """Columns (3,) of a named point."""
        return self._problem.n_free_unknowns + 3 * self._named.index(point) + np.arange(3)

    def _points(self, place: Index | None = None) -> Iterator[_Rows]:
        """All ground points, those with as many rays and rows together; ``place``: those where it is not negative."""
        problem = self._problem
        of_point = problem.observations.point
        order = np.argsort(of_point, kind="stable")
        points, first, rays = np.unique(of_point[order], return_index=True, return_counts=True)
        named = np.isin(points, self._named)
        kind = np.stack([rays, problem.observed[points], problem.active[points], named], axis=1)
        wanted = np.ones(len(points), bool) if place is None else place[points] >= 0
        for m, observed, active, is_named in np.unique(kind[wanted], axis=0).tolist():
            mine = np.flatnonzero(wanted & (kind == [m, observed, active, is_named]).all(axis=1))
            r, c = 2 * m + 3 * observed, m * self._jacobians[0].shape[2] + 3 * is_named
            step = max(1, CHUNK // max(c * c, r * r * self._size))
            for part in (mine[k : k + step] for k in range(0, len(mine), step)):
                seen = order[first[part, None] + np.arange(m)]
                yield self._of_points(points[part], seen, bool(observed), bool(active), bool(is_named))

    def _of_points(self, points: Index, seen: Index, observed: bool, active: bool, named: bool) -> _Rows:
        """Ground points with the same number of image points ``seen`` (P, m)."""
        problem, (n, m) = self._problem, seen.shape
        d_image, d_ground = (jacobian[seen] for jacobian in self._jacobians)
        k = d_image.shape[3]
        r = 2 * m + 3 * observed
        design, ground = np.zeros((n, r, m * k)), np.zeros((n, r, 3))
        for ray in range(m):
            design[:, 2 * ray : 2 * ray + 2, ray * k : (ray + 1) * k] = d_image[:, ray]
        ground[:, : 2 * m] = d_ground.reshape(n, 2 * m, 3)
        rows = (2 * seen[:, :, None] + np.arange(2)).reshape(n, -1)
        columns = self._image_columns(problem.observations.image[seen].ravel()).reshape(n, -1)
        if observed:
            at = problem.control_records[points, POINT.place] + problem.origin_m
            ground[:, 2 * m :] = problem.axes(at) / problem.block.points.known.sigma_enu_m[points][:, :, None]
            place = np.searchsorted(self._observed, points)[:, None]
            rows = np.hstack([rows, 2 * len(problem.observations) + 3 * place + np.arange(3)])
        free = np.tile(np.eye(r), (n, 1, 1))
        if named:
            columns = np.hstack([columns, np.stack([self._point_columns(int(j)) for j in points])])
            design = np.concatenate([design, ground], axis=2)
        elif active:
            basis = np.linalg.qr(ground).Q
            free -= basis @ np.swapaxes(basis, 1, 2)
            design = free @ design
        return _Rows(points, rows, columns, free, design)

    def _others(self) -> Iterator[_Rows]:
        """Priors and own observations."""
        problem = self._problem
        begin = 2 * len(problem.observations) + 3 * len(self._observed)
        if problem.block.options.priors:
            u = problem.n_free_unknowns
            yield _single(begin + np.arange(u), np.arange(u)[:, None], np.ones((u, 1)))
            begin += u
        for extra in problem.block.extra:
            _, blocks = extra_blocks(problem, extra, self._state, jacobian=True)
            columns = np.concatenate([
                self._image_columns(np.array([a.index]))[0, : a.size] if a.is_image else self._point_columns(a.index)
                for a, _ in blocks
            ])  # fmt: skip
            rows = begin + np.arange(extra.n_residuals)
            yield _single(rows, np.tile(columns, (len(rows), 1)), np.hstack([block for _, block in blocks]))
            begin += len(rows)

    def _all(self) -> Iterator[_Rows]:
        yield from self._points()
        yield from self._others()

    @cached_property
    def _gains(self) -> Array:
        """``Q M_j`` (g + 1, u, u) of all groups, last of what belongs to none."""
        from scipy import sparse

        normal = np.zeros((self._size, *self._q.shape))
        for part in self._all():
            n, r, c = part.design.shape
            columns = np.repeat(part.columns, r, axis=0).ravel()
            design = sparse.csr_array(
                (part.design.ravel(), columns, np.arange(0, n * r * c + 1, c)), shape=(n * r, len(self._q))
            )
            label = self._labels[part.rows.ravel()]
            for j in np.unique(label):
                mine = design[label == j]
                product = (mine.T @ mine).tocoo()
                normal[j][product.coords] += product.data
        for own in normal:
            own[:] = self._q @ own
        return normal

    @cached_property
    def parts(self) -> Array:
        """W (g + 1, u, u): parts of the groups in the cofactors of the image unknowns (shared ones once)."""
        u = self._problem.n_free_unknowns
        return np.asarray(self._wide_parts[:, :u, :u])

    @cached_property
    def _wide_parts(self) -> Array:
        return np.stack([gain @ self._q for gain in self._gains])

    @cached_property
    def shared(self) -> Array:
        """S (g + 1, g + 1) of all groups, last row and column: what belongs to none."""
        turned = np.swapaxes(self._gains, 1, 2).reshape(self._size, -1)
        out = self._gains.reshape(self._size, -1) @ turned.T
        for part in self._all():
            label = self._labels[part.rows]
            pair = label[:, :, None] * self._size + label[:, None, :]
            own = part.free * (part.free - 2.0 * part.quadratic(self._q))
            out += np.bincount(pair.ravel(), own.ravel(), self._size**2).reshape(out.shape)
        return 0.5 * (out + out.T)

    def shares(self, points: Index, rows: Index, columns: Array) -> Array:
        """Shares c of the groups in the variances of errors.

        Parameters
        ----------
        points : (n,) int array
            Ground points that suspects belong to.
        rows : (n, m) int array
            Their rows, of their point.
        columns : (n, m, k) array
            Change of the residuals in these rows with the errors.

        Returns
        -------
        (n, g + 1) array
            ``tr((E^T R E)^+ E^T R E_j R E) / d``, last what belongs to no group; the sum of each row is 1.
        """
        out = np.zeros((len(points), self._size))
        wanted = np.full(len(self._problem.active), -1)
        wanted[points] = 0
        for part in self._points(wanted):
            at = np.full(len(wanted), -1)
            at[part.point] = np.arange(len(part.point))
            mine = np.flatnonzero(at[points] >= 0)
            of = at[points[mine]]
            q = part.quadratic(self._q)
            own = np.stack([part.quadratic(w) for w in self._wide_parts], axis=1)
            error = np.zeros((len(mine), part.rows.shape[1], columns.shape[2]))
            i, m, r = np.nonzero(rows[mine][:, :, None] == part.rows[of][:, None, :])
            error[i, r] = columns[mine[i], m]
            out[mine] = _shares(part.free[of], q[of], own[of], error, np.eye(self._size)[self._labels[part.rows[of]]])
        return out


def _single(rows: Index, columns: Index, design: Array) -> _Rows:
    """Rows without a point: one of each."""
    n = len(rows)
    return _Rows(np.full(n, -1), rows[:, None], columns, np.ones((n, 1, 1)), design[:, None, :])


def _shares(free: Array, q: Array, own: Array, error: Array, select: Array) -> Array:
    """Shares (n, g) of errors (n, r, k); F, H (n, r, r), ``A W_j A^T`` (n, g, r, r), groups of the rows (n, r, g)."""
    size, axes = np.linalg.eigh(np.swapaxes(error, 1, 2) @ (free - q) @ error)
    checked = size > CHECKED * np.maximum(size[:, -1:], np.finfo(float).tiny)
    scaled = error @ np.where(checked[:, None], axes / np.sqrt(np.where(checked, size, 1.0))[:, None], 0.0)
    within = np.sum((free @ scaled) * ((free - 2.0 * q) @ scaled), axis=2)
    whole = np.einsum("nrg,nr->ng", select, within) + np.einsum("nra,ngrs,nsa->ng", scaled, own, scaled, optimize=True)
    return np.asarray(whole / np.maximum(checked.sum(axis=1), 1)[:, None])
