"""Read DIMAP 1.1 metadata of SPOT 1 to 5, level 1A.

Source: Riazanoff 2004 (SPOT Geometry Handbook) as specified in docs/equations.md 2. The conventions were determined
with a real SPOT-5 file: the model meets its frame points within 4 cm (docs/equations.md 2).

The time of a line is ``SCENE_CENTER_TIME + LINE_PERIOD (line - SCENE_CENTER_LINE)``; lines are counted from 1. The
reader **negates roll and pitch and keeps yaw**. The records therefore contain angles of the orbital frame of
convention B.

Files of SPOT 5 contain ``Corrected_Attitudes``, which are used unchanged. Files of SPOT 1 to 4 contain raw attitudes:
absolute angles every 9 s and angular speeds at 8 Hz. A speed is interpreted as the mean over the interval **before**
its time tag. Angles are therefore linear between the tags. The sum of the speeds starts at the first absolute angle::

    angle(t_k) = angle(t_(k-1)) + speed_k (t_k - t_(k-1))

The reason is a comparison in the four known files. The second absolute angle minus the first equals the sum of all
speeds times 1/8 s plus one further speed. The further speed is similar to the last speeds of the list, not to the first
speeds (pitch of SPOT 1, in quanta: first speed 32, last speed -2, further speed -1). The rule "interval after the tag"
would move the corners by up to 1.4 m. The corners cannot show which rule is right, because the producer computed them
**without** attitudes. With zero angles, the model meets the corners within 0.4, 0.4, 0.5 and 1.6 m (SPOT1, SPOT2, SP2,
SPOT4). With the attitudes, it meets them within 8.1, 3.6, 1.7 and 24.5 m.

A speed is never extended by more than 0.2 s, neither in a gap nor at the ends of the list.

Files of SPOT 1 to 4 give look angles for the first and the last detector only. The detectors lie on a **straight line
in the focal plane**. The viewing directions of all other detectors are therefore interpolated linearly between these
two. With this table, the model meets Scene_Center as well as the corners (6.3, 0.2, 1.4, 15.8 m). If tangents about
the nadir were interpolated instead, the scene centre would be wrong by 64 to 722 m.
"""

from __future__ import annotations

import numpy as np

from factors.arrays import Array
from fg_orient.formats import dimap_checks as checks
from fg_orient.formats.dimap_checks import DIMAP_FIRST_PIXEL
from fg_orient.formats.xml import PURE, RADIANS, RADIANS_PER_SECOND, SECONDS, Quantity, XmlNode
from fg_orient.model.errors import Finding, OutOfTimeRange, finding
from fg_orient.sensors.metadata import AngleAttitude, LineTiming, LookAngleTable, PushbroomMetadata

PROFILES = ("SPOTSCENE_1A", "SPOTSEGMENT_1A")
#: The values of the file are multiplied by these signs to give roll, pitch, yaw of the records.
ATTITUDE_SIGN = np.array([-1.0, -1.0, 1.0])
#: An angular speed is used for at most this time beyond its own interval, which is 0.125 s.
SPEED_HOLD_S = 0.2
#: Height of the points of Dataset_Frame and of the tie points: they lie on the ellipsoid.
FRAME_HEIGHT_M = 0.0
_LAYOUT = checks.Layout(
    "Raster_CS/PIXEL_ORIGIN", "Raster_Dimensions", "Data_Strip/Ephemeris/Points/Point", "Dataset_Frame",
    ("TIME", "Location", "Velocity"), ("FRAME_ROW", "FRAME_COL", "FRAME_LON", "FRAME_LAT"), "Scene_Center",
    FRAME_HEIGHT_M,
)  # fmt: skip


