"""Common parts of the frame states and line-scan states of the Community Sensor Model (USGSCSM)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from factors.geometry import ellipsoid
from fg_orient.formats.json_files import JsonFile
from fg_orient.formats.registry import read_bytes
from fg_orient.geodesy.bodies import Body, is_earth, spheroid
from fg_orient.model.errors import InputError
from fg_orient.sensors.base import Sensor
from fg_orient.sensors.focal_plane import Detector, Distortion
from fg_orient.sensors.metadata import DirectionTable, LineTiming, SegmentTiming

FRAME_MODEL: Final = "USGS_ASTRO_FRAME_SENSOR_MODEL"
LINE_SCAN_MODEL: Final = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"
#: A state names its distortion model by one of these numbers.
DISTORTIONS: Final = {0: "radial", 1: "transverse", 7: "radtan"}
RADTAN: Final = 7
#: Maximum difference of the norm of a quaternion from 1.
UNIT: Final = 1e-3


def line_directions(x: Array, y: Array) -> tuple[DirectionTable, Array]:
    """Directions of the samples of a detector line, and the rotation (3, 3) from our camera axes to the file's.

    ``x``, ``y`` (n,): lines of sight ``(x, y, 1)`` in the file's camera axes, z to the ground. Our axes are forward,
    left of flight and away from the ground. A detector line along y is also converted to a line across track.
    """
    across_x = np.ptp(x) >= np.ptp(y)
    forward, left = (y, x) if across_x else (x, -y)
    table = DirectionTable(np.arange(len(x), dtype=float), np.ascontiguousarray(forward), np.ascontiguousarray(left))
    along_x = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return table, along_x if across_x else np.diag([1.0, -1.0, -1.0])


def line_timing(
    first_line: Array, start_s: Array, period_s: Array, *, file: Path, places: tuple[str, str]
) -> LineTiming:
    """Return the times of the lines of segments; the file gives line 0 the number 0.5.

    A segment begins half a line before the centre of its first line.
    ``places``: names of the periods and of the lines in the file, for InputError if they are impossible.
    """
    if (period_s == 0.0).any():
        raise InputError.of("earth.period", file=file, place=places[0], value="0")
    if (np.diff(first_line) <= 0.0).any():
        raise InputError.of("earth.order", file=file, place=places[1], value=f"{len(first_line)} values")
    return SegmentTiming.of(first_line - 0.5, start_s + 0.5 * period_s, period_s)


def distortion_fields(distortion: Distortion) -> dict[str, Any]:
    """Return the fields of a distortion (none: radial coefficients of zero); inverse of :func:`distortion_of`."""
    kind = {name: number for number, name in DISTORTIONS.items()}.get(distortion.model, 0)
    c = distortion.coefficients or (0.0, 0.0, 0.0)
    return {"m_distortionType": kind, "m_opticalDistCoeffs": list(c[:-1] if kind == RADTAN else c)}


def semi_axes(sensor: Sensor) -> tuple[float, float]:
    """Return the major and minor semi-axis of the body of an image, m."""
    return (ellipsoid.A_M, ellipsoid.B_M) if sensor.body is None else (sensor.body.radii_m[0], sensor.body.radii_m[2])


def body_of(state: JsonFile) -> Body | None:
    """Return the body to which the axes of a state are fixed; None for the Earth."""
    axes = state.number("m_majorAxis"), state.number("m_minorAxis")
    if is_earth(*axes):
        return None
    name = state.text("m_targetName", "") or "body"  # line-scan states have no name
    return spheroid(name, *axes, file=state.path, place="m_majorAxis, m_minorAxis")


def common_fields(
    model: str, sensor: Sensor, size: tuple[int, int], detector: Detector, focal: float, distortion: Distortion,
    centre_m: Array, reach_m: float,
) -> dict[str, Any]:  # fmt: skip
    """Return the fields that states of both models have.

    Parameters
    ----------
    model : str
    sensor : Sensor
    size : (2,) tuple of int
        Lines and samples.
    detector, focal, distortion : Detector, float, Distortion
        Camera of the state; both models have other fields for the origin of the detector.
    centre_m : (3,) array
        Ground point in the middle, body-fixed.
    reach_m : float
        Largest height, and depth, above the radii.
    """
    major, minor = semi_axes(sensor)
    return {
        "m_modelName": model, "m_imageIdentifier": Path(sensor.file).stem, "m_nLines": size[0], "m_nSamples": size[1],
        "m_majorAxis": major, "m_minorAxis": minor, "m_minElevation": -reach_m, "m_maxElevation": reach_m,
        "m_referencePointXyz": centre_m.tolist(), "m_focalLength": focal, "m_iTransL": list(detector.lines),
        "m_iTransS": list(detector.samples), "m_detectorLineSumming": detector.summing[0],
        "m_detectorSampleSumming": detector.summing[1], "m_startingDetectorLine": detector.start[0],
        "m_startingDetectorSample": detector.start[1], **distortion_fields(distortion),
        "m_sunPosition": [0.0, 0.0, 0.0],
    }  # fmt: skip


def open_state(path: Path, model: str) -> JsonFile:
    """Read the values of a state, which is a JSON object. A line with the name of the model may precede it.

    Raises
    ------
    InputError
        The file cannot be read, or it contains a state of another model.
    """
    state = JsonFile.read(path, skip=0 if read_bytes(path, 200).lstrip()[:1] == b"{" else 1)
    if state.text("m_modelName") != model:
        raise InputError.of("isd.model", file=path, place="m_modelName", value=state.text("m_modelName"), known=model)
    return state


def distortion_of(state: JsonFile) -> Distortion:
    """Return the distortion of a state.

    The coordinates of the distortion ``radtan`` are divided by the focal length of the state.
    InputError: the distortion is not one of :data:`DISTORTIONS`, or its coefficients are impossible.
    """
    kind = int(state.number("m_distortionType", 0))
    if kind not in DISTORTIONS:
        raise InputError.of("isd.distortion", file=state.path, place="m_distortionType", value=kind,
                            known=", ".join(f"{k} ({name})" for k, name in DISTORTIONS.items()))  # fmt: skip
    try:
        c = state.numbers("m_opticalDistCoeffs", -1).tolist()
        return Distortion(DISTORTIONS[kind], (*c, state.number("m_focalLength")) if kind == RADTAN else tuple(c))
    except InputError as error:
        problem = error.problems[0]
        raise InputError.of(problem.code, file=state.path, place="m_opticalDistCoeffs", value=problem.value,
                            **dict(problem.data)) from None  # fmt: skip
