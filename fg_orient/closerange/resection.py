"""Resect a photo: compute rotation and projection centre from control points and a known camera."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from operator import attrgetter
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from factors.cameras.frame import FRAME_COLLINEARITY, RECORD, camera
from factors.cameras.frame_camera import CAMERA
from fg_orient.closerange import fitting
from fg_orient.closerange.dlt import direct_dlt, recover
from fg_orient.closerange.minima import SAME, Rival, bend, rival_of
from fg_orient.closerange.photo import Photo, PhotoInterior
from fg_orient.model.errors import FgOrientError, Finding, InputError, NoSolutionError, finding
from fg_orient.quality.mix_ups import BETTER
from fg_orient.rectification.transformation import Scaling

Pose = tuple[Array, Array]

LEAST: Final = 4
#: Number of image points, chosen far apart, whose triples give start values.
SPREAD: Final = 6
#: The iteration begins at this number of best start values.
TRIED: Final = 4
#: Minimum number of points that test another reading of the image coordinates.
LEAST_TESTED: Final = 6
#: Smaller median distances (tangents) are ignored.
TINY: Final = 1e-12
#: Code and place of the error for points that do not determine a photo.
REFUSED: Final = ("closerange.pose", "resection")


@dataclass(frozen=True)
class Resection(fitting.Fit):
    """Photo oriented by control points.

    Cofactors refer to rotations about the camera axes (rad) and to the centre (m).

    Parameters
    ----------
    photo : Photo
    rotation : (3, 3) array
        Camera axes X right, Y down, Z along the view, from ground axes.
    centre_m : (3,) array
    residuals : (n, 2) array
        Computed minus ideal image coordinates, in their unit.
    weighted_squares : float
        v'Pv for the given sigmas.
    bend : float
        Bend. Above 0.25 each standard deviation is correct, but the covariance as a whole
        is optimistic (:func:`fg_orient.closerange.minima.bend`): far cameras, whose
        rotations move the centre along an arc.
    rival : Rival or None
        Second pose: distant points of a plane fit two poses, mirrored in the line of sight.
    """

    photo: Photo
    rotation: Array
    centre_m: Array
    residuals: Array
    weighted_squares: float
    bend: float
    rival: Rival | None = None

    def second_pose(self, place: str = "") -> list[Finding]:
        """Return the warning of the rival, if there is one."""
        return [] if self.rival is None else [self.rival.warning("closerange.second_pose", "centre_m", place)]


def resect(
    interior: PhotoInterior,
    ground_m: npt.ArrayLike,
    image: npt.ArrayLike,
    *,
    sigma: npt.ArrayLike = 1.0,
    name: str = "",
) -> Resection:
    """Orient a photo of a known camera by control points.

    Parameters
    ----------
    interior : PhotoInterior
    ground_m : (n, 3) array
        Four control points or more (three have up to four solutions), m.
    image : (n, 2) array
        Measured x, y, in the unit of the focal length.
    sigma : float or array that fits (n, 2)
        Standard deviations of the image coordinates.
    name : str
        Name of the photo.

    Returns
    -------
    Resection

    Raises
    ------
    InputError
        There are too few points, or they do not determine the orientation (points on a
        line, or on a dangerous cylinder).
    NoSolutionError
        No start value, or the iteration does not converge.

    Notes
    -----
    Start values come from triples of points (Grunert 1841 in the form of Haralick et al. 1994), and from the DLT if
    there are six points or more.
    The adjustment uses ``factors.cameras.frame`` with observations corrected for the distortion. The result is
    the minimum with the smallest weighted squares. The mirrored pose of a plane (Schweighofer & Pinz 2006) is always
    tried, and reported if it fits as well.
    """
    ground = fitting.as_points(ground_m, 3, "ground")
    measured = fitting.as_points(image, 2, "image")
    size = fitting.as_sigmas(sigma, measured)
    if len(ground) != len(measured) or len(ground) < LEAST:
        raise InputError.of("closerange.few", place="resection", value=len(ground), least=LEAST)
    tangents = interior.tangents(measured)
    try:
        return _best(interior, ground, tangents, size / interior.focal, name)
    except NoSolutionError as error:
        raise NoSolutionError(*other_readings([(name, interior, ground, measured, ())]), *error.problems) from None


def _best(interior: PhotoInterior, ground: Array, tangents: Array, size: Array, name: str) -> Resection:
    """Return the minimum with the smallest weighted squares; ``size`` are the sigmas of the tangents."""
    poses = start_poses(ground, tangents)
    if not poses:
        _require_off_line(ground)
        raise NoSolutionError.of("closerange.no_start", place="resection", value=f"{len(ground)} points")
    minima, failures = list[Resection](), list[FgOrientError]()

    def descend(pose: Pose) -> None:
        try:
            minima.append(_adjusted(interior, ground, tangents, size, pose, name))
        except (NoSolutionError, InputError) as error:
            failures.append(error)

    for pose in poses[:TRIED]:
        descend(pose)
    if not minima:
        _require_off_line(ground)
        raise failures[0]
    first = min(minima, key=attrgetter("weighted_squares"))
    descend(_mirrored((first.rotation, first.centre_m), ground))
    first, *others = sorted(minima, key=attrgetter("weighted_squares"))
    distance = float(np.linalg.norm(ground - first.centre_m, axis=1).mean())
    for one in others:
        moved = np.linalg.norm(one.centre_m - first.centre_m) > SAME * distance
        if moved or np.abs(one.rotation - first.rotation).max() > SAME:
            own, squares = first.weighted_squares, one.weighted_squares
            return replace(first, rival=rival_of(own, squares, first.redundancy, one.rotation, one.centre_m))
    return first


def _require_off_line(ground: Array) -> None:
    """If there is no pose, refuse points that are so close to a line that the rotation about it is undetermined."""
    along, across = np.linalg.svd(ground - ground.mean(axis=0), compute_uv=False)[:2] / np.sqrt(len(ground))
    if across * fitting.UNDETERMINED <= along or along == 0.0:
        raise InputError.of("closerange.line", place="resection", value=f"{across:.2g} m rms across, {along:.2g} along")


def _mirrored(pose: Pose, ground: Array) -> Pose:
    """Return the mirrored pose of a plane of points, which has nearly the same image.

    The points are reflected in their own plane, which does not move them. Then they are reflected
    across the line of sight to their middle. Both reflections together are a rotation.
    """
    rotation, centre = pose
    middle = ground.mean(axis=0)
    seen = rotation @ (middle - centre)
    along, normal = seen / np.linalg.norm(seen), np.linalg.svd(ground - middle)[2][2]
    turned = (np.eye(3) - 2.0 * np.outer(along, along)) @ rotation @ (np.eye(3) - 2.0 * np.outer(normal, normal))
    return np.asarray(turned), np.asarray(middle - turned.T @ seen)


def _adjusted(
    interior: PhotoInterior, ground: Array, tangents: Array, sigma: Array, start: Pose, name: str
) -> Resection:
    """Adjust from a start.

    Unknowns are rotations (rad) and the centre in units of the object's distance.
    """
    rotation, centre = start
    distance = float(np.linalg.norm(ground - centre, axis=1).mean())
    # line and sample are tangents here: focal length 1, line down
    records = RECORD.pack(
        line=tangents[:, 1],
        sample=tangents[:, 0],
        a_line=1.0 / sigma[:, 1],
        a_sample=1.0 / sigma[:, 0],
        rotation=rotation.ravel(),
        centre=np.zeros(3),
        focal=1.0,
        principal=np.zeros(2),
        distortion=np.zeros(5),
        aspect=0.0,
        unit=0.0,
    )
    setup = np.stack([np.arange(6.0), np.array([1.0, 1.0, 1.0, distance, distance, distance])])
    rows = fitting.equation_rows(FRAME_COLLINEARITY, records, setup, (ground - centre,))
    try:
        minimum = fitting.adjust(rows, np.zeros(6), "resection")
    except NoSolutionError:
        fitting.determined(rows(np.zeros(6), True)[1], sigma, *REFUSED)
        raise
    turned = camera(records[0], setup, minimum.state)
    rotation = turned[CAMERA.rotation].reshape(3, 3)
    depth = (ground - centre - turned[CAMERA.centre]) @ rotation[2]
    if not (depth > 0.0).all():
        raise NoSolutionError.of("closerange.behind", place=f"point {int(np.argmin(depth)) + 1}")
    assessed = fitting.determined(minimum.design, sigma, *REFUSED)
    # the unknowns are rotations about the start's axes; J transforms them to the axes of the adjusted camera
    away = np.diag(setup[1])
    away[:3, :3] = turned[CAMERA.jacobian].reshape(3, 3)
    moved = centre + turned[CAMERA.centre]
    photo = Photo.of(name, interior, rotation, moved)
    residuals = minimum.residual.reshape(-1, 2)[:, ::-1] * sigma * interior.focal * [1.0, interior.sign]
    facts = fitting.statistics(minimum.residual, assessed, len(minimum.log), away)
    facts["redundancy_numbers"] = facts["redundancy_numbers"].reshape(-1, 2)[:, ::-1].ravel()
    return Resection(
        photo, rotation, moved, residuals, minimum.squares, bend(rows, minimum.state, facts["m0"]), **facts
    )


def start_poses(ground: Array, tangents: Array) -> list[Pose]:
    """Return start poses from ground points (n, 3) and tangents (n, 2), ordered by median residual of all tangents."""
    poses = list[Pose]()
    for three in map(list, combinations(_spread(tangents), 3)):
        poses += three_point_poses(ground[three], tangents[three])
    if len(ground) >= 6:
        poses += _pose_by_dlt(ground, tangents)
    misfits = []
    for rotation, centre in poses:
        q = (ground - centre) @ rotation.T
        ahead = bool((q[:, 2] > 0.0).all())
        misfits.append(float(np.median(np.linalg.norm(q[:, :2] / q[:, 2:] - tangents, axis=1))) if ahead else np.inf)
    order = np.argsort(misfits, kind="stable")
    return [poses[k] for k in order if np.isfinite(misfits[k])]


def other_readings(photos: Iterable[tuple[str, PhotoInterior, Array, Array, Sequence[str]]]) -> list[Finding]:
    """Return findings on photos whose points fit far better with other image coordinates.

    The other direction of y differs from exchanged columns x and y by a rotation of the photo, so both are named.
    Otherwise the findings name points that fit only after an exchange of their own x and y.

    Parameters
    ----------
    photos : iterable of tuple
        Name, interior, known points (n, 3), their image points (n, 2), and the ids of the points; without ids they are
        counted. Photos with fewer than six points are skipped: one pose fits three points exactly.
    """
    mirrored, times, out = list[str](), list[float](), list[Finding]()
    for name, interior, ground, image, ids in photos:
        if len(ground) < LEAST_TESTED:
            continue
        given = _misfit(interior, ground, image)
        if given is None:
            continue
        pose, away = given
        other = _misfit(replace(interior, y_axis="up" if interior.y_axis == "down" else "down"), ground, image)
        middle, best = _middle(away), np.inf if other is None else _middle(other[1])
        if BETTER * best < middle:
            mirrored.append(name)
            times.append(middle / best)
            continue
        swapped = _apart(pose, ground, interior.tangents(np.ascontiguousarray(image[:, ::-1])))
        wrong = (away > BETTER * middle) & (BETTER * swapped < away)
        points = [ids[k] if ids else str(k + 1) for k in np.flatnonzero(wrong).tolist()]
        if points:
            out.append(finding("closerange.exchanged_point", place=f"photo {name}" if name else "", points=points))
    if mirrored:
        named = [name for name in mirrored if name]
        out.insert(0, finding("closerange.other_reading", photos=named, times=min(times)))
    return out


def doubted_readings(photos: Iterable[tuple[str, PhotoInterior, Array, Array, Sequence[str]]]) -> list[Finding]:
    """Return the findings of :func:`other_readings` as doubts on a result: an iteration can also converge with them."""
    return [replace(one, severity="doubt") for one in other_readings(photos)]


def _misfit(interior: PhotoInterior, ground: Array, image: Array) -> tuple[Pose, Array] | None:
    """Return the best start pose and the residuals (n,) of all tangents; None without a pose."""
    try:
        tangents = interior.tangents(image)
    except FgOrientError:
        return None
    poses = start_poses(ground, tangents)
    return (poses[0], _apart(poses[0], ground, tangents)) if poses else None


def _middle(away: Array) -> float:
    """Return the median distance, or the fifth smallest of few points: a pose fits three points exactly."""
    return max(float(np.sort(away)[max(len(away) // 2, 4)]), TINY)


def _apart(pose: Pose, ground: Array, tangents: Array) -> Array:
    """Return the distances (n,) between projected points and tangents."""
    rotation, centre = pose
    q = (ground - centre) @ rotation.T
    return np.asarray(np.linalg.norm(q[:, :2] / q[:, 2:] - tangents, axis=1))


def _spread(points: Array) -> list[int]:
    """Return some points far apart: each is the farthest from the points before it."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    while len(chosen) < min(SPREAD, len(points)):
        apart = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(apart)))
    return chosen


