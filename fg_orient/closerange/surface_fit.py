"""Fits of surfaces to points: by normal distances (weights of the points) or by conditions (Ayhan 1996).

Points, sigmas and unknowns are normalised; all results are in metres. Undetermined parameters are refused by name:
without priors a parameter whose standard deviation exceeds 1000 sigmas of a point follows from the noise alone, and the
iteration may converge to any value. Noise may also make a narrow minimum, so semi-axes are additionally held fixed at
very different values (``closerange.minima``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.fitting import (
    UNDETERMINED,
    Determination,
    Fit,
    Minimum,
    Rows,
    adjust,
    as_points,
    determination,
    distance_rows,
    finite_rows,
    require_sigmas,
    statistics,
    weighted_distances,
)
from fg_orient.closerange.minima import followed, held, reach
from fg_orient.closerange.surface import Kind, Surface, SurfaceModel, models_of
from fg_orient.formats.closerange import LARGEST, SMALLEST
from fg_orient.model.errors import FgOrientError, InputError, NoSolutionError

Array = npt.NDArray[np.float64]
Method = Literal["geometric", "algebraic"]
#: Names with prior values and sigmas, m.
Priors = Mapping[str, tuple[float, float]]

SEMI_AXES: Final = ("a", "b", "c")
METHODS: Final = ("geometric", "algebraic")
#: Parts of a direction below this share of its largest are not named.
NAMED: Final = 0.1


@dataclass(frozen=True)
class SurfaceFit(Fit):
    """Fitted surface; the condition number is that of weighted normal distances.

    Parameters
    ----------
    surface : Surface
    method : str
    names : tuple of str
        Of the parameters: lengths in m; coefficients of a quadric without unit; rotations and tilts in rad about the
        axes of ``surface.rotation``, whose values are 0 by definition.
    values : (u,) array
    deviations_m : (n, 3) array
        Along X, Y, Z from the points to the surface: to their foot points, or first-order residuals of the algebraic
        method (:meth:`Surface.deviations`).
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
class _Points:
    """Normalised points: ``p = offset + size * points``; known: sigmas were given."""

    points: Array
    sigma: Array
    offset: Array
    size: float
    known: bool

    @classmethod
    def of(cls, points_m: npt.ArrayLike, sigma_m: npt.ArrayLike | None) -> _Points:
        points = as_points(points_m, 3, "points")
        sigma = np.broadcast_to(np.asarray(1.0 if sigma_m is None else sigma_m, float), points.shape)
        require_sigmas(sigma, "sigma_m")
        offset = points.mean(axis=0)
        size = float(np.linalg.norm(points - offset, axis=1).max()) or 1.0
        return cls((points - offset) / size, sigma / size, offset, size, sigma_m is not None)

    @property
    def typical_sigma(self) -> float:
        """Root mean square of the sigmas."""
        return float(np.sqrt(np.mean(self.sigma**2)))


def fit_surface(
    points_m: npt.ArrayLike, kind: Kind, *, axis: str = "y", sigma_m: npt.ArrayLike | None = None,
    method: Method = "geometric", priors: Priors | None = None,
) -> SurfaceFit:  # fmt: skip
    """Fit a surface to points.

    Parameters
    ----------
    points_m : (n, 3) array
    kind : "sphere", "spheroid", "ellipsoid" or "quadric"
        Spheroid: semi-axis a across the axis of revolution, b along it.
    axis : str
        Of a spheroid: "x", "y", "z" or "free" (two tilts more).
    sigma_m : float or array that fits (n, 3), optional
        Standard deviations of the points. By default all have weight 1, and m0 estimates their sigma, in m; priors are
        then weighted relative to 1 m.
    method : "geometric" or "algebraic"
        Least weighted squares of the distances to the surface, or least squares of the conditions of
        ``factors.conditions.surfaces`` with equal weights (Ayhan 1996, eqs. 138-154; the coefficients of a quadric of
        length 1).
    priors : mapping, optional
        Observed parameters by name, value and sigma, m or rad (geometric method).

    Returns
    -------
    SurfaceFit

    Raises
    ------
    InputError
        Too few points, undetermined parameters (named, with their direction), impossible values.
    NoSolutionError
        The iteration does not converge.
    """
    if method not in METHODS:
        raise InputError.of("closerange.method", place="method", value=method, known=", ".join(METHODS))
    given = _Points.of(points_m, sigma_m)
    models = models_of(kind, given.points, axis)
    unknowns = len(models[0].names) - (kind == "quadric")
    known = _require_priors(models[0], priors or {}, method)
    if len(given.points) + len(known) < unknowns:
        raise InputError.of("closerange.few", place=kind, value=len(given.points), least=unknowns - len(known))
    tried, failures = [], []
    for model in models:
        try:
            tried.append(_fitted(given, model, method, known))
        except (InputError, NoSolutionError) as error:
            failures.append(error)
    if not tried:
        raise failures[0]
    model, minimum = min(tried, key=lambda one: one[1].squares)
    return _result(given, model, minimum, method, known)


