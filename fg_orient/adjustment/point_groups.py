"""Divide ground points into groups.

Compute the groups' reduced normal matrices and their square roots.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from factors.arrays import Array, Mask
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.schur_structure import Small
from fg_orient.kernels.batch_matrix import add_shared
from fg_orient.kernels.batch_pairs import gather_blocks, gather_gradients

Index = npt.NDArray[np.int64]

#: Work of a group that does not depend on its size (calls and small matrices), in multiplications.
OVERHEAD: Final = 1_500_000
#: Maximum number of sets of images that are compared with each other.
MOST_SETS: Final = 2000
#: Maximum number of sets that are joined by their work. If there are more sets, neighbours are joined
#: before.
MOST_JOINED: Final = 400


def vector_names(problem: Problem) -> list[str]:
    """Return the names "image:ID" and "shared:ID" of the vectors of unknowns, by number, also of length zero."""
    names = [f"image:{image.id}" for image in problem.block.images]
    return names + ([] if problem.ties is None else [f"shared:{shared}" for shared in problem.ties.ids])


def vector_parts(problem: Problem) -> list[tuple[int, slice]]:
    """Return the number of each vector of image unknowns (images, then shared ids) and its part of the free unknowns.

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
    number : int
    chunks, places, points : (2,) int tuples
        First and end of its chunks, of its positions among the ground points, and of its image points.
    images : (m,) int array
        Images that see its points, ascending.
    wide : (w,) int array
        Unknowns of these images, numbered among the unknowns of all images.
    vectors : tuple of int
        Vectors of unknowns, see :func:`vector_parts`.
    free : (n,) int array
        Their unknowns among the free ones.
    fold : (w,) int array or None
        Column among these n for each of the ``wide`` unknowns; None if both are the same.
    """

    number: int
    chunks: tuple[int, int]
    places: tuple[int, int]
    points: tuple[int, int]
    images: Index
    wide: Index
    vectors: tuple[int, ...]
    free: Index
    fold: Index | None


class GroupRows:
    """Rows of a group at given image vectors: error (n + 1,) and Jacobian (n + 1, n).

    With the reduced normal matrix S of the group, its gradient g and its cost c

        error  (0, t),    Jacobian  (R, g^T / t),    t^2 = 2 c,    R^T R = S - g g^T / t^2,

    so that ``J^T J = S``, ``J^T e = g`` and ``|e|^2 = 2 c``. The last row is the length
    of all residuals of the group and its derivative. R is computed at its first use.

    Parameters
    ----------
    at : (n,) array
        The unknowns.
    matrix, gradient : (n, n), (n,) arrays
        S, positive semidefinite, and g; None if only the cost was computed.
    twice_cost : float
        2 c, not below ``g^T S^+ g``.
    """

    def __init__(self, at: Array, matrix: Array | None, gradient: Array | None, twice_cost: float) -> None:
        self.at, self.cost, self._matrix, self._gradient = at, 0.5 * float(twice_cost), matrix, gradient

    @property
    def has_matrix(self) -> bool:
        """True if there are rows; False if there is only the cost."""
        return self._matrix is not None

    @property
    def _normal(self) -> tuple[Array, Array]:
        assert self._matrix is not None and self._gradient is not None
        return self._matrix, self._gradient

    @cached_property
    def error(self) -> Array:
        """Error (n + 1,)."""
        matrix, gradient = self._normal
        # because of rounding, the cost may be smaller than the decrease that a single unknown allows
        diagonal = np.diag(matrix)
        least = gradient**2 / np.where(diagonal > 0.0, diagonal, np.inf)
        out = np.zeros(len(self.at) + 1)
        out[-1] = math.sqrt(max(2.0 * self.cost, float(least.max(initial=0.0))))
        return out

    @cached_property
    def jacobian(self) -> Array:
        """Jacobian (n + 1, n)."""
        return square_root(*self._normal, float(self.error[-1]))


def numbers_of_groups(first: Small, image: Small, size: Index) -> Index:
    """Return the number of the group of each ground point, from 0 in the order of the points.

    Points that the same images see belong to one group. Two groups are joined if this
    decreases the predicted work: a group with n unknowns needs ``n^3`` for its matrix in
    GTSAM, and :data:`OVERHEAD`. If all images see points together, the result is one
    group.

    Parameters
    ----------
    first : (P + 1,) int array
        First image point of each ground point, and the end of the last.
    image : (N,) int array
        Image of each image point.
    size : (M,) int array
        Unknowns of each image.
    """
    label = np.random.default_rng(0).integers(1 << 62, size=len(size), dtype=np.uint64)
    code = np.add.reduceat(label[image], first[:-1])  # equal for points with the same images
    of_set = _in_order(code)
    bunch = of_set // (int(of_set.max()) // MOST_SETS + 1)
    seen = np.zeros((int(bunch.max()) + 1, len(size)), bool)
    seen[np.repeat(bunch, np.diff(first)), image] = True
    sets = np.unique(seen, axis=0)
    sets = sets[np.count_nonzero(_contains(sets, sets), axis=0) == 1]
    sets = np.logical_or.reduceat(sets, np.arange(0, len(sets), len(sets) // MOST_JOINED + 1))
    groups = _joined(np.unique(sets, axis=0), size)
    every = np.logical_or.reduce(groups, axis=0).reshape(1, -1)
    if _work(every, size).sum() < _work(groups, size).sum():
        groups = every
    work = np.where(_contains(groups, seen), (groups @ size)[:, None], np.inf)
    return _in_order(work.argmin(axis=0)[bunch])


def _work(groups: Mask, size: Index) -> Array:
    """Return the predicted work (G,) of groups of images (G, M)."""
    return np.asarray((groups @ size).astype(float) ** 3 + OVERHEAD)


def _contains(groups: Mask, sets: Mask) -> Mask:
    """Return whether each group (G, M) contains each set (S, M)."""
    return np.asarray((~groups).astype(np.float32) @ sets.T.astype(np.float32) == 0.0)


def _in_order(label: npt.NDArray[Any]) -> Index:
    """Return the numbers from 0 in place of labels (P,), in the order of their first occurrence."""
    _, begin, number = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(begin), np.int64)
    rank[np.argsort(begin)] = np.arange(len(begin))
    return rank[number]


def _joined(sets: Mask, size: Index) -> Mask:
    """Return sets of images (G, M) from different sets (S, M).

    No two of them would take less work as one.
    """

    def gains(k: int) -> Array:
        """Return the work (S,) that is saved if set k is joined with each other set."""
        saved = work + work[k] - _work(sets | sets[k], size)
        saved[k] = -np.inf
        return np.where(left, saved, -np.inf)

    left, work = np.ones(len(sets), bool), _work(sets, size)
    gain = np.array([gains(k) for k in range(len(sets))])
    while True:
        a, b = np.unravel_index(int(gain.argmax()), gain.shape)
        if gain[a, b] <= 0.0:
            return sets[left]
        sets[a] |= sets[b]
        inside = left & ~(sets & ~sets[a]).any(axis=1)
        inside[a] = False
        left[inside], work[a] = False, _work(sets[[a]], size)[0]
        gain[inside], gain[:, inside] = -np.inf, -np.inf
        gain[a] = gains(int(a))
        gain[:, a] = gain[a]


def square_root(matrix: Array, gradient: Array, length: float) -> Array:
    """Return the Jacobian (n + 1, n) with ``J^T J = S``; its last row is the gradient over the length of the error.

    The other rows are a pivoted Cholesky factor of the rest of S, scaled to a unit
    diagonal; pivots that are rounding are left out.

    Parameters
    ----------
    matrix, gradient : (n, n), (n,) arrays
        S and g.
    length : float
        Not below ``sqrt(g^T S^+ g)``.
    """
    n = len(gradient)
    jacobian = np.zeros((n + 1, n), order="F")
    diagonal = np.diag(matrix)
    root = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    if length > 0.0:
        jacobian[n] = gradient / length
    matrix = matrix - np.outer(jacobian[n], jacobian[n])
    matrix /= root[:, None]
    matrix /= root
    # the transposed view has Fortran's order, so LAPACK uses it without a copy
    factor, pivots, rank, _ = lapack.dpstrf(matrix.T, tol=n * np.finfo(float).eps, lower=1, overwrite_a=1)
    jacobian[:rank, pivots - 1] = np.triu(factor.T)[:rank]
    jacobian[:rank] *= root
    return jacobian


class GroupMatrices:
    """Groups of ground points, and their matrices at the last elimination of the points.

    Parameters
    ----------
    backend : SchurBackend
    begins : (G,) int array
        First position of each group among the ground points.
    parts : mapping
        Part of the free unknowns of each vector, by its number.
    """

    def __init__(self, backend: SchurBackend, begins: Index, parts: Mapping[int, slice]) -> None:
        s, problem = backend.structure, backend.problem
        self._backend = backend
        self._chunks = np.append(np.searchsorted(s.chunk_places, begins), len(s.chunk_places) - 1)
        out = []
        for g, (lo, hi) in enumerate(pairwise(self._chunks.tolist())):
            places = int(s.chunk_places[lo]), int(s.chunk_places[hi])
            points = int(s.first[places[0]]), int(s.first[places[1]])
            images = np.flatnonzero(np.bincount(s.image[slice(*points)])).astype(np.int64)
            wide = np.concatenate([np.arange(problem.first[k], problem.first[k + 1]) for k in images])
            own = wide if problem.ties is None else problem.ties.of[wide]
            vectors = [n for n, part in parts.items() if ((own >= part.start) & (own < part.stop)).any()]
            free = np.concatenate([np.arange(parts[n].start, parts[n].stop) for n in vectors] or [wide])
            fold = np.searchsorted(free, own) if problem.ties is not None else None
            out.append(PointGroup(g, (lo, hi), places, points, images, wide, tuple(vectors), free, fold))
        self.groups = tuple(out)

    @cached_property
    def _sorted(self) -> tuple[Any, Index, Index, Index, Index]:
        """Slots in the order of groups and blocks; first slot (E + 1,) and images (E,), (E,) of each block of a group.

        The last array (G + 1,) contains the first block of each group.
        """
        s = self._backend.structure
        slot_chunk = np.searchsorted(s.slot_begin, np.arange(len(s.slot_own)), side="right") - 1
        slot_block = np.empty(len(s.slot_own), np.int64)
        slot_block[s.block_slots] = np.repeat(np.arange(len(s.block_row)), np.diff(s.block_begin))
        slot_group = np.searchsorted(self._chunks, slot_chunk, side="right") - 1
        order = np.lexsort((np.arange(len(slot_block)), slot_block, slot_group))
        entry, begin = np.unique(slot_group[order] * len(s.block_row) + slot_block[order], return_index=True)
        block = entry % len(s.block_row)
        first = np.searchsorted(entry // len(s.block_row), np.arange(len(self._chunks)))
        begin = np.append(begin, len(order)).astype(np.int64)
        return order.astype(s.block_slots.dtype), begin, s.block_row[block], s.block_column[block], first

    def blocks(self, groups: set[int]) -> Array:
        """Return the blocks (E, k, k) of the matrices of groups, by the entries of all groups."""
        backend, s, (slots, begin, row, column, first) = self._backend, self._backend.structure, self._sorted
        blocks = np.empty((len(row), s.wide.shape[1], s.wide.shape[1]))
        lo, hi = int(first[min(groups)]), int(first[max(groups) + 1])
        backend.workers.run(
            gather_blocks,
            hi - lo,
            begin,
            slots,
            s.slot_own,
            row,
            column,
            backend.buffers.sums,
            s.wide,
            s.scale,
            s.size,
            s.n_basis,
            s.n_components,
            blocks,
            start=lo,
        )
        return blocks

    def normal(self, group: PointGroup, blocks: Array) -> tuple[Array, Array]:
        """Return the reduced normal matrix (n, n) and gradient (n,) of a group."""
        s, (slots, begin, row, column, first) = self._backend.structure, self._sorted
        lo, hi = first[group.number : group.number + 2].tolist()
        gradient = np.zeros(self._backend.problem.n_image_unknowns)
        gather_gradients(
            begin[lo : hi + 1],
            slots,
            s.slot_own,
            row[lo:hi],
            column[lo:hi],
            self._backend.buffers.gradients,
            s.wide,
            s.scale,
            s.size,
            s.n_components,
            gradient,
        )
        own = gradient[group.wide]
        if group.fold is None:
            return self._matrix(group, row[lo:hi], column[lo:hi], blocks[lo:hi]), own
        own = np.bincount(group.fold, own, len(group.free)).astype(float)
        matrix = np.zeros((len(own), len(own)))
        of = np.zeros(len(gradient), np.int64)
        of[group.wide] = group.fold
        add_shared(row[lo:hi], column[lo:hi], self._backend.problem.first, of, s.size, blocks[lo:hi], matrix)
        return matrix, own

    def _matrix(self, group: PointGroup, row: Index, column: Index, blocks: Array) -> Array:
        """Return reduced normal matrix (w, w) of the images of a group, from its blocks (E, k, k) and their images."""
        size = self._backend.structure.size[group.images]
        m, widest = len(size), int(size.max(initial=0))
        a, b = (np.searchsorted(group.images, k) for k in (row, column))
        own = blocks[:, :widest, :widest]
        out = np.zeros((m, widest, m, widest))
        out[b, :, a, :] = own.transpose(0, 2, 1)
        out[a, :, b, :] = own
        used = np.flatnonzero(np.arange(widest) < size[:, None])
        whole = out.reshape(m * widest, m * widest)
        return whole if len(used) == len(whole) else whole[np.ix_(used, used)]
