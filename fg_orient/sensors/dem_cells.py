"""Group near positions by cells of an elevation model, interpolate between knots, and limit the sizes of caches."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.model.machine import allowed_bytes

#: Maximum share of the memory limit of a run for the caches of an elevation model.
MEMORY_SHARE: Final = 0.125


def groups(row: npt.NDArray[Any], column: npt.NDArray[Any], edge: int) -> list[Index]:
    """Group positions (n,) of a raster by squares of ``edge`` cells."""
    down, across = (np.asarray(part, float) // edge for part in (row, column))
    _, number = np.unique(down * (1.0 + np.ptp(across)) + across, return_inverse=True)
    order = np.argsort(number, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(number[order])) + 1)


def bilinear(knots: list[Array], values: Array, at: list[Array]) -> Array:
    """Interpolate values on the grid ``at`` from the grid of ``knots``."""
    rows = np.stack([np.interp(at[1], knots[1], row) for row in values])
    return np.stack([np.interp(at[0], knots[0], column) for column in rows.T], axis=1)


def share(memory_limit_gb: float | None, usual_bytes: int) -> float:
    """Return how much of the usual sizes of the caches the memory limit allows, as a share of at most 1."""
    allowed = allowed_bytes(memory_limit_gb)
    return 1.0 if allowed is None else min(1.0, MEMORY_SHARE * allowed / usual_bytes)
