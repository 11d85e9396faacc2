"""Location of points with the adjusted orientation, with covariance from measurement, orientation and height.

The whitened rows of the image points at the located point, ``e + J dx + G dX = 0``, are solved for dX.
A point of one image has a third row for the height (or the slope of the DEM). With B the inverse or,
for several images, the pseudo-inverse ``(G^T G)^-1 G^T``::

    C = B (I + J C_x J^T) B^T

C_x is the joint covariance of the images, so it includes the correlation of their errors.

Error ellipses and the radii CE90, LE90 and SE90 follow exactly from the covariance: the normal density is
integrated over the circle or sphere. The usual rule, CE90 = 2.146 times the mean of the two sigmas, is valid
for circles only. For an ellipse of 10 : 1 its result is 28 % too small.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from factors.arrays import Array
from factors.geometry import ellipsoid
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised, side_by_side, whitened_records
from fg_orient.model.block import ImagePoints
from fg_orient.model.distributions import chi_square_limit, normal_quantile, normal_within
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.quality.cofactors import Cofactors
from fg_orient.sensors import initial
from fg_orient.sensors.correction import HeightSurface

Pixel = tuple[float, float]

#: Half the distance over which the slope of a DEM is computed.
SLOPE_M = 1.0
#: Maximum number of steps of the intersection, and step length at convergence.
MAX_STEPS, STEP_M = 20, 1e-6


@dataclass(frozen=True)
class LocatedPoint:
    """A located point with its covariance.

    Parameters
    ----------
    ground_m : (3,) array
        Coordinates in ECEF, or X, Y, Z of a local system.
    covariance_m2 : (3, 3) array
        Covariance in the same axes.
    axes : (3, 3) array
        Rotation to East, North, Up; identity in a local system.
    """

    ground_m: Array
    covariance_m2: Array
    axes: Array

    @cached_property
    def covariance_enu_m2(self) -> Array:
        """Covariance (3, 3) of East, North, Up."""
        return np.asarray(self.axes @ self.covariance_m2 @ self.axes.T)

    @property
    def sigma_enu_m(self) -> Array:
        """Standard deviations of East, North, Up (3,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance_enu_m2), 0.0))

    @property
    def lon_lat_height(self) -> tuple[float, float, float]:
        """Longitude and latitude (degrees), ellipsoidal height (m)."""
        lon, lat, height = ellipsoid.geodetic_array(np.ascontiguousarray(self.ground_m[None]))[0]
        return float(np.degrees(lon)), float(np.degrees(lat)), float(height)

    @property
    def ellipse(self) -> ErrorEllipse:
        """Error ellipse of East and North."""
        return error_ellipse(self.covariance_enu_m2[:2, :2])

    @property
    def ce90_m(self) -> float:
        """Radius of the circle that contains 90 % of the horizontal errors."""
        return radius(self.covariance_enu_m2[:2, :2])

    @property
    def le90_m(self) -> float:
        """Height error that 90 % of the errors do not exceed."""
        return radius(self.covariance_enu_m2[2:, 2:])

    @property
    def se90_m(self) -> float:
        """Radius of the sphere that contains 90 % of the errors."""
        return radius(self.covariance_enu_m2)


@dataclass(frozen=True)
class Orientation:
    """Adjusted orientation of a block; ``scale`` converts roots of cofactors to standard deviations."""

    problem: Problem
    state: State
    cofactors: Cofactors
    scale: float

    def index(self, image: str) -> int:
        """Return the index of an image; InputError for an unknown image."""
        place = self.problem.block.find(f"image:{image}")
        if place is None:
            raise InputError.of("covariance.no_such", place="image", value=image)
        return place[1]

    def measured(self, pixels: Mapping[str, Pixel], sigma_px: Pixel | None) -> ImagePoints:
        """Return the image points of one ground point.

        Default sigmas are the medians of the image's measurements times ``scale``.
        """
        o = self.problem.observations
        rows = []
        for image, (line, sample) in pixels.items():
            k = self.index(image)
            own = o.image == k
            usual = (
                self.scale * float(np.median(s[own])) if own.any() else np.nan
                for s in (o.sigma_line_px, o.sigma_sample_px)
            )
            rows.append((k, 0, line, sample, *(sigma_px or usual)))
        columns = [np.array(c) for c in zip(*rows, strict=True)]
        if not (np.isfinite(columns[4:]).all() and np.min(columns[4:]) > 0.0):
            raise InputError.of("statistics.sigma_px", place="sigma_px", value=sigma_px)
        return ImagePoints(*columns)

    def rows(self, points: ImagePoints, ground_m: Array) -> tuple[Array, Array, Array]:
        """Return whitened residuals (2k,), derivatives by the ground point (2k, 3), and ``J C_x J^T`` (2k, 2k)."""
        p, k = self.problem, len(points)
        records = whitened_records(p.models, points, ground_m[None], p.origin_m)
        at = State(self.state.image, (ground_m - p.origin_m)[None])
        values, by_image, by_point = linearised(replace(p, observations=points, records=records), at)
        d_image, _, images = side_by_side(p, points.image, by_image)
        c = self.scale**2 * d_image @ self.cofactors.joint(images, ()) @ d_image.T
        return values.ravel(), by_point.reshape(2 * k, 3), c


