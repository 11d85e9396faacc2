"""Synthetic blocks of pinhole images of any size serve the comparison of bundle adjustment programs.

Cameras stand on a grid above rough ground and look down, each tilted its own way by some degrees; every point is
measured in the cameras nearest to it. Unknown are, per image, rotation, projection centre, focal length, k1 and k2: the
nine of BAL. There is no control: the priors, as wide as the errors of the start values, hold the datum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import spatial

from factors._contract import Array
from factors.cameras import frame_camera, frame_corrections
from fg_orient.model.block import Block, Coordinates, GroundPoints, Image, ImagePoints, Options, WithheldCoordinates
from fg_orient.model.names import Role
from fg_orient.sensors.frame import FrameCamera, FrameSensor
from fg_orient.simulate.options import require

#: Distance of neighbouring cameras, their height above the mean ground and the range of relief, m.
SPACING_M: Final = 40.0
HEIGHT_M: Final = 100.0
RELIEF_M: Final = 40.0
TILT_RAD: Final = 0.15
FOCAL_PX: Final = 1500.0
#: Half the side of an image: wide enough for all points that the nearest cameras see.
HALF_SIDE_PX: Final = 4000
#: Sigma of the noise of line and sample.
NOISE_PX: Final = 0.5
#: Unknowns, and the sigmas of the errors of their start values, which are the prior sigmas.
SIGMA: Final = {
    "rotation_x": 2e-3, "rotation_y": 2e-3, "rotation_z": 2e-3, "centre_x": 0.2, "centre_y": 0.2, "centre_z": 0.2,
    "focal": 5.0, "k1": 3e-3, "k2": 3e-3,
}  # fmt: skip
#: Sigma of the errors of the start values of ground points, m.
GROUND_ERROR_M: Final = 0.2


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """True cameras, as unknowns in prior sigmas (M, 9) against the block's, and ground points (N, 3) m."""

    image: Array
    ground_m: Array


def pinhole_block(
    n_images: int,
    n_points: int,
    views: int = 4,
    seed: int = 0,
    *,
    noise_px: float = NOISE_PX,
    mixed: bool = False,
    columns: int | None = None,
) -> tuple[Block, FrameTruth]:
    """Return a block of ``n_images`` pinhole images and ``n_points`` tie points with start values, and its truth.

    Parameters
    ----------
    n_images, n_points : int
    views : int
        Images that see each point: the nearest ones, two at least.
    seed : int
    noise_px : float
        Sigma of the noise of line and sample; observations have the sigma :data:`NOISE_PX`.
    mixed : bool
        All images overlap, and those that see a point are drawn at random: the reduced normal matrix is full.
    columns : int, optional
        Cameras in a row; by default as many as there are rows.

    Raises
    ------
    InputError
        Fewer than two images or views, more views than images, or no point.
    """
    require(n_images >= 2, "n_images", n_images, "two images or more")
    require(2 <= views <= n_images, "views", views, "two views or more, and no more than images")
    require(n_points >= 1, "n_points", n_points, "a point or more")
    rng = np.random.default_rng(seed)
    columns = columns or math.ceil(math.sqrt(n_images))
    centre, cameras = _cameras(n_images, columns, rng, SPACING_M / (math.sqrt(n_images) if mixed else 1.0))
    ground = _points(centre, n_points, rng)
    if mixed:
        seen = _drawn(n_points, n_images, views, rng)
    else:
        _, seen = spatial.KDTree(centre[:, :2]).query(ground[:, :2], k=views)
    image, point = np.sort(seen, axis=1).ravel(), np.repeat(np.arange(n_points), views)
    line, sample = _observed(cameras, image, ground[point])
    noise = noise_px * rng.standard_normal((2, len(point)))
    start, truth = _disturbed(cameras, rng)
    sigma = np.full(len(point), NOISE_PX)
    observations = ImagePoints(image, point, line + noise[0], sample + noise[1], sigma, sigma)
    first = ground + GROUND_ERROR_M * rng.standard_normal(ground.shape)
    return _block(start, first, observations), FrameTruth(truth, ground)


def _drawn(n: int, images: int, views: int, rng: np.random.Generator) -> npt.NDArray[np.intp]:
    """Return random different images (n, views) for each of n points.

    Floyd's algorithm (Bentley & Floyd 1987).
    """
    out = np.empty((n, views), np.intp)
    for k, last in enumerate(range(images - views, images)):
        image = rng.integers(last + 1, size=n)
        out[:, k] = np.where((out[:, :k] == image[:, None]).any(axis=1), last, image)
    return out


