"""Published and reproduced values, cell by cell, with the claims: computation of ``fg-orient reproduce``."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors._contract import Array
from fg_orient.adjustment.linear.l_curve import LCurve
from fg_orient.model.errors import InputError
from fg_orient.model.names import CellKey
from fg_orient.studies.claims import ClaimResult, all_claims, run_claims
from fg_orient.studies.published.tables import PublishedTables, load
from fg_orient.studies.reproduce.sources import SOURCES, Source
from fg_orient.studies.reproduce.verdict import KINDS, CellComparison, assess_runs, known_reason
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
    claims: tuple[ClaimResult, ...]
    options: dict[str, Any]
    sha256: dict[str, str]
    curves: dict[int, LCurve] = field(default_factory=dict)

    def counts(self, table: str | None = None) -> dict[str, int]:
        """Number of rows with each verdict, of one table or of all."""
        counter = Counter(row.verdict for row in self.rows if table in (None, row.table))
        return {kind: counter[kind] for kind in KINDS}


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
    rows = pair(printed, computed, source, chosen, on_points, as_run=as_run)
    curves = source.curves(on_twin, seeds[0], as_run=as_run) if source.curves else {}
    return Reproduction(source, titles, rows, tuple(assessed), options, printed.sha256, curves)


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
    compared: Mapping[CellKey, CellComparison] | None = None, *, as_run: bool = False,
) -> tuple[Row, ...]:  # fmt: skip
    """Compare each published cell of some tables with its runs, unless ``compared`` contains its comparison."""
    rows = []
    for cell in printed.cells:
        key = cell.key
        if key.table not in tables:
            continue
        orders = computed.get(key._replace(quantity="matrix_order"), np.array([math.nan]))
        comparison, known = (compared or {}).get(key), ""
        if comparison is None:
            comparison = assess_runs(cell, computed.get(key), None if np.isnan(orders[0]) else float(orders[0]))
            known = known_reason(source.known, cell, as_run) if comparison.kind == "differs" else ""
        rows.append(Row(
            key, cell.value, comparison.reproduced, comparison.low, comparison.high, comparison.kind,
            "; ".join(filter(None, (comparison.reason, known))), cell.text or cell.printed, cell.unit, cell.note,
        ))  # fmt: skip
    return tuple(rows)
