"""Orbital frame under corrections: its exact difference, and derivatives of a ground point's coordinates in it.

With x, y, z the axes of convention B at position P and velocity V, w = (x, y, z)^T (G - P), v2 = V . y, v3 = V . z::

    dw1 = x.(dG - dP) - (w2/v2) x.dV + ((w2 v3/v2 - w3)/|P|) x.dP
    dw2 = y.(dG - dP) + (w1/v2) x.dV - (w3 y + (w1 v3/v2) x).dP/|P|
    dw3 = z.(dG - dP) + (w1 x + w2 y).dP/|P|

V acts only through x.dV, which is a pure yaw. Source: docs/equations.md 3.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import inlined
from factors.geometry.rotations import Matrix, Vector, ecef_from_orbital


@inlined
def reference(position: Vector, velocity: Vector) -> tuple[Matrix, Vector]:
    """Orbital frame of P and V; |P| (m), V . y and V . z (m/s)."""
    px, py, pz = position
    vx, vy, vz = velocity
    f = ecef_from_orbital(px, py, pz, vx, vy, vz)
    p = np.sqrt(px * px + py * py + pz * pz)
    return f, (p, vx * f[1] + vy * f[4] + vz * f[7], vx * f[2] + vy * f[5] + vz * f[8])


@inlined
def turned(lengths: Vector, dp: Vector, dv: Vector) -> tuple[Matrix, Vector]:
    """Difference of the orbital frame when P and V change, in coordinates of the frame before the change.

    Exact, not linearised: in its own coordinates that frame is the unit matrix and V x z = (v2, 0, 0), so no digits
    cancel.

    Parameters
    ----------
    lengths : tuple
        |P|, v2, v3 before the change.
    dp, dv : tuples
        Changes of P (m) and V (m/s), in coordinates of that frame.

    Returns
    -------
    difference : tuple of 9
        Columns: differences of the axes x, y, z.
    scales : tuple
        1/|P|, 1/v2 and v3 after the change.
    """
    p, v2, v3 = lengths
    a, b, up = dp[0], dp[1], p + dp[2]
    p2 = np.sqrt(a * a + b * b + up * up)
    one_p = 1.0 / p2
    zx, zy = a * one_p, b * one_p
    dzz = -(a * a + b * b) * one_p / (p2 + up)
    zz = 1.0 + dzz
    vx, vy, vz = dv[0], v2 + dv[1], v3 + dv[2]
    # n = V x z, |n| = V . y
    dnx = dv[1] + vy * dzz - vz * zy
    nx, ny, nz = v2 + dnx, vz * zx - vx * zz, vx * zy - vy * zx
    across = ny * ny + nz * nz
    n = np.sqrt(nx * nx + across)
    one_n = 1.0 / n
    dxx, xy, xz = -across * one_n / (n + nx), ny * one_n, nz * one_n
    dyy = dzz + dxx + dzz * dxx - zx * xz
    yx, yz = zy * xz - zz * xy, zx * xy - zy * (1.0 + dxx)
    return (dxx, yx, zx, xy, dyy, zy, xz, yz, dzz), (one_p, one_n, vx * zx + vy * zy + vz * zz)


@inlined
def row_derivatives(c: Vector, w: Vector, frame: Matrix, scales: Vector, follows: Any) -> tuple[Vector, Vector, Vector]:
    """Derivatives of ``c . w`` with respect to P, V and G, c constant: three 3-tuples, ECEF.

    ``frame`` and ``scales`` (see :func:`turned`) belong to w; ``follows`` is 1.0, or 0.0 if the frame is constant.
    """
    x1, y1, _, x2, y2, _, x3, y3, _ = frame
    turn = (c[1] * w[0] - c[0] * w[1]) * scales[1] * follows
    along_x = (c[2] * w[0] - c[0] * w[2]) * scales[0] * follows - turn * scales[2] * scales[0]
    along_y = (c[2] * w[1] - c[1] * w[2]) * scales[0] * follows
    g1 = c[0] * x1 + c[1] * y1 + c[2] * frame[2]
    g2 = c[0] * x2 + c[1] * y2 + c[2] * frame[5]
    g3 = c[0] * x3 + c[1] * y3 + c[2] * frame[8]
    return (
        (along_x * x1 + along_y * y1 - g1, along_x * x2 + along_y * y2 - g2, along_x * x3 + along_y * y3 - g3),
        (turn * x1, turn * x2, turn * x3),
        (g1, g2, g3),
    )
