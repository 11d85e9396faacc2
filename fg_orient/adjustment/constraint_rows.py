"""Rows of constraints between ground points or images, and the figures through points.

The misclosure c(p, f) of a figure depends on its points p and on its parameters f, which no other observation has.
They are eliminated: f minimises ``|w c + k|^2``, and the rows of the adjustment are ``N^T (w c + k)`` with
``N^T dc/df = 0`` (Golub and Pereyra 1973; Jacobian by Kaufman 1975). w is the weight, k are correlates
(:mod:`fg_orient.adjustment.constraints`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from factors._contract import Argument, Equation
from factors.arrays import Array
from factors.conditions.circles import CIRCLE_RECORD
from factors.conditions.constraints import FACTOR, FIGURE
from factors.records import Record
from fg_orient.adjustment.constraint_kinds import RELATIONS, ROWS, Figure, figure_of
from fg_orient.adjustment.problem import Problem, State
from fg_orient.model.block import ExtraObservation
from fg_orient.model.constraint import OF_PHOTOS, SIZES, Constraint

#: Weight w of the misclosures, factor of the misclosure of a sphere that makes it metres, axes of the figure (3, 3) and
#: its frame at the start (normal or direction, two axes across). A relation's record and the correlates k follow.
HEAD: Final = Record(weight=1, scale=1, axes=9, frame=9)
#: Figures with a frame.
FRAMES: Final = {"plane": FIGURE, "line": FIGURE, "circle": CIRCLE_RECORD}
#: R of dependent rows of unit length.
DEPENDENT: Final = 1e-10
_NONE: Final = np.zeros((2, 0))
_FITTED: Final = 1e-14
_FITS: Final = 100


@dataclass(frozen=True, eq=False)
class Place:
    """Three numbers ``base + by @ x`` of the unknowns x (k,) of an image: projection centre, m, or rotation, rad."""

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
        """Whether it holds exactly."""
        return self.constraint.sigma is None

    def members(self, problem: Problem, state: State) -> list[Array]:
        """Coordinates, or rotation vectors, (3,) of the members at a state."""
        found = problem.extra_arguments(self)
        if not self.places:
            return [np.ascontiguousarray(state.ground[a.index]) if a.constant is None else a.constant for a in found]
        return [p.base + p.by @ problem.unknowns(state, a.index) for p, a in zip(self.places, found, strict=True)]


def constraint_observation(
    constraint: Constraint, places: tuple[Place, ...] = (), *, is_exact: bool = False
) -> ConstraintObservation:
    """Extra observation of a constraint between ground points or images; :func:`prepared` completes it.

    ``is_exact`` allows a figure that goes through any such points: it has no rows, but :func:`fitted_figures`.

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
        First row of each block; the others are zero.
    design : (r, f) array
        Derivatives by the figure; none (f = 0) for a relation.
    """

    value: Any
    blocks: list[Array]
    first: list[int]
    design: Array

    @cached_property
    def basis(self) -> Array:
        """N (r, r - f): rows without the figure."""
        r, f = self.design.shape
        return np.linalg.qr(self.design, mode="complete")[0][:, f:] if f else np.eye(r)


def whole_rows(constraint: Constraint, record: Any, points: Any, total: int) -> WholeRows:
    """Rows of a constraint. Points may be complex; the derivatives are those of their real parts."""
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
    """Rows of a figure at a state: each of a single point, beside its figure."""
    total = extra.n_residuals + SIZES[extra.constraint.kind][1]
    return whole_rows(extra.constraint, extra.record, extra.members(problem, state), total)


def _fitted(
    constraint: Constraint, head: Array, points: Any, correlates: Array
) -> tuple[Any, Array, Any, list[Array], Figure]:  # fmt: skip
    """Figure x (f,) that minimises ``|w c + k|^2``, its design (r, f), rows (r,), derivatives (m, 3) by each point."""
    whole = np.array(points)
    real = np.ascontiguousarray(np.real(whole))
    figure = figure_of(constraint, real)
    own, x = figure.record.copy(), figure.start
    own[FACTOR.factor] = head[HEAD.weight] * head[HEAD.scale]
    if constraint.kind in FRAMES and head[HEAD.frame].any():  # the correlates have the axes of the start
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
        Centres in the local system of the block, without its origin, along the axes of the figure: those of the local
        system, or East, North, Up at the points.
    points : tuple of int
        Numbers of its points.
    own : (k, k) array
        Cofactors if the points are known.
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
    """Figures of the constraints at a solution.

    With the joint cofactors C of its points a figure has the cofactors ``own + by C by^T``.
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
