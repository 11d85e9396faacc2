"""Multifrontal solution of the reduced system of a dissected block; only vectors are in the memory of this process.

The tree is eliminated from the parts to the root. Then solutions are computed from the
root to the parts. Each front computes the unknowns of its images from the unknowns of its
border. The matrices are in the files of the fronts.
"""

from __future__ import annotations

import contextlib
import os
import weakref
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from factors.arrays import Array, Index
from fg_orient.adjustment.parts import fronts, tasks
from fg_orient.adjustment.parts.dissection import Dissection, Front
from fg_orient.adjustment.parts.fronts import Added, front_file, inverse_file, rest_file
from fg_orient.adjustment.parts.parts import read_array
from fg_orient.adjustment.parts.pool import Pool
from fg_orient.adjustment.parts.tasks import At
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.schur_reduced import inverse_norm, require_regular
from fg_orient.formats.staging import scratch_folder


class Multifrontal:
    """Factor of a reduced system in the files of its fronts; see ``schur_reduced.Reduced``.

    Parameters
    ----------
    problem : Problem
    dissection : Dissection
        Dissection with fronts.
    pool : Pool
    folder : Path
        Work folder.
    name : str
        Part of the names of the files.
    """

    def __init__(self, problem: Problem, dissection: Dissection, pool: Pool, folder: Path, name: str) -> None:
        self._problem, self._levels, self._pool = problem, dissection.levels, pool
        self._folder, self._name = folder, name
        self._depth = np.zeros(problem.n_images, np.int64)
        self._node = np.zeros(problem.n_images, np.int64)
        for depth, level in enumerate(self._levels):
            for number, node in enumerate(level):
                self._depth[node.images], self._node[node.images] = depth, number
        self._read: tuple[Front, Array] | None = None
        #: Half the weighted sum of squares of all parts.
        self.error = 0.0

    def eliminate(
        self, at: list[At], point_damping: float, diagonal: float, gradient: Array, blocks: Array | None
    ) -> None:
        """Eliminate the points of all parts, then the images from the parts to the root.

        Parameters
        ----------
        at : list of At
            One for each part.
        point_damping, diagonal : float
            Damping of the ground points; priors and damping of the images.
        gradient : (u,) array
            Gradient of priors and extra observations of the images.
        blocks : (M, k, k) array or None
            Normal equations of the extra observations of each image.

        Raises
        ------
        Singular
            Singular :: A ground point, or an image, is not determined.
        """
        size = np.diff(self._problem.first).tolist()

        def added(node: Front) -> Added:
            own = () if blocks is None else tuple(blocks[k, : size[k], : size[k]] for k in node.images.tolist())
            return Added(diagonal, gradient[node.unknowns[: node.own]], own)

        parts = sorted((node for level in self._levels for node in level if node.is_part), key=lambda node: node.lo)
        self.error = float(
            self._pool.total(
                tasks.front,
                [(one, point_damping, node, added(node), self._name) for one, node in zip(at, parts, strict=True)],
            )
        )
        for depth in range(len(self._levels) - 2, -1, -1):
            sums = [
                (node, [c for c in self._levels[depth + 1] if node.lo <= c.lo and c.hi <= node.hi], added(node))
                for node in self._levels[depth]
                if not node.is_part
            ]
            self._each(fronts.front_of_children, sums)
            _unlink(rest_file(self._folder, self._name, child) for _, children, _ in sums for child in children)

    def _each(self, task: Callable[..., Any], arguments: list[tuple[Any, ...]]) -> list[Any]:
        """Run a task for some fronts; return the results in their order."""
        folder, out = str(self._folder), dict[int, Any]()
        out.update(self._pool.each(task, [(folder, self._name, *one) for one in arguments]))
        return [out[k] for k in range(len(arguments))]

    def step(self) -> Array:
        """Solve ``S x = -gradient`` for the gradient of the elimination."""
        return self._backward(np.empty((int(self._problem.first[-1]), 1)), given=False)[:, 0]

    def _backward(self, x: Array, *, given: bool = True) -> Array:
        """Replace right sides (u, c) after forward substitution by solutions, from the root on.

        By default, the right side is the gradient.
        """
        for level in self._levels:
            places = [(node.unknowns[: node.own], node.unknowns[node.own :]) for node in level]
            arguments = [
                (node, x[own] if given else None, x[border]) for node, (own, border) in zip(level, places, strict=True)
            ]
            for (own, _), solved in zip(places, self._each(fronts.backward, arguments), strict=True):
                x[own] = solved
        return x

    def solved(self, right: Array) -> Array:
        """Return the solutions (u, c) of S for right sides."""
        x = right.copy()
        for level in reversed(self._levels):
            done = self._each(fronts.forward, [(node, x[node.unknowns[: node.own]]) for node in level])
            for node, (own, border) in zip(level, done, strict=True):
                x[node.unknowns[: node.own]] = own
                x[node.unknowns[node.own :]] -= border
        return self._backward(x)

    def _product(self, x: Array | None) -> Array:
        """Return the product of S with a vector (u,); without a vector, return the diagonal of S."""
        out = np.zeros(int(self._problem.first[-1]))
        nodes = [node for level in self._levels for node in level]
        of_nodes = self._each(fronts.product, [(node, None if x is None else x[node.unknowns]) for node in nodes])
        for node, part in zip(nodes, of_nodes, strict=True):
            out[node.unknowns] += part
        return out

    def condition(self) -> float:
        """Return the estimated condition number in the 1-norm of S, scaled to a unit diagonal."""
        return self._condition

    @cached_property
    def _condition(self) -> float:
        scale = 1.0 / np.sqrt(self._product(None))
        norm = inverse_norm(lambda x: scale * self._product(scale * x), len(scale))
        return norm * inverse_norm(lambda x: self.solved((x / scale)[:, None])[:, 0] / scale, len(scale))

    def covariance(self, images: tuple[int, ...]) -> Array:
        """Return the joint cofactors of images: from the front that contains all of them, else from unit columns.

        RuntimeError: S is too close to singular.
        """
        require_regular(self._condition)
        first = self._problem.first
        index = np.concatenate([np.arange(first[k], first[k + 1]) for k in images])
        lowest = max(images, key=lambda k: int(self._depth[k]))
        node = self._levels[self._depth[lowest]][self._node[lowest]]
        if np.isin(index, node.unknowns).all():
            at = _places(node, index)
            return np.asarray(self._cofactors(node)[np.ix_(at, at)])
        right = np.zeros((int(first[-1]), len(index)))
        right[index, np.arange(len(index))] = 1.0
        q = self.solved(right)[index]
        return np.asarray(0.5 * (q + q.T))

    @property
    def selects(self) -> bool:
        """See ``schur_reduced.Reduced``."""
        return True

    def selected(self, pairs: Index) -> Array:
        """See ``schur_reduced.Reduced``; one front after the other."""
        require_regular(self._condition)
        size, k = np.diff(self._problem.first), int(np.diff(self._problem.first).max())
        out = np.zeros((len(pairs), k, k))
        lowest = pairs[np.arange(len(pairs)), np.argmax(self._depth[pairs], axis=1)]
        for b in np.lexsort((self._node[lowest], self._depth[lowest])).tolist():
            (i, j) = pairs[b].tolist()
            q = self.covariance((i,) if i == j else (i, j))
            out[b, : size[i], : size[j]] = q[: size[i], -size[j] :]
        return out

    def _cofactors(self, node: Front) -> Array:
        """Return the cofactors of a front.

        The fronts on the path from the root are computed first.
        """
        if self._read is None or self._read[0] is not node:
            path = [f for level in self._levels for f in level if f.lo <= node.lo and node.hi <= f.hi]
            for parent, one in zip([None, *path], path, strict=False):
                if not inverse_file(self._folder, self._name, one).exists():
                    fronts.inverse(str(self._folder), self._name, one, parent)
            self._read = node, read_array(inverse_file(self._folder, self._name, node))
        return self._read[1]

    def keep(self, parent: Path) -> Multifrontal:
        """Move the files to a folder that exists as long as this object.

        Then only this process works on them.
        """
        kept = contextlib.ExitStack()
        own = kept.enter_context(scratch_folder(parent))
        weakref.finalize(self, kept.close)
        for file in self._files():
            os.replace(file, own / file.name)
        self._folder, self._pool = own, Pool()
        return self

    def remove(self) -> None:
        """Remove the files."""
        _unlink(self._files())

    def _files(self) -> list[Path]:
        return [front_file(self._folder, self._name, node) for level in self._levels for node in level if node.own]


def _unlink(files: Iterable[Path]) -> None:
    for file in files:
        with contextlib.suppress(OSError):
            file.unlink()


def _places(node: Front, unknowns: Index) -> Index:
    """Return the places of unknowns in a front."""
    order = np.argsort(node.unknowns)
    return np.asarray(order[np.searchsorted(node.unknowns, unknowns, sorter=order)])
