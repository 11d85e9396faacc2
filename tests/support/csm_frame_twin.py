"""An evaluator of CSM frame states follows the published definitions of the fields without ``fg_orient``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


class State:
    """A frame state of USGSCSM."""

    def __init__(self, path: Path) -> None:
        name, _, body = path.read_text().partition("\n")
        assert name == "USGS_ASTRO_FRAME_SENSOR_MODEL"
        self.s = json.loads(body)
        x, y, z, w = self.s["m_currentParameterValue"][3:]
        #: Columns are the axes of the camera in body-fixed axes.
        self.m = np.array([
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (w * y + x * z)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]) / (x * x + y * y + z * z + w * w)  # fmt: skip

    def undistorted(self, x: float, y: float) -> tuple[float, float]:
        """Return the ideal coordinates, mm."""
        c = self.s["m_opticalDistCoeffs"]
        kind = self.s["m_distortionType"]
        if kind == 0:
            r = x * x + y * y
            d = c[0] + r * (c[1] + r * c[2])
            return x * (1 - d), y * (1 - d)
        u, v = x, y
        for _ in range(50):  # a fixed point: distortion is small
            du, dv = self._transverse(u, v) if kind == 1 else self._brown(u, v)
            u, v = u + x - du, v + y - dv
        return u, v

    def _transverse(self, x: float, y: float) -> tuple[float, float]:
        c = self.s["m_opticalDistCoeffs"]
        f = [1, x, y, x * x, x * y, y * y, x * x * x, x * x * y, x * y * y, y * y * y]
        return sum(c[i] * f[i] for i in range(10)), sum(c[10 + i] * f[i] for i in range(10))

    def _brown(self, x: float, y: float) -> tuple[float, float]:
        """Return the distortion of type 7: k1, k2, p1, p2, k3 as in OpenCV, in units of the focal length."""
        f = self.s["m_focalLength"]
        k1, k2, p1, p2, k3 = self.s["m_opticalDistCoeffs"]
        a, b = x / f, y / f
        r2 = a * a + b * b
        k = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        return (
            f * (a * k + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)),
            f * (b * k + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b),
        )

    def distorted(self, x: float, y: float) -> tuple[float, float]:
        """Return measured coordinates in mm."""
        if self.s["m_distortionType"] == 1:
            return self._transverse(x, y)
        if self.s["m_distortionType"] == 7:
            return self._brown(x, y)
        u, v = x, y
        for _ in range(100):
            du, dv = self.undistorted(u, v)
            u, v = u + x - du, v + y - dv
        return u, v

    def pixel(self, ground: Array) -> Array:
        """Return the line and sample of CSM (0.5 at the centre of the first pixel) of a body-fixed point, m."""
        q = self.m.T @ (ground - np.array(self.s["m_currentParameterValue"][:3]))
        f = self.s["m_focalLength"]
        x, y = self.distorted(f * q[0] / q[2] + self.s["m_samplePp"], f * q[1] / q[2] + self.s["m_linePp"])
        out = []
        for axis, centre in (("L", self.s["m_ccdCenter"][0]), ("S", self.s["m_ccdCenter"][1])):
            t = self.s[f"m_iTrans{axis}"]
            word = "Line" if axis == "L" else "Sample"
            detector = centre + t[0] + t[1] * x + t[2] * y
            out.append((detector - self.s[f"m_startingDetector{word}"]) / self.s[f"m_detector{word}Summing"])
        return np.array(out)
