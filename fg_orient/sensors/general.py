"""General pushbroom sensor from a description: line, camera, payload, orbit, inertial axes, Earth.

The description states a chain of transformations from the image to the Earth::

    P = P_U + R_OG R_UY (C_M + s R_KU p_k),   p_k = (0, y, 0) - c_s + delta       (Terlemezoğlu 2019, eqs. 2.3-2.21)

The chain is converted to the look-angle collinearity. The mounting of a line is ``M = R_OG^T R_ECEF_from_camera``,
where R_OG belongs to the projection centre. The unknowns, kernels and backends of ``fg_orient.sensors.pushbroom`` can
then be used.

Light time, aberration and refraction rotate the line of sight of each pixel by up to 3e-5 rad. This rotation is
computed from the metadata and the distance of the ground point, and it is held fixed. A correction of 1 km or 1e-3 rad
would change it by less than 1e-8 rad.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.cameras import look
from factors.geometry import ellipsoid, interpolation, light, orbital, polynomials, rotations
from fg_orient.model.errors import Finding, InputError
from fg_orient.sensors.base import ImageModel
from fg_orient.sensors.correction import Correction, HeightSurface
from fg_orient.sensors.light_sizes import light_sizes
from fg_orient.sensors.metadata import (
    AngleAttitude,
    GeneralMetadata,
    LightEffects,
    QuaternionList,
    QuaternionPolynomial,
)
from fg_orient.sensors.pushbroom import LineStates, PushbroomModel, PushbroomSensor
from fg_orient.sensors.surface import landed

if TYPE_CHECKING:
    from fg_orient.model.block import Options

#: Number of iterations of ground point, distance and line of sight. On slopes, the error
#: is 0.3 mm after two iterations and 1e-7 m after three.
_ROUNDS = 3


class GeneralPushbroom(PushbroomSensor):
    """Sensor of one pushbroom image that a sensor description defines.

    Parameters
    ----------
    metadata : GeneralMetadata

    Raises
    ------
    InputError
        All samples look in the same direction.
    OutOfTimeRange
        Orbit or attitudes do not cover the image. They are never extrapolated.
    """

    metadata: GeneralMetadata
    _camera = "camera"

    def __init__(self, metadata: GeneralMetadata) -> None:
        super().__init__(metadata)
        self.bends_light = bool(metadata.effects)
        self.body, self.georeferenced = metadata.body, metadata.body is None

    def _bind_attitude(self, seconds: float) -> tuple[Finding, ...]:
        self.states([0.0, self.n_lines - 1.0])
        return ()

    @cached_property
    def light_sizes(self) -> list[dict[str, Any]]:
        """See :func:`fg_orient.sensors.light_sizes.light_sizes`."""
        return light_sizes(self)

    def with_effects(self, effects: LightEffects) -> GeneralPushbroom:
        """Return a sensor of the same image with other effects on light."""
        return GeneralPushbroom(replace(self.metadata, effects=effects))

    def image_model(self, options: Options) -> ImageModel:
        """See :class:`GeneralModel`."""
        return GeneralModel(self, options)

    # --- the chain ---------------------------------------------------------------------------

    def _require_attitude(self, line: Array) -> None:
        assert not isinstance(self.attitude, QuaternionPolynomial)  # a description contains lists
        self._require_listed("earth.list_span", line, self.attitude.time_s, "attitude")

    def _orbit(self, t: Array) -> tuple[Array, Array]:
        """Return position and Earth-fixed velocity (N, 3) of the orbit's reference point in Earth-fixed axes."""
        p, v = super()._orbit(t)
        if self.metadata.ephemeris.frame != "ITRF":
            turn = self._earth(t)
            p, v = np.einsum("nij,nj->ni", turn, p), np.einsum("nij,nj->ni", turn, v)
            v = v - np.cross([0.0, 0.0, self._rate(t)], p)
        return p, v

    def _earth(self, t: Array) -> Array:
        earth = self.metadata.earth
        if earth is None:
            raise InputError.of("earth.missing", file=self.file, place="[earth]")
        return earth.matrices(t)

    def _rate(self, t: Array) -> float:
        earth = self.metadata.earth
        return light.EARTH_RATE_RAD_S if earth is None else earth.rate_rad_s(float(t[0]))

    def _ecef_from_payload(self, t: Array, p: Array, v: Array) -> Array:
        """Return the rotations (N, 3, 3) from payload axes to ECEF, from the metadata."""
        source, kind = self.attitude, self.metadata.orbital_frame
        if isinstance(source, AngleAttitude):
            inertial = v + np.cross([0.0, 0.0, self._rate(t)], p)
            if kind == "kepler":
                frame = orbital.frames_from_kepler(orbital.kepler_angles(p, inertial))
            else:
                frame = orbital.frames_from_state(p, v if kind == "earth-fixed velocity" else inertial)
            angles = interpolation.linear(source.time_s, source.angles_rad, t)
            return np.asarray(frame @ orbital.attitude_matrices(angles))
        assert isinstance(source, QuaternionList)  # a description contains lists
        matrices = rotations.quaternion_matrices(np.ascontiguousarray(source.at(t)))
        return matrices if source.frame == "ITRF" else np.asarray(self._earth(t) @ matrices)

    def states(self, line: npt.ArrayLike) -> LineStates:
        """Return the state of the projection centre at N lines. Angles are 0, as the mounting contains the attitude."""
        line = np.atleast_1d(np.asarray(line, float))
        self._require_listed("earth.list_span", line, self.metadata.ephemeris.time_s, "orbit")
        self._require_attitude(line)
        return self.states_at(self._line_time(line), line)

    def states_at(self, t: Array, line: Array) -> LineStates:
        """See :meth:`PushbroomSensor.states_at`."""
        p, v = self._orbit(t)
        payload = self._ecef_from_payload(t, p, v)
        p = np.ascontiguousarray(p + payload @ self.metadata.offset_m)
        v = np.ascontiguousarray(v)
        ecef_from_camera = payload @ self.metadata.mounting @ orbital.B_FROM_A.T
        mount = np.swapaxes(rotations.orbital_frames(p, v), 1, 2) @ ecef_from_camera
        return LineStates(polynomials.normalised(line, self.n_lines), p, v, np.zeros((len(t), 3)), mount)

    # --- light -------------------------------------------------------------------------------

    def _mounting(self, states: LineStates, psi: tuple[Array, Array], to_ground_m: Array | None) -> Array:
        """Return the mountings (N, 3, 3) with the effects on light; see :meth:`PushbroomSensor._mounting`.

        Light time and refraction depend on the distance of the ground point. If the point is at 5000 m but the
        distance to height 0 is used, light time is wrong by 1 mm, and refraction by 1 m tan z.
        """
        effects = self.metadata.effects
        if not effects:
            return states.mount
        p, frame = states.position_m, rotations.orbital_frames(states.position_m, states.velocity_m_s)
        seen = light.unit(np.einsum("nij,njk,nk->ni", frame, states.mount, look.direction(*psi)))
        direction = seen
        if effects.aberration:
            inertial = states.velocity_m_s + np.cross([0.0, 0.0, light.EARTH_RATE_RAD_S], p)
            direction = light.without_aberration(direction, inertial)
        if effects.light_time or effects.refraction:
            distance_m = None if to_ground_m is None else np.linalg.norm(to_ground_m, axis=1)
            direction = self._shifted(p, direction, distance_m)
        turned = light.turns(seen, direction) @ frame @ states.mount
        return np.asarray(np.swapaxes(frame, 1, 2) @ turned)

    def _shifted(self, p: Array, direction: Array, distance_m: Array | None) -> Array:
        """Convert apparent to true directions of ground points at given distances; None means height 0."""
        effects = self.metadata.effects
        if distance_m is None:
            ground = ellipsoid.intersect(p, np.ascontiguousarray(direction), np.zeros(len(p)))
            distance_m = np.linalg.norm(ground - p, axis=1)
            # if a ray misses the Earth, the distance of its point nearest to the Earth is used
            if not np.isfinite(distance_m).all():
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

    def _located(
        self, line: Array, sample: Array, height_m: npt.ArrayLike | None, dem: HeightSurface | None,
        correction: Correction | None,
    ) -> Array:  # fmt: skip
        """Return ground points, with the effects on light at the distance of each point."""
        to_ground, ground = None, np.empty((0, 3))
        for _ in range(_ROUNDS if self.metadata.effects else 1):
            p, u = self.rays(line, sample, correction, to_ground)
            ground = landed(p, u, height_m, dem, (line, sample), self.file, self.body)
            to_ground = ground - self.states(line).position_m
        return ground


class GeneralModel(PushbroomModel):
    """Image model of a general pushbroom: the model of a pushbroom, with the sizes of the effects on light."""

    sensor: GeneralPushbroom

    def facts(self) -> dict[str, Any]:
        """Return the entries of a pushbroom and ``light``. See :func:`fg_orient.sensors.light_sizes.light_sizes`."""
        return super().facts() | {"light": [] if self.sensor.body else self.sensor.light_sizes}
