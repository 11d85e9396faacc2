"""The pinhole problem has no priors and no control, and nine unknowns per camera: pose, focal length, k1 and k2."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.formats.exchange.bal import read_bal
from tests.support.pinhole import pinhole_block

Array = npt.NDArray[np.float64]

#: Numbers of cameras and of ground points with four rays each; a name is the order of the
#: number of image points. In "340 mixed" the four images of a point are drawn at random.
PINHOLE_SIZES: Final = {"1e3": (9, 250), "1e4": (36, 2_500), "1e5": (100, 25_000), "340 mixed": (340, 50_000)}
#: These sizes are for the comparison of wide networks (``benchmarks.wide``).
WIDE_SIZES: Final = {"340 mixed": (340, 50_000), "1000 mixed": (1000, 100_000), "3000 mixed": (3000, 200_000)}
VIEWS: Final = 4
#: The file is in the folder named by FG_ORIENT_REAL_DATA.
LADYBUG: Final = "bal/problem-49-7776-pre.txt.gz"


def pinhole_problem(size: str) -> Problem:
    """Return the synthetic problem of a size, without the priors of its simulation."""
    images, points = (PINHOLE_SIZES | WIDE_SIZES)[size]
    block, _ = pinhole_block(images, points, VIEWS, mixed=size.endswith("mixed"))
    return compile_problem(replace(block, options=replace(block.options, datum="free", priors=False)))


def ladybug_problem() -> Problem | None:
    """Return BAL Ladybug-49 from the folder of the real data; None if the file does not exist."""
    folder = os.environ.get("FG_ORIENT_REAL_DATA")
    path = Path(folder, LADYBUG) if folder else None
    return compile_problem(read_bal(path)) if path and path.is_file() else None


@dataclass(frozen=True)
class Pinhole:
    """Start values and observations are arrays for programs with their own pinhole camera.

    ``rotation`` (M, 3, 3) camera from ground, X right, Y down, Z forward; ``centre`` (M, 3) and ``ground`` (N, 3) m,
    local; ``interior`` (M, 3) focal length (px), k1, k2; ``image``, ``point`` (n,); ``pixel`` (n, 2) sample and line
    from the principal point; ``sigma`` (px) of both.
    """

    rotation: Array
    centre: Array
    interior: Array
    ground: Array
    image: npt.NDArray[np.intp]
    point: npt.NDArray[np.intp]
    pixel: Array
    sigma: float


def as_pinhole(problem: Problem) -> Pinhole:
    """Return the arrays of a problem of frame images with these nine unknowns.

    Raises
    ------
    ValueError
        The cameras have other parameters, or the sigmas differ.
    """
    cameras = [image.sensor.camera for image in problem.block.images]
    o = problem.observations
    sigmas = np.concatenate([o.sigma_line_px, o.sigma_sample_px])
    other = np.array([np.concatenate([c.principal_px, c.distortion[2:]]) for c in cameras])
    if other.any() or np.ptp(sigmas) > 0.0 or {len(p) for p in problem.parameters} != {9}:
        raise ValueError("cameras with focal length, k1, k2 and one sigma for all image points are expected")
    return Pinhole(
        np.array([c.rotation for c in cameras]),
        np.array([c.centre_m for c in cameras]) - problem.origin_m,
        np.array([[c.focal_px, *c.distortion[:2]] for c in cameras]),
        problem.start.ground, o.image, o.point, np.column_stack([o.sample, o.line]), float(sigmas[0]),
    )  # fmt: skip
