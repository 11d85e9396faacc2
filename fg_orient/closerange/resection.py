"""Resection of one photo: rotation and projection centre from control points and a known camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from operator import attrgetter
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.cameras.frame import FRAME_BROWN_IDEAL_TO_MEASURED, RECORD, camera
from factors.cameras.frame_camera import CAMERA
from fg_orient.closerange.curvature import bend
from fg_orient.closerange.dlt import direct_dlt, recover
from fg_orient.closerange.fitting import (
    UNDETERMINED,
    Deviations,
    adjust,
    as_points,
    determination,
    equation_rows,
    require_sigmas,
    unit_weight,
)
from fg_orient.closerange.photo import Interior, Photo
from fg_orient.closerange.rivals import SAME, likeness, ratio_limit
from fg_orient.model.errors import FgOrientError, Finding, InputError, NoSolutionError, finding
from fg_orient.rectification.transformation import Scaling

Array = npt.NDArray[np.float64]
Pose = tuple[Array, Array]

LEAST: Final = 4
#: Points far apart in the image whose triples start the iteration.
SPREAD: Final = 6
#: Starts that are iterated, the best ones of all.
TRIED: Final = 4


@dataclass(frozen=True)
class Rival:
    """A second pose that the points do not tell from the first.

    Parameters
    ----------
    rotation : (3, 3) array
    centre_m : (3,) array
    ratio : float
        Its weighted squares by those of the first.
    limit : float
        Ratio from which an F test at ``rivals.LEVEL`` tells them apart.
    """

    rotation: Array
    centre_m: Array
    ratio: float
    limit: float

    def finding(self, place: str = "") -> Finding:
        """What a user should know of it."""
        centre = self.centre_m.tolist()
        return finding("closerange.second_pose", place=place, centre_m=centre, ratio=self.ratio, limit=self.limit)


@dataclass(frozen=True)
class Resection(Deviations):
    """An oriented photo.

    Parameters
    ----------
    photo : Photo
    rotation : (3, 3) array
        Camera axes X right, Y down, Z along the view, from ground axes.
    centre_m : (3,) array
    cofactors : (6, 6) array
        Of turns about the camera axes (rad) and the centre (m); times m0 squared their covariance.
    residuals : (n, 2) array
        Computed minus ideal image coordinates, in their unit.
    weighted_squares : float
        v'Pv for the sigmas given.
    m0 : float or None
    redundancy : int
        Two or more: four points have eight coordinates.
    condition : float
    iterations : int
    bend : float
        Above 0.25 the covariance as a whole is optimistic (:func:`fg_orient.closerange.curvature.bend`), standard
        deviations one by one are not: far cameras, whose turns move the centre along an arc.
    rival : Rival or None
        Points of a plane seen from far away fit two poses, mirrored in the line of sight.
    """

    photo: Photo
    rotation: Array
    centre_m: Array
    cofactors: Array
    residuals: Array
    weighted_squares: float
    m0: float | None
    redundancy: int
    condition: float
    iterations: int
    bend: float
    rival: Rival | None = None


def resect(
    interior: Interior, ground_m: npt.ArrayLike, image: npt.ArrayLike, *, sigma: npt.ArrayLike = 1.0, name: str = ""
) -> Resection:
    """Orient a photo of a known camera by control points.

    Parameters
    ----------
    interior : Interior
    ground_m : (n, 3) array
        Four control points or more (three have up to four solutions), m.
    image : (n, 2) array
        Measured x, y, in the unit of the focal length.
    sigma : float or array that fits (n, 2)
        Of the image coordinates.
    name : str
        Of the photo.

    Returns
    -------
    Resection

    Raises
    ------
    InputError
        Too few points, or points that leave the orientation open (on a line, on a dangerous cylinder).
    NoSolutionError
        No start value, or the iteration does not converge.

    Notes
    -----
    Start: three points at a time (Grunert 1841 in the form of Haralick et al. 1994), and DLT from six points on. The
    adjustment is that of ``factors.cameras.frame`` with the distortion taken off the observations. Of all minima found
    the one with the smallest weighted squares is the answer; the mirrored pose of a plane (Schweighofer & Pinz 2006) is
    always tried, and told if it fits as well.
    """
    ground = as_points(ground_m, 3, "ground", InputError.of)
    measured = as_points(image, 2, "image", InputError.of)
    size = np.broadcast_to(np.asarray(sigma, float), measured.shape)
    if len(ground) != len(measured) or len(ground) < LEAST:
        raise InputError.of("closerange.few", place="resection", value=len(ground), least=LEAST)
    require_sigmas(size)
    tangents = interior.tangents(measured)
    poses = start_poses(ground, tangents)
    if not poses:
        _require_off_line(ground)
        raise NoSolutionError.of("closerange.no_start", place="resection", value=f"{len(ground)} points")
    found, failures = list[Resection](), list[FgOrientError]()

    def descend(pose: Pose) -> None:
        try:
            found.append(_adjusted(interior, ground, tangents, size / interior.focal, pose, name))
        except (NoSolutionError, InputError) as error:
            failures.append(error)

    for pose in poses[:TRIED]:
        descend(pose)
    if not found:
        _require_off_line(ground)
        raise failures[0]
    first = min(found, key=attrgetter("weighted_squares"))
    descend(_mirrored((first.rotation, first.centre_m), ground))
    return _with_rival(found, ground)


def _require_off_line(ground: Array) -> None:
    """Where no pose was found: points as close to a line as a turn about it needs to be ``UNDETERMINED`` are why."""
    along, across = np.linalg.svd(ground - ground.mean(axis=0), compute_uv=False)[:2] / np.sqrt(len(ground))
    if across * UNDETERMINED <= along or along == 0.0:
        raise InputError.of("closerange.line", place="resection", value=f"{across:.2g} m rms across, {along:.2g} along")


def _with_rival(found: list[Resection], ground: Array) -> Resection:
    """The minimum of all, with the next one if an F test of equal redundancies does not tell the two apart."""
    first, *others = sorted(found, key=attrgetter("weighted_squares"))
    distance = float(np.linalg.norm(ground - first.centre_m, axis=1).mean())
    apart = [
        one for one in others
        if np.linalg.norm(one.centre_m - first.centre_m) > SAME * distance
        or np.abs(one.rotation - first.rotation).max() > SAME
    ]  # fmt: skip
    if not apart:
        return first
    ratio = likeness(first.weighted_squares, apart[0].weighted_squares, first.redundancy)
    if ratio is None:
        return first
    limit = ratio_limit(first.redundancy)
    return replace(first, rival=Rival(apart[0].rotation, apart[0].centre_m, ratio, limit))


def _mirrored(pose: Pose, ground: Array) -> Pose:
    """Pose from which points of a plane look nearly the same: their plane mirrored across the line of sight.

    A reflection across the line of sight to the middle of the points, after one in their plane, which points of the
    plane do not feel, is a rotation.
    """
    rotation, centre = pose
    middle = ground.mean(axis=0)
    seen = rotation @ (middle - centre)
    along, normal = seen / np.linalg.norm(seen), np.linalg.svd(ground - middle)[2][2]
    turned = (np.eye(3) - 2.0 * np.outer(along, along)) @ rotation @ (np.eye(3) - 2.0 * np.outer(normal, normal))
    return np.asarray(turned), np.asarray(middle - turned.T @ seen)


def _adjusted(interior: Interior, ground: Array, tangents: Array, sigma: Array, start: Pose, name: str) -> Resection:
    """Adjust from a start; unknowns are turns (rad) and the centre in units of the object's distance."""
    rotation, centre = start
    distance = float(np.linalg.norm(ground - centre, axis=1).mean())
    # line and sample are tangents here: focal length 1, line down
    records = RECORD.pack(
        line=tangents[:, 1], sample=tangents[:, 0], a_line=1.0 / sigma[:, 1], a_sample=1.0 / sigma[:, 0],
        rotation=rotation.ravel(), centre=np.zeros(3), focal=1.0, principal=np.zeros(2), distortion=np.zeros(5),
    )  # fmt: skip
    setup = np.stack([np.arange(6.0), np.array([1.0, 1.0, 1.0, distance, distance, distance])])
    rows = equation_rows(FRAME_BROWN_IDEAL_TO_MEASURED, records, setup, (ground - centre,))
    try:
        found = adjust(rows, np.zeros(6), "resection")
    except NoSolutionError:
        _require_determined(rows(np.zeros(6), True)[1], sigma)
        raise
    turned = camera(records[0], setup, found.state)
    rotation = turned[CAMERA.rotation].reshape(3, 3)
    depth = (ground - centre - turned[CAMERA.centre]) @ rotation[2]
    if not (depth > 0.0).all():
        raise NoSolutionError.of("closerange.behind", place=f"point {int(np.argmin(depth)) + 1}")
    condition, cofactors = _require_determined(found.design, sigma)
    # the unknowns turn about fixed axes at the start; J leads to turns of the adjusted camera
    away = np.diag(setup[1])
    away[:3, :3] = turned[CAMERA.jacobian].reshape(3, 3)
    moved = centre + turned[CAMERA.centre]
    photo = Photo.of(name, interior, rotation, moved)
    residuals = -found.residual.reshape(-1, 2)[:, ::-1] * sigma * interior.focal * [1.0, interior.sign]
    squares, redundancy = float(found.residual @ found.residual), len(found.residual) - 6
    m0 = unit_weight(squares, redundancy)
    return Resection(
        photo, rotation, moved, away @ cofactors @ away.T, residuals, squares, m0, redundancy, condition,
        len(found.log), bend(rows, found.state, m0),
    )  # fmt: skip


