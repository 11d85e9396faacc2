"""What is known about a published number from elsewhere: a value, perhaps with a spread, and a sentence."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from fg_orient.errors import InputError
from fg_orient.reproduce.verdict import Kind


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


def attempt(call: Callable[..., float], *printed: float) -> float:
    """Call with printed numbers; nan where the call refuses them, as a copy may hold any."""
    try:
        return call(*printed)
    except InputError:
        return math.nan
