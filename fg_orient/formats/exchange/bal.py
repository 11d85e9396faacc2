"""Files of "Bundle Adjustment in the Large" (Agarwal et al. 2010): frame images, tie points, start values; no control.

A file is text, plain or compressed by gzip or bzip2: number of cameras, points and observations; one observation per
line (camera, point, x, y); nine numbers per camera (rotation vector, translation, f, k1, k2), three per point. Cameras
look along -Z, x runs right and y up from the middle of the image (Snavely et al. 2006). The projection centre is
``-R^T t``. A block of such a file counts pixels from the middle: samples are x and lines -y. A frame model counts them
from the first pixel; the middle of an image of w x h pixels is at ((h - 1) / 2, (w - 1) / 2), because the lower left
corner is at (-w/2, -h/2) in Bundler. These files contain neither the principal point nor the size of the images.

Bundler's files (``bundle.out``, v0.3) have the same camera model, rotations as matrices, a colour of each point, and
zeros for images without orientation. The list of images is another file: one name per line, in the order of the bundle.
"""

from __future__ import annotations

import bz2
import gzip
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from factors.cameras import frame_camera
from fg_orient.formats.atomic import require_free_files, write_bytes
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import TextLines, read_packed, whole
from fg_orient.formats.exchange.ties import model_survey
from fg_orient.formats.frame_model import FrameModel, Pose, frame_block
from fg_orient.formats.registry import TIES_ONLY, Format, Settings
from fg_orient.formats.tables import finite, sha256_of
from fg_orient.model.block import Block, Source
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.frame import HALF_TURN, IDEAL_TO_MEASURED, ORTHONORMAL, away_from_rotation, not_a_rotation
from fg_orient.sensors.interior import Interior, converted

Array = npt.NDArray[np.float64]

#: Coefficients that the camera model of these files lacks, by the position in ``Interior.distortion``.
_BEYOND: Final = {2: "k3", 3: "p1", 4: "p2"}
N_CAMERA: Final = 9
#: Unknowns of a camera.
UNKNOWN: Final = (
    "rotation_x", "rotation_y", "rotation_z", "centre_x", "centre_y", "centre_z", "focal", "k1", "k2",
)  # fmt: skip
#: A count above this is that of a damaged file.
LARGEST: Final = 10**9


@dataclass(frozen=True, eq=False)
class BalData:
    """Contents of a file, in its own conventions.

    Parameters
    ----------
    camera, point : (n,) int arrays
    xy : (n, 2) array, px
    cameras : (M, 9) array
        Rotation vector (rad), translation, f (px), k1, k2.
    points : (N, 3) array
    """

    camera: npt.NDArray[np.intp]
    point: npt.NDArray[np.intp]
    xy: Array
    cameras: Array
    points: Array


def read_bal(path: str | Path, *, keep_behind: bool = True) -> Block:
    """Read a file as a block in a local system, with the options to adjust it as the literature does.

    There are no priors and the datum is free; Levenberg-Marquardt; sigma 1 px: the cost is then that of the literature,
    in px^2. Points measured in one image only, once or more, are left out: nothing determines their depth.

    Parameters
    ----------
    path : str or Path
    keep_behind : bool
        Keep points whose start values lie behind one of their cameras. The equation holds there as well, but no
        camera sees backwards. Programs differ: Ceres keeps them. GTSAM's ``GeneralSFMFactor`` counts their residuals
        as zero, so that a cost of GTSAM corresponds to False.

    Raises
    ------
    InputError
        The file cannot be read, is truncated or damaged: with the line of the first fault.
    """
    path = Path(path)
    model = frame_model_of(read_bal_data(path), from_middle=True)
    source = Source(str(path), sha256_of(path))
    return frame_block(model, path.name, (source,), unknowns=UNKNOWN, keep_behind=keep_behind)


