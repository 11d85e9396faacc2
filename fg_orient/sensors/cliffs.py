"""Cliffs in elevation models that land does not have: probably an undeclared nodata value among plausible heights."""

from __future__ import annotations

from typing import Final

import numpy as np

from factors.arrays import Array

#: Steps between neighbouring cells that land does not have: height, m, and height over distance (80 degrees).
CLIFF_M: Final = 200.0
CLIFF_SLOPE: Final = 5.7
#: Least number of such steps with one value.
CLIFFS: Final = 4


def cliff_of(heights: Array, cell_m: tuple[float, float]) -> tuple[float, float, tuple[int, int]] | None:
    """Value of cells that form steps to their neighbours which land does not have, the largest step and its cell.

    Parameters
    ----------
    heights : (rows, columns) array
        Heights, m; nan is no height.
    cell_m : (float, float)
        Distances of neighbouring cells, down and across, m.

    Returns
    -------
    (float, float, (int, int)) or None
        None if there are no such cells: fewer than ``CLIFFS`` steps, or no value that half of them have on one side.
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
