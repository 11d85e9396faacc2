"""Bundle problems of libmv (``problem_NN.bin``) that Ceres Solver publishes.

Their layout is not documented. It was determined from the numbers of problem_01.bin. With
the following layout, the file ends exactly after the last record, all matrices are
orthonormal, all references exist, and image points differ from their projections by only
0.9 px (rms):

- letters v and P (little-endian numbers, coordinates in pixels; files with other letters are refused)
- 8 float32: focal length, principal point x, y (px), five coefficients of distortion, which are zero
- int32 number of images; each: int32 id, rotation by columns (9 float32) and translation (3), from ground to camera
- int32 number of points; each: int32 id, X, Y, Z (3 float32)
- int32 number of image points; each: int32 image, int32 point, x, y (2 float32)

Files with distortion are refused: all coefficients of the known file are zero, so that
the order and direction of the polynomial are unknown. The file states neither the
direction of y nor the pixel origin. It is assumed that y points down, and that the origin
is the centre of the first pixel. Image points and principal point have the same origin.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from factors.arrays import Array, Index
from fg_orient.formats.exchange.bal import sizes_of
from fg_orient.formats.exchange.text import positions
from fg_orient.formats.exchange.ties import model_format
from fg_orient.formats.faults import Faults
from fg_orient.formats.frame_model import FrameModel, Pose
from fg_orient.formats.registry import read_bytes
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import ORTHONORMAL, away_from_rotation, not_a_rotation
from fg_orient.sensors.interior import Interior

HEAD: Final = b"vP"
_IMAGE: Final = np.dtype([("id", "<i4"), ("columns", "<f4", (3, 3)), ("t", "<f4", 3)])
_POINT: Final = np.dtype([("id", "<i4"), ("xyz", "<f4", 3)])
_MARK: Final = np.dtype([("image", "<i4"), ("point", "<i4"), ("xy", "<f4", 2)])


def read_libmv(path: str | Path, image_sizes: Mapping[str, tuple[int, int]] | None = None) -> FrameModel:
    """Read a file as a frame model with one camera; the numbers of images and points in the file are their names.

    Parameters
    ----------
    path : str or Path
    image_sizes : mapping of str to (n_lines, n_samples), optional
        Sizes of the images. If a size is missing, a square up to the outermost image
        point is assumed, with a note.

    Raises
    ------
    InputError
        The file cannot be read, has another layout, is damaged, or has distortion.
    """
    path = Path(path)
    raw = read_bytes(path, -1, "ties.unreadable")
    if raw[:2] != HEAD or len(raw) < 34:
        raise InputError.of("libmv.head", file=path.name, value=raw[:2])
    camera = np.frombuffer(raw, "<f4", 8, 2).astype(float)
    tables, at = [], 34
    for kind, what in ((_IMAGE, "images"), (_POINT, "points"), (_MARK, "image points")):
        n = int.from_bytes(raw[at : at + 4], "little", signed=True)
        if len(raw) < at + 4 or n < 1 or at + 4 + n * kind.itemsize > len(raw):
            raise InputError.of("libmv.length", file=path.name, place=f"byte {at}", value=f"{n} {what}")
        tables.append(np.frombuffer(raw, kind, n, at + 4))
        at += 4 + n * kind.itemsize
    if at != len(raw):
        raise InputError.of("libmv.length", file=path.name, place=f"byte {at}", value=f"{len(raw) - at} bytes more")
    images, points, marks = tables
    matrices = np.swapaxes(images["columns"].astype(float), 1, 2)
    image, point = positions(images["id"], marks["image"]), positions(points["id"], marks["point"])
    _check(path.name, camera, tables, away_from_rotation(matrices), (image, point))
    matrices = Rotation.from_matrix(matrices).as_matrix()  # makes them orthonormal in double precision
    names, xy = images["id"].astype(str).tolist(), marks["xy"].astype(float)
    sizes, notes = sizes_of(names, image_sizes or {}, int(np.ceil(xy.max(initial=0.0))) + 1)
    interior = Interior(*sizes[0], camera[0], camera[2:0:-1], name="1")
    shifts = images["t"].astype(float)
    poses = [Pose(name, "1", r, -r.T @ t) for name, r, t in zip(names, matrices, shifts, strict=True)]
    return FrameModel(
        {"1": interior}, tuple(poses), tuple(points["id"].astype(str).tolist()), points["xyz"].astype(float), image,
        point, xy[:, 1], xy[:, 0], notes,
    )  # fmt: skip


def _check(
    file: str, camera: Array, tables: list[npt.NDArray[np.void]], away: Array,
    at: tuple[Index, Index],
) -> None:  # fmt: skip
    """Refuse a file with impossible values; all faults are reported together."""
    faults = Faults(file)
    images, points, marks = tables
    if not (np.isfinite(camera).all() and camera[0] > 0.0):
        faults.add("libmv.camera", place="byte 2", value=camera[:3].tolist())
    elif camera[3:].any():
        faults.add("libmv.distortion", place="byte 14", value=camera[3:].tolist())
    for table, what in ((images, "image"), (points, "point")):
        _, first = np.unique(table["id"], return_index=True)
        for k in np.setdiff1d(np.arange(len(table)), first):
            faults.add("interchange.twice", place=f"{what} {k}", value=int(table["id"][k]), kind=what)
    faults.raise_if_any()  # if an id occurs twice, references to it have no meaning
    for k in np.flatnonzero(~(away <= 10 * ORTHONORMAL)):
        faults.add("libmv.rotation", place=f"image {images['id'][k]}", value=not_a_rotation(float(away[k])))
    for k in np.flatnonzero((at[0] < 0) | (at[1] < 0)):
        value = f"image {marks['image'][k]}, point {marks['point'][k]}"
        faults.add("libmv.mark", place=f"image point {k}", value=value)
    for table, name, what in ((images, "t", "image"), (points, "xyz", "point"), (marks, "xy", "image point")):
        for k in np.flatnonzero(~np.isfinite(table[name]).all(axis=1)):
            faults.add("libmv.number", place=f"{what} {k}", value=table[name][k].tolist())
    seen = np.stack(at, axis=1)
    _, first = np.unique(seen, axis=0, return_index=True)
    for k in np.setdiff1d(np.arange(len(seen)), first):
        faults.add("interchange.twice", place=f"image point {k}", kind="point in this image",
                   value=f"image {marks['image'][k]}, point {marks['point'][k]}")  # fmt: skip
    faults.raise_if_any()


FORMAT: Final = model_format(
    lambda paths, settings: read_libmv(paths[0], settings.image_sizes),
    name="libmv",
    title="libmv bundle problem (problem_NN.bin of Ceres Solver)",
    files=("problem",),
    first_pixel=(0.0, 0.0),
    pixel_axes="x right, y down (pixels)",
    help=__doc__ or "",
    evidence="problem_01.bin of Ceres Solver, from which the layout was found; y down is an assumption",
)
