"""Metadata records of pushbroom sensors, independent of file formats.

Readers (``fg_orient.formats.dimap1``, ``dimap2``, ``metadata.pushbroom``) make these
immutable records. The sensors (``fg_orient.sensors.pushbroom``, ``general``) use them.
The conventions are:

- Times are seconds since ``epoch``, which is 0 h UTC of the day of the image.
- Positions and velocities are Earth-fixed (ECEF, WGS84), in m and m/s, unless a frame is stated. Angles are in rad.
- Pixels are (line, sample); (0, 0) is the centre of the first pixel.
- Attitudes rotate body axes to the orbital frame of convention B (X = V x Z right of flight, Y = Z x X forward, Z =
  radial outward), or they are quaternions from body axes to ECEF.
- Camera and payload axes of the general pushbroom follow convention A: X forward, Y left of flight, Z away from the
  Earth.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from factors.arrays import Array
from factors.cameras import look
from factors.geometry import interpolation, polynomials
from factors.geometry.rotations import quaternion_matrices
from fg_orient.model.errors import Finding
from fg_orient.sensors.earth_rotation import EarthRotation

if TYPE_CHECKING:
    from fg_orient.geodesy.bodies import Body

Frame = Literal["ITRF", "GCRS", "EME2000"]
#: Target frame of attitudes: an orbital frame, an Earth-fixed frame or an inertial frame.
AttitudeFrame = Literal["orbital", "ITRF", "GCRS", "EME2000"]
#: Interpolation of states in time. "usual": Lagrange polynomials through the eight
#: nearest samples for states, linear interpolation for quaternions. "lagrange": Lagrange
#: polynomials for quaternions, too. "centred": Lagrange polynomials for both, with equal
#: numbers of samples before and after the time, up to eight; near the ends of the list,
#: there are fewer (CSM line-scan states). "shortest": cubic polynomials through positions
#: and velocities, and the shortest rotation between two quaternions (image support data).
Scheme = Literal["usual", "lagrange", "centred", "shortest"]
#: Smaller differences between two line times, in lines, are rounding.
SAME_LINE: Final = 1e-6
#: Definition of the orbital frame: by position and Earth-fixed velocity, by position and
#: inertial velocity, or by Kepler angles.
OrbitalFrame = Literal["earth-fixed velocity", "inertial velocity", "kepler"]


@dataclass(frozen=True)
class LineTiming:
    """Times of lines: ``t(line) = reference_time_s + line_period_s * (line - reference_line)``."""

    reference_line: float  # counted from 0
    reference_time_s: float
    line_period_s: float

    def time_s(self, line: Array) -> Array:
        """Return the times of N lines, s."""
        return np.asarray(self.reference_time_s + self.line_period_s * (line - self.reference_line))

    def line(self, time_s: Array) -> Array:
        """Return the lines at N times."""
        return np.asarray(self.reference_line + (time_s - self.reference_time_s) / self.line_period_s)


@dataclass(frozen=True, eq=False)
class SegmentTiming(LineTiming):
    """Times of lines in segments: ``t(line) = start_time_s[k] + period_s[k] (line - start_line[k])``.

    k is the last segment that has begun. The arrays ``start_line``, ``start_time_s``,
    ``period_s`` (n,) have increasing lines. The first segment is also used before its
    start. The fields of :class:`LineTiming` describe the first segment.
    """

    start_line: Array
    start_time_s: Array
    period_s: Array

    @classmethod
    def of(cls, start_line: Array, start_time_s: Array, period_s: Array) -> LineTiming:
        """Make the timing of n segments.

        If all have one rate without jumps, it is a :class:`LineTiming`.
        """
        first = float(start_line[0]), float(start_time_s[0]), float(period_s[0])
        plain = LineTiming(*first)
        off_lines = (plain.time_s(start_line) - start_time_s) / period_s
        if np.abs(off_lines).max() < SAME_LINE and np.abs(period_s / period_s[0] - 1.0).max() < SAME_LINE * 1e-4:
            return plain
        return cls(*first, start_line, start_time_s, period_s)

    def time_s(self, line: Array) -> Array:
        """Return the times of N lines, s."""
        k = np.clip(np.searchsorted(self.start_line, line, side="right") - 1, 0, None)
        return np.asarray(self.start_time_s[k] + self.period_s[k] * (line - self.start_line[k]))

    def line(self, time_s: Array) -> Array:
        """Return the lines at N times; times must increase with the line."""
        k = np.clip(np.searchsorted(self.start_time_s, time_s, side="right") - 1, 0, None)
        return np.asarray(self.start_line[k] + (time_s - self.start_time_s[k]) / self.period_s[k])


@dataclass(frozen=True)
class Ephemeris:
    """State vectors: ``time_s`` (n,), ``position_m`` (n, 3), ``velocity_m_s`` (n, 3) in ``frame``.

    ITRF means ECEF.
    """

    time_s: Array
    position_m: Array
    velocity_m_s: Array
    frame: Frame = "ITRF"
    scheme: Scheme = "usual"

    def at(self, time_s: Array) -> Array:
        """Interpolate position and velocity (N, 6) at N times."""
        if self.scheme == "shortest":
            from scipy.interpolate import CubicHermiteSpline  # loaded for these files only

            spline = CubicHermiteSpline(self.time_s, self.position_m, self.velocity_m_s)
            return np.hstack([spline(time_s), spline(time_s, 1)])
        samples = np.hstack([self.position_m, self.velocity_m_s])
        if self.scheme == "centred":
            return interpolation.centred(self.time_s, samples, time_s)
        return interpolation.lagrange(self.time_s, samples, time_s)


@dataclass(frozen=True)
class AngleAttitude:
    """Sampled attitude angles relative to an orbital frame, interpolated linearly in time.

    The fields are ``time_s`` (n,) and ``angles_rad`` (n, 3) = roll, pitch, yaw. For DIMAP
    v1, the signs have already been changed: roll and pitch are the negated values of the
    file, and yaw is the value of the file (docs/equations.md 2).
    ``factors.geometry.orbital`` defines the angles of a general pushbroom.
    """

    time_s: Array
    angles_rad: Array


@dataclass(frozen=True)
class QuaternionList:
    """Sampled quaternions from body axes to ``frame``: ``time_s`` (n,), ``quaternion`` (n, 4), scalar part first.

    Each component is interpolated, then the quaternion is normalised; the scheme
    "shortest" interpolates the rotation. Signs are chosen such that neighbours have a
    positive product (``factors.geometry.interpolation.sign_aligned``).
    """

    time_s: Array
    quaternion: Array
    frame: Frame = "ITRF"
    scheme: Scheme = "usual"

    def at(self, time_s: Array) -> Array:
        """Interpolate unit quaternions (N, 4) at N times."""
        if self.scheme == "usual":
            return interpolation.quaternion_linear(self.time_s, self.quaternion, time_s)
        if self.scheme == "shortest":
            from scipy.spatial.transform import Rotation, Slerp  # loaded for these files only

            listed = Rotation.from_quat(np.roll(self.quaternion, -1, axis=1))
            inside = np.clip(time_s, self.time_s[0], self.time_s[-1])  # half a line before and after the list
            return np.asarray(np.roll(Slerp(self.time_s, listed)(inside).as_quat(), 1, axis=1))
        scheme = interpolation.centred if self.scheme == "centred" else interpolation.lagrange
        q = scheme(self.time_s, self.quaternion, time_s)
        return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))


@dataclass(frozen=True)
class BodyRotation:
    """Rotation of a body during an image: listed rotations from inertial axes, followed by a constant rotation (3, 3).

    It has the methods of :class:`fg_orient.sensors.earth_rotation.EarthRotation`.
    """

    turns: QuaternionList
    constant: Array

    def matrices(self, time_s: Array) -> Array:
        """Rotations (N, 3, 3) to body-fixed axes from inertial axes at N times."""
        return np.asarray(self.constant @ quaternion_matrices(np.ascontiguousarray(self.turns.at(time_s))))

    def rate_rad_s(self, _: float) -> float:
        """Angular velocity about the third axis, the mean over the list."""
        ends = self.turns.time_s[[0, -1]]
        first, last = self.matrices(ends)
        turn = first @ last.T
        return float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]) / (ends[1] - ends[0]))


@dataclass(frozen=True)
class QuaternionPolynomial:
    """Polynomials of quaternions from body axes to ECEF; ``coefficients`` has the shape (4, k).

    ``Q_j(t) = sum_i coefficients[j, i] ((t - offset_s) / scale_s)^i``
    """

    offset_s: float
    scale_s: float
    coefficients: Array


@dataclass(frozen=True)
class LookAngleTable:
    """Table of look angles by detector; between its rows, the tangents are linear in the sample.

    ``sample`` (n,) contains increasing detector numbers from 0. ``psi_x_rad`` and
    ``psi_y_rad`` (n,) are the look angles.
    """

    sample: Array
    psi_x_rad: Array
    psi_y_rad: Array

    def angles(self, sample: Array) -> tuple[Array, Array]:
        """Return the look angles psi_x (along track), psi_y (across track), rad, of N samples."""
        return look.from_table(self.sample, *self._tangents, sample)

    @cached_property
    def _tangents(self) -> tuple[Array, Array]:
        return np.tan(self.psi_x_rad), np.tan(self.psi_y_rad)


@dataclass(frozen=True)
class LookAnglePolynomial:
    """Tangents of the look angles as polynomials of ``sample - origin_sample``.

    ``tan_psi_x`` (k,) is along track, ``tan_psi_y`` (k,) is across track. The constant term is first.
    """

    origin_sample: float
    tan_psi_x: Array
    tan_psi_y: Array

    def angles(self, sample: Array) -> tuple[Array, Array]:
        """Return the look angles psi_x (along track), psi_y (across track), rad, of N samples."""
        return look.from_polynomial(self.tan_psi_x, self.tan_psi_y, self.origin_sample, sample)


class Camera:
    """Interior orientation of a general pushbroom: viewing directions of the detectors."""

    def tangents(self, sample: Array) -> tuple[Array, Array]:
        """Return the forward and left components of the viewing directions of N samples, per unit of depth."""
        raise NotImplementedError

    def angles(self, sample: Array) -> tuple[Array, Array]:
        """Return the look angles psi_x (forward), psi_y (left), rad, of N samples."""
        forward, left = self.tangents(sample)
        return np.arctan(forward), np.arctan(left)


@dataclass(frozen=True, eq=False)
class LineCamera(Camera):
    """Line of detectors behind a lens: ``p_k = (0, y, 0) - (x_s, y_s, c) + delta`` (Terlemezoğlu 2019, eq. 2.5).

    Parameters
    ----------
    focal_length_m : float
    pitch_m : float
        Step along camera Y (left of flight) from one sample to the next; negative if
        samples increase to the right.
    principal_sample : float
        Sample at y_s; it may lie outside the image.
    forward_m : float
        Position -x_s of the line along camera X.
    n_samples : int
    delta_forward_m, delta_left_m : (k,) arrays
        Coefficients of systematic image corrections for s^0, s^1, ...; s is -1 at the
        first and 1 at the last sample.
    """

    focal_length_m: float
    pitch_m: float
    principal_sample: float
    forward_m: float
    n_samples: int
    delta_forward_m: Array = field(default_factory=lambda: np.zeros(1))
    delta_left_m: Array = field(default_factory=lambda: np.zeros(1))

    def tangents(self, sample: Array) -> tuple[Array, Array]:
        """See :class:`Camera`."""
        s = polynomials.normalised(sample, self.n_samples)
        delta = [polynomials.evaluate(c[None], s)[:, 0] for c in (self.delta_forward_m, self.delta_left_m)]
        forward = self.forward_m + delta[0]
        left = self.pitch_m * (sample - self.principal_sample) + delta[1]
        return forward / self.focal_length_m, left / self.focal_length_m


@dataclass(frozen=True, eq=False)
class DirectionTable(Camera):
    """Table of viewing directions: ``tan_forward``, ``tan_left`` (n,) at ``sample`` (n,), interpolated linearly."""

    sample: Array
    tan_forward: Array
    tan_left: Array

    def tangents(self, sample: Array) -> tuple[Array, Array]:
        """See :class:`Camera`.

        Beyond the table, the last interval is extrapolated by half a pixel.
        """
        k = np.clip(np.searchsorted(self.sample, sample) - 1, 0, len(self.sample) - 2)
        f = (sample - self.sample[k]) / (self.sample[k + 1] - self.sample[k])
        forward, left = ((1.0 - f) * t[k] + f * t[k + 1] for t in (self.tan_forward, self.tan_left))
        return np.asarray(forward), np.asarray(left)


@dataclass(frozen=True)
class LightEffects:
    """Effects on light that are applied.

    Vendors' attitudes often contain the aberration already.
    """

    light_time: bool = False
    aberration: bool = False
    refraction: bool = False

    def __bool__(self) -> bool:
        return self.light_time or self.aberration or self.refraction


@dataclass(frozen=True)
class FramePoint:
    """Point whose ground position is in the metadata file; ``height_m`` is None if the file does not state it."""

    id: str
    line: float
    sample: float
    lon_deg: float
    lat_deg: float
    height_m: float | None


@dataclass(frozen=True)
class PushbroomMetadata:
    """Data of the rigorous model of one pushbroom image."""

    file: str
    mission: str  # "SPOT 5", "SPOT 6", "PHR 1A", ...
    instrument: str
    format: str  # "DIMAP 1.1", "DIMAP 2.0", ...
    epoch: np.datetime64  # 0 h UTC, datetime64[D]
    n_lines: int
    n_samples: int
    timing: LineTiming
    ephemeris: Ephemeris
    attitude: AngleAttitude | QuaternionList | QuaternionPolynomial
    look: LookAngleTable | LookAnglePolynomial | Camera
    frame_points: tuple[FramePoint, ...] = ()
    notes: tuple[Finding, ...] = field(default=())
    frame_note: Finding | None = None  # why the frame points may not agree with the model; also in the notes


@dataclass(frozen=True, kw_only=True)
class GeneralMetadata(PushbroomMetadata):
    """Data of the general model of one pushbroom image; ``attitude`` rotates payload axes to its frame.

    Parameters
    ----------
    offset_m : (3,) array
        Vector in the payload frame from the point that the orbit describes to the projection centre (C_M).
    mounting : (3, 3) array
        Rotation from camera axes to payload axes (R_KU).
    orbital_frame : str
        Definition of the orbital frame; it is used only if attitudes are angles.
    earth : EarthRotation, BodyRotation or None
        Rotation of the Earth or of another body. It is required if the orbit or the attitudes are inertial, or if
        ``orbital_frame`` is "kepler" and the orbit is inertial.
    effects : LightEffects
    body : Body or None
        Body to which the ground points are fixed; None for the Earth.
    """

    format: str = "sensor description"
    offset_m: Array
    mounting: Array
    orbital_frame: OrbitalFrame = "earth-fixed velocity"
    earth: EarthRotation | BodyRotation | None = None
    effects: LightEffects = LightEffects()
    body: Body | None = None
