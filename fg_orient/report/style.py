"""How figures look: sizes of a journal's columns, inks that colour-blind readers tell apart, files that repeat.

Blue and orange carry what is opposed (Okabe and Ito 2008), and every quantity also has a marker, a line style or
a number. Matplotlib (extra "report") is loaded on use.
"""

from __future__ import annotations

import io
import math
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

#: Ink and paper; pages that take a figure in replace them by their own, for dark ones.
INK: Final = "#1d2327"
PAPER: Final = "#fefefe"
BLUE, ORANGE, GREEN, PINK, GREY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#8a9298"
#: Widths of one and of two columns, inches (88 and 180 mm).
ONE_COLUMN: Final = 3.46
TWO_COLUMNS: Final = 7.09
#: Fonts of 7 to 8 points at the printed width; text stays text in SVG and PDF.
STYLE: Final[dict[Any, Any]] = {
    "svg.fonttype": "none", "svg.hashsalt": "fg_orient", "pdf.fonttype": 42, "text.parse_math": False,
    "font.family": "sans-serif", "font.size": 8, "axes.titlesize": 8, "axes.labelsize": 8, "xtick.labelsize": 7,
    "ytick.labelsize": 7, "legend.fontsize": 7, "text.color": INK, "axes.edgecolor": INK, "axes.labelcolor": INK,
    "xtick.color": INK, "ytick.color": INK, "figure.facecolor": PAPER, "axes.facecolor": PAPER,
    "savefig.facecolor": PAPER, "legend.facecolor": PAPER, "legend.framealpha": 0.9, "legend.edgecolor": "none",
    "hatch.color": GREY, "hatch.linewidth": 0.6, "axes.linewidth": 0.6, "xtick.major.width": 0.6,
    "ytick.major.width": 0.6, "axes.unicode_minus": True, "figure.max_open_warning": 0,
}  # fmt: skip
#: Nothing of the clock or the machine goes into a file.
_METADATA: Final = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


def available() -> bool:
    """Tell whether matplotlib is there."""
    return find_spec("matplotlib") is not None


def new_figure(width: float, height: float) -> Figure:
    """Give an empty figure whose parts make room for each other; inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def file_of(figure: Figure, kind: str) -> bytes:
    """Give the bytes of a figure as ``svg`` or ``pdf``; the same figure gives the same bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, metadata=_METADATA[kind])
    return stream.getvalue()


def short(value: float) -> str:
    """A number in at most four characters; a dash where there is none."""
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else "–"
    exponent = math.floor(math.log10(abs(value)))
    if -2 <= exponent <= 2:
        return f"{value:.2g}" if exponent < 2 else f"{value:.0f}"
    return plain_exponent(f"{value:.0e}")


def plain_exponent(text: str) -> str:
    """Write "1e+05" as "1e5" and a true minus."""
    return text.replace("e+0", "e").replace("e+", "e").replace("e-0", "e−").replace("e-", "e−")


def log_scale(axes: Axes) -> None:
    """Powers of ten up the side, in plain figures."""
    axes.set_yscale("log")
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(lambda value, _: plain_exponent(f"{value:.0e}"))


def plain_log_ticks(axis: Axis, most: int = 8) -> None:
    """Powers of ten in plain figures; with 2 and 5 where they are few, other round values where there are none."""
    from matplotlib.ticker import LogLocator, MaxNLocator

    low, high = (math.log10(v) for v in axis.get_view_interval())
    few = math.floor(high) - math.ceil(low) < 2
    log = LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=most)
    axis.set_major_locator(log if high - low > 0.7 else MaxNLocator(nbins=max(2, most // 2)))
    axis.set_major_formatter(lambda value, _: f"{value:g}" if 1e-3 <= value < 1e5 else plain_exponent(f"{value:.0e}"))
    axis.set_minor_formatter(lambda value, _: "")
    axis.set_tick_params(which="minor", length=0)


def plain_log_scale(axes: Axes) -> None:
    """One, two and five times the powers of ten along the horizontal axis, for a few decades."""
    from matplotlib.ticker import LogLocator

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _: "")
    axes.xaxis.set_tick_params(which="minor", length=0)


def cut(name: str, length: int = 24) -> str:
    """A name that fits a title; control characters are replaced."""
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)
    return text if len(text) <= length else text[: length - 1] + "…"
