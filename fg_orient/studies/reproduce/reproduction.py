"""Compare published and reproduced values cell by cell and assess the claims, for ``fg-orient reproduce``."""

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

#: Function called after each run with runs done, number of runs, and name of the work.
Callback = Callable[[int, int, str], None]

#: Default number of runs, which take about a minute.
DEFAULT_SEEDS: Final = 10
MAX_SEEDS: Final = 1000


@dataclass(frozen=True)
class Row:
    """One published number with the result of the runs and the verdict.

    Parameters
    ----------
    key : CellKey
        Address of the number.
    published, reproduced : float
        Values; nan if nothing is printed, or if the runs broke down. ``reproduced`` is the median.
    low, high : float
        Smallest and largest result of the runs.
    verdict, reason : str
        Verdict, one of ``KINDS``, and its reason.
    printed, unit, note : str
        Printed digits, unit, and doubts about the number.
    chance : float
        Share of the shuffles of printed values in which the cell gets this verdict or a
        stronger one. nan if the cell has no verdict, or if no other cell can be exchanged
        with it (see :func:`baseline`).
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
        """True if the digits agree and the agreement is not explained by the role of the cell."""
        return self.verdict in DIGITS and not self.chance == 1.0

    @property
    def table(self) -> str:
        """Table that contains the number."""
        return self.key.table

    @property
    def cell(self) -> str:
        """Description of the address in the table."""
        return str(self.key)

    def as_dict(self) -> dict[str, Any]:
        """Return the columns by name: table and cell, then all fields but ``key``."""
        columns = {"table": self.table, "cell": self.cell} | vars(self)
        del columns["key"]
        return columns


@dataclass(frozen=True)
class Reproduction:
    """All rows and claims of one publication.

    Parameters
    ----------
    source : Source
    titles : dict
        Titles of the tables, in order.
    rows : tuple of Row
    baseline : Baseline
        Verdicts that shuffled values get.
    claims : tuple of ClaimResult
    options : dict
        The options ``tables``, ``seeds``, ``as_run``.
    sha256 : dict
        SHA-256 of the files of published values.
    curves : dict
        L-curve for the first seed, for each EOP set whose kappas are among the rows.
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
        """Return the number of rows with each verdict, for one table or for all."""
        counter = Counter(row.verdict for row in self.rows if table in (None, row.table))
        return {kind: counter[kind] for kind in KINDS}

    def shuffled(self, table: str | None = None) -> dict[str, float]:
        """Return the number of rows with each verdict after shuffling printed values, for one table or all."""
        chosen = [counts for name, counts in self.baseline.verdicts.items() if table in (None, name)]
        return {kind: sum(counts[kind] for counts in chosen) for kind in KINDS}

    def gained(self, table: str | None = None) -> float:
        """Return how many more cells agree in digits, spread or size than after shuffling, for one table or all."""
        if table is None:
            return sum(map(self.gained, self.titles))
        true = sum(r.verdict in AGREEING for r in self.rows if r.table == table and r.key in self.baseline.chance)
        return max(true - sum(self.shuffled(table)[kind] for kind in AGREEING), 0.0)


def reproduce(
    name: str,
    *,
    tables: str = "",
    n_seeds: int = DEFAULT_SEEDS,
    as_run: bool = False,
    claims: bool = True,
    published: Path | None = None,
    data: Path | None = None,
    permutations: int = PERMUTATIONS,
    callback: Callback | None = None,
) -> Reproduction:
    """Run the experiments of a publication on synthetic blocks, and compare the results with the printed values.

    Parameters
    ----------
    name : str
        "terlemezoglu2019" or "topan2010"; "ipbuker1994" or "ayhan1996", which have no
        seeds, points or programs to vary.
    tables : str
        Tables and ranges of tables ("4.3-4.9,4.28"); "" for all tables.
    n_seeds : int
        Number of synthetic blocks; their seeds are 1 to n.
    as_run : bool
        True to use the procedure of the authors' program, on blocks with radial velocity and attitude.
    claims : bool
        True to assess the claims about the publication too.
    published : Path, optional
        Another folder with published tables.
    data : Path, optional
        Control points of the SPOT-6 scene, for tables 4.35-4.55; default ``$FG_ORIENT_REAL_DATA``.
    permutations : int
        Number of orders of these points, in addition to the order of their file.
    callback : callable, optional
        Function called after each run of the tables and of the claims.

    Raises
    ------
    InputError
        The publication or table is unknown, the number of seeds is out of range, or tables are damaged.
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
        on_points = source.real(printed, chosen, data, permutations=permutations, progress=progress("real points"))
    about_it = [claim for claim in all_claims() if claims and claim.id in source.claims]
    assessed = run_claims(seeds, progress("claims", n_seeds, steps), about_it) if about_it else []
    titles = {table: printed.titles[table] for table in chosen}
    rows, null = pair(printed, computed, source, chosen, on_points, as_run=as_run)
    curves = source.curves(on_twin, seeds[0], as_run=as_run) if source.curves else {}
    return Reproduction(source, titles, rows, null, tuple(assessed), options, printed.sha256, curves)


def select(text: str, tables: Sequence[str]) -> tuple[str, ...]:
    """Return the tables chosen by name and range.

    Raises
    ------
    InputError
        A table does not exist, or the ends of a range are exchanged.
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
    printed: PublishedTables,
    computed: Mapping[CellKey, Array],
    source: Source,
    tables: Sequence[str],
    on_points: Mapping[CellKey, Judge] | None = None,
    *,
    as_run: bool = False,
) -> tuple[tuple[Row, ...], Baseline]:
    """Compare each published cell of some tables with its runs, or by its judge ``on_points``.

    Then shuffle.
    """
    cells = [cell for cell in printed.cells if cell.key.table in tables]
    judges = {cell.key: (on_points or {}).get(cell.key) or _of_runs(cell.key, computed) for cell in cells}
    null, rows = baseline(cells, judges), []
    for cell in cells:
        comparison: CellComparison = judges[cell.key](cell)
        is_open = comparison.kind == "differs" and cell.key not in (on_points or {})
        known = known_reason(source.known, cell, as_run) if is_open else ""
        rows.append(
            Row(
                cell.key,
                cell.value,
                comparison.reproduced,
                comparison.low,
                comparison.high,
                comparison.kind,
                "; ".join(filter(None, (comparison.reason, known))),
                cell.text or cell.printed,
                cell.unit,
                cell.note,
                null.chance.get(cell.key, math.nan),
            )
        )
    return tuple(rows), null


