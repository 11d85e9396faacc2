"""Draw the figures of a comparison as SVG text: heat maps, condition numbers, singular values, run times.

Colour-blind readers can distinguish the colours (blue and orange; Okabe and Ito 2008). In
addition, every quantity has a number, a marker or a line style. Matplotlib (extra
"report") is imported when a figure is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import chain
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from fg_orient.adjustment.linear.registry import solver
from fg_orient.model.names import EOP_SETS
from fg_orient.report.chart import BLUE, GREY, INK, ORANGE, SERIES, Axis, Chart, broad, decades, limits_of, short
from fg_orient.report.paper import STYLE, available, file_of, new_figure, panels_of
from fg_orient.studies.comparison.model import (
    LARGEST_CONDITION,
    Comparison,
    ErrorVectors,
    groups,
    regularisation_words,
    tried,
)
from fg_orient.studies.error_maps import RoleErrors, error_map, places_km

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: Style of the figures. They are larger than a column of a paper, because they are for pages.
_STYLE: Final[dict[Any, Any]] = {
    **STYLE, "font.size": 9, "axes.titlesize": 9, "axes.labelsize": 9, "xtick.labelsize": 9, "ytick.labelsize": 9,
    "legend.fontsize": 8,
}  # fmt: skip
#: Range of the colours in heat maps, as powers of ten relative to the target.
_DECADES: Final = (-2.0, 4.0)
#: Systems whose condition numbers and spectra are drawn, with their words and kinds of mark.
_SYSTEMS: Final = {
    ("published 1", "raw"): ("published, raw units", "series-1"),
    ("published 1", "columns"): ("published, columns scaled", "series-3"),
    ("published 2", "raw"): ("published, raw units", "series-1"),
    ("published 2", "columns"): ("published, columns scaled", "series-3"),
    ("no priors", "priors"): ("prior units, without priors", "series-2"),
    ("adjustment", "priors"): ("prior units, with priors (as solved)", "series-0"),
}
#: Kinds of mark for systems with a penalty.
_REGULARISED: Final = ("series-4", "series-5", "control", "check", "station", "tie")


def figures(comparison: Comparison) -> dict[str, str]:
    """Draw the figures for which the rows have data: SVG text by file name.

    No figures without matplotlib.
    """
    if not available():
        return {}
    drawings: dict[str, Callable[[Comparison], Figure | None]] = {
        "heatmap_control.svg": lambda c: _heat_map(c, "control"),
        "heatmap_check.svg": lambda c: _heat_map(c, "check"),
        "conditions.svg": _conditions,
        "spectra.svg": _spectra,
        "l_curves.svg": _l_curves,
        "error_vectors_solvers.svg": _vectors_of_solvers,
        "error_vectors_sets.svg": _vectors_of_sets,
        "seconds.svg": _seconds,
    }
    import matplotlib

    out = {}
    with matplotlib.rc_context(_STYLE):
        for name, draw in drawings.items():
            figure = draw(comparison)
            if figure is not None:
                out[name] = file_of(figure, "svg").decode()
    return out


def _heat_map(comparison: Comparison, role: str) -> Figure | None:
    """Draw the RMSE relative to the target for each EOP set and solver.

    Failed adjustments are hatched.
    """
    grouped, sets = tried(comparison), comparison.eop_sets
    values = [[math.nan if r is None else getattr(r, f"{role}_rmse_m") for r in rows] for rows in grouped.values()]
    failed = [[r is not None and bool(r.failure) for r in rows] for rows in grouped.values()]
    if not np.isfinite(values).any():
        return None
    figure = new_figure(2.9 + 0.36 * max(len(sets), 13), 1.3 + 0.235 * len(grouped))
    axes = figure.add_subplot()
    image = _coloured(axes, np.array(values), np.array(failed), comparison.target_m)
    axes.set_xticks(range(len(sets)), [str(n) for n in sets])
    axes.set_yticks(range(len(grouped)), [key.name(comparison.labels) for key in grouped])
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
            artist.set_in_layout(False)  # otherwise the layout of hundreds of cells takes most of the time
    return image


def _separate(axes: Axes, keys: list[tuple[str, int | None]]) -> None:
    """Draw lines between backends and types."""
    for i in range(1, len(keys)):
        if keys[i] != keys[i - 1]:
            axes.axhline(i - 0.5, color=INK, lw=1.2)


def _conditions(comparison: Comparison) -> Figure | None:
    """Draw the condition numbers of N by EOP set, before and after scaling and priors."""
    wanted = _systems(comparison)
    if not wanted:
        return None
    sets = comparison.eop_sets
    values = [s.condition for s in comparison.spectra if (s.system, s.scaling) in wanted]
    x = Axis("EOP set", (-0.6, len(sets) - 0.4), names=[str(n) for n in sets])
    y = Axis("condition number of N", decades([*values, LARGEST_CONDITION]), log=True)
    chart = broad("condition numbers", x, y)
    for key, (label, kind) in wanted.items():
        conditions = {s.eop_set: s.condition for s in comparison.spectra if (s.system, s.scaling) == key}
        chart.add("dots", kind, [sets.index(n) for n in conditions], list(conditions.values()), label=label)
    chart.across("limit", 1e16, label="1e16: limit of the publication")
    chart.across("zero", LARGEST_CONDITION)
    return panels_of([chart], 7.2, 3.6)


def _systems(comparison: Comparison) -> dict[tuple[str, str], tuple[str, str]]:
    """Return the systems to draw with words and kind of mark; of the two published types, only the first."""
    present = {(s.system, s.scaling) for s in comparison.spectra}
    treated = [word for word in comparison.regularisations if regularisation_words(word)]
    known = _SYSTEMS | {
        (f"adjustment, {word}", "priors"): (f"prior units, {regularisation_words(word)}", kind)
        for word, kind in zip(treated, _REGULARISED, strict=False)
    }
    drawn = [k for k in known if k in present and (k[0] != "published 2" or ("published 1", k[1]) not in present)]
    return {key: known[key] for key in drawn}


def _spectra(comparison: Comparison) -> Figure | None:
    """Draw the singular values of A, with one panel for each EOP set."""
    wanted = _systems(comparison)
    if not wanted:
        return None
    drawn = [s for s in comparison.spectra if (s.system, s.scaling) in wanted]
    floor = np.finfo(float).eps / 10.0  # smaller values have no meaning
    shares = [np.maximum(s.values / s.values[0], floor) for s in drawn]
    y = Axis("singular value / largest", decades(np.concatenate(shares)), log=True)
    charts = []
    for number in comparison.eop_sets:
        dead = sum(d.held_by == "nothing" for d in comparison.directions if d.eop_set == number)
        title = f"{number} {EOP_SETS[number].name}" + (f" ({dead})" if dead else "")
        chart = Chart("singular values", Axis("first to last", about=1), y, title=title)
        for s, share in zip(drawn, shares, strict=True):
            if s.eop_set == number:
                label, kind = wanted[s.system, s.scaling]
                chart.add("line", kind, np.linspace(0, 1, len(share)), share, label=label)
        charts.append(chart)
    return panels_of(charts, 1.75, 1.6)


def _l_curves(comparison: Comparison) -> Figure | None:
    """Draw the L-curves of the published bundle, with one panel for each EOP set, and the choices of its solvers."""
    types = sorted({of_set.type for of_set in comparison.curves})
    chosen = [(name, solver(name).label) for name in comparison.solvers if solver(name).family == "tikhonov"]
    if not types or not chosen:
        return None
    curves = {of_set.eop_set: of_set.curve for of_set in comparison.curves if of_set.type == types[0]}
    charts = []
    for number in comparison.eop_sets:
        chart = Chart("L-curve", title=f"{number} {EOP_SETS[number].name}")
        if number in curves:
            curve = curves[number]
            kappas = {row.solver: row.kappa for row in comparison.select(eop_set=number, type=types[0])}
            places = [curve.place(kappas.get(name, math.nan)) for name, _ in chosen]
            chart.add("line", "normal", curve.residual_norm, curve.solution_norm)
            for k, ((_, label), place) in enumerate(zip(chosen, places, strict=True)):
                chart.add("dots", f"series-{k % SERIES}", [place[0]], [place[1]], label=label)
            across, up = (limits_of([*norms, *(p[k] for p in places)])
                          for k, norms in enumerate((curve.residual_norm, curve.solution_norm)))  # fmt: skip
            chart.x, chart.y = Axis("|Ax − l|", across, log=True), Axis("|x|: m, m/s, rad", up, log=True)
        charts.append(chart)
    return panels_of(charts, 1.75, 1.8)


def _vectors_of_solvers(comparison: Comparison) -> Figure | None:
    """Draw error vectors of the published procedure with the recommended or first set, for each type and solver."""
    if not comparison.vectors:
        return None
    sets = {one.eop_set for one in comparison.vectors}
    wanted = None if comparison.advice is None else comparison.advice.eop_set
    number = wanted if wanted in sets else min(sets)
    return _maps(comparison, [
        (one, f"{one.type} {comparison.labels.get(one.solver, one.solver)}")
        for one in sorted(comparison.vectors, key=lambda own: own.type) if one.eop_set == number
    ])  # fmt: skip


def _vectors_of_sets(comparison: Comparison) -> Figure | None:
    """Draw error vectors for each type and set, with the published solver that solves most sets."""
    solved = [one.solver for one in comparison.vectors]
    if not solved or len(comparison.eop_sets) == 1:
        return None
    solver_name = max(comparison.solvers, key=solved.count)
    return _maps(comparison, [
        (one, f"{one.type} set {one.eop_set} {EOP_SETS[one.eop_set].name}")
        for one in sorted(comparison.vectors, key=lambda own: own.type) if one.solver == solver_name
    ])  # fmt: skip


def _maps(comparison: Comparison, chosen: list[tuple[ErrorVectors, str]]) -> Figure | None:
    """Draw maps of the error vectors that have a row, with their titles."""
    places, charts = places_km(comparison.block), []
    for one, title in chosen:
        for row in comparison.select(eop_set=one.eop_set, backend="faithful", type=one.type, solver=one.solver):
            rmse = {"control": row.control_rmse_m, "check": row.check_rmse_m}
            roles = {role: RoleErrors(names, one.enu_m[role], rmse[role]) for role, names in one.ids.items()}
            charts.append(error_map(places, roles, title, numbers=False))
    return panels_of(charts, 2.2, 2.6) if charts else None


def _seconds(comparison: Comparison) -> Figure | None:
    """Draw the median and range of the processor times over the EOP sets."""
    solved = groups([r for r in comparison.rows if math.isfinite(r.processor_s) and not r.failure])
    timed = {key.name(comparison.labels): [r.processor_s for r in rows] for key, rows in solved.items()}
    if not timed:
        return None
    x = Axis("processor time per adjustment, s", limits_of([*chain(*timed.values())]), log=True)
    chart = broad("run times", x, Axis(limits=(-0.5, len(timed) - 0.5), down=True, names=[*timed]))
    for k, values in enumerate(timed.values()):
        chart.add("line", "limit", [min(values), max(values)], [k, k])
    chart.add("dots", "line-dot", [float(np.median(values)) for values in timed.values()], range(len(timed)))
    return panels_of([chart], 7.2, 0.9 + 0.22 * len(timed))
