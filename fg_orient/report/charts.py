"""Drawings of the orientation and of the adjustment: corrections, correlations, redundancy, iterations."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from fg_orient.report.orientation import image_correlations, short_names
from fg_orient.report.panel import Panel, powers, ticks
from fg_orient.report.words import signed
from fg_orient.result.record import Result

Array = npt.NDArray[np.float64]

#: Correlations are coloured in so many steps each side of 0.
STEPS: Final = 5
#: Images whose correlations are drawn.
MAX_HEAT: Final = 16
_ROW: Final = 17.0


def correction_chart(image: str, rows: Sequence[dict[str, Any]]) -> Markup:
    """Corrections of an image over their prior sigmas, with bars of one standard deviation; empty without priors.

    Parameters
    ----------
    image : str
    rows : sequence of dict
        ``name``, ``degree``, ``value``, ``sigma``, ``prior`` in one unit each; see
        :func:`fg_orient.report.orientation.corrections`.
    """
    drawn = [row for row in rows if row["prior"] and row["value"] is not None]
    if not drawn:
        return Markup("")
    share = np.array([row["value"] / row["prior"] for row in drawn])
    sigma = np.array([(row["sigma"] or math.nan) / row["prior"] for row in drawn])
    reach = 1.05 * max(1.25, float(np.nanmax(np.abs(share) + np.where(np.isfinite(sigma), sigma, 0.0))))
    panel = Panel((-reach, reach), (0.0, len(drawn)), f"corrections of image {image} in prior standard deviations",
                  width=560.0, height=len(drawn) * _ROW + 60.0, y_down=True, left=190.0, top=10.0)  # fmt: skip
    panel.axes("correction in prior standard deviations, bar ± 1 σ", "", ticks(-reach, reach, 6))
    for edge in (-1.0, 0.0, 1.0):
        panel.line([(edge, 0.0), (edge, float(len(drawn)))], "limit" if edge else "zero")
    for k, row in enumerate(drawn):
        y = k + 0.5
        panel.text(panel.left - 8, panel.py(y) + 4, f"{row['name']}, {row['degree']}", "end")
        if np.isfinite(sigma[k]):
            panel.line([(share[k] - sigma[k], y), (share[k] + sigma[k], y)], "whisker")
        panel.dots([(float(share[k]), y)], "line-dot", 3.2)
    return panel.svg("panel broad")


def heat_maps(result: Result) -> list[dict[str, Any]]:
    """Correlations of each image's unknowns as a triangle of squares; none where covariances are withheld."""
    names = short_names(result)
    chosen = itertools.islice(image_correlations(result).items(), MAX_HEAT)
    return [{"image": image, "drawing": heat_map(image, names[image], rho)} for image, rho in chosen]


def heat_map(image: str, names: Sequence[str], rho: Array) -> Markup:
    """Lower triangle of correlations: hue tells the sign, strength the size, a written figure what is above 0.9."""
    n, side, left = len(names), 26.0, 104.0
    width, height = left + n * side + 8.0, n * side + 92.0
    panel = Panel((0.0, 1.0), (0.0, 1.0), f"correlations of the unknowns of image {image}", width=width, height=height)
    for i in range(n):
        y = 6.0 + i * side
        panel.text(left - 6, y + side / 2 + 4, names[i], "end")
        x = left + i * side + side / 2
        panel.add('<text class="small" transform="translate({} {}) rotate(-60)" text-anchor="end">{}</text>',
                  x + 4, n * side + 18.0, names[i])  # fmt: skip
        for j in range(i):
            _cell(panel, left + j * side, y, side, float(rho[i, j]), f"{names[i]} with {names[j]}")
        _square(panel, "cell-one", left + i * side, y, side, "")
    return panel.svg("panel heat")


def _cell(panel: Panel, x: float, y: float, side: float, rho: float, what: str) -> None:
    """A square of the heat map with its tip."""
    if not math.isfinite(rho):
        return
    step = min(STEPS, math.floor(abs(rho) * STEPS + 0.5))
    kind = f"cell {'p' if rho > 0 else 'm'}{step}" if step else "cell"
    _square(panel, kind, x, y, side, f"{what}: {signed(rho)}")
    if abs(rho) >= 0.9:
        hundredths = f"{'−' if rho < 0.0 else ''}.{min(99, math.floor(abs(rho) * 100.0))}"  # .99 is not rounded to 1
        panel.add('<text class="figure" x="{}" y="{}" text-anchor="middle">{}</text>', x + side / 2 - 0.5,
                  y + side / 2 + 3.5, hundredths)  # fmt: skip


