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
        for p in range(size[i]):
            for q in range(size[j]):
                r, c = place[j] + q, place[i] + p
                if i == j and r < c:
                    continue
                if r < c:
                    r, c = c, r
                value = blocks[b, p, q] * scale[r] * scale[c]
                out[c, r - c if banded else r] = value
                sums[c] += abs(value)
                if r != c:
                    sums[r] += abs(value)


@threaded
def fill_diagonal(row: Index, column: Index, place: Index, size: Index, blocks: Array, out: Array) -> None:
    """Add the diagonal elements of the blocks (B, k, k) to ``out`` (n,); see :func:`fill_lower`."""
    for b in range(len(row)):
        if row[b] == column[b]:
            for p in range(size[row[b]]):
                out[place[row[b]] + p] += blocks[b, p, p]