def _pose_by_dlt(ground: Array, tangents: Array) -> list[Pose]:
    """Return the pose of the linear DLT; an empty list if the points are coplanar."""
    source, target = Scaling.of(ground, shared=True), Scaling.of(tangents, shared=True)
    p = np.append(direct_dlt(source.normalised(ground), target.normalised(tangents)), 1.0).reshape(3, 4)
    p[:, :3] /= source.scale
    p[:2] = target.scale[:, None] * p[:2] + target.offset[:, None] * p[2]
    try:
        pose = recover(p.ravel()[:11], source.offset)
    except (FgOrientError, np.linalg.LinAlgError):
        return []
    return [(pose.rotation, pose.centre_m)] if np.isfinite(pose.rotation).all() else []


def three_point_poses(ground: Array, tangents: Array) -> list[Pose]:
    """Return up to four poses of a camera from three points in front of it; none for points on a line.

    Grunert 1841; coefficients of the quartic as in Haralick et al. 1994, eqs. 9-16.

    Parameters
    ----------
    ground : (3, 3) array
        Points in its rows.
    tangents : (3, 2) array
        X/Z, Y/Z in camera axes.
    """
    rays = np.column_stack([tangents, np.ones(3)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    a, b, c = (float(np.sum((ground[i] - ground[j]) ** 2)) for i, j in ((1, 2), (0, 2), (0, 1)))
    if min(a, b, c) == 0.0:
        return []
    cos_a, cos_b, cos_c = (float(rays[i] @ rays[j]) for i, j in ((1, 2), (0, 2), (0, 1)))
    p, q, r, s = (a - c) / b, (a + c) / b, (b - c) / b, (b - a) / b
    coefficients = [
        (p - 1.0) ** 2 - 4.0 * c / b * cos_a**2,
        4.0 * (p * (1.0 - p) * cos_b - (1.0 - q) * cos_a * cos_c + 2.0 * c / b * cos_a**2 * cos_b),
        2.0
        * (
            p**2
            - 1.0
            + 2.0 * p**2 * cos_b**2
            + 2.0 * r * cos_a**2
            - 4.0 * q * cos_a * cos_b * cos_c
            + 2.0 * s * cos_c**2
        ),
        4.0 * (-p * (1.0 + p) * cos_b + 2.0 * a / b * cos_c**2 * cos_b - (1.0 - q) * cos_a * cos_c),
        (1.0 + p) ** 2 - 4.0 * a / b * cos_c**2,
    ]
    poses = []
    # noise can make a double root complex: its real part is a start value
    for v in sorted({float(root.real) for root in np.roots(coefficients) if abs(root.imag) < 0.1 * abs(root)}):
        below, first = 2.0 * (cos_c - v * cos_a), 1.0 + v * v - 2.0 * v * cos_b
        u = ((p - 1.0) * v * v - 2.0 * p * cos_b * v + 1.0 + p) / below if below != 0.0 else -1.0
        if v > 0.0 and u > 0.0 and first > 0.0:
            poses.append(_pose(ground, rays * (np.sqrt(b / first) * np.array([[1.0], [u], [v]]))))
    return [pose for pose in poses if pose is not None]


def _pose(ground: Array, seen: Array) -> Pose | None:
    """Return rotation and centre that transform three ground points to the same points in camera axes."""
    frames = []
    for points in (ground, seen):
        along = points[1] - points[0]
        normal = np.cross(along, points[2] - points[0])
        length = np.linalg.norm(normal)
        if not length > 1e-12 * np.sum(along**2):
            return None
        x, z = along / np.linalg.norm(along), normal / length
        frames.append(np.stack([x, np.cross(z, x), z]))
    rotation = np.asarray(frames[1].T @ frames[0])
    return rotation, np.asarray(ground.mean(axis=0) - rotation.T @ seen.mean(axis=0))
