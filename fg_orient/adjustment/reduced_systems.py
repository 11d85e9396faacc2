"""Reduced camera systems of one pattern: the method of solution, and the solution of the blocks by GTSAM.

GTSAM eliminates a graph of one HessianFactor per image and one per pair of images that share points; its ordering is
computed once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.iterative_reduced import ImplicitProduct, IterativeReduced
from fg_orient.adjustment.reduced_choice import Choice, Pattern, choose, narrowest
from fg_orient.adjustment.schur_reduced import LapackInverse, LapackReduced, Reduced

if TYPE_CHECKING:
    import gtsam

    from fg_orient.adjustment.ties import Ties

REDUCED: Final = ("auto", "blocks", "dense", "banded", "graph", "iterative", "implicit")


class GraphReduced:
    """GTSAM graph over the images; parameters as in :class:`LapackReduced`, and the elimination order."""

    def __init__(
        self, pattern: Pattern, first: Index, blocks: Array, diagonal: float, ordering: gtsam.Ordering, threads: int = 1
    ) -> None:
        import gtsam

        self._inverse = LapackInverse(pattern, first, blocks, diagonal, threads)
        self._first, self._ordering = first, ordering
        self._off, self._own = gtsam.GaussianFactorGraph(), []
        size = pattern.size.tolist()
        own = [diagonal * np.eye(k) for k in size]
        for b, (i, j) in enumerate(zip(pattern.block_row.tolist(), pattern.block_column.tolist(), strict=True)):
            block = blocks[b, : size[i], : size[j]]
            if i == j:
                own[i] += block
                continue
            n, m = size[i], size[j]
            self._off.add(
                gtsam.HessianFactor(i, j, np.zeros((n, n)), block, np.zeros(n), np.zeros((m, m)), np.zeros(m), 0.0)
            )
        self._own = own
        self._marginals: gtsam.Marginals | None = None

    @property
    def selects(self) -> bool:
        """See :class:`Reduced`."""
        return self._inverse.selects

    def selected(self, pairs: Index) -> Array:
        """See :class:`Reduced`."""
        return self._inverse.factor.selected(pairs)

    def _graph(self, gradient: Array) -> gtsam.GaussianFactorGraph:
        import gtsam

        graph = gtsam.GaussianFactorGraph()
        for i, block in enumerate(self._own):
            graph.add(gtsam.HessianFactor(i, block, -gradient[self._first[i] : self._first[i + 1]], 0.0))
        graph.push_back(self._off)
        return graph

    def solve(self, gradient: Array) -> Array:
        """See :class:`Reduced`."""
        return np.asarray(self._graph(gradient).optimize(self._ordering).vector())

    def covariance(self, images: tuple[int, ...]) -> Array:
        """See :class:`Reduced`."""
        import gtsam

        if self._marginals is None:
            zero = gtsam.VectorValues()
            for i, block in enumerate(self._own):
                zero.insert(i, np.zeros(len(block)))
            self._marginals = gtsam.Marginals(self._graph(np.zeros(int(self._first[-1]))), zero)
        if len(images) == 1:
            return np.asarray(self._marginals.marginalCovariance(images[0]))
        joint = self._marginals.jointMarginalCovariance(list(images))
        return np.block([[np.asarray(joint.at(a, b)) for b in images] for a in images])


def elimination_order(pattern: Pattern) -> gtsam.Ordering:
    """Order the images by COLAMD, from the pattern of the blocks."""
    import gtsam

    graph, one = gtsam.GaussianFactorGraph(), np.eye(1)
    for i in range(len(pattern.size)):
        graph.add(gtsam.HessianFactor(i, one, np.zeros(1), 0.0))
    for i, j in zip(pattern.block_row.tolist(), pattern.block_column.tolist(), strict=True):
        if i != j:
            graph.add(gtsam.HessianFactor(i, j, one, one, np.zeros(1), one, np.zeros(1), 0.0))
    return gtsam.Ordering.ColamdGaussianFactorGraph(graph)


class ReducedSystems:
    """Reduced systems of one pattern, with the method of solution for it.

    Parameters
    ----------
    pattern : Pattern
    first : (M + 1,) int array
    kind : str
        See :class:`fg_orient.adjustment.schur.SchurBackend`.
    ties : Ties, optional
        Unknowns shared by images; the matrix is then full.
    choice : Choice, optional
        Method, if it was chosen before.
    threads : int
        See :class:`LapackReduced`.
    """

    def __init__(
        self,
        pattern: Pattern,
        first: Index,
        kind: str = "blocks",
        ties: Ties | None = None,
        choice: Choice | None = None,
        threads: int = 1,
    ) -> None:
        self.pattern, self._first, self._ties, self._ordering = pattern, first, ties, None
        self._threads = threads
        #: Prediction of the chosen method; None if the kind was given.
        self.choice = choice
        if ties is not None:
            self.kind = "dense"
            return
        self._order = narrowest(pattern, first)
        if choice is None and kind in ("auto", "blocks"):
            self.choice = choose(pattern, self._order.band)
        self.kind = kind if self.choice is None else self.choice.kind
        self._ordering = elimination_order(pattern) if self.kind == "graph" else None

    def __call__(
        self,
        blocks: Array,
        diagonal: float,
        added: Array | None = None,
        chi2: float = 0.0,
        implicit: ImplicitProduct | None = None,
    ) -> Reduced:
        """Return a system of blocks (B, k, k) with ``diagonal`` and a matrix (z, z) added; Singular if not definite.

        ``chi2`` and ``implicit``: see :class:`IterativeReduced`.
        """
        plain = self._ties is None and added is None
        if plain and self._ordering is not None:
            return GraphReduced(self.pattern, self._first, blocks, diagonal, self._ordering, self._threads)
        if plain and self.kind in ("iterative", "implicit"):
            return IterativeReduced(self.pattern, self._first, blocks, diagonal, chi2, implicit, self._threads)
        order = self._order if plain and self.kind == "banded" else None
        return LapackReduced(self.pattern, self._first, blocks, diagonal, order, self._ties, added, self._threads)
