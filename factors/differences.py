"""Rotations as reference plus difference: rounding relative to the correction.

A rotation applied to ``v + dv`` under angles ``a + da`` is split into its value at the
reference (a, v) and the exact difference to it, formed from small quantities only. The sum
equals the plain product to rounding; the difference keeps 16 digits of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import compiled
from factors.rotations import Matrix, Vector


@compiled
def d_ecef_from_orbital(frame: Matrix, state: Any, d: Any) -> Matrix:
    """Difference of the orbital frame when P and V change by d[0:3] m and d[3:6] m/s.

    ``frame`` belongs to ``state`` = P, V (6). Exact, not linearised: with Z = P/p,
    n = V x Z, X = n/|n| the differences of p and |n| are formed without cancellation.
    """
    xx, yx, zx, xy, yy, zy, xz, yz, zz = frame
    p = np.sqrt(state[0] ** 2 + state[1] ** 2 + state[2] ** 2)
    p2 = np.sqrt((state[0] + d[0]) ** 2 + (state[1] + d[1]) ** 2 + (state[2] + d[2]) ** 2)
    dp = (d[0] * (2.0 * state[0] + d[0]) + d[1] * (2.0 * state[1] + d[1]) + d[2] * (2.0 * state[2] + d[2])) / (p + p2)
    dzx, dzy, dzz = (d[0] - zx * dp) / p2, (d[1] - zy * dp) / p2, (d[2] - zz * dp) / p2
    # n = V x Z at the reference has length n along X; its difference:
    ux, uy, uz = zx + dzx, zy + dzy, zz + dzz
    dnx = d[4] * uz - d[5] * uy + state[4] * dzz - state[5] * dzy
    dny = d[5] * ux - d[3] * uz + state[5] * dzx - state[3] * dzz
    dnz = d[3] * uy - d[4] * ux + state[3] * dzy - state[4] * dzx
    n = state[3] * yx + state[4] * yy + state[5] * yz
    ax, ay, az = n * xx + dnx, n * xy + dny, n * xz + dnz
    n2 = np.sqrt(ax * ax + ay * ay + az * az)
    dn = (dnx * (n * xx + ax) + dny * (n * xy + ay) + dnz * (n * xz + az)) / (n + n2)
    dxx, dxy, dxz = (dnx - xx * dn) / n2, (dny - xy * dn) / n2, (dnz - xz * dn) / n2
    vx, vy, vz = xx + dxx, xy + dxy, xz + dxz
    dyx = dzy * vz - dzz * vy + zy * dxz - zz * dxy
    dyy = dzz * vx - dzx * vz + zz * dxx - zx * dxz
    dyz = dzx * vy - dzy * vx + zx * dxy - zy * dxx
    return (dxx, dyx, dzx, dxy, dyy, dzy, dxz, dyz, dzz)


@compiled
def _turn(a: Any, da: Any, u: Any, v: Any, du: Any, dv: Any) -> Any:
    """Pair form of (c u + s v, -s u + c v) with c, s of a + da."""
    s, c = np.sin(a), np.cos(a)
    half = np.sin(0.5 * da)
    ds, dc = 2.0 * np.cos(a + 0.5 * da) * half, -2.0 * np.sin(a + 0.5 * da) * half
    s2, c2 = s + ds, c + dc
    return c * u + s * v, -s * u + c * v, c2 * du + s2 * dv + dc * u + ds * v, -s2 * du + c2 * dv - ds * u + dc * v


@compiled
def body_from_orbital_pair(angles: Any, d: Any, w: Vector, dw: Vector) -> Any:
    """Reference and difference of ``R_UY(angles + d)^T (w + dw)``: two 3-tuples.

    ``angles`` and ``d``: roll, pitch, yaw (rad); inverse of ``rotations.orbital_from_body``.
    """
    y, z, dy, dz = _turn(angles[1], d[1], w[1], w[2], dw[1], dw[2])
    z, x, dz, dx = _turn(angles[0], d[0], z, w[0], dz, dw[0])
    x, y, dx, dy = _turn(angles[2], d[2], x, y, dx, dy)
    return (x, y, z), (dx, dy, dz)


@compiled
def body_from_orbital_small_pair(angles: Any, d: Any, w: Vector, dw: Vector) -> Any:
    """Pair form of the transposed small-angle matrix, see ``rotations.orbital_from_body_small``."""
    r, p, y = angles[0], angles[1], angles[2]
    r2, p2, y2 = r + d[0], p + d[1], y + d[2]
    reference = (w[0] + y * w[1] - r * w[2], w[1] - y * w[0] + p * w[2], w[2] + r * w[0] - p * w[1])
    difference = (
        dw[0] + y2 * dw[1] - r2 * dw[2] + d[2] * w[1] - d[0] * w[2],
        dw[1] - y2 * dw[0] + p2 * dw[2] - d[2] * w[0] + d[1] * w[2],
        dw[2] + r2 * dw[0] - p2 * dw[1] + d[0] * w[0] - d[1] * w[1],
    )
    return reference, difference
