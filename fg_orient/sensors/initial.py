"""Start values: intersection of rays with the metadata orientation.

The point nearest to all rays solves ``sum (I - u u^T) X = sum (I - u u^T) P``
(docs/equations.md 6, any number of images).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fg_orient.model.block import Image, ImagePoints
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.base import Sensor

Array = npt.NDArray[np.float64]

#: Rays closer to parallel than this give no point.
MIN_CONVERGENCE_DEG = 0.1


def missing_rows(coordinates_m: Array) -> npt.NDArray[np.bool_]:
    """Tell which rows (N, 3) hold no coordinates."""
    return np.asarray(np.isnan(coordinates_m).any(axis=1))


def all_rays(
    images: tuple[Image, ...], observations: ImagePoints, corrections: Sequence[Any] | None = None
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
    convergence_deg : (n_points,) array, the largest angle between any two rays of the point
        (0 = parallel, or fewer than two rays)
    """
    normal = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    n = np.zeros((n_points, 3, 3))
    b = np.zeros((n_points, 3))
    count = np.bincount(point, minlength=n_points)
    reference = centre_m.mean(axis=0)
    np.add.at(n, point, normal)
    np.add.at(b, point, np.einsum("nij,nj->ni", normal, centre_m - reference))
    out = np.full((n_points, 3), np.nan)
    spread = _largest_angles_deg(direction, point, count)
    good = np.flatnonzero(spread > MIN_CONVERGENCE_DEG)
    if len(good):
        out[good] = np.linalg.solve(n[good], b[good][:, :, None])[:, :, 0] + reference
    return out, spread


def intersection_covariances(
    images: tuple[Image, ...], observations: ImagePoints, ground_m: Array, corrections: Sequence[Any] | None = None
) -> Array:
    """Covariances (n_points, 3, 3) ECEF m^2 that the sigmas of the image points give :func:`nearest_points`.

    With P = I - u u^T and D the shift of a ray at the ground by a pixel (over half a pixel to either side)::

        C = N^-1 (sum P D S D^T P) N^-1,   N = sum P

    The orientation is taken as free of error. nan for points of fewer than two rays.
    """
    shift = np.zeros((len(observations), 3, 2))
    normal = np.zeros((len(observations), 3, 3))
    for k, image in enumerate(images):
        rows = np.flatnonzero(observations.image == k)
        if not len(rows):
            continue
        correction = None if corrections is None else corrections[k]
        line, sample, ground = observations.line[rows], observations.sample[rows], ground_m[observations.point[rows]]
        direction = image.sensor.rays(line, sample, correction)[1]
        normal[rows] = np.eye(3) - direction[:, :, None] * direction[:, None, :]
        shift[rows] = _pixel_shifts(image.sensor, (line, sample), ground, correction)
    noise = shift * np.stack([observations.sigma_line_px, observations.sigma_sample_px], axis=1)[:, None]
    spread = normal @ noise
    n, middle = (np.zeros((len(ground_m), 3, 3)) for _ in range(2))
    np.add.at(n, observations.point, normal)
    np.add.at(middle, observations.point, spread @ np.swapaxes(spread, 1, 2))
    out = np.full((len(ground_m), 3, 3), np.nan)
    good = np.flatnonzero(np.bincount(observations.point, minlength=len(ground_m)) >= 2)
    inverse = np.linalg.inv(n[good])
    out[good] = inverse @ middle[good] @ inverse
    return out


def _pixel_shifts(sensor: Any, pixel: tuple[Array, Array], ground_m: Array, correction: Any) -> Array:
    """Shift (n, 3, 2) m of rays at ground points by a line and by a sample; differences stay inside the image."""
    limits = ((sensor.first_line, sensor.last_line), (sensor.first_sample, sensor.last_sample))
    out = np.zeros((len(ground_m), 3, 2))
    for k, (first, last) in enumerate(limits):
        low, high = (np.clip(pixel[k] + step, first - 0.5, last + 0.5) for step in (-0.5, 0.5))
        feet = []
        for values in (low, high):
            at = (values, pixel[1]) if k == 0 else (pixel[0], values)
            centre, direction = sensor.rays(*at, correction)
            feet.append(_foot(centre, direction, ground_m))
        out[:, :, k] = (feet[1] - feet[0]) / (high - low)[:, None]
    return out


def _foot(centre_m: Array, direction: Array, ground_m: Array) -> Array:
    """Points (n, 3) of rays nearest to ground points."""
    along = np.einsum("ni,ni->n", ground_m - centre_m, direction)
    return np.asarray(centre_m + along[:, None] * direction)


