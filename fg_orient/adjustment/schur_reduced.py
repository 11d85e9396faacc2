"""The reduced camera system solved: LAPACK's Cholesky of the full matrix, or GTSAM on its blocks.

Blocks are those of the upper triangle, (B, k, k) in the order of ``Pattern.block_row``; the unknowns of image i
are ``first[i]`` to ``first[i + 1]``. GTSAM eliminates a graph of one HessianFactor per image and one per pair of
images that share points; its ordering is found once.
"""

from __future__ import annotations

from typing import Final, Protocol

import gtsam
import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

Array = npt.NDArray[np.float64]
Bounds = npt.NDArray[np.intp]
Index = npt.NDArray[np.int64]

#: Condition of the reduced system, its diagonal scaled to 1, beyond which no covariance is given: the relative
#: rounding error of a cofactor, some eps cond, passes 1e-3 there.
CONDITION_LIMIT: Final = 1e13
#: Reduced unknowns up to which the full matrix is always taken, and at all. Between them GTSAM gets systems with fewer
#: than SPARSE of the blocks. Dense against GTSAM: about equal at 972 unknowns with 0.46 of the blocks, 68 and 42 ms at
#: 1728 and 0.22, 219 and 102 ms at 2700 and 0.15 (measured; benchmarks/schur_cost.py --reduced).
DENSE_LIMIT: Final = 1000
FULL_LIMIT: Final = 3000
SPARSE: Final = 1.0 / 3.0
REDUCED: Final = ("auto", "dense", "graph")


class Singular(RuntimeError):
    """The reduced camera system is not positive definite."""


class Pattern(Protocol):
    """Blocks of a reduced system: those of a ``Structure``, or of the sum of several.

    ``size`` (M,): unknowns of each image; ``block_row``, ``block_column`` (B,): images of each block.
    """

    @property
    def size(self) -> Index:
        """Unknowns."""
        ...

    @property
    def block_row(self) -> Index:
        """Images."""
        ...

    @property
    def block_column(self) -> Index:
        """Images."""
        ...


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
    pattern : Pattern
    first : (M + 1,) int array
    blocks : (B, k, k) array
    diagonal : float
        Added to the diagonal: priors and damping.

    Raises
    ------
    Singular
        It is not positive definite.
    """

    def __init__(self, pattern: Pattern, first: Bounds, blocks: Array, diagonal: float) -> None:
        self._first = first
        n = int(first[-1])
        s, size = np.zeros((n, n)), pattern.size
        for b, (i, j) in enumerate(zip(pattern.block_row.tolist(), pattern.block_column.tolist(), strict=True)):
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
        self, pattern: Pattern, first: Bounds, blocks: Array, diagonal: float, ordering: gtsam.Ordering
    ) -> None:
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


def elimination_order(pattern: Pattern) -> gtsam.Ordering:
    """COLAMD order of the images by the pattern of the blocks."""
    graph, one = gtsam.GaussianFactorGraph(), np.eye(1)
    for i in range(len(pattern.size)):
        graph.add(gtsam.HessianFactor(i, one, np.zeros(1), 0.0))
    for i, j in zip(pattern.block_row.tolist(), pattern.block_column.tolist(), strict=True):
        if i != j:
            graph.add(gtsam.HessianFactor(i, j, one, one, np.zeros(1), one, np.zeros(1), 0.0))
    return gtsam.Ordering.ColamdGaussianFactorGraph(graph)


class ReducedSystems:
    """Reduced systems of one pattern, solved by what suits it.

    Parameters
    ----------
    pattern : Pattern
    first : (M + 1,) int array
    kind : str
        "dense": LAPACK on the full matrix; "graph": GTSAM on its blocks; "auto": by size.
    """

    def __init__(self, pattern: Pattern, first: Bounds, kind: str = "auto") -> None:
        self.pattern, self._first = pattern, first
        sparse = _sparse(pattern, int(first[-1])) if kind == "auto" else kind == "graph"
        self._ordering: gtsam.Ordering | None = elimination_order(pattern) if sparse else None

    def __call__(self, blocks: Array, diagonal: float) -> Reduced:
        """The system of these blocks (B, k, k), ``diagonal`` added.

        Raises
        ------
        Singular
            It is not positive definite.
        """
        if self._ordering is None:
            return DenseReduced(self.pattern, self._first, blocks, diagonal)
        return GraphReduced(self.pattern, self._first, blocks, diagonal, self._ordering)


def _sparse(pattern: Pattern, unknowns: int) -> bool:
    """Whether the reduced system is left to GTSAM."""
    images = len(pattern.size)
    share = 2.0 * len(pattern.block_row) / (images * (images + 1))
    return unknowns > FULL_LIMIT or (unknowns > DENSE_LIMIT and share < SPARSE)
