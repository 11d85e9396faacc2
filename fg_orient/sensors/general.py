"""The general pushbroom: image -> line -> camera -> payload -> orbit -> inertial axes -> Earth, from a description.

    P = P_U + R_OG R_UY (C_M + s R_KU p_k),   p_k = (0, y, 0) - c_s + delta       (Terlemezoğlu 2019, eqs. 2.3-2.21)

The chain of the metadata is brought into the look-angle collinearity: the mounting of a line is
``M = R_OG^T R_ECEF_from_camera`` with R_OG of the projection centre, so that the unknowns, kernels and backends are
those of ``fg_orient.sensors.pushbroom``. Light time, aberration and refraction turn the sight of each pixel by up to
3e-5 rad; that turn is formed with the metadata and the ground point's distance and held (a correction of 1 km or
1e-3 rad changes it by less than 1e-8 rad).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.cameras import look
from factors.cameras.pushbroom import RECORD
from factors.geometry import ellipsoid, interpolation, kepler, light, polynomials, rotations
from fg_orient.model.errors import InputError, OutOfTimeRange, finding
from fg_orient.sensors.base import same_length
from fg_orient.sensors.correction import Correction, HeightSurface
from fg_orient.sensors.metadata import GeneralMetadata
from fg_orient.sensors.pushbroom import TIME_PRINT_S, LineStates, PushbroomSensor
from fg_orient.sensors.surface import landed

Array = npt.NDArray[np.float64]

#: Rounds of "ground point, distance, sight": the second leaves 0.3 mm on slopes, the third 1e-7 m.
_ROUNDS = 3


class GeneralPushbroom(PushbroomSensor):
    """One image of a pushbroom that a sensor description stands for.

    Parameters
    ----------
    metadata : GeneralMetadata

    Raises
    ------
    InputError
        All samples look in the same direction.
    OutOfTimeRange
        Orbit or attitudes do not cover the image; nothing is extrapolated.
    """

    def __init__(self, metadata: GeneralMetadata) -> None:
        self.metadata = metadata  # type: ignore[assignment]  # what both hold goes by the same names
        self.n_lines, self.n_samples = metadata.n_lines, metadata.n_samples
        self.first_line, self.last_line = 0.0, self.n_lines - 1.0
        self.first_sample, self.last_sample = 0.0, self.n_samples - 1.0
        self.follows_orbit = metadata.attitude.frame == "orbital"
        self.notes = metadata.notes
        self._check_field_of_view("camera")
        self.states([0.0, self.n_lines - 1.0])

    @property
    def _general(self) -> GeneralMetadata:
        return self.metadata  # type: ignore[return-value]

    # --- the chain ---------------------------------------------------------------------------

    def _require_attitude(self, line: Array) -> None:
        self._require_times("attitude", line, self._general.attitude.time_s)

    def _require_times(self, what: str, line: Array, time_s: Array) -> None:
        """Refuse lines beyond a list; half a line, the border of a pixel, is free."""
        t = self._line_time(line)
        gap = np.maximum(time_s[0] - t, t - time_s[-1])
        beyond = gap > TIME_PRINT_S + 0.51 * abs(self._general.timing.line_period_s)
        if beyond.any():
            place = f"[{what}], line {line[beyond][0]:.2f}"
            raise OutOfTimeRange(finding(
                "earth.list_span", file=self.file, place=place, value=f"{t[beyond][0]:.6f} s", what=what,
                first=time_s[0], last=time_s[-1],
            ))  # fmt: skip

    def _orbit(self, t: Array) -> tuple[Array, Array]:
        """Position and Earth-fixed velocity (N, 3) of the point that the orbit describes, Earth-fixed axes."""
        orbit = self._general.orbit
        state = interpolation.lagrange(orbit.time_s, np.hstack([orbit.position_m, orbit.velocity_m_s]), t)
        p, v = state[:, :3], state[:, 3:]
        if orbit.frame != "ITRF":
            turn = self._earth(t)
            p, v = np.einsum("nij,nj->ni", turn, p), np.einsum("nij,nj->ni", turn, v)
            v = v - np.cross([0.0, 0.0, self._rate(t)], p)
        return p, v

    def _earth(self, t: Array) -> Array:
        earth = self._general.earth
        if earth is None:
            raise InputError.of("earth.missing", file=self.file, place="[earth]")
        return earth.matrices(t)

    def _rate(self, t: Array) -> float:
        earth = self._general.earth
        return light.EARTH_RATE_RAD_S if earth is None else earth.rate_rad_s(float(t[0]))

    def _ecef_from_payload(self, t: Array, p: Array, v: Array) -> Array:
        """Rotations (N, 3, 3) of the metadata."""
        source, kind = self._general.attitude, self._general.orbital_frame
        if source.angles_rad is not None:
            inertial = v + np.cross([0.0, 0.0, self._rate(t)], p)
            if kind == "kepler":
                frame = kepler.frames_from_kepler(kepler.kepler_angles(p, inertial))
            else:
                frame = kepler.frames_from_state(p, v if kind == "earth-fixed velocity" else inertial)
            return np.asarray(
                frame @ kepler.attitude_matrices(interpolation.linear(source.time_s, source.angles_rad, t))
            )
        assert source.quaternion is not None  # an attitude has one or the other
        q = interpolation.quaternion_linear(source.time_s, source.quaternion, t)
        turned = rotations.quaternion_matrices(np.ascontiguousarray(q))
        return turned if source.frame == "ITRF" else np.asarray(self._earth(t) @ turned)

    def states(self, line: npt.ArrayLike) -> LineStates:
        """State of the projection centre at N lines; angles are 0, the mounting holds all of the attitude.

        Raises
        ------
        OutOfTimeRange
            A line outside the image that orbit or attitudes do not cover.
        """
        line = np.atleast_1d(np.asarray(line, float))
        t = self._line_time(line)
        self._require_times("orbit", line, self._general.orbit.time_s)
        self._require_attitude(line)
        p, v = self._orbit(t)
        payload = self._ecef_from_payload(t, p, v)
        p = np.ascontiguousarray(p + payload @ self._general.offset_m)
        v = np.ascontiguousarray(v)
        ecef_from_camera = payload @ self._general.mounting @ kepler.B_FROM_A.T
        mount = np.swapaxes(rotations.orbital_frames(p, v), 1, 2) @ ecef_from_camera
        return LineStates(polynomials.normalised(line, self.n_lines), p, v, np.zeros((len(t), 3)), mount)

    def look_angles(self, sample: npt.ArrayLike) -> tuple[Array, Array]:
        """Look angles psi_x (forward), psi_y (left), rad, of N samples: the camera of the description."""
        forward, left = self._general.camera.tangents(np.atleast_1d(np.asarray(sample, float)))
        return np.arctan(forward), np.arctan(left)

    # --- light -------------------------------------------------------------------------------

    def _bent(self, states: LineStates, psi: tuple[Array, Array], distance_m: Array | None) -> Array:
        """Mountings (N, 3, 3) with the effects on light, for ground points at given distances (None: height 0)."""
        effects = self._general.effects
        if not effects:
            return states.mount
        p, frame = states.position_m, rotations.orbital_frames(states.position_m, states.velocity_m_s)
        seen = light.unit(np.einsum("nij,njk,nk->ni", frame, states.mount, look.direction(*psi)))
        direction = seen
        if effects.aberration:
            inertial = states.velocity_m_s + np.cross([0.0, 0.0, light.EARTH_RATE_RAD_S], p)
            direction = light.without_aberration(direction, inertial)
        if effects.light_time or effects.refraction:
            direction = self._shifted(p, direction, distance_m)
        turned = light.turns(seen, direction) @ frame @ states.mount
        return np.asarray(np.swapaxes(frame, 1, 2) @ turned)

    def _shifted(self, p: Array, direction: Array, distance_m: Array | None) -> Array:
        """Directions to where the ground points are, from those to where they seem to be."""
        effects = self._general.effects
        if distance_m is None:
            ground = ellipsoid.intersect(p, np.ascontiguousarray(direction), np.zeros(len(p)))
            distance_m = np.linalg.norm(ground - p, axis=1)
            if not np.isfinite(distance_m).all():  # the ray misses the Earth: as far as the point nearest to it
                distance_m = np.where(np.isfinite(distance_m), distance_m, -np.einsum("ni,ni->n", p, direction))
        ground = p + distance_m[:, None] * direction
        shift = np.zeros_like(ground)
        if effects.light_time:
            shift += light.earth_turn(ground, distance_m)
        if effects.refraction:
            lon, lat, height = ellipsoid.geodetic_array(np.ascontiguousarray(ground)).T
            up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
            shift += light.refraction_shift(direction, up, height)
        return light.unit(ground + shift - p)

    # --- what the adjustment and the user call ----------------------------------------------

    def records(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, reference_m: Array, origin_m: Array | None = None, *,
        small_angle: bool = False,
    ) -> Array:  # fmt: skip
        """See :meth:`PushbroomSensor.records`; the effects on light are those of the distance to ``reference_m``."""
        out = super().records(line, sample, reference_m, origin_m, small_angle=small_angle)
        if self._general.effects:
            states = LineStates(
                out[:, RECORD.tau], out[:, RECORD.position].copy(), out[:, RECORD.velocity].copy(),
                out[:, RECORD.angles], out[:, RECORD.mounting].reshape(-1, 3, 3),
            )  # fmt: skip
            distance = np.linalg.norm(out[:, RECORD.from_position], axis=1)
            look = out[:, RECORD.psi_x], out[:, RECORD.psi_y]
            out[:, RECORD.mounting] = self._bent(states, look, distance).reshape(-1, 9)
        return out

    def rays(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: Correction | None = None,
        distance_m: Array | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Projection centres (N, 3) m and unit directions (N, 3), ECEF, to where the ground points are.

        ``distance_m`` (N,): distance of the ground point that light time and refraction are meant for; None takes
        height 0, at 5000 m light time is then 1 mm and refraction 1 m tan z off.
        """
        c = correction or Correction()
        lines, s = same_length(line, sample)
        states = self.states(lines)
        psi = self.look_angles(s)
        mount = self._bent(states, psi, distance_m)
        delta = c.eop_at(states.tau)
        if c.look.shape[1]:
            bend = polynomials.evaluate(c.look, polynomials.normalised(s, self.n_samples))
            psi = psi[0] + bend[:, 0], psi[1] + bend[:, 1]
        p, v = states.position_m + delta[:, 0:3], states.velocity_m_s
        frame = (p, v + delta[:, 3:6]) if self.follows_orbit else (states.position_m, v)
        turn = rotations.attitude_matrices(np.ascontiguousarray(delta[:, 6:9]), c.small_angle)
        ecef = rotations.orbital_frames(*(np.ascontiguousarray(a) for a in frame)) @ turn @ mount
        return p, light.unit(np.einsum("nij,nj->ni", ecef, look.direction(*psi)))

    def locate(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, *, height_m: npt.ArrayLike | None = None,
        dem: HeightSurface | None = None, correction: Correction | None = None,
    ) -> Array:  # fmt: skip
        """See :meth:`PushbroomSensor.locate`; the effects on light are those of the points found."""
        line, sample = same_length(line, sample)
        self.require_inside(line, sample)
        distance, ground = None, np.empty((0, 3))
        for _ in range(_ROUNDS if self._general.effects else 1):
            p, u = self.rays(line, sample, correction, distance)
            ground = landed(p, u, height_m, dem, (line, sample), self.file)
            distance = np.linalg.norm(ground - self.states(line).position_m, axis=1)
        return ground
