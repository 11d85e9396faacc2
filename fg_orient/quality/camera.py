"""Test whether the observations separate the camera parameters from other unknowns, by their correlations.

A shift of the principal point together with a rotation has nearly the same effect as decentring distortion.
On parallel photos of a flat object, a change of the principal distance together with the distance from the
object has nearly no effect. The sums of these effects are determined, but not the single values. The
standard deviation of each is ``1 / sqrt(1 - rho^2)`` times as large as with the other parameters held
fixed. Two correlations are computed for each camera. The first is the multiple correlation rho of x0 or
y0 with p1 and p2 together. The second is the correlation of c with the projection centre along the
view, as the median over the photos.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from factors.arrays import Array
from factors.cameras.frame_camera import CAMERA
from fg_orient.adjustment.problem import Problem, State
from fg_orient.model.errors import Finding, finding
from fg_orient.quality.cofactors import Cofactors
from fg_orient.sensors.frame import FrameSensor
from fg_orient.sensors.frame_unknowns import INTERIOR

#: Parameters with a correlation above this are called inseparable: their standard deviations are 3.2 times as large.
INSEPARABLE: Final = 0.95
#: Names of the principal distance in close range and in frame images.
DISTANCE: Final[tuple[str, ...]] = ("c", "focal")
PRINCIPAL: Final[tuple[str, ...]] = ("x0", "y0", "principal_sample", "principal_line")
DECENTRING: Final[tuple[str, ...]] = ("p1", "p2")


@dataclass(frozen=True, eq=False)
class ImageCofactors:
    """Cofactors of the unknowns of an image.

    Parameters
    ----------
    camera : str
        Images of one camera have the same camera parameters.
    names : tuple of str
    cofactors : (k, k) array
    along : (k,) array
        Coefficients of the component of the projection centre along the view; 0 for fixed coordinates.
    """

    camera: str
    names: tuple[str, ...]
    cofactors: Array
    along: Array


def multiple_correlation(cofactors: Array) -> float:
    """Return the multiple correlation of the first of k unknowns with all others together, 0 to 1; 0 if it is fixed."""
    root = np.sqrt(np.diag(cofactors))
    if not root.all():
        return 0.0
    rho = cofactors / np.outer(root, root)
    explained = float(rho[0, 1:] @ np.linalg.lstsq(rho[1:, 1:], rho[1:, 0], rcond=None)[0])
    return float(np.sqrt(np.clip(explained, 0.0, 1.0)))


def inseparable(images: Iterable[ImageCofactors], limit: float = INSEPARABLE) -> list[Finding]:
    """Return the warnings on correlated camera parameters.

    Parameters
    ----------
    images : iterable of ImageCofactors
    limit : float
        A warning is given for this correlation or a larger one.
    """
    cameras: dict[str, list[ImageCofactors]] = {}
    for one in images:
        cameras.setdefault(one.camera, []).append(one)
    principal, distance = [], []
    for camera, own in cameras.items():
        names, q = own[0].names, own[0].cofactors
        bent = [names.index(name) for name in DECENTRING if name in names]
        for name in (name for name in PRINCIPAL if bent and name in names):
            rows = [names.index(name), *bent]
            rho = multiple_correlation(q[np.ix_(rows, rows)])
            principal += [f"{name} of {camera} ({rho:.3f})"] if rho >= limit else []
        for name in (name for name in DISTANCE if name in names):
            rho = float(np.median([_with_distance(one, name) for one in own if one.along.any()] or [0.0]))
            distance += [f"{name} of {camera} ({rho:.3f})"] if rho >= limit else []
    out = []
    if principal:
        out.append(finding(
            "camera.decentring (warning): the principal point is hardly separated from p1 and p2, with which it is "
            "correlated: {which:6}; only their joint effect is determined\n"
            "    -> use the parameters together only; hold p1 and p2 if they are not significant together, or measure "
            "points that fill the images, from photos rolled by 90 degrees about the view",
            which=principal,
        ))  # fmt: skip
    if distance:
        out.append(finding(
            "camera.distance (warning): the principal distance is hardly separated from the distance of the photos, "
            "with which it is correlated: {which:6}\n"
            "    -> add convergent photos, points and control at several depths, or hold the principal distance",
            which=distance,
        ))  # fmt: skip
    return out


def _with_distance(image: ImageCofactors, name: str) -> float:
    """Return the correlation of the principal distance with the projection centre along the view."""
    rows = np.vstack([np.eye(len(image.names))[image.names.index(name)], image.along])
    return multiple_correlation(rows @ image.cofactors @ rows.T)


def frame_cofactors(problem: Problem, state: State, cofactors: Cofactors) -> list[ImageCofactors]:
    """Return the cofactors of the frame images that have unknown camera parameters.

    Parameters
    ----------
    problem : Problem
    state : State
    cofactors : Cofactors
    """
    out = []
    for k, (image, parameters) in enumerate(zip(problem.block.images, problem.parameters, strict=True)):
        names = parameters.names
        inner = [name for name in names if name in INTERIOR]
        if not isinstance(image.sensor, FrameSensor) or not inner:
            continue
        camera = image.sensor.camera
        ids = {camera.shared.get(name, "") for name in inner}
        common = ids.pop() if len(ids) == 1 else ""
        key = f"camera {common.removeprefix('camera ')}" if common else f"image {image.id}"
        correction = problem.models[k].correction(problem.unknowns(state, k))
        view = camera.corrected(correction)[CAMERA.rotation].reshape(3, 3)[2]
        of = dict(zip(("centre_x", "centre_y", "centre_z"), view.tolist(), strict=True))
        along = np.array([of.get(name, 0.0) for name in names])
        scale = np.outer(parameters.sigma, parameters.sigma)
        out.append(ImageCofactors(key, names, cofactors.image(k) * scale, along))
    return out
