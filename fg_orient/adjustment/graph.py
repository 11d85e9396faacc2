"""The graph backend: image vectors as variables, ground points eliminated (:mod:`fg_orient.adjustment.eliminated`).

In the public graph and for iSAM2, each factor contains a group of ground points with all
their rays and links the images that see them (:func:`group_factor`). In ``adjust``,
GTSAM's Gauss-Newton, Levenberg-Marquardt or Dogleg get the sums over all points instead,
as a new graph for each iteration (:mod:`fg_orient.adjustment.reduced_graph`). The normal
equations are the same. Priors are GTSAM's prior factors; an extra observation of images
is a separate factor.

In long sequences points and shared unknowns form one variable, the border, and images are
eliminated (:class:`ImagesGraph`). For given unknowns x of this border
(:mod:`fg_orient.adjustment.images_first`) each image is oriented again from its points
(variable projection: Golub & Pereyra 1973), and eliminated. The result is a function of x
alone, with the cost c(x), its gradient g(x) and the reduced normal matrix S(x) of
Gauss-Newton. For each iteration, GTSAM's optimisers receive a Hessian factor with S and
g, and a factor of the cost, as with eliminated points
(:mod:`fg_orient.adjustment.reduced_graph`). Images are oriented by Newton's steps. They
begin at the orientation that the last linearised solution predicts for the step of the
border. The elimination contains one further step. A step that does not decrease the cost
is halved.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from functools import cached_property
from typing import Final

import gtsam
import numpy as np
import numpy.typing as npt

from factors._contract import NotFiniteError
from factors.arrays import Array
from factors.conditions.control import POINT
from factors.graph import eliminated_factor
from fg_orient.adjustment.border import Border, ImagesBorder, divided, small_enough
from fg_orient.adjustment.eliminated import IMPOSSIBLE, INTERSECTED, MAX_STEPS, Elimination
from fg_orient.adjustment.explicit import (
    ExplicitBackend,
    ExplicitSystem,
    add_image_priors,
    build_graph,
    extra_factor,
    point_key,
    vector_keys,
)
from fg_orient.adjustment.images_first import Images, Places
from fg_orient.adjustment.problem import Problem, State, no_point_is_named
from fg_orient.adjustment.reduced_graph import GroupSums, ReducedGraph, cost_factor, free_unknowns
from fg_orient.adjustment.robust import Robust, Weighing, squares, weighted_problem, weights_at
from fg_orient.adjustment.schur import SchurSystem
from fg_orient.adjustment.schur_reduced import Singular

Index = npt.NDArray[np.int64]


def group_factor(elimination: Elimination, g: int, keys: Mapping[int, int], label: str) -> gtsam.CustomFactor:
    """Return the factor of group g.

    Parameters
    ----------
    elimination : Elimination
    g : int
    keys : mapping
        GTSAM key of each vector of unknowns by its number, see :func:`point_groups.vector_parts`.
    label : str
        Name of the group in messages.
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
    """Problem as a GTSAM graph over its images, and over the ground points named by extra observations.

    Parameters
    ----------
    problem : Problem
    threads : int, optional
        Number of threads of the kernels.
    grouped : bool
        False: one factor for all groups of points. The optimisers need only the sums of all groups.
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
        """Return the factor of the group with the rays of ground point j; None for a point without rays."""
        place = np.flatnonzero(self.elimination.backend.structure.number == j)
        return [
            self.graph.at(g)
            for g, group in enumerate(self.elimination.groups)
            if ((place >= group.places[0]) & (place < group.places[1])).any()
        ]

    def values(self, state: State) -> gtsam.Values:
        """Return GTSAM values of a state.

        The eliminated ground points become the start of the next intersections.
        """
        values, vector = gtsam.Values(), self.problem.image_vector(state)
        for key, part in self._vectors:
            values.insert(key, vector[part])
        for j in self.points.tolist():
            values.insertPoint3(point_key(j), state.ground[j])
        self.elimination.start_at(vector, state.ground)
        return values

    def free(self, values: gtsam.Values) -> Array:
        """Return the image unknowns (u,) of GTSAM values."""
        return free_unknowns(values, self._vectors)

    def state(self, values: gtsam.Values, free: Array | None = None, *, complete: bool = False) -> State:
        """Return the state of values, with image unknowns (u,), that were evaluated last.

        See :meth:`Elimination.state`.
        """
        state = self.elimination.state(self.free(values) if free is None else free, complete=complete)
        for j in self.points.tolist():
            state.ground[j] = values.atPoint3(point_key(j))
        return state

    def linearised(self, values: gtsam.Values, free: Array | None = None) -> ReducedGraph:
        """Return the graph for one iteration of an optimiser at these values, with image unknowns (u,)."""
        return ReducedGraph(self, values, self.free(values) if free is None else free)

    @cached_property
    def ordering(self) -> gtsam.Ordering:
        """Order of elimination of the graph."""
        return self.graph.orderingCOLAMD()

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``robust.RobustBackend``; image points in the order of the structure."""
        return self.elimination.backend.squares(state)

    def linearise(self, state: State) -> SchurSystem | Border | ExplicitSystem:
        """Linearise at a solution, for cofactors: as arrays, or as rows if arrays do not determine the unknowns."""
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


