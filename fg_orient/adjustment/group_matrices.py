"""Reduced normal matrices of groups of ground points, from the sums that the kernels leave in the buffers."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.adjustment.point_groups import PointGroup
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.kernels.batch_matrix import add_shared
from fg_orient.kernels.batch_pairs import gather_blocks, gather_gradients

Index = npt.NDArray[np.int64]


class GroupMatrices:
    """Groups of ground points, and their matrices where the points were eliminated last.

    Parameters
    ----------
    backend : SchurBackend
    begins : (G,) int array
        First place of each group among the ground points.
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
        """Slots in the order of groups and blocks, first slot (E + 1,) and images (E,), (E,) of each block of a group.

        The last array (G + 1,) has the first block of each group.
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
        """Blocks (E, k, k) of the matrices of groups, by the entries of all groups."""
        backend, s, (slots, begin, row, column, first) = self._backend, self._backend.structure, self._sorted
        blocks = np.empty((len(row), s.wide.shape[1], s.wide.shape[1]))
        lo, hi = int(first[min(groups)]), int(first[max(groups) + 1])
        backend.workers.run(
            gather_blocks, hi - lo, begin, slots, s.slot_own, row, column, backend.buffers.sums, s.wide, s.scale,
            s.size, s.n_basis, s.n_components, blocks, start=lo,
        )  # fmt: skip
        return blocks

    def normal(self, group: PointGroup, blocks: Array) -> tuple[Array, Array]:
        """Reduced normal matrix (n, n) and gradient (n,) of a group."""
        s, (slots, begin, row, column, first) = self._backend.structure, self._sorted
        lo, hi = first[group.number : group.number + 2].tolist()
        gradient = np.zeros(self._backend.problem.n_image_unknowns)
        gather_gradients(
            begin[lo : hi + 1], slots, s.slot_own, row[lo:hi], column[lo:hi],
            self._backend.buffers.gradients, s.wide, s.scale, s.size, s.n_components, gradient,
        )  # fmt: skip
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
        """Reduced normal matrix (w, w) of the images of a group, from its blocks (E, k, k) and their images."""
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
