"""Pushbroom image: look-angle collinearity with the coefficients of an EOP set as unknowns."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation
from factors.cameras.pushbroom import LOOK_ANGLE_COLLINEARITY, RECORD
from factors.geometry import polynomials
from factors.geometry.polynomials import per_line_from_tau
from factors.geometry.rotations import orbital_frames
from fg_orient.model.block import ImagePoints, Options
from fg_orient.model.names import COMPONENTS, VELOCITY
from fg_orient.model.parameters import CURVE, CURVES, DEGREES, N_EOP, UNITS, orientation_parameters
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.eop import fit_eop
from fg_orient.sensors.projection import pixel_derivative
from fg_orient.sensors.pushbroom import PushbroomSensor

Array = npt.NDArray[np.float64]

_YAW: Final = 8


class PushbroomModel:
    """See ``fg_orient.adjustment.models.contract.ImageModel``.

    Parameters
    ----------
    sensor : PushbroomSensor
    options : Options
        EOP set, look polynomial, their prior sigmas, small-angle form.
    """

    equation: Equation = LOOK_ANGLE_COLLINEARITY

    def __init__(self, sensor: PushbroomSensor, options: Options) -> None:
        self.sensor, self.small_angle = sensor, options.small_angle
        camera = f"{sensor.metadata.mission} {sensor.metadata.instrument}".strip()
        self.parameters = orientation_parameters(options, sensor.file, camera)
        self.n_curves = options.curve_intervals if max(self.parameters.codes) >= CURVE else 0

    def records(self, points: ImagePoints, ground_m: Array, origin_m: Array) -> Array:
        """Whiten with ``S^-1 J^-1``, J = dF/d(line, sample) of the metadata orientation."""
        line, sample, small = points.line, points.sample, self.small_angle
        out = self.sensor.records(line, sample, ground_m, origin_m, small_angle=small)
        j = pixel_derivative(self.sensor, line, sample, ground_m, Correction(small_angle=small))
        sigma = np.stack([points.sigma_line_px, points.sigma_sample_px], axis=1)
        out[:, RECORD.whitening] = (np.linalg.inv(j) / sigma[:, :, None]).reshape(-1, 4)
        return np.hstack([out, polynomials.curves(out[:, RECORD.tau], self.n_curves)]) if self.n_curves else out

    def correction(self, x: Array) -> Correction:
        """EOP corrections (9, 3), look corrections (2, degree + 1) and curves (9, k) in physical units."""
        eop, codes, curve = np.zeros(N_EOP), self.parameters.codes, np.zeros((9, self.n_curves))
        # psi_x and psi_y in turn: a polynomial of both has an even number
        highest = max((code for code in codes if code < CURVE), default=0) - N_EOP
        look = np.zeros(2 * (highest // 2 + 1) if highest >= 0 else 0)
        for code, value in zip(codes, x * self.parameters.sigma, strict=True):
            if code < N_EOP:
                eop[code] = value
            elif code < CURVE:
                look[code - N_EOP] = value
            else:
                curve[divmod(code - CURVE, CURVES)] = value
        look = np.ascontiguousarray(look.reshape(-1, 2).T)
        return Correction(eop.reshape(9, 3), look, self.small_angle, curve)

    def silent_directions(self) -> list[tuple[str, Array]]:
        """Velocity acts through V x P only (docs/equations.md 3).

        Along track and radial it has no effect. Across track it rotates the orbital frame like a yaw; with Earth-fixed
        attitudes (DIMAP v2) it has no effect.
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
        """Orbital frame at the image centre (columns across, along, radial) and the speed along it, m/s."""
        state = self.sensor.states((self.sensor.first_line + self.sensor.last_line) / 2.0)
        frame = orbital_frames(state.position_m, state.velocity_m_s)[0]
        return frame, float(state.velocity_m_s[0] @ frame[:, 1])

    def per_line(self) -> tuple[Array, tuple[str, ...]]:
        """Factors to coefficients of line minus central line; nan for the look polynomial."""
        change = per_line_from_tau(self.sensor.n_lines)
        codes, units = self.parameters.codes, self.parameters.units
        factors = np.array([change[code % 3] if code < N_EOP else np.nan for code in codes])
        texts = [
            unit + ("", "/line", "/line^2")[code % 3] if code < N_EOP else ""
            for code, unit in zip(codes, units, strict=True)
        ]
        return factors, tuple(texts)

    def is_valid(self, ground_m: Array) -> npt.NDArray[np.bool_]:
        """Everywhere."""
        return np.ones(len(ground_m), bool)

    def facts(self) -> dict[str, Any]:
        """Mission of the file, and degree-2 fits of its EOPs (T-Table 4.1): coefficients per line, residuals."""
        meta, fit = self.sensor.metadata, fit_eop(self.sensor)
        polynomials = [
            {"component": COMPONENTS[k], "unit": UNITS[k], "per_line": fit.per_line[k].tolist(),
             "rms": float(fit.rms[k]), "largest": float(fit.largest[k])}
            for k in range(len(COMPONENTS))
        ]  # fmt: skip
        return {
            "model": "pushbroom", "mission": meta.mission, "instrument": meta.instrument, "format": meta.format,
            "metadata_polynomials": polynomials,
        }  # fmt: skip