def _require_determined(design: Array, sigma: Array) -> tuple[float, Array]:
    """Condition and cofactors; a point's own sigma is that of its image at the object's distance, the unit here."""
    judged = determination(design)
    worst = np.inf if judged.cofactors is None else float(np.sqrt(np.diag(judged.cofactors).max()))
    if judged.cofactors is None or worst > UNDETERMINED * float(np.sqrt(np.mean(sigma**2))):
        raise InputError.of("closerange.pose", place="resection", value=f"condition {judged.condition:.2g}")
    return judged.condition, judged.cofactors


def start_poses(ground: Array, tangents: Array) -> list[Pose]:
    """Rotations and centres worth trying, the one with the smallest misfit at all points first.

    Parameters
    ----------
    ground : (n, 3) array
    tangents : (n, 2) array
        X/Z, Y/Z in camera axes.
    """
    chosen = _spread(tangents)
    poses = list[Pose]()
    for three in combinations(chosen, 3):
        poses += three_point_poses(ground[list(three)], tangents[list(three)])
    if len(ground) >= 6:
        poses += _pose_by_dlt(ground, tangents)
    misfits = [_misfit(pose, ground, tangents) for pose in poses]
    order = np.argsort(misfits, kind="stable")
    return [poses[k] for k in order if np.isfinite(misfits[k])]


