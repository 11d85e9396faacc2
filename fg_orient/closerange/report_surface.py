"""Deviations of points from a surface: views with the surface's outline, coloured and sized by normal distance."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from fg_orient.closerange.report_maps import AXES, MAX_NAMES, VIEWS, WIDTH, Frame
from fg_orient.closerange.report_words import length, round_length
from fg_orient.closerange.surface import Surface
from fg_orient.report.panel import Panel, ticks
from fg_orient.report.scale import round_down
from fg_orient.report.words import printable

Array = npt.NDArray[np.float64]

#: Radii of the smallest and of the largest deviation, drawing units.
SMALLEST: Final = 1.5
LARGEST: Final = 11.0
#: An axis of a quadric with less than this of the largest curvature is open.
_FLAT: Final = 1e-6
#: Strengths of a colour, as in the heat maps.
_STEPS: Final = 5


def deviation_views(record: dict[str, Any]) -> list[tuple[str, Markup]]:
    """Words and drawing of three views."""
    points = record["points"]
    at = np.array([[p[f"{a}_m"] for a in "xyz"] for p in points])
    distance = np.array([p["distance_m"] for p in points])
    return [(words, _view(record, points, at, distance, words, across, up)) for words, across, up in VIEWS]


def _view(
    record: dict[str, Any], points: list[dict[str, Any]], at: Array, distance: Array, words: str, across: int, up: int
) -> Markup:
    axes = [across, up]
    rim = outline(record["surface"], axes)
    frame = Frame(np.vstack([at[:, axes], rim]))
    largest = float(np.abs(distance).max()) or 1.0
    parts = []
    if len(rim):
        path = "L".join(f"{x:.1f} {y:.1f}" for x, y in frame(rim).tolist())
        parts.append(Markup('<path class="outline" d="M{}z"/>').format(path))
    drawn = frame(at[:, axes])
    for k in np.argsort(-np.abs(distance), kind="stable").tolist():  # small ones stay visible above large ones
        parts.append(_mark(points[k], drawn[k], distance[k], largest, len(points) <= MAX_NAMES))
    parts.append(_foot(frame, largest, across, up))
    return Markup('<svg class="map" viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>').format(
        WIDTH, round(frame.height + 84.0, 1), f"deviations: {words}", Markup("").join(parts)
    )


def outline(surface: dict[str, Any], axes: list[int]) -> Array:
    """Outline (n, 2) of a closed surface seen along the third axis; none of open quadrics.

    Parameters
    ----------
    surface : dict
        See :meth:`fg_orient.closerange.surface.Surface.as_dict`.
    axes : list of int
        Across and up.
    """
    found = Surface(surface["kind"], np.array(surface["centre_m"]), np.array(surface["semi_axes_m"]),
                    np.array(surface["rotation"]), np.array(surface["coefficients"] or [], float))  # fmt: skip
    form = found.conditions
    values, vectors = np.linalg.eigh(form.square)
    if np.abs(values).min() <= _FLAT * np.abs(values).max():
        return np.zeros((0, 2))
    inverse = (vectors / values) @ vectors.T
    middle = -inverse @ form.linear
    shape = -float(form.value(middle[None])[0]) * inverse
    if np.linalg.eigvalsh(shape)[0] <= 0.0:
        return np.zeros((0, 2))
    angle = np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    half = np.linalg.cholesky(shape[np.ix_(np.array(axes), np.array(axes))])
    return np.asarray((found.centre + middle)[axes] + circle @ half.T)


def _radius(share: float) -> float:
    return SMALLEST + (LARGEST - SMALLEST) * math.sqrt(share)


def _mark(point: dict[str, Any], place: Array, distance: float, largest: float, named: bool) -> Markup:
    """A disk: colour and its strength tell sign and size, so does its radius."""
    share = abs(distance) / largest
    kind = f"{'p' if distance >= 0.0 else 'm'}{max(1, math.ceil(share * _STEPS))}"
    x, y, name = round(float(place[0]), 1), round(float(place[1]), 1), printable(point["id"])
    told = "; ".join(f"{a.upper()} {length(point[f'deviation_{a}_m'])}" for a in "xyz")
    label = Markup('<text class="name" x="{}" y="{}">{}</text>').format(x + 10, y - 6, name) if named else Markup("")
    return Markup('<g><title>{}</title><circle class="deviation {}" cx="{}" cy="{}" r="{:.1f}"/>{}</g>').format(
        f"{name}: normal distance {length(distance)}; along {told}", kind, x, y, _radius(share), label)  # fmt: skip


def _foot(frame: Frame, largest: float, across: int, up: int) -> Markup:
    """Key of sizes and colours, scale bar, axes."""
    y, x, parts = frame.height + 18.0, 30.0, []
    for kind, sign, share in (("p5", "+", 1.0), ("p2", "+", 0.3), ("m2", "−", 0.3), ("m5", "−", 1.0)):
        disk = '<circle class="deviation {}" cx="{}" cy="{}" r="{:.1f}"/><text x="{}" y="{}">{}</text>'
        parts.append(Markup(disk).format(
            kind, x, y - 4, _radius(share), x + 17, y + 1, f"{sign}{length(share * largest)}"))  # fmt: skip
        x += 130.0
    metres = round_down(0.2 * WIDTH / frame.units)
    size = round(metres * frame.units, 1)
    parts.append(Markup('<path class="bar-line" d="M24 {}v5h{}v-5"/><text x="{}" y="{}">{}</text>').format(
        y + 31, size, size + 34, y + 39, round_length(metres)))  # fmt: skip
    parts.append(Markup('<text class="small" x="{}" y="{}" text-anchor="end">{} to the right, {} up</text>').format(
        WIDTH - 10, y + 39, AXES[across], AXES[up]))  # fmt: skip
    return Markup("").join(parts)


def distance_histogram(record: dict[str, Any]) -> Markup:
    """Histogram of the normal distances, mm."""
    values = 1e3 * np.array([p["distance_m"] for p in record["points"]])
    reach = 1.05 * (float(np.abs(values).max()) or 1.0)
    counts, edges = np.histogram(values, np.linspace(-reach, reach, min(21, 2 * math.ceil(math.sqrt(len(values))) + 1)))
    high = 1.1 * max(float(counts.max()), 1.0)
    panel = Panel((-reach, reach), (0.0, high), "histogram of the normal distances", width=560.0, height=220.0)
    panel.axes(
        "normal distance, mm", "points", ticks(-reach, reach, 6), [k for k in ticks(0.0, high, 4) if k == round(k)]
    )
    for left, right, count in zip(edges[:-1].tolist(), edges[1:].tolist(), counts.tolist(), strict=True):
        if count:
            panel.add('<path class="column" d="M{} {}V{}H{}V{}z"/>', panel.px(left), panel.py(0.0), panel.py(count),
                      round(panel.px(right) - 1, 1), panel.py(0.0))  # fmt: skip
    panel.line([(0.0, 0.0), (0.0, high)], "zero")
    return panel.svg("panel broad")
