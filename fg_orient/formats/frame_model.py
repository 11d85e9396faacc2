"""Frame images with cameras, poses, points and image points, as bundle-adjustment programs exchange them.

A :class:`FrameModel` contains the data of a COLMAP text model, or of a file of Bundler or
BAL. A model has the conventions of ``fg_orient.sensors.frame``: a camera looks along +Z, Y points down,
and (0, 0) is the centre of the first pixel. Coordinates refer to a local Cartesian system in metres or
another unit. :func:`frame_block` converts the model to a block for an adjustment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from typing import Final

import numpy as np

from factors.arrays import Array, Index, Mask
from factors.cameras.frame_camera import CAMERA
from fg_orient.model.block import (
    Block,
    Coordinates,
    GroundPoints,
    Image,
    ImagePoints,
    Options,
    Source,
    WithheldCoordinates,
)
from fg_orient.model.errors import Finding, finding
from fg_orient.model.names import Role
from fg_orient.sensors.frame import MEASURED_TO_IDEAL, FrameCamera, FrameSensor
from fg_orient.sensors.frame_unknowns import FURTHER, NAMES, UNKNOWNS
from fg_orient.sensors.interior import Interior

#: Default unknowns of an image when a frame model is adjusted.
EXTERIOR: Final = UNKNOWNS[:6]


@dataclass(frozen=True, eq=False)
class Pose:
    """Exterior orientation of an image.

    Parameters
    ----------
    name : str
    camera : str
        Key of its camera.
    rotation : (3, 3) array
        Rotates ground axes to camera axes (X right, Y down, Z forward).
    centre_m : (3,) array
        Projection centre.
    """

    name: str
    camera: str
    rotation: Array
    centre_m: Array


@dataclass(frozen=True, eq=False)
class FrameModel:
    """Cameras, poses, points and image points.

    Parameters
    ----------
    cameras : mapping of str to Interior
    poses : tuple of Pose
    point_ids : tuple of str
    points_m : (N, 3) array
    image, point : (n,) int arrays
        For each image point, its position in ``poses`` and in the list of points.
    line, sample : (n,) arrays
        Image coordinates, px.
    notes : tuple of Finding
        Remarks of the reader.
    from_middle : bool
        Image coordinates are relative to the middle of each image instead of its first pixel.
    """

    cameras: Mapping[str, Interior]
    poses: tuple[Pose, ...]
    point_ids: tuple[str, ...]
    points_m: Array
    image: Index
    point: Index
    line: Array
    sample: Array
    notes: tuple[Finding, ...] = ()
    from_middle: bool = False

    @cached_property
    def sensors(self) -> tuple[FrameSensor, ...]:
        """Return the sensor of each image."""
        out = []
        for pose in self.poses:
            own = self.cameras[pose.camera]
            line, sample = (-0.5 * (n - 1.0) if self.from_middle else 0.0 for n in (own.n_lines, own.n_samples))
            out.append(FrameSensor(
                own.camera(pose.rotation, pose.centre_m), own.n_lines, own.n_samples, first_line=line,
                first_sample=sample, georeferenced=False, file=pose.camera,
            ))  # fmt: skip
        return tuple(out)

    def residuals_px(self) -> Array:
        """Return computed minus measured line and sample (n, 2); nan if a point is not in front of the camera."""
        out = np.empty((len(self.image), 2))
        for k, sensor in enumerate(self.sensors):
            own = np.flatnonzero(self.image == k)
            if len(own):
                line, sample = sensor.project(self.points_m[self.point[own]])
                out[own] = np.column_stack([line - self.line[own], sample - self.sample[own]])
        return out


def frame_block(
    model: FrameModel, name: str, sources: tuple[Source, ...] = (), *, sigma_px: float = 1.0,
    unknowns: Sequence[str] = EXTERIOR, keep_behind: bool = True,
) -> Block:  # fmt: skip
    """Convert a model to a block of an adjustment.

    All points are tie points with start values. The block has a free datum and no priors, and
    its optimiser is Levenberg-Marquardt. Points that are measured in only one image are left
    out, because their depth is not determined.

    Parameters
    ----------
    model : FrameModel
    name : str
        Name of the block; messages use it as the file name.
    sources : tuple of Source, optional
    sigma_px : float, optional
        Standard deviation of line and sample of every image point. The files do not contain
        standard deviations.
    unknowns : sequence of str, optional
        Unknowns of each image (``fg_orient.sensors.frame_unknowns``). Images do not share
        them. All other parameters are held fixed.
    keep_behind : bool, optional
        Keep points whose start values lie behind a camera that shows them.
    """
    n, images = len(model.points_m), []
    alone, behind = _in_one_image(model.image, model.point, n), np.zeros(n, bool)
    for k, (pose, sensor) in enumerate(zip(model.poses, model.sensors, strict=True)):
        own = np.flatnonzero(model.image == k)
        point = model.point[own]
        behind[point[(model.points_m[point] - pose.centre_m) @ pose.rotation[2] <= 0.0]] = True
        camera = _in_pixels(sensor.camera, unknowns, model.line[own], model.sample[own], model.points_m[point])
        images.append(Image(pose.name, sensor.with_camera(camera, name)))
    used = ~(alone | behind & (not keep_behind))[model.point]
    # with a polynomial that corrects measured coordinates, residuals are in stretched samples
    cameras = [model.cameras[pose.camera] for pose in model.poses]
    aspects = ((camera.aspect if camera.model == MEASURED_TO_IDEAL else 0.0) for camera in cameras)
    stretch = np.array([1.0 + aspect for aspect in aspects])[model.image[used]]
    sigma = np.full(int(used.sum()), sigma_px)
    seen = ImagePoints(model.image[used], model.point[used], model.line[used], model.sample[used], sigma,
                       sigma * stretch)  # fmt: skip
    counts = (("points.alone", int(alone.sum())), ("points.behind", int(behind.sum())))
    notes = tuple(finding(code, n=count) for code, count in counts if count)
    known = Coordinates(model.points_m, np.full((n, 3), np.nan), np.zeros(n, bool))
    points = GroundPoints(model.point_ids, (Role.TIE,) * n, known)
    options = Options(datum="free", priors=False, optimizer="levenberg-marquardt", max_iterations=500)
    return Block(name, tuple(images), points, seen, WithheldCoordinates(), options, sources, (*model.notes, *notes))


def adjusted_model(model: FrameModel, corrections: Sequence[Array], ground_m: Array) -> FrameModel:
    """Return the model with adjusted poses, cameras and points.

    Parameters
    ----------
    model : FrameModel
    corrections : sequence of (15,) or (k,) arrays
        Corrections of each image, as ``Solution.correction`` returns them. If the interior
        orientation was adjusted, each image gets a separate camera.
    ground_m : (N, 3) array
        Adjusted points (``Solution.ground_m``). Points with nan are left out, and a note gives their number.
    """
    cameras, poses = dict(model.cameras), []
    for pose, sensor, correction in zip(model.poses, model.sensors, corrections, strict=True):
        full, name, interior = sensor.camera.corrected(correction), pose.camera, model.cameras[pose.camera]
        if np.any(np.asarray(correction)[6:] != 0.0):
            name = f"{pose.camera} of {pose.name}"
            # if its unit is not stated, a polynomial of measured coordinates has the given focal length as unit
            cameras[name] = replace(
                interior, focal_px=float(full[CAMERA.focal]), principal_px=full[CAMERA.principal][::-1],
                distortion=full[CAMERA.distortion], unit_px=sensor.camera.unit_px, name=name,
                aspect=float(full[CAMERA.aspect]), further=_further(sensor.camera, np.asarray(correction)),
            )  # fmt: skip
        poses.append(Pose(pose.name, name, full[CAMERA.rotation].reshape(3, 3), full[CAMERA.centre]))
    used = {pose.camera for pose in poses}
    known = np.asarray(np.isfinite(ground_m).all(axis=1), bool)
    seen, number = known[model.point], np.cumsum(known) - 1
    left_out = () if known.all() else (finding("points.not_adjusted", n=(~known).sum()),)
    return replace(
        model, cameras={name: camera for name, camera in cameras.items() if name in used}, poses=tuple(poses),
        point_ids=tuple(compress(model.point_ids, known)), points_m=ground_m[known], image=model.image[seen],
        point=number[model.point[seen]], line=model.line[seen], sample=model.sample[seen],
        notes=(*model.notes, *left_out),
    )  # fmt: skip


def _further(camera: FrameCamera, correction: Array) -> dict[str, float]:
    """Return the adjusted additional coefficients of a camera by name, without those that are 0."""
    change = dict(zip(FURTHER, correction[len(NAMES) - len(FURTHER) :].tolist(), strict=False))
    values = {name: camera.further.get(name, 0.0) + change.get(name, 0.0) for name in FURTHER}
    return {name: value for name, value in values.items() if value != 0.0}


def _in_one_image(image: Index, point: Index, n_points: int) -> Mask:
    """Return a mask (n_points,) of the points that are measured in exactly one image."""
    some, several = (np.zeros(n_points, bool) for _ in range(2))
    any_image = np.zeros(n_points, np.intp)
    some[point], any_image[point] = True, image
    several[point[image != any_image[point]]] = True
    return some & ~several


def _in_pixels(
    camera: FrameCamera, unknowns: Sequence[str], line: Array, sample: Array, ground_m: Array
) -> FrameCamera:
    """Return the camera with new units of its unknowns.

    At the start values, one unit of an unknown moves the image points (n,) of the camera by 1
    px (root of the sum of squares). Without priors, the units change only the damped steps
    (Moré 1978). With these units, the steps do not depend on the units of the file. The
    polynomial of the camera must convert ideal to measured coordinates.
    """
    camera = replace(camera, sigma=dict.fromkeys(unknowns, 1.0))
    _, derivatives = camera.linearised(unknowns, line, sample, ground_m)
    length = np.sqrt(np.sum(derivatives**2, axis=(0, 1)))
    usable = np.isfinite(length) & (length > 0.0)
    return replace(camera, sigma=dict(zip(unknowns, 1.0 / np.where(usable, length, 1.0), strict=True)))