def _square(panel: Panel, kind: str, x: float, y: float, side: float, tip: str) -> None:
    """A square with a gap of one unit to its neighbours, and its tip."""
    panel.add('<rect class="{}" x="{}" y="{}" width="{}" height="{}">', kind, x, y, side - 1, side - 1)
    panel.add("<title>{}</title></rect>" if tip else "</rect>", tip)


def redundancy_chart(result: Result) -> Markup:
    """Histogram of the redundancy numbers of all image coordinates; empty where they are not given."""
    return redundancy_histogram(result.residuals.numbers("redundancy_line", "redundancy_sample"))


def redundancy_histogram(values: Array, names: tuple[str, str] = ("line", "sample")) -> Markup:
    """Histogram of redundancy numbers (n, 2) of two coordinates with these names; empty where there are none."""
    panel_values = [column[np.isfinite(column)] for column in values.T]
    if not sum(map(len, panel_values)):
        return Markup("")
    edges = np.linspace(0.0, 1.0, 21)
    counts = [np.histogram(np.clip(column, 0.0, 1.0), edges)[0] for column in panel_values]
    high = 1.08 * max(1.0, float(np.max(counts)))
    panel = Panel(
        (0.0, 1.0), (0.0, high), f"redundancy numbers of {names[0]} and {names[1]}", width=560.0, height=240.0
    )
    panel.axes("redundancy number: 0 unchecked, 1 fully checked", "coordinates of image points",
               [0, 0.2, 0.4, 0.6, 0.8, 1.0], ticks(0.0, high, 4))  # fmt: skip
    for k, column in enumerate(counts):
        for left, count in zip(edges.tolist(), column.tolist(), strict=False):
            if count:
                x0, x1 = panel.px(left + 0.025 * k), panel.px(left + 0.025 * (k + 1)) - 1
                panel.add('<path class="column {}" d="M{} {}V{}H{}V{}z"/>', ("of-line", "of-sample")[k], x0,
                          panel.py(0.0), panel.py(count), round(x1, 1), panel.py(0.0))  # fmt: skip
    x = panel.left + 12
    for k, word in enumerate(names):
        panel.add('<rect class="column {}" x="{}" y="{}" width="10" height="10"/>', ("of-line", "of-sample")[k],
                  x + 70 * k, panel.top + 8)  # fmt: skip
        panel.text(x + 14 + 70 * k, panel.top + 17, word)
    return panel.svg("panel broad")


def iteration_charts(iterations: Sequence[dict[str, Any]], units: str = "prior σ or m") -> list[Markup]:
    """Weighted squares and largest step (in ``units``) over the iterations, both logarithmic; none without a log."""
    taken = [i for i in iterations if i["accepted"]]
    if not taken:
        return []
    squares = [(0.0, taken[0]["chi2"]), *((float(i["iteration"]), i["chi2_after"]) for i in taken)]
    steps = [(float(i["iteration"]), i["step"]) for i in taken]
    last = float(taken[-1]["iteration"])
    return [panel.svg() for panel in (_history(squares, (0.0, last), "sum of weighted squares"),
            _history(steps, (0.0, last), f"largest step, {units}")) if panel is not None]  # fmt: skip


def _history(points: list[tuple[float, float]], x: tuple[float, float], words: str) -> Panel | None:
    """A line with dots over the iterations; None without a positive value."""
    points = [(k, value) for k, value in points if value and value > 0.0]
    if not points:
        return None
    exponents = [math.log10(value) for _, value in points]
    low, high = math.floor(min(exponents) - 0.05), math.ceil(max(exponents) + 0.05)
    panel = Panel(x, (low, high), f"{words} over the iterations", log_y=True)
    panel.axes("iteration", words, [k for k in ticks(*x, 6) if k == round(k)], powers(low, high), _power)
    panel.line(points, "curve")
    panel.dots(points, "line-dot", 3.0)
    return panel


def _power(value: float) -> str:
    """Write an iteration as it is, a power of ten with its exponent where it is long."""
    if value == 0.0 or 1e-2 <= value < 1e4:
        return f"{value:g}"
    return f"1e{round(math.log10(value))}".replace("-", "−")
