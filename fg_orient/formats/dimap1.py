"""Reader of DIMAP 1.1, SPOT 1 to 5, level 1A.

Sources: Riazanoff 2004 (SPOT Geometry Handbook) as specified in docs/equations.md 2;
conventions fixed on a real SPOT-5 file whose frame points are met to 4 cm
(docs/equations.md 2).

Time of a line: ``SCENE_CENTER_TIME + LINE_PERIOD (line - SCENE_CENTER_LINE)``, lines
counted from 1. Attitude: **roll and pitch are negated, yaw is kept** (sign step), so the
records hold the angles of the orbital frame of convention B.

SPOT 5 brings ``Corrected_Attitudes``; they are read as they are. SPOT 1 to 4 bring the
raw ones: absolute angles every 9 s and angular speeds at 8 Hz. A speed is taken as the
mean over the interval **before** its time tag, so angles are piecewise linear between the
tags; the sum starts at the first absolute angle::

    angle(t_k) = angle(t_(k-1)) + speed_k (t_k - t_(k-1))

Why: in the four known files the second absolute angle minus the first is the sum of all
speeds over 1/8 s plus exactly one more speed, and that one continues the last speeds, not
the first (SPOT 1 pitch, in quanta: first 32, last -2, missing -1). The rule after the tag
moves the corners by up to 1.4 m; they cannot decide, because the producer computed them
**without** attitudes (met within 0.4, 0.4, 0.5, 1.6 m if the angles are set to zero; with
them 8.1, 3.6, 1.7, 24.5 m for SPOT1, SPOT2, SP2, SPOT4). A speed is never held longer
than 0.2 s, neither in a gap nor at the ends of the list.

Look angles of SPOT 1 to 4 are given for the first and the last detector only. The
detectors lie on a **straight line in the focal plane**, so the viewing directions of unit
length are linear between the two, and the table is filled for every detector. Tangents
linear in the sample, about the nadir instead of the optical axis, would be 64 to 722 m off
at the scene centre; filled this way, Scene_Center is met like the corners (6.3, 0.2, 1.4, 15.8 m).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fg_orient.formats import dimap_checks as checks
from fg_orient.formats.dimap_checks import DIMAP_FIRST_PIXEL
from fg_orient.formats.xml import METRES, METRES_PER_SECOND, RADIANS, RADIANS_PER_SECOND, SECONDS, Quantity, XmlNode
from fg_orient.model.errors import Finding, OutOfTimeRange, finding
from fg_orient.sensors.metadata import (
    AngleAttitude,
    Ephemeris,
    LineTiming,
    LookAngleTable,
    PushbroomMetadata,
)

Array = npt.NDArray[np.float64]

PROFILES = ("SPOTSCENE_1A", "SPOTSEGMENT_1A")
#: Records hold roll, pitch, yaw = these signs times the file's values.
ATTITUDE_SIGN = np.array([-1.0, -1.0, 1.0])
#: Longest time an angular speed is held (its own interval is 0.125 s).
SPEED_HOLD_S = 0.2
#: Dataset_Frame and tie points lie on the ellipsoid.
FRAME_HEIGHT_M = 0.0
_FRAME_TAGS = ("FRAME_ROW", "FRAME_COL", "FRAME_LON", "FRAME_LAT")


def read_dimap1(root: XmlNode) -> PushbroomMetadata:
    """Read a DIMAP 1.1 document of SPOT 1 to 5, level 1A.

    Parameters
    ----------
    root : XmlNode
        Root of the document; :func:`fg_orient.formats.metadata.dimap.read_dimap` has checked its profile.

    Raises
    ------
    InputError
        A value is missing, malformed or implausible.
    OutOfTimeRange
        Angular speeds leave more than 0.2 s of the image open.
    """
    checks.require_pixel_origin(root, "Raster_CS/PIXEL_ORIGIN")
    scene = root.one("Dataset_Sources/Source_Information/Scene_Source")
    index = scene.one("MISSION_INDEX").integer(1, 5)
    n_lines, n_samples = checks.image_size(root, "Raster_Dimensions")
    epoch, timing = _timing(root)
    ends = timing.reference_time_s + timing.line_period_s * (np.array([0.0, n_lines - 1.0]) - timing.reference_line)
    attitude, attitude_notes = _attitude(root, epoch, index, ends)
    look, look_notes = _look_angles(root, n_samples)
    frame_note = None if index == 5 else finding("image.frame_without_attitudes")
    return PushbroomMetadata(
        file=root.file,
        mission=f"SPOT {index}",
        instrument=f"{scene.one('INSTRUMENT').text()} {scene.one('INSTRUMENT_INDEX').integer(1, 9)}",
        format="DIMAP 1.1",
        epoch=epoch,
        n_lines=n_lines,
        n_samples=n_samples,
        timing=timing,
        ephemeris=_ephemeris(root, epoch),
        attitude=attitude,
        look=look,
        frame_points=checks.frame_points(root.maybe("Dataset_Frame"), _FRAME_TAGS, "Scene_Center", FRAME_HEIGHT_M),
        notes=attitude_notes + look_notes + ((frame_note,) if frame_note else ()),
        frame_note=frame_note,
    )


def _timing(root: XmlNode) -> tuple[np.datetime64, LineTiming]:
    stamp = root.one("Data_Strip/Sensor_Configuration/Time_Stamp")
    epoch, seconds = stamp.one("SCENE_CENTER_TIME").time()
    line = stamp.one("SCENE_CENTER_LINE").number(low=-checks.MAX_IMAGE_SIZE, high=checks.MAX_IMAGE_SIZE)
    period = stamp.one("LINE_PERIOD").number(SECONDS, *checks.LINE_PERIOD_S)
    return epoch, LineTiming(line - DIMAP_FIRST_PIXEL, float(seconds), period)


def _ephemeris(root: XmlNode, epoch: np.datetime64) -> Ephemeris:
    points = root.every("Data_Strip/Ephemeris/Points/Point", checks.MIN_EPHEMERIS_POINTS)
    time_s = checks.times([p.one("TIME") for p in points], epoch)
    position, velocity = (
        np.array([[p.one(f"{group}/{axis}").number(quantity) for axis in "XYZ"] for p in points])
        for group, quantity in (("Location", METRES), ("Velocity", METRES_PER_SECOND))
    )
    return checks.ephemeris(points, time_s, position, velocity)


def _look_angles(root: XmlNode, n_samples: int) -> tuple[LookAngleTable, tuple[Finding, ...]]:
    bands = root.every("Data_Strip/Sensor_Configuration/Instrument_Look_Angles_List/Instrument_Look_Angles")
    detector, psi_x, psi_y = _plain_angles(bands[0], n_samples) or _checked_angles(bands[0], n_samples)
    if detector[0] != DIMAP_FIRST_PIXEL or detector[-1] != n_samples:
        seen = f"detectors {detector[0]:.0f} to {detector[-1]:.0f}"
        raise bands[0].fault("dimap.detectors_cover", seen, first=DIMAP_FIRST_PIXEL, last=n_samples)
    notes: tuple[Finding, ...] = ()
    if len(bands) > 1:
        notes = (finding("image.first_band", n=len(bands), band=_band(bands[0])),)
    return straight_line(detector - DIMAP_FIRST_PIXEL, psi_x, psi_y), notes


def _plain_angles(band: XmlNode, n_samples: int) -> tuple[Array, Array, Array] | None:
    """Detectors and their look angles, read at once; None where one has to look closer."""
    found = band.one("Look_Angles_List").plain_numbers("Look_Angles", ("DETECTOR_ID", "PSI_X", "PSI_Y"))
    if found is None or len(found) < 2:
        return None
    detector, angles = found[:, 0], found[:, 1:]
    good = (detector >= DIMAP_FIRST_PIXEL) & (detector <= n_samples) & (detector == np.floor(detector))
    if not good.all() or np.any(np.diff(detector) <= 0.0) or np.abs(angles).max() > checks.MAX_LOOK_ANGLE_RAD:
        return None
    return detector.copy(), angles[:, 0].copy(), angles[:, 1].copy()


def _checked_angles(band: XmlNode, n_samples: int) -> tuple[Array, Array, Array]:
    """Detectors and their look angles, each value checked for itself."""
    rows = band.every("Look_Angles_List/Look_Angles", 2)
    limit = checks.MAX_LOOK_ANGLE_RAD
    detector = np.array([row.one("DETECTOR_ID").integer(DIMAP_FIRST_PIXEL, n_samples) for row in rows], float)
    psi_x, psi_y = (
        np.array([row.one(tag).number(RADIANS, -limit, limit) for row in rows]) for tag in ("PSI_X", "PSI_Y")
    )
    wrong = np.flatnonzero(np.diff(detector) <= 0.0)
    if len(wrong):
        raise rows[int(wrong[0]) + 1].one("DETECTOR_ID").fault("dimap.detector_order", f"{detector[wrong[0] + 1]:.0f}")
    return detector, psi_x, psi_y


def straight_line(sample: Array, psi_x_rad: Array, psi_y_rad: Array) -> LookAngleTable:
    """Look angles of every detector from some, the detectors being on a straight line in the focal plane.

    Parameters
    ----------
    sample : (n,) array
        0-based numbers, increasing, the first and the last detector among them.
    psi_x_rad, psi_y_rad : (n,) arrays
        Their look angles along and across track.

    Returns
    -------
    LookAngleTable
        One row per detector; given rows are kept as they are.
    """
    every = np.arange(sample[0], sample[-1] + 1.0)
    if len(every) == len(sample):
        return LookAngleTable(sample, psi_x_rad, psi_y_rad)
    rays = np.stack([np.tan(psi_x_rad), np.tan(psi_y_rad), np.ones(len(sample))])
    x, y, z = (np.interp(every, sample, row) for row in rays / np.linalg.norm(rays, axis=0))
    psi_x, psi_y = np.arctan(x / z), np.arctan(y / z)
    given = (sample - sample[0]).astype(np.intp)
    psi_x[given], psi_y[given] = psi_x_rad, psi_y_rad
    return LookAngleTable(every, psi_x, psi_y)


def _band(node: XmlNode) -> str:
    index = node.maybe("BAND_INDEX")
    return index.text() if index else "not given"


# --- attitude --------------------------------------------------------------------------------


def _attitude(
    root: XmlNode, epoch: np.datetime64, index: int, ends_s: Array
) -> tuple[AngleAttitude, tuple[Finding, ...]]:
    source = root.one("Data_Strip/Satellite_Attitudes")
    if index == 5:
        nodes = source.every("Corrected_Attitudes/Corrected_Attitude/Angles", 2)
        time_s, angles = _rows(nodes, epoch, RADIANS)
        return AngleAttitude(time_s, ATTITUDE_SIGN * angles), _flagged(nodes)
    raw = source.one("Raw_Attitudes/Aocs_Attitude")
    speed_nodes = raw.every("Angular_Speeds_List/Angular_Speeds", 2)
    angle_nodes = raw.every("Angles_List/Angles", 1)
    time_s, angles, notes = _integrate(speed_nodes, angle_nodes, epoch, ends_s)
    return AngleAttitude(time_s, ATTITUDE_SIGN * angles), _flagged(speed_nodes + angle_nodes) + notes


def _rows(nodes: list[XmlNode], epoch: np.datetime64, quantity: Quantity) -> tuple[Array, Array]:
    """Give times (n,) and ROLL, PITCH, YAW (n, 3) as in the file."""
    time_s = checks.times([n.one("TIME") for n in nodes], epoch)
    limit = checks.MAX_ATTITUDE_RAD  # rad, and rad/s for angular speeds
    tags = ("ROLL", "PITCH", "YAW")
    return time_s, np.array([[n.one(tag).number(quantity, -limit, limit) for tag in tags] for n in nodes])


def _flagged(nodes: list[XmlNode]) -> tuple[Finding, ...]:
    flags = [node.maybe("OUT_OF_RANGE") for node in nodes]
    count = sum(flag is not None and flag.text() != "N" for flag in flags)
    return (finding("image.attitude_flags", count=count, n=len(nodes)),) if count else ()


def _integrate(
    speed_nodes: list[XmlNode], angle_nodes: list[XmlNode], epoch: np.datetime64, ends_s: Array
) -> tuple[Array, Array, tuple[Finding, ...]]:
    """Angles (n, 3) as in the file from angular speeds and the first absolute angle."""
    speed_time, speeds = _rows(speed_nodes, epoch, RADIANS_PER_SECOND)
    angle_time, absolute = _rows(angle_nodes, epoch, RADIANS)
    _require_close(speed_nodes, angle_nodes, speed_time, angle_time)
    before, after = _held(speed_nodes[0], speed_time, angle_time, ends_s)
    head, tail = int(before > 0.0), int(after > 0.0)
    time_s = np.concatenate([[speed_time[0] - before] * head, speed_time, [speed_time[-1] + after] * tail])
    # an interval has the speed of its end; after the last tag the last one is held
    of_interval = np.concatenate([speeds[:head], speeds[1:], speeds[len(speeds) - tail :]])
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(of_interval * np.diff(time_s)[:, None], axis=0)])
    anchor, last = (np.array([np.interp(t, time_s, column) for column in sums.T]) for t in angle_time[[0, -1]])
    notes = [finding("image.speeds_held", before_s=before, after_s=after)]
    if len(angle_time) > 1:
        closing = np.abs(absolute[-1] - absolute[0] - (last - anchor)).max()
        notes.append(finding("image.speeds_closing", closing_microrad=closing * 1e6))
    return time_s, absolute[0] + sums - anchor, tuple(notes)


def _held(node: XmlNode, speed_time: Array, angle_time: Array, ends_s: Array) -> tuple[float, float]:
    """Seconds for which the first and the last speed are held to reach image and absolute angles."""
    if max(speed_time[0] - ends_s[0], ends_s[1] - speed_time[-1]) > SPEED_HOLD_S:
        raise OutOfTimeRange(finding(
            "dimap.speed_span", file=node.file, place=node.place, hold=SPEED_HOLD_S,
            value=f"image {ends_s[0]:.3f} .. {ends_s[1]:.3f} s", first=speed_time[0], last=speed_time[-1],
        ))  # fmt: skip
    before = speed_time[0] - min(angle_time[0], ends_s[0])
    after = max(angle_time[-1], ends_s[1]) - speed_time[-1]
    return float(np.clip(before, 0.0, SPEED_HOLD_S)), float(np.clip(after, 0.0, SPEED_HOLD_S))


def _require_close(
    speed_nodes: list[XmlNode], angle_nodes: list[XmlNode], speed_time: Array, angle_time: Array
) -> None:
    """Refuse gaps over which a speed would be held too long, and an anchor outside the list."""
    gaps = np.diff(speed_time)
    if gaps.max() > SPEED_HOLD_S:
        k = int(gaps.argmax()) + 1
        raise speed_nodes[k].fault("dimap.speed_gap", f"{gaps.max():.3f} s", hold=SPEED_HOLD_S)
    if not speed_time[0] - SPEED_HOLD_S <= angle_time[0] <= speed_time[-1] + SPEED_HOLD_S:
        raise angle_nodes[0].fault("dimap.anchor", angle_nodes[0].one("TIME").text(), hold=SPEED_HOLD_S)
