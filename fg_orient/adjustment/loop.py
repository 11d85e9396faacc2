"""Gauss-Newton, Levenberg-Marquardt and Dogleg in one loop for all backends.

Python owns the state. A backend only linearises, solves and retracts (docs/equations.md
9: GTSAM's own optimisers copy all values at every callback of a Python factor). Unknowns
are scaled (prior sigmas; metres for ground points). Therefore one step length is valid
for all of them. The loop ends in three cases:

- the scaled step is below the tolerance;
- the scaled step is below 1e-6 and no longer shrinks, because it is rounding;
- full steps shrink fast, and the next step, extrapolated with a margin of ten, would be below the tolerance.

The relative cost is not used.

:class:`Carried` contains everything that one iteration passes to the next. A loop that
starts from it continues with identical bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from factors._preparation import working_clock
from fg_orient.model.errors import Finding, finding

S = TypeVar("S")

STEP_TOLERANCE = 1e-8
ROUNDING_STEP = 1e-6
#: A step below ROUNDING_STEP is rounding if it is larger than this share of the last
#: step. Newton's steps shrink faster. Reweighted steps shrink by a constant factor. Steps
#: of rounding do not shrink.
SHRINK = 0.5
SHRINK_REWEIGHTED = 1.0
MAX_REJECTED = 20
#: Maximum number of rejected steps in :func:`delayed_gratification`, where the damping only doubles.
MAX_REJECTED_DOUBLING = 60
LEAST_DAMPING = 1e-14
SMALL = finding("loop.small_step")


@dataclass(frozen=True)
class Step:
    """A step; backends may have steps of other classes with ``length`` and ``predicted_error``.

    Parameters
    ----------
    data : object
        Movement of a state in the form of the backend; for full matrices a vector (u,) in scaled unknowns.
    length : float
        Largest scaled element; inf if the equations are singular.
    predicted_error : float
        Error that the linear model predicts after the step.
    kappa : float
        Regularisation parameter; nan without a regularised solver.
    """

    data: Any
    length: float
    predicted_error: float
    kappa: float = math.nan


class System(Protocol):
    """One linearisation; ``error`` is half the weighted sum of squares at its point."""

    error: float

    def solve(self, damping: float) -> Step:
        """Solve the normal equations with ``damping`` times the identity added."""
        ...


class Backend(Protocol[S]):
    """Solver that the loop calls."""

    def linearise(self, state: S) -> System:
        """Linearise at a state."""
        ...

    def error(self, state: S) -> float:
        """Return half the weighted sum of squares."""
        ...

    def retract(self, state: S, step: Step) -> S:
        """Return the state after a step."""
        ...


@dataclass(frozen=True)
class IterationRecord:
    """One iteration, for log and callback.

    ``step`` is the largest scaled element; ``chi2`` and ``chi2_after`` are weighted sums
    of squares (under a loss twice the cost); ``ratio`` is actual over predicted decrease
    (nan if the predicted decrease is rounding: the step is accepted); ``mu`` is the stage
    under a loss (nan without); ``kappa`` is the regularisation parameter of the step (nan
    without).
    """

    iteration: int
    chi2: float
    chi2_after: float
    predicted: float
    ratio: float
    step: float
    damping: float
    accepted: bool
    seconds: float
    mu: float = math.nan
    kappa: float = math.nan


Callback = Callable[[IterationRecord], None]


@dataclass(frozen=True)
class Carried(Generic[S]):
    """State and control that one iteration passes to the next.

    Parameters
    ----------
    state : S
    control : float
        Damping or radius; nan: initial value of the optimiser.
    growth : float
        Factor of the damping after the next rejected step.
    previous : float
        Largest scaled element of the last accepted step.
    rejected, rising : int
        Number of consecutive rejected steps; number of consecutive increases of the error.
    log : tuple of IterationRecord
    begun_at : int
        Number of iterations of earlier stages.
    mu, image_scale, control_scale : float
        Stage (``fg_orient.adjustment.stages``; nan without loss) and units of its losses, in sigmas.
    """

    state: S
    control: float = math.nan
    growth: float = 2.0
    previous: float = math.inf
    rejected: int = 0
    rising: int = 0
    log: tuple[IterationRecord, ...] = ()
    begun_at: int = 0
    mu: float = math.nan
    image_scale: float = 1.0
    control_scale: float = 1.0

    @property
    def scale(self) -> tuple[float, float]:
        """Both scales."""
        return self.image_scale, self.control_scale


@dataclass(frozen=True)
class LoopResult(Generic[S]):
    """End of the loop: state, its error, the log and the reason of the end; ``iterations`` if there is no log."""

    state: S
    error: float
    log: tuple[IterationRecord, ...]
    converged: bool
    end: Finding
    iterations: int = 0

    @property
    def reason(self) -> str:
        """Sentence on the end of the iteration."""
        return str(self.end)


class Course(Generic[S]):
    """Progress of a loop from a state, or from the input of the next iteration of an interrupted loop.

    ``callback`` receives each record; ``keep`` receives the input of each further iteration.
    """

    def __init__(
        self, start: S | Carried[S], callback: Callback | None, keep: Callable[[Carried[S]], None] | None
    ) -> None:
        self.carried: Carried[S] = start if isinstance(start, Carried) else Carried(start)
        self._callback, self._keep = callback, keep
        log = self.carried.log
        self._start = working_clock() - (log[-1].seconds if log else 0.0)

    def remaining(self, max_iterations: int) -> range:
        """Return the range of iterations that remain for this stage."""
        return range(max_iterations - len(self.carried.log) + self.carried.begun_at)

    def assess(self, before: float, after: float, step: Step, control: float, always: bool = False) -> IterationRecord:
        """Record a step.

        The step is accepted if the error decreases, if the predicted decrease is rounding, or if ``always`` is true.
        """
        predicted = before - step.predicted_error
        ratio = (before - after) / predicted if predicted > 1e-12 * max(before, 1.0) else math.nan
        accepted = always or (math.isfinite(after) and (math.isnan(ratio) or ratio > 0.0))
        log = self.carried.log
        record = IterationRecord(
            len(log) + 1,
            2.0 * before,
            2.0 * after,
            2.0 * predicted,
            ratio,
            step.length,
            control,
            accepted,
            working_clock() - self._start,
            self.carried.mu,
            getattr(step, "kappa", math.nan),
        )
        self.carried = replace(self.carried, log=(*log, record))
        if self._callback:
            self._callback(record)
        return record

    def go_on(self, **changed: Any) -> None:
        """Pass changed values on to the next iteration."""
        self.carried = replace(self.carried, **changed)
        if self._keep:
            self._keep(self.carried)

    def end(self, state: S, error: float, converged: bool, end: Finding) -> LoopResult[S]:
        """Return the end of the loop."""
        return LoopResult(state, error, self.carried.log, converged, end)


def exhausted(max_iterations: int) -> Finding:
    """Report the end at the maximum number of iterations."""
    return finding("loop.iterations", iterations=max_iterations)


def share_at_radius(across_squared: float, steepest_dot_across: float, length: float, radius: float) -> float:
    """Return where the way from the steepest-descent step to the Gauss-Newton step reaches the radius, as a share."""
    b, c = steepest_dot_across, length**2 - radius**2
    return (-b + math.sqrt(b * b - across_squared * c)) / across_squared


def small(step: float, previous: float, tolerance: float, shrink: float) -> bool:
    """Return whether a step is below the tolerance, or is rounding and no longer shrinks."""
    return step < tolerance or (step < ROUNDING_STEP and step > shrink * previous)


def settled(step: float, previous: float, tolerance: float) -> bool:
    """Return whether the next step, at this rate and with a margin of ten, would be below the tolerance."""
    rate = step / previous if 0.0 < previous < math.inf else 1.0
    return rate < 0.1 and 10.0 * step * rate < tolerance


def gauss_newton(
    backend: Backend[S],
    start: S | Carried[S],
    max_iterations: int,
    callback: Callback | None = None,
    tolerance: float = STEP_TOLERANCE,
    *,
    shrink: float = SHRINK,
    keep: Callable[[Carried[S]], None] | None = None,
) -> LoopResult[S]:
    """Iterate with full steps; stop without convergence if the error is not finite or increases three times in a row.

    ``start``, ``callback`` and ``keep``: see :class:`Course`. A step shrinks if it is
    below ``shrink`` times the last step.
    """
    course = Course(start, callback, keep)
    system = backend.linearise(course.carried.state)
    for _ in course.remaining(max_iterations):
        carried, step = course.carried, system.solve(0.0)
        state = backend.retract(carried.state, step)
        last = small(step.length, carried.previous, tolerance, shrink)
        last = last or settled(step.length, carried.previous, tolerance)
        following = None if last else backend.linearise(state)
        error = following.error if following else backend.error(state)
        course.assess(system.error, error, step, 0.0, always=True)
        rising = carried.rising + 1 if error > system.error * (1.0 + 1e-9) + 1e-9 else 0
        if not math.isfinite(error) or rising >= 3:
            return course.end(state, error, False, finding("loop.error_rises"))
        if following is None:
            return course.end(state, error, rising == 0, SMALL if rising == 0 else finding("loop.last_step"))
        system = following
        course.go_on(state=state, previous=step.length, rising=rising)
    return course.end(course.carried.state, system.error, False, exhausted(max_iterations))


@dataclass(frozen=True)
class _Control:
    """Control of the steps by a damping or radius.

    ``first`` is its initial value. ``method`` names the method of the system that
    computes the step. ``follow`` computes the next value and growth from value, growth
    and record. ``regular``: a larger value makes singular equations regular, so they do
    not end the loop. ``max_rejected`` consecutive rejected steps end the loop.
    """

    first: float
    method: str
    follow: Callable[[float, float, IterationRecord], tuple[float, float]]
    regular: bool = False
    max_rejected: int = MAX_REJECTED

    def step(self, system: System, control: float) -> Step:
        """Return the step for a value.

        Its length is infinite if the equations are singular under so little damping.
        """
        try:
            step: Step = getattr(system, self.method)(control)
            return step
        except RuntimeError:
            if not self.regular:
                raise
            return Step(None, math.inf, system.error)


def _arrived(system: System, log: tuple[IterationRecord, ...], small: bool) -> bool:
    """Return whether the accepted step was the last step.

    A damped step may be small because of the damping, so the undamped step decides. With
    a free datum the equations are singular without damping, and with very little damping
    steps need not become small. The loop then ends when the predicted decrease is
    rounding.
    """
    rounding = math.isnan(log[-1].ratio)
    if rounding and len(log) > 1 and math.isinf(log[-2].step):
        return True
    try:
        return small and system.solve(0.0).length < ROUNDING_STEP
    except RuntimeError:
        return rounding


def nielsen(damping: float, growth: float, record: IterationRecord) -> tuple[float, float]:
    """Control the damping by the ratio of actual to predicted decrease (Nielsen 1999).

    The damping decreases fast if the linear model is good.
    """
    if not record.accepted:
        return damping * growth, 2.0 * growth
    ratio = 1.0 if math.isnan(record.ratio) else record.ratio
    return max(damping * max(1e-3, 1.0 - (2.0 * ratio - 1.0) ** 3), LEAST_DAMPING), 2.0


def delayed_gratification(damping: float, growth: float, record: IterationRecord) -> tuple[float, float]:
    """Double the damping after a rejected step, divide it by five after an accepted one (Transtrum, Sethna 2012, 5).

    The damping stays as large as the error permits. The steps into a narrow curved valley
    are therefore short, which helps with poor start values.
    """
    return (2.0 * damping if not record.accepted else max(0.2 * damping, LEAST_DAMPING)), growth


def _trust(radius: float, growth: float, record: IterationRecord) -> tuple[float, float]:
    """Return the radius of a trust region by the ratio of actual to predicted decrease."""
    if not record.accepted or record.ratio < 0.25:
        return 0.25 * radius, growth
    return max(radius, 3.0 * record.step) if record.ratio > 0.75 else radius, growth


def _controlled(
    rule: _Control,
    backend: Backend[S],
    start: S | Carried[S],
    max_iterations: int,
    callback: Callback | None = None,
    tolerance: float = STEP_TOLERANCE,
    *,
    shrink: float = SHRINK,
    keep: Callable[[Carried[S]], None] | None = None,
) -> LoopResult[S]:
    """Iterate with steps that decrease the error, controlled by a damping or radius.

    See :func:`gauss_newton`.
    """
    course = Course(start, callback, keep)
    if math.isnan(course.carried.control):
        course.carried = replace(course.carried, control=rule.first)
    system = backend.linearise(course.carried.state)
    for _ in course.remaining(max_iterations):
        carried, step = course.carried, rule.step(system, course.carried.control)
        solved = math.isfinite(step.length)
        trial = backend.retract(carried.state, step) if solved else carried.state
        error = backend.error(trial) if solved else math.inf
        record = course.assess(system.error, error, step, carried.control)
        control, growth = rule.follow(carried.control, carried.growth, record)
        if not record.accepted:
            if carried.rejected + 1 >= rule.max_rejected:
                return course.end(carried.state, system.error, False, finding("loop.no_step"))
            course.go_on(control=control, growth=growth, rejected=carried.rejected + 1)
            continue
        if _arrived(system, course.carried.log, small(step.length, carried.previous, tolerance, shrink)):
            return course.end(trial, error, True, SMALL)
        system = backend.linearise(trial)
        course.go_on(state=trial, control=control, growth=growth, previous=step.length, rejected=0)
    return course.end(course.carried.state, system.error, False, exhausted(max_iterations))


Optimizer = Callable[..., LoopResult[Any]]
#: Optimiser with damped steps.
levenberg_marquardt: Optimizer = partial(_controlled, _Control(1e-4, "solve", nielsen, regular=True))
#: Optimiser with damped steps for poor start values.
delayed_levenberg_marquardt: Optimizer = partial(
    _controlled,
    _Control(1e-2, "solve", delayed_gratification, regular=True, max_rejected=MAX_REJECTED_DOUBLING),
)
#: Optimiser with Powell's dogleg steps in a trust region of the scaled unknowns.
dogleg: Optimizer = partial(_controlled, _Control(1e3, "dogleg", _trust))

OPTIMIZERS: dict[str, Optimizer] = {
    "gauss-newton": gauss_newton,
    "levenberg-marquardt": levenberg_marquardt,
    "dogleg": dogleg,
}
