"""Interpolation in time: Lagrange for the ephemeris, linear for angles, linear or polynomial for quaternions.

Source: Terlemezoğlu 2019, eqs. 2.32 (with t_e in the denominator, as corrected), 2.33
(interval as corrected) and 2.37-2.40.
"""

from __future__ import annotations

import numpy as np

from factors._contract import compiled
from factors.arrays import Array, Index

#: Largest number of samples interpolated by one Lagrange polynomial.
MAX_SAMPLES = 8
#: Above this number of times, a compiled loop is used. It takes a fifth of numpy's time and gives the same bits.
MANY = 1024


def lagrange(sample_time_s: Array, samples: Array, time_s: Array) -> Array:
    """Interpolate position and velocity samples (n, c) at N times: -> (N, c); uses up to eight nearest samples.

    Nothing is extrapolated; the caller checks the span. The result is exact for
    polynomials up to degree min(n, 8) - 1.
    """
    use = min(len(sample_time_s), MAX_SAMPLES)
    window = np.arange(len(sample_time_s) - use + 1) + np.arange(use)[:, None]  # (use, W)
    apart = sample_time_s[window][:, None] - sample_time_s[window][None]  # from sample e (axis 1) to sample d (axis 0)
    apart[np.arange(use), np.arange(use)] = 1.0
    divisor = np.multiply.reduce(apart, axis=1)
    first = np.clip(np.searchsorted(sample_time_s, time_s) - use // 2, 0, len(sample_time_s) - use)
    if len(time_s) >= MANY:
        return _sums(sample_time_s, np.ascontiguousarray(samples), time_s, first, divisor)
    near = first + np.arange(use)[:, None]
    away = time_s - sample_time_s[near]  # (use, N)
    before, after = np.ones_like(away), np.ones_like(away)  # products over the samples before and after d
    for d in range(1, use):
        np.multiply(before[d - 1], away[d - 1], out=before[d])
        np.multiply(after[use - d], away[use - d], out=after[use - d - 1])
    weight = before * after / divisor[:, first]
    return np.asarray(np.add.reduce(weight[:, :, None] * samples[near], axis=0))


@compiled
def _sums(sample_time_s: Array, samples: Array, time_s: Array, first: Index, divisor: Array) -> Array:
    """Return weighted sums of samples from ``first`` (N,) on, at N times, with the operations of :func:`lagrange`."""
    use = divisor.shape[0]
    away, before, after = np.empty(use), np.ones(use), np.ones(use)
    out = np.zeros((time_s.shape[0], samples.shape[1]))
    for i in range(time_s.shape[0]):
        at = first[i]
        for d in range(use):
            away[d] = time_s[i] - sample_time_s[at + d]
        for d in range(1, use):
            before[d] = before[d - 1] * away[d - 1]
            after[use - d - 1] = after[use - d] * away[use - d]
        for d in range(use):
            weight = before[d] * after[d] / divisor[d, at]
            for c in range(samples.shape[1]):
                out[i, c] += weight * samples[at + d, c]
    return out


def centred(sample_time_s: Array, samples: Array, time_s: Array) -> Array:
    """Interpolate (n, c) samples at N times by polynomials through as many samples before as after the time: -> (N, c).

    A polynomial uses eight samples; near the ends of the list it uses six, four or two.
    CSM line-scan states are interpolated in this way.
    """
    n = len(sample_time_s)
    before = np.clip(np.searchsorted(sample_time_s, time_s, side="right") - 1, 0, n - 2)
    half = np.minimum(MAX_SAMPLES // 2, np.minimum(before + 1, n - 1 - before))
    out = np.empty((len(time_s), samples.shape[1]))
    for size in np.unique(half):
        rows = np.flatnonzero(half == size)
        near = before[rows] - size + 1 + np.arange(2 * size)[:, None]
        listed, at = sample_time_s[near], time_s[rows]
        weight = np.ones((2 * size, len(rows)))
        for d, e in np.ndindex(2 * size, 2 * size):
            if d != e:
                weight[d] *= (at - listed[e]) / (listed[d] - listed[e])
        out[rows] = np.add.reduce(weight[:, :, None] * samples[near], axis=0)
    return out


def linear(sample_time_s: Array, samples: Array, time_s: Array) -> Array:
    """Return the piecewise linear interpolation, constant beyond the ends: (n, c), (N,) -> (N, c)."""
    return np.stack([np.interp(time_s, sample_time_s, column) for column in samples.T], axis=1)


def sign_aligned(quaternion: Array) -> Array:
    """Change the signs of quaternions so that neighbours have a positive product, and normalise: (n, 4) -> (n, 4).

    q and -q are the same rotation, so a jump between them must not be interpolated.
    """
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    products = np.einsum("ij,ij->i", unit[1:], unit[:-1])
    sign = np.concatenate([[1.0], np.cumprod(np.where(products < 0.0, -1.0, 1.0))])
    return np.asarray(unit * sign[:, None])


def extended(sample_time_s: Array, samples: Array, before_s: float, after_s: float) -> tuple[Array, Array]:
    """Return samples (n, c), extended by ``before_s`` and ``after_s`` beyond the ends at the last rate (0: no sample).

    Quaternions (with aligned signs) are extended along the line through two neighbours.
    In a few seconds the attitude changes by less than 0.1 rad; the normalised line
    differs from the constant rate by the cube of that angle.
    """
    times, rows = [sample_time_s], [samples]
    for end, neighbour, seconds, at in ((0, 1, -before_s, 0), (-1, -2, after_s, 2)):
        if seconds:
            rate = (samples[end] - samples[neighbour]) / (sample_time_s[end] - sample_time_s[neighbour])
            times.insert(at, sample_time_s[[end]] + seconds)
            rows.insert(at, (samples[end] + rate * seconds)[None])
    return np.concatenate(times), np.concatenate(rows)


def quaternion_linear(sample_time_s: Array, quaternion: Array, time_s: Array) -> Array:
    """Return the normalised linear interpolation of sampled quaternions: (n, 4), (N,) -> (N, 4).

    The samples must have the signs of :func:`sign_aligned`: values between q and a
    neighbour near -q are meaningless.
    """
    q = linear(sample_time_s, quaternion, time_s)
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))


def quaternion_polynomial(coefficients: Array, offset_s: float, scale_s: float, time_s: Array) -> Array:
    """Return the normalised polynomials of the scaled time: (4, k), (N,) -> (N, 4)."""
    scaled = (np.asarray(time_s, float) - offset_s) / scale_s
    q = (scaled[:, None] ** np.arange(coefficients.shape[1])) @ coefficients.T
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))
