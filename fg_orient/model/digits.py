"""Numbers as texts: reading, and comparison with printed numbers by digits."""

from __future__ import annotations

import math
import re
from typing import Final, Literal

Agreement = Literal["equal", "rounding", "sigma", "differs"]
#: Meaning of each kind of agreement.
MEANING: Final[dict[Agreement, str]] = {
    "equal": "all printed digits", "rounding": "one unit of the last digit", "sigma": "within one standard deviation",
    "differs": "differs by more than one standard deviation",
}  # fmt: skip
#: Pattern of texts that are read as numbers.
NUMBER: Final = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
#: Largest relative difference between a double and its decimal print.
SLACK: Final = 1e-9


def decimal(text: str) -> float:
    """Return the finite number that a text of ASCII digits states; raise ValueError for any other text.

    Unlike ``float``, digits of other scripts, ``1_000``, ``inf``, ``nan`` and numbers that overflow are refused.
    """
    value = float(text) if NUMBER.fullmatch(text) else math.nan
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def last_digit(text: str, significant: int | None = None) -> float:
    """Return the size of one unit of the last printed digit: 0.001 for "0.510", 1e-12 for "-8.5e-11".

    ``significant``: number of significant digits, for a number printed without its final zeros; it does not apply to 0.
    """
    mantissa, _, exponent = text.lower().partition("e")
    if significant is not None and float(text):
        return 10.0 ** (math.floor(math.log10(abs(float(text)))) + 1 - significant)
    decimals = len(mantissa.partition(".")[2])
    return float(10.0 ** (int(exponent or 0) - decimals))


def agreement(off: float, printed: float, unit: float, sigma: float = math.nan) -> Agreement:
    """Return the name of the closest agreement between a number and a printed number; "differs" also if ``off`` is nan.

    Parameters
    ----------
    off : float
        Difference between the number and the printed one.
    printed : float
    unit : float
        One unit of the last printed digit.
    sigma : float
        Standard deviation; nan if unknown.
    """
    slack = SLACK * abs(printed)
    limits: dict[Agreement, float] = {"equal": 0.5 * unit + slack, "rounding": unit + slack, "sigma": sigma}
    return next((kind for kind, limit in limits.items() if abs(off) <= limit), "differs")
