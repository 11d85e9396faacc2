"""The reduced camera system solved: LAPACK's Cholesky of the full matrix, or GTSAM on its blocks.

Blocks are those of the upper triangle, (B, k, k) in the order of ``Structure.block_row``; the unknowns of image i
are ``first[i]`` to ``first[i + 1]``. GTSAM eliminates a graph of one HessianFactor per image and one per pair of
images that share points; its ordering is found once.
"""

from __future__ import annotations

from typing import Final, Protocol

import gtsam
import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from fg_orient.adjustment.schur_structure import Structure

Array = npt.NDArray[np.float64]
Bounds = npt.NDArray[np.intp]

#: Condition of the reduced system, its diagonal scaled to 1, beyond which no covariance is given: the relative
#: rounding error of a cofactor, some eps cond, passes 1e-3 there.
CONDITION_LIMIT: Final = 1e13


class Singular(RuntimeError):
    """The reduced camera system is not positive definite."""


class Reduced(Protocol):
    """A reduced system ``S``."""

    def solve(self, gradient: Array) -> Array:
        """Solve ``S x = -gradient``.

        Raises
        ------
        RuntimeError
            S is not positive definite.
        """
        ...

    def covariance(self, images: tuple[int, ...]) -> Array:
        """Joint block of the inverse of S for different images, in the order given.

        Raises
        ------
        RuntimeError
            S is too close to singular.
        """
        ...


class DenseReduced:
    """The full matrix.

    Parameters
    ----------
    structure : Structure
    first : (M + 1,) int array
    blocks : (B, k, k) array
    diagonal : float
        Added to the diagonal: priors and damping.

    Raises
    ------
    Singular
        It is not positive definite.
    """

    def __init__(self, structure: Structure, first: Bounds, blocks: Array, diagonal: float) -> None:
        self._first = first
        n = int(first[-1])
        s, size = np.zeros((n, n)), structure.size
        for b, (i, j) in enumerate(zip(structure.block_row.tolist(), structure.block_column.tolist(), strict=True)):
            s[first[i] : first[i + 1], first[j] : first[j + 1]] = blocks[b, : size[i], : size[j]]
        s.ravel()[:: n + 1] += diagonal
        d = np.diag(s).copy()
        if not (d > 0.0).all():
            raise Singular("an unknown of an image is in no observation")
        # scaled to a unit diagonal: pivots are judged alike, whatever the units
        self._scale = 1.0 / np.sqrt(d)
        s *= self._scale[:, None]
        s *= self._scale
        self._factor, info = lapack.dpotrf(s.T, lower=1, clean=0, overwrite_a=1)
        if info != 0:
            raise Singular("the reduced camera system is not positive definite")
        self._inverse: Array | None = None

    def solve(self, gradient: Array) -> Array:
        """See :class:`Reduced`."""
        x, _ = lapack.dpotrs(self._factor, -gradient * self._scale, lower=1)
        return np.asarray(x * self._scale)

    def covariance(self, images: tuple[int, ...]) -> Array:
        """See :class:`Reduced`; the inverse is formed at the first call."""
        if self._inverse is None:
            root = np.tril(self._factor)
            norm = float(np.abs(root @ root.T).sum(axis=0).max())
            reciprocal, _ = lapack.dpocon(self._factor, norm, uplo="L")
            if not reciprocal * CONDITION_LIMIT > 1.0:
                raise Singular(f"the condition of the scaled reduced system is above {CONDITION_LIMIT:.0e}")
            half = np.tril(lapack.dpotri(self._factor, lower=1)[0])
            self._inverse = (half + np.tril(half, -1).T) * np.outer(self._scale, self._scale)
        index = np.concatenate([np.arange(self._first[k], self._first[k + 1]) for k in images])
        return np.asarray(self._inverse[np.ix_(index, index)])


class GraphReduced:
    """A GTSAM graph over the images; parameters as for :class:`DenseReduced`, and the elimination order."""

    def __init__(
        self, structure: Structure, first: Bounds, blocks: Array, diagonal: float, ordering: gtsam.Ordering
    ) -> None:
        self._first, self._ordering = first, ordering
        self._off, self._own = gtsam.GaussianFactorGraph(), []
        size = structure.size.tolist()
        own = [diagonal * np.eye(k) for k in size]
        for b, (i, j) in enumerate(zip(structure.block_row.tolist(), structure.block_column.tolist(), strict=True)):
            block = blocks[b, : size[i], : size[j]]
            if i == j:
                own[i] += block
                continue
            n, m = size[i], size[j]
            self._off.add(gtsam.HessianFactor(
                i, j, np.zeros((n, n)), block, np.zeros(n), np.zeros((m, m)), np.zeros(m), 0.0
            ))  # fmt: skip
        self._own = own
        self._marginals: gtsam.Marginals | None = None

    def _graph(self, gradient: Array) -> gtsam.GaussianFactorGraph:
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
        if self._marginals is None:
            zero = gtsam.VectorValues()
            for i, block in enumerate(self._own):
                zero.insert(i, np.zeros(len(block)))
            self._marginals = gtsam.Marginals(self._graph(np.zeros(int(self._first[-1]))), zero)
        if len(images) == 1:
            return np.asarray(self._marginals.marginalCovariance(images[0]))
        found = self._marginals.jointMarginalCovariance(list(images))
        return np.block([[np.asarray(found.at(a, b)) for b in images] for a in images])


def elimination_order(structure: Structure) -> gtsam.Ordering:
    """COLAMD order of the images by the pattern of the blocks."""
    graph, one = gtsam.GaussianFactorGraph(), np.eye(1)
    for i in range(len(structure.size)):
        graph.add(gtsam.HessianFactor(i, one, np.zeros(1), 0.0))
    for i, j in zip(structure.block_row.tolist(), structure.block_column.tolist(), strict=True):
        if i != j:
            graph.add(gtsam.HessianFactor(i, j, one, one, np.zeros(1), one, np.zeros(1), 0.0))
    return gtsam.Ordering.ColamdGaussianFactorGraph(graph)
