"""Figures of a comparison as SVG text: heat maps, condition numbers, singular values, run times.

Colours are told apart by colour-blind readers (blue and orange; Okabe and Ito 2008), and every
quantity also has a number, a marker or a line style. Matplotlib (extra "report") is loaded on use.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fg_orient.adjustment.linear.registry import solver
from fg_orient.model.names import EOP_SETS
from fg_orient.report.chart import BLUE, GREEN, GREY, INK, ORANGE, PINK, plain_exponent, short
from fg_orient.report.paper import STYLE, available, file_of, new_figure
from fg_orient.studies.comparison.model import LARGEST_CONDITION, Comparison, groups

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from fg_orient.adjustment.linear.l_curve import LCurve

#: Larger than in a paper's column: these figures are read on pages.
_STYLE: Final[dict[Any, Any]] = {
    **STYLE, "font.size": 9, "axes.titlesize": 9, "axes.labelsize": 9, "xtick.labelsize": 9, "ytick.labelsize": 9,
    "legend.fontsize": 8,
}  # fmt: skip
#: Powers of ten beside the target that the heat maps tell apart.
_DECADES: Final = (-2.0, 4.0)
#: Systems of the condition numbers and spectra: words, colour, marker, line.
_SYSTEMS: Final = {
    ("published 1", "raw"): ("published, raw units", ORANGE, "s", "-"),
    ("published 1", "columns"): ("published, columns scaled", PINK, "D", "--"),
    ("published 2", "raw"): ("published, raw units", ORANGE, "s", "-"),
    ("published 2", "columns"): ("published, columns scaled", PINK, "D", "--"),
    ("no priors", "priors"): ("prior units, without priors", GREEN, "^", ":"),
    ("adjustment", "priors"): ("prior units, with priors (as solved)", BLUE, "o", "-"),
}


def figures(comparison: Comparison) -> dict[str, str]:
    """Give the figures that the rows support: file name to SVG text; none without matplotlib."""
    if not available():
        return {}
    found: dict[str, Callable[[Comparison], Figure | None]] = {
        "heatmap_control.svg": lambda c: _heat_map(c, "control"),
        "heatmap_check.svg": lambda c: _heat_map(c, "check"),
        "conditions.svg": _conditions,
        "spectra.svg": _spectra,
        "l_curves.svg": _l_curves,
        "seconds.svg": _seconds,
    }
    import matplotlib

    out = {}
    with matplotlib.rc_context(_STYLE):
        for name, draw in found.items():
            figure = draw(comparison)
            if figure is not None:
                out[name] = file_of(figure, "svg").decode()
    return out


def row_name(comparison: Comparison, backend: str, kind: int | None, solver: str) -> str:
    """Name a group of rows for people."""
    label = comparison.labels.get(solver, solver)
    words = {"faithful": f"published {kind}", "dense": "dense", "graph": "graph"}
    return f"{words[backend]} · {label}"


def _heat_map(comparison: Comparison, role: str) -> Figure | None:
    """EOP set x solver: RMSE beside the target; failed adjustments hatched."""
    grouped = {k: rows for k, rows in groups(comparison.rows).items() if not all(r.left_out for r in rows)}
    sets = comparison.eop_sets
    values = np.full((len(grouped), len(sets)), np.nan)
    failed = np.zeros(values.shape, bool)
    for i, rows in enumerate(grouped.values()):
        for row in rows:
            j = sets.index(row.eop_set)
            values[i, j], failed[i, j] = getattr(row, f"{role}_rmse_m"), bool(row.failure)
    if not np.isfinite(values).any():
        return None
    figure = new_figure(2.9 + 0.36 * max(len(sets), 13), 1.3 + 0.235 * len(grouped))
    axes = figure.add_subplot()
    image = _coloured(axes, values, failed, comparison.target_m)
    axes.set_xticks(range(len(sets)), [str(n) for n in sets])
    axes.set_yticks(range(len(grouped)), [row_name(comparison, *key) for key in grouped])
    axes.set_xlabel("EOP set")
    axes.tick_params(length=0)
    _separate(axes, [key[:2] for key in grouped])
    pad = 0.1 / figure.get_figheight()
    bar = figure.colorbar(image, ax=axes, location="top", shrink=0.8, aspect=40, pad=pad, extend="both")
    ticks = range(int(_DECADES[0]), int(_DECADES[1]) + 1)
    bar.set_ticks(list(ticks), labels=[short(comparison.target_m * 10.0**k) for k in ticks])
    bar.set_label(f"RMSE at {role} points, m; white: target {comparison.target_m:.3g} m")
    return figure


def _coloured(axes: Axes, values: Any, failed: Any, target_m: float) -> Any:
    """Draw the cells with their numbers."""
    from matplotlib.colors import LinearSegmentedColormap, TwoSlopeNorm
    from matplotlib.patches import Rectangle

    colours = LinearSegmentedColormap.from_list("target", [BLUE, "#f7f7f7", ORANGE])
    with np.errstate(divide="ignore", invalid="ignore"):
        decades = np.log10(values / target_m)
    image = axes.imshow(
        np.ma.masked_invalid(np.clip(decades, *_DECADES)),
        cmap=colours,
        norm=TwoSlopeNorm(0.0, *_DECADES),
        aspect="auto",
    )
    for i, j in np.ndindex(values.shape):
        artist: Any = None
        if failed[i, j]:
            artist = axes.add_patch(
                Rectangle((j - 0.5, i - 0.5), 1, 1, facecolor="none", edgecolor=GREY, hatch="////", lw=0)
            )
        elif np.isfinite(values[i, j]):
            dark = not -1.0 < decades[i, j] < 2.2
            ink = "#fdfdfd" if dark else "#111111"
            artist = axes.text(j, i, short(values[i, j]), ha="center", va="center", fontsize=6, color=ink)
        if artist is not None:
            artist.set_in_layout(False)  # hundreds of cells: laying them out takes most of the time
    return image


def _separate(axes: Axes, keys: list[tuple[str, int | None]]) -> None:
    """Lines between backends and types."""
    for i in range(1, len(keys)):
        if keys[i] != keys[i - 1]:
            axes.axhline(i - 0.5, color=INK, lw=1.2)


def _conditions(comparison: Comparison) -> Figure | None:
    """Condition numbers of N by EOP set, before and after scaling and priors."""
    wanted = _systems(comparison)
    if not wanted:
        return None
    figure = new_figure(7.2, 3.6)
    axes = figure.add_subplot()
    for key in wanted:
        label, colour, marker, _ = _SYSTEMS[key]
        found = {s.eop_set: s.condition for s in comparison.spectra if (s.system, s.scaling) == key}
        places = [comparison.eop_sets.index(n) for n in found]
        axes.plot(places, list(found.values()), color=colour, marker=marker, ls="", ms=5, label=label)
    log_scale(axes)
    axes.axhline(1e16, color=GREY, lw=1, ls="-.", label="1e16: limit of the publication")
    axes.axhline(LARGEST_CONDITION, color=GREY, lw=0.6)
    axes.set_xticks(range(len(comparison.eop_sets)), [str(n) for n in comparison.eop_sets])
    axes.set_xlabel("EOP set")
    axes.set_ylabel("condition number of N")
    figure.legend(loc="outside upper center", ncols=2, frameon=False)
    return figure


def _systems(comparison: Comparison) -> list[tuple[str, str]]:
    """Systems to draw; of the two published types the first."""
    present = {(s.system, s.scaling) for s in comparison.spectra}
    keys = [key for key in _SYSTEMS if key in present]
    return [k for k in keys if k[0] != "published 2" or ("published 1", k[1]) not in present]


def _spectra(comparison: Comparison) -> Figure | None:
    """Singular values of A, one panel per EOP set."""
    wanted = _systems(comparison)
    if not wanted:
        return None
    sets = comparison.eop_sets
    columns = min(5, len(sets))
    lines = -(-len(sets) // columns)
    figure = new_figure(max(1.75 * columns, 5.0), 1.5 * lines + 0.9)
    panels = figure.subplots(lines, columns, sharex=False, sharey=True, squeeze=False).ravel()
    for panel, number in zip(panels, sets, strict=False):
        silent = sum(d.held_by == "nothing" for d in comparison.directions if d.eop_set == number)
        panel.set_title(f"{number} {EOP_SETS[number].name}" + (f": {silent} silent" if silent else ""))
        for key in wanted:
            label, colour, _, line = _SYSTEMS[key]
            for s in comparison.spectra:
                if s.eop_set == number and (s.system, s.scaling) == key:
                    floor = s.values[0] * np.finfo(float).eps / 10.0  # below is rounding of rounding
                    panel.plot(np.linspace(0, 1, len(s.values)), np.maximum(s.values, floor) / s.values[0],
                               color=colour, ls=line, lw=1.2, label=label)  # fmt: skip
        log_scale(panel)
        panel.set_xticks([0, 1], ["first", "last"])
    for panel in panels[len(sets) :]:
        panel.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    figure.supylabel("singular value / largest", fontsize=9)
    return figure


def _l_curves(comparison: Comparison) -> Figure | None:
    """L-curves of the published bundle, one panel per EOP set, with the choices of its Tikhonov solvers."""
    kinds = sorted({found.type for found in comparison.curves})
    chosen = [(name, solver(name).label) for name in comparison.solvers if solver(name).family == "tikhonov"]
    if not kinds or not chosen:
        return None
    sets, columns = comparison.eop_sets, min(5, len(comparison.eop_sets))
    lines = -(-len(sets) // columns)
    figure = new_figure(max(1.75 * columns, 5.0), 1.6 * lines + 0.9)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    curves = {found.eop_set: found.curve for found in comparison.curves if found.type == kinds[0]}
    for panel, number in zip(panels, sets, strict=False):
        panel.set_title(f"{number} {EOP_SETS[number].name}")
        panel.set_xscale("log")
        panel.set_yscale("log")
        if number in curves:
            kappas = {row.solver: row.kappa for row in comparison.select(eop_set=number, type=kinds[0])}
            _l_curve(panel, curves[number], [(label, kappas.get(name, math.nan)) for name, label in chosen])
        plain_log_ticks(panel.xaxis, 3)
        plain_log_ticks(panel.yaxis, 5)
        panel.tick_params(labelsize=7)
    for panel in panels[len(sets) :]:
        panel.set_axis_off()
    handles = {label: h for p in panels for h, label in zip(*p.get_legend_handles_labels(), strict=True)}
    figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=4, frameon=False)
    figure.supxlabel("norm of the residuals |Ax − l|", fontsize=9)
    figure.supylabel("norm of the solution |x| (m, m/s, rad)", fontsize=9)
    return figure


def _l_curve(panel: Axes, curve: LCurve, chosen: list[tuple[str, float]]) -> None:
    """Draw a curve with the kappas of some solvers by their labels."""
    panel.plot(curve.residual_norm, curve.solution_norm, color=GREY, lw=1.2)
    for k, (label, kappa) in enumerate(chosen):
        colour, marker = (BLUE, ORANGE, GREEN, PINK)[k % 4], "osD^v*"[k % 6]
        panel.plot(*curve.place(kappa), color=colour, marker=marker, mfc="none", ls="", ms=5, label=label)


def _seconds(comparison: Comparison) -> Figure | None:
    """Median and range of the run times over the EOP sets."""
    timed: list[tuple[str, list[float]]] = []
    for key, rows in groups(comparison.rows).items():
        values = [r.seconds for r in rows if math.isfinite(r.seconds) and not r.failure]
        if values:
            timed.append((row_name(comparison, *key), values))
    if not timed:
        return None
    figure = new_figure(7.2, 0.9 + 0.22 * len(timed))
    axes = figure.add_subplot()
    for i, (_, values) in enumerate(timed):
        axes.plot([min(values), max(values)], [i, i], color=GREY, lw=2, solid_capstyle="round")
        axes.plot([float(np.median(values))], [i], "o", color=BLUE, ms=5)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_yticks(range(len(timed)), [name for name, _ in timed])
    axes.invert_yaxis()
    axes.set_xlabel("seconds per adjustment: median and range over the EOP sets")
    axes.grid(axis="x", lw=0.4, color=GREY)
    return figure


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
