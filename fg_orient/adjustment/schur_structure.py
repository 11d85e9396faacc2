"""Convert a problem to the arrays of the Schur backend: sorted observations, columns, pieces, chunks, tiles.

Image points are sorted by ground point. Ground points are sorted by the images that see
them. Therefore data that are used together are adjacent in memory. The layout is described in
``fg_orient.kernels.batch``, ``fg_orient.kernels.batch_points`` and ``fg_orient.kernels.batch_pairs``.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.reduced_choice import Pattern
from fg_orient.adjustment.rows import groups
from fg_orient.kernels import batch_sort
from fg_orient.kernels.batch import Columns, batch
from fg_orient.kernels.batch_pairs import widen
from fg_orient.kernels.batch_rows import Flags

Index = npt.NDArray[np.int64]
Small = npt.NDArray[np.int32]

#: Number of chunks. Each chunk has its own sums (a few blocks of 6 kB). The threads share the chunks.
CHUNKS: Final = 12
#: Minimum and maximum number of image points of a chunk.
LEAST_CHUNK: Final = 768
MOST_CHUNK: Final = 16384
#: Time for the rows of an image point, in units of the time for a pair of rays (measured: 110 and 50 ns).
RAY_COST: Final = 2
#: Limits for the sums of the chunks: bytes per image point, bytes that are always allowed, minimum number of chunks.
SUMS: Final = 48
LEAST_SUMS: Final = 16_000_000
LEAST_CHUNKS: Final = 2
#: Number of image points whose rows are computed together: 25 MB.
TILE: Final = 131_072
#: Up to this number of image points, all rows are kept (200 bytes each). In larger
#: blocks, only this number of rows is kept, so that the memory is below 256 bytes per
#: image point. The other rows are computed three times instead of once.
ALL_KEPT: Final = 300_000
KEPT_SHARE: Final = 0.28
#: Number of records that are copied together.
RECORDS: Final = 32_768


@dataclass(frozen=True)
class Group:
    """Images of one equation and one set of unknowns.

    ``members`` (m,): their image points in ascending order; None: all image points.
    """

    rows: Callable[..., int]
    columns: Columns
    images: Index
    members: Small | None
    n_basis: int


@dataclass(frozen=True)
class Tile:
    """Consecutive chunks whose rows are computed and used together.

    First and end of its image points, of its positions among the ground points, and of
    its chunks. ``kept``: true if its rows stay in memory; otherwise they are computed for
    each use.
    """

    points: tuple[int, int]
    places: tuple[int, int]
    chunks: tuple[int, int]
    kept: bool


@dataclass(frozen=True)
class Structure:
    """Arrays that do not change between iterations.

    Parameters
    ----------
    groups : tuple of Group
    row, image, point : (n,) int arrays
        Arrays of the sorted image points: row in the problem, image, ground point.
    number, free : (P,) int arrays
        Ground point of each position; kind: 0 constant, 1 unknown, 2 unknown and observed.
    first : (P + 1,) int array
        First image point of each position.
    basis : (n, b) array
    n_basis, n_components, size : (M,) int arrays
        Numbers of each image; ``size``: number of its unknowns.
    wide, scale : (M, k) arrays
        Position among the wide numbers, and factor, of each unknown.
    pieces, chunks, slots : int arrays
        See ``fg_orient.kernels.batch_pairs``.
    chunk_places, slot_begin : (N + 1,) int arrays
        First place and first slot of each chunk.
    slot_own : (S,) int array
        1 for slots of rays that are paired with themselves.
    cost : (N + 1,) int array
        Cumulative cost of the chunks, in pairs of rays.
    block_row, block_column : (B,) int arrays
        Images of each block of the reduced system, row <= column.
    block_begin, block_slots : (B + 1,), (S,) int arrays
        Slots of each block.
    tiles : tuple of Tile
    """

    groups: tuple[Group, ...]
    row: Small
    image: Small
    point: Small
    number: Small
    free: npt.NDArray[np.int8]
    first: Small
    basis: Array
    n_basis: Index
    n_components: Index
    size: Index
    wide: Index
    scale: Array
    pieces: Index
    chunks: Index
    slots: Small
    chunk_places: Small
    slot_begin: Index
    slot_own: Small
    cost: Index
    block_row: Index
    block_column: Index
    block_begin: Index
    block_slots: Small
    tiles: tuple[Tile, ...]

    @property
    def pattern(self) -> Pattern:
        """Blocks of the reduced system."""
        return Pattern(self.size, self.block_row, self.block_column)

    @cached_property
    def observed(self) -> Index:
        """Ground points with control-point equations."""
        return np.asarray(self.number[self.free == 2], dtype=np.int64)

    @cached_property
    def width(self) -> int:
        """Largest number of wide numbers of an image."""
        return int((self.n_basis * self.n_components).max())

    @cached_property
    def own_block(self) -> dict[int, int]:
        """Block of each image with itself."""
        own = np.flatnonzero(self.block_row == self.block_column)
        return dict(zip(self.block_row[own].tolist(), own.tolist(), strict=True))

    def widened(self, image: Array) -> Array:
        """Return the wide numbers (M, w) of unknowns (M, k), in the units of the components."""
        out = np.zeros((len(image), self.width))
        widen(image, self.wide, self.scale, self.size, out)
        return out


#: Number (P,) of the group of each ground point, from its first image point and the images of all image points.
Grouping = Callable[[Small, Small], Index]


def compile_structure(problem: Problem, grouping: Grouping | None = None, *, diagonal: bool = False) -> Structure:
    """Sort and index a problem. The points of a group follow each other, and a chunk contains points of one group only.

    With ``diagonal``, only the blocks of each image with itself exist, and all rows are kept.
    """
    row, image, point, first, fence = _sorted(problem, grouping)
    number = point[first[:-1]]
    free = np.where(problem.active[number], np.where(problem.observed[number], 2, 1), 0).astype(np.int8)
    image_groups = _groups(problem, image)
    n_basis, n_components, size = (np.zeros(problem.n_images, np.int64) for _ in range(3))
    widest = int(np.diff(problem.first).max())
    wide, scale = np.zeros((problem.n_images, widest), np.int64), np.zeros((problem.n_images, widest))
    basis = np.zeros((len(row), max(g.n_basis for g in image_groups)))
    for g in image_groups:
        k = len(g.columns.scale)
        n_basis[g.images], n_components[g.images], size[g.images] = g.n_basis, g.columns.n_components, k
        wide[g.images, :k], scale[g.images, :k] = g.columns.wide, g.columns.scale
        _write_basis(problem, row, g, basis)
    numbers = int(n_basis.max() * n_components.max()) ** 2
    pieces, chunks, slots = _chunks(first, image, free, fence, problem.n_images, numbers, diagonal)
    chunk_places = np.append(pieces[chunks[:-1], 1], len(number)).astype(np.int32)
    pairs = np.append(pieces[1:, 4], _entries(pieces)) - pieces[:, 4]
    cost = np.concatenate([[0], np.cumsum((pairs + RAY_COST * pieces[:, 3]) * pieces[:, 2])])[chunks]
    return Structure(
        image_groups,
        row,
        image,
        point,
        number,
        free,
        first,
        basis,
        n_basis,
        n_components,
        size,
        wide,
        scale,
        pieces,
        chunks,
        chunk_places=chunk_places,
        cost=cost,
        tiles=_tiles(first, chunk_places, diagonal),
        **slots,
    )


def _sorted(problem: Problem, grouping: Grouping | None) -> tuple[Small, Small, Small, Small, Flags]:
    """Return row, image and ground point of sorted image points, first of each ground point, flags of new groups.

    Image points are sorted by ground point. Ground points are sorted by first and last
    image, number of rays and all their images. So rays that two images share lie in few
    runs of memory, and points seen in the same images follow each other.
    """
    o, n, m = problem.observations, len(problem.observations), problem.n_images
    image, point = np.asarray(o.image, np.int64), np.asarray(o.point, np.int64)
    order, other = np.arange(n, dtype=np.int32), np.empty(n, np.int32)
    batch_sort.sort_by(image, order, np.empty(m + 1, np.int64), other)
    batch_sort.sort_by(point, other, np.empty(len(problem.active) + 1, np.int64), order)
    key, code, start = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n + 1, np.int32)
    constant = (~problem.active).astype(np.int8)
    seen = batch_sort.signatures(order, point, image, constant, m, key, code, start)
    first = np.empty(seen + 1, np.int32)
    row, sorted_image, sorted_point = other, np.empty(n, np.int32), np.empty(n, np.int32)
    points = np.lexsort((code[:seen], key[:seen]))
    batch_sort.arrange(points, start, order, image, point, row, sorted_image, sorted_point, first)
    fence = np.zeros(seen, np.int8)
    if grouping is not None:
        group = grouping(first, sorted_image)
        places = np.argsort(group, kind="stable")
        fence[1:] = np.diff(group[places]) != 0
        batch_sort.arrange(points[places], start, order, image, point, row, sorted_image, sorted_point, first)
    return row, sorted_image, sorted_point, first, fence


def _groups(problem: Problem, image: Small) -> tuple[Group, ...]:
    """Return the images with the same equation and unknowns, and their image points."""
    out, image_groups = [], groups(problem.models)
    for images in image_groups:
        model = problem.models[images[0]]
        rows, columns = batch(model.equation, model.parameters.setup, problem.records)
        members = None
        if len(image_groups) > 1:
            inside = np.zeros(problem.n_images, dtype=bool)
            inside[images] = True
            members = np.flatnonzero(inside[image]).astype(np.int32)
        out.append(Group(rows, columns, np.array(images, np.int64), members, int(columns.basis.max(initial=0)) + 1))
    return tuple(out)


def _write_basis(problem: Problem, row: Small, group: Group, basis: Array) -> None:
    """Write the basis values of a group's image points, some at a time, because their records are copied for it."""
    for lo in range(0, len(row) if group.members is None else len(group.members), RECORDS):
        at = slice(lo, lo + RECORDS) if group.members is None else group.members[lo : lo + RECORDS]
        basis[at, : group.n_basis] = group.columns.values(problem.records[row[at]])


