"""``rpc fit``: a rational function model from control points or from a sensor, with its stated errors.

The sensor's own model locates the pixels of a virtual grid on several height layers. All layers are adjusted in one
system (Tao & Hu 2001). (Terlemezoğlu 2019, section 2.4, averages the coefficients of the layers, which is not a
least-squares estimate.) The stated errors are those at independent points: pixels and heights between those of the
grid. A fit to control points is assessed by cross-validation and at check points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from factors._contract import Array
from factors.geometry import ellipsoid
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.errors import Finding, InputError, finding, judged
from fg_orient.model.names import Progress
from fg_orient.rpc.estimate import SOLVER, fit_linear, fit_true, fit_weighted, require_points
from fg_orient.rpc.fit import CrossValidation, RfmFit, cross_validate, rms
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.options import Denominators, FitOptions
from fg_orient.rpc.points import ControlPoints, MeasuredPoints, statistics
from fg_orient.rpc.select import fit_selected
from fg_orient.sensors.base import Sensor
from fg_orient.sensors.rpc import NEAR_ZERO, RpcModel, RpcValidity

#: Lines, samples, height layers.
SHAPE: Final = (20, 20, 5)
#: Least number of nodes per axis: four for a cubic, and one more to check it.
LEAST: Final = 5
#: Penalty of the coefficients beyond the affine ones, because the normal equations of degree 3 are singular in
#: practice. It changes residuals by less than 1e-4 px.
KAPPA: Final = 1e-12
#: Independent points per grid point.
CHECK_SHARE: Final = 1.0


@dataclass(frozen=True)
class SensorRfm:
    """A rational function model of a sensor.

    Parameters
    ----------
    forward : RfmFit
        Ground to image.
    inverse : RfmFit
        Image to ground with exchanged roles: "line" is the latitude, "sample" the longitude (degrees), "ground" is
        sample, line and height.
    validity : RpcValidity
        Ranges of the grid: pixels, degrees, m.
    fit_px, check_px : (n, 2) arrays
        Residuals of line and sample, pixels: at the grid, at independent points.
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
        """Model with validity range and inverse coefficients, for projection and files."""
        errors = np.abs(self.check_px).max(axis=0).tolist()
        note = finding("rpc.fitted_to_sensor", errors_px=errors, n=len(self.check_px))
        scaling = self.forward.scaling
        return RpcModel(
            scaling.offsets, scaling.scales, self.forward.coefficients, self.validity,
            int(self.validity.line[1]) + 1, int(self.validity.sample[1]) + 1,
            direct=self.inverse.coefficients[[2, 3, 0, 1]], file=file, notes=(note,),
        )  # fmt: skip