def _of_runs(key: CellKey, computed: Mapping[CellKey, Array]) -> Judge:
    """Return a function that judges a cell by its runs on synthetic blocks."""
    order = float(computed.get(key._replace(quantity="matrix_order"), np.array([math.nan]))[0])
    return partial(assess_runs, runs=computed.get(key), order=None if math.isnan(order) else order)


#: Number of shuffles; their seeds are 1 to N.
SHUFFLES: Final = 20
#: Verdicts that contain information on the value of a cell, strongest first. A value on
#: the same side of a limit does not count.
AGREEING: Final[tuple[Kind, ...]] = ("equal", "rounding", "unit", "sigma", "spread", "order")
#: Verdicts on digits, the only ones counted by the headline.
DIGITS: Final[tuple[Kind, ...]] = ("equal", "rounding")


@dataclass(frozen=True)
class Baseline:
    """Verdicts that shuffled values get.

    Parameters
    ----------
    verdicts : dict
        For each table, the mean number of cells with each verdict over the shuffles.
        Cells without verdict, and cells that cannot be exchanged, are left out.
    chance : dict
        Share of the shuffles in which a cell gets its own verdict or a stronger one.
        Cells that are left out have no entry.
    """

    verdicts: dict[str, dict[Kind, float]]
    chance: dict[CellKey, float]


def roles(cells: Sequence[PublishedCell]) -> list[list[int]]:
    """Return the places of the cells of each role that has at least two printed numbers."""
    groups: dict[CellKey, list[int]] = {}
    for place, cell in enumerate(cells):
        if cell.text:
            key = cell.key._replace(eop_set="", stage="", method="")
            row_is_name = key == cell.key  # without set, image and solver, the parameter is the name of the row
            groups.setdefault(key._replace(parameter="") if row_is_name else key, []).append(place)
    return [places for places in groups.values() if len(places) > 1]


def shuffled(cells: Sequence[PublishedCell], seed: int) -> tuple[PublishedCell, ...]:
    """Exchange the printed values among the cells of each role.

    Parameters
    ----------
    cells : sequence of PublishedCell
    seed : int
        Seed of the permutations.
    """
    out, rng = list(cells), np.random.default_rng(seed)
    for places in roles(cells):
        for to, origin in zip(places, rng.permutation(places), strict=True):
            other = cells[int(origin)]
            out[to] = replace(cells[to], value=other.value, text=other.text, printed=other.printed)
    return tuple(out)


def baseline(cells: Sequence[PublishedCell], judges: Mapping[CellKey, Judge], n: int = SHUFFLES) -> Baseline:
    """Compare exchanged values: within a table, printed values are exchanged among cells of the same role.

    If exchanged values get a verdict as often as the true values, the verdict only shows that the
    quantity has this size in the table. It does not show that the cell has this value
    (docs/reproduce.md). The role consists of table, quantity, coefficient, axis, point set and type.
    EOP sets, images and solvers are exchanged; in tables without these, rows are exchanged. Computed
    values are not exchanged.

    Parameters
    ----------
    cells : sequence of PublishedCell
    judges : mapping
        Function that judges each cell.
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
