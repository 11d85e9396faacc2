"""Files of "Bundle Adjustment in the Large" (Agarwal et al. 2010).

The files contain frame images, tie points and start values, but no control. A file is
text, which may be compressed by gzip or bzip2. It begins with the numbers of cameras,
points and observations. Each observation is one line (camera, point, x, y). Each camera
has nine numbers (rotation vector, translation, f, k1, k2), and each point has three. A
block of such a file counts pixels from the middle of the image: samples are x, and lines
are -y.

Cameras look along -Z. From the middle of the image, x points right and y points up
(Snavely et al. 2006). The projection centre is ``-R^T t``. A frame model counts pixels
from the first pixel. The middle of an image of w x h pixels is then at ((h - 1) / 2, (w -
1) / 2), because Bundler has the lower left corner at (-w/2, -h/2). The files contain
neither the principal point nor the size of the images.
"""

from __future__ import annotations

import bz2
import gzip
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from factors.arrays import Array, Index
from factors.cameras import frame_camera
from fg_orient.formats.atomic import outputs, require_free_files, write_bytes
from fg_orient.formats.columns import finite
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import read_packed, whole
from fg_orient.formats.exchange.ties import model_format, model_survey
from fg_orient.formats.frame_model import FrameModel, Pose, frame_block
from fg_orient.formats.registry import Format, Settings
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.block import Block, Source
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.frame import HALF_TURN, IDEAL_TO_MEASURED
from fg_orient.sensors.interior import Interior, converted

#: Coefficients that the camera model of these files does not have, by their position in ``Interior.distortion``.
_BEYOND: Final = {2: "k3", 3: "p1", 4: "p2"}


#: Maximum distance of an image point from the middle of its image.
FARTHEST_PX: Final = 1e9


@dataclass(frozen=True, eq=False)
class BalData:
    """Contents of a file, in the conventions of the file.

    Parameters
    ----------
    camera, point : (n,) int arrays
    xy : (n, 2) array, px
    cameras : (M, 9) array
        Rotation vector (rad), translation, f (px), k1, k2.
    points : (N, 3) array
    """

    camera: Index
    point: Index
    xy: Array
    cameras: Array
    points: Array


def frame_model_of(
    data: BalData, names: Sequence[str] | None = None, sizes: Sequence[tuple[int, int] | None] | None = None,
    notes: tuple[Finding, ...] = (), *, from_middle: bool = False,
) -> FrameModel:  # fmt: skip
    """Convert the numbers of a file to a frame model; each image has its own camera.

    Parameters
    ----------
    data : BalData
    names : sequence of str, optional
        Names of the images; by default, they are numbered from 0.
    sizes : sequence of (n_lines, n_samples) or None, optional
        Sizes of the images. If a size is missing, the image is assumed to be the square
        that contains the outermost image point of all images. A note names these images.
    notes : tuple of Finding
    from_middle : bool
        Count the pixels from the middle of the images; then there is no note on sizes.
    """
    n, side = len(data.cameras), assumed_side(data)
    keys = tuple(names) if names is not None else tuple(map(str, range(n)))
    given = {key: size for key, size in zip(keys, sizes or (None,) * n, strict=True) if size}
    found, assumed = sizes_of(keys, given, side)
    notes = notes if from_middle else (*notes, *assumed)
    size = np.array(found, int).reshape(n, 2)
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
    )


def sizes_of(
    names: Sequence[str], given: Mapping[str, tuple[int, int]], side: int
) -> tuple[list[tuple[int, int]], tuple[Finding, ...]]:
    """Return the lines and samples of each image, and a note.

    Images without a given size are squares with this side, px; the note names them.
    """
    assumed = [name for name in names if name not in given]
    notes = (finding("points.sizes_assumed", side=side, images=assumed),) if assumed else ()
    return [given.get(name, (side, side)) for name in names], notes


def assumed_side(data: BalData) -> int:
    """Return the side of a square about the middle that contains all image points: an odd number of pixels."""
    return 2 * math.ceil(float(np.abs(data.xy).max(initial=0.0))) + 1


