"""Cholesky factor of a banded matrix in vectors of 512 bits.

LAPACK's takes twice as long where its BLAS has no kernels for such vectors (measured: 0.51 against 0.26 ms for 432
unknowns with a band of 269, 18.4 against 9.4 for 2700 with 593). Tiles of :data:`TILE` columns from left to right: what
the columns before take away, in registers; the factor of the tile on the diagonal; the rows below solved with it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from factors._compile import threaded
from factors._contract import Array
from fg_orient.kernels.vectors import LANES, data_of, load, splat, store

#: Rows and columns of a tile; as many columns at once as fill the 32 registers of 512 bits.
TILE: Final = 24
COLUMNS: Final = 8
VECTORS: Final = TILE // LANES
#: Whether the processor has the vectors this is written for: with others it is right, but not faster than LAPACK.
PAYS: Final = LANES == 8
#: Numbers of a column below the band: whole tiles reach so far, and a square one on the diagonal as far above it.
MARGIN: Final = 2 * TILE


def _variable(builder: Any) -> Any:
    """A vector that keeps its register from one round of a loop to the next."""
    make: Callable[..., Any] = cgutils.alloca_once
    return make(builder, ir.VectorType(ir.DoubleType(), LANES))


def _take(builder: Any, a: Any, b: Any, total: Any) -> None:
    """Subtract ``a b``, fused, from a variable."""
    product = builder.fmul(a, b, flags=("contract",))
    builder.store(builder.fsub(builder.load(total), product, flags=("contract",)), total)


def _less_products(
    typing: Any, out: Any, at: Any, apart: Any, s: Any, c: Any, a: Any, b: Any, stride: Any, count: Any
) -> Any:  # fmt: skip
    """Write ``C - A B^T``, columns ``apart``, from place ``at`` of ``out``.

    C (24, 8) from place c of ``s``, A (24, count) from a, B (8, count) from b, all with columns ``stride`` apart.
    """
    place = types.intp
    signature = types.void(out, place, place, s, place, place, place, place, place)

    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        target, source = (data_of(context, builder, given.args[k], arguments[k]) for k in (0, 3))
        begin, spacing, first, left, right, step, number = (arguments[k] for k in (1, 2, 4, 5, 6, 7, 8))

        def column(base: Any, start: Any, k: int, width: Any) -> Any:
            return builder.gep(base, [builder.add(start, builder.mul(ir.Constant(start.type, k), width))])

        rows = [ir.Constant(first.type, v * LANES) for v in range(VECTORS)]
        sums = [[_variable(builder) for _ in rows] for _ in range(COLUMNS)]
        for k in range(COLUMNS):
            for total, row in zip(sums[k], rows, strict=True):
                builder.store(load(builder, column(source, first, k, step), row), total)
        with cgutils.for_range(builder, number) as loop:
            behind = builder.mul(loop.index, step)
            own = builder.gep(source, [builder.add(left, behind)])
            others = builder.gep(source, [builder.add(right, behind)])
            taken = [load(builder, own, row) for row in rows]
            for k in range(COLUMNS):
                factor = splat(builder, builder.load(builder.gep(others, [ir.Constant(first.type, k)])))
                for part, total in zip(taken, sums[k], strict=True):
                    _take(builder, part, factor, total)
        for k in range(COLUMNS):
            for v in range(VECTORS):
                store(builder, builder.load(sums[k][v]), column(target, begin, k, spacing), v * LANES)
        return context.get_dummy_value()

    return signature, generate


def _less_columns(typing: Any, x: Any, at: Any, stride: Any, factors: Any, c: Any) -> Any:
    """Take from column c of a tile of ``x`` the c columns before it times ``factors[p TILE + c]``."""
    place = types.intp
    signature = types.void(x, place, place, factors, place)

    def generate(context: Any, builder: Any, given: Any, arguments: Any) -> Any:
        base, number = (data_of(context, builder, given.args[k], arguments[k]) for k in (0, 3))
        step, count = arguments[2], arguments[4]
        first = builder.gep(base, [arguments[1]])
        rows = [ir.Constant(step.type, v * LANES) for v in range(VECTORS)]
        column = builder.gep(first, [builder.mul(count, step)])
        sums = [_variable(builder) for _ in rows]
        for total, row in zip(sums, rows, strict=True):
            builder.store(load(builder, column, row), total)
        with cgutils.for_range(builder, count) as loop:
            at_factor = builder.add(builder.mul(loop.index, ir.Constant(step.type, TILE)), count)
            factor = splat(builder, builder.load(builder.gep(number, [at_factor])))
            other = builder.gep(first, [builder.mul(loop.index, step)])
            for total, row in zip(sums, rows, strict=True):
                _take(builder, load(builder, other, row), factor, total)
        for v, total in enumerate(sums):
            store(builder, builder.load(total), column, v * LANES)
        return context.get_dummy_value()

    return signature, generate


_less: Callable[..., None] = intrinsic(_less_products)
_reduce: Callable[..., None] = intrinsic(_less_columns)


@threaded
def _scale(x: Array, at: int, factor: float) -> None:
    """Multiply a column of a tile."""
    for r in range(at, at + TILE):
        x[r] *= factor


@threaded
def _factorise_tile(t: Array, inverse: Array) -> bool:
    """Cholesky factor of a tile in place, column by column, and one over its diagonal; False: not definite."""
    for c in range(TILE):
        _reduce(t, 0, TILE, t, c)
        if not t[c * TILE + c] > 0.0:
            return False
        inverse[c] = 1.0 / np.sqrt(t[c * TILE + c])
        _scale(t, c * TILE, inverse[c])
    return True


@threaded
def _solve_tile(x: Array, at: int, stride: int, t: Array, inverse: Array) -> None:
    """Solve ``X L^T = C`` in place: C from a place, L the factor t."""
    for c in range(TILE):
        _reduce(x, at, stride, t, c)
        _scale(x, at + c * stride, inverse[c])


@threaded
def factorise_band(s: Array, band: int) -> int:
    """Replace a positive definite matrix by its lower Cholesky factor.

    Parameters
    ----------
    s : (n, band + MARGIN + 1) array
        Element (r, c) of the lower triangle at ``[c, r - c]``; n is a multiple of TILE, all below the band zero.

    Returns
    -------
    int
        0, or the 1-based column at which it is not positive definite.
    """
    n, stride, flat = s.shape[0], s.shape[1] - 1, s.ravel()
    t, inverse = np.empty(TILE * TILE), np.empty(TILE)
    for j in range(0, n, TILE):
        for i in range(j, min(n, j + TILE + band), TILE):
            k = min(max(0, i - band), j)
            for q in range(0, TILE, COLUMNS):
                c, a, b = (j + q) * stride + i, k * stride + i, k * stride + j + q
                if i == j:
                    _less(t, q * TILE, TILE, flat, c, a, b, stride, j - k)
                else:
                    _less(flat, c, stride, flat, c, a, b, stride, j - k)
            if i > j:
                _solve_tile(flat, j * stride + i, stride, t, inverse)
                continue
            if not _factorise_tile(t, inverse):
                return j + 1
            for c in range(TILE):
                for r in range(c, TILE):
                    flat[(j + c) * stride + j + r] = t[c * TILE + r]
    return 0
