"""Text models of COLMAP: the files cameras.txt, images.txt and points3D.txt in one folder.

A pose transforms ground axes to camera axes (quaternion w x y z, then translation t = -R
C). The axes are the same as in ``fg_orient.sensors.frame``. Pixels are (x, y); (0.5, 0.5)
is the centre of the first pixel. Each image has two lines. The second line lists the
keypoints and may be empty; a keypoint without a point has the number -1. Since version
3.12 COLMAP also writes rigs.txt and frames.txt, which contain no further data if each
image has a single camera. COLMAP's databases have the same camera models.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from factors.arrays import Array, Index
from fg_orient.formats.atomic import made_folder, outputs, require_free_files, write_lines
from fg_orient.formats.columns import finite
from fg_orient.formats.exchange.text import TextLines, positions, require_once, whole
from fg_orient.formats.exchange.ties import model_format
from fg_orient.formats.frame_model import FrameModel, Pose
from fg_orient.model.errors import InputError, finding
from fg_orient.sensors.conventions import CONVENTIONS, Image, interior_parameters
from fg_orient.sensors.frame import IDEAL_TO_MEASURED
from fg_orient.sensors.interior import Interior, converted

#: Camera models that can be read, with their conventions. The writer uses the smallest sufficient model.
CONVENTION: Final = {
    model: CONVENTIONS[f"colmap-{model.lower().replace('_', '-')}"]
    for model in (
        "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV",
    )
}  # fmt: skip
#: Names of the parameters of each model, in the order of the files.
MODELS: Final = {model: convention.names for model, convention in CONVENTION.items()}
#: Coordinate of the first pixel's centre in COLMAP's files.
FIRST_PIXEL: Final = CONVENTION["PINHOLE"].first_pixel


def interior_of(
    model: str, size: tuple[int, int], parameters: Sequence[float], name: str, *, file: str = "", place: str = ""
) -> Interior:
    """Convert a camera of COLMAP to an interior orientation.

    Parameters
    ----------
    model : str
        Name of the model in cameras.txt.
    size : (int, int)
        Width and height, px.
    parameters : sequence of float
        Parameters in COLMAP's order, px.
    name : str
    file, place : str
        File, and place in it; used in messages.

    Raises
    ------
    InputError
        The model or a parameter has no counterpart, the number of parameters is wrong, or
        a value is impossible.
    """
    if model not in MODELS:
        raise InputError.of("colmap.model", file=file, place=place, value=model, known=", ".join(MODELS))
    if len(parameters) != len(MODELS[model]):
        needed = f"{model} with {' '.join(MODELS[model])}"
        value = f"{len(parameters)} numbers"
        raise InputError.of("interchange.cells", file=file, place=place, value=value, needed=needed)
    absent = CONVENTION[model].absent.split()
    beyond = [f"{key} {v:g}" for key, v in zip(MODELS[model], parameters, strict=True) if key in absent and v != 0.0]
    if beyond:
        raise InputError.of("colmap.camera", file=file, place=place, value=" ".join(beyond))
    return CONVENTION[model].interior(parameters, Image(size[1], size[0]), name)


def parameters_of(interior: Interior) -> tuple[str, tuple[float, ...], float]:
    """Convert a camera to COLMAP's smallest model that has all its parameters.

    Returns
    -------
    model : str
    parameters : tuple of float
        Parameters in COLMAP's order, px.
    error_px : float
        Largest error of the conversion. It is 0 if the polynomial of the camera converts
        ideal to measured coordinates. Otherwise a polynomial of that direction is fitted
        (``fg_orient.sensors.interior.converted``).
    """
    others = any(v != 0.0 and not name.startswith("fisheye_") for name, v in interior.further.items())
    others |= interior.is_fisheye and bool(interior.distortion.any())
    fitted = converted(interior, IDEAL_TO_MEASURED, brown=others)  # COLMAP has neither shear nor further terms
    own = interior_parameters(fitted.interior)
    model = next(name for name, c in CONVENTION.items() if c.is_of(fitted.interior) and c.has(own != 0.0))
    values = [*CONVENTION[model].values(own, Image()).tolist(), *(0.0 for _ in CONVENTION[model].absent.split())]
    return model, tuple(values), fitted.max_px


def camera_lines(model: FrameModel) -> tuple[list[str], tuple[str, ...]]:
    """Return the lines of cameras.txt, and the information that they cannot contain, in words."""
    lines, lost = [], []
    for k, (name, interior) in enumerate(model.cameras.items(), start=1):
        kind, values, error = parameters_of(interior)
        size = f"{interior.n_samples} {interior.n_lines}"
        lines.append(f"{k} {kind} {size} {' '.join(map(repr, values))}")
        if error > 0.0:
            lost.append(f"camera {name}: distortion fitted the other way round, up to {error:.2g} px in the image")
    return lines, tuple(lost)


FILES: Final = ("cameras.txt", "images.txt", "points3D.txt")
#: Point id of a keypoint without a point. Files also contain it as an unsigned number.
NO_POINT: Final = -1.0
_UNSIGNED_NO_POINT: Final = 2.0**64
#: Maximum difference of the length of a quaternion from 1.
NORM: Final = 1e-3


def read_colmap_text(folder: str | Path) -> FrameModel:
    """Read a text model.

    InputError: a file is missing or damaged, two files contradict each other, or this
    program has no equivalent of a camera. The message names the first faulty line.
    """
    folder = Path(folder)
    cameras = _read_cameras(TextLines(folder / FILES[0]))
    poses, keypoints = _read_images(TextLines(folder / FILES[1]), cameras)
    ids, points, n_tracked = _read_points(TextLines(folder / FILES[2]))
    image = np.repeat(np.arange(len(poses)), [len(k) for k in keypoints])
    rows = np.concatenate([np.empty((0, 3)), *keypoints])
    measured = (rows[:, 2] != NO_POINT) & (rows[:, 2] < _UNSIGNED_NO_POINT)
    image, rows = image[measured], rows[measured]
    point = positions(ids, rows[:, 2])
    if (point < 0).any():
        _no_reference(FILES[1], folder.name, int(rows[point < 0, 2][0]), "point", FILES[2])
    if n_tracked != len(rows):
        raise InputError.of("colmap.track", file=FILES[2], place=folder.name, n_tracks=n_tracked, n_images=len(rows))
    left_out = int((~measured).sum())
    notes = (finding("points.no_track", n=left_out),) if left_out else ()
    names = tuple(str(int(i)) for i in ids)
    line, sample = rows[:, 1] - FIRST_PIXEL, rows[:, 0] - FIRST_PIXEL
    return FrameModel(cameras, poses, names, points, image, point, line, sample, notes)


def _no_reference(file: str, place: str, value: object, kind: str, other: str) -> NoReturn:
    raise InputError.of("colmap.reference", file=file, place=place, value=value, kind=kind, other=other)


def _read_cameras(text: TextLines) -> dict[str, Interior]:
    rows = [(number, line.split()) for number, line in text.content()]
    cameras: dict[str, Interior] = {}
    ids = [cells[0] for _, cells in rows]
    require_once(ids, "camera", text.path.name, lambda k: (f"line {rows[k][0]}", ids[k]))
    for number, cells in rows:
        values, size = finite(cells[4:]), [whole(cell) for cell in cells[2:4]]
        if len(cells) < 5 or values is None or None in size:
            text.refuse(number, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
        width, height = (n for n in size if n is not None)
        cameras[cells[0]] = interior_of(
            cells[1], (width, height), values.tolist(), cells[0], file=text.path.name, place=f"line {number}"
        )
    return cameras


def _read_images(text: TextLines, cameras: dict[str, Interior]) -> tuple[tuple[Pose, ...], list[Array]]:
    """Return the poses, and the keypoints (k, 3) of each image: x, y, point id."""
    poses, keypoints = [], []
    upcoming = iter(enumerate(text.lines, start=1))
    for number, line in upcoming:
        if not line.strip() or line.startswith("#"):
            continue
        poses.append(_pose(text, number, line, cameras))
        second, keypoint_line = next(upcoming, (number, ""))
        cells = keypoint_line.split()
        values = finite(cells)
        if values is None or len(cells) % 3:
            text.refuse(second, "X Y POINT3D_ID of each keypoint")
        keypoints.append(values.reshape(-1, 3))
    return tuple(poses), keypoints


def _pose(text: TextLines, number: int, line: str, cameras: dict[str, Interior]) -> Pose:
    cells = line.split(maxsplit=9)
    values = finite(cells[1:8])
    if len(cells) < 10 or values is None or abs(np.linalg.norm(values[:4]) - 1.0) > NORM:
        text.refuse(number, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME with a quaternion of length 1")
    if cells[8] not in cameras:
        _no_reference(text.path.name, f"line {number}", cells[8], "camera", FILES[0])
    rotation = Rotation.from_quat(values[[1, 2, 3, 0]]).as_matrix()
    return Pose(cells[9].strip(), cells[8], rotation, -rotation.T @ values[4:7])


def _read_points(text: TextLines) -> tuple[Array, Array, int]:
    """Return ids (N,) and coordinates (N, 3) of the points, and the number of image points of all tracks."""
    needed = "POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]"
    content = text.content()
    counts = [len(line.split()) for _, line in content]
    for (number, _), count in zip(content, counts, strict=True):
        if count < 8 or count % 2:
            text.refuse(number, needed)
    rows = text.numbers([(number, line.split(maxsplit=4)[:4]) for number, line in content], 4, needed)
    require_once(rows[:, 0], "point", text.path.name, lambda k: ("", int(rows[k, 0])))
    return rows[:, 0], rows[:, 1:], (sum(counts) - 8 * len(counts)) // 2


def write_colmap_text(folder: str | Path, model: FrameModel, *, overwrite: bool = False) -> tuple[str, ...]:
    """Write a text model; return the lost information in words. A missing folder is created.

    Cameras, images and points are numbered from 1 in the order of the model. Other names
    of points and cameras are lost. InputError: a file exists or cannot be written, or the
    name of an image contains a blank, where COLMAP would truncate it.
    """
    folder = Path(folder)
    paths = [folder / name for name in FILES]
    require_free_files(*paths, overwrite=overwrite)
    for pose in model.poses:
        if len(pose.name.split()) != 1:
            needed = "a NAME without blanks"
            raise InputError.of("interchange.cells", file=FILES[1], value=repr(pose.name), needed=needed)
    cameras, lost = camera_lines(model)
    order = np.lexsort((model.point, model.image))
    place = np.empty(len(order), np.intp)  # number of an image point within its image
    place[order] = np.arange(len(order)) - np.searchsorted(model.image[order], model.image[order])
    with made_folder(folder), outputs(*paths, overwrite=overwrite):
        write_lines(paths[0], ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", *cameras])
        write_lines(paths[1], [*_IMAGE_HEAD, *_image_lines(model, order)])
        write_lines(paths[2], [_POINT_HEAD, *_point_lines(model, place)])
    return lost


_IMAGE_HEAD: Final = (
    "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
    "# X Y POINT3D_ID of each keypoint; (0.5, 0.5) is the centre of the first pixel",
)
_POINT_HEAD: Final = "# POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]"


def _image_lines(model: FrameModel, order: Index) -> Iterator[str]:
    """Return the two lines of each image; ``order`` sorts the image points by image."""
    ends = np.searchsorted(model.image[order], np.arange(len(model.poses) + 1))
    camera = {name: k for k, name in enumerate(model.cameras, start=1)}
    for k, pose in enumerate(model.poses):
        x, y, z, w = Rotation.from_matrix(pose.rotation).as_quat(canonical=True).tolist()
        t = (-pose.rotation @ pose.centre_m).tolist()
        yield f"{k + 1} {' '.join(map(repr, (w, x, y, z, *t)))} {camera[pose.camera]} {pose.name}"
        own = order[ends[k] : ends[k + 1]]
        xs, ys = (model.sample[own] + FIRST_PIXEL).tolist(), (model.line[own] + FIRST_PIXEL).tolist()
        yield " ".join(f"{x!r} {y!r} {p}" for x, y, p in zip(xs, ys, (model.point[own] + 1).tolist(), strict=True))


def _point_lines(model: FrameModel, place: Index) -> Iterator[str]:
    """Return the lines of the points with their tracks and mean residuals as in COLMAP.

    The colour is grey.
    """
    order = np.argsort(model.point, kind="stable")
    ends = np.searchsorted(model.point[order], np.arange(len(model.points_m) + 1)).tolist()
    residual = np.linalg.norm(model.residuals_px(), axis=1)[order]
    tokens = [f"{i} {p}" for i, p in zip((model.image[order] + 1).tolist(), place[order].tolist(), strict=True)]
    for k, xyz in enumerate(model.points_m.tolist()):
        first, last = ends[k], ends[k + 1]
        error = float(residual[first:last].mean()) if last > first else float("nan")
        error = error if np.isfinite(error) else -1.0
        yield " ".join([str(k + 1), *map(repr, xyz), "128 128 128", repr(error), *tokens[first:last]])


TEXT: Final = model_format(
    lambda paths, settings: read_colmap_text(paths[0]),
    name="colmap-text",
    title="COLMAP text model (folder of cameras.txt, images.txt, points3D.txt)",
    files=("model",),
    first_pixel=(FIRST_PIXEL, FIRST_PIXEL),
    pixel_axes="x column, y row (pixels)",
    help=__doc__ or "",
    write_model=lambda out, model, overwrite: write_colmap_text(out, model, overwrite=overwrite),
    evidence="models written by pycolmap 4.2; ours are read by it",
)
