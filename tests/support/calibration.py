"""The self-calibration has photos of one camera with distortion, from above and rolled, over control points."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from factors._contract import Array
from fg_orient.model.block import (
    Block,
    Coordinates,
    GroundPoints,
    Image,
    ImagePoints,
    Options,
    WithheldCoordinates,
)
from fg_orient.model.names import Role
from fg_orient.sensors.frame import IDEAL_TO_MEASURED, FrameCamera, FrameSensor, rotation_of_opk

FOCAL_PX, SIZE = 2000.0, 3000
MIDDLE = np.array([0.5 * SIZE, 0.5 * SIZE])
NOISE_PX, N_CONTROL = 0.3, 10
POSE = dict.fromkeys(("rotation_x", "rotation_y", "rotation_z"), 1e-3) | dict.fromkeys(
    ("centre_x", "centre_y", "centre_z"), 0.01
)
CENTRES = np.array([[0.0, 0.0, 10.0], [4.0, 0.0, 10.0], [0.0, 4.0, 10.0], [4.0, 4.0, 10.0], [2.0, 2.0, 11.0],
                    [2.0, 2.0, 9.0]])  # fmt: skip


def calibration_block(
    distortion: tuple[float, ...], true: str = IDEAL_TO_MEASURED, stated: str = IDEAL_TO_MEASURED, *, seed: int = 8,
    unknown: tuple[str, ...] = ("k1",), sigma_px: float = NOISE_PX, n: int = 80, priors: bool = True,
    noise_px: float = NOISE_PX,
) -> Block:  # fmt: skip
    """Return the block of six photos with the true distortion (5,) and direction; the cameras start without distortion.

    ``stated``: direction of the cameras of the block; ``unknown``: terms that they share, with a wide prior.
    """
    rng = np.random.default_rng(seed)
    images, sensors = [], []
    for k, centre in enumerate(CENTRES):
        turn = rotation_of_opk(*rng.normal(0.0, 0.15, 2), 0.5 * np.pi * k)
        camera = FrameCamera(turn, centre, FOCAL_PX, MIDDLE, np.array(distortion), {}, true, FOCAL_PX)
        sensors.append(FrameSensor(camera, SIZE, SIZE, georeferenced=False, file=f"I{k}"))
        off = rng.normal(size=6) * list(POSE.values())
        start = FrameCamera(
            Rotation.from_rotvec(off[:3]).as_matrix() @ turn, centre + off[3:], FOCAL_PX, MIDDLE, np.zeros(5),
            POSE | dict.fromkeys(unknown, 0.1), stated, FOCAL_PX, shared=dict.fromkeys(unknown, "camera"),
        )  # fmt: skip
        images.append(Image(f"I{k}", FrameSensor(start, SIZE, SIZE, georeferenced=False, file=f"I{k}")))
    ground = np.column_stack([rng.uniform(-4.0, 8.0, (n, 2)), rng.uniform(-1.0, 1.0, n)])
    rows = [(k, j, *at) for k, sensor in enumerate(sensors)
            for j, at in enumerate(zip(*sensor.project(ground), strict=True)) if sensor.is_inside(*at)]  # fmt: skip
    image, point = (np.array([row[c] for row in rows], np.intp) for c in (0, 1))
    pixels = np.array([row[2:] for row in rows]) + rng.normal(0.0, noise_px, (len(rows), 2))
    seen = np.bincount(point, minlength=n) > 1
    keep = seen[point]
    number, ground = np.cumsum(seen) - 1, ground[seen]
    sigma = np.full(int(keep.sum()), sigma_px)
    observations = ImagePoints(image[keep], number[point[keep]], *pixels[keep].T, sigma, sigma)
    return Block("calibration", tuple(images), _points(ground, rng), observations, _NOTHING,
                 Options(priors=priors, backend="dense"))  # fmt: skip


_NOTHING = WithheldCoordinates((), lambda: Coordinates(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool)))


def _points(ground: Array, rng: np.random.Generator) -> GroundPoints:
    """Return the control points with an error of 2 mm, other points with start coordinates."""
    n = len(ground)
    at, sigma = ground + rng.normal(0.0, 0.05, ground.shape), np.full((n, 3), np.nan)
    at[:N_CONTROL] = ground[:N_CONTROL] + rng.normal(0.0, 0.002, (N_CONTROL, 3))
    sigma[:N_CONTROL] = 0.002
    roles = (Role.CONTROL,) * N_CONTROL + (Role.TIE,) * (n - N_CONTROL)
    return GroundPoints(tuple(f"P{j}" for j in range(n)), roles, Coordinates(at, sigma, np.zeros(n, bool)))
