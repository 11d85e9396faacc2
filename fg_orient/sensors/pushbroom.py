"""Rigorous pushbroom sensor; it connects metadata with the look-angle collinearity.

One class is used for DIMAP v1 (angles in the orbital frame) and DIMAP v2 (quaternions from body to ECEF). Pixels are
(line, sample); (0, 0) is the centre of the first pixel. Ground points are ECEF, m. ``Correction`` contains corrections
of EOPs and look angles in physical units. Light time and aberration are not applied, because the vendor's attitudes
contain the aberration (docs/equations.md 2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.cameras import look
from factors.cameras.pushbroom import LOOK_ANGLE_COLLINEARITY, RECORD
from factors.geometry import interpolation, light, polynomials, rotations
from fg_orient.model.errors import Finding, InputError, OutOfTimeRange, finding
from fg_orient.model.names import COMPONENTS, VELOCITY
from fg_orient.model.options import MAX_EXTRAPOLATION_S
from fg_orient.model.parameters import (
    CURVE,
    CURVES,
    DEGREES,
    N_EOP,
    UNITS,
    orientation_parameters,
    parameter_name,
)
from fg_orient.sensors import projection
from fg_orient.sensors.base import ImageModel, Sensor, ground_rows, same_length
from fg_orient.sensors.correction import Correction, correction_by_code, fit_eop
from fg_orient.sensors.jitter import with_jitter
from fg_orient.sensors.metadata import (
    AngleAttitude,
    LookAngleTable,
    PushbroomMetadata,
    QuaternionList,
    QuaternionPolynomial,
)

if TYPE_CHECKING:
    from fg_orient.model.block import ImagePoints, Options
    from fg_orient.model.jitter import JitterCurve

#: Minimum plausible field of view, rad. The narrowest known field of view is 0.015 rad.
MIN_FIELD_RAD = 1e-4
#: Rounding of printed times, s. The lists of SPOT 6 start and end exactly with the image.
TIME_PRINT_S = 2e-6
#: Maximum power of the sample in a look-angle polynomial.
MAX_LOOK_DEGREE = 10
_YAW = 8
#: Rotates our body axes to the vendor's body axes of DIMAP v2 (x along track, y across track, z to the Earth).
V2_BODY_FROM_BODY = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class LineStates:
    """States of N lines from the metadata; they are constants of the observation equation."""

    tau: Array
    position_m: Array
    velocity_m_s: Array
    angles_rad: Array
    mount: Array  # (N, 3, 3)

    def first(self, n: int) -> LineStates:
        """Return the states of the first n lines."""
        return LineStates(*(a[:n] for a in (self.tau, self.position_m, self.velocity_m_s, self.angles_rad, self.mount)))


def _extended(source: AngleAttitude | QuaternionList, seconds: Array) -> AngleAttitude | QuaternionList:
    """Extrapolate attitudes with the last rate by ``seconds`` (2,) before and after their list."""
    if not seconds.any():
        return source
    if isinstance(source, AngleAttitude):
        return AngleAttitude(*interpolation.extended(source.time_s, source.angles_rad, *seconds))
    return QuaternionList(*interpolation.extended(source.time_s, source.quaternion, *seconds))


class PushbroomSensor(Sensor):
    """Rigorous model of one pushbroom image.

    Parameters
    ----------
    metadata : PushbroomMetadata
        Contents of the file.
    extrapolate_attitude_s : float
        If the list of attitudes ends inside the image, it is extrapolated with the last rate by at most this time, s,
        and a note reports this. With the default 0, lines without attitude are refused when they are used.

    Raises
    ------
    InputError
        All samples look in the same direction, or the extrapolation time is invalid.
    OutOfTimeRange
        The ephemeris does not cover the image, or the attitudes do not cover any line.
    """

    #: Words for the camera in messages.
    _camera = "look angles"
    #: Whether effects on light rotate each line of sight. The mounting then depends on the sample.
    bends_light = False

    def __init__(self, metadata: PushbroomMetadata, *, extrapolate_attitude_s: float = 0.0) -> None:
        self.metadata, self.file = metadata, metadata.file
        self.n_lines, self.n_samples = metadata.n_lines, metadata.n_samples
        self.first_line, self.last_line = 0.0, self.n_lines - 1.0
        self.first_sample, self.last_sample = 0.0, self.n_samples - 1.0
        if isinstance(metadata.look, LookAngleTable):
            self.first_sample, self.last_sample = float(metadata.look.sample[0]), float(metadata.look.sample[-1])
        self.attitude = metadata.attitude
        self.follows_orbit = isinstance(self.attitude, AngleAttitude)
        self.frame_points, self.frame_note = metadata.frame_points, metadata.frame_note
        _, across = self.look_angles([self.first_sample, self.last_sample])
        if abs(across[1] - across[0]) < MIN_FIELD_RAD:
            value = f"{abs(across[1] - across[0]):.3g} rad"
            raise InputError.of("sensor.no_field", file=self.file, place=self._camera, value=value, least=MIN_FIELD_RAD)
        self.notes: tuple[Finding, ...] = metadata.notes + self._bind_attitude(extrapolate_attitude_s)

    def _line_time(self, line: Array) -> Array:
        return self.metadata.timing.time_s(line)

    def _bind_attitude(self, seconds: float) -> tuple[Finding, ...]:
        """Check the ephemeris, extrapolate the attitudes, and restrict the lines to them; notes report changes."""
        times, covered = self._line_time(np.array([0.0, self.n_lines - 1.0])), self.metadata.ephemeris.time_s
        image = f"image {times.min():.6f} .. {times.max():.6f} s"
        if times.min() < covered[0] - TIME_PRINT_S or times.max() > covered[-1] + TIME_PRINT_S:
            raise OutOfTimeRange.of("sensor.ephemeris_span", file=self.file, place="ephemeris", value=image,
                                    first=covered[0], last=covered[-1])  # fmt: skip
        if not 0.0 <= seconds <= MAX_EXTRAPOLATION_S:
            raise InputError.of("sensor.extrapolation", file=self.file, place="extrapolate attitude", value=seconds,
                                most=MAX_EXTRAPOLATION_S)  # fmt: skip
        if isinstance(self.attitude, QuaternionPolynomial):
            return ()
        open_s = np.array([self.attitude.time_s[0] - times.min(), times.max() - self.attitude.time_s[-1]])
        open_s = np.where(open_s > TIME_PRINT_S, open_s, 0.0)
        added = np.minimum(open_s, seconds)
        self.attitude = _extended(self.attitude, added)
        timing, time_s = self.metadata.timing, self.attitude.time_s[[0, -1]] + [-TIME_PRINT_S, TIME_PRINT_S]
        ends = timing.line(time_s)
        self.first_line = max(0.0, float(np.ceil(ends.min())))
        self.last_line = min(self.n_lines - 1.0, float(np.floor(ends.max())))
        if self.first_line > self.last_line:
            raise self._attitude_fault("attitudes", image, times)
        codes = ("image.attitude_starts_late", "image.attitude_ends_early")
        notes = [finding(codes[k], open_s=open_s[k], added_s=added[k]) for k in (0, 1) if added[k]]
        if self.first_line > 0.0:
            notes.append(finding("image.lines_refused", first=0, last=int(self.first_line) - 1))
        if self.last_line < self.n_lines - 1.0:
            notes.append(finding("image.lines_refused", first=int(self.last_line) + 1, last=self.n_lines - 1))
        return tuple(notes)

    def _attitude_fault(self, place: str, value: str, t: Array) -> OutOfTimeRange:
        listed = self.attitude.time_s  # type: ignore[union-attr]
        gap = float(np.maximum(listed[0] - t, t - listed[-1]).max())
        lines = f"lines {self.first_line:.0f} to {self.last_line:.0f}" if self.first_line <= self.last_line else "them"
        return OutOfTimeRange.of("sensor.attitude_span", file=self.file, place=place, value=value,
                                 first=listed[0], last=listed[-1], gap=gap, lines=lines)  # fmt: skip

    def require_inside(self, line: Array, sample: Array) -> None:
        """Refuse pixels outside the image (OutOfImage) and lines without attitudes (OutOfTimeRange)."""
        in_image = (line >= -0.5) & (line <= self.n_lines - 0.5)
        super().require_inside(np.where(in_image, np.clip(line, self.first_line, self.last_line), line), sample)
        self._require_attitude(line)

    def _require_attitude(self, line: Array) -> None:
        """Refuse lines without attitude; a hundredth of a pixel is tolerated as rounding."""
        if isinstance(self.attitude, QuaternionPolynomial):
            return
        beyond = (line < self.first_line - 0.51) | (line > self.last_line + 0.51)
        if beyond.any():
            t = self._line_time(line[beyond][:1])
            raise self._attitude_fault(f"line {line[beyond][0]:.2f}", f"{t[0]:.6f} s", t)

    # --- constants of the equation -----------------------------------------------------------

    def states(self, line: npt.ArrayLike) -> LineStates:
        """Return the states of the metadata at N lines; lines are counted from 0 and may be fractions.

        OutOfTimeRange: the ephemeris or the attitudes do not cover a line.
        """
        line = np.atleast_1d(np.asarray(line, float))
        self._require_listed("sensor.ephemeris_span", line, self.metadata.ephemeris.time_s)
        self._require_attitude(line)
        return self.states_at(self._line_time(line), line)

    def states_at(self, t: Array, line: Array) -> LineStates:
        """Return the states of the metadata at N times, s, with given lines; the lists must cover the times."""
        p, v = self._orbit(t)
        angles, mount = self._attitude(t, p, v)
        return LineStates(polynomials.normalised(line, self.n_lines), p, v, angles, mount)

    def _orbit(self, t: Array) -> tuple[Array, Array]:
        """Interpolate position and velocity (N, 3) of the state vectors at N times."""
        state = self.metadata.ephemeris.at(t)
        return state[:, :3], state[:, 3:]

    def _require_listed(self, code: str, line: Array, listed_s: Array, table: str = "") -> None:
        """Refuse lines outside a list of times; half a line is allowed, because a pixel extends so far."""
        t = self._line_time(line)
        gap = np.maximum(listed_s[0] - t, t - listed_s[-1])
        beyond = gap > TIME_PRINT_S + 0.51 * abs(self.metadata.timing.line_period_s)
        if beyond.any():
            place, fields = f"line {line[beyond][0]:.2f}", {"what": table} if table else {}
            raise OutOfTimeRange.of(
                code, file=self.file, place=f"[{table}], {place}" if table else place, value=f"{t[beyond][0]:.6f} s",
                first=listed_s[0], last=listed_s[-1], **fields,
            )  # fmt: skip

    def _attitude(self, t: Array, p: Array, v: Array) -> tuple[Array, Array]:
        """Return the angles (N, 3) and the mounting (N, 3, 3) of the observation equation."""
        source = self.attitude
        if isinstance(source, AngleAttitude):
            angles = interpolation.linear(source.time_s, source.angles_rad, t)
            return angles, np.broadcast_to(np.eye(3), (len(t), 3, 3))
        if isinstance(source, QuaternionList):
            q = source.at(t)
        else:
            q = interpolation.quaternion_polynomial(source.coefficients, source.offset_s, source.scale_s, t)
        ecef_from_body = rotations.quaternion_matrices(q) @ V2_BODY_FROM_BODY
        mount = np.swapaxes(rotations.orbital_frames(p, v), 1, 2) @ ecef_from_body
        return np.zeros((len(t), 3)), mount

    def centre_position(self) -> Array:
        """Return the position (3,) at the central line, ECEF m."""
        return np.asarray(self.states((self.first_line + self.last_line) / 2.0).position_m[0])

    def look_angles(self, sample: npt.ArrayLike) -> tuple[Array, Array]:
        """Return the look angles psi_x (along track), psi_y (across track), rad, of N samples."""
        return self.metadata.look.angles(np.atleast_1d(np.asarray(sample, float)))

    def _mounting(self, states: LineStates, psi: tuple[Array, Array], to_ground_m: Array | None) -> Array:
        """Return mountings (N, 3, 3) for ground points minus projection centres (N, 3); None means height 0."""
        return states.mount

    def records(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, reference_m: Array, origin_m: Array | None = None, *,
        small_angle: bool = False,
    ) -> Array:  # fmt: skip
        """Return the constants (N, 34) of the look-angle collinearity for N image points without whitening.

        ``reference_m`` (N, 3) or (3,) are ECEF points near the observed points. Differences are
        relative to them. ``origin_m`` (3,) is the local origin of the ground unknowns, ECEF (default 0).
        """
        s = np.atleast_1d(np.asarray(sample, float))
        records = self.records_of(self.states(line), s, self.look_angles(s), reference_m, small_angle=small_angle)
        if origin_m is not None:
            records[:, RECORD.reference] -= origin_m
        return records

    def records_of(
        self, states: LineStates, sample: Array, psi: tuple[Array, Array], reference_m: Array, *, small_angle: bool
    ) -> Array:
        """Make the same records as :meth:`records` from N states, samples and look angles; the local origin is 0."""
        to_ground = reference_m - states.position_m
        return RECORD.pack(
            position=states.position_m, velocity=states.velocity_m_s, angles=states.angles_rad,
            mounting=self._mounting(states, psi, to_ground).reshape(-1, 9), tau=states.tau, look=np.stack(psi, axis=1),
            s=polynomials.normalised(sample, self.n_samples), whitening=np.eye(2).ravel(), follows=self.follows_orbit,
            small_angle=small_angle, reference=reference_m, from_position=to_ground,
        )  # fmt: skip

    def corrected_look(self, psi: tuple[Array, Array], sample: Array, correction: Correction) -> tuple[Array, Array]:
        """Return the look angles psi_x, psi_y of N samples with their corrections."""
        if not correction.look.shape[1]:
            return psi
        bend = polynomials.evaluate(correction.look, polynomials.normalised(sample, self.n_samples))
        return psi[0] + bend[:, 0], psi[1] + bend[:, 1]

    # --- image to ground ---------------------------------------------------------------------

    def rays(
        self, line: npt.ArrayLike, sample: npt.ArrayLike, correction: Correction | None = None,
        to_ground_m: Array | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return projection centres (N, 3), m, and unit viewing directions (N, 3), ECEF.

        This is the inverse of the observation equation. It has its own formula, because a direction has no ground
        point; tests/40_sensors compare both within 1e-6 px. ``to_ground_m`` (N, 3) contains ground points minus
        projection centres, for effects on light (``fg_orient.sensors.general``). Errors: see :meth:`states`.
        """
        c = correction or Correction()
        lines, s = same_length(line, sample)
        states, psi = self.states(lines), self.look_angles(s)
        p, ecef = self.oriented(states, self._mounting(states, psi, to_ground_m), c)
        return p, light.unit(np.einsum("nij,nj->ni", ecef, look.direction(*self.corrected_look(psi, s, c))))

    def oriented(self, states: LineStates, mount: Array, correction: Correction) -> tuple[Array, Array]:
        """Return projection centres (N, 3), m, and rotations (N, 3, 3) from body to ECEF."""
        delta = correction.eop_at(states.tau)
        p = states.position_m + delta[:, 0:3]
        p_frame, v_frame = states.position_m, states.velocity_m_s
        if self.follows_orbit:
            p_frame, v_frame = p, states.velocity_m_s + delta[:, 3:6]
        orbital = rotations.attitude_matrices(states.angles_rad + delta[:, 6:9], correction.small_angle) @ mount
        return p, np.asarray(rotations.orbital_frames(p_frame, v_frame) @ orbital)

    def central_mounting(self, states: LineStates) -> Array:
        """Return the mountings (N, 3, 3) of N states for the central sample and height 0."""
        psi = self.look_angles(np.full(len(states.tau), 0.5 * (self.first_sample + self.last_sample)))
        return self._mounting(states, psi, None)

    # --- ground to image ---------------------------------------------------------------------

    def project(self, ground_m: npt.ArrayLike, correction: Correction | None = None) -> tuple[Array, Array]:
        """Return line and sample of N ECEF points (N, 3), m; Newton's method (``fg_orient.sensors.projection``).

        See the module for points outside the image and for nan.
        """
        return projection.project(self, ground_rows(ground_m), correction or Correction())

    # --- adjustment --------------------------------------------------------------------------

    def image_model(self, options: Options) -> ImageModel:
        """See :class:`PushbroomModel`."""
        return PushbroomModel(self, options)

    def correction_of(self, values: Mapping[str, float], options: Options) -> Correction:
        """Make a correction from the values of the EOP coefficients by name.

        See :meth:`Sensor.correction_of`.
        """
        known = (*range(N_EOP + 2 * (MAX_LOOK_DEGREE + 1)), *range(CURVE, CURVE + 9 * CURVES))
        codes = {parameter_name(code): code for code in known}
        by_code = {codes[name]: value for name, value in values.items()}
        if not options.jitter_curves:
            return correction_by_code(by_code, options.small_angle, options.curve_intervals)
        n = 1 + max(((code - CURVE) % CURVES for code in by_code if code >= CURVE), default=-1)
        return correction_by_code(by_code, options.small_angle, n, is_jitter=True)


