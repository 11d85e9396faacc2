"""``rpc fit``: a rational function model from control points or from a rigorous model, with its stated errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import Finding, InputError, finding, judged
from fg_orient.model.names import Progress
from fg_orient.rpc.check import NEAR_ZERO
from fg_orient.rpc.estimate import SOLVER, Penalty, fit_linear, fit_true, fit_weighted
from fg_orient.rpc.fit import RfmFit
from fg_orient.rpc.form import Denominators, RfmForm
from fg_orient.rpc.points import MeasuredPoints, statistics
from fg_orient.rpc.rfm_points import ControlPoints
from fg_orient.rpc.select import fit_selected
from fg_orient.rpc.validate import CrossValidation, cross_validate
from fg_orient.rpc.virtual_grid import SHAPE, Errors, LocatingSensor, fit_sensor
from fg_orient.sensors.rpc import RpcModel

Array = npt.NDArray[np.float64]

EQUATIONS: Final = ("true", "linear", "weighted")
#: Selection where nothing else is asked for: the one whose cross-validated errors are lowest on real points.
SELECTION: Final = "ridge_press"
NO_SELECTION: Final = "none"
FOLDS: Final = 10
#: Errors at points left out that exceed those of the fit by this factor: more coefficients than the points carry.
OVERFITTED: Final = 3.0


@dataclass(frozen=True)
class FitOptions:
    """How to fit to control points.

    Parameters
    ----------
    degree : int
    denominators : "separate", "common" or "one"
    equations : "true", "linear" or "weighted"
    selection : str, optional
        Of :func:`fg_orient.rpc.select.selections`, or "none"; default ``SELECTION`` for true equations without kappa.
    kappa : float, optional
        Penalty; default 0.
    penalty : "beyond_affine" or "identity"
    solver : str, optional
        Of the linear form.
    normalise : bool
    folds : int, optional
        Of the cross-validation; default 10, or all points if they are fewer.
    seed : int

    Raises
    ------
    InputError
        Options that exclude each other, or no such equations.
    """

    degree: int = 3
    denominators: Denominators = "separate"
    equations: str = "true"
    selection: str | None = None
    kappa: float | None = None
    penalty: Penalty = "beyond_affine"
    solver: str | None = None
    normalise: bool = True
    folds: int | None = None
    seed: int = 1

    def __post_init__(self) -> None:
        if self.equations not in EQUATIONS:
            raise InputError.of("rpc.equations", option="equations", value=self.equations, known=", ".join(EQUATIONS))
        if self.selection not in (None, NO_SELECTION):
            clashes = {
                "kappa": self.kappa is not None, "equations": self.equations != "true",
                "no_normalise": not self.normalise,
            }  # fmt: skip
            for name, clash in clashes.items():
                if clash:
                    raise InputError.of("options.two_ways", option=f"select, {name}")
        if self.solver is not None and self.equations != "linear":
            raise InputError.of("rpc.solver_form", option="solver", value=self.solver)

    @property
    def selector(self) -> str | None:
        """Selection that is used; None for a plain or a penalised fit."""
        if self.selection is not None:
            return None if self.selection == NO_SELECTION else self.selection
        return SELECTION if self.equations == "true" and self.kappa is None and self.normalise else None

    def fit(self, points: ControlPoints) -> RfmFit:
        """Fit to points; poles are allowed and seen by ``RfmFit.has_pole``."""
        form, kappa = RfmForm(self.degree, self.denominators), self.kappa or 0.0
        if self.selector is not None:
            return fit_selected(points, form, self.selector, allow_pole=True)
        if self.equations == "linear":
            return fit_linear(
                points, form, normalise=self.normalise, solver=self.solver or SOLVER, kappa=kappa, penalty=self.penalty,
                allow_pole=True,
            )  # fmt: skip
        method = fit_true if self.equations == "true" else fit_weighted
        return method(points, form, normalise=self.normalise, kappa=kappa, penalty=self.penalty, allow_pole=True)


def fit_points(
    measured: MeasuredPoints, options: FitOptions, progress: Progress | None = None
) -> tuple[RpcModel, dict[str, Any]]:
    """Fit to control points and judge by cross-validation and at check points.

    ``progress`` is called with (done, of, text) for each fold of the cross-validation.

    Returns
    -------
    model : RpcModel
        Valid where the control points are.
    record : dict
        status, warnings, degree, denominators, equations, method, choice, kappa, unknowns, rank, condition, redundancy,
        least_denominators, m0_linear_px, m0_px, control, check, cross_validation.

    Raises
    ------
    InputError
        Fewer points than the coefficients need, no such degree, solver, selection.
    NoSolutionError
        The fit breaks down or does not end.
    """
    control, check = measured.take(~measured.check).points, measured.take(measured.check)
    _require_enough(control, options)
    fit = options.fit(control)
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
        "cross_validation": _validation_record(validation),
    }  # fmt: skip
    model = fit.model()
    return model, {**judged([*_doubts(fit, validation), *model.notes]), **record}


def _require_enough(control: ControlPoints, options: FitOptions) -> None:
    """Refuse fewer points than coefficients where nothing holds them.

    Raises
    ------
    InputError
    """
    form = RfmForm(options.degree, options.denominators)
    held = (options.kappa or 0.0) > 0.0
    if 2 * len(control) < len(form) and not held:
        place = f"degree {form.degree}, {form.denominators} denominators"
        least = -(-len(form) // 2)
        raise InputError.of("rfm.few_points", place=place, value=len(control), unknowns=len(form), least=least)


def _validation(control: ControlPoints, options: FitOptions, progress: Progress | None) -> CrossValidation | None:
    """Cross-validation with every choice made anew in each fold; None if a fold has too few points for it."""
    folds = options.folds or min(FOLDS, len(control))
    try:
        every = None if folds == len(control) else folds
        return cross_validate(control, options.fit, folds=every, seed=options.seed, progress=progress)
    except InputError:
        if options.folds is not None:
            raise
        return None


def _validation_record(found: CrossValidation | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "folds": len(found.fits), "statistics": statistics(found.residuals_px), "choices": found.choices,
        "failures": len(found.failures),
    }  # fmt: skip


def _doubts(fit: RfmFit, validation: CrossValidation | None) -> list[Finding]:
    """What makes a fit unfit for use."""
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
    sensor: LocatingSensor, heights_m: tuple[float, float], *, degree: int = 3, denominators: Denominators = "separate",
    shape: tuple[int, int, int] = SHAPE, seed: int = 1, file: str = "",
) -> tuple[RpcModel, dict[str, Any]]:  # fmt: skip
    """Fit to a rigorous model by a virtual grid.

    Parameters
    ----------
    sensor, heights_m, degree, denominators, shape, seed
        See :func:`fg_orient.rpc.virtual_grid.fit_sensor`.
    file : str
        Of the sensor, for messages.

    Returns
    -------
    model : RpcModel
        With both directions.
    record : dict
        status, warnings, degree, denominators, grid, heights_m, fit (errors at the grid), check (at independent
        points), image_to_ground (East, North, m).

    Raises
    ------
    InputError, NoSolutionError
        See :func:`fg_orient.rpc.virtual_grid.fit_sensor`.
    """
    found = fit_sensor(sensor, heights_m, shape=shape, degree=degree, denominators=denominators, seed=seed)
    model = found.model(file)
    least = found.forward.least_denominators
    small = float(least.min()) < NEAR_ZERO
    record = {
        **judged([finding("rpc.near_zero", least=least.min())] if small else []),
        "source": "sensor", "degree": degree, "denominators": denominators, "grid": list(shape),
        "heights_m": list(heights_m),
        "least_denominator_line": float(least[0]), "least_denominator_sample": float(least[1]),
        "fit": _errors(found.fit_px, ("line_px", "sample_px")),
        "check": _errors(found.check_px, ("line_px", "sample_px")),
        "image_to_ground": _errors(found.inverse_m, ("east_m", "north_m")),
    }  # fmt: skip
    return replace(model, notes=()), record


def _errors(found: Errors, axes: tuple[str, str]) -> dict[str, Any]:
    out: dict[str, Any] = {"n": found.points}
    for name, pair in (("rms", found.rms), ("max", found.largest)):
        out |= {f"{name}_{axis}": float(value) for axis, value in zip(axes, pair, strict=True)}
    return out
