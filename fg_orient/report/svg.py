"""Drawing of a chart as SVG text for a page, without any library.

Colours are classes of the style sheet, so that light and dark pages both work.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from markupsafe import Markup, escape

from fg_orient.report.chart import HEAT, INKS, Chart, Mark, Picture, hundredths
from fg_orient.report.words import signed

Box = tuple[float, float, float, float]

#: Markers that are drawn as the points of a line, because this needs less text.
TINY: Final = "dot-foot"
#: Width of a digit of the ticks.
_DIGIT: Final = 7.5
#: Possible places of a name relative to its point: across, down, anchor. The first free place is used. The
#: last number is the width of a letter.
_PLACES: Final[dict[str, tuple[list[tuple[float, float, str]], float]]] = {
    "name": ([(7, -5, "start"), (-7, -5, "end"), (7, 15, "start"), (-7, 15, "end")], 8.0),
    "label": (
        [
            (0, -10, "middle"),
            (0, 20, "middle"),
            (12, 5, "start"),
            (-12, 5, "end"),
            *((0, 34 + 18 * k, "middle") for k in range(8)),
        ],
        9.2,
    ),
    "mark-label": ([(8, -6 - 14 * k, "start") for k in range(8)], 8.0),
}


def svg(chart: Chart | None) -> Markup:
    """Draw a chart as an ``<svg>`` element; empty without one."""
    return Markup("") if chart is None else _Drawing(chart).text()


class _Drawing:
    """SVG text of one chart; all texts are escaped."""

    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        self.parts: list[str] = []
        self.taken: list[Box] = []

    def text(self) -> Markup:
        chart = self.chart
        if chart.framed:
            self._axes()
        if chart.picture is not None:
            self._picture(chart.picture)
        for mark in sorted(chart.marks, key=lambda mark: mark.shape == "names"):
            getattr(self, f"_{mark.shape}")(mark)
        height = chart.height if chart.framed else self._foot()
        if chart.framed:
            self._legend()
            self._bars_above()
        return Markup('<svg class="{}" viewBox="0 0 {:g} {:g}" role="img" aria-label="{}">{}</svg>').format(
            chart.css, chart.width, round(height, 1), chart.words, Markup("".join(self.parts))
        )

    def _write(self, x: float, y: float, words: object, anchor: str = "start", kind: str = "small") -> None:
        self.parts.append(f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>')

    def _path(self, kind: str, path: str) -> None:
        self.parts.append(f'<path class="{escape(kind)}" d="{path}"/>')

    def _axes(self) -> None:
        chart = self.chart
        (wide, tall), x0, y0 = chart.inner, chart.left, chart.top
        for value, words in chart.x.ticks():
            at = x0 + wide * float(chart.x.share(value))
            if chart.x.names:
                turned = f'transform="translate({at + 4:.1f} {y0 + tall + 12:.1f}) rotate(-60)" text-anchor="end"'
                self.parts.append(f'<text class="small" {turned}>{escape(words)}</text>')
                continue
            self._path("grid", f"M{at:.1f} {y0}V{y0 + tall:.1f}")
            half = 0.5 * _DIGIT * len(words)  # otherwise the border would cut off a long number at the end of the axis
            self._write(min(max(at, half), chart.width - half), y0 + tall + 16, words, "middle")
        for value, words in chart.y.ticks():
            at = float(chart.place(chart.x.limits[0], value)[1])
            if not chart.y.names:
                self._path("grid", f"M{x0} {at:.1f}H{x0 + wide:.1f}")
            self._write(x0 - 5, at + 4, words, "end")
        if not chart.x.names:
            self.parts.append(f'<rect class="frame" x="{x0}" y="{y0}" width="{wide:.1f}" height="{tall:.1f}"/>')
        self._write(x0 + wide / 2, chart.height - 8, chart.x.words, "middle")
        self._write(x0, y0 - 8, chart.y.words)

    def _picture(self, picture: Picture) -> None:
        (x0, y0), (x1, y1) = self.chart.place(picture.x, picture.y).tolist()
        box = (
            f'x="{x0 - self.chart.left:.1f}" y="{y0 - self.chart.top:.1f}" width="{x1 - x0:.1f}" height="{y1 - y0:.1f}"'
        )
        self._inside(f'<image class="pixels" {box} preserveAspectRatio="none" href="{escape(picture.href)}"/>')

    def _inside(self, drawn: str) -> None:
        """Add elements with coordinates from the corner of the frame, cut at the frame."""
        wide, tall = self.chart.inner
        box = f'x="{self.chart.left:g}" y="{self.chart.top:g}" width="{wide:.1f}" height="{tall:.1f}"'
        self.parts.append(f"<svg {box}>{drawn}</svg>")

    def _line(self, mark: Mark) -> None:
        at = self._at(mark)
        if mark.kind == "look":  # a name must not cover the direction of view
            (west, north), (east, south) = np.min(at, axis=0).tolist(), np.max(at, axis=0).tolist()
            self.taken.append((west, east, north, south))
        self._path(mark.kind, "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in at))

    def _area(self, mark: Mark) -> None:
        """Draw a closed line, cut at the frame."""
        corners = "L".join(f"{x - self.chart.left:.1f} {y - self.chart.top:.1f}" for x, y in self._at(mark))
        self._inside(f'<path class="{escape(mark.kind)}" d="M{corners}z"/>')

    def _at(self, mark: Mark) -> list[list[float]]:
        out: list[list[float]] = self.chart.place(mark.x, mark.y).tolist()
        return out

    def _dots(self, mark: Mark) -> None:
        ink, at = INKS[mark.kind], self._at(mark)
        sizes = [ink.radius] * len(at) if mark.sizes is None else mark.sizes.tolist()
        # a line of length zero with round ends looks like a circle and needs a quarter of its text
        tiny = mark.sizes is None and mark.kind == TINY
        symbols = [f"M{x:.1f} {y:.1f}h0" if tiny else symbol(ink.marker, x, y, r)
                   for (x, y), r in zip(at, sizes, strict=True)]  # fmt: skip
        if ink.radius >= 4.0:
            self.taken += [(x - r, x + r, y - r, y + r) for (x, y), r in zip(at, sizes, strict=True)]
        lines = [""] * len(at)
        if mark.vectors is not None and self.chart.per_width:
            unit = self.chart.inner[0] / self.chart.per_width
            ends = (mark.vectors * unit * np.array([1.0, 1.0 if self.chart.y.down else -1.0])).tolist()
            lines = [f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}" if math.isfinite(dx) and math.isfinite(dy) and (dx or dy)
                     else "" for (x, y), (dx, dy) in zip(at, ends, strict=True)]  # fmt: skip
        kind = f"{'bar' if mark.thick else 'vector'} {mark.kind}"
        if not mark.tips:
            if any(lines):
                self._path(kind, "".join(lines))
            if symbols:
                self._path(f"{mark.kind} tiny" if tiny else mark.kind, "".join(symbols))
            return
        for tip, line, shape in zip(mark.tips, lines, symbols, strict=True):
            stroke = f'<path class="{kind}" d="{line}"/>' if line else ""
            self.parts.append(f'<g><title>{escape(tip)}</title>{stroke}<path class="{mark.kind}" d="{shape}"/></g>')

    def _bars(self, mark: Mark) -> None:
        """Draw bars; the bars of several marks share the width of a bin."""
        several = [other for other in self.chart.marks if other.shape == "bars"]
        number = next(k for k, other in enumerate(several) if other is mark)
        zero = self.chart.place(mark.x[0], 0.0)[1]
        left, tops = self.chart.place(mark.x[:-1], mark.y).tolist(), self.chart.place(mark.x[1:], mark.y).tolist()
        for (x0, y), (x1, _), count in zip(left, tops, mark.y.tolist(), strict=True):
            if count:
                wide = (x1 - x0) / len(several)
                x = x0 + number * wide
                path = f"M{x:.1f} {zero:.1f}V{y:.1f}H{x + max(wide - 0.8, 0.5):.1f}V{zero:.1f}z"
                self._path(f"column {mark.kind}", path)

    def _cells(self, mark: Mark) -> None:
        """Draw the lower triangle of a matrix. The class gives sign and size; values from 0.9 are printed."""
        side = self.chart.inner[0] / len(mark.y)
        for (i, j), rho in np.ndenumerate(mark.y):
            x, y = self.chart.left + j * side, self.chart.top + i * side
            step = min(HEAT, math.floor(abs(rho) * HEAT + 0.5)) if math.isfinite(rho) else 0
            if j > i or (not math.isfinite(rho) and i != j):
                continue
            kind = "cell-one" if i == j else f"cell {'p' if rho > 0 else 'm'}{step}" if step else "cell"
            tip = "" if i == j else f"<title>{escape(mark.tips[i])} with {escape(mark.tips[j])}: {signed(rho)}</title>"
            box = f'x="{x:.1f}" y="{y:.1f}" width="{side - 1:.1f}" height="{side - 1:.1f}"'
            self.parts.append(f'<rect class="{kind}" {box}>{tip}</rect>')
            if i != j and abs(rho) >= 0.9:
                self._write(x + side / 2 - 0.5, y + side / 2 + 3.5, hundredths(rho), "middle", "figure")

    def _names(self, mark: Mark) -> None:
        """Write names at free places; a name without a free place is omitted."""
        places, letter = _PLACES[mark.kind]
        chart = self.chart
        for words, (x, y) in zip(mark.tips, self._at(mark), strict=True):
            long = letter * len(words)
            for dx, dy, anchor in places:
                left = x + dx - {"start": 0.0, "end": long, "middle": 0.5 * long}[anchor]
                if mark.kind != "name":
                    left = min(max(left, 4.0), chart.width - 4.0 - long)
                box = (left, left + long, y + dy - 12.0, y + dy + 3.0)
                inside = left >= 0.0 and box[1] <= chart.width and 0.0 <= box[2] and box[3] <= chart.height
                if inside and all(box[0] > b or box[1] < a or box[2] > d or box[3] < c for a, b, c, d in self.taken):
                    self.taken.append(box)
                    at = {"start": left, "end": left + long, "middle": left + 0.5 * long}[anchor]
                    self._write(at, y + dy, words, anchor, mark.kind)
                    break

    def _entry(self, mark: Mark, x: float, y: float) -> None:
        """Draw an entry of the legend; y is its base line."""
        begin = x + 18
        if mark.shape == "dots":
            radius = INKS[mark.kind].radius if mark.sizes is None else float(mark.sizes.max())
            begin = max(begin, x + 12 + radius)
            self._path(mark.kind, symbol(INKS[mark.kind].marker, x + 6, y - 5, radius))
        elif mark.shape == "line":
            self._path(mark.kind, f"M{x:.1f} {y - 5:.1f}h14")
        else:
            kind = f"column {mark.kind}" if mark.shape == "bars" else mark.kind
            self._path(kind, f"M{x:.1f} {y - 10:.1f}h12v10h-12z")
        self._write(begin, y, mark.label)

    def _legend(self) -> None:
        chart = self.chart
        labelled = [mark for mark in chart.marks if mark.label]
        y = chart.top + 16 if chart.legend != "bottom" else chart.height - chart.bottom - 17.0 * len(labelled)
        longest = max((len(mark.label) for mark in labelled), default=0)
        x = chart.left + 8 if chart.legend != "right" else chart.width - chart.right - 24 - 7.0 * longest
        for k, mark in enumerate(labelled):
            self._entry(mark, x, y + 17.0 * k)

    def _bars_above(self) -> None:
        """Draw the length of a vector above the frame, at its right end."""
        for share, words in self.chart.bars:
            long = share * self.chart.inner[0]
            x = self.chart.width - self.chart.right - long
            self._path("bar-line", f"M{x:.1f} 8v4h{long:.1f}v-4")
            self._write(x - 6, 14, words, "end")

    def _foot(self) -> float:
        """Draw the legend and the scale bars below a map; return the total height."""
        chart, x = self.chart, 18.0
        y = chart.height + 18.0
        shown: set[str] = set()
        for mark in chart.marks:
            if mark.label and mark.label not in shown:
                shown.add(mark.label)
                self._entry(mark, x, y)
                x += 30.0 + 11.5 * max(len(mark.label), 6)  # the letters of narrow screens are 20 units high
        if chart.note:
            self._write(chart.width - 20.0, y, chart.note, "end")
        for share, words in chart.bars:
            y += 30.0
            long = share * chart.inner[0]
            self._path("bar-line", f"M24.0 {y - 5:.1f}v5h{long:.1f}v-5")
            self._write(24.0 + long + 10.0, y + 3.0, words, kind="words")
        return y + 14.0


def symbol(marker: str, x: float, y: float, r: float) -> str:
    """Return the path of a marker at a place."""
    if marker == "^":
        return f"M{x:.1f} {y - r:.1f}l{0.88 * r:.1f} {1.5 * r:.1f}h{-1.76 * r:.1f}z"
    if marker == "s":
        return f"M{x - r:.1f} {y - r:.1f}h{2 * r:g}v{2 * r:g}h{-2 * r:g}z"
    if marker == "D":
        return f"M{x:.1f} {y - r:.1f}l{r:.1f} {r:.1f}l{-r:.1f} {r:.1f}l{-r:.1f} {-r:.1f}z"
    return f"M{x - r:.1f} {y:.1f}a{r:g} {r:g} 0 1 0 {2 * r:g} 0a{r:g} {r:g} 0 1 0 {-2 * r:g} 0"
