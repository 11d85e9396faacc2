"""Fit any function by least squares with full statistics; the bundle adjustment has the same iteration loop.

Unknowns have no priors here, so only the columns of the Jacobian define their scales. A
scale is the larger of the present length of the column (Marquardt 1963) and half the
scale before it. If a column collapses (an exponent that diverges), its unknown stays
damped for some steps; if the column stays short, the unknown becomes free. With the
largest length so far (Moré 1978) this unknown would always stay damped.

A step is measured in the space of the observations, ``|J dx| / (sqrt(u) sigma0)``: the
relative offset of Bates and Watts (1981), independent of units and parametrisation.
Observations that fit exactly have no sigma0; therefore it is at least sqrt(eps) times the
root mean square of the observations.

Damped steps include the second-order correction along the step (geodesic acceleration:
Transtrum, Sethna 2012, eqs. 3-6). They are rejected if this correction is large.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from factors._contract import NotFiniteError
from factors.arrays import Array
from fg_orient.adjustment.loop import (
    SHRINK_REWEIGHTED,
    Callback,
    IterationRecord,
    LoopResult,
    Optimizer,
    Step,
    delayed_levenberg_marquardt,
    gauss_newton,
)
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.model.errors import InputError, NoSolutionError

Model = Callable[..., Any]

EPS: Final = float(np.finfo(np.float64).eps)
#: Share of a scale that remains after each accepted step.
FORGET: Final = 0.5
#: Share of the step at which the second difference is taken, and largest correction relative to the step.
PROBE: Final = 0.1
MAX_ACCELERATION: Final = 0.75
#: Complex step, relative to the parameter: far below rounding, far above underflow.
TINY: Final = 1e-30
#: Residuals above this are rejected, because their squares overflow.
LARGEST: Final = 1e150
#: Largest relative difference between derivatives and difference quotients of a column of the model.
DERIVATIVE_TOLERANCE: Final = 1e-3


@dataclass(frozen=True)
class CurveFit:
    """Result of :func:`fit_curve`.

    Parameters
    ----------
    parameters : (u,) array
    residuals : (n,) array
        Model minus observation, in the unit of the observation.
    chi2 : float
        Weighted sum of squares of the residuals; without sigmas their sum of squares.
    redundancy : int
        n - u.
    cofactors : (u, u) array or None
        Inverse of ``J^T W J``; None if unknowns are not determined (``unavailable``).
    redundancy_numbers : (n,) array or None
        Share of the error of each observation in its residual; their sum is the redundancy.
    converged : bool
    reason : str
        Reason for the end of the iteration.
    log : tuple of IterationRecord
        Records of the iterations; their ``chi2`` is in units of the loop.
    unavailable : str
        Reason why there are no cofactors.
    """

    parameters: Array
    residuals: Array
    chi2: float
    redundancy: int
    cofactors: Array | None
    redundancy_numbers: Array | None
    converged: bool
    reason: str
    log: tuple[IterationRecord, ...]
    unavailable: str = ""

    @property
    def iterations(self) -> int:
        """Number of steps tried."""
        return len(self.log)

    @property
    def sigma0(self) -> float | None:
        """Standard deviation of unit weight, or of an observation without given sigmas; None without redundancy."""
        return float(np.sqrt(self.chi2 / self.redundancy)) if self.redundancy > 0 else None

    @cached_property
    def covariance(self) -> Array | None:
        """``sigma0^2 Q`` (u, u); None without redundancy or cofactors."""
        if self.cofactors is None or self.sigma0 is None:
            return None
        return np.asarray(self.cofactors * self.sigma0**2)

    @cached_property
    def standard_deviations(self) -> Array | None:
        """Standard deviations (u,) of the parameters; None without redundancy or cofactors."""
        return None if self.covariance is None else np.sqrt(self.covariance.diagonal())

    @cached_property
    def correlations(self) -> Array | None:
        """Correlations (u, u) of the parameters; None without cofactors."""
        if self.cofactors is None:
            return None
        root = np.sqrt(self.cofactors.diagonal())
        return np.asarray(self.cofactors / np.outer(root, root))


def fit_curve(
    model: Model,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    start: Sequence[float] | Array,
    *,
    sigma: npt.ArrayLike | None = None,
    jacobian: Model | None = None,
    optimizer: str = "levenberg-marquardt",
    max_iterations: int = 5000,
    callback: Callback | None = None,
) -> CurveFit:
    """Fit the parameters of a function to observations by least squares.

    Parameters
    ----------
    model : callable
        ``model(x, b1, ..., bu)`` gives (n,) values. Without ``jacobian`` it must accept
        complex parameters (arithmetic and analytic functions of numpy do).
    x : array
        First argument of the model.
    y : (n,) array
        Observations.
    start : (u,) array
        Start values.
    sigma : (n,) array or float, optional
        Standard deviations of the observations; default 1: sigma0 is then the standard
        deviation of an observation.
    jacobian : callable, optional
        ``jacobian(x, b1, ..., bu)`` gives the (n, u) derivatives; default: complex steps, exact to rounding.
    optimizer : str
        "levenberg-marquardt" or "gauss-newton".
    max_iterations : int
    callback : callable, optional
        Called with an ``IterationRecord`` after each iteration.

    Returns
    -------
    CurveFit

    Raises
    ------
    InputError
        Numbers that are not finite, too few observations, a model of the wrong shape, wrong derivatives.
    NoSolutionError
        The model has no finite derivatives at an iterate, or Gauss-Newton's equations are singular.
    """
    loops: dict[str, Optimizer] = {
        "levenberg-marquardt": delayed_levenberg_marquardt,
        "gauss-newton": gauss_newton,
    }
    if optimizer not in loops:
        raise InputError.of("curve.optimizer", place="optimizer", value=optimizer, known=", ".join(loops))
    b, observed = _numbers(start, "start", "(u,) start values"), _numbers(y, "y", "(n,) observations")
    if len(observed) < len(b) or not len(b):
        raise InputError.of("curve.unknowns", place="y", count=len(observed), unknowns=len(b))
    weight = _weights(sigma, len(observed))
    backend = _Backend(model, jacobian, np.asarray(x), observed, weight)
    backend.require_sound(b)
    with one_blas_thread():
        try:
            start_point = _Point(b, np.zeros(len(b)))
            result = loops[optimizer](backend, start_point, max_iterations, callback, shrink=SHRINK_REWEIGHTED)
            return _conclude(backend, result)
        except (NotFiniteError, _Singular) as error:
            raise NoSolutionError.of("curve.lost", value=error) from error


def _numbers(values: npt.ArrayLike, place: str, wanted: str) -> Array:
    out = np.array(values, dtype=np.float64)
    if out.ndim != 1 or not np.isfinite(out).all():
        raise InputError.of("curve.numbers", place=place, value=values, wanted=wanted)
    return out


def _weights(sigma: npt.ArrayLike | None, n: int) -> Array:
    """Return one over the standard deviations."""
    if sigma is None:
        return np.ones(n)
    given = np.array(sigma, dtype=np.float64)
    if given.shape not in ((), (n,)) or not (np.isfinite(given).all() and (given > 0.0).all()):
        raise InputError.of("curve.numbers", place="sigma", value=sigma, wanted="standard deviations above zero")
    return np.asarray(1.0 / np.broadcast_to(given, n))


class _Point(NamedTuple):
    """Parameters and the scales of their columns at the last step; see the module docstring."""

    parameters: Array
    scale: Array


class _Backend:
    """A function and its observations as ``loop.Backend``; ``unit`` is the unit of residuals in the loop.

    ``unit`` is sqrt(eps) times the root mean square of the weighted observations: smaller residuals are rounding.
    """

    def __init__(self, model: Model, jacobian: Model | None, x: Any, y: Array, weight: Array) -> None:
        self._model, self._jacobian, self._x, self.y = model, jacobian, x, y
        level = float(np.sqrt(np.mean((y * weight) ** 2)))
        self.unit = np.sqrt(EPS) * level if level > 0.0 else 1.0
        self.weight = weight / self.unit

    def residuals(self, b: Array) -> Array:
        """Return model minus observation (n,) in units of the loop."""
        with np.errstate(all="ignore"):
            return np.asarray((self._model(self._x, *b) - self.y) * self.weight, dtype=np.float64)

    def design(self, b: Array) -> Array:
        """Return the derivatives (n, u) of the residuals."""
        with np.errstate(all="ignore"):
            if self._jacobian is not None:
                return np.asarray(self._jacobian(self._x, *b), dtype=np.float64) * self.weight[:, None]
            out = np.empty((len(self.y), len(b)))
            for k, value in enumerate(b):
                step, moved = TINY * max(abs(value), TINY), b.astype(np.complex128)
                moved[k] += 1j * step
                out[:, k] = np.imag(self._model(self._x, *moved)) / step
            return out * self.weight[:, None]

    def require_sound(self, b: Array) -> None:
        """Raise InputError for a model with a wrong shape or wrong derivatives."""
        with np.errstate(all="ignore"):
            value = np.asarray(self._model(self._x, *b))
        n = len(self.y)
        if value.shape != (n,) or not np.isrealobj(value) or not np.isfinite(value).all():
            seen = f"shape {value.shape}" if value.shape != (n,) else value[:3]
            raise InputError.of("curve.model", place="model", value=seen, count=n)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", np.exceptions.ComplexWarning)
                design = self.design(b)
        except (TypeError, ValueError, np.exceptions.ComplexWarning) as error:
            raise InputError.of("curve.derivatives", place="model or jacobian", value=error) from error
        if design.shape != (n, len(b)):
            raise InputError.of("curve.derivatives", place="jacobian", value=f"shape {design.shape}")
        for k in range(len(b)):
            step, rounding = self._difference(b, k)
            off, limit = np.linalg.norm(step - design[:, k]), np.linalg.norm(step) + np.linalg.norm(design[:, k])
            if not off <= DERIVATIVE_TOLERANCE * limit + rounding:
                raise InputError.of("curve.derivatives", place=f"parameter {k + 1}", value=f"{off / limit:.2g} of both")

    def _difference(self, b: Array, k: int) -> tuple[Array, float]:
        """Return the central difference of the residuals (n,), and its possible rounding error."""
        h = EPS ** (1 / 3) * (abs(b[k]) or 1.0)
        ends = [self.residuals(np.where(np.arange(len(b)) == k, b[k] + s * h, b)) for s in (-1.0, 1.0)]
        values = np.abs(ends[1]) + np.abs(self.y * self.weight)
        return (ends[1] - ends[0]) / (2.0 * h), 10.0 * EPS * float(np.linalg.norm(values)) / h

    def linearise(self, state: _Point) -> _System:
        """Linearise; NotFiniteError for derivatives that are not finite."""
        return _System(self, state)

    def error(self, state: _Point) -> float:
        """Return half the sum of squares."""
        residual = self.residuals(state.parameters)
        with np.errstate(over="ignore"):
            return 0.5 * float(residual @ residual)

    def retract(self, state: _Point, step: Any) -> _Point:
        """Return the parameters after a step, and the scales of that step."""
        return _Point(state.parameters + step.data.parameters, step.data.scale)


class _Singular(RuntimeError):
    """Error: the equations need damping."""


class _System:
    """One linearisation in scaled columns, reduced to a triangle by QR; see ``loop.System``."""

    def __init__(self, backend: _Backend, point: _Point) -> None:
        self._backend, self._b = backend, point.parameters
        self.residual, design = backend.residuals(self._b), backend.design(self._b)
        if not (np.isfinite(self.residual).all() and np.isfinite(design).all()):
            raise NotFiniteError(f"parameters {', '.join(f'{v:.6g}' for v in self._b)}")
        with np.errstate(over="ignore"):
            self.error = 0.5 * float(self.residual @ self.residual)
        largest = np.abs(design).max(axis=0)
        safe = np.where(largest > 0.0, largest, 1.0)  # squares may overflow
        scale = np.maximum(safe * np.linalg.norm(design / safe, axis=0), FORGET * point.scale)
        self.scale = np.where(scale > 0.0, scale, 1.0)
        self.design = design / self.scale
        self.orthogonal, self.triangle = np.linalg.qr(self.design)
        n, u = design.shape
        sigma0 = max(float(np.sqrt(2.0 * self.error / max(n - u, 1))), 1.0)
        self._offset = 1.0 / (np.sqrt(u) * sigma0)

    def solve(self, damping: float) -> Step:
        """Return a Gauss-Newton step, or a damped step of second order.

        _Singular if an unknown is not determined.
        """
        against = self._factor(damping)
        first = against(self.residual)
        with np.errstate(over="ignore"):
            after = self.residual + self.design @ first
            predicted = 0.5 * float(after @ after)
        length = float(np.linalg.norm(self.triangle @ first)) * self._offset
        step = first if damping == 0.0 else first + 0.5 * self._acceleration(first, against)
        if not np.isfinite(step).all():
            length = np.inf
        return Step(_Point(step / self.scale, self.scale), length, predicted)

    def _factor(self, damping: float) -> Callable[[Array], Array]:
        """Return the solver of the damped equations: from residuals (n,) to the scaled step (u,)."""
        u, rows = len(self._b), self.triangle
        if damping > 0.0:
            rows = np.vstack([rows, np.sqrt(damping) * np.eye(u)])
        orthogonal, upper = np.linalg.qr(rows)
        weak = np.abs(upper.diagonal()) <= len(rows) * EPS * np.linalg.norm(rows, axis=0)
        if weak.any():
            raise _Singular(f"parameter {int(np.argmax(weak)) + 1} depends on those before it within rounding")
        onto = orthogonal[:u].T @ self.orthogonal.T
        return lambda right: np.asarray(-solve_triangular(upper, onto @ right, check_finite=False))

    def _acceleration(self, first: Array, against: Callable[[Array], Array]) -> Array:
        """Return the second derivative (u,) of the path; nan if it is not small relative to the step."""
        beyond = self._backend.residuals(self._b + PROBE * first / self.scale)
        if np.isfinite(beyond).all() and np.abs(beyond).max() < LARGEST:
            second = against(2.0 / PROBE * ((beyond - self.residual) / PROBE - self.design @ first))
            if 2.0 * np.linalg.norm(second) <= MAX_ACCELERATION * np.linalg.norm(first):
                return second
        return np.full(len(first), np.nan)


def _conclude(backend: _Backend, result: LoopResult[_Point]) -> CurveFit:
    """Compute the statistics at the end."""
    b, unit = result.state.parameters, backend.unit
    system = backend.linearise(_Point(b, np.zeros(len(b))))
    n, u = system.design.shape
    cofactors, numbers, unavailable = None, None, ""
    diagonal = np.abs(system.triangle.diagonal())
    weak = np.flatnonzero(diagonal <= max(n, u) * EPS)
    if len(weak):
        names = ", ".join(str(k + 1) for k in weak)
        unavailable = f"no covariance: parameter {names} acts on nothing that those before it do not act on"
    else:
        inverse = solve_triangular(system.triangle, np.eye(u)) / system.scale[:, None]
        cofactors = inverse @ inverse.T / unit**2
        numbers = 1.0 - np.sum(system.orthogonal**2, axis=1)
    return CurveFit(
        b,
        system.residual / backend.weight,
        2.0 * system.error * unit**2,
        n - u,
        cofactors,
        numbers,
        result.converged,
        result.reason,
        result.log,
        unavailable,
    )
