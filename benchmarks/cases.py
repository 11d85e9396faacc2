"""The module makes the problems that are timed: synthetic SPOT-like blocks of fixed sizes, and a resection."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy.sparse as sp

from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.model.block import Block, Coordinates, GroundPoints
from fg_orient.model.names import Role
from fg_orient.simulate.block import BlockOptions, grid_block


@dataclass(frozen=True)
class Size:
    """A size states the number of scenes along each side of the block and the number of ground points."""

    rows: int
    columns: int
    points: int


#: Each image has 27 unknowns. The blocks have 2, 4, 16, 36 and 100 images with 2 to 4 rays
#: per ground point. A name is the order of magnitude of the number of image points; only "94"
#: is exact: a pair of images with 43 points.
SIZES: Final = {
    "94": Size(1, 2, 43),
    "1e3": Size(2, 2, 339),
    "1e4": Size(4, 4, 3_290),
    "1e5": Size(6, 6, 31_880),
    "1e6": Size(10, 10, 305_021),
}
EOP_SET: Final = 20
RESECTION_POINTS: Final = 94


def spot_block(size: str) -> Block:
    """Return the block of a size with set 20.

    2 % of the points (6 or more) are control points, the others tie points.
    """
    s = SIZES[size]
    options = BlockOptions(rows=s.rows, columns=s.columns, points=s.points, check_share=0.0)
    block, _ = grid_block(options)
    return replace(block, options=replace(block.options, eop_set=EOP_SET))


def resection_block() -> Block:
    """Return a block of one image and 94 control points without errors; it has 27 unknowns."""
    full = BlockOptions(rows=1, columns=2, points=RESECTION_POINTS, control_share=1.0, check_share=0.0)
    block, _ = grid_block(full)
    known = block.points.known
    fixed = Coordinates(known.ecef_m, known.sigma_enu_m, np.ones(len(known.ecef_m), bool))
    return replace(
        block,
        images=block.images[:1],
        points=GroundPoints(block.points.ids, (Role.CONTROL,) * len(block.points.ids), fixed),
        observations=block.observations.take(block.observations.image == 0),
        options=replace(block.options, eop_set=EOP_SET),
    )


def resection_problem() -> Problem:
    """Return the compiled problem of the resection."""
    return compile_problem(resection_block())


@dataclass(frozen=True)
class Counts:
    """Every record contains these numbers.

    One image point gives two equations; a pair consists of two rays of one point.
    """

    n_images: int
    n_ground_points: int
    n_image_points: int
    n_observations: int
    n_unknowns: int
    redundancy: int
    n_pairs: int
    image_unknowns: int
    half_bandwidth: int


def counts(problem: Problem) -> Counts:
    """Return the numbers of a problem; ``half_bandwidth`` belongs to the reduced system in the order of the images."""
    o = problem.observations
    free = problem.active[o.point]
    rays = np.bincount(o.point[free], minlength=len(problem.active))
    seen = sp.csr_array((np.ones(len(o)), (o.image, o.point)), shape=(problem.n_images, len(problem.active)))
    together = (seen @ seen.T).tocoo()
    reach = int(np.abs(together.coords[0] - together.coords[1]).max(initial=0))
    widest = int(np.diff(problem.first).max())
    return Counts(
        problem.n_images, int(problem.active.sum()), len(o), problem.n_observations, problem.n_unknowns,
        problem.redundancy, int((rays * (rays + 1) // 2).sum()), problem.n_image_unknowns, (reach + 1) * widest - 1,
    )  # fmt: skip


def note(text: str) -> None:
    """Print a line of progress."""
    print(text, file=sys.stderr, flush=True)
