"""Nested dissection of a block in parts, and the fronts of its multifrontal elimination.

The parts are the leaves of a binary tree (``pool.tree``). An image is eliminated at the
lowest node that contains all its image points, because no other part contributes to its
normal equations. The front of a node consists of the images that it eliminates, and of
the images on its border. Images on the border also have image points outside the node
(George 1973; Duff & Reid 1983).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.adjustment.parts.parts import divide, rays_of_points, rows_of
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.reduced_choice import Choice, choose, narrowest, pattern_of

#: Up to this size, bytes, one process solves the whole reduced system. Statistics form its inverse up to 0.29 GB.
HELD: Final = 0.3e9
#: Fronts are used only if the largest front is smaller than the whole reduced system by
#: this factor. The elimination of a front needs up to three times its memory.
SMALLER: Final = 4.0


@dataclass(frozen=True)
class Front:
    """Front of the node of the parts ``lo`` to ``hi - 1``.

    Parameters
    ----------
    lo, hi : int
    images : (m,) int array
        Images that the node eliminates.
    unknowns : (n,) int array
        Unknowns of the front, numbered among the unknowns of all images; first the ``own`` ones of
        these images, then the border.
    own : int
    above : (n - own,) int array
        Places of the border in the front of the parent.
    """

    lo: int
    hi: int
    images: Index
    unknowns: Index
    own: int
    above: Index

    @property
    def is_part(self) -> bool:
        """True if the node is a single part."""
        return self.hi - self.lo == 1


@dataclass(frozen=True)
class Dissection:
    """Ground points of each part, and the fronts of each level of the tree, the root first.

    Without levels one process solves the sum of all parts.
    """

    points: list[Index]
    levels: tuple[tuple[Front, ...], ...] = ()

    @property
    def choice(self) -> Choice:
        """Return the predicted work of the elimination, and the bytes and unknowns of the largest front."""
        fronts = [front for level in self.levels for front in level]
        n, own = (np.array(v, float) for v in ([len(f.unknowns) for f in fronts], [f.own for f in fronts]))
        work = float(np.sum(own * (own**2 / 3.0 + (n - own) * n)))
        return Choice("fronts", work, 8.0 * float(n.max()) ** 2, int(n.max()))


def dissected(problem: Problem, parts: int, *, joined: bool) -> Dissection:
    """Return parts with fronts if the reduced system is large and all fronts are small; else parts without fronts.

    The memory of the whole system includes a factor, which conjugate gradients need for
    the covariance. ``joined``: observations of several images connect images of different
    nodes, so there are no fronts. Errors as in
    :func:`fg_orient.adjustment.parts.parts.divide`.
    """
    whole = Dissection(divide(problem, parts))
    if joined or 8.0 * float(problem.first[-1]) ** 2 <= HELD:
        return whole
    pattern = pattern_of(problem)._replace(rays=0)
    stored = 8.0 * float(np.prod(pattern.size[np.stack(pattern.blocks)], axis=0).sum())
    choice = choose(pattern, narrowest(pattern, problem.first).band)
    needed = stored + (8.0 * float(problem.first[-1]) ** 2 if choice.kind == "iterative" else choice.memory)
    if needed <= HELD:
        return whole
    out = nested(problem, parts)
    return out if out.choice.memory * SMALLER <= needed else whole


def nested(problem: Problem, parts: int) -> Dissection:
    """Divide the points into halves repeatedly, so that both halves share few images; return the fronts of this tree.

    At each node the images that are not yet on a border are ordered along the longest
    extent of their ground points. Each point belongs to the first of its images. Halves
    have about the same work: pairs of rays.
    """
    seen, rays, image = rays_of_points(problem, parts)
    begin, work = np.cumsum(rays) - rays, rays * (rays + 1) // 2
    centres, out = _centres(problem), list[Index]()

    def halve(points: Index, count: int, held: Mask) -> None:
        if count == 1:
            out.append(np.sort(seen[points]))
            return
        starts = np.cumsum(rays[points]) - rays[points]
        images = image[np.repeat(begin[points] - starts, rays[points]) + np.arange(rays[points].sum())]
        place = np.where(held, problem.n_images, _order(centres, ~held & _mask(images, len(held))))[images]
        last = np.maximum.reduceat(np.where(place < problem.n_images, place, -1), starts)
        order = np.lexsort((last, np.minimum.reduceat(place, starts)))
        total, first = np.cumsum(work[points[order]]), count // 2
        cut = int(np.searchsorted(total, total[-1] * first / count))
        cut = min(max(cut, first), len(points) - (count - first))
        left = np.zeros(len(points), bool)
        left[order[:cut]] = True
        of_ray = np.repeat(left, rays[points])
        both = _mask(images[of_ray], len(held)) & _mask(images[~of_ray], len(held))
        halve(points[left], first, held | both)
        halve(points[~left], count - first, held | both)

    halve(np.arange(len(seen)), parts, np.zeros(problem.n_images, bool))
    return Dissection(out, fronts_of(problem, out))


def _mask(images: Index, n: int) -> Mask:
    return np.asarray(np.bincount(images, minlength=n) > 0, dtype=bool)


def _centres(problem: Problem) -> Array:
    """Return the means (M, 3) of the approximate ground points of each image, m."""
    o, ground = problem.observations, problem.start.ground
    known = np.isfinite(ground[o.point]).all(axis=1)
    count = np.maximum(np.bincount(o.image[known], minlength=problem.n_images), 1)
    return np.stack([
        np.bincount(o.image[known], ground[o.point[known], axis], problem.n_images) / count for axis in range(3)
    ], axis=1)  # fmt: skip


def _order(centres: Array, chosen: Mask) -> Index:
    """Return the places (M,) of the chosen images along the longest extent of their centres; 0 for the others."""
    place, at = np.zeros(len(centres), np.int64), centres[chosen]
    if len(at):
        at = at - at.mean(axis=0)
        direction = np.linalg.eigh(at.T @ at)[1][:, -1]
        place[np.flatnonzero(chosen)[np.argsort(at @ direction, kind="stable")]] = np.arange(len(at))
    return place


def fronts_of(problem: Problem, points: list[Index]) -> tuple[tuple[Front, ...], ...]:
    """Return the fronts of the tree over these parts by level.

    Images without image points belong to the first part.
    """
    seen = np.zeros((len(points), problem.n_images), bool)
    for part, rows in zip(seen, rows_of(problem, points), strict=True):
        part[problem.observations.image[rows]] = True
    seen[0] |= ~seen.any(axis=0)
    first, last = seen.argmax(axis=0), len(points) - 1 - seen[::-1].argmax(axis=0)
    levels: list[list[tuple[int, int, Mask, Mask]]] = []

    def node(lo: int, hi: int, depth: int) -> Mask:
        if depth == len(levels):
            levels.append([])
        half = lo + (hi - lo) // 2
        images = seen[lo] if hi - lo == 1 else node(lo, half, depth + 1) | node(half, hi, depth + 1)
        complete = images & (first >= lo) & (last < hi)
        border: Mask = images & ~complete
        levels[depth].append((lo, hi, complete, border))
        return border

    node(0, len(points), 0)
    out, above = list[tuple[Front, ...]](), list[Front]()
    for level in levels:
        fronts = []
        for lo, hi, complete, border in level:
            own, rest = (_unknowns(problem, np.flatnonzero(m)) for m in (complete, border))
            parent = next((f.unknowns for f in above if f.lo <= lo and hi <= f.hi), rest)
            order = np.argsort(parent)
            places = order[np.searchsorted(parent, rest, sorter=order)]
            fronts.append(Front(lo, hi, np.flatnonzero(complete), np.concatenate([own, rest]), len(own), places))
        out.append(tuple(fronts))
        above = fronts
    return tuple(out)


def _unknowns(problem: Problem, images: Index) -> Index:
    """Return the numbers of the unknowns of some images, one image after the other."""
    first = problem.first
    return np.concatenate([np.zeros(0, np.int64), *(np.arange(first[k], first[k + 1]) for k in images.tolist())])
