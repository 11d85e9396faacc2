"""Cofactors of ground points and rays from the cofactors of images, and the effects of errors on the images.

With the whitened Jacobians J_a (image) and G_a (ground) of the rays a of a point, ``H = sum G_a^T G_a + W^T W`` and
the joint cofactors Q of the images::

    Q_point = H^-1 + H^-1 (sum_ab G_a^T T_ab G_b) H^-1,     T_ab = J_a Q_ab J_b^T

This is the back-substitution of the elimination (Brown 1976; Mikhail & Ackermann 1976, 5.9) with two rows per ray
instead of all columns of its image. For the adjusted image point of ray a and its effect on the ground point::

    C_a = sum_b G_b^T T_ba,     R_a = Q_point G_a^T - H^-1 C_a
    F_a = T_aa + G_a R_a - (G_a H^-1 C_a)^T

F_a is the cofactor matrix ``A_a N^-1 A_a^T`` of the adjusted observation (A_a = [J_a G_a]), I - F_a the
cofactor matrix of the residual. R_a is the part of ``N^-1 A_a^T`` that belongs to the ground point. For
the image i of the ray, this part is U_a: a whitened error e of the image point changes the unknowns of
the image by U_a e::

    U_a = sum_b Q_i,i(b) J_b^T (delta_ab I - G_b H^-1 G_a^T)

In units of the image's own sigmas, the size of this change is the norm of
``L_i^-1 U_a e`` with ``Q_ii = L_i L_i^T`` (external reliability, Baarda 1968). ``Q J_b^T`` is formed once for
each pair of rays and used for all these quantities.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from fg_orient.kernels.batch_rows import Index


@threaded
def ray_cofactors(
    lo: int,
    hi: int,
    first: Index,
    image: Index,
    size: Index,
    free: Index,
    d_image: Array,
    d_ground: Array,
    inverse: Array,
    block: Index,
    q: Array,
    turned: Array,
    roots: Any,
    out: Array,
    fitted: Any,
    response: Any,
    effect: Any,
) -> None:
    """Write cofactors (P, 3, 3) of points lo to hi; for their rays F_a (n, 2, 2), R_a (n, 3, 2) and ``L_i^-1 U_a``.

    Parameters
    ----------
    first : (P + 1,) int array
        First ray of each point; the rays of a point are in the order of their images.
    image : (n,) int array
    size : (M,) int array
        Number of unknowns of each image, at most k.
    free : (P,) int array
        1 for unknown points, 0 for fixed points; F_a of a fixed point is T_aa.
    d_image, d_ground : (n, 2, k), (n, 2, 3) arrays
    inverse : (P, 3, 3) array
        H^-1.
    block : (M, M) int array
        Place in ``q`` of the common block of two images, row <= column.
    q, turned : (B, k, k) arrays
        Cofactors of the images, and their transposes.
    roots : (M, k, k) array or None
        Transposes of ``L_i^-1``.
    fitted, response, effect : arrays or None
        ``effect`` is (n, 2, k), with one row for a line error and one for a sample error. If ``effect`` and ``roots``
        are None, only cofactors of points are computed.
    """
    e, u, t, w = np.empty((2, q.shape[2])), np.empty((2, q.shape[2])), np.empty((2, 2)), np.empty((2, 2))
    total, half, near = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 2))
    for p in range(lo, hi):
        total[:], half[:], out[p] = 0.0, 0.0, 0.0
        if effect is not None:
            response[first[p] : first[p + 1]] = 0.0
        for a in range(first[p], first[p + 1]):
            i = image[a]
            if effect is not None:
                u[:] = 0.0
                _near(inverse, p, d_ground, a, near)
            for b in range(first[p] if effect is not None and free[p] else a, first[p + 1] if free[p] else a + 1):
                j = image[b]
                if i <= j:
                    _product(turned[block[i, j]], d_image[b], size[j], e)
                else:
                    _product(q[block[j, i]], d_image[b], size[j], e)
                if effect is not None:
                    _add_effect(d_ground, b, near, a == b, e, w, u)
                if b >= a:
                    _between(d_image[a], e, size[i], t)
                    if free[p]:
                        _add(total, d_ground, a, b, t)
                    if effect is not None:
                        if free[p]:
                            _gather(response, d_ground, a, b, t)
                        if a == b:
                            fitted[a] = t
            if effect is not None:
                _product(roots[i], u, size[i], effect[a])
        if not free[p]:
            continue
        _add_product(inverse[p], total, half)
        for r in range(3):
            for c in range(3):
                out[p, r, c] = inverse[p, r, c]
        _add_product(half, inverse[p], out[p])
        if effect is None:  # copied, so that the matrix is symmetric to the last bit
            for r in range(3):
                for c in range(r):
                    out[p, c, r] = out[p, r, c]
        else:
            for a in range(first[p], first[p + 1]):
                _finish(inverse[p], out[p], d_ground[a], fitted[a], response[a])


@threaded
def _product(turned: Array, rows: Array, n: int, out: Array) -> None:
    """Write ``(Q x)^T`` (2, k) for two columns ``x = rows^T``; n rows of the transpose of Q are used.

    Two rows of Q are processed in one pass, which halves the time. Each sum keeps the order of the rows.
    """
    for r in range(out.shape[1]):
        out[0, r], out[1, r] = 0.0, 0.0
    for s in range(0, n - 1, 2):
        x, y, v, w = rows[0, s], rows[1, s], rows[0, s + 1], rows[1, s + 1]
        for r in range(out.shape[1]):
            g, h = turned[s, r], turned[s + 1, r]
            out[0, r] += g * x + h * v
            out[1, r] += g * y + h * w
    if n % 2:
        for r in range(out.shape[1]):
            out[0, r] += turned[n - 1, r] * rows[0, n - 1]
            out[1, r] += turned[n - 1, r] * rows[1, n - 1]


@threaded
def _add_product(a: Array, b: Array, c: Array) -> None:
    """Add the product of two (3, 3) matrices to a third, with loops: for ``c += d`` numba compiles 40 functions."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                c[i, j] += a[i, k] * b[k, j]


