"""Shared names: roles, statuses, components of the exterior orientation, and EOP sets."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Final, Literal, NamedTuple

#: Coordinates larger than this (m, mm or pixels) have a resolution worse than 1e-4 in double precision.
LARGEST: Final = 1e12
#: No measurement has a standard deviation or focal length below this, in any unit.
SMALLEST: Final = 1e-12
#: Range of the coordinate of the first pixel's centre: 0, 0.5 or 1 in known programs, and -1 for the opposite shift.
FIRST_PIXELS: Final = (-1.0, 1.0)
#: Largest height of a zero level above or below the ellipsoid, m. Geoids have at most 120 m; local levels can be
#: thousands of metres apart.
MAX_UNDULATION_M: Final = 10_000.0
#: Forms (file extensions) of the tables of a result or a simulated block, and the default form.
TableForm = Literal["csv", "parquet", "arrow"]
TABLE_FORM: Final = "csv"
#: Callback of long work: steps done, total number of steps, name of the current step.
Progress = Callable[[int, int, str], None]


class Role(StrEnum):
    """Role of a ground point in the adjustment."""

    CONTROL = "control"
    CHECK = "check"
    TIE = "tie"


class Status(StrEnum):
    """Way in which an adjustment ended."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not_converged"
    RANK_DEFICIENT = "rank_deficient"
    NOT_TRUSTWORTHY = "not_trustworthy"


EXIT_CODE: dict[Status, int] = {
    Status.CONVERGED: 0,
    Status.NOT_CONVERGED: 3,
    Status.RANK_DEFICIENT: 3,
    Status.NOT_TRUSTWORTHY: 4,
}

COMPONENTS: Final = ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw")
POSITION, VELOCITY, ATTITUDE = (0, 1, 2), (3, 4, 5), (6, 7, 8)


class EopSet(NamedTuple):
    """Set of EOP: its name, positions in ``COMPONENTS``, and degrees in time of each component."""

    name: str
    components: tuple[int, ...]
    degrees: tuple[int, ...]


#: EOP sets by number; add a row for a further set. 1 to 20: Terlemezoğlu 2019, Table 4.2
#: (1 to 19: Topan & Maktav 2010, Table 2). PU: position, V: velocity, A: attitude.
EOP_SETS: Final = dict(enumerate((
    EopSet("PU", POSITION, (0, 1, 2)),
    EopSet("PU0", POSITION, (0,)),
    EopSet("PU1", POSITION, (1,)),
    EopSet("PU2", POSITION, (2,)),
    EopSet("V", VELOCITY, (0, 1, 2)),
    EopSet("V0", VELOCITY, (0,)),
    EopSet("V1", VELOCITY, (1,)),
    EopSet("V2", VELOCITY, (2,)),
    EopSet("A", ATTITUDE, (0, 1, 2)),
    EopSet("A0", ATTITUDE, (0,)),
    EopSet("A1", ATTITUDE, (1,)),
    EopSet("A2", ATTITUDE, (2,)),
    EopSet("PUV", POSITION + VELOCITY, (0, 1, 2)),
    EopSet("PUV0", POSITION + VELOCITY, (0,)),
    EopSet("PUA", POSITION + ATTITUDE, (0, 1, 2)),
    EopSet("PUA0", POSITION + ATTITUDE, (0,)),
    EopSet("VA", VELOCITY + ATTITUDE, (0, 1, 2)),
    EopSet("VA0", VELOCITY + ATTITUDE, (0,)),
    EopSet("PUVA0", POSITION + VELOCITY + ATTITUDE, (0,)),
    EopSet("PUVA", POSITION + VELOCITY + ATTITUDE, (0, 1, 2)),
), start=1))  # fmt: skip
#: Range of the numbers of all EOP sets, as text.
ALL_SETS: Final = f"1-{len(EOP_SETS)}"
#: Default limit for the predicted processor time, s, of an adjustment in a comparison.
TIME_LIMIT_S: Final = 60.0


class CellKey(NamedTuple):
    """Where a number is printed in the published tables; fields that do not apply are empty.

    The values occur in the tables under ``fg_orient/studies/published``: for instance
    ``CellKey("4.28", "5", "bundle", "1", "gcp", "rmse_x", "pivot_inverse")``.
    """

    table: str
    eop_set: str = ""
    stage: str = ""
    pre_adjustment_type: str = ""
    point_role: str = ""
    quantity: str = ""
    method: str = ""
    parameter: str = ""
    point_set: str = ""

    def __str__(self) -> str:
        words = (
            self.point_set,
            self.eop_set and f"set {self.eop_set}",
            self.stage,
            self.pre_adjustment_type and f"type {self.pre_adjustment_type}",
            self.point_role,
            self.quantity,
            self.parameter,
            self.method,
        )
        return ", ".join(filter(None, words))
