"""Map of an adjustment, for page and paper alike, its first view, and the data of the live drawings of a page.

The first view shows everything, or only the points where the footprints are so large that these would be a dot.

Live drawings: coordinates are Float32 in base64, little endian; a column that is one value everywhere is that value.
Words are JSON, with every character that could end the element written as an escape.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from fg_orient.report.chart import Chart, large, mapped, round_down, thousands
from fg_orient.report.words import signed
from fg_orient.result.record import Result

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Maximum number of points of a map on a page; a paper shows more.
MAX_POINTS: Final = 1500
#: Length of a large vector (90 % quantile) as a share of the width.
SHARE: Final = 0.07
#: Points that fill less than this share of the map of all footprints get their own view.
FILLED: Final = 0.4
#: Border around them, a share of the larger side of their extent.
BORDER: Final = 0.12
#: Minimum extent of a view, km.
LEAST_KM: Final = 0.1
KM_PER_DEGREE: Final = 111.2
#: Maximum number of image points in the page; of more the page contains a sample.
LIMIT: Final = 200_000
#: Seed of that sample.
SEED: Final = 1
#: Limit of flagged residuals, in their own sigmas.
FLAG: Final = 3.0
#: Order of the points in the page, and of the roles' numbers.
ROLES: Final = ("control", "check", "tie")


def shrink_at(lat_deg: float) -> float:
    """Length of a degree of longitude as a share of one of latitude."""
    return max(math.cos(math.radians(lat_deg)), 0.01)


def first_view(points_deg: Array, footprints_deg: Sequence[Array]) -> Array | None:
    """Corners of the first view, if it does not show everything.

    Parameters
    ----------
    points_deg : (n, 2) array
        Longitude and latitude of the points; rows with nan are ignored.
    footprints_deg : sequence of (k, 2) array
        Corners of the images.

    Returns
    -------
    (2, 2) array or None
        Lowest and highest longitude and latitude, degrees, border included; None where all is shown: there are no
        points, or they fill enough of the whole.
    """
    located = points_deg[np.isfinite(points_deg).all(axis=1)]
    if not len(located):
        return None
    everything = np.vstack([located, *footprints_deg])
    middle = 0.5 * (located.min(axis=0) + located.max(axis=0))
    km = KM_PER_DEGREE * np.array([shrink_at(float(middle[1])), 1.0])
    size, whole = (float((np.ptp(part, axis=0) * km).max()) for part in (located, everything))
    if size >= FILLED * whole:
        return None
    half = 0.5 * np.maximum(np.ptp(located, axis=0) * km, LEAST_KM) + BORDER * max(size, LEAST_KM)
    return np.stack([middle - half / km, middle + half / km])


def view_of(result: Result) -> Array | None:
    """First view of the points of a result; see :func:`first_view`."""
    return first_view(result.points.numbers("lon_deg", "lat_deg"), footprints(result.record))


def footprints(record: dict[str, Any]) -> list[Array]:
    """Corners (k, 2) of each image with a footprint: longitude and latitude in degrees."""
    corners_of = (np.array(image["footprint_lon_lat_deg"], float).reshape(-1, 2) for image in record["images"])
    return [corners for corners in corners_of if len(corners)]


def point_map(result: Result, *, up: bool = False, most: int | None = None) -> Chart | None:
    """Map of footprints and points with horizontal error vectors, or with bars of the errors in height.

    Parameters
    ----------
    result : Result
    up : bool
        Draw differences in height instead of horizontal ones.
    most : int, optional
        Number of points from which on tie points are thinned; default :data:`MAX_POINTS`.
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
    chart.x = replace(chart.x, words="longitude, WGS 84", write=lambda value: _degrees(value, "EW"))
    chart.y = replace(chart.y, words="latitude, WGS 84", write=lambda value: _degrees(value, "NS"))
    _footprints(chart, result.record)
    for role in ("tie", "control", "check"):
        mine = rows[roles[rows] == role]
        if len(mine):
            tips = [_tip(role, table.words["id"][k], enu[k]) for k in mine.tolist()]
            label = f"{role} ({int((roles[located] == role).sum())})"
            chart.add(
                "dots", role, place[mine, 0], place[mine, 1], label=label, tips=tips, vectors=vectors[mine], thick=up
            )
    km = float(np.ptp(chart.x.limits)) * shrink * KM_PER_DEGREE
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


def _thinned(rows: Index, tie: npt.NDArray[np.bool_], most: int) -> Index:
    """Rows, at most ``most``: control and check points before tie points."""
    if len(rows) <= most:
        return rows
    first, ties = rows[~tie], rows[tie]
    kept = first[:: max(1, math.ceil(len(first) / most))]
    room = most - len(kept)
    return np.append(kept, ties[:: math.ceil(len(ties) / room)]) if room > 0 and len(ties) else kept


def _footprints(chart: Chart, record: dict[str, Any]) -> None:
    """Add outlines of the images, and names at the upper corner of those that reach into the map."""
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


# --- data of the live drawings --------------------------------------------------------------------


