"""Orientation of the images: corrections with their sigmas, correlations, singular values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fg_orient.report import style
from fg_orient.report.figure_data import Folder
from fg_orient.report.orientation import corrections as readable_corrections
from fg_orient.report.words import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Limits of the observability analysis: the data say nothing, the prior holds.
LIMITS: Final = ((1e-5, "dead"), (1.0, "weak"))
#: Smallest singular value that is told from zero in the drawing.
FLOOR: Final = 1e-9
#: Unknowns up to which correlations are written into the cells.
WRITTEN: Final = 12
_DEGREE: Final = {"constant": "", "linear": " · τ", "quadratic": " · τ²"}


def corrections(folder: Folder, images: list[str]) -> Figure | None:
    """Draw the corrections of up to two images in prior sigmas with their own sigmas; values beside them.

    Without priors a correction stands in its own sigmas.
    """
    found = {str(image["image"]): image["rows"] for image in readable_corrections(folder.result)}
    wanted = [(name, found[name]) for name in images if found.get(name)]
    if not wanted:
        return None
    tallest = max(len(rows) for _, rows in wanted)
    width = style.TWO_COLUMNS if len(wanted) > 1 else style.ONE_COLUMN
    figure = style.new_figure(width, 0.95 + 0.165 * tallest)
    panels = figure.subplots(1, len(wanted), squeeze=False).ravel()
    for axes, (name, rows) in zip(panels, wanted, strict=True):
        _forest(axes, rows)
        axes.set_title(style.cut(name))
    return figure


def _forest(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """One line per unknown: value and sigma beside the prior, the numbers in their unit at the right."""
    with_priors = any(row["prior"] for row in rows)
    unit = "prior" if with_priors else "sigma"
    if with_priors:
        axes.axvspan(-1.0, 1.0, color=style.GREY, alpha=0.18, lw=0)
    axes.axvline(0.0, color=style.INK, lw=0.6)
    for k, row in enumerate(rows):
        size = row[unit]
        if size and row["value"] is not None:
            error = None if row["sigma"] is None else [row["sigma"] / size]
            axes.errorbar([row["value"] / size], [k], xerr=error, fmt="o", ms=3.2, color=style.BLUE, lw=1.0, capsize=2)
    right = axes.secondary_yaxis("right")
    right.set_yticks(range(len(rows)), [_value(row) for row in rows])
    right.tick_params(length=0, pad=2, labelsize=6.5)
    axes.set_yticks(range(len(rows)), [row["name"] + _DEGREE.get(row["degree"], f" · {row['degree']}") for row in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    reach = 1.08 * max(1.0, *np.abs(axes.get_xlim()))
    axes.set_xlim(-reach, reach)
    axes.tick_params(axis="y", length=0)
    axes.locator_params(axis="x", nbins=5)
    axes.set_xlabel("correction, prior σ (grey: ±1)" if with_priors else "correction, own σ")


def _value(row: dict[str, Any]) -> str:
    """Value and sigma with the digits that count."""
    if row["value"] is None:
        return "–"
    if not row["sigma"]:
        return f"{row['value']:.3g} {row['unit']}".replace("-", "−")
    digits = min(max(1 - math.floor(math.log10(row["sigma"])), 0), 6)
    return f"{number(row['value'], digits)} ± {number(row['sigma'], digits)} {row['unit']}"


def correlations(folder: Folder, images: list[str]) -> Figure | None:
    """Draw the correlations of the unknowns within each of up to two images; None where covariances are withheld."""
    wanted = [(name, folder.correlations[name]) for name in images if name in folder.correlations]
    if not wanted:
        return None
    from matplotlib.colors import LinearSegmentedColormap

    colours = LinearSegmentedColormap.from_list("signed", [style.BLUE, "#f7f7f7", style.ORANGE])
    width = style.TWO_COLUMNS if len(wanted) > 1 else style.ONE_COLUMN
    figure = style.new_figure(width, 4.1)
    panels = figure.subplots(1, len(wanted), squeeze=False).ravel()
    drawn: Any = None
    for axes, (name, r) in zip(panels, wanted, strict=True):
        drawn = axes.imshow(r, cmap=colours, vmin=-1.0, vmax=1.0)
        names = folder.parameters[name]
        axes.set_xticks(range(len(names)), names, rotation=90, fontsize=6)
        axes.set_yticks(range(len(names)), names, fontsize=6)
        axes.tick_params(length=0)
        axes.set_title(style.cut(name))
        if len(names) <= WRITTEN:
            _write_cells(axes, r)
    bar = figure.colorbar(drawn, ax=list(panels), location="bottom", shrink=0.5, aspect=40, pad=0.02)
    bar.set_label("correlation")
    bar.set_ticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    return figure


def _write_cells(axes: Axes, r: Any) -> None:
    for i, j in np.ndindex(r.shape):
        if i != j:
            ink = "#fdfdfd" if abs(r[i, j]) > 0.75 else "#111111"
            text = axes.text(j, i, f"{r[i, j]:.2f}".replace("-", "−"), ha="center", va="center", fontsize=5, color=ink)
            text.set_in_layout(False)


def singular_values(folder: Folder, images: list[str]) -> Figure | None:
    """Draw the singular values of some images, descending, with the limits and the names of dead directions."""
    wanted = [o for o in folder.record["observability"] if str(o["image"]) in images and o["singular_values"]]
    if not wanted:
        return None
    figure = style.new_figure(style.ONE_COLUMN, 2.9)
    axes = figure.add_subplot()
    inks = (style.BLUE, style.ORANGE, style.GREEN, style.PINK)
    for k, image in enumerate(wanted):
        values = np.array([v or 0.0 for v in image["singular_values"]])
        axes.plot(range(1, len(values) + 1), np.maximum(values, FLOOR), color=inks[k % 4], marker="os^D"[k % 4], ms=3.2,
                  mfc="none", lw=0.7, label=style.cut(str(image["image"])))  # fmt: skip
    style.log_scale(axes)
    lowest = max(min(v for o in wanted for v in (w or FLOOR for w in o["singular_values"])), FLOOR)
    for limit, word in LIMITS:
        if limit == 1.0 or lowest < 30.0 * limit:
            axes.axhline(limit, color=style.GREY, lw=0.8, ls="--")
            axes.annotate(f"{word} below", (1.0, limit), xycoords=("axes fraction", "data"), xytext=(-2, -2),
                          textcoords="offset points", ha="right", va="top", fontsize=6.5)  # fmt: skip
    axes.set_xlabel("number, in descending order")
    axes.set_ylabel("singular value, prior σ")
    axes.xaxis.get_major_locator().set_params(integer=True)  # type: ignore[call-arg]
    axes.legend(loc="upper right", frameon=False)
    return figure
