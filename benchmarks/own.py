"""The entries of fg_orient run its backends on a compiled problem: structure, solution, stages of one iteration."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Any

import gtsam

from benchmarks.entries import FUNCTION_TOLERANCE, MAX_EVALUATIONS, Outcome
from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.graph import GraphBackend
from fg_orient.adjustment.loop import OPTIMIZERS, IterationRecord, levenberg_marquardt
from fg_orient.adjustment.optimisers import GTSAM_OPTIMIZERS
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.solve import solve
from fg_orient.kernels.batch_pairs import pair_blocks
from fg_orient.model.block import Block

#: Solutions that take less than this time run several times in a row for one record.
SHORT_S = 0.1


def repeated(once: Callable[[], Outcome]) -> Callable[[], Outcome]:
    """Repeat a short solution several times, because the first run is slower in unused memory.

    Return the outcome with the median duration; each of its stages is the median of all runs.
    """

    def seconds(outcome: Outcome) -> float:
        return outcome.solve + outcome.structure

    def run() -> Outcome:
        first = once()
        if seconds(first) > SHORT_S:
            return first
        n = max(3, min(51, int(SHORT_S / seconds(first))))
        all_found = sorted((once() for _ in range(n)), key=seconds)
        stages = {name: median(o.stages[name] for o in all_found) for name in first.stages}
        return replace(all_found[n // 2], stages=stages, inner=n)

    return run


def _loop(make: Callable[[], Any], optimizer: str, max_iterations: int) -> tuple[Outcome, Any]:
    """Make the backend and adjust to the end; return the outcome and the backend."""
    marks = [time.perf_counter()]
    backend = make()
    marks.append(time.perf_counter())
    result = OPTIMIZERS[optimizer](backend, backend.initial(), max_iterations, None)
    marks.append(time.perf_counter())
    taken = sum(record.accepted for record in result.log)  # refused steps take time, but are no iterations
    outcome = Outcome(
        marks[2] - marks[1], marks[1] - marks[0], taken, len(result.log), float(result.error), result.reason
    )
    return outcome, backend


class _TimedWorkers:
    """The class runs the threads of a backend and adds up the seconds of each kernel by its name."""

    def __init__(self, workers: Any) -> None:
        self._workers, self.seconds = workers, dict[str, float]()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._workers, name)

    def run(self, kernel: Any, *arguments: Any, **options: Any) -> Any:
        start = time.perf_counter()
        result = self._workers.run(kernel, *arguments, **options)
        name = getattr(kernel, "__name__", str(kernel))
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
        return result


def _stages(backend: Any, state: Any) -> dict[str, float]:
    """Return the seconds of linearise, solve and retract at a state, in memory that was used before."""
    marks = [time.perf_counter()]
    system = backend.linearise(state)
    marks.append(time.perf_counter())
    step = system.solve(0.0)
    marks.append(time.perf_counter())
    backend.retract(state, step)
    marks.append(time.perf_counter())
    names = ("linearise", "solve", "retract")
    return {name: b - a for name, a, b in zip(names, marks, marks[1:], strict=False)}


def _kernels(backend: SchurBackend) -> None:
    """Run the kernels of a thread one by one. The threads wait after each kernel, and rows come from distant memory."""
    s, b, state, stages = backend.structure, backend.buffers, backend.initial(), backend.stages
    run, wide = backend.workers.run, s.widened(state.image)
    for tile in s.tiles:
        rows, (first, last), (place, end), (lo, hi) = b.rows(tile), tile.points, tile.places, tile.chunks
        run(stages.rows, last - first, rows, state, wide, True, start=first)
        run(stages.points, end - place, rows, state, 0.0, b, start=place)
        at = (s.chunks, s.pieces, s.slots, s.slot_begin, s.image, s.n_basis, s.n_components, s.basis, first)
        run(pair_blocks, s.cost[lo : hi + 1], *at, rows.d_image, b.scaled, b.sums, b.gradients, start=lo)


def schur(
    problem: Problem, threads: int | None, *, reduced: str = "auto", optimizer: str = "gauss-newton"
) -> Callable[[], Outcome]:
    """Return the loop of fg_orient on the Schur backend. The stages and kernels are measured in one more iteration."""

    def once() -> Outcome:
        outcome, backend = _loop(lambda: SchurBackend(problem, threads=threads, reduced=reduced), optimizer, 50)
        start = backend.initial()
        outcome.stages = _stages(backend, start)
        backend.workers = _TimedWorkers(backend.workers)
        _stages(backend, start)
        _kernels(backend)
        outcome.stages |= {f"kernel:{name}": seconds for name, seconds in backend.workers.seconds.items()}
        return outcome

    return repeated(once)


class _Enough(Exception):
    """The callback raises this exception where the rule of another program would end the iterations."""


def damped(problem: Problem, threads: int | None) -> Callable[[], Outcome]:
    """Return Levenberg-Marquardt on the Schur backend, ended by the rule of other programs: the cost hardly decreases.

    The rule of fg_orient uses the step and needs one or two more iterations.
    """

    def once() -> Outcome:
        log: list[IterationRecord] = []

        def judge(record: IterationRecord) -> None:
            log.append(record)
            if record.accepted and record.chi2 - record.chi2_after <= FUNCTION_TOLERANCE * record.chi2:
                raise _Enough

        marks = [time.perf_counter()]
        backend = SchurBackend(problem, threads=threads)
        marks.append(time.perf_counter())
        ended = f"relative decrease of the cost below {FUNCTION_TOLERANCE:g}"
        try:
            ended = levenberg_marquardt(backend, backend.initial(), MAX_EVALUATIONS, judge).reason
        except _Enough:
            pass
        marks.append(time.perf_counter())
        taken = sum(record.accepted for record in log)
        cost = 0.5 * min(record.chi2_after for record in log)
        return Outcome(marks[2] - marks[1], marks[1] - marks[0], taken, len(log), cost, ended)

    return repeated(once)


def eliminated(problem: Problem, optimizer: str) -> Callable[[], Outcome]:
    """Return GTSAM's optimiser over factors with eliminated points (graph backend), to the end of ``adjust``."""

    def once() -> Outcome:
        marks = [time.perf_counter()]
        backend = GraphBackend(problem, grouped=False)
        marks.append(time.perf_counter())
        with one_blas_thread():
            result = GTSAM_OPTIMIZERS[optimizer](backend, problem.start, 50)
        marks.append(time.perf_counter())
        n = len(result.log)
        return Outcome(marks[2] - marks[1], marks[1] - marks[0], n, n, result.error, result.reason)

    return repeated(once)