def bal_data_of(model: FrameModel, file: str = "") -> tuple[BalData, tuple[str, ...]]:
    """Convert a frame model to the conventions of these files; pixels are counted from the principal point.

    Returns
    -------
    data : BalData
    lost : tuple of str
        Information that the files cannot contain, in words.

    Raises
    ------
    InputError
        A camera has a coefficient k3, p1 or p2.
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


def bundle_format(
    load: Callable[[tuple[Path, ...]], tuple[BalData, Sequence[str], tuple[Finding, ...]]],
    save: Callable[..., None], **fields: Any,
) -> Format:  # fmt: skip
    """Make the registry record of a format that contains the same numbers as BAL.

    Parameters
    ----------
    load : callable
        Function that reads the files and returns numbers, names of the images and notes.
    save : callable
        Function that writes numbers to a file. If its argument ``overwrite`` is True, it
        replaces an existing file.
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
            if name not in settings.image_sizes:  # without the size, the first pixel is unknown
                raise InputError.of("ties.size", file=paths[0].name, place=name)
        return model_survey(model)

    def write_model(out: Path, model: FrameModel, overwrite: bool) -> tuple[str, ...]:
        data, lost = bal_data_of(model, out.name)
        save(out, data, overwrite=overwrite)
        return lost

    axes = "x right, y up from the middle of the image (pixels)"
    return model_format(read_model, read=read, write_model=write_model, pixel_axes=axes, **fields)


N_CAMERA: Final = 9
#: Unknowns of each camera.
UNKNOWN: Final = (
    "rotation_x", "rotation_y", "rotation_z", "centre_x", "centre_y", "centre_z", "focal", "k1", "k2",
)  # fmt: skip
#: A larger number of cameras, points or observations shows that the file is damaged.
LARGEST: Final = 10**9


def read_bal(path: str | Path, *, keep_behind: bool = True) -> Block:
    """Read a file as a block in a local system, with the adjustment options that the literature uses.

    There are no priors, the datum is free, and the optimiser is Levenberg-Marquardt. The
    standard deviation of an image point is 1 px, so that the cost is the same as in the
    literature, in px^2. Points that are measured in only one image are left out, because
    their depth is not determined.

    Parameters
    ----------
    path : str or Path
    keep_behind : bool
        Keep points whose start values lie behind one of their cameras. The equation is
        also valid there, but no camera sees backwards. Programs treat such points
        differently. Ceres keeps them. GTSAM's ``GeneralSFMFactor`` sets their residuals
        to zero, so that False gives the same cost as GTSAM.

    Raises
    ------
    InputError
        The file cannot be read, is truncated or damaged. The message names the line of the first fault.
    """
    path = Path(path)
    model = frame_model_of(read_bal_data(path), from_middle=True)
    source = Source(str(path), sha256_of(path))
    return frame_block(model, path.name, (source,), unknowns=UNKNOWN, keep_behind=keep_behind)


def read_bal_data(path: str | Path) -> BalData:
    """Read the numbers of a file into arrays; it raises the same errors as :func:`read_bal`."""
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
    far = np.argwhere(np.abs(observed[:, 2:]) > FARTHEST_PX)
    if len(far):
        _refuse(text, file, 5 + 4 * int(far[0, 0]) + int(far[0, 1]), "bal.number")
    cameras = values[4 * n : 4 * n + N_CAMERA * m].reshape(-1, N_CAMERA)
    short = np.flatnonzero(cameras[:, 6] <= 0.0)
    if len(short):
        _refuse(text, file, 3 + 4 * n + N_CAMERA * int(short[0]) + 6, "bal.focal")
    index = observed[:, :2].astype(np.intp)
    points = values[-3 * n_points :].reshape(-1, 3).copy()
    return BalData(index[:, 0], index[:, 1], observed[:, 2:].copy(), cameras.copy(), points)


def _refuse(text: str, file: str, wrong: int, code: str, **fields: object) -> NoReturn:
    """Raise InputError for the number with this position among all numbers.

    The message names its line.
    """
    for line, row in enumerate(text.split("\n"), start=1):
        cells = row.split()
        if wrong < len(cells):
            raise InputError.of(code, file=file, place=f"line {line}", value=cells[wrong][:60], **fields)
        wrong -= len(cells)
    raise AssertionError("the file contains the number")


def write_bal(path: str | Path, data: BalData, *, overwrite: bool = False) -> None:
    """Write a file with all digits; it is compressed if its name ends with .gz or .bz2.

    InputError: the file exists.
    """
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
    with outputs(path, overwrite=overwrite):
        write_bytes(path, bz2.compress(raw) if path.suffix == ".bz2" else raw)


def _load(paths: tuple[Path, ...]) -> tuple[BalData, list[str], tuple[Finding, ...]]:
    data = read_bal_data(paths[0])
    return data, list(map(str, range(len(data.cameras)))), ()


FORMAT: Final = bundle_format(
    _load, write_bal, name="bal", title="Bundle Adjustment in the Large", files=("bundle",),
    help=__doc__ or "", evidence="the published problem Ladybug 49",
)  # fmt: skip
