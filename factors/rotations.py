"""Rotations of the pushbroom chain, as scalar maps on 9-tuples in row-major order.

Frames: *body* (payload), *orbital* of convention B (X = V x Z right of flight, Y = Z x X
forward, Z radial outward) and *ECEF*. Names read target_from_source. Active elementary
rotations; roll turns about Y, pitch about X, yaw about Z of the orbital frame.

Source: Terlemezoğlu 2019, eqs. 2.23-2.27 as corrected in docs/equations.md 2 (columns, not
rows; X = V x Z); quaternions: eq. 2.36.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import Array, compiled

Matrix = Any  # a tuple of 9 scalars, real or complex
Vector = Any  # a tuple of 3 scalars


@compiled
def multiply_transposed(a: Matrix, x: Any, y: Any, z: Any) -> Vector:
    """Transposed matrix times vector."""
    return (
        a[0] * x + a[3] * y + a[6] * z,
        a[1] * x + a[4] * y + a[7] * z,
        a[2] * x + a[5] * y + a[8] * z,
    )


@compiled
def ecef_from_orbital(px: Any, py: Any, pz: Any, vx: Any, vy: Any, vz: Any) -> Matrix:
    """Orbital frame of convention B from position (m) and velocity (m/s) in ECEF."""
    p = np.sqrt(px * px + py * py + pz * pz)
    zx, zy, zz = px / p, py / p, pz / p
    nx, ny, nz = vy * zz - vz * zy, vz * zx - vx * zz, vx * zy - vy * zx
    n = np.sqrt(nx * nx + ny * ny + nz * nz)
    xx, xy, xz = nx / n, ny / n, nz / n
    yx, yy, yz = zy * xz - zz * xy, zz * xx - zx * xz, zx * xy - zy * xx
    return (xx, yx, zx, xy, yy, zy, xz, yz, zz)


@compiled
def orbital_from_body(roll: Any, pitch: Any, yaw: Any) -> Matrix:
    """Attitude Rx(pitch) Ry(roll) Rz(yaw), full form (T 2.23)."""
    sr, cr = np.sin(roll), np.cos(roll)
    sp, cp = np.sin(pitch), np.cos(pitch)
    sy, cy = np.sin(yaw), np.cos(yaw)
    return (
        cr * cy, -cr * sy, sr,
        cp * sy + sp * sr * cy, cp * cy - sp * sr * sy, -sp * cr,
        sp * sy - cp * sr * cy, sp * cy + cp * sr * sy, cp * cr,
    )  # fmt: skip


@compiled
def orbital_from_body_small(roll: Any, pitch: Any, yaw: Any) -> Matrix:
    """Small-angle attitude I + [a]x (T 2.24); its transpose serves as inverse throughout."""
    one = 1.0 + 0.0 * roll
    return (one, -yaw, roll, yaw, one, -pitch, -roll, pitch, one)


@compiled
def d_orbital_from_body(roll: Any, pitch: Any, yaw: Any) -> tuple[Matrix, Matrix, Matrix]:
    """Derivatives of :func:`orbital_from_body` with respect to roll, pitch, yaw (1/rad)."""
    r = orbital_from_body(roll, pitch, yaw)
    sr, cr = np.sin(roll), np.cos(roll)
    sp, cp = np.sin(pitch), np.cos(pitch)
    sy, cy = np.sin(yaw), np.cos(yaw)
    t0, t1, t2 = -cr * cy, cr * sy, -sr
    d_roll = (-sr * cy, sr * sy, cr, -sp * t0, -sp * t1, -sp * t2, cp * t0, cp * t1, cp * t2)
    d_pitch = (0.0 * sr, 0.0 * sr, 0.0 * sr, -r[6], -r[7], -r[8], r[3], r[4], r[5])
    d_yaw = (r[1], -r[0], 0.0 * sr, r[4], -r[3], 0.0 * sr, r[7], -r[6], 0.0 * sr)
    return d_roll, d_pitch, d_yaw


@compiled
def d_orbital_from_body_small() -> tuple[Matrix, Matrix, Matrix]:
    """Derivatives of :func:`orbital_from_body_small`, constant."""
    d_roll = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0)
    d_pitch = (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0)
    d_yaw = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return d_roll, d_pitch, d_yaw


@compiled
def matrix_from_quaternion(q0: Any, q1: Any, q2: Any, q3: Any) -> Matrix:
    """Rotation of a quaternion, scalar part first; normalised here (T 2.36)."""
    n = np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    a, b, c, d = q0 / n, q1 / n, q2 / n, q3 / n
    return (
        a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c),
        2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b),
        2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d,
    )  # fmt: skip


@compiled
def add(a: Matrix, b: Matrix) -> Matrix:
    """Sum of two matrices."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5], a[6] + b[6], a[7] + b[7],
            a[8] + b[8])  # fmt: skip


@compiled
def scaled(a: Matrix, k: Any) -> Matrix:
    """Matrix times scalar."""
    return (a[0] * k, a[1] * k, a[2] * k, a[3] * k, a[4] * k, a[5] * k, a[6] * k, a[7] * k, a[8] * k)


@compiled
def orbital_frames(position_m: Array, velocity_m_s: Array) -> Array:
    """Orbital frames of N states: (N, 3), (N, 3) -> (N, 3, 3), ecef_from_orbital."""
    out = np.empty((len(position_m), 3, 3))
    for i in range(len(position_m)):
        p, v = position_m[i], velocity_m_s[i]
        m = ecef_from_orbital(p[0], p[1], p[2], v[0], v[1], v[2])
        for k in range(9):
            out[i, k // 3, k % 3] = m[k]
    return out


@compiled
def attitude_matrices(angles_rad: Array, small: bool) -> Array:
    """Attitudes of N angle triples roll, pitch, yaw: (N, 3) -> (N, 3, 3), orbital_from_body."""
    out = np.empty((len(angles_rad), 3, 3))
    for i in range(len(angles_rad)):
        a = angles_rad[i]
        m = orbital_from_body_small(a[0], a[1], a[2]) if small else orbital_from_body(a[0], a[1], a[2])
        for k in range(9):
            out[i, k // 3, k % 3] = m[k]
    return out


@compiled
def quaternion_matrices(quaternion: Array) -> Array:
    """Rotations of N quaternions: (N, 4) -> (N, 3, 3)."""
    out = np.empty((len(quaternion), 3, 3))
    for i in range(len(quaternion)):
        q = quaternion[i]
        m = matrix_from_quaternion(q[0], q[1], q[2], q[3])
        for k in range(9):
            out[i, k // 3, k % 3] = m[k]
    return out
