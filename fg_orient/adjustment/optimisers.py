"""GTSAM's Gauss-Newton, Levenberg-Marquardt and Dogleg over the graph of images, one ``iterate()`` at a time.

Between two iterations a record is written, a checkpoint kept, and an interrupt can end the run. GTSAM's own tests for
the end compare costs; they are replaced by the rule of :mod:`fg_orient.adjustment.loop` on the scaled step, which
resolves the solution to rounding. Levenberg-Marquardt and Dogleg reject steps whose decrease is below the rounding of
the cost, and try several before they give up; Gauss-Newton steps follow their first short step. Gauss-Newton that
raises the cost continues as Levenberg-Marquardt.

The whitened gradient of the last linearisation, ``sqrt(g^T S^-1 g)``, is the length of the remaining Gauss-Newton step
in units of the standard deviation of the solution. An end with more than :data:`REMAINING` of it is not converged.

Under a loss the weights are held during an iteration and then follow the residuals (iteratively reweighted least
squares); the held cost is not below the cost of the loss, so that a decrease of the one is a decrease of the other.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import gtsam
import numpy as np

from fg_orient.adjustment.graph import GraphBackend
from fg_orient.adjustment.images_graph import ImagesGraph, ImagesReduced
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
from fg_orient.adjustment.problem import State
from fg_orient.adjustment.reduced_graph import ReducedGraph
from fg_orient.model.errors import finding

#: Whitened gradient at the end, in standard deviations of the solution, above which it is not converged.
REMAINING: Final = 1e-3
#: Control of the Gauss-Newton steps that follow the damped ones.
FINAL: Final = 0.0
#: Step of Levenberg-Marquardt or Dogleg, in prior sigmas, that Gauss-Newton steps follow.
SHORT: Final = 0.1
#: Relative increase of the cost that is more than rounding.
RISE: Final = 1e-9
#: Relative decrease of the cost that is rounding.
FLAT: Final = 1e-15
#: Relative change of the cost after a refused step up to which more damping is not tried: the step was short enough.
UNCHANGED: Final = 1e-12
#: First damping of Levenberg-Marquardt in prior sigmas, first radius of Dogleg.
DAMPING: Final = 1e-5
RADIUS: Final = 100.0


@dataclass(frozen=True)
class _Step(Step):
    """A step with the whitened gradient before it, if it is a Gauss-Newton step; a refused one: its least size."""

    gradient: float = math.nan


class _Run:
    """Values that one of GTSAM's optimisers has reached, iteration by iteration.

    Each iteration has an optimiser and a graph of its own (:mod:`fg_orient.adjustment.reduced_graph`), which continue
    with the damping or radius of the last ones.
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
        # with less damping GTSAM may find a free datum singular, and each trial takes a factorisation
        least = DAMPING if self._backend.problem.least_damping > 0.0 else 0.0
        self._optimizer = _optimizer(self.kind, self._linear, self.control, least)
        self.error = float(self._optimizer.error())
        self._done = False

    def iterate(self) -> _Step:
        """Run one iteration."""
        if self._done:
            self._begin()
        backend, here, linear, optimizer, before = self._backend, self.state, self._linear, self._optimizer, self._free
        optimizer.iterate()
        self._done = True
        # a copy: the values of an optimiser are gone with it
        self.values, self.error = linear.of_images(optimizer.values()), float(optimizer.error())
        if self.kind == "levenberg-marquardt":
            self.control = float(optimizer.lambda_())
        elif self.kind == "dogleg":
            self.control = float(optimizer.getDelta())
        self._free = backend.free(self.values)
        step = self._free - before
        if not step.any():
            linear.graph.error(linear.values)  # the last evaluation was that of a refused step
        self.state = backend.state(self.values, self._free)
        moved = (self.state.image - here.image, self.state.ground - here.ground) if step.any() else ()
        length = max((float(np.nanmax(np.abs(by), initial=0.0)) for by in moved), default=0.0)
        predicted, along = linear.after(self.values, step)
        gradient = math.sqrt(max(-along, 0.0)) if step.any() else linear.steepest()
        return _Step(None, length, predicted, gradient=gradient)


def _optimizer(kind: str, linear: ReducedGraph | ImagesReduced, control: float, least: float) -> Any:
    """Make an optimiser whose own tests for the end never hold."""
    makers: dict[str, tuple[Any, Any]] = {
        "gauss-newton": (gtsam.GaussNewtonParams, gtsam.GaussNewtonOptimizer),
        "levenberg-marquardt": (gtsam.LevenbergMarquardtParams, gtsam.LevenbergMarquardtOptimizer),
        "dogleg": (gtsam.DoglegParams, gtsam.DoglegOptimizer),
    }
    make_params, make = makers[kind]
    params = make_params()
    for set_tolerance in (params.setAbsoluteErrorTol, params.setRelativeErrorTol, params.setErrorTol):
        set_tolerance(0.0)
    params.setOrdering(linear.ordering)
    if kind == "levenberg-marquardt":
        params.setRelativeErrorTol(UNCHANGED)
        params.setlambdaInitial(control)
        params.setlambdaLowerBound(least)
    elif kind == "dogleg":
        params.setDeltaInitial(control)
    return make(linear.graph, linear.values, params)


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
    """Run GTSAM's optimiser ``kind``; parameters as of :func:`fg_orient.adjustment.loop.gauss_newton`."""
    course = Course(start, callback, keep)
    carried = course.carried
    final = carried.control == FINAL  # before an interrupt, as the next
    changed = kind == "gauss-newton" and not (math.isnan(carried.control) or final)
    damped = "levenberg-marquardt" if kind == "gauss-newton" else kind  # where Gauss-Newton raises the cost
    first = damped if changed else "gauss-newton" if final else kind
    is_free = backend.problem.least_damping > 0.0  # Gauss-Newton's equations are singular
    # once at most, and not under a loss, whose weights follow each step
    tried = is_free or backend.robust is not None
    run = _begin(first, backend, carried.state, carried.control)
    for _ in course.remaining(max_iterations):
        carried, before, here, control = course.carried, run.error, run.state, run.control
        step, newton = run.iterate(), run.kind == "gauss-newton"
        rises = not run.error <= before * (1.0 + RISE) + RISE
        course.assess(
            before, math.inf if rises else run.error, step, 0.0 if math.isnan(control) else control, always=not rises
        )  # fmt: skip
        if rises:
            if not newton or (final and tried):
                return course.end(here, before, False, finding("loop.no_step"))
            tried, changed = tried or final, changed or not final
            run, final = _begin(damped, backend, here, math.nan), False
            course.go_on(control=run.control, rejected=carried.rejected + 1)
            continue
        known = carried.previous < math.inf
        rate = min(step.length / carried.previous, 1.0) if known else 1.0  # of the steps, and of the gradient
        # a free datum allows no Gauss-Newton steps, and the next damped step cannot decrease the cost
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
) -> LoopResult[State]:  # fmt: skip
    """End of the run after a small step; the gradient says whether it is the solution."""
    if step.length < ROUNDING_STEP and step.gradient <= REMAINING:
        converged, end = True, finding("loop.small_step_damped") if changed else SMALL
    else:
        converged, end = False, finding("loop.gradient_left", step=step.length, gradient=step.gradient)
    return course.end(backend.state(run.values, complete=True), run.error, converged, end)


#: GTSAM's optimisers by name, with the arguments of those of ``loop.OPTIMIZERS``.
GTSAM_OPTIMIZERS: Final = {
    kind: functools.partial(_optimise, kind) for kind in ("gauss-newton", "levenberg-marquardt", "dogleg")
}
