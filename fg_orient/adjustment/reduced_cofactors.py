"""Joint cofactors of images and ground points from a factorised reduced camera system."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index
from fg_orient.adjustment import cofactors
from fg_orient.adjustment.cofactors import (
    DenseUnknowns,
    RayCofactors,
    blocks_of_images,
    cofactors_of_points,
    cofactors_of_rays,
    order_by_point,
    pairs_of_images,
)
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.rows import linearised

if TYPE_CHECKING:
    from fg_orient.adjustment.reduced_choice import Choice
    from fg_orient.adjustment.schur import SchurSystem

#: Maximum number of joint blocks of images in memory.
KNOWN: Final = 1000

# Data of an unknown point: the images that see it, in ascending order; H^-1 (3, 3); K (3, u).
Gain = tuple[tuple[int, ...], Array, Array]


class ImageCofactors(Protocol):
    """Source of the joint cofactors of images: a factorised reduced system, or GTSAM Marginals."""

    def covariance(self, images: tuple[int, ...]) -> Array:
        """Return the joint cofactors of images, prior sigmas."""
        ...

    @property
    def selects(self) -> bool:
        """True if :meth:`selected` is possible in time and memory."""
        ...

    def selected(self, pairs: Index) -> Array:
        """Return the joint cofactors (P, k, k) of pairs of images that share points.

        Shorter blocks end with zeros.
        """
        ...


@dataclass(frozen=True)
class SummedSystem:
    """Equations with priors, linearised at the solution of an adjustment in parts or by the factor graph.

    ``reduced(damping)`` factorises the system by the method ``choice``. It raises
    ``Singular`` if the system is not positive definite.
    """

    state: State
    reduced: Callable[[float], ImageCofactors]
    choice: Choice | None = None


class ReducedCofactors:
    """Joint cofactors from a reduced system; see ``fg_orient.quality.cofactors.Cofactors``.

    Parameters
    ----------
    problem : Problem
    system : SchurSystem or SummedSystem
        Linearisation at the solution.

    Raises
    ------
    RuntimeError
        The normal equations are too close to singular.
    """

    def __init__(self, problem: Problem, system: SchurSystem | SummedSystem) -> None:
        self._problem, self._state, self._reduced = problem, system.state, system.reduced(0.0)
        self._known: dict[tuple[int, ...], Array] = {}
        self._whole: Array | None = None
        self._order = order_by_point(problem)
        self._first = np.searchsorted(problem.observations.point[self._order], np.arange(len(problem.active) + 1))
        self._of((0,))  # raises the error of an ill-conditioned system

    def _of(self, images: tuple[int, ...]) -> Array:
        """Return the joint cofactors of images in ascending order; they are kept."""
        if self._whole is not None:
            index = np.concatenate([np.arange(self._problem.first[k], self._problem.first[k + 1]) for k in images])
            return np.asarray(self._whole[np.ix_(index, index)])
        if len(images) == self._problem.n_images:
            self._whole = self._reduced.covariance(images)
            return self._whole
        if images not in self._known:
            if len(self._known) > KNOWN:
                self._known.clear()
            self._known[images] = self._reduced.covariance(images)
        return self._known[images]

    def image(self, k: int) -> Array:
        """See ``Cofactors``."""
        if not self._is_large:
            return self._of((k,))
        size = len(self._problem.parameters[k])
        return self.blocks(np.array([[k, k]]))[0, :size, :size]

    def point(self, j: int) -> Array:
        """See ``Cofactors``."""
        if not self._problem.active[j]:
            return np.zeros((3, 3))
        images, inverse, gain = self._gain(j)
        q = inverse + gain @ self._of(images) @ gain.T
        return np.asarray(0.5 * (q + q.T))

    def points(self, index: npt.NDArray[np.intp]) -> Array:
        """See ``Cofactors``."""
        return cofactors_of_points(self._problem, self._state, index, self.blocks)

    @property
    def selects(self) -> bool:
        """True if the blocks of all pairs of images that share points cost less than the whole inverse."""
        return self._reduced.selects

    def blocks(self, pairs: npt.NDArray[np.intp]) -> Array:
        """See ``Cofactors``."""
        if not self._is_large:
            return blocks_of_images(self._problem, self._of, pairs)
        keys, found = self._selected
        return found[np.searchsorted(keys, pairs[:, 0] * self._problem.n_images + pairs[:, 1])]

    @property
    def _is_large(self) -> bool:
        """True if joint cofactors of images come from :attr:`_selected`, not from the whole inverse."""
        return bool(cofactors.WHOLE_LIMIT < self._problem.first[-1] and self.selects)

    @cached_property
    def _selected(self) -> tuple[Index, Array]:
        """Keys (B,) (row times number of images plus column) and joint cofactors (B, k, k) of images sharing points."""
        pairs, _ = pairs_of_images(self._problem, self._order)
        return pairs[:, 0] * self._problem.n_images + pairs[:, 1], self._reduced.selected(pairs)

    def unknowns(self, places: Index) -> DenseUnknowns:
        """See ``Cofactors``."""
        first = self._problem.first
        images = np.unique(np.searchsorted(first, places, side="right") - 1).tolist()
        mine = np.searchsorted(np.concatenate([np.arange(first[k], first[k + 1]) for k in images]), places)
        return DenseUnknowns(self._of(tuple(images))[np.ix_(mine, mine)])

    def star(self) -> None:
        """See ``Cofactors``."""

    def rays(self, problem: Problem, state: State) -> RayCofactors:
        """See ``Cofactors``."""
        return cofactors_of_rays(problem, state, self.blocks)

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See ``Cofactors``."""
        unknown = [j for j in points if self._problem.active[j]]
        gains = [self._gain(j) for j in unknown]
        needed = tuple(sorted({*images}.union(*(seen for seen, _, _ in gains))))
        columns, q = self._columns(needed), self._of(needed)
        at = np.concatenate([np.zeros(0, np.intp), *(columns[k] for k in images)])
        n = len(at)
        effect = np.zeros((n + 3 * len(gains), len(q)))
        effect[np.arange(n), at] = 1.0
        for a, (seen, _, gain) in enumerate(gains):
            effect[n + 3 * a : n + 3 * a + 3, np.concatenate([columns[k] for k in seen])] = -gain
        out = effect @ q @ effect.T
        for a, (_, inverse, _) in enumerate(gains):
            for b in np.flatnonzero(np.equal(unknown, unknown[a])):
                out[n + 3 * a : n + 3 * a + 3, n + 3 * b : n + 3 * b + 3] += inverse
        return np.asarray(0.5 * (out + out.T))

    def _columns(self, images: tuple[int, ...]) -> dict[int, npt.NDArray[np.intp]]:
        """Return the columns of images among the unknowns of these images."""
        first = np.concatenate([[0], np.cumsum([len(self._problem.parameters[k]) for k in images])])
        return {k: np.arange(first[n], first[n + 1]) for n, k in enumerate(images)}

    def _gain(self, j: int) -> Gain:
        """See :data:`Gain`."""
        problem, rows = self._problem, self._order[self._first[j] : self._first[j + 1]]
        normal, sums = np.zeros((3, 3)), dict[int, Array]()
        if problem.observed[j]:
            w = problem.control_weights(j)
            normal += w.T @ w
        _, d_image, d_ground = linearised(problem, self._state, rows)
        for k, by_image, by_point in zip(problem.observations.image[rows].tolist(), d_image, d_ground, strict=True):
            normal += by_point.T @ by_point
            sums[k] = sums.get(k, 0.0) + by_point.T @ by_image[:, : len(problem.parameters[k])]
        inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        return tuple(sums), inverse, inverse @ np.hstack(list(sums.values()))
