"""Publications: functions that compute their cells, and declarations from ``sources.toml``."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.l_curve import LCurve
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.errors import FgOrientError
from fg_orient.model.names import CellKey
from fg_orient.studies import tables_spot5, tables_spot6, tables_twin
from fg_orient.studies.published.tables import PublishedTables
from fg_orient.studies.reproduce import ayhan1996, ipbuker1994, spot6
from fg_orient.studies.reproduce.verdict import Cells, Judges, Kind, Values, assess_value, declared


@dataclass(frozen=True)
class Source:
    """Declaration of one publication.

    Parameters
    ----------
    name, title : str
        Name of the folder of published tables; author, year and subject.
    about : str
        Basis of the numbers, for the report.
    compute : callable or None
        ``compute(tables, seeds, as_run=, progress=)`` returns values (n,) of each cell on n synthetic blocks, one per
        seed. None if nothing is computed on synthetic blocks.
    real : callable, optional
        ``real(printed, tables, data, permutations=, progress=)`` returns the judge of each cell of tables that need no
        synthetic block.
    real_tables : tuple of str
        Tables computed by ``real``, if ``compute`` computes other tables.
    curves : callable, optional
        ``curves(tables, seed, as_run=)`` returns the L-curve of each EOP set whose kappas are in these tables.
    claims : tuple of str
        Ids of the claims about the publication.
    meanings : mapping
        Meaning of verdicts, if it differs from the meaning for runs on synthetic blocks.
    known : sequence of mappings
        Known reasons for differences; see :func:`fg_orient.studies.reproduce.verdict.known_reason`.
    """

    name: str
    title: str
    about: str
    compute: Callable[..., dict[CellKey, Array]] | None = None
    real: Callable[..., Judges] | None = None
    real_tables: tuple[str, ...] = ()
    curves: Callable[..., dict[int, LCurve]] | None = None
    claims: tuple[str, ...] = ()
    meanings: Mapping[str, str] = field(default_factory=dict)
    known: Sequence[Mapping[str, Any]] = ()


def recomputed(
    computers: Mapping[str, Callable[[Values], Cells]],
    remarks: Mapping[str, str],
    reasons: Mapping[str, str],
    within: Mapping[str, Kind],
    printed: PublishedTables,
    tables: Collection[str],
    _: Path | None = None,
    *,
    permutations: int = 0,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> Judges:
    """Compare tables that follow from printed numbers.

    Parameters
    ----------
    computers : mapping
        Function that computes the cells of each table from all printed values.
    remarks : mapping
        Origin of computed cells, by regular expressions of "table, address"; see ``Recomputed``.
    reasons : mapping
        Reason why the other cells of a table cannot be reproduced; "*" stands for all other tables.
    within : mapping
        Verdict inside a stated spread, by regular expressions of "table, address", if it is not ``spread``.
    printed : PublishedTables
    tables : collection of str
    permutations : int
        Not used here.
    progress : callable, optional
        Function called with the number of tables done and of all tables.
    """
    values: Values = {cell.key: np.float64(cell.value) for cell in printed.cells}
    why = {table: reason for names, reason in reasons.items() for table in names.split()}
    out: Judges = {}
    for done, table in enumerate(tables, start=1):
        cells, unknown = Cells(), why.get(table, why["*"])
        # a copy of the tables may contain any number; nan then gives the verdict "differs"
        with one_blas_thread(), np.errstate(all="ignore"):
            try:
                if table in computers:
                    cells = computers[table](values)
            except (FgOrientError, np.linalg.LinAlgError) as error:
                unknown = f"the numbers have no solution: {error}"
            for cell in printed.cells:
                if (key := cell.key).table == table:
                    out[key] = partial(
                        assess_value,
                        other=cells.get(key),
                        unknown=unknown,
                        origin=_first(remarks, key, ""),
                        within=_first(within, key, "spread"),
                    )
        progress(done, len(tables))
    return out


def _first(rules: Mapping[str, Any], key: CellKey, other: str) -> Any:
    """Return the value of the first regular expression that matches "table, address"."""
    return next((value for words, value in rules.items() if re.fullmatch(words, f"{key.table}, {key}")), other)


_DECLARED: Final = declared("sources.toml")
_DEFAULTS: Final = {name: value for name, value in _DECLARED.items() if isinstance(value, str)}


def _source(name: str, computers: Mapping[str, Callable[[Values], Cells]] | None = None, **functions: Any) -> Source:
    """Return a source from its declaration and functions; with ``computers`` its tables follow from printed numbers."""
    of_source = dict(_DECLARED[name])
    of_source["claims"] = tuple(of_source.get("claims", "").split())
    texts = of_source.pop("remarks", {}), of_source.pop("reasons", {}), of_source.pop("within", {})
    if computers is not None:
        functions["real"] = partial(recomputed, computers, *texts)
    return Source(name, **_DEFAULTS | of_source | functions)


#: Publications by name.
SOURCES: Final = {source.name: source for source in (
    _source("terlemezoglu2019", compute=tables_spot5.compute, real=spot6.compare, real_tables=tables_spot6.TABLES,
            curves=tables_spot5.tikhonov_curves),
    _source("topan2010", compute=tables_twin.compute),
    _source("ipbuker1994", ipbuker1994.COMPUTERS),
    _source("ayhan1996", ayhan1996.COMPUTERS),
)}  # fmt: skip
