"""Ground to image for hundreds of thousands of points near one scene, to the rounding of the sensor's own projection.

``PushbroomSensor.project`` needs some 25 evaluations of the conditions per point: it starts at the image centre and
forms derivatives by differences at each step. A scene is smooth enough for polynomials of the ground coordinates that
give line and sample within a fraction of a pixel, and the derivatives of the conditions with them. From there the same
conditions are brought to zero with fixed derivatives, two or three evaluations per point. What does not end so is given
to the sensor.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.projection import STEP_PX, conditions, pixel_derivative
from fg_orient.sensors.pushbroom import PushbroomSensor

Array = npt.NDArray[np.float64]

#: Nodes of the fit along line and sample, and its heights; powers East and North together, and of the height.
NODES = 9
HEIGHTS = 3
DEGREE = 5
MAX_STEPS = 10
#: Points this far outside the rectangle of the nodes are outside the image.
BORDER_M = 500.0


class QuickProjection:
    """Polynomials of one sensor with one correction, for heights from 0 to a largest one.

    Parameters
    ----------
    sensor : PushbroomSensor
    correction : Correction
    max_height_m : float
        Ellipsoidal heights of the points, 0 to this; those outside are projected as well, less quickly.
    """

    def __init__(self, sensor: PushbroomSensor, correction: Correction, max_height_m: float) -> None:
        self.sensor, self.correction = sensor, correction
        self._top_m = max(max_height_m, 1.0)
        lon, lat, _ = ecef_to_geodetic(sensor.centre_m)
        self._plane = enu_from_ecef(float(lon[0]), float(lat[0]))[0, :2]
        line, sample, height = (
            grid.ravel()
            for grid in np.meshgrid(
                _nodes(0.0, sensor.n_lines - 1.0, NODES),
                _nodes(sensor.first_sample, sensor.last_sample, NODES),
                _nodes(0.0, self._top_m, HEIGHTS),
                indexing="ij",
            )
        )
        ground = sensor.locate(line, sample, height_m=height, correction=correction)
        east_north = self._east_north(ground)
        self._low, self._high = east_north.min(axis=0), east_north.max(axis=0)
        j = pixel_derivative(sensor, line, sample, ground, correction)
        wanted = np.column_stack([line, sample, np.linalg.inv(j).reshape(-1, 4)])
        terms = self._terms(east_north, height)
        q, r = np.linalg.qr(terms)
        self._coefficients = np.linalg.solve(r, q.T @ wanted)
        difference = np.abs(terms @ self._coefficients - wanted).max(axis=0)
        self.error_px = float(difference[:2].max())
        slopes = np.abs(wanted[:, 2:]).max()
        # of a step with these derivatives, this share is left; the change across error_px is far smaller
        self._rest = max(float(difference[2:].max() / slopes), 1e-7)

    def _east_north(self, ground_m: Array) -> Array:
        """East and North (n, 2) m of ECEF points in the plane at the image centre."""
        return np.asarray((ground_m - self.sensor.centre_m) @ self._plane.T)

    def _terms(self, east_north: Array, height_m: Array) -> Array:
        """Products of powers (n, t), arguments scaled to [-1, 1] inside the image."""
        half = (self._high - self._low) / 2.0
        x, y = ((east_north - self._low) / half - 1.0).T
        h = 2.0 * height_m / self._top_m - 1.0
        powers = [np.vander(a, DEGREE + 1, increasing=True) for a in (x, y)]
        plane = [powers[0][:, a] * powers[1][:, b] for a in range(DEGREE + 1) for b in range(DEGREE + 1 - a)]
        low = [powers[0][:, a] * powers[1][:, b] for a in range(3) for b in range(3 - a)]
        return np.column_stack([*plane, *(h * p for p in low), *(h * h * p for p in low[:1])])

    def near(self, ground_m: Array) -> npt.NDArray[np.intp]:
        """Points (n,) that may lie in the image, out of ECEF points (N, 3) of the same side of the Earth."""
        e = self._east_north(ground_m)
        return np.flatnonzero(((e > self._low - BORDER_M) & (e < self._high + BORDER_M)).all(axis=1))

    def estimate(self, ground_m: Array, height_m: Array) -> Array:
        """Line and sample (n, 2) of the polynomials, ``error_px`` or less away at the nodes."""
        return np.asarray(self._terms(self._east_north(ground_m), height_m) @ self._coefficients[:, :2])

    def project(self, ground_m: Array, height_m: Array) -> Array:
        """Line and sample (n, 2) of ECEF points (n, 3) with ellipsoidal heights (n,) m.

        The zero of the conditions, as ``PushbroomSensor.project`` finds it: both agree to the rounding of a time of
        day (1e-8 px).
        """
        found = self._terms(self._east_north(ground_m), height_m) @ self._coefficients
        pixels, inverse = np.ascontiguousarray(found[:, :2]), found[:, 2:].reshape(-1, 2, 2)
        todo = np.flatnonzero(self.sensor.is_inside(pixels[:, 0], pixels[:, 1]))
        left = np.setdiff1d(np.arange(len(pixels)), todo)
        for _ in range(MAX_STEPS):
            if not len(todo):
                break
            f = conditions(self.sensor, pixels[todo, 0], pixels[todo, 1], ground_m[todo], self.correction)
            step = np.einsum("nij,nj->ni", inverse[todo], f)
            pixels[todo] -= step
            length = np.abs(step).max(axis=1)
            inside = self.sensor.is_inside(pixels[todo, 0], pixels[todo, 1])
            left = np.concatenate([left, todo[~inside]])
            todo = todo[inside & (length * self._rest > STEP_PX)]
        left = np.concatenate([left, todo])
        if len(left):
            pixels[left] = np.stack(self.sensor.project(ground_m[left], self.correction), axis=1)
        return pixels


def _nodes(low: float, high: float, n: int) -> Array:
    """Chebyshev points with the ends: a polynomial through them is good up to the border."""
    return np.asarray(low + (high - low) * (0.5 - 0.5 * np.cos(np.pi * np.arange(n) / (n - 1))))
