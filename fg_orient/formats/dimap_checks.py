"""Checks and records that all DIMAP readers use.

The limits are physical. An Earth observation satellite flies at a height of 100 to 1600
km with a speed of 6 to 9 km/s. It looks at most 45 degrees off nadir and scans a line in
10 microseconds to 10 ms. A value outside these limits is damaged or has a wrong unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from factors.arrays import Array
from fg_orient.formats.xml import DEGREES, METRES, METRES_PER_SECOND, Quantity, XmlNode
from fg_orient.model.errors import Finding, finding
from fg_orient.sensors.metadata import Ephemeris, FramePoint, LineTiming, PushbroomMetadata

MIN_EPHEMERIS_POINTS = 4
RADIUS_M = (6.5e6, 8.0e6)
SPEED_M_S = (6e3, 9e3)
LINE_PERIOD_S = (1e-5, 1e-2)
MAX_LOOK_ANGLE_RAD = math.pi / 4
#: Largest allowed attitude angle. Yaw steering gives up to 0.07 rad; larger angles are degrees written as radians.
MAX_ATTITUDE_RAD = 0.2
MAX_IMAGE_SIZE = 10**7
#: Files contain quaternions of norm 1. If the norm differs by more than this, the quaternion is not a rotation.
QUATERNION_NORM_TOLERANCE = 1e-3
#: DIMAP counts lines, columns and detectors from 1 (Raster_CS: PIXEL_ORIGIN 1). This program counts from 0.
DIMAP_FIRST_PIXEL = 1


@dataclass(frozen=True)
class Layout:
    """Element names of a DIMAP version, for contents that all versions have.

    Parameters
    ----------
    pixel_origin, size, points, frame : str
        Paths of the pixel origin, the image size, the state vectors, and the parent element of the corners.
    state : tuple of str
        Tags of time, position and velocity. Position and velocity contain three numbers,
        or the children X, Y, Z.
    corner : tuple of str
        Tags of row, column, longitude and latitude.
    centre : str
        Tag of the centre of the frame.
    height_m : float or None
        Height of the corners; None if the file does not state it.
    """

    pixel_origin: str
    size: str
    points: str
    frame: str
    state: tuple[str, str, str]
    corner: tuple[str, str, str, str] = ("ROW", "COL", "LON", "LAT")
    centre: str = "Center"
    height_m: float | None = None


def image_size(root: XmlNode, layout: Layout) -> tuple[int, int]:
    """Return the numbers of lines and samples; refuse a pixel origin other than 1."""
    origin = root.maybe(layout.pixel_origin)
    if origin is not None and origin.integer(-1, 10) != DIMAP_FIRST_PIXEL:
        raise origin.fault("dimap.pixel_origin", origin.text())
    size = root.one(layout.size)
    return size.one("NROWS").integer(2, MAX_IMAGE_SIZE), size.one("NCOLS").integer(2, MAX_IMAGE_SIZE)


def metadata(
    root: XmlNode, layout: Layout, size: tuple[int, int], epoch: np.datetime64, timing: LineTiming, **others: Any
) -> PushbroomMetadata:
    """Build the metadata record from the elements that all DIMAP versions have.

    Parameters
    ----------
    root : XmlNode
    layout : Layout
    size : (int, int)
        Lines and samples.
    epoch : datetime64
        Day; times are seconds from its beginning.
    timing : LineTiming
    **others
        Further fields of the record.

    Returns
    -------
    PushbroomMetadata
        It contains state vectors (ECEF, m and m/s) and frame points.
    """
    corners = _frame_points(root.maybe(layout.frame), layout)
    if corners and layout.height_m is None:
        others["frame_note"] = finding("image.frame_without_heights")
    return PushbroomMetadata(
        file=root.file, epoch=epoch, n_lines=size[0], n_samples=size[1], timing=timing,
        ephemeris=_ephemeris(root, layout, epoch), frame_points=corners, **others,
    )  # fmt: skip


def times(nodes: Sequence[XmlNode], epoch: np.datetime64) -> Array:
    """Read TIME elements as seconds (n,) since ``epoch``.

    Raise InputError if they do not increase strictly.
    """
    time_s = np.array([node.seconds_since(epoch) for node in nodes])
    wrong = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(wrong):
        node = nodes[int(wrong[0]) + 1]
        raise node.fault("dimap.time_order", f"{node.text()} after {nodes[int(wrong[0])].text()}")
    return time_s


def _ephemeris(root: XmlNode, layout: Layout, epoch: np.datetime64) -> Ephemeris:
    """Read the state vectors and check that radius and speed are possible for an Earth observation satellite."""
    points = root.every(layout.points, MIN_EPHEMERIS_POINTS)
    time, position, velocity = layout.state
    time_s = times([point.one(time) for point in points], epoch)
    position_m, velocity_m_s = (
        np.array([_vector(point.one(tag), quantity) for point in points])
        for tag, quantity in ((position, METRES), (velocity, METRES_PER_SECOND))
    )
    require_states(points, position_m, velocity_m_s)
    return Ephemeris(time_s, position_m, velocity_m_s)


def require_states(nodes: Sequence[XmlNode], position_m: Array, velocity_m_s: Array) -> None:
    """Refuse a distance (n, 3) or speed (n, 3) that is impossible for an Earth observation satellite."""
    for code, vectors, (low, high) in (
        ("dimap.radius", position_m, RADIUS_M), ("dimap.speed", velocity_m_s, SPEED_M_S)
    ):  # fmt: skip
        norm = np.linalg.norm(vectors, axis=1)
        wrong = np.flatnonzero((norm < low) | (norm > high))
        if len(wrong):
            raise nodes[int(wrong[0])].fault(code, f"{norm[wrong[0]]:.6g}", low=low, high=high)


def _vector(node: XmlNode, quantity: Quantity) -> Array:
    """Read three numbers from an element or from its children X, Y, Z."""
    if any(node.children()):
        return np.array([node.one(axis).number(quantity) for axis in "XYZ"])
    return node.vector(3, quantity)


def require_unit_quaternions(nodes: Sequence[XmlNode], quaternion: Array) -> None:
    """Refuse quaternions whose norm is not 1, for example the zero quaternion."""
    norm = np.linalg.norm(quaternion, axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE)
    if len(wrong):
        node, value = nodes[int(wrong[0])], f"norm {norm[wrong[0]]:.6g}"
        raise node.fault("dimap.quaternion_norm", value, tolerance=QUATERNION_NORM_TOLERANCE)


def flagged(nodes: Sequence[XmlNode], tag: str, good: str, code: str) -> tuple[Finding, ...]:
    """Return a note with the number of elements that are not flagged as ``good``.

    No note if all are good.
    """
    flags = [node.maybe(tag) for node in nodes]
    count = sum(flag is not None and flag.text() != good for flag in flags)
    return (finding(code, count=count, n=len(nodes)),) if count else ()


def _frame_points(frame: XmlNode | None, layout: Layout) -> tuple[FramePoint, ...]:
    """Read the corners of a frame, and its centre if the file contains it."""
    if frame is None:
        return ()
    nodes = [(f"corner {k}", vertex) for k, vertex in enumerate(frame.every("Vertex", 4), start=1)]
    middle = frame.maybe(layout.centre)
    nodes += [("centre", middle)] if middle else []
    row, column, lon, lat = layout.corner

    def pixel(vertex: XmlNode, tag: str) -> float:
        return vertex.one(tag).number(low=-MAX_IMAGE_SIZE, high=MAX_IMAGE_SIZE) - DIMAP_FIRST_PIXEL

    return tuple(
        FramePoint(
            id_, pixel(v, row), pixel(v, column), v.one(lon).number(DEGREES, -360.0, 360.0),
            v.one(lat).number(DEGREES, -90.0, 90.0), layout.height_m,
        )
        for id_, v in nodes
    )  # fmt: skip
