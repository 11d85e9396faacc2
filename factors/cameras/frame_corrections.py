"""Corrections of frame images: all supported terms, in both directions, with perspective or fisheye projection.

Maps::

    projection   (x, y) = (X/Z, s Y/Z), or of a fisheye lens theta_d/r (X/Z, s Y/Z) with r = tan theta and
                 theta_d = theta (1 + f1 theta^2 + f2 theta^4 + f3 theta^6 + f4 theta^8); s = -1: lines count upwards
    corrections  D(x, y) = Brown(x, y) + (A y, B y) + sum a_j T_j(x, y)
    affinity     E(x, y) = ((1 + aspect) x + shear y, y)

    from ideal to measured coordinates   (sample, line) = p_0 + f E(D(x, y))
    from measured to ideal coordinates   f (x, y) = unit D(E((sample, line) - p_0)/unit)

(Kannala, Brandt 2006, as in OpenCV's fisheye model; ``frame_camera``, ``additional_parameters``, ``image_variants``;
Ayhan 1996.) E belongs to the measured coordinates in both directions: Metashape's B1 = f aspect and B2 = f shear.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, compiled
from factors._plain import few_in_python
from factors.cameras import additional_parameters as additional
from factors.cameras import frame_camera
from factors.cameras import image_variants as variants
from factors.cameras.frame_camera import brown, brown_slopes, direction
from factors.records import Record

#: Coefficients that follow the coefficients of ``frame_camera``.
FURTHER: Final = Record(
    shear="shear", fisheye="fisheye_1 fisheye_2 fisheye_3 fisheye_4", affinity="affinity_a affinity_b",
    additional=" ".join(additional.NAMES), variants=" ".join(variants.NAMES),
)  # fmt: skip
#: Names of these coefficients.
NAMES: Final = tuple(name for field in FURTHER.fields.values() for name in str(field).split())
#: Constants of a camera: 1 for a fisheye camera; the sign s; the nominal principal distance of the additional
#: parameters; and the radius of the orthogonal polynomials, in the unit of D.
CONSTANTS: Final = Record(is_fisheye=1, sign=1, nominal=1, radius=1)
CAMERA: Final = Record(**frame_camera.CAMERA.fields, **FURTHER.fields, **CONSTANTS.fields)
#: Largest number of Newton steps for an inverse; the last step must be below the tolerance.
STEPS: Final = 30
TOLERANCE: Final = 1e-13
#: arctan(r)/r and its derivative are computed by series if r^2 is below this.
_SMALL: Final = 0.01
_SERIES: Final = 9


@compiled
def lens(c: Any, x: Any, y: Any) -> Any:
    """Return theta_d/r of a fisheye lens, its derivative by r^2, theta/r and theta^2; for another lens 1, 0, 1, 0."""
    t = x * x + y * y
    if c[CAMERA.is_fisheye].real == 0.0:
        return 1.0 + 0.0 * t, 0.0 * t, 1.0 + 0.0 * t, 0.0 * t
    if t.real < _SMALL:
        h, slope, power = 0.0 * t, 0.0 * t, 1.0 + 0.0 * t  # arctan(r)/r = sum (-t)^k/(2 k + 1)
        for k in range(_SERIES):
            h += power / (2 * k + 1)
            slope -= (k + 1) * power / (2 * k + 3)
            power = -power * t
    else:
        r = np.sqrt(t)
        h = np.arctan(r) / r
        slope = (1.0 / (1.0 + t) - h) / (2.0 * t)
    a, by_a, power = 1.0 + 0.0 * t, 0.0 * t, 1.0 + 0.0 * t
    square = t * h * h
    for k in range(4):
        by_a += (k + 1) * c[CAMERA.fisheye_1 + k] * power
        power = power * square
        a += c[CAMERA.fisheye_1 + k] * power
    return h * a, slope * a + h * by_a * (h * h + 2.0 * t * h * slope), h, square


@compiled
def distorted(c: Any, x: Any, y: Any) -> Any:
    """Return D of coordinates x, y: two numbers."""
    u, v = brown(c, x, y)
    u, v = u + c[CAMERA.affinity_a] * y, v + c[CAMERA.affinity_b] * y
    a = c[CAMERA.additional]
    if np.any(a != 0.0):
        terms = additional.terms(x, y, c[CAMERA.nominal].real)
        for j in range(len(a)):
            u, v = u + a[j] * terms[0, j], v + a[j] * terms[1, j]
    a = c[CAMERA.variants]
    if np.any(a != 0.0):
        terms = variants.terms(x, y, c[CAMERA.radius].real)
        for j in range(len(a)):
            u, v = u + a[j] * terms[0, j], v + a[j] * terms[1, j]
    return u, v


@compiled
def slopes(c: Array, x: float, y: float) -> tuple[float, float, float, float]:
    """Return the derivatives u_x, u_y, v_x, v_y of (u, v) = D(x, y)."""
    xx, xy, yy = brown_slopes(c, x, y)
    out = xx, xy + c[CAMERA.affinity_a], xy, yy + c[CAMERA.affinity_b]
    if np.any(c[CAMERA.additional] != 0.0):
        more = additional.slopes(c[CAMERA.additional], x, y, c[CAMERA.nominal])
        out = out[0] + more[0], out[1] + more[1], out[2] + more[2], out[3] + more[3]
    if np.any(c[CAMERA.variants] != 0.0):
        more = variants.slopes(c[CAMERA.variants], x, y, c[CAMERA.radius])
        out = out[0] + more[0], out[1] + more[1], out[2] + more[2], out[3] + more[3]
    return out


@compiled
def affine(c: Any, x: Any, y: Any) -> Any:
    """Return E of coordinates x, y: two numbers."""
    return (1.0 + c[CAMERA.aspect]) * x + c[CAMERA.shear] * y, y


@compiled
def projected(c: Any, x: Any, y: Any) -> Any:
    """Return the projection (two numbers) of a direction X/Z, Y/Z."""
    factor = lens(c, x, y)[0]
    return factor * x, c[CAMERA.sign] * factor * y


# --- images --------------------------------------------------------------------------------------


@compiled
def undistorted(c: Array, u: float, v: float) -> tuple[float, float]:
    """Return coordinates x, y with D(x, y) = (u, v), found by Newton steps; nan beyond the fold of D."""
    x, y = u, v
    for _ in range(STEPS):
        at, (xx, xy, yx, yy) = distorted(c, x, y), slopes(c, x, y)
        det, ex, ey = xx * yy - xy * yx, u - at[0], v - at[1]
        if not (det > 0.0 and xx > 0.0):
            break
        sx, sy = (yy * ex - xy * ey) / det, (xx * ey - yx * ex) / det
        x, y = x + sx, y + sy
        if abs(sx) + abs(sy) < TOLERANCE * (1.0 + abs(x) + abs(y)):
            return x, y
    return np.nan, np.nan


@compiled
def unprojected(c: Array, x: float, y: float) -> tuple[float, float]:
    """Return direction X/Z, Y/Z of a projection; nan beyond the fold, or 90 degrees or more off the axis."""
    y = c[CAMERA.sign] * y
    target = np.sqrt(x * x + y * y)
    if c[CAMERA.is_fisheye] == 0.0 or target == 0.0:
        return x, y
    theta = target
    for _ in range(STEPS):
        square, value, slope, power = theta * theta, 1.0, 1.0, 1.0
        for k in range(4):
            power *= square
            value += c[CAMERA.fisheye_1 + k] * power
            slope += (2 * k + 3) * c[CAMERA.fisheye_1 + k] * power
        if not slope > 0.0:
            break
        step = (target - theta * value) / slope
        theta += step
        if abs(step) < TOLERANCE:
            factor = np.tan(theta) / target if 0.0 <= theta < 0.5 * np.pi else np.nan
            return factor * x, factor * y
    return np.nan, np.nan


@few_in_python
@compiled
def pixels(c: Array, ground: Array) -> Array:
    """Return line, sample (px) and inverse depth (1/m) of ground points (N, 3): (N, 3); nan if there is no image."""
    out = np.empty((len(ground), 3))
    for i in range(len(ground)):
        x, y, inverse = direction(c, ground[i, 0], ground[i, 1], ground[i, 2])
        x, y = projected(c, x, y)
        if c[CAMERA.unit] == 0.0:
            x, y = distorted(c, x, y)
            x, y = affine(c, x, y)
            scale = c[CAMERA.focal]
        else:
            scale = c[CAMERA.unit]
            x, y = undistorted(c, x * c[CAMERA.focal] / scale, y * c[CAMERA.focal] / scale)
            x = (x - c[CAMERA.shear] * y) / (1.0 + c[CAMERA.aspect])
        out[i, 0], out[i, 1], out[i, 2] = c[CAMERA.line] + scale * y, c[CAMERA.sample] + scale * x, inverse
    return out


@few_in_python
@compiled
def directions(c: Array, line: Array, sample: Array) -> Array:
    """Return directions X/Z, Y/Z of N pixels: (N, 2); nan if the corrections cannot be inverted."""
    out = np.empty((len(line), 2))
    for i in range(len(line)):
        x, y = sample[i] - c[CAMERA.sample], line[i] - c[CAMERA.line]
        if c[CAMERA.unit] == 0.0:
            y = y / c[CAMERA.focal]
            x = (x / c[CAMERA.focal] - c[CAMERA.shear] * y) / (1.0 + c[CAMERA.aspect])
            x, y = undistorted(c, x, y)
        else:
            x, y = affine(c, x / c[CAMERA.unit], y / c[CAMERA.unit])
            x, y = distorted(c, x, y)
            scale = c[CAMERA.unit] / c[CAMERA.focal]
            x, y = scale * x, scale * y
        out[i, 0], out[i, 1] = unprojected(c, x, y)
    return out
