"""A second evaluator of CSM line-scan states follows the published field definitions with numpy alone.

Pixels are those of CSM: (0.5, 0.5) is the centre of the first pixel. Nothing of the package is imported.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

State = dict[str, Any]
MODEL = "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL"


def read_state(path: Path) -> State:
    """Read the fields of a state: the name of the model, then JSON."""
    name, _, text = path.read_text(encoding="utf-8").partition("\n")
    state: State = json.loads(text)
    assert name.strip() == state["m_modelName"] == MODEL
    return state


def interpolated(values: np.ndarray, start_s: float, step_s: float, time_s: float) -> np.ndarray:
    """Return the Lagrange polynomial of order 8 through the samples around a time; of order 6, 4, 2 near the ends."""
    n = len(values)
    position = (time_s - start_s) / step_s
    index = min(max(int(np.floor(position)), 0), n - 2)
    half = min(4, index + 1, n - 1 - index)
    nodes = np.arange(index - half + 1, index + half + 1)
    out = np.zeros(values.shape[1])
    for k in nodes:
        others = nodes[nodes != k]
        out += values[k] * np.prod((position - others) / (k - others))
    return out


def rotation(q: np.ndarray) -> np.ndarray:
    """Return the body-fixed axes from camera axes: quaternion x, y, z, w."""
    x, y, z, w = q / np.linalg.norm(q)
    return np.array([
        [x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), -x * x - y * y + z * z + w * w],
    ])  # fmt: skip


def line_time(state: State, line: float) -> float:
    """Return the time of the centre of a line."""
    starts = np.array(state["m_intTimeLines"])
    k = max(int(np.searchsorted(starts, line, side="right")) - 1, 0)
    return float(state["m_intTimeStartTimes"][k] + state["m_intTimes"][k] * (line - starts[k] + 0.5))


def transverse(x: float, y: float, c: np.ndarray) -> np.ndarray:
    """Return measured focal-plane coordinates of ideal ones by polynomials of degree 3."""
    terms = np.array([1.0, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3])
    return np.array([terms @ c[:10], terms @ c[10:]])


def ideal(state: State, xy: np.ndarray) -> np.ndarray:
    """Return the focal-plane coordinates without distortion."""
    c = np.array(state["m_opticalDistCoeffs"])
    if state["m_distortionType"] == 0:
        r = xy @ xy
        return xy * (1.0 - (c[0] + r * (c[1] + r * c[2])))
    assert state["m_distortionType"] == 1
    at = xy.copy()
    for _ in range(30):
        f, h = transverse(*at, c) - xy, 1e-3
        slope = np.stack(
            [
                (transverse(at[0] + h, at[1], c) - transverse(at[0] - h, at[1], c)) / (2 * h),
                (transverse(at[0], at[1] + h, c) - transverse(at[0], at[1] - h, c)) / (2 * h),
            ],
            axis=1,
        )
        step = np.linalg.solve(slope, f)
        at = at - step
        if np.abs(step).max() < 1e-9:
            break
    return at


def ray(state: State, line: float, sample: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the position of the sensor (3,) m and unit viewing direction (3,), body-fixed, of a CSM pixel."""
    assert not np.any(state["m_currentParameterValue"])
    time_s = line_time(state, line)
    centre = interpolated(np.reshape(state["m_positions"], (-1, 3)), state["m_t0Ephem"], state["m_dtEphem"], time_s)
    q = interpolated(np.reshape(state["m_quaternions"], (-1, 4)), state["m_t0Quat"], state["m_dtQuat"], time_s)
    # the line of the detector is always its first: the image line is in the time
    detector = np.array([
        state["m_startingDetectorLine"],
        sample * state["m_detectorSampleSumming"] + state["m_startingDetectorSample"],
    ])  # fmt: skip
    lines, samples = state["m_iTransL"], state["m_iTransS"]
    t = detector - [state["m_detectorLineOrigin"] + lines[0], state["m_detectorSampleOrigin"] + samples[0]]
    xy = ideal(state, np.linalg.solve(np.array([lines[1:], samples[1:]]), t))
    look = np.array([xy[0] * state["m_zDirection"], xy[1] * state["m_zDirection"], state["m_focalLength"]])
    direction = rotation(q) @ look
    return centre, direction / np.linalg.norm(direction)


def to_ground(state: State, line: float, sample: float, height_m: float) -> np.ndarray:
    """Return the ground point (3,) m of a CSM pixel on the ellipsoid of the state, its axes raised by a height."""
    p, u = ray(state, line, sample)
    axes = np.array([state["m_majorAxis"], state["m_majorAxis"], state["m_minorAxis"]]) + height_m
    a, b, c = (u / axes) @ (u / axes), (u / axes) @ (p / axes), (p / axes) @ (p / axes) - 1.0
    return p + (-b - np.sqrt(b * b - a * c)) / a * u


def to_image(state: State, ground: np.ndarray) -> tuple[float, float]:
    """Return the CSM line and sample of a ground point (3,) m: Newton on the angle between ray and point."""
    pixel = np.array([0.5 * state["m_nLines"], 0.5 * state["m_nSamples"]])

    def miss(at: np.ndarray) -> np.ndarray:
        p, u = ray(state, *at)
        d = (ground - p) / np.linalg.norm(ground - p)
        return np.cross(u, d)

    for _ in range(40):
        f = miss(pixel)
        slope = np.stack([(miss(pixel + h) - miss(pixel - h)) / 2.0 for h in np.eye(2)], axis=1)
        step = np.linalg.lstsq(slope, f, rcond=None)[0]
        pixel = pixel - step
        if np.abs(step).max() < 1e-9:
            break
    return float(pixel[0]), float(pixel[1])
