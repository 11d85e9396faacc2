"""Alternative terms of radial distortion and film deformation: corrections added to measured coordinates.

    radial_j        dr = radial_j r^j                     j = 1, 2, 4, 6, 9: k1 to k3 have r^3, r^5, r^7
    orthogonal_i    dr = orthogonal_i R_n(r/R),           n = 3, 5, 7: Zernike's radial polynomials of order 1
    film_xx         dx = film_xx x
    film_yx         dy = film_yx x

    R_3 = 3 u^3 - 2 u,  R_5 = 10 u^5 - 12 u^3 + 3 u,  R_7 = 35 u^7 - 60 u^5 + 30 u^3 - 4 u

Sources: Ayhan 1996, eqs. 44 to 46 and 49 to 52, who does not name the family of orthogonal
polynomials; Born, Wolf 1999, section 9.2. The displacements of R_3, R_5, R_7 and of a change
of scale (R_1 = u) are orthogonal over the disk of radius R. Because R_n(1) = 1,
``orthogonal_i`` is the displacement at the rim. ``radial_1`` is a change of scale, like a
change of the principal distance. ``image_corrections`` has dx = affinity_a y and dy =
affinity_b y.

x, y are relative to the principal point and r^2 = x^2 + y^2; R is constant. radial_j has the unit of the coordinates to
the power 1 - j; orthogonal_i has the unit of the coordinates; film_xx and film_yx have no unit.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array, compiled
from factors.records import Record

AT: Final = Record(
    radial_1=1, radial_2=1, radial_4=1, radial_6=1, orthogonal_1=1, orthogonal_2=1, orthogonal_3=1,
    film_xx=1, film_yx=1, radial_9=1,
)  # fmt: skip
NAMES: Final = tuple(AT.fields)


@compiled
def _factors(x: Any, y: Any, radius: float) -> Any:
    """Return the factors dr/r (7,) of the radial terms."""
    rr = x * x + y * y
    r, v = np.sqrt(rr), rr / radius**2
    return np.array([
        1.0 + 0.0 * r, r, r * rr, r * rr * rr, (3.0 * v - 2.0) / radius, ((10.0 * v - 12.0) * v + 3.0) / radius,
        (((35.0 * v - 60.0) * v + 30.0) * v - 4.0) / radius,
    ])  # fmt: skip


@compiled
def terms(x: Any, y: Any, radius: float) -> Any:
    """Return the derivatives of dx and dy with respect to the coefficients: array (2, 10)."""
    radial = _factors(x, y, radius)
    out = np.zeros((2, 10), radial.dtype)
    for j in range(7):
        out[0, j], out[1, j] = x * radial[j], y * radial[j]
    out[0, 7], out[1, 8] = x, x
    rr = x * x + y * y
    out[0, 9], out[1, 9] = x * rr**4, y * rr**4
    return out


@compiled
def slopes(c: Array, x: float, y: float, radius: float) -> tuple[float, float, float, float]:
    """Return the derivatives dx_x, dx_y, dy_x, dy_y of the corrections with respect to the point."""
    rr, own, slope = x * x + y * y, 0.0, 0.0
    r, v, radial = np.sqrt(rr), rr / radius**2, _factors(x, y, radius)
    for j in range(7):
        own += c[j] * radial[j]
    own += c[AT.radial_9] * rr**4
    # derivative by r, divided by r. r has no derivative at 0, but there the result is multiplied by x and y
    slope = (c[AT.radial_2] / r if r > 0.0 else 0.0) + 3.0 * c[AT.radial_4] * r + 5.0 * c[AT.radial_6] * r * rr
    by_v = 3.0 * c[AT.orthogonal_1] + (20.0 * v - 12.0) * c[AT.orthogonal_2]
    by_v = by_v + ((105.0 * v - 120.0) * v + 30.0) * c[AT.orthogonal_3]
    slope += 2.0 * by_v / radius**3 + 8.0 * c[AT.radial_9] * rr**3
    return own + x * x * slope + c[AT.film_xx], x * y * slope, x * y * slope + c[AT.film_yx], own + y * y * slope
