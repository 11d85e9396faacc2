"""Circular pass over a ground point, in the Earth-fixed frame.

The orbit is a circle in a fixed plane in inertial space. The inertial axes coincide with the Earth-fixed axes at the
time of the scene centre, so no sidereal time is needed; ``w`` is the Earth's rotation rate::

    p(t) = r(t) (cos u, cos i sin u, sin i sin u) turned by the node,   u(t) = u_c + n t
    r(t) = r_0 + v_r t,   n = sqrt(GM / r_0^3)
    P(t) = Rz(w t) p(t),   V(t) = Rz(w t) (dp/dt - w x p)

with t in seconds from the scene centre and Rz the passive rotation [[c, s, 0], [-s, c, 0], [0, 0, 1]].
``v_r`` is a radial velocity, as in real ephemerides (SPOT 5: 7 to 9 m/s). Position and velocity are then consistent,
but the motion is not a Kepler motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors._contract import Array
from factors.geometry import rotations

GM_M3_S2 = 3.986004418e14
EARTH_RATE_RAD_S = 7.2921151467e-5
MEAN_EARTH_RADIUS_M = 6371e3
#: SPOT 5 (Terlemezoğlu 2019, chapter 4.2).
HEIGHT_M = 832e3
INCLINATION_RAD = math.radians(98.7)

_NEWTON_STEPS = 20
_NEWTON_TOLERANCE_RAD = 1e-13


@dataclass(frozen=True)
class CircularPass:
    """Pass of a satellite; times count from the scene centre.

    Parameters
    ----------
    radius_m : float
        Distance from the geocentre at the scene centre.
    inclination_rad, node_rad : float
        Inclination and longitude of the ascending node, in the axes that are Earth-fixed at time 0.
    latitude_argument_rad : float
        Angle from the ascending node at time 0; between 90 and 270 degrees on a descending pass.
    radial_velocity_m_s : float
        Rate of the distance.
    """

    radius_m: float
    inclination_rad: float
    node_rad: float
    latitude_argument_rad: float
    radial_velocity_m_s: float = 0.0

    def states(self, time_s: npt.ArrayLike) -> tuple[Array, Array]:
        """Positions (N, 3) m and Earth-fixed velocities (N, 3) m/s, ECEF, at N times (s)."""
        t = np.atleast_1d(np.asarray(time_s, float))
        rate = math.sqrt(GM_M3_S2 / self.radius_m**3)
        u = self.latitude_argument_rad + rate * t
        r = self.radius_m + self.radial_velocity_m_s * t
        radial, along = self._in_plane(np.cos(u), np.sin(u)), self._in_plane(-np.sin(u), np.cos(u))
        position = r[:, None] * radial
        velocity = self.radial_velocity_m_s * radial + (r * rate)[:, None] * along
        velocity = velocity - np.cross([0.0, 0.0, EARTH_RATE_RAD_S], position)
        return _turned(position, EARTH_RATE_RAD_S * t), _turned(velocity, EARTH_RATE_RAD_S * t)

    def _in_plane(self, first: Array, second: Array) -> Array:
        """Vectors of the orbital plane from components towards the node and 90 degrees ahead."""
        ci, si = math.cos(self.inclination_rad), math.sin(self.inclination_rad)
        cn, sn = math.cos(self.node_rad), math.sin(self.node_rad)
        y = ci * second
        return np.stack([cn * first - sn * y, sn * first + cn * y, si * second], axis=1)


def _turned(vectors: Array, angle_rad: Array) -> Array:
    """Components (N, 3) in axes rotated by N angles about Z."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = vectors.T
    return np.stack([c * x + s * y, c * y - s * x, z], axis=1)


def find_pass(
    target_m: Array,
    psi_y_rad: float,
    *,
    attitude_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
    radial_velocity_m_s: float = 0.0,
    height_m: float = HEIGHT_M,
) -> CircularPass:
    """Find the descending SPOT-like pass whose look direction meets a ground point at time 0.

    Parameters
    ----------
    target_m : (3,) array
        Ground point, ECEF.
    psi_y_rad : float
        Look angle across track to the point (psi_x is 0); negative: to the right of the flight direction.
    attitude_rad : (roll, pitch, yaw)
        Attitude in the orbital frame of convention B, full rotations.
    radial_velocity_m_s : float
        Rate of the distance from the geocentre.
    height_m : float
        Height of the orbit above the mean Earth radius.

    Returns
    -------
    CircularPass
        By Newton's method for node and argument of latitude, to 1e-13 rad (0.7 micrometre in orbit).

    Raises
    ------
    ValueError
        No such pass: the point is outside the orbit's latitudes or below the horizon.
    """
    x, motion = _start(target_m), (radial_velocity_m_s, height_m)
    for _ in range(_NEWTON_STEPS):
        f, jacobian = _pointing(_pass(x, *motion), target_m, psi_y_rad, attitude_rad), np.empty((2, 2))
        for k in range(2):
            shift = 1e-6 * np.eye(2)[k]
            ends = [_pass(x + s * shift, *motion) for s in (1, -1)]
            pair = [_pointing(end, target_m, psi_y_rad, attitude_rad) for end in ends]
            jacobian[:, k] = (pair[0] - pair[1]) / 2e-6
        step = np.linalg.solve(jacobian, -f)
        x = x + step
        if not np.isfinite(x).all():
            break
        if np.abs(step).max() < _NEWTON_TOLERANCE_RAD:
            return _pass(x, *motion)
    raise ValueError(f"no descending pass sees the point {target_m} with psi_y = {psi_y_rad} rad")


def _pass(x: Array, radial_velocity_m_s: float, height_m: float) -> CircularPass:
    radius = MEAN_EARTH_RADIUS_M + height_m
    return CircularPass(radius, INCLINATION_RAD, float(x[0]), float(x[1]), radial_velocity_m_s)


def _start(target_m: Array) -> Array:
    """Node and argument of latitude of the descending pass right above the point."""
    ratio = target_m[2] / np.linalg.norm(target_m) / math.sin(INCLINATION_RAD)
    if abs(ratio) >= 1.0:
        raise ValueError(f"the point {target_m} lies beyond the latitudes of the orbit")
    u = math.pi - math.asin(ratio)
    ahead = math.atan2(math.cos(INCLINATION_RAD) * math.sin(u), math.cos(u))
    return np.array([math.atan2(target_m[1], target_m[0]) - ahead, u])


def _pointing(
    orbit: CircularPass, target_m: Array, psi_y_rad: float, attitude_rad: tuple[float, float, float]
) -> Array:
    """Conditions (2,) of the point at time 0: zero for the look angles psi_y, psi_x = 0 (docs/equations.md 3)."""
    position, velocity = orbit.states(0.0)
    ecef_from_orbital = rotations.orbital_frames(position, velocity)[0]
    ecef_from_body = ecef_from_orbital @ rotations.attitude_matrices(np.array([attitude_rad]), False)[0]
    w = ecef_from_body.T @ (target_m - position[0])
    return np.array([w[0] / w[2] - math.tan(psi_y_rad), w[1] / w[2]])
