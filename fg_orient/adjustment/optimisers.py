"""GTSAM's Gauss-Newton, Levenberg-Marquardt and Dogleg over the graph of images, one ``iterate()`` at a time; iSAM2.

Between two iterations a record is written, a checkpoint kept, and an interrupt can end
the run. GTSAM's own tests for the end compare costs; they are replaced by the rule of
:mod:`fg_orient.adjustment.loop` on the scaled step, which resolves the solution to
rounding. Levenberg-Marquardt and Dogleg reject steps whose decrease is below the rounding
of the cost, and try several before they give up. Therefore Gauss-Newton steps follow
their first short step. If Gauss-Newton increases the cost, the run continues with
Levenberg-Marquardt.

The whitened gradient of the last linearisation, ``sqrt(g^T S^-1 g)``, is the length of
the remaining Gauss-Newton step in units of the standard deviation of the solution. An end
with a longer remaining step than :data:`REMAINING` is not converged.

Under a loss the weights are held during an iteration and then follow the residuals
(iteratively reweighted least squares). The cost with held weights is never below the cost of the loss,
so if the first cost decreases, the second cost decreases, too.

iSAM2 (:class:`IncrementalGraph`): groups of ground points are added, replaced and removed
one by one. A :class:`LocalGroup` is a separate small adjustment problem: a few images,
and ground points with all their rays, eliminated inside the factor
(:mod:`fg_orient.adjustment.eliminated`). The cost of an update depends on the groups that
changed, and on the part of the tree above their images. There is a linearisation point
for each vector of unknowns. A vector is linearised again if its correction exceeds
:data:`RELINEARISE` prior sigmas; then the points of its groups are intersected again. An
update is repeated until no vector is linearised again.

Errors of the linear model are of second order in the corrections below the threshold. In
a strip of frame images (prior sigmas 5 mrad and 2 m) the solution after each update
differs from the batch solution by 8e-6 of its standard deviation for a threshold of 1e-3,
1e-5 for 2e-3, 1e-4 for 1e-2 and 5e-4 for 3e-2.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Protocol

import gtsam
import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.eliminated import Elimination
from fg_orient.adjustment.graph import GraphBackend, ImagesGraph, group_factor
from fg_orient.adjustment.loop import (
    ROUNDING_STEP,
    SHRINK,
    SMALL,
    STEP_TOLERANCE,
    Callback,
    Carried,
    Course,
    LoopResult,
    Step,
    exhausted,
    settled,
    small,
)
from fg_orient.adjustment.point_groups import vector_names
from fg_orient.adjustment.problem import Problem, State
from fg_orient.model.errors import InputError, finding

#: The run is not converged if the final whitened gradient exceeds this, in standard deviations of the solution.
REMAINING: Final = 1e-3
#: Value of the control for the Gauss-Newton steps that follow the damped steps.
FINAL: Final = 0.0
#: When a step of Levenberg-Marquardt or Dogleg is below this, in prior sigmas, Gauss-Newton steps follow.
SHORT: Final = 0.1
#: Relative increase of the cost above which it is more than rounding.
RISE: Final = 1e-9
#: Relative decrease of the cost below which it is rounding.
FLAT: Final = 1e-15
#: If a refused step changes the cost by less than this (relative), more damping is not tried: the step is short.
UNCHANGED: Final = 1e-12
#: First damping of Levenberg-Marquardt in prior sigmas, first radius of Dogleg.
DAMPING: Final = 1e-5
RADIUS: Final = 100.0


@dataclass(frozen=True)
class _Step(Step):
    """Step. A Gauss-Newton step has the whitened gradient before the step, a refused step its least size."""

    gradient: float = math.nan


class _Run:
    """Run of one of GTSAM's optimisers, with the values that it has reached.

    Each iteration has a new optimiser and a new graph
    (:mod:`fg_orient.adjustment.reduced_graph`). They continue with the damping or radius
    of the previous iteration.
    """

    def __init__(self, kind: str, backend: GraphBackend | ImagesGraph, values: gtsam.Values, control: float) -> None:
        self.kind, self._backend = kind, backend
        self.control = {"levenberg-marquardt": DAMPING, "dogleg": RADIUS}.get(kind, math.nan)
        self.control = self.control if math.isnan(control) or kind == "gauss-newton" else control
        self.values, self._free = values, backend.free(values)
        self.state = backend.state(values, self._free)
        self._begin()

    def _begin(self) -> None:
        """Make the graph and the optimiser of the next iteration."""
        self._linear = self._backend.linearised(self.values, self._free)
        # with less damping GTSAM may find a free datum singular, and each trial needs a factorisation
        least = DAMPING if self._backend.problem.least_damping > 0.0 else 0.0
        self._optimizer = native(self.kind, self._linear, self.control, least)
        self.error = float(self._optimizer.error())
        self._done = False

    def iterate(self) -> _Step:
        """Run one iteration."""
        if self._done:
            self._begin()
        backend, here, linear, optimizer, before = self._backend, self.state, self._linear, self._optimizer, self._free
        optimizer.iterate()
        self._done = True
        # a copy, because the optimiser's values are deleted with it
        self.values, self.error = linear.of_images(optimizer.values()), float(optimizer.error())
        if self.kind == "levenberg-marquardt":
            self.control = float(optimizer.lambda_())
        elif self.kind == "dogleg":
            self.control = float(optimizer.getDelta())
        self._free = backend.free(self.values)
        step = self._free - before
        if not step.any():
            linear.graph.error(linear.values)  # the last evaluation belonged to a refused step
        self.state = backend.state(self.values, self._free)
        moved = (self.state.image - here.image, self.state.ground - here.ground) if step.any() else ()
        length = max((float(np.nanmax(np.abs(by), initial=0.0)) for by in moved), default=0.0)
        predicted, along = linear.after(self.values, step)
        gradient = math.sqrt(max(-along, 0.0)) if step.any() else linear.steepest()
        return _Step(None, length, predicted, gradient=gradient)


class Linearisable(Protocol):
    """Graph, values and elimination order of an optimiser."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    ordering: gtsam.Ordering


