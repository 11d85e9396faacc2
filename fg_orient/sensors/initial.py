"""Compute start values of ground points by space intersection with the metadata orientation.

The point X with the smallest distances from the rays solves ``sum (I - u u^T) X = sum (I
- u u^T) P``, for any number of images (docs/equations.md 6).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.model import arrays
from fg_orient.model.block import Image, ImagePoints
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.base import Sensor

#: Minimum angle between the rays of a point.
MIN_CONVERGENCE_DEG = 0.1


def local_origin(images: Sequence[Image]) -> Array:
    """Return the origin (3,) of the ground unknowns, ECEF m: the mean of the image centres on the ground."""
    return np.asarray(np.mean([image.sensor.centre_m for image in images], axis=0))


def missing_rows(coordinates_m: Array) -> Mask:
    """Return a mask (N,) of the rows of (N, 3) without coordinates."""
    return np.asarray(np.isnan(coordinates_m).any(axis=1))


def all_rays(
    images: tuple[Image, ...], observations: ImagePoints, corrections: Sequence[Any] | None = None
) -> tuple[Array, Array]:
    """Return projection centres and unit directions (n, 3) of all image points, ECEF."""
    centre, direction = np.empty((2, len(observations), 3))
    for sensor, rows, correction in _by_image(images, observations, corrections):
        centre[rows], direction[rows] = sensor.rays(observations.line[rows], observations.sample[rows], correction)
    return centre, direction


def _by_image(
    images: tuple[Image, ...], observations: ImagePoints, corrections: Sequence[Any] | None
) -> Iterator[tuple[Any, Index, Any]]:
    """Yield the sensor, the image points and the correction of each image that has image points."""
    for k, image in enumerate(images):
        rows = np.flatnonzero(observations.image == k)
        if len(rows):
            yield image.sensor, rows, None if corrections is None else corrections[k]


def nearest_points(centre_m: Array, direction: Array, point: Index, n_points: int) -> tuple[Array, Array]:
    """Compute the points that are nearest to their rays.

    Parameters
    ----------
    centre_m, direction : (n, 3) arrays
        Rays in ECEF; directions are unit vectors.
    point : (n,) int array
        Number of the point of each ray, from 0.

    Returns
    -------
    points_m : (n_points, 3) array
        ECEF coordinates; nan for points with fewer than two rays or with parallel rays.
    convergence_deg : (n_points,) array
        Largest angle between any two rays of the point; 0 for parallel rays and for fewer than two rays.
    """
    n, b = _projections(direction, point, n_points), np.empty((n_points, 3))
    reference = centre_m.mean(axis=0)
    from_reference = centre_m - reference
    along = np.einsum("ni,ni->n", direction, from_reference)
    for i in range(3):
        b[:, i] = np.bincount(point, from_reference[:, i] - direction[:, i] * along, n_points)
    out = np.full((n_points, 3), np.nan)
    spread = _largest_angles_deg(direction, point, np.bincount(point, minlength=n_points))
    good = np.flatnonzero(spread > MIN_CONVERGENCE_DEG)
    if len(good):
        out[good] = np.linalg.solve(n[good], b[good][:, :, None])[:, :, 0] + reference
    return out, spread


def _projections(direction: Array, point: Index, n_points: int) -> Array:
    """Return the sum of I - u u^T over the rays u of each point: (n_points, 3, 3).

    The elements are summed one by one, so that no matrix is stored for each ray.
    """
    out, count = np.empty((n_points, 3, 3)), np.bincount(point, minlength=n_points)
    for i in range(3):
        for j in range(i, 3):
            sums = np.bincount(point, direction[:, i] * direction[:, j], n_points)
            out[:, i, j] = out[:, j, i] = (i == j) * count - sums
    return out


def intersection_covariances(images: tuple[Image, ...], observations: ImagePoints, ground_m: Array) -> Array:
    """Return covariance matrices (n_points, 3, 3), ECEF m^2, of the points of :func:`nearest_points`.

    The standard deviations of the image points are propagated. P is I - u u^T. D is the
    shift of a ray at the ground for one pixel, computed from half a pixel to either
    side::

        C = N^-1 (sum P D S D^T P) N^-1,   N = sum P

    The orientation is assumed to have no error. The result is nan for points with fewer than two rays.
    """
    shift, point = np.zeros((len(observations), 3, 2)), observations.point
    for sensor, rows, _ in _by_image(images, observations, None):
        pixel = observations.line[rows], observations.sample[rows]
        shift[rows] = _pixel_shifts(sensor, pixel, ground_m[point[rows]])
    direction = all_rays(images, observations)[1]
    noise = shift * np.stack([observations.sigma_line_px, observations.sigma_sample_px], axis=1)[:, None]
    spread = noise - direction[:, :, None] * np.einsum("ni,nij->nj", direction, noise)[:, None]
    middle = np.zeros((len(ground_m), 3, 3))
    np.add.at(middle, point, spread @ np.swapaxes(spread, 1, 2))
    out = np.full((len(ground_m), 3, 3), np.nan)
    good = np.flatnonzero(np.bincount(point, minlength=len(ground_m)) >= 2)
    inverse = np.linalg.inv(_projections(direction, point, len(ground_m))[good])
    out[good] = inverse @ middle[good] @ inverse
    return out


def _pixel_shifts(sensor: Any, pixel: tuple[Array, Array], ground_m: Array) -> Array:
    """Return the shifts (n, 3, 2), m, of rays at ground points by one line and one sample.

    The differences are formed inside the image.
    """
    limits = ((sensor.first_line, sensor.last_line), (sensor.first_sample, sensor.last_sample))
    out = np.zeros((len(ground_m), 3, 2))
    for k, (first, last) in enumerate(limits):
        low, high = (np.clip(pixel[k] + step, first - 0.5, last + 0.5) for step in (-0.5, 0.5))
        ends = []
        for values in (low, high):
            at = (values, pixel[1]) if k == 0 else (pixel[0], values)
            centre, direction = sensor.rays(*at)
            ends.append(foot_points(centre, direction, ground_m))
        out[:, :, k] = (ends[1] - ends[0]) / (high - low)[:, None]
    return out


def foot_points(centre_m: Array, direction: Array, ground_m: Array) -> Array:
    """Return the points (n, 3) on rays that are closest to ground points (n, 3)."""
    along = np.einsum("ni,ni->n", ground_m - centre_m, direction)
    return np.asarray(centre_m + along[:, None] * direction)


def _largest_angles_deg(direction: Array, point: Index, count: Index) -> Array:
    """Return the largest angle between two rays of each point, degrees.

    All points with the same number of rays are computed together.
    """
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


def intersect(
    sensors: Sequence[Sensor],
    line: npt.ArrayLike,
    sample: npt.ArrayLike,
    corrections: Sequence[Any] | None = None,
) -> Array:
    """Intersect the rays of points that every sensor shows, for two or more images.

    Parameters
    ----------
    sensors : sequence of k sensors, at least two
    line, sample : (k,) or (k, N) arrays
        Pixels of the same points in each image; (0, 0) is the centre of the first pixel.
    corrections : sequence of k corrections of the sensors, or None, optional
        Adjusted orientations, for example ``solution.correction("left")``.

    Returns
    -------
    (N, 3) array
        Points that are nearest to their rays, ECEF m.

    Raises
    ------
    InputError
        A pixel lies outside its image, rays are parallel or intersect behind a sensor, or
        the number of rows of pixels or of corrections differs from the number of sensors.
    """
    if not isinstance(sensors, Sequence) or not sensors:
        raise arrays.wrong("sensors", repr(sensors), "two sensors or more")
    lines, samples = arrays.array(line, "line"), arrays.array(sample, "sample")
    if not lines.size:
        raise arrays.wrong("line", f"shape {lines.shape}", "one point or more")
    if lines.shape != samples.shape or lines.ndim not in (1, 2) or len(lines) != len(sensors):
        raise InputError.of("initial.pixel_count", place="line, sample", sensors=len(sensors),
                            value=f"shapes {lines.shape} and {samples.shape}")  # fmt: skip
    if corrections is not None and len(corrections) != len(sensors):
        raise InputError.of("initial.correction_count", place="corrections", value=len(corrections),
                            sensors=len(sensors))  # fmt: skip
    lines, samples = (a.reshape(len(sensors), -1) for a in (lines, samples))
    for sensor, own_lines, own_samples in zip(sensors, lines, samples, strict=True):
        sensor.require_inside(own_lines, own_samples)
    n, m = len(sensors), lines.shape[1]
    images = tuple(Image(str(k + 1), sensor) for k, sensor in enumerate(sensors))
    one, point = np.ones(n * m), np.tile(np.arange(m), n)
    pixels = ImagePoints(np.repeat(np.arange(n), m), point, lines.ravel(), samples.ravel(), one, one)
    return ground_points(
        images, pixels, tuple(f"number {j + 1}" for j in range(m)), np.full((m, 3), np.nan), corrections
    )


def ground_points(
    images: tuple[Image, ...],
    observations: ImagePoints,
    ids: tuple[str, ...],
    known_m: Array,
    corrections: Sequence[Any] | None = None,
) -> Array:
    """Return start coordinates (N, 3), ECEF m: known points as given, other points by intersection.

    Raises
    ------
    InputError
        A point without coordinates has only one ray, its rays are parallel, or they
        intersect behind the sensors.
    """
    start = known_m.copy()
    unknown = missing_rows(known_m)
    if not unknown.any():
        return start
    used = observations.take(unknown[observations.point])
    centre, direction = all_rays(images, used, corrections)
    nearest, spread = nearest_points(centre, direction, used.point, len(ids))
    start[unknown] = nearest[unknown]
    behind = np.zeros(len(ids), bool)
    behind[used.point[np.einsum("ni,ni->n", start[used.point] - centre, direction) <= 0.0]] = True
    bad = np.flatnonzero(unknown & (missing_rows(start) | behind))
    if len(bad):
        seen = {int(k): [images[i].id for i in used.image[used.point == k]] for k in bad}
        raise InputError(*(_failure(ids[k], spread[k], bool(behind[k]), seen[int(k)]) for k in bad))
    return start


def _failure(point_id: str, spread_deg: float, behind: bool, images: Sequence[str]) -> Finding:
    if len(images) < 2:
        return finding("initial.seen_once", place=f"point {point_id}", value=f"{len(images)} ray",
                       image=f"image {images[0]}" if images else "no image")  # fmt: skip
    code = "initial.behind" if behind and spread_deg > MIN_CONVERGENCE_DEG else "initial.no_intersection"
    return finding(code, place=f"point {point_id}", value=f"convergence {spread_deg:.3f} degrees",
                   least=MIN_CONVERGENCE_DEG)  # fmt: skip
