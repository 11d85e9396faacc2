"""Frame images with their cameras, poses, points and image points, as bundle programs exchange them.

A :class:`FrameModel` is what COLMAP's text models, Bundler's and BAL's files hold, in the conventions of
``fg_orient.sensors.frame``: cameras look along +Z with Y down, (0, 0) is the centre of the first pixel, coordinates
are metres (or another unit) of a local Cartesian system. :func:`frame_block` makes the block that is adjusted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.cameras.frame import FRAME_BROWN_IDEAL_TO_MEASURED
from fg_orient.kernels.batch import batch
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
from fg_orient.sensors.frame import UNKNOWNS, FrameCamera, FrameSensor
from fg_orient.sensors.interior import Interior

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Unknowns of an image in the adjustment of such a model, by default.
EXTERIOR: Final = UNKNOWNS[:6]


@dataclass(frozen=True, eq=False)
class Pose:
    """Orientation of an image.

    Parameters
    ----------
    name : str
    camera : str
        Key of its camera.
    rotation : (3, 3) array
        Camera axes (X right, Y down, Z forward) from ground axes.
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
        Positions in ``poses`` and the points.
    line, sample : (n,) arrays
        Pixels.
    notes : tuple of Finding
        Remarks of the reader.
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

    @cached_property
    def sensors(self) -> tuple[FrameSensor, ...]:
        """The sensor of each image."""
        return tuple(_sensor(self.cameras[p.camera], p) for p in self.poses)

    def residuals_px(self) -> Array:
        """Computed minus measured line and sample (n, 2); nan for points that are not in front of their camera."""
        out = np.empty((len(self.image), 2))
        for k, sensor in enumerate(self.sensors):
            own = np.flatnonzero(self.image == k)
            if len(own):
                line, sample = sensor.project(self.points_m[self.point[own]])
                out[own] = np.column_stack([line - self.line[own], sample - self.sample[own]])
        return out


def _sensor(interior: Interior, pose: Pose) -> FrameSensor:
    camera = interior.camera(pose.rotation, pose.centre_m)
    return FrameSensor(camera, interior.n_lines, interior.n_samples, georeferenced=False, file=pose.camera)


def frame_block(
    model: FrameModel, name: str, sources: tuple[Source, ...] = (), *, sigma_px: float = 1.0,
    unknowns: Sequence[str] = EXTERIOR,
) -> Block:  # fmt: skip
    """Make the block of a model: all points are tie points, the datum is free, and there are no priors.

    Parameters
    ----------
    model : FrameModel
    name : str
    sources : tuple of Source, optional
    sigma_px : float, optional
        Sigma of line and sample of every image point: these files hold none.
    unknowns : sequence of str, optional
        What is unknown of each image (``fg_orient.sensors.frame.UNKNOWNS``), each for itself; the rest is held.
    """
    alone = in_one_image(model.image, model.point, len(model.points_m))
    usable, images = ~alone[model.point], []
    for k, (pose, sensor) in enumerate(zip(model.poses, model.sensors, strict=True)):
        own = np.flatnonzero((model.image == k) & usable)
        place = model.line[own], model.sample[own]
        camera = in_pixels(sensor.camera, unknowns, *place, model.points_m[model.point[own]])
        images.append(Image(pose.name, FrameSensor(
            camera, sensor.n_lines, sensor.n_samples, georeferenced=False, file=sensor.file)))  # fmt: skip
    sigma = np.full(int(usable.sum()), sigma_px)
    seen = ImagePoints(
        model.image[usable], model.point[usable], model.line[usable], model.sample[usable], sigma, sigma
    )  # fmt: skip
    alone_note = (finding("points.alone", n=alone.sum()),) if alone.any() else ()
    return free_block(name, tuple(images), model.point_ids, model.points_m, seen, sources, (*model.notes, *alone_note))


