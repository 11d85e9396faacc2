"""The benchmark measures processor seconds and memory of free networks of frame images with all statistics.

    python -m benchmarks.frames [--sizes NAME ...]

Synthetic photos around an object share one camera. There are scale bars and no control, and
the start values have errors. Each size runs twice in a process of its own; the second run is
measured, so that nothing is compiled or loaded in it. The statistics are the covariance of
all points and images, redundancy numbers, reliability and tests of all observations, and the
significance of the camera parameters.
"""

from __future__ import annotations

import os
import sys

if __name__ == "__main__" and {os.environ.get(f"{name}_NUM_THREADS") for name in ("OPENBLAS", "OMP")} != {"1"}:
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    os.execv(sys.executable, [sys.executable, "-m", "benchmarks.frames", *sys.argv[1:]])

import argparse
import json
import resource
import subprocess
import time
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

import fg_orient as fg
from factors._contract import Array
from fg_orient.model.block import Coordinates, ImagePoints, Options, WithheldCoordinates
from fg_orient.sensors.frame import FrameCamera, FrameSensor

NOISE_PX: Final = 0.3
FOCAL_PX: Final = 2400.0
#: If an exterior or camera parameter changes by its unit, an image point moves by about a pixel.
POSE: Final = {
    "rotation_x": 1e-3, "rotation_y": 1e-3, "rotation_z": 1e-3, "centre_x": 0.01, "centre_y": 0.01, "centre_z": 0.01,
}  # fmt: skip
CAMERA: Final = {
    "focal": 1.0, "principal_sample": 1.0, "principal_line": 1.0, "k1": 1e-3, "k2": 1e-2, "k3": 1e-1, "p1": 1e-3,
    "p2": 1e-3, "aspect": 1e-3, "shear": 1e-3,
}  # fmt: skip


@dataclass(frozen=True)
class Size:
    """A size of a network; ``views``: photos that see a point, 0 for all; ``limit_s``: largest processor seconds."""

    photos: int
    points: int
    views: int
    camera: int
    bars: int
    limit_s: float
    neighbours: bool = False


SIZES: Final = {
    "110 photos": Size(110, 2000, 5, 10, 2, 2.0),
    "28 photos": Size(28, 2000, 5, 10, 0, 2.0),
    "300 photos": Size(300, 100_000, 5, 8, 2, 20.0, True),
    "500 photos, 37 points": Size(500, 37, 0, 8, 2, 1.0),
    "440 photos, 38 points": Size(440, 38, 0, 8, 2, 1.5),
}


