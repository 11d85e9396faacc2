"""Solve a problem: choose the backend and the optimiser, run them, and linearise at the solution."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from factors._contract import NotFiniteError
from factors._preparation import working_clock
from factors.arrays import Array
from factors.losses import losses
from fg_orient.adjustment.best_rays import sharing, with_best_rays
from fg_orient.adjustment.checkpoint import Checkpoint
from fg_orient.adjustment.images_first import images_first
from fg_orient.adjustment.irls import DIMENSIONS, RULES, CycleResult, cycles_on_arrays, norms_at, reweight, weights_of
from fg_orient.adjustment.loop import (
    OPTIMIZERS,
    SHRINK,
    SHRINK_REWEIGHTED,
    STEP_TOLERANCE,
    Callback,
    Carried,
    IterationRecord,
    LoopResult,
)
from fg_orient.adjustment.penalty import needs_rows, penalty_squares
from fg_orient.adjustment.problem import Problem, State, no_point_is_named
from fg_orient.adjustment.reduced_choice import is_wide
from fg_orient.adjustment.resection import METHODS, resection_start
from fg_orient.adjustment.robust import (
    A_PRIORI,
    CONTROL,
    IMAGE,
    NONE,
    Robust,
    Weights,
    inlier_limit,
    scale_at,
    weighted_problem,
    weights_at,
)
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.stages import FROM_RESECTIONS, PLAIN, plan_of, require_possible, run_stages
from fg_orient.model.block import Block
from fg_orient.model.errors import Finding, InputError, NoSolutionError, finding
from fg_orient.model.machine import calm_memory
from fg_orient.model.options import Backend, Options

if TYPE_CHECKING:
    from fg_orient.adjustment.border_matrix import BorderMatrix
    from fg_orient.adjustment.dense import DenseSystem
    from fg_orient.adjustment.explicit import ExplicitSystem
    from fg_orient.adjustment.reduced_cofactors import SummedSystem
    from fg_orient.adjustment.schur import SchurSystem

S = TypeVar("S")

#: If eliminated points give a singular system, a graph with a factor for each image point
#: is built (13 kB each). This is the maximum number of image points for it.
EXPLICIT_LIMIT = 100_000


@dataclass(frozen=True)
class Estimate:
    """Result of the optimisation.

    Parameters
    ----------
    state : State
    chi2 : float
        Weighted sum of squares of the observations, without a penalty; under a loss with
        the weights at the state.
    backend, solver : str
        "graph", "schur" or "dense"; linear solver of the dense backend, else "".
    linear : ExplicitSystem, SchurSystem, DenseSystem, SummedSystem or BorderMatrix
        Undamped linearisation at the state, for cofactors.
    structure_s, solve_s : float
        Wall-clock seconds of compilation and optimisation.
    weights : Weights or None
        Weights at the state under a loss.
    resumed_at : int
        Number of iterations of an interrupted run that this run continued.
    widest : int
        Maximum number of image unknowns that are linked to the unknowns of one image.
    """

    state: State
    chi2: float
    converged: bool
    end: Finding
    log: tuple[IterationRecord, ...]
    iterations: int
    backend: str
    solver: str
    linear: ExplicitSystem | SchurSystem | DenseSystem | SummedSystem | BorderMatrix
    structure_s: float
    solve_s: float
    weights: Weights | None = None
    resumed_at: int = 0
    widest: int = 0

    @property
    def reason(self) -> str:
        """Sentence on the end of the iteration."""
        return str(self.end)


def solve(
    problem: Problem,
    callback: Callback | None = None,
    schur: Callable[[Problem], Any] | None = None,
    checkpoint: Checkpoint | None = None,
    start: State | None = None,
) -> Estimate:
    """Adjust with the backend of the block's options.

    Parameters
    ----------
    problem : Problem
    callback : callable, optional
        Receives each record, first the records of an interrupted run.
    schur : callable, optional
        Function that makes a backend which replaces the backend of the options
        (``fg_orient.adjustment.parts``).
    checkpoint : Checkpoint, optional
        File for the state of the run, from which the run can continue. The caller removes it after the end.
    start : State, optional
        Start that replaces the start of the problem.

    Raises
    ------
    InputError
        Unknown backend, optimiser, solver or loss; too many unknowns for the dense
        backend; a block that the Schur backend refuses; a checkpoint of another problem.
    NoSolutionError
        The equations become singular or not finite.
    KeyboardInterrupt
        Interrupt; its text names the checkpoint if it was written.
    """
    require_possible(problem.block.options)
    try:
        with calm_memory():
            if problem.block.options.loss in RULES:
                return _in_cycles(problem, callback, schur is not None)
            return _with_shared_weights(problem, _run(_Job(problem, callback, checkpoint, start), schur), schur)
    except KeyboardInterrupt:
        done = None if checkpoint is None else checkpoint.write()
        if checkpoint is None or done is None:
            raise
        raise KeyboardInterrupt(finding("loop.interrupted", iteration=done, kept=checkpoint.path.name)) from None
    except (NotFiniteError, RuntimeError) as error:
        raise NoSolutionError.of("adjust.broken_down", place=problem.block.name, why=first_sentence(error)) from error


def suitable_backend(block: Block) -> Backend:
    """Return the backend of the options; for "auto" the graph, or the Schur backend for a free datum."""
    options = block.options
    if options.backend != "auto":
        return options.backend
    return "schur" if options.datum == "free" and no_point_is_named(block) else "graph"


def eliminates_points(problem: Problem) -> bool:
    """Return whether the graph eliminates points inside its factors; else it has one factor for each image point.

    Without priors the normal equations may be too ill-conditioned for an elimination of
    points: GTSAM's QR of the rows does not square the condition number. A regularisation
    bounds the condition number, unless its rank includes small singular values. A free
    datum or an inner datum fixes the motions that control points would fix. Under a loss
    the rays of points that extra observations name would need separate weights.
    """
    points = int(np.count_nonzero(np.bincount(problem.observations.point)))
    all_of_them, some = no_point_is_named(problem.block), len(problem.named_points()) < points
    return not needs_rows(problem) and points_are_eliminated(problem.block.options, all_of_them, some)


def points_are_eliminated(options: Options, all_of_them: bool, some: bool) -> bool:
    """See :func:`eliminates_points`; ``all_of_them``, ``some``: extra observations name no point, not every point."""
    if not (options.holds_unknowns or options.datum in ("free", "inner")):
        return False
    return all_of_them or (options.loss == NONE and some)


def first_sentence(error: Exception) -> str:
    """Return the text of an exception in one line."""
    return " ".join(str(error).split())[:160]


class _Job:
    """Problem with its iteration callback and restart state; ``start`` replaces the start values of the problem."""

    def __init__(
        self, problem: Problem, callback: Callback | None, checkpoint: Checkpoint | None, start: State | None = None
    ) -> None:
        self.problem, self.options = problem, problem.block.options
        self._callback, self._checkpoint, self._plan = callback, checkpoint, plan_of(self.options)
        kept = None if checkpoint is None else checkpoint.read(problem)
        self.backend = suitable_backend(problem.block) if kept is None else kept[0]
        self._resumed = None if kept is None else kept[1]
        self._start, self._scale = start, A_PRIORI
        self._marks = [working_clock()]

    def robust(self) -> Robust | None:
        """Return the losses of the first iteration; None for least squares."""
        first = self._first
        return None if self._plan is None else self._plan.robust(first.mu, first.scale)

    @cached_property
    def _first(self) -> Carried[State]:
        """Return the input of the first iteration, from an interrupted run or from the start values."""
        if self._resumed is not None:
            return self._resumed
        if self._plan is None or self.options.gnc or self.options.robust_start not in METHODS:
            return Carried(self._start or self.problem.start, mu=math.nan if self._plan is None else PLAIN)
        state, _ = resection_start(self.problem, self.options.robust_start)
        image, control = self._measured(state)
        return Carried(state, mu=FROM_RESECTIONS, image_scale=image, control_scale=control)

    def _measured(self, state: State) -> tuple[float, float]:
        """Return the scale of the losses at a state."""
        return scale_at(self.problem, state)

    def _best(self, state: State, scale: tuple[float, float]) -> State:
        """Return the start of the last stage: after graduated stages, points move to where most rays agree.

        After Huber's loss gross errors still bias the images, and most rays may agree on a wrong place.
        """
        if not self.options.gnc:
            return state
        image, control = (s * inlier_limit(self.options.inlier_probability, d)
                          for s, d in zip(scale, (IMAGE, CONTROL), strict=True))  # fmt: skip
        return with_best_rays(self.problem, state, (image, control))

    def start_again(self, backend: str) -> None:
        """Begin again from the start values with another backend."""
        self.backend, self._resumed, self._marks = backend, None, [working_clock()]
        self.__dict__.pop("_first", None)

    def mark(self) -> None:
        """Record the time at the end of a phase."""
        self._marks.append(working_clock())

    def optimise(
        self,
        backend: Any,
        to_state: Callable[[S], State],
        of_state: Callable[[State], S],
        optimizers: Mapping[str, Any] = OPTIMIZERS,
    ) -> LoopResult[S]:
        """Run the optimiser on a backend; ``to_state`` and ``of_state`` convert its states for the checkpoint."""
        options = self.options
        first: Carried[Any] = self._first
        carried: Carried[Any] = replace(first, state=of_state(first.state))
        if self._callback is not None:
            for record in carried.log:
                self._callback(record)

        def keep(carried: Carried[Any]) -> None:
            if self._checkpoint is not None:
                self._checkpoint.keep(self.problem, self.backend, replace(carried, state=to_state(carried.state)))

        def run(start: Carried[S], max_iterations: int, tolerance: float) -> LoopResult[S]:
            optimise: Callable[..., LoopResult[S]] = optimizers[options.optimizer]
            return optimise(
                backend, start, max_iterations, self._callback, tolerance,
                shrink=SHRINK if backend.robust is None else SHRINK_REWEIGHTED, keep=keep,
            )  # fmt: skip

        backend.robust = self.robust()
        if self._plan is None:
            return run(carried, options.max_iterations, STEP_TOLERANCE)
        result, self._scale = run_stages(
            backend, run, self._plan, carried, options.max_iterations, keep,
            lambda state: self._measured(to_state(state)),
            lambda state, scale: of_state(self._best(to_state(state), scale)),
        )  # fmt: skip
        return result

    def estimate(self, backend: Any, result: LoopResult[S], state: State, linear: Any, solver: str = "") -> Estimate:
        """Return the result of the optimisation; ``linear`` is the undamped linearisation at the state."""
        error, weights = result.error, None
        if backend.robust is not None:
            weights, excess = weights_at(self.problem, state, backend.robust)
            weights, error = replace(weights, scale=self._scale), error - excess
        structure, solved = np.diff(self._marks)
        chi2 = 2.0 * error - penalty_squares(self.problem, state)
        return Estimate(
            state, chi2, result.converged, result.end, result.log, result.iterations or len(result.log),
            self.backend, solver, linear, float(structure), float(solved), weights,
            0 if self._resumed is None else len(self._resumed.log),
        )  # fmt: skip


def _run(job: _Job, schur: Callable[[Problem], Any] | None) -> Estimate:
    """Run the backend.

    If eliminated points give a singular system, run an explicit graph with QR.
    """
    if schur is not None:
        job.backend = "schur"
        return _run_schur(job, schur)
    if job.backend == "graph" and job.options.backend == "auto" and not images_first(job.problem):
        job.backend = "schur" if eliminates_points(job.problem) and is_wide(job.problem) else job.backend
    run = {"dense": _run_dense, "schur": _run_schur, "graph": _run_graph}[job.backend]
    if job.backend == "graph" and images_first(job.problem):
        try:
            return _run_images(job)
        except (RuntimeError, NotFiniteError):
            job.start_again("graph")
    if job.backend == "graph" and not eliminates_points(job.problem):
        return _run_explicit(job)
    try:
        return run(job)
    except RuntimeError:
        few, auto = len(job.problem.observations) <= EXPLICIT_LIMIT, job.options.backend == "auto"
        if auto and job.backend == "graph" and job.problem.regularisation is not None:
            job.start_again("schur")  # GTSAM's Cholesky refuses very different pivots
            return _run_schur(job)
        if not few or (job.backend != "graph" and not auto):
            raise
    job.start_again("graph")
    return _run_explicit(job)


def _in_cycles(problem: Problem, callback: Callback | None, parted: bool) -> Estimate:
    """Repeat least squares with the weights of a rule; no checkpoint is kept."""
    options = problem.block.options
    if parted:
        raise InputError.of("adjust.cycles", option="parts", value=options.loss, known=", ".join(losses()))
    plain = replace(options, loss=NONE, backend=suitable_backend(problem.block))
    own, begin = replace(problem, block=replace(problem.block, options=plain)), working_clock()
    log: list[IterationRecord] = []

    def record(iteration: IterationRecord) -> None:
        log.append(replace(iteration, iteration=len(log) + 1))
        if callback is not None:
            callback(log[-1])

    def solved(groups: tuple[Array, ...], start: State | None, callback: Callback | None) -> Estimate:
        weighted = weighted_problem(own, weights_of(problem, groups)) if groups else own
        return _run(_Job(weighted, callback, None, start), None)

    def fit(groups: tuple[Array, ...], last: CycleResult | None) -> CycleResult:
        estimate = solved(groups, None if last is None else last.state, record)
        return CycleResult(estimate.state, estimate.chi2)

    on_arrays = plain.backend != "dense" and no_point_is_named(problem.block) and eliminates_points(own)
    on_arrays &= plain.backend == "schur" or not images_first(own)
    cycles = reweight(
        cycles_on_arrays(own, record) if on_arrays else fit, lambda f: norms_at(problem, f.state),
        lambda f: math.sqrt(f.chi2 / max(problem.redundancy, 1)), RULES[options.loss], DIMENSIONS,
    )  # fmt: skip
    end = solved(cycles.weights, cycles.fit.state, None)
    reason = end.end if cycles.settled else finding("loop.weights", cycles=cycles.cycles)
    return replace(
        end, converged=end.converged and cycles.settled, end=reason, log=tuple(log), iterations=len(log),
        weights=weights_of(problem, cycles.weights), solve_s=working_clock() - begin - end.structure_s,
    )  # fmt: skip


def _with_shared_weights(problem: Problem, end: Estimate, schur: Callable[[Problem], Any] | None) -> Estimate:
    """Adjust again with equal weights for rival rays (``best_rays.sharing``) after graduated non-convexity."""
    options = problem.block.options
    if end.weights is None or not end.converged or not options.gnc:
        return end
    weights = sharing(problem, end.state, end.weights)
    if weights is None:
        return end
    plain = replace(options, loss=NONE, gnc=False, robust_scale="prior", robust_start="huber")
    weighted = weighted_problem(replace(problem, block=replace(problem.block, options=plain)), weights)
    again = _run(_Job(weighted, None, None, State(end.state.image, end.state.ground)), schur)
    return replace(
        again, log=end.log, iterations=end.iterations, structure_s=end.structure_s + again.structure_s,
        solve_s=end.solve_s + again.solve_s, weights=weights, resumed_at=end.resumed_at,
    )  # fmt: skip


def _run_graph(job: _Job) -> Estimate:
    """Build the graph of images, optimise with GTSAM, linearise at the end."""
    from fg_orient.adjustment.graph import GraphBackend
    from fg_orient.adjustment.optimisers import GTSAM_OPTIMIZERS

    backend = GraphBackend(job.problem, grouped=False)
    job.mark()
    with one_blas_thread():
        result = job.optimise(backend, _same, _same, GTSAM_OPTIMIZERS)
        job.mark()
        linear = backend.linearise(result.state)
    return replace(job.estimate(backend, result, result.state, linear), widest=backend.sums.widest)


def _run_images(job: _Job) -> Estimate:
    """Build the graph of points with eliminated images, optimise with GTSAM, linearise at the end."""
    from fg_orient.adjustment.graph import ImagesGraph
    from fg_orient.adjustment.optimisers import GTSAM_OPTIMIZERS

    with one_blas_thread():
        backend = ImagesGraph(job.problem)
        job.mark()
        result = job.optimise(backend, _same, _same, GTSAM_OPTIMIZERS)
        job.mark()
        linear = backend.linearise(result.state)
    return job.estimate(backend, result, result.state, linear)


def _run_explicit(job: _Job) -> Estimate:
    """Build the graph of images and points, optimise, linearise at the end."""
    from fg_orient.adjustment.explicit import ExplicitBackend

    backend = ExplicitBackend(job.problem, job.robust())
    job.mark()
    result = job.optimise(backend, backend.state, backend.values)
    job.mark()
    return job.estimate(backend, result, backend.state(result.state), backend.linearise(result.state))


def _run_dense(job: _Job) -> Estimate:
    """Optimise on full matrices, and linearise at the end."""
    from fg_orient.adjustment.dense import DEFAULT_SOLVER, DenseBackend

    backend = DenseBackend(job.problem, job.options.solver or DEFAULT_SOLVER)
    job.mark()
    result = job.optimise(backend, _same, _same)
    job.mark()
    return job.estimate(backend, result, result.state, backend.linearise(result.state), backend.solver)


def _run_schur(job: _Job, make: Callable[[Problem], Any] | None = None) -> Estimate:
    """Compile to arrays, optimise, linearise at the end."""
    from fg_orient.adjustment.named_points import NamedBackend
    from fg_orient.adjustment.schur import SchurBackend

    named = make is None and bool(job.problem.named_points())
    backend: Any = (make or (NamedBackend if named else SchurBackend))(job.problem)
    job.mark()
    with one_blas_thread():
        result = job.optimise(backend, _same, _same)
        job.mark()
        linear = (backend.border if named else backend.linearise)(result.state)
    return job.estimate(backend, result, result.state, linear)


def _same(state: State) -> State:
    return state
