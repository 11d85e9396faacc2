"""Compute ground points by the RPC of a file; ``locate`` compares them with the file's rigorous model."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from factors.geometry import ellipsoid
from fg_orient.formats.rpc.fields import USUAL_ORDER, Reading
from fg_orient.formats.rpc.text import read_rpc_isd
from fg_orient.model.errors import FgOrientError, Finding, finding
from fg_orient.sensors.metadata import FramePoint
from fg_orient.sensors.rpc_sensor import RpcSensor

#: Number of points along the image and across it.
SIDE: Final = 3


def rpc_points(path: str | Path, size: tuple[int, int]) -> tuple[tuple[FramePoint, ...], Finding]:
    """Return the ground points of 3 x 3 pixels at the mean height of the RPC, and a note.

    If the file has no valid RPC, there are no points.

    Parameters
    ----------
    path : path
        ISD file that contains a section RPB.
    size : (int, int)
        Lines and samples of the image.
    """
    try:
        model = read_rpc_isd(path, Reading(USUAL_ORDER, None))
        sensor = RpcSensor(model)
        line, sample = (a.ravel() for a in np.meshgrid(
            *(np.linspace(0.0, n - 1.0, SIDE) for n in size), indexing="ij"))  # fmt: skip
        ground = sensor.locate(line, sample, height_m=sensor.mean_height_m)
    except FgOrientError as error:
        return (), finding("image.rpc_unread (note): the RPC of the file is not compared with the rigorous model: "
                           "{reason}", reason=str(error))  # fmt: skip
    lon, lat, height = ellipsoid.geodetic_array(np.ascontiguousarray(ground)).T
    points = tuple(
        FramePoint(f"RPC {k}", *map(float, (line[k], sample[k], np.degrees(lon[k]), np.degrees(lat[k]), height[k])))
        for k in range(len(line))
    )
    return points, finding("image.frame_of_rpc (note): the points to compare come from the file's RPC, a fit to its "
                           "rigorous model")  # fmt: skip