def native(kind: str, at: Linearisable, control: float, least: float) -> Any:
    """Make one of GTSAM's optimisers whose own termination tests are never met.

    ``control`` is the first damping or radius, ``least`` the smallest damping of Levenberg-Marquardt.
    """
    makers: dict[str, tuple[Any, Any]] = {
        "gauss-newton": (gtsam.GaussNewtonParams, gtsam.GaussNewtonOptimizer),
        "levenberg-marquardt": (gtsam.LevenbergMarquardtParams, gtsam.LevenbergMarquardtOptimizer),
        "dogleg": (gtsam.DoglegParams, gtsam.DoglegOptimizer),
    }
    make_params, make = makers[kind]
    params = make_params()
    for set_tolerance in (params.setAbsoluteErrorTol, params.setRelativeErrorTol, params.setErrorTol):
        set_tolerance(0.0)
    params.setOrdering(at.ordering)
    if kind == "levenberg-marquardt":
        params.setRelativeErrorTol(UNCHANGED)
        params.setlambdaInitial(control)
        params.setlambdaLowerBound(least)
    elif kind == "dogleg":
        params.setDeltaInitial(control)
    return make(at.graph, at.values, params)


def _optimise(
    kind: str,
    backend: GraphBackend | ImagesGraph,
    start: State | Carried[State],
    max_iterations: int,
    callback: Callback | None = None,
    tolerance: float = STEP_TOLERANCE,
    *,
    shrink: float = SHRINK,
    keep: Callable[[Carried[State]], None] | None = None,
) -> LoopResult[State]:
    """Run GTSAM's optimiser ``kind``.

    Parameters as in :func:`fg_orient.adjustment.loop.gauss_newton`.
    """
    course = Course(start, callback, keep)
    carried = course.carried
    final = carried.control == FINAL  # true when a run continues after an interrupt here
    changed = kind == "gauss-newton" and not (math.isnan(carried.control) or final)
    # Levenberg-Marquardt follows if Gauss-Newton increases the cost
    damped = "levenberg-marquardt" if kind == "gauss-newton" else kind
    first = damped if changed else "gauss-newton" if final else kind
    is_free = backend.problem.least_damping > 0.0  # Gauss-Newton's equations are singular
    # at most once, and not under a loss, whose weights follow each step
    tried = is_free or backend.robust is not None
    run = _begin(first, backend, carried.state, carried.control)
    for _ in course.remaining(max_iterations):
        carried, before, here, control = course.carried, run.error, run.state, run.control
        step, newton = run.iterate(), run.kind == "gauss-newton"
        rises = not run.error <= before * (1.0 + RISE) + RISE
        course.assess(
            before, math.inf if rises else run.error, step, 0.0 if math.isnan(control) else control, always=not rises
        )
        if rises:
            if not newton or (final and tried):
                return course.end(here, before, False, finding("loop.no_step"))
            tried, changed = tried or final, changed or not final
            run, final = _begin(damped, backend, here, math.nan), False
            course.go_on(control=run.control, rejected=carried.rejected + 1)
            continue
        known = carried.previous < math.inf
        rate = min(step.length / carried.previous, 1.0) if known else 1.0  # factor by which steps and gradient decrease
        # with a free datum, Gauss-Newton steps are impossible, and the next damped step cannot decrease the cost
        flat = is_free and rate * step.length < ROUNDING_STEP and rate**2 * (before - run.error) <= FLAT * before
        if flat or (newton and settled(step.length, carried.previous, tolerance)):
            step = replace(step, length=rate * step.length, gradient=rate * step.gradient)
        if flat or step.length == 0.0 or small(step.length, carried.previous, tolerance, shrink):
            if newton or is_free:
                return _end(course, backend, run, step, changed=changed)
            run, final = _begin("gauss-newton", backend, run.state, math.nan), True
            course.go_on(state=run.state, control=FINAL, previous=math.inf, rejected=0)
            continue
        if not (newton or tried) and step.length < SHORT:
            run, final = _Run("gauss-newton", backend, run.values, math.nan), True
            course.go_on(state=run.state, control=FINAL, previous=step.length, rejected=0)
            continue
        course.go_on(state=run.state, control=FINAL if final else run.control, previous=step.length, rejected=0)
        if backend.robust is not None:
            run = _begin(run.kind, backend, run.state, run.control)
    return course.end(run.state, run.error, False, exhausted(max_iterations))


