"""What the data do not tell of observations on board: shifts and drifts of strips, lever arm and boresight, in words.

Directions of the block without priors that are determined worse than their prior sigma are held by the priors. The
share of such directions in an unknown says how far it is one of them; from :data:`HELD` on it is named.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem
from fg_orient.sensors.frame import NAVIGATION

Array = npt.NDArray[np.float64]

#: Share of an unknown in the directions that the priors hold: two strips that shift together have a half each.
HELD: Final = 0.4
#: Beginning of the names of what belongs together, in words, why it is held, and what helps.
_KINDS: Final = (
    ("gnss_shift", "shift of the receiver", "the whole block moves with it", "measure control points"),
    ("gnss_drift", "drift of the receiver", "the block is stretched or turned with it",
     "measure control points at both ends of the strip, or fly a cross strip"),
    ("ins_shift", "shift of the attitude", "the boresight, or a turn of the block, looks the same",
     "fly strips to and fro, or measure control points"),
    ("ins_drift", "drift of the attitude", "the block bends or turns with it",
     "measure control points at both ends of the strip, or more tie points between strips"),
    ("lever", "lever arm", "a shift of the receiver or of the block looks the same",
     "measure it on the ground, or fly to and fro with control points"),
    ("boresight", "boresight", "the shift of the attitude, or a turn of the block, looks the same",
     "fly strips to and fro, or measure control points"),
)  # fmt: skip


def held_on_board(problem: Problem, values: Array, directions: Array, limit: float) -> tuple[str, ...]:
    """One sentence per strip and kind of unknown that the priors hold.

    Parameters
    ----------
    problem : Problem
    values : (k,) array
        Singular values of the block without priors, prior sigmas.
    directions : (k, u) array
        Rows: their directions of the free image unknowns.
    limit : float
        Directions below it are held by the priors.
    """
    ties = problem.ties
    share = np.sum(directions[values < limit] ** 2, axis=0)
    held: dict[tuple[str, str], list[str]] = {}
    for k, (image, p) in enumerate(zip(problem.block.images, problem.parameters, strict=True)):
        for j, name in enumerate(p.names):
            wide = int(problem.first[k]) + j
            free = wide if ties is None else int(ties.of[wide])
            if name not in NAVIGATION or share[free] < HELD:
                continue
            kind, _, axis = name.rpartition("_")
            axes = held.setdefault((p.shared[j] if p.shared and p.shared[j] else f"image {image.id}", kind), [])
            if axis not in axes:
                axes.append(axis)
    words = {kind: rest for kind, *rest in _KINDS}
    return tuple(
        f"{who}: {words[kind][0]} ({', '.join(axes)}) is held by its prior: {words[kind][1]}; {words[kind][2]}"
        for (who, kind), axes in held.items()
    )
