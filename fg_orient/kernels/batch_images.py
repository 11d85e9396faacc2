"""Sums over the rows of each image, if images are eliminated first (``fg_orient.adjustment.images_first``).

Image points are in the order of their images: image m has the points ``first[m]`` to ``first[m + 1]``.
``own[m, i]`` is the place of own unknown i of image m among all unknowns of this image, or -1 if there
is none. ``border[m, j]`` is the place of unknown j of image m in the border, or -1 if it is an own
unknown. ``place[a]`` is the first place in the border of the ground point of image point a, or -1 if it
is constant.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors._compile import inlined, threaded
from factors._contract import Array

Index = npt.NDArray[np.int64]


@threaded
def own_sums(
    first: Index, own: Index, value: Array, d_image: Array, normal: Array, gradient: Array, squares: Array
) -> None:
    """Add the normal matrix (M, k, k) and gradient (M, k) of the own unknowns, and the squares (M,) of each image."""
    x, sums = np.empty(own.shape[1]), np.empty((own.shape[1], own.shape[1]))
    for m in range(len(first) - 1):
        k = count(own[m])
        sums[:k, :k] = 0.0
        for a in range(first[m], first[m + 1]):
            for r in range(2):
                v = value[a, r]
                squares[m] += v * v
                for i in range(k):
                    x[i] = d_image[a, r, own[m, i]]
                for i in range(k):
                    gradient[m, i] += x[i] * v
                    for j in range(k):
                        sums[i, j] += x[i] * x[j]
        for i in range(k):
            for j in range(k):
                normal[m, i, j] += sums[i, j]


@threaded
def border_sums(
    first: Index,
    own: Index,
    border: Index,
    place: Index,
    value: Array,
    d_image: Array,
    d_ground: Array,
    across: Array,
    matrix: Array,
    gradient: Array,
) -> None:
    """Add the products of border and own unknowns (M, b, k), the border's normal matrix (b, b) and its gradient.

    Only the lower triangle of the normal matrix is written. It contains the products with shared unknowns,
    because points come last.
    """
    k, w = own.shape[1], border.shape[1]
    x, y, of, at = np.empty(k), np.empty(w), np.empty(w, np.int64), np.empty(w, np.int64)
    sums = np.empty((w, w + k + 1))
    for m in range(len(first) - 1):
        n, s = count(own[m]), 0
        for j in range(w):
            if border[m, j] >= 0:
                of[s], at[s] = j, border[m, j]
                s += 1
        sums[:] = 0.0
        for a in range(first[m], first[m + 1]):
            p = place[a]
            for r in range(2):
                v = value[a, r]
                for i in range(n):
                    x[i] = d_image[a, r, own[m, i]]
                for j in range(s):
                    y[j] = d_image[a, r, of[j]]
                for j in range(s):
                    for q in range(s):
                        sums[j, q] += y[j] * y[q]
                    for i in range(n):
                        sums[j, w + i] += y[j] * x[i]
                    sums[j, w + k] += y[j] * v
                for c in range(3 if p >= 0 else 0):
                    g = d_ground[a, r, c]
                    gradient[p + c] += g * v
                    for i in range(n):
                        across[m, p + c, i] += g * x[i]
                    for q in range(s):
                        matrix[p + c, at[q]] += g * y[q]
                    for d in range(c + 1):
                        matrix[p + c, p + d] += g * d_ground[a, r, d]
        for j in range(s):
            gradient[at[j]] += sums[j, w + k]
            for i in range(n):
                across[m, at[j], i] += sums[j, w + i]
            for q in range(s):
                if at[q] <= at[j]:
                    matrix[at[j], at[q]] += sums[j, q]


@inlined
def count(places: Index) -> int:
    """Return the number of own unknowns, which come first."""
    n = 0
    for i in range(len(places)):
        if places[i] >= 0:
            n += 1
    return n
