"""Engines of a comparison. Each engine computes a row for an EOP set and a solver; a failure also gives a row.

With each set, the block is adjusted once as :func:`fg_orient.adjust` does it, with all
statistics. The other engines solve the same compiled problem without statistics. Each of
them begins at the start values. With a loss, they use its final weights.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from typing import Any, cast

import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.explicit_optimisers import ExplicitRun
from fg_orient.adjustment.graph import GraphBackend
from fg_orient.adjustment.images_first import images_first
from fg_orient.adjustment.linear.system import singular_values
from fg_orient.adjustment.loop import LoopResult
from fg_orient.adjustment.penalty import penalty_squares, without_penalties
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.solve import eliminates_points, first_sentence
from fg_orient.model.block import Block
from fg_orient.model.errors import FgOrientError
from fg_orient.model.machine import measured
from fg_orient.model.names import Status
from fg_orient.model.options import Backend, Optimizer
from fg_orient.orientation.conclusion import accuracy_at
from fg_orient.orientation.orient import adjust
from fg_orient.orientation.solution import Solution
from fg_orient.quality.accuracy import PointDifferences
from fg_orient.quality.deficiency import judge_observability
from fg_orient.quality.observability import affordable, analyse_block
from fg_orient.studies.comparison import reference, work
from fg_orient.studies.comparison.model import (
    AXES,
    GRAPH_SOLVER,
    UNREGULARISED,
    Direction,
    Row,
    Spectrum,
)
from fg_orient.studies.comparison.published_rows import axes, conditioning, one_line, row, spectra_of
from fg_orient.studies.comparison.selections import regularisation_of
from fg_orient.studies.comparison.set_results import SetResult, of_failure, of_solution
from fg_orient.studies.comparison.solving import Engine, Engines, timed
from fg_orient.studies.comparison.work import Limits, Sparsity

#: The condition number of the reduced matrix is computed up to this number of image unknowns.
CONDITIONED = 1000


class Adjustments:
    """Adjustments of the block with one EOP set: by :func:`fg_orient.adjust`, and by each engine.

    Parameters
    ----------
    block : Block
        Block whose options choose the regularisation.
    eop_set : int
    limits : Limits

    Raises
    ------
    InputError
        The block cannot be adjusted with any set.
    """

    def __init__(self, block: Block, eop_set: int, limits: Limits) -> None:
        self.block, self.eop_set = replace(block, options=replace(block.options, eop_set=eop_set)), eop_set
        self._limits, self.regularisation = limits, regularisation_of(self.block.options)
        self.failure, self.solution = "", cast(Solution | None, None)
        try:
            with np.errstate(all="ignore"), measured() as effort:
                self.solution = adjust(self.block)
            self.problem = _least_squares(self.solution)
            self.result: SetResult = of_solution(eop_set, self.solution, effort.processor_s)
        except FgOrientError as error:
            self.failure, self.problem = one_line(error), compile_problem(self.block)
            self.result = of_failure(eop_set, self.failure, self.problem, self.regularisation)
        self.sparsity = Sparsity(self.problem)
        self.spectra: tuple[Spectrum, ...] = ()
        self.directions = directions_of(self.problem)
        self.matrix: dict[str, Any] = {"order": self.problem.n_unknowns}
        # five decompositions and the matrix take most of the time of small blocks
        svd = replace(self.sparsity.dense("svd"), seconds=5.0 * self.sparsity.dense("svd").operations / work.RATE)
        penalty_is_unknown = self.failure and self.regularisation != UNREGULARISED
        if not limits.reason("svd", svd) and not penalty_is_unknown:
            self._describe()

    def _describe(self) -> None:
        """Compute singular values at the start, with and without priors, in raw, column-scaled and prior units."""
        design = self._at_start[1]
        is_regularised = self.regularisation != UNREGULARISED
        system = f"adjustment, {self.regularisation}" if is_regularised else "adjustment"
        physical = _per_physical_unit(self.problem, design)
        raw, columns = spectra_of(physical, self.eop_set, system)
        spectra = [raw, columns, Spectrum(self.eop_set, system, "priors", singular_values(design))]
        self.matrix |= conditioning(raw, columns, len(design))
        if self.block.options.priors or is_regularised:
            free = _without_priors(self.problem)
            spectra += spectra_of(_per_physical_unit(self.problem, free), self.eop_set, "no priors")
            spectra.append(Spectrum(self.eop_set, "no priors", "priors", singular_values(free)))
        self.spectra = tuple(spectra)

    @cached_property
    def _at_start(self) -> tuple[Array, Array]:
        """Return residuals (n,) and Jacobian (n, u) at the start.

        Columns of shared unknowns are summed.
        """
        return _rows_at(self.problem, self.problem.start)

    def engines(self, backend: str, solvers: tuple[str, ...]) -> list[Engine]:
        """Return the engines of a backend for this problem; ``solvers`` are the solvers of full matrices."""
        return Engines(self.problem, self.sparsity).of(backend, solvers)

    def run(self, engine: Engine) -> Row:
        """Run an engine and return its row."""
        new = partial(
            row, self.eop_set, engine.solver, engine.backend, optimizer=engine.optimizer, kappa=self.result.kappa,
            regularisation=self.regularisation, notes=(engine.note,) if engine.note else (), **self.matrix,
        )  # fmt: skip
        if reason := self.failure or engine.impossible:
            return new(failure=reason, left_out=not self.failure)
        predicted = engine.work()
        new = partial(new, **predicted.columns())
        if reason := self._limits.reason(f"{engine.backend} {engine.solver}", predicted):
            return new(failure=reason, left_out=True)
        options = replace(self.problem.block.options, optimizer=cast(Optimizer, engine.optimizer))
        if engine.backend in ("dense", "schur", "graph"):
            options = replace(options, backend=cast(Backend, engine.backend))
        problem = replace(self.problem, block=replace(self.problem.block, options=options))
        try:
            result, effort = timed(engine, problem)
        except FgOrientError as error:
            return new(failure=one_line(error))
        except RuntimeError as error:
            return new(failure=first_sentence(error))
        values: dict[str, Any] = {"iterations": result.iterations or len(result.log), **vars(effort)}
        if not result.converged:
            return new(failure=str(result.end), **values)
        return new(**values, **self._of_state(result), **self._of_step(engine, problem), **self._of_reduced(engine))

    def _of_state(self, result: LoopResult[State]) -> dict[str, Any]:
        """Return the columns of a row that describe the solution."""
        problem, state = self.problem, result.state
        accuracy = accuracy_at(problem, state)
        redundancy = problem.redundancy
        squares = 2.0 * result.error - penalty_squares(problem, state)
        sigma0 = float(np.sqrt(squares / redundancy)) if redundancy > 0 else np.nan
        out = {"sigma0": sigma0, **_accuracy("control", accuracy.control), **_accuracy("check", accuracy.check)}
        if self.solution is None or self.solution.status is Status.NOT_CONVERGED:
            return out
        theirs = self.solution.state
        apart = np.abs(state.ground - theirs.ground)
        return out | {
            "difference_sigmas": float(np.abs(state.image - theirs.image).max()),
            "difference_m": float(np.nanmax(apart)) if np.isfinite(apart).any() else np.nan,
        }

    @cached_property
    def _common(self) -> tuple[State, Array | None]:
        """Return the state at which all engines are linearised, and the exact Gauss-Newton step of the images there.

        The graph intersects its points again before it linearises. Therefore the state of
        the graph is used for all engines.
        """
        problem, state = self.problem, self.problem.start
        if self.problem.n_unknowns > reference.LIMIT:
            return state, None
        if not images_first(problem) and eliminates_points(problem):
            backend = GraphBackend(problem, grouped=False)
            values = backend.values(state)
            backend.linearised(values)
            state = backend.state(values)
        residual, design = _rows_at(problem, state)
        step = reference.exact(design, -residual)
        return state, None if step is None else step[: problem.n_free_unknowns]

    def _of_step(self, engine: Engine, problem: Problem) -> dict[str, float]:
        """Return the forward error of the first Gauss-Newton step, for the image unknowns in prior sigmas."""
        state, exact = self._common
        if exact is None or engine.optimizer != "gauss-newton":
            return {}
        if engine.backend == "explicit" and engine.solver == GRAPH_SOLVER:
            after = ExplicitRun(problem, engine.optimizer).step(state)
        else:
            after = engine.run(problem, state, 1).state
        step = problem.image_vector(after) - problem.image_vector(state)
        return {"forward_error": reference.forward_error(step, exact)}

    @cached_property
    def _cond_reduced(self) -> float:
        """Return the condition number of the reduced normal matrix at the solution; nan without its inverse."""
        if self.solution is None or self.solution.cofactors is None or self.problem.ties is not None:
            return np.nan
        if self.problem.n_image_unknowns > CONDITIONED:
            return np.nan
        return float(np.linalg.cond(self.solution.cofactors.joint(tuple(range(self.problem.n_images)), ())))

    def _of_reduced(self, engine: Engine) -> dict[str, float]:
        return {"cond_reduced": self._cond_reduced} if engine.backend in ("schur", "graph") else {}


def _least_squares(solution: Solution) -> Problem:
    """Return the problem of a solution; with a loss, the least-squares problem with the weights at the solution."""
    problem = solution.weighted
    if solution.weights is None:
        return problem
    options = replace(problem.block.options, loss="none", gnc=False, robust_scale="prior", robust_start="huber")
    return replace(problem, block=replace(problem.block, options=options))


def _rows_at(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return residuals (n,) and Jacobian (n, u) in which shared unknowns occur once."""
    residual, design = assemble(problem, state)
    return residual, design if problem.ties is None else problem.ties.columns(design)


