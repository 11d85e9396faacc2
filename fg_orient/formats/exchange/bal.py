"""Files of "Bundle Adjustment in the Large" as frame models and back; ``fg_orient.formats.bal`` reads them.

x right and y up from the middle of the image, cameras that look along -Z, f, k1, k2: the camera model of Bundler. The
middle of an image of w x h pixels is at ((h - 1) / 2, (w - 1) / 2): Bundler puts its lower left corner at (-w/2, -h/2).
These files hold neither the principal point nor the size of the images.
"""

from __future__ import annotations

import bz2
import gzip
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.bal import BalData, cameras_of, read_bal_data
from fg_orient.formats.exchange.files import require_free
from fg_orient.formats.exchange.registry import Format, Holds, Settings, register
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.ties import model_survey
from fg_orient.formats.frame_model import FrameModel, Pose
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.frame import HALF_TURN, IDEAL_TO_MEASURED
from fg_orient.sensors.interior import Interior, converted

#: What the camera model of these files does not have, by the position in ``Interior.distortion``.
_BEYOND: Final = {2: "k3", 3: "p1", 4: "p2"}


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


FORMAT: Final = register(
    Format(
        name="bal",
        title="Bundle Adjustment in the Large",
        suffixes=(),
        files=("bundle",),
        first_pixel=None,
        pixel_axes="x right, y up from the middle of the image (pixels)",
        ground_axes="local x, y, z (left out)",
        holds=frozenset({Holds.IMAGE, Holds.IMAGES, Holds.TIES}),
        needs=frozenset(),
        read=read,
        write=None,
        read_model=read_model,
        write_model=write_model,
        evidence="the published problem Ladybug 49",
    )
)
