"""Groups of ground points: which points belong together, and the square root of what a group leaves to its images."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.schur_structure import Small

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

#: Work of a group that does not depend on its size, in multiplications: calls, and small matrices.
OVERHEAD: Final = 1_500_000
#: Share of the unchanged part of the error up to which the rest of the gradient is returned, see :func:`square_root`.
RETURNED: Final = 1e-3
#: Pivot of the factor, its rows scaled to length one, that is kept whatever rounding says.
STRONG: Final = 1e-5


def vector_names(problem: Problem) -> list[str]:
    """Names "image:ID" and "shared:ID" of the vectors of unknowns, by number; those of length zero included."""
    names = [f"image:{image.id}" for image in problem.block.images]
    return names + ([] if problem.ties is None else [f"shared:{shared}" for shared in problem.ties.ids])


def vector_parts(problem: Problem) -> list[tuple[int, slice]]:
    """Number of each vector of image unknowns (images, then ids of shared unknowns) and its part of the free unknowns.

    Vectors of length zero are left out.
    """
    first = problem.first if problem.ties is None else problem.ties.part
    parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(first)]
    return [(n, part) for n, part in enumerate(parts) if part.stop > part.start]


@dataclass(frozen=True)
class PointGroup:
    """Consecutive chunks of ground points, and the unknowns of the images that see them.

    Parameters
    ----------
    chunks, places, points : (2,) int tuples
        First and end of its chunks, of its places among the ground points, and of its image points.
    images : (m,) int array
        Images that see its points, ascending.
    wide : (w,) int array
        Unknowns of these images among those of all images.
    vectors : tuple of int
        The vectors of unknowns, see :func:`vector_parts`.
    free : (n,) int array
        Their unknowns among the free ones.
    fold : (w,) int array or None
        Column of each of ``wide`` among these n; None where they are the same.
    entries : (2,) int tuple
        First and end of its blocks among the blocks of all groups.
    """

    chunks: tuple[int, int]
    places: tuple[int, int]
    points: tuple[int, int]
    images: Index
    wide: Index
    vectors: tuple[int, ...]
    free: Index
    fold: Index | None
    entries: tuple[int, int]


def runs_of_first_images(first: Small, image: Small) -> Index:
    """Places at which a new pair of first and last image begins, in the order of the structure."""
    ends = np.stack([image[first[:-1]], image[first[1:] - 1]])
    return np.concatenate([[0], 1 + np.flatnonzero((ends[:, 1:] != ends[:, :-1]).any(axis=0))])


def best_cuts(first: Small, image: Small, size: Index) -> Index:
    """Places that begin the groups: neighbouring runs are joined where the predicted work becomes less.

    The work of a group with n unknowns is that of its matrix in GTSAM, ``n^3``, and :data:`OVERHEAD`; one group for all
    is the result where all images see points together.
    """
    places = runs_of_first_images(first, image)
    rays = np.append(first[places], first[-1])
    seen = [frozenset(np.unique(image[a:b]).tolist()) for a, b in itertools.pairwise(rays)]

    def work(images: frozenset[int]) -> float:
        return float(size[list(images)].sum()) ** 3 + OVERHEAD

    groups: list[tuple[int, frozenset[int], float]] = []
    for place, images in zip(places.tolist(), seen, strict=True):
        groups.append((place, images, work(images)))
        while len(groups) > 1:
            (begin, before, cost), (_, own, more) = groups[-2:]
            together = before | own
            if work(together) > cost + more:
                break
            groups[-2:] = [(begin, together, work(together))]
    return np.array([place for place, _, _ in groups], np.int64)


def square_root(matrix: Array, gradient: Array, twice_cost: float) -> tuple[Array, Array]:
    """Jacobian (n + 2, n) and error (n + 2,) with ``J^T J = S``, ``J^T e = g``, ``|e|^2 = 2 c``.

    The pivoted Cholesky factor leaves out pivots that are rounding, and with them up to 1e-7 of the gradient. Row n
    returns this rest r to the gradient: its error is a part t of the cost that the images cannot change, its Jacobian
    ``r / t``, which adds ``r r^T / t^2`` to the matrix: with S scaled to a unit diagonal, at most
    ``2 RETURNED^2``.

    Parameters
    ----------
    matrix, gradient : (n, n), (n,) arrays
        S, positive semidefinite, and g in the range of S.
    twice_cost : float
        2 c, not below ``g^T S^+ g``.
    """
    n = len(gradient)
    jacobian, error = np.zeros((n + 2, n), order="F"), np.zeros(n + 2)
    diagonal = np.diag(matrix)
    root = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    factor, pivots, rank, _ = lapack.dpstrf(matrix / np.outer(root, root), lower=1)
    order = pivots - 1
    lower = np.tril(factor)[:, :rank]
    jacobian[:rank, order] = lower.T
    jacobian[:rank] *= root
    error[:rank] = lapack.dtrtrs(lower[:rank], (gradient / root)[order[:rank]], lower=1)[0]
    squares = np.cumsum(error[:rank] ** 2)
    if rank and squares[-1] > twice_cost:  # rounding, divided by small pivots: these rows are left out, too
        strong = int(np.count_nonzero(np.diag(lower) >= STRONG))
        kept = max(strong, int(np.searchsorted(squares, twice_cost)))
        jacobian[kept:], error[kept:] = 0.0, 0.0
    unchanged = math.sqrt(max(twice_cost - float(error @ error), 0.0))
    rest = gradient - jacobian.T @ error
    if unchanged > 0.0 and np.abs(rest / root).max(initial=0.0) <= RETURNED * unchanged:
        error[n] = unchanged / math.sqrt(2.0)
        jacobian[n] = rest / error[n]
        unchanged = error[n]
    error[n + 1] = unchanged
    return jacobian, error
