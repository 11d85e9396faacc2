"""Collinearity of a frame image with all supported corrections: the observation equation.

The equation of ``factors.cameras.frame`` is used with the corrections, projections and directions of
``frame_corrections``::

    1 camera       R = exp([w]x) R_0,  C = C_0 + dC,  interior orientation = metadata + correction
    2 collinearity (x, y, 1) ~ R (G - C);  Z is the depth
    3 difference   from ideal to measured coordinates: d = p_0 + f E(D(x, y)) - observed pixel
                   from measured to ideal coordinates: d = f (x, y) - unit D(E(observed pixel - p_0)/unit)
    4 whitening    r = W d Z^p,  W = (w_line  w_12; 0  w_sample)

The unit of d is the pixel for p = 0, and pixels times metres for p = 1 (Ayhan 1996, eq. 76, condition F with the other
sign). If D converts measured to ideal coordinates, its coefficients refer to the image's ``unit``. If D
converts ideal to measured coordinates, they refer to the unit of X/Z.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, compiled, is_finite, kernel_of, register
from factors.cameras import additional_parameters as additional
from factors.cameras import frame
from factors.cameras import image_variants as variants
from factors.cameras.frame_camera import by_turn, direction, rotate_back
from factors.cameras.frame_corrections import CAMERA, CONSTANTS, FURTHER, affine, distorted, lens, projected, slopes
from factors.geometry.rotations import Vector
from factors.records import Record

#: Record: fields of ``frame``, then coefficients and constants of ``frame_corrections``; a_line and a_sample are the
#: diagonal of W.
RECORD: Final = Record(**frame.RECORD.fields, **FURTHER.fields, **CONSTANTS.fields, w12=1, power=1)
#: Setup: codes and prior sigmas of the unknowns. First the unknowns of ``frame``, then the unknowns of
#: a receiver on board, on which no pixel depends (``factors.conditions.navigation``), then the further
#: coefficients.
UNKNOWN: Final = Record(**frame.UNKNOWN.fields, navigation=18, **FURTHER.fields)
N_UNKNOWNS: Final = UNKNOWN.size
COLUMN: Final = Record(**UNKNOWN.fields, ground="g1 g2 g3")
_FIRST: Final = UNKNOWN.shear
_N_FURTHER: Final = FURTHER.size
_N_CONSTANTS: Final = CONSTANTS.size


@compiled
def camera(record: Any, setup: Any, x: Any) -> Any:
    """Map 1: return the camera, as ``frame_corrections.CAMERA``, for unknowns (k,) in prior sigmas."""
    start, out = frame.camera(record, setup, x), np.empty(CAMERA.size, x.dtype)
    for k in range(len(start)):
        out[k] = start[k]
    for k in range(_N_FURTHER + _N_CONSTANTS):
        out[CAMERA.shear + k] = record[RECORD.shear + k]
    for j in range(setup.shape[1]):
        if setup[0, j] >= _FIRST:
            out[CAMERA.shear + int(setup[0, j]) - _FIRST] += setup[1, j] * x[j]
    return out


@compiled
def difference(c: Any, line: Any, sample: Any, x: Any, y: Any) -> Any:
    """Map 3: return adjusted minus observed line and sample (px) for a direction x, y."""
    x, y = projected(c, x, y)
    if c[CAMERA.unit] == 0.0:
        x, y = distorted(c, x, y)
        x, y = affine(c, x, y)
        return c[CAMERA.line] + c[CAMERA.focal] * y - line, c[CAMERA.sample] + c[CAMERA.focal] * x - sample
    u, v = affine(c, (sample - c[CAMERA.sample]) / c[CAMERA.unit], (line - c[CAMERA.line]) / c[CAMERA.unit])
    u, v = distorted(c, u, v)
    return c[CAMERA.focal] * y - c[CAMERA.unit] * v, c[CAMERA.focal] * x - c[CAMERA.unit] * u


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Return the whitened residual (2,); accepts complex unknowns."""
    c = camera(record, setup, x)
    u, v, inverse = direction(c, ground[0], ground[1], ground[2])
    line, sample = difference(c, record[RECORD.line], record[RECORD.sample], u, v)
    if record[RECORD.power] != 0.0:
        line, sample = line / inverse, sample / inverse
    return np.array(
        [record[RECORD.a_line] * line + record[RECORD.w12] * sample, record[RECORD.a_sample] * sample]
    )  # fmt: skip


