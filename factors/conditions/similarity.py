"""Similarity transformation between two sets of points in space, with seven unknowns: absolute orientation.

    r = W (t_0 + t + e^m s_0 R x - X),   R = exp([w]x) R_0

x is the point in the model, X the point on the ground; the unknowns (7,) are w (rad), m,
t (unit of the ground coordinates).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, compiled, register
from factors.cameras.frame_camera import CAMERA, rotate, turned
from factors.conditions.control import POINT, whitened
from factors.geometry.rotations import cross
from factors.records import Record

#: Record of an equation: W (row-major) and X of the control point; model point x; R_0 (row-major), s_0 and t_0.
RECORD: Final = Record(**POINT.fields, model=3, rotation=9, scale=1, shift=3)


@compiled
def _moved(record: Any, x: Any, turn: Any) -> Any:
    """Return the point e^m s_0 R x (3,)."""
    return np.exp(x[3]) * record[RECORD.scale] * np.array(rotate(turn, record[RECORD.model]))


@compiled
def residual(record: Any, setup: Any, x: Any) -> Any:
    """Return the whitened residual (3,): computed minus given; accepts complex unknowns."""
    turn = np.empty(CAMERA.size, x.dtype)
    turned(x[:3], record[RECORD.rotation], turn)
    d = _moved(record, x, turn) + record[RECORD.shift] + x[4:7] - record[RECORD.place]
    return whitened(record, d)


@compiled
def kernel(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Return the residual (3,) and Jacobian (3, 7)."""
    value = residual(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    turn = np.empty(CAMERA.size, x.dtype)
    turned(x[:3], record[RECORD.rotation], turn)
    p, out, column = _moved(record, x, turn), np.empty((3, 7)), np.empty(3)
    axes = turn[CAMERA.jacobian].reshape(3, 3)
    for j in range(7):
        if j < 3:
            column[0], column[1], column[2] = cross(axes[:, j], p)
        elif j == 3:
            column[:] = p
        else:
            column[:] = 0.0
            column[j - 4] = 1.0
        out[:, j] = whitened(record, column)
    return value, out


SIMILARITY = register(Equation(
    "similarity", kernel, residual, (Argument("similarity", "rad, 1, m"),),
    "the seven-parameter transformation of absolute orientation",
))  # fmt: skip
