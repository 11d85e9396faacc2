"""Plan and elevations of a close-range result: points with error ellipses and vectors, camera stations.

Coordinates are any right-handed system in metres: no map projection, no north. Colours come from the style sheet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup, escape
from scipy.spatial import cKDTree

from fg_orient.closerange.report_words import length, round_length
from fg_orient.report.scale import round_down, thousands
from fg_orient.report.words import printable

Array = npt.NDArray[np.float64]
Box = tuple[float, float, float, float]

WIDTH: Final = 720.0
#: Tallest drawing; what is taller than wide is drawn smaller.
TALLEST: Final = 480.0
MARGIN: Final = 40.0
#: Length of a large ellipse or vector (90 % quantile) as a share of the width.
SHARE: Final = 0.035
#: The same, at most, as a share of the distance between neighbours, and at least, drawing units.
_APART: Final = 0.6
SHORTEST: Final = 5.0
#: More points than this are thinned, new ones first.
MAX_POINTS: Final = 800
#: Stations and points whose names are written.
MAX_NAMES: Final = 24
#: Width of a letter of a point's name, drawing units.
_LETTER: Final = 8.0
#: Views: words, and the axes across and up.
VIEWS: Final = (("Plan, X and Y", 0, 1), ("Elevation, X and Z", 0, 2), ("Elevation, Y and Z", 1, 2))
AXES: Final = "XYZ"
_MIXED: Final = {(0, 1): "cov_xy_m2", (0, 2): "cov_xz_m2", (1, 2): "cov_yz_m2"}
#: Points on the outline of an ellipse.
_OUTLINE: Final = 28


@dataclass(frozen=True, eq=False)
class Scene:
    """Points and stations of a record.

    Parameters
    ----------
    ids, roles : list of str
    at : (n, 3) array
    covariance : (n, 3, 3) array
        nan without.
    difference : (n, 3) array
        Adjusted minus given; nan without.
    stations : list of str
    centres, looks : (s, 3) arrays
        Projection centres and directions of view (nan without).
    station_sigma : (s, 3) array
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
    """Take points and stations out of a record of any kind."""
    points = record.get("points") or _control(record)
    at = _columns(points, *(f"{a}_m" for a in "xyz"))
    sigma = _columns(points, *(f"sigma_{a}_m" for a in "xyz"))
    covariance = np.full((len(points), 3, 3), np.nan)
    covariance[:, [0, 1, 2], [0, 1, 2]] = sigma**2
    for (i, j), name in _MIXED.items():
        covariance[:, i, j] = covariance[:, j, i] = _columns(points, name)[:, 0]
    photos = [p for p in record.get("photos") or record.get("stations") or [] if p.get("exterior")]
    centres = np.array([p["exterior"]["centre_m"] for p in photos], float).reshape(-1, 3)
    looks = [p["exterior"]["rotation"][2] if "rotation" in p["exterior"] else [np.nan] * 3 for p in photos]
    spread = [[np.nan if s is None else s for s in p["exterior"].get("sigma_centre_m", [None] * 3)] for p in photos]
    return Scene(
        [p["id"] for p in points], [p.get("role", "new") for p in points], at, covariance,
        _columns(points, *(f"difference_{a}_m" for a in "xyz")), [p["photo"] for p in photos], centres,
        np.array(looks, float).reshape(-1, 3), np.array(spread, float).reshape(-1, 3),
    )  # fmt: skip


def _control(record: dict[str, Any]) -> list[dict[str, Any]]:
    """Points of photos that were oriented one by one, each once."""
    rows = [row for photo in record.get("photos", []) for row in photo["points"]]
    return list({row["id"]: row for row in rows}.values())


def _columns(rows: list[dict[str, Any]], *names: str) -> Array:
    """Numbers (n, k) of rows; nan where there is none."""
    values = [[np.nan if row.get(name) is None else row[name] for name in names] for row in rows]
    return np.array(values, float).reshape(len(rows), len(names))


