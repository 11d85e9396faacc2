"""GTSAM's own Gauss-Newton, Levenberg-Marquardt and Dogleg on the explicit graph, for comparisons.

An adjustment solves the explicit graph by :mod:`fg_orient.adjustment.loop`. Here GTSAM's
optimiser iterates until the cost no longer decreases. The remaining step of Gauss-Newton
shows whether this is the solution.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import gtsam
import numpy as np

from fg_orient.adjustment.explicit import ExplicitBackend, point_key, vector_keys
from fg_orient.adjustment.loop import ROUNDING_STEP, SMALL, LoopResult, exhausted
from fg_orient.adjustment.optimisers import DAMPING, RADIUS, native
from fg_orient.adjustment.problem import Problem, State
from fg_orient.model.errors import Finding, InputError, finding

#: The run ends if the relative decrease of the cost in an iteration is below this.
DECREASE: Final = 1e-12


class ExplicitRun:
    """Run of one of GTSAM's optimisers on the explicit graph of a problem.

    Parameters
    ----------
    problem : Problem
    kind : str
        "gauss-newton", "levenberg-marquardt" or "dogleg".

    Raises
    ------
    InputError
        The options have a loss.
    """

    def __init__(self, problem: Problem, kind: str) -> None:
        options = problem.block.options
        if options.loss != "none":
            raise InputError.of("graph.loss", option="loss", value=options.loss)
        # the backend makes factors from the rows of figures only for Dogleg, so this optimiser is set
        own = replace(problem, block=replace(problem.block, options=replace(options, optimizer="dogleg")))
        self.backend, self.kind = ExplicitBackend(own), kind
        self.graph, self.ordering = self.backend.graph, self.backend.ordering
        self.values = self.backend.initial()

    def run(self, start: State, max_iterations: int) -> LoopResult[State]:
        """Iterate from a state; the last step is one of Gauss-Newton.

        RuntimeError: the equations are singular.
        """
        self.values = self.backend.values(start)
        control = {"levenberg-marquardt": DAMPING, "dogleg": RADIUS}.get(self.kind, 0.0)
        optimizer = native(self.kind, self, control, 0.0)
        iterations, before = 0, float(optimizer.error())
        while iterations < max_iterations:
            optimizer.iterate()
            iterations, after = iterations + 1, float(optimizer.error())
            if not before - after > DECREASE * before:
                break
            before = after
        else:
            return self._end(optimizer.values(), False, exhausted(max_iterations), iterations)
        values = optimizer.values()
        step = self.backend.linearise(values).solve(0.0)
        converged = step.length < ROUNDING_STEP
        end = SMALL if converged else finding("loop.step_left", step=step.length)
        return self._end(self.backend.retract(values, step), converged, end, iterations)

    def step(self, start: State) -> State:
        """Return the state after one step of Gauss-Newton."""
        values = self.backend.values(start)
        return self.backend.state(self.backend.retract(values, self.backend.linearise(values).solve(0.0)))

    def _end(self, values: gtsam.Values, converged: bool, end: Finding, iterations: int) -> LoopResult[State]:
        state = self.backend.state(values)
        return LoopResult(state, self.backend.error(values), (), converged, end, iterations)


def elimination_seconds(problem: Problem, order: Sequence[int]) -> float:
    """Return the processor seconds of one Cholesky elimination of the explicit graph at the start, clique by clique.

    Parameters
    ----------
    problem : Problem
    order : sequence of int
        Variables, numbered as in ``graph_structure.explicit_structure``.

    Raises
    ------
    RuntimeError
        The equations are singular.
    """
    backend = ExplicitBackend(problem)
    keys = [key for key, _ in vector_keys(problem)]
    keys += [point_key(int(j)) for j in np.flatnonzero(problem.active)]
    ordering = gtsam.Ordering()
    for v in order:
        ordering.push_back(keys[v])
    linear = backend.linearise(backend.initial()).linear
    start = time.process_time()
    linear.optimize(ordering)
    return time.process_time() - start
