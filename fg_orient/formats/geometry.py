"""Remarks on the geometry of a block: how well control and check points are spread.

Only control coordinates and image positions are looked at; the coordinates of check
points stay sealed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import GroundPoints, Image, ImagePoints
from fg_orient.model.errors import Finding, finding
from fg_orient.model.names import Role

#: Below this number of control points an error in one of them hardly shows.
FEW_CONTROL: Final = 6
#: ASPRS Positional Accuracy Standards, edition 2 (2023): least number of check points.
FEW_CHECK: Final = 30
#: Width over length (standard deviations) below which points count as a line.
LINE_RATIO: Final = 0.05
#: Control that spans less than this part of the lines and of the samples counts as clustered.
CLUSTER_SPAN: Final = 0.25


def geometry_remarks(
    images: Sequence[Image], points: GroundPoints, observations: ImagePoints, file: str
) -> tuple[Finding, ...]:
    """Give remarks on number and distribution of control and check points.

    Parameters
    ----------
    images, points, observations
        The parts of a block.
    file : str
        Name of the point file, for the messages.

    Returns
    -------
    tuple of Finding
        Codes ``remark.*``; empty if there is nothing to say.
    """
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
    """Horizontal spread of control: the ratio of its principal standard deviations."""
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


def _clusters(
    images: Sequence[Image], control: np.ndarray[tuple[int], np.dtype[np.intp]], o: ImagePoints, file: str
) -> list[Finding]:
    """Images in which control covers a small part only, and blocks with control in one image."""
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
            remarks.append(
                finding(
                    "remark.control_clustered", file=file, place="control points", value=f"{rows.sum()} points",
                    image=images[k].id, lines=lines, samples=samples,
                )
            )  # fmt: skip
    return remarks
