"""A small drawing with axes as SVG text: frame, ticks, words, limits.

Colours come from the style sheet of the page (classes), so that light and dark both work.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from markupsafe import Markup

#: Distance of ticks that read well, times a power of ten.
_STEPS: Final = (1.0, 2.0, 5.0, 10.0)
#: Beyond this many decades a logarithmic axis has a tick at every second, third ... power.
_DECADES: Final = 6


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round values between two limits, about so many."""
    if not high > low:
        return [low]
    raw = (high - low) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(s * power for s in _STEPS if s * power >= raw * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return [k * step + 0.0 for k in range(first, math.floor(high / step + 1e-9) + 1)]


def powers(low: float, high: float) -> list[float]:
    """Powers of ten between two exponents, thinned so that their labels do not touch."""
    every = max(1, math.ceil((high - low) / _DECADES))
    return [10.0**k for k in range(math.ceil(low), math.floor(high) + 1) if k % every == 0]


def plain(value: float) -> str:
    """Write a tick: short, with a true minus."""
    return f"{value:.6g}".replace("e-0", "e-").replace("e+0", "e").replace("-", "−")


@dataclass
class Panel:
    """Axes into which shapes are drawn.

    Parameters
    ----------
    x, y : (low, high)
        Limits in the units of the axes; of a logarithmic axis their powers of ten.
    label : str
        What the drawing shows, for those who do not see it.
    width, height : float
        Drawing units.
    log_y : bool
        Logarithmic y axis.
    y_down : bool
        The y axis grows downwards, as lines of an image do.
    left, bottom : float
        Room for tick labels and the axis' words.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    label: str
    width: float = 270.0
    height: float = 230.0
    log_y: bool = False
    y_down: bool = False
    left: float = 50.0
    bottom: float = 44.0
    top: float = 22.0
    right: float = 12.0
    parts: list[Markup] = field(default_factory=list)

    def px(self, x: float) -> float:
        """Drawing unit of an x."""
        low, high = self.x
        return round(self.left + (self.width - self.left - self.right) * (x - low) / (high - low), 1)

    def py(self, y: float) -> float:
        """Drawing unit of a y; of a logarithmic axis of the value itself."""
        low, high = self.y
        share = ((math.log10(y) if self.log_y else y) - low) / (high - low)
        inner = self.height - self.top - self.bottom
        return round(self.top + inner * (share if self.y_down else 1.0 - share), 1)

    def axes(
        self, x_words: str, y_words: str, x_ticks: Iterable[float] = (), y_ticks: Iterable[float] = (),
        say: Callable[[float], str] = plain,
    ) -> None:  # fmt: skip
        """Draw the frame, ticks with grid lines, and the words of both axes."""
        x0, x1, y0, y1 = self.left, self.width - self.right, self.top, self.height - self.bottom
        for value in x_ticks:
            at = self.px(value)
            self.add('<path class="grid" d="M{} {}V{}"/>', at, y0, y1)
            self.text(at, y1 + 16, say(value), "middle")
        for value in y_ticks:
            at = self.py(value)
            self.add('<path class="grid" d="M{} {}H{}"/>', x0, at, x1)
            self.text(x0 - 5, at + 4, say(value), "end")
        self.add('<rect class="frame" x="{}" y="{}" width="{}" height="{}"/>', x0, y0, round(x1 - x0, 1),
                 round(y1 - y0, 1))  # fmt: skip
        self.text((x0 + x1) / 2, self.height - 8, x_words, "middle")
        self.text(x0, y0 - 8, y_words)

    def text(self, x: float, y: float, words: object, anchor: str = "start", kind: str = "small") -> None:
        """Write words at drawing units."""
        self.add('<text class="{}" x="{}" y="{}" text-anchor="{}">{}</text>', kind, round(x, 1), round(y, 1), anchor,
                 words)  # fmt: skip

    def line(self, points: Sequence[tuple[float, float]], kind: str) -> None:
        """Draw a polyline through values."""
        path = "L".join(f"{self.px(x)} {self.py(y)}" for x, y in points)
        self.add('<path class="{}" d="M{}"/>', kind, path)

    def dots(self, points: Iterable[tuple[float, float]], kind: str, r: float = 2.2) -> None:
        """Draw one path of all dots, small in the file: each a circle of two arcs."""
        path = "".join(f"M{round(self.px(x) - r, 1)} {self.py(y)}a{r} {r} 0 1 0 {2 * r:g} 0a{r} {r} 0 1 0 {-2 * r:g} 0"
                       for x, y in points)  # fmt: skip
        if path:
            self.add('<path class="{}" d="{}"/>', kind, path)

    def squares(self, points: Iterable[tuple[float, float]], kind: str, r: float = 2.0) -> None:
        """Draw one path of all squares."""
        path = "".join(f"M{round(self.px(x) - r, 1)} {round(self.py(y) - r, 1)}h{2 * r:g}v{2 * r:g}h{-2 * r:g}z"
                       for x, y in points)  # fmt: skip
        if path:
            self.add('<path class="{}" d="{}"/>', kind, path)

    def add(self, shape: str, *values: object) -> None:
        """Add a shape; values are escaped."""
        self.parts.append(Markup(shape).format(*values))

    def svg(self, kind: str = "panel") -> Markup:
        """Give the drawing."""
        return Markup('<svg class="{}" viewBox="0 0 {:g} {:g}" role="img" aria-label="{}">{}</svg>').format(
            kind, self.width, self.height, self.label, Markup("").join(self.parts)
        )