class Frame:
    """One view: metres across and up to drawing units.

    Parameters
    ----------
    places : (n, 2) array
        Everything that must be seen.
    """

    def __init__(self, places: Array) -> None:
        low, high = places.min(axis=0), places.max(axis=0)
        size = np.maximum(high - low, 1e-9)
        least = 0.02 * float(size.max())
        self.centre, size = 0.5 * (low + high), np.maximum(size, least)
        self.units = float(min((WIDTH - 2 * MARGIN) / size[0], (TALLEST - 2 * MARGIN) / size[1]))
        self.height = float(size[1]) * self.units + 2 * MARGIN

    def __call__(self, places: Array) -> Array:
        """Drawing coordinates (n, 2), y downwards."""
        out = (places - self.centre) * self.units * np.array([1.0, -1.0])
        return np.asarray(out + np.array([WIDTH / 2, self.height / 2]))


def views_of(scene: Scene) -> list[tuple[str, Markup]]:
    """Words and drawings: plan and elevations; a plan of the points alone where stations make them small."""
    out = [(words, view(scene, words, across, up)) for words, across, up in VIEWS]
    if len(scene.ids) and len(scene.centres):
        own = np.ptp(scene.at[:, :2], axis=0).max()
        whole = np.ptp(np.vstack([scene.at[:, :2], scene.centres[:, :2]]), axis=0).max()
        if own < 0.6 * whole:
            alone = replace(scene, stations=[], centres=np.zeros((0, 3)))
            out.insert(1, ("Plan of the points alone, X and Y", view(alone, "Plan of the points alone", 0, 1)))
    return [pair for pair in out if pair[1]]


def view(scene: Scene, words: str, across: int, up: int) -> Markup:
    """One view as SVG; empty without points.

    Parameters
    ----------
    scene : Scene
    words : str
        What it shows, for those who do not see it.
    across, up : int
        Axes, 0 to 2.
    """
    if not len(scene.ids):
        return Markup("")
    axes = [across, up]
    rows = _thinned(scene)
    frame = Frame(np.vstack([scene.at[rows][:, axes], scene.centres[:, axes]]))
    flat = scene.covariance[rows][:, axes][:, :, axes]
    vectors = scene.difference[rows][:, axes]
    drawn = frame(scene.at[rows][:, axes])
    enlarged = _enlargement(flat, vectors, drawn) / frame.units
    parts = [_axes(frame, across, up)]
    for place, covariance in zip(drawn, flat, strict=True):
        parts.append(_ellipse(place, covariance, enlarged * frame.units))
    named = sum(role != "new" for role in scene.roles) <= MAX_NAMES
    for k, place, vector in zip(rows, drawn, vectors * enlarged * frame.units, strict=True):
        parts.append(_point(scene, int(k), place, vector * np.array([1.0, -1.0])))
    taken = _symbols(scene, rows, drawn, frame(scene.centres[:, axes]))
    parts += _names(scene, rows, drawn, taken) if named else []
    parts += _stations(scene, frame, axes, taken)
    parts.append(_foot(frame, scene, enlarged, len(scene.ids) - len(rows)))
    return Markup('<svg class="map" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>').format(
        WIDTH, round(frame.height + (94.0 if enlarged > 0.0 else 62.0), 1), words, Markup("").join(parts)
    )


def _thinned(scene: Scene) -> npt.NDArray[np.intp]:
    """Rows that are drawn: all control and check points, new ones as many as fit."""
    new = np.array([role == "new" for role in scene.roles])
    rows, others = np.flatnonzero(new), np.flatnonzero(~new)
    room = max(MAX_POINTS - len(others), 1)
    return np.sort(np.append(others, rows[:: max(1, math.ceil(len(rows) / room))])).astype(np.intp)


def _enlargement(covariance: Array, vectors: Array, drawn: Array) -> float:
    """Drawing units per metre of error, so that a large ellipse or vector has a good length; 0 without any."""
    size = np.sqrt(np.maximum(np.trace(covariance, axis1=1, axis2=2), 0.0))
    lengths = np.concatenate([size, np.linalg.norm(vectors, axis=1)])
    lengths = lengths[np.isfinite(lengths) & (lengths > 0.0)]
    if not len(lengths):
        return 0.0
    good = min(WIDTH * SHARE, max(_APART * _distance(drawn), SHORTEST))
    return good / float(np.quantile(lengths, 0.9))


def _distance(drawn: Array) -> float:
    """Distance of the points (n, 2) from their next one, median; the width of the drawing where there is one only."""
    if len(drawn) < 2:
        return WIDTH
    return float(np.median(np.asarray(cKDTree(drawn).query(drawn, 2)[0], float)[:, 1]))


