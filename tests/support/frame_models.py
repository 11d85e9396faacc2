"""Frame models for tests have cameras around some points, and image points by projection with noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from fg_orient.formats.frame_model import FrameModel, Pose
from fg_orient.sensors.interior import Interior

DISTORTIONS = {
    "none": (0.0, 0.0, 0.0, 0.0, 0.0),
    "k1": (-0.05, 0.0, 0.0, 0.0, 0.0),
    "radial": (-0.05, 0.02, 0.0, 0.0, 0.0),
    "brown": (-0.05, 0.02, 0.0, 3e-4, -2e-4),
    "k3": (-0.05, 0.02, -0.004, 3e-4, -2e-4),
}


def frame_model(
    distortions: tuple[str, ...] = tuple(DISTORTIONS), *, principal: bool = True, noise_px: float = 0.3, seed: int = 5
) -> FrameModel:
    """Return one image per camera and a second one of the first; points within 1 m, seen from 5 m in any attitude."""
    rng = np.random.default_rng(seed)
    cameras = {
        str(k + 1): Interior(
            1000 + k, 1500 + k, 1200.0 + k,
            np.array([499.0 + k, 751.5]) if principal else np.array([(999.0 + k) / 2, (1499.0 + k) / 2]),
            np.array(DISTORTIONS[name]),
        ) for k, name in enumerate(distortions)
    }  # fmt: skip
    points = rng.uniform(-1.0, 1.0, (12, 3))
    poses = []
    for k, camera in enumerate([*cameras, "1"]):
        rotation = Rotation.random(rng=rng).as_matrix()
        centre = rng.normal(scale=0.1, size=3) - 5.0 * rotation[2]
        poses.append(Pose(f"{k}.jpg", camera, rotation, centre))
    n, m = len(points), len(poses)
    image, point = np.repeat(np.arange(m), n), np.tile(np.arange(n), m)
    kept = rng.permutation(n * m)[: n * m - 5]
    exact = FrameModel(
        cameras, tuple(poses), tuple(str(k + 1) for k in range(n)), points, image[kept], point[kept],
        np.zeros(len(kept)), np.zeros(len(kept)),
    )  # fmt: skip
    line, sample = exact.residuals_px().T + rng.normal(scale=noise_px, size=(2, len(kept)))
    return replace(exact, line=line, sample=sample)
