"""Rotations between the frames of a pushbroom image. A matrix is a tuple of 9 scalars in row-major order.

Frames: *body* (payload), *orbital* of convention B (X = V x Z right of flight, Y = Z x X forward, Z radial outward) and
*ECEF*. Names read target_from_source. Elementary rotations are active; roll is a rotation about Y, pitch about X, yaw
about Z of the orbital frame.

Source: Terlemezoğlu 2019, eqs. 2.23-2.27 as corrected in docs/equations.md 2 (columns, not rows; X = V x Z);
quaternions: eq. 2.36.

Sine and cosine are computed here without calls or branches, so that loops over observations become vector
instructions. The argument is reduced by multiples of pi/2 in two parts (Cody & Waite 1980, ch. 8); the series
end where the remainder is below rounding. The cosine is returned as cosine minus one, which keeps the digits
of small corrections.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from factors._contract import Array, inlined
from factors._plain import on_arrays, plain

#: Number of rows that fit into the second-level cache together with all intermediate values.
AT_ONCE: Final = 1024

Matrix = Any  # a tuple of 9 scalars, real or complex
Vector = Any  # three scalars, a tuple or an array


@inlined
def multiply_transposed(a: Matrix, v: Vector) -> Vector:
    """Return the transposed matrix times vector."""
    return (
        a[0] * v[0] + a[3] * v[1] + a[6] * v[2],
        a[1] * v[0] + a[4] * v[1] + a[7] * v[2],
        a[2] * v[0] + a[5] * v[1] + a[8] * v[2],
    )


@inlined
def multiply(a: Matrix, v: Vector) -> Vector:
    """Return the matrix times vector."""
    return (
        a[0] * v[0] + a[1] * v[1] + a[2] * v[2],
        a[3] * v[0] + a[4] * v[1] + a[5] * v[2],
        a[6] * v[0] + a[7] * v[1] + a[8] * v[2],
    )


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def ecef_from_orbital(px: Any, py: Any, pz: Any, vx: Any, vy: Any, vz: Any) -> Matrix:
    """Return the orbital frame of convention B from position (m) and velocity (m/s) in ECEF."""
    one = 1.0 / np.sqrt(px * px + py * py + pz * pz)
    zx, zy, zz = px * one, py * one, pz * one
    nx, ny, nz = vy * zz - vz * zy, vz * zx - vx * zz, vx * zy - vy * zx
    one = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
    xx, xy, xz = nx * one, ny * one, nz * one
    yx, yy, yz = zy * xz - zz * xy, zz * xx - zx * xz, zx * xy - zy * xx
    return (xx, yx, zx, xy, yy, zy, xz, yz, zz)


@inlined
def from_sines(sr: Any, cr: Any, sp: Any, cp: Any, sy: Any, cy: Any) -> Matrix:
    """Return attitude Rx(pitch) Ry(roll) Rz(yaw), full form (T 2.23), from sines and cosines of roll, pitch, yaw."""
    return (
        cr * cy, -cr * sy, sr,
        cp * sy + sp * sr * cy, cp * cy - sp * sr * sy, -sp * cr,
        sp * sy - cp * sr * cy, sp * cy + cp * sr * sy, cp * cr,
    )  # fmt: skip


@inlined
def orbital_from_body(roll: Any, pitch: Any, yaw: Any) -> Matrix:
    """Return the attitude from roll, pitch, yaw (rad)."""
    r, p, y = sine_cosine(roll), sine_cosine(pitch), sine_cosine(yaw)
    return from_sines(r[0], 1.0 + r[1], p[0], 1.0 + p[1], y[0], 1.0 + y[1])


@inlined
def orbital_from_body_small(roll: Any, pitch: Any, yaw: Any) -> Matrix:
    """Return the small-angle attitude I + [a]x (T 2.24); everywhere its transpose is used as its inverse."""
    one = 1.0 + 0.0 * roll
    return (one, -yaw, roll, yaw, one, -pitch, -roll, pitch, one)


@inlined
def matrix_from_quaternion(q0: Any, q1: Any, q2: Any, q3: Any) -> Matrix:
    """Return the rotation of a quaternion with the scalar part first; it is normalised here (T 2.36)."""
    n = np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    a, b, c, d = q0 / n, q1 / n, q2 / n, q3 / n
    return (
        a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c),
        2 * (b * c + a * d), a * a - b * b + c * c - d * d, 2 * (c * d - a * b),
        2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d,
    )  # fmt: skip


@inlined
def turned(a: Matrix, d: Matrix) -> Matrix:
    """Return the product ``a (I + d)``."""
    x = multiply(a, (1.0 + d[0], d[3], d[6]))
    y = multiply(a, (d[1], 1.0 + d[4], d[7]))
    z = multiply(a, (d[2], d[5], 1.0 + d[8]))
    return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])


def orbital_frames(position_m: Array, velocity_m_s: Array) -> Array:
    """Return the orbital frames of N states: (N, 3), (N, 3) -> (N, 3, 3), ecef_from_orbital."""
    return _matrices(ecef_from_orbital, position_m, velocity_m_s)


def attitude_matrices(angles_rad: Array, small: bool) -> Array:
    """Return the attitudes of N angle triples roll, pitch, yaw: (N, 3) -> (N, 3, 3), orbital_from_body."""
    return _matrices(orbital_from_body_small if small else orbital_from_body, angles_rad)


def quaternion_matrices(quaternion: Array) -> Array:
    """Return the rotations of N quaternions: (N, 4) -> (N, 3, 3)."""
    return _matrices(matrix_from_quaternion, quaternion)


def _matrices(rotation: Callable[..., Matrix], *arguments: Array) -> Array:
    """Return the matrices (N, 3, 3) of one of the maps above, applied to columns of N rows."""
    out = np.empty((len(arguments[0]), 9))
    with np.errstate(all="ignore"):  # compiled code does not warn either
        for lo in range(0, len(out), AT_ONCE):
            part = slice(lo, lo + AT_ONCE)
            for k, entry in enumerate(plain(rotation)(*(column for a in arguments for column in a[part].T))):
                out[part, k] = entry
    return out.reshape(-1, 3, 3)


#: pi/2 in two parts: rounded to 33 bits, so that its multiples up to 2^20 are exact, and the remainder.
_HIGH: Final = int(0.5 * math.pi * 2.0**32) / 2.0**32
_LOW: Final = (0.5 * math.pi - _HIGH) + 6.123233995736766e-17
_S3, _S5, _S7, _S9, _S11, _S13, _S15, _S17 = ((-1) ** k / math.factorial(2 * k + 1) for k in range(1, 9))
_C2, _C4, _C6, _C8, _C10, _C12, _C14, _C16 = ((-1) ** k / math.factorial(2 * k) for k in range(1, 9))


@on_arrays(np.where)
@inlined
def _chosen(condition: Any, one: Any, other: Any) -> Any:
    """Return ``one`` where the condition is true, else ``other``."""
    return one if condition else other


@inlined
def sine_cosine(x: Any) -> Any:
    """Return the sine, and cosine minus one, of an angle (rad), real or complex near the real axis.

    The absolute error is below 2.2e-16 up to 1e6 rad, the relative error below 1e-15 up to pi/4; beyond 1e15 rad no
    digit is correct.
    """
    k = np.floor(x.real * (2.0 / math.pi) + 0.5)
    half = np.floor(0.5 * k)
    sign = 1.0 - 2.0 * (half - 2.0 * np.floor(0.5 * half))
    r = (x - k * _HIGH) - k * _LOW
    z = r * r
    s = r + r * z * (_S3 + z * (_S5 + z * (_S7 + z * (_S9 + z * (_S11 + z * (_S13 + z * (_S15 + z * _S17)))))))
    c = z * (_C2 + z * (_C4 + z * (_C6 + z * (_C8 + z * (_C10 + z * (_C12 + z * (_C14 + z * _C16)))))))
    odd = k - 2.0 * half > 0.5
    first, second = 1.0 + c, -1.0 - s
    return sign * _chosen(odd, first, s), sign * _chosen(odd, second, c) + (sign - 1.0)