def _chunks(
    first: Small,
    image: Small,
    free: npt.NDArray[np.int8],
    fence: npt.NDArray[np.int8],
    n_images: int,
    numbers: int,
    diagonal: bool,
) -> tuple[Index, Index, dict[str, Any]]:
    """Return the pieces (Q, 5), the first of each chunk and their number (N + 1,), and their :func:`_slots`.

    The number of chunks is reduced if their sums, ``numbers`` for each slot, would need
    more memory than the rows. This happens if different images see neighbouring points.
    If even one slot for each block needs more, the least number is used. A chunk begins
    at each ``fence``.
    """
    total = int(first[-1])
    limit = min(max(total // CHUNKS, LEAST_CHUNK), MOST_CHUNK)
    space, begin = np.zeros((len(free), 5), np.int64), np.zeros(len(free) + 1, np.int64)
    least, most, too_many = max(LEAST_CHUNKS, int(fence.sum()) + 1), max(SUMS * total, LEAST_SUMS), False
    while True:
        n_pieces, n_chunks = batch_sort.cut_pieces(first, image, free, fence, limit, space, begin)
        few = n_chunks <= least
        if few or not too_many:
            pieces, chunks = space[:n_pieces].copy(), begin[: n_chunks + 1].copy()
            slots = _slots(pieces, chunks, image, free, n_images, diagonal)
            if few or len(slots["slot_own"]) * numbers * 8 <= most:
                return pieces, chunks, slots
            too_many = len(slots["block_row"]) * numbers * 8 > most
        limit *= 2


def _entries(pieces: Index) -> int:
    """Return the number of pairs of rays of all pieces, each piece counted once."""
    return int(pieces[-1, 4] + pieces[-1, 3] * (pieces[-1, 3] + 1) // 2) if len(pieces) else 0


def _slots(
    pieces: Index, chunks: Index, image: Small, free: npt.NDArray[np.int8], n_images: int, diagonal: bool
) -> dict[str, Any]:
    """Return the slots of the pieces, and blocks of the slots: fields of :class:`Structure` by name."""
    key, kind = np.empty(_entries(pieces), np.int64), np.empty(_entries(pieces), np.int64)
    batch_sort.list_entries(pieces, chunks, image, free, n_images, key, kind)
    exists = (kind >= 0) & (key % (n_images + 1) == 0) if diagonal else kind >= 0
    blocks, block = np.unique(key[exists], return_inverse=True)
    chunk, own = np.divmod(kind[exists], 2)
    slot_key, slot = np.unique((chunk * len(blocks) + block) * 2 + own, return_inverse=True)
    slots = np.full(len(key), -1, np.int32)
    slots[exists] = slot
    begin = np.searchsorted(slot_key // (2 * len(blocks)), np.arange(len(chunks)))
    slot_block = slot_key // 2 % len(blocks)
    block_begin = np.concatenate([[0], np.cumsum(np.bincount(slot_block, minlength=len(blocks)))])
    return {
        "slots": slots,
        "slot_begin": begin.astype(np.int64),
        "slot_own": (slot_key % 2).astype(np.int32),
        "block_row": blocks // n_images,
        "block_column": blocks % n_images,
        "block_begin": block_begin.astype(np.int64),
        "block_slots": np.argsort(slot_block, kind="stable").astype(np.int32),
    }


def _tiles(first: Small, places: Small, every: bool) -> tuple[Tile, ...]:
    """Return the tiles of about TILE image points.

    The rows of the first tiles, or of ``every`` tile, are kept.
    """
    points = first[places].astype(np.int64)
    total, cuts = int(points[-1]), [0]
    while cuts[-1] < len(places) - 1:
        cuts.append(max(int(np.searchsorted(points, points[cuts[-1]] + TILE, side="right")) - 1, cuts[-1] + 1))
    out = []
    for lo, hi in itertools.pairwise(cuts):
        kept = every or total <= ALL_KEPT or int(points[hi]) <= KEPT_SHARE * total
        out.append(Tile((int(points[lo]), int(points[hi])), (int(places[lo]), int(places[hi])), (lo, hi), kept))
    return tuple(out)
