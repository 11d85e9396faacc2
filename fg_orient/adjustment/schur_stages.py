"""What one thread of the Schur backend computes of its share of the points: rows, point blocks, sums over pairs.

Threads meet after a share, not after each kernel: to hand over takes up to 50 us, and rows that were just written are
still near the processor when they are used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from factors._contract import NotFiniteError
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.adjustment.schur_rows import Buffers, Rows
from fg_orient.adjustment.schur_structure import ALL_KEPT, Small, Structure
from fg_orient.kernels.batch_pairs import pair_blocks
from fg_orient.kernels.batch_points import point_blocks
from fg_orient.kernels.batch_steps import back_substitute
from fg_orient.kernels.batch_weights import scale_rows

Array = npt.NDArray[np.float64]


class Stages:
    """The stages of one problem; they write to disjoint parts of the memory given, for disjoint shares.

    Parameters
    ----------
    problem : Problem
    structure : Structure
    """

    def __init__(self, problem: Problem, structure: Structure) -> None:
        self.problem, self.structure = problem, structure
        self._records, self._row = _in_order(problem.records, structure)
        largest = max((t.points[1] - t.points[0] for t in structure.tiles), default=0)
        self._all = np.arange(largest, dtype=np.int32)

    def rows(self, lo: int, hi: int, rows: Rows, state: State, wide: Array, want: bool) -> None:
        """Write the residuals of image points lo to hi, all of one tile, and, if wanted, their Jacobians.

        Parameters
        ----------
        wide : (M, w) array
            The image unknowns of the state, see ``Structure.widened``.

        Raises
        ------
        NotFiniteError
            A residual or Jacobian is nan or inf; names the observation.
        """
        s, (start, end) = self.structure, rows.tile.points
        at = slice(start, end)
        for group in s.groups:
            members, part = self._all, (lo - start, hi - start)
            if group.members is not None:
                found = np.searchsorted(group.members, (lo, hi))
                members, part = group.members[found[0] : found[1]] - np.int32(start), (0, int(found[1] - found[0]))
            kernel: Callable[..., Any] = group.rows
            a = kernel(
                *part, members, self._records, self._row[at], s.image[at], s.point[at], group.columns.setup,
                group.n_basis, s.basis[at], wide, state.ground, rows.value, rows.d_image, rows.d_ground, want,
            )  # fmt: skip
            if a >= 0:
                label = self.problem.label(int(s.row[start + a]))
                raise NotFiniteError(f"{label}: residual or Jacobian is not finite")

    def points(self, lo: int, hi: int, rows: Rows, state: State, damping: float, b: Buffers) -> None:
        """Write the blocks of the ground points at places lo to hi, and the rows reduced by them.

        Raises
        ------
        Singular
            A ground point is not determined.
        """
        s, problem = self.structure, self.problem
        p = point_blocks(
            lo, hi, s.first, s.number, s.free, b.control, state.ground, problem.point_damping(damping),
            rows.tile.points[0], rows.value, rows.d_ground, b.root, b.gradient, b.scaled,
        )  # fmt: skip
        if p >= 0:
            raise Singular(f"point {problem.block.points.ids[s.number[p]]} is not determined by its rays")

    def chunks(
        self, lo: int, hi: int, rows: Rows, state: State, wide: Array | None, damping: float, b: Buffers
    ) -> None:  # fmt: skip
        """Eliminate the ground points of chunks lo to hi; with ``wide``, their rows are first computed and weighted.

        Raises
        ------
        NotFiniteError, Singular
        """
        s = self.structure
        if wide is not None:
            self._weighted_rows(lo, hi, rows, state, wide, b)
        self.points(int(s.chunk_places[lo]), int(s.chunk_places[hi]), rows, state, damping, b)
        pair_blocks(
            lo, hi, s.chunks, s.pieces, s.slots, s.slot_begin, s.image, s.n_basis, s.n_components, s.basis,
            rows.tile.points[0], rows.d_image, b.scaled, b.sums, b.gradients,
        )  # fmt: skip

    def substituted(
        self, lo: int, hi: int, rows: Rows, state: State, wide: Array | None, step: Array, b: Buffers, ground: Array
    ) -> None:  # fmt: skip
        """Write the steps (P, 3) of the points of chunks lo to hi after one (M, w) of the images; ``wide``: as above.

        Raises
        ------
        NotFiniteError
        """
        s = self.structure
        if wide is not None:
            self._weighted_rows(lo, hi, rows, state, wide, b)
        back_substitute(
            lo, hi, s.chunk_places, s.first, s.image, s.n_basis, s.n_components, s.basis, step, rows.tile.points[0],
            rows.value, rows.d_image, rows.d_ground, b.root, b.gradient, ground, b.squares,
        )  # fmt: skip

    def _weighted_rows(self, lo: int, hi: int, rows: Rows, state: State, wide: Array, b: Buffers) -> None:
        """Rows of the image points of chunks lo to hi, times the roots of their weights."""
        s = self.structure
        points = [int(s.first[s.chunk_places[k]]) for k in (lo, hi)]
        self.rows(points[0], points[1], rows, state, wide, True)
        if len(b.root_weight):
            start, end = rows.tile.points
            part = points[0] - start, points[1] - start
            scale_rows(*part, b.root_weight[start:end], rows.value, rows.d_image, rows.d_ground)


def _in_order(records: Array, s: Structure) -> tuple[Array, Small]:
    """Records and the row of each sorted image point: copied in that order where all rows are kept.

    In the order of the input they cost 40 ns more per image point and iteration (measured at 1e5).
    """
    if len(s.row) > ALL_KEPT:
        return records, s.row
    return records[s.row], np.arange(len(s.row), dtype=np.int32)
