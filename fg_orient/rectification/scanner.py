"""Optical-mechanical line scanner (MSS, TM) over flat ground (İpbüker 1994, section 3.3.1).

Angles are in rad, lengths in m; the scan angle theta is 0 at nadir. Some printed
equations have misprints; this module contains the corrected forms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite, number, positive


@dataclass(frozen=True)
class Scanner:
    """Scanner on a level flight line.

    Parameters
    ----------
    height_m : float
        Height above the datum, Z_c.
    ifov_along_rad, ifov_across_rad : float
        Angular resolution beta and gamma.
    focal_length_m : float
    speed_m_s : float
        Speed of the ground track.
    overlap : float
        Overlap S of a strip with the next one, as a share.
    rotation_s : float
        Period t_r of the mirror: 2 pi of scan angle.

    Raises
    ------
    InputError
        A value that is not above 0, or an overlap outside 0 .. 1.
    """

    height_m: float
    ifov_along_rad: float
    ifov_across_rad: float
    focal_length_m: float = 1.0
    speed_m_s: float = 1.0
    overlap: float = 0.0
    rotation_s: float = 1.0

    def __post_init__(self) -> None:
        units = {
            "height_m": "m",
            "ifov_along_rad": "rad",
            "ifov_across_rad": "rad",
            "focal_length_m": "m",
            "speed_m_s": "m/s",
            "rotation_s": "s",
        }
        for name, unit in units.items():
            positive(name, getattr(self, name), unit)
        if not 0.0 <= self.overlap < 1.0:
            raise InputError.of("options.value", place="overlap", value=self.overlap, expected="0 to below 1")

    @property
    def strip_m(self) -> float:
        """Width of the ground strip at nadir, dX = Z_c beta."""
        return self.height_m * self.ifov_along_rad

    @property
    def image_element_m(self) -> float:
        """Size of an element in the image, dx = f beta."""
        return self.focal_length_m * self.ifov_along_rad

    @property
    def line_time_s(self) -> float:
        """Time from strip to strip: V dt = (1 - S) dX."""
        return (1.0 - self.overlap) * self.strip_m / self.speed_m_s

    def scan_angle_rad(self, image_y_m: npt.ArrayLike) -> Array:
        """Return the scan angle theta = y/f of a distance along the scan line in the image."""
        return np.asarray(finite("image y", image_y_m) / self.focal_length_m)

    def ground(self, image_x_m: npt.ArrayLike, image_y_m: npt.ArrayLike, height_m: npt.ArrayLike = 0.0) -> Array:
        """Return X, Y (n, 2) from the first strip and from the track: ``(1 - S)(Z_c/f) x``, ``(Z_c - Z_j) tan theta``.

        The time of the mirror adds :meth:`mirror_shift_m` to X.
        """
        theta = self.scan_angle_rad(image_y_m)
        x = (1.0 - self.overlap) * self.height_m / self.focal_length_m * finite("image x", image_x_m)
        y = (self.height_m - finite("height", height_m)) * np.tan(theta)
        return np.stack(np.broadcast_arrays(x, y), axis=-1)

    def element_m(self, theta_rad: npt.ArrayLike, height_m: npt.ArrayLike = 0.0) -> Array:
        """Return the ground size of an element (n, 2): along ``beta h sec theta``, across ``gamma h sec^2 theta``."""
        secant = 1.0 / np.cos(_angle(theta_rad))
        above = self.height_m - finite("height", height_m)
        sizes = self.ifov_along_rad * above * secant, self.ifov_across_rad * above * secant**2
        return np.stack(np.broadcast_arrays(*sizes), axis=-1)

    def panoramic_shift_m(self, theta_rad: npt.ArrayLike) -> Array:
        """Return the displacement on the ground if the scan is used as a plane image: ``Z_c (tan theta - theta)``."""
        theta = _angle(theta_rad)
        return np.asarray(self.height_m * (np.tan(theta) - theta))

    def mirror_shift_m(self, theta_rad: npt.ArrayLike) -> Array:
        """Return the advance of the platform while the mirror turns to theta: ``theta/(2 pi) t_r V``."""
        return np.asarray(finite("scan angle", theta_rad) / (2.0 * math.pi) * self.rotation_s * self.speed_m_s)


def relief_shift_m(height_m: npt.ArrayLike, theta_rad: npt.ArrayLike) -> Array:
    """Return the outward displacement of a point above the datum: ``Z_j tan theta``, m.

    Raise InputError for invalid numbers.
    """
    return np.asarray(finite("height", height_m) * np.tan(_angle(theta_rad)))


def _angle(theta_rad: npt.ArrayLike) -> Array:
    """Return the checked scan angles, below the horizontal on both sides."""
    angle = finite("scan angle", theta_rad)
    if (np.abs(angle) >= 0.5 * math.pi).any():
        raise InputError.of(
            "options.value",
            place="scan angle",
            value=float(np.abs(angle).max()),
            expected="an angle from nadir, rad, between -pi/2 and pi/2",
        )
    return angle


def total_angle_rad(swath_m: float, height_m: float) -> float:
    """Return the total scan angle over flat ground, ``2 arctan(W/(2H))``.

    Raise InputError if an argument is not above 0.
    """
    return 2.0 * math.atan2(positive("swath", swath_m, "m"), 2.0 * positive("height", height_m, "m"))


def swath_m(angle_rad: float, height_m: float, off_nadir_rad: float = 0.0, radius_m: float | None = None) -> float:
    """Return the swath of a field of view, off nadir or at nadir.

    Parameters
    ----------
    angle_rad : float
        Total field of view.
    height_m : float
    off_nadir_rad : float
        Angle of its middle from nadir.
    radius_m : float, optional
        Radius of the Earth; default: flat ground.

    Returns
    -------
    float
        Length on the ground, m; nan where a ray misses the Earth.

    Raises
    ------
    InputError
        The field of view, the height or the radius is not above 0; or, over flat ground,
        a ray is beyond the horizontal.
    """
    positive("field of view", angle_rad, "rad")
    positive("height", height_m, "m")
    number("off nadir", off_nadir_rad, "rad")
    edges = (off_nadir_rad - 0.5 * angle_rad, off_nadir_rad + 0.5 * angle_rad)
    if radius_m is None:
        first, last = np.tan(_angle(edges))
        return float(height_m * (last - first))
    positive("radius", radius_m, "m")
    sines = [math.sin(edge) * (radius_m + height_m) / radius_m for edge in edges]
    if max(map(abs, sines)) > 1.0:
        return math.nan
    centre = [math.asin(sine) - edge for sine, edge in zip(sines, edges, strict=True)]
    return radius_m * (centre[1] - centre[0])


def error_budget(*parts: float) -> float:
    """Return the root of the sum of squares of errors: pointing, digitising, relief (İpbüker 1994, conclusions).

    The errors must be independent. Raises InputError without errors, or if one is below 0 or not finite.
    """
    finite("errors", parts)
    return math.sqrt(sum(number("error", part, "its unit", least=0.0) ** 2 for part in parts))
