"""Mistakes in tables that a block cannot show, because its unknowns take them up, and what is assumed instead.

The non-centrality of a mistake is the decrease of the weighted sum of squares that its true size would give without
noise (``M`` of ``fg_orient.quality.causes``). Below the limit a test at a level of 0.1 % finds it in fewer than 20 %
of cases.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from fg_orient.adjustment.memory import EXACT_RAYS
from fg_orient.model.names import Role
from fg_orient.quality.accuracy import PointDifferences
from fg_orient.quality.ground_causes import GroundErrors
from fg_orient.quality.image_causes import ImageErrors
from fg_orient.quality.reliability import noncentrality
from fg_orient.quality.residuals import ResidualCofactors

#: Level and power of the test, sizes of the mistakes, most measured points.
LEVEL: Final = 0.001
POWER: Final = 0.2
ORIGINS_PX: Final = (0.5, 1.0)
HEIGHT_M: Final = 30.0
SHIFT_M: Final = 0.5
MOST: Final = 100


@dataclass(frozen=True)
class UnseenMistake:
    """A mistake that nothing shows.

    Parameters
    ----------
    mistake, assumption : str
    noncentrality : float
    limit : float
        Non-centrality below which it cannot be seen.
    """

    mistake: str
    assumption: str
    noncentrality: float
    limit: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the record of a run."""
        return asdict(self)


def unseen_mistakes(known: ResidualCofactors, check: PointDifferences) -> tuple[UnseenMistake, ...]:
    """Mistakes that this block cannot show; nothing of blocks too large for their cofactors.

    Parameters
    ----------
    known : ResidualCofactors
        Of a solution without a loss.
    check : PointDifferences
        Of the check points.
    """
    problem = known.problem
    small = len(problem.observations) <= EXACT_RAYS and int(problem.observed.sum()) + len(check) <= MOST
    errors = ImageErrors.of(known) if small and problem.block.options.datum != "inner" else None
    system = None if errors is None else GroundErrors.of(problem, known.state, known.cofactors, check)
    if errors is None or system is None:
        return ()
    every = tuple(range(problem.n_images))
    pixels = np.stack([errors.shifted(every, shift) for shift in ORIGINS_PX], axis=1)
    found = [
        (f"an origin of lines and samples that differs by {shift:g} px", "(0, 0) is the centre of the first pixel", m)
        for shift, m in zip(ORIGINS_PX, np.diag(system.image_normal(errors, pixels)[1]).tolist(), strict=True)
    ]
    axes = np.swapaxes(problem.axes(system.given_m), 1, 2)
    of = "control and check points" if Role.CHECK in problem.block.points.roles else "control points"
    east, north, up = np.diag(system.normal(axes)[1]).tolist()
    found.append((f"an offset of {HEIGHT_M:g} m of the heights of all {of}", "their heights have the vertical datum "
                  "that the table states, else they are ellipsoidal", HEIGHT_M**2 * up))  # fmt: skip
    found.append((f"a shift of {SHIFT_M:g} m of all {of}, as between epochs of ITRF", "they have the reference frame "
                  "of the metadata", SHIFT_M**2 * min(east, north)))  # fmt: skip
    limit = noncentrality(LEVEL, POWER, 1)
    return tuple(UnseenMistake(*one, limit) for one in found if one[2] < limit)
