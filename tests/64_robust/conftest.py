"""Fixtures are the twin with gross errors, and its problems."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.solve import Estimate, solve
from fg_orient.model.block import Block, Coordinates, GroundPoints, ImagePoints
from fg_orient.model.names import Role
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

Index = npt.NDArray[np.intp]


@lru_cache
def twin(seed: int = 1) -> Block:
    return zonguldak_block(ZonguldakOptions(seed=seed))[0]


@lru_cache
def grid(points: int = 60, control_share: float = 0.5) -> Block:
    return grid_block(BlockOptions(rows=2, columns=2, points=points, seed=5, control_share=control_share))[0]


def with_options(block: Block, **options: object) -> Block:
    return replace(block, options=replace(block.options, **options))


def control_rays(block: Block, image: int | None = None) -> Index:
    """Return the image points of control points, of one image or of all."""
    o = block.observations
    mine = np.isin(o.point, block.points.where(Role.CONTROL))
    return np.flatnonzero(mine if image is None else mine & (o.image == image))


def moved(block: Block, rows: Index, line_px: npt.ArrayLike, sample_px: npt.ArrayLike) -> Block:
    o = block.observations
    line, sample = o.line.copy(), o.sample.copy()
    line[rows] += line_px
    sample[rows] += sample_px
    changed = ImagePoints(o.image, o.point, line, sample, o.sigma_line_px, o.sigma_sample_px)
    return replace(block, observations=changed)


def with_sigmas(block: Block, factor: float) -> Block:
    """Return the block with the sigmas of image points and control points changed, and nothing else."""
    o, points = block.observations, block.points
    changed = ImagePoints(o.image, o.point, o.line, o.sample, o.sigma_line_px * factor, o.sigma_sample_px * factor)
    known = Coordinates(points.known.ecef_m, points.known.sigma_enu_m * factor, points.known.fixed)
    return replace(block, observations=changed, points=GroundPoints(points.ids, points.roles, known))


def spoiled(block: Block, share: float, seed: int, size_px: tuple[float, float] = (3.0, 30.0)) -> tuple[Block, Index]:
    """Return the block with errors in a share of the image points of its control points, and which."""
    rng, rows = np.random.default_rng(seed), control_rays(block)
    bad = np.sort(rng.choice(rows, round(share * len(rows)), replace=False))
    angle, size = rng.uniform(0.0, 2.0 * np.pi, len(bad)), rng.uniform(*size_px, len(bad))
    return moved(block, bad, size * np.cos(angle), size * np.sin(angle)), bad


def problem_of(block: Block, **options: object) -> Problem:
    return compile_problem(with_options(block, **{"max_iterations": 200, **options}))


def adjusted(block: Block, **options: object) -> Estimate:
    return solve(problem_of(block, **options))
