"""Publications: functions that compute their cells, claims about them, known reasons for differences."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from factors._contract import Array
from fg_orient.adjustment.linear.l_curve import LCurve
from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.model.cells import CellKey
from fg_orient.model.errors import FgOrientError
from fg_orient.studies import tables_spot5, tables_spot6, tables_twin
from fg_orient.studies.published.tables import PublishedCell, PublishedTables
from fg_orient.studies.reproduce import spot6
from fg_orient.studies.reproduce.verdict import ICP_LIMIT_M, Cells, Comparisons, Values, assess_value

#: Basis of most numbers of the studies on SPOT-5.
ON_TWIN: Final = (
    "The points and images of the publication are not available. Each seed is a twin with points, errors and noise of "
    "its own, so digits cannot agree; patterns, orders of magnitude and which side of the target a result falls on "
    "can. "
    '"Reproduced" is the median of the runs, the range their smallest and largest value.'
)


@dataclass(frozen=True)
class Source:
    """A publication.

    Parameters
    ----------
    name, title : str
        Folder of the published tables; author, year and subject.
    compute : callable or None
        ``compute(tables, seeds, as_run=, progress=)``: values (n,) of each cell on n synthetic blocks, one per seed.
        None if nothing is computed on synthetic blocks.
    claims : tuple of str
        Ids of the claims about it.
    explain : callable
        ``explain(cell, as_run)``: sentence with the known reason for a difference, or "".
    real : callable, optional
        ``real(printed, tables, data, permutations=, progress=)``: comparison of each cell of tables that need no
        synthetic block.
    real_tables : tuple of str
        Tables for ``real``, if ``compute`` computes others.
    about : str
        Basis of the numbers, for the report.
    meanings : mapping, optional
        Meaning of a verdict where it differs from that for runs on synthetic blocks.
    counted, patterned : str
        Summary of the numbers with the verdicts ``rounding`` and ``pattern``.
    curves : callable, optional
        ``curves(tables, seed, as_run=)``: L-curve of each EOP set whose kappas are in these tables.
    """

    name: str
    title: str
    compute: Callable[..., dict[CellKey, Array]] | None = None
    claims: tuple[str, ...] = ()
    explain: Callable[[PublishedCell, bool], str] = lambda *_: ""
    real: Callable[..., Comparisons] | None = None
    real_tables: tuple[str, ...] = ()
    about: str = ON_TWIN
    meanings: Mapping[str, str] = field(default_factory=dict)
    counted: str = "are rounding noise inside the spread of the runs"
    patterned: str = "lie on the same side of the limit"
    curves: Callable[..., dict[int, LCurve]] | None = None


def recomputed_tables(
    computers: Mapping[str, Sequence[Callable[[Values], Cells]]], reasons: Mapping[str, str], otherwise: str
) -> Callable[..., Comparisons]:
    """Comparison of tables that follow from printed numbers, for ``Source.real``.

    Parameters
    ----------
    computers : mapping
        Table to functions that compute cells from all printed values.
    reasons : mapping
        Table to the reason why its other cells cannot be reproduced.
    otherwise : str
        This reason for all other tables.
    """

    def compare(
        printed: PublishedTables, tables: Collection[str], _: Path | None, *, permutations: int = 0,
        progress: Callable[[int, int], None] | None = None,
    ) -> Comparisons:  # fmt: skip
        values: Values = {cell.key: np.float64(cell.value) for cell in printed.cells}
        chosen = [table for table in printed.titles if table in tables]
        out: Comparisons = {}
        for done, table in enumerate(chosen, start=1):
            cells, unknown = Cells(), reasons.get(table, otherwise)
            with one_blas_thread(), np.errstate(all="ignore"):  # a copy may contain any number: nan then differs
                try:
                    for compute in computers.get(table, ()):
                        cells |= compute(values)
                except (FgOrientError, np.linalg.LinAlgError) as error:
                    cells, unknown = {}, f"the numbers have no solution: {error}"
                of_table = (cell for cell in printed.cells if cell.key.table == table)
                out |= {cell.key: assess_value(cell, cells.get(cell.key), unknown) for cell in of_table}
            if progress is not None:
                progress(done, len(chosen))
        return out

    return compare


# --- the two publications on SPOT-5 ---------------------------------------------------------------

_PARALLAXES: Final = "the size depends on the y-parallaxes of points that are not published"
_ATTITUDES: Final = "the program intersects control points with corrected attitudes from uncorrected positions (as run)"
_NOISE: Final = "the size of dP is rounding noise, and with it on which side of the target a set falls"


def explain_terlemezoglu(cell: PublishedCell, as_run: bool = False) -> str:
    """Known reason why a cell of Terlemezoğlu (2019) differs; "" if there is none."""
    key = cell.key
    if key.table in {"eq4.5", "eq4.6"}:
        return "misprint of the source: its own tables use the reproduced count"
    if key.point_role == "icp" and cell.value > ICP_LIMIT_M:
        if as_run:
            return "without bundle rounding decides how far check points diverge"
        return "printed as if check points were intersected after step 2, without bundle (as run), where they diverge"
    if key.quantity == "dP" and "V" in key.parameter:
        return "velocities are printed larger by decades; not explained"
    if key.quantity == "det":
        return "the determinant depends on the units of all unknowns and on the points"
    if key.point_role != "gcp":
        return ""
    if key.eop_set == "13" and key.method in {"moore_penrose_inverse", "tikhonov_od"}:
        if as_run:
            return "not explained: type 1 errs by some metres without bundle and by 3e4 m and more with it"
        return "the program ruins set 13 by the length of its across-track axis, which follows the unknowns (as run)"
    if key.eop_set == "15":
        return _PARALLAXES if as_run else _ATTITUDES
    return _NOISE


def explain_topan(cell: PublishedCell, as_run: bool = False) -> str:
    """Known reason why a cell of Topan & Maktav (2010) differs; "" if there is none."""
    key = cell.key
    if key.quantity == "n_gcp_needed_unmodelled_printed":
        return "misprint of the source: 108000 / 2"
    if key.table != "2" or key.point_role != "gcp":
        return ""
    if key.eop_set in {"15", "16"}:
        return _PARALLAXES if as_run else _ATTITUDES
    if key.eop_set in {"14", "18"}:
        if as_run:
            return "a weak direction: its size depends on the noise and on the radial velocity of the real scenes"
        return "in the program the length of the across-track axis follows the velocity (as run)"
    return _NOISE


TERLEMEZOGLU: Final = Source(
    "terlemezoglu2019",
    "Terlemezoğlu (2019), regularisation of ill-conditioned systems in the orientation of satellite images",
    tables_spot5.compute,
    tuple(f"C{k}" for k in range(1, 23) if k not in (3, 7)),
    explain_terlemezoglu,
    spot6.compare,
    tables_spot6.TABLES,
    curves=tables_spot5.tikhonov_curves,
)
TOPAN: Final = Source(
    "topan2010",
    "Topan & Maktav (2010), geometric accuracy of stereo SPOT-5 HRG level 1A images",
    tables_twin.compute,
    ("C1", "C2", "C3", "C4", "C5", "C6", "C7", "C11"),
    explain_topan,
)
