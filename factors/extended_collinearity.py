"""Collinearity extended by corrections from measured to ideal coordinates, for self-calibrating bundles.

    e = (x' + dx - c X/Z,  y' + dy - s c Y/Z) Z^p,    (X, Y, Z) = R (P - O),    x' = x - x0,  y' = y - y0

(Ayhan 1996, eqs. 76-77, with the derivatives that print has wrong corrected.) dx, dy: ``factors.image_corrections``,
``factors.additional_parameters`` and ``factors.image_variants``. Camera axes X right, Y down, Z along the view; s = -1
where image y points up. With p = 0 the residual is one of the image, with p = 1 the thesis' F, in image units times
metres.

Unknowns: an image's own camera parameters, those it shares with others (photo-variant and block-invariant
calibration), the rotation vector w of R = exp([w]x) R_0 in rad, the projection centre O and the point P, m.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors import additional_parameters as brown
from factors import image_corrections as lens
from factors import image_variants as variants
from factors._contract import Argument, Array, Equation, Example, compiled, register
from factors.frame_camera import CAMERA_SIZE, turned

#: Camera parameters by code: principal distance, principal point, then those of the three modules.
NAMES: Final = ("c", "x0", "y0", *lens.NAMES, *brown.NAMES, *variants.NAMES)
SIZE: Final = 40
#: Record: x y 0:2, w11 w12 w22 of the whitening 2:5, p 5, s 6, held c of Brown's terms 7, camera 8:48, R_0 48:57,
#: held radius of the orthogonal polynomials 57.
RECORD_SIZE: Final = 58


@compiled
def camera(record: Any, setup: Any, own: Any, shared: Any) -> Any:
    """Camera parameters (40,): the record's plus steps times the unknowns; own ones stand first in the setup."""
    out = record[8:48] + 0.0 * (own.sum() + shared.sum())
    n = own.shape[0]
    for j in range(setup.shape[1]):
        out[int(setup[0, j])] += setup[1, j] * (own[j] if j < n else shared[j - n])
    return out


@compiled
def _seen(record: Any, w: Any, centre: Any, point: Any) -> Any:
    """Rotation and J (29,), point in camera axes (3,)."""
    turn, q = np.empty(CAMERA_SIZE, w.dtype), np.empty(3, w.dtype)
    turned(w, record[48:57], turn)
    d = point - centre
    for i in range(3):
        q[i] = turn[3 * i] * d[0] + turn[3 * i + 1] * d[1] + turn[3 * i + 2] * d[2]
    return turn, q


@compiled
def _difference(record: Any, c: Any, q: Any) -> Any:
    """Ideal minus computed coordinates."""
    x, y = record[0] - c[1], record[1] - c[2]
    u, v = lens.ideal(c[3:10], x, y)
    u, v = u - c[0] * q[0] / q[2], v - record[6] * c[0] * q[1] / q[2]
    terms = brown.terms(x, y, record[7])
    for j in range(21):
        u, v = u + c[10 + j] * terms[0, j], v + c[10 + j] * terms[1, j]
    if np.any(c[31:40] != 0.0):
        terms = variants.terms(x, y, record[57])
        for j in range(9):
            u, v = u + c[31 + j] * terms[0, j], v + c[31 + j] * terms[1, j]
    return u, v


@compiled
def residual(record: Any, setup: Any, own: Any, shared: Any, w: Any, centre: Any, point: Any) -> Any:
    """Whitened residual (2,); accepts complex unknowns."""
    c = camera(record, setup, own, shared)
    _, q = _seen(record, w, centre, point)
    a, b = _difference(record, c, q)
    if record[5] != 0.0:
        a, b = a * q[2], b * q[2]
    return np.array([record[2] * a + record[3] * b, record[4] * b])


