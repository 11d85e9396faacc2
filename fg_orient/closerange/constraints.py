"""Constraints of a bundle: variables and observations of their figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.conditions import circles, constraints
from fg_orient.adjustment import constraint_kinds as kinds
from fg_orient.adjustment.constraint_kinds import AXES, MEASURED, Constraint, Figure, relation
from fg_orient.adjustment.network import Observation, Variable
from fg_orient.closerange.surface import Kind
from fg_orient.closerange.surface_fit import fit_surface
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

#: Figures that are fitted to their points before the adjustment, and refused if the points do not determine them.
FITTED_FIRST: Final = ("sphere", "spheroid")
_NONE: Final = np.zeros((2, 0))


def figure_of(constraint: Constraint, points: Array, sigma_m: Array | None = None) -> Figure:
    """Start of a figure from its points (n, 3), which must determine it.

    ``sigma_m`` (n, 1): sigmas of the points, for the test whether they determine a sphere or spheroid. By default their
    misfit replaces it, which is unreliable for five points on a sphere.
    """
    if constraint.kind not in FITTED_FIRST:
        return kinds.figure_of(constraint, points)
    kind: Kind = "sphere" if constraint.kind == "sphere" else "spheroid"
    priors = {{"radius": "a"}.get(name, name): pair for name, pair in constraint.observed.items()} or None
    surface = fit_surface(points, kind, axis=constraint.axis, priors=priors, sigma_m=sigma_m).surface
    if kind == "sphere":
        return kinds.sphere_figure(surface.centre, float(surface.semi_axes[0]))
    return kinds.spheroid_figure(surface.centre, surface.semi_axes, AXES.index(constraint.axis))


def require_one_value(constraints: Sequence[Constraint]) -> None:
    """Refuse different hard lengths between the same two points or photos.

    The adjustment refuses equal ones as dependent; lengths with a sigma are observations.
    """
    first: dict[tuple[str, frozenset[str]], Constraint] = {}
    for one in (c for c in constraints if c.kind in MEASURED and c.sigma is None):
        other = first.setdefault((one.kind, frozenset(one.members)), one)
        if other.value_m != one.value_m:
            names = "; ".join(f"{c.label}: {c.value_m:.10g} m" for c in (other, one))
            raise InputError.of("closerange.contradiction", place="constraints", names=names)


def figure_parts(
    constraint: Constraint, figure: Figure, k: int, points: Sequence[int | Array]
) -> tuple[Variable, list[Observation]]:
    """Variable of a figure, and observations of its points and parameters.

    Parameters
    ----------
    constraint : Constraint
    figure : Figure
    k : int
        Number of the variable.
    points : sequence of int or (3,) array
        Numbers of the variables of the points, or held coordinates.
    """
    hard = constraint.sigma is None
    record = figure.record.copy()
    record[constraints.FIGURE.factor] *= 1.0 / (constraint.sigma or 1.0) * figure.scale
    out = [
        Observation(
            figure.equation, (k, p), record, figure.setup, figure.n_residuals, f"{constraint.label}: {name}", hard
        )
        for p, name in zip(points, constraint.members, strict=True)
    ]
    for name, (value, sigma) in constraint.observed.items():
        j = figure.names.index(name)
        out.append(observed_element(k, j, value - figure.offset[j], sigma, f"{constraint.label}: observed {name}"))
    return Variable(constraint.label, figure.start, figure.names), out


def observed_element(k: int, element: int, value: float, sigma: float, label: str) -> Observation:
    """Observation of one element of variable number ``k``."""
    record = constraints.ELEMENT.pack(factor=1.0 / sigma, value=value, number=element)
    return Observation(constraints.OBSERVED_ELEMENT, (k,), record, _NONE, 1, label)


def plain_observation(constraint: Constraint, unknowns: Sequence[int | Array], start: Sequence[Array]) -> Observation:
    """Observation of a constraint without a figure; ``start``: coordinates of its points, rotations of its photos."""
    if constraint.kind == "equal attitude":
        first, second, between = start[0].ravel(), start[1].ravel(), constraint.offset.ravel()
        equation, n = circles.EQUAL_ATTITUDE, 3
        record = circles.ATTITUDE_RECORD.pack(factor=1.0, first=first, second=second, between=between)
    else:
        equation, n, record = relation(constraint, np.array(start))
    record[constraints.FACTOR.factor] /= constraint.sigma or 1.0
    return Observation(equation, tuple(unknowns), record, _NONE, n, constraint.label, constraint.sigma is None)
