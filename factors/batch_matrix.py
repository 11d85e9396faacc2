"""Blocks of the reduced system written to the matrix that LAPACK factorises, full or banded."""

from __future__ import annotations

from factors._compile import threaded
from factors._contract import Array
from factors.batch_rows import Index


@threaded
def fill_lower(
    row: Index, column: Index, place: Index, size: Index, blocks: Array, scale: Array, banded: bool, out: Array,
    sums: Array,
) -> None:  # fmt: skip
    """Write the lower triangle, scaled, column by column: element (r, c) to ``out[c, r]``, banded to ``out[c, r - c]``.

    Parameters
    ----------
    row, column : (B,) int arrays
        Images of each block (B, k, k); blocks of one image are symmetric.
    place, size : (M,) int arrays
        First unknown of each image in the order of the matrix, and their number.
    scale : (n,) array
        Of rows and columns.
    out : (n, n) or (n, band + 1) array
        Zero where no block writes.
    sums : (n,) array
        The absolute values of each column of the whole matrix are added to it.
    """
    for b in range(len(row)):
        i, j = row[b], column[b]
        r, c = place[j], place[i]
        if r == c:
            for p in range(size[i]):
                _fill_column(b, p, p, size[j], True, blocks, r, c + p, scale, banded, out, sums)
                sums[c + p] -= abs(blocks[b, p, p]) * scale[c + p] * scale[c + p]  # it was added twice
        elif r > c:
            for p in range(size[i]):
                _fill_column(b, p, 0, size[j], True, blocks, r, c + p, scale, banded, out, sums)
        else:
            for q in range(size[j]):
                _fill_column(b, q, 0, size[i], False, blocks, c, r + q, scale, banded, out, sums)


@threaded
def _fill_column(
    b: int, p: int, lo: int, hi: int, by_row: bool, blocks: Array, r: int, c: int, scale: Array, banded: bool,
    out: Array, sums: Array,
) -> None:  # fmt: skip
    """Write row p of a block, or its column p, from element lo to hi to rows r + lo ... of column c of the matrix."""
    here, shift, total = scale[c], c if banded else 0, 0.0
    for q in range(lo, hi):
        value = (blocks[b, p, q] if by_row else blocks[b, q, p]) * scale[r + q] * here
        out[c, r + q - shift] = value
        sums[r + q] += abs(value)
    for q in range(lo, hi):
        total += abs(out[c, r + q - shift])
    sums[c] += total


@threaded
def fill_diagonal(row: Index, column: Index, place: Index, size: Index, blocks: Array, out: Array) -> None:
    """Add the diagonal elements of the blocks (B, k, k) to ``out`` (n,); see :func:`fill_lower`."""
    for b in range(len(row)):
        if row[b] == column[b]:
            for p in range(size[row[b]]):
                out[place[row[b]] + p] += blocks[b, p, p]
