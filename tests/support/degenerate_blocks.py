"""The module makes degenerate blocks of pushbroom images (the twin), of RPC images and of pinhole images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from fg_orient.model.block import Block, Coordinates, GroundPoints, ImagePoints
from fg_orient.model.names import Role
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.pinhole import pinhole_block
from tests.support.rpc_block import rpc_twin

#: Point ids of the pinhole block that lie on one line (made so), and one far off it.
ON_LINE, OFF_LINE = (3, 8, 13), 20


@cache
def pushbroom() -> Block:
    return zonguldak_block(ZonguldakOptions(seed=1))[0]


@cache
def rpc(kind: str = "affine") -> Block:
    return rpc_twin(kind).block


def with_control(block: Block, keep: Sequence[int], known_m: np.ndarray | None = None) -> Block:
    """Return the block with only these points as control points and the others as tie points."""
    known, n = block.points.known, len(block.points.ids)
    mask = np.isin(np.arange(n), keep)[:, None]
    ecef = known.ecef_m if known_m is None else known_m
    sigma = np.where(mask, 0.05 if known_m is not None else known.sigma_enu_m, np.nan) * np.ones(3)
    start = np.where(mask, ecef, np.nan if known_m is None else known.ecef_m)
    roles = tuple(Role.CONTROL if j in keep else Role.TIE for j in range(n))
    points = GroundPoints(block.points.ids, roles, Coordinates(start, sigma, np.zeros(n, bool)))
    return replace(block, points=points, withheld=replace(block.withheld, ids=()))


def options(block: Block, **changes: object) -> Block:
    return replace(block, options=replace(block.options, **changes))


def pinhole(control: Sequence[int] = (), *, on_line: bool = False, seed: int = 2) -> Block:
    """Return four pinhole images, 25 points; control points from the truth.

    ``on_line``: the block is observed anew (without noise) with three points moved onto a line.
    """
    block, truth = pinhole_block(4, 25, views=3, seed=seed)
    if on_line:
        ground = truth.ground_m.copy()
        a, b = ground[ON_LINE[0]], ground[ON_LINE[2]]
        ground[ON_LINE[1]] = 0.4 * a + 0.6 * b
        o = block.observations
        line, sample = o.line.copy(), o.sample.copy()
        for k, image in enumerate(block.images):
            rows = (o.image == k) & (o.point == ON_LINE[1])
            if rows.any():
                line[rows], sample[rows] = image.sensor.project(ground[o.point[rows]])
        known = block.points.known
        start = np.where((np.arange(25) == ON_LINE[1])[:, None], ground, known.ecef_m)
        block = replace(
            block,
            observations=replace(o, line=line, sample=sample),
            points=replace(block.points, known=replace(known, ecef_m=start)),
        )
        truth = replace(truth, ground_m=ground)
    return options(with_control(block, control, truth.ground_m), datum="control") if control else block


def two_pinhole_blocks(control: Sequence[int]) -> Block:
    """Return two blocks that no point links, of images 1-4 and 5-8.

    Control points by their number, 0-24 in the first.
    """
    a, b = pinhole_block(4, 25, views=3, seed=2), pinhole_block(4, 25, views=3, seed=3)
    truth = np.vstack([a[1].ground_m, b[1].ground_m])
    first, second = a[0], b[0]
    images = (*first.images, *(replace(image, id=str(5 + k)) for k, image in enumerate(second.images)))
    names = ("line", "sample", "sigma_line_px", "sigma_sample_px")
    o, p = first.observations, second.observations
    observations = ImagePoints(
        np.concatenate([o.image, 4 + p.image]), np.concatenate([o.point, 25 + p.point]),
        *(np.concatenate([getattr(o, n), getattr(p, n)]) for n in names),
    )  # fmt: skip
    ecef = np.vstack([first.points.known.ecef_m, second.points.known.ecef_m])
    known = Coordinates(ecef, np.full((50, 3), np.nan), np.zeros(50, bool))
    points = GroundPoints(tuple(str(j + 1) for j in range(50)), (Role.TIE,) * 50, known)
    block = replace(first, images=images, observations=observations, points=points)
    return options(with_control(block, control, truth), datum="control") if control else block


def seen_once(block: Block, points: Sequence[int]) -> Block:
    """Return the block in which these points keep their first ray only."""
    o = block.observations
    _, first = np.unique(o.point, return_index=True)
    keep = ~np.isin(o.point, points) | np.isin(np.arange(len(o)), first)
    return replace(block, observations=o.take(keep))
