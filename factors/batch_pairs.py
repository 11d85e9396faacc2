"""The reduced camera system: what is left of the normal equations when the ground points are eliminated.

Two rays a, b of one ground point add ``J_a^T M J_b``, ``M = [a is b] I - Z_a Z_b^T``, ``Z = G R^T``
(``factors.batch_points``), to the block of their images. With J = basis kron components the sum over many pairs is a
sum of ``basis_a basis_b`` times one small matrix of components: half the arithmetic of the full columns, and a third
of the memory traffic.
Pairs are sorted by block and cut into segments that do not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array
from factors.batch_rows import Index, threaded

Small = np.ndarray[tuple[int], np.dtype[np.int32]]


@threaded
def count_pairs(first: Index, image: Index, free: Index) -> int:
    """Pairs of rays of a common unknown point with image of a <= image of b, each ray with itself included."""
    total = 0
    for p in range(len(first) - 1):
        v = first[p + 1] - first[p]
        if free[p] == 0:
            total += v
            continue
        total += v * (v + 1) // 2
        for a in range(first[p], first[p + 1]):
            for b in range(a + 1, first[p + 1]):
                total += image[a] == image[b]
    return total


@threaded
def list_pairs(first: Index, image: Index, free: Index, left: Small, right: Small) -> None:
    """Write the pairs, point by point; two rays in one image stand in both orders."""
    n = 0
    for p in range(len(first) - 1):
        for a in range(first[p], first[p + 1]):
            for b in range(first[p], first[p + 1]):
                if a == b or (free[p] > 0 and (image[a] < image[b] or image[a] == image[b])):
                    left[n], right[n] = a, b
                    n += 1


@threaded
def sort_pairs(left: Small, right: Small, by_left: bool, image: Index, counts: Index, out: Small, other: Small) -> None:
    """One pass of a counting sort by the image of the left or right ray; keeps the order of equal ones."""
    counts[:] = 0
    for n in range(len(left)):
        counts[image[left[n] if by_left else right[n]] + 1] += 1
    for i in range(len(counts) - 1):
        counts[i + 1] += counts[i]
    for n in range(len(left)):
        i = image[left[n] if by_left else right[n]]
        out[counts[i]], other[counts[i]] = left[n], right[n]
        counts[i] += 1


@threaded
def _scaled_ray(d_ground: Array, a: int, root: Array, p: int) -> tuple[float, float, float, float, float, float]:
    """Z = G R^T of one ray, row by row."""
    g00, g01, g02, g10, g11, g12 = (
        d_ground[a, 0, 0], d_ground[a, 0, 1], d_ground[a, 0, 2], d_ground[a, 1, 0], d_ground[a, 1, 1], d_ground[a, 1, 2]
    )  # fmt: skip
    r0, r1, r2, r3, r4, r5 = root[p, 0], root[p, 1], root[p, 2], root[p, 3], root[p, 4], root[p, 5]
    return (
        r0 * g00, r1 * g00 + r2 * g01, r3 * g00 + r4 * g01 + r5 * g02,
        r0 * g10, r1 * g10 + r2 * g11, r3 * g10 + r4 * g11 + r5 * g12,
    )  # fmt: skip


@threaded
def _pair(
    a: int, b: int, p: int, d_image: Array, d_ground: Array, root: Array, turned: Array, u: int, t: Array
) -> None:  # fmt: skip
    """Write ``D_a^T M D_b`` of two rays of point p into t[u], (4, c_a, c_b); ``turned`` is scratch space."""
    x, y = _scaled_ray(d_ground, a, root, p), _scaled_ray(d_ground, b, root, p)
    same = 1.0 if a == b else 0.0
    m00 = same - x[0] * y[0] - x[1] * y[1] - x[2] * y[2]
    m01 = -x[0] * y[3] - x[1] * y[4] - x[2] * y[5]
    m10 = -x[3] * y[0] - x[4] * y[1] - x[5] * y[2]
    m11 = same - x[3] * y[3] - x[4] * y[4] - x[5] * y[5]
    for d in range(t.shape[2]):
        turned[0, d] = m00 * d_image[b, 0, d] + m01 * d_image[b, 1, d]
        turned[1, d] = m10 * d_image[b, 0, d] + m11 * d_image[b, 1, d]
    for c in range(t.shape[1]):
        l0, l1 = d_image[a, 0, c], d_image[a, 1, c]
        for d in range(t.shape[2]):
            t[u, c, d] = l0 * turned[0, d] + l1 * turned[1, d]


@threaded
def pair_blocks(
    lo: int, hi: int, cut: Index, left: Small, right: Small, image: Index, place: Index, n_basis: Index,
    n_components: Index, basis: Array, d_image: Array, d_ground: Array, root: Array, out: Array,
) -> None:  # fmt: skip
    """Write the sums (S, b^2, c^2) of segments lo to hi over pairs of basis values and of components.

    ``cut`` (S + 1,): first pair of each segment; ``place`` (n,): place of each observation's point. Four pairs
    at once: an element of the sum is then loaded and stored once for four products.
    """
    turned, space, weight = np.empty((2, out.shape[2])), np.zeros(4 * out.shape[2]), np.zeros((4, out.shape[1]))
    for s in range(lo, hi):
        i, j = image[left[cut[s]]], image[right[cut[s]]]
        c_a, c_b, b_a, b_b = n_components[i], n_components[j], n_basis[i], n_basis[j]
        size, end = c_a * c_b, cut[s + 1]
        t = space[: 4 * size].reshape((4, size))
        square = t.reshape((4, c_a, c_b))
        out[s] = 0.0
        for n in range(cut[s], end, 4):
            for u in range(4):
                if n + u >= end:
                    for m in range(b_a * b_b):
                        weight[u, m] = 0.0
                    continue
                a, b = left[n + u], right[n + u]
                _pair(a, b, place[a], d_image, d_ground, root, turned, u, square)
                for p in range(b_a):
                    for q in range(b_b):
                        weight[u, p * b_b + q] = basis[a, p] * basis[b, q]
            for m in range(b_a * b_b):
                w0, w1, w2, w3 = weight[0, m], weight[1, m], weight[2, m], weight[3, m]
                for e in range(size):
                    out[s, m, e] += w0 * t[0, e] + w1 * t[1, e] + w2 * t[2, e] + w3 * t[3, e]


@threaded
def gather_blocks(
    lo: int, hi: int, segments: Index, row: Index, column: Index, sums: Array, wide: Index, scale: Array, size: Index,
    n_basis: Index, n_components: Index, out: Array,
) -> None:  # fmt: skip
    """Add the segments of blocks lo to hi and pick the unknowns that exist: (B, k, k).

    ``segments`` (B + 1,): first segment of each block; ``row``, ``column`` (B,): its images; ``wide``, ``scale``
    (M, k) and ``size`` (M,): place, factor and number of the unknowns of each image.
    """
    for n in range(lo, hi):
        i, j = row[n], column[n]
        c_a, c_b, b_b = n_components[i], n_components[j], n_basis[j]
        for p in range(size[i]):
            b_p, c_p = wide[i, p] // c_a, wide[i, p] % c_a
            for q in range(size[j]):
                b_q, c_q = wide[j, q] // c_b, wide[j, q] % c_b
                total = 0.0
                for s in range(segments[n], segments[n + 1]):
                    total += sums[s, b_p * b_b + b_q, c_p * c_b + c_q]
                out[n, p, q] = scale[i, p] * scale[j, q] * total


@threaded
def image_gradients(
    lo: int, hi: int, begin: Index, order: Small, place: Index, n_basis: Index, n_components: Index, basis: Array,
    value: Array, d_image: Array, d_ground: Array, root: Array, gradient: Array, reduced: bool, out: Array,
) -> None:  # fmt: skip
    """Write the wide gradients (M, w) of images lo to hi; reduced by the points, or of the whole system.

    ``begin`` (M + 1,) and ``order`` (n,): the observations of each image, in the order of the points.
    """
    for i in range(lo, hi):
        out[i] = 0.0
        n_c = n_components[i]
        for n in range(begin[i], begin[i + 1]):
            a = order[n]
            q0, q1 = value[a, 0], value[a, 1]
            if reduced:
                p = place[a]
                z, g0, g1, g2 = _scaled_ray(d_ground, a, root, p), gradient[p, 0], gradient[p, 1], gradient[p, 2]
                u0, u1 = root[p, 0] * g0, root[p, 1] * g0 + root[p, 2] * g1
                u2 = root[p, 3] * g0 + root[p, 4] * g1 + root[p, 5] * g2
                q0 -= z[0] * u0 + z[1] * u1 + z[2] * u2
                q1 -= z[3] * u0 + z[4] * u1 + z[5] * u2
            for b in range(n_basis[i]):
                for c in range(n_c):
                    out[i, b * n_c + c] += basis[a, b] * (d_image[a, 0, c] * q0 + d_image[a, 1, c] * q1)
