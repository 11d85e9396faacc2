"""A synthetic block of SPOT-5-like scenes of any size, for cost and accuracy studies.

Ground centres lie on a grid of rows x columns around the twin's centre; each is seen by a
pass of its own, rolled alternately to one side and the other like the fields of a
checkerboard, so that neighbouring scenes (60 km wide, by default 28 km apart) overlap and
intersect at 24 degrees. Ground points are uniform over the block; a point is kept if at
least two scenes see it. About 2.7 (2 x 2 scenes) to 4 (10 x 10) image points come per
ground point. Geometry on the real ellipsoid.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from factors._contract import Array
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import Block
from fg_orient.model.names import Progress, Role
from fg_orient.sensors.correction import Correction
from fg_orient.simulate.files import DIMAP, images_of, simulate_to
from fg_orient.simulate.options import LEAST_CONTROL
from fg_orient.simulate.options import BlockOptions as BlockOptions
from fg_orient.simulate.orbit import find_pass
from fg_orient.simulate.scene import N_LINES, N_SAMPLES, Scene, as_read
from fg_orient.simulate.simulation import (
    QuickProjection,
    Simulation,
    Truth,
    draw_errors,
    ground_points,
    observe,
    random_streams,
)
from fg_orient.simulate.zonguldak import CENTRE_LON_LAT_DEG

#: First day of the images; each image has its own pass on its own day.
FIRST_DAY = np.datetime64("2004-07-05")
HALF_MINUTES = 1041
#: Points this close to a border are not measured there: noise never leaves the image.
MARGIN_PX = 200.0
#: Closer to that limit than this, the exact projection decides.
DOUBT_PX = 1.0
#: The box of points reaches this far beyond the outer ground centres.
BORDER_M = 25e3


def simulate_block(
    out: str | Path, options: BlockOptions | None = None, *, overwrite: bool = False, progress: Progress | None = None
) -> Path:
    """Write a synthetic block: metadata files, points, observations, project file and ``truth/``.

    Parameters
    ----------
    out, overwrite
        See :func:`fg_orient.simulate.files.simulate_to`.
    options : BlockOptions, optional
    progress : callable, optional
        Called with (done, of, text); each part of the work counts from 0.

    Returns
    -------
    Path
        The project file.

    Raises
    ------
    InputError
        See :func:`fg_orient.simulate.files.simulate_to`.
    """
    chosen = options or BlockOptions()
    writer = DIMAP if progress is None else replace(DIMAP, images=partial(images_of, progress=progress))
    return simulate_to(
        out, lambda: simulate(chosen, progress), chosen, "simulate block", overwrite=overwrite, writer=writer
    )


def grid_block(options: BlockOptions | None = None) -> tuple[Block, Truth]:
    """Block in memory as reading its files gives it, and its truth."""
    simulation = simulate(options or BlockOptions())
    return simulation.block(), simulation.truth


def simulate(options: BlockOptions, progress: Progress | None = None) -> Simulation:
    """Draw the block of these options."""
    streams = random_streams(options.seed)
    centres = _centres(options)
    tell = progress or (lambda done, total, text: None)
    scenes = _scenes(options, centres, tell)
    lon_lat_height, visible = _points(options, scenes, streams["points"], tell)
    roles = _roles(options, streams["roles"])
    width = len(str(options.points))
    ids = tuple(f"{k + 1:0{width}d}" for k in range(options.points))
    ground = ground_points(ids, roles, lon_lat_height, options.ground_noise_m, streams["ground_noise"])
    errors = draw_errors(options.errors, streams["orientation"], len(scenes))
    name, noise = f"block of {len(scenes)} images", options.image_noise_px
    look, image_noise = np.zeros((2, 0)), streams["image_noise"]
    return observe(name, scenes, ground, visible, errors, look, noise, image_noise, options.max_height_m, progress)


def _centres(options: BlockOptions) -> Array:
    """Ground centres (m, 3) ECEF at height 0, row by row from the north west."""
    north = (np.arange(options.rows) - (options.rows - 1) / 2.0) * -options.spacing_m
    east = (np.arange(options.columns) - (options.columns - 1) / 2.0) * options.spacing_m
    offset = np.stack([np.tile(east, options.rows), np.repeat(north, options.columns)], axis=1)
    lon_lat = _shifted(offset)
    return geodetic_to_ecef(lon_lat[:, 0], lon_lat[:, 1], np.zeros(len(lon_lat)))


def _shifted(offset_m: Array) -> Array:
    """Longitude and latitude (degrees) of N points given by East and North (m) in the plane at the centre."""
    lon_deg, lat_deg = CENTRE_LON_LAT_DEG
    plane = enu_from_ecef(lon_deg, lat_deg)[0, :2]
    lon, lat, _ = ecef_to_geodetic(geodetic_to_ecef(lon_deg, lat_deg, 0.0) + offset_m @ plane)
    return np.stack([lon, lat], axis=1)


def _scenes(options: BlockOptions, centres: Array, tell: Progress) -> tuple[Scene, ...]:
    out = []
    width = len(str(len(centres)))
    for k, centre in enumerate(centres):
        tell(k, len(centres), "orbits")
        side = 1.0 if sum(divmod(k, options.columns)) % 2 else -1.0
        mirror = side * math.radians(options.roll_deg)
        orbit = find_pass(centre, mirror)
        day = FIRST_DAY + np.timedelta64(k, "D")
        out.append(Scene(f"image{k + 1:0{width}d}", orbit, mirror, day, HALF_MINUTES, full_look_table=False))
    return tuple(out)


def _points(
    options: BlockOptions, scenes: tuple[Scene, ...], rng: np.random.Generator, tell: Progress
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Points seen twice or more: longitude, latitude (degrees), height (m), (n, 3); who sees them (m, n)."""
    sensors = [as_read(scene.metadata()) for scene in scenes]
    cameras = [QuickProjection(sensor, Correction(), options.max_height_m) for sensor in sensors]
    half = BORDER_M + options.spacing_m * (np.array([options.columns, options.rows]) - 1) / 2.0
    found, visible = np.empty((0, 3)), np.empty((len(scenes), 0), bool)
    while len(found) < options.points:
        tell(len(found), options.points, "ground points")
        unit = rng.random((options.points + 100, 3))
        lon_lat = _shifted((2.0 * unit[:, :2] - 1.0) * half)
        drawn = np.column_stack([lon_lat, options.max_height_m * unit[:, 2]])
        seen = _visible(cameras, geodetic_to_ecef(*drawn.T), drawn[:, 2])
        kept = seen.sum(axis=0) >= 2
        found, visible = np.vstack([found, drawn[kept]]), np.hstack([visible, seen[:, kept]])
    return found[: options.points], visible[:, : options.points]


