"""Published and reproduced values, cell by cell, with the claims: computation of ``fg-orient reproduce``."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.l_curve import LCurve
from fg_orient.model.errors import InputError
from fg_orient.model.names import CellKey
from fg_orient.studies.claims import ClaimResult, all_claims, run_claims
from fg_orient.studies.published.tables import PublishedCell, PublishedTables, load
from fg_orient.studies.reproduce.sources import SOURCES, Source
from fg_orient.studies.reproduce.verdict import KINDS, CellComparison, Judge, Kind, assess_runs, known_reason
from fg_orient.studies.tables_spot6 import PERMUTATIONS

#: Called after each run with runs done, number of runs, and name of the work.
Callback = Callable[[int, int, str], None]

#: Default number of runs: about a minute.
DEFAULT_SEEDS: Final = 10
MAX_SEEDS: Final = 1000


@dataclass(frozen=True)
class Row:
    """One published number, the result of the runs, and the verdict.

    Parameters
    ----------
    key : CellKey
        Address.
    published, reproduced : float
        nan if nothing is printed, or the runs broke down. ``reproduced`` is the median.
    low, high : float
        Smallest and largest run.
    verdict, reason : str
        One of ``KINDS``, and its reason.
    printed, unit, note : str
        Digits as printed, unit, doubts about the number.
    chance : float
        Share of the shuffles of the printed values in which the cell gets this verdict or a stronger one; nan if it
        has no verdict or nothing to be exchanged with (see :func:`baseline`).
    """

    key: CellKey
    published: float
    reproduced: float
    low: float
    high: float
    verdict: str
    reason: str
    printed: str
    unit: str
    note: str
    chance: float = math.nan

    @property
    def informs(self) -> bool:
        """The digits agree, and not because the role of the cell alone makes them."""
        return self.verdict in DIGITS and not self.chance == 1.0

    @property
    def table(self) -> str:
        """Table of the number."""
        return self.key.table

    @property
    def cell(self) -> str:
        """Address in the table, in words."""
        return str(self.key)

    def as_dict(self) -> dict[str, Any]:
        """Columns by name: table and cell, then all but ``key``."""
        columns = {"table": self.table, "cell": self.cell} | vars(self)
        del columns["key"]
        return columns


@dataclass(frozen=True)
class Reproduction:
    """All rows and claims of a publication.

    Parameters
    ----------
    source : Source
    titles : dict
        Titles of the tables, in order.
    rows : tuple of Row
    baseline : Baseline
        Verdicts of shuffled values.
    claims : tuple of ClaimResult
    options : dict
        ``tables``, ``seeds``, ``as_run``.
    sha256 : dict
        SHA-256 of the files of published values.
    curves : dict
        L-curve of each EOP set whose kappas are among the rows, for the first seed.
    """

    source: Source
    titles: dict[str, str]
    rows: tuple[Row, ...]
    baseline: Baseline
    claims: tuple[ClaimResult, ...]
    options: dict[str, Any]
    sha256: dict[str, str]
    curves: dict[int, LCurve] = field(default_factory=dict)

    def counts(self, table: str | None = None) -> dict[str, int]:
        """Number of rows with each verdict, of one table or of all."""
        counter = Counter(row.verdict for row in self.rows if table in (None, row.table))
        return {kind: counter[kind] for kind in KINDS}

    def shuffled(self, table: str | None = None) -> dict[str, float]:
        """Number of rows with each verdict if the printed values are shuffled, of one table or of all."""
        chosen = [counts for name, counts in self.baseline.verdicts.items() if table in (None, name)]
        return {kind: sum(counts[kind] for counts in chosen) for kind in KINDS}

    def gained(self, table: str | None = None) -> float:
        """Cells that agree in digits, spread or size beyond those that agree shuffled, of one table or of all."""
        if table is None:
            return sum(map(self.gained, self.titles))
        true = sum(r.verdict in AGREEING for r in self.rows if r.table == table and r.key in self.baseline.chance)
        return max(true - sum(self.shuffled(table)[kind] for kind in AGREEING), 0.0)


def reproduce(
    name: str, *, tables: str = "", n_seeds: int = DEFAULT_SEEDS, as_run: bool = False, claims: bool = True,
    published: Path | None = None, data: Path | None = None, permutations: int = PERMUTATIONS,
    callback: Callback | None = None,
) -> Reproduction:  # fmt: skip
    """Run the experiments of a publication on synthetic blocks and compare with the printed values.

    Parameters
    ----------
    name : str
        "terlemezoglu2019", "topan2010"; "ipbuker1994", "ayhan1996" (without seeds, points or programs to vary).
    tables : str
        Tables and ranges of tables ("4.3-4.9,4.28"); "" for all.
    n_seeds : int
        Number of synthetic blocks, with the seeds 1 to n.
    as_run : bool
        Procedure of the authors' program, on blocks with radial velocity and attitude.
    claims : bool
        Assess the claims about the publication, too.
    published : Path, optional
        Other folder of published tables.
    data : Path, optional
        Control points of the SPOT-6 scene, for tables 4.35-4.55; default ``$FG_ORIENT_REAL_DATA``.
    permutations : int
        Orders of these points in addition to the order of their file.
    callback : callable, optional
        Called after each run of the tables and each run of the claims.

    Raises
    ------
    InputError
        Unknown publication or table, number of seeds out of range, damaged tables.
    """
    for option, count in (("seeds", n_seeds), ("permutations", permutations)):
        if not 1 <= count <= MAX_SEEDS:
            raise InputError.of("options.value", option=option, value=count, expected=f"1 to {MAX_SEEDS}")
    printed = load(name, published)
    source, chosen = SOURCES[name], select(tables, tuple(printed.titles))
    seeds = range(1, n_seeds + 1)

    def progress(work: str, offset: int = 0, of_all: int | None = None) -> Callable[[int, int], None]:
        return lambda done, of: callback(offset + done, of_all or of, work) if callback else None

    steps = n_seeds * (1 + claims)
    on_twin = tuple(table for table in chosen if table not in source.real_tables)
    options: dict[str, Any] = {"tables": list(chosen)}
    computed, on_points = {}, {}
    if source.compute is not None:
        options |= {"seeds": list(seeds), "as_run": as_run}
        if on_twin:
            computed = source.compute(on_twin, seeds, as_run=as_run, progress=progress("tables", 0, steps))
        if len(on_twin) < len(chosen):
            options["permutations"] = permutations
    if source.real is not None:
        on_points = source.real(
            printed, chosen, data, permutations=permutations, progress=progress("real points")
        )  # fmt: skip
    about_it = [claim for claim in all_claims() if claims and claim.id in source.claims]
    assessed = run_claims(seeds, progress("claims", n_seeds, steps), about_it) if about_it else []
    titles = {table: printed.titles[table] for table in chosen}
    rows, null = pair(printed, computed, source, chosen, on_points, as_run=as_run)
    curves = source.curves(on_twin, seeds[0], as_run=as_run) if source.curves else {}
    return Reproduction(source, titles, rows, null, tuple(assessed), options, printed.sha256, curves)


def select(text: str, tables: Sequence[str]) -> tuple[str, ...]:
    """Choose tables by name and range.

    Raises
    ------
    InputError
        No such table, or a range that runs backwards.
    """
    if not text.strip():
        return tuple(tables)
    chosen: set[str] = set()
    for part in filter(None, (word.strip() for word in text.split(","))):
        first, dash, last = (word.strip() for word in part.partition("-"))
        ends = (first, last if dash else first)
        unknown = [name for name in ends if name not in tables]
        if unknown or tables.index(ends[0]) > tables.index(ends[1]):
            value = unknown[0] if unknown else part
            raise InputError.of("reproduce.table", option="tables", value=value, known=", ".join(tables))
        chosen |= set(tables[tables.index(ends[0]) : tables.index(ends[1]) + 1])
    return tuple(name for name in tables if name in chosen)


def pair(
    printed: PublishedTables, computed: Mapping[CellKey, Array], source: Source, tables: Sequence[str],
    on_points: Mapping[CellKey, Judge] | None = None, *, as_run: bool = False,
) -> tuple[tuple[Row, ...], Baseline]:  # fmt: skip
    """Compare each published cell of some tables with its runs, or by its judge ``on_points``; then shuffled."""
    cells = [cell for cell in printed.cells if cell.key.table in tables]
    judges = {cell.key: (on_points or {}).get(cell.key) or _of_runs(cell.key, computed) for cell in cells}
    null, rows = baseline(cells, judges), []
    for cell in cells:
        comparison: CellComparison = judges[cell.key](cell)
        is_open = comparison.kind == "differs" and cell.key not in (on_points or {})
        known = known_reason(source.known, cell, as_run) if is_open else ""
        rows.append(Row(
            cell.key, cell.value, comparison.reproduced, comparison.low, comparison.high, comparison.kind,
            "; ".join(filter(None, (comparison.reason, known))), cell.text or cell.printed, cell.unit, cell.note,
            null.chance.get(cell.key, math.nan),
        ))  # fmt: skip
    return tuple(rows), null


def _of_runs(key: CellKey, computed: Mapping[CellKey, Array]) -> Judge:
    """Judge of a cell by its runs on synthetic blocks."""
    order = float(computed.get(key._replace(quantity="matrix_order"), np.array([math.nan]))[0])
    return partial(assess_runs, runs=computed.get(key), order=None if math.isnan(order) else order)


#: Number of shuffles, with the seeds 1 to N.
SHUFFLES: Final = 20
#: Verdicts with information on the value of a cell, the strongest first; a common side of a limit is not enough.
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
    """Judge shuffled values: those of a table, exchanged among cells of the same role.

    A verdict that exchanged values get as often as the true ones shows that the quantity has this size in the table,
    not that the cell has this value (docs/reproduce.md). Role: table, quantity, coefficient, axis, point set and type;
    EOP sets, images and solvers are exchanged, in tables without these the rows. Computed values stay in their places.

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
