"""Constraints of a bundle, and their figures and observations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation
from factors.conditions import circles, constraints, surfaces
from fg_orient.adjustment.network import Observation, Variable
from fg_orient.closerange.surface_fit import fit_surface
from fg_orient.formats.closerange import LARGEST, SMALLEST
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

#: Kinds with their smallest number of members; kinds between photos are last.
LEAST: Final = {
    "distance": 2, "parallel": 4, "plane": 3, "line": 2, "plumb line": 1, "circle": 3, "horizontal circle": 3,
    "sphere": 4, "spheroid": 5, "base": 2, "equal attitude": 2,
}  # fmt: skip
KINDS: Final = tuple(LEAST)
OF_PHOTOS: Final = ("base", "equal attitude")
#: Kinds that need a value, m, and those with a fixed number of members.
MEASURED: Final = ("distance", "base")
EXACT: Final = ("distance", "parallel", *OF_PHOTOS)
#: Figures that are fitted to their points before the adjustment, and refused if the points do not determine them.
FITTED_FIRST: Final = ("sphere", "spheroid")
AXES: Final = ("x", "y", "z")
_NONE: Final = np.zeros((2, 0))


@dataclass(frozen=True)
class Constraint:
    """Relation between points or photos.

    Parameters
    ----------
    kind : str
        One of ``KINDS``: "distance", "parallel" (two points on each of two lines), "plane", "line", "plumb line",
        "circle", "horizontal circle", "sphere", "spheroid"; of photos "base" and "equal attitude".
    members : tuple of str
        Points, or photos.
    value_m : float, optional
        Distance or base.
    sigma : float, optional
        m; rad for "parallel" and "equal attitude". None: a hard constraint, which holds exactly.
    observed : mapping
        Observed parameters of the figure, value and sigma, m: ``radius`` of circles and spheres, ``a`` (across the
        axis) and ``b`` of a spheroid.
    axis : str
        Of a spheroid: "x", "y" or "z".
    offset : (3, 3) array
        For "equal attitude": axes of the second camera from those of the first; default: equal.

    Raises
    ------
    InputError
        An impossible kind, number of members or value.
    """

    kind: str
    members: tuple[str, ...]
    value_m: float | None = None
    sigma: float | None = None
    observed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    axis: str = "y"
    offset: Array = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", tuple(self.members))
        if self.kind not in LEAST:
            raise self.fault("kind", self.kind, f"one of {', '.join(KINDS)}")
        n, least = len(self.members), LEAST[self.kind]
        if n < least or (self.kind in EXACT and n != least) or len(set(self.members)) != n:
            raise self.fault("members", n, f"{least}{'' if self.kind in EXACT else ' or more'} different ones")
        if (self.value_m is None) == (self.kind in MEASURED) or not (self.value_m is None or 0.0 < self.value_m < 1e9):
            raise self.fault("value_m", self.value_m, "a length above 0 for a distance or base, none for others")
        if self.sigma is not None and not SMALLEST <= self.sigma <= LARGEST:
            raise self.fault("sigma", self.sigma, "a number above 0, or none: the constraint is then hard")
        _, known = FIGURES.get(self.kind, (None, ()))
        for name, (value, sigma) in self.observed.items():
            if name not in known or not (0.0 < value <= LARGEST and SMALLEST <= sigma <= LARGEST):
                expected = f"value and sigma of {', '.join(known) or '-'}, above 0"
                raise self.fault(f"observed {name}", f"{value} +- {sigma}", expected)
        if self.axis not in AXES:
            raise self.fault("axis", self.axis, "x, y or z")
        turn = np.asarray(self.offset, float)
        if turn.shape != (3, 3) or np.abs(turn @ turn.T - np.eye(3)).max() > 1e-9 or np.linalg.det(turn) < 0.0:
            raise self.fault("offset", turn.tolist(), "a rotation matrix")

    @property
    def label(self) -> str:
        """Words for messages."""
        return f"{self.kind} of {', '.join(self.members)}"

    def fault(self, place: str, value: object, expected: str) -> InputError:
        """Error of the constraint."""
        text = f"{self.kind} of {', '.join(self.members[:6])}" if self.kind in LEAST else "constraint"
        text += ", ..." if len(self.members) > 6 else ""
        return InputError.of("closerange.constraint", place=f"{text}, {place}", value=value, expected=expected)  # type: ignore[return-value]


@dataclass(frozen=True)
class Figure:
    """Start of a figure: ``start`` (k,) of the unknowns; the parameters have the values ``offset`` (k,) plus unknowns.

    The unknowns of a spheroid are corrections to the ``offset`` in its record. ``record`` (d,) has s = 1; ``scale`` is
    the factor of s for residuals in metres.
    """

    equation: Equation
    record: Array
    names: tuple[str, ...]
    start: Array
    n_residuals: int
    scale: float = 1.0
    setup: Array = field(default_factory=lambda: np.zeros((2, 0)))
    offset: Array = field(default_factory=lambda: np.zeros(6))


#: Start of a figure from its points, the constraint and the sigmas of the points.
_Start = Callable[[Array, Constraint, Array | None], Figure]


def _axes(points: Array, along: int) -> Array:
    """Right-handed frame (3, 3) of points: direction of largest (0) or smallest (2) extent, then two across."""
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=True)
    out = np.array([axes[along], axes[(along + 1) % 3], axes[(along + 2) % 3]])
    out[2] *= np.sign(np.linalg.det(out))
    return out


def _framed(equation: Equation, points: Array, along: int, names: str, n_residuals: int) -> Figure:
    """Plane or line: the record has origin and frame; see :func:`_axes` for ``along``."""
    frame, labels = _axes(points, along), tuple(names.split())
    record = constraints.FIGURE.pack(factor=1.0, place=points.mean(axis=0), normal=frame[0], e_1=frame[1], e_2=frame[2])
    return Figure(equation, record, labels, np.zeros(len(labels)), n_residuals)


def _flat_circle(plan: Array) -> tuple[Array, float]:
    """Centre and radius of a circle in a plane (Kasa 1976)."""
    middle = plan.mean(axis=0)
    d = plan - middle
    x = np.linalg.lstsq(np.column_stack([2.0 * d, np.ones(len(d))]), np.sum(d**2, axis=1), rcond=None)[0]
    return middle + x[:2], float(np.sqrt(x[2] + x[0] ** 2 + x[1] ** 2))


def _circle(points: Array, _: Constraint, __: Array | None) -> Figure:
    origin, frame = points.mean(axis=0), _axes(points, 2)
    centre, radius = _flat_circle((points - origin) @ frame[1:].T)
    start = np.concatenate([origin + centre @ frame[1:], [0.0, 0.0, radius]])
    record = circles.CIRCLE_RECORD.pack(factor=1.0, normal=frame[0], e_1=frame[1], e_2=frame[2])
    return Figure(circles.CIRCLE, record, ("x", "y", "z", "tilt_1", "tilt_2", "radius"), start, 2)


def _horizontal_circle(points: Array, _: Constraint, __: Array | None) -> Figure:
    centre, radius = _flat_circle(points[:, :2])
    start = np.array([*centre, points[:, 2].mean(), radius])
    return Figure(circles.HORIZONTAL_CIRCLE, np.ones(1), ("x", "y", "z", "radius"), start, 2)


def _sphere(points: Array, c: Constraint, sigma: Array | None) -> Figure:
    priors = {"a": c.observed["radius"]} if "radius" in c.observed else None
    sphere = fit_surface(points, "sphere", priors=priors, sigma_m=sigma).surface
    radius = float(sphere.semi_axes[0])
    start = np.append(sphere.centre, radius)
    return Figure(surfaces.SPHERE, np.ones(1), ("x", "y", "z", "radius"), start, 1, 0.5 / radius)


def _spheroid(points: Array, c: Constraint, sigma: Array | None) -> Figure:
    start = fit_surface(points, "spheroid", axis=c.axis, priors=dict(c.observed), sigma_m=sigma).surface
    centre, semi = start.centre, start.semi_axes
    along = AXES.index(c.axis)
    a, b = float(semi[(along + 1) % 3]), float(semi[along])
    record = surfaces.RECORD.pack(factor=1.0, centre=centre, rotation=np.eye(3).ravel(), semi_axes=semi)
    setup = np.array([[0.0, 1.0, 2.0, 9.0 + along, 6.0 + along], np.ones(5)])
    return Figure(surfaces.ELLIPSOID, record, ("x", "y", "z", "a", "b"), np.zeros(5), 1, 0.5 * min(a, b), setup,
                  np.array([*centre, a, b]))  # fmt: skip


#: Start and observable parameters of each figure.
FIGURES: Final[dict[str, tuple[_Start, tuple[str, ...]]]] = {
    "plane": (lambda points, _, __: _framed(constraints.PLANE, points, 2, "tilt_1 tilt_2 distance", 1), ()),
    "line": (lambda points, _, __: _framed(constraints.LINE, points, 0, "foot_1 foot_2 slope_1 slope_2", 2), ()),
    "plumb line": (lambda points, _, __: Figure(circles.PLUMB_LINE, np.ones(1), ("x", "y"), points.mean(axis=0)[:2], 2),
                   ()),
    "circle": (_circle, ("radius",)),
    "horizontal circle": (_horizontal_circle, ("radius",)),
    "sphere": (_sphere, ("radius",)),
    "spheroid": (_spheroid, ("a", "b")),
}  # fmt: skip


def figure_of(constraint: Constraint, points: Array, sigma_m: Array | None = None) -> Figure:
    """Start of a figure from its points (n, 3), which must determine it.

    ``sigma_m`` (n, 1): sigmas of the points, for the test whether they determine a sphere or spheroid. By default their
    misfit replaces it, which is unreliable for five points on a sphere.
    """
    try:
        with np.errstate(all="raise"):
            return FIGURES[constraint.kind][0](points, constraint, sigma_m)
    except FloatingPointError:
        raise constraint.fault("members", "start coordinates", "points that determine the figure") from None


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
    s = 1.0 / (constraint.sigma or 1.0)
    if constraint.kind in MEASURED:
        equation, n, record = constraints.DISTANCE, 1, constraints.LENGTH.pack(factor=s, distance=constraint.value_m)
    elif constraint.kind == "parallel":
        along = start[1] - start[0]
        across = _axes(np.array([-along, along]), 0)[1:]
        equation, n = constraints.PARALLEL, 2
        record = constraints.DIRECTION.pack(factor=s, e_1=across[0], e_2=across[1])
    else:
        first, second, between = start[0].ravel(), start[1].ravel(), constraint.offset.ravel()
        equation, n = circles.EQUAL_ATTITUDE, 3
        record = circles.ATTITUDE_RECORD.pack(factor=s, first=first, second=second, between=between)
    return Observation(equation, tuple(unknowns), record, _NONE, n, constraint.label, constraint.sigma is None)