#: Key of the variable.
BORDER: Final = int(gtsam.symbol("b", 0))


class ImageElimination:
    """Images of a problem as a function of the border; they are computed again when the border changes.

    Parameters
    ----------
    problem : Problem
    places : Places
    """

    def __init__(self, problem: Problem, places: Places) -> None:
        self.problem, self.places = problem, places
        self._root: Array | None = None
        self._control: Array | None = None
        self._excess = 0.0
        self.start_at(problem.start)

    def start_at(self, state: State) -> None:
        """Begin at a state; the images are oriented again from there."""
        self._own = self.places.own_of(state)
        self._at: Array | None = None  # border at the last elimination of the images; None before the first one
        self._now: Images | None = None  # this elimination; None if it was impossible
        self._base: tuple[Array, Array, Images] | None = None  # border, images and elimination at which S was computed

    def hold_weights(self, robust: Weighing | None, state: State) -> None:
        """Weight the rows with a loss at a state until the next call.

        The cost at this state is the cost of the loss.
        """
        self._root, self._control, self._excess, self._at, self._base = None, None, 0.0, None, None
        if robust is None:
            return
        image_squares, control_squares = squares(self.problem, state)
        image, control, cost = robust.weigh(image_squares, control_squares)
        self._root = np.sqrt(image)[self.places.order]
        self._control = self.problem.control_records.copy()
        self._control[self.problem.observed, POINT.whitening] *= np.sqrt(control)[:, None]
        self._excess = cost - 0.5 * float(np.vdot(image, image_squares) + np.vdot(control, control_squares))

    def cost(self, border: Array) -> float:
        """Return the cost at unknowns (b,) of the border.

        A large finite number if the images cannot be oriented.
        """
        images = self._eliminated(border)
        if images is None:
            return IMPOSSIBLE
        return self._excess + 0.5 * (images.squares - float(np.sum(images.decrements**2)))

    def linearised(self, border: Array) -> tuple[Array, Array]:
        """Return S (b, b) and g (b,) at the point where an optimiser linearises.

        Singular: the images cannot be oriented.
        """
        images = self._eliminated(border)
        if images is None:
            raise Singular("images cannot be oriented by their ground points")
        self._base = border.copy(), self._own, images
        return images.matrix, images.border_gradient

    def state(self, border: Array, *, complete: bool = False) -> State:
        """Return the state with the images of the last evaluation; ``complete`` adds their last Newton step."""
        own = self._own
        if complete and self._now is not None:
            own = own + self._now.own_step
        return self.places.state(own, border)

    def _eliminated(self, border: Array) -> Images | None:
        """Eliminate the images; return None if this is impossible."""
        if self._at is None or not np.array_equal(self._at, border):
            self._at = border.copy()
            if self._base is not None:
                begin, own, images = self._base
                self._own = own + images.own_step + images.followed((border - begin)[:, None])[:, :, 0]
            try:
                self._now = self._oriented(border)
            except (NotFiniteError, Singular):
                self._now = None
                if self._base is not None:
                    self._own = self._base[1]
        return self._now

    def _oriented(self, border: Array) -> Images:
        """Orient the images by Newton's steps."""
        last: tuple[Array, Array] | None = None
        for _ in range(MAX_STEPS):
            images = Images(self.places, self.places.state(self._own, border), self._root, self._control)
            far = images.decrements > INTERSECTED
            if not far.any():
                return images
            ahead = self._own + images.own_step
            if last is not None:
                worse = far & (images.own_squares > last[1] * (1.0 + 1e-12))
                ahead[worse] = 0.5 * (self._own[worse] + last[0][worse])
                here = np.where(worse[:, None], last[0], self._own), np.where(worse, last[1], images.own_squares)
            else:
                here = self._own, images.own_squares
            last, self._own = here, ahead
        raise Singular("images cannot be oriented by their ground points")


