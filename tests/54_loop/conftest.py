"""Fixtures are blocks with gross errors, small enough for all three backends."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from fg_orient.model.block import Block, ImagePoints
from fg_orient.simulate.block import BlockOptions, grid_block


@lru_cache
def clean_block(rows: int, columns: int, points: int) -> Block:
    return grid_block(BlockOptions(rows=rows, columns=columns, points=points, seed=5))[0]


def with_options(block: Block, **options: object) -> Block:
    return replace(block, options=replace(block.options, **options))


def moved_rays(block: Block, rows: npt.NDArray[np.intp], seed: int, size_px: tuple[float, float]) -> Block:
    """Return the block with gross errors in the image points of these rows, in line and in sample."""
    rng, o = np.random.default_rng(seed), block.observations
    line, sample = o.line.copy(), o.sample.copy()
    for column in (line, sample):
        column[rows] += rng.choice([-1.0, 1.0], len(rows)) * rng.uniform(*size_px, len(rows))
    moved = ImagePoints(o.image, o.point, line, sample, o.sigma_line_px, o.sigma_sample_px)
    return replace(block, observations=moved)


def spoiled_block(
    size_px: tuple[float, float], rows: int = 2, columns: int = 3, points: int = 90
) -> tuple[Block, npt.NDArray[np.intp]]:
    """Return a block with a quarter of the rays of each point spoiled, and these rays.

    Points have spoiled rays from four rays on. One of four contradicts three that agree; with two of four there is no
    majority.
    """
    block = clean_block(rows, columns, points)
    o, rng = block.observations, np.random.default_rng(1)
    of_point = [np.flatnonzero(o.point == j) for j in range(len(block.points.ids))]
    chosen = np.sort(np.concatenate([rng.choice(rays, len(rays) // 4, replace=False) for rays in of_point]))
    return moved_rays(block, chosen, 2, size_px), chosen
