"""Comparison of a published number with computed ones.

:func:`assess_runs` compares a number with the runs of the twin, by the rule of its quantity (``RULES``, the one table,
docs/reproduce.md). The tests of a rule are tried in order. The first that holds is the verdict; if none holds it is
``differs``:

- ``equal``: every run gives all printed digits.
- ``order``: published and reproduced (median of the runs) have a ratio of 0.1 to 10, signs aside.
- ``rounding``: the published size lies between the smallest and the largest run, a decade added on
  both sides (not for ranks).
- ``pattern``: published and more than half of the runs lie on the same side of ``limit``; a solver that
  breaks down and a printed NaN lie above it.

:func:`assess_value` compares a number with one that is recomputed from other printed numbers, laws or simulations:

- ``equal``: the printed digits.
- ``rounding``: one unit of the last digit away (not where printed numbers are only added or multiplied), or inside
  the stated spread.
- ``order``: a size of which only the order of magnitude is expected; the ratio is given.
- ``differs``: none of these; ``not_reproducible``: with the reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from factors._contract import Array
from fg_orient.model.cells import CellKey
from fg_orient.model.errors import InputError
from fg_orient.studies.published.tables import PublishedCell

Test = Literal["equal", "order", "rounding", "pattern"]
Kind = Literal["equal", "order", "rounding", "pattern", "differs", "not_reproducible"]
KINDS: Final[tuple[Kind, ...]] = ("equal", "order", "rounding", "pattern", "differs", "not_reproducible")
#: Ratio of published and reproduced that still counts as the same order of magnitude.
ORDER: Final = 10.0
#: The target at control points, 1 pixel (T sect. 4.2.1).
TARGET_M: Final = 5.0
#: Three times the accuracy at check points (P, conclusions): beyond it they have diverged.
ICP_LIMIT_M: Final = 15.0


@dataclass(frozen=True)
class CellComparison:
    """A published number compared with the reproduced one.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    reason : str
        One line.
    reproduced : float
        Recomputed value or median of the runs; nan without one, or if more than half of the runs broke down.
    low, high : float
        Stated spread, or smallest and largest run; nan without one.
    """

    kind: Kind
    reason: str
    reproduced: float = math.nan
    low: float = math.nan
    high: float = math.nan


Comparisons = dict[CellKey, CellComparison]


@dataclass(frozen=True)
class Rule:
    """Tests of a kind of quantity.

    Parameters
    ----------
    tests : tuple of str
        In order, see the module docstring.
    what : str
        Meaning of the number, for the reason.
    limit : float
        Of the test ``pattern``; nan for ranks: the order of the matrix.
    unit : str
        Of the limit.
    without_value : str
        Why a printed NaN without counterpart cannot be compared.
    nan_above : bool
        Whether a printed NaN means a solver that broke down, above every limit.
    decade : bool
        Whether ``rounding`` widens the spread by a decade.
    """

    tests: tuple[Test, ...]
    what: str
    limit: float = math.nan
    unit: str = ""
    without_value: str = "which solver breaks down is decided by the rounding of the unpublished data"
    nan_above: bool = True
    decade: bool = True


_UNDERFLOW = "printed after an underflow (0/0); log-determinants give a number"
RULES: Final[dict[str, Rule]] = {
    "count": Rule(("equal",), "a count"),
    "gcp": Rule(("order", "pattern"), "RMSE at control points", TARGET_M, " m"),
    "icp": Rule(("order", "pattern"), "RMSE at check points", ICP_LIMIT_M, " m"),
    "kappa": Rule(("equal", "rounding"), "follows from a solution of rounding noise"),
    "dP": Rule(("rounding",), "rounding noise amplified by the inverse; its sign cannot be reproduced"),
    "misclosure": Rule(("rounding",), "rounding noise: step 1 has closed all conditions"),
    "residual": Rule(("order", "rounding"), "residuals of the look angles, rad"),
    "normal": Rule(("rounding",), "rounding noise of the solver"),
    "rank": Rule(("equal", "rounding", "pattern"), "rank within rounding", decade=False),
    "det": Rule(("equal", "order", "rounding"), "a determinant near zero; its sign is rounding",
                without_value=_UNDERFLOW),
    "cond_norm": Rule(("order", "rounding", "pattern"), "largest by smallest singular value", 1e16),
    "cond_spectral": Rule(("order", "rounding", "pattern"), "largest by smallest eigenvalue; sign is rounding", 1e3),
    "cond_hadamard": Rule(
        ("order", "rounding", "pattern"), "determinant by row norms", 1e-2, without_value=_UNDERFLOW,
        nan_above=False,
    ),
    "correlation": Rule(("equal", "pattern"), "correlation of the design", 0.98),
}  # fmt: skip


def kind_of(key: CellKey) -> str:
    """Row of ``RULES`` for a cell."""
    if key.quantity.startswith("rmse_"):
        return key.point_role
    if key.quantity in {"sum_residual", "sum_squared_residual"}:
        return "residual" if key.stage == "bundle" else "misclosure"
    if key.quantity.startswith("normal_residual_abs_"):
        return "normal"
    return key.quantity if key.quantity in RULES else "count"


# --- runs of the twin -----------------------------------------------------------------------------


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


def assess_runs(cell: PublishedCell, runs: Array | None, order: float | None = None) -> CellComparison:
    """Compare a published number with the runs of the twin.

    Parameters
    ----------
    cell : PublishedCell
    runs : (n,) array or None
        Values of the cell, nan where a solver broke down; None if nothing computes it.
    order : float, optional
        Order of the matrix, for ranks.
    """
    if runs is None:
        fact = "a fact about the real data or a convention: nothing to compute"
        return _without_number(cell) or CellComparison("not_reproducible", fact)
    finite = runs[np.isfinite(runs)]
    most = 2 * len(finite) > len(runs)
    # a run's own value, not a mean of two: counts and ranks stay whole
    seen = _Runs(len(runs), finite, float(np.sort(finite)[(len(finite) - 1) // 2]) if most else math.nan)
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (math.nan, math.nan)
    return replace(
        _without_number(cell) or _tested(cell, seen, order), reproduced=seen.median, low=low, high=high
    )  # fmt: skip


def _without_number(cell: PublishedCell) -> CellComparison | None:
    """Comparison of a cell without a number; None for all others."""
    if cell.text:
        return None
    has_words = any(character.isalnum() for character in cell.printed)  # a dash says nothing
    return CellComparison("not_reproducible", "a statement in words" if has_words else "nothing is printed")


def _tested(cell: PublishedCell, runs: _Runs, order: float | None) -> CellComparison:
    """Try the tests of the rule in order."""
    rule = RULES[kind_of(cell.key)]
    for name in rule.tests:
        reason = _TESTS[name](cell, rule, runs, order)
        if reason:
            return CellComparison(name, reason)
    if not math.isfinite(cell.value) or not math.isfinite(runs.median):  # one of them broke down, not the other
        broken = "" if math.isfinite(runs.median) else f" (no result in most of {runs.n} runs)"
        return CellComparison("not_reproducible", rule.without_value + broken)
    ratio = abs(runs.median / cell.value) if cell.value else 0.0
    if ratio == 0.0:
        words = f"published {cell.value:g}, reproduced {runs.median:.3g}"
    elif 0.1 <= ratio <= 10:
        words = f"published {cell.value:g}, reproduced {runs.median:.6g}"
    else:
        words = f"reproduced is {ratio:.2g} times the published size"
    return CellComparison("differs", f"{words} ({rule.what})")


# Each test gives a reason if it holds, else "".


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
    is_rank = math.isnan(rule.limit)
    if (is_rank and order is None) or (math.isnan(cell.value) and not rule.nan_above):
        return ""
    limit = float(order or 0.0) - 0.5 if is_rank else rule.limit
    above = not abs(cell.value) <= limit
    n_above = runs.n - int((np.abs(runs.finite) <= limit).sum())
    same = n_above if above else runs.n - n_above
    if 2 * same <= runs.n:
        return ""
    if is_rank:
        return f"both {'of full rank' if above else 'rank deficient'} ({same} of {runs.n} runs)"
    return f"both {'above' if above else 'below'} {rule.limit:g}{rule.unit} ({same} of {runs.n} runs)"


_TESTS: Final = {"equal": _equal, "order": _order, "rounding": _rounding, "pattern": _pattern}


# --- values recomputed from other printed numbers -------------------------------------------------


@dataclass(frozen=True)
class Recomputed:
    """A number that follows from other printed numbers, a law or a simulation.

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

    @classmethod
    def around(cls, value: float, half: float, remark: str, kind: Kind | None = None) -> Recomputed:
        """Number with a spread of the same size to both sides."""
        return cls(float(value), remark, float(value - half), float(value + half), kind=kind)


