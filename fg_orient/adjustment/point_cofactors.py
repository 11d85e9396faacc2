"""Cofactors of many ground points at once; one point with its images: ``fg_orient.adjustment.schur_cofactors``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from factors import batch_cofactors
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import image_rows

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Image points whose Jacobians are held at once.
CHUNK: Final = 50_000
#: Image unknowns up to which all their cofactors are formed to give those of all points: 0.3 GB.
WHOLE_LIMIT: Final = 6000


def cofactors_of_points(problem: Problem, state: State, index: Index, blocks: Callable[[Index], Array]) -> Array:
    """Cofactors (n, 3, 3) m^2 of ground points from those of the images; zero for those that are no unknowns.

    Parameters
    ----------
    problem : Problem
    state : State
        Where to linearise: the solution.
    index : (n,) int array
        Ground points.
    blocks : callable
        Joint cofactors (B, k, k) in prior sigmas of pairs of images (B, 2), row <= column; filled up with zeros.
    """
    out = np.zeros((len(index), 3, 3))
    wanted = np.flatnonzero(problem.active[index])
    if not len(wanted):
        return out
    points, o = index[wanted], problem.observations
    order = np.lexsort((o.image, o.point)).astype(np.intp)
    begin = np.concatenate([[0], np.cumsum(np.bincount(o.point, minlength=len(problem.active)))])
    rays = begin[points + 1] - begin[points]
    pairs, block = _pairs(problem, order)
    q = blocks(pairs)
    cuts = np.searchsorted(np.cumsum(rays), np.arange(CHUNK, rays.sum() + CHUNK, CHUNK), side="left") + 1
    for lo, hi in zip([0, *cuts[:-1].tolist()], cuts.tolist(), strict=True):
        first = np.concatenate([[0], np.cumsum(rays[lo:hi])])
        rows = order[np.repeat(begin[points[lo:hi]] - first[:-1], rays[lo:hi]) + np.arange(first[-1])]
        out[wanted[lo:hi]] = _chunk(problem, state, points[lo:hi], first, rows, block, q)
    return out


def blocks_of_images(problem: Problem, joint: Callable[[tuple[int, ...]], Array], pairs: Index) -> Array:
    """Joint blocks (B, k, k) of pairs of images, from all cofactors of the images if these are few.

    Parameters
    ----------
    problem : Problem
    joint : callable
        Joint cofactors of images in ascending order.
    pairs : (B, 2) int array
        Row <= column.
    """
    first, widest = problem.first, int(np.diff(problem.first).max())
    out = np.zeros((len(pairs), widest, widest))
    whole = joint(tuple(range(problem.n_images))) if first[-1] <= WHOLE_LIMIT else None
    for b, (i, j) in enumerate(pairs.tolist()):
        n, m = first[i + 1] - first[i], first[j + 1] - first[j]
        if whole is not None:
            out[b, :n, :m] = whole[first[i] : first[i + 1], first[j] : first[j + 1]]
        else:
            out[b, :n, :m] = joint((i,) if i == j else (i, j))[:n, -m:]
    return out


def _pairs(problem: Problem, order: Index) -> tuple[Index, Index]:
    """Pairs of images (B, 2) that see a common unknown point, row <= column; their places in a table (M, M).

    ``order`` sorts the image points by ground point, then by image.
    """
    order = order[problem.active[problem.observations.point[order]]]
    image, point = problem.observations.image[order], problem.observations.point[order]
    together = np.zeros((problem.n_images, problem.n_images), bool)
    for apart in range(int(np.bincount(point).max())):
        first, second = slice(0, len(point) - apart), slice(apart, None)
        same = point[first] == point[second]
        together[image[first][same], image[second][same]] = True
    block = np.full(together.shape, -1, np.int64)
    block[together] = np.arange(together.sum())
    return np.argwhere(together), block


def _chunk(
    problem: Problem, state: State, points: Index, first: Index, rows: Index, block: Index, q: Array
) -> Array:  # fmt: skip
    """Cofactors of some points from all their rays."""
    size = np.diff(problem.first)
    image = problem.observations.image[rows]
    d_image, d_ground = np.zeros((len(rows), 2, int(size.max()))), np.empty((len(rows), 2, 3))
    for k in np.unique(image):
        own = np.flatnonzero(image == k)
        _, d_image[own, :, : size[k]], d_ground[own] = image_rows(problem, state, int(k), rows[own], jacobian=True)
    normal = np.add.reduceat(np.einsum("nri,nrj->nij", d_ground, d_ground), first[:-1])
    known = np.flatnonzero(problem.observed[points])
    w = problem.control_records[points[known], :9].reshape(-1, 3, 3)
    normal[known] += np.swapaxes(w, 1, 2) @ w
    out = np.empty((len(points), 3, 3))
    batch_cofactors.point_cofactors(
        0, len(points), first, image, size, d_image, d_ground, np.linalg.inv(normal), block, q, out
    )
    return out
