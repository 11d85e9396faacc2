"""Images and ground points of a growing block that are not yet determined, with the reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from factors.arrays import Array, Index, Mask
from fg_orient.model.block import Block, Coordinates, GroundPoints, ImagePoints, WithheldCoordinates
from fg_orient.model.errors import Finding, finding
from fg_orient.model.names import Role
from fg_orient.sensors import initial

#: Relative eigenvalue of a scaled normal matrix below which a direction is undetermined.
UNDETERMINED: Final = 1e-11
#: An unknown is undetermined if its component in such directions, of unit length, exceeds this; smaller
#: components are rounding errors.
COMPONENT: Final = 1e-4

ONE_RAY: Final = (
    "incremental.one_ray (note): waits: it is seen in image {image} only, and a ground point without control needs"
    " two rays"
)
OTHERS_WAIT: Final = (
    "incremental.others_wait (note): waits: other images that see it are not determined yet: {images:3}"
)
PARALLEL: Final = "incremental.parallel (note): waits: its rays are parallel within {least} degrees"
BEHIND: Final = (
    "incremental.behind (note): waits: its rays meet behind a sensor -> check the point's identity in every image"
)
NO_POINTS: Final = "incremental.no_points (note): waits: it has no image point of a determined ground point"
FEW_POINTS: Final = (
    "incremental.few_points (note): waits: {n} image point(s) of determined ground points do not determine its"
    " {unknowns} unknowns, which have no priors"
)


def excluded_points(block: Block) -> Mask:
    """Return the check points (N,) that do not participate in the adjustment."""
    out = np.zeros(len(block.points.ids), bool)
    if block.options.check_points != "use":
        out[block.points.where(Role.CHECK)] = True
    return out


def control_points(block: Block) -> Mask:
    """Return the control points (N,)."""
    out = np.zeros(len(block.points.ids), bool)
    out[block.points.where(Role.CONTROL)] = True
    return out


def local_block(block: Block, rows: Index) -> tuple[Block, Index, Index]:
    """Make a small block of some image points, in which check points are tie points.

    The result also contains the numbers of its images and ground points. Nothing fixes its datum.
    """
    o, known = block.observations.take(rows), block.points.known
    images, image = np.unique(o.image, return_inverse=True)
    points, point = np.unique(o.point, return_inverse=True)
    roles = (block.points.roles[j] for j in points.tolist())
    ground = GroundPoints(
        tuple(block.points.ids[j] for j in points.tolist()),
        tuple(Role.TIE if role is Role.CHECK else role for role in roles),
        Coordinates(known.ecef_m[points], known.sigma_enu_m[points], known.fixed[points]),
    )
    small = replace(
        block,
        images=tuple(block.images[k] for k in images.tolist()),
        points=ground,
        observations=ImagePoints(image, point, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px),
        withheld=WithheldCoordinates((), lambda: known),
        options=replace(block.options, datum="free"),
    )
    return small, images, points


def judged_points(block: Block, rows: Index, usable: Mask) -> tuple[Index, Mask, dict[str, Finding]]:
    """Return the ground points of image points, whether they are determined, and findings about undetermined points.

    Parameters
    ----------
    block : Block
    rows : (n,) int array
        All image points of these ground points.
    usable : (M,) bool array
        Images that are determined.
    """
    if not len(rows):
        return np.zeros(0, np.intp), np.zeros(0, bool), {}
    small, images, points = local_block(block, rows)
    o = small.observations
    used = o.take(usable[images][o.image])
    control = control_points(small)
    spread, behind = np.zeros(len(points)), np.zeros(len(points), bool)
    if len(used):
        centre, direction = initial.all_rays(small.images, used)
        place, spread = initial.nearest_points(centre, direction, used.point, len(points))
        behind[used.point[np.einsum("ni,ni->n", place[used.point] - centre, direction) <= 0.0]] = True
    count = np.bincount(used.point, minlength=len(points))
    good = np.where(control, count > 0, (spread > initial.MIN_CONVERGENCE_DEG) & ~behind)
    findings = {}
    for j in np.flatnonzero(~good).tolist():
        name, own = f"point {small.points.ids[j]}", o.image[o.point == j]
        seen = [small.images[k].id for k in np.unique(own).tolist()]
        waiting = [small.images[k].id for k in np.unique(own).tolist() if not usable[images[k]]]
        if waiting:
            findings[name] = finding(OTHERS_WAIT, place=name, images=waiting)
        elif len(seen) == 1:
            findings[name] = finding(ONE_RAY, place=name, image=seen[0])
        elif behind[j]:
            findings[name] = finding(BEHIND, place=name)
        else:
            findings[name] = finding(PARALLEL, place=name, least=initial.MIN_CONVERGENCE_DEG)
    return points, good, findings


def image_waits(block: Block, k: int, n_unknowns: int, n_rays: int) -> Finding:
    """Return the finding about an image that is not determined."""
    name = f"image {block.images[k].id}"
    if not n_rays:
        return finding(NO_POINTS, place=name)
    return finding(FEW_POINTS, place=name, n=n_rays, unknowns=n_unknowns)


def undetermined(normal: Array) -> Mask:
    """Return the unknowns (n,) with a component in the null space of a normal matrix (n, n)."""
    scale = np.sqrt(np.where(np.diag(normal) > 0.0, np.diag(normal), 1.0))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    null = vectors[:, values <= UNDETERMINED * max(float(values[-1]), 1.0)]
    return np.asarray(np.linalg.norm(null, axis=1) > COMPONENT)


def determined_images(block: Block, candidates: Mask, known: Mask, find: Callable[[Index, Mask], Mask]) -> Mask:
    """Return the images (M,) whose unknowns are determined without priors; they include ``known``.

    The images ``known`` are determined without the candidates. An additional unknown is then undetermined if, and only
    if, it has a component in the null space of the normal matrix of the additional unknowns. Images with such unknowns
    are removed, with their rays, until no such image is left.

    Parameters
    ----------
    block : Block
    candidates, known : (M,) bool arrays
    find : callable
        Function that returns the images (M,) with undetermined unknowns, from image points and the additional images
        (M,).
    """
    o, excluded, left = block.observations, excluded_points(block), candidates & ~known
    while left.any():
        usable = known | left
        seen = np.zeros(len(block.points.ids), bool)
        seen[o.point[left[o.image]]] = True
        rows = np.flatnonzero((seen & ~excluded)[o.point])
        points, good, _ = judged_points(block, rows, usable)
        inside = np.zeros(len(seen), bool)
        inside[points[good]] = True
        rows = np.flatnonzero(inside[o.point] & usable[o.image])
        with_rays = np.zeros(len(left), bool)
        with_rays[o.image[rows]] = True
        lost = left & ~with_rays
        if not lost.any():
            lost = find(rows, left) & left
        if not lost.any():
            break
        left = left & ~lost
    return known | left
