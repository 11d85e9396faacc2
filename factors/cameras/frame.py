"""Collinearity of a frame image with Brown's distortion: the observation equation.

For an image point measured at (line, sample) of ground point G (docs/equations.md 11; ``frame_camera`` has the maps)::

    1 camera       R = exp([w]x) R_0,  C = C_0 + dC,  interior orientation = metadata + correction
    2 collinearity (x, y, 1) ~ R (G - C)
    3 difference   from ideal to measured coordinates: d = p_0 + f Brown(x, y) - observed pixel
                   from measured to ideal coordinates: d = f (x, y) - unit Brown(u, v), u, v of the observed pixel
    4 whitening    r = A d

Derivatives are carried back from map 4 to map 1. Unknown 1 is the orientation of the image (any elements of
exterior and interior orientation) in prior sigmas; unknown 2 is the ground point (m, local origin). The
projection centre is the unknown, not the translation ``-R C``, because a receiver on board measures it and a
rotation does not move it. w is a rotation vector about the axes of the camera. It contains the whole rotation
since the start, not only the last step. Therefore a state has the same meaning throughout a run. With a
polynomial from measured to ideal coordinates, A applies to the corrected image: a sigma of 1 px means 1 px in
that image.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, compiled, kernel_of, register
from factors.cameras import frame_camera
from factors.cameras.frame_camera import CAMERA, brown, brown_slopes, by_turn, direction, rotate_back
from factors.geometry.rotations import Vector
from factors.records import Record

#: Observed pixel; A, 1/px, for line and sample; the camera without corrections, its centre relative to the local
#: origin, m. The unit is 0 if the polynomial converts ideal to measured coordinates.
RECORD: Final = Record(line=1, sample=1, a_line=1, a_sample=1, rotation=9, centre=3, focal=1, principal=2, distortion=5,
                       aspect=1, unit=1)  # fmt: skip
#: Setup: codes of the unknowns, which are their places here, and their prior sigmas: rotation about the camera's X, Y,
#: Z rad, projection centre m, interior orientation px. The aspect has an effect only if the polynomial converts
#: measured to ideal coordinates.
UNKNOWN: Final = Record(
    rotation="w1 w2 w3", centre="x y z", focal=1, principal="sample line", distortion="k1 k2 k3 p1 p2", aspect=1,
)  # fmt: skip
N_UNKNOWNS: Final = UNKNOWN.size
#: Columns of derivatives: the unknowns, the ground point, and a column of zeros. The column of zeros belongs
#: to image unknowns that do not change a pixel: codes from N_UNKNOWNS on (``factors.conditions.navigation``).
COLUMN: Final = Record(**UNKNOWN.fields, ground="g1 g2 g3", silent=1)
GROUND: Final = COLUMN.ground.start


@compiled
def camera(record: Any, setup: Any, x: Any) -> Any:
    """Map 1: return the camera, as ``CAMERA``, for unknowns (k,) in prior sigmas."""
    d, out = np.zeros(N_UNKNOWNS, x.dtype), np.empty(CAMERA.size, x.dtype)
    for j in range(setup.shape[1]):
        if setup[0, j] < N_UNKNOWNS:
            d[int(setup[0, j])] += setup[1, j] * x[j]
    frame_camera.turned(d[UNKNOWN.rotation], record[RECORD.rotation], out)
    for k in range(N_UNKNOWNS - UNKNOWN.centre.start):
        out[CAMERA.centre.start + k] = record[RECORD.centre.start + k] + d[UNKNOWN.centre.start + k]
    out[CAMERA.unit] = record[RECORD.unit]
    return out


@compiled
def difference(c: Any, line: Any, sample: Any, x: Any, y: Any) -> Any:
    """Map 3: return adjusted minus observed line and sample (px) for a direction x, y."""
    if c[CAMERA.unit] == 0.0:
        computed = frame_camera.pixel(c, x, y)
        return computed[0] - line, computed[1] - sample
    u, v = frame_camera.polynomial_arguments(c, line, sample)
    u, v = brown(c, u, v)
    return c[CAMERA.focal] * y - c[CAMERA.unit] * v, c[CAMERA.focal] * x - c[CAMERA.unit] * u


@compiled
def derivatives(c: Any, observed: Any, ray: Vector, out: Array) -> float:
    """Write the whitened derivatives into ``out`` (2, 19), columns ``COLUMN``; return 0 if they are finite.

    ``observed`` contains the first four numbers of the record, ``ray`` the result of
    :func:`factors.cameras.frame_camera.direction`.
    """
    o_line, o_sample, a_line, a_sample = observed
    x, y, _ = ray
    s_line, s_sample = a_line * c[CAMERA.focal], a_sample * c[CAMERA.focal]
    if c[CAMERA.unit] == 0.0:  # d = p_0 + f Brown(x, y) - observed pixel
        u, v = x, y
        xx, xy, yy = brown_slopes(c, u, v)
        by_focal = brown(c, u, v)
        total = _carry_back(c, ray, s_line * xy, s_line * yy, out, 0)
        total += _carry_back(c, ray, s_sample * xx, s_sample * xy, out, 1)
        out[0, UNKNOWN.sample], out[0, UNKNOWN.line], out[0, UNKNOWN.aspect] = 0.0, a_line, 0.0
        out[1, UNKNOWN.sample], out[1, UNKNOWN.line], out[1, UNKNOWN.aspect] = a_sample, 0.0, 0.0
    else:  # d = f (x, y) - unit Brown(u, v)
        u, v = frame_camera.polynomial_arguments(c, o_line, o_sample)
        xx, xy, yy = brown_slopes(c, u, v)
        by_focal = x, y
        total = _carry_back(c, ray, 0.0, s_line, out, 0) + _carry_back(c, ray, s_sample, 0.0, out, 1)
        stretch, wide = 1.0 + c[CAMERA.aspect], (o_sample - c[CAMERA.sample]) / c[CAMERA.unit]
        s_line, s_sample = -a_line * c[CAMERA.unit], -a_sample * c[CAMERA.unit]
        out[0, UNKNOWN.sample], out[0, UNKNOWN.line] = a_line * xy * stretch, a_line * yy
        out[1, UNKNOWN.sample], out[1, UNKNOWN.line] = a_sample * xx * stretch, a_sample * xy
        out[0, UNKNOWN.aspect], out[1, UNKNOWN.aspect] = s_line * xy * wide, s_sample * xx * wide
    out[0, UNKNOWN.focal], out[1, UNKNOWN.focal] = a_line * by_focal[1], a_sample * by_focal[0]
    r, uv, k_line, k_sample = u * u + v * v, 2.0 * u * v, s_line * v, s_sample * u
    for k in range(UNKNOWN.k1, UNKNOWN.k3 + 1):
        k_line, k_sample = k_line * r, k_sample * r
        out[0, k], out[1, k] = k_line, k_sample
    out[0, UNKNOWN.p1], out[0, UNKNOWN.p2] = s_line * (r + 2.0 * v * v), s_line * uv
    out[1, UNKNOWN.p1], out[1, UNKNOWN.p2] = s_sample * uv, s_sample * (r + 2.0 * u * u)
    return float(0.0 * (total + (xx + xy + yy) + (k_line + k_sample)))


@compiled
def _carry_back(c: Any, ray: Vector, by_x: float, by_y: float, out: Array, row: int) -> float:
    """Write a row's derivatives by rotation, centre and ground point (chain rule of map 2). Return their sum."""
    x, y, inverse = ray
    by_z = -(by_x * x + by_y * y)  # with q = R (G - C) = Z (x, y, 1), derivatives by q are (by_x, by_y, by_z)/Z
    w1, w2, w3 = by_turn(c, (x, y, 1.0), (by_x, by_y, by_z))
    g1, g2, g3 = rotate_back(c, (by_x * inverse, by_y * inverse, by_z * inverse))
    out[row, COLUMN.w1], out[row, COLUMN.w2], out[row, COLUMN.w3] = w1, w2, w3
    out[row, COLUMN.x], out[row, COLUMN.y], out[row, COLUMN.z] = -g1, -g2, -g3
    out[row, COLUMN.g1], out[row, COLUMN.g2], out[row, COLUMN.g3] = g1, g2, g3
    return float((w1 + w2) + (w3 + g1) + (g2 + g3))


