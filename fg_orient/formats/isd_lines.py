"""Read line-scan images from image support data (ISD) of ALE, ``name_model = USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL``.

The file lists positions (km) and pointing in inertial axes, and also the rotation of the body. Positions and velocities
are interpolated by cubic polynomials, rotations by the smallest rotation between neighbours. ``line_scan_rate`` lists
the first line of a segment, its time from ``center_ephemeris_time`` and the time per line; 0.5 is the centre of the
first line. The line of the detector is always its first one. The sensor is the general pushbroom
(``fg_orient.sensors.general``).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from factors.geometry.rotations import quaternion_matrices
from fg_orient.formats.csm import line_directions, line_timing
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
from fg_orient.formats.json_files import JsonFile
from fg_orient.model.errors import InputError
from fg_orient.sensors.general import GeneralPushbroom
from fg_orient.sensors.metadata import BodyRotation, GeneralMetadata, QuaternionList

#: Lists of states of an ISD.
_LISTS: Final = ("instrument_position", "instrument_pointing", "body_rotation")
#: Rotates camera axes that look along the negative third axis to axes that look along the positive
#: third axis.
_HALF_TURN: Final = np.diag([-1.0, 1.0, -1.0])


def read_lines(isd: JsonFile) -> GeneralPushbroom:
    """Line-scan image of an ISD.

    Raises
    ------
    InputError
        A value is missing or impossible.
    OutOfTimeRange
        The lists do not cover the image.
    """
    time, size = isd.number("center_ephemeris_time"), (isd.count("image_lines"), isd.count("image_samples"))
    rate = isd.numbers("line_scan_rate", -1, 3)
    timing = line_timing(*rate.T, file=isd.path, places=("line_scan_rate", "line_scan_rate"))
    orbit, (pointing, body) = orbit_of(isd, time), (turns_of(isd, place, time) for place in _LISTS[1:])
    for place, times in zip(_LISTS, (orbit.time_s, pointing.time_s, body.time_s), strict=True):
        if len(times) < 2:
            raise InputError.of("isd.states", file=isd.path, place=f"{place}.ephemeris_times", value=len(times))
    ends = np.sort(timing.time_s(np.array([0.0, size[0] - 1.0])))
    if ends[0] < body.time_s[0] or ends[1] > body.time_s[-1]:
        raise InputError.of("isd.body_span", file=isd.path, place="body_rotation.ephemeris_times",
                            value=f"{body.time_s[0]:.6f} .. {body.time_s[-1]:.6f} s from the centre", first=ends[0],
                            last=ends[1])  # fmt: skip
    rotation = BodyRotation(body, constant_turn(isd, "body_rotation"))
    constant = constant_turn(isd, "instrument_pointing")
    centre = np.zeros(1)
    focal = focal_mm(isd, constant @ quaternion_matrices(pointing.at(centre))[0], orbit.at(centre)[0, :3])
    if focal == 0.0:
        raise InputError.of("isd.focal", file=isd.path, place="focal_length_model.focal_length", value=focal)
    distortion, notes = distortion_of(isd)
    detector = detector_of(isd, pair_of(isd, "detector_center.{}"), pair_of(isd, "detector_{}_summing", 1.0),
                           pair_of(isd, "starting_detector_{}", 0.0))  # fmt: skip
    sample = np.arange(size[1], dtype=float)
    first_line = np.full(size[1], -0.5)  # line 0 of the detector, also if lines are summed
    x, y = distortion.ideal(detector.millimetres(first_line, sample)).T
    if not np.isfinite(x).all():
        raise InputError.of(
            "frame.no_direction", file=isd.path, place="optical_distortion", value=f"{size[1]} pixel(s)"
        )
    if focal < 0.0:
        x, constant = -x, _HALF_TURN @ constant
    look, mounting = line_directions(x / abs(focal), y / abs(focal))
    conjugate = pointing.quaternion * [1.0, -1.0, -1.0, -1.0]
    return GeneralPushbroom(GeneralMetadata(
        file=str(isd.path), mission=isd.text("name_platform", ""), instrument=isd.text("name_sensor", ""),
        format="ISD", epoch=np.datetime64("1970-01-01", "D"), n_lines=size[0], n_samples=size[1], timing=timing,
        ephemeris=orbit, attitude=QuaternionList(pointing.time_s, conjugate, "EME2000", "shortest"), look=look,
        notes=notes, offset_m=np.zeros(3), mounting=constant.T @ mounting, earth=rotation, body=body_of(isd),
    ))  # fmt: skip