def _largest_angles_deg(direction: Array, point: npt.NDArray[np.intp], count: npt.NDArray[np.intp]) -> Array:
    """Largest angle between any two rays of each point; points with the same number of rays at once."""
    out = np.zeros(len(count))
    order, first = np.argsort(point, kind="stable"), np.cumsum(count) - count
    for rays in np.unique(count[count >= 2]):
        which = np.flatnonzero(count == rays)
        u = direction[order[first[which, None] + np.arange(rays)]]
        chord = np.zeros(len(which))
        for k in range(1, rays):
            apart = np.linalg.norm(u[:, k:] - u[:, :-k], axis=2)
            chord = np.maximum(chord, apart.max(axis=1))
        out[which] = np.degrees(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))
    return out


def _behind(points_m: Array, centre_m: Array, direction: Array, point: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Tell which points lie behind the sensor of one of their rays: (n_points,); nan ones do not."""
    along = np.einsum("ni,ni->n", points_m[point] - centre_m, direction)
    out = np.zeros(len(points_m), bool)
    out[point[along <= 0.0]] = True
    return out


def intersect(
    sensors: Sequence[Sensor],
    line: npt.ArrayLike,
    sample: npt.ArrayLike,
    corrections: Sequence[Any] | None = None,
) -> Array:
    """Ground points seen by every sensor: stereo and multi-ray intersection.

    Parameters
    ----------
    sensors : sequence of k sensors, at least two
    line, sample : (k,) or (k, N) arrays
        Pixels of the same points in each image, (0, 0) = centre of the first pixel.
    corrections : sequence of k corrections as the sensors take them, or None, optional
        Adjusted orientation, for instance ``solution.correction("left")``.

    Returns
    -------
    (N, 3) array
        Points nearest to their rays, ECEF m.

    Raises
    ------
    InputError
        A pixel lies outside its image, rays are parallel or meet behind a sensor, or there is not
        one row of pixels, or not one correction, per sensor.
    """
    lines, samples = (np.asarray(a, float) for a in (line, sample))
    if lines.shape != samples.shape or lines.ndim not in (1, 2) or len(lines) != len(sensors):
        raise InputError.of("initial.pixel_count", place="line, sample", sensors=len(sensors),
                            value=f"shapes {lines.shape} and {samples.shape}")  # fmt: skip
    if corrections is not None and len(corrections) != len(sensors):
        raise InputError.of("initial.correction_count", place="corrections", value=len(corrections),
                            sensors=len(sensors))  # fmt: skip
    lines, samples = (a.reshape(len(sensors), -1) for a in (lines, samples))
    rays = []
    for k, sensor in enumerate(sensors):
        sensor.require_inside(lines[k], samples[k])
        rays.append(sensor.rays(lines[k], samples[k], None if corrections is None else corrections[k]))
    n = lines.shape[1]
    centre, direction = (np.concatenate([pair[i] for pair in rays]) for i in (0, 1))
    point = np.tile(np.arange(n), len(sensors))
    found, spread = nearest_points(centre, direction, point, n)
    behind = _behind(found, centre, direction, point)
    bad = np.flatnonzero(missing_rows(found) | behind)
    if len(bad):
        seen = [str(k + 1) for k in range(len(sensors))]
        raise InputError(*(_complaint(f"number {j + 1}", spread[j], bool(behind[j]), seen) for j in bad))
    return found


def ground_points(
    images: tuple[Image, ...],
    observations: ImagePoints,
    ids: tuple[str, ...],
    known_m: Array,
    corrections: Sequence[Any] | None = None,
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
    behind = _behind(start, centre, direction, observations.point[rows])
    bad = np.flatnonzero(unknown & (missing_rows(start) | behind))
    if len(bad):
        used = observations.take(rows)
        seen = {int(k): [images[i].id for i in used.image[used.point == k]] for k in bad}
        raise InputError(*(_complaint(ids[k], spread[k], bool(behind[k]), seen[int(k)]) for k in bad))
    return start


def _complaint(point_id: str, spread_deg: float, behind: bool, images: Sequence[str]) -> Finding:
    if len(images) < 2:
        return finding("initial.seen_once", place=f"point {point_id}", value=f"{len(images)} ray",
                       image=f"image {images[0]}" if images else "no image")  # fmt: skip
    code = "initial.behind" if behind and spread_deg > MIN_CONVERGENCE_DEG else "initial.no_intersection"
    return finding(code, place=f"point {point_id}", value=f"convergence {spread_deg:.3f} degrees",
                   least=MIN_CONVERGENCE_DEG)  # fmt: skip