def read_bal_data(path: str | Path) -> BalData:
    """Read the numbers of a file into arrays; errors as in :func:`read_bal`."""
    return _parse(read_packed(Path(path), "bal.unreadable"), Path(path).name)


def _parse(raw: bytes, file: str) -> BalData:
    text = raw.decode("ascii", "replace")
    tokens = text.split()
    counts = [whole(token) for token in tokens[:3]]
    m, n_points, n = (count or LARGEST + 1 for count in (*counts, *(None,) * (3 - len(counts))))
    if max(m, n_points, n) > LARGEST:
        raise InputError.of("bal.header", file=file, place="line 1", value=text.split("\n", 1)[0][:60])
    expected = 3 + 4 * n + N_CAMERA * m + 3 * n_points
    if len(tokens) != expected:
        place = f"line {raw.count(10) + 1}"
        raise InputError.of("bal.count", file=file, place=place, value=f"{len(tokens)} numbers", expected=expected)
    values = finite(tokens[3:])
    if values is None:
        _refuse(text, file, next(k for k in range(3, expected) if finite(tokens[k : k + 1]) is None), "bal.number")
    observed = values[: 4 * n].reshape(n, 4)
    limits = np.array([m, n_points])
    bad = np.argwhere((observed[:, :2] < 0) | (observed[:, :2] >= limits) | (observed[:, :2] % 1 != 0))
    if len(bad):
        _refuse(text, file, 3 + 4 * int(bad[0, 0]) + int(bad[0, 1]), "bal.index", last=int(limits[bad[0, 1]]) - 1)
    cameras = values[4 * n : 4 * n + N_CAMERA * m].reshape(-1, N_CAMERA)
    short = np.flatnonzero(cameras[:, 6] <= 0.0)
    if len(short):
        _refuse(text, file, 3 + 4 * n + N_CAMERA * int(short[0]) + 6, "bal.focal")
    index = observed[:, :2].astype(np.intp)
    points = values[-3 * n_points :].reshape(-1, 3).copy()
    return BalData(index[:, 0], index[:, 1], observed[:, 2:].copy(), cameras.copy(), points)


def _refuse(text: str, file: str, wrong: int, code: str, **fields: object) -> NoReturn:
    """Raise InputError for a number, given by its position among all numbers, with its line."""
    for line, row in enumerate(text.split("\n"), start=1):
        cells = row.split()
        if wrong < len(cells):
            raise InputError.of(code, file=file, place=f"line {line}", value=cells[wrong][:60], **fields)
        wrong -= len(cells)
    raise AssertionError("the file contains the number")


# --- frame models --------------------------------------------------------------------------------


def frame_model_of(
    data: BalData, names: Sequence[str] | None = None, sizes: Sequence[tuple[int, int] | None] | None = None,
    notes: tuple[Finding, ...] = (), *, from_middle: bool = False,
) -> FrameModel:  # fmt: skip
    """Convert the numbers of a file to a frame model; each image has its own camera.

    Parameters
    ----------
    data : BalData
    names : sequence of str, optional
        Names of the images; default: counted from 0.
    sizes : sequence of (n_lines, n_samples) or None, optional
        Sizes of the images. An image without one becomes the square that contains the outermost image point of all
        images; a note names these images.
    notes : tuple of Finding
    from_middle : bool
        Count the pixels from the middle of the images; no note on sizes.
    """
    n, side = len(data.cameras), assumed_side(data)
    keys = tuple(names) if names is not None else tuple(map(str, range(n)))
    given = dict(zip(keys, sizes or (None,) * n, strict=True))
    assumed = [key for key, size in given.items() if size is None and not from_middle]
    if assumed:
        notes = (*notes, finding("points.sizes_assumed", side=side, images=assumed))
    size = np.array([given[key] or (side, side) for key in keys], int).reshape(n, 2)
    middle = np.zeros((n, 2)) if from_middle else (size - 1) / 2.0
    cameras, poses = {}, []
    for k, (key, row) in enumerate(zip(keys, data.cameras, strict=True)):
        theirs, distortion = frame_camera.rotated(np.eye(3), row), np.array([row[7], row[8], 0.0, 0.0, 0.0])
        cameras[key] = Interior(int(size[k, 0]), int(size[k, 1]), row[6], middle[k], distortion, name=key)
        poses.append(Pose(key, key, HALF_TURN @ theirs, -theirs.T @ row[3:6]))
    line, sample = middle[data.camera, 0] - data.xy[:, 1], middle[data.camera, 1] + data.xy[:, 0]
    ids = tuple(map(str, range(len(data.points))))
    return FrameModel(
        cameras, tuple(poses), ids, data.points, data.camera, data.point, line, sample, notes, from_middle
    )  # fmt: skip


