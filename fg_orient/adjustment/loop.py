"""Gauss-Newton, Levenberg-Marquardt and Dogleg, one loop over any backend.

The state belongs to Python; a backend only linearises, solves and retracts
(docs/equations.md 9: GTSAM's own optimisers copy all values at every callback of a
Python factor). Unknowns are scaled (prior sigmas; metres for ground points), so one step
length speaks for all. The loop ends when the scaled step is below the tolerance, or below
1e-6 and no longer shrinking (rounding); never on a relative cost. ``tolerance`` replaces the default one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

S = TypeVar("S")

STEP_TOLERANCE = 1e-8
ROUNDING_STEP = 1e-6
MAX_REJECTED = 20
SMALL = "the scaled step is below the tolerance"


class Step(Protocol):
    """A step: its largest scaled element and the error the linear model predicts after it."""

    length: float
    predicted_error: float
    data: Any


class System(Protocol):
    """One linearisation; ``error`` is half the weighted sum of squares at its point."""

    error: float

    def solve(self, damping: float) -> Step:
        """Solve the normal equations with ``damping`` times the identity added."""
        ...

    def dogleg(self, radius: float) -> Step:
        """Give Powell's step inside a trust region of this radius (Euclidean, scaled unknowns)."""
        ...


class Backend(Protocol[S]):
    """What the loop needs of a solver."""

    def linearise(self, state: S) -> System:
        """Linearise at a state."""
        ...

    def error(self, state: S) -> float:
        """Half the weighted sum of squares."""
        ...

    def retract(self, state: S, step: Step) -> S:
        """Give the state after a step."""
        ...


@dataclass(frozen=True)
class IterationRecord:
    """One iteration, as the log and the callback see it.

    ``step`` is the largest scaled element; ``chi2`` and ``chi2_after`` are weighted sums of
    squares; ``ratio`` is actual over predicted decrease (nan where the predicted decrease is rounding:
    such a step is taken).
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


Callback = Callable[[IterationRecord], None]


@dataclass(frozen=True)
class LoopResult(Generic[S]):
    """End of the loop: state, its error, the log, and why it ended."""

    state: S
    error: float
    log: tuple[IterationRecord, ...]
    converged: bool
    reason: str


class _Log:
    """Collect the records and pass each one on."""

    def __init__(self, callback: Callback | None) -> None:
        self.records: list[IterationRecord] = []
        self._callback = callback
        self._start = time.perf_counter()

    def add(self, before: float, after: float, step: Step, damping: float, always: bool = False) -> IterationRecord:
        """Judge a step: taken if the error falls, or if the predicted decrease is rounding (or always)."""
        predicted = before - step.predicted_error
        ratio = (before - after) / predicted if predicted > 1e-12 * max(before, 1.0) else math.nan
        accepted = always or (math.isfinite(after) and (math.isnan(ratio) or ratio > 0.0))
        record = IterationRecord(
            len(self.records) + 1, 2.0 * before, 2.0 * after, 2.0 * predicted, ratio, step.length, damping, accepted,
            time.perf_counter() - self._start,
        )  # fmt: skip
        self.records.append(record)
        if self._callback:
            self._callback(record)
        return record


def _exhausted(max_iterations: int) -> str:
    return f"no convergence within {max_iterations} iteration(s): raise --max-iterations, or look at the start values"


def share_at_radius(across_squared: float, steepest_dot_across: float, length: float, radius: float) -> float:
    """Share of the way from the steepest-descent step (of this length) to Gauss-Newton's that ends at the radius."""
    b, c = steepest_dot_across, length**2 - radius**2
    return (-b + math.sqrt(b * b - across_squared * c)) / across_squared


def _small(step: float, previous: float, tolerance: float) -> bool:
    return step < tolerance or (step < ROUNDING_STEP and step > 0.5 * previous)


