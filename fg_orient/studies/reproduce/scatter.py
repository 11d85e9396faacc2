"""Published against reproduced: one point per number, both axes logarithmic, drawn for the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from markupsafe import Markup

from fg_orient.report.style import plain_exponent
from fg_orient.studies.reproduce.reproduction import Row

SIZE: Final = 520.0
LEFT, BOTTOM, EDGE = 76.0, 46.0, 12.0
#: Powers of ten that the axes span at most; sizes beyond stand at the border.
RANGE: Final = (-30, 15)
#: A number within this factor of the printed one counts as of its order.
BAND: Final = 10.0


def scatter(rows: Sequence[Row]) -> Markup:
    """Draw the sizes of all numbers that are published and reproduced, but not zero; empty without any.

    Points that would cover each other are drawn once.
    """
    pairs = [(abs(r.published), abs(r.reproduced), r) for r in rows]
    pairs = [p for p in pairs if all(math.isfinite(v) and v > 0.0 for v in p[:2])]
    if len(pairs) < 2:
        return Markup("")
    powers = [math.log10(v) for p in pairs for v in p[:2]]
    low, high = (min(max(f, RANGE[0]), RANGE[1]) for f in (math.floor(min(powers)), math.ceil(max(powers))))
    span = max(high - low, 1)
    room = SIZE - LEFT - EDGE

    def place(value: float) -> float:
        return round((min(max(math.log10(value), low), high) - low) / span * room, 1)

    drawn: dict[tuple[int, int, str], tuple[float, float, Row]] = {}
    for published, reproduced, row in pairs:
        x, y = LEFT + place(published), EDGE + room - place(reproduced)
        drawn.setdefault((round(x), round(y), row.verdict), (x, y, row))
    points = Markup("").join(_point(*found) for found in drawn.values())
    shift = room * math.log10(BAND) / span
    head = '<svg viewBox="0 0 {} {}" role="img" aria-label="published against reproduced sizes">{}{}{}</svg>'
    return Markup(head).format(SIZE, EDGE + room + BOTTOM, _frame(room, shift), _ticks(low, high, room), points)


def _point(x: float, y: float, row: Row) -> Markup:
    text = Markup("{}, {}: published {}, reproduced {:.3g}").format(row.table, row.cell, row.printed, row.reproduced)
    return Markup('<circle class="dot {}" cx="{:.1f}" cy="{:.1f}" r="3"><title>{}</title></circle>').format(
        row.verdict, x, y, text
    )


def _frame(room: float, shift: float) -> Markup:
    """Border, the line of equal sizes and the band of one order of magnitude."""
    x, y, end = LEFT, EDGE, LEFT + room
    shift = min(shift, room)
    upper = (x, y + room), (x, y + room - shift), (end - shift, y)
    corners = [*upper, (end, y), (end, y + shift), (x + shift, y + room)]
    band = " ".join(f"{a:.1f},{b:.1f}" for a, b in corners)
    return Markup(
        '<polygon class="band" points="{}"/><rect class="frame" x="{}" y="{}" width="{}" height="{}"/>'
        '<path class="equal-line" d="M{} {}L{} {}"/>'
    ).format(band, x, y, room, room, x, y + room, end, y)


def _ticks(low: int, high: int, room: float) -> Markup:
    step = max(1, math.ceil((high - low) / 8))
    parts = []
    for power in range(low, high + 1, step):
        at = (power - low) / max(high - low, 1) * room
        text = plain_exponent(f"1e{power:+03d}")
        parts.append(Markup('<text class="small" x="{:.1f}" y="{:.1f}" text-anchor="middle">{}</text>').format(
            LEFT + at, EDGE + room + 18.0, text))  # fmt: skip
        parts.append(Markup('<text class="small" x="{:.1f}" y="{:.1f}" text-anchor="end">{}</text>').format(
            LEFT - 6.0, EDGE + room - at + 4.0, text))  # fmt: skip
    parts.append(Markup('<text class="small" x="{:.1f}" y="{:.1f}" text-anchor="middle">published</text>').format(
        LEFT + room / 2.0, EDGE + room + 40.0))  # fmt: skip
    parts.append(Markup('<text class="small" x="{:.1f}" y="{:.1f}" text-anchor="middle" transform="rotate(-90 {} {})">'
                        "reproduced</text>").format(14.0, EDGE + room / 2.0, 14.0, EDGE + room / 2.0))  # fmt: skip
    return Markup("").join(parts)
