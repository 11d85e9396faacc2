"""Blocks of the runs of Börlin, Grussenmeyer (2016): DBAT on exports of PhotoModeler, here from our reader.

DBAT takes image points, camera and start values from the export, and control points from a file of its own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors.constraints import OBSERVED_ELEMENT
from fg_orient.block import Block, Coordinates, ExtraObservation, GroundPoints, Image, ImagePoints, Options
from fg_orient.io.frame_model import FrameModel
from fg_orient.names import Role
from fg_orient.sensors.frame import FrameSensor
from tests.support.dbat import EXTERIOR, NOTHING


def read_control(path: Path) -> dict[int, np.ndarray]:
    """Rows of a control point file by id: X, Y, Z, then sigmas where there are any."""
    rows = [line.split(",") for line in path.read_text().splitlines() if line.strip() and line[0] != "#"]
    return {int(row[0]): np.array([float(word) for word in row[2:]]) for row in rows}


def read_centres(path: Path) -> dict[str, np.ndarray]:
    """X, Y, Z and sigma of projection centres by photo."""
    rows = [line.split(",") for line in path.read_text().splitlines() if line.strip() and line[0] != "#"]
    return {row[0]: np.array([float(word) for word in row[1:]]) for row in rows}


def points_of(export: FrameModel) -> dict[int, np.ndarray]:
    """Start coordinates of all points by number."""
    return {int(name): at for name, at in zip(export.point_ids, export.points_m, strict=True)}


def shift_of(export: FrameModel, control: dict[int, np.ndarray]) -> np.ndarray:
    """What leads from the export's system to that of the control points: mean difference of the control points."""
    points = points_of(export)
    return np.mean([control[i][:3] - points[i] for i in control], axis=0)


def block(export: FrameModel, control: dict[int, np.ndarray], sigma_px: float, centres: dict[str, np.ndarray]) -> Block:
    """Block of a run: the camera held; control points held or with their sigmas, and so observed centres by photo.

    Coordinates are those of the export's system, as in the reports.
    """
    shift = shift_of(export, control)
    (interior,) = export.cameras.values()
    cameras = [interior.camera(pose.rotation, pose.centre_m, EXTERIOR) for pose in export.poses]
    images = tuple(
        Image(pose.name, FrameSensor(c, interior.n_lines, interior.n_samples, georeferenced=False))
        for pose, c in zip(export.poses, cameras, strict=True)
    )
    seen, at = np.unique(export.point, return_inverse=True)
    ids = np.array([int(export.point_ids[k]) for k in seen.tolist()])
    sigma = np.full(len(at), sigma_px)
    measured = ImagePoints(export.image, at, export.line, export.sample, sigma, sigma)
    options = Options(priors=False, datum="control", optimizer="gauss-newton", max_iterations=20)
    return Block("dbat", images, _points(export, ids, control, shift), measured, NOTHING, options,
                 extra=_observed(images, centres, shift))  # fmt: skip


def _points(export: FrameModel, ids: np.ndarray, control: dict[int, np.ndarray], shift: np.ndarray) -> GroundPoints:
    """Control points held, or observed with sigmas; the others begin at the export's coordinates."""
    start = points_of(export)
    xyz, sigma = np.array([start[i] for i in ids.tolist()]), np.full((len(ids), 3), np.nan)
    fixed = np.zeros(len(ids), bool)
    for k, i in enumerate(ids.tolist()):
        if i in control:
            xyz[k] = control[i][:3] - shift
            fixed[k] = len(control[i]) == 3
            sigma[k] = np.nan if fixed[k] else control[i][3:6]
    roles = tuple(Role.CONTROL if i in control else Role.TIE for i in ids.tolist())
    return GroundPoints(tuple(map(str, ids.tolist())), roles, Coordinates(xyz, sigma, fixed))


def _observed(
    images: tuple[Image, ...], centres: dict[str, np.ndarray], shift: np.ndarray
) -> tuple[ExtraObservation, ...]:
    """Observations of projection centres: X, Y, Z, sigma by photo; unknowns stand in units of their prior sigmas."""
    out = []
    for image in images:
        if image.id in centres:
            *at, sigma = centres[image.id]
            unit = EXTERIOR["centre_x"]
            for j, value in enumerate((np.array(at) - shift - image.sensor.camera.centre_m) / unit):
                record = np.array([unit / sigma, value, 3.0 + j])
                out.append(ExtraObservation(OBSERVED_ELEMENT, (f"image:{image.id}",), record, np.zeros((2, 0)), 1, ""))
    return tuple(out)
