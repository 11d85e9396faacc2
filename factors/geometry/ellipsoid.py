"""Ray and ellipsoid: intersection at an ellipsoidal height, and geodetic coordinates.

WGS84: a = 6378137 m, b = a (1 - 1/298.257223563). The sources print b rounded to 0.1 mm. With this value
geodetic coordinates would differ from PROJ by 0.05 mm. The surface of height h is approximated by the
ellipsoid with semi-axes a + h, b + h (T 2.44-2.48 as corrected). It differs from the true surface by 2.5 mm
at 1800 m, so :func:`intersect` repeats the intersection with the remaining height error until that is below
0.01 mm.
"""

from __future__ import annotations

import math

import numpy as np

from factors._contract import Array, compiled
from factors._plain import few_in_python
from factors.geometry.rotations import Vector

A_M = 6378137.0
B_M = A_M * (1.0 - 1.0 / 298.257223563)
E2 = 1.0 - (B_M / A_M) ** 2


@compiled
def geodetic(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Convert ECEF (m) to longitude, latitude (rad) and ellipsoidal height (m), by fixed-point iteration."""
    p = math.sqrt(x * x + y * y)
    latitude = math.atan2(z, p * (1.0 - E2))
    for _ in range(12):
        sine = math.sin(latitude)
        n = A_M / math.sqrt(1.0 - E2 * sine * sine)
        latest = math.atan2(z + E2 * n * sine, p)
        if latest == latitude:
            break
        latitude = latest
    sine, cosine = math.sin(latitude), math.cos(latitude)
    n = A_M / math.sqrt(1.0 - E2 * sine * sine)
    height = p * cosine + z * sine - n * (1.0 - E2 * sine * sine)
    return math.atan2(y, x), latitude, height


@compiled
def distance_to_height(p: Vector, u: Vector, h: float) -> float:
    """Return the smallest s > 0 with ``p + s u`` on the ellipsoid (a + h, b + h).

    nan if the ray misses or p is inside.
    """
    a2, b2 = (A_M + h) ** 2, (B_M + h) ** 2
    d1 = (u[0] * u[0] + u[1] * u[1]) / a2 + u[2] * u[2] / b2
    d2 = 2.0 * ((p[0] * u[0] + p[1] * u[1]) / a2 + p[2] * u[2] / b2)
    d3 = (p[0] * p[0] + p[1] * p[1]) / a2 + p[2] * p[2] / b2 - 1.0
    if d3 <= 0.0:
        return math.nan  # the sensor is below that surface
    inside = d2 * d2 - 4.0 * d1 * d3
    if inside < 0.0:
        return math.nan
    # this form of the roots avoids cancellation between -d2 and the square root
    q = -0.5 * (d2 + math.copysign(math.sqrt(inside), d2))
    s1, s2 = float(q / d1), float(d3 / q)
    low, high = (s1, s2) if s1 < s2 else (s2, s1)
    if low > 0.0:
        return low
    return high if high > 0.0 else math.nan


@few_in_python
@compiled
def intersect(position_m: Array, direction: Array, height_m: Array) -> Array:
    """Return the nearest points (N, 3), ECEF m, of N rays at ellipsoidal heights: positions, directions, heights (N,).

    Rows are nan if the ray misses the ellipsoid or the surface is behind the sensor.
    """
    out = np.empty_like(position_m)
    for i in range(len(position_m)):
        aim = height_m[i]
        for _ in range(4):
            s = distance_to_height(position_m[i], direction[i], aim)
            for k in range(3):
                out[i, k] = position_m[i, k] + s * direction[i, k]
            if not math.isfinite(s):
                break
            error = height_m[i] - geodetic(out[i, 0], out[i, 1], out[i, 2])[2]
            if abs(error) < 1e-5:
                break
            aim += error
    return out


@few_in_python
@compiled
def geodetic_array(xyz_m: Array) -> Array:
    """Return longitude, latitude (rad), height (m) of N points: (N, 3) -> (N, 3)."""
    out = np.empty_like(xyz_m)
    for i in range(len(xyz_m)):
        out[i, 0], out[i, 1], out[i, 2] = geodetic(xyz_m[i, 0], xyz_m[i, 1], xyz_m[i, 2])
    return out
