"""Relative orientation: start values, and the test for a base."""

from __future__ import annotations

from itertools import product
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.distributions import chi_square_limit, f_quantile
from fg_orient.model.errors import InputError
from fg_orient.rectification.transformation import Scaling

Array = npt.NDArray[np.float64]

LEAST_EIGHT_POINT: Final = 8
#: Level of the test that a rotation alone fits two photos.
NO_BASE: Final = 1e-3
#: Difference of the largest and smallest singular values of a homography without base.
FLAT: Final = 1e-12
#: Quarter turns about the view.
_ROLLS: Final = (
    np.diag([-1.0, -1.0, 1.0]),
    *(np.array([[0.0, -s, 0.0], [s, 0.0, 0.0], [0.0, 0.0, 1.0]]) for s in (1, -1)),
)


def start_pairs(points: Array) -> list[tuple[Array, Array]]:
    """Start rotations and bases from tangents (n, 4) of points in both photos."""
    out = [(np.eye(3), sign * np.eye(3)[k]) for k in range(3) for sign in (1.0, -1.0)]
    if len(points) > LEAST_EIGHT_POINT:
        return [*_eight_points(points), *_plane(points), *out[:2]]
    # the linear solution of eight points has no redundancy, so noise can make it useless
    linear = _eight_points(points) if len(points) == LEAST_EIGHT_POINT else []
    corners = np.array(list(product((1.0, -1.0), repeat=3))) / np.sqrt(3.0)
    rolled = [(roll, base) for roll in _ROLLS for _, base in out]  # second camera upright or upside down
    return [*linear, *out, *((np.eye(3), corner) for corner in corners), *rolled, *_plane(points)]


def _rays(points: Array) -> tuple[Array, Array]:
    """Rays (n, 3), (n, 3) of both photos from tangents (n, 4)."""
    ones = np.ones((len(points), 1))
    return np.hstack([points[:, :2], ones]), np.hstack([points[:, 2:], ones])


def _plane(points: Array) -> list[tuple[Array, Array]]:
    """The four decompositions of the homography H = R (1 - b n^T) of a plane, which maps rays d1 to d2."""
    first, second = _rays(points)
    # d2 x H d1 = 0
    across = np.cross(second[:, None, :], np.eye(3)[None])
    rows = np.einsum("nij,nk->njik", across, first).reshape(3 * len(points), 9)
    h = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    h = h / np.linalg.svd(h)[1][1]
    h = h * np.sign(np.sum(second * (first @ h.T)))
    _, (s1, _, s3), axes = np.linalg.svd(h)
    if s1 - s3 <= FLAT:  # no base
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


def _eight_points(points: Array) -> list[tuple[Array, Array]]:
    """The four decompositions of the essential matrix G with d2^T G d1 = 0, G = R [b]x."""
    maps, rays = [], []
    for pair in (points[:, :2], points[:, 2:]):
        scaling = Scaling.of(pair, shared=True)
        size, (x, y) = scaling.scale[0], scaling.offset
        maps.append(np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, size]]) / size)
        rays.append(np.column_stack([scaling.normalised(pair), np.ones(len(pair))]))
    rows = np.einsum("ni,nj->nij", rays[1], rays[0]).reshape(len(points), 9)
    g = maps[1].T @ np.linalg.svd(rows)[2][-1].reshape(3, 3) @ maps[0]
    left, _, right = np.linalg.svd(g)
    left, right = left * np.sign(np.linalg.det(left)), right * np.sign(np.linalg.det(right))
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return [(left @ w @ right, sign * right[2]) for w in (quarter, quarter.T) for sign in (1.0, -1.0)]


def require_base(points: Array, sigma: Array, squares: float, *, known: bool) -> None:
    """Refuse photos whose base is zero within the noise: a rotation alone fits them, two conditions for each point.

    Parameters
    ----------
    points, sigma : (n, 4) arrays
    squares : float
        Least weighted squares of coplanarity, one condition for each point: without known sigmas the size of the noise.
    known : bool
        Whether sigmas are given.
    """
    n, (first, second) = len(points), _rays(points)
    rays = [d / np.linalg.norm(d, axis=1, keepdims=True) for d in (first, second)]
    left, _, right = np.linalg.svd(rays[1].T @ rays[0])
    turn = left * [1.0, 1.0, np.sign(np.linalg.det(left @ right))] @ right
    seen = first @ turn.T
    computed = seen[:, :2] / seen[:, 2:]
    slope = (turn[:2, :2] - computed[:, :, None] * turn[2, :2]) / seen[:, 2, None, None]
    covariance = np.einsum("nij,nj,nkj->nik", slope, sigma[:, :2] ** 2, slope)
    covariance += sigma[:, 2:, None] ** 2 * np.eye(2)
    away = points[:, 2:] - computed
    turned_only = float(np.einsum("ni,ni->", away, np.linalg.solve(covariance, away[:, :, None])[:, :, 0]))
    freedom = 2 * n - 3
    limit = float(chi_square_limit(freedom, NO_BASE))
    if not known:
        limit = freedom * squares / (n - 5) * float(f_quantile(freedom, n - 5, 1.0 - NO_BASE))
    if turned_only <= limit:
        raise InputError.of("closerange.no_base", place="relative orientation",
                            value=f"weighted squares {turned_only:.3g}, {limit:.3g} may be noise")  # fmt: skip