def _begin(kind: str, backend: GraphBackend | ImagesGraph, state: State, control: float) -> _Run:
    """Start an optimiser at a state, with the weights of the loss there."""
    values = backend.values(state)
    backend.elimination.hold_weights(backend.robust, state)
    return _Run(kind, backend, values, control)


def _end(
    course: Course[State], backend: GraphBackend | ImagesGraph, run: _Run, step: _Step, *, changed: bool
) -> LoopResult[State]:
    """End the run after a small step; the gradient decides whether it is the solution."""
    if step.length < ROUNDING_STEP and step.gradient <= REMAINING:
        converged, end = True, finding("loop.small_step_damped") if changed else SMALL
    else:
        converged, end = False, finding("loop.gradient_left", step=step.length, gradient=step.gradient)
    return course.end(backend.state(run.values, complete=True), run.error, converged, end)


#: GTSAM's optimisers by name, with the same arguments as in ``loop.OPTIMIZERS``.
GTSAM_OPTIMIZERS: Final = {
    kind: functools.partial(_optimise, kind) for kind in ("gauss-newton", "levenberg-marquardt", "dogleg")
}


#: A vector of unknowns is linearised again if its correction exceeds this, in prior sigmas.
RELINEARISE: Final = 2e-3
#: iSAM2's back-substitution ends where corrections change by less than this, in prior sigmas.
WILDFIRE: Final = 1e-9
#: Maximum number of repetitions of an update; then the solution is reported as not found.
MAX_REPEATS: Final = 30


@dataclass(eq=False)
class LocalGroup:
    """Ground points with all their rays, eliminated, as factors between vectors of images.

    Parameters
    ----------
    problem : Problem
        Problem whose images see the points.
    points : tuple of int
        Numbers of the points in the whole block.
    """

    problem: Problem
    points: tuple[int, ...]
    elimination: Elimination = field(init=False)
    #: Name of each vector, and its part of the free unknowns.
    vectors: tuple[tuple[str, slice], ...] = field(init=False)
    #: Positions of the factors in iSAM2.
    slots: list[int] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.elimination = Elimination(self.problem, threads=1)
        names = vector_names(self.problem)
        self.vectors = tuple((names[n], part) for n, part in self.elimination.parts.items())

    def sizes(self) -> dict[str, int]:
        """Return the length of each vector."""
        return {name: part.stop - part.start for name, part in self.vectors}

    def _free(self, unknowns: Mapping[str, Array]) -> Array:
        return np.concatenate([unknowns[name] for name, _ in self.vectors])

    def evaluate(self, unknowns: Mapping[str, Array]) -> None:
        """Intersect the points at vectors of images.

        Raises
        ------
        NoSolutionError
            Rays of a point do not intersect.
        """
        free = self._free(unknowns)
        for g, group in enumerate(self.elimination.groups):
            self.elimination.rows(g, free[group.free], lambda: free, accepted=True)
        self.elimination.require_possible()

    def normal(self, unknowns: Mapping[str, Array]) -> Array:
        """Return the reduced normal matrix (n, n) of all vectors of the group."""
        self.evaluate(unknowns)
        out = np.zeros((self.vectors[-1][1].stop,) * 2)
        for group, rows in zip(self.elimination.groups, self.elimination.last_rows(), strict=True):
            out[np.ix_(group.free, group.free)] += rows.jacobian.T @ rows.jacobian
        return out

    def state(self, unknowns: Mapping[str, Array]) -> State:
        """Return the state of the group at vectors of images."""
        self.evaluate(unknowns)
        return self.elimination.state(self._free(unknowns), complete=True)

    def factors(self, key: Callable[[str], int]) -> list[gtsam.CustomFactor]:
        """Return the factors of the points.

        They contain no reference to this object; otherwise the graph would never be released from memory.
        """
        elimination = self.elimination
        keys = {n: key(name) for n, (name, _) in zip(elimination.parts, self.vectors, strict=True)}
        images = ", ".join(image.id for image in self.problem.block.images[:3])
        return [group_factor(elimination, g, keys, f"group of {images}") for g in range(len(elimination.groups))]


