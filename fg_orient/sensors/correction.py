"""Corrections of a pushbroom's orientation, height surfaces, and polynomials fitted to the EOPs of the metadata.

The publications describe each of the nine EOPs by a polynomial of the line, ``q0 + q1 l +
q2 l^2`` (Terlemezoğlu 2019, eq. 2.34, Table 4.1). The adjustment does not use these
polynomials, because it corrects the metadata directly. The residuals of the fits show how
much the metadata deviate from the published model.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from factors.arrays import Array
from factors.geometry import polynomials

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
    """

    eop: Array = field(default_factory=lambda: np.zeros((9, 3)))
    look: Array = field(default_factory=lambda: np.zeros((2, 0)))
    small_angle: bool = False
    curve: Array = field(default_factory=lambda: np.zeros((9, 0)))

    def curve_at(self, tau: Array) -> Array:
        """Return the part of the curves in the corrections of the nine EOPs (N, 9) at N line times tau."""
        return np.asarray(polynomials.curves(tau, self.curve.shape[1]) @ self.curve.T)

    def eop_at(self, tau: Array) -> Array:
        """Return the corrections of the nine EOPs (N, 9) at N line times tau."""
        smooth = polynomials.evaluate(self.eop, tau)
        return smooth + self.curve_at(tau) if self.curve.shape[1] else smooth


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
