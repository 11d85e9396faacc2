"""Make the HTML report of a comparison: heat maps as tables of numbers, and the result in sentences."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from fg_orient.model.errors import sentences
from fg_orient.model.names import Status
from fg_orient.report.chart import INK, short
from fg_orient.report.page import environment
from fg_orient.report.paper import PAPER
from fg_orient.result.plain import dumps
from fg_orient.studies.comparison.model import (
    LARGEST_CONDITION,
    REDUCED_LABELS,
    UNREGULARISED,
    Comparison,
    Direction,
    Key,
    Row,
    groups,
    regularisation_words,
    tried,
)
from fg_orient.studies.comparison.set_results import SetResult

#: Upper limits of the colour steps, as multiples of the target, and their classes: blue up to the target, then orange.
STEPS: Final = ((0.01, "b3"), (0.1, "b2"), (1.0, "b1"), (10.0, "o1"), (100.0, "o2"), (math.inf, "o3"))
#: Names of the engines of an adjustment in sentences.
ENGINES: Final = {
    "graph": "The graph with eliminated points (GTSAM)", "explicit": "The graph with explicit points (GTSAM)",
    "schur": "Arrays with eliminated points", "dense": "Full matrices (scaled, iterated)",
}  # fmt: skip
#: Outcomes of an adjustment: symbol, words and meaning.
OUTCOMES: Final = {
    "reached": ("✓", "at the target", "RMSE of the worst ECEF axis at most the target, at control and check points"),
    "missed": ("✗", "misses the target", "a solution, but an RMSE beyond the target"),
    "failed": ("–", "without solution", "the solver broke down or the iteration did not converge; reasons below"),
    "left_out": ("·", "not tried", "too costly or without meaning for this backend; reasons below"),
}


@dataclass(frozen=True)
class Cell:
    """Field of a heat map: class of its colour, text and tooltip."""

    kind: str
    text: str
    words: str


def outcome(row: Row) -> str:
    """Return the outcome of a row as a key of :data:`OUTCOMES`."""
    if row.left_out:
        return "left_out"
    return "failed" if row.failure else "reached" if row.reached else "missed"


def counts(comparison: Comparison) -> dict[str, int]:
    """Return the number of adjustments by outcome."""
    outcomes = [outcome(row) for row in comparison.rows]
    return {key: outcomes.count(key) for key in OUTCOMES}


def heat_map(comparison: Comparison, role: str) -> list[tuple[str, bool, list[Cell]]]:
    """Return the rows of a heat map of the RMSE at control or check points.

    A row contains its name, True at the first row of a backend, and cells. Engines that
    were not tried with any set are omitted. The result is empty if there is no number.
    """
    out: list[tuple[str, bool, list[Cell]]] = []
    before: tuple[str, int | None] | None = None
    for key, rows in tried(comparison).items():
        cells = [_cell(row, role, comparison.target_m) for row in rows]
        out.append((key.name(comparison.labels), before not in (None, key[:2]), cells))
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
    kind = next(name for limit, name in STEPS if value <= limit * target_m)
    return Cell(kind, short(value), f"set {row.eop_set} {row.eop_set_name}: {value:.4g} m")


def steps(target_m: float) -> Sequence[tuple[str, str]]:
    """Return the classes and words of the colour steps for a legend, in metres."""
    words = [f"≤ {limit * target_m:.3g} m" for limit, _ in STEPS[:-1]]
    words.append(f"> {STEPS[-2][0] * target_m:.3g} m")
    return [(name, text) for (_, name), text in zip(STEPS, words, strict=True)]


def render(comparison: Comparison, record: Mapping[str, Any], figures: Mapping[str, str]) -> str:
    """Return the HTML text of a comparison."""
    from markupsafe import Markup

    shell = environment()
    shell.filters |= {"short": three_digits, "ranges": ranges, "treated": regularisation_words}
    drawn = {name.partition(".")[0]: text for name, text in figures.items() if not name.startswith("heatmap")}
    names = {row.eop_set: row.eop_set_name for row in comparison.rows}
    condition_heads, conditions = _conditions(comparison)
    parts = (("failures", "Without solution", False), ("left-out", "Not tried", True))
    return shell.get_template("compare.html.j2").render(
        r=record, verdict=verdict(comparison), chosen=_chosen(comparison), problems=sentences(record),
        counts=counts(comparison),
        figures={name: Markup(inline(text, name)) for name, text in drawn.items()}, outcomes=OUTCOMES,
        heats={role: rows for role in ("control", "check") if (rows := heat_map(comparison, role))},
        regularised=[s for s in record["sets"] if s["regularisation"] != UNREGULARISED],
        summaries=summaries(comparison), steps=steps(comparison.target_m), conditions=conditions,
        condition_heads=condition_heads, directions=_directions(comparison),
        sets={number: (name, _lines(comparison, number)) for number, name in names.items()},
        reasons=[(id_, title, why) for id_, title, left in parts if (why := _reasons(comparison, left))],
    )  # fmt: skip


def three_digits(value: float | None) -> str:
    """Format a length or a very large number with three digits; a missing number is a dash."""
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value:.2f}" if 0.01 <= abs(value) < 1000.0 or value == 0.0 else f"{value:.0e}"
    return text.replace("e+0", "e").replace("e+", "e").replace("e-0", "e-").replace("-", "−")


def inline(svg: str, name: str) -> str:
    """Return an SVG file for use in a page: without header, with unique ids and the colours of the page."""
    text = svg[svg.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', text)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*" height="[^"]*"', r"\1", text, count=1)
    return text.replace(f"fill: {PAPER}", "fill: none").replace(INK, "currentColor")


def _lines(comparison: Comparison, eop_set: int) -> list[dict[str, Any]]:
    """Return the rows of one set with names and outcomes."""
    return [
        row.as_dict()
        | {"name": row.key.name(comparison.labels)}
        | dict(zip(("sign", "outcome"), OUTCOMES[outcome(row)][:2], strict=True))
        for row in comparison.select(eop_set=eop_set)
    ]


def _chosen(comparison: Comparison) -> list[dict[str, Any]]:
    """Return the rows of the recommended set without the published procedure."""
    advice = comparison.advice
    if advice is None or advice.eop_set is None:
        return []
    rows = [line for line in _lines(comparison, advice.eop_set)
            if line["backend"] != "faithful" and line["regularisation"] == advice.regularisation]  # fmt: skip
    return [line | {"recommended": Key(*(line[k] for k in Key._fields)) == advice.key} for line in rows]


def _conditions(comparison: Comparison) -> tuple[list[str], list[tuple[int, list[tuple[str, str]]]]]:
    """Return a table of condition numbers: a column for each system and scaling, a line for each set."""
    columns = dict.fromkeys((s.system, s.scaling) for s in comparison.spectra)
    conditions = {(s.eop_set, s.system, s.scaling): s.condition for s in comparison.spectra}
    rows = [(n, [_condition(conditions.get((n, *column))) for column in columns]) for n in comparison.eop_sets]
    return [f"{system}, {scaling}" for system, scaling in columns], rows if columns else []


def _directions(comparison: Comparison) -> list[tuple[str, str, list[str], list[int]]]:
    """Return directions in words, what determines them (nothing or the prior), images and sets.

    Directions that nothing determines are first.
    """
    groups_of: dict[tuple[str, str], list[Direction]] = {}
    for direction in comparison.directions:
        groups_of.setdefault((direction.held_by, direction.words), []).append(direction)
    rows = [
        (words, held, list(dict.fromkeys(d.image for d in group)), sorted({d.eop_set for d in group}))
        for (held, words), group in groups_of.items()
    ]
    return sorted(rows, key=lambda row: (row[1] != "nothing", row[3][0]))


def _condition(value: float | None) -> tuple[str, str]:
    """Return the text of a condition number, and the number for sorting."""
    if value is None:
        return "–", ""
    return f"≥ {value:.0e}" if value >= LARGEST_CONDITION else f"{value:.0e}", f"{value:.9g}"


def _reasons(comparison: Comparison, left_out: bool) -> list[tuple[str, int, list[int]]]:
    """Return the reasons for rows without a solution, with numbers of rows and sets.

    Digits are ignored.
    """
    by_text: dict[str, tuple[str, list[int]]] = {}
    for row in comparison.rows:
        if row.failure and row.left_out == left_out:
            text = f"{row.key.name(comparison.labels)}: {row.failure}"
            key = re.sub(r"[0-9.e+-]+", "#", text)
            by_text.setdefault(key, (text, []))[1].append(row.eop_set)
    return [(text, len(sets), sorted(set(sets))) for text, sets in by_text.values()]


# --- result in words ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Summary:
    """Results of one solver of one backend and type over the EOP sets.

    Parameters
    ----------
    backend, type, solver, optimizer, regularisation : str, int or None, str, str, str
    label, name : str
        Label of the solver, and name of the engine.
    tried, solved, reached : int
        Numbers of EOP sets that were tried, that have a solution, and that reach the target.
    missed : tuple of int
        Sets that were run and do not reach the target.
    unsolved : tuple of int
        Sets that were run and have no solution.
    worst_control_m, worst_check_m : float
        Largest RMSE of the sets with a solution; nan if there is no solution.
    """

    backend: str
    type: int | None
    solver: str
    optimizer: str
    regularisation: str
    label: str
    name: str
    tried: int
    solved: int
    reached: int
    missed: tuple[int, ...]
    unsolved: tuple[int, ...]
    worst_control_m: float
    worst_check_m: float


def summaries(comparison: Comparison) -> list[Summary]:
    """Return one summary for each backend, type and solver."""
    return [_summary(key, rows, comparison.labels) for key, rows in groups(comparison.rows).items()]


def _summary(key: Key, rows: Sequence[Row], labels: Mapping[str, str]) -> Summary:
    tried = [r for r in rows if not r.left_out]
    solved = [r for r in tried if not r.failure]
    return Summary(
        *key, _label(key, labels), key.name(labels), len(tried), len(solved), sum(r.reached for r in tried),
        tuple(r.eop_set for r in tried if not r.reached), tuple(r.eop_set for r in tried if r.failure),
        _largest(r.control_rmse_m for r in solved), _largest(r.check_rmse_m for r in solved),
    )  # fmt: skip


def _label(key: Key, labels: Mapping[str, str]) -> str:
    own = REDUCED_LABELS.get(key.solver, "") if key.backend == "schur" else ""
    return own or labels.get(key.solver, key.solver)


def _largest(values: Iterable[float]) -> float:
    return max((v for v in values if math.isfinite(v)), default=math.nan)


def verdict(comparison: Comparison) -> dict[str, Any]:
    """Return the recommendation: ``kind`` (good, warn, bad), ``title``, ``text`` (reasons) and ``details``."""
    advice, details = comparison.advice, _details(comparison)
    best = next((s for s in comparison.sets if advice is not None and s.key == advice.set_key), None)
    if advice is None or best is None:
        if any(not row.failure for row in comparison.rows):  # only the published procedure has a solution
            return {"kind": "warn", "title": details[0] if details else "", "text": details[1:], "details": []}
        why = [] if advice is None else [f"{_capital(reason)}." for reason in advice.set_reason]
        return {"kind": "bad", "title": "No adjustment has a solution", "text": why, "details": details}
    row = next((r for r in comparison.select(eop_set=best.eop_set) if r.key == advice.key), None)
    engine = f" with {row.key.name(comparison.labels)}" if row is not None else ""
    text = [f"Set: {'. '.join(map(_capital, advice.set_reason))}."]
    text += [f"Engine: {advice.solver_reason[0]}.", *(f"{_capital(reason)}." for reason in advice.solver_reason[1:])]
    text += _accuracy_words(comparison, best, row)
    given = ", ".join(f"{name} = {dumps(value)}" for name, value in (advice.options or {}).items())
    text.append(f"In the project file: {given}.")
    if comparison.repeated:
        of = sorted(set(comparison.repeated.values()))
        text.append(f"Not compared: sets {ranges(comparison.repeated)}, in these images the same as {ranges(of)}.")
    if best.status == Status.NOT_TRUSTWORTHY:
        text.append(f"Not trustworthy: {best.reason}.")
    good = row is not None and row.reached and best.status == Status.CONVERGED
    own = regularisation_words(best.regularisation)
    regularised = f", regularised by {own}," if own and row is None else ""
    title = f"Take EOP set {best.eop_set} ({best.name}){regularised}{engine}"
    return {"kind": "good" if good else "warn", "title": title, "text": text, "details": details}


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _accuracy_words(comparison: Comparison, best: SetResult, row: Row | None) -> list[str]:
    """Return sentences on the accuracy of the recommended row, the target and the source of the target."""
    target, predicted = comparison.target_m, f"predicted {best.predicted_m:.3g} m at the check points"
    if best.is_regularised:
        predicted += " with the bias of true deviations of one prior sigma"
    source = {
        "given": f"the target is {target:.3g} m",
        "predicted": f"{predicted}, at most {target:.3g} m in 95 % of cases",
        "pixel": f"no check points have a predicted accuracy: the target is one pixel, {target:.3g} m",
    }[comparison.target_from]
    if row is None:
        return [f"Accuracy: {source}."]
    values = {"check": row.check_rmse_m, "control": row.control_rmse_m}
    shown = ", ".join(f"{role} {value:.3g} m" for role, value in values.items() if math.isfinite(value))
    words = "within it" if row.reached else "beyond it"
    out = [f"Accuracy (RMSE of the worst ECEF axis): {source}; actual {shown}, {words}."]
    if sum(s.n_check > 0 for s in comparison.sets) > 1:
        of_set = "set and regularisation" if any(s.is_regularised for s in comparison.sets) else "set"
        out.append(f"The check points chose the {of_set}: they no longer test it independently.")
    return out


def _details(comparison: Comparison) -> list[str]:
    """Return sentences on the sets at the target by engine, and on adjustments that were not tried."""
    lines, total = summaries(comparison), len(comparison.eop_sets)
    tried = [line for line in lines if line.tried]
    out = []
    for backend, words in ENGINES.items():
        own = [line for line in tried if line.backend == backend]
        for word in dict.fromkeys(line.regularisation for line in own):
            of_word, treated = [line for line in own if line.regularisation == word], regularisation_words(word)
            out += _of_solvers(f"{words}, {treated}" if treated else words, comparison, of_word)
    for kind in comparison.types:
        published = [line for line in tried if line.backend == "faithful" and line.type == kind]
        out += _of_solvers(f"The published procedure, type {kind}", comparison, published)
    if not total:
        return out
    return out + _remarks(comparison, lines)


def _of(count: int, total: int) -> str:
    return f"all {total}" if count == total else f"{count or 'none'} of {total}"


def _reached(line: Summary, total: int) -> str:
    """Describe how many sets reach the target.

    Name the other sets, the worst RMSE, and sets without a solution.
    """
    text = f"{_of(line.reached, total)} sets at the target"
    if not line.missed:
        return text
    which = f", not {ranges(line.missed)}" if line.reached else ""
    values = {"control": line.worst_control_m, "check": line.worst_check_m}
    worst = ", ".join(f"{role} {value:.3g} m" for role, value in values.items() if math.isfinite(value))
    facts = [f"worst: {worst}"] if line.solved > line.reached and worst else []
    if line.solved < line.tried:
        facts.append(f"without solution: {'all' if not line.solved else ranges(line.unsolved)}")
    return f"{text}{which} ({'; '.join(facts)})" if facts else f"{text}{which}"


def ranges(values: Iterable[int]) -> str:
    """Format whole numbers as ranges, for example "1, 5-8"."""
    runs: list[list[int]] = []
    for value in sorted(set(values)):
        if runs and value == runs[-1][-1] + 1:
            runs[-1].append(value)
        else:
            runs.append([value])
    return ", ".join(str(r[0]) if len(r) == 1 else f"{r[0]}-{r[-1]}" for r in runs)


def _of_solvers(name: str, comparison: Comparison, lines: list[Summary]) -> list[str]:
    """Return a sentence on the sets that reach the target with every solver, with some solvers, or with no solver."""
    if not lines:
        return []
    sets = comparison.eop_sets
    if len({(s.reached, s.missed) for s in lines}) == 1:
        solvers = "1 solver" if len(lines) == 1 else f"each of {len(lines)} solvers"
        return [f"{name}: {_reached(lines[0], len(sets))}, with {solvers}."]
    always = sum(all(n not in s.missed for s in lines) for n in sets)
    never = [n for n in sets if all(n in s.missed for s in lines)]
    best = max(s.reached for s in lines)
    names = "; ".join(s.name.partition(" · ")[2] for s in lines if s.reached == best)
    text = f"{name}: {_of(always, len(sets))} sets at the target with every solver"
    text += f"; the others depend on the solver, most with {names} ({_of(best, len(sets))})"
    return [f"{text}; with none: {ranges(never)}." if never else f"{text}."]


def _remarks(comparison: Comparison, lines: list[Summary]) -> list[str]:
    """Return sentences on differences between backends, missing check points and adjustments not tried."""
    out = []
    sigmas = _largest(r.difference_sigmas for r in comparison.rows)
    if math.isfinite(sigmas):
        metres = _largest(r.difference_m for r in comparison.rows)
        out.append(f"Engines differ from the adjustment by at most {sigmas:.1e} prior sigmas and {metres:.1e} m.")
    if any(s.solved for s in lines) and not any(math.isfinite(s.worst_check_m) for s in lines):
        out.append("There are no check points: the target is judged at control points alone, which says little.")
    left_out = [r for r in comparison.rows if r.left_out]
    if left_out:
        names = dict.fromkeys(r.key.name(comparison.labels) for r in left_out)
        out.append(f"Not tried ({len(left_out)} rows; each says why): {'; '.join(names)}.")
    return out
