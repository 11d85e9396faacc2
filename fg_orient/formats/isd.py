"""Read the parts of image support data (ISD) of ALE that frame and line-scan images have in common."""

from __future__ import annotations

import re
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.json_files import JsonFile
from fg_orient.geodesy.bodies import Body, is_earth, known_bodies, spheroid
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.focal_plane import Detector, Distortion
from fg_orient.sensors.frame import ORTHONORMAL, away_from_rotation, not_a_rotation
from fg_orient.sensors.metadata import Ephemeris, QuaternionList

#: If there is only one state, its time may differ from the centre time by at most this, s.
NEAR_S: Final = 0.1
#: Largest plausible coordinate and velocity in inertial axes, km and km/s.
FAR_KM: Final = 1e10
FAST_KM_S: Final = 1e4
#: Distortions of an ISD: names of USGSCSM and of ``focal_plane``.
_DISTORTIONS: Final = ("radial", "transverse", "radtan")


def orbit_of(isd: JsonFile, time: float) -> Ephemeris:
    """Read positions (m) and velocities in inertial axes; times count from ``time``, which must lie among them."""
    times, km = _states(isd, "instrument_position", time, "positions", 3)
    velocity = isd.numbers("instrument_position.velocities", len(times), 3) if len(times) > 1 else np.zeros((1, 3))
    for name, values, most in (("positions", km, FAR_KM), ("velocities", velocity, FAST_KM_S)):
        largest = float(np.abs(values).max())
        if largest > most:
            raise InputError.of("isd.size", file=isd.path, place=f"instrument_position.{name}", value=f"{largest:g}",
                                most=most)  # fmt: skip
    return Ephemeris(times - time, 1e3 * km, 1e3 * velocity, frame="EME2000", scheme="shortest")


def turns_of(isd: JsonFile, place: str, time: float) -> QuaternionList:
    """Read rotations from inertial axes, without the constant rotation after them; times count from ``time``."""
    times, values = _states(isd, place, time, "quaternions", 4)
    if (np.abs(np.linalg.norm(values, axis=1) - 1.0) > 1e-6).any():
        raise InputError.of("earth.quaternion", file=isd.path, place=f"{place}.quaternions")
    return QuaternionList(times - time, values, frame="EME2000", scheme="shortest")


def _states(isd: JsonFile, place: str, time: float, key: str, width: int) -> tuple[Array, Array]:
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


def constant_turn(isd: JsonFile, place: str) -> Array:
    """Return the constant rotation (3, 3) that follows the states; InputError if it is not a rotation."""
    place = f"{place}.constant_rotation"
    turn = np.reshape(isd.numbers(place, 9, default=np.eye(3).ravel()), (3, 3))
    away = float(away_from_rotation(turn))
    if away > ORTHONORMAL:
        raise InputError.of("frame.camera", file=isd.path, place=place, value=not_a_rotation(away),
                            expected="a rotation")  # fmt: skip
    return turn


def body_of(isd: JsonFile) -> Body | None:
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


def distortion_of(isd: JsonFile) -> tuple[Distortion, tuple[Finding, ...]]:
    """Return the distortion of the ISD.

    If it is zero, the distortion of a metric camera is read from the NAIF keywords.
    """
    stated: Any = isd.value("optical_distortion", {})
    if not isinstance(stated, dict) or len(stated) > 1:
        raise InputError.of("isd.distortion", file=isd.path, place="optical_distortion", value=repr(stated)[:60],
                            known=", ".join(_DISTORTIONS))  # fmt: skip
    kind = next(iter(stated), "")
    if kind and kind not in _DISTORTIONS:
        raise InputError.of("isd.distortion", file=isd.path, place="optical_distortion", value=kind,
                            known=", ".join(_DISTORTIONS))  # fmt: skip
    if kind == "transverse":
        place = "optical_distortion.transverse"
        return Distortion(kind, (*isd.numbers(f"{place}.x", 10), *isd.numbers(f"{place}.y", 10))), ()
    if kind == "radtan":
        own = isd.numbers("optical_distortion.radtan.coefficients", 5)
        return Distortion(kind, (*own, abs(isd.number("focal_length_model.focal_length")))), ()
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


def detector_of(isd: JsonFile, centre: Array, summing: Array, start: Array) -> Detector:
    """Return the detector with a centre, summing and start (2,) of lines and samples; InputError without pixels."""
    lines, samples = (isd.numbers(f"focal2pixel_{axis}", 3) for axis in ("lines", "samples"))
    if abs(np.linalg.det([lines[1:], samples[1:]])) < 1e-12 or not (summing > 0.0).all():
        raise InputError.of("isd.detector", file=isd.path, place="focal2pixel_lines, focal2pixel_samples",
                            value=f"{lines[1:].tolist()}, {samples[1:].tolist()}")  # fmt: skip
    return Detector(_two(centre), _three(lines), _three(samples), _two(summing), _two(start))


def pair_of(isd: JsonFile, name: str, *default: float) -> Array:
    """Read the values (2,) for lines and samples; ``name`` contains {} for the axis."""
    return np.array([isd.number(name.format(axis), *default) for axis in ("line", "sample")])


def _two(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _three(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def focal_mm(isd: JsonFile, turn: Array, position: Array) -> float:
    """Return the focal length, mm.

    The focal length is negative if the camera looks along its negative third axis.
    """
    focal = abs(isd.number("focal_length_model.focal_length"))
    return focal if turn[2] @ position < 0.0 else -focal
