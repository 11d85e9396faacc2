"""Similarity of two sets of points in space, seven unknowns: absolute orientation.

    r = W (t_0 + t + e^m s_0 R x - X),   R = exp([w]x) R_0

x is the point in the model, X on the ground; unknowns (7,): w (rad), m, t (unit of the ground coordinates).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, register
from factors.frame_camera import CAMERA_SIZE, turned

#: Record: x 0:3, X 3:6, W 6:15 row-major, R_0 15:24 row-major, s_0 24, t_0 25:28.
RECORD_SIZE: Final = 28


@compiled
def _moved(record: Any, x: Any, turn: Any) -> Any:
    """Point e^m s_0 R x (3,)."""
    size, out = np.exp(x[3]) * record[24], np.empty(3, x.dtype)
    for i in range(3):
        out[i] = size * (
            turn[3 * i] * record[0] + turn[3 * i + 1] * record[1] + turn[3 * i + 2] * record[2]
        )  # fmt: skip
    return out


@compiled
def _whitened(record: Any, d: Any) -> Any:
    out = np.empty_like(d)
    for i in range(3):
        out[i] = record[6 + 3 * i] * d[0] + record[7 + 3 * i] * d[1] + record[8 + 3 * i] * d[2]
    return out


@compiled
def residual(record: Any, setup: Any, x: Any) -> Any:
    """Whitened residual (3,), computed minus given; accepts complex unknowns."""
    turn = np.empty(CAMERA_SIZE, x.dtype)
    turned(x[:3], record[15:24], turn)
    return _whitened(record, _moved(record, x, turn) + record[25:28] + x[4:7] - record[3:6])


@compiled
def kernel(record: Array, setup: Array, x: Array, want: bool) -> tuple[Array, Array]:
    """Residual (3,) and Jacobian (3, 7)."""
    value = residual(record, setup, x)
    if not want:
        return value, np.empty((0, 0))
    turn = np.empty(CAMERA_SIZE, x.dtype)
    turned(x[:3], record[15:24], turn)
    p, out, column = _moved(record, x, turn), np.empty((3, 7)), np.empty(3)
    for j in range(7):
        if j < 3:
            a, b, c = turn[20 + j], turn[23 + j], turn[26 + j]
            column[0], column[1], column[2] = b * p[2] - c * p[1], c * p[0] - a * p[2], a * p[1] - b * p[0]
        elif j == 3:
            column[:] = p
        else:
            column[:] = 0.0
            column[j - 4] = 1.0
        out[:, j] = _whitened(record, column)
    return value, out


def _example(rng: np.random.Generator) -> Example:
    start, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    start *= np.sign(np.linalg.det(start))
    record = np.concatenate([rng.normal(size=15), start.ravel(), [rng.uniform(0.5, 2.0)], rng.normal(size=3)])
    return Example(record, np.zeros((2, 0)), (rng.normal(scale=0.5, size=7),))


SIMILARITY = register(Equation(
    "similarity", kernel, residual, (Argument("similarity", "rad, 1, m"),), _example,
    "the seven-parameter transformation of absolute orientation",
))  # fmt: skip
