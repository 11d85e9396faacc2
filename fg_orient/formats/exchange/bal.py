"""Files of "Bundle Adjustment in the Large" (Agarwal et al. 2010): frame images, tie points, start values; no control.

A file is text, plain or compressed by gzip or bzip2: number of cameras, points and observations; one observation per
line (camera, point, x, y); nine numbers per camera (rotation vector, translation, f, k1, k2), three per point. Cameras
look along -Z, x runs right and y up from the middle of the image (Snavely et al. 2006). The projection centre is
``-R^T t``. A block of such a file counts pixels from the middle: samples are x and lines -y. A frame model counts them
from the first pixel; the middle of an image of w x h pixels is at ((h - 1) / 2, (w - 1) / 2), for Bundler puts its
lower left corner at (-w/2, -h/2). These files hold neither the principal point nor the size of the images.
"""

from __future__ import annotations

import bz2
import gzip
import hashlib
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from factors.cameras import frame_camera
from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import require_free
from fg_orient.formats.exchange.ties import model_survey
from fg_orient.formats.frame_model import FrameModel, Pose, free_block, in_one_image, in_pixels
from fg_orient.formats.registry import TIES_ONLY, Format, Settings
from fg_orient.model.block import Block, Image, ImagePoints, Source
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.frame import HALF_TURN, IDEAL_TO_MEASURED, FrameCamera, FrameSensor
from fg_orient.sensors.interior import Interior, converted

Array = npt.NDArray[np.float64]

#: Coefficients that the camera model of these files lacks, by the position in ``Interior.distortion``.
_BEYOND: Final = {2: "k3", 3: "p1", 4: "p2"}
N_CAMERA: Final = 9
#: Sigma of an image coordinate: the cost of the block is then that of the literature, in px^2.
SIGMA_PX: Final = 1.0
#: Unknowns of a camera.
UNKNOWN: Final = (
    "rotation_x", "rotation_y", "rotation_z", "centre_x", "centre_y", "centre_z", "focal", "k1", "k2",
)  # fmt: skip
#: More than this of anything is no bundle of this world, but a damaged file.
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

    There are no priors and the datum is free; Levenberg-Marquardt; sigma 1 px. Points measured in one image
    only, once or more, are left out: nothing determines their depth.

    Parameters
    ----------
    path : str or Path
    keep_behind : bool
        Keep points whose start values lie behind one of their cameras. The equation holds there as well, but no
        camera sees backwards. Programs differ: Ceres keeps them; GTSAM's ``GeneralSFMFactor`` lets their residuals
        count as zero, so that a cost of GTSAM belongs to False.

    Raises
    ------
    InputError
        The file cannot be read, is truncated or damaged: with the line of the first fault.
    """
    raw, sha256 = _read(Path(path))
    data = _parse(raw, Path(path).name)
    return bal_block(data, Path(path).name, (Source(str(path), sha256),), keep_behind=keep_behind)


def read_bal_data(path: str | Path) -> BalData:
    """Read a file into arrays, as it stands.

    Raises
    ------
    InputError
        See :func:`read_bal`.
    """
    return _parse(_read(Path(path))[0], Path(path).name)


def bal_block(data: BalData, name: str, sources: tuple[Source, ...] = (), *, keep_behind: bool = True) -> Block:
    """Make the block of a file's numbers; see :func:`read_bal`."""
    cameras = cameras_of(data)
    behind = np.zeros(len(data.points), bool)
    behind[data.point[_depths(data, cameras) <= 0.0]] = True
    alone = in_one_image(data.camera, data.point, len(data.points))
    rows = ~(alone | behind & (not keep_behind))[data.point]
    x, y = data.xy[rows].T
    sigma = np.full(len(x), SIGMA_PX)
    observations = ImagePoints(data.camera[rows], data.point[rows], -y, x, sigma, sigma)
    half = math.ceil(float(np.abs(data.xy).max(initial=0.0)))
    images = tuple(
        Image(str(k), FrameSensor(
            camera, 2 * half + 1, 2 * half + 1, first_line=-half, first_sample=-half, georeferenced=False, file=name,
        ))
        for k, camera in enumerate(cameras)
    )  # fmt: skip
    left_out = (("points.alone", int(alone.sum())), ("points.behind", int(behind.sum())))
    notes = tuple(finding(code, n=n) for code, n in left_out if n)
    return free_block(name, images, tuple(map(str, range(len(data.points)))), data.points, observations, sources, notes)


