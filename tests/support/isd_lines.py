"""The module simulates line-scan ISD of ALE and evaluates them by the published definitions with numpy.

Pixels of the evaluator are those of CSM: (0.5, 0.5) is the centre of the first pixel. Nothing of the package is
imported.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Isd = dict[str, Any]
MARS_KM = (3396.19, 3376.20)
RATE_RAD_S = 7.088218e-5


def quaternion(matrix: np.ndarray) -> list[float]:
    """Return the quaternion, scalar first, of a rotation matrix, by its eigenvector of the eigenvalue 1."""
    m = matrix
    k = np.array([
        [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
        [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
        [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
    ])  # fmt: skip
    return np.linalg.eigh(k)[1][:, -1].tolist()  # type: ignore[no-any-return]


def matrix_of(q: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a unit quaternion, scalar first."""
    w, v = q[0], q[1:]
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return (w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross


def turn(axis: int, angle: float) -> np.ndarray:
    """Return the matrix of a rotation of points about an axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[i, i] = out[j, j] = np.cos(angle)
    out[j, i] = np.sin(angle)
    out[i, j] = -out[j, i]
    return out


def simulated(
    pitch_rad: float = 0.0, *, lines: int = 2000, samples: int = 800, backwards: bool = False, ahead_rad: float = 0.0
) -> Isd:
    """Return the ISD of a camera 300 km above Mars.

    It looks forwards by ``pitch_rad`` and is further on its orbit by an angle.
    """
    centre, period = 3.5e8 + 0.25, 1.9e-3
    radius, speed, node = MARS_KM[0] + 300.0, 3.4 / (MARS_KM[0] + 300.0), 0.7
    span = 0.5 * lines * period + 0.5
    times = centre + np.linspace(-span, span, 41)
    positions, velocities, pointing = [], [], []
    for t in times - centre:
        u = 0.4 + ahead_rad + speed * t
        to_orbit = turn(2, node) @ turn(0, 1.45)
        up, along = to_orbit @ [np.cos(u), np.sin(u), 0.0], to_orbit @ [-np.sin(u), np.cos(u), 0.0]
        pitch = pitch_rad + 2e-4 * np.sin(3.0 * t)
        look = along * np.sin(pitch) - up * np.cos(pitch)
        ahead = along * np.cos(pitch) + up * np.sin(pitch)
        camera = turn(2, 1e-4 * t) @ np.stack([np.cross(ahead, look), ahead, look])
        if backwards:  # x and z turned: the camera looks along its third axis backwards
            camera = np.diag([-1.0, 1.0, -1.0]) @ camera
        positions.append((radius * up).tolist())
        velocities.append((radius * speed * along).tolist())
        pointing.append(quaternion(turn(2, 0.3) @ camera))
    body_times = centre + np.linspace(-span, span, 3)
    body = [quaternion(turn(2, -(1.1 + RATE_RAD_S * (t - centre)))) for t in body_times]
    return {
        "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL", "image_lines": lines, "image_samples": samples,
        "name_platform": "MARS_ORBITER", "name_sensor": "LINE CAMERA", "center_ephemeris_time": centre,
        "starting_ephemeris_time": centre - 0.5 * lines * period, "interpolation_method": "lagrange",
        "line_scan_rate": [[0.5, -0.5 * lines * period, period],
                           [0.5 + lines // 2, 0.0, 1.1 * period]],
        "radii": {"semimajor": MARS_KM[0], "semiminor": MARS_KM[1], "unit": "km"},
        "instrument_position": {"ephemeris_times": times.tolist(), "positions": positions, "velocities": velocities,
                                "reference_frame": 1},
        "instrument_pointing": {"ephemeris_times": times.tolist(), "quaternions": pointing, "reference_frame": 1,
                                "constant_rotation": turn(2, -0.3).ravel().tolist()},
        "body_rotation": {"ephemeris_times": body_times.tolist(), "quaternions": body, "reference_frame": 1,
                          "constant_rotation": turn(2, -0.2).ravel().tolist()},
        "naif_keywords": {"BODY499_RADII": [MARS_KM[0], MARS_KM[0], MARS_KM[1]]},
        "focal_length_model": {"focal_length": 350.0}, "detector_center": {"line": 0.0, "sample": 410.0},
        "detector_sample_summing": 1, "detector_line_summing": 1, "starting_detector_line": 0,
        "starting_detector_sample": 0, "focal2pixel_lines": [0.0, 0.0, 140.0], "focal2pixel_samples": [0.0, 140.0, 0.0],
        "optical_distortion": {"radial": {"coefficients": [1e-4, -2e-6, 3e-9]}},
    }  # fmt: skip


def slerp(isd: Isd, place: str, time: float) -> np.ndarray:
    """Return the rotation matrix at a time from the centre.

    It goes the shortest way between neighbours, then the constant rotation follows.
    """
    own = isd[place]
    times, q = np.array(own["ephemeris_times"]) - isd["center_ephemeris_time"], np.array(own["quaternions"])
    k = min(max(int(np.searchsorted(times, time)) - 1, 0), len(times) - 2)
    a, b = q[k], q[k + 1] * (1.0 if q[k] @ q[k + 1] > 0.0 else -1.0)
    angle, part = np.arccos(min(a @ b, 1.0)), (time - times[k]) / (times[k + 1] - times[k])
    if angle > 1e-7:
        value = (np.sin((1.0 - part) * angle) * a + np.sin(part * angle) * b) / np.sin(angle)
    else:
        value = (1.0 - part) * a + part * b
    return np.reshape(own["constant_rotation"], (3, 3)) @ matrix_of(value / np.linalg.norm(value))


def position(isd: Isd, time: float) -> np.ndarray:
    """Return the position (3,) km at a time from the centre by Hermite's polynomial of degree 3."""
    own = isd["instrument_position"]
    times, p, v = (np.array(own[name]) for name in ("ephemeris_times", "positions", "velocities"))
    times = times - isd["center_ephemeris_time"]  # exact; times since 2000 are rounded to 6e-8 s
    k = min(max(int(np.searchsorted(times, time)) - 1, 0), len(times) - 2)
    h = times[k + 1] - times[k]
    s = (time - times[k]) / h
    return np.asarray(
        (1 + 2 * s) * (1 - s) ** 2 * p[k] + s * (1 - s) ** 2 * h * v[k] + s**2 * (3 - 2 * s) * p[k + 1]
        + s**2 * (s - 1) * h * v[k + 1]
    )  # fmt: skip


def ideal(isd: Isd, x: float, y: float) -> tuple[float, float]:
    """Return the coordinates without distortion, mm."""
    ((kind, own),) = isd["optical_distortion"].items()
    if kind == "radial":
        c, r = own["coefficients"], x * x + y * y
        scale = 1.0 - (c[0] + c[1] * r + c[2] * r * r)
        return x * scale, y * scale

    def measured(a: float, b: float) -> tuple[float, float]:
        if kind == "transverse":
            f = [1.0, a, b, a * a, a * b, b * b, a**3, a * a * b, a * b * b, b**3]
            return float(np.dot(own["x"], f)), float(np.dot(own["y"], f))
        focal = isd["focal_length_model"]["focal_length"]
        k1, k2, p1, p2, k3 = own["coefficients"]
        a, b = a / focal, b / focal
        r = a * a + b * b
        k = 1.0 + k1 * r + k2 * r * r + k3 * r**3
        return (focal * (a * k + 2.0 * p1 * a * b + p2 * (r + 2.0 * a * a)),
                focal * (b * k + 2.0 * p2 * a * b + p1 * (r + 2.0 * b * b)))  # fmt: skip

    u, v = x, y
    for _ in range(200):  # a fixed point: distortion is small
        a, b = measured(u, v)
        u, v = u + x - a, v + y - b
    return u, v


def to_ground(isd: Isd, line: float, sample: float) -> np.ndarray:
    """Return the body-fixed point (3,) m of a CSM pixel on the ellipsoid."""
    rates = np.array(isd["line_scan_rate"])
    k = max(int(np.searchsorted(rates[:, 0], line, side="right")) - 1, 0)
    time = rates[k, 1] + rates[k, 2] * (line - rates[k, 0] + 0.5)
    lines, samples = isd["focal2pixel_lines"], isd["focal2pixel_samples"]
    t = np.array([
        isd["starting_detector_line"] - isd["detector_center"]["line"] - lines[0],
        sample * isd["detector_sample_summing"] + isd["starting_detector_sample"] - isd["detector_center"]["sample"]
        - samples[0],
    ])  # fmt: skip
    xy = ideal(isd, *np.linalg.solve(np.array([lines[1:], samples[1:]]), t))
    pointing, body = slerp(isd, "instrument_pointing", time), slerp(isd, "body_rotation", time)
    at = position(isd, time)
    sign = 1.0 if pointing[2] @ at < 0.0 else -1.0  # the body lies before or behind the third axis
    look = body @ pointing.T @ [xy[0], xy[1], sign * isd["focal_length_model"]["focal_length"]]
    p, u = 1e3 * body @ at, look / np.linalg.norm(look)
    axes = 1e3 * np.array([MARS_KM[0], MARS_KM[0], MARS_KM[1]])
    a, b, c = (u / axes) @ (u / axes), (u / axes) @ (p / axes), (p / axes) @ (p / axes) - 1.0
    return p + (-b - np.sqrt(b * b - a * c)) / a * u
