"""Elimination of ground points from the whitened rows, for observability, datum, outlier tests and variance components.

The rows of a ground point have Jacobians B to the unknowns of its images and G to the point (a control point
has three more rows than its image points). In the decomposition ``G = Q R``, the columns of Q after the third
one are called Q2. They are a basis of the combinations of rows that do not depend on the point::

    Q2^T B: reduced rows,   F = Q2 Q2^T = I - G (G^T G)^-1 G^T,   A = F B

Points with the same number of rows are eliminated together. No normal equations are formed, so singular
values of the reduced rows are accurate down to 1e-12 of the largest one. A point named by an extra
observation is not eliminated. Its coordinates are unknowns after the unknowns of the images.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Final

import numpy as np

from factors.arrays import Array, Index
from factors.conditions.control import POINT
from fg_orient.adjustment.border_matrix import triangle
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.linear.system import MAX_UNKNOWNS, LinearSystem, Rest
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import Rows, linearised
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.errors import InputError

#: Largest singular value, in prior sigmas, of a direction that counts as unobservable.
UNOBSERVABLE: Final = 1e-5
#: Maximum number of elements of an array of many points; more points are processed in parts.
CHUNK: Final = 2**21


@dataclass(frozen=True)
class PointRows:
    """Ground points with the same number of rows, or single rows without a point.

    Parameters
    ----------
    point : (P,) int array
        Ground points; -1 for rows without a point.
    kind : (P, k) int array
        Points of the same kind have the same columns.
    rows : (P, r) int array
        Row numbers among all rows: image points, control points (East, North, Up), priors, extra observations.
    columns : (P, c) int array
        Column numbers among the unknowns of the images (shared ones once), followed by the named points.
    basis : (P, r, q) array
        Q2.
    reduced : (P, q, c) array
        ``Q2^T B``.
    """

    point: Index
    kind: Index
    rows: Index
    columns: Index
    basis: Array
    reduced: Array

    @cached_property
    def free(self) -> Array:
        """F (P, r, r)."""
        return np.asarray(self.basis @ np.swapaxes(self.basis, 1, 2))

    @cached_property
    def design(self) -> Array:
        """A (P, r, c)."""
        return np.asarray(self.basis @ self.reduced)

    def quadratic(self, q: Array) -> Array:
        """Return ``A q A^T`` (P, r, r); q is (u, u) for all unknowns, or (P, c, c) for the columns of each point."""
        mine = q if q.ndim == 3 else q[self.columns[:, :, None], self.columns[:, None, :]]
        return np.asarray(self.design @ mine @ np.swapaxes(self.design, 1, 2))


def control_rows(problem: Problem, points: Index) -> Array:
    """Return the whitened rows (m, 3, 3) of control points in East, North, Up, with the weights of a loss."""
    w = problem.control_weights(points)
    axes = problem.axes(problem.control_records[points, POINT.place] + problem.origin_m)
    return np.asarray(np.linalg.norm(w @ np.swapaxes(axes, 1, 2), axis=1)[:, :, None] * axes)


def control_residuals(problem: Problem, state: State) -> Array:
    """Return the whitened residuals (m, 3) of all control points in East, North, Up: adjusted minus measured."""
    points = np.flatnonzero(problem.observed)
    difference = state.ground[points] - problem.control_records[points, POINT.place]
    return np.asarray(np.einsum("nij,nj->ni", control_rows(problem, points), difference))


def image_columns(problem: Problem, images: Index) -> Index:
    """Return the columns (n, k) of the unknowns of images.

    An image with fewer unknowns has its first column repeated; the Jacobians there are zero.
    """
    columns = problem.columns[images]
    wide = np.where(columns < problem.n_image_unknowns, columns, 0)
    return wide if problem.ties is None else problem.ties.of[wide]


def free_cofactors(
    problem: Problem, joint: Callable[[tuple[int, ...], tuple[int, ...]], Array], named: list[int]
) -> Array:
    """Return cofactors of all image unknowns (shared once), then of named points; ``joint``: see ``Cofactors``."""
    q = joint(tuple(range(problem.n_images)), tuple(named))
    if problem.ties is None:
        return q
    place = np.concatenate([problem.ties.place, np.arange(problem.n_image_unknowns, len(q))])
    return np.asarray(q[np.ix_(place, place)])


def eliminated_points(
    problem: Problem, rows: Rows, named: list[int] | tuple[int, ...] = (), *, only: Index | None = None, groups: int = 0
) -> Iterator[PointRows]:
    """Eliminate ground points; points with the same number of rows are eliminated together.

    Parameters
    ----------
    problem : Problem
    rows : Rows
        Rows of all image points.
    named : sequence of int
        Points that are not eliminated, ascending.
    only : int array, optional
        Points to eliminate; default: all that are measured.
    groups : int
        Number of matrices (r, r) that the caller forms per point. It limits the number of points processed
        together.
    """
    of_point = problem.observations.point
    order = np.lexsort((problem.observations.image, of_point))
    points, first, rays = np.unique(of_point[order], return_index=True, return_counts=True)
    wanted = np.ones(len(points), bool) if only is None else np.isin(points, only)
    sort = np.stack([rays, problem.observed[points], problem.active[points], np.isin(points, named)], axis=1)
    for m, observed, active, is_named in np.unique(sort[wanted], axis=0).tolist():
        mine = np.flatnonzero(wanted & (sort == [m, observed, active, is_named]).all(axis=1))
        r, c = 2 * m + 3 * observed, m * rows.image.shape[2] + 3 * is_named
        step = max(1, CHUNK // max(c * c if groups else r * c, r * r * (groups + 1)))
        for part in (mine[k : k + step] for k in range(0, len(mine), step)):
            seen = order[first[part, None] + np.arange(m)]
            keep = None if is_named else bool(active)
            yield _eliminated(problem, rows, points[part], seen, bool(observed), keep, named)


def _eliminated(
    problem: Problem,
    jacobians: Rows,
    points: Index,
    seen: Index,
    observed: bool,
    eliminate: bool | None,
    named: list[int] | tuple[int, ...],
) -> PointRows:
    """Prepare points (P,), with image points ``seen`` (P, m), for elimination.

    ``eliminate`` is None for named points and False for fixed points.
    """
    (n, m), o = seen.shape, problem.observations
    r, ground = 2 * m + 3 * observed, np.zeros((n, 2 * m + 3 * observed, 3))
    ground[:, : 2 * m] = jacobians.ground[seen].reshape(n, 2 * m, 3)
    rows, kind = (2 * seen[:, :, None] + np.arange(2)).reshape(n, -1), o.image[seen].astype(np.intp)
    columns = image_columns(problem, kind.ravel()).reshape(n, -1)
    if observed:
        ground[:, 2 * m :] = control_rows(problem, points)
        place = np.searchsorted(np.flatnonzero(problem.observed), points)[:, None]
        rows = np.hstack([rows, 2 * len(o) + 3 * place + np.arange(3)])
    basis = np.linalg.qr(ground, mode="complete").Q[:, :, 3:] if eliminate else np.tile(np.eye(r), (n, 1, 1))
    turned = np.swapaxes(basis, 1, 2)
    reduced = [turned[:, :, 2 * ray : 2 * ray + 2] @ jacobians.image[seen[:, ray]] for ray in range(m)]
    if eliminate is None:
        own = problem.n_free_unknowns + 3 * np.searchsorted(named, points)[:, None] + np.arange(3)
        columns, kind = np.hstack([columns, own]), np.hstack([kind, points[:, None]])
        reduced.append(ground)
    return PointRows(points, kind, rows, columns, basis, np.concatenate(reduced, axis=2))


def single_rows(rows: Index, columns: Index, design: Array) -> PointRows:
    """Return the rows without a point: ``columns`` (n, c) and ``design`` (n, c)."""
    n = len(rows)
    return PointRows(np.full(n, -1), columns[:, :1], rows[:, None], columns, np.ones((n, 1, 1)), design[:, None, :])


def extra_rows(problem: Problem, state: State, named: list[int], begin: int = 0) -> Iterator[PointRows]:
    """Yield the rows of the extra observations; the first has the number ``begin``."""
    for extra in problem.block.extra:
        _, blocks = extra_blocks(problem, extra, state, jacobian=True)
        columns = np.concatenate([
            image_columns(problem, np.array([a.index]))[0, : a.size] if a.is_image
            else problem.n_free_unknowns + 3 * named.index(a.index) + np.arange(3)
            for a, _ in blocks
        ])  # fmt: skip
        rows = begin + np.arange(extra.n_residuals)
        yield single_rows(rows, np.tile(columns, (len(rows), 1)), np.hstack([block for _, block in blocks]))
        begin += len(rows)


# --- reduced rows of all images -------------------------------------------------------------------


def reduced_rows(problem: Problem, rows: Rows, state: State | None = None) -> Array:
    """Compute the rows (q, z) of all image unknowns (shared ones once) after elimination of the points, without priors.

    Rows of points that the same images see are compressed by QR before they are joined, so that q does not grow with
    the number of points.

    Parameters
    ----------
    problem : Problem
    rows : Rows
    state : State, optional
        Include the extra observations at this state. The points that they name are eliminated last, by QR with
        pivoting, so these points need not be determined.
    """
    return _reduced(problem, rows, state, None)


def reduced_system(problem: Problem, state: State) -> LinearSystem:
    """Return equations ``A x = l`` of a step of all image unknowns (shared ones once); no points, no priors.

    A is the triangle of the compressed rows. ``rest`` contains the number and the squares of all other reduced rows.
    The number of all reduced rows is observations minus coordinates of unknown points. InputError: too many unknowns.
    """
    z, rows = problem.n_free_unknowns, linearised(problem, state)
    if z > MAX_UNKNOWNS:
        raise InputError.of("linear.too_large", place="N", value=z, limit=MAX_UNKNOWNS)
    extras = [extra_blocks(problem, extra, state, jacobian=False)[0] for extra in problem.block.extra]
    residual = np.concatenate([rows.residual.ravel(), control_residuals(problem, state).ravel(), *extras])
    root = triangle(_reduced(problem, rows, state, residual))
    root = np.vstack([root, np.zeros((max(0, z + 1 - len(root)), z + 1))])
    n = len(residual) - 3 * int(problem.active.sum())
    return LinearSystem.from_design(root[:z, :z], -root[:z, z], Rest(max(n - z, 0), float(np.sum(root[z:, z] ** 2))))


def _reduced(problem: Problem, rows: Rows, state: State | None, residual: Array | None) -> Array:
    """Return the rows (q, z) of :func:`reduced_rows`; the residuals (n,) of all rows, if given, are one more column."""
    named = [] if state is None else problem.named_points()
    begin = 2 * len(problem.observations) + 3 * int(problem.observed.sum())
    z, extra = problem.n_free_unknowns, () if state is None else extra_rows(problem, state, named, begin)
    parts, width = chain(eliminated_points(problem, rows, named), extra), z + 3 * len(named)
    with one_blas_thread():
        if residual is None:
            out = _compressed(parts, width)
        else:
            out = _compressed((_with_residual(part, residual, width) for part in parts), width + 1)
        if named:
            from scipy.linalg import qr

            q, r = qr(out[:, z:width], pivoting=True)[:2]
            size = np.abs(np.diag(r))
            rank = int((size > size[0] * np.finfo(float).eps * len(out)).sum())
            out = np.asarray(q[:, rank:].T @ np.delete(out, np.s_[z:width], axis=1))
    return out


def _with_residual(part: PointRows, residual: Array, column: int) -> PointRows:
    """Return the reduced rows with their residuals in one more column."""
    own = np.swapaxes(part.basis, 1, 2) @ residual[part.rows][:, :, None]
    columns = np.hstack([part.columns, np.full((len(part.columns), 1), column)])
    return replace(part, columns=columns, reduced=np.concatenate([part.reduced, own], axis=2))


def _compressed(parts: Iterable[PointRows], width: int) -> Array:
    """Return the reduced rows of all points as one matrix (q, width)."""
    out, height, largest = [np.zeros((0, width))], 0, 2 * width + CHUNK // max(1, width)
    for part in parts:
        order = np.lexsort(part.kind.T)
        new = (part.kind[order[1:]] != part.kind[order[:-1]]).any(axis=1)
        for mine in np.split(order, np.flatnonzero(new) + 1):
            short = triangle(part.reduced[mine].reshape(-1, part.columns.shape[1]))
            out.append(_scattered(short, part.columns[mine[0]], width))
            height += len(short)
            if height > largest:
                out = [triangle(np.vstack(out))]
                height = len(out[0])
    return triangle(np.vstack(out))


def _scattered(rows: Array, columns: Index, width: int) -> Array:
    """Return a matrix (n, width) with the rows (n, c) in their columns (c,); values of a repeated column are added."""
    out = np.zeros((len(rows), width))
    if len(np.unique(columns)) == len(columns):
        out[:, columns] = rows
    else:
        np.add.at(out.T, columns, rows.T)
    return out


def spectrum(rows: Array) -> tuple[Array, Array]:
    """Return the singular values (u,) of rows (n, u), descending, and right directions (u, u); zeros if n < u."""
    short, u = triangle(rows), rows.shape[1]
    _, s, vt = np.linalg.svd(np.vstack([short, np.zeros((max(0, u - len(short)), u))]), full_matrices=False)
    return s, vt


def followed_by_ground(problem: Problem, rows: Rows, directions: Array) -> Array:
    """Compute the movement (N, 3, d) m of the ground points that best follows movements of the images.

    Parameters
    ----------
    problem : Problem
    rows : Rows
    directions : (u, d) array
        Movements of the unknowns of all images (shared ones in each image), prior sigmas.
    """
    o, d = problem.observations, directions.shape[1]
    wide = np.vstack([directions, np.zeros((1, d))])[problem.columns[o.image]]
    moved = np.einsum("nij,njd->nid", rows.image, wide)
    normal, out = problem.point_normals(o.point, rows.ground), np.zeros((len(problem.active), 3, d))
    np.add.at(out, o.point, np.einsum("nik,nid->nkd", rows.ground, moved))
    out[problem.active] = -np.linalg.solve(normal[problem.active], out[problem.active])
    out[~problem.active] = 0.0
    return out
