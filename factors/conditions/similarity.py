"""Similarity transformation between two sets of points in space, seven unknowns: absolute orientation.

    r = W (t_0 + t + e^m s_0 R x - X),   R = exp([w]x) R_0

x is the point in the model, X on the ground; unknowns (7,): w (rad), m, t (unit of the ground coordinates).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, register
from factors.cameras.frame_camera import CAMERA, rotate, turned
from factors.geometry.rotations import Vector, random_rotation
from factors.records import Record

#: x, X, W row-major, R_0 row-major, s_0, t_0.
RECORD: Final = Record(
    model=3, ground=3, whitening="w11 w12 w13 w21 w22 w23 w31 w32 w33", rotation=9, scale=1, shift=3,
)  # fmt: skip


@compiled
def _moved(record: Any, x: Any, turn: Any) -> Any:
    """Point e^m s_0 R x (3,)."""
    return np.exp(x[3]) * record[RECORD.scale] * np.array(rotate(turn, record[RECORD.model]))


@compiled
def _whitened(record: Any, d: Vector) -> Any:
    return np.array([
        record[RECORD.w11] * d[0] + record[RECORD.w12] * d[1] + record[RECORD.w13] * d[2],
        record[RECORD.w21] * d[0] + record[RECORD.w22] * d[1] + record[RECORD.w23] * d[2],
        record[RECORD.w31] * d[0] + record[RECORD.w32] * d[1] + record[RECORD.w33] * d[2],
    ])  # fmt: skip


@compiled
def residual(record: Any, setup: Any, x: Any) -> Any:
    """Whitened residual (3,), computed minus given; accepts complex unknowns."""
    turn = np.empty(CAMERA.size, x.dtype)
    turned(x[:3], record[RECORD.rotation], turn)
    return _whitened(record, _moved(record, x, turn) + record[RECORD.shift] + x[4:7] - record[RECORD.ground])


@compiled
def kernel(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Residual (3,) and Jacobian (3, 7)."""
    value = residual(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    turn = np.empty(CAMERA.size, x.dtype)
    turned(x[:3], record[RECORD.rotation], turn)
    p, out, column = _moved(record, x, turn), np.empty((3, 7)), np.empty(3)
    axes = turn[CAMERA.jacobian].reshape(3, 3)
    for j in range(7):
        if j < 3:
            a, b, c = axes[0, j], axes[1, j], axes[2, j]
            column[0], column[1], column[2] = b * p[2] - c * p[1], c * p[0] - a * p[2], a * p[1] - b * p[0]
        elif j == 3:
            column[:] = p
        else:
            column[:] = 0.0
            column[j - 4] = 1.0
        out[:, j] = _whitened(record, column)
    return value, out


def _example(rng: np.random.Generator) -> Example:
    start = random_rotation(rng)
    model, ground, whitening = rng.normal(size=3), rng.normal(size=3), rng.normal(size=9)
    record = RECORD.pack(model=model, ground=ground, whitening=whitening, rotation=start.ravel(),
                         scale=rng.uniform(0.5, 2.0), shift=rng.normal(size=3))  # fmt: skip
    return Example(record, np.zeros((2, 0)), (rng.normal(scale=0.5, size=7),))


SIMILARITY = register(Equation(
    "similarity", kernel, residual, (Argument("similarity", "rad, 1, m"),), _example,
    "the seven-parameter transformation of absolute orientation",
))  # fmt: skip
