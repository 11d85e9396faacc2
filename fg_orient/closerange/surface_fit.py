"""Fits of surfaces to points: by normal distances (weights of the points) or by conditions (Ayhan 1996).

Points, sigmas and unknowns are normalised before; all results are in metres again. What the points do not determine is
refused by name: without priors a parameter whose standard deviation exceeds 1000 sigmas of a point follows from the
noise alone, and an iteration ends with it anywhere. Where it ends, noise may have made a narrow minimum, so semi-axes
are also held at quite other values (``closerange.profile``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.feet import distance_rows, weighted_distances
from fg_orient.closerange.fitting import (
    UNDETERMINED,
    Adjusted,
    Determination,
    Deviations,
    Rows,
    adjust,
    as_points,
    determination,
    finite_rows,
    require_sigmas,
    unit_weight,
)
from fg_orient.closerange.profile import followed, held, reach
from fg_orient.closerange.surface import Kind, Surface
from fg_orient.closerange.surface_models import Model, models_of
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
class SurfaceFit(Deviations):
    """A fitted surface.

    Parameters
    ----------
    surface : Surface
    method : str
    names : tuple of str
        Of the parameters: lengths in m; coefficients of a quadric without unit; turns and tilts in rad about the axes
        of ``surface.rotation``, 0 by definition, so that only their standard deviations say something.
    values : (u,) array
    cofactors : (u, u) array
        Of the parameters in those units, for the sigmas given; times m0 squared their covariance.
    m0 : float or None
        Standard deviation of unit weight; None without redundancy.
    redundancy : int
    condition : float
        Of the design with columns of unit length, of weighted normal distances.
    deviations_m : (n, 3) array
        Along X, Y, Z from the points to the surface: to their feet, or the first-order residuals of the algebraic
        method (:meth:`Surface.deviations`).
    distances_m : (n,) array
        Normal distances, above 0 outside.
    iterations : int
    """

    surface: Surface
    method: str
    names: tuple[str, ...]
    values: Array
    cofactors: Array
    m0: float | None
    redundancy: int
    condition: float
    deviations_m: Array
    distances_m: Array
    iterations: int

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
        points = as_points(points_m, 3, "points", InputError.of)
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
        Standard deviations of the points. Without them all have weight 1, and m0 is their size, in m; priors then
        weigh as beside points of 1 m.
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
        Too few points, parameters that these do not determine (named, with their direction), values not possible.
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
    model, found = min(tried, key=lambda one: float(one[1].residual @ one[1].residual))
    return _result(given, model, found, method, known)


def _require_priors(model: Model, priors: Priors, method: str) -> Priors:
    for name, (value, sigma) in priors.items():
        possible = abs(value) <= LARGEST and SMALLEST <= sigma <= LARGEST and (value > 0.0 or name not in SEMI_AXES)
        lengths = [known for known, flag in zip(model.names, model.is_length, strict=True) if flag]
        if name not in lengths or method != "geometric" or not possible:
            raise InputError.of("closerange.prior", place=f"prior {name}", value=f"{value} +- {sigma}",
                                known=", ".join(lengths))  # fmt: skip
    return priors


def _fitted(given: _Points, model: Model, method: str, priors: Priors) -> tuple[Model, Adjusted]:
    """Adjust from one start; what is not determined there is told from the last state that was."""

    def rows(x: Array, want: bool) -> tuple[Array, Array]:
        if method == "algebraic":
            value, design, _ = model.derivatives(x, given.points, want=want)
        else:
            value, design = _distance_rows(given, model, x, priors, want)
        # only ratios of coefficients are unknowns of a quadric: a step along them is held at 0
        held = model.kind == "quadric"
        return (np.append(value, 0.0), np.vstack([design, x]) if want else design) if held else (value, design)

    if model.kind == "quadric" and method == "algebraic":  # its start is the solution, by SVD
        return model, Adjusted(model.start, *rows(model.start, True), ())
    try:
        return model, adjust(rows, model.start, model.kind, moved=model.moved)
    except NoSolutionError:
        _require_determined(given, model, model.start, priors)
        for k in _semi_axes(model, priors):
            begun = _begun(given, model, k, priors)
            if begun is not None:
                _require_steep(given, model, begun, k, priors)
        raise


def _distance_rows(given: _Points, model: Model, x: Array, priors: Priors, want: bool) -> tuple[Array, Array]:
    """Normal distances by their sigmas, then priors: their derivatives are those of the conditions at the feet."""
    conditions, centre = model.conditions(x)
    residual, foot = weighted_distances(conditions, given.points - centre, given.sigma)
    scale = np.where(model.is_length, given.size, 1.0)
    shift = _shift(given, model)
    at = [model.names.index(name) for name in priors]
    values = model.values(x) * scale + shift
    residual = np.append(residual, [(values[k] - v) / s for k, (v, s) in zip(at, priors.values(), strict=True)])
    if not want:
        return residual, np.zeros((0, len(x)))
    _, by_unknown, slope = model.derivatives(x, foot + centre)
    design = distance_rows(by_unknown, slope, given.sigma)
    extra = np.zeros((len(at), len(x)))
    extra[np.arange(len(at)), at] = [scale[k] / s for k, (_, s) in zip(at, priors.values(), strict=True)]
    return residual, np.vstack([design, extra])


def _shift(given: _Points, model: Model) -> Array:
    """What the unknowns gain when the origin moves back: that of the points for the centre (u,)."""
    names = ("x0", "y0", "z0")
    return np.array([given.offset[names.index(name)] if name in names else 0.0 for name in model.names])


def _require_determined(given: _Points, model: Model, x: Array, priors: Priors) -> Determination:
    """Judge the weighted normal distances; see the module docstring.

    Raises
    ------
    InputError
        Names the parameters and the direction that the points leave open.
    NoSolutionError
        Normal distances have no derivatives there.
    """
    _, design = finite_rows(_geometric(given, model, priors), model.kind)(x, True)
    tangent = _tangent(model, x)
    found = determination(design @ tangent)
    if found.cofactors is not None:
        sd = np.sqrt(np.einsum("ij,jk,ik->i", tangent, found.cofactors, tangent))
        open_ = (sd > UNDETERMINED * given.typical_sigma) & ~np.isin(model.names, list(priors))
        if not open_.any():
            return found
    raise _open(given, model, tangent @ found.weakest, found.condition)


def _open(given: _Points, model: Model, direction: Array, condition: float) -> FgOrientError:
    """Refusal that names the parameters of a direction."""
    return InputError.of(
        "closerange.undetermined", place=model.kind, value=f"condition {condition:.2g}", limit=UNDETERMINED,
        **_words(model.names, direction * np.where(model.is_length, given.size, 1.0)),
    )  # fmt: skip


def _geometric(given: _Points, model: Model, priors: Priors) -> Rows:
    """Rows of weighted distances and priors."""
    return lambda x, want: _distance_rows(given, model, x, priors, want)


def _semi_axes(model: Model, priors: Priors) -> list[int]:
    """Unknowns that are semi-axes without a prior, that of revolution first: whatever else is open moves them."""
    return [k for k, name in enumerate(model.names) if name in SEMI_AXES and name not in priors][::-1]


def _least(given: _Points, model: Model, state: Array, priors: Priors) -> tuple[Array, float] | None:
    """Least weighted squares of the distances, from the result of either method."""
    try:
        found = adjust(_geometric(given, model, priors), state, model.kind)
    except NoSolutionError:
        return None
    return found.state, float(found.residual @ found.residual)


def _begun(given: _Points, model: Model, k: int, priors: Priors) -> tuple[Array, float] | None:
    """Fit with a semi-axis held at its start."""
    found = held(_geometric(given, model, priors), model.start, k, float(model.start[k]))
    return None if found is None else (found.state, found.squares)


def _require_steep(
    given: _Points, model: Model, base: tuple[Array, float] | None, k: int, priors: Priors
) -> None:  # fmt: skip
    """Hold a semi-axis at quite other values: a fit that gets hardly worse leaves it open.

    Raises
    ------
    InputError
        Names the parameters and the direction, those where the way begins; or the semi-axis of which it cannot be
        told, since neither a fit there converges nor its squares stay far above.
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


