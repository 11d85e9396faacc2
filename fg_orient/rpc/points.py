"""Points of one image: control points with their normalisation, and measured points that are read from a file.

A CSV file has the columns id, line, sample (pixels; (0, 0) is the centre of the first
pixel), lon_deg, lat_deg, height_m (ellipsoidal). Optional columns are role (control or
check), sigma_line_px and sigma_sample_px. A row of a ``.gcp`` file contains id, line,
sample, latitude, longitude (degrees), height (m).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from factors.arrays import Array, Index, Mask
from factors.cameras.rfm_project import RANGE
from fg_orient.formats.tables import Table, require_table
from fg_orient.model.arrays import array, require_size, wrong
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.sensors.rpc import COORDINATES


@dataclass(frozen=True)
class ControlPoints:
    """Ground points with their image coordinates.

    Parameters
    ----------
    line, sample : (n,) array
        Pixels.
    ground : (n, 3) array
        Longitude, latitude (degrees), ellipsoidal height (m).

    Raises
    ------
    InputError
        Shapes do not fit, there are no points, or values are not finite.
    """

    line: Array
    sample: Array
    ground: Array

    def __post_init__(self) -> None:
        line = array(self.line, "line", (-1,))
        read = {
            "line": line,
            "sample": array(self.sample, "sample", line.shape),
            "ground": array(self.ground, "ground", (len(line), 3)),
        }
        if not len(line):
            raise InputError.of("rfm.points", place="control points", value="0 points")
        for name, values in read.items():
            require_size(values, name)
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        return len(self.line)

    @property
    def columns(self) -> Array:
        """Line, sample, longitude, latitude, height: (n, 5)."""
        return np.column_stack([self.line, self.sample, self.ground])

    def take(self, index: Index | Mask) -> ControlPoints:
        """Return some of the points, or all of them in another order."""
        return ControlPoints(self.line[index], self.sample[index], self.ground[index])


@dataclass(frozen=True)
class Scaling:
    """Normalised coordinate = (coordinate - offset)/scale.

    Parameters
    ----------
    offsets, scales : (5,) array
        Line, sample (pixels), longitude, latitude (degrees), height (m).
    """

    offsets: Array
    scales: Array

    @classmethod
    def of(cls, points: ControlPoints, *, normalise: bool = True) -> Scaling:
        """Return the scaling of each coordinate to [-1, 1], T(3.51); without ``normalise``, the identity.

        Raises
        ------
        InputError
            All points have the same value of a coordinate.
        """
        if not isinstance(points, ControlPoints):
            raise wrong("points", type(points).__name__, "ControlPoints")
        if not normalise:
            return cls(np.zeros(5), np.ones(5))
        low, high = points.columns.min(axis=0), points.columns.max(axis=0)
        flat = np.flatnonzero(~(high > low))
        if len(flat):
            raise InputError.of("rfm.flat", place=COORDINATES[flat[0]], value=low[flat[0]])
        return cls(0.5 * (high + low), 0.5 * (high - low))

    def ground(self, ground: Array) -> Array:
        """Return the normalised longitude, latitude, height (n, 3)."""
        return _normalised(ground, self.offsets[RANGE.ground], self.scales[RANGE.ground])

    def image(self, line: Array, sample: Array) -> Array:
        """Return the normalised line and sample (n, 2)."""
        return _normalised(np.column_stack([line, sample]), self.offsets[RANGE.image], self.scales[RANGE.image])


def _normalised(values: Array, offsets: Array, scales: Array) -> Array:
    return np.asarray((values - offsets) / scales)


_COLUMNS: Final = 6
#: Folder and file, among the real data, of the control points of the SPOT-6 scene of Terlemezoğlu 2019.
SPOT6_FOLDER: Final = "geoetrim-pleiades"
SPOT6_FILE: Final = "SPOT6_201805150822087_GCP_WGS84_blh.gcp"


def read_gcp(path: Path) -> ControlPoints:
    """Read a file of control points.

    Parameters
    ----------
    path : Path
        Rows of six words between blanks; empty rows are skipped.

    Raises
    ------
    InputError
        The file cannot be read, or a row has other content; the message names its line.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "no text"
        raise InputError.of("rfm.data", file=path, value=reason) from None
    rows = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words:
            continue
        try:
            row = [float(word) for word in words[1:]]
        except ValueError:
            row = []
        good = len(words) == _COLUMNS and len(row) == _COLUMNS - 1 and np.isfinite(row).all()
        if not good or abs(row[2]) > 90.0 or abs(row[3]) > 360.0:
            raise InputError.of("rfm.data", file=path, place=f"line {number}", value=line.strip())
        rows.append(row)
    if not rows:
        raise InputError.of("rfm.data", file=path, value="no rows")
    table = np.array(rows)
    return ControlPoints(table[:, 0], table[:, 1], table[:, [3, 2, 4]])


