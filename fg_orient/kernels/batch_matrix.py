"""Functions that copy blocks of the reduced system into the full or banded matrix that LAPACK factorises."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from factors._compile import threaded
from factors._contract import Array
from fg_orient.kernels.batch_rows import Index
from fg_orient.kernels.vectors import LINE, SIDE, contiguous, data_of, load, splat, store, total_of


def _write_lines(
    typing: Any, out: Any, to: Any, given: Any, at: Any, scale: Any, begin: Any, sums: Any, factor: Any, lines: Any
) -> Any:
    """Write numbers times ``scale``, from ``begin`` times ``factor``, eight per line; add absolute values to ``sums``.

    Return the sum of the absolute values.
    """
    contiguous(out, given, scale, sums)
    place, number = types.intp, types.float64
    signature = number(out, place, given, place, scale, place, sums, number, place)

    def generate(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        data = [data_of(context, builder, kinds.args[k], arguments[k]) for k in (0, 2, 4, 6)]
        begins = [builder.gep(base, [arguments[k]]) for base, k in zip(data, (1, 3, 5, 5), strict=True)]
        make: Any = cgutils.alloca_once
        total, here = make(builder, LINE), splat(builder, arguments[7], SIDE)
        builder.store(ir.Constant(LINE, [0.0] * SIDE), total)
        absolute = builder.module.declare_intrinsic("llvm.fabs.v8f64", (), ir.FunctionType(LINE, [LINE]))
        with cgutils.for_range(builder, arguments[8]) as loop:
            step = builder.mul(loop.index, ir.Constant(loop.index.type, SIDE))
            target, source, scales, added = begins
            scaled = builder.fmul(load(builder, source, step, SIDE), load(builder, scales, step, SIDE))
            line = builder.fmul(scaled, here)
            store(builder, line, target, step)
            size = builder.call(absolute, [line])
            store(builder, builder.fadd(load(builder, added, step, SIDE), size), added, step)
            builder.store(builder.fadd(builder.load(total), size), total)
        return total_of(builder, builder.load(total))

    return signature, generate


#: Only for compiled code; numba supplies the first argument.
write_lines: Callable[..., float] = intrinsic(_write_lines)


@threaded
def fill_lower(
    row: Index,
    column: Index,
    place: Index,
    size: Index,
    blocks: Array,
    diagonal: float,
    banded: bool,
    out: Array,
    scale: Array,
    sums: Array,
) -> bool:
    """Write the scaled lower triangle by columns: element (r, c) to ``out[c, r]``, banded to ``out[c, r - c]``.

    Return False, and write nothing, if a diagonal element is not positive.

    Parameters
    ----------
    row, column : (B,) int arrays
        Row image and column image of each block (B, k, k); diagonal blocks are symmetric.
    place, size : (M,) int arrays
        Place in the matrix of the first unknown of each image, and number of its unknowns.
    diagonal : float
        Value added to each diagonal element before scaling; the scaled matrix ``out`` has ones on its
        diagonal in any case.
    scale : (n,) array
        Result: factors of rows and columns that make the diagonal one.
    out : (n, n) or (n, band + 1) array
        Result. It must be zero where no block is written.
    sums : (n,) array
        Result: sum of the absolute values of each column of the whole scaled matrix.
    """
    for n in range(len(scale)):
        scale[n] = diagonal
    for b in range(len(row)):
        if row[b] == column[b]:
            for p in range(size[row[b]]):
                scale[place[row[b]] + p] += blocks[b, p, p]
    for n in range(len(scale)):
        if not scale[n] > 0.0:
            return False
        sums[n] = diagonal / scale[n]
        scale[n] = 1.0 / math.sqrt(scale[n])
    for b in range(len(row)):
        i, j = row[b], column[b]
        r, c = place[j], place[i]
        if r >= c:
            for p in range(size[i]):
                lo = p if r == c else 0
                _fill_row(b, p, lo, size[j], blocks, r, c + p, scale, banded, out, sums)
                if r == c:
                    # the diagonal element was added twice above
                    sums[c + p] -= abs(blocks[b, p, p]) * scale[c + p] * scale[c + p]
        else:
            for q in range(size[j]):
                _fill_column(b, q, size[i], blocks, c, r + q, scale, banded, out, sums)
    return True


@threaded
def _fill_row(
    b: int,
    p: int,
    lo: int,
    hi: int,
    blocks: Array,
    r: int,
    c: int,
    scale: Array,
    banded: bool,
    out: Array,
    sums: Array,
) -> None:
    """Write elements lo to hi of row p of a block to rows r + lo ... of column c of the matrix."""
    here, shift, lines = scale[c], c if banded else 0, (hi - lo) // SIDE
    to, at = c * out.shape[1] + r + lo - shift, (b * blocks.shape[1] + p) * blocks.shape[2] + lo
    total = write_lines(out, to, blocks, at, scale, r + lo, sums, here, lines)
    for q in range(lo + lines * SIDE, hi):
        value = blocks[b, p, q] * scale[r + q] * here
        out[c, r + q - shift] = value
        sums[r + q] += abs(value)
        total += abs(value)
    sums[c] += total


@threaded
def _fill_column(
    b: int, p: int, hi: int, blocks: Array, r: int, c: int, scale: Array, banded: bool, out: Array, sums: Array
) -> None:
    """Write column p of a block, up to element hi, to rows r ... of column c of the matrix."""
    here, shift, total = scale[c], c if banded else 0, 0.0
    for q in range(hi):
        value = blocks[b, q, p] * scale[r + q] * here
        out[c, r + q - shift] = value
        sums[r + q] += abs(value)
        total += abs(value)
    sums[c] += total


@threaded
def add_shared(row: Index, column: Index, first: Index, of: Index, size: Index, blocks: Array, out: Array) -> None:
    """Add blocks (B, k, k) of images, and their transposes, to the matrix (z, z) of the free unknowns.

    Parameters
    ----------
    row, column : (B,) int arrays
        Row image and column image of each block, row <= column; diagonal blocks are symmetric.
    first, size : (M + 1,), (M,) int arrays
        Position of the first unknown of each image among the unknowns of all images, and number of its unknowns.
    of : (w,) int array
        Free unknown for each of these unknowns; images may share free unknowns.
    """
    for b in range(len(row)):
        i, j = row[b], column[b]
        for p in range(size[i]):
            r = of[first[i] + p]
            for q in range(size[j]):
                c = of[first[j] + q]
                out[r, c] += blocks[b, p, q]
                if i != j:
                    out[c, r] += blocks[b, p, q]


@threaded
def times_blocks(row: Index, column: Index, blocks: Array, x: Array, out: Array) -> None:
    """Write the product of a symmetric matrix with a vector; its diagonal blocks are complete.

    Parameters
    ----------
    row, column : (B,) int arrays
        Row and column of each block (B, k, k) of the upper triangle.
    x, out : (M, k) arrays
    """
    k = blocks.shape[1]
    out[:] = 0.0
    for b in range(len(row)):
        i, j = row[b], column[b]
        for a in range(k):
            total, factor = 0.0, x[i, a]
            for c in range(k):
                total += blocks[b, a, c] * x[j, c]
            out[i, a] += total
            if i != j:
                for c in range(k):
                    out[j, c] += blocks[b, a, c] * factor
