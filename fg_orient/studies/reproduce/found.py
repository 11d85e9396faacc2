"""What is known about a published number from elsewhere: a value, perhaps with a spread, and a sentence.

The verdicts of :func:`judge`:

- ``equal``: the printed digits.
- ``rounding``: one unit of the last digit away (not where printed numbers are only added or multiplied), or inside
  the stated spread.
- ``order``: a size that is only expected to be of the order of another; the ratio is given.
- ``differs``: neither, with a sentence; ``not_reproducible`` with the reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np

from fg_orient.adjustment.linear.threads import one_blas_thread
from fg_orient.model.cells import CellKey
from fg_orient.model.errors import InputError
from fg_orient.studies.published.tables import PublishedCell, PublishedTables
from fg_orient.studies.reproduce.verdict import ORDER, Kind, Verdict, last_digit


@dataclass(frozen=True)
class Found:
    """A recomputed number.

    Parameters
    ----------
    value : float
        nan if only a verdict is known.
    remark : str
        From what it follows.
    low, high : float
        Spread in which the published number is expected; nan if the digits are.
    is_exact : bool
        Arithmetic on printed numbers: one unit of the last digit is an error, no rounding of values in between.
    is_order : bool
        Only the order of magnitude is expected.
    kind : str, optional
        A verdict that does not follow from the numbers here.
    """

    value: float
    remark: str = ""
    low: float = math.nan
    high: float = math.nan
    is_exact: bool = False
    is_order: bool = False
    kind: Kind | None = None

    @property
    def has_spread(self) -> bool:
        """Tell whether a spread is stated."""
        return not math.isnan(self.low)


def judged_by_tables(
    printed: PublishedTables, tables: Collection[str], compute: Callable[[str], tuple[Mapping[CellKey, Found], str]],
    progress: Callable[[int, int], None] | None = None,
) -> dict[CellKey, Verdict]:  # fmt: skip
    """Judge the cells of some tables.

    Parameters
    ----------
    printed : PublishedTables
    tables : collection of str
    compute : callable
        Gives what is known about the cells of a table, and why nothing is known about the others.
    progress : callable, optional
        Called with tables done and tables in all.
    """
    wanted = [table for table in printed.titles if table in tables]
    out: dict[CellKey, Verdict] = {}
    for done, table in enumerate(wanted, start=1):
        with one_blas_thread(), np.errstate(all="ignore"):  # a copy may hold any number: nan then differs
            found, unknown = compute(table)
            cells = [cell for cell in printed.cells if cell.key.table == table]
            out |= {cell.key: judge(cell, found.get(cell.key), unknown) for cell in cells}
        if progress is not None:
            progress(done, len(wanted))
    return out


def attempt(call: Callable[..., float], *printed: float) -> float:
    """Call with printed numbers; nan where the call refuses them, as a copy may hold any."""
    try:
        return call(*printed)
    except InputError:
        return math.nan


def judge(cell: PublishedCell, found: Found | None, unknown: str) -> Verdict:
    """Compare a printed number with what is known about it; see the module docstring.

    Parameters
    ----------
    cell : PublishedCell
    found : Found or None
    unknown : str
        Why nothing is known about it.
    """
    if not cell.text:
        return Verdict("not_reproducible", "a statement in words" if cell.printed else "nothing is printed")
    if found is None:
        return Verdict("not_reproducible", unknown)
    if found.kind is not None:
        return Verdict(found.kind, found.remark, found.value, found.low, found.high)
    if found.is_order:
        kind, words = _order(cell, found)
    elif found.has_spread:
        kind, words = _spread(cell, found)
    else:
        kind, words = _digits(cell, found)
    reason = f"{words}: {found.remark}" if found.remark else words
    return Verdict(kind, reason, found.value, found.low, found.high)


def _order(cell: PublishedCell, found: Found) -> tuple[Kind, str]:
    """Compare the sizes."""
    if cell.value == 0.0:
        return "differs", f"published 0, reproduced {found.value:.2g}"
    ratio = found.value / cell.value
    return ("order" if 1.0 / ORDER <= ratio <= ORDER else "differs"), f"reproduced / published = {ratio:.2g}"


def _spread(cell: PublishedCell, found: Found) -> tuple[Kind, str]:
    """Compare with the stated spread, widened by the rounding of the print."""
    half = 0.5 * last_digit(cell.text)
    if found.low - half <= cell.value <= found.high + half:
        return "rounding", "inside the spread"
    return "differs", "outside the spread"


def _digits(cell: PublishedCell, found: Found) -> tuple[Kind, str]:
    """Compare with the printed digits; the slack is the decimal print of a double."""
    off, unit = abs(found.value - cell.value), last_digit(cell.text)
    slack = 1e-9 * abs(cell.value)
    if off <= 0.5 * unit + slack:
        return "equal", "all printed digits"
    if off <= unit + slack and not found.is_exact:
        return "rounding", "one unit of the last digit"
    return "differs", f"published {cell.text}, reproduced {found.value:.7g}"