def read_dimap1(root: XmlNode) -> PushbroomMetadata:
    """Read the metadata of a SPOT 1 to 5 document, level 1A.

    Raises
    ------
    InputError
        A value is missing, malformed or implausible.
    OutOfTimeRange
        More than 0.2 s of the image has no angular speeds.
    """
    size = n_lines, n_samples = checks.image_size(root, _LAYOUT)
    scene = root.one("Dataset_Sources/Source_Information/Scene_Source")
    index = scene.one("MISSION_INDEX").integer(1, 5)
    stamp = root.one("Data_Strip/Sensor_Configuration/Time_Stamp")
    epoch, seconds = stamp.one("SCENE_CENTER_TIME").time()
    line = stamp.one("SCENE_CENTER_LINE").number(low=-checks.MAX_IMAGE_SIZE, high=checks.MAX_IMAGE_SIZE)
    period = stamp.one("LINE_PERIOD").number(SECONDS, *checks.LINE_PERIOD_S)
    timing = LineTiming(line - DIMAP_FIRST_PIXEL, float(seconds), period)
    ends = timing.reference_time_s + period * (np.array([0.0, n_lines - 1.0]) - timing.reference_line)
    attitude, attitude_notes = _attitude(root, epoch, index, ends)
    look, look_notes = _look_angles(root, n_samples)
    frame_note = None if index == 5 else finding("image.frame_without_attitudes")
    return checks.metadata(
        root, _LAYOUT, size, epoch, timing, mission=f"SPOT {index}", format="DIMAP 1.1", attitude=attitude, look=look,
        instrument=f"{scene.one('INSTRUMENT').text()} {scene.one('INSTRUMENT_INDEX').integer(1, 9)}",
        notes=attitude_notes + look_notes + ((frame_note,) if frame_note else ()), frame_note=frame_note,
    )  # fmt: skip


def _look_angles(root: XmlNode, n_samples: int) -> tuple[LookAngleTable, tuple[Finding, ...]]:
    bands = root.every("Data_Strip/Sensor_Configuration/Instrument_Look_Angles_List/Instrument_Look_Angles")
    angle = (RADIANS, -checks.MAX_LOOK_ANGLE_RAD, checks.MAX_LOOK_ANGLE_RAD)
    columns = {"DETECTOR_ID": (PURE, DIMAP_FIRST_PIXEL, n_samples), "PSI_X": angle, "PSI_Y": angle}
    detector, psi_x, psi_y = (c.copy() for c in bands[0].one("Look_Angles_List").table("Look_Angles", columns, 2).T)
    for code, wrong in (
        ("xml.not_whole", np.flatnonzero(detector % 1.0)),
        ("dimap.detector_order", np.flatnonzero(np.diff(detector) <= 0.0) + 1),
    ):
        if len(wrong):
            node = bands[0].every("Look_Angles_List/Look_Angles")[int(wrong[0])].one("DETECTOR_ID")
            raise node.fault(code, node.text())
    if detector[0] != DIMAP_FIRST_PIXEL or detector[-1] != n_samples:
        seen = f"detectors {detector[0]:.0f} to {detector[-1]:.0f}"
        raise bands[0].fault("dimap.detectors_cover", seen, first=DIMAP_FIRST_PIXEL, last=n_samples)
    notes: tuple[Finding, ...] = ()
    if len(bands) > 1:
        index = bands[0].maybe("BAND_INDEX")
        notes = (finding("image.first_band", n=len(bands), band=index.text() if index else "not given"),)
    return straight_line(detector - DIMAP_FIRST_PIXEL, psi_x, psi_y), notes


