"""Reduced camera system, solved with LAPACK's Cholesky factor.

The blocks (B, k, k) of the upper triangle are in the order of ``Pattern.block_row``. The
unknowns of image i are ``first[i]`` to ``first[i + 1]``.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from scipy.linalg import blas, lapack

from factors.arrays import Array, Index
from fg_orient.adjustment.reduced_choice import LARGEST_FULL, Order, Pattern, narrowest
from fg_orient.adjustment.runtime import blas_threads
from fg_orient.kernels.batch_matrix import add_shared, fill_lower

if TYPE_CHECKING:
    from fg_orient.adjustment.ties import Ties

#: Limit of the condition number of the reduced system, scaled to a unit diagonal. Above
#: it, no covariance is computed, because the relative rounding error of a cofactor (a few
#: eps times the condition number) exceeds 1e-3.
CONDITION_LIMIT: Final = 1e13
#: With more unknowns, BLAS may use several threads. With fewer, the bits do not depend on the number of threads.
THREADED: Final = 3000
#: Maximum number of elements of a band from which blocks of the inverse are formed: 0.8 GB.
LARGEST_BAND: Final = 100_000_000
#: Maximum number of columns of a band that are solved for a covariance; for more the whole inverse is formed.
COLUMNS: Final = 1000


class Singular(RuntimeError):
    """Error: the reduced camera system is not positive definite."""


class Reduced(Protocol):
    """Reduced system of the images with the matrix ``S``."""

    @property
    def selects(self) -> bool:
        """True if :meth:`selected` is possible in time and memory."""
        ...

    def solve(self, gradient: Array) -> Array:
        """Solve ``S x = -gradient``.

        RuntimeError: S is not positive definite.
        """
        ...

    def covariance(self, images: tuple[int, ...]) -> Array:
        """Return the joint block of the inverse of S for different images, in the given order.

        RuntimeError: S is too close to singular.
        """
        ...

    def selected(self, pairs: Index) -> Array:
        """Return blocks (P, k, k) of the inverse for pairs of images (P, 2) with a block; shorter ones end with zeros.

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
        Value that is added to the diagonal: priors and damping.
    order : Order, optional
        Order of the images for the banded matrix; without an order the matrix is full.
    ties : Ties, optional
        Unknowns shared by images: the matrix is ``T^T S T`` of the free unknowns, full.
    added : (z, z) array, optional
        Matrix to add; the sum is then full.
    threads : int
        Number of threads of BLAS, used from :data:`THREADED` unknowns on: the order of
        its sums depends on them.

    Raises
    ------
    Singular
        Singular :: The matrix is not positive definite.
    """

    def __init__(
        self,
        pattern: Pattern,
        first: Index,
        blocks: Array,
        diagonal: float,
        order: Order | None = None,
        ties: Ties | None = None,
        added: Array | None = None,
        threads: int = 1,
    ) -> None:
        self._first, self._ties, self._banded = first, ties, order is not None
        n = int(first[-1]) if ties is None else len(ties)
        self._threads = threads if n >= THREADED else 1
        self._order = order or Order(first[:-1].astype(np.int64), np.arange(n), n - 1)
        # scaled to a unit diagonal, so that the limit for pivots does not depend on the units
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
        """See :class:`Reduced`; also for columns (u, k)."""
        out, scale = np.empty(gradient.shape), self._scale if gradient.ndim == 1 else self._scale[:, None]
        out[self._order.unknowns] = self._solved(-gradient[self._order.unknowns] * scale) * scale
        return out

    def _blas(self) -> AbstractContextManager[None]:
        return blas_threads(self._threads) if self._threads > 1 else nullcontext()

    def _solved(self, right: Array) -> Array:
        """Solve the scaled system, in its order, for one or more right sides."""
        substitute = lapack.dpbtrs if self._banded else lapack.dpotrs
        return np.asarray(substitute(self._factor, right, lower=1)[0])

    def covariance(self, images: tuple[int, ...]) -> Array:
        """See :class:`Reduced`.

        For a few images, columns of a band are solved; otherwise the inverse is formed.
        The blocks refer to complete image vectors, so that shared unknowns occur in each
        of them.
        """
        require_regular(self.condition())
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

    @property
    def selects(self) -> bool:
        """See :class:`Reduced`."""
        return self._ties is None

    def selected(self, pairs: Index) -> Array:
        """See :class:`Reduced`; from the band without the inverse."""
        require_regular(self.condition())
        place, size = self._order.place, np.diff(self._first)
        at = place[:, None] + np.minimum(np.arange(int(size.max())), size[:, None] - 1)
        there = np.arange(at.shape[1]) < size[:, None]
        i, j = pairs.T
        if self._banded:
            with self._blas():
                out = band_inverse(self._factor, place, size, pairs)
            out *= (self._scale[at] * there)[i][:, :, None] * (self._scale[at] * there)[j][:, None, :]
            return out
        if self._inverse is None:
            self._inverse = self._inverted()
        return np.asarray(
            self._inverse[at[i][:, :, None], at[j][:, None, :]] * (there[i][:, :, None] & there[j][:, None, :])
        )

    def _inverted(self) -> Array:
        """Return the inverse of S, also from a band: solving for columns one by one takes three times as long."""
        factor, unknowns = self._factor, self._order.unknowns
        if self._banded:
            n, band = len(self._scale), self._order.band
            factor = np.zeros((n, n), order="F")
            for c in range(n):
                factor[c : c + band + 1, c] = self._factor[: min(band + 1, n - c), c]
        with self._blas():
            half = np.asarray(lapack.dpotri(factor, lower=1)[0]).T  # the upper triangle, row by row
        half *= self._scale
        half *= self._scale[:, None]
        mirror(half)
        if not self._banded:
            return half
        out: Array = np.empty_like(half)
        out[np.ix_(unknowns, unknowns)] = half
        return out

    def condition(self) -> float:
        """Return the condition number of the scaled matrix in the 1-norm.

        The inverse's norm is estimated (Hager 1984).
        """
        if self._condition is None:
            self._condition = self._norm * inverse_norm(self._solved, len(self._scale))
        return self._condition


def banded_order(pattern: Pattern, first: Index) -> Order | None:
    """Return the narrowest order of the images for the inverse; None without a band, or if the band is too large."""
    order, n = narrowest(pattern, first), int(first[-1])
    return order if (order.band + 1) * n <= LARGEST_BAND and order.band < n - 1 else None


class LapackInverse:
    """Inverse of a system that another method solves; LAPACK computes a factor at the first use.

    Parameters as for :class:`LapackReduced`.
    """

    def __init__(self, pattern: Pattern, first: Index, blocks: Array, diagonal: float, threads: int) -> None:
        # a copy: the next linearisation overwrites the blocks before a covariance is requested
        self._at, self._threads = (pattern, first, blocks.copy(), diagonal), threads

    @property
    def blocks(self) -> Array:
        """Copy of the blocks."""
        return self._at[2]

    @cached_property
    def _order(self) -> Order | None:
        """See :func:`banded_order`."""
        return banded_order(*self._at[:2])

    @property
    def selects(self) -> bool:
        """See :class:`Reduced`."""
        return self._order is not None or int(self._at[1][-1]) <= LARGEST_FULL

    @cached_property
    def factor(self) -> LapackReduced:
        """Cholesky factor. Singular if the system is not positive definite, or too large."""
        if not self.selects:
            unknowns = int(self._at[1][-1])
            raise too_large(unknowns)
        return LapackReduced(*self._at, self._order, threads=self._threads)


def full_matrix(pattern: Pattern, first: Index, blocks: Array, ties: Ties | None) -> Array:
    """Return the symmetric matrix (z, z) of the free unknowns from the blocks: ``T^T S T`` if images share unknowns."""
    of = np.arange(first[-1]) if ties is None else ties.of
    n = len(of) if ties is None else len(ties)
    out = np.zeros((n, n))
    add_shared(pattern.block_row, pattern.block_column, first, of, pattern.size, blocks, out)
    return out


def require_regular(condition: float) -> None:
    """Raise Singular if the condition number of a scaled reduced system is too large for cofactors."""
    if not condition < CONDITION_LIMIT:
        raise Singular(f"the condition of the scaled reduced system is above {CONDITION_LIMIT:.0e}")


def too_large(unknowns: int) -> Singular:
    """Return the error for a full inverse that would have more than :data:`LARGEST_FULL` image unknowns."""
    return Singular(f"the covariance of {unknowns} image unknowns would take {8e-9 * unknowns**2:.0f} GB")


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


#: Number of rows that are mirrored together.
PART: Final = 256


def band_inverse(factor: Array, place: Index, size: Index, pairs: Index) -> Array:
    """Return blocks (P, k, k) of the inverse for pairs of images within the band; shorter ones end with zeros.

    The factor is divided into blocks that are at least as wide as its band. It is then
    block bidiagonal: ``L_k`` is on the diagonal, and ``C_k`` is below it. The inverse is
    computed from the last block upwards. With ``G = C_k L_k^-1`` and the inverse Z of the
    following blocks,

        Z_k+1,k = -Z_k+1 G,    Z_k = L_k^-T L_k^-1 + G^T Z_k+1 G

    are the parts of the inverse in which the matrix may have elements (Takahashi et al. 1973).

    Parameters
    ----------
    factor : (band + 1, n) array
        Lower Cholesky factor as LAPACK's ``dpbtrf`` gives it.
    place, size : (M,) int arrays
        First unknown of each image, and their number.
    pairs : (P, 2) int array
    """
    band, n = len(factor) - 1, factor.shape[1]
    starts, cuts = np.sort(place), [0]
    while n - cuts[-1] > band and len(later := starts[starts >= cuts[-1] + max(band, 1)]):
        cuts.append(int(later[0]))
    cuts.append(n)
    k = int(size.max(initial=1))
    out = np.zeros((len(pairs), k, k))
    turned = place[pairs[:, 0]] > place[pairs[:, 1]]
    left, right = np.where(turned[:, None], pairs[:, ::-1], pairs).T
    block_of = np.searchsorted(cuts, place[left], side="right") - 1
    order = np.argsort(block_of, kind="stable")
    ends = np.searchsorted(block_of[order], np.arange(len(cuts)))
    one = np.arange(k)
    following: Array = np.zeros((0, 0))
    for b in range(len(cuts) - 2, -1, -1):
        lo, hi = cuts[b], cuts[b + 1]
        own = _part(factor, lo, hi, lo, hi)
        inverse = np.asarray(lapack.dpotri(own, lower=1)[0]).T
        mirror(inverse)
        local = inverse
        if len(following):
            below = _part(factor, hi, cuts[b + 2], lo, hi)
            below = blas.dtrsm(1.0, own, below, side=1, lower=1)
            across = following @ below
            inverse += below.T @ across
            local = np.vstack([inverse, -across])
        here = order[ends[b] : ends[b + 1]]
        rows = np.minimum(place[right[here], None] - lo + one, len(local) - 1)
        columns = np.minimum(place[left[here], None] - lo + one, hi - lo - 1)
        blocks = local[rows[:, None, :], columns[:, :, None]]
        blocks *= (one < size[left[here], None])[:, :, None] & (one < size[right[here], None])[:, None, :]
        out[here] = np.where(turned[here, None, None], np.swapaxes(blocks, 1, 2), blocks)
        following = inverse
    return out


def _part(factor: Array, row: int, row_end: int, column: int, column_end: int) -> Array:
    """Return the rows and columns of a lower factor that is stored by its band, as a full matrix in Fortran order."""
    band = len(factor) - 1
    stored = np.ascontiguousarray(factor.T)
    step = stored.itemsize
    # element (r, c) is at r + band c of the stored numbers
    part = np.lib.stride_tricks.as_strided(
        stored.ravel()[row + band * column :], (row_end - row, column_end - column), (step, band * step)
    )
    r, c = np.arange(row, row_end)[:, None], np.arange(column, column_end)
    return np.asfortranarray(np.where((r >= c) & (r - c <= band), part, 0.0))


def mirror(matrix: Array) -> None:
    """Copy the upper triangle of a square matrix to the lower one, in parts, without a second matrix."""
    for lo in range(0, len(matrix), PART):
        own = matrix[lo : lo + PART, lo : lo + PART]
        own[:] = np.triu(own) + np.triu(own, 1).T
        matrix[lo + PART :, lo : lo + PART] = matrix[lo : lo + PART, lo + PART :].T
