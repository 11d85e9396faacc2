"""Space intersection: points from two or more oriented photos, with covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.closerange.fitting import UNDETERMINED, as_points, require_sigmas, unit_weight
from fg_orient.closerange.photo import Photo
from fg_orient.model.errors import InputError, NoSolutionError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

_ITERATIONS: Final = 50
#: Ends the iteration: largest step by the distance of the photos from the points.
_TOLERANCE: Final = 1e-13
#: Angle between rays by its noise, below which it may be noise.
SURELY: Final = 5.0


@dataclass(frozen=True)
class Intersection:
    """Intersected points.

    Parameters
    ----------
    points_m : (n, 3) array
    cofactors : (n, 3, 3) array
        For the sigmas given; times m0 squared their covariance. The photos count as exact.
    residuals : (m, 2) array
        Computed minus ideal image coordinates, in the order of the observations.
    m0 : float or None
        Of all points together; None without redundancy.
    redundancy : int
    iterations : int
    """

    points_m: Array
    cofactors: Array
    residuals: Array
    m0: float | None
    redundancy: int
    iterations: int

    @property
    def sigma_m(self) -> Array | None:
        """Standard deviations (n, 3), m; None without redundancy."""
        if self.m0 is None:
            return None
        return np.asarray(self.m0 * np.sqrt(np.einsum("nii->ni", self.cofactors)))


def intersect_photos(
    photos: Sequence[Photo], photo: npt.ArrayLike, point: npt.ArrayLike, image: npt.ArrayLike, *,
    sigma: npt.ArrayLike = 1.0, ids: Sequence[str] | None = None, reweighted: bool = False,
) -> Intersection:  # fmt: skip
    """Intersect points.

    Parameters
    ----------
    photos : sequence of Photo
    photo, point : (m,) int arrays
        Photo and point of each observation, from 0; every point in two photos or more.
    image : (m, 2) array
        Measured x, y.
    sigma : float or array that fits (m, 2)
        Of the image coordinates.
    ids : sequence of str, optional
        Of the points, for messages.
    reweighted : bool
        True: the equations times their denominators, weighted with the last ones (Ayhan 1996, eqs. 119-124), instead
        of least squares of the image coordinates. They differ by the square of the residuals.

    Returns
    -------
    Intersection

    Raises
    ------
    InputError
        A point in one photo only, or with rays so close to parallel that its depth is open.
    NoSolutionError
        The iteration does not converge, or a point lies behind a photo.

    Notes
    -----
    The linear equations with weight 1 give the start; then Gauss-Newton on the ideal image coordinates. Reweighting
    is the same with slopes at the measured instead of the computed coordinates.
    """
    which, of = np.asarray(photo, np.intp), np.asarray(point, np.intp)
    measured = as_points(image, 2, "image", InputError.of)
    size = np.broadcast_to(np.asarray(sigma, float), measured.shape)
    require_sigmas(size)
    n = int(of.max()) + 1
    names = [str(k + 1) for k in range(n)] if ids is None else list(ids)
    alone = np.flatnonzero(np.bincount(of, minlength=n) < 2)
    if len(alone):
        raise InputError.of("closerange.one_ray", place=f"point {names[alone[0]]}", value=f"{len(alone)} point(s)")
    origin = np.mean([_centre(one) for one in photos], axis=0)
    matrices = np.array([one.about(origin) for one in photos])[which]
    ideal = np.empty_like(measured)
    for k, one in enumerate(photos):
        rows = which == k
        if rows.any():
            ideal[rows] = one.ideal(measured[rows])
    points, iterations = _iterated(matrices, ideal, size, of, _start(matrices, ideal, of, n, names), names,
                                   reweighted)  # fmt: skip
    residuals, slopes, depth = _rows(matrices, ideal, points[of], False)
    if not (depth > 0.0).all():
        raise NoSolutionError.of("closerange.behind", place=f"point {names[of[int(np.argmin(depth))]]}")
    normal = _summed(slopes / size[:, :, None], slopes / size[:, :, None], of, n)
    cofactors: Array = np.linalg.inv(normal).astype(float)
    _require_depth(cofactors, depth, matrices, size, of, names)
    white, redundancy = (residuals / size).ravel(), 2 * len(of) - 3 * n
    m0 = unit_weight(float(white @ white), redundancy)
    return Intersection(points + origin, cofactors, residuals, m0, redundancy, iterations)


def _centre(photo: Photo) -> Array:
    """Projection centre, m."""
    return np.asarray(photo.origin_m - np.linalg.solve(photo.matrix[:, :3], photo.matrix[:, 3]))


def _start(matrices: Array, ideal: Array, of: Index, n: int, names: Sequence[str]) -> Array:
    """Points of the linear equations with weight 1."""
    rows = ideal[:, :, None] * matrices[:, 2:, :] - matrices[:, :2, :]
    rows = rows / np.linalg.norm(rows[:, :, :3], axis=2, keepdims=True)
    normal = _summed(rows[:, :, :3], rows[:, :, :3], of, n)
    right = np.zeros((n, 3))
    np.add.at(right, of, -np.einsum("mij,mi->mj", rows[:, :, :3], rows[:, :, 3]))
    values = np.linalg.eigvalsh(normal)
    weak = np.flatnonzero(values[:, 0] <= 1e-13 * values[:, 2])
    if len(weak):
        raise InputError.of("closerange.parallel_rays", place=f"point {names[weak[0]]}", value=f"{len(weak)} point(s)")
    return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, :, 0])


def _summed(left: Array, right: Array, of: Index, n: int) -> Array:
    """Sums over the observations of each point of left^T right: (n, 3, 3)."""
    out = np.zeros((n, left.shape[2], right.shape[2]))
    np.add.at(out, of, np.einsum("mij,mik->mjk", left, right))
    return out


def _rows(matrices: Array, ideal: Array, points: Array, at_measured: bool) -> tuple[Array, Array, Array]:
    """Residuals (m, 2), their derivatives (m, 2, 3) and depths (m,)."""
    q = np.einsum("mij,mj->mi", matrices[:, :, :3], points) + matrices[:, :, 3]
    computed = q[:, :2] / q[:, 2:]
    at = ideal if at_measured else computed
    slopes = (matrices[:, :2, :3] - at[:, :, None] * matrices[:, 2:, :3]) / q[:, 2:, None]
    return computed - ideal, slopes, q[:, 2]


def _iterated(
    matrices: Array, ideal: Array, size: Array, of: Index, points: Array, names: Sequence[str], reweighted: bool
) -> tuple[Array, int]:
    """Gauss-Newton, each point for itself; ends when no step is above rounding or the largest no longer shrinks."""
    before, length = np.inf, np.full(len(points), np.inf)
    for iteration in range(1, _ITERATIONS + 1):
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a point that runs away ends the loop
            residuals, slopes, _ = _rows(matrices, ideal, points[of], reweighted)
            white = slopes / size[:, :, None]
            normal, right = _summed(white, white, of, len(points)), np.zeros_like(points)
            np.add.at(right, of, -np.einsum("mij,mi->mj", white, residuals / size))
            step = _solved(normal, right)
            points = points + step
            length = np.linalg.norm(step, axis=1) / (np.linalg.norm(points, axis=1) + np.finfo(float).tiny)
        largest = float(length.max())
        if not np.isfinite(largest):
            break
        if largest <= _TOLERANCE or (largest <= 1e-9 and largest >= 0.5 * before):
            return points, iteration
        before = largest
    lost = int(np.nanargmax(np.where(np.isfinite(length), length, np.inf)))
    _require_angle(matrices[of == lost], ideal[of == lost], size[of == lost], names[lost])
    raise NoSolutionError.of("closerange.not_converged", place=f"intersection of point {names[lost]}",
                             reason=f"no convergence within {_ITERATIONS} iterations")  # fmt: skip


def _require_angle(matrices: Array, ideal: Array, size: Array, name: str) -> None:
    """Refuse a point whose rays are parallel, or so close to it that their noise decides, as those of one place are.

    An angle a leaves a distance with 1/a times the sigma of a point, which may be ``UNDETERMINED``.
    """
    rays = np.linalg.solve(matrices[:, :, :3], np.column_stack([ideal, np.ones(len(ideal))])[:, :, None])[:, :, 0]
    centres = -np.linalg.solve(matrices[:, :, :3], matrices[:, :, 3:])[:, :, 0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    angle = max(float(np.linalg.norm(np.cross(rays[i], rays[:i]), axis=1).max()) for i in range(1, len(rays)))
    noise = float(np.sqrt(np.mean((size / np.linalg.norm(matrices[:, 0, :3], axis=1)[:, None]) ** 2)))
    if angle <= max(1.0 / UNDETERMINED, SURELY * noise):
        apart = max(float(np.linalg.norm(centres[i] - centres[:i], axis=1).max()) for i in range(1, len(rays)))
        value = f"{angle:.1g} rad between them, projection centres {apart:.3g} m apart"
        raise InputError.of("closerange.parallel_rays", place=f"point {name}", value=value)


def _solved(normal: Array, right: Array) -> Array:
    """Solutions (n, 3); nan where a normal matrix is singular or not finite."""
    try:
        return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        finite = np.where(np.isfinite(normal).all(axis=(1, 2)), 1.0, 0.0)
        good = np.linalg.matrix_rank(np.nan_to_num(normal) * finite[:, None, None]) == 3
        out = np.full_like(right, np.nan)
        out[good] = np.linalg.solve(normal[good], right[good][:, :, None])[:, :, 0]
        return out


def _require_depth(
    cofactors: Array, depth: Array, matrices: Array, size: Array, of: Index, names: Sequence[str]
) -> None:
    """Refuse points whose coordinates are 1000 times worse than their image at their distance says."""
    focal = np.linalg.norm(matrices[:, 0, :3], axis=1)  # of the depth row times the principal distance, about
    unit = np.zeros(len(cofactors))
    np.maximum.at(unit, of, np.sqrt(np.mean(size**2, axis=1)) * depth / focal)
    sd = np.sqrt(np.einsum("nii->ni", cofactors).max(axis=1))
    bad = np.flatnonzero(sd > UNDETERMINED * unit)
    if len(bad):
        raise InputError.of("closerange.parallel_rays", place=f"point {names[bad[0]]}", value=f"{len(bad)} point(s)")
