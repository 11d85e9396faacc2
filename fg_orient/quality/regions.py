"""Error ellipses, and radii that hold a share of the errors, exactly from the covariance.

The usual rule, CE90 = 2.146 times the mean of the two sigmas, holds for circles only: for an ellipse of 10 : 1 it is
28 % too small. Here the normal density is integrated over the circle or sphere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.distributions import chi_square_limit, normal_quantile, normal_within

Array = npt.NDArray[np.float64]

#: Nodes of Gauss-Legendre on a quarter circle: 1e-8 of probability for any ratio of the axes (tested).
NODES: Final = 96
#: Sigmas beyond which there is nothing of a normal density.
FAR: Final = 9.0
_NODE, _WEIGHT = np.polynomial.legendre.leggauss(NODES)


@dataclass(frozen=True)
class ErrorEllipse:
    """Ellipse of one sigma (39 % of the errors).

    Parameters
    ----------
    semi_major_m, semi_minor_m : float
    azimuth_deg : float
        Of the major axis, from North over East, 0 to 180.
    """

    semi_major_m: float
    semi_minor_m: float
    azimuth_deg: float


def error_ellipse(covariance_m2: Array) -> ErrorEllipse:
    """Error ellipse of East and North from their covariance (2, 2)."""
    size, axes = np.linalg.eigh(covariance_m2)
    minor, major = np.sqrt(np.maximum(size, 0.0))
    east, north = axes[:, 1]
    return ErrorEllipse(float(major), float(minor), float(np.degrees(np.arctan2(east, north)) % 180.0))


def radius(covariance: Array, probability: float = 0.9) -> float:
    """Radius of the interval, circle or sphere about 0 that holds this share of normal errors.

    Parameters
    ----------
    covariance : (d, d) array
        d = 1 (LE90), 2 (CE90) or 3 (SE90); may be singular.
    probability : float
        Above 0, below 1.

    Returns
    -------
    float
        In the unit of the root of the covariance.
    """
    from scipy.optimize import brentq

    sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(np.atleast_2d(covariance)), 0.0))[::-1]
    if sigma[0] == 0.0:
        return 0.0
    low = float(normal_quantile(0.5 * (1.0 + probability)))  # all of it along one axis; the upper end: along all axes
    if len(sigma) == 1 or sigma[1] == 0.0:
        return float(low * sigma[0])
    high = float(np.sqrt(chi_square_limit(len(sigma), 1.0 - probability)))
    share = sigma / sigma[0]
    found = brentq(lambda r: inside(share, r) - probability, 0.999 * low, 1.001 * high, xtol=1e-13, rtol=1e-13)
    return float(found * sigma[0])


def inside(sigma: Array, r: float) -> float:
    """Probability of a distance below r for independent normal errors with these sigmas (d,), largest first."""
    return float(_inside(sigma, np.array([r]))[0])


def _inside(sigma: Array, r: Array) -> Array:
    """See :func:`inside`, for radii (n,); one axis is integrated after the other."""
    if sigma[0] == 0.0:
        return np.ones_like(r)
    if len(sigma) == 1:
        return normal_within(r, float(sigma[0]))
    x = r[:, None] / sigma[0]
    end = np.arcsin(np.minimum(FAR / np.maximum(x, FAR), 1.0))
    angle = 0.5 * end * (_NODE + 1.0)
    density = np.sqrt(2.0 / np.pi) * np.exp(-0.5 * (x * np.sin(angle)) ** 2) * x * np.cos(angle)
    rest = _inside(sigma[1:], (r[:, None] * np.cos(angle)).ravel()).reshape(len(r), -1)
    return np.asarray(np.sum(0.5 * end * _WEIGHT * density * rest, axis=1))
