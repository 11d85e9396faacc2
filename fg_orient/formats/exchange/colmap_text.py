"""Text models of COLMAP: cameras.txt, images.txt and points3D.txt in one folder, read and written; its camera models.

A pose leads from ground to camera axes (quaternion w x y z, then translation t = -R C); the axes are those of
``fg_orient.sensors.frame``. Pixels are (x, y) with (0.5, 0.5) in the centre of the first one. Each image has two
lines, of which the second may be empty: its keypoints, -1 where they belong to no point. What COLMAP may put beside
(rigs.txt, frames.txt: since 3.12) says nothing more about images of single cameras.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from fg_orient.formats.atomic import write_lines
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import make_folder, read_lines, require_free, whole
from fg_orient.formats.exchange.ties import model_survey
from fg_orient.formats.frame_model import FrameModel, Pose
from fg_orient.formats.registry import TIES_ONLY, Format, Settings
from fg_orient.formats.tables import finite
from fg_orient.model.errors import InputError, finding
from fg_orient.sensors.frame import IDEAL_TO_MEASURED
from fg_orient.sensors.interior import Interior, converted

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

#: Coordinate of the centre of the first pixel in COLMAP's files.
FIRST_PIXEL: Final = 0.5
#: Names of the parameters of the models that are read, in the order of the files.
MODELS: Final = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
#: Number of a model in databases.
MODEL_IDS: Final = {0: "SIMPLE_PINHOLE", 1: "PINHOLE", 2: "SIMPLE_RADIAL", 3: "RADIAL", 4: "OPENCV", 6: "FULL_OPENCV"}
#: Coefficients in the order of ``Interior.distortion``.
_BROWN: Final = ("k1", "k2", "k3", "p1", "p2")
FILES: Final = ("cameras.txt", "images.txt", "points3D.txt")
#: Point id of a keypoint without a point: -1, or the same as an unsigned number.
NO_POINT: Final = -1.0
_UNSIGNED_NO_POINT: Final = 2.0**64
#: Quaternions are normalised; further from 1 than this they are none.
NORM: Final = 1e-3


def interior_of(
    model: str, size: tuple[int, int], parameters: Sequence[float], name: str, *, file: str = "", place: str = ""
) -> Interior:  # fmt: skip
    """Camera of COLMAP as an interior orientation.

    Parameters
    ----------
    model : str
        Name as in cameras.txt.
    size : (int, int)
        Width and height, px.
    parameters : sequence of float
        In COLMAP's order.
    name : str
        Of the camera.
    file, place : str
        For messages.

    Raises
    ------
    InputError
        The model or a parameter has no counterpart, the number of parameters is wrong, or a value is impossible.
    """
    if model not in MODELS:
        raise InputError.of("colmap.model", file=file, place=place, value=model, known=", ".join(MODELS))
    if len(parameters) != len(MODELS[model]):
        needed = f"{model} with {' '.join(MODELS[model])}"
        raise InputError.of("colmap.cells", file=file, place=place, value=f"{len(parameters)} numbers", needed=needed)
    value = dict(zip(MODELS[model], parameters, strict=True))
    focal = value.get("f", value.get("fx", 0.0))
    beyond = {key: value[key] for key in ("k4", "k5", "k6") if value.get(key, 0.0) != 0.0}
    if value.get("fy", focal) != focal:
        beyond = {"fx": focal, "fy": value["fy"], **beyond}
    if beyond:
        shown = " ".join(f"{key} {number:g}" for key, number in beyond.items())
        raise InputError.of("colmap.camera", file=file, place=place, value=shown)
    principal = np.array([value["cy"], value["cx"]]) - FIRST_PIXEL
    distortion = np.array([value.get(key, 0.0) for key in _BROWN])
    return Interior(size[1], size[0], focal, principal, distortion, name=name)


def parameters_of(interior: Interior) -> tuple[str, tuple[float, ...], float]:
    """Camera for COLMAP: the smallest model that holds it, its parameters, and the largest error in px.

    The error is 0 unless the polynomial leads from measured to ideal coordinates: it is then fitted the other way
    round (``fg_orient.sensors.interior.converted``).
    """
    turned = converted(interior, IDEAL_TO_MEASURED)
    own = turned.interior
    value = dict(zip(_BROWN, own.distortion.tolist(), strict=True))
    cy, cx = (own.principal_px + FIRST_PIXEL).tolist()
    value |= dict.fromkeys(("f", "fx", "fy"), float(own.focal_px)) | {"cx": cx, "cy": cy}
    needed = {key for key in _BROWN if value[key] != 0.0}
    names = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
    model = next(name for name in names if needed <= set(MODELS[name]))
    return model, tuple(value.get(key, 0.0) for key in MODELS[model]), turned.max_px


def read_colmap_text(folder: str | Path) -> FrameModel:
    """Read a model.

    Raises
    ------
    InputError
        A file is missing or damaged (its first faulty line is named), the files contradict each other, or a camera
        has no counterpart here.
    """
    folder = Path(folder)
    cameras = _read_cameras(folder / FILES[0])
    poses, keypoints = _read_images(folder / FILES[1], cameras)
    ids, points, n_tracked = _read_points(folder / FILES[2])
    image = np.repeat(np.arange(len(poses)), [len(k) for k in keypoints])
    rows = np.concatenate([np.empty((0, 3)), *keypoints])
    measured = (rows[:, 2] != NO_POINT) & (rows[:, 2] < _UNSIGNED_NO_POINT)
    image, rows = image[measured], rows[measured]
    point = _positions(ids, rows[:, 2], folder.name)
    if n_tracked != len(rows):
        raise InputError.of(
            "colmap.track", file=FILES[2], place=folder.name, n_tracks=n_tracked, n_images=len(rows)
        )  # fmt: skip
    left_out = int((~measured).sum())
    notes = (finding("points.no_track", n=left_out),) if left_out else ()
    names = tuple(str(int(i)) for i in ids)
    return FrameModel(
        cameras, poses, names, points, image, point, rows[:, 1] - FIRST_PIXEL, rows[:, 0] - FIRST_PIXEL, notes
    )  # fmt: skip


def _read_cameras(path: Path) -> dict[str, Interior]:
    found: dict[str, Interior] = {}
    for number, line in _content(path):
        place, cells = f"line {number}", line.split()
        values = finite(cells[4:])
        size = [whole(cell) for cell in cells[2:4]]
        if len(cells) < 5 or values is None or None in size:
            _refuse(path, number, line, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
        if cells[0] in found:
            raise InputError.of("colmap.twice", file=path.name, place=place, value=cells[0], kind="camera")
        width, height = (n for n in size if n is not None)
        found[cells[0]] = interior_of(
            cells[1], (width, height), values.tolist(), cells[0], file=path.name, place=place
        )  # fmt: skip
    return found


def _read_images(path: Path, cameras: dict[str, Interior]) -> tuple[tuple[Pose, ...], list[Array]]:
    """Poses and keypoints (k, 3): x, y, point id."""
    lines = read_lines(path)
    poses, keypoints = [], []
    upcoming = iter(enumerate(lines, start=1))
    for number, line in upcoming:
        if not line.strip() or line.startswith("#"):
            continue
        poses.append(_pose(path, number, line, cameras))
        second, text = next(upcoming, (number, ""))
        cells = text.split()
        values = finite(cells)
        if values is None or len(cells) % 3:
            _refuse(path, second, text, "X Y POINT3D_ID of each keypoint")
        keypoints.append(values.reshape(-1, 3))
    return tuple(poses), keypoints


def _pose(path: Path, number: int, line: str, cameras: dict[str, Interior]) -> Pose:
    cells = line.split(maxsplit=9)
    values = finite(cells[1:8])
    if len(cells) < 10 or values is None or abs(np.linalg.norm(values[:4]) - 1.0) > NORM:
        _refuse(path, number, line, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME with a quaternion of length 1")
    if cells[8] not in cameras:
        raise InputError.of(
            "colmap.reference", file=path.name, place=f"line {number}", value=cells[8], kind="camera", other=FILES[0]
        )  # fmt: skip
    rotation = Rotation.from_quat(values[[1, 2, 3, 0]]).as_matrix()
    return Pose(cells[9].strip(), cells[8], rotation, -rotation.T @ values[4:7])


def _read_points(path: Path) -> tuple[Array, Array, int]:
    """Ids (N,), coordinates (N, 3), number of image points of all tracks."""
    content = list(_content(path))
    heads = [line.split(maxsplit=4)[:4] for _, line in content]
    flat = finite([cell for head in heads for cell in head]) if all(len(head) == 4 for head in heads) else None
    counts = [len(line.split()) for _, line in content]
    for (number, line), count, head in zip(content, counts, heads, strict=True):
        if count < 8 or count % 2 or (flat is None and finite(head) is None):
            _refuse(path, number, line, "POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]")
    rows = np.empty((0, 4)) if flat is None else flat.reshape(-1, 4)
    ids, times = np.unique(rows[:, 0], return_counts=True)
    if len(ids) < len(rows):
        again = ids[times > 1][0]
        raise InputError.of("colmap.twice", file=path.name, value=int(again), kind="point")
    return rows[:, 0], rows[:, 1:], (sum(counts) - 8 * len(counts)) // 2


def _positions(ids: Array, wanted: Array, folder: str) -> Index:
    """Place of each wanted id among the ids."""
    order = np.argsort(ids)
    if not len(ids):
        order = np.zeros(0, np.intp)
    at = np.searchsorted(ids, wanted, sorter=order)
    known = at < len(ids)
    known[known] = ids[order[at[known]]] == wanted[known]
    if not known.all():
        value = int(wanted[~known][0])
        raise InputError.of(
            "colmap.reference", file=FILES[1], place=folder, value=value, kind="point", other=FILES[2]
        )  # fmt: skip
    return order[at]


def _refuse(path: Path, number: int, line: str, needed: str) -> NoReturn:
    raise InputError.of("colmap.cells", file=path.name, place=f"line {number}", value=repr(line), needed=needed)


def _content(path: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without comments and blank ones."""
    for number, line in enumerate(read_lines(path), start=1):
        if line.strip() and not line.startswith("#"):
            yield number, line


