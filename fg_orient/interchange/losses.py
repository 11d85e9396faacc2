"""What a format cannot hold, counted before it is written: one line for each kind of information."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from fg_orient.errors import Problem, problem
from fg_orient.interchange.registry import Format, Holds
from fg_orient.interchange.survey import Survey
from fg_orient.names import Role


def losses(survey: Survey, format_: Format, file: str) -> tuple[Problem, ...]:
    """List what the survey holds and the format does not.

    Parameters
    ----------
    survey : Survey
        To be written.
    format_ : Format
        To write it in.
    file : str
        For messages.
    """
    found = []
    for what, (code, count) in _COUNTED.items():
        n = 0 if what in format_.holds else count(survey)
        if n:
            found.append(problem(code, file=file, value=f"{n} points" if n > 1 else "1 point", format=format_.name))
    if Holds.CRS not in format_.holds and not format_.crs and survey.crs:
        found.append(problem("lost.crs", file=file, value=survey.crs, format=format_.name))
    return tuple(found)


def _weighted(survey: Survey) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray(np.isfinite(survey.sigma_enu_m).all(axis=1))


def _unequal(survey: Survey, first: int, second: int) -> int:
    rows = survey.sigma_enu_m[_weighted(survey)]
    return int((rows[:, first] != rows[:, second]).sum())


#: Message and count of each kind of information.
_COUNTED: Final[dict[Holds, tuple[str, Callable[[Survey], int]]]] = {
    Holds.GROUND: ("lost.ground", lambda s: int(s.located.sum())),
    Holds.IMAGE: ("lost.image", lambda s: len(s.observed)),
    Holds.TIES: ("lost.ties", lambda s: int((~s.located).sum())),
    Holds.ROLES: ("lost.roles", lambda s: int((s.of_role(Role.CHECK) & s.located).sum())),
    Holds.HEIGHTS: ("lost.heights", lambda s: int((s.located & np.isfinite(s.coordinates[:, 2])).sum())),
    Holds.SIGMA_GROUND: ("lost.sigma_ground", lambda s: int(_weighted(s).sum())),
    Holds.SIGMA_EAST_NORTH: ("lost.sigma_east_north", lambda s: _unequal(s, 0, 1)),
    Holds.SIGMA_UP: ("lost.sigma_up", lambda s: _unequal(s, 0, 2)),
    Holds.SIGMA_IMAGE: ("lost.sigma_image", lambda s: int(np.isfinite(s.observed.sigma_line_px).sum())),
    Holds.FIXED: ("lost.fixed", lambda s: int(s.fixed.sum())),
}
