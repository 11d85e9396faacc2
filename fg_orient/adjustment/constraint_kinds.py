"""Equations of constraints between points and photos, and start values of their figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from factors._contract import Equation
from factors.arrays import Array
from factors.conditions import circles, constraints, surfaces
from fg_orient.model.constraint import AXES, MEASURED, Constraint


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


def linear_round(plan: Array) -> tuple[Array, float]:
    """Linear fit of centre and radius: circle in a plane (Kasa 1976), or sphere (Ayhan 1996, eqs. 138-141)."""
    middle = plan.mean(axis=0)
    d = plan - middle
    x = np.linalg.lstsq(np.column_stack([2.0 * d, np.ones(len(d))]), np.sum(d**2, axis=1), rcond=None)[0]
    return middle + x[:-1], float(np.sqrt(x[-1] + np.sum(x[:-1] ** 2)))


def _circle(points: Array, _: Constraint) -> Figure:
    origin, frame = points.mean(axis=0), _axes(points, 2)
    centre, radius = linear_round((points - origin) @ frame[1:].T)
    start = np.concatenate([origin + centre @ frame[1:], [0.0, 0.0, radius]])
    record = circles.CIRCLE_RECORD.pack(factor=1.0, normal=frame[0], e_1=frame[1], e_2=frame[2])
    return Figure(circles.CIRCLE, record, ("x", "y", "z", "tilt_1", "tilt_2", "radius"), start, 2)


def _horizontal_circle(points: Array, _: Constraint) -> Figure:
    centre, radius = linear_round(points[:, :2])
    start = np.array([*centre, points[:, 2].mean(), radius])
    return Figure(circles.HORIZONTAL_CIRCLE, np.ones(1), ("x", "y", "z", "radius"), start, 2)


def sphere_figure(centre: Array, radius: float) -> Figure:
    """Sphere with centre (3,)."""
    return Figure(surfaces.SPHERE, np.ones(1), ("x", "y", "z", "radius"), np.append(centre, radius), 1, 0.5 / radius)


def _spheroid(points: Array, c: Constraint) -> Figure:
    centre, radius = linear_round(points)
    return spheroid_figure(centre, np.full(3, radius), AXES.index(c.axis))


def spheroid_figure(centre: Array, semi: Array, along: int) -> Figure:
    """Spheroid with centre (3,), semi-axes (3,) and number of its axis."""
    a, b = float(semi[(along + 1) % 3]), float(semi[along])
    record = surfaces.RECORD.pack(factor=1.0, centre=centre, rotation=np.eye(3).ravel(), semi_axes=semi)
    setup = np.array([[0.0, 1.0, 2.0, 9.0 + along, 6.0 + along], np.ones(5)])
    return Figure(surfaces.ELLIPSOID, record, ("x", "y", "z", "a", "b"), np.zeros(5), 1, 0.5 * min(a, b), setup,
                  np.array([*centre, a, b]))  # fmt: skip


#: Start of each figure from its points and the constraint.
FIGURES: Final[dict[str, Callable[[Array, Constraint], Figure]]] = {
    "plane": lambda points, _: _framed(constraints.PLANE, points, 2, "tilt_1 tilt_2 distance", 1),
    "line": lambda points, _: _framed(constraints.LINE, points, 0, "foot_1 foot_2 slope_1 slope_2", 2),
    "plumb line": lambda points, _: Figure(circles.PLUMB_LINE, np.ones(1), ("x", "y"), points.mean(axis=0)[:2], 2),
    "circle": _circle,
    "horizontal circle": _horizontal_circle,
    "sphere": lambda points, _: sphere_figure(*linear_round(points)),
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
