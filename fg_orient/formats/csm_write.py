"""Write pushbroom images, with their corrections, as line-scan states of the Community Sensor Model (CSM).

Positions and attitudes are sampled in equal time steps. CSM interpolates between the
samples by polynomials. The step is halved until these polynomials agree with the image
within :data:`STATE_PX`. The look angles are converted to a straight detector line with
distortion (``fg_orient.sensors.line_detector``). A state may contain only a band of the
columns. Each band has its own camera: look angles of degree 5 (SPOT 5) need six bands
for 1e-3 px.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from factors.geometry import interpolation
from factors.geometry.interpolation import MAX_SAMPLES, sign_aligned
from fg_orient.formats.atomic import write_text
from fg_orient.formats.csm import LINE_SCAN_MODEL, common_fields, semi_axes
from fg_orient.model.errors import InputError
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.focal_plane import Detector
from fg_orient.sensors.line_detector import COMPARED, LineDetector, fit_detector
from fg_orient.sensors.metadata import QuaternionList, QuaternionPolynomial, SegmentTiming
from fg_orient.sensors.pushbroom import PushbroomSensor

#: Limits of the sampling: largest error of the interpolation, px; first step, s; maximum number of samples.
STATE_PX: Final = 2e-4
FIRST_STEP_S: Final = 0.125
MOST_SAMPLES: Final = 20_000
#: Steps count as equal if they differ by less than this part of a step. Times of the day are rounded.
EQUAL_STEP: Final = 1e-6
#: If the first time is below this limit, s, times are taken as relative to the image. Larger times count from 0 h.
NEAR_S: Final = 1e3
#: Maximum number of steps before the image and after it.
MARGIN: Final = MAX_SAMPLES // 2
#: Rotation from the body axes to axes with x right, y backward, z down.
TURNED: Final = np.diag([1.0, -1.0, -1.0])
_PARAMETERS: Final = 16
#: A state gives these limits for heights above the ellipsoid and depths below it, m.
REACH_M: Final = 10_000.0


def write_state(
    path: Path, sensor: Any, correction: Any = None, columns: tuple[int, int] | None = None
) -> dict[str, Any]:  # fmt: skip
    """Write the state of a pushbroom image, or of a band of its columns.

    Parameters
    ----------
    path : Path
    sensor : PushbroomSensor
    correction : Correction, optional
        From an adjustment.
    columns : (2,) tuple of int, optional
        ``first`` and ``end``: the state describes columns ``first`` to ``end - 1`` of the
        image as a separate image.

    Returns
    -------
    dict
        ``camera_px``: largest differences of the camera along lines and samples; ``step_s``,
        ``states``: sampling of positions and attitudes.

    Raises
    ------
    InputError
        The sensor is not a pushbroom.
    """
    if not isinstance(sensor, PushbroomSensor):
        raise InputError.of("csm.sensor", file=sensor.file, value=type(sensor).__name__)
    c = correction or Correction()
    columns = columns or (0, sensor.n_samples)
    detector = _detector(sensor, c, columns)
    zero_s, times, p, v, q = _sampled(sensor, c, detector)
    fields = _fields(sensor, detector, columns, zero_s, times, p, v, q)
    write_text(path, f"{LINE_SCAN_MODEL}\n{json.dumps(fields, indent=2)}\n")
    step_s = float(times[1] - times[0])
    return {"camera_px": list(detector.largest_px), "step_s": step_s, "states": len(times)}


def _detector(sensor: PushbroomSensor, correction: Correction, columns: tuple[int, int]) -> LineDetector:
    """Fit a detector line to the corrected look angles.

    Detector and look angles are compared at samples over all columns.
    """
    first, end = columns
    sample = np.linspace(first, end - 1.0, min(COMPARED, end - first))
    psi_x, psi_y = sensor.corrected_look(sensor.look_angles(sample), sample, correction)
    return fit_detector(sample, np.stack([-np.tan(psi_y), -np.tan(psi_x)], axis=1), band=end - first < sensor.n_samples)


def _span(sensor: PushbroomSensor) -> tuple[Array, Array]:
    """Return the first and last time of the image, and the first and last time of its lists of states.

    The image is extended by half a line where the lists of states allow it.
    """
    ends = np.array([sensor.first_line - 0.5, sensor.last_line + 0.5])
    image = np.sort(sensor.metadata.timing.time_s(ends))
    lists = [sensor.metadata.ephemeris.time_s]
    if not isinstance(sensor.attitude, QuaternionPolynomial):
        lists.append(sensor.attitude.time_s)
    listed = np.array([max(t[0] for t in lists), min(t[-1] for t in lists)])
    return np.clip(image, *listed), listed


def _own_times(sensor: PushbroomSensor) -> Array:
    """Return the times of the states if positions and attitudes have the same times in equal steps; else empty."""
    orbit, attitude = sensor.metadata.ephemeris, sensor.attitude
    if isinstance(attitude, QuaternionList) and attitude.scheme != "usual":
        step = np.diff(orbit.time_s)
        if np.array_equal(orbit.time_s, attitude.time_s) and np.ptp(step) < EQUAL_STEP * step[0]:
            return orbit.time_s
    return np.zeros(0)


def _sampled(
    sensor: PushbroomSensor, correction: Correction, detector: LineDetector
) -> tuple[float, Array, Array, Array, Array]:
    """Sample the orbit and the attitude of the image in equal steps.

    Returns
    -------
    tuple
        Time that is zero in the state; times (n,), s; positions (n, 3), m; velocities (n, 3),
        m/s; quaternions x, y, z, w (n, 4).
    """
    own = _own_times(sensor)
    if len(own):
        states = _states(sensor, correction, detector, own)
        if _error_px(sensor, correction, detector, own, states) < STATE_PX:
            zero = 0.0 if abs(own[0]) < NEAR_S else float(own[0])
            return zero, own - zero, *states
    image, listed = _span(sensor)
    zero, step = float(np.round(0.5 * image.sum(), 3)), FIRST_STEP_S
    while True:
        before = min(MARGIN, int((image[0] - listed[0]) / step))
        after = min(MARGIN, int((listed[1] - image[1]) / step))
        inner = int(np.ceil((image[1] - image[0]) / step - 1e-9))
        times = np.linspace(image[0] - before * step, image[1] + after * step, before + inner + after + 1)
        states = _states(sensor, correction, detector, times)
        most = len(times) >= MOST_SAMPLES
        if most or _error_px(sensor, correction, detector, times, states) < STATE_PX:
            return zero, times - zero, *states
        step *= 0.5


def _states(
    sensor: PushbroomSensor, correction: Correction, detector: LineDetector, times: Array
) -> tuple[Array, Array, Array]:
    """Return positions, velocities (n, 3) and quaternions (n, 4) of the camera at times (n,) of the metadata."""
    from scipy.spatial.transform import Rotation

    states = sensor.states_at(times, sensor.metadata.timing.line(times))
    p, ecef = sensor.oriented(states, sensor.central_mounting(states), correction)
    v = states.velocity_m_s + correction.eop_at(states.tau)[:, 3:6]
    return p, v, sign_aligned(Rotation.from_matrix(ecef @ TURNED @ detector.rotation).as_quat())


def _error_px(
    sensor: PushbroomSensor, correction: Correction, detector: LineDetector, times: Array,
    states: tuple[Array, Array, Array],
) -> float:  # fmt: skip
    """Return the largest interpolation error of CSM, px.

    The error is tested halfway between the samples in the image.
    """
    image, _ = _span(sensor)
    middle = 0.5 * (times[1:] + times[:-1])
    middle = middle[(middle >= image[0]) & (middle <= image[1])]
    p, _, q = _states(sensor, correction, detector, middle)
    got = interpolation.centred(times, np.hstack([states[0], states[2]]), middle)
    turned = got[:, 3:] / np.linalg.norm(got[:, 3:], axis=1, keepdims=True)
    angle = 2.0 * np.minimum(np.linalg.norm(turned - q, axis=1), np.linalg.norm(turned + q, axis=1))
    height = np.linalg.norm(p, axis=1) - semi_axes(sensor)[0]
    return float((angle + np.linalg.norm(got[:, :3] - p, axis=1) / height).max() * detector.focal_px)


def _lines(sensor: PushbroomSensor, zero_s: float) -> dict[str, list[float]]:
    """Return the segments of the line times.

    CSM gives the centre of the first line the number 0.5.
    """
    timing = sensor.metadata.timing
    segments: tuple[Any, ...] = (np.zeros(1), timing.time_s(np.zeros(1)), np.array([timing.line_period_s]))
    if isinstance(timing, SegmentTiming):
        segments = timing.start_line, timing.start_time_s, timing.period_s
    line, time_s, period = segments
    return {
        "m_intTimeLines": (line + 0.5).tolist(), "m_intTimeStartTimes": (time_s - zero_s - 0.5 * period).tolist(),
        "m_intTimes": period.tolist(),
    }  # fmt: skip


def _fields(
    sensor: PushbroomSensor, detector: LineDetector, columns: tuple[int, int], zero_s: float, times: Array, p: Array,
    v: Array, q: Array,
) -> dict[str, Any]:  # fmt: skip
    """Return all fields of a state as written to the JSON file."""
    image, _ = _span(sensor)
    first, n_samples = columns[0], columns[1] - columns[0]
    centre = sensor.locate(0.5 * (sensor.first_line + sensor.last_line), first + 0.5 * (n_samples - 1), height_m=0.0)[0]
    middle = p[len(p) // 2]
    distance = float(np.linalg.norm(middle - centre))
    start, step = float(times[0]), float((times[-1] - times[0]) / (len(times) - 1))
    seen = Detector(
        (0.0, detector.origin_sample + 0.5), (-detector.offset_px, -detector.slope, 1.0), (0.0, detector.sign, 0.0),
        start=(0.0, float(first)),
    )  # fmt: skip
    size = sensor.n_lines, n_samples
    return {
        **common_fields(LINE_SCAN_MODEL, sensor, size, seen, detector.focal_px, detector.distortion, centre, REACH_M),
        "m_sensorName": sensor.metadata.instrument,
        "m_sensorIdentifier": sensor.metadata.instrument, "m_platformIdentifier": sensor.metadata.mission,
        "m_platformFlag": 1, "m_ikCode": 0, **_lines(sensor, zero_s), "m_startingEphemerisTime": 0.0,
        "m_centerEphemerisTime": 0.0, "m_zDirection": 1.0, "m_detectorSampleOrigin": seen.centre[1],
        "m_detectorLineOrigin": seen.centre[0], "m_gsd": distance / detector.focal_px,
        "m_flyingHeight": float(np.linalg.norm(middle) - np.linalg.norm(centre)),
        "m_halfSwath": 0.5 * n_samples * distance / detector.focal_px,
        "m_halfTime": float(0.5 * (image[1] - image[0])), "m_t0Ephem": start, "m_dtEphem": step, "m_t0Quat": start,
        "m_dtQuat": step, "m_numPositions": p.size, "m_numQuaternions": q.size, "m_positions": p.ravel().tolist(),
        "m_velocities": v.ravel().tolist(), "m_quaternions": q.ravel().tolist(),
        "m_currentParameterValue": [0.0] * _PARAMETERS, "m_parameterType": [2] * _PARAMETERS,
        "m_covariance": [0.0] * _PARAMETERS**2, "m_sunVelocity": [0.0, 0.0, 0.0],
    }  # fmt: skip
