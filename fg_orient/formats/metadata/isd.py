"""Read frame images from image support data (ISD) of ALE: JSON with ``USGS_ASTRO_FRAME_SENSOR_MODEL``.

An ISD contains positions (km) and rotations in an inertial frame, and the rotation of the
body. Rotations are quaternions (scalar first), followed by constant rotations. The ISD
also contains the focal length (mm), the affine map of the detector, summing and
distortion. If there are states at several times, they are interpolated at the centre
time: positions by a cubic Hermite spline, rotations by spherical linear interpolation.

An ISIS label with the same name (``.pvl`` or ``.lbl``) in the same folder completes the
ISD. Its group ``AlphaCube`` contains the reduction of the image, and ``Instrument`` the
serial number. If ``optical_distortion`` is zero, the distortion of metric cameras is read
from ``naif_keywords`` (``OD_K``, ``DECENTER``, ``PP``). If a detector has no stated
centre, its coordinates begin in the middle of the scan. The direction of the body
determines the sign of the focal length, because some cameras look along their negative
third axis.
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
from fg_orient.formats.csm import FRAME_MODEL
from fg_orient.formats.json_files import JsonFile
from fg_orient.formats.pvl import Pvl, read_pvl
from fg_orient.formats.registry import Format
from fg_orient.geodesy.bodies import Body, is_earth, known_bodies, spheroid
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.focal_plane import Detector, Distortion
from fg_orient.sensors.framing import FramingCamera, FramingSensor, Taken, angles_of, turn_of

#: Name of the format in messages.
FORM: Final = "ISD"
LABELS: Final = (".pvl", ".lbl", ".cub")
#: If there is only one state, its time may differ from the centre time by at most this, s.
NEAR_S: Final = 0.1
#: Names of distortions in an ISD, and the corresponding models of ``focal_plane``.
_DISTORTION: Final = {"radial": "radial", "transverse": "transverse"}


def read_isd(path: str | Path) -> FramingSensor:
    """Read an ISD and the label in the same folder.

    Raises
    ------
    InputError
        A file cannot be used; the message names the value.
    """
    path = Path(path)
    isd, beside = JsonFile.read(path), _label_file(path)
    label = None if beside is None else read_pvl(beside)
    if isd.text("name_model") != FRAME_MODEL:
        raise InputError.of("isd.model", file=path, place="name_model", value=isd.text("name_model"), known=FRAME_MODEL)
    time = isd.number("center_ephemeris_time")
    lines, samples = isd.count("image_lines"), isd.count("image_samples")
    inertial = (_constant(isd, "body_rotation") @ _turn(isd, "body_rotation", time)).T
    position = 1e3 * _position(isd, time)
    turn, mounting = _turn(isd, "instrument_pointing", time), _constant(isd, "instrument_pointing")
    distortion, notes = _distortion(isd)
    detector = _detector(isd, label, (lines, samples))
    focal = _focal(isd, mounting @ turn, position)
    try:
        camera = FramingCamera(position, angles_of(turn), mounting, inertial, focal, detector, distortion)
    except InputError as error:
        raise InputError(*(replace(p, file=str(path)) for p in error.problems)) from None
    taken = Taken(isd.text("name_platform", ""), isd.text("name_sensor", ""), _serial(label), FORM)
    return FramingSensor(camera, lines, samples, _body(isd), taken=taken, file=str(path), notes=notes)


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


def _state(isd: JsonFile, place: str, time: float, key: str, width: int) -> tuple[Array, Array]:
    """Read times (n,) and values (n, width) of the states.

    The centre time must lie between the first and the last.
    """
    values = isd.numbers(f"{place}.{key}", -1, width)
    times = isd.numbers(f"{place}.ephemeris_times", len(values))
    near = NEAR_S if len(times) == 1 else 0.0
    if (np.diff(times) <= 0.0).any() or not times[0] - near <= time <= times[-1] + near:
        raise InputError.of("isd.times", file=isd.path, place=f"{place}.ephemeris_times",
                            value=f"{times[0]:.6f} .. {times[-1]:.6f}", time=time)  # fmt: skip
    return times, values


def _position(isd: JsonFile, time: float) -> Array:
    """Return the position (3,), km, at the centre time."""
    times, values = _state(isd, "instrument_position", time, "positions", 3)
    if len(times) == 1:
        return np.asarray(values[0])
    velocities = isd.numbers("instrument_position.velocities", len(times), 3)
    from scipy.interpolate import CubicHermiteSpline  # loaded for these files only

    return np.asarray(CubicHermiteSpline(times, values, velocities)(time))


def _turn(isd: JsonFile, place: str, time: float) -> Array:
    """Return the rotation (3, 3) from inertial axes at the centre time, interpolated between the states."""
    times, values = _state(isd, place, time, "quaternions", 4)
    if (np.abs(np.linalg.norm(values, axis=1) - 1.0) > 1e-6).any():
        raise InputError.of("earth.quaternion", file=isd.path, place=f"{place}.quaternions")
    if len(times) == 1:
        return np.asarray(quaternion_matrices(values)[0])
    from scipy.spatial.transform import Rotation, Slerp  # loaded for these files only

    return np.asarray(Slerp(times, Rotation.from_quat(np.roll(values, -1, axis=1)))(time).as_matrix())


def _constant(isd: JsonFile, place: str) -> Array:
    """Return the constant rotation (3, 3) that follows the rotation of the states."""
    return np.reshape(isd.numbers(f"{place}.constant_rotation", 9, default=np.eye(3).ravel()), (3, 3))


def _body(isd: JsonFile) -> Body | None:
    """Return the body with the radii of the ISD, None for the Earth.

    The names of keywords contain its NAIF code.
    """
    unit = {"km": 1e3, "m": 1.0}.get(isd.text("radii.unit", "km"))
    if unit is None:
        raise InputError.of("isd.unit", file=isd.path, place="radii.unit", value=isd.text("radii.unit"))
    major, minor = (unit * isd.number(f"radii.{name}") for name in ("semimajor", "semiminor"))
    if is_earth(major, minor):
        return None
    keys = isd.value("naif_keywords", {})
    found = next((m for key in keys if (m := re.fullmatch(r"BODY(\d+)_RADII", str(key)))), None)
    begin = f"IAU_2015:{found[1]}" if found else "none"
    name = next((name for name, own in known_bodies().items() if own[:-2] == begin), "body")
    return spheroid(name.title(), major, minor, file=isd.path, place="radii")


def _keyword(isd: JsonFile, name: str, count: int) -> Array | None:
    """Return the numbers of the NAIF keyword with this ending."""
    keys = isd.value("naif_keywords", {})
    found = next((key for key in keys if re.fullmatch(rf"INS-?\d+_{name}", str(key))), None)
    if found is None:
        return None
    return isd.numbers(f"naif_keywords.{found}", count)


def _distortion(isd: JsonFile) -> tuple[Distortion, tuple[Finding, ...]]:
    """Return the distortion of the ISD.

    If it is zero, the distortion of a metric camera in the NAIF keywords.
    """
    stated: Any = isd.value("optical_distortion", {})
    if not isinstance(stated, dict) or len(stated) > 1:
        raise InputError.of("isd.distortion", file=isd.path, place="optical_distortion", value=repr(stated)[:60],
                            known=", ".join(_DISTORTION))  # fmt: skip
    kind = next(iter(stated), "")
    if kind and kind not in _DISTORTION:
        raise InputError.of("isd.distortion", file=isd.path, place="optical_distortion", value=kind,
                            known=", ".join(_DISTORTION))  # fmt: skip
    if kind == "transverse":
        place = "optical_distortion.transverse"
        return Distortion(kind, (*isd.numbers(f"{place}.x", 10), *isd.numbers(f"{place}.y", 10))), ()
    c = isd.numbers("optical_distortion.radial.coefficients", 3, default=[0.0] * 3)
    if c.any():
        return Distortion("radial", tuple(c.tolist())), ()
    radial, decentring, principal = (
        _keyword(isd, name, n) for name, n in (("OD_K", 3), ("DECENTER", 3), ("PP", 2))
    )  # fmt: skip
    if radial is None or decentring is None or principal is None:
        return Distortion(), ()
    note = finding("isd.metric", file=isd.path, place="naif_keywords")
    return Distortion("metric", (*principal.tolist(), *radial.tolist(), *decentring.tolist())), (note,)


def _detector(isd: JsonFile, label: Pvl | None, size: tuple[int, int]) -> Detector:
    """Return the detector of the ISD; the label states the reduction of the image."""
    summing = np.array([isd.number(f"detector_{axis}_summing", 1.0) for axis in ("line", "sample")])
    start = np.array([isd.number(f"starting_detector_{axis}", 0.0) for axis in ("line", "sample")])
    parent, alpha = np.array(size, float) * summing, _group(label, "AlphaCube")
    if alpha is not None:
        parent = np.array([alpha.number("AlphaLines"), alpha.number("AlphaSamples")]) * summing
        first = np.array([alpha.number("AlphaStartingLine"), alpha.number("AlphaStartingSample")]) - 0.5
        last = np.array([alpha.number("AlphaEndingLine"), alpha.number("AlphaEndingSample")]) - 0.5
        start = start + first * summing
        summing = summing * (last - first) / np.array(size)
    centre = [isd.value(f"detector_center.{axis}", None) for axis in ("line", "sample")]
    stated = parent / 2.0 - 0.5 if None in centre else np.array([isd.number(f"detector_center.{a}") for a in _AXES])
    lines, samples = (isd.numbers(f"focal2pixel_{axis}", 3) for axis in ("lines", "samples"))
    if abs(np.linalg.det([lines[1:], samples[1:]])) < 1e-12 or not (summing > 0.0).all():
        raise InputError.of("isd.detector", file=isd.path, place="focal2pixel_lines, focal2pixel_samples",
                            value=f"{lines[1:].tolist()}, {samples[1:].tolist()}")  # fmt: skip
    return Detector(_two(stated), _three(lines), _three(samples), _two(summing), _two(start))


_AXES: Final = ("line", "sample")


def _two(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _three(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _focal(isd: JsonFile, turn: Array, position: Array) -> float:
    """Return the focal length, mm.

    It is negative if the camera looks along its negative third axis.
    """
    focal = abs(isd.number("focal_length_model.focal_length"))
    return focal if turn[2] @ position < 0.0 else -focal


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
    title="image support data of ALE (JSON), frame",
    suffixes=(".isd", ".json"),
    sniff=lambda path, head: head.lstrip().startswith("{") and f'"{FRAME_MODEL}"' in head,
    read_image=read_isd,
    write_image=write_isd,
)
