"""İpbüker (1994): arithmetic of its tables, simulations of its precisions, orbit and sensor figures.

Control points, residuals, coefficients and outlines are not in the thesis. What can be recomputed: numbers that follow
from others beside them, laws and spreads that need no data, physics. The verdicts: ``found``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from fg_orient.model.cells import CellKey
from fg_orient.studies.published.tables import PublishedTables
from fg_orient.studies.reproduce import ipbuker1994_islands, ipbuker1994_orbits, ipbuker1994_points
from fg_orient.studies.reproduce.found import Found, judged_by_tables
from fg_orient.studies.reproduce.sources import Source
from fg_orient.studies.reproduce.verdict import Verdict

Values = Mapping[CellKey, float]
TABLES: Final = ("3.1", "3.2", "3.3", "3.5", "text", "s4.2.2", "5.1", "s6.2", "6.1", "7.1", "s7.2", "7.2", "7.3", "7.4",
                 "7.5", "7.6", "summary")  # fmt: skip
#: Why cells of a table that nothing computes cannot be reproduced.
REASONS: Final = {
    "s4.2.2": "processor times of another computer and program",
    "s6.2": "a figure of another publication; its points are not here",
    "6.1": "another block, with four values or one: too few to fit a law to and to test it",
    "7.1": "control points, residuals and coefficients are not in the source",
    "s7.2": "a fact of the unpublished points; a coefficient with four decimals leaves 226 m",
    "7.2": "the vertices of the outlines are not in the source",
    "7.3": "the vertices of the outlines are not in the source",
    "7.4": "the vertices of the outlines are not in the source",
    "7.5": "the image and its classes are not in the source",
}
FACT: Final = "a fact or a constant: nothing to compute"
#: Tables and who computes them, from all printed values.
_COMPUTERS: Final[dict[str, Callable[[Values], dict[CellKey, Found]]]] = {
    **ipbuker1994_orbits.COMPUTERS, **ipbuker1994_points.COMPUTERS, **ipbuker1994_islands.COMPUTERS,
}  # fmt: skip


def verdicts(
    printed: PublishedTables, tables: Collection[str], data: Path | None = None, *, permutations: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[CellKey, Verdict]:  # fmt: skip
    """Judge the cells of some tables; see ``found.judged_by_tables``. ``data``, ``permutations``: of other sources."""
    values: Values = {cell.key: np.float64(cell.value) for cell in printed.cells}

    def computed(table: str) -> tuple[dict[CellKey, Found], str]:
        compute = _COMPUTERS.get(table)
        return ({} if compute is None else compute(values)), REASONS.get(table, FACT)

    return judged_by_tables(printed, tables, computed, progress)


SOURCE: Final = Source(
    "ipbuker1994",
    "İpbüker (1994), geometric accuracy of images at map scale from satellite data",
    None,
    (),
    lambda *_: "",
    verdicts,
    TABLES,
    "The thesis prints no control points, residuals, coefficients or outlines: its rectifications cannot be repeated. "
    "Recomputed are numbers that follow from others beside them, figures of orbits, sensors and projections, and, by "
    "simulation, how precisions of one kind depend on those of another. The range is the stated spread, if any.",
    {
        "equal": "all printed digits",
        "rounding": "one unit of the last digit, or inside the stated spread",
        "not_reproducible": "a fact, or its points, outlines or images are not in the source",
    },
    "are one unit of the last digit off or inside a stated spread",
)
