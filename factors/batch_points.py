"""Ground points of a block eliminated, and found again: 3 x 3 blocks, gradients, back-substitution.

With the whitened Jacobians J (image) and G (ground) of the image points, ``H = sum G^T G + W^T W + damping I`` of
a ground point, ``H^-1 = R^T R`` (R the inverse Cholesky factor, lower triangular), a solution x of the reduced system
gives the point's step ``-H^-1 (g + sum G^T J x)``. Arrays: ``factors.batch``.
"""

from __future__ import annotations

import math

import numpy as np

from factors._contract import Array
from factors.batch_rows import Index, threaded

#: A point whose pivot falls below this part of its diagonal element is not determined.
SINGULAR = 1e-14


@threaded
def point_blocks(
    lo: int, hi: int, first: Index, number: Index, free: Index, control: Array, ground: Array, value: Array,
    d_ground: Array, damping: float, root: Array, gradient: Array,
) -> int:  # fmt: skip
    """Write R (P, 6) as r00 r10 r11 r20 r21 r22 and the gradient (P, 3) of points lo to hi.

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

    Returns
    -------
    int
        The first point that is not determined, or -1.
    """
    bad, h, d = -1, np.empty((3, 3)), np.empty(3)
    for p in range(lo, hi):
        root[p], gradient[p] = 0.0, 0.0
        if free[p] == 0:
            continue
        h[:] = 0.0
        for k in range(3):
            h[k, k] = damping
        if free[p] == 2:
            j = number[p]
            for r in range(3):
                w = control[j, 3 * r : 3 * r + 3]
                residual = 0.0
                for k in range(3):
                    d[k] = ground[j, k] - control[j, 9 + k]
                    residual += w[k] * d[k]
                _add(h, gradient[p], w, residual)
        for a in range(first[p], first[p + 1]):
            for r in range(2):
                _add(h, gradient[p], d_ground[a, r], value[a, r])
        if not _inverse_root(h, root[p]) and bad < 0:
            bad = p
    return bad


@threaded
def _add(h: Array, gradient: Array, row: Array, residual: float) -> None:
    """Add one equation to the lower triangle and the gradient."""
    for i in range(3):
        gradient[i] += row[i] * residual
        for j in range(i + 1):
            h[i, j] += row[i] * row[j]


@threaded
def _inverse_root(h: Array, out: Array) -> bool:
    """Inverse of the Cholesky factor of the lower triangle; False if it is singular."""
    d0 = h[0, 0]
    if not d0 > 0.0:
        return False
    l00 = math.sqrt(d0)
    l10, l20 = h[1, 0] / l00, h[2, 0] / l00
    d1 = h[1, 1] - l10 * l10
    if not d1 > SINGULAR * h[1, 1]:
        return False
    l11 = math.sqrt(d1)
    l21 = (h[2, 1] - l20 * l10) / l11
    d2 = h[2, 2] - l20 * l20 - l21 * l21
    if not d2 > SINGULAR * h[2, 2]:
        return False
    l22 = math.sqrt(d2)
    out[0], out[2], out[5] = 1.0 / l00, 1.0 / l11, 1.0 / l22
    out[1] = -l10 * out[0] * out[2]
    out[4] = -l21 * out[2] * out[5]
    out[3] = -(l20 * out[0] + l21 * out[1]) * out[5]
    return True


@threaded
def _along(
    a: int, d_image: Array, basis: Array, i: int, wide: Array, n_basis: int, n_components: int
) -> tuple[float, float]:
    """Product of the image Jacobian of observation a with the wide unknowns of image i."""
    y0, y1 = 0.0, 0.0
    for b in range(n_basis):
        for c in range(n_components):
            x = basis[a, b] * wide[i, b * n_components + c]
            y0 += d_image[a, 0, c] * x
            y1 += d_image[a, 1, c] * x
    return y0, y1


@threaded
def back_substitute(
    lo: int, hi: int, first: Index, image: Index, n_basis: Index, n_components: Index, basis: Array, wide: Array,
    value: Array, d_image: Array, d_ground: Array, root: Array, gradient: Array, step: Array, after: Array,
) -> None:  # fmt: skip
    """Write the steps (P, 3) of points lo to hi and the linear residuals (n, 2) after the step."""
    for p in range(lo, hi):
        t0, t1, t2 = gradient[p, 0], gradient[p, 1], gradient[p, 2]
        for a in range(first[p], first[p + 1]):
            i = image[a]
            y0, y1 = _along(a, d_image, basis, i, wide, n_basis[i], n_components[i])
            after[a, 0], after[a, 1] = value[a, 0] + y0, value[a, 1] + y1
            t0 += d_ground[a, 0, 0] * y0 + d_ground[a, 1, 0] * y1
            t1 += d_ground[a, 0, 1] * y0 + d_ground[a, 1, 1] * y1
            t2 += d_ground[a, 0, 2] * y0 + d_ground[a, 1, 2] * y1
        r0, r1, r2, r3, r4, r5 = root[p, 0], root[p, 1], root[p, 2], root[p, 3], root[p, 4], root[p, 5]
        u0, u1, u2 = r0 * t0, r1 * t0 + r2 * t1, r3 * t0 + r4 * t1 + r5 * t2
        x0, x1, x2 = -(r0 * u0 + r1 * u1 + r3 * u2), -(r2 * u1 + r4 * u2), -r5 * u2
        step[p, 0], step[p, 1], step[p, 2] = x0, x1, x2
        for a in range(first[p], first[p + 1]):
            after[a, 0] += d_ground[a, 0, 0] * x0 + d_ground[a, 0, 1] * x1 + d_ground[a, 0, 2] * x2
            after[a, 1] += d_ground[a, 1, 0] * x0 + d_ground[a, 1, 1] * x1 + d_ground[a, 1, 2] * x2


@threaded
def product(
    lo: int, hi: int, first: Index, free: Index, image: Index, n_basis: Index, n_components: Index, basis: Array,
    wide: Array, d_image: Array, d_ground: Array, step: Array, out: Array,
) -> None:  # fmt: skip
    """Write the Jacobian times a given step (wide unknowns, points (P, 3)) for the rays of points lo to hi."""
    for p in range(lo, hi):
        for a in range(first[p], first[p + 1]):
            i = image[a]
            y0, y1 = _along(a, d_image, basis, i, wide, n_basis[i], n_components[i])
            if free[p] > 0:
                for k in range(3):
                    y0 += d_ground[a, 0, k] * step[p, k]
                    y1 += d_ground[a, 1, k] * step[p, k]
            out[a, 0], out[a, 1] = y0, y1
