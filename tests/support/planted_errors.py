"""In blocks of the twin with RPC and only control points, image points and coordinates check each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block, Coordinates
from fg_orient.model.names import Role
from fg_orient.simulate.block import BlockOptions, grid_block
from tests.support.rpc_block import rpc_twin

#: Sigmas that make all three groups estimable: half of a pixel of 5 m is about a position, five a height.
SIGMA_PX, SIGMA_ENU_M = 0.5, np.array([2.5, 2.5, 10.0])


@dataclass(frozen=True)
class Planted:
    """Makes blocks whose errors are the stated sigmas times known factors."""

    block: Block
    ecef_m: np.ndarray

    def draw(self, rng: np.random.Generator, image: float = 1.0, position: float = 1.0, height: float = 1.0) -> Block:
        """Return a block with fresh errors."""
        o, known = self.block.observations, self.block.points.known
        pixel = rng.normal(size=(2, len(o))) * [o.sigma_line_px, o.sigma_sample_px] * image
        lon, lat, _ = ecef_to_geodetic(self.ecef_m)
        enu = rng.normal(size=self.ecef_m.shape) * known.sigma_enu_m * [position, position, height]
        ecef = self.ecef_m + np.einsum("nji,nj->ni", enu_from_ecef(lon, lat), enu)
        known = replace(known, ecef_m=np.where(np.isnan(known.ecef_m), np.nan, ecef))
        return replace(
            self.block, points=replace(self.block.points, known=known),
            observations=replace(o, line=o.line + pixel[0], sample=o.sample + pixel[1]),
        )  # fmt: skip


@cache
def planted() -> Planted:
    """Return the image points without errors, true coordinates."""
    twin = rpc_twin("shift", seed=3, noise_px=0.0)
    n, o = len(twin.ecef_m), twin.block.observations
    known = Coordinates(twin.ecef_m, np.tile(SIGMA_ENU_M, (n, 1)), np.zeros(n, bool))
    points = replace(twin.block.points, roles=(Role.CONTROL,) * n, known=known)
    sigma = np.full(len(o), SIGMA_PX)
    observations = replace(o, sigma_line_px=sigma, sigma_sample_px=sigma)
    block = replace(twin.block, points=points, observations=observations)
    return Planted(replace(block, withheld=replace(twin.block.withheld, ids=())), twin.ecef_m)


@cache
def planted_large() -> Planted:
    """Return four images of 1730 rows with 330 points.

    20 of these are control, whose heights add little to the images.
    """
    chosen = BlockOptions(
        points=330, control_share=0.06, check_share=0.0, seed=2, image_noise_px=0.0, errors="none",
        ground_noise_m=(0.0, 0.0, 0.0),
    )  # fmt: skip
    block, truth = grid_block(chosen)
    o, known = block.observations, block.points.known
    sigma = np.full(len(o), SIGMA_PX)
    block = replace(
        block, observations=replace(o, sigma_line_px=sigma, sigma_sample_px=sigma),
        points=replace(block.points, known=replace(known, sigma_enu_m=np.tile([3.0, 3.0, 6.0], (len(known.fixed), 1)))),
        options=replace(block.options, eop_set=10, priors=False, backend="schur"),
    )  # fmt: skip
    return Planted(block, truth.ecef_m)