Values = Mapping[CellKey, float]
Cells = dict[CellKey, Recomputed]


def row_key(table: str, row: str, quantity: str) -> CellKey:
    """Address of a number in a table of rows and quantities."""
    return CellKey(table, quantity=quantity, parameter=row)


def attempt(call: Callable[..., float], *printed: float) -> float:
    """Call with printed numbers; nan where the call refuses them, as a copy may hold any."""
    try:
        return call(*printed)
    except InputError:
        return math.nan


def assess_value(cell: PublishedCell, other: Recomputed | None, unknown: str) -> CellComparison:
    """Compare a printed number with a recomputed one; see the module docstring.

    Parameters
    ----------
    cell : PublishedCell
    other : Recomputed or None
    unknown : str
        Why nothing is recomputed, for None.
    """
    if without := _without_number(cell):
        return without
    if other is None:
        return CellComparison("not_reproducible", unknown)
    kind, words = (other.kind, "") if other.kind is not None else _value_kind(cell, other)
    reason = ": ".join(filter(None, (words, other.remark)))
    return CellComparison(kind, reason, other.value, other.low, other.high)


def _value_kind(cell: PublishedCell, other: Recomputed) -> tuple[Kind, str]:
    """Compare the sizes, or with the spread widened by the rounding of the print, or with the printed digits."""
    unit = last_digit(cell.text)
    if other.is_order:
        if cell.value == 0.0:
            return "differs", f"published 0, reproduced {other.value:.2g}"
        ratio = other.value / cell.value
        return ("order" if 1.0 / ORDER <= ratio <= ORDER else "differs"), f"reproduced / published = {ratio:.2g}"
    if not math.isnan(other.low):
        inside = other.low - 0.5 * unit <= cell.value <= other.high + 0.5 * unit
        return ("rounding", "inside the spread") if inside else ("differs", "outside the spread")
    off, slack = abs(other.value - cell.value), 1e-9 * abs(cell.value)  # slack: the decimal print of a double
    if off <= 0.5 * unit + slack:
        return "equal", "all printed digits"
    if off <= unit + slack and not other.is_exact:
        return "rounding", "one unit of the last digit"
    return "differs", f"published {cell.text}, reproduced {other.value:.7g}"


def last_digit(text: str) -> float:
    """Size of one unit of the last printed digit: 0.001 for "0.510", 1e-12 for "-8.5e-11"."""
    mantissa, _, exponent = text.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(10.0 ** (int(exponent or 0) - decimals))
