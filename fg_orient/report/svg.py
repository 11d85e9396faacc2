"""Drawings of the report as SVG text: map of points with error vectors, singular values.

Colours come from the style sheet of the page (classes), so that light and dark both work.
Everything written into the drawing is escaped by markupsafe.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup, escape

from fg_orient.report.extent import KM_PER_DEGREE, view_of
from fg_orient.report.scale import round_down, thousands
from fg_orient.report.words import signed
from fg_orient.result.record import Result

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

WIDTH: Final = 720.0
MARGIN: Final = 14.0
FOOT: Final = 108.0
#: More points than this are thinned, tie points first: the report must stay small.
MAX_POINTS: Final = 1500
#: Singular values are drawn for so many images; the table beside lists all.
MAX_IMAGES: Final = 40
#: Length of a large error vector (90 % quantile) as a share of the map's width.
VECTOR_SHARE: Final = 0.07
#: Widths of a letter and heights of a line of the names of images, drawing units.
LETTER: Final = (9.0, 18.0)


class MapFrame:
    """Equirectangular map: longitude, latitude (degrees) to drawing units, North up.

    Parameters
    ----------
    lon_lat_deg : (n, 2) array
        Everything that must be visible.
    """

    def __init__(self, lon_lat_deg: Array) -> None:
        low, high = lon_lat_deg.min(axis=0), lon_lat_deg.max(axis=0)
        self._centre = 0.5 * (low + high)
        self._shrink = max(math.cos(math.radians(float(self._centre[1]))), 0.01)
        size = np.maximum((high - low) * KM_PER_DEGREE * np.array([self._shrink, 1.0]), 1e-3)
        self.km_to_units = min((WIDTH - 2 * MARGIN) / float(size[0]), (WIDTH - 2 * MARGIN) / float(size[1]))
        self.height = float(size[1]) * self.km_to_units + 2 * MARGIN

    def __call__(self, lon_lat_deg: Array) -> Array:
        """Drawing coordinates (n, 2), y downwards."""
        km = (np.atleast_2d(lon_lat_deg) - self._centre) * KM_PER_DEGREE * np.array([self._shrink, 1.0])
        return np.stack(
            [WIDTH / 2 + km[:, 0] * self.km_to_units, self.height / 2 - km[:, 1] * self.km_to_units], axis=1
        )


def point_map(result: Result, *, up: bool = False) -> Markup:
    """Map of footprints and points with horizontal error vectors, or with bars of the Up errors.

    Parameters
    ----------
    result : Result
    up : bool
        Draw Up differences as vertical bars instead of horizontal vectors.

    Returns
    -------
    Markup
        An ``<svg>`` element; the exaggeration is written into it.
    """
    table = result.points
    located = np.flatnonzero(np.isfinite(table.figures["lon_deg"]))
    if not len(located):
        return Markup("<p>No point has coordinates.</p>")
    rows = _thinned(located, np.array([role == "tie" for role in table.words["role"]])[located])
    left_out = len(located) - len(rows)
    place = table.numbers("lon_deg", "lat_deg")[rows]
    error = table.numbers("difference_east_m", "difference_north_m", "difference_up_m")[rows]
    feet = [np.array(image["footprint_lon_lat_deg"], float) for image in result.record["images"]]
    view = view_of(result.record, table.numbers("lon_deg", "lat_deg"))
    frame = MapFrame(np.vstack([place, *feet]) if view is None else view)
    vectors = np.stack([np.zeros(len(rows)), error[:, 2]], axis=1) if up else error[:, :2]
    scale = _vector_scale(vectors)
    names = [image["id"] for image in result.record["images"]]
    drawn_feet = [(name, frame(corners)) for name, corners in zip(names, feet, strict=True)]
    parts = (
        [_footprint(name, corners, k) for k, (name, corners) in enumerate(drawn_feet)]
        if view is None
        else _clipped_footprints(drawn_feet, frame.height)
    )
    drawn = frame(place)
    roles, ids = ([table.words[name][k] for k in rows.tolist()] for name in ("role", "id"))
    for k, vector in enumerate(vectors * scale * np.array([1.0, -1.0])):
        parts.append(_point(roles[k], ids[k], error[k], drawn[k], vector, up))
    exaggeration = scale / frame.km_to_units * 1000.0
    parts.append(_foot(frame, scale, exaggeration, up, left_out))
    title = "Up errors at control and check points" if up else "Points and horizontal errors"
    return Markup('<svg class="map" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>').format(
        WIDTH, round(frame.height + FOOT, 1), title, Markup("").join(parts)
    )


def _thinned(rows: Index, tie: npt.NDArray[np.bool_]) -> Index:
    """At most MAX_POINTS rows: control and check points before tie points."""
    if len(rows) <= MAX_POINTS:
        return rows
    first, ties = rows[~tie], rows[tie]
    kept = first[:: max(1, math.ceil(len(first) / MAX_POINTS))]
    room = MAX_POINTS - len(kept)
    return np.append(kept, ties[:: math.ceil(len(ties) / room)]) if room > 0 and len(ties) else kept


def _vector_scale(vectors: Array) -> float:
    """Drawing units per metre of error, so that a large error has a good length; 0 without errors."""
    lengths = np.linalg.norm(vectors[np.isfinite(vectors).all(axis=1)], axis=1)
    lengths = lengths[lengths > 0.0]
    if not len(lengths):
        return 0.0
    return WIDTH * VECTOR_SHARE / float(np.quantile(lengths, 0.9))


def _footprint(name: str, corners: Array, k: int) -> Markup:
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    at = corners[np.argmin(corners[:, 1])] if k % 2 == 0 else corners[np.argmax(corners[:, 1])]
    shift = 16.0 if k % 2 == 0 else -8.0
    towards = float(np.clip(at[0], 60.0, WIDTH - 60.0))
    return Markup(
        '<polygon class="foot" points="{}"/><text class="label" x="{}" y="{}" text-anchor="middle">{}</text>'
    ).format(text, round(towards, 1), round(float(at[1]) + shift, 1), name)


def _clipped_footprints(feet: Sequence[tuple[str, Array]], height: float) -> list[Markup]:
    """Footprints that reach beyond the map, cut at its border; their names stand inside it, one below the other."""
    outlines = [
        Markup('<polygon class="foot" points="{}"/>').format(" ".join(f"{x:.1f},{y:.1f}" for x, y in corners))
        for _, corners in feet
    ]
    inner = Markup('<svg x="0" y="0" width="{}" height="{}">{}</svg>').format(
        WIDTH, round(height, 1), Markup("").join(outlines)
    )
    taken: list[tuple[float, float, float]] = []
    names = []
    for name, corners in feet:
        if (corners.max(axis=0) < 0.0).any() or (corners.min(axis=0) > np.array([WIDTH, height])).any():
            continue  # nothing of it is seen
        wide, top = LETTER[0] * len(name), corners[np.argmin(corners[:, 1])]
        x, y = float(np.clip(top[0], 6.0 + wide / 2, WIDTH - 6.0 - wide / 2)), max(float(top[1]) + 16.0, 18.0)
        while any(abs(y - t[1]) < LETTER[1] and abs(x - t[0]) < (wide + t[2]) / 2 + 6.0 for t in taken):
            y += LETTER[1]
        taken.append((x, y, wide))
        names.append(Markup('<text class="label" x="{}" y="{}" text-anchor="middle">{}</text>').format(
            round(x, 1), round(y, 1), name))  # fmt: skip
    return [inner, *names]


def _point(role: str, name: str, error_m: Array, at: Array, vector: Array, up: bool) -> Markup:
    """A point with its tip; numbers are written as they are, words are escaped."""
    x, y = round(float(at[0]), 1), round(float(at[1]), 1)
    symbol = {
        "control": f'<path class="control" d="M{x} {round(y - 5.7, 1)}l5 8.6h-10z"/>',
        "check": f'<circle class="check" cx="{x}" cy="{y}" r="4"/>',
    }.get(role, f'<circle class="tie" cx="{x}" cy="{y}" r="1.8"/>')
    line = ""
    if np.isfinite(vector).all() and np.any(vector != 0.0):
        kind = ("bar " if up else "vector ") + role
        ends = round(x + float(vector[0]), 1), round(y + float(vector[1]), 1)
        line = f'<line class="{escape(kind)}" x1="{x}" y1="{y}" x2="{ends[0]}" y2="{ends[1]}"/>'
    axes = zip(("east", "north", "up"), error_m.tolist(), strict=True)
    given = [f"{axis} {signed(value)} m" for axis, value in axes if not math.isnan(value)]
    tip = escape(f"{role} {name}" + (": " + ", ".join(given) if given else ""))
    return Markup(f"<g><title>{tip}</title>{line}{symbol}</g>")


def _foot(frame: MapFrame, scale: float, exaggeration: float, up: bool, left_out: int) -> Markup:
    """Legend and scale bars below the map."""
    y = frame.height + 18.0
    km = round_down(0.2 * WIDTH / frame.km_to_units)
    parts = [
        Markup('<path class="control" d="M22 {}l5 8.6h-10z"/><text x="34" y="{}">control</text>').format(y - 9, y),
        Markup('<circle class="check" cx="152" cy="{}" r="4"/><text x="162" y="{}">check</text>').format(y - 4, y),
        Markup('<circle class="tie" cx="262" cy="{}" r="1.8"/><text x="270" y="{}">tie</text>').format(y - 4, y),
        _bar(24.0, y + 24.0, km * frame.km_to_units, f"{km:g} km on the ground" if km >= 1 else f"{km * 1000:g} m"),
    ]
    if scale > 0.0:
        metres = round_down(0.2 * WIDTH / scale)
        what = "Up error" if up else "horizontal error"
        parts.append(
            _bar(24.0, y + 58.0, metres * scale, f"{metres:g} m {what}, enlarged {thousands(exaggeration)} times")
        )
    if left_out:
        parts.append(Markup('<text x="340" y="{}">{} points are not drawn</text>').format(y, left_out))
    return Markup("").join(parts)


def _bar(x: float, y: float, length: float, text: str) -> Markup:
    path = f"M{x:.1f} {y - 5:.1f}v5h{length:.1f}v-5"
    return Markup('<path class="bar-line" d="{}"/><text x="{}" y="{}">{}</text>').format(
        path, round(x + length + 10.0, 1), round(y + 3.0, 1), text
    )


def singular_values(images: Sequence[dict[str, Any]]) -> Markup:
    """Singular values of each image on a logarithmic axis, with the limits of weak and dead."""
    every = [v for image in images for v in image["singular_values"] if v and v > 0.0]
    if not every:
        return Markup("")
    low, high = -8.0, max(2.0, math.ceil(math.log10(max(every))))
    images = images[:MAX_IMAGES]
    left, right, row = 110.0, WIDTH - 16.0, 26.0
    bottom = row * len(images) + 10.0

    def position(value: float) -> float:
        return round(left + (right - left) * (max(math.log10(max(value, 10.0**low)), low) - low) / (high - low), 1)

    parts = []
    for limit, text in ((1e-5, "dead"), (1.0, "weak")):
        x = position(limit)
        parts.append(Markup('<line class="limit" x1="{}" y1="0" x2="{}" y2="{}"/>').format(x, x, bottom))
        parts.append(Markup('<text class="small" x="{}" y="{}" text-anchor="end">{} below</text>').format(
            x - 4, bottom + 30, text))  # fmt: skip
    for k, image in enumerate(images):
        y = row * k + 16.0
        name = image["image"] if len(image["image"]) <= 14 else image["image"][:13] + "…"
        parts.append(Markup('<text x="0" y="{}">{}</text>').format(y + 4, name))
        parts += [Markup('<circle class="sv" cx="{}" cy="{}" r="3.5"/>').format(position(v or 0.0), y)
                  for v in image["singular_values"]]  # fmt: skip
    for power in range(int(low), int(high) + 1, 2):
        label = ("≤ " if power == low else "") + f"1e{power}"
        parts.append(Markup('<text class="small" x="{}" y="{}" text-anchor="middle">{}</text>').format(
            position(10.0**power), bottom + 14, label))  # fmt: skip
    return Markup('<svg class="map" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>').format(
        WIDTH, bottom + 36, escape("singular values per image"), Markup("").join(parts)
    )
