"""Products with the reduced matrix from the rows of the image points, without the matrix.

Where the images that see a point are nearly any, almost all pairs of images have a block, and each block sums a few
pairs of rays: to form and to read the blocks takes longer than to read the rows again in each product (Agarwal et al.
2010).
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.reduced_choice import LARGEST_FULL
from fg_orient.adjustment.schur_reduced import too_large
from fg_orient.kernels.batch_points import reduced_product

if TYPE_CHECKING:
    from fg_orient.adjustment.schur import SchurSystem
    from fg_orient.adjustment.schur_reduced import Reduced

#: Shares of the points with sums of their own: the order of all sums does not depend on the number of threads.
SHARES: Final = 16


class ImplicitProduct:
    """Reduced matrix of a linearisation under a damping; see ``iterative_reduced.Implicit``."""

    def __init__(self, system: SchurSystem, damping: float) -> None:
        self._system, self._damping = system, damping
        s = system.structure
        self._sums = np.empty((SHARES, len(s.size), s.width))

    @cached_property
    def _cuts(self) -> Index:
        """First place of each share."""
        first = self._system.structure.first
        return np.searchsorted(first, np.linspace(0, first[-1], SHARES + 1)).astype(np.int64)

    def multiply(self, x: Array, out: Array) -> None:
        """See ``iterative_reduced.Implicit``."""
        s, b = self._system.structure, self._system.eliminated_buffers(self._damping)
        d_image, d_ground = b.kept
        self._system.backend.workers.run(
            reduced_product, SHARES, self._cuts, s.first, s.image, s.n_basis, s.n_components, s.basis, s.widened(x),
            d_image, d_ground, b.root, self._sums,
        )  # fmt: skip
        np.multiply(np.take_along_axis(self._sums.sum(axis=0), s.wide, axis=1), s.scale, out=out)

    def with_blocks(self) -> Reduced:
        """See ``iterative_reduced.Implicit``."""
        from fg_orient.adjustment.schur import SchurBackend

        own = self._system.backend
        unknowns = own.problem.n_image_unknowns
        if unknowns > LARGEST_FULL:
            raise too_large(unknowns)
        backend = SchurBackend(own.problem, own.workers.threads, "dense")
        backend.robust = own.robust
        return backend.linearise(self._system.state).reduced(self._damping)
