"""Blocks of the twin as RPC, all points control: image points and coordinates check each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from fg_orient.block import Block, Coordinates
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.names import Role
from tests.support.rpc_block import rpc_twin

#: Sigmas that make all three groups estimable: half of a pixel of 5 m is about a position, five a height.
SIGMA_PX, SIGMA_ENU_M = 0.5, np.array([2.5, 2.5, 10.0])


@dataclass(frozen=True)
class Planted:
    """Makes blocks whose errors are the stated sigmas times known factors."""

    block: Block
    ecef_m: np.ndarray

    def draw(self, rng: np.random.Generator, image: float = 1.0, position: float = 1.0, height: float = 1.0) -> Block:
        """A block with fresh errors."""
        o, n = self.block.observations, len(self.ecef_m)
        pixel = rng.normal(size=(2, len(o))) * SIGMA_PX * image
        lon, lat, _ = ecef_to_geodetic(self.ecef_m)
        enu = rng.normal(size=(n, 3)) * SIGMA_ENU_M * [position, position, height]
        ecef = self.ecef_m + np.einsum("nji,nj->ni", enu_from_ecef(lon, lat), enu)
        known = replace(self.block.points.known, ecef_m=ecef)
        return replace(
            self.block, points=replace(self.block.points, known=known),
            observations=replace(o, line=o.line + pixel[0], sample=o.sample + pixel[1]),
        )  # fmt: skip


@cache
def planted() -> Planted:
    """Image points without errors, true coordinates."""
    twin = rpc_twin("shift", seed=3, noise_px=0.0)
    n, o = len(twin.ecef_m), twin.block.observations
    known = Coordinates(twin.ecef_m, np.tile(SIGMA_ENU_M, (n, 1)), np.zeros(n, bool))
    points = replace(twin.block.points, roles=(Role.CONTROL,) * n, known=known)
    sigma = np.full(len(o), SIGMA_PX)
    observations = replace(o, sigma_line_px=sigma, sigma_sample_px=sigma)
    block = replace(twin.block, points=points, observations=observations)
    return Planted(replace(block, withheld=replace(twin.block.withheld, ids=())), twin.ecef_m)