def _depths(data: BalData, cameras: list[FrameCamera]) -> Array:
    """Depth (n,) of the start value of each measured point in its camera."""
    view = np.array([camera.rotation[2] for camera in cameras])
    centre = np.array([camera.centre_m for camera in cameras])
    depth: Array = np.einsum("ni,ni->n", view[data.camera], data.points[data.point] - centre[data.camera])
    return depth


def cameras_of(data: BalData) -> list[FrameCamera]:
    """The cameras of a file as those of ``fg_orient.sensors.frame``."""
    rotations, centres = np.empty((len(data.cameras), 3, 3)), np.empty((len(data.cameras), 3))
    for k, row in enumerate(data.cameras):
        theirs = frame_camera.rotated(np.eye(3), row)
        rotations[k], centres[k] = HALF_TURN @ theirs, -theirs.T @ row[3:6]
    return [
        _scaled(FrameCamera(rotation, centre, row[6], distortion=np.array([row[7], row[8], 0.0, 0.0, 0.0])), data, k)
        for k, (rotation, centre, row) in enumerate(zip(rotations, centres, data.cameras, strict=True))
    ]


def _scaled(camera: FrameCamera, data: BalData, k: int) -> FrameCamera:
    """Camera with the unknowns of the literature."""
    own = np.flatnonzero(data.camera == k)
    return in_pixels(camera, UNKNOWN, -data.xy[own, 1], data.xy[own, 0], data.points[data.point[own]])


def _read(path: Path) -> tuple[bytes, str]:
    """Content of a file, decompressed as its first bytes tell, and the SHA-256 of the file."""
    try:
        raw = path.read_bytes()
        sha256 = hashlib.sha256(raw).hexdigest()
        if raw[:2] == b"\x1f\x8b":
            return gzip.decompress(raw), sha256
        return (bz2.decompress(raw) if raw[:3] == b"BZh" else raw), sha256
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError.of("bal.unreadable", file=path.name, value=error) from None


def _parse(raw: bytes, file: str) -> BalData:
    """Numbers of a file; on any fault the line is looked for."""
    tokens = raw.split()
    try:
        n_cameras, n_points, n = (_whole(token) for token in tokens[:3])
    except ValueError:
        raise InputError.of("bal.header", file=file, place="line 1", value=_shown(raw)) from None
    if not (0 < n_cameras <= LARGEST and 0 < n_points <= LARGEST and 0 < n <= LARGEST):
        raise InputError.of("bal.header", file=file, place="line 1", value=f"{n_cameras} {n_points} {n}")
    expected = 3 + 4 * n + N_CAMERA * n_cameras + 3 * n_points
    if len(tokens) != expected:
        place = f"line {raw.count(10) + 1}"
        raise InputError.of("bal.count", file=file, place=place, value=f"{len(tokens)} numbers", expected=expected)
    values = _numbers(raw, tokens, file)
    if not np.isfinite(values).all():
        _refuse(raw, file, 3 + int(np.flatnonzero(~np.isfinite(values))[0]), "bal.number")
    observed = values[: 4 * n].reshape(n, 4)
    limits = np.array([n_cameras, n_points])
    bad = np.argwhere((observed[:, :2] < 0) | (observed[:, :2] >= limits) | (observed[:, :2] % 1 != 0))
    if len(bad):
        _refuse(raw, file, 3 + 4 * int(bad[0, 0]) + int(bad[0, 1]), "bal.index", last=int(limits[bad[0, 1]]) - 1)
    cameras = values[4 * n : 4 * n + N_CAMERA * n_cameras].reshape(-1, N_CAMERA)
    short = np.flatnonzero(cameras[:, 6] <= 0.0)
    if len(short):
        _refuse(raw, file, 3 + 4 * n + N_CAMERA * int(short[0]) + 6, "bal.focal")
    index = observed[:, :2].astype(np.intp)
    points = values[-3 * n_points :].reshape(-1, 3).copy()
    return BalData(index[:, 0], index[:, 1], observed[:, 2:].copy(), cameras.copy(), points)


