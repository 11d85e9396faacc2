"""Projection and location of many points with a rational function model, in pixels and degrees.

``offsets`` and ``scales`` (5,), ``RANGE``: line, sample (pixels), longitude, latitude (degrees), height (m).
``compensation`` (6,), ``COMPENSATION``, pixels: shift of line and sample, drift of both with l, drift of both with s
(Grodecki & Dial 2003, with the model's own l and s in [-1, 1])::

    line   = line_off   + line_scale l   + c0 + c2 l + c4 s
    sample = sample_off + sample_scale s + c1 + c3 l + c5 s
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, compiled
from factors.cameras.rfm import cubic, ground_derivatives, value
from factors.records import Record

RANGE: Final = Record(image="line sample", ground="lon lat height")
COMPENSATION: Final = Record(line=1, sample=1, line_l=1, sample_l=1, line_s=1, sample_s=1)
#: Number of points in one block: its four polynomials remain in the cache, and each loop is vectorised.
BLOCK: Final = 256
#: Newton's method ends if the misclosure is below STEP_PX, or below LOCATE_PX if rounding prevents smaller misclosures.
STEP_PX: Final = 1e-11
LOCATE_PX: Final = 1e-7
MAX_STEPS: Final = 40


@compiled
def compensated(b: Any, l: Any, s: Any) -> Any:  # noqa: E741
    """Return the compensation of line and sample at a normalised pixel."""
    return (
        b[COMPENSATION.line] + b[COMPENSATION.line_l] * l + b[COMPENSATION.line_s] * s,
        b[COMPENSATION.sample] + b[COMPENSATION.sample_l] * l + b[COMPENSATION.sample_s] * s,
    )


@compiled
def project(
    c: Array, offsets: Array, scales: Array, compensation: Array, lon_deg: Array, lat_deg: Array, height_m: Array
) -> tuple[Array, Array]:
    """Return line and sample (pixels) of N points: three (N,) arrays -> two; nan at a pole.

    Longitudes may differ from the offset by a full turn.
    """
    n = len(lon_deg)
    line, sample, f = np.empty(n), np.empty(n), np.empty((4, BLOCK))
    for first in range(0, n, BLOCK):
        m = min(BLOCK, n - first)
        for k in range(4):
            _block(c, k, offsets, scales, lon_deg[first:], lat_deg[first:], height_m[first:], f[k, :m])
        for i in range(m):
            l, s = f[0, i] / f[1, i], f[2, i] / f[3, i]  # noqa: E741
            b_line, b_sample = compensated(compensation, l, s)
            line[first + i] = offsets[RANGE.line] + (scales[RANGE.line] * l + b_line)
            sample[first + i] = offsets[RANGE.sample] + (scales[RANGE.sample] * s + b_sample)
        for i in range(first, first + m):
            if not np.isfinite(line[i] + sample[i]):
                line[i], sample[i] = np.nan, np.nan
    return line, sample


@compiled
def _block(c: Any, k: int, offsets: Any, scales: Any, lon: Any, lat: Any, h: Any, out: Any) -> None:
    """Compute polynomial ``k`` at the first points, without a branch in the loop."""
    x0, y0, z0 = offsets[RANGE.lon], offsets[RANGE.lat], offsets[RANGE.height]
    x1, y1, z1 = scales[RANGE.lon], scales[RANGE.lat], scales[RANGE.height]
    for i in range(len(out)):
        d = lon[i] - x0
        d -= 360.0 * np.floor(d / 360.0 + 0.5)
        out[i] = cubic(c, k, d / x1, (lat[i] - y0) / y1, (h[i] - z0) / z1)


@compiled
def locate(c: Array, scales: Array, image: Array, z: Array, start: Array) -> Array:
    """Return normalised longitude and latitude of N normalised pixels at normalised heights, by Newton steps.

    A step is halved as long as it would enlarge the misclosure.

    Parameters
    ----------
    c : (4, 20) array
    scales : (5,) array
        Scales of the model; the scales of line and sample convert misclosures to pixels.
    image : (N, 2) array
        Normalised line and sample, without compensation.
    z : (N,) array
    start : (N, 2) array
        Start values of normalised longitude and latitude.

    Returns
    -------
    (N, 2) array
        nan if the misclosure does not fall below 1e-7 pixels.
    """
    out = np.empty((len(image), 2))
    for i in range(len(image)):
        out[i, 0], out[i, 1] = _locate_one(c, scales, image[i, 0], image[i, 1], z[i], start[i, 0], start[i, 1])
    return out


@compiled
def _misclosure(c: Any, scales: Any, l: float, s: float, x: float, y: float, z: float) -> Any:  # noqa: E741
    """Return the normalised misclosures, and the larger of them in pixels."""
    a, b = value(c, x, y, z)
    return l - a, s - b, max(abs((l - a) * scales[RANGE.line]), abs((s - b) * scales[RANGE.sample]))


@compiled
def _locate_one(c: Any, scales: Any, l: float, s: float, z: float, x: float, y: float) -> tuple[float, float]:  # noqa: E741
    r_l, r_s, size = _misclosure(c, scales, l, s, x, y, z)
    for _ in range(MAX_STEPS):
        if not size > STEP_PX:
            break
        (a, b, _), (e, f, _) = ground_derivatives(c, x, y, z, l - r_l, s - r_s)
        det = a * f - b * e
        d_x, d_y = (f * r_l - b * r_s) / det, (a * r_s - e * r_l) / det
        part = 1.0
        n_l, n_s, n_size = _misclosure(c, scales, l, s, x + d_x, y + d_y, z)
        while not n_size < size and part > 1e-3:
            part *= 0.5
            n_l, n_s, n_size = _misclosure(c, scales, l, s, x + part * d_x, y + part * d_y, z)
        if not n_size < size:
            break
        x, y, r_l, r_s, size = x + part * d_x, y + part * d_y, n_l, n_s, n_size
    if size <= LOCATE_PX:
        return x, y
    return np.nan, np.nan
