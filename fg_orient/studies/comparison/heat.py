"""Heat maps of a comparison as tables: adjustment by EOP set, readable as numbers where there are no colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from fg_orient.report.chart import short
from fg_orient.studies.comparison.model import Comparison, Row, groups
from fg_orient.studies.comparison.plots import row_name

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
    """One field of a heat map: class of its colour, text in it, words for the pointer."""

    kind: str
    text: str
    words: str


def outcome(row: Row) -> str:
    """Give the key of :data:`OUTCOMES`."""
    if row.left_out:
        return "left_out"
    return "failed" if row.failure else "reached" if row.reached else "missed"


def counts(comparison: Comparison) -> dict[str, int]:
    """Number of adjustments by outcome."""
    found = [outcome(row) for row in comparison.rows]
    return {key: found.count(key) for key, *_ in OUTCOMES}


def heat_map(comparison: Comparison, role: str) -> list[tuple[str, bool, list[Cell]]]:
    """Rows of a heat map of the RMSE at control or check points: name, whether a new backend begins, cells.

    Adjustments that were not tried with any set are left out; empty without a single number.
    """
    out: list[tuple[str, bool, list[Cell]]] = []
    before: tuple[str, int | None] | None = None
    for key, rows in groups(comparison.rows).items():
        if all(row.left_out for row in rows):
            continue
        found = {row.eop_set: row for row in rows}
        cells = [_cell(found.get(n), role, comparison.target_m) for n in comparison.eop_sets]
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
