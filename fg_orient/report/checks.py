"""How well the observations check each other, and how the adjustment came to its end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fg_orient.report import style
from fg_orient.report.figure_data import LINE_SAMPLE, Folder
from fg_orient.report.residuals import INKS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BINS: Final = 25
#: Biases that differ by more than this factor stand on a logarithmic axis.
WIDE: Final = 8.0


def redundancy(folder: Folder, images: list[str]) -> Figure | None:
    """Draw redundancy numbers of the image points, and their minimal detectable biases; None where withheld."""
    table = folder.residuals
    if not len(table) or "redundancy_line" not in table.figures:
        return None
    biases = "mdb_line_px" in table.figures
    figure = style.new_figure(style.TWO_COLUMNS if biases else style.ONE_COLUMN, 2.4)
    panels = figure.subplots(1, 2 if biases else 1, squeeze=False).ravel()
    for name in LINE_SAMPLE:
        colour, line, _ = INKS[name]
        how: dict[str, Any] = {"color": colour, "ls": line, "lw": 1.2, "label": name, "histtype": "step"}
        panels[0].hist(np.clip(table.figures[f"redundancy_{name}"], 0.0, 1.0), np.linspace(0.0, 1.0, _BINS + 1), **how)
    panels[0].set_xlabel("redundancy number r")
    panels[0].set_ylabel("image points")
    panels[0].set_xlim(0.0, 1.0)
    panels[0].legend(loc="upper center", frameon=False)
    if biases:
        _biases(panels[1], folder)
    return figure


def _biases(axes: Axes, folder: Folder) -> None:
    """Share of the image points whose error of a given size is found, by axis."""
    for name in LINE_SAMPLE:
        given = folder.residuals.figures[f"mdb_{name}_px"]
        known = np.sort(given[np.isfinite(given)])
        if not len(known):
            continue
        colour, line, _ = INKS[name]
        share = np.arange(1, len(known) + 1) / len(given)
        axes.step(known, share, where="post", color=colour, ls=line, lw=1.2, label=name)
    record = folder.record.get("reliability") or {}
    ends = [float(x) for line in axes.lines for x in np.asarray(line.get_xdata(), float)[[0, -1]]]
    if ends and max(ends) > WIDE * min(ends) > 0.0:
        style.plain_log_scale(axes)
    axes.set_ylim(0.0, 1.02)
    axes.set_ylabel("share of image points")
    size, power = record.get("alpha"), record.get("power")
    found = f" (size {size:g}, power {power:g})" if size and power else ""
    axes.set_xlabel(f"minimal detectable bias, px{found}")
    axes.legend(loc="lower right", frameon=False)


def iterations(folder: Folder, images: list[str]) -> Figure | None:
    """Draw the weighted squares and the largest step by iteration; None where no log is kept."""
    log = folder.result.iterations
    if not log:
        return None
    figure = style.new_figure(style.ONE_COLUMN, 3.2)
    upper, lower = figure.subplots(2, 1, sharex=True)
    number = [0, *(int(i["iteration"]) for i in log)]
    upper.plot(number, [log[0]["chi2"], *(i["chi2_after"] for i in log)], color=style.BLUE, marker="o", ms=3.5, lw=1.0)
    steps = np.array([float(i["step"] or np.nan) for i in log])
    taken = np.array([bool(i["accepted"]) for i in log])
    lower.plot(number[1:], steps, color=style.INK, lw=0.7)
    for mask, filled, words in ((taken, style.ORANGE, "taken"), (~taken, "none", "rejected")):
        if mask.any():
            lower.plot(np.array(number[1:])[mask], steps[mask], color=style.ORANGE, marker="s", ms=3.5, mfc=filled,
                       ls="", label=words)  # fmt: skip
    for axes in (upper, lower):
        if all(v > 0.0 for line in axes.lines for v in np.asarray(line.get_ydata(), float) if np.isfinite(v)):
            style.log_scale(axes)
        axes.grid(axis="y", lw=0.3, color=style.GREY)
    upper.set_ylabel("weighted squares")
    lower.set_ylabel("largest step, prior σ or m")
    lower.set_xlabel("iteration")
    lower.xaxis.get_major_locator().set_params(integer=True)
    lower.legend(loc="lower left", frameon=False)
    figure.align_ylabels()
    return figure
