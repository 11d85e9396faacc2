"""Cofactors of images and points from the reduced camera system.

The inverse of the reduced system holds the cofactors Q of the images. A point follows from the images it is seen
in: with ``K = H^-1 sum G^T J`` its cofactors are ``H^-1 + K Q K^T``, those with the images ``-K Q``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.point_cofactors import blocks_of_images, cofactors_of_points
from fg_orient.adjustment.problem import Problem, State
from fg_orient.adjustment.schur import SchurSystem
from fg_orient.adjustment.schur_reduced import Reduced

Array = npt.NDArray[np.float64]

# Images that see an unknown point, in ascending order, its H^-1 (3, 3) and K (3, u).
Gain = tuple[tuple[int, ...], Array, Array]

#: Joint blocks that are remembered.
KNOWN: Final = 1000
#: Elements of a lower triangle, row by row.
LOWER: Final = np.tril_indices(3)


class ReducedCofactors:
    """Joint cofactors from a reduced system; see ``fg_orient.quality.covariance.Cofactors``.

    Parameters
    ----------
    problem : Problem
    state : State
        The solution.
    reduced : Reduced
    gain : callable
        Of an unknown point.

    Raises
    ------
    RuntimeError
        The normal equations are too close to singular.
    """

    def __init__(self, problem: Problem, state: State, reduced: Reduced, gain: Callable[[int], Gain]) -> None:
        self._problem, self._state, self._reduced, self._gain = problem, state, reduced, gain
        self._known: dict[tuple[int, ...], Array] = {}
        self._whole: Array | None = None
        self._of((0,))  # an ill-conditioned system is found when first asked, not when made

    def _of(self, images: tuple[int, ...]) -> Array:
        """Cofactors of images in ascending order; points that are seen in the same images share the last ones.

        What was asked for of all images is not solved for again.
        """
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
        return self._of((k,))

    def point(self, j: int) -> Array:
        """See ``Cofactors``."""
        if not self._problem.active[j]:
            return np.zeros((3, 3))
        images, inverse, gain = self._gain(j)
        found = inverse + gain @ self._of(images) @ gain.T
        return np.asarray(0.5 * (found + found.T))

    def points(self, index: npt.NDArray[np.intp]) -> Array:
        """See ``Cofactors``."""
        return cofactors_of_points(self._problem, self._state, index, self._blocks)

    def _blocks(self, pairs: npt.NDArray[np.intp]) -> Array:
        """Joint blocks (B, k, k) of pairs of images."""
        return blocks_of_images(self._problem, self._of, pairs)

    def joint(self, images: tuple[int, ...], points: tuple[int, ...]) -> Array:
        """See ``Cofactors``."""
        unknown = [j for j in points if self._problem.active[j]]
        gains = [self._gain(j) for j in unknown]
        needed = tuple(sorted({*images}.union(*(seen for seen, _, _ in gains))))
        columns, q = self._columns(needed), self._of(needed)
        at = np.concatenate([np.zeros(0, np.intp), *(columns[k] for k in images)])
        seen = [np.concatenate([columns[k] for k in who]) for who, _, _ in gains]
        n = len(at)
        found = np.empty((n + 3 * len(gains), n + 3 * len(gains)))
        found[:n, :n] = q[np.ix_(at, at)]
        for a, (_, inverse, gain) in enumerate(gains):
            rows, effect = slice(n + 3 * a, n + 3 * a + 3), -gain @ q[seen[a]]
            found[rows, :n], found[:n, rows] = effect[:, at], effect[:, at].T
            for b in range(len(gains)):
                same = inverse if unknown[a] == unknown[b] else 0.0
                found[rows, n + 3 * b : n + 3 * b + 3] = same - effect[:, seen[b]] @ gains[b][2].T
        return np.asarray(0.5 * (found + found.T))

    def _columns(self, images: tuple[int, ...]) -> dict[int, npt.NDArray[np.intp]]:
        """Columns of images among the unknowns of these images."""
        first = np.concatenate([[0], np.cumsum([len(self._problem.parameters[k]) for k in images])])
        return {k: np.arange(first[n], first[n + 1]) for n, k in enumerate(images)}


class SchurCofactors(ReducedCofactors):
    """Joint cofactors at the solution.

    Parameters
    ----------
    problem : Problem
    system : SchurSystem
        The linearisation at the solution.

    Raises
    ------
    RuntimeError
        The normal equations are too close to singular.
    """

    def __init__(self, problem: Problem, system: SchurSystem) -> None:
        self._system, self._structure = system, system.structure
        self._place = np.full(len(problem.active), -1)
        self._place[self._structure.number] = np.arange(len(self._structure.number))
        reduced = system.reduced(0.0)
        self._root = system.buffers().root.copy()
        super().__init__(problem, system.state, reduced, self._gain_of)

    def _gain_of(self, j: int) -> Gain:
        """See :data:`Gain`."""
        s = self._structure
        p = int(self._place[j])
        r = np.zeros((3, 3))
        r[LOWER] = self._root[p]
        inverse = r.T @ r
        parts: dict[int, Array] = {}
        rows, first = self._system.rays(p), int(s.first[p])
        for a in range(first, int(s.first[p + 1])):
            k = int(s.image[a])
            basis, component = np.divmod(s.wide[k, : s.size[k]], s.n_components[k])
            jacobian = rows.d_image[a - first][:, component] * (s.basis[a, basis] * s.scale[k, : s.size[k]])
            parts[k] = parts.get(k, 0.0) + rows.d_ground[a - first].T @ jacobian
        return tuple(parts), inverse, inverse @ np.hstack(list(parts.values()))
