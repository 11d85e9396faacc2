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
    out = np.zeros((len(time_s), samples.shape[1]))
    for lo in range(0, len(time_s), AT_ONCE):
        t = time_s[lo : lo + AT_ONCE]
        first = np.clip(np.searchsorted(sample_time_s, t) - use // 2, 0, len(sample_time_s) - use)
        near = first + np.arange(use)[:, None]
        times = sample_time_s[near]  # (use, N)
        apart = times[None, :, :] - times[:, None, :]  # of sample e (axis 1) from sample d (axis 0)
        own = np.arange(use)
        apart[own, own] = 1.0
        share = (t - times)[:, None, :] / apart
        share[own, own] = 1.0
        weight = np.multiply.reduce(share, axis=0)
        np.add.reduce(weight[:, :, None] * samples[near], axis=0, out=out[lo : lo + AT_ONCE])
    return out
