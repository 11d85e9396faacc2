"""Rational function with image-space compensation: the observation equation of an RPC image.

For an image point measured at (line, sample) of ground point G (Grodecki & Dial 2003, eqs. 4-5; docs/rfm.md)::

    1 geodetic    longitude, latitude, height of G, normalised by offsets and scales: (x, y, z)
    2 quotients   l = f1(x, y, z)/f2(x, y, z),  s = f3/f4                     (``factors.cameras.rfm``)
    3 pixel       line = offset + scale l + compensation(l, s), sample alike  (``factors.cameras.rfm_project``)
    4 whitening   r = A (line - observed line, sample - observed sample)

Unknown 1 is the compensation of the image in prior sigmas, unknown 2 the ground point (m, ECEF axes, local origin). Map
1 is computed as reference plus difference (``factors.cameras.rfm_ground``): residuals are reproducible to 1e-11 pixels.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, compiled, is_finite, kernel_of, register
from factors.cameras import rfm, rfm_ground
from factors.cameras.rfm_ground import FRAME
from factors.cameras.rfm_project import COMPENSATION as COMPENSATION
from factors.cameras.rfm_project import compensated
from factors.records import Record

#: Observed pixel; A row-major, 1/px; offsets and scales of line and sample, px. Then data of
#: the reference point: normalised longitude, latitude, height, their scales rad and m,
#: position relative to the local origin m, ``FRAME``. Then the coefficients (4, 20).
RECORD: Final = Record(
    line=1, sample=1, whitening="a11 a12 a21 a22", line_offset=1, sample_offset=1, line_scale=1, sample_scale=1,
    normalised="lon lat height", scales="lon_scale lat_scale height_scale", reference="x y z", frame=FRAME.size,
    coefficients=80,
)  # fmt: skip
#: Setup: codes of the unknowns, which number the elements of :data:`factors.cameras.rfm_project.COMPENSATION`, and
#: prior sigmas (px).
COMPENSATIONS: Final = {"shift": (0, 1), "drift": (0, 1, 2, 3), "affine": (0, 1, 2, 3, 4, 5)}


@compiled
def compensation(setup: Any, x: Any) -> Any:
    """Return the compensation (6,), in pixels, for unknowns in prior sigmas."""
    out = np.zeros(COMPENSATION.size, x.dtype)
    for j in range(setup.shape[1]):
        out[int(setup[0, j])] += setup[1, j] * x[j]
    return out


@compiled
def _whitened(record: Any, line: Any, sample: Any) -> Any:
    """Return the product A (line, sample): a pair."""
    whitened_line = record[RECORD.a11] * line + record[RECORD.a12] * sample
    return whitened_line, record[RECORD.a21] * line + record[RECORD.a22] * sample


@compiled
def rational_function(record: Any, b: Any, ground: Any) -> Any:
    """Return the whitened residual (a pair) with a compensation (6,), and the map values for :func:`derivatives`."""
    dx, dy, dz = ground[0] - record[RECORD.x], ground[1] - record[RECORD.y], ground[2] - record[RECORD.z]
    d = rfm_ground.differences(record[RECORD.frame], dx, dy, dz)
    x = record[RECORD.lon] + d[0] / record[RECORD.lon_scale]
    y = record[RECORD.lat] + d[1] / record[RECORD.lat_scale]
    z = record[RECORD.height] + d[2] / record[RECORD.height_scale]
    l, s = rfm.value(record[RECORD.coefficients].reshape(4, 20), x, y, z)  # noqa: E741
    b_line, b_sample = compensated(b, l, s)
    line = (record[RECORD.line_offset] - record[RECORD.line]) + (record[RECORD.line_scale] * l + b_line)
    sample = (record[RECORD.sample_offset] - record[RECORD.sample]) + (record[RECORD.sample_scale] * s + b_sample)
    return _whitened(record, line, sample), (d, (x, y, z), (l, s))


@compiled
def derivatives(record: Array, setup: Array, b: Array, maps: Any, out: Array) -> None:
    """Write the derivatives by compensation and ground point into columns 1 to k + 3 of ``out`` (2, 1 + k + 3)."""
    (d, (x, y, z), (l, s)), k = maps, setup.shape[1]  # noqa: E741
    for j in range(k):
        code = int(setup[0, j])
        g = setup[1, j] * (1.0 if code < 2 else (l if code < 4 else s))
        is_line = code % 2 == 0
        out[0, 1 + j] = record[RECORD.a11 if is_line else RECORD.a12] * g
        out[1, 1 + j] = record[RECORD.a21 if is_line else RECORD.a22] * g
    d_geodetic = rfm_ground.derivatives(record[RECORD.frame], d[0], d[1], d[2])
    by_l, by_s = rfm.ground_derivatives(record[RECORD.coefficients].reshape(4, 20), x, y, z, l, s)
    scales = record[RECORD.scales]
    for c in range(3):  # chain rule from map 1 to map 4, for one coordinate of the ground point
        d_l, d_s = 0.0, 0.0
        for a in range(3):
            g = d_geodetic[a][c] / scales[a]
            d_l += by_l[a] * g
            d_s += by_s[a] * g
        line = (record[RECORD.line_scale] + b[COMPENSATION.line_l]) * d_l + b[COMPENSATION.line_s] * d_s
        sample = (record[RECORD.sample_scale] + b[COMPENSATION.sample_s]) * d_s + b[COMPENSATION.sample_l] * d_l
        out[0, 1 + k + c], out[1, 1 + k + c] = _whitened(record, line, sample)


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Return the whitened residual (2,); accepts complex unknowns."""
    return np.array(rational_function(record, compensation(setup, x), ground)[0])


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row; see :class:`factors._contract.Equation`."""
    k, record = setup.shape[1], records[row]
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    b = compensation(setup, x)
    (out[0, 0], out[1, 0]), maps = rational_function(record, b, ground)
    if want:
        derivatives(record, setup, b, maps, out)
    return is_finite(out, k + 4 if want else 1)


RATIONAL_FUNCTION = register(Equation(
    "rational_function", kernel_of(fill), residual,
    (Argument("compensation", "prior sigma"), Argument("ground", "m", is_point=True)),
    "Grodecki & Dial 2003, eqs. 4-5; Terlemezoğlu 2019, eqs. 2.55-2.57", fill,
))  # fmt: skip
