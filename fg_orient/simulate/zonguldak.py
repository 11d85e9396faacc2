"""Synthetic Zonguldak block: a SPOT-5 HRG stereo pair with 47 ground points.

Two descending circular passes (832 km, 98.7 degrees) see 41.3 N 31.85 E at mirror angles of -18 and +20 degrees from
opposite sides; points lie in the overlap at 0 to 1800 m. Source of the geometry: the data set of Topan & Maktav (2010)
and Terlemezoğlu (2019) as specified in docs/file-formats.md and in its options. The truth is exact in
the model of the adjustment; see :mod:`fg_orient.simulate.simulation`.

The point sets of the published experiments differ in their check points. H-n ("homogeneous"): n random check points,
nested, so that the check points of H-10 are check points of H-20, too. G-A, G-B, G-C ("grouped"): a part of the image
has no control points: one side of the scan line (G-A), one end of the strip (G-B), or the border of the block (G-C).
Sizes: Topan & Maktav 2010 and the authors' programs; the points of each set were never published.
"""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from factors.arrays import Array
from fg_orient.geodesy import enu_from_ecef, geodetic_to_ecef
from fg_orient.model.names import Progress, Role
from fg_orient.simulate.files import Scenario
from fg_orient.simulate.jitter import jitter_waves
from fg_orient.simulate.options import PointSet
from fg_orient.simulate.options import ZonguldakOptions as ZonguldakOptions
from fg_orient.simulate.render import RasterOptions, write_rasters
from fg_orient.simulate.scene import N_LINES, N_SAMPLES, Scene, as_read, find_pass
from fg_orient.simulate.simulation import (
    Simulation,
    draw_errors,
    ground_points,
    numbered,
    observe,
    random_streams,
)

N_POINTS: Final = 47
#: Number of check points of each set.
CHECK_COUNT: Final[dict[PointSet, int]] = {
    "H-0": 0, "H-10": 10, "H-20": 20, "H-30": 30, "H-40": 40, "G-A": 24, "G-B": 23, "G-C": 30
}  # fmt: skip


def roles_of(point_set: PointSet, pixels: Array, rng: np.random.Generator) -> tuple[Role, ...]:
    """Return the role of each point.

    Parameters
    ----------
    point_set : str
    pixels : (n, 2) array
        Line and sample in the first image; only the grouped sets use them.
    rng : np.random.Generator
        Generator for the permutation of the H sets and for the side of G-A and G-B; both are drawn for every set.
    """
    order, side = rng.permutation(len(pixels)), rng.choice([-1.0, 1.0])
    if point_set == "G-A":
        order = np.argsort(side * pixels[:, 1], kind="stable")
    elif point_set == "G-B":
        order = np.argsort(side * pixels[:, 0], kind="stable")
    elif point_set == "G-C":
        order = np.argsort(-np.linalg.norm(pixels - pixels.mean(axis=0), axis=1), kind="stable")
    check = set(order[: CHECK_COUNT[point_set]].tolist())
    return tuple(Role.CHECK if k in check else Role.CONTROL for k in range(len(pixels)))


CENTRE_LON_LAT_DEG = (31.85, 41.3)
#: Image id, mirror angle (degrees), day, half minutes of the day.
IMAGES = (("left", -18.0, "2004-07-05", 1041), ("right", 20.0, "2004-07-06", 1003))
HEIGHT_RANGE_M = (0.0, 1800.0)
#: Smallest distance of the points from the border of both images, so that noise and distortion do not move them out.
MARGIN_PX = 300.0
#: Box of the overlap in which points are drawn, degrees around the centre.
_BOX_DEG = (0.55, 0.40)


def at_centre(enu_m: Array) -> Array:
    """Return ECEF coordinates (n, 3) m of East, North, Up (m) from the centre at height 0."""
    return np.asarray(geodetic_to_ecef(*CENTRE_LON_LAT_DEG, 0.0) + enu_m @ enu_from_ecef(*CENTRE_LON_LAT_DEG)[0])