class IncrementalGraph:
    """iSAM2 over groups of ground points.

    Parameters
    ----------
    priors : bool
        True if each vector of unknowns has a prior of unit weight.
    """

    def __init__(self, priors: bool) -> None:
        self._priors = priors
        self._isam = gtsam.ISAM2(_parameters(priors))
        self._keys: dict[str, int] = {}
        self._n_keys = 0
        self._prior_slots: dict[str, int] = {}
        #: Vectors of unknowns by name, in prior sigmas.
        self.unknowns: dict[str, Array] = {}
        #: True if an update did not end: the object can no longer be used.
        self.broken = False

    def _key(self, name: str) -> int:
        if name not in self._keys:
            self._keys[name], self._n_keys = int(gtsam.symbol("e", self._n_keys)), self._n_keys + 1
        return self._keys[name]

    def start(self, groups: Sequence[LocalGroup]) -> dict[str, Array]:
        """Return the vectors of groups, estimated or zero, at which the points of the groups are intersected.

        Raises
        ------
        InputError
            A shared id has different unknowns in different images.
        NoSolutionError
            Rays of a point do not intersect.
        """
        out: dict[str, Array] = {}
        for name, size in (pair for group in groups for pair in group.sizes().items()):
            out.setdefault(name, self.unknowns.get(name, np.zeros(size)))
            if len(out[name]) != size:
                raise InputError.of(
                    "incremental.shared (failure): images that share unknowns under an id must share the same unknowns"
                    " -> give each camera its own id",
                    place=name,
                    value=f"{size} and {len(out[name])} unknowns",
                )
        for group in groups:
            group.evaluate(out)
        return out

    def update(
        self, gone: Sequence[LocalGroup], new: Sequence[LocalGroup], start: Mapping[str, Array], kept: Iterable[str]
    ) -> None:
        """Replace groups.

        Parameters
        ----------
        gone, new : sequences of LocalGroup
        start : mapping
            Vectors of the new groups, from :meth:`start`.
        kept : iterable of str
            Names of the vectors that remain unknowns.

        Raises
        ------
        RuntimeError
            The equations are singular, or the solution is not found; this object can no longer be used.
        """
        self.broken = True
        graph, values, owners = gtsam.NonlinearFactorGraph(), gtsam.Values(), []
        remove = [slot for group in gone for slot in group.slots]
        for group in new:
            factors = group.factors(self._key)
            owners += [group] * len(factors)
            for factor in factors:
                graph.add(factor)
            group.slots.clear()
        fresh = [name for name in start if name not in self.unknowns]
        for name in fresh:
            values.insert(self._key(name), start[name])
            if self._priors:
                noise = gtsam.noiseModel.Unit.Create(len(start[name]))
                graph.addPriorVector(self._key(name), np.zeros(len(start[name])), noise)
        lost = set(self.unknowns) - set(kept)
        remove += [self._prior_slots.pop(name) for name in sorted(lost) if name in self._prior_slots]
        slots = list(self._isam.update(graph, values, remove).getNewFactorsIndices())
        for group, slot in zip(owners, slots, strict=False):
            group.slots.append(slot)
        self._prior_slots |= dict(zip(fresh, slots[len(owners) :], strict=False))
        for name in lost:
            del self.unknowns[name], self._keys[name]
        self.unknowns |= {name: start[name] for name in fresh}
        self._settle()
        self.broken = False

    def _settle(self) -> None:
        """Repeat the update until no vector is linearised again."""
        for _ in range(MAX_REPEATS):
            if not self._isam.update().getVariablesRelinearized():
                break
        else:
            raise RuntimeError(f"the solution still moves after {MAX_REPEATS} updates")
        values = self._isam.calculateEstimate()
        self.unknowns = {name: np.array(values.atVector(self._key(name))) for name in self.unknowns}


def _parameters(priors: bool) -> gtsam.ISAM2Params:
    method = gtsam.ISAM2GaussNewtonParams()
    method.setWildfireThreshold(WILDFIRE)
    out = gtsam.ISAM2Params()
    out.setOptimizationParams(method)
    out.setRelinearizeThreshold(RELINEARISE)
    out.relinearizeSkip = 1
    out.findUnusedFactorSlots = True
    out.setFactorization("CHOLESKY" if priors else "QR")  # QR of the rows does not square their condition number
    return out
