"""Rational function model (RFM, RPC): value, derivatives, projection and location.

    l = f1/f2,  s = f3/f4         (Terlemezoğlu 2019, eqs. 2.55-2.57; NIMA 2000, STDI-0002 RPC00B)

with l, s the normalised line and sample and f cubic polynomials of the normalised longitude x,
latitude y and height z, 20 terms in RPC00B order (``factors.rfm_terms``). ``c`` (4, 20) holds line
numerator, line denominator, sample numerator, sample denominator; both denominators have the
constant 1. Where one changes its sign the model has a pole, unless the numerator has nearly the same
zeros, as in some vendors' files: then values are good on both sides, but not near. Nothing is hidden
here; ``fg_orient.sensors.rpc`` looks for sign changes inside the image.

``offsets`` and ``scales`` (5,): line, sample (pixels), longitude, latitude (degrees), height (m).
``compensation`` (6,), pixels: shift of line and sample, drift of both with l, drift of both with s
(Grodecki & Dial 2003, with the model's own l and s in [-1, 1])::

    line   = line_off   + line_scale l   + c0 + c2 l + c4 s
    sample = sample_off + sample_scale s + c1 + c3 l + c5 s
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors import rfm_terms
from factors._contract import Array, compiled

#: Newton ends below this, or where rounding stops it below LOCATE_PX.
STEP_PX: Final = 1e-11
LOCATE_PX: Final = 1e-7
MAX_STEPS: Final = 40


@compiled
def cubic(c: Any, k: int, x: Any, y: Any, z: Any) -> Any:
    """Polynomial ``k`` of ``c`` at one normalised ground point, nested."""
    return (
        c[k, 0]
        + x * (c[k, 1] + x * (c[k, 7] + x * c[k, 11] + y * c[k, 14] + z * c[k, 17])
               + y * (c[k, 4] + y * c[k, 12] + z * c[k, 10]) + z * (c[k, 5] + z * c[k, 13]))
        + y * (c[k, 2] + y * (c[k, 8] + y * c[k, 15] + z * c[k, 18]) + z * (c[k, 6] + z * c[k, 16]))
        + z * (c[k, 3] + z * (c[k, 9] + z * c[k, 19]))
    )  # fmt: skip


@compiled
def d_cubic(c: Any, k: int, x: Any, y: Any, z: Any) -> Any:
    """Derivatives of :func:`cubic` with respect to x, y, z."""
    d_x = (c[k, 1] + x * (2.0 * c[k, 7] + 3.0 * x * c[k, 11] + 2.0 * (y * c[k, 14] + z * c[k, 17]))
           + y * (c[k, 4] + y * c[k, 12] + z * c[k, 10]) + z * (c[k, 5] + z * c[k, 13]))  # fmt: skip
    d_y = (c[k, 2] + y * (2.0 * c[k, 8] + 3.0 * y * c[k, 15] + 2.0 * (z * c[k, 18] + x * c[k, 12]))
           + x * (c[k, 4] + x * c[k, 14] + z * c[k, 10]) + z * (c[k, 6] + z * c[k, 16]))  # fmt: skip
    d_z = (c[k, 3] + z * (2.0 * c[k, 9] + 3.0 * z * c[k, 19] + 2.0 * (x * c[k, 13] + y * c[k, 16]))
           + x * (c[k, 5] + x * c[k, 17] + y * c[k, 10]) + y * (c[k, 6] + y * c[k, 18]))  # fmt: skip
    return d_x, d_y, d_z


@compiled
def value(c: Any, x: Any, y: Any, z: Any) -> Any:
    """Normalised line and sample of one point; not finite where a denominator is zero."""
    return cubic(c, 0, x, y, z) / cubic(c, 1, x, y, z), cubic(c, 2, x, y, z) / cubic(c, 3, x, y, z)


@compiled
def ground_derivatives(c: Any, x: float, y: float, z: float, l: float, s: float) -> Any:  # noqa: E741
    """Derivatives of (l, s) with respect to x, y, z: two triples; ``l``, ``s`` are the values there."""
    d_l, d_s = cubic(c, 1, x, y, z), cubic(c, 3, x, y, z)
    a, b = d_cubic(c, 0, x, y, z), d_cubic(c, 1, x, y, z)
    e, f = d_cubic(c, 2, x, y, z), d_cubic(c, 3, x, y, z)
    return (
        ((a[0] - l * b[0]) / d_l, (a[1] - l * b[1]) / d_l, (a[2] - l * b[2]) / d_l),
        ((e[0] - s * f[0]) / d_s, (e[1] - s * f[1]) / d_s, (e[2] - s * f[2]) / d_s),
    )


@compiled
def values(c: Array, ground: Array) -> Array:
    """Normalised line and sample of N normalised ground points: (4, 20), (N, 3) -> (N, 2)."""
    out = np.empty((len(ground), 2))
    for i in range(len(ground)):
        out[i, 0], out[i, 1] = value(c, ground[i, 0], ground[i, 1], ground[i, 2])
    return out


@compiled
def ground_jacobian(c: Array, ground: Array) -> Array:
    """Derivatives of normalised (line, sample) with respect to (x, y, z): (N, 3) -> (N, 2, 3)."""
    out = np.empty((len(ground), 2, 3))
    for i in range(len(ground)):
        x, y, z = ground[i, 0], ground[i, 1], ground[i, 2]
        l, s = value(c, x, y, z)  # noqa: E741
        d_l, d_s = ground_derivatives(c, x, y, z, l, s)
        for k in range(3):
            out[i, 0, k], out[i, 1, k] = d_l[k], d_s[k]
    return out


@compiled
def denominators(c: Array, ground: Array) -> Array:
    """Both denominators at N normalised ground points: (N, 3) -> (N, 2)."""
    out = np.empty((len(ground), 2))
    for i in range(len(ground)):
        out[i, 0] = cubic(c, 1, ground[i, 0], ground[i, 1], ground[i, 2])
        out[i, 1] = cubic(c, 3, ground[i, 0], ground[i, 1], ground[i, 2])
    return out


def coefficient_jacobian(c: Array, ground: Array) -> Array:
    """Derivatives of normalised (line, sample) with respect to their coefficients: (N, 3) -> (N, 2, 40).

    Columns 0-19 belong to the numerator, 20-39 to the denominator of the row's own coordinate (column 20
    is that of the constant, which the model holds at 1).
    """
    monomials, image, below = rfm_terms.terms(ground), values(c, ground), denominators(c, ground)
    numerator = monomials[:, None, :] / below[:, :, None]
    return np.concatenate([numerator, -image[:, :, None] * numerator], axis=2)


@compiled
def project(
    c: Array, offsets: Array, scales: Array, compensation: Array, lon_deg: Array, lat_deg: Array, height_m: Array
) -> tuple[Array, Array]:
    """Line and sample (pixels) of N points: three (N,) arrays -> two; nan at a pole.

    Longitudes may differ from the offset by a full turn.
    """
    n = len(lon_deg)
    line, sample = np.empty(n), np.empty(n)
    for i in range(n):
        d = lon_deg[i] - offsets[2]
        if d > 180.0:
            d -= 360.0
        elif d < -180.0:
            d += 360.0
        l, s = value(c, d / scales[2], (lat_deg[i] - offsets[3]) / scales[3], (height_m[i] - offsets[4]) / scales[4])  # noqa: E741
        if not (np.isfinite(l) and np.isfinite(s)):
            l, s = np.nan, np.nan  # noqa: E741
        line[i] = offsets[0] + (scales[0] * l + (compensation[0] + compensation[2] * l + compensation[4] * s))
        sample[i] = offsets[1] + (scales[1] * s + (compensation[1] + compensation[3] * l + compensation[5] * s))
    return line, sample


@compiled
def locate(c: Array, scales: Array, image: Array, z: Array, start: Array) -> Array:
    """Normalised longitude and latitude of N normalised pixels at normalised heights, by Newton.

    A step is halved while it would enlarge the misclosure.

    Parameters
    ----------
    c : (4, 20) array
    scales : (5,) array
        Its line and sample scales turn misclosures into pixels.
    image : (N, 2) array
        Normalised line and sample, without compensation.
    z : (N,) array
    start : (N, 2) array
        First guess of normalised longitude and latitude.

    Returns
    -------
    (N, 2) array
        nan where the iteration does not come within 1e-7 pixels.
    """
    out = np.empty((len(image), 2))
    for i in range(len(image)):
        out[i, 0], out[i, 1] = _locate_one(c, scales, image[i, 0], image[i, 1], z[i], start[i, 0], start[i, 1])
    return out


@compiled
def _misclosure(c: Any, scales: Any, l: float, s: float, x: float, y: float, z: float) -> Any:  # noqa: E741
    """Normalised misclosures and the larger one in pixels."""
    a, b = value(c, x, y, z)
    return l - a, s - b, max(abs((l - a) * scales[0]), abs((s - b) * scales[1]))


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
