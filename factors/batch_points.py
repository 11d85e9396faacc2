"""Ground points of a block eliminated, and found again: 3 x 3 blocks, gradients, back-substitution.

With the whitened Jacobians J (image) and G (ground) of the image points, ``H = sum G^T G + W^T W`` of a ground point,
its diagonal lengthened by the share ``damping``, ``H^-1 = R^T R`` (R the inverse Cholesky factor, lower triangular), a
solution x of the reduced system gives the point's step ``-H^-1 (g + sum G^T J x)``. Arrays: ``factors.batch``.
"""

from __future__ import annotations

import math

import numpy as np

from factors._compile import threaded
from factors._contract import Array
from factors.batch_rows import Flags, Index, Small

#: A point whose pivot falls below this part of its diagonal element is not determined.
SINGULAR = 1e-14
#: Rays of a point for which space is kept; more get their own.
MOST_RAYS = 64


@threaded
def point_blocks(
    lo: int, hi: int, first: Small, number: Small, free: Flags, control: Array, ground: Array, damping: float,
    base: int, value: Array, d_ground: Array, root: Array, gradient: Array, scaled: Array,
) -> int:  # fmt: skip
    """Write R (P, 6) as r00 r10 r11 r20 r21 r22 and the gradient (P, 3); of each ray Z = G R^T and reduced residuals.

    Parameters
    ----------
    first : (P + 1,) int array
        First observation of each point.
    number : (P,) int array
        Row of the point in ``control`` and ``ground``.
    free : (P,) int array
        0 for a constant, 1 for an unknown, 2 for an unknown with a control-point equation.
    control : (N, 12) array
        W row-major and the observed coordinates.
    base : int
        Observation of row 0 of ``value`` (n, 2), ``d_ground`` (n, 2, 3), ``scaled`` (n, 8: Z, ``residual - Z R g``).

    Returns
    -------
    int
        The first point that is not determined, or -1.
    """
    bad, h, g = -1, np.empty(6), np.empty(3)
    for p in range(lo, hi):
        h[:], g[:] = 0.0, 0.0
        for k in range(6):
            root[p, k] = 0.0
        if free[p] > 0:
            if free[p] == 2:
                _add_control(control, ground, number[p], h, g)
            for a in range(first[p] - base, first[p + 1] - base):
                for r in range(2):
                    _add(h, g, d_ground[a, r, 0], d_ground[a, r, 1], d_ground[a, r, 2], value[a, r])
            for k in (0, 2, 5):
                h[k] *= 1.0 + damping
            if not _inverse_root(h, root, p) and bad < 0:
                bad = p
        for k in range(3):
            gradient[p, k] = g[k]
        r0, r1, r2, r3, r4, r5 = root[p, 0], root[p, 1], root[p, 2], root[p, 3], root[p, 4], root[p, 5]
        u0, u1, u2 = r0 * g[0], r1 * g[0] + r2 * g[1], r3 * g[0] + r4 * g[1] + r5 * g[2]
        for a in range(first[p] - base, first[p + 1] - base):
            for r in range(2):
                x, y, z = d_ground[a, r, 0], d_ground[a, r, 1], d_ground[a, r, 2]
                scaled[a, 3 * r] = r0 * x
                scaled[a, 3 * r + 1] = r1 * x + r2 * y
                scaled[a, 3 * r + 2] = r3 * x + r4 * y + r5 * z
                scaled[a, 6 + r] = value[a, r] - (
                    u0 * (r0 * x) + u1 * (r1 * x + r2 * y) + u2 * (r3 * x + r4 * y + r5 * z)
                )
    return bad


@threaded
def _add_control(control: Array, ground: Array, j: int, h: Array, g: Array) -> None:
    """Add the three equations of a control point."""
    x, y, z = ground[j, 0] - control[j, 9], ground[j, 1] - control[j, 10], ground[j, 2] - control[j, 11]
    for r in range(0, 9, 3):
        w0, w1, w2 = control[j, r], control[j, r + 1], control[j, r + 2]
        _add(h, g, w0, w1, w2, w0 * x + w1 * y + w2 * z)


@threaded
def _add(h: Array, g: Array, x: float, y: float, z: float, residual: float) -> None:
    """Add one equation to the lower triangle (00 10 11 20 21 22) and the gradient."""
    h[0] += x * x
    h[1] += y * x
    h[2] += y * y
    h[3] += z * x
    h[4] += z * y
    h[5] += z * z
    g[0] += x * residual
    g[1] += y * residual
    g[2] += z * residual


@threaded
def _inverse_root(h: Array, out: Array, p: int) -> bool:
    """Write the inverse of the Cholesky factor of a lower triangle to out[p]; False if it is singular."""
    if not h[0] > 0.0:
        return False
    l00 = math.sqrt(h[0])
    l10, l20 = h[1] / l00, h[3] / l00
    d1 = h[2] - l10 * l10
    if not d1 > SINGULAR * h[2]:
        return False
    l11 = math.sqrt(d1)
    l21 = (h[4] - l20 * l10) / l11
    d2 = h[5] - l20 * l20 - l21 * l21
    if not d2 > SINGULAR * h[5]:
        return False
    r00, r11, r22 = 1.0 / l00, 1.0 / l11, 1.0 / math.sqrt(d2)
    out[p, 0], out[p, 2], out[p, 5] = r00, r11, r22
    out[p, 1] = -l10 * r00 * r11
    out[p, 4] = -l21 * r11 * r22
    out[p, 3] = -(l20 * r00 - l21 * l10 * r00 * r11) * r22
    return True


@threaded
def _along(
    a: int, base: int, d_image: Array, basis: Array, i: int, wide: Array, n_basis: int, n_components: int
) -> tuple[float, float]:
    """Product of the image Jacobian of observation a with the wide unknowns of image i."""
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

    ``places`` (N + 1,): first point of each chunk; ``squares`` (N,). Others: see :func:`point_blocks`.
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
            r0, r1, r2, r3, r4, r5 = root[p, 0], root[p, 1], root[p, 2], root[p, 3], root[p, 4], root[p, 5]
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
