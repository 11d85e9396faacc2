"""What a comparison says, in words and in one line per backend, type and solver."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from fg_orient.studies.comparison.model import Comparison, Row, groups

_BACKEND = {
    "faithful": "The published procedure, type",
    "dense": "Dense matrices (scaled, iterated)",
    "graph": "The graph",
}


@dataclass(frozen=True)
class Summary:
    """How one solver of one backend and type did over the EOP sets.

    Parameters
    ----------
    backend, type, solver, label : str, int or None, str, str
    tried, solved, reached : int
        Numbers of EOP sets.
    missed : tuple of int
        Sets that were tried and do not reach the target.
    unsolved : tuple of int
        Sets that were tried and have no solution.
    worst_control_m, worst_check_m : float
        Largest RMSE of the sets with a solution; nan without any.
    """

    backend: str
    type: int | None
    solver: str
    label: str
    tried: int
    solved: int
    reached: int
    missed: tuple[int, ...]
    unsolved: tuple[int, ...]
    worst_control_m: float
    worst_check_m: float


def summaries(comparison: Comparison) -> list[Summary]:
    """One line per backend, type and solver."""
    return [_summary(key, rows, comparison.labels.get(key[2], key[2])) for key, rows in groups(comparison.rows).items()]


def _summary(key: tuple[str, int | None, str], rows: Sequence[Row], label: str) -> Summary:
    tried = [r for r in rows if not r.left_out]
    solved = [r for r in tried if not r.failure]
    return Summary(
        *key, label, len(tried), len(solved), sum(r.reached for r in tried),
        tuple(r.eop_set for r in tried if not r.reached), tuple(r.eop_set for r in tried if r.failure),
        _largest(r.control_rmse_m for r in solved), _largest(r.check_rmse_m for r in solved),
    )  # fmt: skip


def _largest(values: Iterable[float]) -> float:
    return max((v for v in values if math.isfinite(v)), default=math.nan)


def verdict(comparison: Comparison) -> dict[str, Any]:
    """Say how it ended: ``kind`` (good, warn, bad), ``title`` and ``text``, a list of sentences."""
    found = summaries(comparison)
    published = (_published(comparison, found, kind) for kind in comparison.types)
    said = (_graph(comparison, found), _dense(comparison, found), *published, _differences(comparison),
            _without_check_points(comparison, found), _left_out(comparison))  # fmt: skip
    sentences = [sentence for sentence in said if sentence]
    solved = any(s.solved for s in found)
    best = max(found, key=lambda s: (s.backend == "graph", s.reached)) if found else None
    if best is None or not solved:
        return {"kind": "bad", "title": "No adjustment has a solution", "text": sentences}
    all_sets = len(comparison.eop_sets)
    kind = "good" if best.reached == all_sets else "warn"
    name = {"graph": "the graph", "dense": "dense matrices", "faithful": "the published procedure"}[best.backend]
    title = f"With {name}, {_of(best.reached, all_sets)} EOP sets are at the target of {comparison.target_m:.3g} m"
    return {"kind": kind, "title": title, "text": sentences}


def _of(count: int, total: int) -> str:
    return f"all {total}" if count == total else f"{count or 'none'} of {total}"


def _graph(comparison: Comparison, found: list[Summary]) -> str:
    lines = [s for s in found if s.backend == "graph"]
    if not lines:
        return ""
    line = lines[0]
    return f"{_BACKEND['graph']} (GTSAM): {_reached(line, len(comparison.eop_sets))}."


def _reached(line: Summary, total: int) -> str:
    """Sets at the target; if some are not, which, whether they have a solution, and the worst RMSE of those that do."""
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
    """Write whole numbers as ranges: 1, 5-8."""
    runs: list[list[int]] = []
    for value in sorted(set(values)):
        if runs and value == runs[-1][-1] + 1:
            runs[-1].append(value)
        else:
            runs.append([value])
    return ", ".join(str(r[0]) if len(r) == 1 else f"{r[0]}-{r[-1]}" for r in runs)


def _dense(comparison: Comparison, found: list[Summary]) -> str:
    return _many(_BACKEND["dense"], comparison, [s for s in found if s.backend == "dense" and s.tried])


def _published(comparison: Comparison, found: list[Summary], kind: int) -> str:
    lines = [s for s in found if s.backend == "faithful" and s.type == kind and s.tried]
    return _many(f"{_BACKEND['faithful']} {kind}", comparison, lines)


def _many(name: str, comparison: Comparison, lines: list[Summary]) -> str:
    """Say which sets every solver brings to the target, which some do and which none."""
    if not lines:
        return ""
    total = len(comparison.eop_sets)
    if len({(s.reached, s.missed) for s in lines}) == 1:
        return f"{name}: {_reached(lines[0], total)}, with each of {len(lines)} solvers."
    always = [n for n in comparison.eop_sets if all(n not in s.missed for s in lines)]
    never = [n for n in comparison.eop_sets if all(n in s.missed for s in lines)]
    best = max(s.reached for s in lines)
    names = "; ".join(s.label for s in lines if s.reached == best)
    text = f"{name}: {_of(len(always), total)} sets at the target with every solver"
    text += f"; the others depend on the solver, most with {names} ({_of(best, total)})"
    return f"{text}; with none: {ranges(never)}." if never else f"{text}."


def _differences(comparison: Comparison) -> str:
    sigmas = _largest(r.difference_sigmas for r in comparison.rows)
    if math.isnan(sigmas):
        return ""
    metres = _largest(r.difference_m for r in comparison.rows)
    return f"Dense and graph differ by at most {sigmas:.1e} prior sigmas and {metres:.1e} m."


def _without_check_points(comparison: Comparison, found: list[Summary]) -> str:
    if any(math.isfinite(s.worst_check_m) for s in found) or not any(s.solved for s in found):
        return ""
    return "There are no check points: the target is judged at control points alone, which says little."


def _left_out(comparison: Comparison) -> str:
    rows = [r for r in comparison.rows if r.left_out]
    if not rows:
        return ""
    names = dict.fromkeys(f"{r.backend} {comparison.labels.get(r.solver, r.solver)}" for r in rows)
    return f"Not tried ({len(rows)} rows; each says why): {'; '.join(names)}."