@compiled
def derivatives(record: Array, c: Array, ray: Vector, value: Any, has_terms: bool, out: Array) -> None:
    """Write the unwhitened derivatives of line and sample into ``out`` (2, 76), columns ``COLUMN``.

    ``value`` contains line and sample. Columns of additional parameters and variants are written only if ``has_terms``
    is True.
    """
    x, y, _ = ray
    factor, bend, ratio, square = lens(c, x, y)
    f, unit, along, shear = c[CAMERA.focal], c[CAMERA.unit], 1.0 + c[CAMERA.aspect], c[CAMERA.shear]
    u, v = p, q = factor * x, c[CAMERA.sign] * factor * y
    sx, sy = 0.0, 0.0
    if unit != 0.0:
        sx, sy = (record[RECORD.sample] - c[CAMERA.sample]) / unit, (record[RECORD.line] - c[CAMERA.line]) / unit
        u, v = affine(c, sx, sy)
    xx, xy, yx, yy = slopes(c, u, v)
    du, dv = distorted(c, u, v)
    for i in range(2):  # line, sample
        by_du, by_dv = (f * along * i, f * (shear if i else 1.0)) if unit == 0.0 else (-unit * i, -unit * (1 - i))
        by_u, by_v = by_du * xx + by_dv * yx, by_du * xy + by_dv * yy
        if unit == 0.0:
            by_p, by_q = by_u, by_v
            out[i, UNKNOWN.focal] = (by_du * du + by_dv * dv) / f
            out[i, UNKNOWN.line], out[i, UNKNOWN.sample] = 1.0 - i, i
            out[i, UNKNOWN.aspect], out[i, UNKNOWN.shear] = f * du * i, f * dv * i
        else:
            by_p, by_q = f * i, f * (1 - i)
            out[i, UNKNOWN.focal] = p if i else q
            out[i, UNKNOWN.line], out[i, UNKNOWN.sample] = -(by_u * shear + by_v) / unit, -by_u * along / unit
            out[i, UNKNOWN.aspect], out[i, UNKNOWN.shear] = by_u * sx, by_u * sy
        _by_place(c, ray, (factor, bend), by_p, by_q, record[RECORD.power] * value[i], out, i)
        power = (by_p * x + by_q * c[CAMERA.sign] * y) * ratio
        for k in range(4):
            power *= square
            out[i, UNKNOWN.fisheye_1 + k] = power
        _by_corrections(u, v, by_du, by_dv, out, i)
        if has_terms:
            terms = additional.terms(u, v, c[CAMERA.nominal])
            out[i, UNKNOWN.additional] = by_du * terms[0] + by_dv * terms[1]
            terms = variants.terms(u, v, c[CAMERA.radius])
            out[i, UNKNOWN.variants] = by_du * terms[0] + by_dv * terms[1]


@compiled
def _by_corrections(u: float, v: float, by_du: float, by_dv: float, out: Array, i: int) -> None:
    """Write the derivatives of row i by the coefficients of Brown and of the affinity, from the derivatives by D."""
    r, uv, radial = u * u + v * v, 2.0 * u * v, by_du * u + by_dv * v
    for k in range(UNKNOWN.k1, UNKNOWN.k3 + 1):
        radial *= r
        out[i, k] = radial
    out[i, UNKNOWN.p1] = by_du * uv + by_dv * (r + 2.0 * v * v)
    out[i, UNKNOWN.p2] = by_du * (r + 2.0 * u * u) + by_dv * uv
    out[i, UNKNOWN.affinity_a], out[i, UNKNOWN.affinity_b] = by_du * v, by_dv * v


@compiled
def _by_place(c: Array, ray: Vector, view: Any, by_p: float, by_q: float, depth: float, out: Array, i: int) -> None:
    """Write the derivatives of row i by rotation, centre and ground, from derivatives by projection and log Z."""
    x, y, inverse = ray
    factor, bend = view
    by_y = c[CAMERA.sign] * by_q
    radial = 2.0 * bend * (by_p * x + by_y * y)
    by_x, by_y = factor * by_p + radial * x, factor * by_y + radial * y
    by_z = depth - (by_x * x + by_y * y)  # with q = R (G - C) = Z (x, y, 1), derivatives by q are (by_x, by_y, by_z)/Z
    w1, w2, w3 = by_turn(c, (x, y, 1.0), (by_x, by_y, by_z))
    g1, g2, g3 = rotate_back(c, (by_x * inverse, by_y * inverse, by_z * inverse))
    out[i, COLUMN.w1], out[i, COLUMN.w2], out[i, COLUMN.w3] = w1, w2, w3
    out[i, COLUMN.x], out[i, COLUMN.y], out[i, COLUMN.z] = -g1, -g2, -g3
    out[i, COLUMN.g1], out[i, COLUMN.g2], out[i, COLUMN.g3] = g1, g2, g3


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row; see :class:`factors._contract.Equation`."""
    k, record = setup.shape[1], records[row]
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    c = camera(record, setup, x)
    ray = direction(c, ground[0], ground[1], ground[2])
    line, sample = difference(c, record[RECORD.line], record[RECORD.sample], ray[0], ray[1])
    scale = 1.0 if record[RECORD.power] == 0.0 else 1.0 / ray[2]
    a_line, w12, a_sample = scale * record[RECORD.a_line], scale * record[RECORD.w12], scale * record[RECORD.a_sample]
    u, v = (line, sample) if record[RECORD.power] == 0.0 else (line / ray[2], sample / ray[2])
    out[0, 0], out[1, 0] = record[RECORD.a_line] * u + record[RECORD.w12] * v, record[RECORD.a_sample] * v
    if want:
        has_terms, d = False, np.zeros((2, COLUMN.size))
        for j in range(k):
            has_terms |= setup[0, j] >= UNKNOWN.a1
        derivatives(record, c, ray, (line, sample), has_terms, d)
        for j in range(k + 3):
            column, step = COLUMN.g1 + j - k, 1.0
            if j < k:
                column, step = int(setup[0, j]), setup[1, j]
            out[0, 1 + j] = step * (a_line * d[0, column] + w12 * d[1, column])
            out[1, 1 + j] = step * a_sample * d[1, column]
    return is_finite(out, k + 4 if want else 1)


FRAME_EXTENDED = register(Equation(
    "frame_extended", kernel_of(fill), residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)),
    "Brown 1971, 1976; Ayhan 1996, eqs. 2, 44-55, 71-80; Kannala, Brandt 2006; OpenCV fisheye; Metashape B1, B2", fill,
))  # fmt: skip
