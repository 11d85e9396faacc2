"""Relative orientation of two photos by coplanarity, absolute orientation of a model by control points."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Final

import numpy as np
import numpy.typing as npt

from factors._contract import evaluate
from factors.arrays import Array
from factors.cameras.frame_camera import CAMERA, rotated
from factors.conditions.coplanarity import COPLANARITY, turn_and_base
from factors.conditions.coplanarity import RECORD as PAIR
from factors.conditions.similarity import RECORD, SIMILARITY
from fg_orient.closerange import fitting
from fg_orient.closerange.minima import SAME, Rival, bend, ratio_limit, rival_of
from fg_orient.closerange.photo import PhotoInterior
from fg_orient.closerange.relative_starts import rays, start_pairs
from fg_orient.model.distributions import chi_square_limit, f_quantile
from fg_orient.model.errors import Finding, InputError, NoSolutionError
from fg_orient.rectification.transformation import Scaling
from fg_orient.sensors.initial import nearest_points

LEAST_RELATIVE: Final = 6
#: Level of the test whether a rotation alone fits two photos.
NO_BASE: Final = 1e-3
LEAST_ABSOLUTE: Final = 3
#: Code and place of the error for points on a line, which do not determine the rotation about it.
ON_A_LINE: Final = ("closerange.line", "absolute orientation")


@dataclass(frozen=True)
class RelativeOrientation(fitting.Fit):
    """Orientation of the second photo relative to the first.

    Cofactors refer to rotations (rad) about the axes of the second camera, and of the base along ``base_axes``.

    Parameters
    ----------
    rotation : (3, 3) array
        Rotates camera axes of the first photo to camera axes of the second (X right, Y down, Z along
        the view).
    base : (3,) array
        Direction to the second projection centre in axes of the first camera, length 1.
    base_axes : (2, 3) array
        Two directions perpendicular to the base; errors of the base refer to them.
    model : (n, 3) array
        Points in axes of the first camera; the base has length 1.
    distances : (n,) array
        Distance of each pair of image points from coplanarity, in sigmas.
    bend : float
        Bend. Above 0.25 each standard deviation is correct, but the covariance as a whole
        is optimistic (:func:`fg_orient.closerange.minima.bend`): few points of a plane,
        short bases.
    rival : Rival or None
        Second orientation that fits few points of a plane; seven or eight points in space may also have one.
    """

    rotation: Array
    base: Array
    base_axes: Array
    model: Array
    distances: Array
    bend: float = 0.0
    rival: Rival | None = None

    def second_orientation(self) -> list[Finding]:
        """Return the warning of the rival, if there is one."""
        return [] if self.rival is None else [self.rival.warning("closerange.second_orientation", "base")]


@dataclass(frozen=True)
class _Candidate:
    """Minimum of the squares; its ``orientation`` is None if the points do not determine it."""

    squares: float
    rotation: Array
    base: Array
    in_front: bool
    orientation: RelativeOrientation | None


def relative_orientation(
    first: PhotoInterior,
    second: PhotoInterior,
    image_first: npt.ArrayLike,
    image_second: npt.ArrayLike,
    *,
    sigma: float | None = None,
) -> RelativeOrientation:
    """Orient two photos to each other.

    Parameters
    ----------
    first, second : PhotoInterior
    image_first, image_second : (n, 2) arrays
        Measured coordinates of six points or more in both.
    sigma : float, optional
        Standard deviation of all image coordinates, in the unit of the focal lengths;
        without it m0 is the estimate.

    Returns
    -------
    RelativeOrientation
        Smallest minimum with all points in front of both cameras, with its rival.

    Raises
    ------
    InputError
        There are too few points, or they do not determine the orientation at the smallest
        minimum. This also applies if they determine it at another minimum.
    NoSolutionError
        At no minimum do the points lie in front of both cameras.

    Notes
    -----
    Coplanarity (Ayhan 1996, eqs. 9-19) as a condition between five unknowns and the four image coordinates of a point,
    adjusted by foot points. Starts: normal cases along the axes; the homography of a plane (Faugeras, Lustman 1988, in
    the form of Ma et al. 2004); with eight points or more the essential matrix (Longuet-Higgins 1981, normalised as in
    Hartley 1997), which points of a plane do not determine.
    """
    tangents = [
        camera.tangents(fitting.as_points(image, 2, place))
        for camera, image, place in ((first, image_first, "first image"), (second, image_second, "second image"))
    ]
    n = len(tangents[0])
    if n != len(tangents[1]) or n < LEAST_RELATIVE:
        raise InputError.of("closerange.few", place="relative orientation", value=n, least=LEAST_RELATIVE)
    unit = 1.0 if sigma is None else sigma
    fitting.require_sigmas(unit)
    points = np.column_stack(tangents)
    size = np.tile(np.repeat([unit / first.focal, unit / second.focal], 2), (n, 1))
    minima = list[_Candidate]()
    for rotation, base in start_pairs(points):
        with suppress(NoSolutionError):
            minima.append(_adjusted_pair(points, size, rotation, base))
    minima.sort(key=attrgetter("squares"))
    try:
        chosen = _chosen(minima, n - 5, known=sigma is not None)
    except (InputError, NoSolutionError):
        _require_base(points, size, minima[0].squares if minima else 0.0, known=sigma is not None)
        raise
    record, _ = _record(chosen.rotation, chosen.base)
    bent = bend(lambda x, jacobian: _pair_rows(record, points, size, x, jacobian), np.zeros(5), chosen.m0)
    return replace(chosen, bend=bent)


def _chosen(minima: list[_Candidate], redundancy: int, *, known: bool) -> RelativeOrientation:
    """Return the smallest determined minimum with the points in front of both cameras.

    An undetermined minimum is refused if its squares are smaller. If the points of such a minimum lie
    behind a camera, noise may be the reason. The orientation is then refused only if an F test
    distinguishes the determined minimum from this minimum.

    Raises
    ------
    InputError, NoSolutionError
        See :func:`relative_orientation`.
    """
    first = next((one for one in minima if one.in_front and one.orientation is not None), None)
    best = np.inf if first is None else first.squares
    for one in minima:
        below = one.squares < best if one.in_front else one.squares * ratio_limit(redundancy) < best
        if one.orientation is None and below:
            raise InputError.of("closerange.pair", place="relative orientation", value="the least squares are there")
    if first is None or first.orientation is None:
        raise NoSolutionError.of("closerange.no_pair", place="relative orientation")
    for other in minima:
        apart = max(np.abs(other.rotation - first.rotation).max(), np.linalg.norm(other.base - first.base))
        rival = rival_of(first.squares, other.squares, redundancy, other.rotation, other.base, known=known)
        if other.in_front and apart > SAME and rival is not None:
            return replace(first.orientation, rival=rival)
    return first.orientation


def _record(rotation: Array, base: Array) -> tuple[Array, Array]:
    """Return the record of the equation, and the directions at right angles to the base."""
    axes = np.linalg.svd(base[None])[2][1:]
    return PAIR.pack(factor=1.0, rotation=rotation.ravel(), base=base, n_1=axes[0], n_2=axes[1]), axes


def _adjusted_pair(points: Array, sigma: Array, rotation: Array, base: Array) -> _Candidate:
    record, _ = _record(rotation, base)
    minimum = fitting.adjust(
        lambda x, jacobian: _pair_rows(record, points, sigma, x, jacobian), np.zeros(5), "relative orientation"
    )
    turn, moved = turn_and_base(record, minimum.state)
    rotation, base = turn[CAMERA.rotation].reshape(3, 3), moved / np.linalg.norm(moved)
    model = _model(points, rotation, base)
    in_front = bool(
        np.isfinite(model).all() and (model[:, 2] > 0.0).all() and ((model - base) @ rotation[2] > 0.0).all()
    )
    # repeated at the solution, so that the unknowns are rotations about the axes of the second camera
    record, axes = _record(rotation, base)
    distances, design = _pair_rows(record, points, sigma, np.zeros(5), True)
    assessed, squares = fitting.determination(design, sigma), float(distances @ distances)
    if assessed.cofactors is None:
        return _Candidate(squares, rotation, base, in_front, None)
    facts = fitting.statistics(distances, assessed, len(minimum.log), np.eye(5))
    return _Candidate(
        squares, rotation, base, in_front, RelativeOrientation(rotation, base, axes, model, distances, **facts)
    )


def _pair_rows(record: Array, points: Array, sigma: Array, x: Array, with_jacobian: bool) -> tuple[Array, Array]:
    """Return the weighted distances of the image points from coplanarity, and their derivatives."""
    turn, base = turn_and_base(record, x)
    g = turn[CAMERA.rotation].reshape(3, 3) @ np.cross(np.eye(3), base)
    square = np.zeros((4, 4))
    square[2:, :2], square[:2, 2:] = 0.5 * g[:2, :2], 0.5 * g[:2, :2].T
    conditions = fitting.Conditions(square, 0.5 * np.concatenate([g[2, :2], g[:2, 2]]), float(g[2, 2]))
    residual, foot = fitting.weighted_distances(conditions, points, sigma)
    if not with_jacobian:
        return residual, np.zeros((0, 5))
    n = len(points)
    _, (by_unknown, slope) = evaluate(COPLANARITY, np.tile(record, (n, 1)), [np.zeros((2, 0))] * n, [x] * n, foot)
    return residual, fitting.distance_rows(np.concatenate(by_unknown), np.concatenate(slope), sigma)


def _model(points: Array, rotation: Array, base: Array) -> Array:
    """Return the points (n, 3) nearest to both rays; nan for parallel rays."""
    n, (first, second) = len(points), rays(points)
    directions = np.concatenate([first, second @ rotation])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    centres = np.repeat(np.stack([np.zeros(3), base]), n, axis=0)
    return nearest_points(centres, directions, np.tile(np.arange(n), 2), n)[0]


def _require_base(points: Array, sigma: Array, squares: float, *, known: bool) -> None:
    """Refuse photos whose base is zero within the noise: a rotation alone fits them, two conditions for each point.

    Parameters
    ----------
    points, sigma : (n, 4) arrays
    squares : float
        Least weighted squares of coplanarity, one condition for each point; without known
        sigmas they define the noise.
    known : bool
        True if sigmas are given.
    """
    n, (first, second) = len(points), rays(points)
    unit = [d / np.linalg.norm(d, axis=1, keepdims=True) for d in (first, second)]
    left, _, right = np.linalg.svd(unit[1].T @ unit[0])
    turn = left * [1.0, 1.0, np.sign(np.linalg.det(left @ right))] @ right
    seen = first @ turn.T
    computed = seen[:, :2] / seen[:, 2:]
    slope = (turn[:2, :2] - computed[:, :, None] * turn[2, :2]) / seen[:, 2, None, None]
    covariance = np.einsum("nij,nj,nkj->nik", slope, sigma[:, :2] ** 2, slope)
    covariance += sigma[:, 2:, None] ** 2 * np.eye(2)
    away = points[:, 2:] - computed
    turned_only = float(np.einsum("ni,ni->", away, np.linalg.solve(covariance, away[:, :, None])[:, :, 0]))
    freedom = 2 * n - 3
    limit = float(chi_square_limit(freedom, NO_BASE))
    if not known:
        limit = freedom * squares / (n - 5) * float(f_quantile(freedom, n - 5, 1.0 - NO_BASE))
    if turned_only <= limit:
        raise InputError.of(
            "closerange.no_base",
            place="relative orientation",
            value=f"weighted squares {turned_only:.3g}, {limit:.3g} may be noise",
        )


# --- absolute orientation --------------------------------------------------------------------------


@dataclass(frozen=True)
class Similarity(fitting.Fit):
    """Seven-parameter transformation: ground = shift + scale rotation model.

    Cofactors refer to rotations about the ground axes (rad), to the logarithm of the
    scale, and to the shift (m).

    Parameters
    ----------
    scale : float
    rotation : (3, 3) array
    shift_m : (3,) array
    residuals_m : (n, 3) array
        Computed minus given.
    bend : float
        Bend. Above 0.25 each standard deviation is correct, but the covariance as a whole
        is optimistic (:func:`fg_orient.closerange.minima.bend`): points close to a line.
        It is computed for unknowns about the middle of the points.
    """

    scale: float
    rotation: Array
    shift_m: Array
    residuals_m: Array
    bend: float

    def apply(self, model: npt.ArrayLike) -> Array:
        """Return the ground coordinates (n, 3) of model points."""
        return np.asarray(self.shift_m + self.scale * fitting.as_points(model, 3, "model") @ self.rotation.T)


def absolute_orientation(model: npt.ArrayLike, ground_m: npt.ArrayLike, *, sigma_m: npt.ArrayLike = 1.0) -> Similarity:
    """Fit a model to control points.

    Parameters
    ----------
    model : (n, 3) array
        Any unit.
    ground_m : (n, 3) array
        Three points or more, not on a line.
    sigma_m : float or array that fits (n, 3)
        Standard deviations of the differences along X, Y, Z.

    Returns
    -------
    Similarity

    Raises
    ------
    InputError
        There are too few points, or they lie on a line.
    NoSolutionError
        The iteration does not converge.

    Notes
    -----
    Start in closed form (Umeyama 1991), which is the solution for equal sigmas; then ``factors.conditions.similarity``.
    """
    source, target = fitting.as_points(model, 3, "model"), fitting.as_points(ground_m, 3, "ground")
    sigma = fitting.as_sigmas(sigma_m, target, "sigma_m")
    if len(source) != len(target) or len(source) < LEAST_ABSOLUTE:
        raise InputError.of("closerange.few", place="absolute orientation", value=len(source), least=LEAST_ABSOLUTE)
    from_, to = Scaling.of(source, shared=True), Scaling.of(target, shared=True)
    a, b = from_.normalised(source), to.normalised(target)
    size = float(to.scale[0])
    start = _umeyama(a, b)
    rows = _similarity_rows(a, b, sigma / size, *start)
    fitting.determined(rows(np.zeros(7), True)[1], sigma / size, *ON_A_LINE)
    minimum = fitting.adjust(rows, np.zeros(7), "absolute orientation")
    x = minimum.state
    rotation, scale, shift = rotated(start[0], x[:3]), float(np.exp(x[3]) * start[1]), np.asarray(start[2] + x[4:])
    rows = _similarity_rows(a, b, sigma / size, rotation, scale, shift)
    assessed = fitting.determined(rows(np.zeros(7), True)[1], sigma / size, *ON_A_LINE)
    physical = scale * size / float(from_.scale[0])
    offset = physical * rotation @ from_.offset
    # shift = centre on the ground - scale R (middle of the model), so the shift changes with
    # rotations and scale about this middle
    away = np.eye(7)
    away[4:, 4:] *= size
    away[4:, :3], away[4:, 3] = np.cross(np.eye(3), offset), -offset
    facts = fitting.statistics(minimum.residual, assessed, len(minimum.log), away)
    return Similarity(
        physical,
        rotation,
        to.offset + size * shift - offset,
        minimum.residual.reshape(-1, 3) * sigma,
        bend(rows, np.zeros(7), facts["m0"]),
        **facts,
    )


def _umeyama(a: Array, b: Array) -> tuple[Array, float, Array]:
    """Return the rotation (3, 3), scale and shift (3,) with b ~ shift + scale R a for points (n, 3) of equal weight."""
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    left, values, right = np.linalg.svd((b - mean_b).T @ (a - mean_a))
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    spread = float(np.sum((a - mean_a) ** 2))
    if values[0] <= 0.0:
        raise InputError.of("closerange.line", place="absolute orientation", value="one place")
    rotation, scale = left * flip @ right, float(values @ flip) / spread
    return rotation, scale, np.asarray(mean_b - scale * rotation @ mean_a)


def _similarity_rows(a: Array, b: Array, sigma: Array, rotation: Array, scale: float, shift: Array) -> fitting.Rows:
    whitening = (np.eye(3) / sigma[..., None, :]).reshape(*sigma.shape[:-1], 9)
    records = RECORD.pack(model=a, place=b, whitening=whitening, rotation=rotation.ravel(), scale=scale, shift=shift)
    return fitting.equation_rows(SIMILARITY, records, np.zeros((2, 0)))
