"""Refuse bundles with points without rays or with undetermined unknowns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.closerange.bundle_block import CENTRE, FRAME, TURNS, Built
from fg_orient.closerange.fitting import UNDETERMINED
from fg_orient.model.errors import FgOrientError, Finding, InputError, finding
from fg_orient.sensors.frame_unknowns import NAMES, WORDS

#: Unknowns are named if their deviation is above this share of the largest deviation.
NAMED: Final = 0.3
_CODES: Final = {
    "statistics.motions": "closerange.datum", "adjust.rank_deficient": "closerange.unobservable",
    "adjust.rank_without_control": "closerange.unobservable",
}  # fmt: skip
#: Names of camera parameters by the descriptions for frame images, which have pixels, and p1 and p2 exchanged.
_PARAMETERS: Final = {
    WORDS[NAMES.index(frame)]: name for name, frame in FRAME.items() if name not in (*TURNS, *CENTRE)
}  # fmt: skip
_DESCRIBED: Final = re.compile("|".join(map(re.escape, _PARAMETERS)))


def require_rays(built: Built) -> None:
    """Refuse points without rays, and points in one photo without other observations.

    Control points and points of constraints are not checked here: the observability of the whole block decides.
    """
    known, o = built.block.points.known, built.block.observations
    others = {name for e in built.block.extra for name in getattr(e, "members", ())}
    faults = []
    for j, name in enumerate(built.ids):
        photos = np.unique(o.image[o.point == j])
        if not len(photos) and not known.fixed[j]:
            faults.append(finding("closerange.no_ray", place=f"point {name}"))
        elif len(photos) == 1 and not known.fixed[j] and np.isnan(known.sigma_enu_m[j]).any() and name not in others:
            where = f"point {name}, photo {built.photos[photos[0]].name}"
            faults.append(finding("closerange.one_ray", place=where))
    if faults:
        raise InputError(*faults)


def require_determined(labels: Sequence[str], deviation: Array) -> None:
    """Refuse unknowns (u,) whose standard deviations, in units of their accuracy, are too large.

    Unknowns without effect on the observations are refused earlier, by the observability of the block.
    """
    if deviation.max(initial=0.0) > UNDETERMINED:
        order = [k for k in np.argsort(-deviation, kind="stable").tolist() if deviation[k] >= NAMED * deviation.max()]
        names = [labels[k] for k in order]
        shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
        raise InputError.of(
            "closerange.undetermined",
            place="bundle",
            names=shown,
            direction=f"{names[0]}: {deviation[order[0]]:.3g} times",
            limit=UNDETERMINED,
        )


def of_close_range(error: FgOrientError) -> InputError:
    """Convert an error of the adjustment: it gets remedies for photos and the names of their camera parameters."""
    faults = [p for p in error.problems if p.code != "block.no_control"] or list(error.problems)
    return InputError(*map(_of_close_range, faults))


def _of_close_range(fault: Finding) -> Finding:
    code = _CODES.get(fault.code)
    place = _DESCRIBED.sub(lambda words: _PARAMETERS[words[0]], fault.place)
    return fault if code is None else finding(code, place=place)
