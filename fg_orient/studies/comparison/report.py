"""HTML report of a comparison, in the template of all reports, with heat maps as tables of numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from fg_orient.model.errors import sentences
from fg_orient.report.chart import INK, short
from fg_orient.report.page import environment
from fg_orient.report.paper import PAPER
from fg_orient.studies.comparison.model import GRAPH_SOLVER, LARGEST_CONDITION, Comparison, Direction, Row, groups
from fg_orient.studies.comparison.plots import row_name
from fg_orient.studies.comparison.words import ranges, summaries, verdict

#: Upper ends of the steps, as multiples of the target, and their classes: blue at the target, orange beyond.
STEPS: Final = (
    (0.01, "b3", "to 1 % of the target"),
    (0.1, "b2", "to a tenth"),
    (1.0, "b1", "to the target"),
    (10.0, "o1", "to ten times the target"),
    (100.0, "o2", "to a hundred times"),
    (math.inf, "o3", "beyond"),
)
#: Outcomes of an adjustment: key, sign, words and meaning.
OUTCOMES: Final = (
    ("reached", "✓", "at the target", "RMSE of the worst ECEF axis at most the target, at control and check points"),
    ("missed", "✗", "misses the target", "a solution, but an RMSE beyond the target"),
    (
        "failed",
        "–",
        "without solution",
        "the solver broke down or the iteration did not converge; reasons below",
    ),
    ("left_out", "·", "not tried", "too costly or without meaning for this backend; reasons below"),
)


@dataclass(frozen=True)
class Cell:
    """One field of a heat map: class of its colour, its text, its tooltip."""

    kind: str
    text: str
    words: str


def outcome(row: Row) -> str:
    """Key of :data:`OUTCOMES`."""
    if row.left_out:
        return "left_out"
    return "failed" if row.failure else "reached" if row.reached else "missed"


def counts(comparison: Comparison) -> dict[str, int]:
    """Number of adjustments by outcome."""
    outcomes = [outcome(row) for row in comparison.rows]
    return {key: outcomes.count(key) for key, *_ in OUTCOMES}


def heat_map(comparison: Comparison, role: str) -> list[tuple[str, bool, list[Cell]]]:
    """Rows of a heat map of the RMSE at control or check points: name, True at the first row of a backend, cells.

    Adjustments that were not tried with any set are omitted. Empty if there is no number.
    """
    out: list[tuple[str, bool, list[Cell]]] = []
    before: tuple[str, int | None] | None = None
    for key, rows in groups(comparison.rows).items():
        if all(row.left_out for row in rows):
            continue
        by_set = {row.eop_set: row for row in rows}
        cells = [_cell(by_set.get(n), role, comparison.target_m) for n in comparison.eop_sets]
        out.append((row_name(comparison, *key), before not in (None, key[:2]), cells))
        before = key[:2]
    return out if any(cell.kind[0] in "bo" for _, _, cells in out for cell in cells) else []


def _cell(row: Row | None, role: str, target_m: float) -> Cell:
    if row is None or row.left_out:
        return Cell("untried", "·", "not tried")
    if row.failure:
        return Cell("none", "–", f"set {row.eop_set}: {row.failure}")
    value = float(getattr(row, f"{role}_rmse_m"))
    if not math.isfinite(value):
        return Cell("untried", "·", f"no {role} points")
    kind = next(name for limit, name, _ in STEPS if value <= limit * target_m)
    return Cell(kind, short(value), f"set {row.eop_set} {row.eop_set_name}: {value:.4g} m")


def steps(target_m: float) -> Sequence[tuple[str, str]]:
    """Classes and words of the steps, for a legend; in metres."""
    limits = [0.0, *(limit * target_m for limit, _, _ in STEPS)]
    return [
        (name, f"> {low:.3g} m" if math.isinf(high) else f"≤ {high:.3g} m")
        for (_, name, _), low, high in zip(STEPS, limits[:-1], limits[1:], strict=True)
    ]


#: Heading and explanation of each heat map; the folder also contains their drawings, for papers.
HEAT_MAPS: Final = {
    "control": (
        "Control points",
        "RMSE of the worst ECEF axis, metres. Blue is at the target, orange beyond, hatched without solution. The "
        "published procedure holds control points fixed and intersects them again with its own orientation and look "
        "angles; dense and graph adjust them with their standard deviations.",
    ),
    "check": (
        "Check points",
        "The same at check points. In the published procedure they absorb what the orientation gets wrong.",
    ),
}
#: Heading and explanation of each drawing.
CAPTIONS: Final = {
    "conditions.svg": (
        "Condition numbers",
        "Of N = A\u1d40A, as the square of A's. At the upper line the smallest singular value of A is rounding.",
    ),
    "spectra.svg": (
        "Singular values",
        "Of the design matrix A, beside the largest. A drop to 1e−15 is a direction that the data do not show: a "
        "silent one. The table of directions names them where dense or graph were asked for.",
    ),
    "l_curves.svg": (
        "L-curves",
        "Of the published bundle: norm of the solution over norm of the residuals for all κ, with the choices of the "
        "Tikhonov solvers. A good κ lies where the curve bends; unknowns are in m, m/s and rad together, so that κ and "
        "the curve depend on these units.",
    ),
    "seconds.svg": ("Run times", "Wall clock of one adjustment, statistics left out."),
}


def render(comparison: Comparison, record: Mapping[str, Any], figures: Mapping[str, str]) -> str:
    """HTML text of a comparison."""
    from markupsafe import Markup

    shell = environment()
    shell.filters |= {"short": three_digits, "ranges": ranges}
    drawn = [
        (name, *CAPTIONS[name], Markup(inline(figures[name], name.partition(".")[0]))) for name in CAPTIONS
        if name in figures
    ]  # fmt: skip
    heats = [(f"heat-{role}", *words, heat_map(comparison, role)) for role, words in HEAT_MAPS.items()]
    heats = [shown for shown in heats if shown[-1]]
    names = {row.eop_set: row.eop_set_name for row in comparison.rows}
    sets = {number: (name, _lines(comparison, number)) for number, name in names.items()}
    condition_heads, conditions = _conditions(comparison)
    directions = _directions(comparison)
    parts = (("failures", "Without solution", False), ("left-out", "Not tried", True))
    reasons = [(id_, title, rows) for id_, title, left_out in parts if (rows := _reasons(comparison, left_out))]
    return shell.get_template("compare.html.j2").render(
        r=record, verdict=verdict(comparison), problems=sentences(record), figures=drawn, heats=heats,
        summaries=summaries(comparison), sets=sets, conditions=conditions, reasons=reasons,
        condition_heads=condition_heads, directions=directions, outcomes=OUTCOMES, counts=counts(comparison),
        steps=steps(comparison.target_m),
    )  # fmt: skip


def three_digits(value: float | None) -> str:
    """Write a length or a very large number in three digits; a dash for a missing number."""
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value:.2f}" if 0.01 <= abs(value) < 1000.0 or value == 0.0 else f"{value:.0e}"
    return text.replace("e+0", "e").replace("e+", "e").replace("e-0", "e-").replace("-", "−")


def inline(svg: str, name: str) -> str:
    """Prepare an SVG file for a page: no header, unique ids, colours of the page."""
    text = svg[svg.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', text)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"', r"\1", text, count=1)
    return text.replace(f"fill: {PAPER}", "fill: none").replace(INK, "currentColor")


def _lines(comparison: Comparison, eop_set: int) -> list[dict[str, Any]]:
    """Rows of one set with name and outcome."""
    words = {key: (sign, name) for key, sign, name, _ in OUTCOMES}
    return [
        row.as_dict()
        | {"name": row_name(comparison, row.backend, row.type, row.solver)}
        | dict(zip(("sign", "outcome"), words[outcome(row)], strict=True))
        for row in comparison.select(eop_set=eop_set)
    ]


def _conditions(comparison: Comparison) -> tuple[list[str], list[tuple[int, list[tuple[str, str]]]]]:
    """Heads, one per system and scaling, and condition numbers by set; one line per set, for printing."""
    columns = dict.fromkeys((s.system, s.scaling) for s in comparison.spectra)
    conditions = {(s.eop_set, s.system, s.scaling): s.condition for s in comparison.spectra}
    rows = [(n, [_condition(conditions.get((n, *column))) for column in columns]) for n in comparison.eop_sets]
    return [f"{system}, {scaling}" for system, scaling in columns], rows if columns else []


def _directions(comparison: Comparison) -> list[tuple[str, str, list[str], list[int]]]:
    """Directions in words, their constraint (nothing or the prior), images and sets; unconstrained ones first."""
    groups_of: dict[tuple[str, str], list[Direction]] = {}
    for direction in comparison.directions:
        groups_of.setdefault((direction.held_by, direction.words), []).append(direction)
    rows = [
        (words, held, list(dict.fromkeys(d.image for d in group)), sorted({d.eop_set for d in group}))
        for (held, words), group in groups_of.items()
    ]
    return sorted(rows, key=lambda row: (row[1] != "nothing", row[3][0]))


def _condition(value: float | None) -> tuple[str, str]:
    """Text and the number for sorting."""
    if value is None:
        return "–", ""
    return f"≥ {value:.0e}" if value >= LARGEST_CONDITION else f"{value:.0e}", f"{value:.9g}"


def _reasons(comparison: Comparison, left_out: bool) -> list[tuple[str, int, list[int]]]:
    """Reasons for rows that were not tried or have no solution, number of rows and sets; digits are ignored."""
    by_text: dict[str, tuple[str, list[int]]] = {}
    for row in comparison.rows:
        if row.failure and row.left_out == left_out:
            label = comparison.labels.get(row.solver, GRAPH_SOLVER)
            text = f"{row.backend}, {label}: {row.failure}"
            key = re.sub(r"[0-9.e+-]+", "#", text)
            by_text.setdefault(key, (text, []))[1].append(row.eop_set)
    return [(text, len(sets), sorted(set(sets))) for text, sets in by_text.values()]
