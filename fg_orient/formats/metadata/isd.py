"""Read images from image support data (ISD) of ALE, JSON: frames (``USGS_ASTRO_FRAME_SENSOR_MODEL``) and line scans.

An ISD contains positions (km) and rotations in an inertial frame, and the rotation of the
body. Rotations are quaternions (scalar first), followed by constant rotations. The ISD
also contains the focal length (mm), the affine map of the detector, summing and
distortion. If there are states at several times, they are interpolated: positions by a
cubic Hermite spline, rotations by spherical linear interpolation. A frame image has the
states of its centre time; :mod:`fg_orient.formats.isd_lines` reads line-scan images.

An ISIS label with the same name (``.pvl`` or ``.lbl``) in the same folder completes the
ISD of a frame. Its group ``AlphaCube`` contains the reduction of the image, and
``Instrument`` the serial number. If ``optical_distortion`` is zero, the distortion of
metric cameras is read from ``naif_keywords`` (``OD_K``, ``DECENTER``, ``PP``). If a
detector has no stated centre, its coordinates begin in the middle of the scan. The
direction of the body determines the sign of the focal length, because some cameras look
along their negative third axis.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from factors.geometry.rotations import quaternion_matrices
from fg_orient.formats.atomic import write_text
from fg_orient.formats.csm import FRAME_MODEL, LINE_SCAN_MODEL
from fg_orient.formats.isd import (
    body_of,
    constant_turn,
    detector_of,
    distortion_of,
    focal_mm,
    orbit_of,
    pair_of,
    turns_of,
)
from fg_orient.formats.isd_lines import read_lines
from fg_orient.formats.json_files import JsonFile
from fg_orient.formats.pvl import Pvl, read_pvl
from fg_orient.formats.registry import Format
from fg_orient.model.errors import InputError
from fg_orient.sensors.focal_plane import Detector
from fg_orient.sensors.framing import FramingCamera, FramingSensor, Taken, angles_of, turn_of
from fg_orient.sensors.general import GeneralPushbroom

#: Name of the format in messages.
FORM: Final = "ISD"
_MODEL: Final = re.compile(rf'"name_model"\s*:\s*"({FRAME_MODEL}|{LINE_SCAN_MODEL})"|"{FRAME_MODEL}"')
LABELS: Final = (".pvl", ".lbl", ".cub")


def read_isd(path: str | Path) -> FramingSensor | GeneralPushbroom:
    """Read an ISD; for a frame also the label in the same folder.

    Raises
    ------
    InputError
        A file cannot be used; the message names the value.
    """
    path = Path(path)
    isd = JsonFile.read(path)
    name = isd.text("name_model")
    if name == LINE_SCAN_MODEL:
        return read_lines(isd)
    if name != FRAME_MODEL:
        known = f"{FRAME_MODEL}, {LINE_SCAN_MODEL}"
        raise InputError.of("isd.model", file=path, place="name_model", value=name, known=known)
    return _read_frame(path, isd)


def _read_frame(path: Path, isd: JsonFile) -> FramingSensor:
    """Read a frame image from its ISD and its label."""
    beside = _label_file(path)
    label = None if beside is None else read_pvl(beside)
    time = isd.number("center_ephemeris_time")
    lines, samples = isd.count("image_lines"), isd.count("image_samples")
    inertial = (constant_turn(isd, "body_rotation") @ _turn(isd, "body_rotation", time)).T
    orbit = orbit_of(isd, time)
    position = orbit.position_m[0] if len(orbit.time_s) == 1 else orbit.at(np.zeros(1))[0, :3]
    turn, mounting = _turn(isd, "instrument_pointing", time), constant_turn(isd, "instrument_pointing")
    distortion, notes = distortion_of(isd)
    detector = _detector(isd, label, (lines, samples))
    focal = focal_mm(isd, mounting @ turn, position)
    try:
        camera = FramingCamera(position, angles_of(turn), mounting, inertial, focal, detector, distortion)
    except InputError as error:
        raise InputError(*(replace(p, file=str(path)) for p in error.problems)) from None
    taken = Taken(isd.text("name_platform", ""), isd.text("name_sensor", ""), _serial(label), FORM)
    return FramingSensor(camera, lines, samples, body_of(isd), taken=taken, file=str(path), notes=notes)


def _label_file(path: Path) -> Path | None:
    """Return the label file of an ISD, if there is one."""
    return next((p for suffix in LABELS if (p := path.with_suffix(suffix)).is_file()), None)


def _group(label: Pvl | None, name: str) -> Pvl | None:
    return None if label is None else next(label.every(name), None)


def _serial(label: Pvl | None) -> str:
    """Return the serial number in the form of ISIS: platform, instrument, start time; "" without a label."""
    own = _group(label, "Instrument")
    if own is None:
        return ""
    parts = (own.text("SpacecraftName", "").replace(" ", ""), own.text("InstrumentId", ""), own.text("StartTime", ""))
    return "/".join(parts) if all(parts) else ""


def _turn(isd: JsonFile, place: str, time: float) -> Array:
    """Return the rotation (3, 3) from inertial axes at the centre time, interpolated between the states."""
    turns = turns_of(isd, place, time)
    values = turns.quaternion if len(turns.time_s) == 1 else turns.at(np.zeros(1))
    return np.asarray(quaternion_matrices(values)[0])


def _detector(isd: JsonFile, label: Pvl | None, size: tuple[int, int]) -> Detector:
    """Return the detector of the ISD; the label states the reduction of the image."""
    summing, start = pair_of(isd, "detector_{}_summing", 1.0), pair_of(isd, "starting_detector_{}", 0.0)
    parent, alpha = np.array(size, float) * summing, _group(label, "AlphaCube")
    if alpha is not None:
        parent = np.array([alpha.number("AlphaLines"), alpha.number("AlphaSamples")]) * summing
        first = np.array([alpha.number("AlphaStartingLine"), alpha.number("AlphaStartingSample")]) - 0.5
        last = np.array([alpha.number("AlphaEndingLine"), alpha.number("AlphaEndingSample")]) - 0.5
        start = start + first * summing
        summing = summing * (last - first) / np.array(size)
    centre = [isd.value(f"detector_center.{axis}", None) for axis in ("line", "sample")]
    stated = parent / 2.0 - 0.5 if None in centre else pair_of(isd, "detector_center.{}")
    return detector_of(isd, stated, summing, start)


def write_isd(path: Path, sensor: Any, correction: Any = None) -> dict[str, Any]:
    """Write the ISD of an image with adjusted position and attitude, and its label in the same folder.

    ``correction`` (6,) comes from an adjustment. The file has one state at its centre
    time. Everything else is unchanged.

    Raises
    ------
    InputError
        The image was not read from an ISD.
    """
    if not (isinstance(sensor, FramingSensor) and sensor.taken.form == FORM):
        raise InputError.of("isd.write (failure): only an image that was read from an ISD is written as one -> write a "
                            "state of CSM instead", file=sensor.file, value=type(sensor).__name__)  # fmt: skip
    source = Path(sensor.file)
    values, camera = JsonFile.read(source).values, sensor.camera.corrected(correction)
    time = [values["center_ephemeris_time"]]
    from scipy.spatial.transform import Rotation  # loaded for these files only

    quaternion = np.roll(Rotation.from_matrix(turn_of(camera.angles_rad)).as_quat(), 1)
    position = {"ephemeris_times": time, "positions": [(camera.position_m / 1e3).tolist()]}
    if "velocities" in values["instrument_position"]:
        position["velocities"] = values["instrument_position"]["velocities"][:1]
    values["instrument_position"] |= position
    values["instrument_pointing"] |= {"ephemeris_times": time, "quaternions": [quaternion.tolist()]}
    write_text(path, json.dumps(values, indent=2) + "\n")
    label = _label_file(source)
    if label is not None and label.suffix != ".cub" and label.parent.absolute() != path.parent.absolute():
        write_text(path.with_suffix(label.suffix), label.read_text("latin-1"))
    return {"label": label is not None, "largest_px": 0.0, "mean_px": 0.0}


FORMAT = Format(
    name="isd",
    title="image support data of ALE (JSON), frame or line scan",
    suffixes=(".isd", ".json"),
    sniff=lambda path, head: head.lstrip().startswith("{") and _MODEL.search(head) is not None,
    read_image=read_isd,
    write_image=write_isd,
)