def adjusted_model(model: FrameModel, corrections: Sequence[Array], ground_m: Array) -> FrameModel:
    """Give a model its adjusted poses, cameras and points.

    Parameters
    ----------
    model : FrameModel
    corrections : sequence of (15,) arrays
        Of each image, as ``Solution.correction`` gives them; an interior orientation that was adjusted is a camera of
        its own for each image.
    ground_m : (N, 3) array
        Adjusted points (``Solution.ground_m``); those that are nan are left out, and a note counts them.
    """
    cameras, poses = dict(model.cameras), []
    for pose, sensor, correction in zip(model.poses, model.sensors, corrections, strict=True):
        full, name, interior = sensor.camera.corrected(correction), pose.camera, model.cameras[pose.camera]
        if np.any(np.asarray(correction)[6:] != 0.0):
            name = f"{pose.camera} of {pose.name}"
            # the unit of a polynomial of measured coordinates is the focal length as given, unless it is stated
            cameras[name] = replace(
                interior, focal_px=float(full[12]), principal_px=full[[14, 13]], distortion=full[15:20],
                unit_px=sensor.camera.unit_px, name=name,
                aspect=float(full[29]) if sensor.camera.corrects_measured else 0.0,
            )  # fmt: skip
        poses.append(Pose(pose.name, name, full[:9].reshape(3, 3), full[9:12]))
    used = {pose.camera for pose in poses}
    known = np.asarray(np.isfinite(ground_m).all(axis=1), bool)
    seen, number = known[model.point], np.cumsum(known) - 1
    left_out = () if known.all() else (finding("points.not_adjusted", n=(~known).sum()),)
    return FrameModel(
        {name: camera for name, camera in cameras.items() if name in used}, tuple(poses),
        tuple(i for i, k in zip(model.point_ids, known.tolist(), strict=True) if k), ground_m[known],
        model.image[seen], number[model.point[seen]], model.line[seen], model.sample[seen], (*model.notes, *left_out),
    )  # fmt: skip


def free_block(
    name: str, images: tuple[Image, ...], point_ids: tuple[str, ...], points_m: Array, observations: ImagePoints,
    sources: tuple[Source, ...], notes: tuple[Finding, ...],
) -> Block:  # fmt: skip
    """Block of tie points (N, 3) m with start values in a local system: free datum, no priors, Levenberg-Marquardt."""
    n = len(points_m)
    known = Coordinates(points_m, np.full((n, 3), np.nan), np.zeros(n, bool))
    points = GroundPoints(point_ids, (Role.TIE,) * n, known)
    nothing = WithheldCoordinates((), lambda: Coordinates(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool)))
    options = Options(datum="free", priors=False, optimizer="levenberg-marquardt", max_iterations=500)
    return Block(name, images, points, observations, nothing, options, sources, notes)


def in_one_image(image: Index, point: Index, n_points: int) -> npt.NDArray[np.bool_]:
    """Points (n_points,) that are measured, but in one image only: nothing determines their depth."""
    some, several = (np.zeros(n_points, bool) for _ in range(2))
    any_image = np.zeros(n_points, np.intp)
    some[point], any_image[point] = True, image
    several[point[image != any_image[point]]] = True
    return some & ~several


def in_pixels(
    camera: FrameCamera, unknowns: Sequence[str], line: Array, sample: Array, ground_m: Array
) -> FrameCamera:  # fmt: skip
    """Name the unknowns, each in the unit that moves the image points by 1 px (root of the squares) at the start.

    There are no priors: the units rule the damped steps alone (Moré 1978), and so does no unit of the file.

    Parameters
    ----------
    camera : FrameCamera
        Its polynomial leads from ideal to measured coordinates.
    unknowns : sequence of str
    line, sample : (n,) arrays
        Its image points, px.
    ground_m : (n, 3) array
    """
    codes = np.array([UNKNOWNS.index(name) for name in unknowns], dtype=float)
    records = FrameSensor(camera, 1, 1, georeferenced=False).records(line, sample)
    rows, columns = batch(FRAME_BROWN_IDEAL_TO_MEASURED, np.stack([codes, np.ones(len(codes))]), records)
    n, ground = len(line), np.ascontiguousarray(ground_m)
    order, derivatives = np.arange(n, dtype=np.int32), np.zeros((n, 2, len(codes)))
    rows(
        0, n, order, records, order, np.zeros(n, np.int32), order, columns.setup, 1, np.ones((n, 1)),
        np.zeros((1, len(codes))), ground, np.empty((n, 2)), derivatives, np.empty((n, 2, 3)), True,
    )  # fmt: skip
    length = np.sqrt(np.sum(derivatives**2, axis=(0, 1)))
    usable = np.isfinite(length) & (length > 0.0)
    return replace(camera, sigma=dict(zip(unknowns, 1.0 / np.where(usable, length, 1.0), strict=True)))
