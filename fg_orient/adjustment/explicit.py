"""Explicit graph: it has a GTSAM factor for each image point, and a variable for each image and ground point.

One CustomFactor per image point links the image's coefficient vector to the ground point.
Control points and priors are GTSAM's own prior factors, with the weights of
``factors.conditions.control``. GTSAM linearises, eliminates (points first, then images:
the Schur complement as an ordering) and retracts; ``fg_orient.adjustment.loop`` drives
it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import gtsam
import numpy as np

from factors.arrays import Array
from factors.conditions.control import POINT
from factors.graph import factor, image_point_factors
from factors.split import Split
from fg_orient.adjustment.constraint_rows import ConstraintObservation, figure_rows
from fg_orient.adjustment.dense import extra_blocks
from fg_orient.adjustment.loop import Step, share_at_radius
from fg_orient.adjustment.native import NativeObservation
from fg_orient.adjustment.penalty import needs_rows
from fg_orient.adjustment.point_groups import vector_names, vector_parts
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import Robust, squares, weighted_problem, weights_at
from fg_orient.adjustment.rows import groups
from fg_orient.model.block import ExtraObservation
from fg_orient.model.constraint import SIZES


def image_key(k: int) -> int:
    """Return the GTSAM key of an image's coefficient vector."""
    return int(gtsam.symbol("e", k))


def point_key(j: int) -> int:
    """Return the GTSAM key of a ground point."""
    return int(gtsam.symbol("p", j))


def shared_key(g: int) -> int:
    """Return the GTSAM key of the unknowns that images share under the g-th id."""
    return int(gtsam.symbol("c", g))


def vector_keys(problem: Problem) -> list[tuple[int, slice]]:
    """Return the GTSAM vectors of the images that are not empty, with their parts of ``Problem.image_vector``."""
    m = problem.n_images
    return [(image_key(n) if n < m else shared_key(n - m), part) for n, part in vector_parts(problem)]


def key_names(problem: Problem) -> dict[int, str]:
    """Return the name "image:ID" or "shared:ID" of each of these keys."""
    names = vector_names(problem)
    return {key: names[n] for (key, _), (n, _) in zip(vector_keys(problem), vector_parts(problem), strict=True)}


def image_unknown(problem: Problem, k: int) -> int | Split | Array:
    """Return the factor argument of an image vector: a key, several keys for shared unknowns, or an empty vector."""
    ties, size = problem.ties, len(problem.parameters[k])
    if not size:
        return np.zeros(0)
    if ties is None:
        return image_key(k)
    wide, m, parts = problem.image_slice(k), problem.n_images, []
    of, vectors = ties.of[wide], ties.vectors(wide)
    for n in np.unique(vectors).tolist():
        columns, (start, stop) = np.flatnonzero(vectors == n), ties.part[n : n + 2].tolist()
        parts.append((image_key(n) if n < m else shared_key(n - m), columns, of[columns] - start, stop - start))
    if len(parts) == 1 and parts[0][3] == size:
        return parts[0][0]
    return Split(*(tuple(values) for values in zip(*parts, strict=True)))


def figure_key(n: int) -> int:
    """Return the GTSAM key for the change of a figure; the figure belongs to the n-th extra observation."""
    return int(gtsam.symbol("f", n))


def build_graph(problem: Problem) -> gtsam.NonlinearFactorGraph:
    """Return one factor per image point, control point and image prior."""
    graph = gtsam.NonlinearFactorGraph()
    _add_image_points(graph, problem)
    _add_priors(graph, problem)
    for extra in problem.block.extra:
        graph.add(extra_factor(extra, problem))
    return graph


