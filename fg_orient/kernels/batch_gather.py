"""Sums of the chunks added to blocks and gradients of the reduced system, and its unknowns spread out again.

The layout of the sums: ``fg_orient.kernels.batch_pairs``.
"""

from __future__ import annotations

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from fg_orient.kernels.batch_rows import Index, Small
from fg_orient.kernels.vectors import place_in_sum


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
    flat, offset, step = total.reshape(b2 * end), np.empty(wide.shape[1], np.int64), np.empty(wide.shape[1], np.int64)
    for n in range(lo, hi):
        i, j = row[n], column[n]
        c_a, c_b, b_b = n_components[i], n_components[j], n_basis[j]
        for q in range(size[j]):
            b_q, c_q = wide[j, q] // c_b, wide[j, q] % c_b
            offset[q] = b_q * end + place_in_sum(0, c_q, c_a, c_b)
            step[q] = place_in_sum(1, c_q, c_a, c_b) - place_in_sum(0, c_q, c_a, c_b)
        _add_up(begin[n], begin[n + 1], order, own, sums, n_basis[i], b_b, c_b, i == j, half, total)
        for p in range(size[i]):
            at, c_p, factor = wide[i, p] // c_a * b_b * end, wide[i, p] % c_a, scale[i, p]
            for q in range(size[j]):
                out[n, p, q] = factor * scale[j, q] * flat[at + offset[q] + step[q] * c_p]


@threaded
def _add_slot(sums: Array, s: int, out: Array) -> None:
    """Add the sums (b^2, e) of a slot."""
    for m in range(out.shape[0]):
        for e in range(out.shape[1]):
            out[m, e] += sums[s, m, e]


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
        if own[s] > 0:
            _add_slot(sums, s, half)
        else:
            _add_slot(sums, s, total)
    if not diagonal:
        return
    for p in range(b_a):
        for q in range(b_b):
            for c in range(c_b):
                for d in range(c_b):
                    low, high = p * b_b + q, q * b_b + p
                    here, turned = place_in_sum(c, d, c_b, c_b), place_in_sum(d, c, c_b, c_b)
                    total[low, here] += half[low, here] if p <= q else half[high, turned]


@threaded
def gather_gradients(
    begin: Index, order: Small, own: Small, row: Index, column: Index, gradients: Array, wide: Index, scale: Array,
    size: Index, n_components: Index, out: Array,
) -> None:  # fmt: skip
    """Add up the gradients (S, b, c) of the slots of each image, for the unknowns that exist, to ``out`` (u,).

    The other parameters are those of :func:`gather_blocks`.
    """
    first = np.empty(len(size) + 1, np.int64)
    first[0] = 0
    for i in range(len(size)):
        first[i + 1] = first[i] + size[i]
    for n in range(len(row)):
        i = row[n]
        if i != column[n]:
            continue
        for p in range(size[i]):
            b, c, total = wide[i, p] // n_components[i], wide[i, p] % n_components[i], 0.0
            for k in range(begin[n], begin[n + 1]):
                if own[order[k]] > 0:
                    total += gradients[order[k], b, c]
            out[first[i] + p] += scale[i, p] * total


@threaded
def widen(image: Array, wide: Index, scale: Array, size: Index, out: Array) -> None:
    """Write unknowns (M, k), in the units of the components, to their places among the wide numbers (M, w)."""
    for i in range(len(size)):
        for p in range(size[i]):
            out[i, wide[i, p]] = image[i, p] * scale[i, p]