def _whole(token: bytes) -> int:
    """Whole number of digits alone; ValueError for others (``int`` would take 1_0 for 10)."""
    if not token.lstrip(b"-").isdigit():
        raise ValueError(token)
    return int(token)


def _numbers(raw: bytes, tokens: list[bytes], file: str) -> Array:
    """Numbers behind the header."""
    if b"_" not in raw:  # numpy would take 1_0 for 10
        try:
            return np.array(tokens[3:], dtype=np.float64)
        except ValueError:
            pass
    _refuse(raw, file, next(k for k in range(3, len(tokens)) if not _is_number(tokens[k])), "bal.number")


def _is_number(token: bytes) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return b"_" not in token


def _refuse(raw: bytes, file: str, wrong: int, code: str, **fields: object) -> NoReturn:
    """Refuse a number by its place among all, with its line.

    Raises
    ------
    InputError
        Always.
    """
    seen = 0
    for line, text in enumerate(raw.split(b"\n"), start=1):
        parts = text.split()
        if wrong < seen + len(parts):
            raise InputError.of(code, file=file, place=f"line {line}", value=_shown(parts[wrong - seen]), **fields)
        seen += len(parts)
    raise AssertionError("the number stands in the file")


def _shown(raw: bytes) -> str:
    """First line of some bytes as text."""
    return raw.split(b"\n", 1)[0][:60].decode("ascii", "replace")


# --- frame models --------------------------------------------------------------------------------


def frame_model_of(
    data: BalData, names: Sequence[str] | None = None, sizes: Sequence[tuple[int, int]] | None = None,
    notes: tuple[Finding, ...] = (),
) -> FrameModel:  # fmt: skip
    """Give a file's numbers as a frame model; each image has a camera of its own.

    Parameters
    ----------
    data : BalData
    names : sequence of str, optional
        Of the images; else they are counted from 0.
    sizes : sequence of (n_lines, n_samples), optional
        Of the images; else all are as large as the outermost image point of all demands, and square.
    notes : tuple of Finding
    """
    n = len(data.cameras)
    size = np.array(sizes if sizes is not None else [(assumed_side(data),) * 2] * n, int).reshape(n, 2)
    middle = (size - 1) / 2.0
    found = cameras_of(data)
    keys = tuple(names) if names is not None else tuple(map(str, range(n)))
    cameras = {
        key: Interior(int(size[k, 0]), int(size[k, 1]), camera.focal_px, middle[k], camera.distortion, name=key)
        for k, (key, camera) in enumerate(zip(keys, found, strict=True))
    }
    poses = tuple(Pose(key, key, c.rotation, c.centre_m) for key, c in zip(keys, found, strict=True))
    line, sample = middle[data.camera, 0] - data.xy[:, 1], middle[data.camera, 1] + data.xy[:, 0]
    ids = tuple(map(str, range(len(data.points))))
    return FrameModel(cameras, poses, ids, data.points, data.camera, data.point, line, sample, notes)


def assumed_side(data: BalData) -> int:
    """Side of the square that holds all image points about its middle, px: an odd number."""
    return 2 * math.ceil(float(np.abs(data.xy).max(initial=0.0))) + 1


