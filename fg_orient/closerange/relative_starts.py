"""Compute approximate relative orientations of two photos in closed form from tangents (n, 4) of common points.

An orientation consists of a rotation R and a base b. R rotates the axes of the first camera to the axes
of the second; b is given in axes of the first camera. The essential matrix ``G = R [b]x`` fulfils
``d2^T G d1 = 0`` for the rays d1, d2 of a point.
"""

from __future__ import annotations

from itertools import combinations, combinations_with_replacement
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.rectification.transformation import Scaling

Pair = tuple[Array, Array]

#: Minimum number of points of the linear solution, which then has no redundancy.
LEAST_EIGHT_POINT: Final = 8
#: Maximum number of sets of five points.
MAX_SETS: Final = 21
#: Maximum number of essential matrices that give starts, and cosine above which two matrices count as equal.
MAX_MATRICES: Final = 12
SIMILAR: Final = 0.999
#: A homography has no base if its largest and smallest singular values differ by less than this.
FLAT: Final = 1e-12
#: Monomials of degree 3 in the four factors of the null space; those without the last factor come first.
_MONOMIALS: Final = sorted(combinations_with_replacement(range(4), 3), key=lambda m: m.count(3))
_PLACE: Final[dict[tuple[int, ...], int]] = {monomial: k for k, monomial in enumerate(_MONOMIALS)}
#: Position of the product of three factors.
_PRODUCT: Final = np.array([_PLACE[a, b, c] for a, b, c in (sorted(m) for m in np.ndindex(4, 4, 4))])


def start_pairs(points: Array) -> list[Pair]:
    """Return the rotations and bases for tangents (n, 4) of six points or more."""
    axes = [(np.eye(3), sign * np.eye(3)[k]) for k in range(3) for sign in (1.0, -1.0)]
    if len(points) > LEAST_EIGHT_POINT:
        return [*eight_points(points), *plane(points), *axes[:2]]
    return [*five_points(points), *plane(points)]


def rays(points: Array) -> Pair:
    """Return the rays (n, 3), (n, 3) of both photos from tangents (n, 4)."""
    ones = np.ones((len(points), 1))
    return np.hstack([points[:, :2], ones]), np.hstack([points[:, 2:], ones])


def plane(points: Array) -> list[Pair]:
    """Return the four decompositions of the homography H = R (1 - b n^T) of a plane, which maps rays d1 to d2."""
    first, second = rays(points)
    # d2 x H d1 = 0
    across = np.cross(second[:, None, :], np.eye(3)[None])
    rows = np.einsum("nij,nk->njik", across, first).reshape(3 * len(points), 9)
    h = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    h = h / np.linalg.svd(h)[1][1]
    h = h * np.sign(np.sum(second * (first @ h.T)))
    _, (s1, _, s3), axes = np.linalg.svd(h)
    if s1 - s3 <= FLAT:  # the homography is a rotation, so it gives no base
        return []
    v1, v2, v3 = axes * np.sign(np.linalg.det(axes))
    out = []
    for sign in (1.0, -1.0):
        u = (np.sqrt(max(1.0 - s3**2, 0.0)) * v1 + sign * np.sqrt(max(s1**2 - 1.0, 0.0)) * v3) / np.sqrt(s1**2 - s3**2)
        before, after = np.array([v2, u, np.cross(v2, u)]), np.array([h @ v2, h @ u, np.cross(h @ v2, h @ u)])
        rotation = after.T @ before
        base = -rotation.T @ (h - rotation) @ np.cross(v2, u)
        base = base / np.linalg.norm(base)
        out += [(rotation, base), (rotation, -base)]
    return out


def eight_points(points: Array) -> list[Pair]:
    """Return the decompositions of linear essential matrix (Longuet-Higgins 1981, normalised as in Hartley 1997)."""
    maps, normalised = [], []
    for pair in (points[:, :2], points[:, 2:]):
        scaling = Scaling.of(pair, shared=True)
        size, (x, y) = scaling.scale[0], scaling.offset
        maps.append(np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, size]]) / size)
        normalised.append(np.column_stack([scaling.normalised(pair), np.ones(len(pair))]))
    rows = np.einsum("ni,nj->nij", normalised[1], normalised[0]).reshape(len(points), 9)
    return decompositions(maps[1].T @ np.linalg.svd(rows)[2][-1].reshape(3, 3) @ maps[0])


