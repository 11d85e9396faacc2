"""Film deformation as two scales, a skew and a turn (Ayhan 1996, eqs. 49, 51, 53 to 55), and as a matrix.

    (x', y') = A (x, y),    A = [ cos a, sin(a + b); -sin a, cos(a + b)] diag(lx, ly)

a turns the image, b is what the angle between its axes lacks of 90 degrees, lx and ly are their scales. Without
fiducial marks a is taken up by kappa (a = 0) and lx by the principal distance (lx = 1); then A - I = [0, A_p; 0, B_p],
the coefficients ``affinity_a`` and ``affinity_b``. b = 0 leaves two scales.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from factors._contract import Array

#: Parameters in order: rad, rad, 1, 1.
NAMES: Final = ("turn", "skew", "scale_x", "scale_y")


def matrix(parameters: Any) -> Any:
    """Matrix (2, 2) of turn, skew and scales; accepts complex numbers."""
    turn, skew, across, up = parameters
    return np.array([
        [across * np.cos(turn), up * np.sin(turn + skew)],
        [-across * np.sin(turn), up * np.cos(turn + skew)],
    ])  # fmt: skip


def matrix_derivatives(parameters: Array) -> Array:
    """Derivatives (2, 2, 4) of :func:`matrix`."""
    turn, skew, across, up = parameters
    out = np.zeros((2, 2, 4))
    out[:, 0, 0] = -across * np.sin(turn), -across * np.cos(turn)
    out[:, 0, 2] = np.cos(turn), -np.sin(turn)
    for j in (0, 1):
        out[:, 1, j] = up * np.cos(turn + skew), -up * np.sin(turn + skew)
    out[:, 1, 3] = np.sin(turn + skew), np.cos(turn + skew)
    return out


def parameters(film: Array) -> Array:
    """Turn, skew and scales (4,) of a matrix (2, 2)."""
    (xx, xy), (yx, yy) = film
    turn = np.arctan2(-yx, xx)
    return np.array([turn, np.arctan2(xy, yy) - turn, np.hypot(xx, yx), np.hypot(xy, yy)])


def parameter_derivatives(film: Array) -> Array:
    """Derivatives (4, 2, 2) of :func:`parameters`, for their covariance."""
    (xx, xy), (yx, yy) = film
    across, up = np.hypot(xx, yx), np.hypot(xy, yy)
    out = np.zeros((4, 2, 2))
    out[0, :, 0] = yx / across**2, -xx / across**2
    out[1, :, 1] = yy / up**2, -xy / up**2
    out[1] -= out[0]
    out[2, :, 0] = xx / across, yx / across
    out[3, :, 1] = xy / up, yy / up
    return out
