"""Charts as data: axes and marks in the units of the data, and their drawing as SVG text for a page.

A chart is described once. :func:`svg` draws it for a page without any library; its colours are classes of the style
sheet, for light and dark pages. :mod:`fg_orient.report.paper` draws the same chart by matplotlib for papers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import Array

#: Inks for colour-blind readers (Okabe and Ito 2008); each kind also has a marker or a line style.
INK, GREY = "#1d2327", "#8a9298"
BLUE, ORANGE, GREEN, PINK = "#0072b2", "#d55e00", "#009e73", "#cc79a7"


class Ink(NamedTuple):
    """Appearance of a kind of mark; on a page its class gives the colour.

    Parameters
    ----------
    colour : str
        Colour on paper.
    marker : str
        ``^`` triangle, ``o`` circle, ``s`` square, ``D`` diamond.
    radius : float
        Radius of the marker, drawing units of a page.
    filled : bool
        True if marker or area is filled.
    line : str
        Line style of matplotlib.
    width : float
        Line width on paper, points.
    """

    colour: str
    marker: str = "o"
    radius: float = 2.2
    filled: bool = True
    line: str = "-"
    width: float = 1.0


INKS: Final = {
    "control": Ink(BLUE, "^", 5.7), "check": Ink(ORANGE, radius=4.0, filled=False), "tie": Ink(GREY, radius=1.8),
    "station": Ink(INK, "s", 4.5, filled=False), "dot-foot": Ink(INK, radius=1.2),
    "line-dot": Ink(BLUE, radius=2.6), "sample-dot": Ink(ORANGE, "s", 2.4, filled=False),
    "series-0": Ink(BLUE, radius=2.8, filled=False), "series-1": Ink(ORANGE, "s", 2.4, filled=False, line="--"),
    "series-2": Ink(GREEN, "^", 3.2, filled=False, line=":"), "series-3": Ink(PINK, "D", 2.6, False, line="-."),
    "series-4": Ink(INK, radius=2.8, filled=False), "series-5": Ink(GREY, "s", 2.4, filled=False, line="--"),
    "curve": Ink(INK), "zero": Ink(INK, width=0.6), "limit": Ink(GREY, line="--", width=0.8),
    "whisker": Ink(BLUE), "across": Ink(ORANGE, line="--"), "of-line": Ink(BLUE, width=1.2),
    "of-sample": Ink(ORANGE, line="--", width=1.2), "normal": Ink(GREY), "column": Ink(BLUE, width=1.2),
    "foot": Ink(INK, filled=False, line="--", width=0.7), "outline": Ink(GREY, filled=False, line="--", width=0.7),
    "ellipse": Ink(GREY, filled=False, width=0.5), "band": Ink(GREY), "residual": Ink(BLUE), "look": Ink(INK),
    "ring": Ink(ORANGE, radius=9.0, filled=False),
    **{f"deviation {sign}{step}": Ink(ink, width=0.3) for sign, ink in (("p", ORANGE), ("m", BLUE))
       for step in range(1, 6)},
    **{f"dot {kind}": Ink(ink, radius=3.0) for kind, ink in (
        ("equal", GREEN), ("order", "#56b4e9"), ("rounding", BLUE), ("unit", "#cc79a7"), ("spread", "#cc79a7"),
        ("sigma", "#e69f00"), ("side", "#c9b400"), ("fitted", "#b79bd0"), ("differs", ORANGE),
        ("not_reproducible", GREY))},
}  # fmt: skip
#: Number of different marks for series of data.
SERIES: Final = 6
#: Distances between ticks that are easy to read, times a power of ten.
_STEPS: Final = (1.0, 2.0, 5.0, 10.0)
#: Maximum number of powers of ten with a label on a logarithmic axis.
_POWERS: Final = 7
#: Number of colours for positive, and for negative, correlations.
HEAT: Final = 5


def round_down(value: float) -> float:
    """Return the largest number of the form 1, 2 or 5 times a power of ten that is not above the value."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in _STEPS[:3] if step * power <= value * (1 + 1e-12))


