"""Epipolar curve of a pixel in another image, with its band, from the sensor models.

A pixel of image a and the heights of the ground define a short curve in image b, ``P(t) = c0 + c1 t + c2 t^2``, with t
= -1 at the lowest and 1 at the highest height. A candidate has two coordinates: t, which is a height, and its distance
across the curve, the y-parallax. The prior sigmas of the orientation give the standard deviation of the distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.geodesy import ecef_to_geodetic
from fg_orient.model.block import Options
from fg_orient.sensors.rpc_sensor import RpcSensor

#: Lowest and highest height, relative to the mean height, of a scene without a stated range of heights, m.
BELOW_M, ABOVE_M = 1000.0, 3000.0
#: Distance of pixels for numerical derivatives.
STEP_PX: Final = 8.0
#: Smallest length of a curve with a defined direction, pixels. If curves are shorter,
#: both images see the ground from nearly the same direction.
LEAST_CURVE_PX: Final = 1e-3


class Curves(NamedTuple):
    """Epipolar curves of n pixels.

    Parameters
    ----------
    c0, c1, c2 : (n, 2) arrays
        Coefficients of the curve P(t) = c0 + c1 t + c2 t^2, pixels.
    along, across : (n, 2) arrays
        Unit vectors along and across the curve.
    half_px : (n,) array
        Half length of the curve, px.
    """

    c0: Array
    c1: Array
    c2: Array
    along: Array
    across: Array
    half_px: Array

    def at(self, t: Array) -> Array:
        """Return the points (n, 2) at t (n,)."""
        t = np.asarray(t)[:, None]
        return self.c0 + t * (self.c1 + t * self.c2)

    def take(self, rows: Any) -> Curves:
        """Return the curves of some pixels."""
        return Curves(*(part[rows] for part in self))

    def coordinates(self, points: Array) -> tuple[Array, Array]:
        """Return t and y-parallax (px) of points (n, 2), one for each curve."""
        t = np.einsum("ni,ni->n", points - self.c0, self.along) / self.half_px
        for _ in range(2):  # two steps are sufficient, because the curve is almost straight
            t = t - np.einsum("ni,ni->n", self.at(t) - points, self.along) / self.half_px
        return t, np.einsum("ni,ni->n", points - self.at(t), self.across)


@dataclass(frozen=True, eq=False)
class Pair:
    """Two images and the heights of their common ground.

    Parameters
    ----------
    a, b : Sensor
    low_m, high_m : float
        Ellipsoidal heights at t = -1 and 1.
    """

    a: Any
    b: Any
    low_m: float
    high_m: float

    def ground(self, line: Array, sample: Array, height_m: Array | float) -> Array:
        """Locate pixels of a at heights: ground points (n, 3) ECEF m.

        Pixels beyond the model's edge are moved to it.
        """
        s = self.a
        line = np.clip(line, s.first_line - 0.5, s.last_line + 0.5)
        sample = np.clip(sample, s.first_sample - 0.5, s.last_sample + 0.5)
        return np.asarray(s.locate(line, sample, height_m=height_m))

    def project(self, line: Array, sample: Array, height_m: Array | float) -> Array:
        """Return the pixels (n, 2) in b of pixels of a at heights."""
        return np.stack(self.b.project(self.ground(line, sample, height_m)), axis=1)

    def curves(self, line: Array, sample: Array) -> Curves:
        """Return the epipolar curves of n pixels of a."""
        middle = 0.5 * (self.low_m + self.high_m)
        low, centre, high = (self.project(line, sample, h) for h in (self.low_m, middle, self.high_m))
        c1, c2 = 0.5 * (high - low), 0.5 * (high + low) - centre
        half = np.linalg.norm(c1, axis=1)
        short = half < LEAST_CURVE_PX
        along = np.where(short[:, None], [0.0, 1.0], c1 / np.maximum(half, LEAST_CURVE_PX)[:, None])
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        return Curves(centre, c1, c2, along, across, np.maximum(half, LEAST_CURVE_PX))

    def height_m(self, t: Array) -> Array:
        """Return the heights (n,) at parameters t of the curves.

        The parameter is -1 at the lowest and 1 at the highest height.
        """
        return np.asarray(0.5 * (self.low_m + self.high_m) + 0.5 * (self.high_m - self.low_m) * t)

    def t_of(self, height_m: float) -> float:
        """Return the parameter t of a height."""
        return (2.0 * height_m - self.low_m - self.high_m) / (self.high_m - self.low_m)

    def matrix(self, line: float, sample: float, height_m: float) -> Array:
        """Return the derivatives (2, 2) of a pixel of b by the pixel of a, at one height."""
        lines = np.array([line - STEP_PX, line + STEP_PX, line, line])
        samples = np.array([sample, sample, sample - STEP_PX, sample + STEP_PX])
        s = self.a
        lines = np.clip(lines, s.first_line - 0.5, s.last_line + 0.5)
        samples = np.clip(samples, s.first_sample - 0.5, s.last_sample + 0.5)
        p = self.project(lines, samples, height_m)
        return np.stack([(p[1] - p[0]) / (lines[1] - lines[0]), (p[3] - p[2]) / (samples[3] - samples[2])], axis=1)


def height_range(sensors: tuple[Any, ...], low_m: float | None, high_m: float | None) -> tuple[float, float]:
    """Return the range of ground heights for all images.

    Parameters
    ----------
    sensors : tuple of Sensor
    low_m, high_m : float or None
        Given limits, m above the ellipsoid; None: the heights of the RPC, otherwise a
        range about the mean height of the scene.

    Returns
    -------
    low_m, high_m : float
        Heights that all images have in common, otherwise the range that contains the heights of all images.
    """
    lows, highs = [], []
    for sensor in sensors:
        if isinstance(sensor, RpcSensor):
            low, high = sensor.model.validity.height_m
        else:
            low, high = sensor.mean_height_m - BELOW_M, sensor.mean_height_m + ABOVE_M
        lows.append(low)
        highs.append(high)
    low, high = (max(lows), min(highs)) if max(lows) < min(highs) else (min(lows), max(highs))
    return (low if low_m is None else low_m), (high if high_m is None else high_m)


def prior_covariance(sensor: Any, options: Options, line: float, sample: float, height_m: float) -> Array:
    """Propagate the prior sigmas of an image's unknowns to the pixel of a ground point.

    Parameters
    ----------
    sensor : Sensor
    options : Options
        Unknowns and their prior sigmas.
    line, sample : float
        Pixel of the point.
    height_m : float
        Ellipsoidal height of the point, m.

    Returns
    -------
    (2, 2) array
        Covariance of line and sample, px^2.
    """
    model = sensor.image_model(options)
    ground = sensor.locate([line], [sample], height_m=height_m)
    there = np.stack(sensor.project(ground), axis=1)
    moved = []
    for unknown in np.eye(len(model.parameters)):
        moved.append((np.stack(sensor.project(ground, model.correction(unknown)), axis=1) - there)[0])
    shifts = np.nan_to_num(np.array(moved).reshape(-1, 2))
    return np.asarray(shifts.T @ shifts)


def parallax_sigma_px(pair: Pair, options: Options, line: float, sample: float) -> float:
    """Compute the prior standard deviation of the y-parallax of a pair.

    Parameters
    ----------
    pair : Pair
    options : Options
        Unknowns of the images and their prior sigmas.
    line, sample : float
        Pixel of a.

    Returns
    -------
    float
        Standard deviation across the epipolar curve, px of b.
    """
    height = 0.5 * (pair.low_m + pair.high_m)
    there, s = pair.project(np.array([line]), np.array([sample]), height)[0], pair.b
    at = np.clip(there, [s.first_line, s.first_sample], [s.last_line, s.last_sample])
    matrix = pair.matrix(line, sample, height)
    in_a = matrix @ prior_covariance(pair.a, options, line, sample, height) @ matrix.T
    covariance: Array = in_a + prior_covariance(pair.b, options, at[0], at[1], height)
    across = pair.curves(np.array([line]), np.array([sample])).across[0]
    return float(np.sqrt(across @ covariance @ across))


def dem_range(dem: Any, pair: Pair, line: Array, sample: Array, sigma_m: float) -> tuple[float, float] | None:
    """Return the range of the heights of a DEM at some pixels of a.

    Parameters
    ----------
    dem : RasterDem
    pair : Pair
    line, sample : (n,) arrays
        Pixels of a, located at the lowest, mean and highest height of the DEM in the range of the pair.
    sigma_m : float
        Standard deviation of the heights; the range is widened by three times this value.

    Returns
    -------
    (float, float) or None
        Lowest and highest ellipsoidal height, m; None if the DEM has no height there.
    """
    ends = [ecef_to_geodetic(pair.ground(line, sample, h))[:2] for h in (pair.low_m, pair.high_m)]
    low, high = dem.range_over(*np.hstack(ends))
    if not np.isfinite(low):
        return None
    heights = []
    for h in (low, 0.5 * (low + high), high):
        lon, lat, _ = ecef_to_geodetic(pair.ground(line, sample, h))
        heights.append(dem.height_m(lon, lat))
    found = np.concatenate(heights)
    if not np.isfinite(found).any():
        return None
    return float(np.nanmin(found)) - 3.0 * sigma_m, float(np.nanmax(found)) + 3.0 * sigma_m


def inside(points: Array, place: Any, border: float = 0.0) -> Mask:
    """Return which pixels of an image are inside its raster.

    Parameters
    ----------
    points : (n, 2) array
        Line and sample.
    place : Place
        Position and size of the raster in the image.
    border : float
        Smallest distance from the edge of the raster, px.

    Returns
    -------
    (n,) bool array
    """
    row, column = points[:, 0] - place.line, points[:, 1] - place.sample
    good = (row >= border) & (row <= place.rows - 1 - border)
    return np.asarray(good & (column >= border) & (column <= place.columns - 1 - border))