def graph(problem: Problem) -> Callable[[], Outcome]:
    """Return the explicit graph: one Python factor per image point, with a loop in Python."""

    def once() -> Outcome:
        outcome, backend = _loop(lambda: ExplicitBackend(problem), "gauss-newton", 50)
        outcome.stages = _stages(backend, backend.initial())
        return outcome

    return repeated(once)


def public(problem: Problem) -> Callable[[], Outcome]:
    """Return the solution that ``fg_orient.adjust`` calls, with the backend that "auto" chooses."""

    def once() -> Outcome:
        start = time.perf_counter()
        estimate = solve(problem)
        whole = time.perf_counter() - start
        n = estimate.iterations
        ended = f"{estimate.backend}: {estimate.reason}"
        return Outcome(whole - estimate.structure_s, estimate.structure_s, n, n, 0.5 * estimate.chi2, ended)

    return repeated(once)


def compilation(block: Block) -> Callable[[], Outcome]:
    """Return ``compile_problem`` without a solution: start coordinates and whitened records."""

    def once() -> Outcome:
        start = time.perf_counter()
        compile_problem(block)
        return Outcome(0.0, time.perf_counter() - start, 0, 0, None, "compiled")

    return repeated(once)


def native_iteration(problem: Problem) -> Callable[[], Outcome]:
    """Return one ``iterate`` of GTSAM's own Gauss-Newton optimiser on the factors of fg_orient."""

    def once() -> Outcome:
        marks = [time.perf_counter()]
        backend = ExplicitBackend(problem)
        params = gtsam.GaussNewtonParams()
        params.setOrdering(backend.ordering)
        optimizer = gtsam.GaussNewtonOptimizer(backend.graph, backend.initial(), params)
        marks.append(time.perf_counter())
        optimizer.iterate()
        marks.append(time.perf_counter())
        return Outcome(marks[2] - marks[1], marks[1] - marks[0], 1, 1, None, "one iteration")

    return once


def native(problem: Problem) -> Callable[[], Outcome]:
    """Return GTSAM's own Gauss-Newton optimiser on the factors of fg_orient, run to the end."""

    def once() -> Outcome:
        marks = [time.perf_counter()]
        backend = ExplicitBackend(problem)
        marks.append(time.perf_counter())
        params = gtsam.GaussNewtonParams()
        params.setOrdering(backend.ordering)
        params.setAbsoluteErrorTol(0.0)
        params.setRelativeErrorTol(0.0)
        optimizer = gtsam.GaussNewtonOptimizer(backend.graph, backend.initial(), params)
        optimizer.optimize()
        marks.append(time.perf_counter())
        n, error = int(optimizer.iterations()), float(optimizer.error())
        return Outcome(marks[2] - marks[1], marks[1] - marks[0], n, n, error, "GTSAM's own rule")

    return repeated(once)
