"""The graph backend: image vectors as variables, groups of ground points eliminated inside GTSAM factors.

Each factor holds a group of ground points with all their rays (:mod:`fg_orient.adjustment.eliminated`) and links the
images that see them. Priors are GTSAM's prior factors; an extra observation of images is a factor of its own. GTSAM's
Gauss-Newton, Levenberg-Marquardt or Dogleg solve this graph (:mod:`fg_orient.adjustment.optimisers`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from functools import cached_property

import gtsam
import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.graph import eliminated_factor
from fg_orient.adjustment.border import Border, divided, small_enough
from fg_orient.adjustment.eliminated import Elimination
from fg_orient.adjustment.explicit import (
    ExplicitBackend,
    ExplicitSystem,
    add_image_priors,
    build_graph,
    extra_factor,
    point_key,
    vector_keys,
)
from fg_orient.adjustment.problem import Problem, State, no_point_is_named
from fg_orient.adjustment.reduced_graph import GroupSums, ReducedGraph, free_unknowns
from fg_orient.adjustment.robust import Robust
from fg_orient.adjustment.schur import SchurSystem
from fg_orient.adjustment.schur_reduced import Singular

Index = npt.NDArray[np.int64]


def group_factor(elimination: Elimination, g: int, keys: Mapping[int, int], label: str) -> gtsam.CustomFactor:
    """Factor of group g; it refers to the elimination alone, as a reference to the graph would keep that for ever.

    Parameters
    ----------
    elimination : Elimination
    g : int
    keys : mapping
        GTSAM key of each vector of unknowns by its number, see :func:`point_groups.vector_parts`.
    label : str
        Names the group in messages.
    """
    vectors = [(keys[n], part) for n, part in elimination.parts.items()]
    own = [keys[n] for n in elimination.groups[g].vectors]

    def evaluate(values: gtsam.Values, accepted: bool) -> tuple[Array, Array | None]:
        x = np.concatenate([values.atVector(key) for key in own])
        rows = elimination.rows(g, x, lambda: free_unknowns(values, vectors), accepted=accepted)
        return rows.error, rows.jacobian if accepted else None

    sizes = [part.stop - part.start for key, part in vectors if key in own]
    return eliminated_factor(own, sizes, evaluate, label=label)


class GraphBackend:
    """The problem as a GTSAM graph over its images, and the ground points that extra observations name.

    Parameters
    ----------
    problem : Problem
    threads : int, optional
        Of the kernels.
    grouped : bool
        False: one factor for all groups of points. The optimisers need the sums of all groups only.
    """

    name = "graph"

    def __init__(self, problem: Problem, threads: int | None = None, *, grouped: bool = True) -> None:
        self.problem = problem
        #: Ground points that are variables of the graph.
        self.points = np.array(problem.named_points(), np.int64)
        reduced, explicit = divided(problem)
        self.elimination = Elimination(reduced, threads, grouped=grouped)
        self.robust: Robust | None = None
        self._vectors = vector_keys(problem)
        self._prior = 1.0 if problem.block.options.priors else 0.0
        #: Factors that are not groups of points: priors, extra observations, and the rays of named points.
        self.others = gtsam.NonlinearFactorGraph()
        if explicit is not None:
            self.others.push_back(build_graph(explicit))
        else:
            add_image_priors(self.others, problem)
            for extra in problem.block.extra:
                self.others.add(extra_factor(extra, problem))
        self.graph = gtsam.NonlinearFactorGraph()
        #: GTSAM key of each vector of unknowns, by its number.
        self.keys = keys = dict(zip(self.elimination.parts, [key for key, _ in self._vectors], strict=True))
        for g, group in enumerate(self.elimination.groups):
            images = ", ".join(problem.block.images[k].id for k in group.images[:3].tolist())
            self.graph.add(group_factor(self.elimination, g, keys, f"group {g} (images {images} ...)"))
        self.graph.push_back(self.others)
        self.sums = GroupSums(self.elimination, keys, alone=explicit is None and not problem.block.extra)

    def factors_of_point(self, j: int) -> list[gtsam.NonlinearFactor]:
        """Factor of the group that holds the rays of ground point j; none for a point without rays."""
        place = np.flatnonzero(self.elimination.backend.structure.number == j)
        return [
            self.graph.at(g) for g, group in enumerate(self.elimination.groups)
            if ((place >= group.places[0]) & (place < group.places[1])).any()
        ]  # fmt: skip

    def values(self, state: State) -> gtsam.Values:
        """GTSAM values of a state; the eliminated ground points become the start of the next intersections."""
        values, vector = gtsam.Values(), self.problem.image_vector(state)
        for key, part in self._vectors:
            values.insert(key, vector[part])
        for j in self.points.tolist():
            values.insertPoint3(point_key(j), state.ground[j])
        self.elimination.start_at(vector, state.ground)
        return values

    def free(self, values: gtsam.Values) -> Array:
        """Image unknowns (u,) of GTSAM values."""
        return free_unknowns(values, self._vectors)

    def state(self, values: gtsam.Values, free: Array | None = None, *, complete: bool = False) -> State:
        """State of values, with image unknowns (u,), that were evaluated last; see :meth:`Elimination.state`."""
        state = self.elimination.state(self.free(values) if free is None else free, complete=complete)
        for j in self.points.tolist():
            state.ground[j] = values.atPoint3(point_key(j))
        return state

    def linearised(self, values: gtsam.Values, free: Array | None = None) -> ReducedGraph:
        """Graph for one iteration of an optimiser at these values, with image unknowns (u,)."""
        return ReducedGraph(self, values, self.free(values) if free is None else free)

    @cached_property
    def ordering(self) -> gtsam.Ordering:
        """Order of elimination of the graph."""
        return self.graph.orderingCOLAMD()

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``robust.RobustBackend``; image points in the order of the structure."""
        return self.elimination.backend.squares(state)

    def linearise(self, state: State) -> SchurSystem | Border | ExplicitSystem:
        """Linearise at a solution, for cofactors: arrays, or all rows where these do not determine the unknowns."""
        self.elimination.release()
        if not no_point_is_named(self.problem.block):
            self.elimination.backend.buffers.release()
            with contextlib.suppress(Singular):
                if self.robust is None and small_enough(self.problem):
                    return Border(self.problem, state)
            explicit = ExplicitBackend(self.problem)
            explicit.robust = self.robust
            return explicit.linearise(explicit.values(state))
        self.elimination.backend.robust = self.robust
        return self.elimination.backend.linearise(state)