def require_pushbroom(sensor: Any, image: str) -> PushbroomSensor:
    """Return the sensor of an image; raise InputError if it is not a rigorous pushbroom."""
    if not isinstance(sensor, PushbroomSensor):
        kind = type(sensor).__name__
        raise InputError.of("sensor.not_rigorous", file=sensor.file, place=f"image {image}", value=kind)
    return sensor


# --- image model ---------------------------------------------------------------------------------


class PushbroomModel(ImageModel):
    """See ``fg_orient.sensors.base.ImageModel``.

    Parameters
    ----------
    sensor : PushbroomSensor
    options : Options
        EOP set and look polynomial with their prior sigmas; whether to use the small-angle form.
    """

    equation = LOOK_ANGLE_COLLINEARITY

    def __init__(self, sensor: PushbroomSensor, options: Options) -> None:
        self.sensor, self.small_angle = sensor, options.small_angle
        camera = f"{sensor.metadata.mission} {sensor.metadata.instrument}".strip()
        self.parameters = orientation_parameters(options, sensor.file, camera)
        self.n_curves = options.curve_intervals if max(self.parameters.codes) >= CURVE else 0
        self._curves = polynomials.curves

    def add_jitter(self, curves: tuple[JitterCurve, ...]) -> None:
        """See :meth:`ImageModel.add_jitter`."""
        self.parameters = with_jitter(self.parameters, curves)
        self.n_curves, self._curves = curves[0].intervals, polynomials.jitter_curves

    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Return constants whitened with ``-S^-1 J^-1``, J = dF/d(line, sample) of the metadata orientation."""
        metadata = Correction(small_angle=self.small_angle)
        out, j = projection.linearised(self.sensor, points.line, points.sample, ground_m, metadata)
        out[:, RECORD.reference] -= origin_m
        sigma = np.stack([points.sigma_line_px, points.sigma_sample_px], axis=1)
        (a, b), (c, d) = j.transpose(1, 2, 0)
        inverse = np.array([[d, -b], [-c, a]]) / (a * d - b * c)
        out[:, RECORD.whitening] = (-inverse.transpose(2, 0, 1) / sigma[:, :, None]).reshape(-1, 4)
        return np.hstack([out, self._curves(out[:, RECORD.tau], self.n_curves)]) if self.n_curves else out

    def correction(self, x: Array) -> Correction:
        """Return EOP corrections (9, 3), look corrections (2, degree + 1) and curves (9, k) in physical units."""
        values = dict(zip(self.parameters.codes, x * self.parameters.sigma, strict=True))
        is_jitter = self._curves is polynomials.jitter_curves
        return correction_by_code(values, self.small_angle, self.n_curves, is_jitter=is_jitter)

    def silent_directions(self) -> list[tuple[str, Array]]:
        """Return the directions of velocity corrections that the image cannot observe.

        The velocity acts only through V x P (docs/equations.md 3). Corrections along track and in radial direction have
        no effect. A correction across track acts like a yaw; with Earth-fixed attitudes (DIMAP v2), it has no effect.
        """
        out: list[tuple[str, Array]] = []
        frame, speed_m_s = self._central_frame()
        index = {code: j for j, code in enumerate(self.parameters.codes)}
        sigma = self.parameters.sigma
        for degree in range(3):
            rows = [index[3 * c + degree] for c in VELOCITY if 3 * c + degree in index]
            if len(rows) < len(VELOCITY):
                continue
            for axis, text in ((1, "velocity along track ({}) acts on nothing"),
                               (2, "radial velocity ({}) acts on nothing")):  # fmt: skip
                direction = np.zeros(len(sigma))
                direction[rows] = frame[:, axis]
                out.append((text.format(DEGREES[degree]), direction))
            direction = np.zeros(len(sigma))
            direction[rows] = frame[:, 0] / sigma[rows]
            yaw = index.get(3 * _YAW + degree)
            if yaw is not None and self.sensor.follows_orbit:
                direction[yaw] = 1.0 / speed_m_s / sigma[yaw]
                text = "velocity across track acts as yaw ({}): only their sum is observable"
            else:
                text = "velocity across track ({}) acts on nothing"
            out.append((text.format(DEGREES[degree]), direction / np.linalg.norm(direction)))
        return out

    def _central_frame(self) -> tuple[Array, float]:
        """Return the orbital frame at the image centre (columns across, along, radial) and the speed, m/s."""
        state = self.sensor.states((self.sensor.first_line + self.sensor.last_line) / 2.0)
        frame = rotations.orbital_frames(state.position_m, state.velocity_m_s)[0]
        return frame, float(state.velocity_m_s[0] @ frame[:, 1])

    def per_line(self) -> tuple[Array, tuple[str, ...]]:
        """Return factors to coefficients of line minus central line; nan for the look polynomial."""
        change = polynomials.per_line_from_tau(self.sensor.n_lines)
        codes, units = self.parameters.codes, self.parameters.units
        factors = np.array([change[code % 3] if code < N_EOP else np.nan for code in codes])
        powers = ("", "/line", "/line^2")
        named = zip(codes, units, strict=True)
        return factors, tuple(unit + powers[code % 3] if code < N_EOP else "" for code, unit in named)

    def facts(self) -> dict[str, Any]:
        """Return entries of the file, and degree-2 fits of its EOPs (Terlemezoğlu 2019, Table 4.1)."""
        meta, (per_tau, residuals) = self.sensor.metadata, fit_eop(self.sensor)
        per_line = per_tau * polynomials.per_line_from_tau(self.sensor.n_lines)
        rms, largest = np.sqrt(np.mean(residuals**2, axis=0)), np.abs(residuals).max(axis=0)
        rows = zip(COMPONENTS, UNITS, per_line.tolist(), rms.tolist(), largest.tolist(), strict=True)
        names = ("component", "unit", "per_line", "rms", "largest")
        return {
            "model": "pushbroom", "mission": meta.mission, "instrument": meta.instrument, "format": meta.format,
            "metadata_polynomials": [dict(zip(names, row, strict=True)) for row in rows],
        }  # fmt: skip
