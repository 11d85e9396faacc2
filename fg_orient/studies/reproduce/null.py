"""Null model of the verdicts: the printed values of a table, exchanged among cells of the same role.

A verdict that exchanged values get as often as the true ones shows that the quantity has this size in the table, not
that the cell has this value (docs/reproduce.md). Role: table, quantity, coefficient, axis, point set and type; EOP
sets, images and solvers are exchanged, in tables without these the rows. The computed values stay in their places.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fg_orient.model.names import CellKey
from fg_orient.studies.published.tables import PublishedCell
from fg_orient.studies.reproduce.verdict import KINDS, Judge, Kind

#: Number of shuffles, with the seeds 1 to N.
SHUFFLES: Final = 20
#: Verdicts that say something on the value of a cell, the strongest first; a common side of a limit says too little.
AGREEING: Final[tuple[Kind, ...]] = ("equal", "rounding", "unit", "sigma", "spread", "order")
#: Verdicts of digits: the only ones that the headline counts.
DIGITS: Final[tuple[Kind, ...]] = ("equal", "rounding")


@dataclass(frozen=True)
class Baseline:
    """Verdicts that shuffled values get.

    Parameters
    ----------
    verdicts : dict
        Table to verdict to the number of cells, mean of the shuffles; cells that nothing can be exchanged with and
        cells without verdict are left out.
    chance : dict
        Share of the shuffles in which a cell gets its own verdict or a stronger one; no entry for cells left out.
    """

    verdicts: dict[str, dict[Kind, float]]
    chance: dict[CellKey, float]


def roles(cells: Sequence[PublishedCell]) -> list[list[int]]:
    """Places of the cells of each role that has at least two printed numbers."""
    groups: dict[CellKey, list[int]] = {}
    for place, cell in enumerate(cells):
        if cell.text:
            key = cell.key._replace(eop_set="", stage="", method="")
            row_is_name = key == cell.key  # neither set, image nor solver: the parameter is the row of the table
            groups.setdefault(key._replace(parameter="") if row_is_name else key, []).append(place)
    return [places for places in groups.values() if len(places) > 1]


def shuffled(cells: Sequence[PublishedCell], seed: int) -> tuple[PublishedCell, ...]:
    """Exchange the printed values among the cells of each role.

    Parameters
    ----------
    cells : sequence of PublishedCell
    seed : int
        Of the permutations.
    """
    out, rng = list(cells), np.random.default_rng(seed)
    for places in roles(cells):
        for to, origin in zip(places, rng.permutation(places), strict=True):
            other = cells[int(origin)]
            out[to] = replace(cells[to], value=other.value, text=other.text, printed=other.printed)
    return tuple(out)


def baseline(cells: Sequence[PublishedCell], judges: Mapping[CellKey, Judge], n: int = SHUFFLES) -> Baseline:
    """Judge shuffled values.

    Parameters
    ----------
    cells : sequence of PublishedCell
    judges : mapping
        Judge of each cell.
    n : int
        Number of shuffles.
    """
    kinds = [judges[cell.key](cell).kind for cell in cells]
    judged = {k for places in roles(cells) for k in places if kinds[k] != "not_reproducible"}
    total: dict[str, Counter[Kind]] = {cell.key.table: Counter() for cell in cells}
    reached: Counter[CellKey] = Counter()
    for seed in range(1, n + 1):
        mixed = shuffled(cells, seed)
        for k in judged:
            cell = mixed[k]
            kind = judges[cell.key](cell).kind
            total[cell.key.table][kind] += 1
            reached[cell.key] += kind == kinds[k] or _strength(kind) < _strength(kinds[k])
    verdicts = {table: {kind: counter[kind] / n for kind in KINDS} for table, counter in total.items()}
    return Baseline(verdicts, {cells[k].key: reached[cells[k].key] / n for k in sorted(judged)})


def _strength(kind: Kind) -> int:
    return AGREEING.index(kind) if kind in AGREEING else len(AGREEING)
