"""The L-curve of an adjustment by a regularised solver, with the kappas of all rules."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fg_orient.report import style
from fg_orient.report.figure_data import Folder
from fg_orient.report.l_curve import neighbours, on_curve, ranked

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Choices whose places are less apart than this share of the axes get one number.
_NEAR = 0.035


def l_curve(folder: Folder) -> Figure | None:
    """Draw the norm of the solution over that of the residuals; None where nothing was regularised."""
    section = folder.record.get("regularisation")
    if not section:
        return None
    figure = style.new_figure(style.ONE_COLUMN, 2.9)
    axes = figure.add_subplot()
    axes.plot(section["curve"]["residual_norm"], section["curve"]["solution_norm"], color=style.INK, lw=1.0)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.09)
    choices = [choice for choice in ranked(section) if on_curve(choice)]
    for choice in sorted(choices, key=lambda c: bool(c["chosen"])):
        marker, fill, colour = ("o", style.BLUE, style.BLUE) if choice["chosen"] else ("s", "none", style.ORANGE)
        at = choice["residual_norm"], choice["solution_norm"]
        axes.plot(*at, color=colour, marker=marker, mfc=fill, ms=4.5, ls="", zorder=3)
    _number(axes, choices)
    for axis in (axes.xaxis, axes.yaxis):
        style.plain_log_ticks(axis)
    axes.set_xlabel("norm of the residuals |Ax − l|, σ")
    axes.set_ylabel("norm of the solution |x|, prior σ and m")
    return figure


def _number(axes: Axes, choices: list[dict[str, float]]) -> None:
    """Write the numbers of the rules beside their marks, of those that lie together into one label."""
    to_axes = axes.transData + axes.transAxes.inverted()
    places = [tuple(to_axes.transform((c["residual_norm"], c["solution_norm"]))) for c in choices]
    for group in ([choices[k] for k in found] for found in neighbours(places, _NEAR)):
        at = max(c["residual_norm"] for c in group), max(c["solution_norm"] for c in group)
        words = ", ".join(str(c["number"]) for c in group)
        axes.annotate(words, at, xytext=(4, 3), textcoords="offset points", fontsize=7)
