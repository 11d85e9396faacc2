"""Charts of close range in space: points with error ellipses and vectors, stations; deviations from a surface.

Coordinates belong to any right-handed system in metres. There is no map projection and no north direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.closerange.report_words import length, photo_rows, round_length
from fg_orient.report.chart import Axis, Chart, broad, large, mapped, round_down, thousands
from fg_orient.report.words import printable

TALLEST: Final = 480.0
MARGIN: Final = 40.0
#: Length of a large ellipse or vector (90 % quantile) as a share of the width.
SHARE: Final = 0.035
#: Largest length of an ellipse or vector as a share of the distance between neighbours, and
#: smallest length as a share of the width.
_APART: Final = 0.6
SHORTEST: Final = 0.007
#: Maximum number of drawn points; new points are thinned first.
MAX_POINTS: Final = 800
#: Maximum number of stations and points whose names are written.
MAX_NAMES: Final = 24
#: Views: name, horizontal axis and vertical axis.
VIEWS: Final = (("Plan, X and Y", 0, 1), ("Elevation, X and Z", 0, 2), ("Elevation, Y and Z", 1, 2))
AXES: Final = "XYZ"
_MIXED: Final = {(0, 1): "cov_xy_m2", (0, 2): "cov_xz_m2", (1, 2): "cov_yz_m2"}
#: Number of points on the outline of an ellipse.
_OUTLINE: Final = 28
#: Length of a direction of view as a share of the width.
_LOOK: Final = 0.04
#: Radii of the smallest and of the largest deviation, drawing units; steps of their colours.
SMALLEST: Final = 1.5
LARGEST: Final = 11.0
_STEPS: Final = 5
#: An axis of a quadric counts as open if its curvature is below this share of the largest curvature.
_FLAT: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Scene:
    """Points and stations of a record; nan for missing values.

    ``at`` (n, 3) with ``covariance`` (n, 3, 3) and ``difference`` (n, 3), adjusted minus
    given. Projection ``centres`` (s, 3) with ``looks`` (s, 3), the viewing directions,
    and ``station_sigma`` (s, 3).
    """

    ids: list[str]
    roles: list[str]
    at: Array
    covariance: Array
    difference: Array
    stations: list[str]
    centres: Array
    looks: Array
    station_sigma: Array


def scene_of(record: dict[str, Any]) -> Scene:
    """Extract points and stations from a record of any kind."""
    points = record.get("points") or list({row["id"]: row for row in photo_rows(record)}.values())
    at = columns(points, *(f"{a}_m" for a in "xyz"))
    sigma = columns(points, *(f"sigma_{a}_m" for a in "xyz"))
    covariance = np.full((len(points), 3, 3), np.nan)
    covariance[:, [0, 1, 2], [0, 1, 2]] = sigma**2
    for (i, j), name in _MIXED.items():
        covariance[:, i, j] = covariance[:, j, i] = columns(points, name)[:, 0]
    photos = [p for p in record.get("photos") or record.get("stations") or [] if p.get("exterior")]
    nothing = {"rotation": [[None] * 3] * 3, "sigma_centre_m": [None] * 3}
    exterior = [nothing | p["exterior"] for p in photos]
    centres, looks, spread = (
        np.array(rows, float).reshape(-1, 3)
        for rows in (
            [e["centre_m"] for e in exterior],
            [e["rotation"][2] for e in exterior],
            [e["sigma_centre_m"] for e in exterior],
        )
    )
    return Scene(
        [p["id"] for p in points],
        [p.get("role", "new") for p in points],
        at,
        covariance,
        columns(points, *(f"difference_{a}_m" for a in "xyz")),
        [p["photo"] for p in photos],
        centres,
        looks,
        spread,
    )


def columns(rows: list[dict[str, Any]], *names: str) -> Array:
    """Return the numbers (n, k) of rows; nan for None or a missing name."""
    values = [[row.get(name) for name in names] for row in rows]
    return np.array(values, float).reshape(len(rows), len(names))


def views_of(scene: Scene) -> list[tuple[str, Chart]]:
    """Return descriptions and charts: plan, elevations, and a plan without stations if they make points small."""
    if not len(scene.ids):
        return []
    out = [(words, view(scene, words, across, up)) for words, across, up in VIEWS]
    if len(scene.centres):
        own = np.ptp(scene.at[:, :2], axis=0).max()
        whole = np.ptp(np.vstack([scene.at[:, :2], scene.centres[:, :2]]), axis=0).max()
        if own < 0.6 * whole:
            alone = replace(scene, stations=[], centres=np.zeros((0, 3)))
            out.insert(1, ("Plan of the points alone, X and Y", view(alone, "Plan of the points alone", 0, 1)))
    return out


def view(scene: Scene, words: str, across: int, up: int) -> Chart:
    """Return one view of points and stations.

    Parameters
    ----------
    scene : Scene
    words : str
        Description of the view for readers who cannot see it.
    across, up : int
        Axes of the drawing, 0 to 2 for X, Y, Z.
    """
    axes = [across, up]
    rows = _thinned(scene)
    at, vectors = scene.at[rows][:, axes], scene.difference[rows][:, axes]
    flat = scene.covariance[rows][:, axes][:, :, axes]
    chart = _frame(words, np.vstack([at, scene.centres[:, axes]]), across, up)
    chart.per_width = _per_width(flat, vectors, at, float(np.ptp(chart.x.limits)))
    enlarged = float(np.ptp(chart.x.limits)) / chart.per_width if chart.per_width else 0.0
    for place, covariance in zip(at, flat, strict=True):
        if enlarged and np.isfinite(covariance).all() and covariance.any():
            chart.add("area", "ellipse", *_ellipse(place, covariance, enlarged).T)
    roles = np.array(scene.roles)[rows]
    for role, kind in (("new", "tie"), ("control", "control"), ("check", "check")):
        mine = np.flatnonzero(roles == role)
        if len(mine):
            tips = [
                _tip(
                    f"{role} {printable(scene.ids[k])}",
                    scene.at[k],
                    np.sqrt(scene.covariance[k].diagonal()),
                    scene.difference[k],
                )
                for k in rows[mine]
            ]
            chart.add("dots", kind, *at[mine].T, label=role, tips=tips, vectors=vectors[mine])
    known = np.flatnonzero(roles != "new")
    if 0 < len(known) <= MAX_NAMES:
        names = [printable(scene.ids[rows[k]]) for k in known]
        chart.add("names", "name", *at[known].T, tips=names)
    _stations(chart, scene, axes)
    if enlarged:
        size = round_down(0.12 * chart.per_width)
        text = f"{round_length(size)} error, enlarged {thousands(enlarged)} times"
        chart.bars.append((size / chart.per_width, text))
    chart.note = f"{len(scene.ids) - len(rows)} new points are not drawn" if len(rows) < len(scene.ids) else ""
    return chart


def _frame(words: str, places: Array, across: int, up: int) -> Chart:
    """Return the view without points, with a scale bar."""
    chart = mapped(words, places, tallest=TALLEST, margin=MARGIN)
    chart.x, chart.y = replace(chart.x, words=f"{AXES[across]}, m"), replace(chart.y, words=f"{AXES[up]}, m")
    chart.title = words
    wide = float(np.ptp(chart.x.limits))
    metres = round_down(0.2 * wide)
    chart.bars = [(metres / wide, f"{round_length(metres)}; {AXES[across]} to the right, {AXES[up]} up")]
    return chart


def _thinned(scene: Scene) -> Index:
    """Select the rows that are drawn: all control and check points, and new points up to the limit."""
    new = np.array([role == "new" for role in scene.roles])
    rows, others = np.flatnonzero(new), np.flatnonzero(~new)
    room = max(MAX_POINTS - len(others), 1)
    return np.sort(np.append(others, rows[:: max(1, math.ceil(len(rows) / room))])).astype(np.intp)


def _per_width(covariance: Array, vectors: Array, at: Array, wide: float) -> float:
    """Return the error in metres that is drawn as long as the view is wide; 0 without any."""
    from scipy.spatial import cKDTree

    size = np.sqrt(np.maximum(np.trace(covariance, axis1=1, axis2=2), 0.0))
    longest = large(np.concatenate([np.stack([size, 0.0 * size], axis=1), vectors]))
    distance = np.inf if len(at) < 2 else float(np.median(np.asarray(cKDTree(at).query(at, 2)[0], float)[:, 1]))
    return longest / min(SHARE, max(_APART * distance / wide, SHORTEST))


def _ellipse(place: Array, covariance: Array, scale: float) -> Array:
    """Return the outline (n, 2) of the enlarged standard ellipse about a place."""
    values, vectors = np.linalg.eigh(covariance)
    half = scale * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(place + (_circle(_OUTLINE) * half) @ vectors.T)


def _tip(name: str, at: Array, sigma: Array, difference: Array) -> str:
    """Return the name, coordinates with standard deviations, and adjusted minus given."""
    parts = [
        f"{axis} {v:.4f} m" + ("" if np.isnan(s) else f" ± {length(float(s))}")
        for axis, v, s in zip(AXES, at, sigma, strict=True)
    ]
    if np.isfinite(difference).all() and difference.any():
        parts.append("adjusted minus given " + ", ".join(length(float(v)) for v in difference))
    return f"{name}: {'; '.join(parts)}"


def _stations(chart: Chart, scene: Scene, axes: list[int]) -> None:
    """Add projection centres as squares with the viewing direction, and their names if there are few."""
    if not len(scene.centres):
        return
    names = [printable(name) or "photo" for name in scene.stations]
    tips = [
        _tip(f"station {name}", at, sigma, np.zeros(3))
        for name, at, sigma in zip(names, scene.centres, scene.station_sigma, strict=True)
    ]
    at = scene.centres[:, axes]
    ends = at + _LOOK * float(np.ptp(chart.x.limits)) * scene.looks[:, axes]
    for start, end in zip(at, ends, strict=True):
        if np.isfinite(end).all():
            chart.add("line", "look", *np.stack([start, end]).T)
    chart.add("dots", "station", *at.T, label="station", tips=tips)
    if len(names) <= MAX_NAMES:
        chart.add("names", "label", *at.T, tips=names)


# --- deviations from a surface ---------------------------------------------------------------------


def deviation_views(record: dict[str, Any]) -> list[tuple[str, Chart]]:
    """Return the words and charts of three views with the normal distances of the points from a surface."""
    return [(words, _deviations(record, words, across, up)) for words, across, up in VIEWS]


def _deviations(record: dict[str, Any], words: str, across: int, up: int) -> Chart:
    """Return one view: colour shows the sign of a distance.

    Its strength and the radius show the size.
    """
    points, axes = record["points"], [across, up]
    at = columns(points, *(f"{a}_m" for a in "xyz"))[:, axes]
    distance = columns(points, "distance_m")[:, 0]
    rim = outline(record["surface"], axes)
    chart = _frame(f"deviations: {words}", np.vstack([at, rim]), across, up)
    if len(rim):
        chart.add("area", "outline", *rim.T)
    largest = float(np.abs(distance).max()) or 1.0
    share = np.abs(distance) / largest
    step = np.maximum(1, np.ceil(share * _STEPS)).astype(int)
    for k in range(_STEPS, 0, -1):  # small disks are drawn last, so that they stay visible
        for sign, word in (("p", "+"), ("m", "−")):
            mine = np.flatnonzero((step == k) & ((distance >= 0.0) == (sign == "p")))
            tips = [_deviation_tip(points[n]) for n in mine.tolist()]
            label = f"to {word}{length(k / _STEPS * largest)}" if len(mine) and k in (2, _STEPS) else ""
            chart.add(
                "dots",
                f"deviation {sign}{k}",
                *at[mine].T,
                label=label,
                tips=tips,
                sizes=SMALLEST + (LARGEST - SMALLEST) * np.sqrt(share[mine]),
            )
    if len(points) <= MAX_NAMES:
        chart.add("names", "name", *at.T, tips=[printable(p["id"]) for p in points])
    return chart


def _deviation_tip(point: dict[str, Any]) -> str:
    along = "; ".join(f"{a.upper()} {length(point[f'deviation_{a}_m'])}" for a in "xyz")
    return f"{printable(point['id'])}: normal distance {length(point['distance_m'])}; along {along}"


def outline(surface: dict[str, Any], axes: list[int]) -> Array:
    """Return the outline (n, 2) of a closed surface (``Surface.as_dict``) in axes across and up.

    The outline of an open quadric is empty.
    """
    from fg_orient.closerange.surface import Surface

    coefficients = np.array(surface["coefficients"] or [], float)
    form = Surface(surface["kind"], surface["centre_m"], surface["semi_axes_m"], surface["rotation"], coefficients)
    central = form.conditions.central(_FLAT)
    if central is None or (central[1] <= 0.0).any():
        return np.zeros((0, 2))
    middle, squares, directions = central
    shape = (directions * squares) @ directions.T
    half = np.linalg.cholesky(shape[np.ix_(axes, axes)])
    return np.asarray((form.centre + middle)[axes] + _circle(72) @ half.T)


def _circle(n: int) -> Array:
    """Return the points (n, 2) of the unit circle."""
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def distance_histogram(record: dict[str, Any]) -> Chart:
    """Return the histogram of the normal distances, mm."""
    values = 1e3 * columns(record["points"], "distance_m")[:, 0]
    reach = 1.05 * (float(np.abs(values).max()) or 1.0)
    counts, edges = np.histogram(values, np.linspace(-reach, reach, min(21, 2 * math.ceil(math.sqrt(len(values))) + 1)))
    chart = broad(
        "histogram of the normal distances",
        Axis("normal distance, mm", (-reach, reach), about=6),
        Axis("points", (0.0, 1.1 * max(float(counts.max()), 1.0)), about=4, whole=True),
        220.0,
    )
    chart.add("bars", "column", edges, counts)
    chart.upright("zero", 0.0)
    return chart
