"""Solve the reduced camera system by conjugate gradients, with or without its blocks in memory."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal

from factors.arrays import Array, Index
from fg_orient.adjustment.reduced_choice import LARGEST_FULL, Pattern
from fg_orient.adjustment.schur_reduced import LapackInverse, Reduced, Singular, too_large
from fg_orient.kernels.batch_matrix import times_blocks
from fg_orient.kernels.batch_points import reduced_product

if TYPE_CHECKING:
    from fg_orient.adjustment.schur import SchurSystem

#: Limits of conjugate gradients: minimum and maximum relative error of a step in the norm
#: of the matrix; an error in this norm that has no effect; maximum number of steps.
LEAST_ERROR: Final = 1e-10
LARGEST_ERROR: Final = 6e-3
NO_EFFECT: Final = 1e-10
MOST_STEPS: Final = 2000


class IterativeReduced:
    """Preconditioned conjugate gradients, for systems whose factorisation would take too long.

    The preconditioner consists of the diagonal blocks (block Jacobi; Hestenes & Stiefel
    1952, Agarwal et al. 2010). A step is solved only as exactly as necessary (inexact
    Newton method, Dembo, Eisenstat & Steihaug 1982). The ratio of its error in chi2 to
    the decrease of chi2 equals the ratio of this decrease to chi2; this is the size of
    the linearisation errors.

    Parameters
    ----------
    pattern : Pattern
    first : (M + 1,) int array
    blocks : (B, k, k) array
        Blocks of the matrix; the diagonal blocks are sufficient if ``implicit`` is given.
    diagonal : float
        Added to the diagonal: priors and damping.
    chi2 : float
        chi2 at the linearisation; 0: all solutions have the error :data:`LEAST_ERROR`.
    implicit : ImplicitProduct, optional
        Products with the matrix from the rows; without it from the blocks.
    threads : int
        See :class:`fg_orient.adjustment.schur_reduced.LapackReduced`.

    Raises
    ------
    Singular
        A diagonal block is not positive definite.
    """

    def __init__(
        self, pattern: Pattern, first: Index, blocks: Array, diagonal: float, chi2: float = 0.0,
        implicit: ImplicitProduct | None = None, threads: int = 1,
    ) -> None:  # fmt: skip
        self._inverse = LapackInverse(pattern, first, blocks, diagonal, threads)
        self._pattern, self._first, self._blocks = pattern, first, self._inverse.blocks
        self._k, self._chi2, self._implicit = blocks.shape[1], chi2, implicit
        self._used = np.arange(self._k) < pattern.size[:, None]
        own = pattern.block_row == pattern.block_column
        self._diagonal = np.where(self._used, diagonal, 1.0)  # shorter blocks are filled with a unit matrix
        diagonals = blocks[own] + self._diagonal[pattern.block_row[own], :, None] * np.eye(self._k)
        try:
            factors = np.linalg.cholesky(diagonals)
        except np.linalg.LinAlgError:
            raise Singular("an unknown of an image is in no observation") from None
        half = np.linalg.inv(factors)
        self._preconditioner = np.empty_like(diagonals)
        self._preconditioner[pattern.block_row[own]] = np.swapaxes(half, 1, 2) @ half

    def solve(self, gradient: Array) -> Array:
        """See :class:`Reduced`.

        The error in chi2 is the square of the error in the norm of the matrix. It is at
        most the square of the residual in the preconditioned norm divided by the least
        eigenvalue, which follows from the coefficients (Lanczos 1950).

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
        return np.asarray(np.einsum("nij,nj->ni", self._preconditioner, x))

    @cached_property
    def _factorised(self) -> Reduced:
        """Return the same system with a factor, which is computed at the first use."""
        return self._inverse.factor if self._implicit is None else self._implicit.with_blocks()

    @property
    def selects(self) -> bool:
        """See :class:`Reduced`."""
        return self._inverse.selects if self._implicit is None else int(self._first[-1]) <= LARGEST_FULL

    def covariance(self, images: tuple[int, ...]) -> Array:
        """See :class:`Reduced`; it is computed from a factor of the matrix if the factor fits into the memory."""
        return self._factorised.covariance(images)

    def selected(self, pairs: Index) -> Array:
        """See :class:`Reduced`; from a factor."""
        return self._factorised.selected(pairs)


def _least_eigenvalue(lengths: list[float], turns: list[float]) -> float:
    """Return the least eigenvalue (at most 1) of the preconditioned matrix from the coefficients of the iteration."""
    if not lengths:
        return 1.0
    length, turn = np.array(lengths), np.array(turns)[:-1]
    diagonal = 1.0 / length
    diagonal[1:] += turn / length[:-1]
    least = eigvalsh_tridiagonal(diagonal, np.sqrt(turn) / length[:-1], select="i", select_range=(0, 0))[0]
    return min(float(least), 1.0)


#: The points are divided into this number of shares with separate sums. The order of all
#: sums then does not depend on the number of threads.
SHARES: Final = 16


class ImplicitProduct:
    """Reduced matrix of a linearisation under a damping, multiplied by the rows of the image points.

    If nearly every combination of images sees a point, almost all pairs of images have a
    block, which sums only a few pairs of rays. Then it takes longer to form and read the
    blocks than to read the rows again in each product (Agarwal et al. 2010).
    """

    def __init__(self, system: SchurSystem, damping: float) -> None:
        self._system, self._damping = system, damping
        s = system.structure
        self._sums = np.empty((SHARES, len(s.size), s.width))

    @cached_property
    def _cuts(self) -> Index:
        """Return the first position of each share."""
        first = self._system.structure.first
        return np.searchsorted(first, np.linspace(0, first[-1], SHARES + 1)).astype(np.int64)

    def multiply(self, x: Array, out: Array) -> None:
        """Write the product with unknowns (M, k), without priors and damping.

        Shorter rows end with zeros.
        """
        s, b = self._system.structure, self._system.eliminated_buffers(self._damping)
        d_image, d_ground = b.kept
        self._system.backend.workers.run(
            reduced_product, SHARES, self._cuts, s.first, s.image, s.n_basis, s.n_components, s.basis, s.widened(x),
            d_image, d_ground, b.root, self._sums,
        )  # fmt: skip
        np.multiply(np.take_along_axis(self._sums.sum(axis=0), s.wide, axis=1), s.scale, out=out)

    def with_blocks(self) -> Reduced:
        """Return the same system with a full factor."""
        from fg_orient.adjustment.schur import SchurBackend

        own = self._system.backend
        unknowns = own.problem.n_image_unknowns
        if unknowns > LARGEST_FULL:
            raise too_large(unknowns)
        backend = SchurBackend(own.problem, own.workers.threads, "dense")
        backend.robust = own.robust
        return backend.linearise(self._system.state).reduced(self._damping)
