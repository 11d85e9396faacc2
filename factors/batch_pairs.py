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
from factors.batch import Index, threaded

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
def _scaled_ray(g: Array, r: Array, z: Array) -> None:
    """Z = G R^T of one ray (2, 3)."""
    for k in range(2):
        z[k, 0] = r[0] * g[k, 0]
        z[k, 1] = r[1] * g[k, 0] + r[2] * g[k, 1]
        z[k, 2] = r[3] * g[k, 0] + r[4] * g[k, 1] + r[5] * g[k, 2]


@threaded
def pair_blocks(
    lo: int, hi: int, cut: Index, left: Small, right: Small, image: Index, place: Index, n_basis: Index,
    n_components: Index, basis: Array, d_image: Array, d_ground: Array, root: Array, out: Array,
) -> None:  # fmt: skip
    """Write the sums (S, w^2) of segments lo to hi over (basis, basis, component, component).

    ``cut`` (S + 1,): first pair of each segment; ``place`` (n,): place of each observation's point.
    """
    z_a, z_b, turned, t = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 16)), np.empty(256)
    for s in range(lo, hi):
        i, j = image[left[cut[s]]], image[right[cut[s]]]
        c_a, c_b, b_a, b_b = n_components[i], n_components[j], n_basis[i], n_basis[j]
        size, total = c_a * c_b, out[s]
        total[:] = 0.0
        for n in range(cut[s], cut[s + 1]):
            a, b = left[n], right[n]
            r = root[place[a]]
            _scaled_ray(d_ground[a], r, z_a)
            _scaled_ray(d_ground[b], r, z_b)
            same = 1.0 if a == b else 0.0
            m00 = same - z_a[0, 0] * z_b[0, 0] - z_a[0, 1] * z_b[0, 1] - z_a[0, 2] * z_b[0, 2]
            m01 = -z_a[0, 0] * z_b[1, 0] - z_a[0, 1] * z_b[1, 1] - z_a[0, 2] * z_b[1, 2]
            m10 = -z_a[1, 0] * z_b[0, 0] - z_a[1, 1] * z_b[0, 1] - z_a[1, 2] * z_b[0, 2]
            m11 = same - z_a[1, 0] * z_b[1, 0] - z_a[1, 1] * z_b[1, 1] - z_a[1, 2] * z_b[1, 2]
            for d in range(c_b):
                turned[0, d] = m00 * d_image[b, 0, d] + m01 * d_image[b, 1, d]
                turned[1, d] = m10 * d_image[b, 0, d] + m11 * d_image[b, 1, d]
            for c in range(c_a):
                l0, l1, k = d_image[a, 0, c], d_image[a, 1, c], c * c_b
                for d in range(c_b):
                    t[k + d] = l0 * turned[0, d] + l1 * turned[1, d]
            at = 0
            for p in range(b_a):
                for q in range(b_b):
                    weight = basis[a, p] * basis[b, q]
                    part = total[at : at + size]
                    for e in range(size):
                        part[e] += weight * t[e]
                    at += size


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
                at = ((b_p * b_b + b_q) * c_a + c_p) * c_b + c_q
                total = 0.0
                for s in range(segments[n], segments[n + 1]):
                    total += sums[s, at]
                out[n, p, q] = scale[i, p] * scale[j, q] * total


@threaded
def image_gradients(
    lo: int, hi: int, begin: Index, order: Small, place: Index, n_basis: Index, n_components: Index, basis: Array,
    value: Array, d_image: Array, d_ground: Array, root: Array, gradient: Array, reduced: bool, out: Array,
) -> None:  # fmt: skip
    """Write the wide gradients (M, w) of images lo to hi; reduced by the points, or of the whole system.

    ``begin`` (M + 1,) and ``order`` (n,): the observations of each image, in the order of the points.
    """
    z = np.empty((2, 3))
    for i in range(lo, hi):
        out[i] = 0.0
        n_c = n_components[i]
        for n in range(begin[i], begin[i + 1]):
            a = order[n]
            q0, q1 = value[a, 0], value[a, 1]
            if reduced:
                r, g = root[place[a]], gradient[place[a]]
                _scaled_ray(d_ground[a], r, z)
                u0, u1, u2 = r[0] * g[0], r[1] * g[0] + r[2] * g[1], r[3] * g[0] + r[4] * g[1] + r[5] * g[2]
                q0 -= z[0, 0] * u0 + z[0, 1] * u1 + z[0, 2] * u2
                q1 -= z[1, 0] * u0 + z[1, 1] * u1 + z[1, 2] * u2
            for b in range(n_basis[i]):
                for c in range(n_c):
                    out[i, b * n_c + c] += basis[a, b] * (d_image[a, 0, c] * q0 + d_image[a, 1, c] * q1)
