"""Verdicts of shuffled values: published values of a table, exchanged among its EOP sets, images and solvers.

Quantity, coefficient, axis, role and type of a value remain. A verdict that shuffled values get as often as the true
values shows that the quantity has this size in the table, not that the cell has this value (docs/reproduce.md).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from factors._contract import Array
from fg_orient.model.names import CellKey
from fg_orient.studies.published.tables import PublishedCell, PublishedTables
from fg_orient.studies.reproduce.reproduction import pair
from fg_orient.studies.reproduce.sources import Source
from fg_orient.studies.reproduce.verdict import KINDS


def shuffled(cells: Sequence[PublishedCell], seed: int) -> tuple[PublishedCell, ...]:
    """Exchange the printed values of cells that differ by EOP set, image and solver alone.

    Parameters
    ----------
    cells : sequence of PublishedCell
    seed : int
        Of the permutations.
    """
    groups: dict[CellKey, list[int]] = {}
    for place, cell in enumerate(cells):
        if cell.text:
            groups.setdefault(cell.key._replace(eop_set="", stage="", method=""), []).append(place)
    out, rng = list(cells), np.random.default_rng(seed)
    for places in groups.values():
        for to, origin in zip(places, rng.permutation(places), strict=True):
            other = cells[int(origin)]
            out[to] = replace(cells[to], value=other.value, text=other.text, printed=other.printed)
    return tuple(out)


def counts(
    printed: PublishedTables, computed: Mapping[CellKey, Array], source: Source, tables: Sequence[str],
    seeds: Iterable[int] = (),
) -> dict[str, dict[str, float]]:  # fmt: skip
    """Verdicts by table: those of the published values, or the mean over shuffled ones.

    Parameters
    ----------
    printed, computed, source, tables
        As in :func:`fg_orient.studies.reproduce.reproduction.pair`.
    seeds : iterable of int
        One shuffle each; without seeds the values are not shuffled.

    Returns
    -------
    dict
        Table to verdict to number of cells.
    """
    variants = [replace(printed, cells=shuffled(printed.cells, seed)) for seed in seeds] or [printed]
    total: Counter[tuple[str, str]] = Counter()
    for variant in variants:
        total.update((row.table, row.verdict) for row in pair(variant, computed, source, tables))
    return {table: {kind: total[table, kind] / len(variants) for kind in KINDS} for table in tables}
