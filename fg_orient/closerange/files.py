"""Read the tables and photo files of the commands: points in photos and in space, stations, photos.

Stations are observed projection centres with standard deviations; attitudes are optional.
They come from a receiver, a total station or an inertial unit. They have the coordinate system of the
control points.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from factors.arrays import Array, Index
from fg_orient.closerange.photo import Photo, PhotoInterior, rotation_from_aerial
from fg_orient.formats.tables import Table, require_table
from fg_orient.formats.text_files import sha256_of
from fg_orient.model.errors import InputError
from fg_orient.model.names import LARGEST, SMALLEST
from fg_orient.rpc.points import PointTable, checks

if TYPE_CHECKING:
    from fg_orient.formats.closerange import PhotoEntry, Photos

IMAGE: Final = ("x", "y")
GROUND: Final = ("x_m", "y_m", "z_m")
SIGMA_IMAGE: Final = ("sigma_x", "sigma_y")
SIGMA_GROUND: Final = ("sigma_x_m", "sigma_y_m", "sigma_z_m")
ANGLES: Final = ("omega_deg", "phi_deg", "kappa_deg")
SIGMA_TURNS: Final = ("sigma_x_deg", "sigma_y_deg", "sigma_z_deg")
#: A rotation with a larger standard deviation counts as not observed.
_LARGEST_TURN_DEG: Final = 180.0


@dataclass(frozen=True)
class Observed(PointTable):
    """Rows of a table of points; image or ground coordinates are empty columns if the table does not contain them.

    Parameters
    ----------
    photos : tuple of str
        One per row; "" if the table has no such column.
    sigma : array or None
        Standard deviations of the image coordinates (n, 2); in a table without them, of
        the ground coordinates (n, 3). None: relative weights, all 1.
    sha256 : str
    """

    photos: tuple[str, ...]
    sigma: Array | None
    sha256: str

    @property
    def weights(self) -> str:
        """Kind of the weights: "absolute" (sigmas are given, m0 is a ratio) or "relative" (m0 is a sigma)."""
        return "relative" if self.sigma is None else "absolute"

    @property
    def image_sigma(self) -> Array:
        """Sigmas (n, 2) of the image coordinates, 1 with relative weights."""
        return np.ones((len(self), 2)) if self.sigma is None else self.sigma

    def numbered(self, others: Iterable[str] = ()) -> tuple[list[str], list[str], Index, Index]:
        """Number the photos and points.

        Return the names of the photos, the ids of the points and of others, and the
        number (n,) of the photo and of the point of each row.
        """
        names, ids = list(dict.fromkeys(self.photos)), list(dict.fromkeys((*self.ids, *others)))
        rows = ((names, self.photos), (ids, self.ids))
        which, of = (np.array([known.index(one) for one in given], np.intp) for known, given in rows)
        return names, ids, which, of


def read_control(path: Path, sigma: float | None = None) -> Observed:
    """Return the control points measured in photos: id, x, y, x_m, y_m, z_m; optional photo, role, sigma_x and sigma_y.

    ``sigma``: default standard deviation.

    Raises
    ------
    InputError
        The file has errors; all are listed.
    """
    extra = product(((), ("photo",)), ((), ("role",)), ((), SIGMA_IMAGE))
    return _read(path, [("id", *IMAGE, *GROUND, *a, *b, *c) for a, b, c in extra], sigma)


def read_image_points(path: Path, sigma: float | None = None) -> Observed:
    """Return the points measured in photos: id, photo, x, y.

    Optional sigma_x and sigma_y. ``sigma``: default.
    """
    return _read(path, [("id", "photo", *IMAGE, *own) for own in ((), SIGMA_IMAGE)], sigma)


def read_ground_points(path: Path, sigma_m: float | None = None) -> Observed:
    """Return the points in space: id, x_m, y_m, z_m.

    Optional sigma_x_m, sigma_y_m, sigma_z_m. ``sigma_m``: default.
    """
    return _read(path, [("id", *GROUND, *own) for own in ((), SIGMA_GROUND)], sigma_m)


def read_model_points(path: Path) -> tuple[tuple[str, ...], Array]:
    """Return ids and coordinates (n, 3) of a model of any unit: id, x, y, z; other columns of relative are not used.

    Raises
    ------
    InputError
        The file has errors; all are listed.
    """
    added = ((), ("distance",), ("distance", "redundancy"))  # version 0.2 wrote the distance only
    table = require_table(path, [("id", "x", "y", "z", *own) for own in added])
    model, ids = _numbers(table, ("x", "y", "z")), table.cells["id"]
    table.refuse_repeated(ids, "rectify.id_twice", "id", value=lambda row: row.cells["id"])
    table.require_valid()
    return tuple(ids), model


def _read(path: Path, layouts: list[tuple[str, ...]], default: float | None) -> Observed:
    table = require_table(path, layouts)
    columns, names = table.columns, [own for own in (SIGMA_IMAGE, SIGMA_GROUND) if own[0] in table.columns]
    image = _numbers(table, IMAGE if "x" in columns else ())
    ground = _numbers(table, GROUND if "x_m" in columns else ())
    sigma = None if default is None else np.full((len(table), 2 if "x" in columns else 3), default)
    if names:
        sigma = _sigmas(table, names[0])
    photos = tuple(table.cells["photo"]) if "photo" in columns else ("",) * len(table)
    keys = list(zip(table.cells["id"], photos, strict=True))
    table.refuse_repeated(
        keys,
        "rectify.id_twice",
        "id",
        value=lambda row: " in photo ".join(filter(None, (row.cells["id"], row.cells.get("photo")))),
    )
    check = checks(table)
    table.require_valid()
    return Observed(tuple(table.cells["id"]), check, image, ground, photos, sigma, sha256_of(path))


def _numbers(table: Table, names: Sequence[str]) -> Array:
    """Read the numbers (n, k) of some columns; refuse numbers larger than ``LARGEST``."""
    out = table.numbers(*names)
    for name, values in zip(names, out.T, strict=True):
        table.refuse(np.abs(values) > LARGEST, "closerange.range", name, value=values, limit=LARGEST)
    return out


def interiors(photos: Photos) -> dict[str, PhotoInterior]:
    """Return the cameras of a photo file by name; InputError for a photo without a focal length."""
    return {name: _interior(photos, name, entry) for name, entry in photos.entries.items()}


def _interior(photos: Photos, name: str, entry: PhotoEntry) -> PhotoInterior:
    if entry.focal is None:
        raise InputError.of("closerange.no_camera", file=photos.file, place=name)
    return PhotoInterior(entry.focal, np.array(entry.principal), np.array(entry.corrections), entry.y_axis)


def oriented_photos(photos: Photos) -> dict[str, Photo]:
    """Return the oriented photos of a file by name."""
    out = {}
    for name, entry in photos.entries.items():
        if entry.matrix is not None:
            matrix, origin = np.array(entry.matrix), np.array(entry.origin_m)
            if abs(np.linalg.det(matrix[:, :3])) <= 1e-12 * np.prod(np.linalg.norm(matrix[:, :3], axis=1)):
                raise InputError.of(
                    "closerange.camera",
                    file=photos.file,
                    place=f"{name}, matrix",
                    value="singular",
                    expected="the matrix of a central projection",
                )
            out[name] = Photo(name, matrix, origin, np.array(entry.principal), np.array(entry.corrections))
        elif entry.focal is not None and entry.rotation is not None and entry.centre_m is not None:
            out[name] = Photo.of(name, _interior(photos, name, entry), entry.rotation, entry.centre_m)
        else:
            raise InputError.of("closerange.not_oriented", file=photos.file, place=name)
    return out


# --- stations --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Station:
    """Observed projection centre and, optionally, attitude of a photo with standard deviations (3,).

    ``rotation`` (3, 3): camera axes from ground axes; ``sigma_turns_rad``: sigmas of
    rotations about the camera's axes X right, Y down, Z along the view.
    """

    centre_m: Array
    sigma_m: Array
    rotation: Array | None = None
    sigma_turns_rad: Array | None = None


def read_stations(path: Path) -> dict[str, Station]:
    """Return the stations of a CSV table by photo; InputError with all errors of the table.

    Columns: photo, x_m, y_m, z_m, sigma_x_m, sigma_y_m, sigma_z_m; optional omega_deg,
    phi_deg, kappa_deg, sigma_x_deg, sigma_y_deg, sigma_z_deg.
    """
    place = ("photo", *GROUND, *SIGMA_GROUND)
    table = require_table(path, [place, (*place, *ANGLES, *SIGMA_TURNS)])
    names = table.cells["photo"]
    table.refuse([not name for name in names], "table.cell_empty", "photo")
    table.refuse_repeated(names, "closerange.station_twice", "photo")
    columns = [_numbers(table, GROUND), _sigmas(table, SIGMA_GROUND)]
    if ANGLES[0] in table.columns:
        angles = np.radians(table.numbers(*ANGLES)).tolist()
        turns = np.radians(_sigmas(table, SIGMA_TURNS, _LARGEST_TURN_DEG))
        columns += [np.array([rotation_from_aerial(*row) for row in angles]), turns]
    table.require_valid()
    return {name: Station(*rows) for name, *rows in zip(names, *columns, strict=True)}


def _sigmas(table: Table, names: Sequence[str], limit: float = LARGEST) -> Array:
    """Read standard deviations (n, k); impossible values are refused."""
    out = table.numbers(*names)
    for name, values in zip(names, out.T, strict=True):
        wrong = (values < SMALLEST) | (values > limit)
        table.refuse(wrong, "closerange.sigma_range", name, value=values, least=SMALLEST, limit=limit)
    return out
