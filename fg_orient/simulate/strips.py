"""Strips of frame images with GNSS and an inertial unit on board; their errors drift along each strip.

Parallel strips in alternating directions, 1500 m above rough ground, pixels of 0.15 m. All unknowns have prior sigmas,
and their true values are drawn from these sigmas: orientation, shift and drift of position and attitude of each strip,
lever arm, boresight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from factors.arrays import Array, Mask
from factors.cameras.frame_camera import rotated
from factors.conditions.navigation import UNKNOWN
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import Block, Image, Options
from fg_orient.sensors.frame import FrameCamera, FrameSensor
from fg_orient.sensors.frame_unknowns import NAVIGATION, UNKNOWNS
from fg_orient.sensors.navigation import TOP_FORWARD, Fix, Mounting, body_attitude, enu_axes, with_navigation
from fg_orient.simulate.options import require
from fg_orient.simulate.simulation import Simulation, Truth, ground_points, random_streams, roles_in_order, with_noise
from fg_orient.simulate.zonguldak import CENTRE_LON_LAT_DEG, at_centre

#: Flying height, distance of exposures and of strips, range of the ground's heights, m; seconds between exposures.
HEIGHT_M: Final = 1500.0
BASE_M: Final = 600.0
SPACING_M: Final = 1000.0
RELIEF_M: Final = 200.0
INTERVAL_S: Final = 10.0
SIDE_PX: Final = 10000
FOCAL_PX: Final = 10000.0
MARGIN_PX: Final = 50.0
#: Prior sigmas of the exterior orientation, which are the errors of its start values.
EXTERIOR: Final = dict(zip(UNKNOWNS[:6], (5e-3,) * 3 + (2.0,) * 3, strict=True))
#: Sigmas of the observations on board (m, rad) and of image points (px).
POSITION_SIGMA_M: Final = np.array([0.05, 0.05, 0.08])
ATTITUDE_SIGMA_RAD: Final = np.array([5e-5, 5e-5, 1e-4])
IMAGE_SIGMA_PX: Final = 0.4
GROUND_SIGMA_M: Final = (0.03, 0.03, 0.05)
LEVER_M: Final = np.array([0.3, -0.2, 1.5])
MOUNTED: Final = Mounting(
    LEVER_M, TOP_FORWARD, (0.3,) * 3, (0.1,) * 3, (5e-4,) * 3, (2e-4,) * 3, (0.02,) * 3, (2e-3,) * 3
)  # fmt: skip


@dataclass(frozen=True)
class StripOptions:
    """Options: seed; numbers of strips, of images in a strip, of ground points, and of control points among them.

    ``navigation`` adds the observations from on board with their unknowns.

    Raises
    ------
    InputError
        A value is out of range.
    """

    seed: int = 1
    strips: int = 2
    images: int = 5
    points: int = 60
    control: int = 5
    navigation: bool = True

    def __post_init__(self) -> None:
        require(self.seed >= 0, "seed", self.seed, "a whole number from 0")
        require(1 <= self.strips <= 20 and 2 <= self.images <= 200, "strips, images", (self.strips, self.images),
                "1 to 20, 2 to 200")  # fmt: skip
        require(0 <= self.control <= self.points, "control", self.control, f"0 to {self.points} points")


@dataclass(frozen=True, eq=False)
class StripTruth:
    """True unknowns of the images in prior sigmas (M, k), as ``State.image``, and ground points (N, 3) ECEF m."""

    image: Array
    ground_m: Array


def strip_block(options: StripOptions | None = None) -> tuple[Block, StripTruth]:
    """Return a block of strips with its observations from on board, and its truth.

    Parameters
    ----------
    options : StripOptions, optional
    """
    chosen = options or StripOptions()
    streams = random_streams(chosen.seed)
    errors = _errors(chosen, streams["orientation"])
    cameras = [_cameras(*exposure) for exposure in zip(*_exposures(chosen), errors, strict=True)]
    observed = _fixes(chosen, [true for true, _ in cameras], errors, streams["orientation"])
    block, ground = _block(chosen, cameras, streams)
    if chosen.navigation:
        block = with_navigation(block, observed, MOUNTED)
    return block, StripTruth(_unknowns(block, errors), ground)


def _errors(options: StripOptions, rng: np.random.Generator) -> Array:
    """Return true minus given of all unknowns of each image (M, 33), physical units; equal where images share them."""
    sigma = np.array([EXTERIOR.get(name, 0.0) for name in UNKNOWNS] + [MOUNTED.sigmas.get(n, 0.0) for n in NAVIGATION])
    drawn = sigma * rng.standard_normal((options.strips * options.images, len(sigma)))
    strip_unknowns, all_unknowns = slice(UNKNOWN.shift.start, UNKNOWN.lever.start), slice(UNKNOWN.lever.start, None)
    drawn[:, all_unknowns] = drawn[0, all_unknowns]
    for strip in range(options.strips):
        rows = slice(strip * options.images, (strip + 1) * options.images)
        drawn[rows, strip_unknowns] = drawn[rows, strip_unknowns][0]
    return np.asarray(drawn)


def _exposures(options: StripOptions) -> tuple[Array, list[Array]]:
    """Return the projection centres (M, 3) ECEF m, and the body's axes in ECEF of each."""
    enu = enu_from_ecef(*CENTRE_LON_LAT_DEG)[0]
    middle, places, axes = geodetic_to_ecef(*CENTRE_LON_LAT_DEG, 0.0)[0], [], []
    for strip in range(options.strips):
        way = 1.0 if strip % 2 == 0 else -1.0
        for number in range(options.images):
            east = way * BASE_M * (number - (options.images - 1) / 2.0)
            north = SPACING_M * (strip - (options.strips - 1) / 2.0)
            places.append(middle + np.array([east, north, HEIGHT_M + RELIEF_M / 2.0]) @ enu)
            roll, pitch = 0.01 * np.sin(1.0 + number), 0.01 * np.cos(2.0 * number)
            axes.append(body_attitude(roll, pitch, way * np.pi / 2.0, places[-1]))
    return np.array(places), axes


