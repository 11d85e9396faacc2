"""Factor graph of a block for users of GTSAM: graph, values, keys and names, and the solution at any values."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from factors._preparation import working_clock
from factors.arrays import Array
from fg_orient.adjustment.penalty import penalty_squares
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.runtime import one_blas_thread
from fg_orient.adjustment.solve import Estimate, eliminates_points
from fg_orient.model.errors import InputError, finding
from fg_orient.orientation.solution import Solution

if TYPE_CHECKING:
    import gtsam

Points = Literal["eliminated", "explicit"]


@dataclass(frozen=True)
class Prepared:
    """Compiled block, a function that makes a solution from an estimate, and optionally another start."""

    problem: Problem
    conclude: Callable[[Estimate], Solution]
    start: State | None = None


@dataclass(frozen=True, repr=False)
class FactorGraph:
    """Factor graph of a block, see :func:`fg_orient.factor_graph`.

    Vectors of images are corrections in units of their prior sigmas, zero at the metadata, in the order of
    ``solution.problem.parameters``. Ground points are in metres relative to ``origin_m`` (ECEF), with axes parallel to
    ECEF.

    Parameters
    ----------
    prepared : Prepared
    points : str
        "eliminated" or "explicit".
    """

    prepared: Prepared
    points: Points
    _backend: Any = field(init=False)

    def __post_init__(self) -> None:
        problem = self.prepared.problem
        if problem.block.options.loss != "none":
            raise InputError.of("graph.loss", option="loss", value=problem.block.options.loss)
        if self.points == "eliminated":
            from fg_orient.adjustment.graph import GraphBackend

            if not eliminates_points(problem):
                raise InputError.of("graph.no_priors", place="priors", value="false")
            object.__setattr__(self, "_backend", GraphBackend(problem))
        else:
            from fg_orient.adjustment.explicit import ExplicitBackend

            object.__setattr__(self, "_backend", ExplicitBackend(problem))

    def __repr__(self) -> str:
        n = self.graph.size()
        return f"<FactorGraph of {self.prepared.problem.block.name[:60]}: {n} factors, points {self.points}>"

    @property
    def graph(self) -> gtsam.NonlinearFactorGraph:
        """The graph."""
        graph: gtsam.NonlinearFactorGraph = self._backend.graph
        return graph

    @property
    def values(self) -> gtsam.Values:
        """Start values."""
        values: gtsam.Values = self._backend.values(self.prepared.start or self.prepared.problem.start)
        return values

    @property
    def origin_m(self) -> Array:
        """Origin (3,) of the ground points, ECEF m."""
        return self.prepared.problem.origin_m

    def key(self, name: str) -> int:
        """Return the GTSAM key of "image:ID", "point:ID" or "shared:ID" (unknowns that images share under an id).

        Raises
        ------
        InputError
            There is no such name, or it has no variable in this graph.
        """
        key = self._names().get(name)
        if key is None:
            raise InputError.of("graph.name", place=self.prepared.problem.block.name, value=name)
        return key

    def name(self, key: int) -> str:
        """Return the name of a GTSAM key; KeyError if no variable has this key."""
        return {key: name for name, key in self._names().items()}[key]

    def factors(self, name: str) -> list[Any]:
        """Return the factors of an image, shared id or ground point; for an eliminated point, the factor with its rays.

        Raises
        ------
        InputError
            There is no such name, or no factor has it as a variable or among its eliminated points.
        """
        place = self.prepared.problem.block.find(name)
        if self.points == "eliminated" and place is not None and place[0] == "point" and name not in self._names():
            if held := self._backend.factors_of_point(place[1]):
                return list(held)
        key = self.key(name)
        return [f for f in (self.graph.at(n) for n in range(self.graph.size())) if key in f.keys()]

    def _names(self) -> dict[str, int]:
        """Return the key of each variable by its name."""
        from fg_orient.adjustment.explicit import key_names, point_key

        problem = self.prepared.problem
        out = {name: key for key, name in key_names(problem).items()}
        points = self._backend.points if self.points == "eliminated" else np.flatnonzero(problem.active)
        return out | {f"point:{problem.block.points.ids[j]}": point_key(j) for j in points.tolist()}

    def solution(self, values: gtsam.Values) -> Solution:
        """Return the solution at values, with all statistics; it is converged if the whitened gradient is near zero.

        Raises
        ------
        NoSolutionError
            Rays of a ground point do not intersect at these values.
        """
        from fg_orient.adjustment.optimisers import REMAINING

        begin = working_clock()
        with one_blas_thread():
            error, state = float(self.graph.error(values)), self._state(values)
            if self.points == "eliminated":
                self._backend.elimination.require_possible()
            gradient, step = self._gradient(values)
            linear = self._linear(values, state)
        converged = gradient <= REMAINING
        end = finding("loop.given" if converged else "loop.gradient_left", step=step, gradient=gradient)
        chi2 = 2.0 * error - penalty_squares(self.prepared.problem, state)
        return self.prepared.conclude(
            Estimate(state, chi2, converged, end, (), 0, "graph", "", linear, 0.0, working_clock() - begin)
        )

    def gradient(self, values: gtsam.Values) -> float:
        """Return ``sqrt(g^T N^-1 g)``, the length of the next Gauss-Newton step in standard deviations."""
        return self._gradient(values)[0]

    def _gradient(self, values: gtsam.Values) -> tuple[float, float]:
        """Return the whitened gradient, and the largest element of the next Gauss-Newton step."""
        linear = self.graph.linearize(values)
        step = linear.optimize(self._backend.ordering)
        return math.sqrt(max(-float(linear.gradientAtZero().dot(step)), 0.0)), float(np.abs(step.vector()).max())

    def _state(self, values: gtsam.Values) -> State:
        if self.points == "eliminated":
            state: State = self._backend.state(values, complete=True)
            return state
        explicit: State = self._backend.state(values)
        return explicit

    def _linear(self, values: gtsam.Values, state: State) -> Any:
        return self._backend.linearise(state if self.points == "eliminated" else values)