def directions_of(compiled: Problem) -> tuple[Direction, ...]:
    """Return the directions that the image observations do not determine: of each image, then of the whole block."""
    number, out = compiled.block.options.eop_set, list[Direction]()
    for image in judge_observability(compiled):
        words = [text.removeprefix(f"image {image.image}: ") for text in image.sentences]
        out += [Direction(number, image.image, text, "nothing") for text in words]
        out += [Direction(number, image.image, text, "prior") for text in image.held]
    view = analyse_block(compiled) if affordable(compiled) else None
    block = () if view is None else (*view.datum, *view.on_board)
    return (*out, *(Direction(number, "", text.removeprefix("block: "), "prior") for text in block))


def _accuracy(role: str, differences: PointDifferences) -> dict[str, float]:
    statistics = differences.statistics()
    return axes(role, np.array([statistics.get(f"rmse_ecef_{axis}_m", np.nan) for axis in AXES]))


def _per_physical_unit(compiled: Problem, design: Array) -> Array:
    """Convert columns from prior sigmas to m, m/s and rad.

    Columns of ground points are already per metre.
    """
    scale = np.ones(design.shape[1])
    scale[: compiled.n_free_unknowns] = compiled.free(np.concatenate([p.sigma for p in compiled.parameters]))
    return design / scale


def _without_priors(compiled: Problem) -> Array:
    """Return the rows of the observations only, that is, of the block without priors and penalty."""
    options, plain = replace(compiled.block.options, priors=False), without_penalties(compiled)
    free = replace(plain, block=replace(plain.block, options=options))
    return _rows_at(free, free.start)[1]