def _add_image_points(graph: gtsam.NonlinearFactorGraph, problem: Problem) -> None:
    """Add one factor per image point, point by point: neighbours in the graph share a ground point.

    So values, records and linear factors of one point are adjacent in memory.
    """
    o, models = problem.observations, problem.models
    order = np.argsort(o.point, kind="stable")
    records = np.ascontiguousarray(problem.records[order])
    rows = order.tolist()
    makers: dict[int, Callable[[int, int, int], gtsam.CustomFactor]] = {}
    for images in groups(models):
        equation, parameters = models[images[0]].equation, models[images[0]].parameters
        if equation.fill is None:  # equations without this function get general factors below
            continue
        make = image_point_factors(
            equation, len(parameters), records, parameters.setup, lambda n: problem.label(rows[n])
        )
        makers |= dict.fromkeys(images, make)
    image_keys = [image_unknown(problem, i) for i in range(problem.n_images)]
    key, last = 0, -1
    for n, row in enumerate(rows):
        i, j = int(o.image[row]), int(o.point[row])
        if j != last:
            key, last = point_key(j), j
        own = image_keys[i]
        if problem.active[j] and isinstance(own, int) and i in makers:
            graph.add(makers[i](own, key, n))
        elif problem.active[j] or not isinstance(own, np.ndarray):
            point = key if problem.active[j] else np.ascontiguousarray(problem.start.ground[j])
            setup = models[i].parameters.setup
            graph.add(
                factor(
                    models[i].equation,
                    (own, point),
                    (setup.shape[1], 3),
                    records[n],
                    setup,
                    label=problem.label(row),
                )
            )


def extra_factor(extra: ExtraObservation, problem: Problem) -> gtsam.NonlinearFactor:
    """Return the factor of an extra observation.

    GTSAM's own factor is unchanged if all its variables are whole unknowns.
    """
    if isinstance(extra, NativeObservation) and problem.ties is None:
        if all(argument.constant is None for argument in problem.extra_arguments(extra)):
            return extra.factor
    unknowns: list[int | Array | Split] = []
    arguments = problem.extra_arguments(extra)
    for argument in arguments:
        if argument.constant is not None:
            unknowns.append(argument.constant)
        else:
            unknowns.append(image_unknown(problem, argument.index) if argument.is_image else point_key(argument.index))
    return factor(
        extra.equation,
        unknowns,
        [a.size for a in arguments],
        extra.record,
        problem.extra_setup(extra),
        label=extra.label,
        n_residuals=extra.n_residuals,
    )


def _add_priors(graph: gtsam.NonlinearFactorGraph, problem: Problem) -> None:
    for j in np.flatnonzero(problem.observed):
        noise = gtsam.noiseModel.Gaussian.SqrtInformation(problem.control_weights(int(j)))
        graph.addPriorPoint3(point_key(int(j)), problem.control_records[j, POINT.place], noise)
    add_image_priors(graph, problem)


def add_image_priors(graph: gtsam.NonlinearFactorGraph, problem: Problem) -> None:
    """Add a prior factor for each vector of image unknowns, if the options contain priors."""
    if problem.block.options.priors:
        for key, part in vector_keys(problem):
            k = part.stop - part.start
            graph.addPriorVector(key, np.zeros(k), gtsam.noiseModel.Unit.Create(k))


def add_figures(linear: gtsam.GaussianFactorGraph, problem: Problem, state: State, figures: Sequence[int]) -> None:
    """Add rows of figures, the n-th extra observations; each contains one point and the change of the figure.

    The minimum over this change gives the rows of the extra observation, which connect
    all points of the figure.
    """
    for n in figures:
        extra = problem.block.extra[n]
        assert isinstance(extra, ConstraintObservation)
        rows, key, done = figure_rows(extra, problem, state), figure_key(n), 0
        arguments = problem.extra_arguments(extra)
        for argument, block, first in zip(arguments, rows.blocks, rows.first, strict=True):
            part, done = slice(first, first + len(block)), first + len(block)
            unit, right = gtsam.noiseModel.Unit.Create(len(block)), -rows.value[part]
            if argument.constant is None:
                point = point_key(argument.index)
                linear.add(gtsam.JacobianFactor(key, rows.design[part], point, block, right, unit))
            else:
                linear.add(gtsam.JacobianFactor(key, rows.design[part], right, unit))
        if done < len(rows.value):  # observed parameters of the figure
            unit = gtsam.noiseModel.Unit.Create(len(rows.value) - done)
            linear.add(gtsam.JacobianFactor(key, rows.design[done:], -rows.value[done:], unit))


