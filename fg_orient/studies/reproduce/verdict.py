"""Comparison of a published number with computed ones.

:func:`assess_runs` compares a number with the runs on synthetic blocks, by the rule of its quantity (``rules.toml``,
docs/reproduce.md). The tests of a rule are tried in order. The first test that holds gives the verdict; if none holds
it is ``differs``:

- ``equal``: every run gives all printed digits.
- ``rounding``: the reproduced value (median of the runs) rounds to the printed digits.
- ``order``: the ratio of published and reproduced size is 0.1 to 10; signs are ignored.
- ``spread``: the published size lies between the smallest and the largest run, extended by a factor of ten on both
  sides (not for ranks).
- ``side``: the published number and more than half of the runs lie on the same side of ``limit``. A solver that breaks
  down, and a printed NaN, count as above the limit.

:func:`assess_value` compares a number with a number recomputed from other printed numbers, laws or simulations:

- ``equal``: the printed digits agree. ``rounding``: they agree, and a stated spread is wider than one unit of the last
  digit.
- ``unit``: the difference is one unit of the last digit (not for sums and products of printed numbers).
- ``spread``, ``sigma``: the number lies inside the stated spread; ``sigma`` if the spread is one standard deviation.
- ``fitted``: the number lies inside the stated spread, but the computation was fitted partly to the printed values.
- ``order``: only the order of magnitude is expected to agree; the ratio is given.
- ``differs``: none of these holds. ``not_reproducible``: a reason is given.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from factors.arrays import Array
from fg_orient.model.digits import MEANING, agreement, last_digit
from fg_orient.model.errors import InputError
from fg_orient.model.names import CellKey
from fg_orient.studies.published.tables import PublishedCell

Test = Literal["equal", "rounding", "order", "spread", "side"]
Kind = Literal["equal", "rounding", "unit", "spread", "sigma", "order", "side", "fitted", "differs", "not_reproducible"]
#: Largest ratio of published and reproduced numbers accepted as the same order of magnitude.
ORDER: Final = 10.0


@dataclass(frozen=True)
class CellComparison:
    """Result of comparing a published number with the reproduced one.

    Parameters
    ----------
    kind : str
        Verdict, one of ``KINDS``.
    reason : str
        Reason in one line.
    reproduced : float
        Recomputed value, or median of the runs; nan if it is missing, or if half or more of the runs broke down.
    low, high : float
        Stated spread, or smallest and largest run; nan if there is none.
    """

    kind: Kind
    reason: str
    reproduced: float = math.nan
    low: float = math.nan
    high: float = math.nan


#: Function that compares the printed number of a cell, or of another cell
#: (``reproduction.baseline``), with the values of this cell.
Judge = Callable[[PublishedCell], CellComparison]
Judges = dict[CellKey, Judge]


@dataclass(frozen=True)
class Rule:
    """Tests for one kind of quantity.

    Parameters
    ----------
    tests : tuple of str
        Tests in the order of trial; see the module docstring.
    what : str
        Meaning of the number, for the reason.
    limit : float
        Limit for the test ``side``; nan for ranks, which are compared with the order of the matrix.
    unit : str
        Unit of the limit.
    without_value : str
        Reason why a printed NaN without a computed value cannot be compared.
    nan_above : bool
        True if a printed NaN means that the solver broke down; it then counts as above every limit.
    decade : bool
        True if ``spread`` extends the spread by a factor of ten.
    """

    tests: tuple[Test, ...]
    what: str
    limit: float = math.nan
    unit: str = ""
    without_value: str = "which solver breaks down is decided by the rounding of the unpublished data"
    nan_above: bool = True
    decade: bool = True


@cache
def declared(name: str) -> dict[str, Any]:
    """Return the content of a TOML file of this package."""
    return tomllib.loads(Path(__file__).with_name(name).read_text("utf-8"))


_DECLARED: Final = declared("rules.toml")
#: Rule of each kind of quantity.
RULES: Final = {name: Rule(**row | {"tests": tuple(row["tests"])}) for name, row in _DECLARED["rules"].items()}
#: Symbol, name and meaning of each verdict, in the order of reports.
LEGEND: Final[dict[Kind, list[str]]] = _DECLARED["legend"]
KINDS: Final[tuple[Kind, ...]] = tuple(LEGEND)


def known_reason(rules: Iterable[Mapping[str, Any]], cell: PublishedCell, as_run: bool = False) -> str:
    """Return the reason of the first rule whose regular expressions match a cell's address; "" if none does.

    Parameters
    ----------
    rules : iterable of mappings
        Regular expressions for the fields of the address. ``above``: limit that the printed value exceeds. ``why``: the
        reason; ``as_run``: its replacement for the authors' program.
    cell : PublishedCell
    as_run : bool
        True for the procedure of the authors' program.
    """
    for rule in rules:
        fields = rule.keys() & set(CellKey._fields)
        matches = all(re.fullmatch(rule[name], getattr(cell.key, name)) for name in fields)
        if matches and ("above" not in rule or cell.value > rule["above"]):
            return str(rule.get("as_run", rule["why"]) if as_run else rule["why"])
    return ""


def kind_of(key: CellKey) -> str:
    """Return the rule in ``RULES`` that applies to a cell."""
    if key.quantity.startswith("rmse_"):
        return key.point_role
    if key.quantity in {"sum_residual", "sum_squared_residual"}:
        return "residual" if key.stage == "bundle" else "misclosure"
    if key.quantity.startswith("normal_residual_abs_"):
        return "normal"
    return key.quantity if key.quantity in RULES else "count"


# --- runs on synthetic blocks ---------------------------------------------------------------------


def assess_runs(cell: PublishedCell, runs: Array | None, order: float | None = None) -> CellComparison:
    """Compare a published number with the runs on synthetic blocks.

    Parameters
    ----------
    cell : PublishedCell
    runs : (n,) array or None
        Values of the cell, nan if a solver broke down; None if nothing computes the cell.
    order : float, optional
        Order of the matrix, for ranks.
    """
    if runs is None:
        fact = "a fact about the real data or a convention: nothing to compute"
        return _without_number(cell) or CellComparison("not_reproducible", fact)
    finite = np.sort(runs[np.isfinite(runs)])
    # the median is the value of one run, not a mean of two, so that counts and ranks stay whole numbers
    median = float(finite[(len(finite) - 1) // 2]) if 2 * len(finite) > len(runs) else math.nan
    low, high = (float(finite[0]), float(finite[-1])) if len(finite) else (math.nan, math.nan)
    return replace(_without_number(cell) or _tested(cell, runs, median, order), reproduced=median, low=low, high=high)


def _without_number(cell: PublishedCell) -> CellComparison | None:
    """Return the comparison for a cell without a number; None for other cells."""
    if cell.text:
        return None
    has_words = any(character.isalnum() for character in cell.printed)  # this is False for a dash
    return CellComparison("not_reproducible", "a statement in words" if has_words else "nothing is printed")


def _tested(cell: PublishedCell, runs: Array, median: float, order: float | None) -> CellComparison:
    """Try the tests of the rule in order."""
    rule = RULES[kind_of(cell.key)]
    for name in rule.tests:
        if reason := _reason(name, cell, rule, runs, median, order):
            return CellComparison(name, reason)
    # one of the two values is missing because its solver broke down
    if not math.isfinite(cell.value) or not math.isfinite(median):
        broken = "" if math.isfinite(median) else f" (no result in most of {len(runs)} runs)"
        return CellComparison("not_reproducible", rule.without_value + broken)
    ratio = abs(median / cell.value) if cell.value else 0.0
    if ratio == 0.0:
        words = f"published {cell.value:g}, reproduced {median:.3g}"
    elif 0.1 <= ratio <= 10:
        words = f"published {cell.value:g}, reproduced {median:.6g}"
    else:
        words = f"reproduced is {ratio:.2g} times the published size"
    return CellComparison("differs", f"{words} ({rule.what})")


def _reason(test: Test, cell: PublishedCell, rule: Rule, runs: Array, median: float, order: float | None) -> str:
    """Return the reason if a test of the module docstring holds; otherwise ""."""
    n, value, sizes = len(runs), cell.value, np.abs(runs[np.isfinite(runs)])
    if test == "side":  # ranks are on the same side if both are deficient or both are full
        is_rank = math.isnan(rule.limit)
        if (is_rank and order is None) or (math.isnan(value) and not rule.nan_above):
            return ""
        limit = float(order or 0.0) - 0.5 if is_rank else rule.limit
        above = not abs(value) <= limit
        n_above = n - int((sizes <= limit).sum())
        same = n_above if above else n - n_above
        if 2 * same <= n:
            return ""
        if is_rank:
            return f"both {'of full rank' if above else 'rank deficient'} ({same} of {n} runs)"
        return f"both {'above' if above else 'below'} {rule.limit:g}{rule.unit} ({same} of {n} runs)"
    if not math.isfinite(value):
        return ""
    if test == "equal":  # a whole number (counts, 0 after an underflow, 1 at the limit of kappa) must be exact
        half = 0.0 if cell.text.lstrip("+-").isdigit() else 0.5 * last_digit(cell.text)
        slack = 1e-12 * abs(value)  # tolerance for the rounding of a double to its decimal print
        return f"all {n} runs" if len(sizes) == n and (np.abs(runs - value) <= half + slack).all() else ""
    if test == "rounding":  # only an exact zero agrees with a printed zero
        half = 0.5 * last_digit(cell.text) * (1.0 + 1e-9) if value else 0.0
        return "the median rounds to the printed digits" if abs(median - value) <= half else ""
    if test == "order":
        ratio = abs(median / value) if value else 0.0
        return f"reproduced / published = {ratio:.2g}" if 1.0 / ORDER <= ratio <= ORDER else ""
    factor, failed = 10.0 if rule.decade else 1.0, n - len(sizes)
    if not len(sizes) or not sizes.min() / factor <= abs(value) <= sizes.max() * factor:
        return ""
    of = f"{n} runs, {failed} of them without a result" if failed else f"{n} runs"
    return f"inside {sizes.min():.2g} to {sizes.max():.2g} of {of}{' (a decade added)' if rule.decade else ''}"


# --- values recomputed from other printed numbers -------------------------------------------------


@dataclass(frozen=True)
class Recomputed:
    """Number that follows from other printed numbers, a law or a simulation.

    Parameters
    ----------
    value : float
        Recomputed value; nan if only a verdict is known.
    remark : str
        Addition to the origin of the number that ``sources.toml`` declares.
    low, high : float
        Expected spread of the published number; nan if equal digits are expected.
    is_exact : bool
        True for arithmetic on printed numbers: a difference of one unit of the last digit is then an error.
    is_order : bool
        True if only the order of magnitude is expected to agree.
    kind : {"differs", "not_reproducible"}, optional
        Verdict, if it does not follow from these numbers.
    facts : tuple
        Values for the placeholders of the declared sentence.
    """

    value: float
    remark: str = ""
    low: float = math.nan
    high: float = math.nan
    is_exact: bool = False
    is_order: bool = False
    kind: Kind | None = None
    facts: tuple[object, ...] = ()

    @classmethod
    def around(cls, value: float, half: float, remark: str = "", facts: tuple[object, ...] = ()) -> Recomputed:
        """Return the number with a symmetric spread."""
        return cls(float(value), remark, float(value - half), float(value + half), facts=facts)


Values = Mapping[CellKey, float]
Cells = dict[CellKey, Recomputed]


def row_key(table: str, row: str, quantity: str) -> CellKey:
    """Return the address of a number in a table of rows and quantities."""
    return CellKey(table, quantity=quantity, parameter=row)


def attempt(call: Callable[..., float], *printed: float) -> float:
    """Call a function with printed numbers; return nan if it refuses them, because a copy may contain any number."""
    try:
        return call(*printed)
    except InputError:
        return math.nan


def assess_value(
    cell: PublishedCell, other: Recomputed | None, unknown: str, origin: str = "", within: Kind = "spread"
) -> CellComparison:
    """Compare a printed number with a recomputed one; see the module docstring.

    Parameters
    ----------
    cell : PublishedCell
    other : Recomputed or None
    unknown : str
        Reason why there is no recomputed value.
    origin : str
        Sentence on the recomputed value, with placeholders for its facts.
    within : {"spread", "sigma", "fitted"}
        Verdict inside the stated spread; it depends on the nature of the spread.
    """
    if without := _without_number(cell):
        return without
    if other is None:
        return CellComparison("not_reproducible", unknown)
    kind, words = (other.kind, "") if other.kind is not None else _value_kind(cell, other, within)
    reason = ": ".join(filter(None, (words, origin.format(*other.facts) + other.remark)))
    return CellComparison(kind, reason, other.value, other.low, other.high)


def _value_kind(cell: PublishedCell, other: Recomputed, within: Kind) -> tuple[Kind, str]:
    """Compare the sizes; or with the spread, extended by the print's rounding; or with the printed digits."""
    unit = last_digit(cell.text)
    if other.is_order:
        if cell.value == 0.0:
            return "differs", f"published 0, reproduced {other.value:.2g}"
        ratio = other.value / cell.value
        return ("order" if 1.0 / ORDER <= ratio <= ORDER else "differs"), f"reproduced / published = {ratio:.2g}"
    if not math.isnan(other.low):
        inside = other.low - 0.5 * unit <= cell.value <= other.high + 0.5 * unit
        if within != "fitted" and agreement(other.value - cell.value, cell.value, unit) == "equal":
            return "rounding", MEANING["equal"]
        return (within, "inside the spread") if inside else ("differs", "outside the spread")
    kind = agreement(other.value - cell.value, cell.value, unit)
    if kind == "equal":
        return kind, MEANING[kind]
    if kind == "rounding" and not other.is_exact:
        return "unit", MEANING[kind]
    return "differs", f"published {cell.text}, reproduced {other.value:.7g}"