def five_points(points: Array) -> list[Pair]:
    """Return orientations of sets of five points, ordered by the distance of all points from coplanarity.

    Each set has up to ten essential matrices. If noise makes two of them complex, their
    real part is close to both.
    """
    first, second = rays(points)
    products = np.einsum("ni,nj->nij", second, first).reshape(len(points), 9)
    sets = list(combinations(range(len(points)), 5))
    sets = sets[:: -(-len(sets) // MAX_SETS)]
    matrices = np.concatenate([essential_matrices(products[list(chosen)]) for chosen in sets])
    lines = matrices @ first.T, np.swapaxes(matrices, 1, 2) @ second.T
    slopes = sum(np.sum(line[:, :2] ** 2, axis=1) for line in lines)
    squares = np.sum(np.einsum("kin,ni->kn", lines[0], second) ** 2 / slopes, axis=1)
    kept = list[Array]()
    for g in matrices[np.argsort(squares)]:
        if len(kept) < MAX_MATRICES and all(abs(np.sum(g * one)) < SIMILAR for one in kept):
            kept.append(g)
    return [_foremost(first, second, decompositions(g)) for g in kept]


def _foremost(first: Array, second: Array, pairs: list[Pair]) -> Pair:
    """Return the orientation with the largest number of points in front of both cameras."""

    def count(pair: Pair) -> int:
        rotation, base = pair
        turned = second @ rotation
        # depths s, t in s d1 - t R^T d2 = b have the signs of these products
        normal = np.cross(first, turned)
        return int(
            np.sum((np.cross(base, turned) * normal).sum(axis=1) > 0.0)
            + np.sum((np.cross(base, first) * normal).sum(axis=1) > 0.0)
        )

    return max(pairs, key=count)


def essential_matrices(products: Array) -> Array:
    """Return the matrices (k, 3, 3) of norm 1 from the products d2 d1^T (5, 9) of five pairs of rays; k is 10 or 0.

    The matrix is a sum of four matrices of the null space with unknown factors. It is
    essential if ``det G = 0`` and ``2 G G^T G - tr(G G^T) G = 0``, ten cubic equations in
    the factors (Nistér 2004, eqs. 1-9). Elimination of the monomials of degree 3 gives
    the matrix of a multiplication by the first factor. Its eigenvectors contain the
    factors (Stewénius, Engels, Nistér 2006). For complex factors the real part is used.
    """
    null = np.linalg.svd(products)[2][5:].reshape(4, 3, 3)
    cubic = 2.0 * np.einsum("aik,blk,clj->abcij", null, null, null)
    cubic -= np.einsum("aik,bik,clj->abclj", null, null, null)
    determinant = np.einsum("ai,bci->abc", null[:, 0], np.cross(null[:, None, 1], null[None, :, 2]))
    rows = np.zeros((len(_MONOMIALS), 10))
    np.add.at(rows, _PRODUCT, np.column_stack([cubic.reshape(64, 9), determinant.ravel()]))
    try:
        reduced = -np.linalg.solve(rows[:10].T, rows[10:].T)
    except np.linalg.LinAlgError:  # the matrix is singular for special positions of points, such as a line
        return np.zeros((0, 3, 3))
    times = [_PLACE[tuple(sorted((0, *monomial[:2])))] for monomial in _MONOMIALS[10:]]
    vectors = np.linalg.eig(np.vstack([reduced, np.eye(10)])[times])[1]
    factors = vectors[[_PLACE[k, 3, 3] - 10 for k in range(4)]].T
    # an eigenvector has a free complex factor, which makes its largest element real
    largest = np.take_along_axis(factors, np.abs(factors).argmax(axis=1)[:, None], axis=1)
    factors = np.real(factors / largest)
    return np.asarray(np.einsum("ka,aij->kij", factors / np.linalg.norm(factors, axis=1)[:, None], null))


def decompositions(g: Array) -> list[Pair]:
    """Return the four orientations of an essential matrix."""
    left, _, right = np.linalg.svd(g)
    left, right = left * np.sign(np.linalg.det(left)), right * np.sign(np.linalg.det(right))
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return [(left @ w @ right, sign * right[2]) for w in (quarter, quarter.T) for sign in (1.0, -1.0)]
