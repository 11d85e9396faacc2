"""All image points as whitened rows, and what is left of them when the ground points are eliminated.

A ground point with m rays has the rows ``A x + B p`` (A to the images, B (2m, 3) to the point, a control point three
more). The columns of Q beyond the third of ``B = Q R`` give ``Q2^T A``: what the rays say about the images whatever
the point does. It is done for all points with the same number of rays at once; nothing is squared, so singular values
down to 1e-12 of the largest are those of the rows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import qr

from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.rows import Rows

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Elements of the matrix of rows of one chunk.
CHUNK = 2_000_000


def eliminated(problem: Problem, rows: Rows) -> Array:
    """Rows (q, u) of all image unknowns with the unknown ground points eliminated.

    Compressed by QR on the way: q is u at most, unless there are few rows. Priors are left out.

    Parameters
    ----------
    problem : Problem
    rows : Rows
    """
    u, parts, height = problem.n_image_unknowns, [np.zeros((0, problem.n_image_unknowns))], 0
    for rays, control in _alike(problem):
        basis = _complement(problem, rows, rays, control)
        chunk = max(1, CHUNK // max(1, basis.shape[2] * (u + 1)))
        for start in range(0, len(rays), chunk):
            part = slice(start, start + chunk)
            found = _scattered(problem, rows, rays[part], basis[part])
            parts.append(found)
            height += len(found)
            if height > 2 * u + CHUNK // max(1, u):
                parts = [np.asarray(np.linalg.qr(np.vstack(parts), mode="r"))]
                height = len(parts[0])
    whole = np.vstack(parts)
    return np.asarray(np.linalg.qr(whole, mode="r")) if len(whole) > u else whole


def eliminated_with_own(problem: Problem) -> Array:
    """The same at the start, own observations included, by full matrices.

    Raises
    ------
    NotFiniteError
        An own observation is not finite.
    """
    u = problem.n_image_unknowns
    bare = replace(problem, block=replace(problem.block, options=replace(problem.block.options, priors=False)))
    _, design = assemble(bare, problem.start)
    q, r = qr(design[:, u:], pivoting=True)[:2]
    size = np.abs(np.diag(r))
    rank = int((size > size[0] * np.finfo(float).eps * len(design)).sum()) if len(size) else 0
    return np.asarray(q[:, rank:].T @ design[:, :u])


def _alike(problem: Problem) -> list[tuple[Index, Index]]:
    """Rows (P, m) of P points with m rays each, and their numbers (P,) if they are control points, else -1.

    Image points of fixed ground points stand for themselves: number -2.
    """
    point = problem.observations.point
    fixed = np.flatnonzero(~problem.active[point])
    out = [(fixed[:, None], np.full(len(fixed), -2))] if len(fixed) else []
    order = np.flatnonzero(problem.active[point])
    order = order[np.argsort(point[order], kind="stable")]
    ids, first, count = np.unique(point[order], return_index=True, return_counts=True)
    for m in np.unique(count):
        for control in (False, True):
            which = np.flatnonzero((count == m) & (problem.observed[ids] == control))
            if len(which):
                number = ids[which] if control else np.full(len(which), -1)
                out.append((order[first[which, None] + np.arange(m)], number))
    return out


def _complement(problem: Problem, rows: Rows, rays: Index, control: Index) -> Array:
    """Orthonormal combinations (P, 2m, q) of the rows of each point's rays that do not feel the point.

    Rows of the control-point equations have no part in the images: only the upper 2m rows are given.
    """
    n, m = rays.shape
    if control[0] == -2:
        return np.tile(np.eye(2), (n, 1, 1))
    a = rows.ground[rays].reshape(n, 2 * m, 3)
    if control[0] >= 0:
        a = np.concatenate([a, problem.control_weights(control)], axis=1)
    return np.asarray(np.linalg.qr(a, mode="complete")[0][:, : 2 * m, 3:])


def _scattered(problem: Problem, rows: Rows, rays: Index, basis: Array) -> Array:
    """Combinations ``Q2^T A`` (P q, u): each ray's block in the columns of its image."""
    u, image, (n, m) = problem.n_image_unknowns, problem.observations.image, rays.shape
    out = np.zeros((n, basis.shape[2], u + 1))
    for r in range(m):
        block = np.einsum("pik,pij->pkj", basis[:, 2 * r : 2 * r + 2], rows.image[rays[:, r]])
        at = problem.columns[image[rays[:, r]]]
        out[np.arange(n)[:, None, None], np.arange(basis.shape[2])[:, None], at[:, None, :]] += block
    return out[:, :, :u].reshape(-1, u)


def followed_by_ground(problem: Problem, rows: Rows, directions: Array) -> Array:
    """Movement (N, 3, d) m of the ground points that best follows movements of the images.

    Parameters
    ----------
    problem : Problem
    rows : Rows
    directions : (u, d) array
        Of all image unknowns, prior sigmas.
    """
    o, d = problem.observations, directions.shape[1]
    wide = np.vstack([directions, np.zeros((1, d))])[problem.columns[o.image]]
    moved = np.einsum("nij,njd->nid", rows.image, wide)
    n_points = len(problem.active)
    normal, right = problem.point_normals(o.point, rows.ground), np.zeros((n_points, 3, d))
    np.add.at(right, o.point, np.einsum("nik,nid->nkd", rows.ground, moved))
    out = np.zeros((n_points, 3, d))
    seen = np.flatnonzero(problem.active)
    out[seen] = -np.linalg.solve(normal[seen], right[seen])
    return out
