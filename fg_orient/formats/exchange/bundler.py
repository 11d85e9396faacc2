"""Files of Bundler (``bundle.out``, v0.3).

``fg_orient.formats.exchange.bal`` describes the camera model. In these files, rotations are
matrices, each point has a colour, and images without orientation contain zeros. A second file
lists the images in the order of the bundle, one name in each line.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from factors.arrays import Array, Index, Mask
from fg_orient.formats.atomic import outputs, require_free_files, write_bytes
from fg_orient.formats.exchange.bal import BalData, bundle_format
from fg_orient.formats.exchange.text import TextLines
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.sensors.frame import ORTHONORMAL, away_from_rotation, not_a_rotation

HEAD: Final = "# Bundle file v0.3"


def read_bundler(path: str | Path) -> tuple[BalData, tuple[int, ...], tuple[Finding, ...]]:
    """Read a file of Bundler; images without orientation are left out.

    Returns
    -------
    data : BalData
    images : tuple of int
        For each image that is kept, its position in the file and in Bundler's list of images, from 0.
    notes : tuple of Finding

    Raises
    ------
    InputError
        The file cannot be read, has another version, is truncated or damaged; the message names the line.
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


def _camera_rows(text: TextLines, cameras: Array, kept: Mask) -> Array:
    """Return the camera rows of BAL (rotation vector, translation, f, k1, k2) for the images that are kept."""
    own = cameras[kept]
    rotation = own[:, 3:12].reshape(-1, 3, 3)
    away = away_from_rotation(rotation)
    bad = np.flatnonzero(away > ORTHONORMAL)
    if len(bad):
        line = 4 + 5 * int(np.flatnonzero(kept)[bad[0]])
        text.refuse(line, "a rotation", not_a_rotation(float(away[bad[0]])))
    vector = Rotation.from_matrix(rotation).as_rotvec() if len(own) else np.empty((0, 3))
    return np.column_stack([vector, own[:, 12:15], own[:, :3]])


def _views(text: TextLines, rows: Sequence[tuple[int, list[str]]], n_cameras: int) -> tuple[Array, Index]:
    """Return camera, key, x, y (n, 4) of all image points, and the number of image points of each point."""
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
    """Write a file of version 0.3. Points are grey, and keys number the image points of an image.

    InputError: the file exists.
    """
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
    with outputs(path, overwrite=overwrite):
        write_bytes(path, "\n".join([*lines, ""]).encode())


def _named(paths: tuple[Path, ...]) -> tuple[BalData, list[str], tuple[Finding, ...]]:
    """Return the numbers of a file, the names of its images and notes.

    The names come from the list of images; without a list, images are numbered from 0.
    """
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
    files=("bundle", "list"), help=__doc__ or "",
)  # fmt: skip
