"""Rational function with image-space compensation: the observation equation of an RPC image.

    r = A (pixel of the ground point + compensation - observed pixel)       (Grodecki & Dial 2003, eqs. 4-5)

Unknown 1 is the compensation of the image in prior sigmas, unknown 2 the ground point (m, ECEF axes,
local origin). The way from ECEF to longitude, latitude, height is part of the equation. Both are
formed as reference plus difference (``factors.rfm_ground``): residuals repeat to 1e-11 pixels.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors import rfm, rfm_ground
from factors._contract import Argument, Array, Equation, Example, compiled, register

#: Record: observed line, sample 0:2 px; A 2:6 row-major, 1/px; offsets 6:8 and scales 8:10 of line and
#: sample, px; reference point: normalised longitude, latitude, height 10:13; scales of longitude, latitude
#: 13:15 rad and of height 15 m; reference point minus local origin 16:19 m; sin and cos of its longitude, sin
#: and cos of its latitude, its height 19:24; coefficients 24:104, (4, 20) row-major.
RECORD_SIZE: Final = 104
#: Setup: codes of the unknowns and their prior sigmas (px). Code k is element k of ``compensation`` of
#: ``factors.rfm_project``: 0 line shift, 1 sample shift, 2 and 3 drift of line and sample with the normalised line,
#: 4 and 5 with the normalised sample (px at the end of the range).
COMPENSATIONS: Final = {"shift": (0, 1), "drift": (0, 1, 2, 3), "affine": (0, 1, 2, 3, 4, 5)}
N_COMPENSATION: Final = 6


@compiled
def compensation(setup: Any, x: Any) -> Any:
    """Compensation (6,) in pixels of unknowns in prior sigmas."""
    out = np.zeros(N_COMPENSATION, x.dtype)
    for j in range(setup.shape[1]):
        out[int(setup[0, j])] += setup[1, j] * x[j]
    return out


@compiled
def _normalised(record: Any, ground: Any) -> Any:
    """Differences of longitude, latitude, height from the reference, and normalised coordinates."""
    d = rfm_ground.differences(
        record[19:24], ground[0] - record[16], ground[1] - record[17], ground[2] - record[18]
    )  # fmt: skip
    x, y, z = record[10] + d[0] / record[13], record[11] + d[1] / record[14], record[12] + d[2] / record[15]
    return d, x, y, z


@compiled
def _misclosure(record: Any, b: Any, l: Any, s: Any) -> Any:  # noqa: E741
    """Whitened residual of a normalised pixel and a compensation: a pair."""
    line = (record[6] - record[0]) + (record[8] * l + (b[0] + b[2] * l + b[4] * s))
    sample = (record[7] - record[1]) + (record[9] * s + (b[1] + b[3] * l + b[5] * s))
    return record[2] * line + record[3] * sample, record[4] * line + record[5] * sample


@compiled
def residual(record: Any, setup: Any, x: Any, ground: Any) -> Any:
    """Whitened residual (2,); accepts complex unknowns."""
    _, lon, lat, h = _normalised(record, ground)
    l, s = rfm.value(record[24:104].reshape(4, 20), lon, lat, h)  # noqa: E741
    r_line, r_sample = _misclosure(record, compensation(setup, x), l, s)
    return np.array([r_line, r_sample])


@compiled
def _derivatives(record: Array, setup: Array, b: Array, point: Any, image: Any, out: Array) -> None:
    """Write the Jacobians into columns 1.. of ``out`` (2, 1 + k + 3); ``point`` is that of :func:`_normalised`."""
    k, (l, s) = setup.shape[1], image  # noqa: E741
    d, lon, lat, h = point
    d_l, d_s = rfm.ground_derivatives(record[24:104].reshape(4, 20), lon, lat, h, l, s)
    to_geodetic = rfm_ground.derivatives(record[19:24], d[0], d[1], d[2])
    for j in range(k):
        code = int(setup[0, j])
        g = setup[1, j] * (1.0 if code < 2 else (l if code < 4 else s))
        out[0, 1 + j], out[1, 1 + j] = record[2 + code % 2] * g, record[4 + code % 2] * g
    for c in range(3):
        v_l, v_s = 0.0, 0.0
        for a in range(3):
            g = to_geodetic[a][c] / record[13 + a]
            v_l += d_l[a] * g
            v_s += d_s[a] * g
        line = (record[8] + b[2]) * v_l + b[4] * v_s
        sample = (record[9] + b[5]) * v_s + b[3] * v_l
        out[0, 1 + k + c] = record[2] * line + record[3] * sample
        out[1, 1 + k + c] = record[4] * line + record[5] * sample


@compiled
def fill(records: Array, row: int | np.int64, setup: Array, x: Array, ground: Array, out: Array, want: bool) -> bool:
    """Write residual, image and ground Jacobian of one row into ``out`` (2, 1 + k + 3).

    Returns False if the sizes do not fit or a value is not finite.
    """
    k, record = setup.shape[1], records[row]
    if x.shape[0] != k or out.shape[1] != k + 4 or ground.shape[0] != 3:
        return False
    b = compensation(setup, x)
    point = _normalised(record, ground)
    image = rfm.value(record[24:104].reshape(4, 20), point[1], point[2], point[3])
    out[0, 0], out[1, 0] = _misclosure(record, b, image[0], image[1])
    if want:
        _derivatives(record, setup, b, point, image, out)
    total = 0.0
    for j in range(k + 4 if want else 1):
        total += 0.0 * out[0, j] + 0.0 * out[1, j]
    return total == 0.0


@compiled
def kernel(record: Array, setup: Array, x: Array, ground: Array, want: bool) -> tuple[Array, Array, Array]:
    """Residual (2,), Jacobians with respect to the compensation (2, k) and the ground point (2, 3)."""
    k = setup.shape[1]
    out = np.full((2, k + 4), np.nan)  # stays nan if sizes do not fit: never uninitialised memory
    fill(record.reshape((1, -1)), np.int64(0), setup, x, ground, out, want)  # a literal 0 compiles fill once more
    if not want:
        return out[:, 0].copy(), np.empty((0, 0)), np.empty((0, 0))
    return out[:, 0].copy(), out[:, 1 : k + 1].copy(), out[:, k + 1 :].copy()


def example(rng: np.random.Generator) -> Example:
    """Build an observation of a metre-resolution image; shift, drift and affine occur."""
    c = rng.normal(scale=1e-3, size=(4, 20))
    c[1::2, 0] = 1.0
    c[0, 1:4] += 0.1 * rng.normal(), -1.0, 0.1 * rng.normal()
    c[2, 1:4] += 1.0, 0.1 * rng.normal(), 0.1 * rng.normal()
    lon, lat = rng.uniform(-np.pi, np.pi), rng.uniform(-1.4, 1.4)
    record = np.concatenate([
        rng.uniform(0.0, 2e4, 2), (np.eye(2) + 0.2 * rng.normal(size=(2, 2))).ravel() / 0.5, [1e4, 1.2e4, 1e4, 1.2e4],
        rng.uniform(-1, 1, 3), [2e-3 / np.cos(lat), -1.6e-3, 500.0], rng.normal(scale=1e3, size=3),
        [np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat), rng.uniform(-100.0, 3e3)], c.ravel(),
    ])  # fmt: skip
    codes = list(COMPENSATIONS.values())[rng.integers(0, 3)]
    setup = np.ascontiguousarray(np.stack([np.array(codes, float), rng.uniform(0.5, 10.0, len(codes))]))
    return Example(record, setup, (rng.normal(size=len(codes)), record[16:19] + rng.normal(scale=300.0, size=3)))


RATIONAL_FUNCTION = register(Equation(
    "rational_function", kernel, residual,
    (Argument("compensation", "prior sigma"), Argument("ground", "m", is_point=True)), example,
    "Grodecki & Dial 2003, eqs. 4-5; Terlemezoğlu 2019, eqs. 2.55-2.57", fill,
))  # fmt: skip
