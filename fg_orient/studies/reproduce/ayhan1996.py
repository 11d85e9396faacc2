"""Ayhan (1996): surfaces of revolution by close-range photogrammetry, from its own printed measurements.

Verdicts as in ``found``. Here raw data are printed: comparator coordinates of 15 points, refined ones of 49,
geodetic coordinates. What follows from them is recomputed; where the thesis' program computed in single precision, or
with other parameters, the spread that this explains is stated beside the number.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.model.cells import CellKey
from fg_orient.model.errors import FgOrientError
from fg_orient.studies.published.tables import PublishedTables
from fg_orient.studies.reproduce import ayhan1996_bundle, ayhan1996_photos, ayhan1996_surfaces
from fg_orient.studies.reproduce.found import Found, judged_by_tables
from fg_orient.studies.reproduce.sources import Source
from fg_orient.studies.reproduce.verdict import Verdict

Values = Mapping[CellKey, float]

TABLES: Final = (
    "1", "2", "3", "4", "ek1.comparator", "ek1.cameras", "ek1.bundle", "ek1.refined", "ek1.points", "ek2.dlt",
    "ek2.control", "ek2.points", *map(str, range(5, 21)), "ek3.surfaces", "ek3.points", "text",
)  # fmt: skip
MEASURED: Final = "a measurement or a setting: nothing to compute"
#: Why cells of a table that nothing computes cannot be reproduced.
REASONS: Final = {
    "ek1.bundle": "an observed value, or a number that depends on weights and steps that are not printed",
    "ek1.refined": "taken as printed: comparator coordinates of this point are not in the thesis",
    "ek1.points": "taken as printed: geodetic, or adjusted in the bundle as a control point",
    "ek2.dlt": "standard deviations and lens terms of 16 parameters that were held by weights not printed",
    "ek2.control": "taken as printed, or a precision by weights that are not printed",
    "ek3.surfaces": "the six points of case I are not printed",
    **{str(k): "image coordinates of this application are not printed" for k in range(6, 13)},
    "5": "which 8, 6 or 3 points were control is not printed: many choices fit, none can be told from the others",
    **{str(k): "the points of the case are not printed (a lost figure)" for k in range(13, 21)},
}
_COMPUTERS: Final[tuple[Mapping[str, Callable[[Values], dict[CellKey, Found]]], ...]] = (
    ayhan1996_surfaces.COMPUTERS, ayhan1996_photos.COMPUTERS, ayhan1996_bundle.COMPUTERS,
)  # fmt: skip


def verdicts(
    printed: PublishedTables, tables: Collection[str], data: Path | None = None, *, permutations: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[CellKey, Verdict]:  # fmt: skip
    """Judge the cells of some tables; see ``found.judged_by_tables``. ``data``, ``permutations``: of other sources."""
    values: Values = {cell.key: float(cell.value) for cell in printed.cells}
    return judged_by_tables(printed, tables, lambda table: _computed(values, table), progress)


def _computed(values: Values, table: str) -> tuple[dict[CellKey, Found], str]:
    """Found numbers of a table; a copy may hold numbers that have no solution: then why."""
    out: dict[CellKey, Found] = {}
    try:
        for computers in _COMPUTERS:
            if table in computers:
                out |= computers[table](values)
    except (FgOrientError, np.linalg.LinAlgError) as error:
        return {}, f"the numbers have no solution: {error}"
    return out, REASONS.get(table, MEASURED)


SOURCE: Final = Source(
    "ayhan1996",
    "Ayhan (1996), surfaces of revolution by close-range photogrammetry",
    None,
    (),
    lambda *_: "",
    verdicts,
    TABLES,
    "Recomputed in double precision from the measurements that the thesis prints: comparator and refined image "
    "coordinates, cameras, geodetic points. Single precision of its program, or a model with other parameters, is "
    "stated as a spread beside the number. Control points and image coordinates of most applications are not printed. "
    "The range is the stated spread, if any.",
    {
        "equal": "all printed digits",
        "rounding": "one unit of the last digit, or inside the stated spread",
        "pattern": "the bundle: inside a printed mean error, or 5 % of it, under weights inferred from the listing",
        "not_reproducible": "a measurement, or its measurements are not printed",
    },
    "are one unit of the last digit off or inside a stated spread",
    "agree with the bundle under weights inferred from the listing itself",
)
