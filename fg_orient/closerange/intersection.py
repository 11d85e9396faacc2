"""Space intersection of oriented photos with covariance matrices.

Parallax equations of the normal case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Index, Mask
from fg_orient.closerange.fitting import UNDETERMINED, as_points, as_positions, as_sigmas, unit_weight
from fg_orient.closerange.photo import Photo
from fg_orient.model.errors import InputError, NoSolutionError

_ITERATIONS: Final = 50
#: The iteration ends if the largest step, relative to the coordinates, is below this.
_TOLERANCE: Final = 1e-13
#: The angle between rays may be noise if it is less than this multiple of its standard deviation.
SURELY: Final = 5.0


@dataclass(frozen=True)
class Intersection:
    """Intersected points.

    Parameters
    ----------
    points_m : (n, 3) array
    cofactors : (n, 3, 3) array
        Cofactors for the given sigmas; times m0 squared they are the covariance. The
        photos are treated as exact.
    residuals : (m, 2) array
        Computed minus ideal image coordinates, in the order of the observations.
    m0 : float or None
        m0 of all points together; None without redundancy.
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
    photos: Sequence[Photo],
    photo: npt.ArrayLike,
    point: npt.ArrayLike,
    image: npt.ArrayLike,
    *,
    sigma: npt.ArrayLike = 1.0,
    ids: Sequence[str] | None = None,
    reweighted: bool = False,
) -> Intersection:
    """Intersect points.

    Parameters
    ----------
    photos : sequence of Photo
    photo, point : (m,) int arrays
        Photo and point of each observation, from 0; every point in at least two photos.
    image : (m, 2) array
        Measured x, y.
    sigma : float or array that fits (m, 2)
        Standard deviations of the image coordinates.
    ids : sequence of str, optional
        Ids of the points, for messages.
    reweighted : bool
        True: equations are multiplied by their denominators and weighted with the
        previous denominators (Ayhan 1996, eqs. 119-124). False: least squares of the
        image coordinates. The results differ by the square of the residuals.

    Returns
    -------
    Intersection

    Raises
    ------
    InputError
        A point is measured in a single photo only, or its rays are so nearly parallel
        that its depth is not determined.
    NoSolutionError
        The iteration does not converge, or a point lies behind a photo.

    Notes
    -----
    The linear equations with weight 1 give the start; then Gauss-Newton on the ideal image coordinates. Reweighting
    uses slopes at the measured instead of the computed coordinates.
    """
    measured = as_points(image, 2, "image")
    which, of = as_positions(photo, "photo", measured, len(photos)), as_positions(point, "point", measured)
    size = as_sigmas(sigma, measured)
    n = int(of.max()) + 1
    names = [str(k + 1) for k in range(n)] if ids is None else list(ids)
    _refuse(np.bincount(of, minlength=n) < 2, names, "closerange.one_ray")
    shifts = [np.linalg.solve(one.matrix[:, :3], one.matrix[:, 3]) for one in photos]
    origin = np.mean([one.origin_m - shift for one, shift in zip(photos, shifts, strict=True)], axis=0)
    matrices = np.array([one.about(origin) for one in photos])[which]
    ideal = np.empty_like(measured)
    for k, one in enumerate(photos):
        rows = which == k
        if rows.any():
            ideal[rows] = one.ideal(measured[rows])
    points, iterations = _iterated(matrices, ideal, size, of, _start(matrices, ideal, of, n, names), names, reweighted)
    residuals, slopes, depth = _rows(matrices, ideal, points[of], False)
    if not (depth > 0.0).all():
        raise NoSolutionError.of("closerange.behind", place=f"point {names[of[int(np.argmin(depth))]]}")
    normal, _ = _normals(slopes / size[:, :, None], residuals / size, of, n)
    cofactors = np.asarray(np.linalg.inv(normal))
    _require_depth(cofactors, depth, matrices, size, of, names)
    white, redundancy = (residuals / size).ravel(), 2 * len(of) - 3 * n
    m0 = unit_weight(float(white @ white), redundancy)
    return Intersection(points + origin, cofactors, residuals, m0, redundancy, iterations)


def _refuse(bad: Mask, names: Sequence[str], code: str = "closerange.parallel_rays") -> None:
    """Raise InputError that names the first of the bad points (n,)."""
    if bad.any():
        raise InputError.of(code, place=f"point {names[int(np.argmax(bad))]}", value=f"{bad.sum()} point(s)")


def _start(matrices: Array, ideal: Array, of: Index, n: int, names: Sequence[str]) -> Array:
    """Solve the linear equations with weight 1 for the points."""
    rows = ideal[:, :, None] * matrices[:, 2:, :] - matrices[:, :2, :]
    rows = rows / np.linalg.norm(rows[:, :, :3], axis=2, keepdims=True)
    normal, right = _normals(rows[:, :, :3], rows[:, :, 3], of, n)
    values = np.linalg.eigvalsh(normal)
    _refuse(values[:, 0] <= 1e-13 * values[:, 2], names)
    return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, :, 0])


