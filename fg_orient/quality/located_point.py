"""Points located with the adjusted orientation, and the covariance that measurement, orientation and height give them.

The whitened rows of the image points at the located point, ``e + J dx + G dX = 0``, are solved for dX; a point of one
image has a third row, the height (or the slope of the DEM). With B the inverse or, of several images, the
pseudo-inverse ``(G^T G)^-1 G^T``::

    C = B (I + J C_x J^T) B^T

C_x is the joint covariance of the images, so that errors that two images share are not taken for independent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from factors.geometry import ellipsoid
from fg_orient.adjustment.problem import Problem, State, whitened_records
from fg_orient.adjustment.rows import linearised, side_by_side
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.quality.covariance import Cofactors
from fg_orient.quality.regions import ErrorEllipse, error_ellipse, radius
from fg_orient.sensors import initial
from fg_orient.sensors.correction import HeightSurface
from fg_orient.sensors.rpc_sensor import RpcSensor

Array = npt.NDArray[np.float64]
Pixel = tuple[float, float]

#: Half the step of the slope of a DEM.
SLOPE_M = 1.0
#: Steps of the intersection, and the length of the last.
MAX_STEPS, STEP_M = 20, 1e-6


@dataclass(frozen=True)
class LocatedPoint:
    """A located point with its covariance.

    Parameters
    ----------
    ground_m : (3,) array
        ECEF, or X, Y, Z of a local system.
    covariance_m2 : (3, 3) array
        Same axes.
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
        """Radius of the circle that holds 90 % of the horizontal errors."""
        return radius(self.covariance_enu_m2[:2, :2])

    @property
    def le90_m(self) -> float:
        """Height error that 90 % do not exceed."""
        return radius(self.covariance_enu_m2[2:, 2:])

    @property
    def se90_m(self) -> float:
        """Radius of the sphere that holds 90 % of the errors."""
        return radius(self.covariance_enu_m2)


@dataclass(frozen=True)
class Orientation:
    """Adjusted orientation of a block: ``scale`` turns roots of cofactors into standard deviations."""

    problem: Problem
    state: State
    cofactors: Cofactors
    scale: float

    def index(self, image: str) -> int:
        """Number of an image.

        Raises
        ------
        InputError
            There is no such image.
        """
        found = self.problem.block.find(f"image:{image}")
        if found is None:
            raise InputError.of("covariance.no_such", place="image", value=image)
        return found[1]

    def measured(self, pixels: Mapping[str, Pixel], sigma_px: Pixel | None) -> ImagePoints:
        """Image points of one ground point.

        Sigmas that are not given are the medians of the image's measurements times ``scale``.
        """
        o = self.problem.observations
        rows = []
        for image, (line, sample) in pixels.items():
            k = self.index(image)
            own = o.image == k
            usual = (self.scale * float(np.median(s[own])) if own.any() else np.nan
                     for s in (o.sigma_line_px, o.sigma_sample_px))  # fmt: skip
            rows.append((k, 0, line, sample, *(sigma_px or usual)))
        columns = [np.array(c) for c in zip(*rows, strict=True)]
        if not (np.isfinite(columns[4:]).all() and np.min(columns[4:]) > 0.0):
            raise InputError.of("statistics.sigma_px", place="sigma_px", value=sigma_px)
        return ImagePoints(*columns)

    def rows(self, points: ImagePoints, ground_m: Array) -> tuple[Array, Array, Array]:
        """Whitened residuals (2k,), their derivatives by the ground point (2k, 3), and ``J C_x J^T`` (2k, 2k)."""
        p, k = self.problem, len(points)
        records = whitened_records(p.models, points, ground_m[None], p.origin_m)
        at = State(self.state.image, (ground_m - p.origin_m)[None])
        values, by_image, by_point = linearised(replace(p, observations=points, records=records), at)
        d_image, _, images = side_by_side(p, points.image, by_image)
        c = self.scale**2 * d_image @ self.cofactors.joint(images, ()) @ d_image.T
        return values.ravel(), by_point.reshape(2 * k, 3), c


def locate(
    orientation: Orientation, image: str, pixel: Pixel, *, height_m: float | None, dem: HeightSurface | None,
    height_sigma_m: float, sigma_px: Pixel | None,
) -> LocatedPoint:  # fmt: skip
    """Locate a pixel of one image at a height or on a DEM; see ``Solution.locate``."""
    if (height_m is None) == (dem is None):
        raise InputError.of("statistics.one_height", place="height_m, dem")
    if not (np.isfinite(height_sigma_m) and height_sigma_m >= 0.0):
        raise InputError.of("statistics.height_sigma", place="height_sigma_m", value=height_sigma_m)
    p, k = orientation.problem, orientation.index(image)
    sensor = p.block.images[k].sensor
    word = "compensation" if isinstance(sensor, RpcSensor) else "correction"
    how: dict[str, Any] = {"height_m": height_m, "dem": dem, word: p.corrections(orientation.state)[k]}
    ground = np.asarray(sensor.locate(np.array([pixel[0]]), np.array([pixel[1]]), **how))[0]
    _, g, c = orientation.rows(orientation.measured({image: pixel}, sigma_px), ground)
    axes = p.axes(ground[None])[0]
    slope = np.zeros(2) if dem is None else _slope(dem, ground, axes)
    b = np.linalg.inv(np.vstack([g, np.array([-slope[0], -slope[1], 1.0]) @ axes]))
    noise = np.zeros((3, 3))
    noise[:2, :2], noise[2, 2] = np.eye(2) + c, height_sigma_m**2
    return LocatedPoint(ground, b @ noise @ b.T, axes)


def _slope(dem: HeightSurface, ground_m: Array, axes: Array) -> Array:
    """Slope of the DEM to East and North, metres per metre, over 2 m about the point."""
    steps = SLOPE_M * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    lon, lat, _ = ellipsoid.geodetic_array(np.ascontiguousarray(ground_m + steps @ axes)).T
    east, west, north, south = dem.height_m(np.degrees(lon), np.degrees(lat))
    found = np.array([east - west, north - south]) / (2.0 * SLOPE_M)
    if not np.isfinite(found).all():
        raise InputError.of("statistics.dem_border", file=dem.path, place="locate")
    return found


def intersect(orientation: Orientation, pixels: Mapping[str, Pixel], *, sigma_px: Pixel | None) -> LocatedPoint:
    """Intersect the rays of a point in two images or more, by least squares; see ``Solution.intersect``."""
    if len(pixels) < 2:
        raise InputError.of("statistics.one_image", place="pixels", value=", ".join(pixels))
    p, points = orientation.problem, orientation.measured(pixels, sigma_px)
    corrections = p.corrections(orientation.state)
    ground = initial.intersect(
        [p.block.images[k].sensor for k in points.image], points.line, points.sample,
        [corrections[k] for k in points.image],
    )[0]  # fmt: skip
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
