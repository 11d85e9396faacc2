"""Common form of all formats of points: ground points and their image points.

Coordinates stay in the CRS of the file, longitude or easting first, so that a format comes back as it was. Pixels are
(line, sample) with (0, 0) in the centre of the first pixel; readers and writers add what their format counts from.
Whatever a file does not say is nan (numbers) or "" (CRS).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from fg_orient.formats.tables import Faults
from fg_orient.model.block import ImagePoints, Index
from fg_orient.model.errors import Finding
from fg_orient.model.names import Role

Array = npt.NDArray[np.float64]

UNKNOWN: Final = (np.nan, np.nan, np.nan)


def no_image_points() -> ImagePoints:
    """Image points of a file that holds none."""
    none, nobody = np.empty(0), np.empty(0, np.intp)
    return ImagePoints(nobody, nobody, none, none, none, none)


@dataclass(frozen=True, eq=False)
class Survey:
    """Ground points and image points, as a file holds them.

    Parameters
    ----------
    crs : str
        ``EPSG:n`` or ``EPSG:n+m``; "" if unknown.
    ids, roles : tuples of length n
        Ground points. Tie points have no coordinates.
    coordinates : (n, 3) array
        Longitude, latitude (degrees), height (m); easting, northing, height (m); or x, y, z (m); nan where unknown.
    sigma_enu_m : (n, 3) array
        Standard deviations East, North, Up at the point, m; nan where unknown.
    fixed : (n,) array of bool
        Points without uncertainty.
    images : tuple of str
        Ids of the images.
    observed : ImagePoints
        Image points: positions in ``images`` and ``ids``, pixels and sigmas (nan where unknown).
    lines : (n,) int array
        Line of each ground point in its file, for messages; 0 where there is none.
    notes : tuple of Finding
        What a user should know about the reading.
    """

    crs: str
    ids: tuple[str, ...]
    roles: tuple[Role, ...]
    coordinates: Array
    sigma_enu_m: Array
    fixed: npt.NDArray[np.bool_]
    images: tuple[str, ...] = ()
    observed: ImagePoints = field(default_factory=no_image_points)
    lines: npt.NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    notes: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        if not len(self.lines):
            object.__setattr__(self, "lines", np.zeros(len(self.ids), np.int64))

    @property
    def located(self) -> npt.NDArray[np.bool_]:
        """Points with horizontal coordinates: (n,)."""
        return np.asarray(np.isfinite(self.coordinates[:, :2]).all(axis=1))

    def of_role(self, role: Role) -> npt.NDArray[np.bool_]:
        """Tell which points have a role: (n,)."""
        return np.fromiter((one is role for one in self.roles), bool, len(self.roles))

    def take(self, rows: npt.NDArray[np.bool_]) -> Survey:
        """Give some of the ground points, and the image points of these only."""
        kept = np.flatnonzero(rows)
        number = np.full(len(self.ids), -1, np.intp)
        number[kept] = np.arange(len(kept))
        left = self.observed.take(rows[self.observed.point])
        return replace(
            self, ids=tuple(self.ids[k] for k in kept), roles=tuple(self.roles[k] for k in kept),
            coordinates=self.coordinates[kept], sigma_enu_m=self.sigma_enu_m[kept], fixed=self.fixed[kept],
            lines=self.lines[kept], observed=replace_points(left, number[left.point]),
        )  # fmt: skip


def replace_points(observed: ImagePoints, point: Index) -> ImagePoints:
    """Image points that belong to other positions of ground points."""
    o = observed
    return ImagePoints(o.image, point, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px)


class Gathering:
    """Collects the records of a file one by one and notes ids that meet twice.

    Points that only image records name become tie points.

    Parameters
    ----------
    faults : Faults
        Of the file being read; exchange it before the next file.
    """

    def __init__(self, faults: Faults) -> None:
        self.faults = faults
        self._point: dict[str, int] = {}
        self._image: dict[str, int] = {}
        self._ground: list[tuple[Role, Sequence[float], Sequence[float], bool, int]] = []
        self._measured: dict[tuple[int, int], tuple[Sequence[float], Sequence[float], int]] = {}

    def point(
        self, name: str, role: Role, coordinates: Sequence[float], sigma: Sequence[float] = UNKNOWN, *,
        line: int, fixed: bool = False,
    ) -> None:  # fmt: skip
        """Take a ground point."""
        if not name:
            self.faults.add("points.id_missing", place=f"line {line}")
        elif name in self._point:
            first = self._ground[self._point[name]][4]
            self.faults.add("points.id_twice", place=f"line {line}", value=name, first=first)
        else:
            self._point[name] = len(self._ground)
            self._ground.append((role, coordinates, sigma, fixed, line))

    def has(self, name: str) -> bool:
        """Tell whether a point of this id was taken."""
        return name in self._point

    def measure(
        self, image: str, name: str, line_px: float, sample_px: float,
        sigma: Sequence[float] = UNKNOWN[:2], *, line: int,
    ) -> None:  # fmt: skip
        """Take an image point: pixels with (0, 0) in the centre of the first pixel, sigmas of line and sample."""
        if not image or not name:
            self.faults.add("interchange.name_missing", place=f"line {line}")
            return
        if name not in self._point:
            self.point(name, Role.TIE, UNKNOWN, line=line)
        key = self._image.setdefault(image, len(self._image)), self._point[name]
        if key in self._measured:
            first = self._measured[key][2]
            self.faults.add("observations.twice", place=f"line {line}", value=f"{name} in {image}", first=first)
        else:
            self._measured[key] = ((line_px, sample_px), sigma, line)

    def finished(self, crs: str, *, notes: Sequence[Finding] = ()) -> Survey:
        """Give what was taken.

        Raises
        ------
        InputError
            Faults were noted, or nothing was taken.
        """
        if not self._ground and not self.faults:
            self.faults.add("interchange.empty")
        self.faults.raise_if_any()
        roles, xyz, sigma, fixed, lines = zip(*self._ground, strict=True)
        pairs = np.array(list(self._measured), np.intp).reshape(-1, 2)
        pixels = np.array([m[0] for m in self._measured.values()], float).reshape(-1, 2)
        sigmas = np.array([m[1] for m in self._measured.values()], float).reshape(-1, 2)
        return Survey(
            crs, tuple(self._point), roles, np.array(xyz, float), np.array(sigma, float), np.array(fixed, bool),
            tuple(self._image), ImagePoints(*pairs.T, *pixels.T, *sigmas.T), np.array(lines, np.int64), tuple(notes),
        )  # fmt: skip
