"""Effects on light between ground and sensor: aberration, Earth rotation during the light time, and refraction.

Each map converts the directions of N lines of sight to the true directions of the ground points, in Earth-fixed axes at
the time of exposure. Sizes on the ground from an altitude of 700 km: aberration 18 m (v/c = 2.5e-5), light time 1.1 m
cos(latitude), refraction 1.8 m at a zenith angle of 30 degrees.

Sources: classical addition of velocities (Greslou et al. 2008, appendix); refraction of a bent ray over spherical
atmospheric layers (Saastamoinen 1972; Noerdlinger 1999 for the direction of the shift).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from factors._contract import Array

C_M_S: Final = 299_792_458.0
#: Rate of the Earth's rotation, rad/s (WGS84).
EARTH_RATE_RAD_S: Final = 7.2921151467e-5
#: Refractivity n - 1 of visible light (0.6 um) in standard air of 15 C and 101 325 Pa. Its integral over the height is
#: this number times the column of air, 101325 Pa / (1.225 kg/m3 x 9.80665 m/s2) = 8434 m.
REFRACTIVITY: Final = 2.77e-4
COLUMN_M: Final = 8434.5
#: Mean height of the refracting air, divided by the Earth's radius, because the layers are spherical. The
#: height is the integral of the pressure over the height, divided by the pressure (standard atmosphere).
MEAN_HEIGHT: Final = 7313.0 / 6_371_000.0
#: Smallest cosine of the zenith angle. At larger angles the first order in ``MEAN_HEIGHT`` is not sufficient.
STEEPEST_COSINE: Final = 0.1


def unit(vectors: Array) -> Array:
    """Return the vectors (N, 3), scaled to length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def without_aberration(direction: Array, velocity_m_s: Array) -> Array:
    """Return the geometric directions that belong to apparent directions.

    Parameters
    ----------
    direction : (N, 3) array
        Unit vectors to the apparent position of the point.
    velocity_m_s : (N, 3) array
        Inertial velocity of the sensor, in the same axes.

    Returns
    -------
    (N, 3) array
        Unit vectors u for which ``c u + v`` is parallel to ``direction``: classical addition of velocities. The
        relativistic sum differs only by (v/c)^2, 0.3 mm on the ground.
    """
    beta = velocity_m_s / C_M_S
    along = np.einsum("ni,ni->n", direction, beta)
    k = along + np.sqrt(along**2 + 1.0 - np.einsum("ni,ni->n", beta, beta))
    return unit(k[:, None] * direction - beta)


def earth_turn(ground_m: Array, distance_m: Array) -> Array:
    """Return the ground's displacement (N, 3), m, by Earth rotation in the light time, from seen to true position.

    ``ground_m`` is the position, in the axes at exposure, at ``distance_m / c`` before the exposure.
    """
    angle = EARTH_RATE_RAD_S * distance_m / C_M_S
    cosine, sine = -2.0 * np.sin(angle / 2.0) ** 2, np.sin(angle)  # cosine minus 1
    x, y = ground_m[:, 0], ground_m[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, np.zeros(len(x))], axis=1)


def zenith_excess_m(height_m: Array) -> Array:
    """Return the integral of n - 1 from a height to space, m, by standard atmospheric pressure: 2.34 m at sea level."""
    pressure = np.clip(1.0 - 2.25577e-5 * height_m, 0.0, None) ** 5.25588
    return np.asarray(REFRACTIVITY * COLUMN_M * pressure)


def refraction_shift(direction: Array, up: Array, height_m: Array) -> Array:
    """Return the ground shift (N, 3), m, from the end of the straight line of sight to the end of the bent line.

    The shift is horizontal, towards the point below the sensor: ``D tan z / cos^2 z (1 - m (3 / cos^2 z - 1))`` with D
    of :func:`zenith_excess_m` and m = ``MEAN_HEIGHT``. It is the first-order term, in n - 1 and in height / radius, of
    ``R^2 sin z int (n - 1) r / (r^2 - R^2 sin^2 z)^(3/2) dr`` over spherical layers of index n.

    Parameters
    ----------
    direction, up : (N, 3) arrays
        Unit vectors of the lines of sight, downwards, and of the ellipsoid normals at their ends.
    height_m : (N,) array
    """
    cosine = np.maximum(-np.einsum("ni,ni->n", direction, up), STEEPEST_COSINE)
    horizontal = direction + np.einsum("ni,ni->n", -direction, up)[:, None] * up
    spheres = 1.0 - MEAN_HEIGHT * (3.0 / cosine**2 - 1.0)
    return np.asarray(-(zenith_excess_m(height_m) / cosine**3 * spheres)[:, None] * horizontal)


def turns(start: Array, end: Array) -> Array:
    """Return the smallest rotations (N, 3, 3) from unit vectors (N, 3) to other, close ones (Rodrigues)."""
    v = np.cross(start, end)
    skew = np.zeros((len(v), 3, 3))
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    skew -= np.swapaxes(skew, 1, 2)
    cosine = np.einsum("ni,ni->n", start, end)
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + cosine)[:, None, None])
