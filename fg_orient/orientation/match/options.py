"""Options of tie point matching; each field is the only declaration of its option (``fg_orient.model.options``).

The types are read at run time, so this module does not import ``annotations`` from ``__future__``.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal

from fg_orient.model.declaration import Checked, Group, documented, option

SEARCH: Final = Group("Search")
POINTS: Final = Group("Points")

# fmt: off


@documented
@dataclass(frozen=True)
class MatchOptions(Checked):
    """Options of matching; the prior sigmas of the orientation come from the project."""

    lowest_m: float | None = option(
        None, SEARCH, "Lowest ellipsoidal height of the ground.", within=(-12000.0, 10000.0), unit="m",
        left_out="the lowest height of the RPC, else 1000 m below the scenes", spelled="lowest",
    )
    highest_m: float | None = option(
        None, SEARCH, "Highest ellipsoidal height of the ground.", within=(-12000.0, 10000.0), unit="m",
        left_out="the highest height of the RPC, else 3000 m above the scenes", spelled="highest",
    )
    dem_sigma_m: float = option(
        20.0, SEARCH, "Standard deviation of the heights of a DEM that restricts the search.", unit="m",
        within=(0.1, 10000.0),
    )
    ratio: float = option(
        0.85, SEARCH, "Largest ratio of descriptor distances, best to second best candidate (Lowe 2004).",
        below=1.0,
    )
    window: int = option(
        15, POINTS, "Lines and samples of the windows of least-squares matching; odd.", within=(9, 61),
    )
    model: Literal["slope", "curved", "affine", "shift"] = option(
        "slope", POINTS,
        "Geometric unknowns of a window. slope: position, and slope of the ground along the epipolar line (the sensor "
        "models give the rest of the affine map); curved: the curvature of the ground, too; affine: position and whole "
        "map; shift: position.",
    )
    correlation: float = option(
        0.7, POINTS, "Smallest correlation of the grey values of a window after matching.", below=1.0,
    )
    cells: int = option(20, POINTS, "Cells along each side of an image, for an even distribution.", within=(1, 200))
    points_per_cell: int = option(
        60, POINTS, "Largest number of points in a cell and a pair of images.", within=(1, math.inf),
        spelled="per-cell",
    )
    distance_px: float = option(
        6.0, POINTS, "Smallest distance of points in an image.", within=(0.0, 1000.0), unit="px",
    )
    sigma_px: float | None = option(
        None, POINTS, "Sigma of all image points, instead of the sigmas of least-squares matching.", unit="px",
        within=(0.001, 100.0), left_out="the sigma of each point, from its covariance and an estimated factor",
    )
