"""Fit surfaces to points: by weighted normal distances, or by conditions (Ayhan 1996).

Points, sigmas and unknowns are normalised; all results are in metres. Undetermined
parameters are refused by name. Without priors, noise alone determines a parameter whose
standard deviation exceeds 1000 sigmas of a point, and the iteration may converge to any
value. Noise may also make a narrow minimum, so semi-axes are additionally held fixed at
very different values (``closerange.minima``).
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.closerange import fitting
from fg_orient.closerange.minima import followed, held, reach
from fg_orient.closerange.surface import Kind, Surface, SurfaceModel, models_of
from fg_orient.model.errors import FgOrientError, InputError, NoSolutionError
from fg_orient.model.names import LARGEST, SMALLEST

Method = Literal["geometric", "algebraic"]
#: Prior value and sigma, m, by the name of the parameter.
Priors = Mapping[str, tuple[float, float]]

SEMI_AXES: Final = ("a", "b", "c")
METHODS: Final = ("geometric", "algebraic")
#: A part of a direction is named if it is above this share of the largest part.
NAMED: Final = 0.1


@dataclass(frozen=True)
class SurfaceFit(fitting.Fit):
    """Fitted surface; the condition number belongs to weighted normal distances.

    Parameters
    ----------
    surface : Surface
    method : str
    names : tuple of str
        Names of the parameters: lengths in m; coefficients of a quadric without unit;
        rotations and tilts in rad about the axes of ``surface.rotation``, whose values
        are 0 by definition.
    values : (u,) array
    deviations_m : (n, 3) array
        Deviations along X, Y, Z from the points to the surface: to their foot points, or
        first-order residuals of the algebraic method (:meth:`Surface.deviations`).
    distances_m : (n,) array
        Normal distances, above 0 outside.
    """

    surface: Surface
    method: str
    names: tuple[str, ...]
    values: Array
    deviations_m: Array
    distances_m: Array

    @property
    def parameters(self) -> dict[str, float]:
        """Values by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))

    @property
    def rms_m(self) -> float:
        """Root mean square of the normal distances."""
        return float(np.sqrt(np.mean(self.distances_m**2)))


@dataclass(frozen=True)
class _Task:
    """Model, priors and normalised points: ``p = offset + size * points``; ``known``: sigmas were given."""

    model: SurfaceModel
    priors: Priors
    points: Array
    sigma: Array
    offset: Array
    size: float
    known: bool

    @property
    def scale(self) -> Array:
        """Return the unit (u,) of the unknowns in m; 1 for unknowns that are not lengths."""
        return np.where(self.model.is_length, self.size, 1.0)

    @property
    def shift(self) -> Array:
        """Numbers (u,) that are added to unknowns of normalised coordinates: the offset for the centre, else 0."""
        centre = dict(zip(("x0", "y0", "z0"), self.offset.tolist(), strict=True))
        return np.array([centre.get(name, 0.0) for name in self.model.names])

    @property
    def typical_sigma(self) -> float:
        """Root mean square of the sigmas."""
        return float(np.sqrt(np.mean(self.sigma**2)))

    @property
    def semi_axes(self) -> list[int]:
        """Semi-axes without a prior, the axis of revolution first: every undetermined direction changes them."""
        return [k for k, n in enumerate(self.model.names) if n in SEMI_AXES and n not in self.priors][::-1]

    def geometric(self, x: Array, with_jacobian: bool) -> tuple[Array, Array]:
        """Return rows of normal distances divided by their sigmas, then of priors.

        Derivatives at the foot points.
        """
        model = self.model
        conditions, centre = model.conditions(x)
        residual, foot = fitting.weighted_distances(conditions, self.points - centre, self.sigma)
        scale, at = self.scale, [model.names.index(name) for name in self.priors]
        values = model.values(x) * scale + self.shift
        given = list(zip(at, self.priors.values(), strict=True))
        residual = np.append(residual, [(values[k] - v) / s for k, (v, s) in given])
        if not with_jacobian:
            return residual, np.zeros((0, len(x)))
        _, by_unknown, slope = model.derivatives(x, foot + centre)
        extra = np.zeros((len(at), len(x)))
        extra[np.arange(len(at)), at] = [scale[k] / s for k, (_, s) in given]
        return residual, np.vstack([fitting.distance_rows(by_unknown, slope, self.sigma), extra])

    def refusal(self, direction: Array, condition: float) -> FgOrientError:
        """Return the error that names the parameters of a direction (u,)."""
        words = _words(self.model.names, direction * self.scale)
        return InputError.of(
            "closerange.undetermined",
            place=self.model.kind,
            value=f"condition {condition:.2g}",
            limit=fitting.UNDETERMINED,
            **words,
        )

    def unverified(self, k: int, value: float) -> FgOrientError:
        """Return the error for a semi-axis if it cannot be verified that it is determined."""
        name = self.model.names[k]
        return InputError.of(
            "closerange.unverified", place=self.model.kind, name=name, value=f"{name} held at {value * self.size:.4g} m"
        )


