"""Drawing of charts by matplotlib (extra "report") for papers, as SVG and PDF files.

The same chart gives the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from fg_orient.report.chart import BLUE, GREY, INK, INKS, ORANGE, Axis, Chart, Mark, cut, hundredths

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colours of paper and ink. A page that contains a figure replaces them by its own colours, for example on a dark page.
PAPER: Final = "#fefefe"
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
#: Files do not depend on the time or the machine.
_METADATA: Final = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
#: Legend of a map.
_ABOVE: Final[dict[str, Any]] = {
    "loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": 4, "handletextpad": 0.2, "columnspacing": 1.0,
}  # fmt: skip
#: Maximum number of unknowns for which correlations are written into the cells.
WRITTEN: Final = 12


def available() -> bool:
    """Return whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches, in which parts do not overlap."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def file_of(figure: Figure, kind: str) -> bytes:
    """Return the bytes of a figure as ``svg`` or ``pdf``; the same figure gives the same bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, metadata=_METADATA[kind])
    return stream.getvalue()


def figure_of(charts: Sequence[Chart]) -> Figure:
    """Draw charts in one figure, two per row, as wide as one or two columns of a journal."""
    columns = min(2, len(charts))
    width = ONE_COLUMN if columns == 1 else TWO_COLUMNS
    wide = width / columns - 0.6
    return _grid(charts, columns, width, max(wide * _shape(chart) for chart in charts) + 0.75)[0]


def _grid(
    charts: Sequence[Chart], columns: int, width: float, height: float, more: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """Draw charts in rows of a given height, inches, plus ``more`` for the figure.

    Return the figure and the used axes.
    """
    lines = -(-len(charts) // columns)
    figure = new_figure(width, height * lines + more)
    panels = list(figure.subplots(lines, columns, squeeze=False).ravel())
    for axes, chart in zip(panels, charts, strict=False):
        draw(axes, chart)
    for axes in panels[len(charts) :]:
        axes.set_axis_off()
    return figure, panels[: len(charts)]


def panels_of(charts: Sequence[Chart], width: float, height: float) -> Figure:
    """Draw charts as panels of a size in inches, five per row, with one common legend above."""
    columns = min(5, len(charts))
    figure, panels = _grid(charts, columns, max(width * columns, 5.0), height, 0.9 if len(charts) > 1 else 0.0)
    for k, axes in enumerate(panels):
        if k % columns:
            axes.set_ylabel("")
        if k + columns < len(charts):
            axes.set_xlabel("")
        if legend := axes.get_legend():
            legend.remove()
    handles = {label: h for p in panels for h, label in zip(*p.get_legend_handles_labels(), strict=True)}
    if handles:
        figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=2, frameon=False)
    return figure


def _shape(chart: Chart) -> float:
    """Return the height of the frame divided by its width."""
    if chart.y.names and not chart.x.names:
        return max(0.35, 0.06 * len(chart.y.names))
    return float(np.clip(chart.inner[1] / chart.inner[0], 0.62, 1.5))


def draw(axes: Axes, chart: Chart) -> None:
    """Draw a chart into empty axes."""
    _scale(axes, chart.x, "x")
    _scale(axes, chart.y, "y")
    if chart.aspect is not None:
        axes.set_aspect(chart.aspect)
    axes.set_title(cut(chart.title, 40), loc="left")
    for mark in chart.marks:
        _DRAW[mark.shape](axes, mark, chart)
    if chart.y.beside:
        right = axes.secondary_yaxis("right")
        right.set_yticks(range(len(chart.y.beside)), list(chart.y.beside))
        right.tick_params(length=0, pad=2, labelsize=6.5)
    for k, (share, words) in enumerate(chart.bars):
        x, y = (0.04, 0.05 + 0.06 * (len(chart.bars) - 1 - k)) if not chart.framed else (1.0 - share, 1.035)
        axes.plot([x, x + share], [y, y], color=INK, lw=1.6, solid_capstyle="butt", transform=axes.transAxes,
                  clip_on=False)  # fmt: skip
        at, side = (x - 0.02, "right") if chart.framed else (x + share + 0.02, "left")
        paper = {"facecolor": PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 0.6}  # outlines may cross the words
        axes.text(at, y, words, va="center", ha=side, fontsize=6.5, transform=axes.transAxes, zorder=5, bbox=paper)
    if any(mark.label for mark in chart.marks):
        how: dict[str, Any] = {
            "loc": {"top": "upper left", "bottom": "lower left", "right": "upper right"}[chart.legend]
        }
        axes.legend(frameon=False, **how if chart.framed else _ABOVE)
    if chart.note:
        axes.set_title(f"{cut(chart.title)} {chart.note}".strip(), loc="left")


def _scale(axes: Axes, axis: Axis, name: Literal["x", "y"]) -> None:
    """Set limits, ticks and texts of one axis."""
    low, high = axis.limits
    of = getattr(axes, f"{name}axis")
    if axis.log:
        getattr(axes, f"set_{name}scale")("log")
    axes.set(**{f"{name}lim": (high, low) if axis.down else (low, high), f"{name}label": axis.words})
    of.label.set_wrap(name == "x")  # words that are wider than the figure continue on a second line
    given = axis.ticks()
    of.set_ticks([value for value, _ in given], labels=[words for _, words in given])
    of.minorticks_off()
    if axis.names:
        axes.tick_params(axis=name, length=0, labelrotation=90 if name == "x" and max(map(len, axis.names)) > 3 else 0)


def _line(axes: Axes, mark: Mark, chart: Chart) -> None:
    ink = INKS[mark.kind]
    axes.plot(mark.x, mark.y, color=ink.colour, ls=ink.line, lw=ink.width, label=mark.label or None)


def _area(axes: Axes, mark: Mark, chart: Chart) -> None:
    ink = INKS[mark.kind]
    if ink.filled:
        axes.fill(mark.x, mark.y, color=ink.colour, alpha=0.3, lw=0, label=mark.label or None)
    else:
        axes.plot(*np.stack([mark.x, mark.y])[:, [*range(len(mark.x)), 0]], color=ink.colour, ls=ink.line, lw=ink.width,
                  label=mark.label or None)  # fmt: skip


def _dots(axes: Axes, mark: Mark, chart: Chart) -> None:
    ink = INKS[mark.kind]
    radii = ink.radius if mark.sizes is None else mark.sizes
    axes.scatter(
        mark.x, mark.y, s=(0.9 * radii) ** 2, marker=ink.marker, label=mark.label or None, zorder=3,
        facecolors=ink.colour if ink.filled else "none", edgecolors=ink.colour, linewidths=0.7,
    )  # fmt: skip
    if mark.vectors is None or not chart.per_width:
        return
    how: dict[str, Any] = {"width": 0.008, "headwidth": 0, "headlength": 0, "headaxislength": 0} if mark.thick else {}
    u, v = mark.vectors.T
    axes.quiver(mark.x, mark.y, u, -v if chart.y.down else v, color=ink.colour, angles="uv", scale=chart.per_width,
                scale_units="width", zorder=4, **{"width": 0.004, **how})  # fmt: skip


def _bars(axes: Axes, mark: Mark, chart: Chart) -> None:
    ink = INKS[mark.kind]
    axes.stairs(mark.y, mark.x, color=ink.colour, ls=ink.line, lw=ink.width, label=mark.label or None)


def _names(axes: Axes, mark: Mark, chart: Chart) -> None:
    for words, x, y in zip(mark.tips, mark.x.tolist(), mark.y.tolist(), strict=True):
        at, how = ((4.0, 3.0), "left") if mark.kind == "mark-label" else ((0.0, -8.0), "center")
        axes.annotate(words, (x, y), xytext=at, textcoords="offset points", ha=how, fontsize=7)


def _cells(axes: Axes, mark: Mark, chart: Chart) -> None:
    """Draw the lower triangle of a matrix with a colour bar."""
    from matplotlib.colors import LinearSegmentedColormap

    colours = LinearSegmentedColormap.from_list("signed", [BLUE, "#f7f7f7", ORANGE])
    hidden = np.triu(np.ones(mark.y.shape, bool))
    drawn = axes.imshow(np.ma.array(mark.y, mask=hidden), cmap=colours, vmin=-1.0, vmax=1.0)
    axes.tick_params(labelsize=6)
    bar = axes.figure.colorbar(drawn, ax=axes, location="bottom", shrink=0.7, aspect=40, pad=0.02)
    bar.set_label("correlation")
    bar.set_ticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    for (i, j), rho in np.ndenumerate(mark.y):
        if j < i and np.isfinite(rho) and (len(mark.y) <= WRITTEN or abs(rho) >= 0.9):
            ink = "#fdfdfd" if abs(rho) > 0.75 else "#111111"
            axes.text(j, i, hundredths(rho), ha="center", va="center", fontsize=5, color=ink).set_in_layout(False)


def _blocks(axes: Axes, mark: Mark, chart: Chart) -> None:
    """Draw filled rectangles."""
    from matplotlib.collections import PolyCollection

    corners = np.stack([mark.x[:, [0, 1, 1, 0]], mark.y[:, [0, 0, 1, 1]]], axis=-1)
    axes.add_collection(PolyCollection(list(corners), facecolors=INKS[mark.kind].colour, label=mark.label or None))


_DRAW: Final = {
    "line": _line, "area": _area, "dots": _dots, "bars": _bars, "names": _names, "cells": _cells, "blocks": _blocks,
}  # fmt: skip
