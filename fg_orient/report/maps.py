"""Map of an adjustment, for page and paper, and its first view.

The first view shows everything. If the footprints are so large that the points would look like a dot, it
shows only the points.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.report.chart import Chart, large, mapped, round_down, thousands
from fg_orient.report.words import signed
from fg_orient.result.record import Result

#: Maximum number of points of a map on a page; a paper shows more.
MAX_POINTS: Final = 1500
#: Length of a large vector (90 % quantile) as a share of the width.
SHARE: Final = 0.07
#: If the points fill less than this share of the map of all footprints, the first view shows only the points.
FILLED: Final = 0.4
#: Width of the border around the points, as a share of the larger side of their extent.
BORDER: Final = 0.12
#: Minimum extent of a view: of a map, km, and of an image, px.
LEAST_KM: Final = 0.1
LEAST_PX: Final = 100.0
KM_PER_DEGREE: Final = 111.2


def km_per_degree(record: Mapping[str, Any]) -> float:
    """Return the kilometres per degree of latitude on the body of a result."""
    body = record.get("body")
    return KM_PER_DEGREE if body is None else math.radians(1e-3 * sum(body["radii_m"]) / 3.0)


def shrink_at(lat_deg: float) -> float:
    """Return the length of a degree of longitude divided by a degree of latitude."""
    return max(math.cos(math.radians(lat_deg)), 0.01)


def first_view(points_deg: Array, footprints_deg: Sequence[Array], of_degree: float = KM_PER_DEGREE) -> Array | None:
    """Return the corners of the first view, or None if it shows everything.

    Parameters
    ----------
    points_deg : (n, 2) array
        Longitude and latitude of the points; rows with nan are ignored.
    footprints_deg : sequence of (k, 2) array
        Corners of the images.
    of_degree : float
        Kilometres of a degree of latitude.

    Returns
    -------
    (2, 2) array or None
        Lowest and highest longitude and latitude, degrees, including the border. None if there are no points,
        or if they fill enough of the whole map.
    """
    located = points_deg[np.isfinite(points_deg).all(axis=1)]
    if not len(located):
        return None
    everything = np.vstack([located, *footprints_deg])
    km = of_degree * np.array([shrink_at(0.5 * float(located[:, 1].min() + located[:, 1].max())), 1.0])
    view = _around(located * km, everything * km, LEAST_KM)
    return None if view is None else view / km


def image_view(places_px: Array, size_px: Array) -> Array | None:
    """Return the corners of the first view of an image, or None if it shows the whole image.

    Parameters
    ----------
    places_px : (n, 2) array
        Sample and line of the image points; all finite.
    size_px : (2,) array
        Samples and lines of the image; zero if they are unknown.

    Returns
    -------
    (2, 2) array or None
        Lowest and highest sample and line, px, including the border; see :func:`first_view`.
    """
    if not len(places_px):
        return None
    return _around(places_px, np.vstack([places_px, np.zeros(2), size_px]), LEAST_PX)


def _around(points: Array, everything: Array, least: float) -> Array | None:
    """Return the corners of a view of points (n, 2) with a border; None if they fill enough of everything (m, 2)."""
    extent = np.ptp(points, axis=0)
    if extent.max() >= FILLED * np.ptp(everything, axis=0).max():
        return None
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    half = 0.5 * np.maximum(extent, least) + BORDER * max(float(extent.max()), least)
    return np.stack([middle - half, middle + half])


def view_of(result: Result) -> Array | None:
    """Return the first view of the points of a result; see :func:`first_view`."""
    return first_view(
        result.points.numbers("lon_deg", "lat_deg"), footprints(result.record), km_per_degree(result.record)
    )


def footprints(record: dict[str, Any]) -> list[Array]:
    """Return the corners (k, 2) of each image with a footprint: longitude and latitude in degrees."""
    corners_of = (np.array(image["footprint_lon_lat_deg"], float).reshape(-1, 2) for image in record["images"])
    return [corners for corners in corners_of if len(corners)]


def point_map(result: Result, *, up: bool = False, most: int | None = None) -> Chart | None:
    """Return a map of footprints and points with horizontal error vectors, or with bars for errors in height.

    Parameters
    ----------
    result : Result
    up : bool
        Draw differences in height instead of horizontal ones.
    most : int, optional
        If there are more points than this, some tie points are omitted; default :data:`MAX_POINTS`.
    """
    table = result.points
    place = table.numbers("lon_deg", "lat_deg")
    located = np.flatnonzero(np.isfinite(place).all(axis=1))
    if not len(located):
        return None
    roles = np.array([role if role in ("control", "check") else "tie" for role in table.words["role"]])
    rows = _thinned(located, roles[located] == "tie", MAX_POINTS if most is None else most)
    enu = table.numbers("difference_east_m", "difference_north_m", "difference_up_m")
    vectors = np.stack([np.zeros(len(enu)), enu[:, 2]], axis=1) if up else enu[:, :2]
    view = view_of(result)
    everything = np.vstack([place[rows], *footprints(result.record)]) if view is None else view
    shrink = shrink_at(float(everything[:, 1].min() + everything[:, 1].max()) / 2.0)
    words = "Up errors at control and check points" if up else "Points and horizontal errors"
    chart = mapped(words, everything, shrink, per_width=large(vectors[rows]) / SHARE)
    where = (result.record.get("body") or {"name": "WGS 84"})["name"]
    chart.x = replace(chart.x, words=f"longitude, {where}", write=lambda value: _degrees(value, "EW"))
    chart.y = replace(chart.y, words=f"latitude, {where}", write=lambda value: _degrees(value, "NS"))
    _footprints(chart, result.record)
    for role in ("tie", "control", "check"):
        mine = rows[roles[rows] == role]
        if len(mine):
            # with many points, the texts for the pointer would need more space in the page than the points
            every = len(rows) == len(located)
            tips = [_tip(role, table.words["id"][k], enu[k]) for k in mine.tolist()] if every else []
            label = f"{role} ({int((roles[located] == role).sum())})"
            chart.add(
                "dots", role, place[mine, 0], place[mine, 1], label=label, tips=tips, vectors=vectors[mine], thick=up
            )
    km = float(np.ptp(chart.x.limits)) * shrink * km_per_degree(result.record)
    ground = round_down(0.2 * km)
    chart.bars = [(ground / km, f"{ground:g} km on the ground" if ground >= 1.0 else f"{ground * 1000.0:g} m")]
    if chart.per_width:
        size, what = round_down(0.2 * chart.per_width), "Up error" if up else "horizontal error"
        times = thousands(1000.0 * km / chart.per_width)
        chart.bars.append((size / chart.per_width, f"{size:g} m {what}, enlarged {times} times"))
    chart.note = f"{len(located) - len(rows)} points are not drawn" if len(rows) < len(located) else ""
    return chart


def _degrees(value: float, ends: str) -> str:
    text = f"{abs(value):.4f}".rstrip("0").rstrip(".")
    return f"{text}°{ends[0] if value >= 0.0 else ends[1]}"


def _tip(role: str, name: str, enu_m: Array) -> str:
    axes = zip(("east", "north", "up"), enu_m.tolist(), strict=True)
    given = [f"{axis} {signed(value)} m" for axis, value in axes if not math.isnan(value)]
    return f"{role} {name}" + (": " + ", ".join(given) if given else "")


def _thinned(rows: Index, tie: Mask, most: int) -> Index:
    """Return at most ``most`` rows: control and check points before tie points."""
    if len(rows) <= most:
        return rows
    first, ties = rows[~tie], rows[tie]
    kept = first[:: max(1, math.ceil(len(first) / most))]
    room = most - len(kept)
    return np.append(kept, ties[:: math.ceil(len(ties) / room)]) if room > 0 and len(ties) else kept


def _footprints(chart: Chart, record: dict[str, Any]) -> None:
    """Add outlines of the images, and the names of the images inside the map at their upper corners."""
    low, high = np.array([chart.x.limits, chart.y.limits]).T
    names, places = [], []
    for image in record["images"]:
        corners = np.array(image["footprint_lon_lat_deg"], float).reshape(-1, 2)
        if not len(corners):
            continue
        chart.add("area", "foot", *corners.T)
        if (corners.max(axis=0) >= low).all() and (corners.min(axis=0) <= high).all():
            names.append(str(image["id"]))
            places.append(np.clip(corners[np.argmax(corners[:, 1])], low, high))
    if names:
        chart.add("names", "label", *np.array(places).T, tips=names)