def assumed_side(data: BalData) -> int:
    """Side of the square that contains all image points about its middle, px: an odd number."""
    return 2 * math.ceil(float(np.abs(data.xy).max(initial=0.0))) + 1


def bal_data_of(model: FrameModel, file: str = "") -> tuple[BalData, tuple[str, ...]]:
    """Convert a frame model to the conventions of these files; pixels are counted from the principal point.

    Returns
    -------
    data : BalData
    lost : tuple of str
        Information that they cannot hold, in words.

    Raises
    ------
    InputError
        A camera has k3, p1 or p2.
    """
    rows, fitted = [], {}
    lost = ["names of images, points and cameras; sizes of images; principal points"]
    for name, interior in model.cameras.items():
        conversion = converted(interior, IDEAL_TO_MEASURED)
        fitted[name] = own = conversion.interior
        beyond = {text: own.distortion[k] for k, text in _BEYOND.items() if own.distortion[k] != 0.0}
        if beyond:
            value = " ".join(f"{text} {number:g}" for text, number in beyond.items())
            raise InputError.of("bundle.camera", file=file, place=f"camera {name}", value=value)
        if conversion.max_px > 0.0:
            lost.append(f"camera {name}: distortion fitted the other way round, up to {conversion.max_px:.2g} px")
    for pose in model.poses:
        own, theirs = fitted[pose.camera], HALF_TURN @ pose.rotation
        rotation = Rotation.from_matrix(theirs).as_rotvec()
        rows.append([*rotation, *(-theirs @ pose.centre_m), own.focal_px, *own.distortion[:2]])
    principal = np.array([fitted[pose.camera].principal_px for pose in model.poses]).reshape(-1, 2)[model.image]
    xy = np.column_stack([model.sample - principal[:, 1], principal[:, 0] - model.line])
    return BalData(model.image, model.point, xy, np.array(rows).reshape(-1, 9), model.points_m), tuple(lost)


def write_bal(path: str | Path, data: BalData, *, overwrite: bool = False) -> None:
    """Write a file with all digits, compressed if its name ends with .gz or .bz2; InputError if it exists."""
    path = Path(path)
    require_free_files(path, overwrite=overwrite)
    seen = zip(data.camera.tolist(), data.point.tolist(), data.xy.tolist(), strict=True)
    lines = [f"{len(data.cameras)} {len(data.points)} {len(data.xy)}"]
    lines += (f"{c} {p} {x!r} {y!r}" for c, p, (x, y) in seen)
    lines += map(repr, data.cameras.ravel().tolist())
    lines += map(repr, data.points.ravel().tolist())
    raw = "\n".join([*lines, ""]).encode()
    if path.suffix == ".gz":
        raw = gzip.compress(raw, mtime=0)
    write_bytes(path, bz2.compress(raw) if path.suffix == ".bz2" else raw)


