"""Blocks of the inverse of a banded matrix without the inverse, from its Cholesky factor (Takahashi et al. 1973).

The factor is cut into blocks at least as wide as its band: it is block bidiagonal, ``L_k`` with ``C_k`` below it. From
the last block up, with ``G = C_k L_k^-1`` and the inverse Z of what follows,

    Z_k+1,k = -Z_k+1 G,    Z_k = L_k^-T L_k^-1 + G^T Z_k+1 G

are the parts of the inverse where the matrix may have elements. All products are those of dense matrices.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import blas, lapack

from factors.arrays import Array, Index

#: Rows that are mirrored at once.
PART: Final = 256


def band_inverse(factor: Array, place: Index, size: Index, pairs: Index) -> Array:
    """Blocks (P, k, k) of the inverse for pairs of images with a block in the band; shorter ones end with zeros.

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
    """Rows and columns of a lower factor that is stored by its band, as a full matrix in Fortran order."""
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
    """Write the upper triangle of a square matrix to the lower one, in parts: no second matrix is made."""
    for lo in range(0, len(matrix), PART):
        own = matrix[lo : lo + PART, lo : lo + PART]
        own[:] = np.triu(own) + np.triu(own, 1).T
        matrix[lo + PART :, lo : lo + PART] = matrix[lo : lo + PART, lo + PART :].T
