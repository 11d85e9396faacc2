"""Ground points of a block as a whole: residuals of their own observations, and their movement."""

from __future__ import annotations

from factors._compile import threaded
from factors._contract import Array
from factors.conditions.control import POINT
from fg_orient.kernels.batch_rows import Index, Small


@threaded
def control_squares(ground: Array, control: Array, observed: Index, out: Array) -> None:
    """Write the squared norms (m,) of the whitened residuals of observed ground points.

    Parameters
    ----------
    ground : (N, 3) array
    control : (N, 12) array
        Records of observed points, ``factors.conditions.control.POINT``.
    observed : (m,) int array
        Rows of both.
    """
    for k in range(len(observed)):
        j = observed[k]
        x, y = ground[j, 0] - control[j, POINT.x], ground[j, 1] - control[j, POINT.y]
        z = ground[j, 2] - control[j, POINT.z]
        r1 = control[j, POINT.w11] * x + control[j, POINT.w12] * y + control[j, POINT.w13] * z
        r2 = control[j, POINT.w21] * x + control[j, POINT.w22] * y + control[j, POINT.w23] * z
        r3 = control[j, POINT.w31] * x + control[j, POINT.w32] * y + control[j, POINT.w33] * z
        out[k] = r1 * r1 + r2 * r2 + r3 * r3


@threaded
def move(number: Small, step: Array, ground: Array) -> None:
    """Add steps (P, 3) to the ground points (N, 3) with these numbers (P,)."""
    for p in range(len(number)):
        for k in range(3):
            ground[number[p], k] += step[p, k]