def bundle_format(
    load: Callable[[tuple[Path, ...]], tuple[BalData, Sequence[str], tuple[Finding, ...]]],
    save: Callable[..., None], **fields: Any,
) -> Format:  # fmt: skip
    """Registration record of a format with the numbers of BAL.

    Parameters
    ----------
    load : callable
        Files to numbers, names of the images and notes.
    save : callable
        Writes numbers to a file; ``overwrite`` is True to replace an existing file.
    **fields
        Further fields of the record.
    """

    def read_model(paths: tuple[Path, ...], settings: Settings) -> FrameModel:
        data, names, notes = load(paths)
        return frame_model_of(data, names, [settings.image_sizes.get(name) for name in names], notes)

    def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
        model = read_model(paths, settings)
        names = [pose.name for pose in model.poses]
        settings.require_images(names, paths[0].name)
        for name in names:
            if name not in settings.image_sizes:  # without the size the first pixel is unknown
                raise InputError.of("ties.size", file=paths[0].name, place=name)
        return model_survey(model)

    def write_model(out: Path, model: FrameModel, overwrite: bool) -> tuple[str, ...]:
        data, lost = bal_data_of(model, out.name)
        save(out, data, overwrite=overwrite)
        return lost

    return Format(
        pixel_axes="x right, y up from the middle of the image (pixels)", ground_axes="local x, y, z (left out)",
        holds=TIES_ONLY, read=read, read_model=read_model, write_model=write_model, **fields,
    )  # fmt: skip


def _load(paths: tuple[Path, ...]) -> tuple[BalData, list[str], tuple[Finding, ...]]:
    data = read_bal_data(paths[0])
    return data, list(map(str, range(len(data.cameras)))), ()


FORMAT: Final = bundle_format(
    _load, write_bal, name="bal", title="Bundle Adjustment in the Large", files=("bundle",),
    evidence="the published problem Ladybug 49",
)  # fmt: skip


# --- Bundler -------------------------------------------------------------------------------------

HEAD: Final = "# Bundle file v0.3"


def read_bundler(path: str | Path) -> tuple[BalData, tuple[int, ...], tuple[Finding, ...]]:
    """Read a file; images without orientation are left out.

    Returns
    -------
    data : BalData
    images : tuple of int
        Position in the file (and in Bundler's list of images) of each image kept, from 0.
    notes : tuple of Finding

    Raises
    ------
    InputError
        The file cannot be read, is of another version, truncated or damaged: with the line.
    """
    path = Path(path)
    text = TextLines(path)
    lines = text.lines
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines or lines[0].strip() != HEAD:
        text.refuse(1, HEAD)
    rows = [(n, line.split()) for n, line in enumerate(lines, start=1)]
    counts = text.numbers(rows[1:2] or [(2, [])], 2, "numbers of cameras and points")[0]
    if (counts % 1 != 0).any() or (counts < 0).any():
        text.refuse(2, "numbers of cameras and points")
    n_cameras, n_points = counts.astype(int).tolist()
    first = 2 + 5 * n_cameras
    expected = first + 3 * n_points
    if len(lines) != expected:
        raise InputError.of("bundle.lines", file=path.name, value=f"{len(lines)} lines", expected=expected)
    cameras = text.numbers(rows[2:first], 3, "three numbers").reshape(-1, 15)
    kept = cameras[:, 0] > 0.0
    own = _camera_rows(text, cameras, kept)
    points = text.numbers(rows[first::3], 3, "three numbers")
    views, count = _views(text, rows[first + 2 :: 3], n_cameras)
    image, point = views[:, 0].astype(np.intp), np.repeat(np.arange(n_points), count)
    seen = kept[image]
    number = np.cumsum(kept) - 1
    data = BalData(number[image[seen]], point[seen], views[seen, 2:].copy(), own, points)
    n_out = int((~kept).sum())
    notes = (finding("points.images_left_out", n=n_out),) if n_out else ()
    return data, tuple(np.flatnonzero(kept).tolist()), notes


