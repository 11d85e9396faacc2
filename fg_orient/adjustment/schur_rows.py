"""Memory of the Schur backend: rows of the image points by tiles, and what is made of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.schur_structure import Structure, Tile
from fg_orient.kernels.vectors import SLACK, padded

Array = npt.NDArray[np.float64]

#: Bytes that memory moves in.
CACHE_LINE: Final = 64


@dataclass(frozen=True)
class Rows:
    """Rows of the image points of a tile: residuals (n, 2), Jacobians (n, 2, c) and (n, 2, 3)."""

    tile: Tile
    value: Array
    d_image: Array
    d_ground: Array


class Buffers:
    """Arrays of one linearisation, used again by the next: fresh memory costs more than what is computed in it.

    Rows of tiles that are not kept share one space; ``held`` is the tile whose rows stand there.
    """

    def __init__(self, s: Structure, control_records: Array) -> None:
        n, p, slots, c = len(s.row), len(s.number), len(s.slot_own), int(s.n_components.max())
        kept = max((t.points[1] for t in s.tiles if t.kept), default=0)
        largest = max((t.points[1] - t.points[0] for t in s.tiles), default=0)
        again = max((t.points[1] - t.points[0] for t in s.tiles if not t.kept), default=0)
        self.owner: object = None
        self.value, self.trial, self.root_weight = np.empty((n, 2)), np.empty((largest, 2)), np.ones(0)
        self._kept, self._again = row_arrays(kept, c), row_arrays(again, c)
        self.held: Tile | None = None
        self.scaled = _aligned(largest, 8)
        self.root, self.gradient, self.squares = np.empty((p, 6)), np.empty((p, 3)), np.empty(len(s.chunks) - 1)
        self.sums = _aligned(slots, int(s.n_basis.max()) ** 2, padded(c * c))
        self.gradients = np.zeros((slots, int(s.n_basis.max()), (c + 7) // 8 * 8))
        self.blocks = np.zeros((len(s.block_row), s.wide.shape[1], s.wide.shape[1]))
        self.control = control_records  # under a loss, a copy with weights: see SchurSystem

    def rows(self, tile: Tile) -> Rows:
        """Space for the rows of a tile."""
        lo, hi = tile.points
        d_image, d_ground = self._kept if tile.kept else self._again
        at = slice(lo, hi) if tile.kept else slice(0, hi - lo)
        return Rows(tile, self.value[lo:hi], d_image[at], d_ground[at])


def _aligned(*shape: int) -> Array:
    """Uninitialised array at the start of a cache line: vectors across two lines are half as fast (measured)."""
    n = int(np.prod(shape))
    space = np.empty(n + CACHE_LINE // 8)
    skip = -space.ctypes.data % CACHE_LINE // 8
    return space[skip : skip + n].reshape(shape)


def row_arrays(n: int, c: int) -> tuple[Array, Array]:
    """Jacobians of n image points; the first ones with room behind them, see ``fg_orient.kernels.vectors``."""
    space = np.empty(2 * n * c + SLACK)
    space[2 * n * c :] = 0.0
    return space[: 2 * n * c].reshape(n, 2, c), np.empty((n, 2, 3))
