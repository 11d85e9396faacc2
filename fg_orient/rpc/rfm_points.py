"""Control points of a rational function model: file, and normalisation to [-1, 1].

A file has rows of id, line, sample, latitude, longitude (degrees), height (m).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from factors.cameras.rfm_project import RANGE
from fg_orient.model.arrays import Array, Index, Mask
from fg_orient.model.errors import InputError
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
        Inconsistent shapes, no points, or values that are not finite.
    """

    line: Array
    sample: Array
    ground: Array

    def __post_init__(self) -> None:
        n = len(self.line)
        fits = self.line.shape == self.sample.shape == (n,) and self.ground.shape == (n, 3) and n > 0
        if not fits or not np.isfinite(self.columns).all():
            raise InputError.of("rfm.points", place="control points", value=f"{n} lines, ground {self.ground.shape}")

    def __len__(self) -> int:
        return len(self.line)

    @property
    def columns(self) -> Array:
        """Line, sample, longitude, latitude, height: (n, 5)."""
        return np.column_stack([self.line, self.sample, self.ground])

    def take(self, index: Index | Mask) -> ControlPoints:
        """Some of the points, or all of them in another order."""
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
        """Scaling of each coordinate to [-1, 1], T(3.51), or without ``normalise`` the identity.

        Raises
        ------
        InputError
            All points have the same value of a coordinate.
        """
        if not normalise:
            return cls(np.zeros(5), np.ones(5))
        low, high = points.columns.min(axis=0), points.columns.max(axis=0)
        flat = np.flatnonzero(~(high > low))
        if len(flat):
            raise InputError.of("rfm.flat", place=COORDINATES[flat[0]], value=low[flat[0]])
        return cls(0.5 * (high + low), 0.5 * (high - low))

    def ground(self, ground: Array) -> Array:
        """Normalised longitude, latitude, height (n, 3)."""
        return _normalised(ground, self.offsets[RANGE.ground], self.scales[RANGE.ground])

    def image(self, line: Array, sample: Array) -> Array:
        """Normalised line and sample (n, 2)."""
        return _normalised(np.column_stack([line, sample]), self.offsets[RANGE.image], self.scales[RANGE.image])


def _normalised(values: Array, offsets: Array, scales: Array) -> Array:
    return np.asarray((values - offsets) / scales)


_COLUMNS: Final = 6
#: The control points of the SPOT-6 scene of Terlemezoğlu 2019 in the folder of real data.
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
    """Path of the SPOT-6 points: the file itself, or inside a folder of real data.

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
