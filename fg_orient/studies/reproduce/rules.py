"""Which verdicts a published number can get, quantity by quantity: the one table (docs/reproduce.md).

``tests`` are tried in order and the first that holds is the verdict; if none holds it is ``differs``:

- ``equal``: every run gives all printed digits.
- ``order``: published and reproduced (median of the runs) have a ratio of 0.1 to 10, signs aside.
- ``rounding``: the published size lies between the smallest and the largest run, a decade added on
  both sides (not for ranks).
- ``pattern``: published and more than half of the runs lie on the same side of ``limit``; a solver that
  breaks down and a printed NaN lie above it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from fg_orient.model.cells import CellKey

Test = Literal["equal", "order", "rounding", "pattern"]
#: The target at control points, 1 pixel (T sect. 4.2.1).
TARGET_M: Final = 5.0
#: Three times the accuracy at check points (P, conclusions): beyond it they have diverged.
ICP_LIMIT_M: Final = 15.0


@dataclass(frozen=True)
class Rule:
    """Tests of a kind of quantity.

    Parameters
    ----------
    tests : tuple of str
        In order, see the module docstring.
    what : str
        What the number is, for the reason.
    limit : float
        Of the test ``pattern``; nan for ranks: the order of the matrix.
    unit : str
        Of the limit.
    without_value : str
        Why a printed NaN without counterpart cannot be judged.
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
_BY_QUANTITY: Final = {
    "dP": "dP", "kappa": "kappa", "rank": "rank", "det": "det", "cond_norm": "cond_norm",
    "cond_spectral": "cond_spectral", "cond_hadamard": "cond_hadamard", "correlation": "correlation",
    "normal_residual_abs_min": "normal", "normal_residual_abs_max": "normal",
}  # fmt: skip


def kind_of(key: CellKey) -> str:
    """Row of the table for a cell."""
    if key.quantity.startswith("rmse_"):
        return key.point_role
    if key.quantity in {"sum_residual", "sum_squared_residual"}:
        return "residual" if key.stage == "bundle" else "misclosure"
    return _BY_QUANTITY.get(key.quantity, "count")