class ImagesGraph:
    """Graph backend with one variable, the border.

    Parameters
    ----------
    problem : Problem
        See :func:`fg_orient.adjustment.images_first.images_first`.
    """

    name = "graph"

    def __init__(self, problem: Problem) -> None:
        self.problem, self.places = problem, Places(problem)
        self.elimination = ImageElimination(problem, self.places)
        self.robust: Robust | None = None
        part = slice(0, len(self.places))
        #: Factor of the cost of all observations.
        self.cost = cost_factor(self.elimination.cost, [(BORDER, part)])

    def values(self, state: State) -> gtsam.Values:
        """Return the GTSAM values of a state.

        Its images become the start of their next orientation.
        """
        values = gtsam.Values()
        values.insert(BORDER, self.places.border_of(state))
        self.elimination.start_at(state)
        return values

    def free(self, values: gtsam.Values) -> Array:
        """Return the unknowns (b,) of the border."""
        return np.asarray(values.atVector(BORDER))

    def state(self, values: gtsam.Values, free: Array | None = None, *, complete: bool = False) -> State:
        """Return the state of values that were evaluated last.

        See :meth:`ImageElimination.state`.
        """
        return self.elimination.state(self.free(values) if free is None else free, complete=complete)

    def linearised(self, values: gtsam.Values, free: Array) -> ImagesReduced:
        """Return the graph for one iteration of an optimiser at these values, with the unknowns (b,)."""
        return ImagesReduced(self, values, free)

    def squares(self, state: State) -> tuple[Array, Array]:
        """See ``robust.RobustBackend``."""
        return squares(self.problem, state)

    def linearise(self, state: State) -> ImagesBorder:
        """Linearise at a solution, for cofactors; under a loss with the weights there."""
        if self.robust is None:
            return ImagesBorder(self.problem, state, self.places)
        return ImagesBorder(weighted_problem(self.problem, weights_at(self.problem, state, self.robust)[0]), state)


class ImagesReduced:
    """Graph for one iteration, and its linear model; see :class:`fg_orient.adjustment.reduced_graph.ReducedGraph`.

    Parameters
    ----------
    backend : ImagesGraph
    values : gtsam.Values
    free : (b,) array
        Unknowns of the border.
    """

    def __init__(self, backend: ImagesGraph, values: gtsam.Values, free: Array) -> None:
        self._matrix, self._gradient = backend.elimination.linearised(free)
        self._cost = backend.elimination.cost(free)
        self.graph, self.values, self.ordering = gtsam.NonlinearFactorGraph(), values, gtsam.Ordering()
        self.ordering.push_back(BORDER)
        self.graph.add(backend.cost)
        self.graph.add(gtsam.LinearContainerFactor(gtsam.HessianFactor(BORDER, self._matrix, -self._gradient, 0.0)))

    def of_images(self, values: gtsam.Values) -> gtsam.Values:
        """Return a copy of values."""
        return gtsam.Values(values)

    def after(self, values: gtsam.Values, step: Array) -> tuple[float, float]:
        """Return the cost after a step (b,) by the linear model, and the gradient along it."""
        along = float(self._gradient @ step)
        return self._cost + along + 0.5 * float(step @ self._matrix @ step), along

    def steepest(self) -> float:
        """Return the longest Gauss-Newton step of a single unknown, in standard deviations."""
        return float((np.abs(self._gradient) / np.sqrt(np.diag(self._matrix))).max(initial=0.0))
