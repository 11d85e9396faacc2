"""Circles and plumb lines as figures of points, and two cameras of equal attitude; see ``factors.constraints``."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, register
from factors.frame_camera import CAMERA_SIZE, turned

#: Record of the circle: s, n_0 1:4, e_1 4:7, e_2 7:10; of the attitude: s, R_0 of both cameras 1:19, D 19:28.
CIRCLE_RECORD: Final = 10
ATTITUDE_RECORD: Final = 28


def residual_plumb_line(record: Any, setup: Any, x: Any, p: Any) -> Any:
    """Residual (2,) of the plan position x (2,)."""
    return np.array([record[0] * (p[0] - x[0]), record[0] * (p[1] - x[1])])


def kernel_plumb_line(record: Array, setup: Array, x: Array, p: Array, want: bool) -> tuple[Array, Array, Array]:
    """Residual (2,), Jacobians (2, 2) and (2, 3)."""
    value, s = residual_plumb_line(record, setup, x, p), record[0]
    if not want:
        return value, np.empty((0, 0)), np.empty((0, 0))
    return value, np.array([[-s, 0.0], [0.0, -s]]), np.array([[s, 0.0, 0.0], [0.0, s, 0.0]])


def residual_circle(record: Any, setup: Any, x: Any, p: Any) -> Any:
    """Residual (2,) of centre, tilts, radius x (6,): distance from the plane, then from the sphere."""
    n = record[1:4] + x[3] * record[4:7] + x[4] * record[7:10]
    d = p - x[:3]
    off = (n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    return np.array([record[0] * off, record[0] * (np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) - x[5])])


def kernel_circle(record: Array, setup: Array, x: Array, p: Array, want: bool) -> tuple[Array, Array, Array]:
    """Residual (2,), Jacobians (2, 6) and (2, 3)."""
    value, s = residual_circle(record, setup, x, p), record[0]
    if not want:
        return value, np.empty((0, 0)), np.empty((0, 0))
    n, d = record[1:4] + x[3] * record[4:7] + x[4] * record[7:10], p - x[:3]
    size, radius = np.sqrt(np.sum(n * n)), np.sqrt(np.sum(d * d))
    out, ground = np.zeros((2, 6)), np.empty((2, 3))
    ground[0], ground[1] = s / size * n, s / radius * d
    for k in range(2):
        e = record[4 + 3 * k : 7 + 3 * k]
        out[0, 3 + k] = s / size * np.sum(e * d) - value[0] * x[3 + k] / (size * size)
    out[:, :3] = -ground
    out[1, 5] = -s
    return value, out, ground


def residual_horizontal(record: Any, setup: Any, x: Any, p: Any) -> Any:
    """Residual (2,) of centre and radius x (4,): height, then distance in plan."""
    dx, dy = p[0] - x[0], p[1] - x[1]
    return np.array([record[0] * (p[2] - x[2]), record[0] * (np.sqrt(dx * dx + dy * dy) - x[3])])


def kernel_horizontal(record: Array, setup: Array, x: Array, p: Array, want: bool) -> tuple[Array, Array, Array]:
    """Residual (2,), Jacobians (2, 4) and (2, 3)."""
    value, s = residual_horizontal(record, setup, x, p), record[0]
    if not want:
        return value, np.empty((0, 0)), np.empty((0, 0))
    dx, dy = p[0] - x[0], p[1] - x[1]
    f = s / np.sqrt(dx * dx + dy * dy)
    return (
        value, np.array([[0.0, 0.0, -s, 0.0], [-f * dx, -f * dy, 0.0, -s]]),
        np.array([[0.0, 0.0, s], [f * dx, f * dy, 0.0]]),
    )  # fmt: skip


def _relative(record: Any, v: Any, w: Any) -> Any:
    """Turns (29,) of both cameras; E = R_2 R_1^T D^T and R_2 R_1^T (3, 3)."""
    first, second = np.empty(CAMERA_SIZE, v.dtype), np.empty(CAMERA_SIZE, w.dtype)
    turned(v, record[1:10], first)
    turned(w, record[10:19], second)
    between = second[:9].reshape(3, 3) @ first[:9].reshape(3, 3).T
    return first, second, between @ record[19:28].reshape(3, 3).T, between


def residual_attitude(record: Any, setup: Any, v: Any, w: Any) -> Any:
    """Residual (3,): sine of the angle of E about its axis, rad times s."""
    _, _, e, _ = _relative(record, v, w)
    f = 0.5 * record[0]
    return np.array([f * (e[2, 1] - e[1, 2]), f * (e[0, 2] - e[2, 0]), f * (e[1, 0] - e[0, 1])])


def kernel_attitude(record: Array, setup: Array, v: Array, w: Array, want: bool) -> tuple[Array, Array, Array]:
    """Residual (3,), Jacobians (3, 3) by the rotation vectors of both cameras."""
    value = residual_attitude(record, setup, v, w)
    if not want:
        return value, np.empty((0, 0)), np.empty((0, 0))
    first, second, e, between = _relative(record, v, w)
    # [a]x E - ([a]x E)^T is the cross-product matrix of (tr E I - E^T)^T a
    by_turn = 0.5 * record[0] * ((e[0, 0] + e[1, 1] + e[2, 2]) * np.eye(3) - e)
    left, right = first[20:29].reshape(3, 3), second[20:29].reshape(3, 3)
    return value, -(by_turn @ (between @ left)), by_turn @ right


def _example_circle(rng: np.random.Generator) -> Example:
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0].T.ravel()
    return Example(np.append(rng.uniform(0.5, 2.0), frame), _NONE, (rng.normal(scale=0.3, size=6), rng.normal(size=3)))


def _example_attitude(rng: np.random.Generator) -> Example:
    turns = [m * np.sign(np.linalg.det(m)) for m in (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(3))]
    record = np.concatenate([rng.uniform(0.5, 2.0, 1), *(m.ravel() for m in turns)])
    return Example(record, _NONE, (rng.normal(scale=0.3, size=3), rng.normal(scale=0.3, size=3)))


_NONE: Final = np.zeros((2, 0))
_POINT: Final = Argument("point", "m", is_point=True)
PLUMB_LINE = register(Equation(
    "constraint_plumb_line", kernel_plumb_line, residual_plumb_line, (Argument("plumb line", "m"), _POINT),
    lambda rng: Example(rng.uniform(0.5, 2.0, 1), _NONE, (rng.normal(size=2), rng.normal(size=3))),
    "Ayhan 1996, eq. 113",
))  # fmt: skip
CIRCLE = register(Equation(
    "constraint_circle", kernel_circle, residual_circle, (Argument("circle", "m, 1, m"), _POINT), _example_circle,
    "Ayhan 1996, eqs. 115-116",
))  # fmt: skip
HORIZONTAL_CIRCLE = register(Equation(
    "constraint_horizontal_circle", kernel_horizontal, residual_horizontal, (Argument("circle", "m"), _POINT),
    lambda rng: Example(rng.uniform(0.5, 2.0, 1), _NONE, (rng.normal(size=4), rng.normal(size=3))),
    "Ayhan 1996, eq. 117",
))  # fmt: skip
EQUAL_ATTITUDE = register(Equation(
    "constraint_equal_attitude", kernel_attitude, residual_attitude,
    (Argument("rotation", "rad"), Argument("rotation", "rad")), _example_attitude, "Ayhan 1996, eq. 112",
))  # fmt: skip