def _visible(cameras: list[QuickProjection], ecef_m: Array, height_m: Array) -> npt.NDArray[np.bool_]:
    """Points (N) well inside each image: (m, N). Near the limit the exact projection decides."""
    last = np.array([N_LINES, N_SAMPLES]) - 1.0
    out = np.zeros((len(cameras), len(ecef_m)), bool)
    for k, camera in enumerate(cameras):
        near = camera.near(ecef_m)
        pixels = camera.estimate(ecef_m[near], height_m[near])
        doubt = np.abs(np.minimum(pixels, last - pixels).min(axis=1) - MARGIN_PX) < DOUBT_PX + 10.0 * camera.error_px
        pixels[doubt] = camera.project(ecef_m[near[doubt]], height_m[near[doubt]])
        out[k, near] = ((pixels >= MARGIN_PX) & (pixels <= last - MARGIN_PX)).all(axis=1)
    return out


def _roles(options: BlockOptions, rng: np.random.Generator) -> tuple[Role, ...]:
    """Control, check and tie points, drawn."""
    n = options.points
    control = max(LEAST_CONTROL, round(options.control_share * n))
    check = min(round(options.check_share * n), n - control)
    order = rng.permutation(n)
    of_rank = [Role.CONTROL] * control + [Role.CHECK] * check + [Role.TIE] * (n - control - check)
    return tuple(of_rank[k] for k in np.argsort(order))
