"""Collinearity extended by corrections from measured to ideal coordinates, for self-calibrating bundles.

    e = (c X/Z - x' - dx,  s c Y/Z - y' - dy) Z^p,    (X, Y, Z) = R (P - O),    x' = x - x0,  y' = y - y0

(Ayhan 1996, eqs. 76-77; misprinted derivatives are corrected.) dx, dy: ``factors.cameras.image_corrections``,
``factors.cameras.additional_parameters`` and ``factors.cameras.image_variants``. Camera axes X right, Y down, Z along
the view; s = -1 where image y points up. With p = 0 the unit of the residual is the image's, with p = 1 image units
times metres (F of the thesis with the other sign).

Unknowns: an image's own camera parameters, parameters shared with other images (photo-variant and block-invariant
calibration), the rotation vector w of R = exp([w]x) R_0 in rad, the projection centre O and the point P, m.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, compiled, register
from factors.cameras import additional_parameters as brown
from factors.cameras import image_corrections as lens
from factors.cameras import image_variants as variants
from factors.cameras.frame_camera import CAMERA as TURN
from factors.cameras.frame_camera import by_turn, rotate, rotate_back, turned
from factors.geometry.rotations import Vector
from factors.records import Record

#: Camera parameters by code: principal distance, principal point, coefficients of the three modules.
CAMERA: Final = Record(c=1, principal="x0 y0", lens=lens.AT.size, brown=brown.AT.size, variants=variants.AT.size)
NAMES: Final = ("c", "x0", "y0", *lens.NAMES, *brown.NAMES, *variants.NAMES)
#: Whitening w11 w12 w22, power p, sign s, fixed c of Brown's terms, camera, R_0, fixed radius of the orthogonal
#: polynomials.
RECORD: Final = Record(
    x=1, y=1, w11=1, w12=1, w22=1, power=1, sign=1, held_c=1, camera=CAMERA.size, rotation=9, radius=1,
)  # fmt: skip


@compiled
def camera(record: Any, setup: Any, own: Any, shared: Any) -> Any:
    """Camera parameters (40,): the record's plus steps times unknowns; the setup lists own parameters first."""
    out = record[RECORD.camera] + 0.0 * (own.sum() + shared.sum())
    n = own.shape[0]
    for j in range(setup.shape[1]):
        out[int(setup[0, j])] += setup[1, j] * (own[j] if j < n else shared[j - n])
    return out


@compiled
def _seen(record: Any, w: Any, centre: Any, point: Any) -> Any:
    """Turn with R and J, and point in camera axes (3,)."""
    turn = np.empty(TURN.size, w.dtype)
    turned(w, record[RECORD.rotation], turn)
    return turn, np.array(rotate(turn, point - centre))


@compiled
def _difference(record: Any, c: Any, q: Vector) -> Any:
    """Computed minus ideal coordinates."""
    x, y = record[RECORD.x] - c[CAMERA.x0], record[RECORD.y] - c[CAMERA.y0]
    u, v = lens.ideal(c[CAMERA.lens], x, y)
    u, v = c[CAMERA.c] * q[0] / q[2] - u, record[RECORD.sign] * c[CAMERA.c] * q[1] / q[2] - v
    terms, a = brown.terms(x, y, record[RECORD.held_c]), c[CAMERA.brown]
    for j in range(len(a)):
        u, v = u - a[j] * terms[0, j], v - a[j] * terms[1, j]
    a = c[CAMERA.variants]
    if np.any(a != 0.0):
        terms = variants.terms(x, y, record[RECORD.radius])
        for j in range(len(a)):
            u, v = u - a[j] * terms[0, j], v - a[j] * terms[1, j]
    return u, v


@compiled
def residual(record: Any, setup: Any, own: Any, shared: Any, w: Any, centre: Any, point: Any) -> Any:
    """Whitened residual (2,); accepts complex unknowns."""
    c = camera(record, setup, own, shared)
    _, q = _seen(record, w, centre, point)
    a, b = _difference(record, c, q)
    if record[RECORD.power] != 0.0:
        a, b = a * q[2], b * q[2]
    return np.array([record[RECORD.w11] * a + record[RECORD.w12] * b, record[RECORD.w22] * b])


