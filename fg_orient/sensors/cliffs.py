"""Find unnatural cliffs in elevation models; they probably come from an undeclared nodata value."""

from __future__ import annotations

from typing import Final

import numpy as np

from factors.arrays import Array

#: A step between neighbouring cells is unnatural if its height, m, and its slope (80 degrees) exceed these limits.
CLIFF_M: Final = 200.0
CLIFF_SLOPE: Final = 5.7
#: Minimum number of such steps with the same value.
CLIFFS: Final = 4


def cliff_of(heights: Array, cell_m: tuple[float, float]) -> tuple[float, float, tuple[int, int]] | None:
    """Find a value whose cells have unnatural steps to their neighbours.

    Return the value, the largest step, m, and its cell.

    Parameters
    ----------
    heights : (rows, columns) array
        Heights, m; nan marks cells without a height.
    cell_m : (float, float)
        Distances between neighbouring cells, down and across, m.

    Returns
    -------
    (float, float, (int, int)) or None
        None if there are fewer than ``CLIFFS`` steps, or if no value occurs on one side of half of the steps.
    """
    steps, ends = [], []
    for axis, distance in enumerate(cell_m):
        step = np.diff(heights, axis=axis)
        with np.errstate(invalid="ignore"):
            at = np.argwhere(np.abs(step) > max(CLIFF_M, CLIFF_SLOPE * distance))
        steps.append(np.abs(step[tuple(at.T)]))
        ends.append(np.stack([at, at + np.eye(2, dtype=int)[axis]]))
    step, end = np.concatenate(steps), np.concatenate(ends, axis=1)
    if len(step) < CLIFFS:
        return None
    values, counts = np.unique(heights[tuple(end.reshape(-1, 2).T)], return_counts=True)
    value = values[np.argmax(counts)]
    if counts.max() < max(CLIFFS, 0.5 * len(step)):
        return None
    own = heights[end[..., 0], end[..., 1]] == value
    k = int(np.argmax(np.where(own.any(axis=0), step, 0.0)))
    row, column = end[0 if own[0, k] else 1, k].tolist()
    return float(value), float(step[k]), (row, column)
