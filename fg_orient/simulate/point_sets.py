"""The point sets of the published experiments: which of the 47 points are check points.

H-n ("homogeneous"): n check points drawn at random, nested, so that the check points of
H-10 are check points of H-20, too. G-A, G-B, G-C ("grouped"): the control points leave a
part of the image empty: of the scan line (G-A: those of one side by column), of the strip
(G-B: by line), of the border (G-C: those nearest to the centre of the block).
Sizes: Topan & Maktav 2010 and the authors' programs; memberships were never published.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.names import Role
from fg_orient.simulate.options import PointSet

Array = npt.NDArray[np.float64]

N_POINTS: Final = 47
#: Number of check points of each set.
CHECK_COUNT: Final[dict[PointSet, int]] = {
    "H-0": 0, "H-10": 10, "H-20": 20, "H-30": 30, "H-40": 40, "G-A": 24, "G-B": 23, "G-C": 30
}  # fmt: skip


def roles_of(point_set: PointSet, pixels: Array, rng: np.random.Generator) -> tuple[Role, ...]:
    """Role of each point.

    Parameters
    ----------
    point_set : str
    pixels : (n, 2) array
        Line and sample in the first image; only the grouped sets look at them.
    rng : np.random.Generator
        Draws the permutation of the H sets and the side of G-A and G-B; both are drawn
        whatever the set.
    """
    order, side = rng.permutation(len(pixels)), rng.choice([-1.0, 1.0])
    if point_set == "G-A":
        order = np.argsort(side * pixels[:, 1], kind="stable")
    elif point_set == "G-B":
        order = np.argsort(side * pixels[:, 0], kind="stable")
    elif point_set == "G-C":
        order = np.argsort(-np.linalg.norm(pixels - pixels.mean(axis=0), axis=1), kind="stable")
    check = set(order[: CHECK_COUNT[point_set]].tolist())
    return tuple(Role.CHECK if k in check else Role.CONTROL for k in range(len(pixels)))
