"""What a format cannot hold, counted before it is written: one line for each kind of information."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from fg_orient.formats.exchange.registry import Format, Holds
from fg_orient.formats.exchange.survey import Survey
from fg_orient.model.errors import Finding, finding
from fg_orient.model.names import Role


def losses(survey: Survey, format_: Format, file: str) -> tuple[Finding, ...]:
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
        implied = _IMPLIED.get(what)
        if what is Holds.IDS and Holds.NUMBERS in format_.holds:
            count = _no_numbers
        n = 0 if what in format_.holds or (implied and implied not in format_.holds) else count(survey)
        if n:
            found.append(finding(code, file=file, value=f"{n} points" if n > 1 else "1 point", format=format_.name))
    if Holds.CRS not in format_.holds and Holds.GROUND in format_.holds and survey.crs:
        found.append(finding("lost.crs", file=file, value=survey.crs, format=format_.name))
    elif Holds.HEIGHTS in format_.holds and Holds.VERTICAL_CRS not in format_.holds and "+" in survey.crs:
        found.append(finding("lost.vertical_crs", file=file, value=survey.crs, format=format_.name))
    return tuple(found)


def _measured(survey: Survey) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray(np.bincount(survey.observed.point, minlength=len(survey.ids)) > 0)


def _numbered(survey: Survey) -> bool:
    """Tell whether numbering the image points in their order gives the ids that the points have."""
    _, first = np.unique(survey.observed.point, return_index=True)
    order = survey.observed.point[np.sort(first)]
    return [survey.ids[k] for k in order] == [str(k + 1) for k in range(len(survey.ids))]


def _no_numbers(survey: Survey) -> int:
    """Count the ids, unless all are whole numbers as they are printed."""
    return 0 if all(name.isdecimal() and name == str(int(name)) for name in survey.ids) else len(survey.ids)


def _weighted(survey: Survey) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray(np.isfinite(survey.sigma_enu_m).all(axis=1))


def _unequal(survey: Survey, first: int, second: int) -> int:
    rows = survey.sigma_enu_m[_weighted(survey)]
    return int((rows[:, first] != rows[:, second]).sum())


#: Losses that are none of their own if something greater is lost.
_IMPLIED: Final = {
    Holds.BARE_TIES: Holds.TIES, Holds.UNMEASURED: Holds.GROUND, Holds.ROLES: Holds.GROUND,
    Holds.HEIGHTS: Holds.GROUND, Holds.SIGMA_GROUND: Holds.GROUND, Holds.FIXED: Holds.GROUND,
    Holds.SIGMA_EAST_NORTH: Holds.SIGMA_GROUND, Holds.SIGMA_UP: Holds.SIGMA_GROUND, Holds.SIGMA_IMAGE: Holds.IMAGE,
}  # fmt: skip
#: Message and count of each kind of information.
_COUNTED: Final[dict[Holds, tuple[str, Callable[[Survey], int]]]] = {
    Holds.GROUND: ("lost.ground", lambda s: int(s.located.sum())),
    Holds.IMAGE: ("lost.image", lambda s: len(s.observed)),
    Holds.IDS: ("lost.ids", lambda s: 0 if _numbered(s) else len(s.ids)),
    Holds.UNMEASURED: ("lost.unmeasured", lambda s: int((s.located & ~_measured(s)).sum())),
    Holds.BARE_TIES: ("lost.bare_ties", lambda s: int((~s.located & ~_measured(s)).sum())),
    Holds.TIES: ("lost.ties", lambda s: int((~s.located).sum())),
    Holds.ROLES: ("lost.roles", lambda s: int((s.of_role(Role.CHECK) & s.located).sum())),
    Holds.HEIGHTS: ("lost.heights", lambda s: int((s.located & np.isfinite(s.coordinates[:, 2])).sum())),
    Holds.SIGMA_GROUND: ("lost.sigma_ground", lambda s: int(_weighted(s).sum())),
    Holds.SIGMA_EAST_NORTH: ("lost.sigma_east_north", lambda s: _unequal(s, 0, 1)),
    Holds.SIGMA_UP: ("lost.sigma_up", lambda s: _unequal(s, 0, 2)),
    Holds.SIGMA_IMAGE: ("lost.sigma_image", lambda s: int(np.isfinite(s.observed.sigma_line_px).sum())),
    Holds.FIXED: ("lost.fixed", lambda s: int(s.fixed.sum())),
}
