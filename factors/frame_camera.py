"""The frame camera: rotation, projection centre, interior orientation and distortion as scalar maps.

Camera axes: X right along the samples, Y down along the lines, Z forward along the view (OpenCV, COLMAP). Cameras
that look along -Z with Y up (photogrammetric axes, BAL) are these after a half-turn about X.

A *camera* is an array (29,): rotation camera_from_ground 0:9 row-major, projection centre 9:12 m, focal length 12,
sample 13 and line 14 of the principal point px, k1 k2 k3 p1 p2 15:20, and J 20:29 row-major: a change dw of the
rotation vector w turns the camera by J dw about its own axes.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, compiled

CAMERA_SIZE: Final = 29
#: Rotation vectors shorter than the root of this (rad^2) go through series: no cancellation, no division by zero.
SMALL_ANGLE_SQUARED: Final = 1e-4
#: Newton steps from a measured to an ideal direction; the last one must be below the tolerance.
IDEAL_STEPS: Final = 30
IDEAL_TOLERANCE: Final = 1e-13


@compiled
def row_of(t: Array, i: int) -> Any:
    """Row of a table (M, 29) of cameras as a tuple: numbers in registers, where an array would be read again."""
    return (
        t[i, 0], t[i, 1], t[i, 2], t[i, 3], t[i, 4], t[i, 5], t[i, 6], t[i, 7], t[i, 8], t[i, 9], t[i, 10], t[i, 11],
        t[i, 12], t[i, 13], t[i, 14], t[i, 15], t[i, 16], t[i, 17], t[i, 18], t[i, 19], t[i, 20], t[i, 21], t[i, 22],
        t[i, 23], t[i, 24], t[i, 25], t[i, 26], t[i, 27], t[i, 28],
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
def turned(w: Any, start: Any, out: Any) -> None:
    """Write R = exp([w]x) R_0 and J, its left Jacobian at w, into a camera; ``start`` (9,) is R_0.

    Exact and without a singularity below a full turn (Rodrigues; Chirikjian 2012, eq. 10.86).
    """
    x, y, z = w[0], w[1], w[2]
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
                    out[3 * i + j] = (
                        m[3 * i] * start[j] + m[3 * i + 1] * start[3 + j] + m[3 * i + 2] * start[6 + j]
                    )  # fmt: skip
                else:
                    out[20 + 3 * i + j] = m[3 * i + j]


@compiled
def direction(camera: Any, gx: Any, gy: Any, gz: Any) -> Any:
    """X/Z, Y/Z and 1/Z (1/m) of a ground point in camera axes."""
    dx, dy, dz = gx - camera[9], gy - camera[10], gz - camera[11]
    inverse = 1.0 / (camera[6] * dx + camera[7] * dy + camera[8] * dz)
    x = camera[0] * dx + camera[1] * dy + camera[2] * dz
    y = camera[3] * dx + camera[4] * dy + camera[5] * dz
    return x * inverse, y * inverse, inverse


@compiled
def brown_ideal_to_measured(camera: Any, x: Any, y: Any) -> Any:
    """Measured direction from the ideal one (Brown 1966, form of OpenCV): two numbers.

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), likewise y' with p1 and p2 exchanged.
    """
    k1, k2, k3, p1, p2 = camera[15], camera[16], camera[17], camera[18], camera[19]
    xx, yy, xy = x * x, y * y, x * y
    r = xx + yy
    radial = 1.0 + r * (k1 + r * (k2 + r * k3))
    return x * radial + 2.0 * p1 * xy + p2 * (r + 2.0 * xx), y * radial + p1 * (r + 2.0 * yy) + 2.0 * p2 * xy


@compiled
def brown_derivatives(camera: Any, x: Any, y: Any) -> Any:
    """Derivatives x'_x, x'_y = y'_x, y'_y of :func:`brown_ideal_to_measured`."""
    k1, k2, k3, p1, p2 = camera[15], camera[16], camera[17], camera[18], camera[19]
    r = x * x + y * y
    radial, slope = 1.0 + r * (k1 + r * (k2 + r * k3)), 2.0 * (k1 + r * (2.0 * k2 + 3.0 * k3 * r))
    mixed = x * y * slope + 2.0 * (p1 * x + p2 * y)
    along_x, along_y = radial + x * x * slope, radial + y * y * slope
    return along_x + 2.0 * p1 * y + 6.0 * p2 * x, mixed, along_y + 6.0 * p1 * y + 2.0 * p2 * x


@compiled
def pixel(camera: Any, x: Any, y: Any) -> Any:
    """Line and sample (px) of an ideal direction."""
    mx, my = brown_ideal_to_measured(camera, x, y)
    return camera[14] + camera[12] * my, camera[13] + camera[12] * mx


@compiled
def ideal_directions(camera: Array, line: Array, sample: Array) -> Array:
    """Ideal directions X/Z, Y/Z of N pixels by Newton: (N, 2); nan where the distortion cannot be inverted."""
    out = np.full((len(line), 2), np.nan)
    for i in range(len(line)):
        mx, my = (sample[i] - camera[13]) / camera[12], (line[i] - camera[14]) / camera[12]
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
