"""Constraints between points, or between points and figures. Their residual is zero if they are satisfied.

    distance          s (|q - p| - d)                                        eqs. 111 (base), 118
    parallel          s e_i . (q - p) x (t - r) / (|q - p| |t - r|)          i = 1, 2
    perpendicular     s (q - p) . (t - r) / (|q - p| |t - r|)
    equal             s (|q - p| - |t - r|)
    plane             s (n . (p - p_0) - x_2) / |n|,   n = n_0 + x_0 e_1 + x_1 e_2       eq. 116
    line              s (e_i . (p - p_0) - x_i - x_{2+i} n_0 . (p - p_0))    i = 1, 2; eq. 113
    plumb line        s (X - x_0, Y - x_1)                                   eq. 113
    circle            residual of the plane through its centre; s (|p - c| - a)  eqs. 115, 116
    horizontal circle s (Z - x_2,  |(X, Y) - (x_0, x_1)| - x_3)              eq. 117
    observed element  s (x_j - value)                                        eqs. 81-89

Equation numbers: Ayhan 1996. Residuals are metres times s (for
``parallel`` and ``perpendicular`` radians times s): with s = 1/sigma they are whitened. ``factors.conditions.surfaces``
contains spheres and spheroids. The first vector of a figure's frame is the normal of its plane, or the
direction of its line. The frame is chosen close to the figure, so that the unknowns of the figure remain
small. The kernels are plain Python, because there are few constraints.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, register_condition
from factors.geometry.rotations import Vector
from factors.records import Record

#: Constants of the conditions: a figure (its normal n_0 and the axes e_1, e_2 are orthonormal), a distance,
#: a condition with a factor only, two parallel figures, and an observed element of a figure.
FIGURE: Final = Record(factor=1, place=3, normal=3, e_1=3, e_2=3)
LENGTH: Final = Record(factor=1, distance=1)
FACTOR: Final = Record(factor=1)
DIRECTION: Final = Record(factor=1, e_1=3, e_2=3)
ELEMENT: Final = Record(factor=1, value=1, number=1)


def _dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Any:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def residual_distance(record: Any, setup: Any, p: Any, q: Any) -> Any:
    """Return the residual (1,)."""
    d = q - p
    return np.array([record[LENGTH.factor] * (np.sqrt(_dot(d, d)) - record[LENGTH.distance])])


def jacobians_distance(record: Array, setup: Array, value: Array, p: Array, q: Array) -> tuple[Array, Array]:
    """Return the Jacobians (1, 3)."""
    d = q - p
    row = (record[LENGTH.factor] / np.sqrt(_dot(d, d)) * d).reshape((1, 3))
    return -row, row


def residual_parallel(record: Any, setup: Any, p: Any, q: Any, r: Any, t: Any) -> Any:
    """Return the residual (2,); e_1 and e_2 are perpendicular to the lines."""
    a, b = q - p, t - r
    c, size = _cross(a, b), np.sqrt(_dot(a, a) * _dot(b, b))
    s = record[DIRECTION.factor]
    return np.array([s * _dot(record[DIRECTION.e_1], c) / size, s * _dot(record[DIRECTION.e_2], c) / size])


def jacobians_parallel(
    record: Array, setup: Array, value: Array, p: Array, q: Array, r: Array, t: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the Jacobians (2, 3)."""
    a, b = q - p, t - r
    aa, bb = _dot(a, a), _dot(b, b)
    f = record[DIRECTION.factor] / np.sqrt(aa * bb)
    by_a, by_b = np.empty((2, 3)), np.empty((2, 3))
    for i, e in enumerate((record[DIRECTION.e_1], record[DIRECTION.e_2])):
        by_a[i] = f * _cross(b, e) - value[i] / aa * a
        by_b[i] = f * _cross(e, a) - value[i] / bb * b
    return -by_a, by_a, -by_b, by_b


def residual_perpendicular(record: Any, setup: Any, p: Any, q: Any, r: Any, t: Any) -> Any:
    """Return the residual (1,); the record is the factor."""
    a, b = q - p, t - r
    return np.array([record[FACTOR.factor] * _dot(a, b) / np.sqrt(_dot(a, a) * _dot(b, b))])