@compiled
def evaluated(c: Any, observed: Any, ground: Vector, out: Array, want: bool) -> Any:
    """Evaluate maps 2 to 4 for a factor or a batch: return whitened line and sample, and 0 if all values are finite.

    Derivatives are written into ``out`` (2, 19) if ``want`` is True.
    """
    ray = direction(c, ground[0], ground[1], ground[2])
    line, sample = difference(c, observed[0], observed[1], ray[0], ray[1])
    line, sample = observed[2] * line, observed[3] * sample
    zero = 0.0 * (line + sample)
    if want:
        zero += derivatives(c, observed, ray, out)
    return line, sample, zero


@compiled
def columns_of(setup: Any) -> Any:
    """Return the column (k,) of each unknown among the derivatives."""
    out = setup[0].astype(np.int64)
    for j in range(len(out)):
        if out[j] >= N_UNKNOWNS:
            out[j] = COLUMN.silent
    return out


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Return the whitened residual (2,); accepts complex unknowns."""
    c = camera(record, setup, x)
    u, v, _ = direction(c, ground[0], ground[1], ground[2])
    line, sample = difference(c, record[RECORD.line], record[RECORD.sample], u, v)
    return np.array([record[RECORD.a_line] * line, record[RECORD.a_sample] * sample])


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row; see :class:`factors._contract.Equation`."""
    k, record, d = setup.shape[1], records[row], np.zeros((2, COLUMN.size))
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    observed = record[RECORD.line], record[RECORD.sample], record[RECORD.a_line], record[RECORD.a_sample]
    out[0, 0], out[1, 0], zero = evaluated(camera(record, setup, x), observed, ground, d, want)
    if want:
        column = columns_of(setup)
        for i in range(2):
            for j in range(k):
                out[i, 1 + j] = d[i, column[j]] * setup[1, j]
            for j in range(3):
                out[i, 1 + k + j] = d[i, GROUND + j]
    return bool(zero == 0.0)


FRAME_COLLINEARITY = register(Equation(
    "frame_collinearity", kernel_of(fill), residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)),
    "Brown 1966, 1971; OpenCV and COLMAP camera models; BAL (Agarwal et al. 2010); Ayhan 1996; DBAT", fill,
))  # fmt: skip
