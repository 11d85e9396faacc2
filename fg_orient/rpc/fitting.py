"""Fit a rational function model to control points or to a sensor; this is the command ``rpc fit``.

A fit to control points is assessed by cross-validation and at check points. A fit to a
sensor is assessed at independent points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.model.errors import Finding, InputError, decisive, finding, judged
from fg_orient.model.names import Progress
from fg_orient.rpc.estimate import SOLVER, fit_linear, fit_true, fit_weighted, require_points
from fg_orient.rpc.fit import CrossValidation, RfmFit, cross_validate, rms
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.options import FitOptions
from fg_orient.rpc.points import ControlPoints, MeasuredPoints, statistics
from fg_orient.rpc.select import fit_selected
from fg_orient.rpc.virtual_grid import SHAPE, fit_sensor
from fg_orient.sensors.base import Sensor
from fg_orient.sensors.rpc import NEAR_ZERO, RpcModel

FOLDS: Final = 10
#: There are too many coefficients if the ratio of errors at excluded points to errors of the fit exceeds this.
OVERFITTED: Final = 3.0


def fit_to(points: ControlPoints, options: FitOptions) -> RfmFit:
    """Fit to points; poles are allowed, ``RfmFit.has_pole`` reports them."""
    form, kappa = RfmForm(options.degree, options.denominators), options.kappa or 0.0
    if options.selector is not None:
        return fit_selected(
            points, form, options.selector, allow_pole=True, seed=options.seed, evaluations=options.evaluations
        )
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
        Model whose validity range is the range of the control points.
    record : dict
        status, warnings, degree, denominators, equations, method, choice, kappa,
        unknowns, rank, condition, redundancy, least_denominators, m0_linear_px, m0_px,
        control, check, cross_validation.

    Raises
    ------
    InputError
        There are too few points for the coefficients, or the degree, solver or selection does not exist.
    NoSolutionError
        The fit has no solution or does not converge.
    """
    control, check = measured.take(~measured.check).points, measured.take(measured.check)
    require_points(control, RfmForm(options.degree, options.denominators), options.kappa or 0.0)
    fit = fit_to(control, options)
    validation = _validation(control, options, progress)
    least = fit.least_denominators
    record = {
        "source": "points",
        "degree": options.degree,
        "denominators": options.denominators,
        "equations": options.equations,
        "normalised": options.normalise,
        "method": fit.method,
        "choice": fit.choice,
        "kappa": fit.kappa,
        "unknowns": len(fit.form),
        "rank": fit.rank,
        "condition": fit.conditioning.cond_norm,
        "redundancy": fit.redundancy,
        "iterations": fit.iterations,
        "least_denominator_line": float(least[0]),
        "least_denominator_sample": float(least[1]),
        "m0_linear_px": fit.m0_linear_px,
        "m0_px": fit.m0_px,
        "control": statistics(fit.residuals_px()),
        "check": None if not len(check) else statistics(fit.residuals_px(check.points)),
        "cross_validation": None
        if validation is None
        else {
            "folds": len(validation.fits),
            "statistics": statistics(validation.residuals_px),
            "choices": validation.choices,
            "failures": len(validation.failures),
        },
    }
    model = fit.model()
    return model, {**judged([*_doubts(fit, validation), *model.notes]), **record}


def _validation(control: ControlPoints, options: FitOptions, progress: Progress | None) -> CrossValidation | None:
    """Cross-validate, with every choice repeated in each fold.

    Return None if a fold has too few points.
    """
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
    """Return findings that forbid the use of a fit."""
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
        See :func:`fg_orient.rpc.virtual_grid.fit_sensor`.
    options : FitOptions
        Degree, denominators and seed.

    Returns
    -------
    model : RpcModel
        Ground to image and image to ground.
    record : dict
        status, warnings, degree, denominators, grid, heights_m, fit (errors at the grid),
        check (at independent points), image_to_ground (East, North, m).

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.rpc.virtual_grid.fit_sensor`.
    """
    degree, denominators = options.degree, options.denominators
    fit = fit_sensor(sensor, heights_m, shape=shape, degree=degree, denominators=denominators, seed=options.seed)
    least = fit.forward.least_denominators
    small = float(least.min()) < NEAR_ZERO
    found = decisive(sensor.notes)  # doubts on an adjusted orientation
    record = {
        **judged([*found, *([finding("rpc.near_zero", least=least.min())] if small else [])]),
        "source": "sensor",
        "degree": degree,
        "denominators": denominators,
        "grid": list(shape),
        "heights_m": list(heights_m),
        "least_denominator_line": float(least[0]),
        "least_denominator_sample": float(least[1]),
        "fit": _errors(fit.fit_px, ("line_px", "sample_px")),
        "check": _errors(fit.check_px, ("line_px", "sample_px")),
        "image_to_ground": _errors(fit.inverse_m, ("east_m", "north_m")),
    }
    return replace(fit.model(sensor.file), notes=()), record


def _errors(residuals: Array, axes: tuple[str, str]) -> dict[str, Any]:
    """Return the number of points, RMS and largest amount of residuals (n, 2) by axis."""
    figures = {"rms": rms(residuals), "max": np.abs(residuals).max(axis=0)}
    named = {f"{name}_{axis}": float(v) for name, two in figures.items() for axis, v in zip(axes, two, strict=True)}
    return {"n": len(residuals), **named}
