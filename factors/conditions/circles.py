"""Constraints of points on circles and plumb lines, and of cameras with equal attitude; formulas: ``constraints``."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, register_condition
from factors.cameras.frame_camera import CAMERA, turned
from factors.conditions.constraints import FACTOR
from factors.records import Record

#: Record of a circle: factor s, normal and axes of its plane. Record of two cameras: s, their rotations R_0 and D,
#: row-major.
CIRCLE_RECORD: Final = Record(factor=1, normal=3, e_1=3, e_2=3)
ATTITUDE_RECORD: Final = Record(factor=1, first=9, second=9, between=9)


def residual_plumb_line(record: Any, setup: Any, x: Any, p: Any) -> Any:
    """Return the residual (2,) of the position in plan x (2,)."""
    return np.array([record[FACTOR.factor] * (p[0] - x[0]), record[FACTOR.factor] * (p[1] - x[1])])


def jacobians_plumb_line(record: Array, setup: Array, value: Array, x: Array, p: Array) -> tuple[Array, Array]:
    """Return the Jacobians (2, 2) and (2, 3)."""
    s = record[FACTOR.factor]
    return np.array([[-s, 0.0], [0.0, -s]]), np.array([[s, 0.0, 0.0], [0.0, s, 0.0]])


def _normal(record: Any, x: Any) -> Any:
    """Return the normal (3,) of the circle's plane."""
    return record[CIRCLE_RECORD.normal] + x[3] * record[CIRCLE_RECORD.e_1] + x[4] * record[CIRCLE_RECORD.e_2]


def residual_circle(record: Any, setup: Any, x: Any, p: Any) -> Any:
    """Return the residual (2,) for centre, tilts, radius x (6,): distance from the plane, then from the sphere."""
    n = _normal(record, x)
    d = p - x[:3]
    off = (n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    s, distance = record[CIRCLE_RECORD.factor], np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return np.array([s * off, s * (distance - x[5])])


def jacobians_circle(record: Array, setup: Array, value: Array, x: Array, p: Array) -> tuple[Array, Array]:
    """Return the Jacobians (2, 6) and (2, 3)."""
    s = record[CIRCLE_RECORD.factor]
    n, d = _normal(record, x), p - x[:3]
    size, radius = np.sqrt(np.sum(n * n)), np.sqrt(np.sum(d * d))
    out, ground = np.zeros((2, 6)), np.empty((2, 3))
    ground[0], ground[1] = s / size * n, s / radius * d
    for k, e in enumerate((record[CIRCLE_RECORD.e_1], record[CIRCLE_RECORD.e_2])):
        out[0, 3 + k] = s / size * np.sum(e * d) - value[0] * x[3 + k] / (size * size)
    out[:, :3] = -ground
    out[1, 5] = -s
    return out, ground


def residual_horizontal(record: Any, setup: Any, x: Any, p: Any) -> Any:
    """Return the residual (2,) for centre and radius x (4,): height, then distance in plan."""
    s, dx, dy = record[FACTOR.factor], p[0] - x[0], p[1] - x[1]
    return np.array([s * (p[2] - x[2]), s * (np.sqrt(dx * dx + dy * dy) - x[3])])


def jacobians_horizontal(record: Array, setup: Array, value: Array, x: Array, p: Array) -> tuple[Array, Array]:
    """Return the Jacobians (2, 4) and (2, 3)."""
    s = record[FACTOR.factor]
    dx, dy = p[0] - x[0], p[1] - x[1]
    f = s / np.sqrt(dx * dx + dy * dy)
    return (
        np.array([[0.0, 0.0, -s, 0.0], [-f * dx, -f * dy, 0.0, -s]]),
        np.array([[0.0, 0.0, s], [f * dx, f * dy, 0.0]]),
    )  # fmt: skip


def _relative(record: Any, v: Any, w: Any) -> Any:
    """Return the turns of both cameras; E = R_2 R_1^T D^T and R_2 R_1^T (3, 3)."""
    first, second = np.empty(CAMERA.size, v.dtype), np.empty(CAMERA.size, w.dtype)
    turned(v, record[ATTITUDE_RECORD.first], first)
    turned(w, record[ATTITUDE_RECORD.second], second)
    between = second[CAMERA.rotation].reshape(3, 3) @ first[CAMERA.rotation].reshape(3, 3).T
    return first, second, between @ record[ATTITUDE_RECORD.between].reshape(3, 3).T, between


def residual_attitude(record: Any, setup: Any, v: Any, w: Any) -> Any:
    """Return the residual (3,): sine of the rotation angle of E times its axis, rad times s."""
    _, _, e, _ = _relative(record, v, w)
    f = 0.5 * record[ATTITUDE_RECORD.factor]
    return np.array([f * (e[2, 1] - e[1, 2]), f * (e[0, 2] - e[2, 0]), f * (e[1, 0] - e[0, 1])])


def jacobians_attitude(record: Array, setup: Array, value: Array, v: Array, w: Array) -> tuple[Array, Array]:
    """Return the Jacobians (3, 3) by the rotation vectors of both cameras."""
    first, second, e, between = _relative(record, v, w)
    # [a]x E - ([a]x E)^T is the cross-product matrix of (tr E I - E^T)^T a
    by_turn = 0.5 * record[ATTITUDE_RECORD.factor] * ((e[0, 0] + e[1, 1] + e[2, 2]) * np.eye(3) - e)
    left, right = first[CAMERA.jacobian].reshape(3, 3), second[CAMERA.jacobian].reshape(3, 3)
    return -(by_turn @ (between @ left)), by_turn @ right


_POINT: Final = Argument("point", "m", is_point=True)
PLUMB_LINE = register_condition(
    "constraint_plumb_line",
    residual_plumb_line,
    jacobians_plumb_line,
    (Argument("plumb line", "m"), _POINT),
    "Ayhan 1996, eq. 113",
    n_constants=FACTOR.size,
)
CIRCLE = register_condition(
    "constraint_circle",
    residual_circle,
    jacobians_circle,
    (Argument("circle", "m, 1, m"), _POINT),
    "Ayhan 1996, eqs. 115-116",
    n_constants=CIRCLE_RECORD.size,
)
HORIZONTAL_CIRCLE = register_condition(
    "constraint_horizontal_circle",
    residual_horizontal,
    jacobians_horizontal,
    (Argument("circle", "m"), _POINT),
    "Ayhan 1996, eq. 117",
    n_constants=FACTOR.size,
)
EQUAL_ATTITUDE = register_condition(
    "constraint_equal_attitude",
    residual_attitude,
    jacobians_attitude,
    (Argument("rotation", "rad"), Argument("rotation", "rad")),
    "Ayhan 1996, eq. 112",
    n_constants=ATTITUDE_RECORD.size,
)