def gauss_newton(
    backend: Backend[S],
    start: S,
    max_iterations: int,
    callback: Callback | None = None,
    tolerance: float = STEP_TOLERANCE,
) -> LoopResult[S]:
    """Full steps; ends unconverged when the error rises three times running or is not finite."""
    log, state, previous, rising = _Log(callback), start, math.inf, 0
    system = backend.linearise(state)
    for _ in range(max_iterations):
        step = system.solve(0.0)
        state = backend.retract(state, step)
        last = _small(step.length, previous, tolerance)
        following = None if last else backend.linearise(state)
        error = following.error if following else backend.error(state)
        log.add(system.error, error, step, 0.0, always=True)
        rising = rising + 1 if error > system.error * (1.0 + 1e-9) + 1e-9 else 0
        if not math.isfinite(error) or rising >= 3:
            return LoopResult(
                state, error, tuple(log.records), False, "the error rises: try --optimizer levenberg-marquardt"
            )
        if following is None:
            reason = SMALL if rising == 0 else "the last step raised the error: try --optimizer levenberg-marquardt"
            return LoopResult(state, error, tuple(log.records), rising == 0, reason)
        system, previous = following, step.length
    return LoopResult(state, system.error, tuple(log.records), False, _exhausted(max_iterations))


def levenberg_marquardt(
    backend: Backend[S],
    start: S,
    max_iterations: int,
    callback: Callback | None = None,
    tolerance: float = STEP_TOLERANCE,
) -> LoopResult[S]:
    """Damped steps; the damping follows the ratio of actual to predicted decrease (Nielsen 1999)."""
    growth = 2.0

    def solve(system: System, damping: float) -> Step:
        return system.solve(damping)

    def follow(damping: float, record: IterationRecord) -> float:
        nonlocal growth
        if not record.accepted:
            damping, growth = damping * growth, 2.0 * growth
            return damping
        growth = 2.0
        ratio = 1.0 if math.isnan(record.ratio) else record.ratio
        return max(damping * max(1e-3, 1.0 - (2.0 * ratio - 1.0) ** 3), 1e-14)

    return _controlled(backend, start, max_iterations, callback, tolerance, solve, follow, 1e-4)


def dogleg(
    backend: Backend[S],
    start: S,
    max_iterations: int,
    callback: Callback | None = None,
    tolerance: float = STEP_TOLERANCE,
) -> LoopResult[S]:
    """Powell's dogleg in a trust region of the scaled unknowns."""

    def solve(system: System, radius: float) -> Step:
        return system.dogleg(radius)

    def follow(radius: float, record: IterationRecord) -> float:
        if not record.accepted or record.ratio < 0.25:
            return 0.25 * radius
        return max(radius, 3.0 * record.step) if record.ratio > 0.75 else radius

    return _controlled(backend, start, max_iterations, callback, tolerance, solve, follow, 1e3)


def _controlled(
    backend: Backend[S],
    start: S,
    max_iterations: int,
    callback: Callback | None,
    tolerance: float,
    solve: Callable[[System, float], Step],
    follow: Callable[[float, IterationRecord], float],
    control: float,
) -> LoopResult[S]:
    """Take steps that lower the error; ``control`` (damping or radius) follows each record."""
    log, state, previous, rejected = _Log(callback), start, math.inf, 0
    system = backend.linearise(state)
    for _ in range(max_iterations):
        step = solve(system, control)
        trial = backend.retract(state, step)
        error = backend.error(trial)
        record = log.add(system.error, error, step, control)
        control = follow(control, record)
        if not record.accepted:
            rejected += 1
            if rejected >= MAX_REJECTED:
                return LoopResult(state, system.error, tuple(log.records), False, "no step lowers the error")
            continue
        state, rejected = trial, 0
        # a damped step may be small because of the damping: the undamped one decides
        if _small(step.length, previous, tolerance) and system.solve(0.0).length < ROUNDING_STEP:
            return LoopResult(state, error, tuple(log.records), True, SMALL)
        system, previous = backend.linearise(state), step.length
    return LoopResult(state, system.error, tuple(log.records), False, _exhausted(max_iterations))


OPTIMIZERS: dict[str, Callable[..., LoopResult[Any]]] = {
    "gauss-newton": gauss_newton,
    "levenberg-marquardt": levenberg_marquardt,
    "dogleg": dogleg,
}
