"""Rational function with image-space compensation: the observation equation of an RPC image.

    r = A (pixel of the ground point + compensation - observed pixel)       (Grodecki & Dial 2003, eqs. 4-5)

Unknown 1 is the compensation of the image in prior sigmas, unknown 2 the ground point (m, ECEF axes,
local origin). The way from ECEF to longitude, latitude, height is part of the equation. Both are
formed as reference plus difference (``factors.cameras.rfm_ground``): residuals repeat to 1e-11 pixels.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Argument, Array, Equation, Example, compiled, is_finite, kernel_of, register
from factors.cameras import rfm, rfm_ground
from factors.cameras.rfm_ground import FRAME
from factors.cameras.rfm_project import COMPENSATION as COMPENSATION
from factors.cameras.rfm_project import compensated
from factors.records import Record

#: Observed pixel; A row-major, 1/px; offsets and scales of line and sample, px; of the reference point: normalised
#: longitude, latitude, height, their scales rad and m, place minus local origin m, ``FRAME``; coefficients (4, 20).
RECORD: Final = Record(
    line=1, sample=1, whitening="a11 a12 a21 a22", line_offset=1, sample_offset=1, line_scale=1, sample_scale=1,
    normalised="lon lat height", scales="lon_scale lat_scale height_scale", reference="x y z", frame=FRAME.size,
    coefficients=80,
)  # fmt: skip
#: Setup: codes of the unknowns, which are elements of :data:`factors.cameras.rfm_project.COMPENSATION`, and prior
#: sigmas (px).
COMPENSATIONS: Final = {"shift": (0, 1), "drift": (0, 1, 2, 3), "affine": (0, 1, 2, 3, 4, 5)}


@compiled
def compensation(setup: Any, x: Any) -> Any:
    """Compensation (6,) in pixels of unknowns in prior sigmas."""
    out = np.zeros(COMPENSATION.size, x.dtype)
    for j in range(setup.shape[1]):
        out[int(setup[0, j])] += setup[1, j] * x[j]
    return out


@compiled
def _normalised(record: Any, ground: Any) -> Any:
    """Differences of longitude, latitude, height from the reference, and normalised coordinates."""
    d = rfm_ground.differences(
        record[RECORD.frame], ground[0] - record[RECORD.x], ground[1] - record[RECORD.y], ground[2] - record[RECORD.z]
    )  # fmt: skip
    lon = record[RECORD.lon] + d[0] / record[RECORD.lon_scale]
    lat = record[RECORD.lat] + d[1] / record[RECORD.lat_scale]
    return d, lon, lat, record[RECORD.height] + d[2] / record[RECORD.height_scale]


@compiled
def _coefficients(record: Any) -> Any:
    """Coefficients (4, 20)."""
    return record[RECORD.coefficients].reshape(4, 20)


@compiled
def _whitened(record: Any, line: Any, sample: Any) -> Any:
    """Product A (line, sample): a pair."""
    whitened_line = record[RECORD.a11] * line + record[RECORD.a12] * sample
    return whitened_line, record[RECORD.a21] * line + record[RECORD.a22] * sample


@compiled
def _misclosure(record: Any, b: Any, l: Any, s: Any) -> Any:  # noqa: E741
    """Whitened residual of a normalised pixel and a compensation: a pair."""
    b_line, b_sample = compensated(b, l, s)
    line = (record[RECORD.line_offset] - record[RECORD.line]) + (record[RECORD.line_scale] * l + b_line)
    sample = (record[RECORD.sample_offset] - record[RECORD.sample]) + (record[RECORD.sample_scale] * s + b_sample)
    return _whitened(record, line, sample)


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Whitened residual (2,); accepts complex unknowns."""
    _, lon, lat, h = _normalised(record, ground)
    l, s = rfm.value(_coefficients(record), lon, lat, h)  # noqa: E741
    r_line, r_sample = _misclosure(record, compensation(setup, x), l, s)
    return np.array([r_line, r_sample])


