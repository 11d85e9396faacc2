"""Arguments of a sensor: corrections of its orientation, and surfaces to locate on; EOP polynomials of its metadata.

The publications describe each of the nine EOPs as ``q0 + q1 l + q2 l^2`` of the line (Terlemezoğlu 2019, eq. 2.34,
Table 4.1). The adjustment does not use these fits, because it corrects the metadata itself; their residuals are the
deviations of the metadata from the published model.
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
    """A surface to locate on: ellipsoidal height (m) at longitude, latitude (degrees), nan outside."""

    path: str

    @property
    def range_m(self) -> tuple[float, float]:
        """Lowest and highest height."""
        ...

    def cell(self, lon_deg: Array, lat_deg: Array) -> tuple[Array, Array]:
        """Row and column of N points in the surface's grid; rays are followed cell by cell."""
        ...

    def height_m(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Ellipsoidal heights of N points."""
        ...


@dataclass(frozen=True)
class Correction:
    """Orientation corrections of one image in physical units.

    Parameters
    ----------
    eop : (9, 3) array
        c0, c1, c2 of tau for X, Y, Z (m), VX, VY, VZ (m/s), roll, pitch, yaw (rad).
    look : (2, k) array
        Coefficients of s^k added to psi_x and psi_y (rad).
    small_angle : bool
        Use the small-angle attitude matrix (faithful mode).
    curve : (9, k) array
        Amplitudes of the curves of ``factors.geometry.polynomials`` over k intervals, for the nine EOP.
    """

    eop: Array = field(default_factory=lambda: np.zeros((9, 3)))
    look: Array = field(default_factory=lambda: np.zeros((2, 0)))
    small_angle: bool = False
    curve: Array = field(default_factory=lambda: np.zeros((9, 0)))

    def curve_at(self, tau: Array) -> Array:
        """Contribution of the curves to the nine EOP (N, 9) at N line times tau."""
        return np.asarray(polynomials.curves(tau, self.curve.shape[1]) @ self.curve.T)

    def eop_at(self, tau: Array) -> Array:
        """Corrections of the nine EOP (N, 9) at N line times tau."""
        smooth = polynomials.evaluate(self.eop, tau)
        return smooth + self.curve_at(tau) if self.curve.shape[1] else smooth


# --- EOP polynomials -----------------------------------------------------------------------------

#: Number of lines at which the polynomials are fitted.
EOP_LINES: Final = 601


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


def fit_eop(sensor: PushbroomSensor) -> tuple[Array, Array]:
    """Degree-2 polynomials of X, Y, Z (m), VX, VY, VZ (m/s), roll, pitch, yaw (rad) at evenly spaced lines.

    Returns
    -------
    per_tau : (9, 3) array
        c0, c1, c2 of tau, which is -1 at the first and 1 at the last line of the image.
    residuals : (N, 9) array
        Metadata minus polynomial at the N lines.
    """
    line = np.linspace(sensor.first_line, sensor.last_line, EOP_LINES)
    return polynomials.fit(polynomials.normalised(line, sensor.n_lines), metadata_eop(sensor, line), 2)