def _ellipse(place: Array, covariance: Array, scale: float) -> Markup:
    """Standard ellipse about a place; nothing where there is no covariance."""
    if scale <= 0.0 or not np.isfinite(covariance).all() or not covariance.any():
        return Markup("")
    values, vectors = np.linalg.eigh(covariance)
    turn = np.linspace(0.0, 2.0 * np.pi, _OUTLINE, endpoint=False)
    half = scale * np.sqrt(np.maximum(values, 0.0))
    outline = place + (np.stack([np.cos(turn), np.sin(turn)], axis=1) * half) @ vectors.T * np.array([1.0, -1.0])
    return Markup('<path class="ellipse" d="M{}z"/>').format("L".join(f"{x:.1f} {y:.1f}" for x, y in outline.tolist()))


def _point(scene: Scene, k: int, place: Array, vector: Array) -> Markup:
    """A point with its vector and its tip, which tells its name."""
    x, y = (round(float(v), 1) for v in place)
    role, name = scene.roles[k], printable(scene.ids[k])
    symbol = {
        "control": f'<path class="control" d="M{x} {round(y - 5.7, 1)}l5 8.6h-10z"/>',
        "check": f'<circle class="check" cx="{x}" cy="{y}" r="4"/>',
    }.get(role, f'<circle class="tie" cx="{x}" cy="{y}" r="1.8"/>')
    line = ""
    if np.isfinite(vector).all() and vector.any():
        line = (
            f'<line class="vector {escape(role)}" x1="{x}" y1="{y}" x2="{x + vector[0]:.1f}" y2="{y + vector[1]:.1f}"/>'
        )
    spread: Array = np.sqrt(scene.covariance[k].diagonal())
    told = [f"{axis} {v:.4f} m" + ("" if np.isnan(s) else f" ± {length(float(s))}")
            for axis, v, s in zip(AXES, scene.at[k], spread, strict=True)]  # fmt: skip
    if np.isfinite(scene.difference[k]).all() and scene.difference[k].any():
        told.append("adjusted minus given " + ", ".join(length(float(v)) for v in scene.difference[k]))
    return Markup(f"<g><title>{escape(f'{role} {name}: ' + '; '.join(told))}</title>{line}{symbol}</g>")


def _symbols(scene: Scene, rows: npt.NDArray[np.intp], drawn: Array, stations: Array) -> list[Box]:
    """Boxes of control points, check points and stations: no name may cover them."""
    known = [place for k, place in zip(rows, drawn.tolist(), strict=True) if scene.roles[k] != "new"]
    sized = [(5.0, known), (6.0, stations.tolist())]
    return [(x - half, x + half, y - half, y + half) for half, places in sized for x, y in places]


def _names(scene: Scene, rows: npt.NDArray[np.intp], drawn: Array, taken: list[Box]) -> list[Markup]:
    """Names of control and check points at the first of four corners where nothing in ``taken`` stands; adds them."""
    kept = [(printable(scene.ids[k]), x, y) for k, (x, y) in zip(rows, drawn.tolist(), strict=True)
            if scene.roles[k] != "new"]  # fmt: skip
    out = []
    for name, x, y in kept:
        length = _LETTER * len(name)
        for left, base in ((x + 7, y - 5), (x - 7 - length, y - 5), (x + 7, y + 15), (x - 7 - length, y + 15)):
            box = (left, left + length, base - 11.0, base + 3.0)
            if left >= 0.0 and left + length <= WIDTH and _free(box, taken):
                taken.append(box)
                anchor, at = ("start", x + 7) if left > x else ("end", x - 7)
                out.append(Markup('<text class="name" x="{}" y="{}" text-anchor="{}">{}</text>').format(
                    round(at, 1), round(base, 1), anchor, name))  # fmt: skip
                break
    return out


def _free(box: Box, taken: list[Box]) -> bool:
    """Tell whether a box (left, right, top, bottom) covers none of the others."""
    return all(box[0] > b or box[1] < a or box[2] > d or box[3] < c for a, b, c, d in taken)


