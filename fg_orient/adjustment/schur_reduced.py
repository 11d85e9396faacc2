"""Solution of the reduced camera system: LAPACK's Cholesky factor, GTSAM on its blocks, or conjugate gradients.

The blocks (B, k, k) of the upper triangle are in the order of ``Pattern.block_row``. The unknowns of image i are
``first[i]`` to ``first[i + 1]``. GTSAM eliminates a graph of one HessianFactor per image and one per pair of images
that share points; its ordering is computed once.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal, lapack

from factors.arrays import Array, Index
from fg_orient.adjustment.reduced_choice import LARGEST_FULL, Choice, Order, Pattern, choose, narrowest
from fg_orient.adjustment.runtime import blas_threads
from fg_orient.kernels.batch_matrix import add_shared, fill_lower, times_blocks

if TYPE_CHECKING:
    import gtsam

    from fg_orient.adjustment.ties import Ties

#: Limit of the condition number of the reduced system, scaled to a unit diagonal. Above it there is no covariance: the
#: relative rounding error of a cofactor, a few eps cond, exceeds 1e-3.
CONDITION_LIMIT: Final = 1e13
#: Unknowns from which on BLAS may take more threads than one: below the bits do not depend on their number.
THREADED: Final = 3000
#: Columns of a band that are solved for a covariance; of more the whole inverse is formed.
COLUMNS: Final = 1000
REDUCED: Final = ("auto", "blocks", "dense", "banded", "graph", "iterative", "implicit")
#: Least and largest error of a step of conjugate gradients, relative in the norm of the matrix; error in that norm that
#: has no effect; most steps.
LEAST_ERROR: Final = 1e-10
LARGEST_ERROR: Final = 6e-3
NO_EFFECT: Final = 1e-10
MOST_STEPS: Final = 2000


class Singular(RuntimeError):
    """The reduced camera system is not positive definite."""


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
    threads : int
        Threads of BLAS, from :data:`THREADED` unknowns on: the order of its sums depends on them.

    Raises
    ------
    Singular
        It is not positive definite.
    """

    def __init__(
        self, pattern: Pattern, first: Index, blocks: Array, diagonal: float, order: Order | None = None,
        ties: Ties | None = None, added: Array | None = None, threads: int = 1,
    ) -> None:  # fmt: skip
        self._first, self._ties, self._banded = first, ties, order is not None
        n = int(first[-1]) if ties is None else len(ties)
        self._threads = threads if n >= THREADED else 1
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
        with self._blas():
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

    def _blas(self) -> AbstractContextManager[None]:
        return blas_threads(self._threads) if self._threads > 1 else nullcontext()

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
        if self._banded and (len(images) < len(self._first) - 1 or len(index) > COLUMNS):
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
        with self._blas():
            half = np.tril(lapack.dpotri(factor, lower=1)[0])
        out: Array = np.empty_like(half)
        out[np.ix_(unknowns, unknowns)] = (half + np.tril(half, -1).T) * np.outer(self._scale, self._scale)
        return out

    def condition(self) -> float:
        """Condition number of the scaled matrix in the 1-norm; the norm of the inverse is estimated (Hager 1984)."""
        if self._condition is None:
            self._condition = self._norm * inverse_norm(self._solved, len(self._scale))
        return self._condition


def full_matrix(pattern: Pattern, first: Index, blocks: Array, ties: Ties | None) -> Array:
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