def _normals(rows: Array, residuals: Array, of: Index, n: int) -> tuple[Array, Array]:
    """Return normal matrices (n, 3, 3) and right sides (n, 3) of points from rows (m, 2, 3) and residuals (m, 2)."""
    normal, right = np.zeros((n, 3, 3)), np.zeros((n, 3))
    np.add.at(normal, of, np.einsum("mij,mik->mjk", rows, rows))
    np.add.at(right, of, -np.einsum("mij,mi->mj", rows, residuals))
    return normal, right


def _rows(matrices: Array, ideal: Array, points: Array, at_measured: bool) -> tuple[Array, Array, Array]:
    """Return the residuals (m, 2), their derivatives (m, 2, 3) and depths (m,)."""
    q = np.einsum("mij,mj->mi", matrices[:, :, :3], points) + matrices[:, :, 3]
    computed = q[:, :2] / q[:, 2:]
    at = ideal if at_measured else computed
    slopes = (matrices[:, :2, :3] - at[:, :, None] * matrices[:, 2:, :3]) / q[:, 2:, None]
    return computed - ideal, slopes, q[:, 2]


def _iterated(
    matrices: Array, ideal: Array, size: Array, of: Index, points: Array, names: Sequence[str], reweighted: bool
) -> tuple[Array, int]:
    """Run Gauss-Newton for each point, until all steps are at rounding level or the largest no longer decreases."""
    before, length = np.inf, np.full(len(points), np.inf)
    for iteration in range(1, _ITERATIONS + 1):
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the loop ends if a point diverges
            residuals, slopes, _ = _rows(matrices, ideal, points[of], reweighted)
            step = _solved(*_normals(slopes / size[:, :, None], residuals / size, of, len(points)))
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
    raise NoSolutionError.of(
        "closerange.not_converged",
        place=f"intersection of point {names[lost]}",
        reason=f"no convergence within {_ITERATIONS} iterations",
    )


def _require_angle(matrices: Array, ideal: Array, size: Array, name: str) -> None:
    """Refuse a point whose rays are parallel within their noise, such as rays from one place.

    With an angle a between the rays, the sigma of the distance is 1/a times the sigma of
    a point; the limit of this factor is ``UNDETERMINED``.
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
    """Return the solutions (n, 3); nan where a normal matrix is singular or not finite."""
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
    """Refuse points with a standard deviation above 1000 times the standard deviation of their image points."""
    # the norm of the first row is the norm of the depth row times the principal distance
    focal = np.linalg.norm(matrices[:, 0, :3], axis=1)
    unit = np.zeros(len(cofactors))
    np.maximum.at(unit, of, np.sqrt(np.mean(size**2, axis=1)) * depth / focal)
    sd = np.sqrt(np.einsum("nii->ni", cofactors).max(axis=1))
    _refuse(sd > UNDETERMINED * unit, names)


# --- normal case -----------------------------------------------------------------------------------


def normal_case(
    left: npt.ArrayLike,
    right: npt.ArrayLike,
    base_m: float,
    focal: float,
    focal_right: float | None = None,
    station_m: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Array:
    """Return the points of a stereo pair without rotations, with its base along x.

    Axes as in Ayhan 1996: X right, Y away from the cameras, Z up; image x right, z up
    from the principal points.

    Parameters
    ----------
    left, right : (n, 2) arrays
        Ideal x, z of the points, about the principal points.
    base_m : float
    focal, focal_right : float
        Principal distances c1, c2, in the unit of the image coordinates; default c2 = c1.
    station_m : (3,) array
        X0, Y0, Z0 of the left photo.

    Returns
    -------
    (n, 3) array
        X, Y, Z in m.

    Raises
    ------
    InputError
        A parallax is not above 0, or values are impossible.

    Notes
    -----
    Ayhan 1996, eqs. 29 and 30: Y - Y0 = b c1 c2/(x1 c2 - x2 c1), X - X0 = (Y - Y0) x1/c1, Z - Z0 = (Y - Y0) z1/c1.
    """
    first, second = as_points(left, 2, "left"), as_points(right, 2, "right")
    other = focal if focal_right is None else focal_right
    for place, value in (("base_m", base_m), ("focal", focal), ("focal_right", other)):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError.of("closerange.camera", place=place, value=value, expected="a number above 0")
    parallax = first[:, 0] * other - second[:, 0] * focal
    bad = np.flatnonzero(~(parallax > 0.0))
    if len(bad):
        raise InputError.of("closerange.parallax", place=f"point {bad[0] + 1}", value=parallax[bad[0]])
    depth = base_m * focal * other / parallax
    away = np.column_stack([depth * first[:, 0] / focal, depth, depth * first[:, 1] / focal])
    return np.asarray(away + np.asarray(station_m, float))
