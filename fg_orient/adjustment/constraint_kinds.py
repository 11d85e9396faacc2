"""Kinds of constraints between points and photos, and start values of their figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import Equation
from factors.conditions import circles, constraints, surfaces
from fg_orient.formats.closerange import LARGEST, SMALLEST
from fg_orient.model.errors import InputError

Array = npt.NDArray[np.float64]

#: Kinds with their smallest number of members; kinds between photos are last.
LEAST: Final = {
    "distance": 2, "parallel": 4, "perpendicular": 4, "equal": 4,
    "plane": 3, "line": 2, "plumb line": 1, "circle": 3, "horizontal circle": 3,
    "sphere": 4, "spheroid": 5, "base": 2, "equal attitude": 2,
}  # fmt: skip
KINDS: Final = tuple(LEAST)
OF_PHOTOS: Final = ("base", "equal attitude")
#: Kinds that need a value, m, and those with a fixed number of members.
MEASURED: Final = ("distance", "base")
EXACT: Final = ("distance", "parallel", "perpendicular", "equal", *OF_PHOTOS)
#: Observable parameters of figures.
OBSERVABLE: Final = {
    "circle": ("radius",), "horizontal circle": ("radius",), "sphere": ("radius",), "spheroid": ("a", "b"),
}  # fmt: skip
AXES: Final = ("x", "y", "z")


@dataclass(frozen=True)
class Constraint:
    """Relation between points or photos.

    Parameters
    ----------
    kind : str
        One of ``KINDS``: "distance", "parallel", "perpendicular" and "equal" (two points on each of two lines),
        "plane", "line", "plumb line", "circle", "horizontal circle", "sphere", "spheroid"; of photos "base" and
        "equal attitude".
    members : tuple of str
        Points, or photos.
    value_m : float, optional
        Distance or base.
    sigma : float, optional
        m; rad for "parallel", "perpendicular" and "equal attitude". None: a hard constraint, which holds exactly.
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
        known = OBSERVABLE.get(self.kind, ())
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


def _round(plan: Array) -> tuple[Array, float]:
    """Centre and radius of a circle in a plane (Kasa 1976), or of a sphere."""
    middle = plan.mean(axis=0)
    d = plan - middle
    x = np.linalg.lstsq(np.column_stack([2.0 * d, np.ones(len(d))]), np.sum(d**2, axis=1), rcond=None)[0]
    return middle + x[:-1], float(np.sqrt(x[-1] + np.sum(x[:-1] ** 2)))


def _circle(points: Array, _: Constraint) -> Figure:
    origin, frame = points.mean(axis=0), _axes(points, 2)
    centre, radius = _round((points - origin) @ frame[1:].T)
    start = np.concatenate([origin + centre @ frame[1:], [0.0, 0.0, radius]])
    record = circles.CIRCLE_RECORD.pack(factor=1.0, normal=frame[0], e_1=frame[1], e_2=frame[2])
    return Figure(circles.CIRCLE, record, ("x", "y", "z", "tilt_1", "tilt_2", "radius"), start, 2)


def _horizontal_circle(points: Array, _: Constraint) -> Figure:
    centre, radius = _round(points[:, :2])
    start = np.array([*centre, points[:, 2].mean(), radius])
    return Figure(circles.HORIZONTAL_CIRCLE, np.ones(1), ("x", "y", "z", "radius"), start, 2)


def sphere_figure(centre: Array, radius: float) -> Figure:
    """Sphere with centre (3,)."""
    return Figure(surfaces.SPHERE, np.ones(1), ("x", "y", "z", "radius"), np.append(centre, radius), 1, 0.5 / radius)


def _spheroid(points: Array, c: Constraint) -> Figure:
    centre, radius = _round(points)
    return spheroid_figure(centre, np.full(3, radius), AXES.index(c.axis))


def spheroid_figure(centre: Array, semi: Array, along: int) -> Figure:
    """Spheroid with centre (3,), semi-axes (3,) and number of its axis."""
    a, b = float(semi[(along + 1) % 3]), float(semi[along])
    record = surfaces.RECORD.pack(factor=1.0, centre=centre, rotation=np.eye(3).ravel(), semi_axes=semi)
    setup = np.array([[0.0, 1.0, 2.0, 9.0 + along, 6.0 + along], np.ones(5)])
    return Figure(surfaces.ELLIPSOID, record, ("x", "y", "z", "a", "b"), np.zeros(5), 1, 0.5 * min(a, b), setup,
                  np.array([*centre, a, b]))  # fmt: skip


#: Residuals of each point, and unknowns, of each figure.
SIZES: Final = {
    "plane": (1, 3), "line": (2, 4), "plumb line": (2, 2), "circle": (2, 6), "horizontal circle": (2, 4),
    "sphere": (1, 4), "spheroid": (1, 5),
}  # fmt: skip
#: Start of each figure from its points and the constraint.
FIGURES: Final[dict[str, Callable[[Array, Constraint], Figure]]] = {
    "plane": lambda points, _: _framed(constraints.PLANE, points, 2, "tilt_1 tilt_2 distance", 1),
    "line": lambda points, _: _framed(constraints.LINE, points, 0, "foot_1 foot_2 slope_1 slope_2", 2),
    "plumb line": lambda points, _: Figure(circles.PLUMB_LINE, np.ones(1), ("x", "y"), points.mean(axis=0)[:2], 2),
    "circle": _circle,
    "horizontal circle": _horizontal_circle,
    "sphere": lambda points, _: sphere_figure(*_round(points)),
    "spheroid": _spheroid,
}


#: Equations of constraints without a figure.
RELATIONS: Final = {
    "distance": constraints.DISTANCE, "base": constraints.DISTANCE, "parallel": constraints.PARALLEL,
    "perpendicular": constraints.PERPENDICULAR, "equal": constraints.EQUAL, "equal attitude": circles.EQUAL_ATTITUDE,
}  # fmt: skip
#: Their residuals where they are more than one.
ROWS: Final = {"parallel": 2, "equal attitude": 3}


def relation_record(constraint: Constraint, start: Array) -> Array:
    """Record (factor 1) of a constraint without a figure.

    ``start``: coordinates (n, 3) of its points; for "equal attitude" the rotations (2, 3, 3) of its photos.
    """
    if constraint.kind in MEASURED:
        return constraints.LENGTH.pack(factor=1.0, distance=constraint.value_m)
    if constraint.kind == "parallel":
        along = start[1] - start[0]
        across = _axes(np.array([-along, along]), 0)[1:]
        return constraints.DIRECTION.pack(factor=1.0, e_1=across[0], e_2=across[1])
    if constraint.kind == "equal attitude":
        first, second = start.reshape(2, 9)
        return circles.ATTITUDE_RECORD.pack(factor=1.0, first=first, second=second, between=constraint.offset.ravel())
    return np.ones(1)


def figure_of(constraint: Constraint, points: Array) -> Figure:
    """Start of a figure from its points (n, 3); InputError if they do not determine it."""
    try:
        with np.errstate(all="raise"):
            return FIGURES[constraint.kind](points, constraint)
    except (FloatingPointError, np.linalg.LinAlgError):
        raise constraint.fault("members", "coordinates", "points that determine the figure") from None
