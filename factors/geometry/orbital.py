"""Change of the orbital frame caused by corrections, and derivatives of a ground point's coordinates in this frame.

With x, y, z the axes of convention B at position P and velocity V, w = (x, y, z)^T (G - P), v2 = V . y, v3 = V . z::

    dw1 = x.(dG - dP) - (w2/v2) x.dV + ((w2 v3/v2 - w3)/|P|) x.dP
    dw2 = y.(dG - dP) + (w1/v2) x.dV - (w3 y + (w1 v3/v2) x).dP/|P|
    dw3 = z.(dG - dP) + (w1 x + w2 y).dP/|P|

V has an effect only through x.dV, which is a pure yaw. Source: docs/equations.md 3.

Frames of convention A come from position and velocity, or from Kepler angles: X forward, Y along the orbit normal (left
of flight), Z outward. Convention B (X right, Y forward) is ``A K`` with :data:`B_FROM_A` transposed. Attitude of
convention A: ``Rx(roll) Ry(pitch) Rz(yaw)``, active and right-handed. Source: Terlemezoğlu 2019, eqs. 2.7-2.21 as
corrected: columns, four-quadrant angles, inertial velocity.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, inlined
from factors.geometry.rotations import Matrix, Vector, ecef_from_orbital


@inlined
def reference(position: Vector, velocity: Vector) -> tuple[Matrix, Vector]:
    """Return the orbital frame of P and V; and |P| (m), V . y and V . z (m/s)."""
    px, py, pz = position
    vx, vy, vz = velocity
    f = ecef_from_orbital(px, py, pz, vx, vy, vz)
    p = np.sqrt(px * px + py * py + pz * pz)
    return f, (p, vx * f[1] + vy * f[4] + vz * f[7], vx * f[2] + vy * f[5] + vz * f[8])


@inlined
def turned(lengths: Vector, dp: Vector, dv: Vector) -> tuple[Matrix, Vector]:
    """Return the difference of the orbital frame if P and V change, in coordinates of the frame before the change.

    The difference is exact, not linearised. In its own coordinates the frame before the change is the unit
    matrix and V x z = (v2, 0, 0), so no digits are lost by cancellation.

    Parameters
    ----------
    lengths : tuple
        |P|, v2, v3 before the change.
    dp, dv : tuples
        Changes of P (m) and V (m/s), in coordinates of the frame before the change.

    Returns
    -------
    difference : tuple of 9
        Differences of the axes x, y, z, as columns.
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
    """Return the derivatives of ``c . w`` by P, V and G for constant c: three 3-tuples, ECEF.

    w is computed with ``frame`` and ``scales`` (see :func:`turned`). ``follows`` is 1.0, or 0.0 if the frame
    is constant.
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


#: Axes of convention B from axes of convention A: X_B = -Y_A, Y_B = X_A.
B_FROM_A: Final = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def kepler_angles(position_m: Array, velocity_m_s: Array) -> Array:
    """Return inclination, node and argument of latitude (N, 3), rad, of N states.

    ``velocity_m_s`` is inertial, in the axes of the position. Source: eqs. 2.11-2.16; node and argument of latitude use
    atan2, so that descending passes are correct.
    """
    c = np.cross(position_m, velocity_m_s)
    inclination = np.arccos(c[:, 2] / np.linalg.norm(c, axis=1))
    node = np.arctan2(c[:, 0], -c[:, 1])
    x, y, z = position_m.T
    latitude = np.arctan2(z / np.sin(inclination), x * np.cos(node) + y * np.sin(node))
    return np.stack([inclination, node, latitude], axis=1)


def frames_from_kepler(angles_rad: Array) -> Array:
    """Return the orbital frames (N, 3, 3) for inclination, node and argument of latitude (N, 3): eq. 2.18."""
    ci, co, cw = np.cos(angles_rad).T
    si, so, sw = np.sin(angles_rad).T
    rows = [
        [-co * sw - so * ci * cw, so * si, co * cw - so * ci * sw],
        [-so * sw + co * ci * cw, -co * si, so * cw + co * ci * sw],
        [si * cw, ci, si * sw],
    ]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))


def frames_from_state(position_m: Array, velocity_m_s: Array) -> Array:
    """Return the orbital frames (N, 3, 3) for positions and velocities (N, 3): eqs. 2.19-2.21.

    With the Earth-fixed velocity the frame follows the ground track, with the inertial velocity it follows the orbit:
    the two frames differ by 3 degrees of yaw.
    """
    z = position_m / np.linalg.norm(position_m, axis=1, keepdims=True)
    y = np.cross(z, velocity_m_s)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=2)


def attitude_matrices(angles_rad: Array) -> Array:
    """Return the rotations (N, 3, 3) from payload to orbital frame for roll, pitch, yaw (N, 3) in convention A."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles_rad).T, np.sin(angles_rad).T
    rows = [
        [cp * cy, -cp * sy, sp],
        [cr * sy + sr * sp * cy, cr * cy - sr * sp * sy, -sr * cp],
        [sr * sy - cr * sp * cy, cr * sp * sy + sr * cy, cr * cp],
    ]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))
