"""EOP polynomials of an image: degree-2 fits to the metadata, with their residuals.

The publications describe each of the nine EOPs as ``q0 + q1 l + q2 l^2`` of the line
(Terlemezoğlu 2019, eq. 2.34, Table 4.1). The adjustment does not use these fits (it
corrects the metadata itself), but how well a parabola describes the metadata says what the
published model left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.geometry import polynomials
from fg_orient.sensors.pushbroom import PushbroomSensor

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class EopPolynomials:
    """Fit of X, Y, Z (m), VX, VY, VZ (m/s), roll, pitch, yaw (rad) over the image.

    Parameters
    ----------
    per_tau : (9, 3) array
        c0, c1, c2 of tau in [-1, 1].
    per_line : (9, 3) array
        q0, q1, q2 per line about the same central line.
    rms, largest : (9,) arrays
        Residuals metadata minus polynomial at the sampled lines.
    """

    per_tau: Array
    per_line: Array
    rms: Array
    largest: Array


def metadata_eop(sensor: PushbroomSensor, line: Array) -> Array:
    """The nine EOPs of the metadata at N lines: (N, 9); attitudes in the orbital frame of convention B."""
    states = sensor.states(line)
    angles = states.angles_rad
    if not sensor.follows_orbit:
        m = states.mount
        roll = np.arcsin(m[:, 0, 2])
        pitch, yaw = np.arctan2(-m[:, 1, 2], m[:, 2, 2]), np.arctan2(-m[:, 0, 1], m[:, 0, 0])
        angles = np.stack([roll, pitch, yaw], axis=1)
    return np.hstack([states.position_m, states.velocity_m_s, angles])


def fit_eop(sensor: PushbroomSensor, n_lines: int = 601) -> EopPolynomials:
    """Fit degree-2 polynomials to the metadata at ``n_lines`` evenly spaced lines that it covers."""
    line = np.linspace(sensor.first_line, sensor.last_line, n_lines)
    values = metadata_eop(sensor, line)
    per_tau, residual = polynomials.fit(polynomials.normalised(line, sensor.n_lines), values, 2)
    return EopPolynomials(
        per_tau,
        per_tau * polynomials.per_line_from_tau(sensor.n_lines),
        np.sqrt(np.mean(residual**2, axis=0)),
        np.abs(residual).max(axis=0),
    )
