"""Bundler's files (``bundle.out``, v0.3), read and written; ``fg_orient.formats.exchange.bal`` has the camera model.

Bundler writes rotations as matrices, a colour of each point, and zeros for images that it could not orient. Its list of
images (one name in a line, in the order of the file) is another file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NoReturn

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.exchange.bal import BalData, bal_data_of, bundle_survey, sized_model
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.exchange.text import read_lines, require_free
from fg_orient.formats.frame_model import FrameModel
from fg_orient.formats.registry import TIES_ONLY, Format, Settings
from fg_orient.formats.tables import finite
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.frame import ORTHONORMAL, away_from_rotation, not_a_rotation

Array = npt.NDArray[np.float64]

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
    lines = read_lines(path)
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines or lines[0].strip() != HEAD:
        _refuse(path, 1, lines[:1], HEAD)
    counts = finite(lines[1].split()) if len(lines) > 1 else None
    if counts is None or len(counts) != 2 or (counts % 1 != 0).any() or (counts < 0).any():
        _refuse(path, 2, lines[1:2], "numbers of cameras and points")
    n_cameras, n_points = counts.astype(int).tolist()
    if len(lines) != 2 + 5 * n_cameras + 3 * n_points:
        raise InputError.of(
            "bundle.lines", file=path.name, value=f"{len(lines)} lines", expected=2 + 5 * n_cameras + 3 * n_points
        )  # fmt: skip
    cameras = _triples(path, lines, 2, 5 * n_cameras).reshape(-1, 15)
    kept = cameras[:, 0] > 0.0
    rows = _camera_rows(path, cameras, kept)
    first = 2 + 5 * n_cameras
    points = _triples(path, lines[first::3], first, n_points, step=3)
    views, count = _views(path, lines, first, n_cameras)
    point = np.repeat(np.arange(n_points), count)
    seen = kept[views[:, 0].astype(np.intp)]
    number = np.cumsum(kept) - 1
    data = BalData(
        number[views[seen, 0].astype(np.intp)], point[seen], views[seen, 2:].copy(), rows, points
    )  # fmt: skip
    n_out = int((~kept).sum())
    notes = (finding("points.images_left_out", n=n_out),) if n_out else ()
    return data, tuple(np.flatnonzero(kept).tolist()), notes


def _triples(path: Path, lines: list[str], first: int, n: int, step: int = 1) -> Array:
    """Three numbers of each of n lines; ``first`` and ``step`` say where they stand in the file."""
    own = lines[first : first + n] if step == 1 else lines
    cells = [line.split() for line in own]
    flat = finite([cell for row in cells for cell in row]) if all(len(row) == 3 for row in cells) else None
    if flat is None:
        bad = next(k for k, row in enumerate(cells) if len(row) != 3 or finite(row) is None)
        _refuse(path, first + step * bad + 1, own[bad : bad + 1], "three numbers")
    return flat.reshape(-1, 3)


def _camera_rows(path: Path, cameras: Array, kept: npt.NDArray[np.bool_]) -> Array:
    """Rows of BAL (rotation vector, translation, f, k1, k2) of the images that are kept."""
    own = cameras[kept]
    rotation = own[:, 3:12].reshape(-1, 3, 3)
    away = away_from_rotation(rotation)
    bad = np.flatnonzero(away > ORTHONORMAL)
    if len(bad):
        line = 4 + 5 * int(np.flatnonzero(kept)[bad[0]])
        _refuse(path, line, [not_a_rotation(float(away[bad[0]]))], "a rotation")
    vector = Rotation.from_matrix(rotation).as_rotvec() if len(own) else np.empty((0, 3))
    return np.column_stack([vector, own[:, 12:15], own[:, :3]])


def _views(path: Path, lines: list[str], first: int, n_cameras: int) -> tuple[Array, npt.NDArray[np.intp]]:
    """Camera, key, x, y (n, 4) of all image points, and how many each point has."""
    own = [line.split() for line in lines[first + 2 :: 3]]
    flat = finite([cell for row in own for cell in row[1:]])
    good = flat is not None and all(row and row[0] == str((len(row) - 1) // 4) and len(row) % 4 == 1 for row in own)
    views = flat.reshape(-1, 4) if good and flat is not None else np.empty((0, 4))
    if not good or (views[:, 0] % 1 != 0).any() or (views[:, 0] < 0).any() or (views[:, 0] >= n_cameras).any():
        for k, row in enumerate(own):
            values = finite(row)
            whole = values is not None and len(row) % 4 == 1 and row[0] == str((len(row) - 1) // 4)
            if values is None or not whole or not set(values[1::4].tolist()) <= set(range(n_cameras)):
                line = first + 3 + 3 * k
                _refuse(path, line, lines[line - 1 : line], "the number of views, then camera, key, x, y of each")
    return views, np.array([(len(row) - 1) // 4 for row in own], np.intp)


def _refuse(path: Path, number: int, found: list[str], needed: str) -> NoReturn:
    value = repr(found[0]) if found else "the end of the file"
    raise InputError.of("bundle.cells", file=path.name, place=f"line {number}", value=value, needed=needed)


def write_bundler(path: str | Path, data: BalData, *, overwrite: bool = False) -> None:
    """Write a file of v0.3; points are grey, keys count the image points of an image.

    Raises
    ------
    InputError
        The file exists, or cannot be written.
    """
    path = Path(path)
    require_free(path, overwrite=overwrite)
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
    """Numbers of a file, names of its images by the list, or by numbers from 0, and notes."""
    data, images, notes = read_bundler(paths[0])
    names = [str(k) for k in images]
    if len(paths) > 1:
        listed = [line.split()[0] for line in read_lines(paths[1]) if line.strip()]
        if images and images[-1] >= len(listed):
            raise InputError.of("bundle.list", file=paths[1].name, value=f"{len(listed)} names", last=images[-1] + 1)
        names = [listed[k] for k in images]
    return data, names, notes


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read the tie points of a file."""
    data, names, notes = _named(paths)
    return bundle_survey(data, names, settings, notes, paths[0].name)


def read_model(paths: tuple[Path, ...], settings: Settings) -> FrameModel:
    """Read a whole file."""
    data, names, notes = _named(paths)
    return sized_model(data, names, settings, notes)


def write_model(out: Path, model: FrameModel, overwrite: bool) -> tuple[str, ...]:
    """Write a whole file."""
    data, lost = bal_data_of(model, out.name)
    write_bundler(out, data, overwrite=overwrite)
    return lost


FORMAT: Final = Format(
    name="bundler",
    title="Bundler (bundle.out, v0.3)",
    suffixes=(".out",),
    files=("bundle", "list"),
    pixel_axes="x right, y up from the middle of the image (pixels)",
    ground_axes="local x, y, z (left out)",
    holds=TIES_ONLY,
    read=read,
    read_model=read_model,
    write_model=write_model,
)
