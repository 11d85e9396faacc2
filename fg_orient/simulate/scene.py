"""Simulated SPOT-5 HRG scene: circular pass over a ground point, camera, metadata with errors.

The orbit is a circle in a fixed plane in inertial space. The inertial axes coincide with the Earth-fixed axes at the
time of the scene centre, so no sidereal time is needed. With the Earth's rotation rate ``w``::

    p(t) = r(t) (cos u, cos i sin u, sin i sin u) turned by the node,   u(t) = u_c + n t
    r(t) = r_0 + v_r t,   n = sqrt(GM / r_0^3)
    P(t) = Rz(w t) p(t),   V(t) = Rz(w t) (dp/dt - w x p)

with t in seconds from the scene centre and Rz the passive rotation [[c, s, 0], [-s, c, 0], [0, 0, 1]].
``v_r`` is a radial velocity, as in real ephemerides (SPOT 5: 7 to 9 m/s). Position and velocity are then consistent,
but the motion is not a Kepler motion.

The camera of the twin (SPOT-5 HRG) has 12000 detectors of 6.5 micrometres and a focal length of 1.082 m (field 4.13
degrees, pixel 5 m). The mirror turns the line of sight across track::

    psi_y(sample) = mirror + arctan((sample - 5999.5) 6.5e-6 / 1.082),   psi_x = 0

With u1 = (-tan psi_y, tan psi_x, -1) and X to the right of the flight direction, a negative mirror
angle looks to the right (west on a descending pass). Samples increase from right to left (west to
east), as in the real SPOT-5 file.

Errors are polynomials in tau = (line - c)/c, c = (NROWS - 1)/2. The metadata contain *true minus error* at all epochs
of ephemeris and attitude, including those far from the image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.geometry import polynomials, rotations
from fg_orient.formats.dimap1 import straight_line
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.sensors.metadata import (
    AngleAttitude,
    Ephemeris,
    FramePoint,
    LineTiming,
    LookAngleTable,
    PushbroomMetadata,
)
from fg_orient.sensors.pushbroom import PushbroomSensor

GM_M3_S2 = 3.986004418e14
EARTH_RATE_RAD_S = 7.2921151467e-5
MEAN_EARTH_RADIUS_M = 6371e3
#: Orbit and camera of SPOT 5 (Terlemezoğlu 2019, chapter 4.2).
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
        """Return the positions (N, 3) m and Earth-fixed velocities (N, 3) m/s, ECEF, at N times (s)."""
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
        """Return the vectors of the orbital plane from components towards the node and 90 degrees ahead."""
        ci, si = math.cos(self.inclination_rad), math.sin(self.inclination_rad)
        cn, sn = math.cos(self.node_rad), math.sin(self.node_rad)
        y = ci * second
        return np.stack([cn * first - sn * y, sn * first + cn * y, si * second], axis=1)


def _turned(vectors: Array, angle_rad: Array) -> Array:
    """Return the components (N, 3) in axes rotated by N angles about Z."""
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
        Attitude in the orbital frame of convention B, as full rotations.
    radial_velocity_m_s : float
        Rate of the distance from the geocentre.
    height_m : float
        Height of the orbit above the mean Earth radius.

    Returns
    -------
    CircularPass
        Pass, found by Newton's method for node and argument of latitude, to 1e-13 rad (0.7 micrometre in orbit).

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
    """Return the node and argument of latitude of the descending pass right above the point."""
    ratio = target_m[2] / np.linalg.norm(target_m) / math.sin(INCLINATION_RAD)
    if abs(ratio) >= 1.0:
        raise ValueError(f"the point {target_m} lies beyond the latitudes of the orbit")
    u = math.pi - math.asin(ratio)
    ahead = math.atan2(math.cos(INCLINATION_RAD) * math.sin(u), math.cos(u))
    return np.array([math.atan2(target_m[1], target_m[0]) - ahead, u])


def _pointing(
    orbit: CircularPass, target_m: Array, psi_y_rad: float, attitude_rad: tuple[float, float, float]
) -> Array:
    """Return conditions (2,) of point at time 0: zero for the look angles psi_y, psi_x = 0 (docs/equations.md 3)."""
    position, velocity = orbit.states(0.0)
    ecef_from_orbital = rotations.orbital_frames(position, velocity)[0]
    ecef_from_body = ecef_from_orbital @ rotations.attitude_matrices(np.array([attitude_rad]), False)[0]
    w = ecef_from_body.T @ (target_m - position[0])
    return np.array([w[0] / w[2] - math.tan(psi_y_rad), w[1] / w[2]])


N_LINES = 12000
N_SAMPLES = 12000
LINE_PERIOD_S = 0.7521e-3
#: Line of the scene centre, 0-based; SCENE_CENTER_LINE of the real file is 6001.
REFERENCE_LINE = 6000.0
DETECTOR_M = 6.5e-6
FOCAL_LENGTH_M = 1.082
#: Ephemeris on full half minutes: four before, one immediately before, and four after the image.
EPHEMERIS_STEP_S = 30.0
N_EPHEMERIS = 9
ATTITUDE_STEP_S = 0.125
N_ATTITUDES = 233
#: Time from a full half minute to SCENE_CENTER_TIME. With this value all lines are between the same two epochs.
AFTER_HALF_MINUTE_S = 7.332158


@dataclass(frozen=True)
class Scene:
    """True values of one simulated scene.

    Parameters
    ----------
    id : str
        Image id.
    orbit : CircularPass
    mirror_rad : float
        Look angle psi_y of the middle of the line.
    epoch : np.datetime64
        Day of the image.
    half_minutes : int
        Half minutes of the day; the central line was taken 7.332158 s later.
    attitude_rad : (roll, pitch, yaw)
        True attitude, constant.
    full_look_table : bool
        One look-angle row per detector; otherwise only the first and last row, from which the
        reader computes the others (same camera, small files).
    """

    id: str
    orbit: CircularPass
    mirror_rad: float
    epoch: np.datetime64
    half_minutes: int
    attitude_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    full_look_table: bool = True

    @property
    def centre_time_s(self) -> float:
        """Time of the reference line, seconds of the day."""
        return EPHEMERIS_STEP_S * self.half_minutes + AFTER_HALF_MINUTE_S

    @property
    def file(self) -> str:
        """Name of the metadata file."""
        return f"{self.id}.DIM"

    def metadata(self, error: Array | None = None) -> PushbroomMetadata:
        """Return the metadata with an error: true minus the polynomials.

        Parameters
        ----------
        error : (9, 3) array, optional
            c0, c1, c2 of tau of position (m), velocity (m/s), attitude (rad); default none.
        """
        coefficients = np.zeros((9, 3)) if error is None else np.ascontiguousarray(error)
        sample = np.arange(float(N_SAMPLES)) if self.full_look_table else np.array([0.0, N_SAMPLES - 1.0])
        metadata = PushbroomMetadata(
            file=self.file,
            mission="SPOT 5",
            instrument="HRG 1",
            format="DIMAP 1.1",
            epoch=self.epoch,
            n_lines=N_LINES,
            n_samples=N_SAMPLES,
            timing=LineTiming(REFERENCE_LINE, self.centre_time_s, LINE_PERIOD_S),
            ephemeris=self._ephemeris(coefficients),
            attitude=self._attitude(coefficients),
            look=LookAngleTable(sample, np.zeros(len(sample)), camera_psi_y(sample, self.mirror_rad)),
        )
        return replace(metadata, frame_points=_frame_points(as_read(metadata)))

    def _ephemeris(self, error: Array) -> Ephemeris:
        time_s = EPHEMERIS_STEP_S * (self.half_minutes + np.arange(float(N_EPHEMERIS)) - N_EPHEMERIS // 2)
        position, velocity = self.orbit.states(time_s - self.centre_time_s)
        wrong = polynomials.evaluate(error, self._tau(time_s))
        return Ephemeris(time_s, position - wrong[:, 0:3], velocity - wrong[:, 3:6])

    def _attitude(self, error: Array) -> AngleAttitude:
        time_s = math.floor(self.centre_time_s) + ATTITUDE_STEP_S * (np.arange(float(N_ATTITUDES)) - N_ATTITUDES // 2)
        wrong = polynomials.evaluate(error, self._tau(time_s))
        return AngleAttitude(time_s, np.array(self.attitude_rad) - wrong[:, 6:9])

    def _tau(self, time_s: Array) -> Array:
        line = REFERENCE_LINE + (time_s - self.centre_time_s) / LINE_PERIOD_S
        return polynomials.normalised(line, N_LINES)


def camera_psi_y(sample: Array, mirror_rad: float) -> Array:
    """Return the look angles across track (rad) of N samples."""
    return mirror_rad + np.arctan((sample - (N_SAMPLES - 1) / 2) * (DETECTOR_M / FOCAL_LENGTH_M))


def as_read(metadata: PushbroomMetadata) -> PushbroomSensor:
    """Return the sensor as read from the written file: the reader interpolates a look-angle table of two detectors."""
    look = metadata.look
    if isinstance(look, LookAngleTable) and len(look.sample) < metadata.n_samples:
        metadata = replace(metadata, look=straight_line(look.sample, look.psi_x_rad, look.psi_y_rad))
    return PushbroomSensor(metadata)


def _frame_points(sensor: PushbroomSensor) -> tuple[FramePoint, ...]:
    """Return the four corners and the centre at height 0, computed from the metadata."""
    last_line, last_sample = N_LINES - 1.0, N_SAMPLES - 1.0
    line = [0.0, 0.0, last_line, last_line, REFERENCE_LINE]
    sample = [0.0, last_sample, last_sample, 0.0, REFERENCE_LINE]
    lon, lat, _ = ecef_to_geodetic(sensor.locate(line, sample, height_m=0.0))
    names = [*(f"corner {k}" for k in range(1, 5)), "centre"]
    return tuple(
        FramePoint(name, x, y, float(east), float(north), 0.0)
        for name, x, y, east, north in zip(names, line, sample, lon, lat, strict=True)
    )
