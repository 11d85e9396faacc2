"""Frame camera: rotation, projection centre, interior orientation and distortion as scalar maps.

Camera axes: X right along the samples, Y down along the lines, Z forward along the view (OpenCV, COLMAP). Cameras that
look along -Z with Y up (photogrammetric axes, BAL) have these axes after a rotation by 180 degrees about X.

A *camera* is an array with the fields of ``CAMERA``: rotation camera_from_ground (row-major), projection
centre (m), focal length and principal point (px), coefficients of the distortion, and J (row-major). A change
dw of the rotation vector w rotates the camera by J dw about its own axes. A *turn* is a camera in which only
the rotation and J are set.

Brown's polynomial has one of two directions. It converts ideal to measured coordinates (OpenCV, COLMAP, BAL;
x, y are X/Z, Y/Z); or it corrects the measured coordinates, as in photogrammetric calibrations (Brown 1971;
Ayhan 1996; DBAT: Börlin, Grussenmeyer 2016, "backward" models). A map in one direction is the inverse of a
map in the other direction, but the inverse of a polynomial is not a polynomial. A correcting polynomial has
the arguments ``x = (sample - sample_0) (1 + aspect) / unit`` and ``y = (line - line_0) / unit`` with a fixed
unit (px), for example the number of pixels in 1 mm: the coefficients do not change with the focal length.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, compiled, inlined
from factors.geometry.rotations import Vector, cross, multiply, multiply_transposed
from factors.records import Record

CAMERA: Final = Record(
    rotation="r11 r12 r13 r21 r22 r23 r31 r32 r33", centre="x y z", focal=1, principal="sample line",
    distortion="k1 k2 k3 p1 p2", aspect=1, unit=1, jacobian="j11 j12 j13 j21 j22 j23 j31 j32 j33",
)  # fmt: skip
#: Rotation vectors with a smaller squared length (rad^2) use series, which avoid cancellation and division by zero.
SMALL_ANGLE_SQUARED: Final = 1e-4


@compiled
def rotation_coefficients(t: Any) -> Any:
    """Return the coefficients sin a / a, (1 - cos a) / a^2, (a - sin a) / a^3 for t = a^2."""
    if t.real < SMALL_ANGLE_SQUARED:
        c = 1.0 / 6.0 - t / 120.0 + t * t / 5040.0
        return 1.0 - t * c, 0.5 - t / 24.0 + t * t / 720.0, c
    a = np.sqrt(t)
    s, h = np.sin(a) / a, np.sin(0.5 * a) / a
    return s, 2.0 * h * h, (1.0 - s) / t


@inlined
def _exponential(w: Vector, p: Any, q: Any) -> Any:
    """Return the matrix I + p [w]x + q [w]x^2, row-major."""
    x, y, z = w[0], w[1], w[2]
    return (
        1.0 - q * (y * y + z * z), q * x * y - p * z, q * x * z + p * y,
        q * x * y + p * z, 1.0 - q * (x * x + z * z), q * y * z - p * x,
        q * x * z - p * y, q * y * z + p * x, 1.0 - q * (x * x + y * y),
    )  # fmt: skip


@compiled
def turned(w: Vector, start: Any, out: Any) -> None:
    """Write R = exp([w]x) R_0 and J, its left Jacobian at w, into a camera; ``start`` (9,) is R_0.

    The formulas are exact and have no singularity below a full turn (Rodrigues; Chirikjian 2012, eq. 10.86).
    """
    s, b, c = rotation_coefficients(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    turn, jacobian, first = _exponential(w, s, b), _exponential(w, b, c), start.reshape(3, 3)
    rotation = out[CAMERA.rotation].reshape(3, 3)
    for j in range(3):
        rotation[0, j], rotation[1, j], rotation[2, j] = multiply(turn, (first[0, j], first[1, j], first[2, j]))
    for j in range(9):
        out[CAMERA.j11 + j] = jacobian[j]


@inlined
def _rotation(c: Any) -> Any:
    """Return the rotation R of a camera: nine numbers, row-major."""
    return (
        c[CAMERA.r11], c[CAMERA.r12], c[CAMERA.r13], c[CAMERA.r21], c[CAMERA.r22], c[CAMERA.r23], c[CAMERA.r31],
        c[CAMERA.r32], c[CAMERA.r33],
    )  # fmt: skip


@inlined
def rotate(turn: Any, d: Vector) -> Any:
    """Return the product R d (three numbers)."""
    return multiply(_rotation(turn), d)


@inlined
def rotate_back(turn: Any, d: Vector) -> Any:
    """Return the product R^T d (three numbers)."""
    return multiply_transposed(_rotation(turn), d)


@inlined
def by_turn(turn: Any, q: Vector, g: Vector) -> Any:
    """Return the derivatives J^T (q x g) by the rotation vector, where q = R p and g are a function's derivatives by q.

    A step dw changes q by (J dw) x q, and g . (e x q) = e . (q x g).
    """
    x, y, z = cross(q, g)
    return (
        turn[CAMERA.j11] * x + turn[CAMERA.j21] * y + turn[CAMERA.j31] * z,
        turn[CAMERA.j12] * x + turn[CAMERA.j22] * y + turn[CAMERA.j32] * z,
        turn[CAMERA.j13] * x + turn[CAMERA.j23] * y + turn[CAMERA.j33] * z,
    )


def rotated(start: Array, w: Array) -> Array:
    """Return the rotation ``exp([w]x) start`` (3, 3)."""
    out = np.empty(CAMERA.size)
    turned(np.ascontiguousarray(w), np.ascontiguousarray(start).ravel(), out)
    return np.asarray(out[CAMERA.rotation].reshape(3, 3))


@compiled
def direction(camera: Any, gx: Any, gy: Any, gz: Any) -> Any:
    """Return X/Z, Y/Z and 1/Z (1/m) of a ground point in camera axes."""
    x, y, z = rotate(camera, (gx - camera[CAMERA.x], gy - camera[CAMERA.y], gz - camera[CAMERA.z]))
    inverse = 1.0 / z
    return x * inverse, y * inverse, inverse


@compiled
def brown(camera: Any, x: Any, y: Any) -> Any:
    """Return the result of Brown's polynomial (Brown 1966, form of OpenCV): two numbers.

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2); y' has the same form with p1 and p2 exchanged.
    """
    k1, k2, k3 = camera[CAMERA.k1], camera[CAMERA.k2], camera[CAMERA.k3]
    p1, p2 = camera[CAMERA.p1], camera[CAMERA.p2]
    xx, yy, xy = x * x, y * y, x * y
    r = xx + yy
    radial = 1.0 + r * (k1 + r * (k2 + r * k3))
    return x * radial + 2.0 * p1 * xy + p2 * (r + 2.0 * xx), y * radial + p1 * (r + 2.0 * yy) + 2.0 * p2 * xy


@compiled
def brown_slopes(camera: Any, x: Any, y: Any) -> Any:
    """Return the derivatives x'_x, x'_y = y'_x, y'_y of :func:`brown`."""
    k1, k2, k3 = camera[CAMERA.k1], camera[CAMERA.k2], camera[CAMERA.k3]
    p1, p2 = camera[CAMERA.p1], camera[CAMERA.p2]
    r = x * x + y * y
    radial, slope = 1.0 + r * (k1 + r * (k2 + r * k3)), 2.0 * (k1 + r * (2.0 * k2 + 3.0 * k3 * r))
    mixed = x * y * slope + 2.0 * (p1 * x + p2 * y)
    along_x, along_y = radial + x * x * slope, radial + y * y * slope
    return along_x + 2.0 * p1 * y + 6.0 * p2 * x, mixed, along_y + 6.0 * p1 * y + 2.0 * p2 * x


@compiled
def pixel(camera: Any, x: Any, y: Any) -> Any:
    """Return line and sample (px) of an ideal direction."""
    mx, my = brown(camera, x, y)
    return camera[CAMERA.line] + camera[CAMERA.focal] * my, camera[CAMERA.sample] + camera[CAMERA.focal] * mx


@compiled
def polynomial_arguments(c: Any, line: Any, sample: Any) -> Any:
    """Return the arguments x, y of a correcting polynomial, from a measured pixel."""
    x, y = sample - c[CAMERA.sample], line - c[CAMERA.line]
    return x * (1.0 + c[CAMERA.aspect]) / c[CAMERA.unit], y / c[CAMERA.unit]
