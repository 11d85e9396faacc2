"""The block has pushbroom images and a frame camera on a satellite above it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fg_orient.adjustment.problem import compile_problem
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block, Image, ImagePoints
from fg_orient.sensors.frame import HALF_TURN, FrameCamera, FrameSensor

#: Half of its unknowns: another equation, 6 unknowns.
SIGMA = {"rotation_x": 1e-5, "rotation_y": 1e-5, "rotation_z": 1e-4, "centre_x": 5.0, "centre_z": 5.0, "focal": 20.0}
NOISE_PX = 0.5


def with_frame_above(block: Block) -> Block:
    """Return the block with one more image, which sees every point from 500 km; noise of half a pixel, seed 4."""
    problem = compile_problem(block)
    ground = problem.start.ground + problem.origin_m
    lon, lat, _ = ecef_to_geodetic(problem.origin_m[None])
    up = enu_from_ecef(lon, lat)[0]
    camera = FrameCamera(HALF_TURN @ up, problem.origin_m + 5e5 * up[2], 1e5, sigma=SIGMA)
    sensor = FrameSensor(camera, 16001, 16001, first_line=-8000, first_sample=-8000)
    seen, o = np.unique(block.observations.point), block.observations
    pixels = np.stack(sensor.project(ground[seen]))
    pixels += np.random.default_rng(4).normal(scale=NOISE_PX, size=pixels.shape)
    own, sigma = np.full(len(seen), len(block.images)), np.full(len(seen), NOISE_PX)
    both = zip((o.image, o.point, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px),
               (own, seen, *pixels, sigma, sigma), strict=True)  # fmt: skip
    observations = ImagePoints(*(np.concatenate(pair) for pair in both))
    return replace(block, images=(*block.images, Image("frame", sensor)), observations=observations)
