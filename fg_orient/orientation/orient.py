"""Adjustment of a block.

``adjust`` compiles the problem, assesses observability **before** the solution, and runs the backend. It opens the
coordinates of the check points only after the solution.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from factors._preparation import preparing_seconds, working_clock
from fg_orient.adjustment.checkpoint import Checkpoint
from fg_orient.adjustment.constraints import has_constraints, hold, released, tightened
from fg_orient.adjustment.loop import Callback
from fg_orient.adjustment.memory import Need, Parts, within_memory
from fg_orient.adjustment.native import with_observations
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.solve import Estimate, solve
from fg_orient.adjustment.stages import require_possible
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError, finding
from fg_orient.model.machine import return_memory
from fg_orient.model.options import Backend, Datum, Options
from fg_orient.model.parameters import with_options
from fg_orient.orientation.adjusted import AdjustmentResult
from fg_orient.orientation.camera_direction import with_direction
from fg_orient.orientation.conclusion import cofactors_at, conclude
from fg_orient.orientation.confirmation import confirmed
from fg_orient.orientation.solution import Solution
from fg_orient.quality import doubts, regularisation, vendor_datum, verdict
from fg_orient.quality.deficiency import compiled_problem, judge_observability, refuse_deficient, require_determined
from fg_orient.quality.free_network import (
    held_unknowns,
    to_inner_datum,
    with_minimal_datum,
    without_priors,
)
from fg_orient.quality.observability import BlockObservability, ImageObservability
from fg_orient.result.record import Result

if TYPE_CHECKING:
    import gtsam

    from fg_orient.adjustment.parts.execution import Execution
    from fg_orient.orientation.factor_graph import FactorGraph

#: Function of a graph and start values that returns the values of a solution.
Optimizer = Callable[["gtsam.NonlinearFactorGraph", "gtsam.Values"], "gtsam.Values"]
# Observability of the images, and of the whole block.
View = tuple[tuple[ImageObservability, ...], BlockObservability]
#: Function that is called at each stage of the work with its name and the number of image points.
Stage = Callable[[str, int], None]


def adjust(
    block: Block,
    *,
    eop_set: int | str | None = None,
    priors: bool | None = None,
    datum: Datum | None = None,
    backend: Backend | None = None,
    loss: str | None = None,
    snoop: bool | None = None,
    optimizer: str | Optimizer | None = None,
    variance_components: Sequence[str] | None = None,
    options: Options | None = None,
    start: Solution | Result | str | Path | None = None,
    start_prior: bool = False,
    parts: int | None = None,
    workers: int | None = None,
    cluster: Any = None,
    work_dir: str | Path | None = None,
    callback: Callback | None = None,
    stage: Stage | None = None,
    checkpoint: Checkpoint | None = None,
    **more: Any,
) -> Solution:
    """Adjust a block; arguments override the options of its project file.

    Parameters
    ----------
    block : Block
    eop_set : int or str, optional
        Number or name ("PUA").
    priors, datum, backend, loss, snoop, variance_components : optional
        Frequent options, see :class:`fg_orient.Options`. None keeps the value of the block.
    optimizer : str or callable, optional
        Name of an optimiser, or a function that receives the graph (``gtsam.NonlinearFactorGraph``) and the start
        values (``gtsam.Values``) of :func:`fg_orient.factor_graph` and returns the values of the solution.
    options : Options, optional
        Options that replace those of the block.
    start : Solution, Result or path of a result folder, optional
        Earlier result: start values of common images (by id) and ground points.
    start_prior : bool
        Also use the joint cofactors of these images and points as an observation (``fg_orient.orientation.earlier``).
    parts : int, optional
        Number of parts of the ground points (docs/parallel.md). Default with ``workers`` or ``cluster``: chosen by the
        size of the block. The results do not depend on the workers.
    workers : int, optional
        Number of processes of this machine that adjust the parts; 1: only this process.
    cluster : str or dask.distributed.Client, optional
        Scheduler of a running cluster; replaces ``workers``.
    work_dir : path, optional
        Folder for the files of the parts, accessible to all workers.
    callback : callable, optional
        Function that receives an ``IterationRecord`` after each iteration, in every round of a search.
    stage : callable, optional
        Function that is called at the start of each stage with its name and the number of image points.
    checkpoint : Checkpoint, optional
        File for the state of the run, from which it can continue; the caller removes it in the end. A search writes
        only its first round, an estimation of variance components writes nothing.
    **more
        Any other option of :class:`fg_orient.Options`; docs/options.md.

    Returns
    -------
    Solution

    Raises
    ------
    InputError
        The block cannot be adjusted (exit code 2).
    RankDeficientError
        Some directions are unobservable without priors; one problem per direction (exit code 3).
    TypeError
        An argument is not an option.
    """
    block = with_options(block, "adjust")
    block = with_options(
        block if options is None else replace(block, options=options),
        "adjust",
        eop_set=eop_set,
        priors=priors,
        datum=datum,
        backend=backend,
        loss=loss,
        snoop=snoop,
        variance_components=variance_components,
        **more,
    )
    block, begin = with_observations(block), None
    if start is not None:
        from fg_orient.orientation.earlier import continued

        block, begin = continued(block, start, with_prior=start_prior)
    elif start_prior:
        raise InputError.of("earlier.no_start", option="start_prior")
    named = None if callable(optimizer) else optimizer
    block = with_options(block, "adjust", optimizer=named)
    require_possible(block.options)
    block.require_adjustable()
    if block.options.jitter == "auto":
        if callable(optimizer):
            raise InputError.of("graph.own_optimizer", option="jitter")
        from fg_orient.orientation.jitter import adjust_with_jitter

        how = {"start": start, "start_prior": start_prior, "parts": parts, "workers": workers, "cluster": cluster}
        report: dict[str, Any] = {"work_dir": work_dir, "callback": callback, "stage": stage}
        return adjust_with_jitter(block, lambda one: adjust(one, **how, **report))
    doubts.require_acceptances(block.options.accept)
    block = vendor_datum.with_datum(block)
    regularisation.require_possible(block)
    rejected, total = tuple[str, ...](), len(block.observations)
    if block.options.median_rejection is not None:
        from fg_orient.orientation.median_rejection import without_rejected

        block, rejected = without_rejected(block, block.options.median_rejection)
    if callable(optimizer):
        wanted = {
            "snoop": block.options.snoop,
            "variance_components": block.options.variance_components,
            "parts": parts,
            "workers": workers,
            "cluster": cluster,
            "checkpoint": checkpoint,
            "callback": callback,
        }
        if ignored := [name for name, value in wanted.items() if value]:
            raise InputError.of("graph.own_optimizer", option=ignored[0])
        own = _factor_graph(block, "eliminated", begin)
        return own.solution(optimizer(own.graph, own.values))
    shared = not (parts is None and workers is None and cluster is None)
    if work_dir is not None and not shared:
        raise InputError.of("parallel.no_parts", option="work_dir", value=work_dir)
    execution = None
    if shared:
        from fg_orient.adjustment.parts.execution import Execution

        execution = Execution(parts, workers or 1, cluster, work_dir)
    run = _Run(execution, callback, stage, checkpoint, begin)

    def run_with_components(block: Block, begin: State | None) -> Solution:
        from fg_orient.orientation.components import adjust_with_components

        return adjust_with_components(block, run.once, begin)

    special = block.options.datum in ("inner", "vendor") or block.options.regularisation != "none"
    several = block.options.variance_components or special or has_constraints(block)

    def next_round(block: Block, begin: State, like: Problem) -> AdjustmentResult:
        return runner(block, begin) if several else run.again(block, like, begin)

    runner = run_with_components if block.options.variance_components else run.once
    alone = replace(run, callback=None, stage=None, checkpoint=None, begin=None)

    def completed(solution: Solution) -> Solution:
        if rejected:
            from fg_orient.orientation.median_rejection import rejection_finding

            findings = (rejection_finding(rejected, total), *solution.findings)
            solution = replace(solution, findings=findings, rejected=rejected)
        return with_direction(confirmed(solution, alone.once), block, alone.once)

    if not block.options.snoop:
        return completed(runner(block, None))
    from fg_orient.orientation.outlier_search import require_possible_search, search

    require_possible_search(block)
    (memory, block), prepared = run.within_memory(block), preparing_seconds()
    run = run.within(memory)
    first = runner(block, None) if several else run.first(block)
    jit = preparing_seconds() - prepared
    end, record = search(block, first, next_round)
    whole = end.whole(jit) if isinstance(end, SearchRound) else end
    assert isinstance(whole, Solution)
    findings = doubts.with_accepted([*record.findings(), *whole.findings], block.options.accept)
    return completed(replace(whole, snooping=record, findings=tuple(findings), memory=memory))


def _compiled(
    block: Block, *, at_once: bool = True
) -> tuple[Problem, tuple[ImageObservability, ...], BlockObservability, float]:
    """Return the compiled block, the observability of images and block, and the seconds of both steps.

    ``at_once``: see :func:`fg_orient.quality.deficiency.compiled_problem`.
    """
    start, inner = working_clock(), block.options.datum == "inner"
    compiled = compiled_problem(without_priors(block) if inner else block, at_once=at_once)
    observability, block_view = _view(compiled)
    if inner and block_view.null is not None:
        compiled = with_minimal_datum(compiled, block_view.null)
    held = vendor_datum.with_vendor_datum(compiled) if block.options.datum == "vendor" else compiled
    held = regularisation.with_regularisation(held)
    return_memory(len(compiled.observations))
    return held, observability, block_view, working_clock() - start


def _view(compiled: Problem) -> View:
    """Return the observability of images and block; RankDeficientError if directions are undetermined."""
    observability = judge_observability(compiled)
    return observability, refuse_deficient(compiled, observability)


def factor_graph(block: Block, points: Literal["eliminated", "explicit"] = "eliminated") -> FactorGraph:
    """Return the factor graph of a block.

    Parameters
    ----------
    block : Block
        Block whose options choose unknowns, priors and datum. A robust loss is not part of the graph.
    points : str
        "eliminated": variables are the images, and the ground points that extra observations name; each factor contains
        a group of ground points with all their rays. "explicit": images and ground points are variables, with one
        factor for each image point.

    Returns
    -------
    FactorGraph

    Raises
    ------
    InputError
        The block cannot be adjusted, or it has a loss. Points cannot be eliminated in a block without priors.
    RankDeficientError
        Without priors some directions are not observable.
    """
    with_options(block, "factor_graph").require_adjustable()
    return _factor_graph(vendor_datum.with_datum(with_observations(block)), points)


def _factor_graph(
    block: Block, points: Literal["eliminated", "explicit"], begin: Callable[[Problem], State] | None = None
) -> FactorGraph:
    """Return the factor graph of a block without native factors, with another start if given."""
    from fg_orient.orientation.factor_graph import FactorGraph, Prepared

    compiled, observability, block_view, structure = _compiled(block)
    compiled = tightened(compiled)

    def concluded(estimate: Estimate) -> Solution:
        return conclude(compiled, observability, block_view, estimate, structure)

    return FactorGraph(Prepared(compiled, concluded, None if begin is None else begin(compiled)), points)


def adjust_from(block: Block, start: Callable[[Problem], State]) -> Solution:
    """Adjust a block once with its options, from a state of the compiled problem."""
    compiled, observability, block_view, structure = _compiled(block)
    estimate = solve(compiled, start=start(compiled))
    compiled, estimate = released(*hold(compiled, estimate, lambda p, begin, _: solve(p, start=begin)))
    return conclude(compiled, observability, block_view, estimate, structure)


@dataclass(frozen=True)
class _Run:
    """Adjustments with the same callbacks, in this process or in parts; see :func:`adjust`.

    ``begin`` returns the start of the first adjustment, if it is not the start of the problem.
    """

    execution: Execution | None
    callback: Callback | None = None
    stage: Stage | None = None
    checkpoint: Checkpoint | None = None
    begin: Callable[[Problem], State] | None = None

    def once(self, block: Block, begin: State | None = None) -> Solution:
        """Adjust a block once with its options, from a state if given."""
        (memory, block), prepared = self.within_memory(block), preparing_seconds()
        return self.within(memory)._once(block, begin, memory, prepared)

    def _once(self, block: Block, begin: State | None, memory: Need, prepared: float) -> Solution:
        """Adjust a block that fits the memory."""
        self._report("structure", len(block.observations))
        inner = block.options.datum == "inner"
        compiled, observability, block_view, structure = _compiled(block, at_once=self._at_once)
        checkpoint = self.checkpoint if begin is None else None
        if begin is None and self.begin is not None:
            begin = self.begin(compiled)
        estimate = self._solved(compiled, checkpoint, begin)
        compiled, estimate = hold(compiled, estimate, lambda p, begin, n: self._solved(p, None, begin, n))
        compiled, estimate = to_inner_datum(compiled, estimate, solve) if inner else (compiled, estimate)
        compiled, estimate = released(compiled, estimate)
        self._report("statistics", len(compiled.observations))
        solution = conclude(compiled, observability, block_view, estimate, structure)
        return_memory(len(compiled.observations))
        if inner and not len(held_unknowns(compiled)):  # without a datum defect the usual adjustment is sufficient
            code = "solution.no_inner_datum_nor_priors" if block.options.priors else "solution.no_inner_datum"
            findings = doubts.with_accepted([finding(code), *solution.findings], block.options.accept)
            solution = replace(solution, findings=tuple(findings))
        if memory.note is not None:
            solution = replace(solution, findings=(*solution.findings, memory.note))
        return replace(solution, memory=memory, seconds=replace(solution.seconds, jit=preparing_seconds() - prepared))

    def within_memory(self, block: Block) -> tuple[Need, Block]:
        """See ``fg_orient.adjustment.memory.within_memory``."""
        given = self.execution
        return within_memory(
            block, None if given is None else Parts(given.parts, max(given.workers, 1), given.cluster is not None)
        )

    @property
    def _at_once(self) -> bool:
        """True if the arrays of all image points may be in memory."""
        return self.execution is None or self.execution.kept is None

    def within(self, memory: Need) -> _Run:
        """Run in the parts that the memory requires."""
        if memory.kept is None:
            return self
        from fg_orient.adjustment.parts.execution import Execution

        return replace(self, execution=replace(self.execution or Execution(memory.parts), kept=memory.kept))

    def first(self, block: Block) -> SearchRound:
        """Adjust a block for the first time in a search."""
        self._report("structure", len(block.observations))
        compiled, observability, block_view, structure = _compiled(block, at_once=self._at_once)
        begin = None if self.begin is None else self.begin(compiled)
        estimate = self._solved(compiled, self.checkpoint, begin)
        return replace(self._round(compiled, estimate, structure), view=(observability, block_view))

    def again(self, block: Block, like: Problem, begin: State) -> SearchRound:
        """Adjust a block that differs in some observations from the block of ``like``, from a state near the solution.

        Only the values that the choice of the next excluded observations requires are computed.
        """
        start = working_clock()
        self._report("structure", len(block.observations))
        compiled = compiled_problem(block, like)
        require_determined(compiled)
        structure = working_clock() - start
        return self._round(compiled, self._solved(compiled, None, begin), structure)

    def _round(self, compiled: Problem, estimate: Estimate, structure_s: float) -> SearchRound:
        """Return the round of a search."""
        self._report("statistics", len(compiled.observations))
        cofactors, unavailable = cofactors_at(compiled, estimate)
        return SearchRound(
            problem=compiled,
            status=verdict.assess_solution(compiled, estimate, unavailable).status,
            state=estimate.state,
            chi2=estimate.chi2,
            cofactors=cofactors,
            unavailable=unavailable,
            estimate=estimate,
            structure_s=structure_s,
        )

    def _report(self, name: str, count: int) -> None:
        """Report the start of a stage."""
        if self.stage is not None:
            self.stage(name, count)

    def _solved(self, compiled: Problem, checkpoint: Checkpoint | None, begin: State | None, done: int = 0) -> Estimate:
        """Run the optimisation in this process or in parts; records are numbered after ``done`` iterations."""
        own = self.callback
        callback = own if own is None or not done else lambda r: own(replace(r, iteration=done + r.iteration))
        if not done:
            self._report("iterations", len(compiled.observations))
        if self.execution is None:
            return solve(compiled, callback, checkpoint=checkpoint, start=begin)
        from fg_orient.adjustment.parts.solve import solve_in_parts

        return solve_in_parts(compiled, self.execution, callback, checkpoint, begin)


@dataclass(frozen=True, kw_only=True)
class SearchRound(AdjustmentResult):
    """Round of a search; ``whole`` completes the last round. ``view``: observability, if it is known."""

    estimate: Estimate
    structure_s: float
    view: View | None = None

    def whole(self, jit_s: float) -> Solution:
        """Complete this round to a solution."""
        observability, block_view = self.view or _view(self.problem)
        solution = conclude(self.problem, observability, block_view, self.estimate, self.structure_s)
        return replace(solution, seconds=replace(solution.seconds, jit=jit_s))