class ExplicitSystem:
    """One linearisation of the graph; see ``loop.System``."""

    def __init__(self, backend: ExplicitBackend, values: gtsam.Values) -> None:
        self._backend = backend
        graph, self._excess = backend.weighted(values)
        self.linear: gtsam.GaussianFactorGraph = graph.linearize(values)
        if backend.figures:
            add_figures(self.linear, backend.problem, backend.state(values), list(backend.figures))
        self.error = float(self.linear.error(backend.zero)) + self._excess

    @property
    def zero(self) -> gtsam.VectorValues:
        """Zero values of all unknowns."""
        return self._backend.zero

    @cached_property
    def _point_diagonals(self) -> dict[int, Array]:
        """Diagonal (3,) of the normal equations of each unknown ground point, by key."""
        _, column, value = self.linear.sparseJacobian_()
        diagonal: Array = np.bincount(np.asarray(column, np.intp) - 1, weights=np.asarray(value) ** 2).astype(
            np.float64, copy=False
        )
        sizes = {
            key: self.zero.at(key).size for key in sorted([*self._backend.ordering_keys, *self._backend.figure_keys])
        }
        ends = np.cumsum(list(sizes.values()))
        parts = zip(sizes, np.split(diagonal, ends)[: len(sizes)], strict=True)
        return {key: part for key, part in parts if gtsam.symbolChr(key) == ord("p")}

    def solve(self, damping: float) -> Step:
        """Eliminate points first, then images.

        Damped on the diagonal, see :meth:`ExplicitBackend.damping_factors`.
        """
        linear, damping = self.linear, max(damping, self._backend.problem.least_damping)
        if damping > 0.0:
            linear = gtsam.GaussianFactorGraph()
            linear.push_back(self.linear)
            linear.push_back(self._backend.damping_factors(damping, self._point_diagonals))
        if not self._backend.use_qr:
            try:
                # a sixth faster than by cliques, because each point would be a separate clique
                return self._step(linear.eliminateSequential(self._backend.ordering).optimize())
            except RuntimeError:  # GTSAM's Cholesky fails on well-posed but badly scaled systems; QR does not
                pass  # the next iteration tries Cholesky again, because an iteration must depend only on its input
        return self._step(linear.optimize(self._backend.ordering, gtsam.EliminateQR))

    def dogleg(self, radius: float) -> Step:
        """Return a blend of the steepest-descent and the Gauss-Newton step."""
        newton = self.solve(0.0)
        if newton.data.norm() <= radius:
            return newton
        steepest = self.linear.optimizeGradientSearch()
        length = steepest.norm()
        if length >= radius:
            return self._step(steepest.scale(radius / length))
        across = newton.data.subtract(steepest)
        share = share_at_radius(across.squaredNorm(), steepest.dot(across), length, radius)
        return self._step(steepest.add(across.scale(share)))

    def _step(self, delta: gtsam.VectorValues) -> Step:
        error, backend = self._excess + float(self.linear.error(delta)), self._backend
        if backend.figures:
            own, whole = gtsam.VectorValues(), delta
            for key in backend.ordering_keys:
                own.insert(key, whole.at(key))
            delta = own
        return Step(delta, float(np.abs(delta.vector()).max()), error)