def network(size: Size, seed: int = 0) -> tuple[fg.Block, Array]:
    """Return a block of photos on a ring that look at an object of 6 m, and the true points (N, 3), m."""
    rng, n = np.random.default_rng(seed), size.photos
    angle = 2.0 * np.pi * np.arange(n) / n
    centre = np.column_stack([12.0 * np.cos(angle), 12.0 * np.sin(angle), rng.uniform(-4.0, 4.0, n)])
    ahead = -centre / np.linalg.norm(centre, axis=1, keepdims=True)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    looking = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    roll = Rotation.from_rotvec(
        rng.choice(4, n)[:, None] * [0.0, 0.0, 0.5 * np.pi] + rng.normal(scale=0.03, size=(n, 3))
    )
    rotation = roll.as_matrix() @ looking
    ground = rng.uniform(-3.0, 3.0, (size.points, 3))
    if size.views == 0:
        seen = np.tile(np.arange(n), (size.points, 1))
    elif size.neighbours:
        seen = (rng.integers(0, n, size.points)[:, None] + np.cumsum(np.arange(size.views))) % n
    else:
        seen = rng.random((size.points, n)).argpartition(size.views, axis=1)[:, : size.views]
    image, point = np.sort(seen, axis=1).ravel(), np.repeat(np.arange(size.points), seen.shape[1])
    names = dict(list(CAMERA.items())[: size.camera])
    images, pixels = [], np.empty((len(image), 2))
    for k in range(n):
        true = FrameCamera(
            rotation[k], centre[k], FOCAL_PX, np.array([1000.0, 1500.0]), np.array([-0.1, 0.05, 0, 0, 0])
        )
        own = image == k
        line, sample = FrameSensor(true, 2000, 3000, georeferenced=False).project(ground[point[own]])
        pixels[own] = np.column_stack([line, sample])
        away = Rotation.from_rotvec(rng.normal(scale=1e-3, size=3)).as_matrix()
        start = replace(
            true, rotation=away @ true.rotation, centre_m=true.centre_m + rng.normal(scale=0.01, size=3),
            sigma={**POSE, **names}, shared=dict.fromkeys(names, "camera 1"),
            further={"shear": 0.0} if size.camera > 8 else {},
        )  # fmt: skip
        images.append(fg.Image(f"p{k}", FrameSensor(start, 2000, 3000, georeferenced=False)))
    pixels += rng.normal(scale=NOISE_PX, size=pixels.shape)
    sigma, none = np.full(len(image), NOISE_PX), np.zeros((0, 3))
    known = Coordinates(ground + rng.normal(scale=0.02, size=ground.shape), np.full(ground.shape, np.nan),
                        np.zeros(len(ground), bool))  # fmt: skip
    points = fg.GroundPoints(tuple(map(str, range(size.points))), (fg.Role.TIE,) * size.points, known)
    bars = tuple(
        fg.Constraint(
            "distance", (str(2 * k), str(2 * k + 1)), float(np.linalg.norm(ground[2 * k] - ground[2 * k + 1])), 1e-4
        )
        for k in range(size.bars)
    )
    options = Options(priors=False, datum="inner")
    block = fg.Block(
        "network", tuple(images), points, ImagePoints(image, point, pixels[:, 0], pixels[:, 1], sigma, sigma),
        WithheldCoordinates((), lambda: Coordinates(none, none, np.zeros(0, bool))), options, extra=bars,
    )  # fmt: skip
    return block, ground


def statistics(solution: fg.Solution) -> Array:
    """Compute all statistics of a network; return the cofactors of all points."""
    q = solution.cofactors.points(np.arange(len(solution.block.points.ids)))
    solution.reliability()
    solution.suspicious()
    solution.significance()
    return np.asarray(q)


def measured(name: str) -> dict[str, Any]:
    """Measure the second run of a size."""
    size = SIZES[name]
    block, _ = network(size)
    statistics(fg.adjust(network(replace(size, points=min(size.points, max(300, 20 * size.photos))), 1)[0]))  # compiles
    statistics(fg.adjust(block))
    begin = time.process_time()
    solution = fg.adjust(block)
    adjusted = time.process_time()
    q = statistics(solution)
    return {
        "limit_s": size.limit_s, "adjust_s": adjusted - begin, "whole_s": time.process_time() - begin,
        "image_points": len(block.observations), "unknowns": solution.problem.n_unknowns,
        "status": str(solution.status),
        "sigma0": solution.sigma0, "iterations": solution.iterations,
        "rms_sigma_m": float(np.sqrt(np.einsum("nii->", q) / len(q))),
        "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }  # fmt: skip


def main() -> int:
    """Print one line per size. The exit code is always 0, because a benchmark only reports."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sizes", nargs="+", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--one", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measured(given.one)))
        return 0
    for name in given.sizes:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.frames", "--one", name], stdout=subprocess.PIPE, text=True
        )
        if done.returncode:
            print(f"{name}: exit {done.returncode}")
            continue
        r = json.loads(done.stdout.splitlines()[-1])
        print(f"{name}: {r['whole_s']:.2f} s of processor time (limit {r['limit_s']}), adjust {r['adjust_s']:.2f} s, "
              f"{r['image_points']} image points, {r['unknowns']} unknowns, {r['iterations']} iterations, "
              f"{r['status']}, sigma0 {r['sigma0']:.3f}, points {1e6 * r['rms_sigma_m']:.1f} um, "
              f"peak {r['peak_MB']:.0f} MB")  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
