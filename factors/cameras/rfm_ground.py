"""Geodetic coordinates of a point near a reference point, as exact differences, and their derivatives.

Longitude, latitude and height of an ECEF point have 16 digits, which is a resolution of 1e-9 m to 1e-8 m.
Differences from a reference point are smaller numbers, so their 16 digits are much finer.
``frame`` contains ``FRAME``: the height of the reference point, and sines and cosines of its longitude and
latitude. The functions accept complex differences (complex-step tests).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import compiled
from factors.geometry.ellipsoid import A_M, E2
from factors.records import Record

FRAME: Final = Record(sin_lon=1, cos_lon=1, sin_lat=1, cos_lat=1, height=1)

#: Number of Newton steps in the meridian plane: at 100 km from the reference the third step is exact.
STEPS: Final = 4


@compiled
def differences(frame: Any, dx: Any, dy: Any, dz: Any) -> Any:
    """Return the differences of longitude, latitude (rad) and height (m) for an ECEF difference (m).

    nan if the point lies beyond the Earth's axis, seen from the reference point.
    """
    s_lon, c_lon, s0, c0 = frame[FRAME.sin_lon], frame[FRAME.cos_lon], frame[FRAME.sin_lat], frame[FRAME.cos_lat]
    h0 = frame[FRAME.height]
    along, east = dx * c_lon + dy * s_lon, dy * c_lon - dx * s_lon
    root0 = np.sqrt(1.0 - E2 * s0 * s0)
    n0 = A_M / root0
    q = (n0 + h0) * c0 + along
    if not q.real > 0.0:
        return np.nan + 0.0 * q, np.nan + 0.0 * q, np.nan + 0.0 * q
    tangent = east / q
    real = tangent.real
    # the complex arctan would lose tiny imaginary parts
    d_lon = np.arctan(real) + (tangent - real) / (1.0 + real * real)
    d_p = along + east * east / (np.sqrt(q * q + east * east) + q)
    d_lat, d_h = 0.0 * d_p, 0.0 * d_p
    for _ in range(STEPS):
        sine, half = np.sin(d_lat), np.sin(0.5 * d_lat)
        d_s = c0 * sine - 2.0 * s0 * half * half
        d_c = -s0 * sine - 2.0 * c0 * half * half
        s, c = s0 + d_s, c0 + d_c
        root = np.sqrt(1.0 - E2 * s * s)
        d_n = A_M * E2 * d_s * (s + s0) / (root * root0 * (root + root0))
        r_p = d_p - (n0 + h0) * d_c - (d_n + d_h) * c
        r_z = dz - (n0 * (1.0 - E2) + h0) * d_s - (d_n * (1.0 - E2) + d_h) * s
        d_lat = d_lat + (r_z * c - r_p * s) / (A_M * (1.0 - E2) / (root * root * root) + h0 + d_h)
        d_h = d_h + (r_p * c + r_z * s)
    return d_lon, d_lat, d_h


@compiled
def derivatives(frame: Any, d_lon: float, d_lat: float, d_h: float) -> Any:
    """Return the derivatives of longitude, latitude, height with respect to the ECEF coordinates: three triples."""
    a, b = np.sin(d_lon), np.cos(d_lon)
    s0, c0 = frame[FRAME.sin_lon], frame[FRAME.cos_lon]
    s_lon, c_lon = s0 * b + c0 * a, c0 * b - s0 * a
    a, b = np.sin(d_lat), np.cos(d_lat)
    s0, c0 = frame[FRAME.sin_lat], frame[FRAME.cos_lat]
    s, c = s0 * b + c0 * a, c0 * b - s0 * a
    root, h = np.sqrt(1.0 - E2 * s * s), frame[FRAME.height] + d_h
    parallel = (A_M / root + h) * c
    meridian = A_M * (1.0 - E2) / (root * root * root) + h
    return (
        (-s_lon / parallel, c_lon / parallel, 0.0),
        (-s * c_lon / meridian, -s * s_lon / meridian, c / meridian),
        (c * c_lon, c * s_lon, s),
    )
