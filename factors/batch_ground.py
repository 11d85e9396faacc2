"""Ground points of a block as a whole: residuals of their own observations, and their movement."""

from __future__ import annotations

from factors._compile import threaded
from factors._contract import Array
from factors.batch_rows import Index, Small


@threaded
def control_squares(ground: Array, control: Array, observed: Index, out: Array) -> None:
    """Write the squared norms (m,) of the whitened residuals of observed ground points.

    Parameters
    ----------
    ground : (N, 3) array
    control : (N, 12) array
        W row-major and the observed coordinates.
    observed : (m,) int array
        Rows of both.
    """
    for k in range(len(observed)):
        j = observed[k]
        x, y, z = ground[j, 0] - control[j, 9], ground[j, 1] - control[j, 10], ground[j, 2] - control[j, 11]
        square = 0.0
        for r in range(0, 9, 3):
            residual = control[j, r] * x + control[j, r + 1] * y + control[j, r + 2] * z
            square += residual * residual
        out[k] = square


@threaded
def move(number: Small, step: Array, ground: Array) -> None:
    """Add steps (P, 3) to the ground points (N, 3) with these numbers (P,)."""
    for p in range(len(number)):
        for k in range(3):
            ground[number[p], k] += step[p, k]