def fit_surface(
    points_m: npt.ArrayLike,
    kind: Kind,
    *,
    axis: str = "y",
    sigma_m: npt.ArrayLike | None = None,
    method: Method = "geometric",
    priors: Priors | None = None,
) -> SurfaceFit:
    """Fit a surface to points.

    Parameters
    ----------
    points_m : (n, 3) array
    kind : "sphere", "spheroid", "ellipsoid" or "quadric"
        Spheroid: semi-axis a across the axis of revolution, b along it.
    axis : str
        Axis of a spheroid: "x", "y", "z" or "free" (two additional tilts).
    sigma_m : float or array that fits (n, 3), optional
        Standard deviations of the points. By default all have weight 1, and m0 estimates
        their sigma, in m; priors are then weighted relative to 1 m.
    method : "geometric" or "algebraic"
        Least weighted squares of the distances to the surface, or least squares of the
        conditions of ``factors.conditions.surfaces`` with equal weights (Ayhan 1996, eqs.
        138-154; the coefficients of a quadric of length 1).
    priors : mapping, optional
        Observed parameters by name, value and sigma, m or rad (geometric method).

    Returns
    -------
    SurfaceFit

    Raises
    ------
    InputError
        There are too few points, parameters are undetermined (the message names them and
        their direction), or values are impossible.
    NoSolutionError
        The iteration does not converge.
    """
    if method not in METHODS:
        raise InputError.of("closerange.method", place="method", value=method, known=", ".join(METHODS))
    points = fitting.as_points(points_m, 3, "points")
    sigma = fitting.as_sigmas(1.0 if sigma_m is None else sigma_m, points, "sigma_m")
    offset = points.mean(axis=0)
    size = float(np.linalg.norm(points - offset, axis=1).max()) or 1.0
    normalised = (points - offset) / size
    models, observed = models_of(kind, normalised, axis), priors or {}
    unknowns = len(models[0].names) - (kind == "quadric")
    lengths = [name for name, is_length in zip(models[0].names, models[0].is_length, strict=True) if is_length]
    for name, (value, spread) in observed.items():
        possible = abs(value) <= LARGEST and SMALLEST <= spread <= LARGEST and (value > 0.0 or name not in SEMI_AXES)
        if name not in lengths or method != "geometric" or not possible:
            raise InputError.of(
                "closerange.prior", place=f"prior {name}", value=f"{value} +- {spread}", known=", ".join(lengths)
            )
    if len(points) + len(observed) < unknowns:
        raise InputError.of("closerange.few", place=kind, value=len(points), least=unknowns - len(observed))
    tried, failures = list[tuple[_Task, fitting.Minimum]](), list[FgOrientError]()
    for model in models:
        task = _Task(model, observed, normalised, sigma / size, offset, size, sigma_m is not None)
        try:
            tried.append((task, _minimum(task, method)))
        except (InputError, NoSolutionError) as error:
            failures.append(error)
    if not tried:
        raise failures[0]
    return _result(*min(tried, key=lambda one: one[1].squares), method)


def _minimum(task: _Task, method: str) -> fitting.Minimum:
    """Minimise from one start; without convergence undetermined parameters are refused at the last possible state."""
    model = task.model

    def rows(x: Array, with_jacobian: bool) -> tuple[Array, Array]:
        if method == "algebraic":
            value, design, _ = model.derivatives(x, task.points, with_jacobians=with_jacobian)
        else:
            value, design = task.geometric(x, with_jacobian)
        if model.kind != "quadric":
            return value, design
        # only ratios of coefficients are unknowns: a step along the coefficients is constrained to 0
        return np.append(value, 0.0), np.vstack([design, x]) if with_jacobian else design

    if model.kind == "quadric" and method == "algebraic":  # in this case SVD has already given the solution as start
        return fitting.Minimum(model.start, *rows(model.start, True), ())
    try:
        return fitting.adjust(rows, model.start, model.kind, moved=model.moved)
    except NoSolutionError:
        _require_determined(task, model.start)
        for k in task.semi_axes:
            start = held(task.geometric, model.start, k, float(model.start[k]))
            if start is not None:
                _require_steep(task, (start.state, start.squares), k)
        raise


