"""Solution of the reduced camera system: LAPACK's Cholesky factor of the full or banded matrix, or GTSAM on its blocks.

The blocks (B, k, k) of the upper triangle are in the order of ``Pattern.block_row``. The unknowns of image i are
``first[i]`` to ``first[i + 1]``. GTSAM eliminates a graph of one HessianFactor per image and one per pair of images
that share points; its ordering is computed once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from factors.arrays import Array
from fg_orient.kernels.batch_matrix import add_shared, fill_lower

if TYPE_CHECKING:
    import gtsam

    from fg_orient.adjustment.ties import Ties

Bounds = npt.NDArray[np.intp]
Index = npt.NDArray[np.int64]

#: Limit of the condition number of the reduced system, scaled to a unit diagonal. Above it there is no covariance: the
#: relative rounding error of a cofactor, a few eps cond, exceeds 1e-3.
CONDITION_LIMIT: Final = 1e13
#: A band of up to this share of the matrix is used. LAPACK's banded and full factorisations and GTSAM took 1.7, 2.1
#: and 3.3 ms for 432 unknowns with a band of 0.62; 6.4, 14.5 and 20 ms for 972 with 0.39; 40, 204 and 92 ms for 2700
#: with 0.22 (measured, blocks of 4 x 4, 6 x 6 and 10 x 10 scenes).
BANDED: Final = 0.65
#: Elements of the largest band: 0.24 GB.
BAND_LIMIT: Final = 30_000_000
#: Without a band, the full matrix is used up to DENSE_LIMIT unknowns, and up to FULL_LIMIT unless fewer than SPARSE of
#: the blocks exist: then GTSAM solves the system. A full matrix of FULL_LIMIT unknowns takes 0.5 GB; GTSAM needs six
#: times LAPACK's time for it (measured at 3060).
DENSE_LIMIT: Final = 1000
FULL_LIMIT: Final = 8000
SPARSE: Final = 1.0 / 3.0
REDUCED: Final = ("auto", "dense", "banded", "graph")


class Singular(RuntimeError):
    """The reduced camera system is not positive definite."""


class Pattern(NamedTuple):
    """Blocks of a reduced system: unknowns (M,) of each image; images (B,) of each block, row <= column."""

    size: Index
    block_row: Index
    block_column: Index


class Reduced(Protocol):
    """A reduced system ``S``."""

    def solve(self, gradient: Array) -> Array:
        """Solve ``S x = -gradient``.

        RuntimeError: S is not positive definite.
        """
        ...

    def covariance(self, images: tuple[int, ...]) -> Array:
        """Joint block of the inverse of S for different images, in the given order.

        RuntimeError: S is too close to singular.
        """
        ...


class LapackReduced:
    """Cholesky factor of the full matrix, or of its band if an order of the images makes it narrow.

    Parameters
    ----------
    pattern : Pattern
    first : (M + 1,) int array
    blocks : (B, k, k) array
    diagonal : float
        Added to the diagonal: priors and damping.
    order : Order, optional
        Order of the images for the banded matrix; without an order the matrix is full.
    ties : Ties, optional
        Unknowns shared by images: the matrix is ``T^T S T`` of the free unknowns, full.
    added : (z, z) array, optional
        Added to the matrix, which is then full.

    Raises
    ------
    Singular
        It is not positive definite.
    """

    def __init__(
        self, pattern: Pattern, first: Bounds, blocks: Array, diagonal: float, order: Order | None = None,
        ties: Ties | None = None, added: Array | None = None,
    ) -> None:  # fmt: skip
        self._first, self._ties, self._banded = first, ties, order is not None
        n = int(first[-1]) if ties is None else len(ties)
        self._order = order or Order(first[:-1].astype(np.int64), np.arange(n), n - 1)
        # scaled to a unit diagonal: the limit for pivots does not depend on the units
        if ties is None and added is None:
            self._scale, sums, s = np.empty(n), np.empty(n), np.zeros((n, self._order.band + 1))
            at = (pattern.block_row, pattern.block_column, self._order.place, pattern.size, blocks)
            regular = fill_lower(*at, diagonal, self._banded, s, self._scale, sums)
            s.ravel()[:: s.shape[1] + (0 if self._banded else 1)] = 1.0
        else:
            s = full_matrix(pattern, first, blocks, ties)
            s[np.arange(n), np.arange(n)] += diagonal
            s += 0.0 if added is None else added
            d = np.diag(s)
            regular = bool((d > 0.0).all())
            self._scale = 1.0 / np.sqrt(np.where(d > 0.0, d, 1.0))
            s *= np.outer(self._scale, self._scale)
            sums = np.abs(s).sum(axis=0)
        if not regular:
            raise Singular("an unknown of an image is in no observation")
        self._norm = float(sums.max())
        self._factor: Any
        if self._banded:
            self._factor, info = lapack.dpbtrf(s.T, lower=1, overwrite_ab=1)
        else:
            self._factor, info = lapack.dpotrf(s.T, lower=1, clean=0, overwrite_a=1)
        if info != 0:
            raise Singular("the reduced camera system is not positive definite")
        self._inverse: Array | None = None
        self._condition: float | None = None

    def solve(self, gradient: Array) -> Array:
        """See :class:`Reduced`."""
        out = np.empty(len(self._scale))
        out[self._order.unknowns] = self._solved(-gradient[self._order.unknowns] * self._scale) * self._scale
        return out

    def _solved(self, right: Array) -> Array:
        """Solve the scaled system, in its order, for one or more right sides."""
        substitute = lapack.dpbtrs if self._banded else lapack.dpotrs
        return np.asarray(substitute(self._factor, right, lower=1)[0])

    def covariance(self, images: tuple[int, ...]) -> Array:
        """See :class:`Reduced`; for some images columns of a band are solved, else the inverse is formed.

        The blocks refer to complete image vectors: shared unknowns occur in each.
        """
        if not self.condition() < CONDITION_LIMIT:
            raise Singular(f"the condition of the scaled reduced system is above {CONDITION_LIMIT:.0e}")
        index = np.concatenate([np.arange(self._first[k], self._first[k + 1]) for k in images])
        index = index if self._ties is None else self._ties.of[index]
        if self._banded and (len(images) < len(self._first) - 1 or len(index) > DENSE_LIMIT):
            place = np.empty(len(self._scale), np.int64)
            place[self._order.unknowns] = np.arange(len(place))
            right = np.zeros((len(self._scale), len(index)), order="F")
            right[place[index], np.arange(len(index))] = self._scale[place[index]]
            return np.asarray(self._solved(right)[place[index]] * self._scale[place[index], None])
        if self._inverse is None:
            self._inverse = self._inverted()
        return np.asarray(self._inverse[np.ix_(index, index)])

    def _inverted(self) -> Array:
        """Inverse of S, also from a band: solving for columns one by one takes three times as long."""
        factor, unknowns = self._factor, self._order.unknowns
        if self._banded:
            n, band = len(self._scale), self._order.band
            factor = np.zeros((n, n), order="F")
            for c in range(n):
                factor[c : c + band + 1, c] = self._factor[: min(band + 1, n - c), c]
        half = np.tril(lapack.dpotri(factor, lower=1)[0])
        out: Array = np.empty_like(half)
        out[np.ix_(unknowns, unknowns)] = (half + np.tril(half, -1).T) * np.outer(self._scale, self._scale)
        return out

    def condition(self) -> float:
        """Condition number of the scaled matrix in the 1-norm; the norm of the inverse is estimated (Hager 1984)."""
        if self._condition is None:
            self._condition = self._norm * inverse_norm(self._solved, len(self._scale))
        return self._condition


def full_matrix(pattern: Pattern, first: Bounds, blocks: Array, ties: Ties | None) -> Array:
    """Symmetric matrix (z, z) of the free unknowns from the blocks: ``T^T S T`` where images share unknowns."""
    of = np.arange(first[-1]) if ties is None else ties.of
    n = len(of) if ties is None else len(ties)
    out = np.zeros((n, n))
    add_shared(pattern.block_row, pattern.block_column, first, of, pattern.size, blocks, out)
    return out


def inverse_norm(solve: Callable[[Array], Array], n: int) -> float:
    """Estimate the 1-norm of the inverse of a symmetric matrix from solutions with it (Hager 1984, algorithm 1)."""
    x, estimate = np.full(n, 1.0 / n), 0.0
    for _ in range(5):
        y = solve(x)
        estimate = max(estimate, float(np.abs(y).sum()))
        z = solve(np.where(y >= 0.0, 1.0, -1.0))
        j = int(np.argmax(np.abs(z)))
        if np.abs(z[j]) <= z @ x:
            break
        x = np.zeros(n)
        x[j] = 1.0
    return estimate


@dataclass(frozen=True)
class Order:
    """An order of the images: first unknown (M,) of each image, and all unknowns (u,).

    ``band`` is the number of elements of a column of the lower triangle below the diagonal.
    """

    place: Index
    unknowns: Index
    band: int


def narrowest(pattern: Pattern, first: Bounds) -> Order:
    """Order of the images with the narrower band: as given, or reversed Cuthill-McKee (George & Liu 1981)."""
    images = len(pattern.size)
    if len(pattern.block_row) == images * (images + 1) // 2:  # all images share points: the order has no effect
        return Order(first[:-1].astype(np.int64), np.arange(first[-1]), int(first[-1]) - 1)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    links = coo_array((np.ones(len(pattern.block_row)), (pattern.block_row, pattern.block_column)), (images, images))
    orders = []
    for order in (np.arange(images), reverse_cuthill_mckee((links + links.T).tocsr(), symmetric_mode=True)):
        place = np.empty(images, np.int64)
        place[order] = np.concatenate([[0], np.cumsum(pattern.size[order])[:-1]])
        begin = np.minimum(place[pattern.block_row], place[pattern.block_column])
        end = np.maximum(
            place[pattern.block_row] + pattern.size[pattern.block_row],
            place[pattern.block_column] + pattern.size[pattern.block_column],
        )
        unknowns = np.concatenate([np.arange(first[k], first[k + 1]) for k in order])
        orders.append(Order(place, unknowns, int((end - begin).max(initial=1)) - 1))
    return min(orders, key=lambda o: o.band)


class GraphReduced:
    """A GTSAM graph over the images; parameters as for :class:`LapackReduced`, and the elimination order."""

    def __init__(
        self, pattern: Pattern, first: Bounds, blocks: Array, diagonal: float, ordering: gtsam.Ordering
    ) -> None:
        import gtsam

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
    """COLAMD order of the images by the pattern of the blocks."""
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
        "dense": LAPACK on the full matrix; "banded": on its band; "graph": GTSAM on its blocks; "auto": by size.
    ties : Ties, optional
        Unknowns shared by images; the matrix is then full.
    """

    def __init__(self, pattern: Pattern, first: Bounds, kind: str = "auto", ties: Ties | None = None) -> None:
        self.pattern, self._first, self._ties, self._ordering = pattern, first, ties, None
        if ties is not None:
            self.kind = "dense"
            return
        self._order = narrowest(pattern, first)
        self.kind = _suitable(pattern, int(first[-1]), self._order.band) if kind == "auto" else kind
        self._ordering = elimination_order(pattern) if self.kind == "graph" else None

    def __call__(self, blocks: Array, diagonal: float, added: Array | None = None) -> Reduced:
        """System of these blocks (B, k, k) with ``diagonal`` and a matrix (z, z) added; Singular if not definite."""
        if self._ties is not None or added is not None:
            return LapackReduced(self.pattern, self._first, blocks, diagonal, ties=self._ties, added=added)
        if self._ordering is not None:
            return GraphReduced(self.pattern, self._first, blocks, diagonal, self._ordering)
        order = self._order if self.kind == "banded" else None
        return LapackReduced(self.pattern, self._first, blocks, diagonal, order)


def _suitable(pattern: Pattern, unknowns: int, band: int) -> str:
    """Fastest kind of solution for a pattern."""
    if band <= BANDED * unknowns and (band + 1) * unknowns <= BAND_LIMIT:
        return "banded"
    images = len(pattern.size)
    share = 2.0 * len(pattern.block_row) / (images * (images + 1))
    return "graph" if unknowns > FULL_LIMIT or (unknowns > DENSE_LIMIT and share < SPARSE) else "dense"