@compiled
def _by_camera(record: Array, setup: Array, c: Array, q: Array, scale: float) -> Array:
    """Derivatives (2, k) with respect to the camera unknowns, not whitened."""
    x, y = record[0] - c[1], record[1] - c[2]
    xx, xy, yx, yy = lens.slopes(c[3:10], x, y)
    ax, ay, bx, by = brown.slopes(c[10:31], x, y, record[7])
    ux, uy, vx, vy = variants.slopes(c[31:40], x, y, record[57])
    ax, ay, bx, by = ax + ux, ay + uy, bx + vx, by + vy
    terms, others = brown.terms(x, y, record[7]), variants.terms(x, y, record[57])
    out = np.empty((2, setup.shape[1]))
    for j in range(setup.shape[1]):
        code = int(setup[0, j])
        if code == 0:
            u, v = -q[0] / q[2], -record[6] * q[1] / q[2]
        elif code == 1:
            u, v = -(xx + ax), -(yx + bx)
        elif code == 2:
            u, v = -(xy + ay), -(yy + by)
        elif code < 10:
            u, v = lens.by_coefficient(code - 3, x, y)
        elif code < 31:
            u, v = terms[0, code - 10], terms[1, code - 10]
        else:
            u, v = others[0, code - 31], others[1, code - 31]
        out[0, j], out[1, j] = scale * setup[1, j] * u, scale * setup[1, j] * v
    return out


@compiled
def _by_place(record: Array, c: Array, q: Array, turn: Array, scale: float) -> tuple[Array, Array]:
    """Derivatives (2, 3) with respect to the rotation vector and to the point, not whitened."""
    f, z = c[0] * scale / q[2], q[2]
    a, b = _difference(record, c, q)
    power = record[5]
    by_q = np.array([[-f, 0.0, f * q[0] / z + power * a], [0.0, -record[6] * f, record[6] * f * q[1] / z + power * b]])
    spin, point = np.empty((2, 3)), np.empty((2, 3))
    for i in range(2):
        g = by_q[i]
        # q moves by (J dw) x q, and g . (e x q) = e . (q x g)
        t = (q[1] * g[2] - q[2] * g[1], q[2] * g[0] - q[0] * g[2], q[0] * g[1] - q[1] * g[0])
        for k in range(3):
            spin[i, k] = turn[20 + k] * t[0] + turn[23 + k] * t[1] + turn[26 + k] * t[2]
            point[i, k] = turn[k] * g[0] + turn[3 + k] * g[1] + turn[6 + k] * g[2]
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
    scale = 1.0 if record[5] == 0.0 else q[2]
    by_camera = whitened_rows(record, _by_camera(record, setup, c, q, scale))
    spin, by_point = _by_place(record, c, q, turn, scale)
    by_point = whitened_rows(record, by_point)
    n = own.shape[0]
    return (value, by_camera[:, :n].copy(), by_camera[:, n:].copy(), whitened_rows(record, spin), -by_point, by_point)


@compiled
def whitened_rows(record: Array, rows: Array) -> Array:
    """W times rows (2, k), in place."""
    for j in range(rows.shape[1]):
        rows[0, j] = record[2] * rows[0, j] + record[3] * rows[1, j]
        rows[1, j] *= record[4]
    return rows


def _example(rng: np.random.Generator) -> Example:
    start, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    start *= np.sign(np.linalg.det(start))
    centre, seen = rng.normal(size=3), np.append(rng.normal(scale=0.4, size=2), 1.0) * rng.uniform(3.0, 9.0)
    codes = rng.permutation(SIZE)[: rng.integers(2, SIZE + 1)]
    n = int(rng.integers(1, len(codes)))
    given = np.concatenate([rng.normal(size=2), [1.3, 0.2, 0.7, float(rng.integers(0, 2)), rng.choice([-1.0, 1.0]),
                            2.0, 2.1], rng.normal(scale=0.02, size=SIZE - 1)])  # fmt: skip
    setup = np.ascontiguousarray(np.stack([codes.astype(float), rng.uniform(0.01, 0.1, len(codes))]))
    x = rng.normal(scale=0.3, size=len(codes))
    return Example(np.concatenate([given, start.ravel(), rng.uniform(0.8, 2.0, 1)]), setup,
                   (x[:n], x[n:], rng.normal(scale=0.02, size=3), centre, centre + start.T @ seen))  # fmt: skip


EXTENDED_COLLINEARITY = register(Equation(
    "extended_collinearity_measured_to_ideal", kernel, residual,
    (Argument("own camera", "steps"), Argument("shared camera", "steps"), Argument("rotation", "rad"),
     Argument("centre", "m", is_point=True), Argument("point", "m", is_point=True)), _example,
    "Brown 1971, 1976; Ayhan 1996, eqs. 2, 44-55, 71-80",
))  # fmt: skip
