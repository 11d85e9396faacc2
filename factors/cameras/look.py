"""Look angles of a sample, from a table or polynomials, and their viewing direction.

The viewing direction is ``u1 = (-tan psi_y, tan psi_x, -1)`` in the body frame: x right of flight, y forward, z outward
(docs/equations.md 2; the printed third component +1 points into space). Between detectors the tangents are linear, not
the angles.
"""

from __future__ import annotations

import numpy as np

from factors._contract import Array


def from_table(sample_grid: Array, tan_psi_x: Array, tan_psi_y: Array, sample: Array) -> tuple[Array, Array]:
    """Return look angles psi_x, psi_y (rad) at N samples.

    Beyond the table its first and last segments are continued.
    """
    s = np.asarray(sample, float)
    k = np.clip(np.searchsorted(sample_grid, s, side="right") - 1, 0, len(sample_grid) - 2)
    f = (s - sample_grid[k]) / (sample_grid[k + 1] - sample_grid[k])
    ends = [(tangent[k], tangent[k + 1]) for tangent in (tan_psi_x, tan_psi_y)]
    psi_x, psi_y = (np.arctan(low + f * (high - low)) for low, high in ends)
    return psi_x, psi_y


def from_polynomial(tan_psi_x: Array, tan_psi_y: Array, origin_sample: float, sample: Array) -> tuple[Array, Array]:
    """Return look angles psi_x, psi_y (rad) at N samples from polynomials of ``sample - origin_sample``."""
    d = np.asarray(sample, float) - origin_sample
    return (
        np.arctan(np.polynomial.polynomial.polyval(d, tan_psi_x)),
        np.arctan(np.polynomial.polynomial.polyval(d, tan_psi_y)),
    )


def direction(psi_x_rad: Array, psi_y_rad: Array) -> Array:
    """Return the unnormalised viewing direction in the body frame: (N,), (N,) -> (N, 3)."""
    return np.stack([-np.tan(psi_y_rad), np.tan(psi_x_rad), -np.ones_like(psi_x_rad)], axis=1)