def _camera_rows(text: TextLines, cameras: Array, kept: npt.NDArray[np.bool_]) -> Array:
    """Rows of BAL (rotation vector, translation, f, k1, k2) of the images that are kept."""
    own = cameras[kept]
    rotation = own[:, 3:12].reshape(-1, 3, 3)
    away = away_from_rotation(rotation)
    bad = np.flatnonzero(away > ORTHONORMAL)
    if len(bad):
        line = 4 + 5 * int(np.flatnonzero(kept)[bad[0]])
        text.refuse(line, "a rotation", not_a_rotation(float(away[bad[0]])))
    vector = Rotation.from_matrix(rotation).as_rotvec() if len(own) else np.empty((0, 3))
    return np.column_stack([vector, own[:, 12:15], own[:, :3]])


def _views(
    text: TextLines, rows: Sequence[tuple[int, list[str]]], n_cameras: int
) -> tuple[Array, npt.NDArray[np.intp]]:
    """Camera, key, x, y (n, 4) of all image points, and the number of image points of each point."""
    needed = "the number of views, then camera, key, x, y of each"
    for number, cells in rows:
        if len(cells) % 4 != 1 or cells[0] != str(len(cells) // 4):
            text.refuse(number, needed)
    views = text.numbers([(n, cells[k : k + 4]) for n, cells in rows for k in range(1, len(cells), 4)], 4, needed)
    count = np.array([len(cells) // 4 for _, cells in rows], np.intp)
    bad = np.flatnonzero((views[:, 0] % 1 != 0) | (views[:, 0] < 0) | (views[:, 0] >= n_cameras))
    if len(bad):
        text.refuse(rows[int(np.searchsorted(np.cumsum(count), bad[0], side="right"))][0], needed)
    return views, count


def write_bundler(path: str | Path, data: BalData, *, overwrite: bool = False) -> None:
    """Write a file of v0.3; points are grey, keys count the image points of an image. InputError if it exists."""
    path = Path(path)
    require_free_files(path, overwrite=overwrite)
    lines = [HEAD, f"{len(data.cameras)} {len(data.points)}"]
    for row in data.cameras:
        matrix = Rotation.from_rotvec(row[:3]).as_matrix()
        lines += (" ".join(map(repr, three.tolist())) for three in (row[6:], *matrix, row[3:6]))
    order = np.argsort(data.point, kind="stable")
    ends = np.searchsorted(data.point[order], np.arange(len(data.points) + 1)).tolist()
    by_image = np.argsort(data.camera, kind="stable")
    key = np.empty(len(order), np.intp)
    key[by_image] = np.arange(len(order)) - np.searchsorted(data.camera[by_image], data.camera[by_image])
    seen = zip(data.camera[order].tolist(), key[order].tolist(), data.xy[order].tolist(), strict=True)
    views = [f"{c} {k} {x!r} {y!r}" for c, k, (x, y) in seen]
    for k, xyz in enumerate(data.points.tolist()):
        own = views[ends[k] : ends[k + 1]]
        lines += [" ".join(map(repr, xyz)), "128 128 128", " ".join([str(len(own)), *own])]
    write_bytes(path, "\n".join([*lines, ""]).encode())


def _named(paths: tuple[Path, ...]) -> tuple[BalData, list[str], tuple[Finding, ...]]:
    """Numbers of a file, names of its images (from the list, else numbers from 0) and notes."""
    data, images, notes = read_bundler(paths[0])
    names = [str(k) for k in images]
    if len(paths) > 1:
        listed = [line.split()[0] for line in TextLines(paths[1]).lines if line.strip()]
        if images and images[-1] >= len(listed):
            raise InputError.of("bundle.list", file=paths[1].name, value=f"{len(listed)} names", last=images[-1] + 1)
        names = [listed[k] for k in images]
    return data, names, notes


BUNDLER: Final = bundle_format(
    _named, write_bundler, name="bundler", title="Bundler (bundle.out, v0.3)", suffixes=(".out",),
    files=("bundle", "list"),
)  # fmt: skip
