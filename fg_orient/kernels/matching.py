"""Least-squares matching of image windows (Gruen 1985), with radiometric unknowns, in compiled loops.

A window around a pixel of the first image is the template f. The second image is g, interpolated by a cubic B-spline.
At each pixel u of the window, counted from its centre::

    v(u) = r0 + r1 g(q + A u) - f(u)

The unknowns are q (line, sample of the window's centre in the second image), the radiometric r0, r1, and
parameters of A. Without a sensor model these are all elements of A. With a sensor model, A = A0 + e
s^T. Here e is the direction of the epipolar line, and the unknown s is the change of the parallax along
the window (the slope of the ground). For curved ground, terms of second order in u are added along e.
Weights are Gaussian about the centre. The covariance of q is the least-squares covariance, s0^2 (J^T P
J)^-1, with s0^2 = v^T P v / (n - u). It includes the noise and the texture (Förstner 1982), but neither
correlations of the noise nor errors of the model. Therefore callers multiply it by an estimated factor.
Pixels are (line, sample) with (0, 0) = centre of the first pixel of the arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from factors._contract import Array, compiled, inlined
from factors.records import Record

#: Result for a window: place in the second image, its covariance (px^2), matrix A, and correlation of the grey values.
FIT = Record(
    place="line sample",
    covariance="line_line line_sample sample_sample",
    affine="a_11 a_12 a_21 a_22",
    correlation=1,
    noise=1,
    gain=1,
)
#: Approximate place and matrix A of a window.
START = Record(place="line sample", affine="a_11 a_12 a_21 a_22")
#: Unknowns of a window with slope and curvature along the epipolar line, and of a window with the whole matrix A.
UNKNOWN = Record(
    line=1,
    sample=1,
    offset=1,
    gain=1,
    slope="slope_line slope_sample",
    curvature="line_line line_sample sample_sample",
)
OF_AFFINE = Record(line=1, sample=1, offset=1, gain=1, affine="a_11 a_12 a_21 a_22")
#: Kinds of windows, by number of unknowns: only the centre; with slope; with matrix A; with slope and curvature.
SHIFT, SLOPE, AFFINE, CURVED = 4, 6, OF_AFFINE.size, UNKNOWN.size
#: The iteration ends if the step of the centre is smaller than this, pixels.
STEP_PX = 0.003


@inlined
def _weights(x: float, w: Any, d: Any) -> None:
    """Return the weights of four coefficients for a cubic B-spline and its derivative, at x in [0, 1)."""
    y = 1.0 - x
    w[0], w[3] = y * y * y / 6.0, x * x * x / 6.0
    w[1] = 2.0 / 3.0 - 0.5 * x * x * (2.0 - x)
    w[2] = 2.0 / 3.0 - 0.5 * y * y * (2.0 - y)
    d[0], d[3] = -0.5 * y * y, 0.5 * x * x
    d[1], d[2] = 1.5 * x * x - 2.0 * x, -1.5 * y * y + 2.0 * y


@compiled
def fit_window(
    template: Any,
    spline: Any,
    centre: Array,
    start: Array,
    direction: Array,
    kind: int,
    half: int,
    spread: float,
    most: int,
    reach: float,
    out: Array,
) -> bool:
    """Match one window; return False if it leaves an image, meets nodata, moves beyond ``reach`` or does not converge.

    Parameters
    ----------
    template : (P, Q) float array
        Grey values of the first image; nan for nodata.
    spline : (R, S) float array
        Coefficients of the cubic B-spline of the second image; nan for nodata.
    centre : (2,) array
        Line and sample of the window's centre in ``template``, whole numbers.
    start : (START.size,) array
        Approximate line and sample in ``spline``, and A by rows.
    direction : (2,) array
        Unit vector of the epipolar line in the second image.
    kind : int
        SHIFT, SLOPE, AFFINE or CURVED.
    half : int
        Half size: the window has 2 half + 1 lines and samples.
    spread : float
        Standard deviation of the Gaussian weights, pixels.
    most : int
        Largest number of iterations.
    reach : float
        Largest distance from the start, pixels.
    out : (FIT.size,) array
        Result.
    """
    n, k = 2 * half + 1, kind
    i0, j0 = int(centre[0]) - half, int(centre[1]) - half
    if i0 < 0 or j0 < 0 or i0 + n > template.shape[0] or j0 + n > template.shape[1]:
        return False
    c0, c1, c2 = 0.0, 0.0, 0.0
    q0, q1 = start[START.line], start[START.sample]
    a11, a12, a21, a22 = start[START.a_11], start[START.a_12], start[START.a_21], start[START.a_22]
    wl, ws, dl, ds = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    row, x = np.empty(k), np.empty(k)
    normal, right = np.empty((k, k)), np.empty(k)
    total, mean, square = 0.0, 0.0, 0.0
    for i in range(n):
        for j in range(n):
            p = np.exp(-0.5 * ((i - half) ** 2 + (j - half) ** 2) / spread**2)
            f = template[i0 + i, j0 + j]
            total += p
            mean += p * f
            square += p * f * f
    mean /= total
    deviation = square / total - mean * mean
    if not deviation > 0.0:  # nan for nodata
        return False
    gain, offset, chi2 = 1.0, 0.0, 0.0
    for iteration in range(most + 1):
        normal[:], right[:] = 0.0, 0.0
        chi2 = 0.0
        sum_g, sum_gg, sum_fg = 0.0, 0.0, 0.0
        for i in range(n):
            u = float(i - half)
            for j in range(n):
                v = float(j - half)
                bend = c0 * u * u + c1 * u * v + c2 * v * v
                y = q0 + a11 * u + a12 * v + bend * direction[0]
                z = q1 + a21 * u + a22 * v + bend * direction[1]
                r, c = int(np.floor(y)) - 1, int(np.floor(z)) - 1
                if r < 0 or c < 0 or r + 4 > spline.shape[0] or c + 4 > spline.shape[1]:
                    return False
                _weights(y - r - 1, wl, dl)
                _weights(z - c - 1, ws, ds)
                g, gl, gs = 0.0, 0.0, 0.0
                for m in range(4):
                    across, along = 0.0, 0.0
                    for t in range(4):
                        across += ws[t] * spline[r + m, c + t]
                        along += ds[t] * spline[r + m, c + t]
                    g += wl[m] * across
                    gl += dl[m] * across
                    gs += wl[m] * along
                p = np.exp(-0.5 * (u * u + v * v) / spread**2)
                f = template[i0 + i, j0 + j]
                if iteration == 0:
                    sum_g += p * g
                    sum_gg += p * g * g
                    sum_fg += p * f * g
                    continue
                e = offset + gain * g - f
                chi2 += p * e * e
                gl, gs = gain * gl, gain * gs
                row[UNKNOWN.line], row[UNKNOWN.sample] = gl, gs
                row[UNKNOWN.offset], row[UNKNOWN.gain] = 1.0, g
                if kind == SLOPE or kind == CURVED:
                    along = gl * direction[0] + gs * direction[1]
                    row[UNKNOWN.slope_line], row[UNKNOWN.slope_sample] = along * u, along * v
                    if kind == CURVED:
                        row[UNKNOWN.line_line], row[UNKNOWN.line_sample] = along * u * u, along * u * v
                        row[UNKNOWN.sample_sample] = along * v * v
                elif kind == AFFINE:
                    row[OF_AFFINE.a_11], row[OF_AFFINE.a_12] = gl * u, gl * v
                    row[OF_AFFINE.a_21], row[OF_AFFINE.a_22] = gs * u, gs * v
                for s in range(k):
                    right[s] -= p * row[s] * e
                    for t in range(s + 1):
                        normal[s, t] += p * row[s] * row[t]
        if iteration == 0:  # the first iteration sets the radiometric unknowns
            sum_g /= total
            covariance, variance = sum_fg / total - mean * sum_g, sum_gg / total - sum_g * sum_g
            if not (covariance > 0.0 and variance > 0.0):
                return False
            gain = covariance / variance
            offset = mean - gain * sum_g
            continue
        if not _solve(normal, right, x):
            return False
        q0, q1 = q0 + x[UNKNOWN.line], q1 + x[UNKNOWN.sample]
        offset, gain = offset + x[UNKNOWN.offset], gain + x[UNKNOWN.gain]
        if kind == SLOPE or kind == CURVED:
            if kind == CURVED:
                c0, c1 = c0 + x[UNKNOWN.line_line], c1 + x[UNKNOWN.line_sample]
                c2 += x[UNKNOWN.sample_sample]
            a11, a12 = a11 + direction[0] * x[UNKNOWN.slope_line], a12 + direction[0] * x[UNKNOWN.slope_sample]
            a21, a22 = a21 + direction[1] * x[UNKNOWN.slope_line], a22 + direction[1] * x[UNKNOWN.slope_sample]
        elif kind == AFFINE:
            a11, a12 = a11 + x[OF_AFFINE.a_11], a12 + x[OF_AFFINE.a_12]
            a21, a22 = a21 + x[OF_AFFINE.a_21], a22 + x[OF_AFFINE.a_22]
        if not (q0 - start[START.line]) ** 2 + (q1 - start[START.sample]) ** 2 <= reach * reach or not gain > 0.0:
            return False
        if x[UNKNOWN.line] ** 2 + x[UNKNOWN.sample] ** 2 < STEP_PX * STEP_PX:
            break
        if iteration == most:
            return False
    # effective number of observations of a Gaussian window: n = (sum p)^2 / sum p^2
    effective = min(float(n * n), 4.0 * np.pi * spread * spread)
    noise = chi2 / total * effective / max(effective - k, 1.0)
    out[FIT.line], out[FIT.sample] = q0, q1
    for t in (UNKNOWN.line, UNKNOWN.sample):
        right[:] = 0.0
        right[t] = 1.0
        if not _solve(normal, right, x):
            return False
        if t == UNKNOWN.line:
            out[FIT.line_line], out[FIT.line_sample] = noise * x[UNKNOWN.line], noise * x[UNKNOWN.sample]
        else:
            out[FIT.sample_sample] = noise * x[UNKNOWN.sample]
    out[FIT.a_11], out[FIT.a_12], out[FIT.a_21], out[FIT.a_22] = a11, a12, a21, a22
    out[FIT.correlation] = np.sqrt(max(1.0 - chi2 / total / deviation, 0.0))
    out[FIT.noise], out[FIT.gain] = np.sqrt(noise), gain
    return True


@inlined
def _solve(normal: Any, right: Any, x: Any) -> bool:
    """Solve by the Cholesky factor of the lower triangle, in a copy; return False if it is not positive definite."""
    k = len(right)
    factor = normal.copy()
    for s in range(k):
        for t in range(s + 1):
            value = factor[s, t]
            for m in range(t):
                value -= factor[s, m] * factor[t, m]
            if s == t:
                if not value > 1e-10 * normal[s, s]:
                    return False
                factor[s, s] = np.sqrt(value)
            else:
                factor[s, t] = value / factor[t, t]
    for s in range(k):
        value = right[s]
        for m in range(s):
            value -= factor[s, m] * x[m]
        x[s] = value / factor[s, s]
    for s in range(k - 1, -1, -1):
        value = x[s]
        for m in range(s + 1, k):
            value -= factor[m, s] * x[m]
        x[s] = value / factor[s, s]
    return True


@compiled
def fit_windows(
    template: Any,
    spline: Any,
    centre: Array,
    start: Array,
    direction: Array,
    kind: int,
    half: int,
    spread: float,
    most: int,
    reach: float,
    out: Array,
    done: Any,
) -> None:
    """Match N windows by :func:`fit_window`.

    Each array has N rows, and ``done`` (N,) contains the results True or False.
    """
    for m in range(len(centre)):
        done[m] = fit_window(
            template, spline, centre[m], start[m], direction[m], kind, half, spread, most, reach, out[m]
        )
