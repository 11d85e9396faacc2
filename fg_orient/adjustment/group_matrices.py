"""Reduced normal matrices of groups of ground points, from the sums that the kernels leave in the buffers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.point_groups import PointGroup
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.kernels.batch_matrix import add_shared
from fg_orient.kernels.batch_pairs import gather_blocks, gather_gradients

Array = npt.NDArray[np.float64]
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
        self._backend = backend
        self.groups = self._grouped(begins, parts)

    def _grouped(self, begins: Index, parts: Mapping[int, slice]) -> tuple[PointGroup, ...]:
        """Groups by their first places, and the slots of their blocks."""
        s, problem = self._backend.structure, self._backend.problem
        chunks = np.append(np.searchsorted(s.chunk_places, begins), len(s.chunk_places) - 1)
        slot_chunk = np.searchsorted(s.slot_begin, np.arange(len(s.slot_own)), side="right") - 1
        slot_block = np.empty(len(s.slot_own), np.int64)
        slot_block[s.block_slots] = np.repeat(np.arange(len(s.block_row)), np.diff(s.block_begin))
        slot_group = np.searchsorted(chunks, slot_chunk, side="right") - 1
        order = np.lexsort((np.arange(len(slot_block)), slot_block, slot_group))
        key = slot_group[order] * len(s.block_row) + slot_block[order]
        entry, begin = np.unique(key, return_index=True)
        self._slots = order.astype(s.block_slots.dtype)
        self._begin = np.append(begin, len(order)).astype(np.int64)
        block = entry % len(s.block_row)
        entries = np.searchsorted(entry // len(s.block_row), np.arange(len(chunks)))
        self._row, self._column = s.block_row[block], s.block_column[block]
        out = []
        for g in range(len(chunks) - 1):
            lo, hi = int(chunks[g]), int(chunks[g + 1])
            places = int(s.chunk_places[lo]), int(s.chunk_places[hi])
            points = int(s.first[places[0]]), int(s.first[places[1]])
            images = np.unique(s.image[slice(*points)]).astype(np.int64)
            wide = np.concatenate([np.arange(problem.first[k], problem.first[k + 1]) for k in images])
            own = wide if problem.ties is None else problem.ties.of[wide]
            vectors = [n for n, part in parts.items() if ((own >= part.start) & (own < part.stop)).any()]
            free = np.concatenate([np.arange(parts[n].start, parts[n].stop) for n in vectors] or [wide])
            fold = np.searchsorted(free, own) if problem.ties is not None else None
            out.append(PointGroup(
                (lo, hi), places, points, images, wide, tuple(vectors), free, fold,
                (int(entries[g]), int(entries[g + 1])),
            ))  # fmt: skip
        return tuple(out)

    def blocks(self, groups: set[int]) -> Array:
        """Blocks (E, k, k) of the matrices of groups, by the entries of all groups."""
        backend, s = self._backend, self._backend.structure
        blocks = np.empty((len(self._row), s.wide.shape[1], s.wide.shape[1]))
        first, end = min(self.groups[g].entries[0] for g in groups), max(self.groups[g].entries[1] for g in groups)
        backend.workers.run(
            gather_blocks, end - first, self._begin, self._slots, s.slot_own, self._row, self._column,
            backend.buffers.sums, s.wide, s.scale, s.size, s.n_basis, s.n_components, blocks, start=first,
        )  # fmt: skip
        return blocks

    def normal(self, group: PointGroup, blocks: Array) -> tuple[Array, Array]:
        """Reduced normal matrix (n, n) and gradient (n,) of a group."""
        s, (lo, hi) = self._backend.structure, group.entries
        gradient = np.zeros(self._backend.problem.n_image_unknowns)
        gather_gradients(
            self._begin[lo : hi + 1], self._slots, s.slot_own, self._row[lo:hi], self._column[lo:hi],
            self._backend.buffers.gradients, s.wide, s.scale, s.size, s.n_components, gradient,
        )  # fmt: skip
        own = gradient[group.wide]
        if group.fold is None:
            return self._matrix(group, blocks), own
        own = np.bincount(group.fold, own, len(group.free)).astype(float)
        matrix = np.zeros((len(own), len(own)))
        of = np.zeros(len(gradient), np.int64)
        of[group.wide] = group.fold
        add_shared(
            self._row[lo:hi], self._column[lo:hi], self._backend.problem.first, of, s.size, blocks[lo:hi], matrix
        )
        return matrix, own

    def _matrix(self, group: PointGroup, blocks: Array) -> Array:
        """Reduced normal matrix (w, w) of the images of a group."""
        size, entries = self._backend.structure.size[group.images], slice(*group.entries)
        m, widest = len(size), int(size.max(initial=0))
        a, b = (np.searchsorted(group.images, k[entries]) for k in (self._row, self._column))
        own = blocks[entries, :widest, :widest]
        out = np.zeros((m, widest, m, widest))
        out[b, :, a, :] = own.transpose(0, 2, 1)
        out[a, :, b, :] = own
        used = np.flatnonzero(np.arange(widest) < size[:, None])
        whole = out.reshape(m * widest, m * widest)
        return whole if len(used) == len(whole) else whole[np.ix_(used, used)]