class ExplicitBackend:
    """The problem as a GTSAM graph; ``fg_orient.adjustment.loop`` iterates on it.

    Parameters
    ----------
    problem : Problem
    robust : Robust, optional
        Losses; they may be replaced between linearisations.
    """

    name = "graph"

    def __init__(self, problem: Problem, robust: Robust | None = None) -> None:
        self.problem, self.robust = problem, robust
        # unknowns of each figure whose points are variables; the gradient of Dogleg does not support them
        found = [] if problem.block.options.optimizer == "dogleg" else list(enumerate(problem.block.extra))
        self.figures = {
            n: SIZES[e.constraint.kind][1]
            for n, e in found
            if isinstance(e, ConstraintObservation) and e.constraint.kind in SIZES
        }
        self.figure_keys = list(map(figure_key, self.figures))
        self.graph = self._built(problem)
        # without priors the normal equations may be too ill-conditioned for Cholesky; their rank was
        # tested before
        self.use_qr = not problem.block.options.priors or needs_rows(problem)
        self._points = [int(j) for j in np.flatnonzero(problem.active)]
        self.ordering = gtsam.Ordering()
        for j in self._points:
            self.ordering.push_back(point_key(j))
        self._vectors = vector_keys(problem)
        self.ordering_keys = [key for key, _ in self._vectors] + [point_key(j) for j in self._points]
        for key in (*(key for key, _ in self._vectors), *self.figure_keys):
            self.ordering.push_back(key)
        self.zero = gtsam.VectorValues()
        for key, part in self._vectors:
            self.zero.insert(key, np.zeros(part.stop - part.start))
        for j in self._points:
            self.zero.insert(point_key(j), np.zeros(3))
        for key, size in zip(self.figure_keys, self.figures.values(), strict=True):
            self.zero.insert(key, np.zeros(size))

    def _built(self, problem: Problem) -> gtsam.NonlinearFactorGraph:
        """Return the graph of a problem without its figures, whose rows are in the linear system."""
        extra = tuple(e for n, e in enumerate(problem.block.extra) if n not in self.figures)
        return build_graph(replace(problem, block=replace(problem.block, extra=extra)) if self.figures else problem)

    def weighted(self, values: gtsam.Values) -> tuple[gtsam.NonlinearFactorGraph, float]:
        """Return the graph with the weights of losses at these values, and an offset.

        The offset is the cost of the losses minus half the sum of squares of the graph.
        """
        if self.robust is None:
            return self.graph, 0.0
        weights, excess = weights_at(self.problem, self.state(values), self.robust)
        return self._built(weighted_problem(self.problem, weights)), excess

    def initial(self) -> gtsam.Values:
        """Return the start values."""
        return self.values(self.problem.start)

    def values(self, state: State) -> gtsam.Values:
        """Return the GTSAM values of a state."""
        values = gtsam.Values()
        vector = self.problem.image_vector(state)
        for key, part in self._vectors:
            values.insert(key, vector[part])
        for j in self._points:
            values.insertPoint3(point_key(j), state.ground[j])
        return values

    def state(self, values: gtsam.Values) -> State:
        """Return the arrays of GTSAM values."""
        image = np.concatenate([values.atVector(key) for key, _ in self._vectors])
        ground = self.problem.start.ground.copy()
        for j in self._points:
            ground[j] = values.atPoint3(point_key(j))
        return State(self.problem.image_matrix(image), ground)

    def linearise(self, state: gtsam.Values) -> ExplicitSystem:
        """Linearise at a state."""
        return ExplicitSystem(self, state)

    def error(self, state: gtsam.Values) -> float:
        """Return half the weighted sum of squares, or the cost under the losses."""
        graph, excess = self.weighted(state)
        own = [self.problem.block.extra[n] for n in self.figures]
        at = self.state(state) if own else None
        rows = (extra_blocks(self.problem, e, at, jacobian=False)[0] for e in own if at is not None)
        return float(graph.error(state)) + excess + 0.5 * sum(float(v @ v) for v in rows)

    def squares(self, state: gtsam.Values) -> tuple[Array, Array]:
        """See ``robust.RobustBackend``."""
        return squares(self.problem, self.state(state))

    def retract(self, state: gtsam.Values, step: Any) -> gtsam.Values:
        """Return the state after a step."""
        return state.retract(step.data)

    def damping_factors(self, damping: float, diagonal: dict[int, Array]) -> gtsam.GaussianFactorGraph:
        """Return rows that add ``damping`` to the diagonal of the images, and a part of it to the points."""
        graph = gtsam.GaussianFactorGraph()
        root, point = np.sqrt(damping), gtsam.noiseModel.Unit.Create(3)
        share = self.problem.point_damping(damping)
        for key, part in self._vectors:
            k = part.stop - part.start
            image = gtsam.noiseModel.Unit.Create(k)
            graph.add(gtsam.JacobianFactor(key, root * np.eye(k), np.zeros(k), image))
        for j in self._points:
            own = np.sqrt(share * diagonal[point_key(j)])
            graph.add(gtsam.JacobianFactor(point_key(j), np.diag(own), np.zeros(3), point))
        return graph