def bal_data_of(model: FrameModel, file: str = "") -> tuple[BalData, tuple[str, ...]]:
    """Give a frame model in the conventions of these files; pixels are counted from the principal point.

    Returns
    -------
    data : BalData
    lost : tuple of str
        What they cannot hold, in words.

    Raises
    ------
    InputError
        A camera has k3, p1 or p2.
    """
    rows, turned = [], {}
    lost = ["names of images, points and cameras; sizes of images; principal points"]
    for name, interior in model.cameras.items():
        conversion = converted(interior, IDEAL_TO_MEASURED)
        turned[name] = own = conversion.interior
        beyond = {text: own.distortion[k] for k, text in _BEYOND.items() if own.distortion[k] != 0.0}
        if beyond:
            value = " ".join(f"{text} {number:g}" for text, number in beyond.items())
            raise InputError.of("bundle.camera", file=file, place=f"camera {name}", value=value)
        if conversion.max_px > 0.0:
            lost.append(f"camera {name}: distortion fitted the other way round, up to {conversion.max_px:.2g} px")
    for pose in model.poses:
        own, theirs = turned[pose.camera], HALF_TURN @ pose.rotation
        rotation = Rotation.from_matrix(theirs).as_rotvec()
        rows.append([*rotation, *(-theirs @ pose.centre_m), own.focal_px, *own.distortion[:2]])
    principal = np.array([turned[pose.camera].principal_px for pose in model.poses]).reshape(-1, 2)[model.image]
    xy = np.column_stack([model.sample - principal[:, 1], principal[:, 0] - model.line])
    return BalData(model.image, model.point, xy, np.array(rows).reshape(-1, 9), model.points_m), tuple(lost)


def write_bal(path: str | Path, data: BalData, *, overwrite: bool = False) -> None:
    """Write a file; compressed if its name ends with .gz or .bz2. Numbers have all their digits.

    Raises
    ------
    InputError
        The file exists, or cannot be written.
    """
    path = Path(path)
    require_free(path, overwrite=overwrite)
    seen = zip(data.camera.tolist(), data.point.tolist(), data.xy.tolist(), strict=True)
    lines = [f"{len(data.cameras)} {len(data.points)} {len(data.xy)}"]
    lines += (f"{c} {p} {x!r} {y!r}" for c, p, (x, y) in seen)
    lines += map(repr, data.cameras.ravel().tolist())
    lines += map(repr, data.points.ravel().tolist())
    raw = "\n".join([*lines, ""]).encode()
    if path.suffix == ".gz":
        raw = gzip.compress(raw, mtime=0)
    write_bytes(path, bz2.compress(raw) if path.suffix == ".bz2" else raw)


def sized_model(data: BalData, names: Sequence[str], settings: Settings, notes: tuple[Finding, ...] = ()) -> FrameModel:
    """Frame model of a bundle with the sizes of the settings; a note tells those that had to be assumed."""
    side = assumed_side(data)
    without = [name for name in names if name not in settings.image_sizes]
    if without:
        notes = (*notes, finding("points.sizes_assumed", side=side, images=without))
    return frame_model_of(data, names, [settings.image_sizes.get(name, (side, side)) for name in names], notes)


def bundle_survey(
    data: BalData, names: Sequence[str], settings: Settings, notes: tuple[Finding, ...], file: str
) -> Survey:
    """Tie points of a bundle; the sizes of its images are those of the settings.

    Raises
    ------
    InputError
        The size of an image is not given: nothing else tells where the first pixel is.
    """
    settings.require_images(names, file)
    for name in names:
        if name not in settings.image_sizes:
            raise InputError.of("ties.size", file=file, place=name)
    return model_survey(sized_model(data, names, settings, notes))


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the tie points of a file; its images are named by numbers from 0."""
    data = read_bal_data(paths[0])
    return bundle_survey(data, tuple(map(str, range(len(data.cameras)))), settings, (), paths[0].name)


def read_model(paths: tuple[Path, ...], settings: Settings) -> FrameModel:
    """Read a whole file."""
    data = read_bal_data(paths[0])
    return sized_model(data, tuple(map(str, range(len(data.cameras)))), settings)


def write_model(out: Path, model: FrameModel, overwrite: bool) -> tuple[str, ...]:
    """Write a whole file."""
    data, lost = bal_data_of(model, out.name)
    write_bal(out, data, overwrite=overwrite)
    return lost


FORMAT: Final = Format(
    name="bal",
    title="Bundle Adjustment in the Large",
    files=("bundle",),
    pixel_axes="x right, y up from the middle of the image (pixels)",
    ground_axes="local x, y, z (left out)",
    holds=TIES_ONLY,
    read=read,
    read_model=read_model,
    write_model=write_model,
    evidence="the published problem Ladybug 49",
)
