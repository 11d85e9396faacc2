"""Points on surfaces of the second degree: sphere, ellipsoid with selected unknowns, and general quadric.

    sphere     r = s (|p - c|^2 - a^2)                                       Ayhan 1996, eqs. 135 and 138
    ellipsoid  r = s (q1^2/a^2 + q2^2/b^2 + q3^2/c^2 - 1),  q = R (p - c)    Ayhan 1996, eq. 142 (R = I, a = c)
    quadric    r = s (A x^2 + B y^2 + C z^2 + 2 D xy + 2 E xz + 2 F yz + 2 G x + 2 H y + 2 I z + J)   eq. 125

A spheroid is an ellipsoid with one unknown for two semi-axes. The rotation is ``exp([w]x) R_0``, as in
``factors.cameras.frame``. Each condition connects unknowns with an observed point, and has Jacobians by both.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, compiled, register_condition
from factors.cameras.frame_camera import CAMERA, by_turn, rotate, rotate_back, turned
from factors.records import Record

#: Record of the ellipsoid, with its rotation row-major; the records of sphere and quadric contain only the factor s.
RECORD: Final = Record(factor=1, centre=3, rotation=9, semi_axes=3)
#: Codes of the unknowns in the setup of the ellipsoid (codes; steps). ``others`` are the two semi-axes that are not the
#: first, second or third. Unknowns are corrections to the record.
UNKNOWN: Final = Record(centre=3, rotation=3, semi_axes=3, others=3)


@compiled
def shape(record: Any, setup: Any, x: Any) -> Any:
    """Return the centre (3,), the turn with R and J (``factors.cameras.frame_camera``), and the semi-axes (3,)."""
    d, turn = np.zeros(UNKNOWN.size, x.dtype), np.empty(CAMERA.size, x.dtype)
    for j in range(setup.shape[1]):
        d[int(setup[0, j])] += setup[1, j] * x[j]
    turned(d[UNKNOWN.rotation], record[RECORD.rotation], turn)
    centre, semi = record[RECORD.centre] + d[UNKNOWN.centre], record[RECORD.semi_axes] + d[UNKNOWN.semi_axes]
    others = d[UNKNOWN.others]
    for i in range(3):
        for k in range(3):
            if k != i:
                semi[i] += others[k]
    return centre, turn, semi


@compiled
def _local(centre: Any, turn: Any, point: Any) -> Any:
    """Return q = R (p - c) (3,)."""
    return np.array(rotate(turn, point - centre))


@compiled
def residual_ellipsoid(record: Any, setup: Any, x: Any, point: Any) -> Any:
    """Return the residual (1,); accepts complex unknowns."""
    centre, turn, semi = shape(record, setup, x)
    # unknowns or point may be complex: same type for all
    q = _local(centre + 0.0 * point, turn + 0.0 * point[0], point + 0.0 * centre)
    size = (q[0] / semi[0]) ** 2 + (q[1] / semi[1]) ** 2 + (q[2] / semi[2]) ** 2
    return np.array([record[RECORD.factor] * (size - 1.0)])


@compiled
def jacobians_ellipsoid(record: Array, setup: Array, value: Array, x: Array, point: Array) -> tuple[Array, Array]:
    """Return the Jacobians with respect to the unknowns (1, k) and the point (1, 3)."""
    centre, turn, semi = shape(record, setup, x)
    q = _local(centre, turn, point)
    d, g = np.zeros(UNKNOWN.size), 2.0 * record[RECORD.factor] * q / semi**2
    ground, by_semi = np.array(rotate_back(turn, g)).reshape((1, 3)), -g * q / semi
    d[UNKNOWN.centre] = -ground[0]
    d[UNKNOWN.rotation] = np.array(by_turn(turn, q, g))
    d[UNKNOWN.semi_axes], d[UNKNOWN.others] = by_semi, (by_semi[0] + by_semi[1] + by_semi[2]) - by_semi
    out = np.empty((1, setup.shape[1]))
    for j in range(setup.shape[1]):
        out[0, j] = setup[1, j] * d[int(setup[0, j])]
    return out, ground


def residual_sphere(record: Any, setup: Any, x: Any, point: Any) -> Any:
    """Return the residual (1,) for the unknowns centre and radius (4,)."""
    d = point - x[:3]
    return np.array([record[RECORD.factor] * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - x[3] * x[3])])


def jacobians_sphere(record: Array, setup: Array, value: Array, x: Array, point: Array) -> tuple[Array, Array]:
    """Return the Jacobians (1, 4) and (1, 3)."""
    d = 2.0 * record[RECORD.factor] * (point - x[:3])
    return np.array([[*-d, -2.0 * record[RECORD.factor] * x[3]]]), d.reshape((1, 3))


def residual_quadric(record: Any, setup: Any, c: Any, p: Any) -> Any:
    """Return the residual (1,) for the ten coefficients; only their ratios are determined."""
    square = c[0] * p[0] * p[0] + c[1] * p[1] * p[1] + c[2] * p[2] * p[2]
    mixed = c[3] * p[0] * p[1] + c[4] * p[0] * p[2] + c[5] * p[1] * p[2]
    linear = c[6] * p[0] + c[7] * p[1] + c[8] * p[2]
    return np.array([record[RECORD.factor] * (square + 2.0 * (mixed + linear) + c[9])])


def jacobians_quadric(record: Array, setup: Array, value: Array, c: Array, p: Array) -> tuple[Array, Array]:
    """Return the Jacobians (1, 10) and (1, 3)."""
    s, (x, y, z) = record[RECORD.factor], p
    terms = np.array([[x * x, y * y, z * z, 2.0 * x * y, 2.0 * x * z, 2.0 * y * z, 2.0 * x, 2.0 * y, 2.0 * z, 1.0]])
    slope = np.array([[
        c[0] * x + c[3] * y + c[4] * z + c[6], c[3] * x + c[1] * y + c[5] * z + c[7],
        c[4] * x + c[5] * y + c[2] * z + c[8],
    ]])  # fmt: skip
    return s * terms, 2.0 * s * slope


_POINT: Final = Argument("point", "m", is_point=True)
SPHERE = register_condition(
    "surface_sphere",
    residual_sphere,
    jacobians_sphere,
    (Argument("centre and radius", "m"), _POINT),
    "Ayhan 1996, eqs. 135-141",
    n_constants=1,
)
ELLIPSOID = register_condition(
    "surface_ellipsoid",
    residual_ellipsoid,
    jacobians_ellipsoid,
    (Argument("corrections", "steps"), _POINT),
    "Ayhan 1996, eqs. 142-154; free axes: the same in rotated coordinates",
    n_constants=RECORD.size,
)
QUADRIC = register_condition(
    "surface_quadric",
    residual_quadric,
    jacobians_quadric,
    (Argument("coefficients", "1"), _POINT),
    "Ayhan 1996, eq. 125",
    n_constants=1,
)
