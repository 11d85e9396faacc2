"""Read the rigorous line-scan model from DigitalGlobe ISD XML of level 1B (WorldView, GeoEye, QuickBird).

The file has these parts:

- ``EPH`` contains Earth-fixed positions and velocities in equal steps;
- ``ATT`` contains quaternions from spacecraft axes to Earth-fixed axes (scalar last) in equal steps;
- ``TLC`` contains times of lines;
- ``GEO`` contains the camera: principal distance, perspective centre, attitude in the spacecraft, and detector line.

Camera axes are defined as in the file. The line of sight of a detector at (x, y) mm is (x, y, PD).
Sample s lies at ``origin + pitch s (sin a, -cos a)`` with a = DETROTANGLE.

The attitudes already contain the effects on light. Without further effects, the mean
difference between the model and the RPC of the same file is 0.3 px. With velocity
aberration, it is 48 px (docs/line-scan.md gives figures of two images).
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array
from factors.geometry import rotations
from factors.geometry.interpolation import sign_aligned
from fg_orient.formats import dimap_checks as checks
from fg_orient.formats.metadata.rpc_points import rpc_points
from fg_orient.formats.registry import Format, xml_root
from fg_orient.formats.xml import DEGREES, XmlNode, read_xml
from fg_orient.sensors.general import GeneralPushbroom
from fg_orient.sensors.light_sizes import chosen, noted
from fg_orient.sensors.metadata import (
    DirectionTable,
    Ephemeris,
    GeneralMetadata,
    LightEffects,
    LineTiming,
    QuaternionList,
    SegmentTiming,
)

#: Images of this product level are not resampled.
LEVEL: Final = "1B"
#: Default effects on light.
USUAL: Final = LightEffects()
SECTIONS: Final = ("IMD", "EPH", "ATT", "GEO")
#: Length of a record of states: its number, position, velocity, 6 covariances. Length of
#: a record of attitudes: its number, quaternion, 10 covariances.
_STATE, _ATTITUDE = 13, 15
_STEP_S: Final = (1e-4, 60.0)
#: Allowed ranges of the principal distance, and of the position and pitch of detectors, mm.
_DISTANCE_MM, _POSITION_MM, _PITCH_MM = (1e2, 1e6), (-2e3, 2e3), (1e-4, 1.0)
#: Rotates our camera axes (z away from the ground) to the axes of the file (z to the ground).
_THEIRS: Final = np.diag([1.0, -1.0, -1.0])


def read_isd(path: str | Path, light: tuple[str, ...] = ()) -> GeneralMetadata:
    """Read the rigorous model of an ISD file.

    Parameters
    ----------
    path : path
    light : tuple of str
        Effects on light; by default, there are none.

    Raises
    ------
    InputError
        A value is missing, malformed or implausible, or the camera has an optical
        distortion, which is not supported.
    """
    root = read_xml(path)
    image, band = root.one("IMD"), _band(root)
    size = image.one("NUMROWS").integer(2, checks.MAX_IMAGE_SIZE), image.one("NUMCOLUMNS").integer(2, 10**6)
    epoch, _ = root.one("EPH/STARTTIME").time()
    geometry, camera = root.one("GEO"), root.one("GEO/CAMERA_ATTITUDE")
    centre = geometry.one("PERSPECTIVE_CENTER")
    turn = np.array([[camera.one(f"QCS{k}").number() for k in (4, 1, 2, 3)]])
    checks.require_unit_quaternions([camera], turn)
    satellite = image.one("IMAGE/SATID").text()
    points, note = rpc_points(path, size)
    return GeneralMetadata(
        file=root.file, mission=satellite, instrument=band, format="DigitalGlobe ISD", epoch=epoch,
        n_lines=size[0], n_samples=size[1], timing=_timing(image.one("IMAGE"), epoch),
        ephemeris=_ephemeris(root.one("EPH"), epoch), attitude=_attitude(root.one("ATT"), epoch),
        look=_detectors(geometry, band, size[1]),
        offset_m=np.array([centre.one(f"C{axis}").number(low=-100.0, high=100.0) for axis in "XYZ"]),
        mounting=rotations.quaternion_matrices(turn / np.linalg.norm(turn))[0] @ _THEIRS,
        effects=chosen(light, USUAL), frame_points=points, frame_note=note,
    )  # fmt: skip


def _band(root: XmlNode) -> str:
    """Return the band of the RPC; without an RPC, the first band of the camera."""
    mounting = root.one("GEO/DETECTOR_MOUNTING")
    bands = [child.tag.removeprefix("BAND_") for child in mounting.children() if child.tag.startswith("BAND_")]
    if not bands:
        raise mounting.fault("xml.missing_element", element="BAND_P")
    wanted = root.maybe("IMD/BANDID")
    return wanted.text() if wanted is not None and wanted.text() in bands else bands[0]


def _timing(image: XmlNode, epoch: np.datetime64) -> LineTiming:
    """Read the times of lines.

    Times are linear between the pairs of the list, and the last rate is used after it.
    """
    nodes = image.every("TLCLISTList/TLCLIST")
    line, seconds = np.array([node.vector(2) for node in nodes]).T
    start = image.one("TLCTIME").seconds_since(epoch)
    rate = image.one("AVGLINERATE").number(low=1.0 / checks.LINE_PERIOD_S[1], high=1.0 / checks.LINE_PERIOD_S[0])
    wrong = np.flatnonzero(np.diff(line) <= 0.0)
    if len(wrong):
        raise nodes[int(wrong[0]) + 1].fault("dimap.time_order", nodes[int(wrong[0]) + 1].text())
    period = np.diff(seconds) / np.diff(line)
    low, high = checks.LINE_PERIOD_S
    wrong = np.flatnonzero((period < low) | (period > high))
    if len(wrong):
        raise nodes[int(wrong[0]) + 1].fault("xml.out_of_range", f"{period[wrong[0]]:.6g}", low=low, high=high,
                                             unit=" s per line")  # fmt: skip
    period = np.append(period, period[-1:] if len(period) else 1.0 / rate)
    return SegmentTiming.of(line, start + seconds, period)


def _table(section: XmlNode, name: str, size: int, epoch: np.datetime64) -> tuple[list[XmlNode], Array, Array]:
    """Return the elements of a list, their times (n,), and their numbers (n, size - 1) without the record number."""
    nodes = section.every(f"{name}List/{name}", checks.MIN_EPHEMERIS_POINTS)
    values = np.array([node.vector(size) for node in nodes])
    wrong = np.flatnonzero(values[:, 0] != np.arange(1.0, len(nodes) + 1.0))
    if len(wrong):
        k = int(wrong[0])
        raise nodes[k].fault("digitalglobe.numbered", f"{values[k, 0]:g}", expected=k + 1)
    count = section.one("NUMPOINTS")
    if count.integer(1, 10**7) != len(nodes):
        raise count.fault("digitalglobe.count", count.text(), n=len(nodes), name=name)
    step = section.one("TIMEINTERVAL").number(low=_STEP_S[0], high=_STEP_S[1])
    start = section.one("STARTTIME").seconds_since(epoch)
    return nodes, np.asarray(start + step * np.arange(len(nodes))), np.ascontiguousarray(values[:, 1:])


def _ephemeris(section: XmlNode, epoch: np.datetime64) -> Ephemeris:
    nodes, time_s, values = _table(section, "EPHEMLIST", _STATE, epoch)
    parts = np.ascontiguousarray(values[:, :3]), np.ascontiguousarray(values[:, 3:6])
    checks.require_states(nodes, *parts)
    return Ephemeris(time_s, *parts)


def _attitude(section: XmlNode, epoch: np.datetime64) -> QuaternionList:
    nodes, time_s, values = _table(section, "ATTLIST", _ATTITUDE, epoch)
    quaternion = values[:, [3, 0, 1, 2]]
    checks.require_unit_quaternions(nodes, quaternion)
    return QuaternionList(time_s, sign_aligned(quaternion), scheme="lagrange")


def _detectors(geometry: XmlNode, band: str, n_samples: int) -> DirectionTable:
    """Return the directions of the first and last sample.

    The detectors lie on a straight line in the focal plane.
    """
    distortion = geometry.maybe("OPTICAL_DISTORTION")
    if distortion is not None and distortion.one("POLYORDER").integer(-1, 20) >= 0:
        raise distortion.fault("digitalglobe.distortion", f"order {distortion.one('POLYORDER').text()}")
    arrays = geometry.every(f"DETECTOR_MOUNTING/BAND_{band}/DETECTOR_ARRAY")
    if len(arrays) > 1:
        raise arrays[1].fault("digitalglobe.arrays", f"{len(arrays)} arrays")
    array, distance = arrays[0], geometry.one("PRINCIPAL_DISTANCE/PD").number(low=_DISTANCE_MM[0], high=_DISTANCE_MM[1])
    x, y = (array.one(f"DETORIGIN{axis}").number(low=_POSITION_MM[0], high=_POSITION_MM[1]) for axis in "XY")
    angle = array.one("DETROTANGLE").number(DEGREES, -360.0, 360.0) * np.pi / 180.0
    along = array.one("DETPITCH").number(low=_PITCH_MM[0], high=_PITCH_MM[1]) * np.array([0.0, n_samples - 1.0])
    forward, right = x + along * np.sin(angle), y - along * np.cos(angle)
    return DirectionTable(np.array([0.0, n_samples - 1.0]), forward / distance, -right / distance)


def _is_rigorous(path: Path, head: str) -> bool:
    """Return whether a file has level 1B with states and camera.

    Other files contain only an RPC, or describe a resampled image.
    """
    if xml_root(head) != "isd":
        return False
    root = read_xml(path)
    level = root.maybe("IMD/PRODUCTLEVEL")
    return level is not None and LEVEL in level.text() and all(root.maybe(name) is not None for name in SECTIONS)


FORMAT = Format(
    name="digitalglobe-isd", title="DigitalGlobe ISD XML, level 1B", sniff=_is_rigorous, beside_rpc=True,
    chooses_light=True, read_image=lambda path, light=(): noted(GeneralPushbroom(read_isd(path, light))),
)  # fmt: skip
