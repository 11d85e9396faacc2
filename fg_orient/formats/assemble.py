"""Brings points and observations together: who is measured how often, and who is left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fg_orient.formats.observations import ObservationFile
from fg_orient.formats.points import PointFile, take_points
from fg_orient.model.block import GroundPoints, ImagePoints, WithheldCoordinates
from fg_orient.model.errors import Finding, finding
from fg_orient.model.names import Role

#: Ids named in one message.
_NAMED = 10


@dataclass(frozen=True)
class Assembly:
    """Points that take part, their observations, and what was found on the way."""

    points: GroundPoints
    observations: ImagePoints
    withheld: WithheldCoordinates
    problems: tuple[Finding, ...]
    remarks: tuple[Finding, ...]


def assemble(
    image_ids: Sequence[str], points: PointFile, observations: ObservationFile, *, drop: bool, relative: bool = False
) -> Assembly:
    """Leave out unmeasured points; refuse, or ``drop``, check and tie points with a single ray.

    Control points with a single ray stay: their coordinates complete it. An image without
    any measured point is refused, and so is a block without measured control, unless the
    adjustment is to be ``relative``.
    """
    problems: list[Finding] = []
    remarks: list[Finding] = []
    rays = np.bincount(observations.observations.point, minlength=len(points.points.ids))
    control = np.zeros(len(rays), bool)
    control[points.points.where(Role.CONTROL)] = True
    lonely = (rays == 1) & ~control
    file, point_file = str(observations.path), str(points.path)
    if lonely.any():
        code, found = ("remark.seen_once", remarks) if drop else ("observations.seen_once", problems)
        named = _named(_with_image(points.points.ids, image_ids, observations.observations), np.flatnonzero(lonely))
        found.append(finding(code, file=file, place="column id", value=named, count=int(lonely.sum())))
    unmeasured = np.flatnonzero(rays == 0)
    if len(unmeasured):
        named = _named(points.points.ids, unmeasured)
        remarks.append(
            finding("remark.not_measured", file=point_file, place="column id", value=named, count=len(unmeasured))
        )
    if not relative and not (control & (rays > 0)).any():
        value = f"{control.sum()} control points in the file, 0 measured"
        problems.append(finding("block.no_control", file=point_file, place="column role", value=value))
    kept = np.flatnonzero((rays > 0) & ~lonely)
    taken = _renumber(observations.observations, kept, len(rays))
    for k in np.flatnonzero(np.bincount(taken.image, minlength=len(image_ids)) == 0).tolist():
        problems.append(finding("observations.image_unused", file=file, place="column image", value=image_ids[k]))
    left = take_points(points.points, kept)
    withheld = points.withheld([left.ids[k] for k in left.where(Role.CHECK)])
    return Assembly(left, taken, withheld, tuple(problems), tuple(remarks))


def _named(ids: Sequence[str], rows: np.ndarray[tuple[int], np.dtype[np.intp]]) -> str:
    more = " ..." if len(rows) > _NAMED else ""
    return ", ".join(ids[int(k)] for k in rows[:_NAMED]) + more


def _with_image(ids: Sequence[str], image_ids: Sequence[str], observations: ImagePoints) -> list[str]:
    """Ids of points, each with one image that it is measured in."""
    only = dict(zip(observations.point.tolist(), observations.image.tolist(), strict=True))
    return [f"{name} (image {image_ids[only[j]]})" if j in only else name for j, name in enumerate(ids)]


def _renumber(observations: ImagePoints, kept: np.ndarray[tuple[int], np.dtype[np.intp]], n_points: int) -> ImagePoints:
    """Observations of the kept points, numbered anew."""
    number = np.full(n_points, -1, np.intp)
    number[kept] = np.arange(len(kept))
    taken = observations.take(number[observations.point] >= 0)
    return ImagePoints(
        taken.image, number[taken.point], taken.line, taken.sample, taken.sigma_line_px, taken.sigma_sample_px
    )