def _require_priors(model: SurfaceModel, priors: Priors, method: str) -> Priors:
    for name, (value, sigma) in priors.items():
        possible = abs(value) <= LARGEST and SMALLEST <= sigma <= LARGEST and (value > 0.0 or name not in SEMI_AXES)
        lengths = [known for known, flag in zip(model.names, model.is_length, strict=True) if flag]
        if name not in lengths or method != "geometric" or not possible:
            raise InputError.of("closerange.prior", place=f"prior {name}", value=f"{value} +- {sigma}",
                                known=", ".join(lengths))  # fmt: skip
    return priors


def _fitted(given: _Points, model: SurfaceModel, method: str, priors: Priors) -> tuple[SurfaceModel, Minimum]:
    """Minimum from one start; without convergence undetermined parameters are refused at the last possible state."""

    def rows(x: Array, with_jacobian: bool) -> tuple[Array, Array]:
        if method == "algebraic":
            value, design, _ = model.derivatives(x, given.points, with_jacobians=with_jacobian)
        else:
            value, design = _distance_rows(given, model, x, priors, with_jacobian)
        if model.kind != "quadric":
            return value, design
        # only ratios of coefficients are unknowns: a step along the coefficients is constrained to 0
        return np.append(value, 0.0), np.vstack([design, x]) if with_jacobian else design

    if model.kind == "quadric" and method == "algebraic":  # its start is the solution, by SVD
        return model, Minimum(model.start, *rows(model.start, True), ())
    try:
        return model, adjust(rows, model.start, model.kind, moved=model.moved)
    except NoSolutionError:
        _require_determined(given, model, model.start, priors)
        for k in _semi_axes(model, priors):
            start = held(_geometric(given, model, priors), model.start, k, float(model.start[k]))
            if start is not None:
                _require_steep(given, model, (start.state, start.squares), k, priors)
        raise


def _distance_rows(
    given: _Points, model: SurfaceModel, x: Array, priors: Priors, with_jacobian: bool
) -> tuple[Array, Array]:
    """Rows of normal distances divided by their sigmas, then of priors; derivatives at the foot points."""
    conditions, centre = model.conditions(x)
    residual, foot = weighted_distances(conditions, given.points - centre, given.sigma)
    scale = np.where(model.is_length, given.size, 1.0)
    shift = _shift(given, model)
    at = [model.names.index(name) for name in priors]
    values = model.values(x) * scale + shift
    residual = np.append(residual, [(values[k] - v) / s for k, (v, s) in zip(at, priors.values(), strict=True)])
    if not with_jacobian:
        return residual, np.zeros((0, len(x)))
    _, by_unknown, slope = model.derivatives(x, foot + centre)
    design = distance_rows(by_unknown, slope, given.sigma)
    extra = np.zeros((len(at), len(x)))
    extra[np.arange(len(at)), at] = [scale[k] / s for k, (_, s) in zip(at, priors.values(), strict=True)]
    return residual, np.vstack([design, extra])


def _shift(given: _Points, model: SurfaceModel) -> Array:
    """Change (u,) of the unknowns from normalised to original coordinates: the offset for the centre."""
    names = ("x0", "y0", "z0")
    return np.array([given.offset[names.index(name)] if name in names else 0.0 for name in model.names])


def _require_determined(given: _Points, model: SurfaceModel, x: Array, priors: Priors) -> Determination:
    """Determination by the weighted normal distances; see the module docstring.

    Raises
    ------
    InputError
        Names the parameters and the undetermined direction.
    NoSolutionError
        Normal distances have no derivatives at this state.
    """
    _, design = finite_rows(_geometric(given, model, priors), model.kind)(x, True)
    tangent = _tangent(model, x)
    judged = determination(design @ tangent)
    if judged.cofactors is not None:
        sd = np.sqrt(np.einsum("ij,jk,ik->i", tangent, judged.cofactors, tangent))
        open_ = (sd > UNDETERMINED * given.typical_sigma) & ~np.isin(model.names, list(priors))
        if not open_.any():
            return judged
    raise _open(given, model, tangent @ judged.weakest, judged.condition)


def _open(given: _Points, model: SurfaceModel, direction: Array, condition: float) -> FgOrientError:
    """Refusal that names the parameters of a direction."""
    return InputError.of(
        "closerange.undetermined", place=model.kind, value=f"condition {condition:.2g}", limit=UNDETERMINED,
        **_words(model.names, direction * np.where(model.is_length, given.size, 1.0)),
    )  # fmt: skip


