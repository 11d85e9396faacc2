"""The frame camera: rotation, projection centre, interior orientation and distortion as scalar maps.

Camera axes: X right along the samples, Y down along the lines, Z forward along the view (OpenCV, COLMAP). Cameras
that look along -Z with Y up (photogrammetric axes, BAL) are these after a half-turn about X.

A *camera* is an array with the fields of ``CAMERA``: rotation camera_from_ground row-major, projection centre m, focal
length and principal point px, coefficients of the distortion, and J row-major: a change dw of the rotation vector w
turns the camera by J dw about its own axes. A *turn* is a camera whose rotation and J alone are given.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, compiled
from factors.geometry.rotations import Vector
from factors.records import Record

CAMERA: Final = Record(
    rotation="r11 r12 r13 r21 r22 r23 r31 r32 r33", centre="x y z", focal=1, principal="sample line",
    distortion="k1 k2 k3 p1 p2", jacobian="j11 j12 j13 j21 j22 j23 j31 j32 j33",
)  # fmt: skip
#: Rotation vectors shorter than the root of this (rad^2) go through series: no cancellation, no division by zero.
SMALL_ANGLE_SQUARED: Final = 1e-4
#: Newton steps from a measured to an ideal direction; the last one must be below the tolerance.
IDEAL_STEPS: Final = 30
IDEAL_TOLERANCE: Final = 1e-13


@compiled
def row_of(t: Array, i: int) -> Any:
    """Row of a table (M, 29) of cameras as a tuple: numbers in registers, where an array would be read again."""
    return (
        t[i, CAMERA.r11], t[i, CAMERA.r12], t[i, CAMERA.r13], t[i, CAMERA.r21], t[i, CAMERA.r22], t[i, CAMERA.r23],
        t[i, CAMERA.r31], t[i, CAMERA.r32], t[i, CAMERA.r33], t[i, CAMERA.x], t[i, CAMERA.y], t[i, CAMERA.z],
        t[i, CAMERA.focal], t[i, CAMERA.sample], t[i, CAMERA.line], t[i, CAMERA.k1], t[i, CAMERA.k2], t[i, CAMERA.k3],
        t[i, CAMERA.p1], t[i, CAMERA.p2], t[i, CAMERA.j11], t[i, CAMERA.j12], t[i, CAMERA.j13], t[i, CAMERA.j21],
        t[i, CAMERA.j22], t[i, CAMERA.j23], t[i, CAMERA.j31], t[i, CAMERA.j32], t[i, CAMERA.j33],
    )  # fmt: skip


@compiled
def rotation_coefficients(t: Any) -> Any:
    """Coefficients sin a / a, (1 - cos a) / a^2, (a - sin a) / a^3 for t = a^2."""
    if t.real < SMALL_ANGLE_SQUARED:
        c = 1.0 / 6.0 - t / 120.0 + t * t / 5040.0
        return 1.0 - t * c, 0.5 - t / 24.0 + t * t / 720.0, c
    a = np.sqrt(t)
    s, h = np.sin(a) / a, np.sin(0.5 * a) / a
    return s, 2.0 * h * h, (1.0 - s) / t


@compiled
def turned(w: Vector, start: Any, out: Any) -> None:
    """Write R = exp([w]x) R_0 and J, its left Jacobian at w, into a camera; ``start`` (9,) is R_0.

    Exact and without a singularity below a full turn (Rodrigues; Chirikjian 2012, eq. 10.86).
    """
    x, y, z = w[0], w[1], w[2]
    first, rotation = start.reshape(3, 3), out[CAMERA.rotation].reshape(3, 3)
    jacobian = out[CAMERA.jacobian].reshape(3, 3)
    s, b, c = rotation_coefficients(x * x + y * y + z * z)
    for k in range(2):
        # I + p [w]x + q [w]x^2, the same form for both
        p, q = (s, b) if k == 0 else (b, c)
        m = (
            1.0 - q * (y * y + z * z), q * x * y - p * z, q * x * z + p * y,
            q * x * y + p * z, 1.0 - q * (x * x + z * z), q * y * z - p * x,
            q * x * z - p * y, q * y * z + p * x, 1.0 - q * (x * x + y * y),
        )  # fmt: skip
        for i in range(3):
            for j in range(3):
                if k == 0:
                    rotation[i, j] = (
                        m[3 * i] * first[0, j] + m[3 * i + 1] * first[1, j] + m[3 * i + 2] * first[2, j]
                    )  # fmt: skip
                else:
                    jacobian[i, j] = m[3 * i + j]


@compiled
def rotate(turn: Any, d: Vector) -> Any:
    """Product R d (three numbers)."""
    return (
        turn[CAMERA.r11] * d[0] + turn[CAMERA.r12] * d[1] + turn[CAMERA.r13] * d[2],
        turn[CAMERA.r21] * d[0] + turn[CAMERA.r22] * d[1] + turn[CAMERA.r23] * d[2],
        turn[CAMERA.r31] * d[0] + turn[CAMERA.r32] * d[1] + turn[CAMERA.r33] * d[2],
    )


@compiled
def rotate_back(turn: Any, d: Vector) -> Any:
    """Product R^T d (three numbers)."""
    return (
        turn[CAMERA.r11] * d[0] + turn[CAMERA.r21] * d[1] + turn[CAMERA.r31] * d[2],
        turn[CAMERA.r12] * d[0] + turn[CAMERA.r22] * d[1] + turn[CAMERA.r32] * d[2],
        turn[CAMERA.r13] * d[0] + turn[CAMERA.r23] * d[1] + turn[CAMERA.r33] * d[2],
    )


@compiled
def by_turn(turn: Any, d: Vector) -> Any:
    """Product J^T d (three numbers): turns derivatives by a small turn into those by the rotation vector."""
    return (
        turn[CAMERA.j11] * d[0] + turn[CAMERA.j21] * d[1] + turn[CAMERA.j31] * d[2],
        turn[CAMERA.j12] * d[0] + turn[CAMERA.j22] * d[1] + turn[CAMERA.j32] * d[2],
        turn[CAMERA.j13] * d[0] + turn[CAMERA.j23] * d[1] + turn[CAMERA.j33] * d[2],
    )


def rotated(start: Array, w: Array) -> Array:
    """Rotation ``exp([w]x) start`` (3, 3)."""
    out = np.empty(CAMERA.size)
    turned(np.ascontiguousarray(w), np.ascontiguousarray(start).ravel(), out)
    return np.asarray(out[CAMERA.rotation].reshape(3, 3))


@compiled
def direction(camera: Any, gx: Any, gy: Any, gz: Any) -> Any:
    """X/Z, Y/Z and 1/Z (1/m) of a ground point in camera axes."""
    dx, dy, dz = gx - camera[CAMERA.x], gy - camera[CAMERA.y], gz - camera[CAMERA.z]
    inverse = 1.0 / (camera[CAMERA.r31] * dx + camera[CAMERA.r32] * dy + camera[CAMERA.r33] * dz)
    x = camera[CAMERA.r11] * dx + camera[CAMERA.r12] * dy + camera[CAMERA.r13] * dz
    y = camera[CAMERA.r21] * dx + camera[CAMERA.r22] * dy + camera[CAMERA.r23] * dz
    return x * inverse, y * inverse, inverse


@compiled
def brown_ideal_to_measured(camera: Any, x: Any, y: Any) -> Any:
    """Measured direction from the ideal one (Brown 1966, form of OpenCV): two numbers.

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), likewise y' with p1 and p2 exchanged.
    """
    k1, k2, k3 = camera[CAMERA.k1], camera[CAMERA.k2], camera[CAMERA.k3]
    p1, p2 = camera[CAMERA.p1], camera[CAMERA.p2]
    xx, yy, xy = x * x, y * y, x * y
    r = xx + yy
    radial = 1.0 + r * (k1 + r * (k2 + r * k3))
    return x * radial + 2.0 * p1 * xy + p2 * (r + 2.0 * xx), y * radial + p1 * (r + 2.0 * yy) + 2.0 * p2 * xy


@compiled
def brown_derivatives(camera: Any, x: Any, y: Any) -> Any:
    """Derivatives x'_x, x'_y = y'_x, y'_y of :func:`brown_ideal_to_measured`."""
    k1, k2, k3 = camera[CAMERA.k1], camera[CAMERA.k2], camera[CAMERA.k3]
    p1, p2 = camera[CAMERA.p1], camera[CAMERA.p2]
    r = x * x + y * y
    radial, slope = 1.0 + r * (k1 + r * (k2 + r * k3)), 2.0 * (k1 + r * (2.0 * k2 + 3.0 * k3 * r))
    mixed = x * y * slope + 2.0 * (p1 * x + p2 * y)
    along_x, along_y = radial + x * x * slope, radial + y * y * slope
    return along_x + 2.0 * p1 * y + 6.0 * p2 * x, mixed, along_y + 6.0 * p1 * y + 2.0 * p2 * x


@compiled
def pixel(camera: Any, x: Any, y: Any) -> Any:
    """Line and sample (px) of an ideal direction."""
    mx, my = brown_ideal_to_measured(camera, x, y)
    return camera[CAMERA.line] + camera[CAMERA.focal] * my, camera[CAMERA.sample] + camera[CAMERA.focal] * mx


@compiled
def ideal_directions(camera: Array, line: Array, sample: Array) -> Array:
    """Ideal directions X/Z, Y/Z of N pixels by Newton: (N, 2); nan where the distortion cannot be inverted."""
    out = np.full((len(line), 2), np.nan)
    for i in range(len(line)):
        mx = (sample[i] - camera[CAMERA.sample]) / camera[CAMERA.focal]
        my = (line[i] - camera[CAMERA.line]) / camera[CAMERA.focal]
        x, y = mx, my
        for _ in range(IDEAL_STEPS):
            fx, fy = brown_ideal_to_measured(camera, x, y)
            a, b, d = brown_derivatives(camera, x, y)
            det = a * d - b * b
            if not (det > 0.0 and a > 0.0):  # beyond the fold of the polynomial two directions share a pixel
                break
            ex, ey = mx - fx, my - fy
            sx, sy = (d * ex - b * ey) / det, (a * ey - b * ex) / det
            x, y = x + sx, y + sy
            if abs(sx) + abs(sy) < IDEAL_TOLERANCE * (1.0 + abs(x) + abs(y)):
                out[i, 0], out[i, 1] = x, y
                break
    return out


@compiled
def project(camera: Array, ground: Array) -> Array:
    """Line, sample (px) and inverse depth (1/m) of N ground points (N, 3): (N, 3)."""
    out = np.empty((len(ground), 3))
    for i in range(len(ground)):
        x, y, out[i, 2] = direction(camera, ground[i, 0], ground[i, 1], ground[i, 2])
        out[i, 0], out[i, 1] = pixel(camera, x, y)
    return out
