"""Rational function model of a sensor, fitted to a virtual grid and checked between its points.

The sensor's own model locates the pixels of a grid on several height layers. All layers
are adjusted in one system (Tao & Hu 2001). (Terlemezoğlu 2019, section 2.4, averages the
coefficients of the layers, which is not a least-squares estimate.) The stated errors are
errors at independent points, whose pixels and heights lie between the grid values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from factors.arrays import Array
from factors.cameras.rfm_project import RANGE
from factors.geometry import ellipsoid
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.errors import InputError, finding
from fg_orient.rpc.estimate import fit_true
from fg_orient.rpc.fit import RfmFit
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.options import Denominators
from fg_orient.rpc.points import ControlPoints, Scaling
from fg_orient.sensors.base import Sensor
from fg_orient.sensors.rpc import RpcModel, RpcValidity
from fg_orient.sensors.rpc_sensor import RpcSensor

#: Numbers of lines, samples and height layers.
SHAPE: Final = (20, 20, 5)
#: Minimum number of nodes per axis: four for a cubic, and one more to check it.
LEAST: Final = 5
#: Penalty on the coefficients beyond the affine part. Without it, the normal equations of
#: degree 3 are singular in practice. It changes residuals by less than 1e-4 px.
KAPPA: Final = 1e-12
#: Number of independent points per grid point.
CHECK_SHARE: Final = 1.0


@dataclass(frozen=True)
class SensorRfm:
    """A rational function model of a sensor.

    Parameters
    ----------
    forward : RfmFit
        Fit from ground to image.
    inverse : RfmFit
        Fit from image to ground with exchanged roles: "line" is the latitude, "sample" is
        the longitude (degrees), and "ground" is sample, line and height.
    validity : RpcValidity
        Ranges of the grid: pixels, degrees, m.
    fit_px, check_px : (n, 2) arrays
        Residuals of line and sample, pixels: at the grid, and at independent points.
    inverse_m : (n, 2) array
        Residuals of the inverse model, East and North in metres on the ground, at the same independent points.
    """

    forward: RfmFit
    inverse: RfmFit
    validity: RpcValidity
    fit_px: Array
    check_px: Array
    inverse_m: Array

    def model(self, file: str = "") -> RpcModel:
        """Return the model with validity range and inverse coefficients, for projection and files."""
        errors = np.abs(self.check_px).max(axis=0).tolist()
        note = finding("rpc.fitted_to_sensor", errors_px=errors, n=len(self.check_px))
        scaling = self.forward.scaling
        return RpcModel(
            scaling.offsets, scaling.scales, self.forward.coefficients, self.validity,
            int(self.validity.line[1]) + 1, int(self.validity.sample[1]) + 1,
            direct=self.inverse.coefficients[[2, 3, 0, 1]], file=file, notes=(note,),
        )  # fmt: skip


def fit_sensor(
    sensor: Sensor,
    heights_m: tuple[float, float],
    *,
    shape: tuple[int, int, int] = SHAPE,
    degree: int = 3,
    denominators: Denominators = "separate",
    seed: int = 1,
) -> SensorRfm:
    """Fit a rational function model to a sensor.

    Parameters
    ----------
    sensor : Sensor
        Sensor whose method ``locate`` gives the ground points; (0, 0) = centre of the first pixel.
    heights_m : (float, float)
        Lowest and highest layer, m above the ellipsoid.
    shape : (int, int, int)
        Lines, samples and layers of the grid, at least 5 each, spaced like Chebyshev
        nodes: denser at the borders.
    degree, denominators
        See :class:`fg_orient.rpc.form.RfmForm`.
    seed : int
        Seed of the independent points.

    Raises
    ------
    InputError
        The grid is too small, heights do not increase or are not finite, or a ray misses a layer.
    NoSolutionError
        The fit does not converge, or has a pole in the grid.
    """
    low, high = heights_m
    if min(shape) < LEAST:
        raise InputError.of("rfm.grid", place="virtual grid", value=shape, least=LEAST)
    if not (np.isfinite([low, high]).all() and high > low):
        raise InputError.of("rfm.heights", place="heights", value=f"{low:g}, {high:g}")
    ends = ((sensor.first_line, sensor.last_line), (sensor.first_sample, sensor.last_sample), heights_m)
    axes = [_nodes(*end, n) for end, n in zip(ends, shape, strict=True)]
    grid = _located(sensor, *(axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")))
    rng = np.random.default_rng(seed)
    count = int(CHECK_SHARE * len(grid))
    check = _located(sensor, *(rng.uniform(*end, count) for end in ends))
    form = RfmForm(degree, denominators)
    with one_blas_thread():  # for small matrices, a second thread is not faster
        forward, inverse = fit_true(grid, form, kappa=KAPPA), fit_true(_exchanged(grid), form, kappa=KAPPA)
    ranges = zip(grid.columns.min(axis=0).tolist(), grid.columns.max(axis=0).tolist(), strict=True)
    back = inverse.residuals_px(_exchanged(check))
    return SensorRfm(
        forward,
        inverse,
        RpcValidity(*ranges),
        forward.residuals_px(),
        forward.residuals_px(check),
        _metres(back, check),
    )


def with_image_to_ground(model: RpcModel) -> RpcModel:
    """Add coefficients from image to ground to a model, fitted over its validity range in its own normalisation.

    Raises
    ------
    NoSolutionError
        The fit does not converge, or has a pole in the grid.
    """
    v = model.validity
    axes = [_nodes(*end, n) for end, n in zip((v.line, v.sample, v.height_m), SHAPE, strict=True)]
    nodes = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    grid = _exchanged(_located(RpcSensor(model, poles=True), *nodes))
    exchanged = [RANGE.lat, RANGE.lon, RANGE.sample, RANGE.line, RANGE.height]
    own = Scaling(model.offsets[exchanged], model.scales[exchanged])
    with one_blas_thread():
        fit = fit_true(grid, RfmForm(3, "separate"), kappa=KAPPA, scaling=own)
    return replace(model, direct=fit.coefficients[[2, 3, 0, 1]])


def _nodes(first: float, last: float, count: int) -> Array:
    """Return Chebyshev nodes that extend to both ends.

    With a regular grid, the errors of a fit would be largest at the border.
    """
    nodes = -np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return np.asarray(0.5 * (first + last) + 0.5 * (last - first) * nodes / nodes[-1])


def _located(sensor: Sensor, line: Array, sample: Array, height_m: Array) -> ControlPoints:
    """Return the control points of pixels at heights.

    Longitudes are continuous across 180 degrees.
    """
    geodetic = ellipsoid.geodetic_array(np.ascontiguousarray(sensor.locate(line, sample, height_m=height_m)))
    lon, lat = np.degrees(geodetic[:, 0]), np.degrees(geodetic[:, 1])
    lon = lon[0] + (lon - lon[0] + 180.0) % 360.0 - 180.0
    return ControlPoints(line, sample, np.column_stack([lon, lat, height_m]))


def _exchanged(points: ControlPoints) -> ControlPoints:
    """Exchange the roles: latitude and longitude as functions of sample, line and height."""
    lon, lat, height = points.ground.T
    return ControlPoints(lat, lon, np.column_stack([points.sample, points.line, height]))


def _metres(residuals_deg: Array, points: ControlPoints) -> Array:
    """Convert differences of latitude and longitude (degrees) to East and North in metres: (n, 2)."""
    lat = np.radians(points.ground[:, 1])
    root = np.sqrt(1.0 - ellipsoid.E2 * np.sin(lat) ** 2)
    east = np.radians(residuals_deg[:, 1]) * np.cos(lat) * (ellipsoid.A_M / root + points.ground[:, 2])
    north = np.radians(residuals_deg[:, 0]) * (ellipsoid.A_M * (1.0 - ellipsoid.E2) / root**3 + points.ground[:, 2])
    return np.column_stack([east, north])