def locate(
    orientation: Orientation,
    image: str,
    pixel: Pixel,
    *,
    height_m: float | None,
    dem: HeightSurface | None,
    height_sigma_m: float,
    sigma_px: Pixel | None,
) -> LocatedPoint:
    """Locate a pixel of one image at a height or on a DEM; see ``Solution.locate``."""
    if (height_m is None) == (dem is None):
        raise InputError.of("statistics.one_height", place="height_m, dem")
    if not (np.isfinite(height_sigma_m) and height_sigma_m >= 0.0):
        raise InputError.of("statistics.height_sigma", place="height_sigma_m", value=height_sigma_m)
    p, k = orientation.problem, orientation.index(image)
    sensor = p.block.images[k].sensor
    correction = p.corrections(orientation.state)[k]
    ground = sensor.locate([pixel[0]], [pixel[1]], height_m=height_m, dem=dem, correction=correction)[0]
    _, g, c = orientation.rows(orientation.measured({image: pixel}, sigma_px), ground)
    axes = p.axes(ground[None])[0]
    slope = np.zeros(2) if dem is None else _slope(dem, ground, axes)
    b = np.linalg.inv(np.vstack([g, np.array([-slope[0], -slope[1], 1.0]) @ axes]))
    noise = np.zeros((3, 3))
    noise[:2, :2], noise[2, 2] = np.eye(2) + c, height_sigma_m**2
    return LocatedPoint(ground, b @ noise @ b.T, axes)


def _slope(dem: HeightSurface, ground_m: Array, axes: Array) -> Array:
    """Return the slope of the DEM to East and North, metres per metre, over 2 m around the point."""
    steps = SLOPE_M * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    lon, lat, _ = ellipsoid.geodetic_array(np.ascontiguousarray(ground_m + steps @ axes)).T
    east, west, north, south = dem.height_m(np.degrees(lon), np.degrees(lat))
    slope = np.array([east - west, north - south]) / (2.0 * SLOPE_M)
    if not np.isfinite(slope).all():
        raise InputError.of("statistics.dem_border", file=dem.path, place="locate")
    return slope


def intersect(orientation: Orientation, pixels: Mapping[str, Pixel], *, sigma_px: Pixel | None) -> LocatedPoint:
    """Intersect the rays of a point in two or more images, by least squares; see ``Solution.intersect``."""
    if len(pixels) < 2:
        raise InputError.of("statistics.one_image", place="pixels", value=", ".join(pixels))
    p, points = orientation.problem, orientation.measured(pixels, sigma_px)
    corrections = p.corrections(orientation.state)
    ground = initial.intersect(
        [p.block.images[k].sensor for k in points.image],
        points.line,
        points.sample,
        [corrections[k] for k in points.image],
    )[0]
    for _ in range(MAX_STEPS):
        residual, g, c = orientation.rows(points, ground)
        step = -np.linalg.lstsq(g, residual, rcond=None)[0]
        ground = ground + step
        if np.abs(step).max() < STEP_M:
            break
    else:
        raise NoSolutionError.of("statistics.not_located", place=", ".join(pixels), value=MAX_STEPS)
    b = np.linalg.pinv(g)
    return LocatedPoint(ground, b @ (np.eye(len(c)) + c) @ b.T, p.axes(ground[None])[0])


# --- error ellipses and radii ---------------------------------------------------------------------

#: Gauss-Legendre nodes on a quarter circle: error below 1e-8 of probability for any ratio of the axes (tested).
NODES: Final = 96
#: Number of sigmas above which the normal density is negligible.
FAR: Final = 9.0
_NODE, _WEIGHT = np.polynomial.legendre.leggauss(NODES)


@dataclass(frozen=True)
class ErrorEllipse:
    """Error ellipse of one sigma (contains 39 % of the errors).

    Parameters
    ----------
    semi_major_m, semi_minor_m : float
    azimuth_deg : float
        Azimuth of the major axis, from North over East, 0 to 180.
    """

    semi_major_m: float
    semi_minor_m: float
    azimuth_deg: float


def error_ellipse(covariance_m2: Array) -> ErrorEllipse:
    """Compute the error ellipse of East and North from their covariance (2, 2)."""
    size, axes = np.linalg.eigh(covariance_m2)
    minor, major = np.sqrt(np.maximum(size, 0.0))
    east, north = axes[:, 1]
    return ErrorEllipse(float(major), float(minor), float(np.degrees(np.arctan2(east, north)) % 180.0))


def radius(covariance: Array, probability: float = 0.9) -> float:
    """Compute the radius of the interval, circle or sphere around 0 that contains this share of normal errors.

    Parameters
    ----------
    covariance : (d, d) array
        d = 1 (LE90), 2 (CE90) or 3 (SE90); may be singular.
    probability : float
        Above 0, below 1.

    Returns
    -------
    float
        Radius in the unit of the root of the covariance.
    """
    from scipy.optimize import brentq

    sigma = np.sqrt(np.maximum(np.linalg.eigvalsh(np.atleast_2d(covariance)), 0.0))[::-1]
    if sigma[0] == 0.0:
        return 0.0
    # the lower bound is exact for errors along one axis, the upper bound for equal errors along all axes
    low = float(normal_quantile(0.5 * (1.0 + probability)))
    if len(sigma) == 1 or sigma[1] == 0.0:
        return float(low * sigma[0])
    high = float(np.sqrt(chi_square_limit(len(sigma), 1.0 - probability)))
    share = sigma / sigma[0]
    root = brentq(lambda r: inside(share, r) - probability, 0.999 * low, 1.001 * high, xtol=1e-13, rtol=1e-13)
    return float(root * sigma[0])


def inside(sigma: Array, r: float) -> float:
    """Return probability of a distance below r for independent normal errors with these sigmas (d,), largest first."""
    return float(_inside(sigma, np.array([r]))[0])


def _inside(sigma: Array, r: Array) -> Array:
    """Compute :func:`inside` for radii (n,); one axis is integrated after the other."""
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