def _require_determined(task: _Task, x: Array) -> fitting.Determination:
    """Determine the unknowns by the weighted normal distances; see the module docstring.

    Raises
    ------
    InputError
        The points leave a direction undetermined; the error names its parameters.
    NoSolutionError
        Normal distances have no derivatives at this state.
    """
    _, design = fitting.finite_rows(task.geometric, task.model.kind)(x, True)
    tangent = _tangent(task.model, x)
    assessed = fitting.determination(design @ tangent)
    if assessed.cofactors is not None:
        sd = np.sqrt(np.einsum("ij,jk,ik->i", tangent, assessed.cofactors, tangent))
        if not ((sd > fitting.UNDETERMINED * task.typical_sigma) & ~np.isin(task.model.names, list(task.priors))).any():
            return assessed
    raise task.refusal(tangent @ assessed.weakest, assessed.condition)


def _require_steep(task: _Task, base: tuple[Array, float] | None, k: int) -> None:
    """Refuse a semi-axis if a fit with it fixed at a very different value is hardly worse.

    Parameters
    ----------
    base : tuple of (state (u,), weighted squares) or None
        Least weighted squares of the distances; None: no convergence.
    k : int
        Number of the unknown.

    Raises
    ------
    InputError
        The error names the parameters and the direction near the start. If a semi-axis cannot
        be verified, it names this axis: no fit converges there, and its sum of squares is not
        clearly larger.
    """
    model = task.model
    if base is None:
        raise task.unverified(k, float(model.values(model.start)[k]))
    state, squares = base
    redundancy = len(task.points) + len(task.priors) - len(state)
    ends = reach(task.typical_sigma, squares, redundancy, known=task.known)
    if ends is None:
        return
    far, growth = ends
    for away in (far, -far):
        value = float(model.values(state)[k] + away)
        if value <= 0.0:
            continue
        other = followed(task.geometric, state, k, float(state[k] + away), squares + growth)
        if other is None:
            raise task.unverified(k, value)
        if other[1] - squares < growth:
            assessed = fitting.determination(task.geometric(other[0], True)[1])
            raise task.refusal(assessed.weakest, assessed.condition)


def _tangent(model: SurfaceModel, x: Array) -> Array:
    """Return the free directions (u, f) of the unknowns.

    All directions are free, except for quadrics: only the ratios of their coefficients can change.
    """
    if model.kind != "quadric":
        return np.eye(len(x))
    return np.asarray(np.linalg.svd(x[None])[2][1:].T)


def _words(names: tuple[str, ...], direction: Array) -> dict[str, str]:
    """Return the parameters of a direction, largest first, and the direction relative to the first one."""
    order = np.argsort(-np.abs(direction), kind="stable")
    first, *others = order[np.abs(direction[order]) >= NAMED * np.abs(direction[order[0]])].tolist()
    if not others:
        return {"names": f"{names[first]} is not determined", "direction": f"d{names[first]} alone"}
    ratios = [f"d{names[k]} = {direction[k] / direction[first]:+.2f} d{names[first]}" for k in others]
    *parts, last = (names[k] for k in (first, *others))
    return {"names": f"{', '.join(parts)} and {last} are inseparable", "direction": ", ".join(ratios)}


def _result(task: _Task, minimum: fitting.Minimum, method: str) -> SurfaceFit:
    model, state = task.model.settled(minimum.state)
    task = replace(task, model=model)
    assessed, tangent = _require_determined(task, state), _tangent(model, state)
    least = None
    with suppress(NoSolutionError):
        geometric = fitting.adjust(task.geometric, state, model.kind)
        least = geometric.state, geometric.squares
    for k in task.semi_axes:
        _require_steep(task, least, k)
    cofactors = assessed.cofactors
    if method == "algebraic":
        cofactors = fitting.determination(model.derivatives(state, task.points)[1] @ tangent).cofactors
    if cofactors is None:  # the normal distances determine the same unknowns
        raise NoSolutionError.of("closerange.not_converged", place=model.kind, reason="the conditions are singular")
    residual = minimum.residual[: len(minimum.residual) - (model.kind == "quadric")]
    own = replace(assessed, cofactors=cofactors)
    unit = model.surface(state)
    surface = replace(unit, centre=unit.centre * task.size + task.offset, semi_axes=unit.semi_axes * task.size)
    points = task.points * task.size + task.offset
    foot = surface.foot_points(points, task.sigma)
    return SurfaceFit(
        surface,
        method,
        model.names,
        model.values(state) * task.scale + task.shift,
        foot - points if method == "geometric" else surface.deviations(points),
        surface.distances(points),
        **fitting.statistics(residual, own, len(minimum.log), task.scale[:, None] * tangent),
    )
