"""Collinearity of a frame image with Brown's distortion from measured to ideal coordinates: the observation equation.

    r = A (pixel of the ground point without distortion - corrected observed pixel)

The polynomial of ``factors.cameras.frame_camera`` corrects what was measured, as in photogrammetric calibrations (Brown
1971; Ayhan 1996; DBAT: Börlin, Grussenmeyer 2016, "backward" models), where OpenCV, COLMAP and BAL distort what is
computed
(``factors.cameras.frame``). The two are each other's inverse; no finite polynomial is both. Its argument is

    x = (sample - sample_0) (1 + aspect) / unit,    y = (line - line_0) / unit

with a fixed unit (px), so that coefficients do not change with the focal length: of 1 mm for calibrations in mm.
A is given for the corrected image: a sigma of 1 px is one there.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, kernel_of, register
from factors.cameras import frame, frame_camera
from factors.cameras.frame import COLUMN, UNKNOWN, sight_row, spread
from factors.cameras.frame_camera import brown_derivatives, brown_ideal_to_measured, direction
from factors.geometry.rotations import Vector
from factors.records import Record

#: That of ``factors.cameras.frame`` with aspect and unit (px).
RECORD: Final = Record(**frame.RECORD.fields, aspect=1, unit=1)
#: That of ``factors.cameras.frame_camera`` with aspect and unit (px).
CAMERA: Final = Record(**frame_camera.CAMERA.fields, aspect=1, unit=1)


@compiled
def camera(record: Any, setup: Any, x: Any) -> Any:
    """Camera (31,) of unknowns (k,) in prior sigmas."""
    out = np.empty(CAMERA.size, x.dtype)
    out[: frame_camera.CAMERA.size] = frame.camera(record, setup, x)
    out[CAMERA.aspect], out[CAMERA.unit] = record[RECORD.aspect], record[RECORD.unit]
    for j in range(setup.shape[1]):
        if int(setup[0, j]) == UNKNOWN.aspect:
            out[CAMERA.aspect] += setup[1, j] * x[j]
    return out


@compiled
def measured(c: Any, line: float, sample: float) -> Any:
    """Arguments x, y of the polynomial, from a pixel."""
    x, y = sample - c[CAMERA.sample], line - c[CAMERA.line]
    return x * (1.0 + c[CAMERA.aspect]) / c[CAMERA.unit], y / c[CAMERA.unit]


@compiled
def difference(c: Any, line: float, sample: float, u: Any, v: Any) -> Any:
    """Pixel of the ideal direction (u, v) minus the corrected one: line, sample (px)."""
    x, y = measured(c, line, sample)
    cx, cy = brown_ideal_to_measured(c, x, y)
    return c[CAMERA.focal] * v - c[CAMERA.unit] * cy, c[CAMERA.focal] * u - c[CAMERA.unit] * cx


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Whitened residual (2,); accepts complex unknowns."""
    c = camera(record, setup, x)
    u, v, _ = direction(c, ground[0], ground[1], ground[2])
    line, sample = difference(c, record[RECORD.line], record[RECORD.sample], u, v)
    return np.array([record[RECORD.a_line] * line, record[RECORD.a_sample] * sample])


