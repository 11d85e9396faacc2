"""A problem compiled to arrays for the Schur backend, once: sorted observations, columns, pairs, segments.

Image points are sorted by ground point, and ground points by the images that see them: what is used together lies
together in memory. The layout is that of ``factors.batch``, ``factors.batch_points`` and ``factors.batch_pairs``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors import batch_pairs
from factors.batch import Columns, batch, has_batch
from fg_orient.adjustment.models.contract import groups
from fg_orient.adjustment.problem import Problem

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Small = npt.NDArray[np.int32]

#: Fewer image points than this are computed by one thread: starting a second one costs 50 us at each stage (measured).
SERIAL_LIMIT: Final = 2000
#: Pairs of one segment at most: small enough to share out, large enough to make the sums between segments cheap.
SEGMENT: Final = 2048


def reason_against(problem: Problem) -> str:
    """Why the Schur backend cannot take a problem; empty if it can."""
    if problem.block.extra:
        return "the block has own observations"
    unknown = sorted({m.equation.name for m in problem.models if not has_batch(m.equation)})
    return f"no batch for the equation {', '.join(unknown)}" if unknown else ""


@dataclass(frozen=True)
class Group:
    """Images of one equation and one set of unknowns."""

    rows: Callable[..., int]
    columns: Columns
    images: Index
    members: Index
    n_basis: int


@dataclass(frozen=True)
class Structure:
    """What does not change between iterations.

    Parameters
    ----------
    groups : tuple of Group
    row, image, point, place : (n,) int arrays
        Of the sorted image points: row in the problem, image, ground point, and its place among those seen.
    number, free : (P,) int arrays
        Ground point of each place; 0 constant, 1 unknown, 2 unknown and observed.
    first : (P + 1,) int array
        First image point of each place.
    begin, order : (M + 1,), (n,) int arrays
        Image points of each image.
    basis : (n, b) array
    n_basis, n_components, size : (M,) int arrays
        Of each image; ``size``: number of its unknowns.
    wide, scale : (M, k) arrays
        Place among the wide numbers and factor of each unknown.
    left, right : (q,) int arrays
        Pairs of image points, sorted by block.
    cut, segments : int arrays
        First pair of each segment, first segment of each block.
    block_row, block_column : (B,) int arrays
        Images of each block of the reduced system, row <= column.
    """

    groups: tuple[Group, ...]
    row: Index
    image: Index
    point: Index
    place: Index
    number: Index
    free: Index
    first: Index
    begin: Index
    order: Small
    basis: Array
    n_basis: Index
    n_components: Index
    size: Index
    wide: Index
    scale: Array
    left: Small
    right: Small
    cut: Index
    segments: Index
    block_row: Index
    block_column: Index

    @property
    def observed(self) -> Index:
        """Ground points with control-point equations."""
        return np.asarray(self.number[self.free == 2])

    @property
    def width(self) -> int:
        """Largest number of wide numbers of an image."""
        return int((self.n_basis * self.n_components).max())

    def widened(self, image: Array) -> Array:
        """Wide numbers (M, w) of unknowns (M, k), in the units of the components."""
        out = np.zeros((len(image), self.width))
        for group in self.groups:
            c = group.columns
            out[np.ix_(group.images, c.wide)] = image[group.images][:, : len(c.scale)] * c.scale
        return out

    def narrowed(self, wide: Array) -> Array:
        """Gradient (u,) of all unknowns from the wide one (M, w)."""
        return np.concatenate([
            wide[i, self.wide[i, : self.size[i]]] * self.scale[i, : self.size[i]] for i in range(len(wide))
        ])  # fmt: skip


def compile_structure(problem: Problem) -> Structure:
    """Sort and index a problem that :func:`reason_against` has nothing against."""
    o = problem.observations
    row = _order(o.image, o.point)
    image, point = o.image[row].astype(np.int64), o.point[row].astype(np.int64)
    first = np.append(np.flatnonzero(np.diff(point, prepend=-1)), len(point)).astype(np.int64)
    number, place = point[first[:-1]], np.repeat(np.arange(len(first) - 1), np.diff(first))
    free = np.where(problem.active[number], np.where(problem.observed[number], 2, 1), 0).astype(np.int64)
    found = _groups(problem, image)
    n_basis, n_components, size = (np.zeros(problem.n_images, np.int64) for _ in range(3))
    widest = int(np.diff(problem.first).max())
    wide, scale = np.zeros((problem.n_images, widest), np.int64), np.zeros((problem.n_images, widest))
    basis = np.zeros((len(row), max(g.n_basis for g in found)))
    for g in found:
        k = len(g.columns.scale)
        n_basis[g.images], n_components[g.images], size[g.images] = g.n_basis, g.columns.n_components, k
        wide[g.images, :k], scale[g.images, :k] = g.columns.wide, g.columns.scale
        basis[g.members, : g.n_basis] = g.columns.values(problem.records[row[g.members]])
    left, right = _pairs(first, image, free, problem.n_images)
    cut, segments = _segments(image[left] * problem.n_images + image[right])
    order = np.argsort(image, kind="stable").astype(np.int32)
    begin = np.concatenate([[0], np.cumsum(np.bincount(image, minlength=problem.n_images))]).astype(np.int64)
    starts = cut[segments[:-1]]
    return Structure(
        found, row, image, point, place.astype(np.int64), number, free, first, begin, order, basis, n_basis,
        n_components, size, wide, scale, left, right, cut, segments, image[left[starts]], image[right[starts]],
    )  # fmt: skip


def _order(image: npt.NDArray[np.intp], point: npt.NDArray[np.intp]) -> Index:
    """Rows of image points by ground point, points by first and last image and number of rays.

    The rays that two images share then lie in few runs of memory, whatever the order of the points in the file: a
    third of the time of the pairs at 1e5 image points (measured).
    """
    row = np.lexsort((image, point))
    seen, first, place = np.unique(point[row], return_index=True, return_inverse=True)
    rays = np.diff(np.append(first, len(row)))
    last = image[row[first + rays - 1]]
    rank = np.empty(len(seen), np.int64)
    rank[np.lexsort((rays, last, image[row[first]]))] = np.arange(len(seen))
    return row[np.argsort(rank[place], kind="stable")].astype(np.int64)


def _groups(problem: Problem, image: Index) -> tuple[Group, ...]:
    """Images with the same equation and unknowns, and their image points."""
    out = []
    for images in groups(problem.models):
        model = problem.models[images[0]]
        rows, columns = batch(model.equation, model.parameters.setup)
        inside = np.zeros(problem.n_images, dtype=bool)
        inside[images] = True
        members = np.flatnonzero(inside[image]).astype(np.int64)
        out.append(Group(rows, columns, np.array(images, np.int64), members, int(columns.basis.max()) + 1))
    return tuple(out)


def _pairs(first: Index, image: Index, free: Index, n_images: int) -> tuple[Small, Small]:
    """Pairs of rays sorted by image of the first, then of the second ray; by point within."""
    n = batch_pairs.count_pairs(first, image, free)
    left, right, other_left, other_right = (np.empty(n, np.int32) for _ in range(4))
    batch_pairs.list_pairs(first, image, free, left, right)
    counts = np.empty(n_images + 1, np.int64)
    batch_pairs.sort_pairs(left, right, False, image, counts, other_left, other_right)
    batch_pairs.sort_pairs(other_left, other_right, True, image, counts, left, right)
    return left, right


def _segments(keys: Index) -> tuple[Index, Index]:
    """First pair of each segment and first segment of each block, both with their ends, of sorted block keys."""
    starts = np.flatnonzero(np.diff(keys, prepend=-1))
    lengths = np.diff(np.append(starts, len(keys)))
    counts = -(-lengths // SEGMENT)
    segments = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    within = np.arange(segments[-1]) - np.repeat(segments[:-1], counts)
    cut = np.repeat(starts, counts) + within * SEGMENT
    return np.append(cut, len(keys)).astype(np.int64), segments


class Workers:
    """Run a kernel over a range, divided among threads; results do not depend on their number.

    Parameters
    ----------
    threads : int
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    def _others(self) -> ThreadPoolExecutor:
        """Threads beside the caller's, kept: to start one takes 0.1 to 0.5 ms. A forked process has lost them."""
        if self._pool is None or self._process != os.getpid():
            self._pool, self._process = ThreadPoolExecutor(self.threads - 1), os.getpid()
        return self._pool

    def run(self, kernel: Callable[..., Any], cuts: int | Index, *arguments: Any) -> list[Any]:
        """Call ``kernel(lo, hi, *arguments)`` for each part; results in the order of the parts.

        ``cuts`` is the length of the range, or the running sum of the cost of its items from 0.
        """
        bounds = self._bounds(cuts)

        def part(k: int) -> Any:
            return kernel(int(bounds[k]), int(bounds[k + 1]), *arguments)

        others = [self._others().submit(part, k) for k in range(1, self.threads)]
        try:
            own = part(0)
        finally:
            wait(others)  # they write to the arrays of the caller
        return [own, *(other.result() for other in others)]

    def _bounds(self, cuts: int | Index) -> Index:
        shares = np.arange(self.threads + 1) / self.threads
        if isinstance(cuts, int):
            return np.asarray(np.round(shares * cuts), dtype=np.int64)
        bounds: Index = np.searchsorted(cuts, shares * cuts[-1]).astype(np.int64)
        bounds[-1] = len(cuts) - 1  # items that cost nothing may stand at the end
        return bounds
