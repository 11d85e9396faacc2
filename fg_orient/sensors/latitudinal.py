"""Observe control points by latitude, longitude and radius, as ISIS jigsaw does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factors.arrays import Mask
from factors.conditions.latitudinal import LATITUDINAL_POINT, RECORD
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.names import Role
from fg_orient.sensors.initial import local_origin


def with_angles(block: Block) -> Block:
    """Return the block with control points that are observed by longitude, latitude and radius.

    These observations replace the observed coordinates. The standard deviations are lengths along the
    three directions, m. Fixed points remain fixed.
    """
    known, origin, extra = block.points.known, local_origin(block.images), []
    rows = [j for j in block.points.where(Role.CONTROL).tolist() if not known.fixed[j]]
    for j in rows:
        x, y, z = known.ecef_m[j]
        flat = np.hypot(x, y)
        record = RECORD.pack(
            origin=origin, observed=[np.arctan2(y, x), np.arctan2(z, flat), np.hypot(flat, z)],
            sigma=known.sigma_enu_m[j],
        )  # fmt: skip
        name = block.points.ids[j]
        extra.append(ExtraObservation(LATITUDINAL_POINT, (f"point:{name}",), record, np.zeros((2, 0)), 3,
                                      f"latitude, longitude, radius of point {name}"))  # fmt: skip
    return replace(block, extra=(*block.extra, *extra))


def observed_by_angles(block: Block) -> Mask:
    """Return a mask (N,) of the points that are observed by latitude, longitude and radius."""
    named = {e.unknowns[0] for e in block.extra if getattr(e, "equation", None) is LATITUDINAL_POINT}
    if not named:
        return np.zeros(len(block.points.ids), bool)
    return np.array([f"point:{name}" in named for name in block.points.ids])
