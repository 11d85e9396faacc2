"""Effect of errors of image points on the unknowns of their image, in the image's own sigmas.

An error e (whitened) of the image point of ray a moves the unknowns of its image i by U_a e, the rows of
``N^-1 A_a^T`` that belong to the image. With H, J, G and Q as in ``factors.batch_cofactors``::

    U_a = sum_b Q_i,i(b) J_b^T (delta_ab I - G_b H^-1 G_a^T)

Its size in the image's own sigmas is that of ``L^-1 U_a e`` with ``Q_ii = L L^T`` (external reliability, Baarda 1968).
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.batch_rows import Index, threaded


@threaded
def image_effects(
    lo: int, hi: int, first: Index, image: Index, size: Index, free: Index, d_image: Array, d_ground: Array,
    inverse: Array, block: Index, q: Array, root: Array, out: Array,
) -> None:  # fmt: skip
    """Write the squared sizes (n, 2) for unit errors of line and sample of the rays of points lo to hi.

    Parameters as of ``factors.batch_cofactors.ray_cofactors``, and

    root : (M, k, k) array
        L^-1 of each image, lower triangular.
    """
    k = q.shape[2]
    effect, turned, w, near = np.empty((2, k)), np.empty((2, k)), np.empty((2, 2)), np.empty((3, 2))
    for p in range(lo, hi):
        for a in range(first[p], first[p + 1]):
            effect[:] = 0.0
            _near(inverse, p, d_ground, a, near)
            for b in range(first[p] if free[p] else a, first[p + 1] if free[p] else a + 1):
                for r in range(2):
                    for c in range(2):
                        w[r, c] = 1.0 if a == b and r == c else 0.0
                        for s in range(3):
                            w[r, c] -= d_ground[b, r, s] * near[s, c]
                for c in range(2):
                    for s in range(size[image[b]]):
                        turned[c, s] = w[0, c] * d_image[b, 0, s] + w[1, c] * d_image[b, 1, s]
                _add_product(q, block, image[a], image[b], size, turned, effect)
            for c in range(2):
                out[a, c] = _squared(root, image[a], size[image[a]], effect, c)


@threaded
def _near(inverse: Array, p: int, d_ground: Array, a: int, near: Array) -> None:
    """Write ``H^-1 G_a^T``."""
    for r in range(3):
        for c in range(2):
            near[r, c] = 0.0
            for s in range(3):
                near[r, c] += inverse[p, r, s] * d_ground[a, c, s]


@threaded
def _add_product(q: Array, block: Index, i: int, j: int, size: Index, turned: Array, effect: Array) -> None:
    """Add ``Q_ij`` times the columns ``turned``; the block of a pair stands once, row <= column."""
    if i <= j:
        for r in range(size[i]):
            for s in range(size[j]):
                value = q[block[i, j], r, s]
                effect[0, r] += value * turned[0, s]
                effect[1, r] += value * turned[1, s]
    else:
        for s in range(size[j]):
            for r in range(size[i]):
                value = q[block[j, i], s, r]
                effect[0, r] += value * turned[0, s]
                effect[1, r] += value * turned[1, s]


@threaded
def _squared(root: Array, i: int, n: int, effect: Array, c: int) -> float:
    """Squared length of ``L^-1 u``."""
    total = 0.0
    for r in range(n):
        value = 0.0
        for s in range(r + 1):
            value += root[i, r, s] * effect[c, s]
        total += value * value
    return total
