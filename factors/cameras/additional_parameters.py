"""Brown's 21 additional parameters: corrections of image coordinates by film, lens and interior orientation.

    dx = a1 x + a2 y + a3 xy + a4 y^2 + a5 x^2 y + a6 x y^2 + a7 x^2 y^2 + x s + a19 + a21 x/c
    dy = a8 xy + a9 x^2 + a10 x^2 y + a11 x y^2 + a12 x^2 y^2 + y s + a20 + a21 y/c
    s  = [a13 (x^2 - y^2) + a14 x^2 y^2 + a15 (x^4 - y^4)]/c + a16 r^2 + a17 r^4 + a18 r^6

(Brown 1976, quoted by Ayhan 1996, eq. 2.) x, y are relative to the principal point; c is a fixed nominal
principal distance. a16 to a18 are k1 to k3; a19 to a21 change the interior orientation. Therefore an
adjustment holds a16 to a21 fixed if k1 to k3 or the interior orientation are unknown.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, compiled
from factors.records import Record

AT: Final = Record(all="a1 a2 a3 a4 a5 a6 a7 a8 a9 a10 a11 a12 a13 a14 a15 a16 a17 a18 a19 a20 a21")
NAMES: Final = tuple(f"a{j + 1}" for j in range(AT.size))


@compiled
def terms(x: Any, y: Any, c: float) -> Any:
    """Return the derivatives of dx and dy with respect to the parameters: array (2, 21)."""
    xx, yy, xy, o, one = x * x, y * y, x * y, 0.0 * x, 1.0 + 0.0 * x
    r = xx + yy
    a, b, d, r4 = (xx - yy) / c, xx * yy / c, (xx * xx - yy * yy) / c, r * r
    return np.array([
        [x, y, xy, yy, xx * y, x * yy, xx * yy, o, o, o, o, o,
         x * a, x * b, x * d, x * r, x * r4, x * (r4 * r), one, o, x / c],
        [o, o, o, o, o, o, o, xy, xx, xx * y, x * yy, xx * yy,
         y * a, y * b, y * d, y * r, y * r4, y * (r4 * r), o, one, y / c],
    ])  # fmt: skip


@compiled
def slopes(a: Array, x: float, y: float, c: float) -> tuple[float, float, float, float]:
    """Return the derivatives dx_x, dx_y, dy_x, dy_y of the corrections with respect to the point."""
    xx, yy, r = x * x, y * y, x * x + y * y
    a13, a14, a15, a16, a17, a18 = a[AT.a13], a[AT.a14], a[AT.a15], a[AT.a16], a[AT.a17], a[AT.a18]
    s = (a13 * (xx - yy) + a14 * xx * yy + a15 * (xx * xx - yy * yy)) / c + r * (a16 + r * (a17 + r * a18))
    radial = 2.0 * (a16 + r * (2.0 * a17 + 3.0 * r * a18))
    s_x = (2.0 * a13 * x + 2.0 * a14 * x * yy + 4.0 * a15 * xx * x) / c + x * radial
    s_y = (-2.0 * a13 * y + 2.0 * a14 * xx * y - 4.0 * a15 * yy * y) / c + y * radial
    own = s + a[AT.a21] / c
    return (
        a[AT.a1] + a[AT.a3] * y + 2.0 * a[AT.a5] * x * y + a[AT.a6] * yy + 2.0 * a[AT.a7] * x * yy + own + x * s_x,
        a[AT.a2] + a[AT.a3] * x + 2.0 * a[AT.a4] * y + a[AT.a5] * xx + 2.0 * a[AT.a6] * x * y
        + 2.0 * a[AT.a7] * xx * y + x * s_y,
        a[AT.a8] * y + 2.0 * a[AT.a9] * x + 2.0 * a[AT.a10] * x * y + a[AT.a11] * yy
        + 2.0 * a[AT.a12] * x * yy + y * s_x,
        a[AT.a8] * x + a[AT.a10] * xx + 2.0 * a[AT.a11] * x * y + 2.0 * a[AT.a12] * xx * y + own + y * s_y,
    )  # fmt: skip