def thousands(value: float) -> str:
    """Return the text of an enlargement with two significant digits."""
    return f"{float(f'{value:.2g}'):,.0f}"


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Return round values between two limits; ``about`` is their approximate number."""
    if not high > low:
        return [low]
    raw = (high - low) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(s * power for s in _STEPS if s * power >= raw * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return [k * step + 0.0 for k in range(first, math.floor(high / step + 1e-9) + 1)]


def log_ticks(low: float, high: float) -> list[float]:
    """Return round values between two positive limits: powers of ten, and 2 and 5 times these if there are few."""
    ends = math.log10(low) - 1e-9, math.log10(high) + 1e-9
    whole = [10.0**k for k in range(math.ceil(ends[0]), math.floor(ends[1]) + 1)]
    if len(whole) >= 3:
        return whole[:: math.ceil(len(whole) / _POWERS)]
    decades = range(math.floor(ends[0]), math.ceil(ends[1]) + 1)
    between = [step * 10.0**k for k in decades for step in _STEPS[:3] if low <= step * 10.0**k <= high]
    return between if len(between) > 1 else ticks(low, high, 3)


def decades(values: npt.ArrayLike) -> tuple[float, float]:
    """Return the powers of ten below and above the positive values."""
    exponents = np.log10([v for v in np.asarray(values, float) if math.isfinite(v) and v > 0.0] or [1.0])
    return 10.0 ** math.floor(exponents.min() - 0.05), 10.0 ** math.ceil(exponents.max() + 0.05)


def limits_of(values: npt.ArrayLike) -> tuple[float, float]:
    """Return limits of the positive values, with a margin of 9 % of the decades, at least 0.05."""
    exponents = np.log10([v for v in np.asarray(values, float) if math.isfinite(v) and v > 0.0] or [1.0])
    margin = max(0.09 * float(np.ptp(exponents)), 0.05)
    return 10.0 ** (float(exponents.min()) - margin), 10.0 ** (float(exponents.max()) + margin)


def plain(value: float) -> str:
    """Return the text of a tick, with a typographic minus sign."""
    return plain_exponent(f"{value:.6g}").replace("-", "−")


def plain_power(value: float) -> str:
    """Return the text of a tick of a logarithmic axis, with an exponent below 0.01 and from 10 000."""
    return f"{value:.6g}" if 1e-2 <= value < 1e4 else plain_exponent(f"{value:.0e}")


def short(value: float) -> str:
    """Return a number in at most four characters; a dash if it is not finite."""
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else "–"
    exponent = math.floor(math.log10(abs(value)))
    if -2 <= exponent <= 2:
        return f"{value:.2g}" if exponent < 2 else f"{value:.0f}"
    return plain_exponent(f"{value:.0e}")


def plain_exponent(text: str) -> str:
    """Return the text with "1e5" instead of "1e+05" and with typographic minus signs."""
    return text.replace("e+0", "e").replace("e+", "e").replace("e-0", "e−").replace("e-", "e−")


def cut(name: str, length: int = 24) -> str:
    """Return a name shortened for a title; control characters are replaced."""
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)
    return text if len(text) <= length else text[: length - 1] + "…"


@dataclass(frozen=True)
class Axis:
    """One axis of a chart.

    Parameters
    ----------
    words : str
        Quantity and unit.
    limits : (low, high)
        Limits in units of the data, also for logarithmic axes.
    log, down : bool
        Logarithmic axis; values increase downwards, as the lines of an image do.
    about : int
        Approximate number of ticks; 0: no ticks.
    whole : bool
        True for ticks at whole numbers only.
    names : sequence of str
        Texts that replace the numbers, at 0, 1, 2 ...
    beside : sequence of str
        Values that a paper shows opposite to the names; a page shows them in a table.
    write : callable, optional
        Function that returns the text of a tick.
    """

    words: str = ""
    limits: tuple[float, float] = (0.0, 1.0)
    log: bool = False
    down: bool = False
    about: int = 5
    whole: bool = False
    names: Sequence[str] = ()
    beside: Sequence[str] = ()
    write: Callable[[float], str] | None = None

    def ticks(self) -> list[tuple[float, str]]:
        """Return the values and texts of the ticks."""
        if self.names:
            return [(float(k), name) for k, name in enumerate(self.names)]
        if not self.about:
            return []
        values = log_ticks(*self.limits) if self.log else ticks(*self.limits, self.about)
        write = self.write or (plain_power if self.log else plain)
        return [(v, write(v)) for v in values if not self.whole or v == round(v)]

    def share(self, values: npt.ArrayLike) -> Array:
        """Return positions: 0 at the lower limit, 1 at the upper limit."""
        low, high = (math.log10(v) for v in self.limits) if self.log else self.limits
        given = np.log10(np.asarray(values, float)) if self.log else np.asarray(values, float)
        return np.asarray((given - low) / ((high - low) or 1.0))


@dataclass(frozen=True)
class Mark:
    """Shapes of one kind.

    Parameters
    ----------
    shape : str
        ``line``, ``area`` (closed), ``dots``, ``bars``, ``names``, ``cells``; on paper ``blocks``, too.
    kind : str
        Key of :data:`INKS` and class of the style sheet.
    x, y : (n,) arrays
        Coordinates. Bars: edges (n + 1) and counts (n). Cells: y is a matrix of correlations. Blocks: edges
        (n, 2). A line is interrupted at nan.
    label : str
        Text in the legend; "": no entry.
    tips : sequence of str
        Text that the pointer shows for each dot, or the names themselves.
    vectors : (n, 2) array, optional
        Vector that starts at each dot, in units of :attr:`Chart.per_width`; nan: no vector.
    thick : bool
        True if vectors are drawn as bars.
    sizes : (n,) array, optional
        Radii that replace the radius of the kind.
    """

    shape: str
    kind: str
    x: Array
    y: Array
    label: str = ""
    tips: Sequence[str] = ()
    vectors: Array | None = None
    thick: bool = False
    sizes: Array | None = None


@dataclass(frozen=True)
class Picture:
    """Picture below the marks: its content as an address, and the coordinates of its borders."""

    href: str
    x: tuple[float, float]
    y: tuple[float, float]


@dataclass
class Chart:
    """Axes and marks.

    Parameters
    ----------
    words : str
        Description of the content for screen readers.
    x, y : Axis
    title : str
        Title on paper; a page has headings instead.
    width, height : float
        Size in drawing units, including margins.
    left, right, top, bottom : float
        Margins.
    framed : bool
        True: a page shows axes. False: it shows scale bars, as on maps.
    aspect : float, optional
        Length of one unit of y divided by one unit of x; None if they have no common scale.
    per_width : float
        Length of a vector that would be as long as the width of the frame.
    bars : list of (float, str)
        Scale bars of the ground and of the vectors: length as a share of the width, and text.
    note : str
        Remark below a map.
    legend : str
        ``top``, ``right`` or ``bottom``.
    css : str
        Classes of the drawing.
    picture : Picture, optional
        Below the marks, on a page.
    """

    words: str
    x: Axis = field(default_factory=Axis)
    y: Axis = field(default_factory=Axis)
    title: str = ""
    width: float = 270.0
    height: float = 230.0
    left: float = 50.0
    right: float = 12.0
    top: float = 22.0
    bottom: float = 44.0
    framed: bool = True
    aspect: float | None = None
    per_width: float = 0.0
    bars: list[tuple[float, str]] = field(default_factory=list)
    note: str = ""
    legend: str = "top"
    css: str = "panel"
    picture: Picture | None = None
    marks: list[Mark] = field(default_factory=list)

    def add(self, shape: str, kind: str, x: npt.ArrayLike, y: npt.ArrayLike, **more: object) -> None:
        """Add marks; see :class:`Mark`."""
        self.marks.append(Mark(shape, kind, np.asarray(x, float), np.asarray(y, float), **more))  # type: ignore[arg-type]

    def across(self, kind: str, y: float, label: str = "") -> None:
        """Add a horizontal line."""
        self.add("line", kind, self.x.limits, [y, y], label=label)

    def upright(self, kind: str, x: float) -> None:
        """Add a vertical line."""
        self.add("line", kind, [x, x], self.y.limits)

    @property
    def inner(self) -> tuple[float, float]:
        """Return width and height inside the frame."""
        return self.width - self.left - self.right, self.height - self.top - self.bottom

    def place(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Return positions in drawing units (n, 2), y downwards."""
        up = self.y.share(y)
        wide, tall = self.inner
        return np.stack([self.left + wide * self.x.share(x), self.top + tall * (up if self.y.down else 1.0 - up)], -1)


