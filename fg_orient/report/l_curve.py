"""Drawing of the L-curve of a regularised adjustment, with the kappas of all rules on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

from markupsafe import Markup

from fg_orient.report.panel import Panel, plain
from fg_orient.report.panel import ticks as linear_ticks

#: Choices closer than this, in drawing units, share one mark.
NEAR: Final = 14.0
#: Width of a character and height of a line of a label, drawing units.
LETTER: Final = 8.0
LINE: Final = 14.0
#: Share of the range that is left free at each end.
_MARGIN: Final = 0.09
_WIDTH: Final = 560.0
_HEIGHT: Final = 380.0
#: What the axes of an adjustment's curve show.
AXES: Final = ("norm of the residuals |Ax − l|, σ", "norm of the solution |x|, prior σ and m")


def ranked(section: dict[str, Any]) -> list[dict[str, Any]]:
    """Rules in the order of their kappas, the largest first, with their ``number`` and ``chosen``; failures last.

    Parameters
    ----------
    section : dict
        ``regularisation`` of a record.
    """
    found = sorted(section["rules"], key=lambda rule: -math.inf if rule["kappa"] is None else rule["kappa"])[::-1]
    return [{**rule, "number": k, "chosen": rule["rule"] == section["rule"]} for k, rule in enumerate(found, start=1)]


def on_curve(choice: dict[str, Any]) -> bool:
    """Tell whether a choice has a place on the curve: kappa 0 of a singular system has none."""
    return all(choice[name] is not None and choice[name] > 0.0 for name in ("residual_norm", "solution_norm"))


def log_ticks(low: float, high: float) -> list[float]:
    """Exponents of round values between two exponents: powers of ten; 2 and 5 between where there are few."""
    whole = [float(k) for k in range(math.ceil(low), math.floor(high) + 1)]
    if len(whole) >= 3:
        return whole[:: max(1, math.ceil(len(whole) / 7))]
    values = (math.log10(step) + k for k in range(math.floor(low), math.ceil(high) + 1) for step in (1.0, 2.0, 5.0))
    found = [value for value in values if low <= value <= high]
    return found if len(found) > 1 else [math.log10(value) for value in linear_ticks(10.0**low, 10.0**high, 3)]


def l_curve_chart(section: dict[str, Any] | None, axes: tuple[str, str] = AXES) -> Markup:
    """Norm of the solution over that of the residuals, both logarithmic, marks numbered as :func:`ranked`.

    Empty without a regularisation.

    Parameters
    ----------
    section : dict or None
        ``regularisation`` of a record.
    axes : (str, str)
        What both norms are, and their units.
    """
    points = [] if section is None else _logarithms(section["curve"])
    if section is None or len(points) < 2:
        return Markup("")
    choices = [choice for choice in ranked(section) if on_curve(choice)]
    marks = _logarithms({name: [c[name] for c in choices] for name in ("residual_norm", "solution_norm")})
    panel = Panel(
        _range([x for x, _ in points + marks]), _range([y for _, y in points + marks]),
        "L-curve: norm of the solution over norm of the residuals, with the choices of the rules",
        width=_WIDTH, height=_HEIGHT, left=62.0,
    )  # fmt: skip
    panel.axes(*axes, log_ticks(*panel.x), log_ticks(*panel.y), lambda exponent: plain(float(f"{10.0**exponent:.6g}")))
    panel.line(points, "curve")
    taken: list[tuple[float, float, float]] = []
    for group in neighbours([(panel.px(x), panel.py(y)) for x, y in marks], NEAR):
        _mark(panel, [choices[k] for k in group], [marks[k] for k in group], taken)
    return panel.svg("panel broad")


def _logarithms(norms: dict[str, Sequence[float | None]]) -> list[tuple[float, float]]:
    """Exponents of both norms, where both are above zero."""
    pairs = zip(norms["residual_norm"], norms["solution_norm"], strict=True)
    return [(math.log10(r), math.log10(s)) for r, s in pairs if r and s and r > 0.0 and s > 0.0]


def _range(values: Sequence[float]) -> tuple[float, float]:
    """Limits with a margin; of a curve that is a point a tenth of a decade."""
    low, high = min(values), max(values)
    margin = max(_MARGIN * (high - low), 0.05)
    return low - margin, high + margin


def neighbours(places: Sequence[tuple[float, float]], near: float) -> list[list[int]]:
    """Numbers of marks in their order along the curve, those nearer to the one before than ``near`` in one list."""
    out: list[list[int]] = []
    for k, place in enumerate(places):
        if out and math.dist(place, places[k - 1]) < near:
            out[-1].append(k)
        else:
            out.append([k])
    return out


def _mark(
    panel: Panel, choices: Sequence[dict[str, Any]], places: Sequence[tuple[float, float]],
    taken: list[tuple[float, float, float]],
) -> None:  # fmt: skip
    """Draw marks with one label of their numbers, up and to the right, where the curve is not; above ``taken`` ones."""
    panel.squares([at for choice, at in zip(choices, places, strict=True) if not choice["chosen"]], "sample-dot", 3.4)
    panel.dots([at for choice, at in zip(choices, places, strict=True) if choice["chosen"]], "line-dot", 4.5)
    x, y = max(panel.px(x) for x, _ in places), min(panel.py(y) for _, y in places)
    words = ", ".join(str(choice["number"]) for choice in choices)
    wide = LETTER * len(words)
    while any(abs(y - other[1]) < LINE and x < other[0] + other[2] and other[0] < x + wide for other in taken):
        y -= LINE
    taken.append((x, y, wide))
    panel.add('<text class="mark-label" x="{}" y="{}">{}</text>', round(x + 8, 1), round(y - 6, 1), words)
