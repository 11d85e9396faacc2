"""Steps of the ground points after one of the images, squares of the linear model, weights, residuals of control.

A solution x of the reduced system gives a point's step ``-H^-1 (g + sum G^T J x)``, ``H^-1 = R^T R``; symbols and
arrays: ``fg_orient.kernels.batch_points``.
"""

from __future__ import annotations

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from factors.conditions.control import POINT
from fg_orient.kernels.batch_components import row_along
from fg_orient.kernels.batch_points import ROOT
from fg_orient.kernels.batch_rows import Flags, Index, Small

#: Rays of a point for which space is kept; more get their own.
MOST_RAYS = 64


@threaded
def _along(
    a: int, base: int, d_image: Array, basis: Array, i: int, wide: Array, n_basis: int, n_components: int
) -> tuple[float, float]:
    """Product of the image Jacobian of observation a with the wide unknowns of image i."""
    if n_basis == 3 and n_components == 9 and d_image.shape[2] == 9:
        return row_along(d_image, 18 * (a - base), basis, a * basis.shape[1], wide, i * wide.shape[1])
    y0, y1 = 0.0, 0.0
    for c in range(n_components):
        x = 0.0
        for b in range(n_basis):
            x += basis[a, b] * wide[i, b * n_components + c]
        y0 += d_image[a - base, 0, c] * x
        y1 += d_image[a - base, 1, c] * x
    return y0, y1


@threaded
def back_substitute(
    lo: int, hi: int, places: Small, first: Small, image: Small, n_basis: Index, n_components: Index, basis: Array,
    wide: Array, base: int, value: Array, d_image: Array, d_ground: Array, root: Array, gradient: Array, step: Array,
    squares: Array,
) -> None:  # fmt: skip
    """Write the steps (P, 3) of the points of chunks lo to hi, and the sums of the squares of the linear residuals.

    ``places`` (N + 1,): first point of each chunk; ``squares`` (N,); others: see
    :func:`fg_orient.kernels.batch_points.point_blocks`.
    """
    along = np.empty((MOST_RAYS, 2))
    for n in range(lo, hi):
        total = 0.0
        for p in range(places[n], places[n + 1]):
            t0, t1, t2 = gradient[p, 0], gradient[p, 1], gradient[p, 2]
            if first[p + 1] - first[p] > len(along):
                along = np.empty((first[p + 1] - first[p], 2))
            for a in range(first[p], first[p + 1]):
                k, i = a - base, image[a]
                y0, y1 = _along(a, base, d_image, basis, i, wide, n_basis[i], n_components[i])
                along[a - first[p], 0], along[a - first[p], 1] = y0, y1
                t0 += d_ground[k, 0, 0] * y0 + d_ground[k, 1, 0] * y1
                t1 += d_ground[k, 0, 1] * y0 + d_ground[k, 1, 1] * y1
                t2 += d_ground[k, 0, 2] * y0 + d_ground[k, 1, 2] * y1
            r0, r1, r2 = root[p, ROOT.r00], root[p, ROOT.r10], root[p, ROOT.r11]
            r3, r4, r5 = root[p, ROOT.r20], root[p, ROOT.r21], root[p, ROOT.r22]
            u0, u1, u2 = r0 * t0, r1 * t0 + r2 * t1, r3 * t0 + r4 * t1 + r5 * t2
            x0, x1, x2 = -(r0 * u0 + r1 * u1 + r3 * u2), -(r2 * u1 + r4 * u2), -r5 * u2
            step[p, 0], step[p, 1], step[p, 2] = x0, x1, x2
            for a in range(first[p], first[p + 1]):
                k = a - base
                for r in range(2):
                    after = value[k, r] + along[a - first[p], r]
                    after += d_ground[k, r, 0] * x0 + d_ground[k, r, 1] * x1 + d_ground[k, r, 2] * x2
                    total += after * after
        squares[n] = total


@threaded
def product(
    lo: int, hi: int, places: Small, first: Small, free: Flags, image: Small, n_basis: Index, n_components: Index,
    basis: Array, wide: Array, base: int, share: float, value: Array, d_image: Array, d_ground: Array, step: Array,
    squares: Array,
) -> None:  # fmt: skip
    """Sum the squares of ``share`` of the residuals plus the Jacobian times a given step, by chunk.

    ``wide``: the step of the images; ``step`` (P, 3): that of the points. Others: see :func:`back_substitute`.
    """
    for n in range(lo, hi):
        total = 0.0
        for p in range(places[n], places[n + 1]):
            moves = 1.0 if free[p] > 0 else 0.0
            x0, x1, x2 = moves * step[p, 0], moves * step[p, 1], moves * step[p, 2]
            for a in range(first[p], first[p + 1]):
                k, i = a - base, image[a]
                y = _along(a, base, d_image, basis, i, wide, n_basis[i], n_components[i])
                for r in range(2):
                    after = share * value[k, r] + y[r]
                    after += d_ground[k, r, 0] * x0 + d_ground[k, r, 1] * x1 + d_ground[k, r, 2] * x2
                    total += after * after
        squares[n] = total


@threaded
def scale_rows(lo: int, hi: int, root: Array, value: Array, d_image: Array, d_ground: Array) -> None:
    """Apply weights: multiply the rows of image points lo to hi by ``root`` (n,)."""
    for a in range(lo, hi):
        factor = root[a]
        for r in range(2):
            value[a, r] *= factor
            for k in range(3):
                d_ground[a, r, k] *= factor
            for c in range(d_image.shape[2]):
                d_image[a, r, c] *= factor


@threaded
def control_squares(ground: Array, control: Array, observed: Index, out: Array) -> None:
    """Write the squared norms (m,) of the whitened residuals of observed ground points.

    Parameters
    ----------
    ground : (N, 3) array
    control : (N, 12) array
        Records of observed points, ``factors.conditions.control.POINT``.
    observed : (m,) int array
        Rows of both.
    """
    for k in range(len(observed)):
        j = observed[k]
        x, y = ground[j, 0] - control[j, POINT.x], ground[j, 1] - control[j, POINT.y]
        z = ground[j, 2] - control[j, POINT.z]
        r1 = control[j, POINT.w11] * x + control[j, POINT.w12] * y + control[j, POINT.w13] * z
        r2 = control[j, POINT.w21] * x + control[j, POINT.w22] * y + control[j, POINT.w23] * z
        r3 = control[j, POINT.w31] * x + control[j, POINT.w32] * y + control[j, POINT.w33] * z
        out[k] = r1 * r1 + r2 * r2 + r3 * r3


@threaded
def move(number: Small, step: Array, ground: Array) -> None:
    """Add steps (P, 3) to the ground points (N, 3) with these numbers (P,)."""
    for p in range(len(number)):
        for k in range(3):
            ground[number[p], k] += step[p, k]
