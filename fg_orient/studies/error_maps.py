"""Maps of the error vectors of points, in the arrangement of Terlemezoğlu 2019, Figs. 4.3 and 4.4."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from factors.arrays import Array
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.report.chart import Axis, Chart, cut, large, round_down, short
from fg_orient.studies.two_stage_results import AxisErrors

#: Length of a large vector as a share of the width of a map.
SHARE: Final = 0.12
KM: Final = 1e3
#: Maximum number of characters in the title of a small map.
NAME: Final = 30


class RoleErrors(NamedTuple):
    """Errors of the points of one role.

    Parameters
    ----------
    ids : tuple of str
    enu_m : (n, 3) array
        Computed minus measured, East, North, Up at the middle of the control points.
    rmse_m : float
        RMSE of the worst ECEF axis; nan if the points are not determined.
    """

    ids: Sequence[str]
    enu_m: Array
    rmse_m: float


def errors_of(block: Block, errors: AxisErrors) -> dict[str, RoleErrors]:
    """Return the errors of the published procedure by role: "control", "check"."""
    middle = block.points.known.ecef_m[block.points.where(Role.CONTROL)].mean(axis=0)
    lon, lat, _ = ecef_to_geodetic(middle)
    turn = enu_from_ecef(lon, lat).reshape(3, 3)
    roles = {"control": (errors.gcp_ids, errors.gcp_m, errors.gcp_rmse),
             "check": (errors.icp_ids, errors.icp_m, errors.icp_rmse)}  # fmt: skip
    return {role: RoleErrors(ids, -away @ turn.T, float(rmse.max()) if len(rmse) else math.nan)
            for role, (ids, away, rmse) in roles.items()}  # fmt: skip


def places_km(block: Block) -> dict[str, Array]:
    """Return east and north (2,) of a block's control and check points, km from their mean."""
    ids = [*np.array(block.points.ids)[block.points.where(Role.CONTROL)].tolist(), *block.withheld.ids]
    known = block.points.known.ecef_m[block.points.where(Role.CONTROL)]
    ecef = np.vstack([known, block.withheld.open().ecef_m.reshape(-1, 3)])
    middle = ecef.mean(axis=0)
    lon, lat, _ = ecef_to_geodetic(middle)
    enu = (ecef - middle) @ enu_from_ecef(lon, lat).reshape(3, 3).T
    return dict(zip(ids, enu[:, :2] / KM, strict=True))


def empty_map(place: Array, title: str) -> Chart:
    """Return an empty map with space for points (n, 2), km, and a legend."""
    low, high = place.min(axis=0), place.max(axis=0)
    half = 0.5 * 1.15 * float(max((high - low).max(), 1e-3))
    east, north = (0.5 * (low + high)).tolist()
    x = Axis("east, km", (east - half, east + half), about=4)
    y = Axis("north, km", (north - half, north + 1.3 * half), about=4)  # the upper limit leaves space for the legend
    return Chart(title, x, y, title=title, aspect=1.0)


def error_map(
    places: Mapping[str, Array], roles: Mapping[str, RoleErrors], title: str, *, numbers: bool = True
) -> Chart:  # fmt: skip
    """Draw horizontal error vectors at points (:func:`places_km`) with the RMSE of each role.

    With ``numbers``, the RMSE is in the legend. Otherwise it is in the map; this is for
    small maps with a common legend, which have a bar of length and no ticks. North is up.
    """
    chart = empty_map(np.array([*places.values()]), title if numbers else cut(title, NAME))
    drawn = [np.zeros((0, 2))]
    for role, one in roles.items():
        text = f"{short(one.rmse_m)} m" if math.isfinite(one.rmse_m) else "not determined"
        at = np.array([places[name] for name in one.ids]).reshape(-1, 2)
        vectors = one.enu_m.reshape(-1, 3)[:, :2]
        drawn.append(vectors)
        chart.add("dots", role, *at.T, label=f"{role}: {text}" if numbers else role, vectors=vectors)
    size = large(np.vstack(drawn))
    if math.isfinite(size) and size > 0.0:
        chart.per_width = size / SHARE
        unit = round_down(0.25 * chart.per_width)
        chart.bars = [(unit / chart.per_width, f"{unit:g} m")]
    if not numbers:
        _without_axes(chart, [one.rmse_m for one in roles.values()])
    return chart


def _without_axes(chart: Chart, rmse_m: Sequence[float]) -> None:
    """Replace the axes by a bar of length, and state the RMSE in the lower left corner."""
    west, east = chart.x.limits
    south, north = chart.y.limits
    length = round_down(0.3 * (east - west))
    words = " / ".join(short(value) if math.isfinite(value) else "–" for value in rmse_m)
    chart.x = Axis(limits=(west, east), about=0)
    chart.y = Axis(limits=(south - 0.3 * (north - south), north - 0.15 * (north - south)), about=0)
    chart.framed = False
    vectors = [(share, f"error {text}") for share, text in chart.bars]
    chart.bars = [(0.0, f"{words} m"), (length / (east - west), f"{length:g} km"), *vectors]