def _cameras(place_m: Array, body: Array, error: Array) -> tuple[FrameCamera, FrameCamera]:
    """Return the true camera of an exposure, and the camera with the errors of its start values."""
    principal = np.full(2, (SIDE_PX - 1) / 2.0)
    rotation, start_m = MOUNTED.camera_from_body @ body.T, place_m - error[UNKNOWN.centre]
    true = FrameCamera(rotation, place_m, FOCAL_PX, principal)
    return true, FrameCamera(
        rotated(np.eye(3), -error[UNKNOWN.rotation]) @ rotation, start_m, FOCAL_PX, principal, sigma=EXTERIOR
    )  # fmt: skip


def _fixes(options: StripOptions, cameras: list[FrameCamera], errors: Array, rng: np.random.Generator) -> list[Fix]:
    """Return the observations on board: truth, errors of strip and mounting, noise."""
    out = []
    for k, (camera, d) in enumerate(zip(cameras, errors, strict=True)):
        strip, number = divmod(k, options.images)
        first, tau = strip * options.images, 2.0 * number / (options.images - 1) - 1.0
        enu = enu_axes(np.mean([other.centre_m for other in cameras[first : first + options.images]], axis=0))
        body = camera.rotation.T @ rotated(np.eye(3), d[UNKNOWN.boresight]) @ MOUNTED.camera_from_body
        noise = POSITION_SIGMA_M * rng.standard_normal(3), ATTITUDE_SIGMA_RAD * rng.standard_normal(3)
        wrong = d[UNKNOWN.shift] + tau * d[UNKNOWN.drift] + noise[0]
        turn = d[UNKNOWN.turn] + tau * d[UNKNOWN.turn_drift] + noise[1]
        position = camera.centre_m - body @ (MOUNTED.lever_m + d[UNKNOWN.lever]) + enu.T @ wrong
        out.append(Fix(
            _name(k), str(strip + 1), number * INTERVAL_S, position, POSITION_SIGMA_M,
            body @ rotated(np.eye(3), turn).T, ATTITUDE_SIGMA_RAD,
        ))  # fmt: skip
    return out


def _name(k: int) -> str:
    return f"image{k + 1:02d}"


def _block(
    options: StripOptions, cameras: list[tuple[FrameCamera, FrameCamera]], streams: dict[str, np.random.Generator]
) -> tuple[Block, Array]:  # fmt: skip
    """Return the images, points in two images or more, and true coordinates of the points."""
    sensors = [FrameSensor(true, SIDE_PX, SIDE_PX) for true, _ in cameras]
    lon_lat_height, pixels, seen = _points(options, sensors, streams["points"])
    roles = roles_in_order(streams["roles"].permutation(options.points), options.control, 0)
    ids = tuple(str(j + 1) for j in range(options.points))
    ground = ground_points(ids, roles, lon_lat_height, GROUND_SIGMA_M, streams["ground_noise"])
    image, point = (a.astype(np.intp) for a in np.nonzero(seen))
    true = pixels[image, point]
    images = tuple(
        Image(_name(k), FrameSensor(given, SIDE_PX, SIDE_PX, file=_name(k))) for k, (_, given) in enumerate(cameras)
    )
    simulation = Simulation(
        "strips", (), ground, image, point, *with_noise(true, IMAGE_SIGMA_PX, streams["image_noise"]),
        Truth.of(ground, [i.id for i in images], (), true), images,
        options=Options() if options.control else Options(datum="priors"),
    )  # fmt: skip
    return simulation.block(), ground.ecef_m


def _points(options: StripOptions, sensors: list[FrameSensor], rng: np.random.Generator) -> tuple[Array, Array, Mask]:
    """Draw points in two images or more: longitude, latitude, height (n, 3); pixels (M, n, 2); visibility (M, n)."""
    half = 0.5 * np.array([BASE_M * options.images, SPACING_M * options.strips]) + 300.0
    unit = rng.random((20 * options.points + 100, 3))
    place = at_centre(np.column_stack([(2.0 * unit[:, :2] - 1.0) * half, RELIEF_M * unit[:, 2]]))
    pixels = np.stack([np.stack(sensor.project(place), axis=1) for sensor in sensors])
    seen = np.asarray(((pixels > MARGIN_PX) & (pixels < SIDE_PX - 1 - MARGIN_PX)).all(axis=2))
    kept = np.flatnonzero(seen.sum(axis=0) >= 2)[: options.points]
    return np.stack(ecef_to_geodetic(place[kept]), axis=1), pixels[:, kept], seen[:, kept]


def _unknowns(block: Block, errors: Array) -> Array:
    """Return the true unknowns of each image in prior sigmas, in the order of its parameters."""
    names, out = (*UNKNOWNS, *NAVIGATION), []
    for image, error in zip(block.images, errors, strict=True):
        sigma = image.sensor.camera.sigma  # type: ignore[attr-defined]  # a frame image
        out.append([error[j] / sigma[name] for j, name in enumerate(names) if name in sigma])
    return np.array(out)