def jacobians_perpendicular(
    record: Array, setup: Array, value: Array, p: Array, q: Array, r: Array, t: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the Jacobians (1, 3)."""
    a, b = q - p, t - r
    aa, bb = _dot(a, a), _dot(b, b)
    f = record[FACTOR.factor] / np.sqrt(aa * bb)
    by_a, by_b = (f * b - value[0] / aa * a).reshape((1, 3)), (f * a - value[0] / bb * b).reshape((1, 3))
    return -by_a, by_a, -by_b, by_b


def residual_equal(record: Any, setup: Any, p: Any, q: Any, r: Any, t: Any) -> Any:
    """Return the residual (1,); the record is the factor."""
    a, b = q - p, t - r
    return np.array([record[FACTOR.factor] * (np.sqrt(_dot(a, a)) - np.sqrt(_dot(b, b)))])


def jacobians_equal(
    record: Array, setup: Array, value: Array, p: Array, q: Array, r: Array, t: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the Jacobians (1, 3)."""
    by_a, by_b = (record[FACTOR.factor] / np.sqrt(_dot(d, d)) * d.reshape((1, 3)) for d in (q - p, t - r))
    return -by_a, by_a, by_b, -by_b


def _normal(record: Any, x: Any) -> Any:
    return record[FIGURE.normal] + x[0] * record[FIGURE.e_1] + x[1] * record[FIGURE.e_2]


def residual_plane(record: Any, setup: Any, x: Any, p: Any) -> Any:
    """Return the residual (1,) for tilts and distance x (3,)."""
    n = _normal(record, x)
    return np.array([record[FIGURE.factor] * (_dot(n, p - record[FIGURE.place]) - x[2]) / np.sqrt(_dot(n, n))])


def jacobians_plane(record: Array, setup: Array, value: Array, x: Array, p: Array) -> tuple[Array, Array]:
    """Return the Jacobians (1, 3)."""
    n, d = _normal(record, x), p - record[FIGURE.place]
    nn = _dot(n, n)
    f = record[FIGURE.factor] / np.sqrt(nn)
    out = np.empty((1, 3))
    for i, e in enumerate((record[FIGURE.e_1], record[FIGURE.e_2])):
        out[0, i] = f * _dot(e, d) - value[0] * x[i] / nn
    out[0, 2] = -f
    return out, (f * n).reshape((1, 3))


def residual_line(record: Any, setup: Any, x: Any, p: Any) -> Any:
    """Return the residual (2,) for foot point and slopes x (4,)."""
    d = p - record[FIGURE.place]
    along = _dot(record[FIGURE.normal], d)
    return np.array([
        record[FIGURE.factor] * (_dot(record[FIGURE.e_1], d) - x[0] - x[2] * along),
        record[FIGURE.factor] * (_dot(record[FIGURE.e_2], d) - x[1] - x[3] * along),
    ])  # fmt: skip


def jacobians_line(record: Array, setup: Array, value: Array, x: Array, p: Array) -> tuple[Array, Array]:
    """Return the Jacobians (2, 4) and (2, 3)."""
    s, out, ground = record[FIGURE.factor], np.zeros((2, 4)), np.empty((2, 3))
    along = _dot(record[FIGURE.normal], p - record[FIGURE.place])
    for i, e in enumerate((record[FIGURE.e_1], record[FIGURE.e_2])):
        out[i, i], out[i, 2 + i] = -s, -s * along
        ground[i] = s * (e - x[2 + i] * record[FIGURE.normal])
    return out, ground


def residual_element(record: Any, setup: Any, x: Any) -> Any:
    """Return the residual (1,) of an observed element of x."""
    return np.array([record[ELEMENT.factor] * (x[int(record[ELEMENT.number])] - record[ELEMENT.value])])


def jacobians_element(record: Array, setup: Array, value: Array, x: Array) -> Array:
    """Return the Jacobian (1, k)."""
    out = np.zeros((1, len(x)))
    out[0, int(record[ELEMENT.number])] = record[ELEMENT.factor]
    return out


_POINT: Final = Argument("point", "m", is_point=True)
DISTANCE = register_condition(
    "constraint_distance", residual_distance, jacobians_distance, (_POINT, _POINT),
    "Ayhan 1996, eqs. 111, 118", n_constants=LENGTH.size,
)  # fmt: skip
PARALLEL = register_condition(
    "constraint_parallel", residual_parallel, jacobians_parallel, (_POINT,) * 4,
    "Ayhan 1996, section 2.4.2", n_constants=DIRECTION.size,
)  # fmt: skip
PERPENDICULAR = register_condition(
    "constraint_perpendicular", residual_perpendicular, jacobians_perpendicular, (_POINT,) * 4,
    "sine of the deviation", n_constants=FACTOR.size,
)  # fmt: skip
EQUAL = register_condition(
    "constraint_equal", residual_equal, jacobians_equal, (_POINT,) * 4,
    "difference of two distances", n_constants=FACTOR.size,
)  # fmt: skip
PLANE = register_condition(
    "constraint_plane", residual_plane, jacobians_plane, (Argument("plane", "1, m"), _POINT),
    "Ayhan 1996, eq. 116", n_constants=FIGURE.size,
)  # fmt: skip
LINE = register_condition(
    "constraint_line", residual_line, jacobians_line, (Argument("line", "m, 1"), _POINT),
    "Ayhan 1996, eq. 113", n_constants=FIGURE.size,
)  # fmt: skip
OBSERVED_ELEMENT = register_condition(
    "observed_element", residual_element, jacobians_element, (Argument("x", "any"),),
    "Ayhan 1996, eqs. 81-89", n_constants=ELEMENT.size,
)  # fmt: skip
