"""Cofactors of ground points and rays from the cofactors of the images, and effects of errors on the images.

With the whitened Jacobians J_a (image) and G_a (ground) of the rays a of a point, ``H = sum G_a^T G_a + W^T W`` and
the joint cofactors Q of the images::

    Q_point = H^-1 + H^-1 (sum_ab G_a^T T_ab G_b) H^-1,     T_ab = J_a Q_ab J_b^T

This is the back-substitution of the elimination (Brown 1976; Mikhail & Ackermann 1976, 5.9) with two rows per ray
instead of all columns of its image. For the adjusted image point of ray a and its effect on the ground point::

    C_a = sum_b G_b^T T_ba,     R_a = Q_point G_a^T - H^-1 C_a
    F_a = T_aa + G_a R_a - (G_a H^-1 C_a)^T

F_a is the cofactor matrix ``A_a N^-1 A_a^T`` of the adjusted observation (A_a = [J_a G_a]), I - F_a the cofactor
matrix of the residual; R_a is the part of ``N^-1 A_a^T`` that belongs to the ground point. The part of the ray's
image i is U_a: a whitened error e of the image point changes the unknowns of the image by U_a e::

    U_a = sum_b Q_i,i(b) J_b^T (delta_ab I - G_b H^-1 G_a^T)

In the image's own sigmas the size of this change is that of ``L_i^-1 U_a e`` with ``Q_ii = L_i L_i^T`` (external
reliability, Baarda 1968), so the products ``L_i^-1 Q_ij`` of all pairs of images are formed once.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from fg_orient.kernels.batch_rows import Index


@threaded
def ray_cofactors(
    lo: int, hi: int, first: Index, image: Index, size: Index, free: Index, d_image: Array, d_ground: Array,
    inverse: Array, block: Index, q: Array, out: Array, fitted: Any, response: Any,
) -> None:  # fmt: skip
    """Write cofactors (P, 3, 3) of points lo to hi, F_a (n, 2, 2) and R_a (n, 3, 2) of their rays.

    Parameters
    ----------
    first : (P + 1,) int array
        First ray of each point; its rays are in the order of their images.
    image : (n,) int array
    size : (M,) int array
        Unknowns of each image, at most k.
    free : (P,) int array
        1 for unknown points, 0 for fixed ones, whose F_a is T_aa.
    d_image, d_ground : (n, 2, k), (n, 2, 3) arrays
    inverse : (P, 3, 3) array
        H^-1.
    block : (M, M) int array
        Place in ``q`` of the joint block of two images, row <= column.
    q : (B, k, k) array
        Cofactors of the images.
    fitted, response : arrays or None
        None: cofactors of the points only.
    """
    turned, t, total, half = np.empty((2, q.shape[2])), np.empty((2, 2)), np.empty((3, 3)), np.empty((3, 3))
    for p in range(lo, hi):
        total[:], half[:], out[p] = 0.0, 0.0, 0.0
        if response is not None:
            for a in range(first[p], first[p + 1]):
                response[a] = 0.0
        for a in range(first[p], first[p + 1]):
            i = image[a]
            for b in range(a, first[p + 1] if free[p] else a + 1):
                j = image[b]
                _between(d_image, a, b, q, block[i, j], size[i], size[j], turned, t)
                if free[p]:
                    _add(total, d_ground, a, b, t)
                if response is not None:
                    if free[p]:
                        _gather(response, d_ground, a, b, t)
                    if a == b:
                        for r in range(2):
                            for c in range(2):
                                fitted[a, r, c] = t[r, c]
        if not free[p]:
            continue
        _add_product(inverse[p], total, half)
        for r in range(3):
            for c in range(3):
                out[p, r, c] = inverse[p, r, c]
        _add_product(half, inverse[p], out[p])
        if response is None:  # symmetric to the last bit
            for r in range(3):
                for c in range(r):
                    out[p, c, r] = out[p, r, c]
        else:
            for a in range(first[p], first[p + 1]):
                _finish(inverse[p], out[p], d_ground[a], fitted[a], response[a])


@threaded
def _add_product(a: Array, b: Array, c: Array) -> None:
    """Add the product of two (3, 3) matrices to a third, in loops: for ``c += d`` numba compiles 40 functions."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                c[i, j] += a[i, k] * b[k, j]