def find_spot6(where: Path) -> Path:
    """Return the path of the SPOT-6 points: the file itself, or inside a folder of real data.

    Raises
    ------
    InputError
        The file does not exist.
    """
    candidates = (where, where / SPOT6_FILE, where / SPOT6_FOLDER / SPOT6_FILE)
    for path in candidates:
        if path.is_file():
            return path
    raise InputError.of("rfm.data", file=where, value=f"no {SPOT6_FILE}")


# --- measured points --------------------------------------------------------------------------------------
COLUMNS: Final = ("id", "line", "sample", "lon_deg", "lat_deg", "height_m")
_SIGMAS: Final = ("sigma_line_px", "sigma_sample_px")
AXES: Final = ("line", "sample")


@dataclass(frozen=True)
class PointTable:
    """Rows of a table of points.

    Parameters
    ----------
    ids : tuple of str
    check : (n,) bool array
        Points that are not used in an estimation.
    image : (n, 2) array
        Line and sample, pixels; in close range x, y.
    ground : (n, k) array
        Longitude, latitude (degrees), height (m), or coordinates in m.
    """

    ids: tuple[str, ...]
    check: Mask
    image: Array
    ground: Array

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class MeasuredPoints(PointTable):
    """Points of one image.

    Parameters
    ----------
    sigma_px : (n, 2) array
        Standard deviations of line and sample; 1 if the file has none.
    stated : bool
        False if the file has no standard deviations, so that 1 px is only an assumption.
    """

    sigma_px: Array
    stated: bool = True

    def take(self, index: Mask) -> MeasuredPoints:
        """Return some of the points."""
        ids = tuple(name for name, wanted in zip(self.ids, index, strict=True) if wanted)
        return MeasuredPoints(
            ids, self.check[index], self.image[index], self.ground[index], self.sigma_px[index], self.stated
        )

    @property
    def points(self) -> ControlPoints:
        """Points in the form for the estimators; at least one point."""
        return ControlPoints(self.image[:, 0], self.image[:, 1], self.ground)


def read_measured(path: Path) -> MeasuredPoints:
    """Read a CSV file of measured points.

    Parameters
    ----------
    path : Path
        Lines and samples in pixels, longitudes and latitudes in degrees (WGS84), ellipsoidal heights in m.

    Raises
    ------
    InputError
        The file has errors: columns, numbers, roles, repeated ids, invalid coordinates. All are listed.
    """
    layouts = [(*COLUMNS, *role, *sigmas) for role in ((), ("role",)) for sigmas in ((), _SIGMAS)]
    table = require_table(path, layouts)
    values = table.numbers(*COLUMNS[1:])
    lon, lat = np.abs(values[:, 2:4]).T
    swapped = (lon <= 90.0) & (lat <= 180.0)
    table.refuse((lat > 90.0) & swapped, "points.swapped_range", "lat_deg")
    table.refuse((lat > 90.0) & ~swapped, "points.latitude", "lat_deg")
    table.refuse(lon > 180.0, "points.longitude", "lon_deg")
    ids, check = ids_and_checks(table)
    stated = _SIGMAS[0] in table.columns
    sigma = positive_numbers(table, _SIGMAS) if stated else np.ones((len(table), 2))
    table.require_valid()
    return MeasuredPoints(ids, check, values[:, :2], values[:, 2:], sigma, stated)


def ids_and_checks(table: Table) -> tuple[tuple[str, ...], Mask]:
    """Return the ids of the points, and whether their role is "check" (n,), by default "control".

    Empty and repeated ids and other roles are refused.
    """
    ids = tuple(table.cells["id"])
    table.refuse([not name for name in ids], "points.id_missing", "id")
    table.refuse_repeated([name or k for k, name in enumerate(ids)], "points.id_twice", "id")
    return ids, checks(table)


def checks(table: Table) -> Mask:
    """Return whether the role of a point is "check" (n,), by default "control".

    Other roles are refused.
    """
    if "role" not in table.columns:
        return np.zeros(len(table), bool)
    check = table.where("role", Role.CHECK)
    table.refuse(~check & ~table.where("role", Role.CONTROL), "rectify.role", "role")
    return check


def positive_numbers(table: Table, columns: Sequence[str]) -> Array:
    """Return columns (n, k) as numbers; numbers that are not above 0 are refused."""
    values = table.numbers(*columns)
    for name, column in zip(columns, values.T, strict=True):
        table.refuse(column <= 0.0, "rectify.positive", name, unit=name.rpartition("_")[2])
    return values


def statistics(residuals_px: Array) -> dict[str, Any] | None:
    """Return mean, RMS and largest absolute value of residuals (n, 2) of line and sample; None without points."""
    if not len(residuals_px):
        return None
    with np.errstate(invalid="ignore", over="ignore"):
        figures = {
            "mean": residuals_px.mean(axis=0),
            "rms": np.sqrt(np.mean(residuals_px**2, axis=0)),
            "max": np.abs(residuals_px).max(axis=0),
        }
    named = {f"{name}_{axis}_px": float(v) for name, two in figures.items() for axis, v in zip(AXES, two, strict=True)}
    return {"n": len(residuals_px), **named}
