"""Stages of the Schur backend for a range of points (rows, point blocks, sums over pairs), and their memory.

A thread runs all stages of its range before the threads synchronise. A synchronisation
takes up to 50 us. In addition, new rows are still in the cache when the next stage uses
them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import refuse
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.adjustment.schur_structure import Structure, Tile
from fg_orient.kernels.batch_pairs import pair_blocks
from fg_orient.kernels.batch_points import back_substitute, point_blocks, scale_rows
from fg_orient.kernels.vectors import SLACK, padded

#: Bytes of a cache line.
CACHE_LINE: Final = 64
#: Up to this number of image points, records (0.3 kB each) are copied in the order of the
#: points. In the order of the input, an iteration takes 40 ns more for each image point.
COPIED: Final = 100_000


@dataclass(frozen=True)
class TileRows:
    """Rows of the image points of a tile: residuals (n, 2), Jacobians (n, 2, c) and (n, 2, 3)."""

    tile: Tile
    value: Array
    d_image: Array
    d_ground: Array


class Buffers:
    """Arrays of one linearisation. The next one uses them again, because allocating takes longer than computing.

    Tiles that are not kept share one space; ``held`` is the tile whose rows it contains.
    """

    def __init__(self, s: Structure, control_records: Array) -> None:
        n, p, slots, c = len(s.row), len(s.number), len(s.slot_own), int(s.n_components.max())
        kept = max((t.points[1] for t in s.tiles if t.kept), default=0)
        largest = max((t.points[1] - t.points[0] for t in s.tiles), default=0)
        again = max((t.points[1] - t.points[0] for t in s.tiles if not t.kept), default=0)
        self.owner: object = None
        self.value, self.trial, self.root_weight = np.empty((n, 2)), np.empty((largest, 2)), np.ones(0)
        #: Jacobians of the image points of all tiles that are kept.
        self.kept = row_arrays(kept, c)
        self._again = row_arrays(again, c)
        self._no_image = np.empty((largest, 2, 0))
        self.held: Tile | None = None
        self.scaled = _aligned(largest, 8)
        self.root, self.gradient, self.squares = np.empty((p, 6)), np.empty((p, 3)), np.empty(len(s.chunks) - 1)
        self._pairs = slots, int(s.n_basis.max()) ** 2, padded(c * c)
        self._blocks = len(s.block_row), s.wide.shape[1], s.wide.shape[1]
        self.gradients = np.zeros((slots, int(s.n_basis.max()), (c + 7) // 8 * 8))
        self.control = control_records  # under a loss a copy with weights: see SchurSystem

    @cached_property
    def sums(self) -> Array:
        """Sums of pairs of rays of each chunk."""
        return _aligned(*self._pairs)

    @cached_property
    def blocks(self) -> Array:
        """Blocks (B, k, k) of the reduced system."""
        return np.zeros(self._blocks)

    @property
    def has_sums(self) -> bool:
        """True if there are sums of pairs."""
        return "sums" in self.__dict__

    def release(self) -> None:
        """Free the largest arrays. The reduced system is eliminated again if it is needed again."""
        for name in ("sums", "blocks"):
            self.__dict__.pop(name, None)

    def rows(self, tile: Tile, *, of_images: bool = True) -> TileRows:
        """Return the space for the rows of a tile; without ``of_images`` for derivatives by the points only."""
        lo, hi = tile.points
        d_image, d_ground = self.kept if tile.kept else self._again
        at = slice(lo, hi) if tile.kept else slice(0, hi - lo)
        return TileRows(tile, self.value[lo:hi], d_image[at] if of_images else self._no_image[: hi - lo], d_ground[at])


def _aligned(*shape: int) -> Array:
    """Return an uninitialised array that begins at a cache line.

    Other arrays are half as fast (measured).
    """
    n = int(np.prod(shape))
    space = np.empty(n + CACHE_LINE // 8)
    skip = -space.ctypes.data % CACHE_LINE // 8
    return space[skip : skip + n].reshape(shape)


def row_arrays(n: int, c: int) -> tuple[Array, Array]:
    """Return Jacobians of n image points.

    The first array is padded at its end, see ``fg_orient.kernels.vectors``.
    """
    space = np.empty(2 * n * c + SLACK)
    space[2 * n * c :] = 0.0
    return space[: 2 * n * c].reshape(n, 2, c), np.empty((n, 2, 3))


class Stages:
    """Stages of one problem; for disjoint ranges they write to disjoint parts of the arrays.

    Parameters
    ----------
    problem : Problem
    structure : Structure
    """

    def __init__(self, problem: Problem, structure: Structure) -> None:
        self.problem, self.structure = problem, structure
        self._own = len(structure.row) <= COPIED
        self._row = np.arange(len(structure.row), dtype=np.int32) if self._own else structure.row
        largest = max((t.points[1] - t.points[0] for t in structure.tiles), default=0)
        self._all = np.arange(largest, dtype=np.int32)

    @cached_property
    def _records(self) -> Array:
        """Return the records that belong to ``_row``."""
        return self.problem.records[self.structure.row] if self._own else self.problem.records

    def release(self) -> None:
        """Free the records; they are copied again if needed."""
        self.__dict__.pop("_records", None)

    def rows(self, lo: int, hi: int, rows: TileRows, state: State, wide: Array, want: bool) -> None:
        """Write the residuals of image points lo to hi, all of one tile, and, if wanted, their Jacobians.

        ``wide`` (M, w) are the image unknowns of the state, see ``Structure.widened``.
        Raises NotFiniteError for a residual or Jacobian that is not finite.
        """
        s, (start, end) = self.structure, rows.tile.points
        at, records = slice(start, end), self._records
        for group in s.groups:
            members, part = self._all, (lo - start, hi - start)
            if group.members is not None:
                first, end_of_part = np.searchsorted(group.members, (lo, hi))
                members, part = group.members[first:end_of_part] - np.int32(start), (0, int(end_of_part - first))
            a = group.rows(
                *part,
                members,
                records,
                self._row[at],
                s.image[at],
                s.point[at],
                group.columns.setup,
                group.n_basis,
                s.basis[at],
                wide,
                state.ground,
                rows.value,
                rows.d_image,
                rows.d_ground,
                want,
            )
            if a >= 0:
                refuse(self.problem, state, int(s.row[start + a]))

    def points(self, lo: int, hi: int, rows: TileRows, state: State, damping: float, b: Buffers) -> None:
        """Write the blocks of the ground points at places lo to hi, and the rows reduced by them.

        Raises Singular for a ground point that is not determined.
        """
        s, problem = self.structure, self.problem
        p = point_blocks(
            lo,
            hi,
            s.first,
            s.number,
            s.free,
            b.control,
            state.ground,
            problem.point_damping(damping),
            rows.tile.points[0],
            rows.value,
            rows.d_ground,
            b.root,
            b.gradient,
            b.scaled,
        )
        if p >= 0:
            raise Singular(f"point {problem.block.points.ids[s.number[p]]} is not determined by its rays")

    def chunks(
        self,
        lo: int,
        hi: int,
        rows: TileRows,
        state: State,
        wide: Array | None,
        damping: float,
        b: Buffers,
        pairs: bool = True,
    ) -> None:
        """Eliminate the ground points of chunks lo to hi; with ``wide`` their rows are computed and weighted first.

        Without ``pairs`` only the blocks of the points are computed, for their own steps.
        """
        s = self.structure
        if wide is not None:
            self._weighted_rows(lo, hi, rows, state, wide, b)
        self.points(int(s.chunk_places[lo]), int(s.chunk_places[hi]), rows, state, damping, b)
        if pairs:
            self.pairs(lo, hi, rows, b)

    def pairs(self, lo: int, hi: int, rows: TileRows, b: Buffers) -> None:
        """Write the sums over pairs of rays for chunks lo to hi.

        Their points have been eliminated.
        """
        s = self.structure
        pair_blocks(
            lo,
            hi,
            s.chunks,
            s.pieces,
            s.slots,
            s.slot_begin,
            s.image,
            s.n_basis,
            s.n_components,
            s.basis,
            rows.tile.points[0],
            rows.d_image,
            b.scaled,
            b.sums,
            b.gradients,
        )

    def substituted(
        self, lo: int, hi: int, rows: TileRows, state: State, wide: Array | None, step: Array, b: Buffers, ground: Array
    ) -> None:
        """Write the steps (P, 3) of the points of chunks lo to hi after a step (M, w) of the images."""
        s = self.structure
        if wide is not None:
            self._weighted_rows(lo, hi, rows, state, wide, b)
        back_substitute(
            lo,
            hi,
            s.chunk_places,
            s.first,
            s.image,
            s.n_basis,
            s.n_components,
            s.basis,
            step,
            rows.tile.points[0],
            rows.value,
            rows.d_image,
            rows.d_ground,
            b.root,
            b.gradient,
            ground,
            b.squares,
        )

    def _weighted_rows(self, lo: int, hi: int, rows: TileRows, state: State, wide: Array, b: Buffers) -> None:
        """Compute the rows of the image points of chunks lo to hi, multiplied by the roots of their weights."""
        s = self.structure
        points = [int(s.first[s.chunk_places[k]]) for k in (lo, hi)]
        self.rows(points[0], points[1], rows, state, wide, True)
        if len(b.root_weight):
            start, end = rows.tile.points
            part = points[0] - start, points[1] - start
            scale_rows(*part, b.root_weight[start:end], rows.value, rows.d_image, rows.d_ground)


class ImageExtras:
    """Extra observations of images, linearised at a state; their J^T J is added to the reduced system.

    An observation of one image is added to the block of this image, an observation of
    several images to the full matrix. Elimination and back-substitution of the ground
    points do not depend on them.
    """

    def __init__(self, problem: Problem, state: State) -> None:
        self._problem = problem
        self._rows: list[tuple[tuple[int, ...], Array, tuple[Array, ...]]] = []
        for extra in problem.block.extra:
            residual, blocks = extra_blocks(problem, extra, state, jacobian=True)
            self._rows.append((tuple(a.index for a, _ in blocks), residual, tuple(block for _, block in blocks)))

    def add_blocks(self, own_block: Mapping[int, int], blocks: Array) -> None:
        """Add ``J^T J`` of single images to the blocks (B, k, k) ; ``own_block``: of each image."""
        for images, _, jacobians in self._rows:
            if len(images) == 1:
                (k,), (j,) = images, jacobians
                blocks[own_block[k], : j.shape[1], : j.shape[1]] += j.T @ j

    @property
    def joined(self) -> bool:
        """True if an observation belongs to several images."""
        return any(len(images) > 1 for images, _, _ in self._rows)

    @cached_property
    def matrix(self) -> Array | None:
        """Return ``J^T J`` (z, z) of observations of several images, for the free unknowns; None without such."""
        wide = [self._free(images, jacobians) for images, _, jacobians in self._rows if len(images) > 1]
        rows = np.vstack(wide) if wide else None
        return None if rows is None else rows.T @ rows

    def _free(self, images: tuple[int, ...], jacobians: tuple[Array, ...]) -> Array:
        """Return the Jacobian (r, z) by the free unknowns of all images."""
        out = np.zeros((len(jacobians[0]), self._problem.n_image_unknowns))
        for k, j in zip(images, jacobians, strict=True):
            out[:, self._problem.image_slice(k)] += j
        return out if self._problem.ties is None else np.asarray(out @ self._problem.ties.matrix)

    @cached_property
    def gradient(self) -> Array:
        """``J^T r`` (w,) of the unknowns of all images, one image after the other."""
        out = np.zeros(self._problem.n_image_unknowns)
        for images, r, jacobians in self._rows:
            for k, j in zip(images, jacobians, strict=True):
                out[self._problem.image_slice(k)] += j.T @ r
        return out

    def squares_along(self, image: Array, share: float) -> float:
        """Return squares of ``share`` of the residuals plus their Jacobian times a step (u,) of the images, summed."""
        step = self._problem.image_matrix(image)
        moved = (
            share * r + sum(j @ step[k, : j.shape[1]] for k, j in zip(images, jacobians, strict=True))
            for images, r, jacobians in self._rows
        )
        return sum(float(v @ v) for v in moved)


def half_extras(problem: Problem, state: State) -> float:
    """Return half the sum of squares of the extra observations at a state."""
    extras = (extra_blocks(problem, e, state, jacobian=False)[0] for e in problem.block.extra)
    return 0.5 * sum(float(r @ r) for r in extras)
