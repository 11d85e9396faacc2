"""Coplanarity of two rays and the base: the condition of relative orientation.

    r = s b . (d1 x R^T d2),   d_i = (x_i, y_i, 1)     (Ayhan 1996, eqs. 9-19; equivalent to the essential matrix)

Camera axes are X right, Y down, Z forward; x_i, y_i are tangents of the ideal directions. R = exp([w]x) R_0 rotates the
first camera's axes to the second's. b = b_0 + y_1 n_1 + y_2 n_2 is the second projection centre relative to the first;
its length is not determined. The unknowns (5,) are w and y. The second argument (4,) is the observed point x_1 y_1 x_2
y_2.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, compiled, register
from factors.cameras.frame_camera import CAMERA, by_turn, rotate, rotate_back, turned
from factors.geometry.rotations import cross
from factors.records import Record

#: Factor s, R_0 row-major, b_0, n_1, n_2.
RECORD: Final = Record(factor=1, rotation=9, base=3, n_1=3, n_2=3)


@compiled
def turn_and_base(record: Any, x: Any) -> Any:
    """Return the turn (R and J as in ``factors.cameras.frame_camera``) and the base (3,)."""
    turn = np.empty(CAMERA.size, x.dtype)
    turned(x[:3], record[RECORD.rotation], turn)
    return turn, record[RECORD.base] + x[3] * record[RECORD.n_1] + x[4] * record[RECORD.n_2]


@compiled
def residual(record: Any, setup: Any, x: Any, image: Any) -> Any:
    """Return the residual (1,); accepts complex unknowns."""
    turn, b = turn_and_base(record, x)
    e, f, g = rotate_back(turn, (image[2], image[3], 1.0))
    u, v = image[0], image[1]
    return np.array([record[RECORD.factor] * (b[0] * (v * g - f) + b[1] * (e - u * g) + b[2] * (u * f - v * e))])


@compiled
def kernel(record: Array, setup: Array, x: Array, image: Array, want: bool) -> tuple[Array, Array, Array]:
    """Return the residual (1,), and its Jacobians by the unknowns (1, 5) and the image points (1, 4)."""
    value = residual(record, setup, x, image)
    if not want:
        return value, np.empty((0, 0)), np.empty((0, 0))
    turn, b = turn_and_base(record, x)
    s, u, v, p, q = record[RECORD.factor], image[0], image[1], image[2], image[3]
    e, f, g = rotate_back(turn, (p, q, 1.0))
    by_base = np.array([v * g - f, e - u * g, u * f - v * e])
    m = rotate(turn, cross(b, (u, v, 1.0)))  # r = s d2 . (R n) with n = b x d1
    out, points = np.empty((1, 5)), np.empty((1, 4))
    w1, w2, w3 = by_turn(turn, m, (p, q, 1.0))  # r / s = d2 . R n
    out[0, 0], out[0, 1], out[0, 2] = s * w1, s * w2, s * w3
    for j, axis in enumerate((record[RECORD.n_1], record[RECORD.n_2])):
        out[0, 3 + j] = s * (axis[0] * by_base[0] + axis[1] * by_base[1] + axis[2] * by_base[2])
    points[0, 0], points[0, 1] = s * (b[2] * f - b[1] * g), s * (b[0] * g - b[2] * e)
    points[0, 2], points[0, 3] = s * m[0], s * m[1]
    return value, out, points


COPLANARITY = register(Equation(
    "coplanarity", kernel, residual, (Argument("relative orientation", "rad"), Argument("image points", "1")),
    "Ayhan 1996, eqs. 9-19",
))  # fmt: skip
