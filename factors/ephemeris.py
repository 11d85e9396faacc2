"""Ephemeris: Lagrange interpolation of state vectors, position and velocity alike.

Source: Terlemezoğlu 2019, eq. 2.32 as corrected (t_e in the denominator). The samples
nearest to t are used, up to eight. Nothing is extrapolated: the caller checks the span.
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array, compiled

MAX_SAMPLES = 8


@compiled
def lagrange(sample_time_s: Array, samples: Array, time_s: Array) -> Array:
    """Interpolate (n, c) samples at N times inside their span: -> (N, c).

    Exact for polynomials up to degree min(n, 8) - 1.
    """
    n, columns = samples.shape
    use = min(n, MAX_SAMPLES)
    out = np.zeros((len(time_s), columns))
    for i in range(len(time_s)):
        t = time_s[i]
        first = np.searchsorted(sample_time_s, t) - use // 2
        first = max(0, min(n - use, first))
        for e in range(first, first + use):
            weight = 1.0
            for d in range(first, first + use):
                if d != e:
                    weight *= (t - sample_time_s[d]) / (sample_time_s[e] - sample_time_s[d])
            for c in range(columns):
                out[i, c] += weight * samples[e, c]
    return out