@compiled
def _by_camera(record: Array, setup: Array, c: Array, q: Array, scale: float) -> Array:
    """Derivatives (2, k) with respect to the camera unknowns, not whitened."""
    x, y = record[RECORD.x] - c[CAMERA.x0], record[RECORD.y] - c[CAMERA.y0]
    xx, xy, yx, yy = lens.slopes(c[CAMERA.lens], x, y)
    ax, ay, bx, by = brown.slopes(c[CAMERA.brown], x, y, record[RECORD.held_c])
    ux, uy, vx, vy = variants.slopes(c[CAMERA.variants], x, y, record[RECORD.radius])
    ax, ay, bx, by = ax + ux, ay + uy, bx + vx, by + vy
    # columns (2, 40): derivatives of the ideal minus the computed coordinates
    every = np.empty((2, CAMERA.size))
    every[0, CAMERA.c], every[1, CAMERA.c] = -q[0] / q[2], -record[RECORD.sign] * q[1] / q[2]
    every[0, CAMERA.x0], every[1, CAMERA.x0] = -(xx + ax), -(yx + bx)
    every[0, CAMERA.y0], every[1, CAMERA.y0] = -(xy + ay), -(yy + by)
    every[:, CAMERA.lens] = lens.terms(x, y)
    every[:, CAMERA.brown] = brown.terms(x, y, record[RECORD.held_c])
    every[:, CAMERA.variants] = variants.terms(x, y, record[RECORD.radius])
    out = np.empty((2, setup.shape[1]))
    for j in range(setup.shape[1]):
        code = int(setup[0, j])
        out[0, j], out[1, j] = -scale * setup[1, j] * every[0, code], -scale * setup[1, j] * every[1, code]
    return out


@compiled
def _by_place(record: Array, c: Array, q: Array, turn: Array, scale: float) -> tuple[Array, Array]:
    """Derivatives (2, 3) with respect to the rotation vector and to the point, not whitened."""
    f, z, power, sign = c[CAMERA.c] * scale / q[2], q[2], record[RECORD.power], record[RECORD.sign]
    a, b = _difference(record, c, q)
    by_q = np.array([[f, 0.0, power * a - f * q[0] / z], [0.0, sign * f, power * b - sign * f * q[1] / z]])
    spin, point = np.empty((2, 3)), np.empty((2, 3))
    for i in range(2):
        g = by_q[i]
        spin[i, 0], spin[i, 1], spin[i, 2] = by_turn(turn, q, g)
        point[i, 0], point[i, 1], point[i, 2] = rotate_back(turn, g)
    return spin, point


@compiled
def kernel(
    record: Array, setup: Array, own: Array, shared: Array, w: Array, centre: Array, point: Array, want: bool
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Residual (2,); Jacobians of own (2, k1) and shared (2, k2) parameters, rotation, centre and point (2, 3)."""
    value = residual(record, setup, own, shared, w, centre, point)
    if not want:
        e = np.empty((0, 0))
        return value, e, e, e, e, e
    c = camera(record, setup, own, shared)
    turn, q = _seen(record, w, centre, point)
    scale = 1.0 if record[RECORD.power] == 0.0 else q[2]
    by_camera = whitened_rows(record, _by_camera(record, setup, c, q, scale))
    spin, by_point = _by_place(record, c, q, turn, scale)
    by_point = whitened_rows(record, by_point)
    n = own.shape[0]
    return (value, by_camera[:, :n].copy(), by_camera[:, n:].copy(), whitened_rows(record, spin), -by_point, by_point)


@compiled
def whitened_rows(record: Array, rows: Array) -> Array:
    """W times rows (2, k), in place."""
    for j in range(rows.shape[1]):
        rows[0, j] = record[RECORD.w11] * rows[0, j] + record[RECORD.w12] * rows[1, j]
        rows[1, j] *= record[RECORD.w22]
    return rows


EXTENDED_COLLINEARITY = register(Equation(
    "extended_collinearity_measured_to_ideal", kernel, residual,
    (Argument("own camera", "steps"), Argument("shared camera", "steps"), Argument("rotation", "rad"),
     Argument("centre", "m", is_point=True), Argument("point", "m", is_point=True)),
    "Brown 1971, 1976; Ayhan 1996, eqs. 2, 44-55, 71-80",
))  # fmt: skip