@compiled
def _derivatives(record: Array, setup: Array, b: Array, point: Any, image: Any, out: Array) -> None:
    """Write the Jacobians into columns 1.. of ``out`` (2, 1 + k + 3); ``point`` is that of :func:`_normalised`."""
    k, (l, s) = setup.shape[1], image  # noqa: E741
    d, lon, lat, h = point
    d_l, d_s = rfm.ground_derivatives(_coefficients(record), lon, lat, h, l, s)
    scales = record[RECORD.scales]
    to_geodetic = rfm_ground.derivatives(record[RECORD.frame], d[0], d[1], d[2])
    for j in range(k):
        code = int(setup[0, j])
        g = setup[1, j] * (1.0 if code < 2 else (l if code < 4 else s))
        is_line = code % 2 == 0
        out[0, 1 + j] = record[RECORD.a11 if is_line else RECORD.a12] * g
        out[1, 1 + j] = record[RECORD.a21 if is_line else RECORD.a22] * g
    for c in range(3):
        v_l, v_s = 0.0, 0.0
        for a in range(3):
            g = to_geodetic[a][c] / scales[a]
            v_l += d_l[a] * g
            v_s += d_s[a] * g
        line = (record[RECORD.line_scale] + b[COMPENSATION.line_l]) * v_l + b[COMPENSATION.line_s] * v_s
        sample = (record[RECORD.sample_scale] + b[COMPENSATION.sample_s]) * v_s + b[COMPENSATION.sample_l] * v_l
        out[0, 1 + k + c], out[1, 1 + k + c] = _whitened(record, line, sample)


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row; see :class:`factors._contract.Equation`."""
    k, record = setup.shape[1], records[row]
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    b = compensation(setup, x)
    point = _normalised(record, ground)
    image = rfm.value(_coefficients(record), point[1], point[2], point[3])
    out[0, 0], out[1, 0] = _misclosure(record, b, image[0], image[1])
    if want:
        _derivatives(record, setup, b, point, image, out)
    return is_finite(out, k + 4 if want else 1)


def example(rng: np.random.Generator) -> Example:
    """Build an observation of a metre-resolution image; shift, drift and affine occur."""
    c = rng.normal(scale=1e-3, size=(4, 20))
    c[1::2, 0] = 1.0
    c[0, 1:4] += 0.1 * rng.normal(), -1.0, 0.1 * rng.normal()
    c[2, 1:4] += 1.0, 0.1 * rng.normal(), 0.1 * rng.normal()
    lon, lat = rng.uniform(-np.pi, np.pi), rng.uniform(-1.4, 1.4)
    line, sample = rng.uniform(0.0, 2e4, 2)
    record = RECORD.pack(
        line=line, sample=sample, whitening=(np.eye(2) + 0.2 * rng.normal(size=(2, 2))).ravel() / 0.5, line_offset=1e4,
        sample_offset=1.2e4, line_scale=1e4, sample_scale=1.2e4, normalised=rng.uniform(-1, 1, 3),
        scales=[2e-3 / np.cos(lat), -1.6e-3, 500.0], reference=rng.normal(scale=1e3, size=3),
        frame=[np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat), rng.uniform(-100.0, 3e3)], coefficients=c.ravel(),
    )  # fmt: skip
    codes = list(COMPENSATIONS.values())[rng.integers(0, 3)]
    setup = np.ascontiguousarray(np.stack([np.array(codes, float), rng.uniform(0.5, 10.0, len(codes))]))
    x, away = rng.normal(size=len(codes)), rng.normal(scale=300.0, size=3)
    return Example(record, setup, (x, record[RECORD.reference] + away))


RATIONAL_FUNCTION = register(Equation(
    "rational_function", kernel_of(fill), residual,
    (Argument("compensation", "prior sigma"), Argument("ground", "m", is_point=True)), example,
    "Grodecki & Dial 2003, eqs. 4-5; Terlemezoğlu 2019, eqs. 2.55-2.57", fill,
))  # fmt: skip
