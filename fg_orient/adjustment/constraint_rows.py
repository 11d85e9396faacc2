"""Equations and rows of constraints between ground points or images, and start values of figures through points.

The misclosure c(p, f) of a figure depends on its points p and on its parameters f. No
other observation depends on f. Therefore f is eliminated: it minimises ``|w c + k|^2``,
and the rows of the adjustment are ``N^T (w c + k)`` with ``N^T dc/df = 0`` (Golub and
Pereyra 1973; Jacobian by Kaufman 1975). w is the weight, k are correlates
(:mod:`fg_orient.adjustment.constraints`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np

from factors._contract import Argument, Equation
from factors.arrays import Array
from factors.conditions import circles, constraints, surfaces
from factors.conditions.circles import CIRCLE_RECORD
from factors.conditions.constraints import FACTOR, FIGURE
from factors.records import Record
from fg_orient.adjustment.problem import Problem, State
from fg_orient.model.block import ExtraObservation
from fg_orient.model.constraint import AXES, MEASURED, OF_PHOTOS, SIZES, Constraint


@dataclass(frozen=True)
class Figure:
    """Start values ``start`` (k,) of the unknowns of a figure. Its parameters are ``offset`` (k,) plus the unknowns.

    The unknowns of a spheroid are corrections to the ``offset`` in its record. ``record``
    (d,) has s = 1; ``scale`` is the factor of s for residuals in metres.
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
    """Return a right-handed frame (3, 3) of points.

    Its first axis is the direction of the largest (0) or smallest (2) extent; the other two axes are across it.
    """
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=True)
    out = np.array([axes[along], axes[(along + 1) % 3], axes[(along + 2) % 3]])
    out[2] *= np.sign(np.linalg.det(out))
    return out


def _framed(equation: Equation, points: Array, along: int, names: str, n_residuals: int) -> Figure:
    """Return a plane or line; its record has origin and frame. ``along``: see :func:`_axes`."""
    frame, labels = _axes(points, along), tuple(names.split())
    record = constraints.FIGURE.pack(factor=1.0, place=points.mean(axis=0), normal=frame[0], e_1=frame[1], e_2=frame[2])
    return Figure(equation, record, labels, np.zeros(len(labels)), n_residuals)


def linear_round(plan: Array) -> tuple[Array, float]:
    """Fit centre and radius linearly: circle in a plane (Kasa 1976), or sphere (Ayhan 1996, eqs. 138-141)."""
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
    """Return the sphere with centre (3,)."""
    return Figure(surfaces.SPHERE, np.ones(1), ("x", "y", "z", "radius"), np.append(centre, radius), 1, 0.5 / radius)


def _spheroid(points: Array, c: Constraint) -> Figure:
    centre, radius = linear_round(points)
    return spheroid_figure(centre, np.full(3, radius), AXES.index(c.axis))


def spheroid_figure(centre: Array, semi: Array, along: int) -> Figure:
    """Return the spheroid with centre (3,), semi-axes (3,) and number of its axis."""
    a, b = float(semi[(along + 1) % 3]), float(semi[along])
    record = surfaces.RECORD.pack(factor=1.0, centre=centre, rotation=np.eye(3).ravel(), semi_axes=semi)
    setup = np.array([[0.0, 1.0, 2.0, 9.0 + along, 6.0 + along], np.ones(5)])
    return Figure(surfaces.ELLIPSOID, record, ("x", "y", "z", "a", "b"), np.zeros(5), 1, 0.5 * min(a, b), setup,
                  np.array([*centre, a, b]))  # fmt: skip


#: Functions that compute the start of each figure from its points and the constraint.
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
#: Number of residuals of these equations, if there is more than one.
ROWS: Final = {"parallel": 2, "equal attitude": 3}