@threaded
def _gather(response: Array, d_ground: Array, a: int, b: int, t: Array) -> None:
    """Add ``G_b^T T_ba`` to C_a and, if the rays differ, ``G_a^T T_ab`` to C_b."""
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
def _between(rows: Array, e: Array, n: int, t: Array) -> None:
    """Write ``T_ab = J_a Q J_b^T`` (2, 2) from ``(Q J_b^T)^T``."""
    t[:] = 0.0
    for s in range(n):
        t[0, 0] += rows[0, s] * e[0, s]
        t[0, 1] += rows[0, s] * e[1, s]
        t[1, 0] += rows[1, s] * e[0, s]
        t[1, 1] += rows[1, s] * e[1, s]


@threaded
def _add(total: Array, d_ground: Array, a: int, b: int, t: Array) -> None:
    """Add ``G_a^T T G_b`` and, if the rays differ, its transpose."""
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
def _near(inverse: Array, p: int, d_ground: Array, a: int, near: Array) -> None:
    """Write ``H^-1 G_a^T``."""
    for r in range(3):
        for c in range(2):
            near[r, c] = 0.0
            for s in range(3):
                near[r, c] += inverse[p, r, s] * d_ground[a, c, s]


@threaded
def _add_effect(d_ground: Array, b: int, near: Array, same: bool, e: Array, w: Array, u: Array) -> None:
    """Add the contribution of ray b to U_a: ``Q J_b^T (delta_ab I - G_b H^-1 G_a^T)``, with ``near = H^-1 G_a^T``."""
    for r in range(2):
        for c in range(2):
            w[r, c] = 1.0 if same and r == c else 0.0
            for s in range(3):
                w[r, c] -= d_ground[b, r, s] * near[s, c]
    for r in range(u.shape[1]):
        u[0, r] += e[0, r] * w[0, 0] + e[1, r] * w[1, 0]
        u[1, r] += e[0, r] * w[0, 1] + e[1, r] * w[1, 1]
