"""Cameras and points of sba (Lourakis, Argyros 2009), as the demonstration program eucsbademo reads them.

Each line of the first file is a camera. It contains the rotation from ground to camera as
a quaternion w x y z, and the translation t = -R C. If there is no third file with a
common camera matrix, fx, x0, y0, aspect fy/fx and skew precede them. Bouguet's five
coefficients k1 k2 p1 p2 k3 may follow the skew. Each line of the second file is a point.
It contains X Y Z, the number of images, and image, x, y for each image. Each image point
may also have the covariance matrix of x, y, complete or as upper triangle. Images are
numbered from 0. Camera axes are X right, Y down, Z forward.

According to sba's description, pixels are counted from the top left corner of the image.
It is therefore assumed that (0.5, 0.5) is the centre of the first pixel. Image points and
principal point have the same origin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from factors.arrays import Array
from fg_orient.formats.columns import finite
from fg_orient.formats.exchange.bal import sizes_of
from fg_orient.formats.exchange.text import TextLines
from fg_orient.formats.exchange.ties import model_format
from fg_orient.formats.faults import Faults
from fg_orient.formats.frame_model import FrameModel, Pose
from fg_orient.formats.registry import Settings
from fg_orient.model.errors import InputError, finding
from fg_orient.sensors.frame import IDEAL_TO_MEASURED, MEASURED_TO_IDEAL
from fg_orient.sensors.interior import Interior

#: Coordinate of the first pixel's centre.
CORNER: Final = 0.5
#: Number of cells of a camera: with exterior orientation only; also with fx x0 y0 aspect skew; also with distortion.
_POSE, _INTERIOR, _DISTORTED = 7, 12, 17
#: Maximum difference of the length of a quaternion from 1; the files contain six decimals.
_UNIT: Final = 1e-4
#: Positions of k1 k2 k3 p1 p2 among Bouguet's coefficients.
_BROWN: Final = [0, 1, 4, 2, 3]
_CAMERA: Final = "qw qx qy qz tx ty tz, or before them fx x0 y0 aspect skew, or these and k1 k2 p1 p2 k3"
_VIEWS: Final = "X Y Z, number of images, then image x y for each, or image x y and its covariance matrix for each"


def read_sba(
    cameras: str | Path, points: str | Path, calibration: str | Path | None = None, *,
    image_sizes: Mapping[str, tuple[int, int]] | None = None,
) -> FrameModel:  # fmt: skip
    """Read files of sba as a frame model.

    Each image has its own camera. If ``calibration`` is given, all images have the same
    camera. Covariance matrices of image points are left out, with a note.

    Parameters
    ----------
    cameras, points : str or Path
    calibration : str or Path, optional
        File of the camera matrix. It is needed if the cameras contain only the exterior orientation.
    image_sizes : mapping of str to (n_lines, n_samples), optional
        Sizes of the images 0, 1, ... If a size is missing, a square up to the outermost
        image point is assumed, with a note.

    Raises
    ------
    InputError
        A file cannot be read or is damaged. Or a camera has a skew, or both an aspect and distortion.
    """
    rows = _cameras(TextLines(Path(cameras)))
    width = rows.shape[1]
    if (calibration is None) is (width == _POSE):
        value = f"{width} numbers per camera, {'no ' if calibration is None else ''}calibration"
        raise InputError.of("sba.calibration", file=Path(cameras).name, value=value)
    xyz, views, count, covariances = _points(TextLines(Path(points)), len(rows))
    image, pixels = views[:, 0].astype(np.intp), views[:, 1:] - CORNER
    names = list(map(str, range(len(rows))))
    sizes, notes = sizes_of(names, image_sizes or {}, int(np.ceil(pixels.max(initial=0.0))) + 1)
    if calibration is None:
        own = {name: _interior(row[:-_POSE], size, name, Path(cameras).name)
               for name, row, size in zip(names, rows, sizes, strict=True)}  # fmt: skip
    else:
        common = _interior(_matrix(TextLines(Path(calibration))), sizes[0], "1", Path(calibration).name)
        own = dict.fromkeys(names, common)
    poses = []
    rotations = Rotation.from_quat(rows[:, [-6, -5, -4, -7]]).as_matrix()
    for name, rotation, row in zip(names, rotations, rows, strict=True):
        poses.append(Pose(name, name if calibration is None else "1", rotation, -rotation.T @ row[-3:]))
    if covariances:
        notes = (*notes, finding("sba.covariance (note): the covariance matrices of {n} image point(s) are left out",
                                 file=Path(points).name, n=covariances))  # fmt: skip
    return FrameModel(
        {camera.name: camera for camera in own.values()}, tuple(poses), tuple(map(str, range(len(xyz)))), xyz, image,
        np.repeat(np.arange(len(xyz)), count), pixels[:, 1], pixels[:, 0], notes,
    )  # fmt: skip


def _cameras(text: TextLines) -> Array:
    """Read the rows (n, 7), (n, 12) or (n, 17) of the cameras.

    All faulty lines are reported together.
    """
    content = [(number, line.split()) for number, line in text.content()]
    width = len(content[0][1]) if content else 0
    if width not in (_POSE, _INTERIOR, _DISTORTED):
        text.refuse(content[0][0] if content else len(text.lines) + 1, _CAMERA)
    faults, rows = Faults(text.path.name), []
    for number, cells in content:
        row = finite(cells)
        good = row is not None and len(row) == width
        if not good or abs(float(np.linalg.norm(row[-7:-3])) - 1.0) > _UNIT:  # type: ignore[index]
            faults.add("interchange.cells", place=f"line {number}", value=repr(text.lines[number - 1]),
                       needed=f"{width} numbers, a quaternion of length 1 and a translation at the end")  # fmt: skip
        rows.append(row)
    faults.raise_if_any()
    return np.array(rows)


def _points(text: TextLines, n_images: int) -> tuple[Array, Array, list[int], int]:
    """Read the points.

    Returns
    -------
    tuple
        Coordinates (N, 3); image, x, y (n, 3) of all image points; number of image points
        of each point; number of covariance matrices.
    """
    faults, xyz, views, covariances = Faults(text.path.name), [], [], 0
    for number, line in text.content():
        row = finite(line.split())
        each = _each(row)
        seen = np.empty((0, 3)) if row is None or not each else row[4:].reshape(-1, each)
        known = np.isin(seen[:, 0], np.arange(n_images)).all() and len(np.unique(seen[:, 0])) == len(seen)
        if not len(seen) or not known:
            faults.add("interchange.cells", place=f"line {number}", value=repr(line),
                       needed=f"{_VIEWS}; different images 0 to {n_images - 1}")  # fmt: skip
            continue
        xyz.append(row[:3])  # type: ignore[index]
        views.append(seen[:, :3])
        covariances += len(seen) * (each > 3)
    if not (xyz or faults):
        text.refuse(len(text.lines) + 1, _VIEWS)
    faults.raise_if_any()
    return np.array(xyz), np.concatenate(views), [len(own) for own in views], covariances


def _each(row: Array | None) -> int:
    """Return how many numbers each image point of a line has; 0 if the length of the line does not fit."""
    if row is None or len(row) < 5 or row[3] < 1.0 or row[3] % 1 or (len(row) - 4) % row[3]:
        return 0
    each = int((len(row) - 4) // row[3])
    return each if each in (3, 6, 7) else 0


def _matrix(text: TextLines) -> Array:
    """Read a camera matrix and return fx x0 y0 aspect skew (5,)."""
    content = text.content()
    needed = "the camera matrix: fx skew x0, 0 fy y0, 0 0 1"
    if len(content) != 3:
        text.refuse(content[-1][0] if content else 1, needed, f"{len(content)} lines")
    k = text.numbers([(number, line.split()) for number, line in content], 3, needed)
    if k[1, 0] or k[2].tolist() != [0.0, 0.0, 1.0] or not k[0, 0] > 0.0:
        text.refuse(content[0][0], needed, k.tolist())
    return np.array([k[0, 0], k[0, 2], k[1, 2], k[1, 1] / k[0, 0], k[0, 1]])


def _interior(row: Sequence[float] | Array, size: tuple[int, int], name: str, file: str) -> Interior:
    """Make the camera from fx x0 y0 aspect skew and, if there is distortion, five coefficients."""
    fx, x0, y0, aspect, skew = row[:5]
    distortion = np.array(row[5:])[_BROWN] if len(row) > 5 else np.zeros(5)
    bent = bool(distortion.any())
    if skew or not (fx > 0.0 and aspect > 0.0) or (bent and aspect != 1.0):
        value = f"fx {fx:g}, aspect {aspect:g}, skew {skew:g}{', distortion' * bent}"
        raise InputError.of("sba.camera", file=file, place=f"camera {name}", value=value)
    # if samples are multiplied by fy / fx, the principal distance is fy for both axes
    model = MEASURED_TO_IDEAL if aspect != 1.0 else IDEAL_TO_MEASURED
    principal = np.array([y0, x0]) - CORNER
    return Interior(*size, fx * aspect, principal, distortion, model, aspect=aspect - 1.0, name=name)


def _model(paths: tuple[Path, ...], settings: Settings) -> FrameModel:
    if len(paths) < 2:
        raise InputError.of("interchange.files", file=paths[0], value="1 file", format="sba",
                            names=", ".join(FORMAT.files))  # fmt: skip
    return read_sba(*paths, image_sizes=settings.image_sizes)


FORMAT: Final = model_format(
    _model,
    name="sba",
    title="sba: cameras, points and camera matrix",
    files=("cams", "pts", "calib"),
    first_pixel=(CORNER, CORNER),
    pixel_axes="x right, y down from the top left corner (pixels)",
    help=__doc__ or "",
    evidence="the two examples published with sba (7 and 9 cameras); the pixel origin is by description",
)
