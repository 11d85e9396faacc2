"""Combine the points and observations of a block: count rays, exclude points, and judge their distribution.

Only control coordinates and image coordinates are used. The coordinates of check points stay sealed.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from factors.arrays import Index
from fg_orient.formats.points import ObservationFile, PointFile
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import GroundPoints, Image, ImagePoints, WithheldCoordinates
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

#: Maximum number of ids in one message.
_NAMED: Final = 10
#: With fewer control points, an error in one of them can hardly be detected.
FEW_CONTROL: Final = 6
#: ASPRS Positional Accuracy Standards, edition 2 (2023): minimum number of check points.
FEW_CHECK: Final = 30
#: Points are treated as a line if their width divided by their length (standard deviations) is below this value.
LINE_RATIO: Final = 0.05
#: Control points are clustered if they cover less than this part of the lines and less than this part of the samples.
CLUSTER_SPAN: Final = 0.25


def assemble(
    image_ids: Sequence[str],
    points: PointFile,
    observations: ObservationFile,
    *,
    drop: bool,
    relative: bool = False,
    named: Collection[str] = (),
) -> tuple[GroundPoints, ImagePoints, WithheldCoordinates, tuple[Finding, ...]]:
    """Return the points of the block, their observations, the sealed check points and remarks.

    Points without image points are removed. Exceptions are fixed points that constraints
    name (``named``). Check and tie points with only one ray are refused, or removed if
    ``drop`` is true. Control points with only one ray are kept, because their coordinates
    are known. Images without measured points are refused. A block without measured
    control points is refused, unless the adjustment is ``relative``.

    Raises
    ------
    InputError
        A point or image is refused; the error lists all of them.
    """
    problems: list[Finding] = []
    remarks: list[Finding] = []
    rays = np.bincount(observations.observations.point, minlength=len(points.points.ids))
    control = np.zeros(len(rays), bool)
    control[points.points.where(Role.CONTROL)] = True
    lonely = (rays == 1) & ~control
    file, point_file = str(observations.path), str(points.path)
    if lonely.any():
        code, listed = ("remark.seen_once", remarks) if drop else ("observations.seen_once", problems)
        named = _named(_with_image(points.points.ids, image_ids, observations.observations), np.flatnonzero(lonely))
        listed.append(finding(code, file=file, place="column id", value=named, count=int(lonely.sum())))
    held = points.points.known.fixed & np.isin(points.points.ids, list(named))
    unmeasured = np.flatnonzero((rays == 0) & ~held)
    if len(unmeasured):
        named = _named(points.points.ids, unmeasured)
        count = len(unmeasured)
        remarks.append(finding("remark.not_measured", file=point_file, place="column id", value=named, count=count))
    if not relative and not (control & (rays > 0)).any():
        value = f"{control.sum()} control points in the file, 0 measured"
        problems.append(finding("block.no_control", file=point_file, place="column role", value=value))
    kept = np.flatnonzero((rays > 0) & ~lonely | held)
    taken = _renumber(observations.observations, kept, len(rays))
    for k in np.flatnonzero(np.bincount(taken.image, minlength=len(image_ids)) == 0).tolist():
        problems.append(finding("observations.image_unused", file=file, place="column image", value=image_ids[k]))
    if problems:
        raise InputError(*problems)
    left = points.points.take(kept)
    withheld = points.withheld([left.ids[k] for k in left.where(Role.CHECK)])
    return left, taken, withheld, tuple(remarks)


def _named(ids: Sequence[str], rows: Index) -> str:
    more = " ..." if len(rows) > _NAMED else ""
    return ", ".join(ids[int(k)] for k in rows[:_NAMED]) + more


def _with_image(ids: Sequence[str], image_ids: Sequence[str], observations: ImagePoints) -> list[str]:
    """Return the ids of points; to each id, append one image in which the point is measured."""
    only = dict(zip(observations.point.tolist(), observations.image.tolist(), strict=True))
    return [f"{name} (image {image_ids[only[j]]})" if j in only else name for j, name in enumerate(ids)]


def _renumber(observations: ImagePoints, kept: Index, n_points: int) -> ImagePoints:
    """Return the observations of the points that are kept, with the new numbers of the points."""
    number = np.full(n_points, -1, np.intp)
    number[kept] = np.arange(len(kept))
    taken = observations.take(number[observations.point] >= 0)
    return replace(taken, point=number[taken.point])


# --- distribution --------------------------------------------------------------------------------


def geometry_remarks(
    images: Sequence[Image], points: GroundPoints, observations: ImagePoints, file: str
) -> tuple[Finding, ...]:
    """Check the number and distribution of control and check points; ``file`` is the point file in messages."""
    control, n_check = points.where(Role.CONTROL), len(points.where(Role.CHECK))
    remarks: list[Finding] = []
    if len(control) < FEW_CONTROL:
        value = ", ".join(points.ids[k] for k in control)
        remarks.append(finding("remark.few_control", file=file, place="column role", value=value, count=len(control)))
    remarks += _line(points, file)
    remarks += _clusters(images, control, observations, file)
    if n_check < FEW_CHECK:
        remarks.append(finding("remark.few_check", file=file, place="column role", value=n_check, count=n_check))
    return tuple(remarks)


def _line(points: GroundPoints, file: str) -> list[Finding]:
    """Return a remark if the control points lie nearly on a line: ratio of their principal standard deviations."""
    control = points.where(Role.CONTROL)
    if len(control) < 3:
        return []
    ecef = points.known.ecef_m[control]
    lon, lat, _ = ecef_to_geodetic(ecef.mean(axis=0))
    horizontal = ((ecef - ecef.mean(axis=0)) @ enu_from_ecef(lon, lat)[0].T)[:, :2]
    along, across = np.linalg.svd(horizontal, compute_uv=False) / np.sqrt(len(control))
    if across >= LINE_RATIO * along:
        return []
    value = f"{len(control)} control points"
    return [finding("remark.control_line", file=file, place="coordinates", value=value, across_m=across, along_m=along)]


def _clusters(images: Sequence[Image], control: Index, o: ImagePoints, file: str) -> list[Finding]:
    """Return remarks if control covers only a small part of an image, or if only one image has control."""
    remarks: list[Finding] = []
    is_control = np.isin(o.point, control)
    seen_in = sorted(set(o.image[is_control].tolist()))
    if len(seen_in) == 1 and len(images) > 1:
        name = images[seen_in[0]].id
        remarks.append(finding("remark.control_one_image", file=file, place="control points", value=name, image=name))
    for k in seen_in:
        rows = is_control & (o.image == k)
        lines = float(np.ptp(o.line[rows])) / images[k].sensor.n_lines
        samples = float(np.ptp(o.sample[rows])) / images[k].sensor.n_samples
        if rows.sum() > 1 and max(lines, samples) < CLUSTER_SPAN:
            remarks.append(finding(
                "remark.control_clustered", file=file, place="control points", value=f"{rows.sum()} points",
                image=images[k].id, lines=lines, samples=samples,
            ))  # fmt: skip
    return remarks