def broad(words: str, x: Axis, y: Axis, height: float = 240.0, **more: object) -> Chart:
    """Return a chart as wide as a page."""
    return Chart(words, x, y, width=560.0, height=height, css="panel broad", **more)  # type: ignore[arg-type]


def mapped(words: str, places: Array, shrink: float = 1.0, tallest: float = 720.0, **more: object) -> Chart:
    """Return a map with the same scale along both axes.

    Parameters
    ----------
    words : str
    places : (n, 2) array
        Points that must be visible.
    shrink : float
        Length of one unit of x divided by one unit of y, for degrees of longitude and latitude.
    tallest : float
        Largest height of the drawing, drawing units.
    **more
        Of :class:`Chart`; ``margin`` in drawing units.
    """
    margin = float(str(more.pop("margin", 14.0)))
    low, high = places.min(axis=0), places.max(axis=0)
    stretch = np.array([shrink, 1.0])
    size = np.maximum((high - low) * stretch, max(1e-9, 0.02 * float(((high - low) * stretch).max())))
    units = min((720.0 - 2.0 * margin) / size[0], (tallest - 2.0 * margin) / size[1])
    height = float(size[1] * units) + 2.0 * margin
    half = 0.5 * (np.array([720.0, height]) - 2.0 * margin) / units / stretch
    ends = np.stack([0.5 * (low + high) - half, 0.5 * (low + high) + half], axis=1)
    (x, y) = (Axis(limits=(float(a), float(b)), about=4) for a, b in ends)
    given = {"x": x, "y": y, "aspect": 1.0 / shrink, "framed": False, "css": "map"} | more
    return Chart(words, width=720.0, height=height, left=margin, right=margin, top=margin, bottom=margin, **given)  # type: ignore[arg-type]


def large(vectors: Array) -> float:
    """Return the 90 % quantile of the lengths of vectors (n, 2); 0 without vectors."""
    lengths = np.linalg.norm(vectors[np.isfinite(vectors).all(axis=1)], axis=1)
    lengths = lengths[lengths > 0.0]
    return float(np.quantile(lengths, 0.9)) if len(lengths) else 0.0


def hundredths(rho: float) -> str:
    """Return a correlation in hundredths as text; 0.999 is not rounded to 1."""
    return f"{'−' if rho < 0.0 else ''}.{min(99, math.floor(abs(rho) * 100.0)):02d}"
