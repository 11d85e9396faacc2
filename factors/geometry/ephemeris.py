"""Ephemeris: Lagrange interpolation of state vectors, position and velocity alike.

Source: Terlemezoğlu 2019, eq. 2.32 as corrected (t_e in the denominator). The samples
nearest to t are used, up to eight. Nothing is extrapolated: the caller checks the span.
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array

MAX_SAMPLES = 8
#: Times that are interpolated together: what is read and written stays near the processor.
AT_ONCE = 1024


def lagrange(sample_time_s: Array, samples: Array, time_s: Array) -> Array:
    """Interpolate (n, c) samples at N times inside their span: -> (N, c).

    Exact for polynomials up to degree min(n, 8) - 1.
    """
    use = min(len(sample_time_s), MAX_SAMPLES)
    window = np.arange(len(sample_time_s) - use + 1) + np.arange(use)[:, None]  # (use, W)
    apart = sample_time_s[window][:, None] - sample_time_s[window][None]  # of sample d (axis 0) from sample e (axis 1)
    apart[np.arange(use), np.arange(use)] = 1.0
    divisor = np.multiply.reduce(apart, axis=1)
    out = np.zeros((len(time_s), samples.shape[1]))
    for lo in range(0, len(time_s), AT_ONCE):
        t = time_s[lo : lo + AT_ONCE]
        first = np.clip(np.searchsorted(sample_time_s, t) - use // 2, 0, len(sample_time_s) - use)
        near = first + np.arange(use)[:, None]
        away = t - sample_time_s[near]  # (use, N)
        before, after = np.ones_like(away), np.ones_like(away)  # products over the samples before and after sample d
        for d in range(1, use):
            np.multiply(before[d - 1], away[d - 1], out=before[d])
            np.multiply(after[use - d], away[use - d], out=after[use - d - 1])
        weight = before * after / divisor[:, first]
        np.add.reduce(weight[:, :, None] * samples[near], axis=0, out=out[lo : lo + AT_ONCE])
    return out
