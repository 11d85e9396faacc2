"""Checks and records that both DIMAP readers share.

Each limit is physical: an Earth observation satellite flies 100 to 1600 km high at 6 to
9 km/s, looks at most 45 degrees off, and scans a line in 10 microseconds to 10 ms. A value
outside is a damaged file or a wrong unit, never a scene.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fg_orient.formats.xml import DEGREES, XmlNode
from fg_orient.sensors.metadata import Ephemeris, FramePoint

Array = npt.NDArray[np.float64]

MIN_EPHEMERIS_POINTS = 4
RADIUS_M = (6.5e6, 8.0e6)
SPEED_M_S = (6e3, 9e3)
LINE_PERIOD_S = (1e-5, 1e-2)
MAX_LOOK_ANGLE_RAD = math.pi / 4
#: Attitude angles stay below the yaw steering of 0.07 rad; larger ones are degrees typed as radians.
MAX_ATTITUDE_RAD = 0.2
MAX_IMAGE_SIZE = 10**7
#: Quaternions are delivered normalised; beyond this they are no rotation.
QUATERNION_NORM_TOLERANCE = 1e-3
#: DIMAP counts lines, columns and detectors from 1 (Raster_CS: PIXEL_ORIGIN 1); here the first is 0.
DIMAP_FIRST_PIXEL = 1


def image_size(root: XmlNode, path: str) -> tuple[int, int]:
    """Lines and samples from the Raster_Dimensions at ``path``."""
    size = root.one(path)
    return size.one("NROWS").integer(2, MAX_IMAGE_SIZE), size.one("NCOLS").integer(2, MAX_IMAGE_SIZE)


def require_pixel_origin(root: XmlNode, path: str) -> None:
    """Refuse a file that states another pixel origin than 1."""
    node = root.maybe(path)
    if node is not None and node.integer(-1, 10) != DIMAP_FIRST_PIXEL:
        raise node.fault("dimap.pixel_origin", node.text())


def times(nodes: Sequence[XmlNode], epoch: np.datetime64) -> Array:
    """Strictly increasing times of TIME elements: (n,) seconds since ``epoch``.

    Raises
    ------
    InputError
        A time is malformed or not later than the one before.
    """
    time_s = np.array([node.seconds_since(epoch) for node in nodes])
    wrong = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(wrong):
        node = nodes[int(wrong[0]) + 1]
        raise node.fault("dimap.time_order", f"{node.text()} after {nodes[int(wrong[0])].text()}")
    return time_s


def ephemeris(points: Sequence[XmlNode], time_s: Array, position_m: Array, velocity_m_s: Array) -> Ephemeris:
    """State vectors after their checks; ``points`` are the elements to name in a message.

    Raises
    ------
    InputError
        A radius or a speed that no Earth observation satellite has.
    """
    for code, values, (low, high) in (
        ("dimap.radius", position_m, RADIUS_M),
        ("dimap.speed", velocity_m_s, SPEED_M_S),
    ):
        norm = np.linalg.norm(values, axis=1)
        wrong = np.flatnonzero((norm < low) | (norm > high))
        if len(wrong):
            raise points[int(wrong[0])].fault(code, f"{norm[wrong[0]]:.6g}", low=low, high=high)
    return Ephemeris(time_s, position_m, velocity_m_s)


def require_unit_quaternions(nodes: Sequence[XmlNode], quaternion: Array) -> None:
    """Refuse quaternions whose norm is not one (the zero quaternion among them)."""
    norm = np.linalg.norm(quaternion, axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE)
    if len(wrong):
        raise nodes[int(wrong[0])].fault(
            "dimap.quaternion_norm", f"norm {norm[wrong[0]]:.6g}", tolerance=QUATERNION_NORM_TOLERANCE
        )


def frame_points(
    frame: XmlNode | None, names: tuple[str, str, str, str], centre: str, height_m: float | None
) -> tuple[FramePoint, ...]:
    """Corners of a frame and its centre, if it has one.

    Parameters
    ----------
    frame : XmlNode or None
        Parent of the elements ``Vertex``.
    names : tuple of str
        Tags of row, column, longitude, latitude.
    centre : str
        Tag of the centre.
    height_m : float or None
        Height of the points; None if the file gives none.
    """
    if frame is None:
        return ()
    nodes = [(f"corner {k}", vertex) for k, vertex in enumerate(frame.every("Vertex", 4), start=1)]
    middle = frame.maybe(centre)
    nodes += [("centre", middle)] if middle else []
    row, column, lon, lat = names

    def pixel(vertex: XmlNode, tag: str) -> float:
        return vertex.one(tag).number(low=-MAX_IMAGE_SIZE, high=MAX_IMAGE_SIZE) - DIMAP_FIRST_PIXEL

    return tuple(
        FramePoint(
            id_, pixel(v, row), pixel(v, column), v.one(lon).number(DEGREES, -360.0, 360.0),
            v.one(lat).number(DEGREES, -90.0, 90.0), height_m,
        )
        for id_, v in nodes
    )  # fmt: skip
