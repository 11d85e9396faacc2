"""Choose the method for a reduced camera system by its predicted work and memory, from the sparsity of its blocks.

Work is counted in floating-point operations of LAPACK's Cholesky factorisation. GTSAM
takes six times as long for the same number (measured: 3060 unknowns, full). In each step
conjugate gradients read all blocks, or the rows of all image points, at 10 GB/s; LAPACK
computes 45 GFlop/s (one thread). Products from the rows need no blocks. The fill of the
sparse factor is counted by a symbolic elimination with least degree.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import Index, Mask
from fg_orient.adjustment.problem import Problem, no_point_is_named

if TYPE_CHECKING:
    from scipy.sparse import coo_array

#: Maximum number of elements of a band: 0.24 GB. Maximum number of unknowns of a full matrix: 1.8 GB.
BAND_LIMIT: Final = 30_000_000
LARGEST_FULL: Final = 15_000
#: Maximum number of unknowns of a full matrix of a border: 0.5 GB.
FULL_BORDER: Final = 8000
#: Time of GTSAM divided by the time of LAPACK for the same operations. GTSAM also takes the time of
#: ``GTSAM_IMAGE`` operations of LAPACK for each image.
GTSAM: Final = 6.0
GTSAM_IMAGE: Final = 1e6
#: Time of LAPACK's factorisation of a band divided by the time of its factorisation of a full matrix
#: with the same number of operations (measured with 432 to 2700 unknowns).
BANDED: Final = 1.4
#: Number of steps of conjugate gradients that are expected for each link on the path from
#: one image to the farthest one (measured: 2 to 10 in each of the first iterations), and
#: number of LAPACK's operations in the time in which a byte is read.
STEPS: Final = 15
PER_BYTE: Final = 4.5
#: Bytes of the rows of an image point, which each step reads if the blocks are not
#: formed; LAPACK's operations in the time in which a block is formed (measured: 2.5 us if
#: images are paired at random).
ROW_BYTES: Final = 208
PER_BLOCK: Final = 1e5
#: A method with a factor gives the covariance. It is preferred if its work divided by the least work is
#: below this.
PREFERRED: Final = 2.0
#: Number of unknowns above which conjugate gradients may be chosen; their number of steps
#: depends on the condition number.
ITERATIVE: Final = 3000
#: Number of image unknowns above which the Schur backend replaces the graph by default,
#: and how many times faster it must be.
WIDE: Final = 1500
FASTER: Final = 3.0
#: Maximum number of images for which the fill of a sparse factor is counted.
COUNTED: Final = 5000


class Pattern(NamedTuple):
    """Blocks of a reduced system: unknowns (M,) of each image; images (B,) of each block, row <= column.

    ``rays``: number of image points for products with the matrix by rows; zero if there are only blocks.
    """

    size: Index
    block_row: Index
    block_column: Index
    rays: int = 0

    @property
    def blocks(self) -> tuple[Index, Index]:
        """Images of each block."""
        return self.block_row, self.block_column

    def links(self) -> coo_array:
        """Return the matrix (M, M) with a number other than 0 where two images have a block.

        Its upper triangle.
        """
        from scipy.sparse import coo_array

        images = len(self.size)
        return coo_array((np.ones(len(self.block_row)), (self.block_row, self.block_column)), (images, images))


@dataclass(frozen=True)
class Order:
    """Order of the images: first unknown (M,) of each image, and all unknowns (u,).

    ``band`` is the number of elements below the diagonal in a column of the lower triangle.
    """

    place: Index
    unknowns: Index
    band: int


def narrowest(pattern: Pattern, first: Index) -> Order:
    """Return the order of images with the narrower band: as given, or reversed Cuthill-McKee (George & Liu 1981)."""
    images = len(pattern.size)
    if len(pattern.block_row) == images * (images + 1) // 2:  # all images share points, so the order has no effect
        return Order(first[:-1].astype(np.int64), np.arange(first[-1]), int(first[-1]) - 1)
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    links, orders = pattern.links(), []
    for order in (np.arange(images), reverse_cuthill_mckee((links + links.T).tocsr(), symmetric_mode=True)):
        place = np.empty(images, np.int64)
        place[order] = np.concatenate([[0], np.cumsum(pattern.size[order])[:-1]])
        begin = np.minimum(place[pattern.block_row], place[pattern.block_column])
        end = np.maximum(
            place[pattern.block_row] + pattern.size[pattern.block_row],
            place[pattern.block_column] + pattern.size[pattern.block_column],
        )
        unknowns = np.concatenate([np.arange(first[k], first[k + 1]) for k in order])
        orders.append(Order(place, unknowns, int((end - begin).max(initial=1)) - 1))
    return min(orders, key=lambda o: o.band)


class Choice(NamedTuple):
    """Method for a reduced system, its predicted work (operations of LAPACK) and memory (bytes).

    ``front``: unknowns of the largest front of a block in parts
    (``fg_orient.adjustment.parts.dissection``), else 0.
    """

    kind: str
    work: float
    memory: float
    front: int = 0


def predictions(pattern: Pattern, band: int) -> list[Choice]:
    """Return the methods that are possible for a pattern whose best order has this band.

    Parameters
    ----------
    pattern : Pattern
    band : int
        Elements of a column of the lower triangle below the diagonal.
    """
    u, b, k = float(pattern.size.sum()), float(band), float(pattern.size.max(initial=1))
    stored = 8.0 * k**2 * len(pattern.block_row)
    out = []
    if (b + 1.0) * u <= BAND_LIMIT and b < u - 1.0:
        out.append(Choice("banded", BANDED * (u * b**2 - 2.0 / 3.0 * b**3 + u * b), 8.0 * u * (b + 1.0)))
    if u <= LARGEST_FULL:
        out.append(Choice("dense", u**3 / 3.0, 8.0 * u**2))
    if u > ITERATIVE:
        steps, rows = STEPS * farthest(pattern) * PER_BYTE, float(ROW_BYTES * pattern.rays)
        out.append(Choice("iterative", steps * stored, stored))
        if pattern.rays:
            out.append(Choice("implicit", steps * rows, rows))
    if len(pattern.size) <= COUNTED:
        degrees = elimination_degrees(pattern).astype(float)
        work = GTSAM * k**3 * float(np.sum(1.0 / 3.0 + degrees + degrees**2)) + GTSAM_IMAGE * len(degrees)
        out.append(Choice("graph", work, 8.0 * k**2 * float(np.sum(1.0 + degrees))))
    return out


def choose(pattern: Pattern, band: int) -> Choice:
    """Return the method with the least predicted work, factors preferred.

    See :func:`predictions`.
    """
    formed = PER_BLOCK * len(pattern.block_row)
    return min(predictions(pattern, band), key=lambda one: _rank(one) + (0.0 if one.kind == "implicit" else formed))


def choice_of(problem: Problem) -> Choice:
    """Return the method for the reduced system of a problem, from its image points alone.

    See :func:`choose`.
    """
    pattern = pattern_of(problem)
    return choose(pattern, narrowest(pattern, problem.first).band)


def _rank(one: Choice) -> float:
    """Return the work; it is increased for methods without a factor."""
    return one.work * (PREFERRED if one.kind in ("iterative", "implicit") else 1.0)


def is_wide(problem: Problem) -> bool:
    """Return whether LAPACK or conjugate gradients solve the reduced system in much less time than GTSAM."""
    if problem.n_free_unknowns < WIDE or problem.ties is not None or not no_point_is_named(problem.block):
        return False
    pattern = pattern_of(problem)
    work = {one.kind: _rank(one) for one in predictions(pattern, narrowest(pattern, problem.first).band)}
    return min(work.values()) < work.get("graph", np.inf) / FASTER


def pattern_of(problem: Problem) -> Pattern:
    """Return the images with common unknown points, from the image points alone."""
    o, free = problem.observations, problem.active[problem.observations.point]
    return pattern_of_rays(o.image[free], o.point[free], np.diff(problem.first))


def pattern_of_rays(image: Index, point: Index, size: Index) -> Pattern:
    """Return the pattern of images with common points, from the image and unknown point (n,) of the image points."""
    from scipy.sparse import csr_array, eye_array

    seen = csr_array((np.ones(len(image)), (image, point)), (len(size), int(point.max(initial=0)) + 1))
    one, other = (seen @ seen.T + eye_array(len(size))).nonzero()
    upper = one <= other
    row, column = one[upper].astype(np.int64), other[upper].astype(np.int64)
    return Pattern(size.astype(np.int64), row, column, len(image))


def farthest(pattern: Pattern) -> int:
    """Count the links on the shortest path from the first image to the farthest image that is connected with it."""
    from scipy.sparse.csgraph import dijkstra

    way = dijkstra(pattern.links().tocsr(), directed=False, unweighted=True, indices=np.zeros(1, np.int64))
    return int(way[np.isfinite(way)].max(initial=1.0))


def elimination_degrees(pattern: Pattern) -> Index:
    """Count the images (M,) that remain linked to each image when it is eliminated, in the order of least degree."""
    images = len(pattern.size)
    if len(pattern.block_row) == images * (images + 1) // 2:
        return np.arange(images)[::-1]
    upper = pattern.links().toarray() != 0.0
    bits = _packed((upper | upper.T) & ~np.eye(images, dtype=bool))
    single = _packed(np.eye(images, dtype=bool))
    degree, out = np.bitwise_count(bits).sum(axis=1, dtype=np.int64), np.zeros(images, np.int64)
    gone = np.iinfo(np.int64).max
    for n in range(images):
        k = int(np.argmin(degree))
        out[n] = degree[k]
        if degree[k] == images - n - 1:  # the elimination of this image links all remaining images
            out[n:] = np.arange(images - n)[::-1]
            break
        own, degree[k] = bits[k], gone
        near = np.flatnonzero(np.unpackbits(own.view(np.uint8), count=images))
        bits[near] = (bits[near] | own) & ~single[near] & ~single[k]
        degree[near] = np.bitwise_count(bits[near]).sum(axis=1, dtype=np.int64)
    return out


def _packed(mask: Mask) -> npt.NDArray[np.uint64]:
    """Return the rows of a mask (n, m) as bits, in words of 64."""
    bits = np.packbits(mask, axis=1)
    return np.pad(bits, ((0, 0), (0, -bits.shape[1] % 8))).view(np.uint64)