def _cameras(n: int, columns: int, rng: np.random.Generator, spacing_m: float) -> tuple[Array, list[FrameCamera]]:
    """Return the true cameras row by row, looking down, turned at random about the vertical."""
    k = np.arange(n)
    plane = spacing_m * np.stack([k % columns, k // columns], axis=1) + rng.uniform(-4.0, 4.0, (n, 2))
    centre = np.column_stack([plane, HEIGHT_M + rng.uniform(-5.0, 5.0, n)])
    out = []
    for c in centre:
        w = np.append(rng.normal(scale=TILT_RAD, size=2), rng.uniform(-3.0, 3.0))
        rotation = frame_camera.rotated(_DOWN, w)
        distortion = np.array([rng.normal(-0.05, 0.005), rng.normal(0.01, 0.002), 0.0, 0.0, 0.0])
        focal = FOCAL_PX * rng.uniform(0.99, 1.01)
        out.append(FrameCamera(rotation, c, focal, distortion=distortion, sigma=SIGMA))
    return centre, out


#: Rotation of a camera that looks down, its lines running South.
_DOWN: Final = np.diag([1.0, -1.0, -1.0])


def _points(centre: Array, n: int, rng: np.random.Generator) -> Array:
    """Return the ground points (n, 3) below the cameras, sorted along the rows."""
    low, high = centre[:, :2].min(axis=0) - 0.5 * SPACING_M, centre[:, :2].max(axis=0) + 0.5 * SPACING_M
    plane = rng.uniform(low, high, (n, 2))
    plane = plane[np.lexsort((plane[:, 0], plane[:, 1] // SPACING_M))]
    return np.column_stack([plane, rng.uniform(-0.5 * RELIEF_M, 0.5 * RELIEF_M, n)])


def _observed(cameras: list[FrameCamera], image: npt.NDArray[np.intp], ground_m: Array) -> tuple[Array, Array]:
    """Return the lines and samples (n,) of points (n, 3) in their images."""
    out = np.empty((len(image), 2))
    order = np.argsort(image, kind="stable")
    for k, rows in enumerate(np.split(order, np.searchsorted(image[order], np.arange(1, len(cameras))))):
        out[rows] = frame_corrections.pixels(cameras[k].corrected(), np.ascontiguousarray(ground_m[rows]))[:, :2]
    return out[:, 0], out[:, 1]


def _disturbed(cameras: list[FrameCamera], rng: np.random.Generator) -> tuple[list[FrameCamera], Array]:
    """Return the cameras with the errors of start values, and the unknowns (M, 9) that lead back to the true ones."""
    x = rng.standard_normal((len(cameras), len(SIGMA)))
    out = []
    for camera, row in zip(cameras, x * np.array(list(SIGMA.values())), strict=True):
        distortion = camera.distortion - np.array([row[7], row[8], 0.0, 0.0, 0.0])
        rotation, centre = frame_camera.rotated(camera.rotation, -row[:3]), camera.centre_m - row[3:6]
        out.append(FrameCamera(rotation, centre, camera.focal_px - row[6], distortion=distortion, sigma=SIGMA))
    return out, x


def _block(cameras: list[FrameCamera], ground_m: Array, observations: ImagePoints) -> Block:
    """Return the block of cameras and start values of ground points."""
    side, width = 2 * HALF_SIDE_PX + 1, len(str(len(cameras)))
    images = tuple(
        Image(f"{k + 1:0{width}d}", FrameSensor(
            camera, side, side, first_line=-HALF_SIDE_PX, first_sample=-HALF_SIDE_PX, georeferenced=False,
        ))
        for k, camera in enumerate(cameras)
    )  # fmt: skip
    n = len(ground_m)
    known = Coordinates(ground_m, np.full((n, 3), np.nan), np.zeros(n, bool))
    points = GroundPoints(tuple(map(str, range(1, n + 1))), (Role.TIE,) * n, known)
    nothing = Coordinates(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool))
    options = Options(datum="priors", optimizer="levenberg-marquardt")
    name = f"{len(cameras)} pinhole images"
    return Block(name, images, points, observations, WithheldCoordinates((), lambda: nothing), options)
