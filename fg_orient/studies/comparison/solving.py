"""Engines that solve the adjustment of one compiled problem, with their predicted effort."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from factors._preparation import preparing_seconds
from fg_orient.adjustment.dense import DenseBackend
from fg_orient.adjustment.explicit import ExplicitBackend
from fg_orient.adjustment.explicit_optimisers import ExplicitRun
from fg_orient.adjustment.graph import GraphBackend, ImagesGraph
from fg_orient.adjustment.images_first import images_first
from fg_orient.adjustment.linear import registry
from fg_orient.adjustment.loop import OPTIMIZERS, LoopResult, gauss_newton
from fg_orient.adjustment.optimisers import GTSAM_OPTIMIZERS
from fg_orient.adjustment.penalty import NORMAL_LIMIT, needs_rows
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.reduced_choice import choose, predictions
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.solve import eliminates_points
from fg_orient.model.errors import finding
from fg_orient.model.machine import Effort, calm_memory, measured
from fg_orient.studies.comparison.model import GRAPH_SOLVER, LOOP_SOLVER, OWN_CHOICE, REDUCED_LABELS
from fg_orient.studies.comparison.work import Sparsity, Work


@dataclass(frozen=True)
class Engine:
    """Engine: one way to solve the adjustment.

    Parameters
    ----------
    backend, solver, optimizer : str
        Columns of the engine's row.
    run : callable
        Function that solves a problem from a state with a maximum number of iterations.
    work : callable
        Function that predicts the effort.
    impossible : str
        Reason why the engine cannot solve this problem; "" if it can.
    note : str
        Remark for the row.
    """

    backend: str
    solver: str
    optimizer: str
    run: Callable[[Problem, State, int], LoopResult[State]]
    work: Callable[[], Work]
    impossible: str = ""
    note: str = ""


class Engines:
    """Engines that can solve a problem.

    Parameters
    ----------
    problem : Problem
    sparsity : Sparsity
    """

    def __init__(self, problem: Problem, sparsity: Sparsity) -> None:
        self.problem, self.sparsity = problem, sparsity

    def of(self, backend: str, solvers: tuple[str, ...]) -> list[Engine]:
        """Return the engines of a backend; ``solvers`` are the solvers of full matrices."""
        if backend == "dense":
            return self._dense(solvers)
        return {"schur": self._schur, "explicit": self._explicit, "graph": self._graph}[backend]()

    def _dense(self, solvers: tuple[str, ...]) -> list[Engine]:
        optimizer, u = self.problem.block.options.optimizer, self.problem.n_unknowns

        def engine(name: str) -> Engine:
            damped = registry.solver(name).family == "tikhonov"
            return Engine(
                "dense", name, optimizer, _by_loop(lambda p: DenseBackend(p, name, max(u, 1)), optimizer),
                lambda: self.sparsity.dense(name), str(finding("compare.damped", place=name)) if damped else "",
            )  # fmt: skip

        return [engine(name) for name in solvers]

    def _schur(self) -> list[Engine]:
        """Return engines with each method for the reduced system.

        The program's own method has each optimiser.
        """
        problem, sparsity = self.problem, self.sparsity
        named = bool(problem.named_points())
        possible = {one.kind for one in predictions(sparsity.pattern, sparsity.band)} | {
            "dense",
            "iterative",
            "implicit",
        }
        chosen = "dense" if problem.ties is not None else choose(sparsity.pattern, sparsity.band).kind
        rest = [kind for kind in REDUCED_LABELS if kind != chosen]

        def engine(kind: str, optimizer: str) -> Engine:
            why = ""
            if named:
                why = str(finding("compare.named", place=f"schur {kind}"))
            elif problem.ties is not None and kind != "dense":
                why = str(finding("compare.shared", place=f"schur {kind}"))
            elif kind not in possible:
                why = str(finding("compare.full", place=f"schur {kind}"))
            elif needs_rows(problem):
                why = self._ill_conditioned(f"schur {kind}")
            return Engine(
                "schur", kind, optimizer, _by_loop(lambda p: SchurBackend(p, reduced=kind), optimizer),
                lambda: sparsity.schur(kind), why, OWN_CHOICE if kind == chosen else "",
            )  # fmt: skip

        return [engine(chosen, name) for name in OPTIMIZERS] + [engine(kind, "gauss-newton") for kind in rest]

    def _ill_conditioned(self, engine: str) -> str:
        """Return the reason why engines that form normal equations are not tried."""
        assert self.problem.regularisation is not None
        condition = self.problem.regularisation.condition
        return str(finding("compare.ill_conditioned", place=engine, condition=condition, limit=NORMAL_LIMIT))

    def _explicit(self) -> list[Engine]:
        """Return engines on the graph with a factor for each image point.

        These engines are our Gauss-Newton over GTSAM's elimination, and GTSAM's optimisers.
        """

        def run(optimizer: str, problem: Problem, start: State, most: int) -> LoopResult[State]:
            return ExplicitRun(problem, optimizer).run(start, most)

        def loop(problem: Problem, start: State, most: int) -> LoopResult[State]:
            backend = ExplicitBackend(problem)
            result = gauss_newton(backend, backend.values(start), most)
            state = backend.state(result.state)
            return LoopResult(state, result.error, result.log, result.converged, result.end, result.iterations)

        work = partial(self.sparsity.explicit, native=True)
        native = [Engine("explicit", GRAPH_SOLVER, name, partial(run, name), work) for name in GTSAM_OPTIMIZERS]
        own = Engine("explicit", LOOP_SOLVER, "gauss-newton", loop, self.sparsity.explicit)
        return [own, *native]

    def _graph(self) -> list[Engine]:
        """Return engines with GTSAM's optimisers on the graph whose factors eliminate the points."""
        first = images_first(self.problem)
        impossible = "" if first or eliminates_points(self.problem) else str(finding("compare.not_eliminated"))
        if needs_rows(self.problem):
            impossible = self._ill_conditioned("graph")

        def run(optimizer: str, problem: Problem, start: State, most: int) -> LoopResult[State]:
            backend = ImagesGraph(problem) if first else GraphBackend(problem, grouped=False)
            return GTSAM_OPTIMIZERS[optimizer](backend, start, most)

        return [Engine("graph", GRAPH_SOLVER, name, partial(run, name), self.sparsity.graph, impossible)
                for name in GTSAM_OPTIMIZERS]  # fmt: skip


def _by_loop(make: Callable[[Problem], Any], optimizer: str) -> Callable[[Problem, State, int], LoopResult[State]]:
    """Run our optimiser on a backend."""

    def run(problem: Problem, start: State, most: int) -> LoopResult[State]:
        backend = make(problem)
        result: LoopResult[State] = OPTIMIZERS[optimizer](backend, start, most)
        return result

    return run


def timed(engine: Engine, problem: Problem) -> tuple[LoopResult[State], Effort]:
    """Return the result and the effort of an engine.

    Repeat the run if kernels were compiled or loaded in it.
    """
    while True:
        prepared = preparing_seconds()
        with np.errstate(all="ignore"), calm_memory(), measured() as effort:
            result = engine.run(problem, problem.start, problem.block.options.max_iterations)
        if preparing_seconds() == prepared:
            return result, effort
