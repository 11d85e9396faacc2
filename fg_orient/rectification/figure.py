"""Drawing of the residual vectors: one SVG that also stands alone."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.report.scale import round_down

Array = npt.NDArray[np.float64]

WIDTH: Final = 720.0
MARGIN: Final = 28.0
FOOT: Final = 66.0
#: Length of a large residual (90 % quantile), at most, as a share of the width.
SHARE: Final = 0.07
#: Length of the longest residual, at most, as a share of the width.
MOST: Final = 0.3
#: More points than this are thinned.
MAX_POINTS: Final = 3000
CONTROL: Final = "#0067b0"
CHECK: Final = "#c65102"
GREY: Final = "#7b8790"


def residual_figure(record: dict[str, Any]) -> str:
    """Draw the points in the target system with their residuals, enlarged.

    Parameters
    ----------
    record : dict
        See :func:`fg_orient.rectification.record.record_of`.

    Returns
    -------
    str
        An ``<svg>`` element. Maps have north up, images lines downwards; the enlargement is written into it.
    """
    (first, second), unit = record["axes"], record["unit"]
    rows = record["points"][:: max(1, math.ceil(len(record["points"]) / MAX_POINTS))]
    across, up = (second, first) if first == "line" else (first, second)
    sign = -1.0 if "line" in (first, second) else 1.0
    at = _columns(rows, f"{across}_{unit}", f"{up}_{unit}") * np.array([1.0, sign])
    vector = _columns(rows, f"residual_{across}_{unit}", f"residual_{up}_{unit}") * np.array([1.0, sign])
    lengths = np.linalg.norm(vector, axis=1)
    large = max(float(np.quantile(lengths, 0.9)) / SHARE, float(lengths.max()) / MOST)
    scale = WIDTH / large if large > 0.0 else 0.0
    at = at - at.min(axis=0)
    per_unit = _largest_scale(at, vector * scale)
    ends = np.concatenate([at * per_unit, at * per_unit + vector * scale])
    low, high = ends.min(axis=0), ends.max(axis=0)
    left, height = 0.5 * (WIDTH - high[0] - low[0]), high[1] - low[1] + 2 * MARGIN
    place = np.column_stack([left + at[:, 0] * per_unit, MARGIN + high[1] - at[:, 1] * per_unit])
    parts = [_point(row, p, v * scale * np.array([1.0, -1.0])) for row, p, v in zip(rows, place, vector, strict=True)]
    parts.append(_foot(height, per_unit, scale, unit))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {height + FOOT:.1f}" role="img" '
        f'aria-label="residual vectors" font-family="sans-serif" font-size="14" fill="{GREY}">{"".join(parts)}</svg>'
    )


def _largest_scale(at: Array, vector: Array) -> float:
    """Drawing units per unit of the coordinates with which points and the ends of their vectors fill the width.

    By bisection: the extent grows with the scale wherever it is larger than that of the vectors alone.
    """
    room = WIDTH - 2.0 * MARGIN
    low, high = 0.0, room / max(float(at.max()), 1e-9)
    for _ in range(60):
        middle = 0.5 * (low + high)
        ends = np.concatenate([at * middle, at * middle + vector])
        low, high = (middle, high) if float(np.ptp(ends, axis=0).max()) <= room else (low, middle)
    return low


def _columns(rows: list[dict[str, Any]], *names: str) -> Array:
    return np.array([[row[name] for name in names] for row in rows], float)


def _point(row: dict[str, Any], at: Array, vector: Array) -> str:
    x, y = (round(float(v), 1) for v in at)
    colour = CONTROL if row["role"] == "control" else CHECK
    fill = colour if row["role"] == "control" else "none"
    end = f"{x + vector[0]:.1f}", f"{y + vector[1]:.1f}"
    ring = f'<circle cx="{x}" cy="{y}" r="9" fill="none" stroke="{CHECK}"/>' if row["suspicious"] else ""
    return (
        f'<line x1="{x}" y1="{y}" x2="{end[0]}" y2="{end[1]}" stroke="{colour}" stroke-width="1.6"/>'
        f'<circle cx="{x}" cy="{y}" r="3.5" fill="{fill}" stroke="{colour}" stroke-width="1.5"/>{ring}'
    )


def _foot(height: float, per_unit: float, scale: float, unit: str) -> str:
    """Legend, and the scales of map and vectors."""
    y = height + 18.0
    parts = [
        f'<circle cx="30" cy="{y - 5}" r="3.5" fill="{CONTROL}"/><text x="40" y="{y}">control</text>'
        f'<circle cx="120" cy="{y - 5}" r="3.5" fill="none" stroke="{CHECK}"/><text x="130" y="{y}">check</text>',
        _bar(24.0, y + 28.0, round_down(0.2 * WIDTH / per_unit), per_unit, unit, ""),
    ]
    if scale > 0.0:
        enlarged = f" residual, enlarged {float(f'{scale / per_unit:.2g}'):,.0f} times"
        parts.append(_bar(360.0, y + 28.0, round_down(0.2 * WIDTH / scale), scale, unit, enlarged))
    return "".join(parts)


def _bar(x: float, y: float, length: float, per_unit: float, unit: str, words: str) -> str:
    drawn = length * per_unit
    path = f"M{x:.1f} {y - 5:.1f}v5h{drawn:.1f}v-5"
    return (
        f'<path d="{path}" fill="none" stroke="{GREY}" stroke-width="1.5"/>'
        f'<text x="{x:.1f}" y="{y + 16:.1f}">{length:g} {unit}{words}</text>'
    )
