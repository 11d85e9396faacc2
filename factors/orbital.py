"""Coordinates of a ground point in the orbital frame, and their derivatives.

``w = R_OG(P, V)^T (G - P)`` with x, y, z the axes of convention B, v2 = V . y, v3 = V . z::

    dw1 = x.(dG - dP) - (w2/v2) x.dV + ((w2 v3/v2 - w3)/|P|) x.dP
    dw2 = y.(dG - dP) + (w1/v2) x.dV - (w3 y + (w1 v3/v2) x).dP/|P|
    dw3 = z.(dG - dP) + (w1 x + w2 y).dP/|P|

V acts only through x.dV, which is a pure yaw. Source: docs/equations.md 3.
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array, compiled
from factors.rotations import Matrix, Vector


@compiled
def coordinate_derivatives(e: Array, frame: Matrix, w: Vector, follows: bool) -> Array:
    """Derivatives of w with respect to P, V (columns 0-5) and G (columns 6-8): (3, 9).

    ``e`` begins with P (m) and V (m/s), ``frame`` is ecef_from_orbital, ``follows`` tells whether
    the frame belongs to these P and V (else it is constant and V has no effect).
    """
    d = np.zeros((3, 9))
    for i in range(3):
        x, y, z = frame[3 * i], frame[3 * i + 1], frame[3 * i + 2]
        d[0, 6 + i], d[1, 6 + i], d[2, 6 + i] = x, y, z
        d[0, i], d[1, i], d[2, i] = -x, -y, -z
    if follows:
        p = np.sqrt(e[0] ** 2 + e[1] ** 2 + e[2] ** 2)
        v3 = frame[2] * e[3] + frame[5] * e[4] + frame[8] * e[5]
        v2 = frame[1] * e[3] + frame[4] * e[4] + frame[7] * e[5]
        for i in range(3):
            x, y, z = frame[3 * i], frame[3 * i + 1], frame[3 * i + 2]
            d[0, i] += (w[1] * v3 / v2 - w[2]) / p * x
            d[1, i] -= (w[2] * y + w[0] * v3 / v2 * x) / p
            d[2, i] += (w[0] * x + w[1] * y) / p
            d[0, 3 + i] -= w[1] / v2 * x
            d[1, 3 + i] += w[0] / v2 * x
    return d
