"""Effect of errors of image points on the unknowns of their image, in the image's own sigmas.

An error e (whitened) of the image point of ray a moves the unknowns of its image i by U_a e, the rows of
``N^-1 A_a^T`` that belong to the image. With H, J, G and Q as in ``fg_orient.kernels.batch_cofactors``::

    U_a = sum_b Q_i,i(b) J_b^T (delta_ab I - G_b H^-1 G_a^T)

Its size in the image's own sigmas is that of ``L_i^-1 U_a e`` with ``Q_ii = L_i L_i^T`` (external reliability, Baarda
1968), so the products ``L_i^-1 Q_ij`` of all pairs of images are formed once.
"""

from __future__ import annotations

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from fg_orient.kernels.batch_rows import Index


@threaded
def image_effects(
    lo: int, hi: int, first: Index, image: Index, size: Index, free: Index, d_image: Array, d_ground: Array,
    inverse: Array, block: Index, upper: Array, lower: Array, out: Array,
) -> None:  # fmt: skip
    """Write the squared sizes (n, 2) for unit errors of line and sample of the rays of points lo to hi.

    Parameters as of ``fg_orient.kernels.batch_cofactors.ray_cofactors``, and

    upper, lower : (B, k, k) arrays
        Of the pairs of images i <= j, rows those of the second factor: ``(L_i^-1 Q_ij)^T`` and ``(L_j^-1 Q_ji)^T``.
    """
    k = upper.shape[2]
    effect, w, near = np.empty((2, k)), np.empty((2, 2)), np.empty((3, 2))
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
                i, j = image[a], image[b]
                if i <= j:
                    _add_product(upper, block[i, j], size[j], d_image, b, w, effect)
                else:
                    _add_product(lower, block[j, i], size[j], d_image, b, w, effect)
            for c in range(2):
                out[a, c] = 0.0
                for s in range(k):
                    out[a, c] += effect[c, s] * effect[c, s]


@threaded
def _near(inverse: Array, p: int, d_ground: Array, a: int, near: Array) -> None:
    """Write ``H^-1 G_a^T``."""
    for r in range(3):
        for c in range(2):
            near[r, c] = 0.0
            for s in range(3):
                near[r, c] += inverse[p, r, s] * d_ground[a, c, s]


@threaded
def _add_product(half: Array, place: int, n: int, d_image: Array, b: int, w: Array, effect: Array) -> None:
    """Add ``L^-1 Q J_b^T w``; the inner loop runs over what lies side by side."""
    k = effect.shape[1]
    for s in range(n):
        x = w[0, 0] * d_image[b, 0, s] + w[1, 0] * d_image[b, 1, s]
        y = w[0, 1] * d_image[b, 0, s] + w[1, 1] * d_image[b, 1, s]
        for r in range(k):
            effect[0, r] += half[place, s, r] * x
            effect[1, r] += half[place, s, r] * y