class GraphReduced:
    """A GTSAM graph over the images; parameters as for :class:`LapackReduced`, and the elimination order."""

    def __init__(
        self, pattern: Pattern, first: Index, blocks: Array, diagonal: float, ordering: gtsam.Ordering
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


class Implicit(Protocol):
    """A reduced matrix without its blocks."""

    def multiply(self, x: Array, out: Array) -> None:
        """Write the product with unknowns (M, k), without priors and damping; shorter rows end with zeros."""
        ...

    def with_blocks(self) -> Reduced:
        """The same system with a full factor."""
        ...


class IterativeReduced:
    """Preconditioned conjugate gradients, where a factor of the matrix would take too long.

    The preconditioner is the diagonal blocks (block Jacobi; Hestenes & Stiefel 1952, Agarwal et al. 2010). A step is
    solved as exactly as it is worth (inexact Newton method, Dembo, Eisenstat & Steihaug 1982): its error in chi2 is to
    the decrease of chi2 as that decrease is to chi2, as the errors of linearisation are.

    Parameters
    ----------
    pattern : Pattern
    first : (M + 1,) int array
    blocks : (B, k, k) array
        The diagonal blocks suffice if ``implicit`` is given.
    diagonal : float
        Added to the diagonal: priors and damping.
    chi2 : float
        Where the system was linearised; 0: :data:`LEAST_ERROR` for all solutions.
    implicit : Implicit, optional
        Products with the matrix from the rows; else from the blocks.

    Raises
    ------
    Singular
        A diagonal block is not positive definite.
    """

    def __init__(
        self, pattern: Pattern, first: Index, blocks: Array, diagonal: float, chi2: float = 0.0,
        implicit: Implicit | None = None,
    ) -> None:  # fmt: skip
        # a copy: the next linearisation overwrites the blocks before a covariance is wanted
        self._pattern, self._first, self._blocks, self._shift = pattern, first, blocks.copy(), diagonal
        self._k, self._chi2, self._implicit = blocks.shape[1], chi2, implicit
        self._dense: Reduced | None = None
        self._used = np.arange(self._k) < pattern.size[:, None]
        own = pattern.block_row == pattern.block_column
        self._diagonal = np.where(self._used, diagonal, 1.0)  # shorter blocks end with a unit matrix
        diagonals = blocks[own] + self._diagonal[pattern.block_row[own], :, None] * np.eye(self._k)
        try:
            factors = np.linalg.cholesky(diagonals)
        except np.linalg.LinAlgError:
            raise Singular("an unknown of an image is in no observation") from None
        half = np.linalg.inv(factors)
        self._inverse = np.empty_like(diagonals)
        self._inverse[pattern.block_row[own]] = np.swapaxes(half, 1, 2) @ half

    def solve(self, gradient: Array) -> Array:
        """See :class:`Reduced`.

        The square of the error in the norm of the matrix, which is the error in chi2, is at most that of the residual
        in the preconditioned norm over the least eigenvalue, which the coefficients give (Lanczos 1950).

        RuntimeError: more than :data:`MOST_STEPS` steps.
        """
        right = np.zeros(self._used.shape)
        right[self._used] = -gradient
        x, residual, product = np.zeros_like(right), right, np.empty_like(right)
        scaled = self._preconditioned(residual)
        direction, size = scaled, float(np.vdot(residual, scaled))
        decrease, lengths, turns = 0.0, list[float](), list[float]()
        for _ in range(MOST_STEPS):
            share = min(decrease / self._chi2, LARGEST_ERROR**2) if self._chi2 > 0.0 else 0.0
            enough = max(share * decrease, LEAST_ERROR**2 * decrease, NO_EFFECT**2)
            if size <= enough and size <= enough * _least_eigenvalue(lengths, turns):
                return np.asarray(x[self._used])
            self._multiply(direction, product)
            product += self._diagonal * direction
            curvature = float(np.vdot(direction, product))
            if not curvature > 0.0:
                raise Singular("the reduced camera system is not positive definite")
            length = size / curvature
            decrease += length * size
            x, residual = x + length * direction, residual - length * product
            scaled = self._preconditioned(residual)
            size, before = float(np.vdot(residual, scaled)), size
            direction = scaled + size / before * direction
            lengths.append(length)
            turns.append(size / before)
        raise Singular(f"conjugate gradients of the reduced system do not converge in {MOST_STEPS} steps")

    def _multiply(self, x: Array, out: Array) -> None:
        """Write the product with the matrix without priors and damping."""
        if self._implicit is None:
            times_blocks(self._pattern.block_row, self._pattern.block_column, self._blocks, x, out)
        else:
            self._implicit.multiply(x, out)

    def _preconditioned(self, x: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", self._inverse, x))

    def covariance(self, images: tuple[int, ...]) -> Array:
        """See :class:`Reduced`; from a full factor, which is formed now, where it fits into the memory."""
        if self._dense is None:
            unknowns = int(self._first[-1])
            if unknowns > LARGEST_FULL:
                raise Singular(f"the covariance of {unknowns} image unknowns would take {8e-9 * unknowns**2:.0f} GB")
            self._dense = (
                LapackReduced(self._pattern, self._first, self._blocks, self._shift)
                if self._implicit is None else self._implicit.with_blocks()
            )  # fmt: skip
        return self._dense.covariance(images)


def _least_eigenvalue(lengths: list[float], turns: list[float]) -> float:
    """Least eigenvalue of the preconditioned matrix, from the coefficients of conjugate gradients, 1 at most."""
    if not lengths:
        return 1.0
    length, turn = np.array(lengths), np.array(turns)[:-1]
    diagonal = 1.0 / length
    diagonal[1:] += turn / length[:-1]
    least = eigvalsh_tridiagonal(diagonal, np.sqrt(turn) / length[:-1], select="i", select_range=(0, 0))[0]
    return min(float(least), 1.0)


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
        See :class:`fg_orient.adjustment.schur.SchurBackend`.
    ties : Ties, optional
        Unknowns shared by images; the matrix is then full.
    choice : Choice, optional
        Method, chosen before.
    threads : int
        See :class:`LapackReduced`.
    """

    def __init__(
        self, pattern: Pattern, first: Index, kind: str = "blocks", ties: Ties | None = None,
        choice: Choice | None = None, threads: int = 1,
    ) -> None:  # fmt: skip
        self.pattern, self._first, self._ties, self._ordering = pattern, first, ties, None
        self._threads = threads
        #: Prediction of the chosen method; None where the kind was given.
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
        self, blocks: Array, diagonal: float, added: Array | None = None, chi2: float = 0.0,
        implicit: Implicit | None = None,
    ) -> Reduced:  # fmt: skip
        """System of these blocks (B, k, k) with ``diagonal`` and a matrix (z, z) added; Singular if not definite.

        ``chi2`` and ``implicit``: see :class:`IterativeReduced`.
        """
        plain = self._ties is None and added is None
        if plain and self._ordering is not None:
            return GraphReduced(self.pattern, self._first, blocks, diagonal, self._ordering)
        if plain and self.kind in ("iterative", "implicit"):
            return IterativeReduced(self.pattern, self._first, blocks, diagonal, chi2, implicit)
        order = self._order if plain and self.kind == "banded" else None
        return LapackReduced(self.pattern, self._first, blocks, diagonal, order, self._ties, added, self._threads)
