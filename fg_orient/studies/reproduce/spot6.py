"""Tables 4.35-4.55 of Terlemezoğlu (2019) with the real control points: data, verdicts, reasons.

Unlike the synthetic blocks of other tables, these are the authors' own points: a number
either agrees with the printed digits or is rounding noise. The verdicts (docs/rfm.md):

- ``equal``: the points in the order of their file give all printed digits, and each permutation gives a value within
  one unit of the last digit.
- ``spread``: the interval of the published size, given by its printed digits, overlaps min/30 to 30 max of the
  permutations. If the method itself loses digits (degree 3, inverses formed from N): in
  the order of the file, [vv] agrees within 0.2 px^2.
- ``differs``: none of these holds. ``not_reproducible``: there are no points, or there is nothing to compare with.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.model.digits import last_digit
from fg_orient.model.names import CellKey
from fg_orient.rpc.points import SPOT6_FILE, SPOT6_FOLDER, ControlPoints, find_spot6, read_gcp
from fg_orient.studies import tables_spot6
from fg_orient.studies.published.tables import PublishedCell, PublishedTables
from fg_orient.studies.reproduce.verdict import CellComparison, Judges, Kind, declared, known_reason

#: Environment variable for the folder of real data, used if ``--data`` is not given.
VARIABLE: Final = "FG_ORIENT_REAL_DATA"
#: These whole numbers must agree exactly, like a printed zero. For other quantities, "13" means 13 +- 0.5.
COUNTED: Final = ("n_observations", "n_unknowns", "matrix_order", "rank")
#: For rounding noise, the range of the permutations is extended by this factor.
MARGIN: Final = 30.0
#: A number is not noise if the relative spread of the permutations is below this.
STEADY: Final = 0.01
#: Inverses formed from the normalised N of degree 3 (condition 4e12) lose digits of [vv].
#: The result is 0 to 0.7 px^2 above its minimum 2.94, for all methods and orders of the
#: points (printed: 2.9 to 3.1).
INVERSES: Final = ("pivot_inverse", "cholesky_inverse", "gauss_inverse", "moore_penrose_inverse")
VV_TOLERANCE_PX2: Final = 0.2
#: Effect of the tolerance of 0.2 px^2 on m0, plus the rounding error of the printed m0.
M0_TOLERANCE_PX: Final = 0.0044 + 0.005
NO_POINTS: Final = f"the 99 control points are not here: give them as data, or a folder of real data in {VARIABLE}"


def control_points(data: Path | None) -> ControlPoints | None:
    """Read the points from a file or folder, by default from ``$FG_ORIENT_REAL_DATA``.

    Returns
    -------
    ControlPoints or None
        Points; None if nothing is given and the environment names no folder with the points.

    Raises
    ------
    InputError
        The given file or folder is missing or damaged.
    """
    if data is not None:
        return read_gcp(find_spot6(data))
    name = os.environ.get(VARIABLE, "")
    path = Path(name) / SPOT6_FOLDER / SPOT6_FILE
    return read_gcp(path) if name and path.is_file() else None


def compare(
    printed: PublishedTables,
    tables: Collection[str],
    data: Path | None,
    *,
    permutations: int = tables_spot6.PERMUTATIONS,
    progress: Callable[[int, int], None] | None = None,
) -> Judges:
    """Compare the cells of some tables; tables of other scenes are ignored.

    Parameters
    ----------
    printed : PublishedTables
    tables : collection of str
    data : Path, optional
        Folder or file of points; see :func:`control_points`.
    permutations : int
        Number of orders of the points, in addition to the order of the file.
    progress : callable, optional
        Function called with runs done and number of runs.
    """
    cells = [cell for cell in printed.cells if cell.key.table in tables and cell.key.table in tables_spot6.TABLES]
    if not cells:
        return {}
    points = control_points(data)
    if points is None:
        return {cell.key: lambda _: CellComparison("not_reproducible", NO_POINTS) for cell in cells}
    chosen = {cell.key.table for cell in cells}
    computed = tables_spot6.compute(
        chosen, points, permutations=permutations, kappas=printed_kappas(printed), progress=progress
    )
    return {cell.key: partial(assess, computed=computed) for cell in cells}


def printed_kappas(printed: PublishedTables) -> dict[tuple[str, int], float]:
    """Return the kappas of Table 4.45 by method and degree."""
    cells = (cell for cell in printed.cells if cell.key.table == "4.45" and cell.key.quantity == "kappa")
    return {(cell.key.method, int(cell.key.stage[-1])): cell.value for cell in cells}


def assess(cell: PublishedCell, computed: Mapping[CellKey, Array]) -> CellComparison:
    """Compare a printed number with the file's order and the permutations; see the module docstring.

    Parameters
    ----------
    cell : PublishedCell
    computed : mapping
        Result of :func:`fg_orient.studies.tables_spot6.compute`.
    """
    runs = computed[cell.key]
    sizes = _sizes(runs)
    low, high = (float(sizes.min()), float(sizes.max())) if len(sizes) else (math.nan, math.nan)
    kind, reason = _tested(cell, runs, sizes)
    more = _more(cell, computed)
    return CellComparison(kind, f"{reason}; {more}" if more else reason, float(runs[0]), low, high)


def _sizes(runs: Array) -> Array:
    """Return the finite sizes of the permutations."""
    return np.abs(runs[1:][np.isfinite(runs[1:])])


def _quantiles(sizes: Array) -> str:
    return ", ".join(f"{q:.2g}" for q in np.quantile(sizes, (0.05, 0.5, 0.95)))


def _tested(cell: PublishedCell, runs: Array, sizes: Array) -> tuple[Kind, str]:
    """Return the kind of verdict and its reason."""
    if reason := _equal(cell, runs):
        return "equal", reason
    tolerance = _tolerance(cell.key)
    if tolerance is not None and abs(runs[0] - cell.value) <= tolerance:
        return "spread", f"{runs[0]:.4g} in the order of the file, within {tolerance:g}: the inverse loses digits"
    if hadamard := _hadamard(cell, runs):
        return "not_reproducible", hadamard
    if math.isnan(cell.value):
        return "not_reproducible", f"printed NaN; computed {runs[0]:.2g}"
    overflows = int(np.isinf(runs[1:]).sum())
    if math.isinf(cell.value) and overflows:
        return "spread", f"beyond the largest number, as printed, in {overflows} of {len(runs) - 1} permutations"
    if not len(sizes):
        return "not_reproducible", f"no result in any of {len(runs) - 1} permutations"
    span = f"{sizes.min():.2g} to {sizes.max():.2g} in {len(sizes)} of {len(runs) - 1} permutations"
    noise = f"{span}, 5/50/95 %: {_quantiles(sizes)}"
    half = 0.0 if cell.text == "0" else 0.5 * last_digit(cell.text)
    least, most = max(0.0, abs(cell.value) - half), abs(cell.value) + half
    if most >= sizes.min() / MARGIN and least <= sizes.max() * MARGIN:
        spread, gap = float(sizes.max() - sizes.min()), max(sizes.min() - most, least - sizes.max())
        if gap > spread and spread < STEADY * sizes.max():
            return "spread", f"within the limits, but steady here and not as printed: {noise}"
        return "spread", f"rounding noise: {noise}"
    return "differs", f"{known_reason(declared('rules.toml')['spot6'], cell)} ({noise})"


def _equal(cell: PublishedCell, runs: Array) -> str:
    """Return the reason why a number counts as equal; "" if it does not."""
    if math.isinf(cell.value):
        return "overflows like the printed one" if np.isinf(runs).all() and runs[0] == cell.value else ""
    if not math.isfinite(cell.value) or not math.isfinite(runs[0]):
        return ""
    off = np.abs(runs - cell.value)
    exact = cell.key.quantity in COUNTED or (cell.value == 0.0 and cell.key.quantity != "rpc")
    unit = 0.0 if exact else last_digit(cell.text)
    slack = 1e-9 * abs(cell.value)  # tolerance for the rounding of a double to its decimal print
    stays = np.isfinite(runs).all() and float(off.max()) <= 1.5 * unit + slack
    return "all printed digits" if off[0] <= 0.5 * unit + slack and stays else ""


def _tolerance(key: CellKey) -> float | None:
    """Return the tolerance of cells whose method loses digits."""
    if key.method not in INVERSES or key.stage != tables_spot6.stage(3):
        return None
    if key.table == "4.55" and key.quantity == "m0":
        return M0_TOLERANCE_PX
    return VV_TOLERANCE_PX2 if key.table in tables_spot6.NORMALISED and key.quantity == "sum_squared_residual" else None


def _hadamard(cell: PublishedCell, runs: Array) -> str:
    """Return the reason for Hadamard numbers that no matrix of these points gives; "" for other numbers."""
    if cell.key.quantity != "cond_hadamard":
        return ""
    if math.isnan(cell.value):
        return "printed NaN after an overflow (Inf/Inf); log-determinants give less than 1e-308"
    if cell.key.table != "4.53":
        return ""
    return (
        f"T(3.14) gives {runs[0]:.2g} on these points in any order, while determinant and rank agree: it is not known "
        "by which row norms the printed number was divided"
    )


def _more(cell: PublishedCell, computed: Mapping[CellKey, Array]) -> str:
    """Return the numbers that the source does not give: m0 of true image residuals.

    M0 with the printed kappa.
    """
    key = cell.key
    if key.quantity != "m0":
        return ""
    true = computed.get(key._replace(quantity=tables_spot6.TRUE_M0))
    if true is not None:
        return f"true image residuals of the same coefficients: m0 {true[0]:.3g} px"
    other = computed.get(key._replace(table=tables_spot6.WITH_PRINTED_KAPPA))
    if other is None:
        return ""
    sizes = _sizes(other)
    points = _quantiles(sizes) if len(sizes) else "none"
    return f"with the printed kappa {other[0]:.2g}, 5/50/95 %: {points}"
