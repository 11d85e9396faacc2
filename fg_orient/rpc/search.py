"""Select the coefficients of a rational function model by random search: a genetic search, or a particle swarm.

Both search for a subset of the coefficients beyond the affine part. The best subset has
the smallest sum of squared errors of the linear form at excluded points (Allen 1974). At
the end, single coefficients are added or dropped as long as this decreases the sum. The
publications use control points and dependent check points instead, and they describe
their operators only in words. The reduced system contains the seed and the maximum number
of evaluated subsets.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.rpc.select import LEAST_FREEDOM, Reduced, Selection, register_selection

#: Number of subsets in a population and of particles in a swarm; share of the coefficients at the start.
POPULATION: Final = 40
SWARM: Final = 30
DENSITY: Final = 0.3
#: Number of the best subsets that stay in the population.
ELITE: Final = 4
#: Weights of the last velocity and of the differences from a particle's own best subset
#: and from the best subset of the swarm; largest speed.
INERTIA: Final = 0.7
TO_OWN: Final = 1.5
TO_BEST: Final = 1.5
FASTEST: Final = 4.0
#: Number of generations without a better subset after which a search ends.
IDLE: Final = 25
#: Columns of length 1 are dependent if a diagonal element of their triangular factor is below this.
DEPENDENT: Final = 1e-9


def left_out_squares(reduced: Reduced, chosen: Index) -> float:
    """Return the sum of squared errors at excluded points, of both equations together; inf for dependent columns.

    Parameters
    ----------
    reduced : Reduced
    chosen : (k,) array of int
        Columns of the reduced system; the affine part is always in the model.
    """
    n = len(reduced.design) // 2
    columns = reduced.design[:, chosen]
    orthogonal, upper = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))
    if len(chosen) and np.abs(upper.diagonal()).min() <= DEPENDENT:
        return np.inf
    v = reduced.observed - orthogonal @ (orthogonal.T @ reduced.observed)
    basis = np.hstack([reduced.affine, orthogonal])
    both = np.stack([basis[:n], basis[n:]], axis=1)
    free = np.eye(2) - both @ np.swapaxes(both, 1, 2)
    determinant = free[:, 0, 0] * free[:, 1, 1] - free[:, 0, 1] ** 2
    if (determinant <= DEPENDENT).any():  # a coefficient depends on a single point only
        return np.inf
    return float(np.sum(np.linalg.solve(free, np.stack([v[:n], v[n:]], axis=1)[:, :, None]) ** 2))


class _Search:
    """Evaluated subsets, the best of them, and the random numbers of a search."""

    def __init__(self, reduced: Reduced) -> None:
        self.reduced, self.known = reduced, dict[bytes, float]()
        self.random = np.random.default_rng(reduced.seed)
        self.size = reduced.design.shape[1]
        self.most = min(self.size, reduced.freedom - LEAST_FREEDOM)
        self.best, self.least = np.zeros(self.size, bool), np.inf
        self.evaluate([self.best])

    @property
    def is_spent(self) -> bool:
        """True if as many subsets were evaluated as allowed."""
        return len(self.known) >= self.reduced.evaluations

    def start(self, count: int) -> Mask:
        """Return random subsets (count, q)."""
        return self.limited(self.random.random((count, self.size)) < DENSITY)

    def limited(self, subsets: Mask) -> Mask:
        """Drop random coefficients of subsets that have too many."""
        for subset in subsets:
            many = int(subset.sum()) - max(self.most, 0)
            if many > 0:
                subset[self.random.choice(np.flatnonzero(subset), many, replace=False)] = False
        return subsets

    def evaluate(self, subsets: Iterable[Mask]) -> Array:
        """Return the sums of squares of subsets; inf when the maximum number of evaluations has been reached."""
        out = []
        for subset in subsets:
            key = subset.tobytes()
            if key not in self.known and not self.is_spent:
                self.known[key] = left_out_squares(self.reduced, np.flatnonzero(subset))
                if self.known[key] < self.least:
                    self.best, self.least = subset.copy(), self.known[key]
            out.append(self.known.get(key, np.inf))
        return np.array(out)

    def finished(self) -> Selection:
        """Return the best subset, after changes of single coefficients that improve it."""
        before = np.inf
        while self.least < before and not self.is_spent:
            before = self.least
            near = np.tile(self.best, (self.size, 1)) ^ np.eye(self.size, dtype=bool)
            self.evaluate(near[near.sum(axis=1) <= self.most])
        return Selection(np.flatnonzero(self.best))


@register_selection("genetic", "genetic search", source="after Valadan Zoej et al. 2007; Naeini et al. 2017")
def genetic(reduced: Reduced) -> Selection:
    """Find the subset with the smallest errors at excluded points, by a genetic search.

    Each parent is the better of two random subsets. A child takes each coefficient from
    one of its parents at random. Then each coefficient changes with the probability 1/q.
    The best four subsets remain in the population.
    """
    search = _Search(reduced)
    if not search.size:
        return search.finished()
    population, idle, random = search.start(POPULATION), 0, search.random
    squares = search.evaluate(population)
    while idle < IDLE and not search.is_spent:
        before, order = search.least, np.argsort(squares, kind="stable")
        population, squares = population[order], squares[order]
        # subsets are sorted, so that the better one has the smaller number
        parents = random.integers(POPULATION, size=(2, POPULATION - ELITE, 2)).min(axis=2)
        of_first = random.random((POPULATION - ELITE, search.size)) < 0.5
        children = np.where(of_first, population[parents[0]], population[parents[1]])
        children ^= random.random(children.shape) < 1.0 / search.size
        population = np.vstack([population[:ELITE], search.limited(children)])
        squares = search.evaluate(population)
        idle = 0 if search.least < before else idle + 1
    return search.finished()


@register_selection("particle_swarm", "particle swarm", source="after Moghaddam et al. 2018; Kennedy & Eberhart 1997")
def particle_swarm(reduced: Reduced) -> Selection:
    """Find the subset with the smallest errors at excluded points, by a binary particle swarm.

    Each coefficient has a velocity. The velocity changes towards the best subset of the particle and
    the best subset of the swarm. The coefficient is in the subset with the probability 1/(1 +
    exp(-velocity)).
    """
    search = _Search(reduced)
    if not search.size:
        return search.finished()
    place, idle, random = search.start(SWARM), 0, search.random
    velocity = np.where(place, 1.0, -1.0) * random.random(place.shape)
    own, squares = place.copy(), search.evaluate(place)
    while idle < IDLE and not search.is_spent:
        before = search.least
        to_own, to_best = (
            (own ^ place) * np.where(own, 1.0, -1.0),
            (search.best ^ place) * np.where(search.best, 1.0, -1.0),
        )
        velocity = (
            INERTIA * velocity
            + TO_OWN * random.random(place.shape) * to_own
            + TO_BEST * random.random(place.shape) * to_best
        )
        velocity = np.clip(velocity, -FASTEST, FASTEST)
        place = search.limited(random.random(place.shape) < 1.0 / (1.0 + np.exp(-velocity)))
        now = search.evaluate(place)
        better = now < squares
        own[better], squares[better] = place[better], now[better]
        idle = 0 if search.least < before else idle + 1
    return search.finished()