def simulate(options: ZonguldakOptions) -> Simulation:
    """Draw the synthetic block of these options."""
    streams = random_streams(options.seed)
    scenes = _scenes(options)
    lon_lat_height, pixels = _points(scenes, streams["points"])
    roles = roles_of(options.point_set, pixels, streams["roles"])
    ground = ground_points(numbered(N_POINTS), roles, lon_lat_height, options.ground_noise_m, streams["ground_noise"])
    errors = draw_errors(options.errors, streams["orientation"], len(scenes))
    bend = np.array([[0.0, 0.0, options.distortion_rad]] * 2) if options.distortion_rad else np.zeros((2, 0))
    visible = np.ones((len(scenes), N_POINTS), bool)
    return observe(
        "zonguldak twin",
        scenes,
        ground,
        visible,
        errors,
        bend,
        options.image_noise_px,
        streams["image_noise"],
        waves=jitter_waves(options, [scene.id for scene in scenes], streams["jitter"]),
    )


_TWIN: Final = Scenario("simulate zonguldak", ZonguldakOptions(), lambda options, _: simulate(options))
zonguldak_block = _TWIN.block


def simulate_zonguldak(
    out: str | Path,
    options: ZonguldakOptions | None = None,
    *,
    overwrite: bool = False,
    rasters: RasterOptions | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write the synthetic block: see :meth:`fg_orient.simulate.files.Scenario.write`.

    Parameters
    ----------
    out, options, overwrite
        Folder, options of the twin, replacement of an earlier twin.
    rasters : RasterOptions, optional
        Write ``dem.tif`` and the images, too.
    progress : callable, optional
        Function that receives, while images are rendered, the number of finished blocks, of all blocks, and the image.
    """
    more = None if rasters is None else partial(write_rasters, options=rasters, progress=progress)
    return _TWIN.write(out, options, overwrite=overwrite, more=more)


def _scenes(options: ZonguldakOptions) -> tuple[Scene, ...]:
    centre = geodetic_to_ecef(*CENTRE_LON_LAT_DEG, 0.0)[0]
    out = []
    for name, mirror_deg, day, half_minutes in IMAGES:
        mirror = math.radians(mirror_deg)
        orbit = find_pass(
            centre, mirror, attitude_rad=options.attitude_rad, radial_velocity_m_s=options.radial_velocity_m_s
        )
        out.append(Scene(name, orbit, mirror, np.datetime64(day), half_minutes, options.attitude_rad))
    return tuple(out)


def _points(scenes: tuple[Scene, ...], rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw points uniformly in the overlap, longitude, latitude (degrees), height (m); also pixels in the first image.

    They depend only on the true orbits and the camera of the files, not on errors, noise and distortion.
    """
    sensors = [as_read(scene.metadata()) for scene in scenes]
    points, pixels = np.empty((0, 3)), np.empty((0, 2))
    size, low_m, high_m = np.array([N_LINES, N_SAMPLES]), *HEIGHT_RANGE_M
    while len(points) < N_POINTS:
        unit = rng.random((4 * N_POINTS, 3))
        lon_lat = np.array(CENTRE_LON_LAT_DEG) + (2.0 * unit[:, :2] - 1.0) * _BOX_DEG
        drawn = np.column_stack([lon_lat, low_m + (high_m - low_m) * unit[:, 2]])
        ecef = geodetic_to_ecef(*drawn.T)
        seen = np.stack([np.stack(sensor.project(ecef), axis=1) for sensor in sensors])
        inside = ((seen >= MARGIN_PX) & (seen <= size - 1 - MARGIN_PX)).all(axis=(0, 2))
        points, pixels = np.vstack([points, drawn[inside]]), np.vstack([pixels, seen[0, inside]])
    return points[:N_POINTS], pixels[:N_POINTS]