def _spread(points: Array) -> list[int]:
    """Some points far from each other: each is the farthest from those before it."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    while len(chosen) < min(SPREAD, len(points)):
        apart = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(apart)))
    return chosen


def _misfit(pose: Pose, ground: Array, tangents: Array) -> float:
    """Median distance of computed and given tangents; inf if any point lies behind the camera."""
    q = (ground - pose[1]) @ pose[0].T
    if not (q[:, 2] > 0.0).all():
        return np.inf
    return float(np.median(np.linalg.norm(q[:, :2] / q[:, 2:] - tangents, axis=1)))


def _pose_by_dlt(ground: Array, tangents: Array) -> list[Pose]:
    """Pose of the linear DLT; none if the points lie in a plane."""
    source, target = Scaling.of(ground, shared=True), Scaling.of(tangents, shared=True)
    p = np.append(direct_dlt(source.normalised(ground), target.normalised(tangents)), 1.0).reshape(3, 4)
    p[:, :3] /= source.scale
    p[:2] = target.scale[:, None] * p[:2] + target.offset[:, None] * p[2]
    try:
        found = recover(p.ravel()[:11], source.offset)
    except (FgOrientError, np.linalg.LinAlgError):
        return []
    return [(found.rotation, found.centre_m)] if np.isfinite(found.rotation).all() else []


def three_point_poses(ground: Array, tangents: Array) -> list[Pose]:
    """Up to four poses of a camera that sees three points.

    Parameters
    ----------
    ground : (3, 3) array
        Points in its rows.
    tangents : (3, 2) array
        X/Z, Y/Z in camera axes.

    Returns
    -------
    list of (rotation (3, 3), centre (3,))
        Points in front of the camera; empty for points on a line.

    Notes
    -----
    Grunert 1841; coefficients of the quartic as in Haralick et al. 1994, eqs. 9-16.
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
        2.0 * (p**2 - 1.0 + 2.0 * p**2 * cos_b**2 + 2.0 * r * cos_a**2 - 4.0 * q * cos_a * cos_b * cos_c
               + 2.0 * s * cos_c**2),
        4.0 * (-p * (1.0 + p) * cos_b + 2.0 * a / b * cos_c**2 * cos_b - (1.0 - q) * cos_a * cos_c),
        (1.0 + p) ** 2 - 4.0 * a / b * cos_c**2,
    ]  # fmt: skip
    poses = []
    # noise makes a double root complex: its real part is a start value
    for v in sorted({float(root.real) for root in np.roots(coefficients) if abs(root.imag) < 0.1 * abs(root)}):
        below, first = 2.0 * (cos_c - v * cos_a), 1.0 + v * v - 2.0 * v * cos_b
        u = ((p - 1.0) * v * v - 2.0 * p * cos_b * v + 1.0 + p) / below if below != 0.0 else -1.0
        if v > 0.0 and u > 0.0 and first > 0.0:
            poses.append(_pose(ground, rays * (np.sqrt(b / first) * np.array([[1.0], [u], [v]]))))
    return [pose for pose in poses if pose is not None]


def _pose(ground: Array, seen: Array) -> Pose | None:
    """Rotation and centre that lead three ground points to the same points in camera axes."""
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