@threaded
def _gather(response: Array, d_ground: Array, a: int, b: int, t: Array) -> None:
    """Add ``G_b^T T_ba`` to C_a and, for two different rays, ``G_a^T T_ab`` to C_b."""
    for r in range(3):
        for c in range(2):
            for k in range(2):
                response[a, r, c] += d_ground[b, k, r] * t[c, k]
                if a != b:
                    response[b, r, c] += d_ground[a, k, r] * t[k, c]


@threaded
def _finish(inverse: Array, q: Array, g: Array, f: Array, r: Array) -> None:
    """Turn T_aa into F_a and C_a into R_a, in place."""
    h = np.zeros((3, 2))
    for i in range(3):
        for c in range(2):
            for k in range(3):
                h[i, c] += inverse[i, k] * r[k, c]
    for i in range(3):
        for c in range(2):
            r[i, c] = -h[i, c]
            for k in range(3):
                r[i, c] += q[i, k] * g[c, k]
    for c in range(2):
        for d in range(c, 2):
            value = 0.5 * (f[c, d] + f[d, c])
            for k in range(3):
                value += 0.5 * (g[c, k] * (r[k, d] - h[k, d]) + g[d, k] * (r[k, c] - h[k, c]))
            f[c, d], f[d, c] = value, value


@threaded
def _between(d_image: Array, a: int, b: int, q: Array, block: int, n: int, m: int, turned: Array, t: Array) -> None:
    """Write ``J_a Q J_b^T`` (2, 2) of two rays."""
    turned[:] = 0.0
    for r in range(n):
        x, y = d_image[a, 0, r], d_image[a, 1, r]
        for s in range(m):
            turned[0, s] += x * q[block, r, s]
            turned[1, s] += y * q[block, r, s]
    t[:] = 0.0
    for s in range(m):
        t[0, 0] += turned[0, s] * d_image[b, 0, s]
        t[0, 1] += turned[0, s] * d_image[b, 1, s]
        t[1, 0] += turned[1, s] * d_image[b, 0, s]
        t[1, 1] += turned[1, s] * d_image[b, 1, s]


@threaded
def _add(total: Array, d_ground: Array, a: int, b: int, t: Array) -> None:
    """Add ``G_a^T T G_b``, and its transpose for two different rays."""
    for r in range(3):
        for c in range(3):
            value = 0.0
            for k in range(2):
                for m in range(2):
                    value += d_ground[a, k, r] * t[k, m] * d_ground[b, m, c]
            total[r, c] += value
            if a != b:
                total[c, r] += value


@threaded
def image_effects(
    lo: int, hi: int, first: Index, image: Index, size: Index, free: Index, d_image: Array, d_ground: Array,
    inverse: Array, block: Index, upper: Array, lower: Array, out: Array,
) -> None:  # fmt: skip
    """Write the effects (n, 2, k) of unit errors of line and sample of the rays of points lo to hi on their image.

    Parameters as of :func:`ray_cofactors`, and

    upper, lower : (B, k, k) arrays
        For the pairs of images i <= j, stored transposed: ``(L_i^-1 Q_ij)^T`` and ``(L_j^-1 Q_ji)^T``.
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
                    _add_effect(upper, block[i, j], size[j], d_image, b, w, effect)
                else:
                    _add_effect(lower, block[j, i], size[j], d_image, b, w, effect)
            out[a] = effect


@threaded
def _near(inverse: Array, p: int, d_ground: Array, a: int, near: Array) -> None:
    """Write ``H^-1 G_a^T``."""
    for r in range(3):
        for c in range(2):
            near[r, c] = 0.0
            for s in range(3):
                near[r, c] += inverse[p, r, s] * d_ground[a, c, s]


@threaded
def _add_effect(half: Array, place: int, n: int, d_image: Array, b: int, w: Array, effect: Array) -> None:
    """Add ``L^-1 Q J_b^T w``; the inner loop runs over adjacent numbers."""
    k = effect.shape[1]
    for s in range(n):
        x = w[0, 0] * d_image[b, 0, s] + w[1, 0] * d_image[b, 1, s]
        y = w[0, 1] * d_image[b, 0, s] + w[1, 1] * d_image[b, 1, s]
        for r in range(k):
            effect[0, r] += half[place, s, r] * x
            effect[1, r] += half[place, s, r] * y
