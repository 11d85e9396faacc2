"""What flows into a sensor: corrections of its orientation, and surfaces to locate on.

``PixelModel`` is what ``fg_orient.sensors.projection`` needs of a line sensor.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from factors.geometry import polynomials

Array = npt.NDArray[np.float64]


class HeightSurface(Protocol):
    """A surface to locate on: ellipsoidal height (m) at longitude, latitude (degrees), nan outside."""

    path: str

    @property
    def range_m(self) -> tuple[float, float]:
        """Lowest and highest height."""
        ...

    def cell(self, lon_deg: Array, lat_deg: Array) -> tuple[Array, Array]:
        """Row and column of N points in the surface's grid; the unit is what a ray may step over."""
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
        """What the curves add to the nine EOP (N, 9) at N line times tau."""
        return np.asarray(polynomials.curves(tau, self.curve.shape[1]) @ self.curve.T)

    def eop_at(self, tau: Array) -> Array:
        """Corrections of the nine EOP (N, 9) at N line times tau."""
        found = polynomials.evaluate(self.eop, tau)
        return found + self.curve_at(tau) if self.curve.shape[1] else found


class PixelModel(Protocol):
    """A line sensor as the projection sees it."""

    first_line: float
    last_line: float
    first_sample: float
    last_sample: float

    def records(
        self,
        line: npt.ArrayLike,
        sample: npt.ArrayLike,
        reference_m: Array,
        origin_m: Array | None = None,
        *,
        small_angle: bool = False,
    ) -> Array:
        """Constants of the look-angle collinearity for N image points: (N, 34)."""
        ...

    def centre_position(self) -> Array:
        """Position at the central line, ECEF m (3,)."""
        ...
