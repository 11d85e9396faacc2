"""Ground points of a block eliminated: 3 x 3 blocks, gradients, rows reduced by them.

With the whitened Jacobians J (image) and G (ground) of the image points, ``H = sum G^T G + W^T W`` of a ground point,
its diagonal lengthened by the share ``damping``, ``H^-1 = R^T R`` (R the inverse Cholesky factor, lower triangular).
Arrays: ``fg_orient.kernels.batch``; the steps of the points: ``fg_orient.kernels.batch_steps``.
"""

from __future__ import annotations

import math
from typing import Final

from factors._compile import threaded
from factors._contract import Array
from factors.conditions.control import POINT
from factors.records import Record
from fg_orient.kernels.batch_rows import Flags, Small

Block = tuple[float, float, float, float, float, float]  # lower triangle: 00 10 11 20 21 22
Gradient = tuple[float, float, float]

#: Lower triangle R of a ground point; of its rays both rows of Z = G R^T, and the residuals reduced by the point.
ROOT: Final = Record(r00=1, r10=1, r11=1, r20=1, r21=1, r22=1)
SCALED: Final = Record(line="x0 x1 x2", sample="y0 y1 y2", residuals="r_line r_sample")
ZERO_BLOCK: Final = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ZERO_GRADIENT: Final = (0.0, 0.0, 0.0)
#: A point whose pivot falls below this part of its diagonal element is not determined.
SINGULAR = 1e-14


@threaded
def point_blocks(
    lo: int, hi: int, first: Small, number: Small, free: Flags, control: Array, ground: Array, damping: float,
    base: int, value: Array, d_ground: Array, root: Array, gradient: Array, scaled: Array,
) -> int:  # fmt: skip
    """Write R (P, 6) as ``ROOT`` and the gradient (P, 3); of each ray Z = G R^T and reduced residuals, ``SCALED``.

    Parameters
    ----------
    first : (P + 1,) int array
        First observation of each point.
    number : (P,) int array
        Row of the point in ``control`` and ``ground``.
    free : (P,) int array
        0 for a constant, 1 for an unknown, 2 for an unknown with a control-point equation.
    control : (N, 12) array
        Records of observed points, ``factors.conditions.control.POINT``.
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
        root[p, ROOT.r00], root[p, ROOT.r10], root[p, ROOT.r11] = r0, r1, r2
        root[p, ROOT.r20], root[p, ROOT.r21], root[p, ROOT.r22] = r3, r4, r5
        gradient[p, 0], gradient[p, 1], gradient[p, 2] = g
        u0, u1, u2 = r0 * g[0], r1 * g[0] + r2 * g[1], r3 * g[0] + r4 * g[1] + r5 * g[2]
        for a in range(first[p] - base, first[p + 1] - base):
            for r in range(2):
                x, y, z = d_ground[a, r, 0], d_ground[a, r, 1], d_ground[a, r, 2]
                z0, z1, z2 = r0 * x, r1 * x + r2 * y, r3 * x + r4 * y + r5 * z
                if r == 0:
                    scaled[a, SCALED.x0], scaled[a, SCALED.x1], scaled[a, SCALED.x2] = z0, z1, z2
                else:
                    scaled[a, SCALED.y0], scaled[a, SCALED.y1], scaled[a, SCALED.y2] = z0, z1, z2
                scaled[a, SCALED.residuals.start + r] = value[a, r] - (u0 * z0 + u1 * z1 + u2 * z2)
    return bad


@threaded
def _with_control(control: Array, ground: Array, j: int, h: Block, g: Gradient) -> tuple[Block, Gradient]:
    """Block and gradient with the three equations of a control point."""
    x, y = ground[j, 0] - control[j, POINT.x], ground[j, 1] - control[j, POINT.y]
    z = ground[j, 2] - control[j, POINT.z]
    for w0, w1, w2 in (
        (control[j, POINT.w11], control[j, POINT.w12], control[j, POINT.w13]),
        (control[j, POINT.w21], control[j, POINT.w22], control[j, POINT.w23]),
        (control[j, POINT.w31], control[j, POINT.w32], control[j, POINT.w33]),
    ):
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
