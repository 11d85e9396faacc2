"""Ground points of a block eliminated: 3 x 3 blocks, gradients, rows reduced by them.

With the whitened Jacobians J (image) and G (ground) of the image points, ``H = sum G^T G + W^T W`` of a ground point,
its diagonal lengthened by the share ``damping``, ``H^-1 = R^T R`` (R the inverse Cholesky factor, lower triangular).
Arrays: ``factors.batch``; the steps of the points: ``factors.batch_steps``.
"""

from __future__ import annotations

import math
from typing import Final

from factors._compile import threaded
from factors._contract import Array
from factors.batch_rows import Flags, Small

Block = tuple[float, float, float, float, float, float]  # lower triangle: 00 10 11 20 21 22
Gradient = tuple[float, float, float]

ZERO_BLOCK: Final = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ZERO_GRADIENT: Final = (0.0, 0.0, 0.0)
#: A point whose pivot falls below this part of its diagonal element is not determined.
SINGULAR = 1e-14


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
    bad = -1
    for p in range(lo, hi):
        h, g, found = ZERO_BLOCK, ZERO_GRADIENT, ZERO_BLOCK
        if free[p] > 0:
            if free[p] == 2:
                h, g = _with_control(control, ground, number[p], h, g)
            for a in range(first[p] - base, first[p + 1] - base):
                for r in range(2):
                    h, g = _with(h, g, d_ground[a, r, 0], d_ground[a, r, 1], d_ground[a, r, 2], value[a, r])
            more = 1.0 + damping
            regular, found = _inverse_root((h[0] * more, h[1], h[2] * more, h[3], h[4], h[5] * more))
            bad = p if bad < 0 and not regular else bad
        r0, r1, r2, r3, r4, r5 = found
        root[p, 0], root[p, 1], root[p, 2], root[p, 3], root[p, 4], root[p, 5] = found
        gradient[p, 0], gradient[p, 1], gradient[p, 2] = g
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
def _with_control(control: Array, ground: Array, j: int, h: Block, g: Gradient) -> tuple[Block, Gradient]:
    """Block and gradient with the three equations of a control point."""
    x, y, z = ground[j, 0] - control[j, 9], ground[j, 1] - control[j, 10], ground[j, 2] - control[j, 11]
    for r in range(0, 9, 3):
        w0, w1, w2 = control[j, r], control[j, r + 1], control[j, r + 2]
        h, g = _with(h, g, w0, w1, w2, w0 * x + w1 * y + w2 * z)
    return h, g


@threaded
def _with(h: Block, g: Gradient, x: float, y: float, z: float, residual: float) -> tuple[Block, Gradient]:
    """Block and gradient with one equation more."""
    return (
        (h[0] + x * x, h[1] + y * x, h[2] + y * y, h[3] + z * x, h[4] + z * y, h[5] + z * z),
        (g[0] + x * residual, g[1] + y * residual, g[2] + z * residual),
    )


@threaded
def _inverse_root(h: Block) -> tuple[bool, Block]:
    """Inverse of the Cholesky factor of a lower triangle; zeros, and False, if it is singular."""
    if not h[0] > 0.0:
        return False, ZERO_BLOCK
    l00 = math.sqrt(h[0])
    l10, l20 = h[1] / l00, h[3] / l00
    d1 = h[2] - l10 * l10
    if not d1 > SINGULAR * h[2]:
        return False, ZERO_BLOCK
    l11 = math.sqrt(d1)
    l21 = (h[4] - l20 * l10) / l11
    d2 = h[5] - l20 * l20 - l21 * l21
    if not d2 > SINGULAR * h[5]:
        return False, ZERO_BLOCK
    r00, r11, r22 = 1.0 / l00, 1.0 / l11, 1.0 / math.sqrt(d2)
    r20 = -(l20 * r00 - l21 * l10 * r00 * r11) * r22
    return True, (r00, -l10 * r00 * r11, r11, r20, -l21 * r11 * r22, r22)
