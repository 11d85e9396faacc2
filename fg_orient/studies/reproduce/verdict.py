"""The verdict on one published number: it depends on this number and on the computed runs, on nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from fg_orient.studies.published.tables import PublishedCell
from fg_orient.studies.reproduce.rules import RULES, Rule, kind_of

Array = npt.NDArray[np.float64]
Kind = Literal["equal", "order", "rounding", "pattern", "differs", "not_reproducible"]
KINDS: Final[tuple[Kind, ...]] = ("equal", "order", "rounding", "pattern", "differs", "not_reproducible")
#: Ratio of published and reproduced that still counts as the same order of magnitude.
ORDER: Final = 10.0


@dataclass(frozen=True)
class Verdict:
    """Published beside reproduced.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    reason : str
        One line.
    reproduced : float
        Median of the runs; nan if more than half of them broke down, or there are none.
    low, high : float
        Smallest and largest run; nan if all broke down.
    """

    kind: Kind
    reason: str
    reproduced: float = math.nan
    low: float = math.nan
    high: float = math.nan


@dataclass(frozen=True)
class _Runs:
    """The runs of a cell, summarised."""

    n: int
    finite: Array
    median: float

    @property
    def of(self) -> str:
        """Words for the count of runs."""
        failed = self.n - len(self.finite)
        return f"{self.n} runs" if not failed else f"{self.n} runs, {failed} of them without a result"


def judge(cell: PublishedCell, runs: Array | None, order: float | None = None) -> Verdict:
    """Compare a published number with the runs of the twin.

    Parameters
    ----------
    cell : PublishedCell
    runs : (n,) array or None
        Values of the cell, nan where a solver broke down; None if nothing computes it.
    order : float, optional
        Order of the matrix, for ranks.
    """
    rule = RULES[kind_of(cell.key)]
    summary = None if runs is None else _summary(runs)
    verdict = _without_comparison(cell, rule, summary) or _tested(cell, rule, summary, order)
    if summary is None:
        return verdict
    low, high = (summary.finite.min(), summary.finite.max()) if len(summary.finite) else (math.nan, math.nan)
    return replace(verdict, reproduced=summary.median, low=float(low), high=float(high))


def _summary(runs: Array) -> _Runs:
    finite = runs[np.isfinite(runs)]
    most = 2 * len(finite) > len(runs)
    # a run's own value, not a mean of two: counts and ranks stay whole
    return _Runs(len(runs), finite, float(np.sort(finite)[(len(finite) - 1) // 2]) if most else math.nan)


def _without_comparison(cell: PublishedCell, rule: Rule, runs: _Runs | None) -> Verdict | None:
    """Cells that hold nothing to compare; None for all others."""
    if not cell.text:
        has_words = any(character.isalnum() for character in cell.printed)  # a dash says nothing
        return Verdict("not_reproducible", "a statement in words" if has_words else "nothing is printed")
    if runs is None:
        return Verdict("not_reproducible", "a fact about the real data or a convention: nothing to compute")
    return None


def _tested(cell: PublishedCell, rule: Rule, runs: _Runs | None, order: float | None) -> Verdict:
    """Try the tests of the rule in order."""
    assert runs is not None
    for name in rule.tests:
        reason = _TESTS[name](cell, rule, runs, order)
        if reason:
            return Verdict(name, reason)
    if not math.isfinite(cell.value) or not math.isfinite(runs.median):  # one of them broke down, not the other
        seen = "" if math.isfinite(runs.median) else f" (no result in most of {runs.n} runs)"
        return Verdict("not_reproducible", rule.without_value + seen)
    return Verdict("differs", f"{_difference(cell, runs)} ({rule.what})")


def _difference(cell: PublishedCell, runs: _Runs) -> str:
    """Say how far published and reproduced are apart."""
    if cell.value == 0.0 or runs.median == 0.0:
        return f"published {cell.value:g}, reproduced {runs.median:.3g}"
    ratio = abs(runs.median / cell.value)
    return (
        f"reproduced is {ratio:.2g} times the published size"
        if not 0.1 <= ratio <= 10
        else (f"published {cell.value:g}, reproduced {runs.median:.6g}")
    )


# --- the tests: a reason if they hold, else "" ----------------------------------------------------


def _equal(cell: PublishedCell, rule: Rule, runs: _Runs, order: float | None) -> str:
    """All printed digits in all runs; a whole number (counts, 0 after an underflow, a clamped 1) is exact."""
    if not math.isfinite(cell.value) or len(runs.finite) < runs.n:
        return ""
    half = 0.0 if cell.text.lstrip("+-").isdigit() else 0.5 * last_digit(cell.text)
    slack = 1e-12 * abs(cell.value)  # the decimal print of a double
    return f"all {runs.n} runs" if (np.abs(runs.finite - cell.value) <= half + slack).all() else ""


def _order(cell: PublishedCell, rule: Rule, runs: _Runs, limit: float | None) -> str:
    if not (math.isfinite(cell.value) and math.isfinite(runs.median)) or 0.0 in (cell.value, runs.median):
        return ""
    ratio = abs(runs.median / cell.value)
    return f"reproduced / published = {ratio:.2g}" if 1.0 / ORDER <= ratio <= ORDER else ""


def _rounding(cell: PublishedCell, rule: Rule, runs: _Runs, limit: float | None) -> str:
    if not math.isfinite(cell.value) or not len(runs.finite):
        return ""
    sizes, factor = np.abs(runs.finite), 10.0 if rule.decade else 1.0
    if not sizes.min() / factor <= abs(cell.value) <= sizes.max() * factor:
        return ""
    return f"inside {sizes.min():.2g} to {sizes.max():.2g} of {runs.of}{' (a decade added)' if rule.decade else ''}"


def _pattern(cell: PublishedCell, rule: Rule, runs: _Runs, order: float | None) -> str:
    """Same side of the limit; ranks: both deficient or both full."""
    if math.isnan(rule.limit) and order is None:
        return ""
    limit = float(order or 0.0) - 0.5 if math.isnan(rule.limit) else rule.limit
    if math.isnan(cell.value) and not rule.nan_above:
        return ""
    above = not abs(cell.value) <= limit
    n_above = runs.n - int((np.abs(runs.finite) <= limit).sum())
    same = n_above if above else runs.n - n_above
    if 2 * same <= runs.n:
        return ""
    if math.isnan(rule.limit):
        return f"both {'of full rank' if above else 'rank deficient'} ({same} of {runs.n} runs)"
    return f"both {'above' if above else 'below'} {rule.limit:g}{rule.unit} ({same} of {runs.n} runs)"


_TESTS: Final = {"equal": _equal, "order": _order, "rounding": _rounding, "pattern": _pattern}


def last_digit(text: str) -> float:
    """Size of one unit of the last printed digit: 0.001 for "0.510", 1e-12 for "-8.5e-11"."""
    mantissa, _, exponent = text.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(10.0 ** (int(exponent or 0) - decimals))
