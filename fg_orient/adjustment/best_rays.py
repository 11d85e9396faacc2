"""Find the position of a ground point with contradictory rays: the place where most of its rays agree.

If a point has a wrong ray, a redescending loss has several minima. One of them excludes
the wrong ray; others exclude a right ray. The graduated stages may end in any of these
minima. Therefore all candidates are compared with the images held fixed. Candidates are
the measured coordinates and the intersections of all pairs of rays. The candidate with
the least truncated cost is chosen (exhaustive consensus, after Fischler & Bolles 1981)::

    c(x) = sum min(|v|^2, L^2),   L: limit of right observations

Each candidate is improved by steps. The first step uses the observations within twice the
limit, because two rays intersect less precisely than all right rays. The next steps use the
observations within the limit. At the solution, rays get the same weight if the data do not show which
of them is wrong (:func:`sharing`).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, combinations, permutations
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from factors.conditions.control import POINT
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.robust import DOWN, Weights
from fg_orient.adjustment.rows import linearised, residuals, summed

#: Minimum and maximum number of rays of a point. With two rays, the data do not show
#: which one is wrong. With more than twelve rays, most of them agree.
FEWEST: Final = 3
MOST: Final = 12
#: Number of steps of an intersection.
STEPS: Final = 5
#: Largest step of an intersection, m. Nearly parallel rays do not intersect.
FARTHEST_M: Final = 1e5
#: The steps after an intersection use the observations within these multiples of the limit.
WIDTHS: Final = (2.0, 1.0, 1.0)
#: Two places, or two rays, are rivals if their costs differ by less than this, in units
#: of the variance factor. Their likelihoods then differ by a factor of at most 100. A
#: point moves only if the cost decreases by more than this.
RIVAL: Final = 9.21


def with_best_rays(problem: Problem, state: State, limits: tuple[float, float]) -> State:
    """Move contradictory points of a state to the place where most of their rays agree.

    Parameters
    ----------
    problem : Problem
    state : State
    limits : (float, float)
        Limits L of image points and of control points, sigmas.
    """
    o, far = problem.observations, np.sum(residuals(problem, state) ** 2, axis=1) > limits[0] ** 2
    rays = np.bincount(o.point, minlength=len(problem.active))
    doubtful = np.bincount(o.point, far, len(problem.active)) > 0
    points = np.flatnonzero(problem.active & doubtful & (rays >= FEWEST) & (rays <= MOST))
    if not len(points):
        return state
    search = _Search(problem, state, points, limits)
    begin = state.ground[points]
    before, best, least = search.cost(begin), begin.copy(), np.full(len(points), np.inf)
    pairs = combinations(range(int(rays[points].max())), 2)
    starts = (search.moved(begin, np.isin(search.number, pair), STEPS) for pair in pairs)
    for place in chain([search.measured(begin)], starts):
        for width in WIDTHS:
            place = search.moved(place, search.inside(place, width), 1, width)
        cost = search.cost(place)
        better = cost < least
        best[better], least[better] = place[better], cost[better]
    ground = state.ground.copy()
    ground[points] = np.where((least < before - RIVAL)[:, None], best, begin)
    return State(state.image, ground)


def sharing(problem: Problem, state: State, weights: Weights) -> Weights | None:
    """Give rivals the weight of the down-weighted ray; return None if there are no rivals.

    A loss keeps the rays that fit best and down-weights the other rays. A kept ray and a down-weighted
    ray are rivals under two conditions. The point fits nearly as well if the two are exchanged, and it
    fits far worse with both. One of them is wrong, but the data do not show which one. An example is a
    pair of nearly parallel rays with an error along their plane. Both rays of the pair are then
    down-weighted, like the rays of a point with two rays.

    Parameters
    ----------
    problem : Problem
    state : State
        Solution after graduated non-convexity.
    weights : Weights
        Weights at this solution.
    """
    point, n, limit = problem.observations.point, len(problem.active), RIVAL * weights.scale[0] ** 2
    down = (weights.image < DOWN) & (np.sum(residuals(problem, state) ** 2, axis=1) > limit)
    kept = np.bincount(point, ~down, n)
    doubtful = (kept >= 2) & (kept < np.bincount(point, minlength=n)) & (np.bincount(point, minlength=n) <= MOST)
    doubtful[problem.named_points()] = False
    points = np.flatnonzero(problem.active & ~problem.observed & doubtful)
    if not len(points):
        return None
    search = _Search(problem, state, points, (np.inf, np.inf))
    rows, image, begin = search.rows, weights.image.copy(), state.ground[points]
    low, number = down[rows], search.number

    def cost(used: npt.NDArray[np.bool_]) -> Array:
        return search.sum_of_squares(search.moved(begin, used, STEPS), used)

    now = cost(~low)
    for a, b in permutations(range(int(number.max()) + 1), 2):
        exchanged = search.count(low & (number == a)) * search.count(~low & (number == b)) > 0
        if not exchanged.any():
            continue
        both = ~low | (number == a)
        rival = (exchanged & (cost(both & (number != b)) < now + limit) & (cost(both) > now + 2.0 * limit))[search.of]
        mine = rows[rival & (number == b)]
        image[mine] = np.minimum(image[mine], weights.image[rows[rival & (number == a)]])
    return None if np.array_equal(image, weights.image) else replace(weights, image=image)


class _Search:
    """Costs and steps of some ground points (p,) with the images held fixed."""

    def __init__(self, problem: Problem, state: State, points: Index, limits: tuple[float, float]) -> None:
        self._problem, self._state, self._points, self._limits = problem, state, points, limits
        o = problem.observations
        rows = np.flatnonzero(np.isin(o.point, points))
        #: Row of each ray. ``of`` is the position of its point among the given points, ``number``
        #: its number among the rays of its point.
        self.rows = rows[np.argsort(o.point[rows], kind="stable")]
        self.of = np.searchsorted(points, o.point[self.rows])
        self._first = np.searchsorted(self.of, np.arange(len(points) + 1))
        self.number = np.arange(len(self.rows)) - self._first[self.of]
        self._observed = problem.observed[points]
        self._place = problem.control_records[points[self._observed], POINT.place]
        self._weight = problem.control_weights(points[self._observed])

    def _at(self, place: Array) -> State:
        ground = self._state.ground.copy()
        ground[self._points] = place
        return State(self._state.image, ground)

    def _control(self, place: Array) -> Array:
        return np.asarray(np.einsum("pij,pj->pi", self._weight, place[self._observed] - self._place))

    def _squares(self, place: Array) -> Array:
        return np.asarray(np.sum(linearised(self._problem, self._at(place), self.rows).residual ** 2, axis=1))

    def count(self, values: npt.NDArray[Any]) -> Array:
        """Sum a value of each ray over the rays of each point: (p,)."""
        return np.asarray(np.bincount(self.of, values, len(self._points)), np.float64)

    def sum_of_squares(self, place: Array, used: npt.NDArray[np.bool_]) -> Array:
        """Return the sum of squares (p,) of some of the rays at positions (p, 3)."""
        return self.count(self._squares(place) * used)

    def cost(self, place: Array) -> Array:
        """Return the truncated cost (p,) of positions (p, 3)."""
        image, control = (limit**2 for limit in self._limits)
        squares = self._squares(place)
        out = self.count(np.minimum(squares, image))
        out[self._observed] += np.minimum(np.sum(self._control(place) ** 2, axis=1), control)
        return out

    def measured(self, place: Array) -> Array:
        """Return the positions with the measured coordinates of control points."""
        out = place.copy()
        out[self._observed] = self._place
        return out

    def inside(self, place: Array, width: float) -> npt.NDArray[np.bool_]:
        """Return whether each ray is within a multiple of its limit at positions (p, 3)."""
        return np.asarray(self._squares(place) <= (width * self._limits[0]) ** 2)

    def moved(self, place: Array, used: npt.NDArray[np.bool_], steps: int, width: float = 0.0) -> Array:
        """Return the positions after Gauss-Newton steps with some of the rays.

        If these rays do not intersect, return the given position. Coordinates of control
        points within ``width`` times their limit are also used.
        """
        begin, place = place, place.copy()
        for _ in range(steps):
            part = linearised(self._problem, self._at(place), self.rows)
            slope = used[:, None, None] * part.ground
            normal = summed(np.swapaxes(slope, 1, 2) @ part.ground, self._first)
            gradient = summed(np.einsum("nij,ni->nj", slope, part.residual), self._first)
            if width:
                v = self._control(place)
                held = self._weight * (np.sum(v**2, axis=1) <= (width * self._limits[1]) ** 2)[:, None, None]
                normal[self._observed] += np.swapaxes(held, 1, 2) @ self._weight
                gradient[self._observed] += np.einsum("pij,pi->pj", held, v)
            step = -np.einsum("pij,pj->pi", np.linalg.pinv(normal, hermitian=True), gradient)
            bad = ~(np.linalg.norm(step, axis=1) < FARTHEST_M)
            step[bad] = 0.0
            place += step
            away = np.linalg.norm(place - begin, axis=1) > FARTHEST_M
            place[away] = begin[away]
        return place
