"""Tables and photo files of the commands: points in photos, points in space, photos from and to TOML."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from factors.cameras.image_corrections import NAMES
from fg_orient.closerange.photo import Interior, Photo
from fg_orient.formats.closerange import LARGEST, SMALLEST
from fg_orient.formats.tables import Faults, Row, Table, number, read_table
from fg_orient.model.errors import InputError

if TYPE_CHECKING:
    from fg_orient.formats.closerange import Photos

Array = npt.NDArray[np.float64]

IMAGE: Final = ("x", "y")
GROUND: Final = ("x_m", "y_m", "z_m")
SIGMA_IMAGE: Final = ("sigma_x", "sigma_y")
SIGMA_GROUND: Final = ("sigma_x_m", "sigma_y_m", "sigma_z_m")
ROLES: Final = ("control", "check")


@dataclass(frozen=True)
class Observed:
    """Rows of a table of points.

    Parameters
    ----------
    ids, photos : tuple of str
        One per row; the photo is "" if the table has no such column.
    image : (n, 2) array
        Empty columns where the table has none.
    ground : (n, 3) array
    sigma : array or None
        Of the image coordinates (n, 2); of a table without them of the ground coordinates (n, 3).
    check : (n,) bool array
    sha256 : str
    """

    ids: tuple[str, ...]
    photos: tuple[str, ...]
    image: Array
    ground: Array
    sigma: Array | None
    check: npt.NDArray[np.bool_]
    sha256: str

    def __len__(self) -> int:
        return len(self.ids)


def read_control(path: Path) -> Observed:
    """Control points measured in photos: id, x, y, x_m, y_m, z_m; if wanted photo, role, sigma_x and sigma_y.

    Raises
    ------
    InputError
        All faults of the file.
    """
    extra = product(((), ("photo",)), ((), ("role",)), ((), SIGMA_IMAGE))
    return _read(path, [("id", *IMAGE, *GROUND, *a, *b, *c) for a, b, c in extra])


def read_image_points(path: Path) -> Observed:
    """Points measured in photos: id, photo, x, y; if wanted sigma_x and sigma_y."""
    return _read(path, [("id", "photo", *IMAGE, *sigma) for sigma in ((), SIGMA_IMAGE)])


def read_ground_points(path: Path) -> Observed:
    """Points in space: id, x_m, y_m, z_m; if wanted sigma_x_m, sigma_y_m, sigma_z_m."""
    return _read(path, [("id", *GROUND, *sigma) for sigma in ((), SIGMA_GROUND)])


def _read(path: Path, layouts: list[tuple[str, ...]]) -> Observed:
    faults = Faults(str(path))
    table = read_table(path, layouts, faults)
    rows = () if table is None else table.rows
    sigma_names = next((names for names in (SIGMA_IMAGE, SIGMA_GROUND) if _has(table, names[0])), ())
    sigma = _numbers(rows, sigma_names, faults)
    for row, values in zip(rows, sigma, strict=True):
        for name, value in zip(sigma_names, values, strict=True):
            if 0.0 < value < SMALLEST:
                faults.add("closerange.sigma_range", place=row.place(name), value=value, least=SMALLEST, limit=LARGEST)
            if value <= 0.0:
                faults.add("rectify.positive", place=row.place(name), value=value, unit="the unit of the coordinates")
    found = Observed(
        tuple(row.cells["id"] for row in rows), tuple(row.cells.get("photo", "") for row in rows),
        _numbers(rows, IMAGE if _has(table, "x") else (), faults),
        _numbers(rows, GROUND if _has(table, "x_m") else (), faults), sigma if sigma_names else None,
        np.array([_is_check(row, faults) for row in rows], bool), table.sha256 if table else "",
    )  # fmt: skip
    _refuse_twice(rows, faults)
    faults.raise_if_any()
    return found


def _has(table: Table | None, column: str) -> bool:
    return table is not None and column in table.columns


def _numbers(rows: Sequence[Row], names: Sequence[str], faults: Faults) -> Array:
    """Numbers (n, k) of some columns, none larger than ``LARGEST``."""
    out = np.array([[number(row, name, faults) for name in names] for row in rows], float)
    out = out.reshape(len(rows), len(names))
    for k, j in np.argwhere(np.abs(out) > LARGEST):
        faults.add("closerange.range", place=rows[k].place(names[j]), value=out[k, j], limit=LARGEST)
    return out


def _is_check(row: Row, faults: Faults) -> bool:
    role = row.cells.get("role", ROLES[0])
    if role not in ROLES:
        faults.add("rectify.role", place=row.place("role"), value=role)
    return role == ROLES[1]


def _refuse_twice(rows: Sequence[Row], faults: Faults) -> None:
    seen = set[tuple[str, str]]()
    for row in rows:
        key = (row.cells["id"], row.cells.get("photo", ""))
        if key in seen:
            faults.add("rectify.id_twice", place=row.place("id"), value=" in photo ".join(filter(None, key)))
        seen.add(key)


def interiors(photos: Photos) -> dict[str, Interior]:
    """Cameras of a photo file by name.

    Raises
    ------
    InputError
        A photo without a focal length.
    """
    out = {}
    for name, entry in photos.entries.items():
        if entry.focal is None:
            raise InputError.of("closerange.no_camera", file=photos.file, place=name)
        out[name] = Interior(entry.focal, np.array(entry.principal), np.array(entry.corrections), entry.y_axis)
    return out


def oriented_photos(photos: Photos) -> dict[str, Photo]:
    """Oriented photos of a file by name.

    Raises
    ------
    InputError
        A photo with neither a matrix nor rotation, centre and focal length.
    """
    out = {}
    for name, entry in photos.entries.items():
        if entry.matrix is not None:
            matrix, origin = np.array(entry.matrix), np.array(entry.origin_m)
            if abs(np.linalg.det(matrix[:, :3])) <= 1e-12 * np.prod(np.linalg.norm(matrix[:, :3], axis=1)):
                raise InputError.of("closerange.camera", file=photos.file, place=f"{name}, matrix",
                                    value="singular", expected="the matrix of a central projection")  # fmt: skip
            out[name] = Photo(name, matrix, origin, np.array(entry.principal), np.array(entry.corrections))
        elif entry.focal is not None and entry.rotation is not None and entry.centre_m is not None:
            camera = Interior(entry.focal, np.array(entry.principal), np.array(entry.corrections), entry.y_axis)
            out[name] = Photo.of(name, camera, entry.rotation, entry.centre_m)
        else:
            raise InputError.of("closerange.not_oriented", file=photos.file, place=name)
    return out


def photo_text(photo: Photo, interior: Interior | None = None, rotation: Array | None = None) -> str:
    """One ``[[photos]]`` table: of a camera with its rotation, else with the matrix."""
    lines = ["[[photos]]", f"name = {json.dumps(photo.name, ensure_ascii=False)}"]
    if interior is not None and rotation is not None:
        lines += [f"focal = {interior.focal!r}", f'y_axis = "{interior.y_axis}"', f"rotation = {rotation.tolist()}",
                  f"centre_m = {photo.origin_m.tolist()}"]  # fmt: skip
    else:
        lines += [f"matrix = {photo.matrix.tolist()}", f"origin_m = {photo.origin_m.tolist()}"]
    lines.append(f"principal = {photo.principal.tolist()}")
    lines += [f"{n} = {float(v)!r}" for n, v in zip(NAMES, photo.corrections, strict=True) if v != 0.0]
    return "\n".join(lines) + "\n"
