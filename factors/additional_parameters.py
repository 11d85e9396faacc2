"""Brown's 21 additional parameters: corrections of image coordinates by film, lens and interior orientation.

    dx = a1 x + a2 y + a3 xy + a4 y^2 + a5 x^2 y + a6 x y^2 + a7 x^2 y^2 + x s + a19 + a21 x/c
    dy = a8 xy + a9 x^2 + a10 x^2 y + a11 x y^2 + a12 x^2 y^2 + y s + a20 + a21 y/c
    s  = [a13 (x^2 - y^2) + a14 x^2 y^2 + a15 (x^4 - y^4)]/c + a16 r^2 + a17 r^4 + a18 r^6

(Brown 1976, as Ayhan 1996, eq. 2 quotes it.) x, y are reduced to the principal point, c is a nominal principal distance
and held. a16 to a18 are k1 to k3, a19 to a21 move the interior orientation: an adjustment that has those holds these.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, compiled

SIZE: Final = 21
NAMES: Final = tuple(f"a{j}" for j in range(1, SIZE + 1))


@compiled
def terms(x: Any, y: Any, c: float) -> Any:
    """Derivatives of dx and dy with respect to the parameters: array (2, 21)."""
    xx, yy, xy = x * x, y * y, x * y
    r = xx + yy
    out = np.zeros((2, 21), np.array([x]).dtype)
    out[0, 0], out[0, 1], out[0, 2], out[0, 3] = x, y, xy, yy
    out[0, 4], out[0, 5], out[0, 6] = xx * y, x * yy, xx * yy
    out[1, 7], out[1, 8], out[1, 9], out[1, 10], out[1, 11] = xy, xx, xx * y, x * yy, xx * yy
    s = (xx - yy) / c
    for j in range(12, 18):
        if j == 13:
            s = xx * yy / c
        elif j == 14:
            s = (xx * xx - yy * yy) / c
        elif j > 14:
            s = r if j == 15 else s * r
        out[0, j], out[1, j] = x * s, y * s
    out[0, 18], out[1, 19], out[0, 20], out[1, 20] = 1.0, 1.0, x / c, y / c
    return out


@compiled
def slopes(a: Array, x: float, y: float, c: float) -> tuple[float, float, float, float]:
    """Derivatives dx_x, dx_y, dy_x, dy_y of the corrections with respect to the point."""
    xx, yy, r = x * x, y * y, x * x + y * y
    s = (a[12] * (xx - yy) + a[13] * xx * yy + a[14] * (xx * xx - yy * yy)) / c + r * (a[15] + r * (a[16] + r * a[17]))
    radial = 2.0 * (a[15] + r * (2.0 * a[16] + 3.0 * r * a[17]))
    s_x = (2.0 * a[12] * x + 2.0 * a[13] * x * yy + 4.0 * a[14] * xx * x) / c + x * radial
    s_y = (-2.0 * a[12] * y + 2.0 * a[13] * xx * y - 4.0 * a[14] * yy * y) / c + y * radial
    own = s + a[20] / c
    return (
        a[0] + a[2] * y + 2.0 * a[4] * x * y + a[5] * yy + 2.0 * a[6] * x * yy + own + x * s_x,
        a[1] + a[2] * x + 2.0 * a[3] * y + a[4] * xx + 2.0 * a[5] * x * y + 2.0 * a[6] * xx * y + x * s_y,
        a[7] * y + 2.0 * a[8] * x + 2.0 * a[9] * x * y + a[10] * yy + 2.0 * a[11] * x * yy + y * s_x,
        a[7] * x + a[9] * xx + 2.0 * a[10] * x * y + 2.0 * a[11] * xx * y + own + y * s_y,
    )
