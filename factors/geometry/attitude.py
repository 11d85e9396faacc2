"""Attitude at a time: linear angles, linear normalised quaternions, quaternion polynomials.

Source: Terlemezoğlu 2019, eq. 2.33 (interval as corrected) and 2.37-2.40.
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array


def linear(sample_time_s: Array, samples: Array, time_s: Array) -> Array:
    """Piecewise linear interpolation, constant beyond the ends: (n, c), (N,) -> (N, c)."""
    return np.stack([np.interp(time_s, sample_time_s, column) for column in samples.T], axis=1)


def sign_aligned(quaternion: Array) -> Array:
    """Turn signs so that neighbours have a positive product: (n, 4) -> (n, 4), normalised.

    q and -q are the same rotation; a jump between them must not be interpolated.
    """
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    products = np.einsum("ij,ij->i", unit[1:], unit[:-1])
    sign = np.concatenate([[1.0], np.cumprod(np.where(products < 0.0, -1.0, 1.0))])
    return np.asarray(unit * sign[:, None])


def extended(sample_time_s: Array, samples: Array, before_s: float, after_s: float) -> tuple[Array, Array]:
    """Samples (n, c), and one more at each end that is open for ``before_s`` or ``after_s``: the last rate held.

    Of quaternions (aligned signs) the line through two neighbours is meant: over seconds the attitude turns by
    less than 0.1 rad, and its normalised line differs from the constant rate by the cube of that angle.
    """
    times, rows = [sample_time_s], [samples]
    for end, neighbour, seconds, at in ((0, 1, -before_s, 0), (-1, -2, after_s, 2)):
        if seconds:
            rate = (samples[end] - samples[neighbour]) / (sample_time_s[end] - sample_time_s[neighbour])
            times.insert(at, sample_time_s[[end]] + seconds)
            rows.insert(at, (samples[end] + rate * seconds)[None])
    return np.concatenate(times), np.concatenate(rows)


def quaternion_linear(sample_time_s: Array, quaternion: Array, time_s: Array) -> Array:
    """Normalised linear interpolation of sampled quaternions: (n, 4), (N,) -> (N, 4).

    The samples must be those of :func:`sign_aligned`: between q and a neighbour near -q lies nothing of use.
    """
    q = linear(sample_time_s, quaternion, time_s)
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))


def quaternion_polynomial(coefficients: Array, offset_s: float, scale_s: float, time_s: Array) -> Array:
    """Polynomials of the scaled time, normalised: (4, k), (N,) -> (N, 4)."""
    scaled = (np.asarray(time_s, float) - offset_s) / scale_s
    q = (scaled[:, None] ** np.arange(coefficients.shape[1])) @ coefficients.T
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))
