"""Start values: intersection of rays with the metadata orientation.

The point nearest to all rays solves ``sum (I - u u^T) X = sum (I - u u^T) P``
(docs/equations.md 6, any number of images).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fg_orient.block import Image, ImagePoints
from fg_orient.errors import InputError, Problem, problem
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.pushbroom import PushbroomSensor

Array = npt.NDArray[np.float64]

#: Rays closer to parallel than this give no point.
MIN_CONVERGENCE_DEG = 0.1


def missing_rows(coordinates_m: Array) -> npt.NDArray[np.bool_]:
    """Tell which rows (N, 3) hold no coordinates."""
    return np.asarray(np.isnan(coordinates_m).any(axis=1))


def all_rays(
    images: tuple[Image, ...], observations: ImagePoints, corrections: list[Correction] | None = None
) -> tuple[Array, Array]:
    """Projection centres and unit directions (n, 3) of all image points, ECEF."""
    centre = np.empty((len(observations), 3))
    direction = np.empty((len(observations), 3))
    for k, image in enumerate(images):
        rows = np.flatnonzero(observations.image == k)
        if len(rows):
            correction = None if corrections is None else corrections[k]
            rays = image.sensor.rays(observations.line[rows], observations.sample[rows], correction)
            centre[rows], direction[rows] = rays
    return centre, direction


def nearest_points(
    centre_m: Array, direction: Array, point: npt.NDArray[np.intp], n_points: int
) -> tuple[Array, Array]:
    """Points nearest to their rays.

    Parameters
    ----------
    centre_m, direction : (n, 3) arrays
        Rays, ECEF; directions of unit length.
    point : (n,) int array
        Which of the ``n_points`` points each ray belongs to.

    Returns
    -------
    points_m : (n_points, 3) array, nan for points with fewer than two rays or parallel ones
    convergence_deg : (n_points,) array, the angle between two rays (0 = parallel); for more
        rays the angle of two with the same smallest eigenvalue of the mean projector
    """
    normal = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    n = np.zeros((n_points, 3, 3))
    b = np.zeros((n_points, 3))
    count = np.bincount(point, minlength=n_points)
    reference = centre_m.mean(axis=0)
    np.add.at(n, point, normal)
    np.add.at(b, point, np.einsum("nij,nj->ni", normal, centre_m - reference))
    out = np.full((n_points, 3), np.nan)
    spread = np.zeros(n_points)
    use = np.flatnonzero(count >= 2)
    if len(use):
        # the smallest eigenvalue of sum(I - u u^T) is k sin^2(half angle) for two rays
        smallest = np.linalg.eigvalsh(n[use])[:, 0] / count[use]
        spread[use] = np.degrees(2.0 * np.arcsin(np.sqrt(np.clip(smallest, 0.0, 1.0))))
        good = use[spread[use] > MIN_CONVERGENCE_DEG]
        if len(good):
            out[good] = np.linalg.solve(n[good], b[good][:, :, None])[:, :, 0] + reference
    return out, spread


def intersect(
    sensors: Sequence[PushbroomSensor],
    line: npt.ArrayLike,
    sample: npt.ArrayLike,
    corrections: Sequence[Correction | None] | None = None,
) -> Array:
    """Ground points seen by every sensor: stereo and multi-ray intersection.

    Parameters
    ----------
    sensors : sequence of k PushbroomSensor, at least two
    line, sample : (k,) or (k, N) arrays
        Pixels of the same points in each image, (0, 0) = centre of the first pixel.
    corrections : sequence of k Correction or None, optional
        Adjusted orientation, for instance ``solution.correction("left")``.

    Returns
    -------
    (N, 3) array
        Points nearest to their rays, ECEF m.

    Raises
    ------
    InputError
        A pixel lies outside its image, or rays are parallel.
    """
    lines, samples = (np.asarray(a, float).reshape(len(sensors), -1) for a in (line, sample))
    rays = []
    for k, sensor in enumerate(sensors):
        sensor.require_inside(lines[k], samples[k])
        rays.append(sensor.rays(lines[k], samples[k], None if corrections is None else corrections[k]))
    n = lines.shape[1]
    centre, direction = (np.concatenate([pair[i] for pair in rays]) for i in (0, 1))
    found, spread = nearest_points(centre, direction, np.tile(np.arange(n), len(sensors)), n)
    bad = np.flatnonzero(missing_rows(found))
    if len(bad):
        raise InputError(*(_complaint(f"number {j + 1}", spread[j], False) for j in bad))
    return found


def ground_points(
    images: tuple[Image, ...],
    observations: ImagePoints,
    ids: tuple[str, ...],
    known_m: Array,
    corrections: list[Correction] | None = None,
) -> Array:
    """Start coordinates (N, 3) ECEF m: known ones as given, the others intersected.

    Raises
    ------
    InputError
        A point without coordinates is seen once, by parallel rays, or behind the sensors.
    """
    start = known_m.copy()
    unknown = missing_rows(known_m)
    if not unknown.any():
        return start
    rows = unknown[observations.point]
    centre, direction = all_rays(images, observations.take(rows), corrections)
    found, spread = nearest_points(centre, direction, observations.point[rows], len(ids))
    start[unknown] = found[unknown]
    ahead = np.einsum("ni,ni->n", start[observations.point[rows]] - centre, direction) > 0.0
    behind = np.isin(np.arange(len(ids)), observations.point[rows][~ahead & ~np.isnan(ahead)])
    problems = [_complaint(ids[k], spread[k], bool(behind[k])) for k in np.flatnonzero(unknown)
                if np.isnan(start[k]).any() or behind[k]]  # fmt: skip
    if problems:
        raise InputError(*problems)
    return start


def _complaint(point_id: str, spread_deg: float, behind: bool) -> Problem:
    code = "initial.behind" if behind and spread_deg > MIN_CONVERGENCE_DEG else "initial.no_intersection"
    return problem(code, place=f"point {point_id}", value=f"convergence {spread_deg:.3f} degrees",
                   least=MIN_CONVERGENCE_DEG)  # fmt: skip
