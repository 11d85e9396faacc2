"""Common data structure of all point formats: ground points and their image points.

Coordinates remain in the CRS of the file, with longitude or easting first. If the data
are written in the same format again, the file is therefore the same. Pixels are (line,
sample); (0, 0) is the centre of the first pixel. Readers and writers convert the pixel
origin of their format. A value that the file does not contain is nan, or "" for the CRS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array, Mask
from fg_orient.formats.faults import Faults
from fg_orient.geodesy import crs_kind
from fg_orient.geodesy.crs import epsg_code, same_horizontal, with_codes
from fg_orient.model.block import ImagePoints
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import Role

UNKNOWN: Final = (np.nan, np.nan, np.nan)
#: Maximum number of characters of a CRS in a note.
_LONG: Final = 80


def no_image_points() -> ImagePoints:
    """Return an empty set of image points, for files without image points."""
    none, nobody = np.empty(0), np.empty(0, np.intp)
    return ImagePoints(nobody, nobody, none, none, none, none)


@dataclass(frozen=True, eq=False)
class Survey:
    """Ground points and image points of a file.

    Parameters
    ----------
    crs : str
        ``EPSG:n`` or ``EPSG:n+m``; "" if unknown.
    ids, roles : tuples of length n
        Ids and roles of the ground points. Tie points have no coordinates.
    coordinates : (n, 3) array
        Longitude, latitude (degrees), height (m); or easting, northing, height (m); or x,
        y, z (m). Unknown values are nan.
    sigma_enu_m : (n, 3) array
        Standard deviations East, North, Up at the point, m; nan where unknown.
    fixed : (n,) array of bool
        Mask of the points without uncertainty.
    images : tuple of str
        Ids of the images.
    observed : ImagePoints
        Image points: positions in ``images`` and ``ids``, pixels, and standard deviations (nan if unknown).
    lines : (n,) int array
        Line of each ground point in its file, for messages; 0 if it has no line.
    unit : str
        "line", or "row" if the file has no lines.
    starts : (n, 3) array, optional
        Approximate coordinates of tie points; nan for other points.
    notes : tuple of Finding
        Remarks of the reader for the user.
    """

    crs: str
    ids: tuple[str, ...]
    roles: tuple[Role, ...]
    coordinates: Array
    sigma_enu_m: Array
    fixed: Mask
    images: tuple[str, ...] = ()
    observed: ImagePoints = field(default_factory=no_image_points)
    lines: npt.NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    notes: tuple[Finding, ...] = ()
    unit: str = "line"
    starts: Array | None = None

    def __post_init__(self) -> None:
        if not len(self.lines):
            object.__setattr__(self, "lines", np.zeros(len(self.ids), np.int64))

    def place(self, k: int) -> str:
        """Return the place of a ground point in its file, for messages."""
        return f"{self.unit} {self.lines[k]}"

    @property
    def located(self) -> Mask:
        """Return a mask (n,) of the points with horizontal coordinates."""
        return np.asarray(np.isfinite(self.coordinates[:, :2]).all(axis=1))


def decided_crs(stated: str, given: str, file: object) -> tuple[str, tuple[Finding, ...]]:
    """Determine the EPSG code; the file, the user or both may state it.

    Parameters
    ----------
    stated : str
        Code, WKT or PROJ string in the file; "" if the file does not state a CRS.
    given : str
        EPSG code from the user; "" if the user does not give one. It may add a vertical
        CRS to the CRS of the file. If the text in the file is not a CRS of EPSG, the code
        replaces it, and a note is returned.
    file : object
        The file; used in messages.

    Raises
    ------
    InputError
        Neither of them states a CRS, the CRS is not in EPSG, or the two CRS differ.
    """
    own = epsg_code(stated) if stated.strip() else ""
    if given:
        given = with_codes(given)
        crs_kind(given)
        if own and not same_horizontal(own, given):
            raise InputError.of("interchange.crs_differs", file=file, place="CRS", value=own, given=given)
        replaced = "" if own else " ".join(stated.split())
        text = replaced if len(replaced) <= _LONG else replaced[: _LONG - 3] + "..."
        return given, (finding("points.crs_replaced", stated=text, crs=given),) if replaced else ()
    if not stated.strip():
        raise InputError.of("interchange.no_crs", file=file, place="CRS")
    if not own:
        raise InputError.of("interchange.crs_unknown", file=file, place="CRS", value=stated)
    crs_kind(own)
    return own, ()


class Gathering:
    """Collector that takes the records of a file one by one and notes ids that occur twice.

    A point that has only image points becomes a tie point.

    Parameters
    ----------
    path : Path
        File to read.
    given, stated : str
        CRS from the user and from the file; see :func:`decided_crs`.

    Attributes
    ----------
    faults : Faults
        Faults of the current file; replace this object before the next file is read.
    crs : str
    notes : tuple of Finding
    """

    def __init__(self, path: Path, given: str, stated: str = "") -> None:
        self.faults = Faults(str(path))
        self.crs, self.notes = decided_crs(stated, given, path)
        self._point: dict[str, int] = {}
        self._image: dict[str, int] = {}
        self._ground: list[tuple[Role, Sequence[float], Sequence[float], bool, int]] = []
        self._starts: dict[str, Sequence[float]] = {}
        self._measured: dict[tuple[int, int], tuple[Sequence[float], Sequence[float], int]] = {}

    def point(
        self, name: str, role: Role, coordinates: Sequence[float], sigma: Sequence[float] = UNKNOWN, *,
        line: int, fixed: bool = False,
    ) -> None:  # fmt: skip
        """Add a ground point; outer blanks do not belong to its id."""
        name = name.strip()
        if not name:
            self.faults.add("points.id_missing", place=f"line {line}")
        elif name in self._point:
            first = self._ground[self._point[name]][4]
            self.faults.add("points.id_twice", place=f"line {line}", value=name, first=f"line {first}")
        else:
            self._point[name] = len(self._ground)
            self._ground.append((role, coordinates, sigma, fixed, line))

    def start(self, name: str, coordinates: Sequence[float]) -> None:
        """Add approximate coordinates of a tie point."""
        self._starts[name.strip()] = coordinates

    def feature(
        self, name: str, role: str, coordinates: Sequence[float], sigma: Sequence[float], *, number: int, fixed: bool
    ) -> None:
        """Add a control or check point of a layer; ``number`` counts from 1.

        Standard deviations must be > 0 or nan.
        """
        if role not in (Role.CONTROL, Role.CHECK):
            self.faults.add("points.role", place=f"feature {number}", value=repr(role))
        elif any(value <= 0.0 for value in sigma):
            self.faults.add("points.sigma_not_positive", place=f"feature {number}", value=name)
        else:
            self.point(name, Role(role), coordinates, sigma, line=number, fixed=fixed)

    def measure(
        self, image: str, name: str, line_px: float, sample_px: float,
        sigma: Sequence[float] = UNKNOWN[:2], *, line: int,
    ) -> None:  # fmt: skip
        """Add an image point with line, sample and their standard deviations; (0, 0) is the first pixel's centre."""
        image, name = image.strip(), name.strip()
        if not image or not name:
            self.faults.add("interchange.name_missing", place=f"line {line}")
            return
        if name not in self._point:
            self.point(name, Role.TIE, UNKNOWN, line=line)
        key = self._image.setdefault(image, len(self._image)), self._point[name]
        if key in self._measured:
            first = self._measured[key][2]
            self.faults.add(
                "observations.twice", place=f"line {line}", value=f"{name} in {image}", first=f"line {first}"
            )
        else:
            self._measured[key] = ((line_px, sample_px), sigma, line)

    def finished(self) -> Survey:
        """Return the survey of all records; raise InputError if there are faults or no records."""
        if not self._ground and not self.faults:
            self.faults.add("interchange.empty")
        self.faults.raise_if_any()
        roles, xyz, sigma, fixed, lines = zip(*self._ground, strict=True)
        pairs = np.array(list(self._measured), np.intp).reshape(-1, 2)
        pixels = np.array([m[0] for m in self._measured.values()], float).reshape(-1, 2)
        sigmas = np.array([m[1] for m in self._measured.values()], float).reshape(-1, 2)
        return Survey(
            self.crs, tuple(self._point), roles, np.array(xyz, float), np.array(sigma, float), np.array(fixed, bool),
            tuple(self._image), ImagePoints(*pairs.T, *pixels.T, *sigmas.T), np.array(lines, np.int64), self.notes,
            starts=np.array([self._starts.get(name, UNKNOWN) for name in self._point]) if self._starts else None,
        )  # fmt: skip