def write_colmap_text(folder: str | Path, model: FrameModel, *, overwrite: bool = False) -> tuple[str, ...]:
    """Write a model; the folder is made if it is missing. Numbers have all their digits.

    Ids of cameras, images and points count from 1, in the order of the model: names of points and cameras that are
    no numbers are lost.

    Returns
    -------
    tuple of str
        What the files cannot hold, in words.

    Raises
    ------
    InputError
        A file exists, cannot be written, or a name of an image holds a blank: COLMAP would cut it there.
    """
    folder = Path(folder)
    paths = [folder / name for name in FILES]
    require_free(*paths, overwrite=overwrite)
    for pose in model.poses:
        if len(pose.name.split()) != 1:
            raise InputError.of("colmap.cells", file=FILES[1], value=repr(pose.name), needed="a NAME without blanks")
    cameras, lost = _camera_lines(model)
    order = np.lexsort((model.point, model.image))
    place = np.empty(len(order), np.intp)  # of an image point among those of its image
    place[order] = np.arange(len(order)) - np.searchsorted(model.image[order], model.image[order])
    make_folder(folder)
    write_lines(paths[0], ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", *cameras])
    write_lines(paths[1], [*_IMAGE_HEAD, *_image_lines(model, order)])
    write_lines(paths[2], [_POINT_HEAD, *_point_lines(model, place)])
    return lost


_IMAGE_HEAD: Final = (
    "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
    "# X Y POINT3D_ID of each keypoint; (0.5, 0.5) is the centre of the first pixel",
)
_POINT_HEAD: Final = "# POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]"


def _camera_lines(model: FrameModel) -> tuple[list[str], tuple[str, ...]]:
    lines, lost = [], []
    for k, (name, interior) in enumerate(model.cameras.items(), start=1):
        kind, values, error = parameters_of(interior)
        size = f"{interior.n_samples} {interior.n_lines}"
        lines.append(f"{k} {kind} {size} {' '.join(map(repr, values))}")
        if error > 0.0:
            lost.append(f"camera {name}: distortion fitted the other way round, up to {error:.2g} px in the image")
    return lines, tuple(lost)


def _image_lines(model: FrameModel, order: Index) -> Iterator[str]:
    """Two lines of each image; ``order`` sorts the image points by image."""
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
    """Lines of the points with their tracks, grey, and the mean residual as COLMAP states it."""
    order = np.argsort(model.point, kind="stable")
    ends = np.searchsorted(model.point[order], np.arange(len(model.points_m) + 1)).tolist()
    residual = np.linalg.norm(model.residuals_px(), axis=1)[order]
    tokens = [f"{i} {p}" for i, p in zip((model.image[order] + 1).tolist(), place[order].tolist(), strict=True)]
    for k, xyz in enumerate(model.points_m.tolist()):
        first, last = ends[k], ends[k + 1]
        error = float(residual[first:last].mean()) if last > first else float("nan")
        error = error if np.isfinite(error) else -1.0
        yield " ".join([str(k + 1), *map(repr, xyz), "128 128 128", repr(error), *tokens[first:last]])


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the tie points of a model."""
    return model_survey(read_colmap_text(paths[0]))


FORMAT: Final = Format(
    name="colmap-text",
    title="COLMAP text model (folder of cameras.txt, images.txt, points3D.txt)",
    files=("model",),
    first_pixel=(FIRST_PIXEL, FIRST_PIXEL),
    pixel_axes="x column, y row (pixels)",
    ground_axes="local x, y, z (left out)",
    holds=TIES_ONLY,
    read=read,
    read_model=lambda paths, settings: read_colmap_text(paths[0]),
    write_model=lambda out, model, overwrite: write_colmap_text(out, model, overwrite=overwrite),
    evidence="models written by pycolmap 4.2; ours are read by it",
)
