"""Result of a comparison in sentences and in one line per backend, type and solver."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from fg_orient.studies.comparison.model import Comparison, Row, groups


@dataclass(frozen=True)
class Summary:
    """Results of one solver of one backend and type over the EOP sets.

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
    """Outcome of the comparison: ``kind`` (good, warn, bad), ``title`` and ``text``, a list of sentences."""
    lines, total = summaries(comparison), len(comparison.eop_sets)
    tried = [line for line in lines if line.tried]
    sentences = [f"The graph (GTSAM): {_reached(line, total)}." for line in lines if line.backend == "graph"]
    dense = [line for line in tried if line.backend == "dense"]
    sentences += _of_solvers("Dense matrices (scaled, iterated)", comparison, dense)
    for kind in comparison.types:
        published = [line for line in tried if line.backend == "faithful" and line.type == kind]
        sentences += _of_solvers(f"The published procedure, type {kind}", comparison, published)
    sentences += _remarks(comparison, lines)
    best = max(lines, key=lambda line: (line.backend == "graph", line.reached), default=None)
    if best is None or not any(line.solved for line in lines):
        return {"kind": "bad", "title": "No adjustment has a solution", "text": sentences}
    name = {"graph": "the graph", "dense": "dense matrices", "faithful": "the published procedure"}[best.backend]
    title = f"With {name}, {_of(best.reached, total)} EOP sets are at the target of {comparison.target_m:.3g} m"
    return {"kind": "good" if best.reached == total else "warn", "title": title, "text": sentences}


def _of(count: int, total: int) -> str:
    return f"all {total}" if count == total else f"{count or 'none'} of {total}"


def _reached(line: Summary, total: int) -> str:
    """Number of sets at the target; the other sets, the worst RMSE, and the sets without solution."""
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


def _of_solvers(name: str, comparison: Comparison, lines: list[Summary]) -> list[str]:
    """Sentence on the sets at the target with every solver, with some solvers and with none."""
    if not lines:
        return []
    sets = comparison.eop_sets
    if len({(s.reached, s.missed) for s in lines}) == 1:
        solvers = "1 solver" if len(lines) == 1 else f"each of {len(lines)} solvers"
        return [f"{name}: {_reached(lines[0], len(sets))}, with {solvers}."]
    always = sum(all(n not in s.missed for s in lines) for n in sets)
    never = [n for n in sets if all(n in s.missed for s in lines)]
    best = max(s.reached for s in lines)
    names = "; ".join(s.label for s in lines if s.reached == best)
    text = f"{name}: {_of(always, len(sets))} sets at the target with every solver"
    text += f"; the others depend on the solver, most with {names} ({_of(best, len(sets))})"
    return [f"{text}; with none: {ranges(never)}." if never else f"{text}."]


def _remarks(comparison: Comparison, lines: list[Summary]) -> list[str]:
    """Sentences on differences between backends, missing check points and adjustments that were not tried."""
    out = []
    sigmas = _largest(r.difference_sigmas for r in comparison.rows)
    if math.isfinite(sigmas):
        metres = _largest(r.difference_m for r in comparison.rows)
        out.append(f"Dense and graph differ by at most {sigmas:.1e} prior sigmas and {metres:.1e} m.")
    if any(s.solved for s in lines) and not any(math.isfinite(s.worst_check_m) for s in lines):
        out.append("There are no check points: the target is judged at control points alone, which says little.")
    left_out = [r for r in comparison.rows if r.left_out]
    if left_out:
        names = dict.fromkeys(f"{r.backend} {comparison.labels.get(r.solver, r.solver)}" for r in left_out)
        out.append(f"Not tried ({len(left_out)} rows; each says why): {'; '.join(names)}.")
    return out
