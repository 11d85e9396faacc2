"""Corrections from measured to ideal image coordinates: radial and decentring distortion, affinity.

    K = k1 r^2 + k2 r^4 + k3 r^6,   r^2 = x^2 + y^2      (x, y reduced to the principal point)
    x' = x + x K + P1 (r^2 + 2 x^2) + 2 P2 x y + A y
    y' = y + y K + P2 (r^2 + 2 y^2) + 2 P1 x y + B y

Brown 1966; Ayhan 1996, eqs. 48, 53 and 71-73, with a corrected misprint (eq. 71 repeats "x"). The direction is
**measured to ideal**, opposite to ``factors.cameras.frame_camera``. The coefficients (7,) are k1 k2 k3 P1 P2 A B. Their
units follow from the unit of the coordinates: mm^-2, mm^-4, mm^-6, mm^-1, mm^-1, 1, 1 for coordinates in mm.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, compiled, inlined
from factors._plain import plain
from factors.records import Record

AT: Final = Record(k1=1, k2=1, k3=1, p1=1, p2=1, affinity_a=1, affinity_b=1)
NAMES: Final = tuple(AT.fields)


@inlined
def ideal(c: Any, x: Any, y: Any) -> Any:
    """Return the ideal coordinates (2 numbers) of measured coordinates."""
    xx, yy, xy = x * x, y * y, x * y
    r = xx + yy
    radial = 1.0 + r * (c[AT.k1] + r * (c[AT.k2] + r * c[AT.k3]))
    return (
        x * radial + c[AT.p1] * (r + 2.0 * xx) + 2.0 * c[AT.p2] * xy + c[AT.affinity_a] * y,
        y * radial + c[AT.p2] * (r + 2.0 * yy) + 2.0 * c[AT.p1] * xy + c[AT.affinity_b] * y,
    )


@compiled
def terms(x: Any, y: Any) -> Any:
    """Return the derivatives of x' and y' with respect to the coefficients: array (2, 7)."""
    r, xy, o = x * x + y * y, 2.0 * x * y, 0.0 * x
    return np.array([
        [x * r, x * (r * r), x * (r * r * r), r + 2.0 * x * x, xy, y, o],
        [y * r, y * (r * r), y * (r * r * r), xy, r + 2.0 * y * y, o, y],
    ])  # fmt: skip


def ideal_points(c: Array, reduced: Array) -> Array:
    """Return the ideal coordinates (N, 2) of N measured points (N, 2), both about the principal point."""
    return np.stack(plain(ideal)(c, *reduced.T), axis=1)