def _stations(scene: Scene, frame: Frame, axes: list[int], taken: list[Box]) -> list[Markup]:
    """Projection centres as squares with the direction of view, their names where there are few and nothing stands."""
    places = frame(scene.centres[:, axes]).round(1).tolist()
    names: list[Markup] = []
    out: list[Markup] = []
    for k, (x, y) in enumerate(places):
        look = scene.looks[k][axes]
        view_line = Markup("")
        if np.isfinite(look).all():
            view_line = Markup('<path class="look" d="M{} {}l{} {}"/>').format(
                x, y, f"{26.0 * look[0]:.1f}", f"{-26.0 * look[1]:.1f}")  # fmt: skip
        sigma = scene.station_sigma[k]
        told = [f"{axis} {v:.4f} m" + ("" if np.isnan(s) else f" ± {length(float(s))}")
                for axis, v, s in zip(AXES, scene.centres[k], sigma, strict=True)]  # fmt: skip
        name = printable(scene.stations[k]) or "photo"
        if len(scene.stations) <= MAX_NAMES:
            names.append(_label(x, y, name, taken, frame.height, look[1] > 0.0))
        out.append(Markup('<g><title>{}</title>{}<path class="station" d="M{} {}h9v9h-9z"/></g>').format(
            f"station {name}: {'; '.join(told)}", view_line, round(x - 4.5, 1), round(y - 4.5, 1)))  # fmt: skip
    return [*names, *out]


def _label(x: float, y: float, name: str, taken: list[Box], height: float, below: bool) -> Markup:
    """A name above or below its place (first ``below``), where no other stands; none where neither is free."""
    half = 4.6 * len(name) + 4.0
    middle = min(max(x, half), WIDTH - half)
    for at in (y + 20, y - 10) if below else (y - 10, y + 20):
        box = (middle - half, middle + half, at - 13.0, at + 3.0)
        if _free(box, taken) and 14.0 < at < height:
            taken.append(box)
            return Markup('<text class="label" x="{}" y="{}" text-anchor="middle">{}</text>').format(
                round(middle, 1), round(at, 1), name)  # fmt: skip
    return Markup("")


def _axes(frame: Frame, across: int, up: int) -> Markup:
    """Arrows of both axes in the lower left corner."""
    y = round(frame.height - 6.0, 1)
    return Markup('<path class="bar-line" d="M10 {}h34m-6 -4l6 4l-6 4M10 {}v-34m-4 6l4 -6l4 6"/>'
                  '<text class="small" x="48" y="{}">{}</text><text class="small" x="14" y="{}">{}</text>').format(
        y, y, y + 4, AXES[across], y - 36, AXES[up])  # fmt: skip


def _foot(frame: Frame, scene: Scene, enlarged: float, left_out: int) -> Markup:
    """Legend and scale bars below the drawing."""
    y = frame.height + 24.0
    parts, x = [], 24.0
    for role, word, symbol in (
        ("control", "control", '<path class="control" d="M{} {}l5 8.6h-10z"/>'),
        ("check", "check", '<circle class="check" cx="{}" cy="{}" r="4"/>'),
        ("new", "new", '<circle class="tie" cx="{}" cy="{}" r="1.8"/>'),
    ):
        if role in scene.roles:
            parts.append(Markup(symbol).format(x, round(y - (9 if role == "control" else 4), 1)))
            parts.append(Markup('<text x="{}" y="{}">{}</text>').format(x + 11, y, word))
            x += 105.0
    if scene.stations:
        parts.append(Markup('<path class="station" d="M{} {}h9v9h-9z"/><text x="{}" y="{}">station</text>').format(
            x - 4, round(y - 9, 1), x + 11, y))  # fmt: skip
    metres = round_down(0.2 * WIDTH / frame.units)
    parts.append(_bar(24.0, y + 26.0, metres * frame.units, round_length(metres)))
    if enlarged > 0.0:
        size = round_down(0.12 * WIDTH / (enlarged * frame.units))
        text = f"{round_length(size)} error, enlarged {thousands(enlarged)} times"
        parts.append(_bar(24.0, y + 60.0, size * enlarged * frame.units, text))
    if left_out:
        parts.append(Markup('<text class="small" x="700" y="{}" text-anchor="end">{} new points are not drawn</text>')
                     .format(y + 26.0, left_out))  # fmt: skip
    return Markup("").join(parts)


def _bar(x: float, y: float, size: float, text: str) -> Markup:
    return Markup('<path class="bar-line" d="M{} {}v5h{}v-5"/><text x="{}" y="{}">{}</text>').format(
        x, round(y - 5, 1), round(size, 1), round(x + size + 10.0, 1), round(y + 3.0, 1), text
    )