def relation_record(constraint: Constraint, start: Array) -> Array:
    """Return the record (factor 1) of a constraint without a figure.

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
    """Return the start of a figure from its points (n, 3).

    Raise InputError if they do not determine it.
    """
    try:
        with np.errstate(all="raise"):
            return FIGURES[constraint.kind](points, constraint)
    except (FloatingPointError, np.linalg.LinAlgError):
        raise constraint.fault("members", "coordinates", "points that determine the figure") from None


#: Beginning of the record of a constraint: weight of the misclosures; factor that converts the misclosure of a sphere
#: to metres; coordinate axes (3, 3); normal or direction of the figure at the start, and two axes perpendicular to it.
#: Behind it are the constants of the relation and the correlates.
HEAD: Final = Record(weight=1, scale=1, axes=9, frame=9)
#: Figures with a frame.
FRAMES: Final = {"plane": FIGURE, "line": FIGURE, "circle": CIRCLE_RECORD}
#: Rows of unit length are dependent if a diagonal element of their matrix R is below this value.
DEPENDENT: Final = 1e-10
_NONE: Final = np.zeros((2, 0))
_FITTED: Final = 1e-14
_FITS: Final = 100


@dataclass(frozen=True, eq=False)
class Place:
    """Projection centre, m, or rotation, rad, of an image: ``base + by @ x`` with the image unknowns x (k,)."""

    base: Array
    by: Array


@dataclass(frozen=True, eq=False)
class ConstraintObservation(ExtraObservation):
    """Extra observation of a constraint; ``places`` of its images, none for points."""

    constraint: Constraint
    final_weight: float = 0.0
    places: tuple[Place, ...] = ()

    @property
    def hard(self) -> bool:
        """True if the constraint must be met exactly."""
        return self.constraint.sigma is None

    def members(self, problem: Problem, state: State) -> list[Array]:
        """Return the coordinates, or rotation vectors, (3,) of the members at a state."""
        found = problem.extra_arguments(self)
        if not self.places:
            return [np.ascontiguousarray(state.ground[a.index]) if a.constant is None else a.constant for a in found]
        return [p.base + p.by @ problem.unknowns(state, a.index) for p, a in zip(self.places, found, strict=True)]


def constraint_observation(
    constraint: Constraint, places: tuple[Place, ...] = (), *, is_exact: bool = False
) -> ConstraintObservation:
    """Return the extra observation of a constraint between ground points or images; :func:`prepared` completes it.

    ``is_exact`` allows a figure that goes exactly through its points: it has no rows, but
    it is in :func:`fitted_figures`.

    InputError: a figure through too few points.
    """
    total, free = ROWS.get(constraint.kind, 1), 0
    constraint.require_surplus(0 if is_exact else 1)
    if constraint.kind in SIZES:
        free = SIZES[constraint.kind][1]
        total = constraint.surplus + free
    kind, unit = ("image", "prior sigma") if constraint.kind in OF_PHOTOS else ("point", "m")
    argument = tuple(Argument(f"{kind} {name}", unit, is_point=kind == "point") for name in constraint.members)

    def at(unknowns: Any) -> Any:
        return [p.base + p.by @ x for p, x in zip(places, unknowns, strict=True)] if places else unknowns

    def residual(record: Any, _setup: Any, *unknowns: Any) -> Any:
        rows = whole_rows(constraint, record, at(unknowns), total)
        return rows.basis.T @ rows.value

    def kernel(record: Array, setup: Array, *unknowns_and_want: Any) -> tuple[Array, ...]:
        *unknowns, want = unknowns_and_want
        rows = whole_rows(constraint, record, at(unknowns), total)
        value, across = rows.basis.T @ rows.value, rows.basis.T
        if not want:
            return value, *(np.empty((0, 0)) for _ in rows.blocks)
        blocks = [
            across[:, first : first + len(block)] @ block for first, block in zip(rows.first, rows.blocks, strict=True)
        ]
        return value, *((b @ p.by for b, p in zip(blocks, places, strict=True)) if places else blocks)

    equation = Equation(f"constraint {constraint.kind}", kernel, residual, argument, "see this module")
    names, record = tuple(f"{kind}:{name}" for name in constraint.members), np.zeros(HEAD.size + total)
    return ConstraintObservation(
        equation, names, record, np.zeros((2, 0)), total - free, constraint.label, constraint, places=places
    )


@dataclass(frozen=True, eq=False)
class WholeRows:
    """Rows of a constraint before its figure is eliminated.

    Parameters
    ----------
    value : (r,) array
        ``w c + k``.
    blocks : list of (m, 3) array
        Derivatives by each point.
    first : list of int
        First row of each block; other rows are zero.
    design : (r, f) array
        Derivatives by the figure; no columns (f = 0) for a relation.
    """

    value: Any
    blocks: list[Array]
    first: list[int]
    design: Array

    @cached_property
    def basis(self) -> Array:
        """Return N (r, r - f): the combinations of rows that do not depend on the figure."""
        r, f = self.design.shape
        return np.linalg.qr(self.design, mode="complete")[0][:, f:] if f else np.eye(r)


def whole_rows(constraint: Constraint, record: Any, points: Any, total: int) -> WholeRows:
    """Return the rows of a constraint.

    Points may be complex; the derivatives belong to their real parts.
    """
    head, own = record[: HEAD.size], record[HEAD.size : len(record) - total].copy()
    correlates, real = record[len(record) - total :], [np.ascontiguousarray(np.real(p)) for p in points]
    if constraint.kind not in SIZES:
        equation = RELATIONS[constraint.kind]
        own[FACTOR.factor] *= head[HEAD.weight]
        own_blocks = equation.kernel(own, _NONE, *real, True)[1:]
        value = equation.residual(own, _NONE, *points) + correlates
        return WholeRows(value, list(own_blocks), [0] * len(own_blocks), np.zeros((total, 0)))
    axes = head[HEAD.axes].reshape(3, 3)
    _, design, value, blocks, _ = _fitted(constraint, head, [axes @ p for p in points], correlates)
    first = range(0, len(blocks) * len(blocks[0]), len(blocks[0]))
    return WholeRows(value, [block @ axes for block in blocks], list(first), design)


def figure_rows(extra: ConstraintObservation, problem: Problem, state: State) -> WholeRows:
    """Return the rows of a figure at a state; each row belongs to a single point and the figure."""
    total = extra.n_residuals + SIZES[extra.constraint.kind][1]
    return whole_rows(extra.constraint, extra.record, extra.members(problem, state), total)


def _fitted(
    constraint: Constraint, head: Array, points: Any, correlates: Array
) -> tuple[Any, Array, Any, list[Array], Figure]:
    """Find the figure x (f,) with least ``|w c + k|^2``, its design (r, f), rows (r,), derivatives (m, 3) by points."""
    whole = np.array(points)
    real = np.ascontiguousarray(np.real(whole))
    figure = figure_of(constraint, real)
    own, x = figure.record.copy(), figure.start
    own[FACTOR.factor] = head[HEAD.weight] * head[HEAD.scale]
    if constraint.kind in FRAMES and head[HEAD.frame].any():  # the correlates refer to the axes of the start
        record, (normal, first, _) = FRAMES[constraint.kind], head[HEAD.frame].reshape(3, 3)
        n = own[record.normal] * (1.0 if own[record.normal] @ normal > 0.0 else -1.0)
        across = first - (first @ n) * n
        across /= np.linalg.norm(across)
        own[record.normal], own[record.e_1], own[record.e_2] = n, across, np.cross(n, across)
    elements = [(figure.names.index(name), *pair) for name, pair in constraint.observed.items()]
    by_element = np.array([np.eye(len(x))[j] / s for j, _, s in elements]).reshape(-1, len(x))
    for _ in range(_FITS):
        rows = [figure.equation.kernel(own, figure.setup, np.ascontiguousarray(np.real(x)), p, True) for p in real]
        design = np.vstack([*(row[1] for row in rows), by_element])
        parts = [row[0] for row in rows]
        if np.iscomplexobj(whole):
            parts = [figure.equation.residual(own, figure.setup, x, p) for p in points]
        observed = [(x[j] + figure.offset[j] - value) / sigma for j, value, sigma in elements]
        value = np.concatenate([*parts, observed]) + correlates
        length = np.linalg.norm(design, axis=0)
        left, right = np.linalg.qr(design / length)
        if np.abs(np.diag(right)).min() < DEPENDENT:
            raise constraint.fault("members", "coordinates", "points that determine the figure")
        step = np.linalg.solve(right, left.T @ value) / length
        if (np.abs(step) <= _FITTED * (1.0 + np.abs(x))).all():
            break
        x = x - step
    return x, design, value, [row[2] for row in rows], figure


@dataclass(frozen=True, eq=False)
class FittedFigure:
    """Adjusted figure of a constraint.

    Parameters
    ----------
    label : str
    names : tuple of str
    values : (k,) array
        Parameters of the figure. Centres are in the local system of the block, without
        its origin. The axes belong to the figure: axes of the local system, or East, North, Up at the
        points.
    points : tuple of int
        Numbers of its points.
    own : (k, k) array
        Cofactors for known points.
    by : (k, 3 n) array
        Derivatives by the coordinates of the points.
    """

    label: str
    names: tuple[str, ...]
    values: Array
    points: tuple[int, ...]
    own: Array
    by: Array


def fitted_figures(problem: Problem, state: State) -> list[FittedFigure]:
    """Return the figures of the constraints at a solution.

    Let C be the joint cofactors of the points of a figure. The cofactors of the figure are then ``own +
    by C by^T``.
    """
    out = []
    for e in problem.block.extra:
        if not isinstance(e, ConstraintObservation) or e.constraint.kind not in SIZES:
            continue
        head, total = e.record[: HEAD.size], e.n_residuals + SIZES[e.constraint.kind][1]
        axes = head[HEAD.axes].reshape(3, 3)
        at = [axes @ p for p in e.members(problem, state)]
        x, design, _, blocks, figure = _fitted(e.constraint, head, at, e.record[-total:])
        left, right = np.linalg.qr(design)
        inverse = np.linalg.inv(right)
        m = figure.n_residuals
        by = -inverse @ np.hstack([left[k * m : k * m + m].T @ block @ axes for k, block in enumerate(blocks)])
        points = tuple(a.index for a in problem.extra_arguments(e))
        values = x + figure.offset[: len(x)]
        out.append(FittedFigure(e.label, figure.names, values, points, inverse @ inverse.T, by))
    return out
