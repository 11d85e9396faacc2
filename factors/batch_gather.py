"""Sums of the chunks added to blocks and gradients of the reduced system; layout: ``factors.batch_pairs``."""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.batch_pairs import Small
from factors.batch_rows import Index, threaded


@threaded
def gather_blocks(
    lo: int, hi: int, begin: Index, order: Small, own: Small, row: Index, column: Index, sums: Array, wide: Index,
    scale: Array, size: Index, n_basis: Index, n_components: Index, out: Array,
) -> None:  # fmt: skip
    """Add the slots of blocks lo to hi and pick the unknowns that exist: (B, k, k).

    Parameters
    ----------
    begin, order : (B + 1,), (S,) int arrays
        Slots of each block.
    own : (S,) int array
        1 where each ray is paired with itself: of these sums only those of basis p <= q are given.
    row, column : (B,) int arrays
        Images of each block.
    wide, scale : (M, k) arrays
        Place and factor of the unknowns of each image, ``size`` (M,) of them.
    """
    b2, end = sums.shape[1], sums.shape[2]
    total, half = np.empty((b2, end)), np.empty((b2, end))
    place, component = np.empty(wide.shape[1], np.int64), np.empty(wide.shape[1], np.int64)
    for n in range(lo, hi):
        i, j = row[n], column[n]
        c_a, c_b, b_b = n_components[i], n_components[j], n_basis[j]
        for q in range(size[j]):
            place[q], component[q] = wide[j, q] // c_b, wide[j, q] % c_b
        _add_up(begin[n], begin[n + 1], order, own, sums, n_basis[i], b_b, c_b, i == j, half, total)
        for p in range(size[i]):
            b_p, c_p = wide[i, p] // c_a, wide[i, p] % c_a
            for q in range(size[j]):
                out[n, p, q] = scale[i, p] * scale[j, q] * total[b_p * b_b + place[q], c_p * c_b + component[q]]


@threaded
def _add_up(
    lo: int, hi: int, order: Small, own: Small, sums: Array, b_a: int, b_b: int, c_b: int, diagonal: bool, half: Array,
    total: Array,
) -> None:  # fmt: skip
    """Write the total (b^2, c^2) of the slots lo to hi of a block; ``half`` is scratch space."""
    b2, end = sums.shape[1], sums.shape[2]
    for m in range(b2):
        for e in range(end):
            total[m, e], half[m, e] = 0.0, 0.0
    for k in range(lo, hi):
        s = order[k]
        for m in range(b2):
            for e in range(end):
                if own[s] > 0:
                    half[m, e] += sums[s, m, e]
                else:
                    total[m, e] += sums[s, m, e]
    if not diagonal:
        return
    for p in range(b_a):
        for q in range(b_b):
            for c in range(c_b):
                for d in range(c_b):
                    low, high = p * b_b + q, q * b_b + p
                    from_half = half[low, c * c_b + d] if p <= q else half[high, d * c_b + c]
                    total[low, c * c_b + d] += from_half


@threaded
def gather_gradients(
    lo: int, hi: int, begin: Index, order: Small, own: Small, row: Index, column: Index, n_basis: Index,
    n_components: Index, gradients: Array, out: Array,
) -> None:  # fmt: skip
    """Add the gradients (S, b, c) of the slots of blocks lo to hi to those of the images (M, w)."""
    for n in range(lo, hi):
        if row[n] != column[n]:
            continue
        n_c = n_components[row[n]]
        for k in range(begin[n], begin[n + 1]):
            if own[order[k]] > 0:
                for b in range(n_basis[row[n]]):
                    for c in range(n_c):
                        out[row[n], b * n_c + c] += gradients[order[k], b, c]
