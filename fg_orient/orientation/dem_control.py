"""Elevation model as control: the heights of points above the model are observations.

Each observation has the value zero and a sigma. The model is replaced by a plane at the last position of the
point (``factors.conditions.control``). The planes are read again at the adjusted positions until the points
no longer move. These observations determine the height of a block that has few control points and tie points
on open ground. On slopes they also determine the position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from factors.conditions.control import HEIGHT, HEIGHT_CONTROL
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.orientation.orient import adjust
from fg_orient.orientation.solution import Solution
from fg_orient.sensors.correction import HeightSurface

__all__ = ["DemAdjustment", "adjust_with_dem"]


#: Half the distance over which slopes are computed; maximum number of rounds; largest movement of a point in the last
#: round.
SLOPE_M: Final = 1.0
MAX_ROUNDS: Final = 10
REST_M: Final = 1e-3


@dataclass(frozen=True)
class DemAdjustment:
    """Result of :func:`adjust_with_dem`: solution of the last of ``rounds`` adjustments, the first without the model.

    ``ids`` are the points with observed heights, ``outside`` points without a height in the model ``dem``; ``height_m``
    (n,) adjusted heights above the model, ``sigma_m`` the standard deviation of a height. ``moved_m`` is the largest
    movement of a point in the last round; above 1 mm the points are still moving.
    """

    solution: Solution
    dem: str
    ids: tuple[str, ...]
    outside: tuple[str, ...]
    height_m: Array
    sigma_m: float
    rounds: int
    moved_m: float

    @property
    def at_rest(self) -> bool:
        """True if the points no longer move."""
        return self.moved_m <= REST_M

    def as_dict(self) -> dict[str, Any]:
        """Return the entry ``dem_control`` of ``result.json``."""
        h = self.height_m
        return {
            "dem": self.dem,
            "sigma_m": self.sigma_m,
            "n": len(self.ids),
            "outside": list(self.outside),
            "rounds": self.rounds,
            "at_rest": self.at_rest,
            "moved_m": self.moved_m,
            "mean_m": float(h.mean()),
            "rms_m": float(np.sqrt(np.mean(h**2))),
            "max_m": float(np.abs(h).max()),
        }


def adjust_with_dem(
    block: Block, dem: HeightSurface, sigma_m: float, *, roles: Sequence[Role] = (Role.TIE,), **options: Any
) -> DemAdjustment:
    """Adjust a block with heights of its points as observations from an elevation model.

    Parameters
    ----------
    block : Block
    dem : HeightSurface
        Ellipsoidal heights, such as ``RasterDem("dem.tif")``.
    sigma_m : float
        Standard deviation of a height of the model at a point.
    roles : sequence of Role
        Roles of the points; coordinates of check points stay sealed.
    **options
        Options of :func:`fg_orient.adjust`; the backends graph and dense accept these observations.

    Returns
    -------
    DemAdjustment

    Raises
    ------
    InputError
        Invalid sigma, no point on the model, or a block that cannot be adjusted.
    """
    if not (np.isfinite(sigma_m) and sigma_m > 0.0):
        raise InputError.of("dem_control.sigma", place="sigma_m", value=sigma_m)
    wanted = np.flatnonzero([role in roles for role in block.points.roles])
    solution = adjust(block, **options)
    moved, rounds = np.inf, 1
    while rounds < MAX_ROUNDS and moved > REST_M:
        ground = solution.ground_m
        used, extra = height_observations(block, dem, sigma_m, ground, wanted, solution.problem.origin_m)
        if not len(used):
            raise InputError.of("dem_control.no_point", file=dem.path, value=f"{len(wanted)} points")
        solution = adjust(replace(block, extra=(*block.extra, *extra)), **options)
        moved, rounds = float(np.linalg.norm(solution.ground_m[used] - ground[used], axis=1).max()), rounds + 1
    lon, lat, h = ecef_to_geodetic(solution.ground_m[used])
    names = block.points.ids
    return DemAdjustment(
        solution,
        dem.path,
        tuple(names[j] for j in used),
        tuple(names[j] for j in np.setdiff1d(wanted, used)),
        h - dem.height_m(lon, lat),
        float(sigma_m),
        rounds,
        moved,
    )


def height_observations(
    block: Block, dem: HeightSurface, sigma_m: float, ground_m: Array, points: Index, origin_m: Array
) -> tuple[Index, tuple[ExtraObservation, ...]]:
    """Return the points (m,) with observed heights above the planes of an elevation model, and their observations.

    Parameters
    ----------
    block : Block
    dem : HeightSurface
    sigma_m : float
    ground_m : (n, 3) array
        Coordinates of all points of the block, ECEF m; nan if unknown.
    points : (k,) int array
        Points to observe; points without coordinates, height or slope are excluded.
    origin_m : (3,) array
        Local origin of the ground unknowns (``Problem.origin_m``).
    """
    placed = points[np.isfinite(ground_m[points]).all(axis=1)]
    at = np.ascontiguousarray(ground_m[placed])
    lon, lat, h = ecef_to_geodetic(at)
    axes = enu_from_ecef(lon, lat)
    above = h - dem.height_m(lon, lat)
    slope = np.empty((len(placed), 2))
    for k in range(2):
        ends = [dem.height_m(*ecef_to_geodetic(at + sign * SLOPE_M * axes[:, k])[:2]) for sign in (-1.0, 1.0)]
        slope[:, k] = (ends[1] - ends[0]) / (2.0 * SLOPE_M)
    good = np.flatnonzero(np.isfinite(above) & np.isfinite(slope).all(axis=1))
    up = axes[:, 2]
    normal = up - slope[:, :1] * axes[:, 0] - slope[:, 1:] * axes[:, 1]
    foot = at - above[:, None] * up - origin_m
    extra = tuple(
        ExtraObservation(
            HEIGHT_CONTROL,
            (f"point:{block.points.ids[placed[j]]}",),
            HEIGHT.pack(normal=normal[j] / sigma_m, place=foot[j]),
            np.zeros((2, 0)),
            1,
            f"height of point {block.points.ids[placed[j]]} from the DEM",
        )
        for j in good
    )
    return placed[good], extra