@dataclass(frozen=True)
class Payload:
    """Data of the drawings of the script.

    Parameters
    ----------
    data : dict
        JSON, arrays packed.
    words : str
        Sentence on omitted image points; empty if there are none.
    """

    data: dict[str, Any]
    words: str

    def json(self) -> Markup:
        """Text of the data element; no character in it ends the element."""
        text = json.dumps(self.data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
        for sign in "<>&":
            text = text.replace(sign, f"\\u{ord(sign):04x}")
        return Markup(text)


def pack(values: npt.ArrayLike, kind: str = "f4") -> dict[str, Any]:
    """Pack a column as base64 of a little-endian typed array, or as its one value.

    Parameters
    ----------
    values : (n,) array
    kind : str
        ``f4``, ``u1``, ``u2`` or ``u4``.
    """
    column = np.ascontiguousarray(values, dtype=f"<{kind}")
    if len(column) > 1 and np.isfinite(column[0]) and (column == column[0]).all():
        return {"one": float(column[0]), "n": len(column)}
    return {"kind": kind, "n": len(column), "base64": base64.b64encode(column.tobytes()).decode()}


def payload(result: Result) -> Payload | None:
    """Pack points, footprints and image points; None for a block without geographic coordinates."""
    located = np.isfinite(result.points.figures["lon_deg"])
    if not located.any():
        return None
    rays, words = chosen_rays(result)
    place = {name: k for k, name in enumerate(result.points.words["id"])}
    of_ray = np.fromiter((place[result.residuals.words["id"][k]] for k in rays.tolist()), np.intp, len(rays))
    role = np.array([ROLES.index(word) if word in ROLES else 2 for word in result.points.words["role"]])
    if words:  # tie points without an image point in the page are left out
        seen = np.zeros(len(located), bool)
        seen[of_ray] = True
        located &= seen | (role < 2)
    points = np.flatnonzero(located)
    points = points[np.argsort(role[points], kind="stable")]
    number = np.full(len(located), -1, np.intp)
    number[points] = np.arange(len(points))
    drawn = number[of_ray] >= 0
    places = result.points.numbers("lon_deg", "lat_deg")
    everything, view = np.vstack([places, *footprints(result.record)]), view_of(result)
    centre = 0.5 * (np.nanmin(everything, axis=0) + np.nanmax(everything, axis=0))
    data = {
        "view": None if view is None else np.round(_kilometres(view, centre), 4).tolist(),
        "points": _point_columns(result, points, role[points], centre),
        "rays": _ray_columns(result, rays[drawn], number[of_ray[drawn]]),
        "images": [
            {"id": image["id"], "lines": image["n_lines"], "samples": image["n_samples"],
             "foot": np.round(_kilometres(np.array(image["footprint_lon_lat_deg"], float), centre), 4).tolist()}
            for image in result.record["images"]
        ],
        "centre": centre.tolist(), "kmPerDegree": [KM_PER_DEGREE * shrink_at(float(centre[1])), KM_PER_DEGREE],
        "roles": ROLES,
    }  # fmt: skip
    return Payload(data, words)


def chosen_rays(result: Result) -> tuple[Index, str]:
    """Rows of the image points in the page, and a sentence on those that are not; flagged ones before others."""
    n = len(result.residuals)
    if n <= LIMIT:
        return np.arange(n), ""
    ratio = np.nan_to_num(np.abs(result.normalised[0]).max(axis=1), nan=0.0)
    flagged, others = np.flatnonzero(ratio > FLAG), np.flatnonzero(ratio <= FLAG)
    room = max(LIMIT - len(flagged), 0)
    sample = np.random.default_rng(SEED).choice(others, min(room, len(others)), replace=False)
    rows = np.sort(np.append(flagged, sample))
    words = (
        f"The moving drawings hold {len(rows):,} of {n:,} image points: all {len(flagged):,} with a residual beyond "
        f"{FLAG:g} σ and a random sample of the others (seed {SEED}); all control and check points, and the tie points "
        "of these image points. The tables in the folder hold all."
    )
    return rows, words


def _kilometres(lon_lat_deg: Array, centre: Array) -> Array:
    """Kilometres East and North of the centre, equirectangular."""
    return np.asarray((lon_lat_deg - centre) * KM_PER_DEGREE * np.array([shrink_at(float(centre[1])), 1.0]))


def _point_columns(result: Result, rows: Index, role: Index, centre: Array) -> dict[str, Any]:
    """Columns of the points; differences of control and check points only, which come first."""
    table = result.points
    km = _kilometres(table.numbers("lon_deg", "lat_deg")[rows], centre)
    known = int(np.searchsorted(role, 2))
    out: dict[str, Any] = {"id": [table.words["id"][k] for k in rows.tolist()], "role": pack(role, "u1"),
                           "x": pack(km[:, 0]), "y": pack(km[:, 1])}  # fmt: skip
    for axis in ("east", "north", "up"):
        out[axis] = pack(table.figures[f"difference_{axis}_m"][rows[:known]])
        out[f"sigma_{axis}"] = pack(table.figures[f"sigma_{axis}_m"][rows])
    return out


def _ray_columns(result: Result, rows: Index, point: Index) -> dict[str, Any]:
    """Columns of the image points, those of an image together."""
    table = result.residuals
    image = table.codes("image", [facts["id"] for facts in result.record["images"]])[rows]
    order = np.argsort(image, kind="stable")
    rows, point, image = rows[order], point[order], image[order]
    columns = {"line": "line", "sample": "sample", "vl": "v_line_px", "vs": "v_sample_px"}
    own, tested = result.normalised[0][rows], result.normalised[1]
    return {
        "image": pack(image, "u2"), "point": pack(point, "u4"),
        **{name: pack(table.figures[column][rows]) for name, column in columns.items()},
        "wl": pack(own[:, 0]), "ws": pack(own[:, 1]), "tested": tested,
    }  # fmt: skip