@compiled
def derivatives(c: Any, ray: Vector, line: float, sample: float, a_line: float, a_sample: float, out: Array) -> float:
    """Write the whitened derivatives of the residual into ``out`` (2, 19), as ``factors.cameras.frame.derivatives``."""
    x, y = measured(c, line, sample)
    a, b, d = brown_derivatives(c, x, y)
    zero = sight_row(c, ray[1], ray, 0.0, 1.0, a_line, out, 0) + sight_row(c, ray[0], ray, 1.0, 0.0, a_sample, out, 1)
    r, xy, stretch = x * x + y * y, 2.0 * x * y, 1.0 + c[CAMERA.aspect]
    out[0, UNKNOWN.focal], out[1, UNKNOWN.focal] = a_line * ray[1], a_sample * ray[0]
    out[0, UNKNOWN.sample], out[1, UNKNOWN.sample] = a_line * b * stretch, a_sample * a * stretch
    out[0, UNKNOWN.line], out[1, UNKNOWN.line] = a_line * d, a_sample * b
    s_line, s_sample = -a_line * c[CAMERA.unit], -a_sample * c[CAMERA.unit]
    for k in range(3):
        power = r ** (k + 1)
        out[0, UNKNOWN.k1 + k], out[1, UNKNOWN.k1 + k] = s_line * y * power, s_sample * x * power
    out[0, UNKNOWN.p1], out[0, UNKNOWN.p2] = s_line * (r + 2.0 * y * y), s_line * xy
    out[1, UNKNOWN.p1], out[1, UNKNOWN.p2] = s_sample * xy, s_sample * (r + 2.0 * x * x)
    wide = (sample - c[CAMERA.sample]) / c[CAMERA.unit]
    out[0, UNKNOWN.aspect], out[1, UNKNOWN.aspect] = s_line * b * wide, s_sample * a * wide
    return float(zero + 0.0 * (a + b + d + r * r * r))


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row into ``out``; see :func:`factors.cameras.frame.fill`."""
    k, record, d = setup.shape[1], records[row], np.zeros((2, COLUMN.size))
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    c = camera(record, setup, x)
    ray = direction(c, ground[0], ground[1], ground[2])
    o_line, o_sample, a_line = record[RECORD.line], record[RECORD.sample], record[RECORD.a_line]
    a_sample = record[RECORD.a_sample]
    line, sample = difference(c, o_line, o_sample, ray[0], ray[1])
    out[0, 0], out[1, 0] = a_line * line, a_sample * sample
    zero = 0.0 * (out[0, 0] + out[1, 0])
    if want:
        zero += derivatives(c, ray, o_line, o_sample, a_line, a_sample, d)
        spread(d, setup, out)
    return bool(zero == 0.0)


@compiled
def corrected(c: Array, line: Array, sample: Array) -> Array:
    """Ideal directions X/Z, Y/Z of N pixels: (N, 2)."""
    out = np.empty((len(line), 2))
    for i in range(len(line)):
        x, y = measured(c, line[i], sample[i])
        x, y = brown_ideal_to_measured(c, x, y)
        out[i, 0], out[i, 1] = x * c[CAMERA.unit] / c[CAMERA.focal], y * c[CAMERA.unit] / c[CAMERA.focal]
    return out


@compiled
def pixels(c: Array, x: Array, y: Array) -> Array:
    """Line and sample (N, 2) px of coordinates x, y of the polynomial."""
    out = np.empty((len(x), 2))
    for i in range(len(x)):
        out[i, 0] = c[CAMERA.line] + c[CAMERA.unit] * y[i]
        out[i, 1] = c[CAMERA.sample] + c[CAMERA.unit] * x[i] / (1.0 + c[CAMERA.aspect])
    return out


def example(rng: np.random.Generator) -> Example:
    """Build an observation of a wide-angle camera with an aspect, in a unit that is not its focal length."""
    e = frame.example(rng)
    own = rng.normal(scale=1e-3), e.record[RECORD.focal] * rng.uniform(0.5, 2.0)
    record = np.concatenate([e.record, own])
    codes = np.append(e.setup[0], float(UNKNOWN.aspect))
    setup = np.ascontiguousarray(np.stack([codes, np.append(e.setup[1], 1e-3)]))
    return Example(record, setup, (np.append(e.unknowns[0], rng.normal()), e.unknowns[1]))


FRAME_BROWN_MEASURED_TO_IDEAL = register(Equation(
    "frame_brown_measured_to_ideal", kernel_of(fill), residual,
    (Argument("image", "prior sigma"), Argument("ground", "m", is_point=True)), example,
    "Brown 1971; Ayhan 1996; Börlin, Grussenmeyer 2016 (DBAT, backward models)", fill,
))  # fmt: skip
