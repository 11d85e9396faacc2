"""Normal equations of all eliminated points as GTSAM factors, for one iteration of an optimiser.

A factor written in Python can only give GTSAM a Jacobian, from which GTSAM forms the
normal matrix again. A ``HessianFactor`` contains the matrix itself, but its cost belongs
to a linear model. Therefore the graph of an iteration contains, in place of the factors
of groups of points,

- the blocks of the reduced normal matrix of all groups and the gradient, in Hessian factors of two or three image
  vectors without a cost (``LinearContainerFactor`` without a linearisation point has the cost 0 at all values);
- one factor with the cost of all groups at any values, and a Jacobian of zeros.

At the values where the graph was made, the sum has the matrix, the gradient and the cost
of the groups. At all other values it has their cost. This is sufficient for an iteration
of GTSAM's optimisers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Any, Final

import gtsam
import numpy as np

from factors.arrays import Array
from fg_orient.adjustment.eliminated import Elimination
from fg_orient.adjustment.problem import State
from fg_orient.adjustment.schur_reduced import full_matrix

if TYPE_CHECKING:
    from fg_orient.adjustment.graph import GraphBackend

Pair = tuple[int, int]

#: If there are at least ``JOINED_FROM`` vectors and all are linked, they are joined to variables of
#: about ``JOINED_SIZE`` unknowns. Up to ``JOINED_SIZE`` unknowns, all vectors form one variable. GTSAM
#: takes less time for few large factors.
JOINED_FROM: Final = 40
JOINED_SIZE: Final = 150
#: Blocks of a factor of three vectors, in the order of GTSAM's arguments.
_PLACES: Final = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def cover(pairs: Collection[Pair]) -> list[tuple[int, ...]]:
    """Return sets of up to three vectors that together contain each pair (n < m) exactly once.

    There are few sets, because a factor of three vectors takes as long to make as a
    factor of two. Vectors that are in no pair are left out.
    """
    size = 1 + max((m for _, m in pairs), default=0)
    left = np.zeros((size, size), bool)
    for n, m in pairs:
        left[n, m] = left[m, n] = True
    out: list[tuple[int, ...]] = []
    for n in range(size):
        for m in np.flatnonzero(left[n]).tolist():
            if not left[n, m]:
                continue
            third = np.flatnonzero(left[n] & left[m])
            own = (n, m, int(third[0])) if len(third) else (n, m)
            for a in own:
                for b in own:
                    left[a, b] = False
            out.append(tuple(sorted(own)))
    return out


def free_unknowns(values: gtsam.Values, vectors: Sequence[tuple[int, slice]]) -> Array:
    """Return image unknowns (u,) of GTSAM values from their keys and parts; nan for vectors that are missing."""
    free = np.full(vectors[-1][1].stop, np.nan)
    for key, part in vectors:
        if values.exists(key):
            free[part] = values.atVector(key)
    return free


class GroupSums:
    """Factors that contain the sums of all point groups: the vectors that they link, and the factor of their cost.

    Parameters
    ----------
    elimination : Elimination
    keys : mapping
        GTSAM key of each vector of unknowns, by its number.
    alone : bool
        True if the priors of the vectors are the only other factors.
    """

    def __init__(self, elimination: Elimination, keys: Mapping[int, int], *, alone: bool) -> None:
        self.elimination, self._ties = elimination, elimination.problem.ties
        #: Keys of the images and shared unknowns, and their parts of the free unknowns.
        self.vectors = [(keys[n], part) for n, part in elimination.parts.items()]
        #: Order of elimination, from the pattern of the first graph.
        self.ordering: gtsam.Ordering | None = None
        self._parts, self._keys = elimination.parts, dict(keys)
        pairs, n = self._pairs(), len(keys)
        linked = {k: part.stop - part.start for k, part in elimination.parts.items()}
        size = dict(linked)
        for a, b in pairs:
            linked[a], linked[b] = linked[a] + size[b], linked[b] + size[a]
        #: Maximum number of unknowns of the vectors linked to a vector; the widest elimination has at least this size.
        self.widest = max(linked.values(), default=0)
        # vectors are joined to few variables if no elimination order saves work, or if a full matrix
        # is cheaper than small factors
        is_dense = n >= JOINED_FROM and len(pairs) == n * (n - 1) // 2
        self.is_joined = alone and (is_dense or self.vectors[-1][1].stop <= JOINED_SIZE)
        if self.is_joined:
            cuts = np.linspace(0, n, 1 + -(-self.vectors[-1][1].stop // JOINED_SIZE)).astype(int)
            first = [self.vectors[k][1].start if k < n else self.vectors[-1][1].stop for k in cuts.tolist()]
            self._parts = {k: slice(*ends) for k, ends in enumerate(pairwise(first))}
            self._keys = {k: int(gtsam.symbol("a", k)) for k in self._parts}
            pairs = set(combinations(self._parts, 2))
        #: Keys of the variables of the graph, and their parts.
        self.variables = [(self._keys[n], part) for n, part in self._parts.items()]
        prior = 1.0 if self.is_joined and elimination.problem.block.options.priors else 0.0
        self.cost = cost_factor(lambda free: elimination.cost(free) + 0.5 * prior * float(free @ free), self.variables)
        covered = cover(pairs)
        single, s = set(self._keys) - {n for own in covered for n in own}, elimination.backend.structure
        # block of the reduced matrix of each pair; images without eliminated points have no block
        self._block = (
            {}
            if self.is_joined or self._ties is not None
            else {pair: k for k, pair in enumerate(zip(s.block_row.tolist(), s.block_column.tolist(), strict=True))}
        )
        size = {n: part.stop - part.start for n, part in self._parts.items()}
        self._zero = {(a, b): np.zeros((a, b)) for a in {*size.values()} for b in {*size.values()}}
        self._sets, seen = [], set[Pair]()
        for own in [*covered, *((n,) for n in sorted(single))]:
            blocks = [(own[a], own[b]) for a, b in _PLACES if b < len(own)]
            self._sets.append(
                (
                    [self._keys[n] for n in own],
                    [(pair, (size[pair[0]], size[pair[1]]), pair not in seen) for pair in blocks],
                    [(self._parts[n], (n, n) not in seen) for n in own],
                )
            )
            seen.update(blocks)

    def _pairs(self) -> set[Pair]:
        """Return pairs of different vectors that a block of the reduced matrix links."""
        elimination, s = self.elimination, self.elimination.backend.structure
        exists, of_image = elimination.parts, dict[int, list[int]]()
        for k in range(elimination.problem.n_images):
            wide = elimination.problem.image_slice(k)
            own = [k] if self._ties is None else np.unique(self._ties.vectors(wide)).tolist()
            of_image[k] = [n for n in own if n in exists]
        links = zip(s.block_row.tolist(), s.block_column.tolist(), strict=True)
        every = ((n, m) for i, j in links for n in of_image[i] for m in of_image[j])
        return {(min(n, m), max(n, m)) for n, m in every if n != m}

    def factors(self, blocks: Array, gradient: Array, prior: Array) -> list[gtsam.LinearContainerFactor]:
        """Return the factors of blocks (B, k, k) and gradient (u,) of :meth:`Elimination.linearised`.

        Their cost is zero.

        ``prior`` (u,) is added to the diagonal.
        """
        s, parts, zero, number = self.elimination.backend.structure, self._parts, self._zero, self._block
        if self._ties is None and not self.is_joined:

            def block(pair: Pair, size: Pair) -> Array:
                k = number.get(pair)
                return zero[size] if k is None else blocks[k, : size[0], : size[1]]
        else:
            whole = full_matrix(s.pattern, self.elimination.problem.first, blocks, self._ties)
            whole[np.diag_indices(len(whole))] += prior

            def block(pair: Pair, size: Pair) -> Array:
                return whole[parts[pair[0]], parts[pair[1]]]

        right, out = -gradient, gtsam.GaussianFactorGraph()
        hessian: Any = gtsam.HessianFactor  # its overloads do not accept a list of arguments
        for keys, pairs, own in self._sets:
            g = [block(pair, size) if is_new else zero[size] for pair, size, is_new in pairs]
            r = [
                right[part] if is_new else zero[part.stop - part.start, part.stop - part.start][0]
                for part, is_new in own
            ]
            out.add(hessian(*keys, *_arguments(g, r), 0.0))
        return [gtsam.LinearContainerFactor(out.at(k)) for k in range(out.size())]


class ReducedGraph:
    """Graph for one iteration, and its linear model.

    Parameters
    ----------
    backend : GraphBackend
    values : gtsam.Values
        Values at which the optimiser linearises.
    free : (u,) array
        Image unknowns of these values.
    """

    def __init__(self, backend: GraphBackend, values: gtsam.Values, free: Array) -> None:
        self._backend, self._values, self._free, sums = backend, values, free, backend.sums
        blocks, self._gradient = sums.elimination.linearised(self._free)
        self._blocks, self._cost = blocks.copy(), sums.elimination.cost(self._free)
        self.graph = gtsam.NonlinearFactorGraph()
        self.graph.add(sums.cost)
        prior = 1.0 if sums.is_joined and backend.problem.block.options.priors else 0.0
        for factor in sums.factors(blocks, self._gradient + prior * self._free, np.full(len(self._free), prior)):
            self.graph.add(factor)
        #: Values of the variables of the graph.
        self.values = values
        if sums.is_joined:
            self.values = _values(self._free, sums.variables)
        else:
            self.graph.push_back(backend.others)
        sums.ordering = sums.ordering or self.graph.orderingCOLAMD()
        self.ordering = sums.ordering

    def of_images(self, values: gtsam.Values) -> gtsam.Values:
        """Return a copy of the values of images from the values of the variables of the graph."""
        sums = self._backend.sums
        return _values(free_unknowns(values, sums.variables), sums.vectors) if sums.is_joined else gtsam.Values(values)

    def after(self, values: gtsam.Values, step: Array) -> tuple[float, float]:
        """Return the cost after a step (u,) to other values by the linear model of groups, and the gradient along it.

        The cost of the other factors is the actual one.
        """
        backend, problem = self._backend, self._backend.problem
        s = backend.elimination.backend.structure
        wide = problem.image_matrix(step)
        along_columns = np.matmul(self._blocks, wide[s.block_column, :, None])[:, :, 0]
        squares = np.einsum("bp,bp->b", wide[s.block_row], along_columns)
        squares[s.block_row != s.block_column] *= 2.0
        along = float(self._gradient @ step)
        cost = self._cost + along + 0.5 * float(squares.sum())
        gradient, delta = self._slope(), self._values.localCoordinates(values)
        along += sum(float(gradient.at(key) @ delta.at(key)) for key in backend.others.keyVector())
        return cost + float(backend.others.error(values)), along

    def steepest(self) -> float:
        """Return the longest Gauss-Newton step of a single image unknown.

        The unit is the standard deviation that follows from the groups of points.
        """
        backend, s = self._backend, self._backend.elimination.backend.structure
        gradient, slope, ties = self._gradient.copy(), self._slope(), backend.problem.ties
        for key, part in backend.sums.vectors:
            if slope.exists(key):
                gradient[part] += slope.at(key)
        if ties is None:
            own, of_image = s.block_row == s.block_column, np.zeros((len(s.size), self._blocks.shape[1]))
            of_image[s.block_row[own]] = np.einsum("bpp->bp", self._blocks[own])
            diagonal = backend.problem.image_vector(State(of_image, np.zeros((0, 3))))
        else:
            diagonal = np.diag(full_matrix(s.pattern, backend.problem.first, self._blocks, ties))
        return float((np.abs(gradient) / np.sqrt(np.where(diagonal > 0.0, diagonal, np.inf))).max(initial=0.0))

    def _slope(self) -> gtsam.VectorValues:
        """Return the gradient of the other factors."""
        return self._backend.others.linearize(self._values).gradientAtZero()


def _arguments(blocks: list[Array], right: list[Array]) -> list[Array]:
    """Return the blocks and right sides of one, two or three vectors in the order of GTSAM's constructor."""
    if len(right) == 1:
        return [blocks[0], right[0]]
    if len(right) == 2:
        return [blocks[0], blocks[1], right[0], blocks[2], right[1]]
    return [*blocks[:3], right[0], *blocks[3:5], right[1], blocks[5], right[2]]


def _values(free: Array, vectors: Sequence[tuple[int, slice]]) -> gtsam.Values:
    """Return the GTSAM values of image unknowns (u,)."""
    values = gtsam.Values()
    for key, part in vectors:
        values.insert(key, free[part])
    return values


def cost_factor(cost: Callable[[Array], float], vectors: Sequence[tuple[int, slice]]) -> gtsam.CustomFactor:
    """Return a factor with the cost at any values of the unknowns (u,) of vectors.

    Its Jacobian is zero.
    """

    def error(_this: Any, values: Any, jacobians: Any) -> Array:
        if jacobians is not None:
            jacobians[0] = np.zeros((1, vectors[0][1].stop))
        return np.array([math.sqrt(2.0 * cost(free_unknowns(values, vectors)))])

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [vectors[0][0]], error)
