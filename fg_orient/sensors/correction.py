"""Correct the orientation of a pushbroom, describe height surfaces, and fit polynomials to the EOPs of the metadata.

The publications describe each of the nine EOPs by a polynomial of the line, ``q0 + q1 l +
q2 l^2`` (Terlemezoğlu 2019, eq. 2.34, Table 4.1). The adjustment does not use these
polynomials, because it corrects the metadata directly. The residuals of the fits show how
much the metadata deviate from the published model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from factors.arrays import Array
from factors.geometry import polynomials
from fg_orient.model.parameters import CURVE, CURVES, N_EOP

if TYPE_CHECKING:
    from fg_orient.sensors.pushbroom import PushbroomSensor


class HeightSurface(Protocol):
    """Surface on which pixels are located.

    It gives the ellipsoidal height (m) at longitude and latitude (degrees); nan outside the surface.
    """

    path: str

    @property
    def range_m(self) -> tuple[float, float]:
        """Return the lowest and the highest height, m."""
        ...

    def cell(self, lon_deg: Array, lat_deg: Array) -> tuple[Array, Array]:
        """Return row and column of N points in the grid of the surface.

        Rays are followed from cell to cell.
        """
        ...

    def height_m(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Return the ellipsoidal heights of N points, m."""
        ...


@dataclass(frozen=True)
class Wave:
    """Sine wave of one EOP over the lines of an image, used for simulated jitter.

    The value at tau is ``amplitude sin(pi cycles (tau + 1) + phase)``: ``phase`` is its
    phase at the first line.

    Parameters
    ----------
    component : int
        Position of the EOP in ``fg_orient.model.names.COMPONENTS``: 6 is roll, 7 pitch.
    amplitude : float
        m, m/s or rad.
    cycles : float
        Number of cycles from the first to the last line.
    phase_rad : float
    """

    component: int
    amplitude: float
    cycles: float
    phase_rad: float

    def at(self, tau: Array) -> Array:
        """Value (N,) at N line times tau."""
        return np.asarray(self.amplitude * np.sin(np.pi * self.cycles * (tau + 1.0) + self.phase_rad))


@dataclass(frozen=True)
class Correction:
    """Corrections of the orientation of one image, in physical units.

    Parameters
    ----------
    eop : (9, 3) array
        Coefficients c0, c1, c2 of polynomials in tau for X, Y, Z (m), VX, VY, VZ (m/s), roll, pitch, yaw (rad).
    look : (2, k) array
        Coefficients of the powers s^k that are added to psi_x and psi_y (rad).
    small_angle : bool
        Whether to use the small-angle attitude matrix, as published (faithful mode).
    curve : (9, k) array
        Amplitudes of the curves of ``factors.geometry.polynomials`` over k intervals, for the nine EOPs.
    waves : tuple of Wave
        Simulated jitter.
    """

    eop: Array = field(default_factory=lambda: np.zeros((9, 3)))
    look: Array = field(default_factory=lambda: np.zeros((2, 0)))
    small_angle: bool = False
    curve: Array = field(default_factory=lambda: np.zeros((9, 0)))
    waves: tuple[Wave, ...] = ()

    @property
    def is_quadratic(self) -> bool:
        """True if the EOPs are corrected by polynomials of degree 2 only."""
        return not self.curve.shape[1] and not self.waves

    def curve_at(self, tau: Array) -> Array:
        """Return what curves and waves add to the corrections of the nine EOPs (N, 9) at N line times tau."""
        n = self.curve.shape[1]
        out = polynomials.curves(tau, n) @ self.curve.T if n else np.zeros((len(tau), 9))
        for wave in self.waves:
            out[:, wave.component] += wave.at(tau)
        return np.asarray(out)

    def eop_at(self, tau: Array) -> Array:
        """Return the corrections of the nine EOPs (N, 9) at N line times tau."""
        smooth = polynomials.evaluate(self.eop, tau)
        return smooth if self.is_quadratic else smooth + self.curve_at(tau)


def correction_by_code(
    values: Mapping[int, float], small_angle: bool, n_curves: int, *, is_jitter: bool = False
) -> Correction:
    """Make a correction from values by code of the unknown, in physical units; ``is_jitter`` is the kind of curves."""
    eop, curve = np.zeros(N_EOP), np.zeros((9, n_curves))
    # the codes of psi_x and psi_y alternate: polynomials of both have an even number of codes
    highest = max((code for code in values if code < CURVE), default=0) - N_EOP
    look = np.zeros(2 * (highest // 2 + 1) if highest >= 0 else 0)
    for code, value in values.items():
        if code < N_EOP:
            eop[code] = value
        elif code < CURVE:
            look[code - N_EOP] = value
        else:
            curve[divmod(code - CURVE, CURVES)] = value
    if is_jitter and n_curves:
        curve = np.ascontiguousarray(curve @ polynomials.curves_from_jitter(n_curves).T)
    return Correction(eop.reshape(9, 3), np.ascontiguousarray(look.reshape(-1, 2).T), small_angle, curve)


# --- EOP polynomials -----------------------------------------------------------------------------

#: Number of lines at which the polynomials are fitted.
EOP_LINES: Final = 601


def metadata_eop(sensor: PushbroomSensor, line: Array) -> Array:
    """Return the nine EOPs of the metadata (N, 9) at N lines.

    Attitudes refer to the orbital frame of convention B.
    """
    states = sensor.states(line)
    angles = states.angles_rad
    if not sensor.follows_orbit:
        m = states.mount
        roll = np.arcsin(m[:, 0, 2])
        pitch, yaw = np.arctan2(-m[:, 1, 2], m[:, 2, 2]), np.arctan2(-m[:, 0, 1], m[:, 0, 0])
        angles = np.stack([roll, pitch, yaw], axis=1)
    return np.hstack([states.position_m, states.velocity_m_s, angles])


def fit_eop(sensor: PushbroomSensor) -> tuple[Array, Array]:
    """Fit polynomials of degree 2 to X, Y, Z (m), VX, VY, VZ (m/s), roll, pitch, yaw (rad) at equally spaced lines.

    Returns
    -------
    per_tau : (9, 3) array
        Coefficients c0, c1, c2 of tau. tau is -1 at the first and 1 at the last line of the image.
    residuals : (N, 9) array
        Metadata minus polynomial at N lines.
    """
    line = np.linspace(sensor.first_line, sensor.last_line, EOP_LINES)
    return polynomials.fit(polynomials.normalised(line, sensor.n_lines), metadata_eop(sensor, line), 2)