def _geometric(given: _Points, model: SurfaceModel, priors: Priors) -> Rows:
    """Rows of weighted distances and priors."""
    return lambda x, with_jacobian: _distance_rows(given, model, x, priors, with_jacobian)


def _semi_axes(model: SurfaceModel, priors: Priors) -> list[int]:
    """Semi-axes without a prior, that of revolution first: every undetermined direction changes them."""
    return [k for k, name in enumerate(model.names) if name in SEMI_AXES and name not in priors][::-1]


def _least(given: _Points, model: SurfaceModel, state: Array, priors: Priors) -> tuple[Array, float] | None:
    """Least weighted squares of the distances, from the result of either method."""
    try:
        minimum = adjust(_geometric(given, model, priors), state, model.kind)
    except NoSolutionError:
        return None
    return minimum.state, minimum.squares


def _require_steep(
    given: _Points, model: SurfaceModel, base: tuple[Array, float] | None, k: int, priors: Priors
) -> None:  # fmt: skip
    """Refuse a semi-axis if a fit with it fixed at a very different value is hardly worse.

    Raises
    ------
    InputError
        Names the parameters and the direction near the start; or the semi-axis that cannot be verified, because no fit
        converges there and its squares do not stay far above.
    """
    if base is None:
        raise _unverified(given, model, k, float(model.values(model.start)[k]))
    state, squares = base
    redundancy = len(given.points) + len(priors) - len(state)
    ends = reach(given.typical_sigma, squares, redundancy, known=given.known)
    if ends is None:
        return
    rows, (far, growth) = _geometric(given, model, priors), ends
    for away in (far, -far):
        if model.values(state)[k] + away <= 0.0:
            continue
        other = followed(rows, state, k, float(state[k] + away), squares + growth)
        if other is None:
            raise _unverified(given, model, k, float(model.values(state)[k] + away))
        if other[1] - squares < growth:
            judged = determination(rows(other[0], True)[1])
            raise _open(given, model, judged.weakest, judged.condition)


def _unverified(given: _Points, model: SurfaceModel, k: int, value: float) -> FgOrientError:
    """Refusal of a semi-axis that may or may not be determined."""
    return InputError.of("closerange.unverified", place=model.kind, name=model.names[k],
                         value=f"{model.names[k]} held at {value * given.size:.4g} m")  # fmt: skip


def _tangent(model: SurfaceModel, x: Array) -> Array:
    """Free directions (u, f) of the unknowns: all, but for quadrics only those that change ratios."""
    if model.kind != "quadric":
        return np.eye(len(x))
    return np.asarray(np.linalg.svd(x[None])[2][1:].T)


def _words(names: tuple[str, ...], direction: Array) -> dict[str, str]:
    """Parameters of a direction, largest first, and the direction relative to the first one."""
    order = np.argsort(-np.abs(direction), kind="stable")
    order = order[np.abs(direction[order]) >= NAMED * np.abs(direction[order[0]])]
    first = names[order[0]]
    ratios = [f"d{names[k]} = {direction[k] / direction[order[0]]:+.2f} d{first}" for k in order[1:]]
    parts = [names[k] for k in order]
    which = f"{', '.join(parts[:-1])} and {parts[-1]} are inseparable" if len(parts) > 1 else f"{first} is open"
    return {"names": which, "direction": ", ".join(ratios) or f"d{first} alone"}


def _result(given: _Points, model: SurfaceModel, minimum: Minimum, method: str, priors: Priors) -> SurfaceFit:
    model, state = model.settled(minimum.state)
    judged, tangent = _require_determined(given, model, state, priors), _tangent(model, state)
    least = _least(given, model, state, priors)
    for k in _semi_axes(model, priors):
        _require_steep(given, model, least, k, priors)
    cofactors = judged.cofactors
    if method == "algebraic":
        cofactors = determination(model.derivatives(state, given.points)[1] @ tangent).cofactors
    if cofactors is None:  # the normal distances determine the same unknowns
        raise NoSolutionError.of("closerange.not_converged", place=model.kind, reason="the conditions are singular")
    scale = np.where(model.is_length, given.size, 1.0)
    residual = minimum.residual[: len(minimum.residual) - (model.kind == "quadric")]
    own = replace(judged, cofactors=cofactors)
    unit = model.surface(state)
    surface = Surface(
        unit.kind, unit.centre * given.size + given.offset, unit.semi_axes * given.size, unit.rotation,
        unit.coefficients,
    )  # fmt: skip
    points = given.points * given.size + given.offset
    foot = surface.foot_points(points, given.sigma)
    return SurfaceFit(
        surface, method, model.names, model.values(state) * scale + _shift(given, model),
        foot - points if method == "geometric" else surface.deviations(points), surface.distances(points),
        **statistics(residual, own, len(minimum.log), scale[:, None] * tangent),
    )  # fmt: skip
