"""Synthetic block of SPOT-5-like scenes of any size, for cost and accuracy studies.

Ground centres lie on a grid of rows x columns around the centre of the Zonguldak block.
Each scene has its own pass. Neighbouring scenes look to opposite sides, left or right, like the fields
of a checkerboard. So the rays of neighbouring scenes (60 km wide, by default 28 km apart) intersect at
24 degrees. Ground points are uniform over the block; a point is kept if it is in two scenes or more. A
ground point has about 2.7 (2 x 2 scenes) to 4 (10 x 10) image points. All computations use the
ellipsoid, not a plane.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from factors.arrays import Array, Mask
from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef
from fg_orient.model.names import Progress
from fg_orient.sensors.correction import Correction
from fg_orient.simulate.files import Scenario
from fg_orient.simulate.jitter import jitter_waves
from fg_orient.simulate.options import LEAST_CONTROL
from fg_orient.simulate.options import BlockOptions as BlockOptions
from fg_orient.simulate.scene import N_LINES, N_SAMPLES, Scene, as_read, find_pass
from fg_orient.simulate.simulation import (
    QuickProjection,
    Simulation,
    draw_errors,
    ground_points,
    numbered,
    observe,
    random_streams,
    roles_in_order,
)
from fg_orient.simulate.zonguldak import at_centre

#: First day of the images; each image has its own pass on its own day.
FIRST_DAY = np.datetime64("2004-07-05")
HALF_MINUTES = 1041
#: Points closer to the image border than this, px, are not measured, because noise could move them out of the image.
MARGIN_PX = 200.0
#: For points closer to that limit than this, the exact projection decides.
DOUBT_PX = 1.0
#: The box of the points extends beyond the outer ground centres by this distance.
BORDER_M = 25e3


def simulate(options: BlockOptions, progress: Progress | None = None) -> Simulation:
    """Draw the block of these options."""
    streams, n = random_streams(options.seed), options.points
    report_progress = progress or (lambda done, total, text: None)
    scenes = _scenes(options, _centres(options), report_progress)
    lon_lat_height, visible = _points(options, scenes, streams["points"], report_progress)
    control = max(LEAST_CONTROL, round(options.control_share * n))
    check = min(round(options.check_share * n), n - control)
    roles = roles_in_order(np.argsort(streams["roles"].permutation(n)), control, check)
    ground = ground_points(numbered(n), roles, lon_lat_height, options.ground_noise_m, streams["ground_noise"])
    errors = draw_errors(options.errors, streams["orientation"], len(scenes))
    return observe(
        f"block of {len(scenes)} images",
        scenes,
        ground,
        visible,
        errors,
        np.zeros((2, 0)),
        options.image_noise_px,
        streams["image_noise"],
        options.max_height_m,
        progress,
        jitter_waves(options, [scene.id for scene in scenes], streams["jitter"]),
    )


_BLOCK: Final = Scenario("simulate block", BlockOptions(), simulate)
simulate_block, grid_block = _BLOCK.write, _BLOCK.block


def _centres(options: BlockOptions) -> Array:
    """Return the ground centres (m, 3) ECEF at height 0, row by row from the north west."""
    north = (np.arange(options.rows) - (options.rows - 1) / 2.0) * -options.spacing_m
    east = (np.arange(options.columns) - (options.columns - 1) / 2.0) * options.spacing_m
    offset = np.stack([np.tile(east, options.rows), np.repeat(north, options.columns)], axis=1)
    lon_lat = _shifted(offset)
    return geodetic_to_ecef(lon_lat[:, 0], lon_lat[:, 1], np.zeros(len(lon_lat)))


def _shifted(offset_m: Array) -> Array:
    """Return longitude and latitude (degrees) of N points given by East and North (m) in the plane at the centre."""
    return np.stack(ecef_to_geodetic(at_centre(np.pad(offset_m, ((0, 0), (0, 1)))))[:2], axis=1)


def _scenes(options: BlockOptions, centres: Array, report_progress: Progress) -> tuple[Scene, ...]:
    out = []
    width = len(str(len(centres)))
    for k, centre in enumerate(centres):
        report_progress(k, len(centres), "orbits")
        side = 1.0 if sum(divmod(k, options.columns)) % 2 else -1.0
        mirror = side * math.radians(options.roll_deg)
        orbit = find_pass(centre, mirror)
        day = FIRST_DAY + np.timedelta64(k, "D")
        out.append(Scene(f"image{k + 1:0{width}d}", orbit, mirror, day, HALF_MINUTES, full_look_table=False))
    return tuple(out)


def _points(
    options: BlockOptions, scenes: tuple[Scene, ...], rng: np.random.Generator, report_progress: Progress
) -> tuple[Array, Mask]:
    """Draw points in two images or more: longitude, latitude (degrees), height (m), (n, 3).

    Visibility (m, n).
    """
    sensors = [as_read(scene.metadata()) for scene in scenes]
    cameras = [QuickProjection(sensor, Correction(), options.max_height_m) for sensor in sensors]
    half = BORDER_M + options.spacing_m * (np.array([options.columns, options.rows]) - 1) / 2.0
    points, visible = np.empty((0, 3)), np.empty((len(scenes), 0), bool)
    while len(points) < options.points:
        report_progress(len(points), options.points, "ground points")
        unit = rng.random((options.points + 100, 3))
        lon_lat = _shifted((2.0 * unit[:, :2] - 1.0) * half)
        drawn = np.column_stack([lon_lat, options.max_height_m * unit[:, 2]])
        seen = _visible(cameras, geodetic_to_ecef(*drawn.T), drawn[:, 2])
        kept = seen.sum(axis=0) >= 2
        points, visible = np.vstack([points, drawn[kept]]), np.hstack([visible, seen[:, kept]])
    return points[: options.points], visible[:, : options.points]


def _visible(cameras: list[QuickProjection], ecef_m: Array, height_m: Array) -> Mask:
    """Return which of N points are well inside each of m images (m, N).

    Near the limit, the exact projection decides.
    """
    last = np.array([N_LINES, N_SAMPLES]) - 1.0
    out = np.zeros((len(cameras), len(ecef_m)), bool)
    for k, camera in enumerate(cameras):
        near = camera.near(ecef_m)
        pixels = camera.estimate(ecef_m[near], height_m[near])
        doubt = np.abs(np.minimum(pixels, last - pixels).min(axis=1) - MARGIN_PX) < DOUBT_PX + 10.0 * camera.error_px
        pixels[doubt] = camera.project(ecef_m[near[doubt]], height_m[near[doubt]])
        out[k, near] = ((pixels >= MARGIN_PX) & (pixels <= last - MARGIN_PX)).all(axis=1)
    return out