def straight_line(sample: Array, psi_x_rad: Array, psi_y_rad: Array) -> LookAngleTable:
    """Interpolate the look angles of all detectors, which lie on a straight line in the focal plane.

    Parameters
    ----------
    sample : (n,) array
        Numbers of some detectors from 0, in increasing order. The first and the last detector are among them. Their
        angles are not changed.
    psi_x_rad, psi_y_rad : (n,) arrays
        Their look angles along and across track.
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


def _attitude(
    root: XmlNode, epoch: np.datetime64, index: int, ends_s: Array
) -> tuple[AngleAttitude, tuple[Finding, ...]]:
    source = root.one("Data_Strip/Satellite_Attitudes")
    if index == 5:
        nodes = source.every("Corrected_Attitudes/Corrected_Attitude/Angles", 2)
        time_s, angles = _rows(nodes, epoch, RADIANS)
        flags = checks.flagged(nodes, "OUT_OF_RANGE", "N", "image.attitude_flags")
        return AngleAttitude(time_s, ATTITUDE_SIGN * angles), flags
    raw = source.one("Raw_Attitudes/Aocs_Attitude")
    speed_nodes = raw.every("Angular_Speeds_List/Angular_Speeds", 2)
    angle_nodes = raw.every("Angles_List/Angles", 1)
    time_s, angles, notes = _integrate(speed_nodes, angle_nodes, epoch, ends_s)
    flags = checks.flagged(speed_nodes + angle_nodes, "OUT_OF_RANGE", "N", "image.attitude_flags")
    return AngleAttitude(time_s, ATTITUDE_SIGN * angles), flags + notes


def _rows(nodes: list[XmlNode], epoch: np.datetime64, quantity: Quantity) -> tuple[Array, Array]:
    """Read times (n,) and ROLL, PITCH, YAW (n, 3) without a change of their signs."""
    time_s = checks.times([n.one("TIME") for n in nodes], epoch)
    limit = checks.MAX_ATTITUDE_RAD  # rad, and rad/s for angular speeds
    tags = ("ROLL", "PITCH", "YAW")
    return time_s, np.array([[n.one(tag).number(quantity, -limit, limit) for tag in tags] for n in nodes])


def _integrate(
    speed_nodes: list[XmlNode], angle_nodes: list[XmlNode], epoch: np.datetime64, ends_s: Array
) -> tuple[Array, Array, tuple[Finding, ...]]:
    """Integrate angular speeds from the first absolute angle. The angles (n, 3) have the signs of the file."""
    speed_time, speeds = _rows(speed_nodes, epoch, RADIANS_PER_SECOND)
    angle_time, absolute = _rows(angle_nodes, epoch, RADIANS)
    _require_close(speed_nodes, angle_nodes, speed_time, angle_time)
    before, after = _held(speed_nodes[0], speed_time, angle_time, ends_s)
    head, tail = int(before > 0.0), int(after > 0.0)
    time_s = np.concatenate([[speed_time[0] - before] * head, speed_time, [speed_time[-1] + after] * tail])
    # an interval has the speed given at its end; after the last tag, the last speed is used
    of_interval = np.concatenate([speeds[:head], speeds[1:], speeds[len(speeds) - tail :]])
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(of_interval * np.diff(time_s)[:, None], axis=0)])
    anchor, last = (np.array([np.interp(t, time_s, column) for column in sums.T]) for t in angle_time[[0, -1]])
    notes = [finding("image.speeds_held", before_s=before, after_s=after)]
    if len(angle_time) > 1:
        closing = np.abs(absolute[-1] - absolute[0] - (last - anchor)).max()
        notes.append(finding("image.speeds_closing", closing_microrad=closing * 1e6))
    return time_s, absolute[0] + sums - anchor, tuple(notes)


def _held(node: XmlNode, speed_time: Array, angle_time: Array, ends_s: Array) -> tuple[float, float]:
    """Return the seconds by which the first and the last speed are extended.

    The speeds must cover the image and the absolute angles.
    """
    if max(speed_time[0] - ends_s[0], ends_s[1] - speed_time[-1]) > SPEED_HOLD_S:
        raise OutOfTimeRange.of(
            "dimap.speed_span", file=node.file, place=node.place, hold=SPEED_HOLD_S,
            value=f"image {ends_s[0]:.3f} .. {ends_s[1]:.3f} s", first=speed_time[0], last=speed_time[-1],
        )  # fmt: skip
    before = speed_time[0] - min(angle_time[0], ends_s[0])
    after = max(angle_time[-1], ends_s[1]) - speed_time[-1]
    return float(np.clip(before, 0.0, SPEED_HOLD_S)), float(np.clip(after, 0.0, SPEED_HOLD_S))


def _require_close(
    speed_nodes: list[XmlNode], angle_nodes: list[XmlNode], speed_time: Array, angle_time: Array
) -> None:
    """Refuse gaps that are longer than the limit. Refuse a first absolute angle outside the list of speeds."""
    gaps = np.diff(speed_time)
    if gaps.max() > SPEED_HOLD_S:
        k = int(gaps.argmax()) + 1
        raise speed_nodes[k].fault("dimap.speed_gap", f"{gaps.max():.3f} s", hold=SPEED_HOLD_S)
    if not speed_time[0] - SPEED_HOLD_S <= angle_time[0] <= speed_time[-1] + SPEED_HOLD_S:
        raise angle_nodes[0].fault("dimap.anchor", angle_nodes[0].one("TIME").text(), hold=SPEED_HOLD_S)