def fit_sensor(
    sensor: Sensor, heights_m: tuple[float, float], *, shape: tuple[int, int, int] = SHAPE, degree: int = 3,
    denominators: Denominators = "separate", seed: int = 1,
) -> SensorRfm:  # fmt: skip
    """Fit a rational function model to a sensor.

    Parameters
    ----------
    sensor : Sensor
        Its method ``locate`` gives the ground points; (0, 0) = centre of the first pixel.
    heights_m : (float, float)
        Lowest and highest layer, m above the ellipsoid.
    shape : (int, int, int)
        Lines, samples and layers of the grid, at least 5 each, spaced like Chebyshev nodes: denser at the borders.
    degree, denominators
        See :class:`fg_orient.rpc.form.RfmForm`.
    seed : int
        Seed of the independent points.

    Raises
    ------
    InputError
        Too small a grid, heights that do not increase or are not finite, a ray that misses a layer.
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
    with one_blas_thread():  # a second thread does not accelerate small matrices
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


def _nodes(first: float, last: float, count: int) -> Array:
    """Chebyshev nodes stretched to both ends; errors of a fit to a regular grid are largest at the border."""
    nodes = -np.cos(np.pi * (np.arange(count) + 0.5) / count)
    return np.asarray(0.5 * (first + last) + 0.5 * (last - first) * nodes / nodes[-1])


def _located(sensor: Sensor, line: Array, sample: Array, height_m: Array) -> ControlPoints:
    """Control points of pixels at heights; longitudes continuous across 180 degrees."""
    geodetic = ellipsoid.geodetic_array(np.ascontiguousarray(sensor.locate(line, sample, height_m=height_m)))
    lon, lat = np.degrees(geodetic[:, 0]), np.degrees(geodetic[:, 1])
    lon = lon[0] + (lon - lon[0] + 180.0) % 360.0 - 180.0
    return ControlPoints(line, sample, np.column_stack([lon, lat, height_m]))


def _exchanged(points: ControlPoints) -> ControlPoints:
    """Exchange the roles: latitude and longitude as functions of sample, line and height."""
    lon, lat, height = points.ground.T
    return ControlPoints(lat, lon, np.column_stack([points.sample, points.line, height]))


def _metres(residuals_deg: Array, points: ControlPoints) -> Array:
    """Longitude and latitude differences in metres: (n, 2) from residuals of latitude, longitude in degrees."""
    lat = np.radians(points.ground[:, 1])
    root = np.sqrt(1.0 - ellipsoid.E2 * np.sin(lat) ** 2)
    east = np.radians(residuals_deg[:, 1]) * np.cos(lat) * (ellipsoid.A_M / root + points.ground[:, 2])
    north = np.radians(residuals_deg[:, 0]) * (ellipsoid.A_M * (1.0 - ellipsoid.E2) / root**3 + points.ground[:, 2])
    return np.column_stack([east, north])


FOLDS: Final = 10
#: Ratio of the errors at points left out to those of the fit above which there are too many coefficients.
OVERFITTED: Final = 3.0


def fit_to(points: ControlPoints, options: FitOptions) -> RfmFit:
    """Fit to points; poles are allowed, ``RfmFit.has_pole`` reports them."""
    form, kappa = RfmForm(options.degree, options.denominators), options.kappa or 0.0
    if options.selector is not None:
        return fit_selected(points, form, options.selector, allow_pole=True)
    methods: dict[str, Callable[..., RfmFit]] = {"true": fit_true, "linear": fit_linear, "weighted": fit_weighted}
    solver = {"solver": options.solver or SOLVER} if options.equations == "linear" else {}
    return methods[options.equations](
        points, form, normalise=options.normalise, kappa=kappa, penalty=options.penalty, allow_pole=True, **solver
    )


def fit_points(
    measured: MeasuredPoints, options: FitOptions, progress: Progress | None = None
) -> tuple[RpcModel, dict[str, Any]]:
    """Fit to control points; assess the fit by cross-validation and at check points.

    ``progress`` is called with (done, of, text) for each fold of the cross-validation.

    Returns
    -------
    model : RpcModel
        Its validity range is that of the control points.
    record : dict
        status, warnings, degree, denominators, equations, method, choice, kappa, unknowns, rank, condition, redundancy,
        least_denominators, m0_linear_px, m0_px, control, check, cross_validation.

    Raises
    ------
    InputError
        Too few points for the coefficients; no such degree, solver or selection.
    NoSolutionError
        The fit has no solution or does not converge.
    """
    control, check = measured.take(~measured.check).points, measured.take(measured.check)
    require_points(control, RfmForm(options.degree, options.denominators), options.kappa or 0.0)
    fit = fit_to(control, options)
    validation = _validation(control, options, progress)
    least = fit.least_denominators
    record = {
        "source": "points", "degree": options.degree, "denominators": options.denominators,
        "equations": options.equations, "normalised": options.normalise, "method": fit.method, "choice": fit.choice,
        "kappa": fit.kappa, "unknowns": len(fit.form), "rank": fit.rank, "condition": fit.conditioning.cond_norm,
        "redundancy": fit.redundancy, "iterations": fit.iterations,
        "least_denominator_line": float(least[0]), "least_denominator_sample": float(least[1]),
        "m0_linear_px": fit.m0_linear_px, "m0_px": fit.m0_px,
        "control": statistics(fit.residuals_px()),
        "check": None if not len(check) else statistics(fit.residuals_px(check.points)),
        "cross_validation": None if validation is None else {
            "folds": len(validation.fits), "statistics": statistics(validation.residuals_px),
            "choices": validation.choices, "failures": len(validation.failures),
        },
    }  # fmt: skip
    model = fit.model()
    return model, {**judged([*_doubts(fit, validation), *model.notes]), **record}


def _validation(control: ControlPoints, options: FitOptions, progress: Progress | None) -> CrossValidation | None:
    """Cross-validation that repeats every choice in each fold; None if a fold has too few points."""
    folds = options.folds or min(FOLDS, len(control))
    try:
        every = None if folds == len(control) else folds
        return cross_validate(
            control, partial(fit_to, options=options), folds=every, seed=options.seed, progress=progress
        )
    except InputError:
        if options.folds is not None:
            raise
        return None


def _doubts(fit: RfmFit, validation: CrossValidation | None) -> list[Finding]:
    """Findings that make a fit unfit for use."""
    out, least = [], float(fit.least_denominators.min())
    if fit.has_pole:
        out.append(finding("rpc.sign_change", least=least))
    elif least < NEAR_ZERO:
        out.append(finding("rpc.near_zero_among", least=least))
    if fit.m0_px > OVERFITTED * fit.m0_linear_px:
        out.append(finding("rpc.linear_m0", linear_px=fit.m0_linear_px, true_px=fit.m0_px))
    if validation is None:
        return [*out, finding("rpc.not_validated")]
    left_out, own = validation.rms_px, fit.rms_px
    if validation.failures:
        out.append(finding("rpc.folds_failed", failed=len(validation.failures), folds=len(validation.fits)))
    elif not (left_out <= OVERFITTED * np.maximum(own, 1e-6)).all():
        out.append(finding("rpc.overfitted", left_out_px=list(left_out), fit_px=list(own)))
    return out


def fit_image(
    sensor: Sensor, heights_m: tuple[float, float], options: FitOptions, shape: tuple[int, int, int] = SHAPE
) -> tuple[RpcModel, dict[str, Any]]:
    """Fit to a rigorous model by a virtual grid.

    Parameters
    ----------
    sensor, heights_m, shape
        See :func:`fg_orient.rpc.fitting.fit_sensor`.
    options : FitOptions
        Degree, denominators and seed.

    Returns
    -------
    model : RpcModel
        Ground to image and image to ground.
    record : dict
        status, warnings, degree, denominators, grid, heights_m, fit (errors at the grid), check (at independent
        points), image_to_ground (East, North, m).

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.rpc.fitting.fit_sensor`.
    """
    degree, denominators = options.degree, options.denominators
    fit = fit_sensor(sensor, heights_m, shape=shape, degree=degree, denominators=denominators, seed=options.seed)
    least = fit.forward.least_denominators
    small = float(least.min()) < NEAR_ZERO
    record = {
        **judged([finding("rpc.near_zero", least=least.min())] if small else []),
        "source": "sensor", "degree": degree, "denominators": denominators, "grid": list(shape),
        "heights_m": list(heights_m),
        "least_denominator_line": float(least[0]), "least_denominator_sample": float(least[1]),
        "fit": _errors(fit.fit_px, ("line_px", "sample_px")),
        "check": _errors(fit.check_px, ("line_px", "sample_px")),
        "image_to_ground": _errors(fit.inverse_m, ("east_m", "north_m")),
    }  # fmt: skip
    return replace(fit.model(sensor.file), notes=()), record


def _errors(residuals: Array, axes: tuple[str, str]) -> dict[str, Any]:
    """Number of points, RMS and largest amount of residuals (n, 2) by axis."""
    figures = {"rms": rms(residuals), "max": np.abs(residuals).max(axis=0)}
    named = {f"{name}_{axis}": float(v) for name, two in figures.items() for axis, v in zip(axes, two, strict=True)}
    return {"n": len(residuals), **named}
