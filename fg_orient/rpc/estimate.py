"""Estimate rational function models from control points: linear form, weighted linear form, true equations.

The linear form and its weights 1/f2 are from Tao & Hu 2001. Further sources are
Terlemezoğlu 2019, section 2.4 and T(2.53)-(2.57), T(3.51).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.linear.registry import solve
from fg_orient.adjustment.linear.ridge import regularised
from fg_orient.adjustment.linear.system import LinearSystem
from fg_orient.model.arrays import array
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.rpc.fit import RfmFit
from fg_orient.rpc.form import RfmForm
from fg_orient.rpc.options import Penalty
from fg_orient.rpc.points import ControlPoints, Scaling

#: Default solver, QR of A. The condition number of A is the square root of the condition number of N.
SOLVER: Final = "qr_scaled"
#: Solver of systems with a penalty and of the weighted linear form, whose design may lack full rank.
STEP_SOLVER: Final = "svd_scaled"
MAX_ITERATIONS: Final = 100
#: The iteration ends if a step changes all unknowns by less than this share,
END: Final = 1e-12
#: or if two consecutive steps reduce the sum of squares by less than this share. A residual then changes by 1e-10.
GAIN: Final = 1e-10
#: Damping of Levenberg-Marquardt relative to the diagonal of N: start, change.
DAMPING: Final = 1e-6
DAMPING_CHANGE: Final = 10.0
MAX_DAMPING: Final = 1e10


def penalised_unknowns(form: RfmForm, penalty: Penalty) -> Array:
    """Return an indicator (u,) of the penalised unknowns: all unknowns, or all except the affine part.

    A satellite image is affine within some pixels, so the second choice is a suitable
    prior. The first choice also pulls the scale of the image to zero.

    Raises
    ------
    InputError
        The penalty does not exist.
    """
    if penalty == "identity":
        return np.ones(len(form))
    if penalty == "beyond_affine":
        return form.beyond_affine.astype(np.float64)
    raise InputError.of("rfm.penalty", place="penalty", value=penalty)


def linear_system(points: ControlPoints, form: RfmForm, scaling: Scaling) -> LinearSystem:
    """Return the normal equations of the linear form, as published: rows of the sample, then of the line."""
    m = form.monomials(scaling.ground(points.ground))
    return LinearSystem.from_design(*form.design(m, scaling.image(points.line, points.sample)))


def _unfitted(points: ControlPoints, form: RfmForm, scaling: Scaling, kappa: float, penalty: Penalty) -> RfmFit:
    """Return a fit whose unknowns are all zero, before the estimation."""
    require_points(points, form, kappa)
    return RfmFit(form, scaling, points, np.zeros(len(form)), "", kappa, penalised_unknowns(form, penalty))


def fit_linear(
    points: ControlPoints,
    form: RfmForm,
    *,
    normalise: bool = True,
    solver: str = SOLVER,
    kappa: float = 0.0,
    penalty: Penalty = "beyond_affine",
    allow_pole: bool = False,
) -> RfmFit:
    """Fit the linear form m a - sample m' b = sample, as published.

    Parameters
    ----------
    points : ControlPoints
    form : RfmForm
    normalise : bool
        Coordinates to [-1, 1]; without it the system is singular within rounding (T, section 4.3).
    solver : str
        A name in the registry of :mod:`fg_orient.adjustment.linear`.
    kappa : float
        Factor of the squares of the penalised unknowns, which are added to the squares of the residuals.
    penalty : "beyond_affine" or "identity"
        See :func:`penalised_unknowns`.
    allow_pole : bool
        Return a model even if a denominator changes sign among the points.

    Raises
    ------
    InputError
        There are fewer equations than coefficients, a coordinate has no extent, the solver is unknown, or kappa is
        invalid.
    NoSolutionError
        The solver breaks down, or a denominator changes sign.
    """
    start = _unfitted(points, form, Scaling.of(points, normalise=normalise), kappa, penalty)
    system = linear_system(points, form, start.scaling)
    if kappa > 0.0:
        used = STEP_SOLVER if solver == SOLVER else solver
        solution = regularised(system, kappa, np.diag(start.penalised), solver=used)
    else:
        solution = solve(solver, system)
    fit = replace(start, x=solution.x, method=f"linear form, {solver}", notes=solution.notes)
    return fit if allow_pole else fit.without_pole()


def fit_weighted(
    points: ControlPoints,
    form: RfmForm,
    *,
    normalise: bool = True,
    kappa: float = 0.0,
    penalty: Penalty = "beyond_affine",
    allow_pole: bool = False,
) -> RfmFit:
    """Fit the linear form with the weights 1/f2^2 of the last cycle until convergence (Tao & Hu 2001).

    At convergence, A^T P v = 0, and the weighted residuals are the true residuals.
    However, A is not the Jacobian of the true residuals. Therefore the result is close to
    the least-squares solution of the true equations, but not equal to it.

    Raises
    ------
    InputError
        See :func:`fit_linear`.
    NoSolutionError
        A denominator changes sign, or the cycles do not converge.
    """
    start = fit_linear(points, form, normalise=normalise, kappa=kappa, penalty=penalty, allow_pole=True)
    m = form.monomials(start.scaling.ground(points.ground))
    design, observed = form.design(m, start.scaling.image(points.line, points.sample))
    x = start.x
    for iteration in range(1, MAX_ITERATIONS + 1):
        below = form.below(x, m)
        if not (below > 0.0).all():
            raise NoSolutionError.of("rfm.pole", place=f"weighted cycle {iteration}", value=f"{below.min():.3g}")
        weight = 1.0 / np.concatenate([below[:, 1], below[:, 0]])
        system = LinearSystem.from_design(design * weight[:, None], observed * weight)
        previous, x = x, _solution(system, kappa * start.penalised)
        if np.abs(x - previous).max() <= 1e-10 * (1.0 + np.abs(x).max()):
            fit = replace(start, x=x, method="weighted linear form", true=True, iterations=iteration, notes=())
            return fit if allow_pole else fit.without_pole()
    raise NoSolutionError.of("rfm.no_end", place="weighted linear form", value=f"{MAX_ITERATIONS} cycles")


def fit_true(
    points: ControlPoints,
    form: RfmForm,
    *,
    normalise: bool = True,
    kappa: float = 0.0,
    penalty: Penalty = "beyond_affine",
    scaling: Scaling | None = None,
    allow_pole: bool = False,
) -> RfmFit:
    """Fit the true equations sample - f1/f2 = 0, line - f3/f4 = 0 by damped Gauss-Newton (Levenberg-Marquardt).

    Parameters
    ----------
    points, form, normalise, kappa, penalty, allow_pole
        See :func:`fit_linear`.
    scaling : Scaling, optional
        Replaces the scaling of the points.

    Raises
    ------
    InputError
        See :func:`fit_linear`.
    NoSolutionError
        The iteration does not converge, or a denominator changes sign among the points.
    """
    start = _unfitted(points, form, scaling or Scaling.of(points, normalise=normalise), kappa, penalty)
    m = form.monomials(start.scaling.ground(points.ground))
    image = start.scaling.image(points.line, points.sample)
    x, iterations = _minimise(form, m, image, _affine(form, m, image), kappa * start.penalised)
    fit = replace(start, x=x, method="true equations", true=True, iterations=iterations)
    return fit if allow_pole else fit.without_pole()


def _minimise(form: RfmForm, m: Array, image: Array, x: Array, penalty: Array) -> tuple[Array, int]:
    """Minimise by Levenberg-Marquardt; if a step crosses a pole at a point, it is shortened."""
    root = np.sqrt(penalty)
    damping, flat, (r, cost) = DAMPING, 0, _misfit(form, m, image, x, root)
    for iteration in range(1, MAX_ITERATIONS + 1):
        jacobian = np.vstack([form.jacobian(x, m), -np.diag(root)])
        length = np.linalg.norm(jacobian, axis=0)
        length = np.where(length > 0.0, length, 1.0)
        q, upper = np.linalg.qr(jacobian / length)
        left, values, right = np.linalg.svd(upper)
        beta = left.T @ (q.T @ r)
        while True:
            step = (right.T @ (beta * values / (values**2 + damping))) / length
            new_r, new_cost = _misfit(form, m, image, x + step, root)
            if new_cost <= cost:
                break
            damping *= DAMPING_CHANGE
            if damping > MAX_DAMPING:  # no step reduces the sum of squares by more than rounding
                return x, iteration
        gain = cost - new_cost
        still = np.abs(step * length).max() <= END * (1.0 + np.abs(x * length).max())
        x, r, cost = x + step, new_r, new_cost
        flat = flat + 1 if gain <= GAIN * cost else 0
        if still or flat == 2 or cost == 0.0:
            return x, iteration
        damping = max(damping / DAMPING_CHANGE**2, 1e-18)
    raise NoSolutionError.of("rfm.no_end", place="true equations", value=f"{MAX_ITERATIONS} iterations")


def _misfit(form: RfmForm, m: Array, image: Array, x: Array, root: Array) -> tuple[Array, float]:
    """Return residuals of observations and penalty, and their sum of squares; inf if a denominator is not positive."""
    if not (form.below(x, m) > 0.0).all():
        return np.zeros(0), np.inf
    v = image - form.image(x, m)
    r = np.concatenate([v[:, 1], v[:, 0], root * x])
    return r, float(r @ r)


def _affine(form: RfmForm, m: Array, image: Array) -> Array:
    """Solve least squares for the affine unknowns; all others are zero."""
    x = np.zeros(len(form))
    plain = ~form.beyond_affine
    design, observed = form.design(m, image)
    x[plain] = np.linalg.lstsq(design[:, plain], observed, rcond=None)[0]
    return x


def _solution(system: LinearSystem, penalty: Array) -> Array:
    """Solve least squares with a penalty on each unknown."""
    if not penalty.any():
        return solve(STEP_SOLVER, system).x
    return regularised(system, 1.0, np.diag(np.sqrt(penalty)), solver=STEP_SOLVER).x


def require_points(points: ControlPoints, form: RfmForm, kappa: float) -> None:
    """Refuse fewer equations than coefficients without a penalty, and an invalid kappa."""
    array(kappa, "kappa", ())
    if not (np.isfinite(kappa) and kappa >= 0.0):
        raise InputError.of("linear.kappa_value", place="kappa", value=kappa)
    equations = 2 * len(points)
    if equations < len(form) and kappa == 0.0:
        place = f"degree {form.degree}, {form.denominators} denominators"
        least = -(-len(form) // 2)
        raise InputError.of("rfm.few_points", place=place, value=len(points), unknowns=len(form), least=least)