def _unverified(given: _Points, model: Model, k: int, value: float) -> FgOrientError:
    """Refusal where nobody can tell whether a semi-axis is determined."""
    return InputError.of("closerange.unverified", place=model.kind, name=model.names[k],
                         value=f"{model.names[k]} held at {value * given.size:.4g} m")  # fmt: skip


def _tangent(model: Model, x: Array) -> Array:
    """Directions (u, f) in which the unknowns may move: all, but for quadrics only those that change ratios."""
    if model.kind != "quadric":
        return np.eye(len(x))
    return np.asarray(np.linalg.svd(x[None])[2][1:].T)


def _words(names: tuple[str, ...], direction: Array) -> dict[str, str]:
    """Parameters of a direction, largest first, and the direction with the first one as unit."""
    order = np.argsort(-np.abs(direction), kind="stable")
    order = order[np.abs(direction[order]) >= NAMED * np.abs(direction[order[0]])]
    first = names[order[0]]
    ratios = [f"d{names[k]} = {direction[k] / direction[order[0]]:+.2f} d{first}" for k in order[1:]]
    parts = [names[k] for k in order]
    which = f"{', '.join(parts[:-1])} and {parts[-1]} are inseparable" if len(parts) > 1 else f"{first} is open"
    return {"names": which, "direction": ", ".join(ratios) or f"d{first} alone"}


def _result(given: _Points, model: Model, found: Adjusted, method: str, priors: Priors) -> SurfaceFit:
    model, state = model.settled(found.state)
    judged, tangent = _require_determined(given, model, state, priors), _tangent(model, state)
    least = _least(given, model, state, priors)
    for k in _semi_axes(model, priors):
        _require_steep(given, model, least, k, priors)
    own = judged
    if method == "algebraic":
        own = determination(model.derivatives(state, given.points)[1] @ tangent)
    if own.cofactors is None:  # the same unknowns as the normal distances, which determine them
        raise NoSolutionError.of("closerange.not_converged", place=model.kind, reason="the conditions are singular")
    scale = np.where(model.is_length, given.size, 1.0)
    away = scale[:, None] * tangent
    residual = found.residual[: len(found.residual) - (model.kind == "quadric")]
    redundancy = len(residual) - tangent.shape[1]
    unit = model.surface(state)
    surface = Surface(
        unit.kind, unit.centre * given.size + given.offset, unit.semi_axes * given.size, unit.rotation,
        unit.coefficients,
    )  # fmt: skip
    points = given.points * given.size + given.offset
    foot = surface.feet(points, given.sigma)
    return SurfaceFit(
        surface, method, model.names, model.values(state) * scale + _shift(given, model),
        away @ own.cofactors @ away.T, unit_weight(float(residual @ residual), redundancy), redundancy,
        judged.condition, foot - points if method == "geometric" else surface.deviations(points),
        surface.distances(points), len(found.log),
    )  # fmt: skip
