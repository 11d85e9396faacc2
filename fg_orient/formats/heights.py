"""Convert heights above a zero level that PROJ does not contain to ellipsoidal heights.

The user gives the zero level by a geoid file, by a constant undulation, or by a table of
points with both heights. The constant is estimated from such a table. The conversion is
done when a table is read. The CRS of the survey then has no vertical part.

If PROJ does not find the grid of a compound CRS, a file with the same grid under another name
in PROJ's folders is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Self

import numpy as np

from factors.arrays import Array, Index
from fg_orient.formats.both_heights import estimated
from fg_orient.formats.exchange.survey import Survey
from fg_orient.geodesy import (
    BODY_FIXED,
    crs_kind,
    ecef_to_geodetic,
    geodetic_to_ecef,
    known_crs,
    longitude_latitude,
    operation_to_ecef,
    spatial_crs,
    to_geographic,
)
from fg_orient.geodesy.crs import from_ecef
from fg_orient.geodesy.geoid import LIMIT_M, GeoidFile, world_undulation_m
from fg_orient.geodesy.heights import found_grid, vertical_reference
from fg_orient.model.block import GroundSystem
from fg_orient.model.errors import Finding, InputError, finding
from fg_orient.model.names import MAX_UNDULATION_M

#: Semi-major axis and flattening: an ellipsoid with these values is treated as WGS84; the difference is below 0.1 mm.
_WGS84: Final = (6378137.0, 1.0 / 298.2572)


@dataclass(frozen=True)
class ZeroLevel:
    """Zero level of the heights of a table, as the user states it; at most one of the three fields is set.

    Parameters
    ----------
    geoid : Path, optional
        Raster of undulations, in a format that GDAL reads.
    undulation_m : float, optional
        Height of the zero level above the WGS84 ellipsoid.
    both_heights : Path, optional
        Table of points with both heights.
    """

    geoid: Path | None = None
    undulation_m: float | None = None
    both_heights: Path | None = None

    def __post_init__(self) -> None:
        if self.undulation_m is not None and not abs(self.undulation_m) <= MAX_UNDULATION_M:
            expected = f"a number from {-MAX_UNDULATION_M:g} to {MAX_UNDULATION_M:g} in m"
            raise InputError.of("options.value", option="undulation_m", value=self.undulation_m, expected=expected)

    @classmethod
    def of(cls, entry: object, folder: Path) -> Self:
        """Read the zero level from an entry of a project file; paths are relative to ``folder``."""
        geoid, both = (getattr(entry, name, None) for name in ("geoid", "both_heights"))
        geoid, both = (None if name is None else (folder / name).absolute() for name in (geoid, both))
        return cls(geoid, getattr(entry, "undulation_m", None), both)

    def __bool__(self) -> bool:
        return any(value is not None for value in (self.geoid, self.undulation_m, self.both_heights))

    @property
    def files(self) -> tuple[Path, ...]:
        """Return the files that the zero level names."""
        return tuple(path for path in (self.geoid, self.both_heights) if path is not None)

    def system(self, crs: str) -> GroundSystem:
        """Return the zero level together with the CRS of the table, as a block stores them."""
        constant = self.undulation_m if self.both_heights is None else estimated(self.both_heights).undulation_m
        return GroundSystem(_flat(crs) if self else crs, "" if self.geoid is None else str(self.geoid), constant)

    def applied(self, survey: Survey) -> Survey:
        """Return the survey with ellipsoidal heights and a note on the conversion.

        Raises
        ------
        InputError
            More than one zero level is given, or a file cannot be used or does not cover a point.
        """
        if sum(value is not None for value in (self.geoid, self.undulation_m, self.both_heights)) > 1:
            raise InputError.of("heights.two_ways")
        if not self:
            return survey
        if survey.crs and crs_kind(survey.crs) == "geocentric":
            raise InputError.of("heights.geocentric", value=survey.crs)
        if self.geoid is not None:
            file = GeoidFile(self.geoid)
            return _by_geoid(survey, file)
        estimate = None if self.both_heights is None else estimated(self.both_heights)
        constant = self.undulation_m if estimate is None else estimate.undulation_m
        assert constant is not None
        notes = (finding("heights.constant", undulation_m=constant),) if estimate is None else estimate.notes
        lonlat, rows = _places(survey)
        notes += _odd_constant(constant, lonlat)
        return _raised(survey, rows, lonlat, np.full(len(rows), constant), notes)


def coordinates_in(system: GroundSystem, xyz_m: Array) -> tuple[Array, str]:
    """Convert ECEF points (n, 3), m, to coordinates (n, 3) in the CRS of a table, with heights above its zero level.

    This is the inverse of the conversion by the readers. The second returned value
    describes the heights in words; it is "" if the CRS is geocentric. InputError: the CRS
    is unknown, or a geoid file or grid is missing or does not cover a point.
    """
    if system.crs == BODY_FIXED:
        return xyz_m, ""
    if crs_kind(system.crs) == "geocentric":
        return from_ecef(system.crs, xyz_m)[0], ""
    lon, lat, height = ecef_to_geodetic(xyz_m)
    if system.geoid:
        grid = GeoidFile(Path(system.geoid))
        words, undulation = f"above the geoid of {grid.path.name}", grid.undulation_m(lon, lat)
    elif system.undulation_m is not None:
        words = f"above a zero level {system.undulation_m:.3f} m above the WGS84 ellipsoid"
        undulation = np.full(len(height), system.undulation_m)
    else:
        name = vertical_reference(system.crs)[0]
        words = f"above the zero level of {name}" if name else "ellipsoidal"
        try:
            return from_ecef(system.crs, xyz_m)[0], words
        except InputError as error:
            if (found := found_grid(error)) is None:
                raise
            undulation = found.undulation_m(lon, lat)
    out = from_ecef(_flat(system.crs), xyz_m)[0]
    out[:, 2] = height - undulation  # undulations refer to the WGS84 ellipsoid, whatever the ellipsoid of the CRS
    return out, words


def without_vertical(survey: Survey) -> Survey:
    """Return the survey with the horizontal part of its CRS only."""
    return replace(survey, crs=_flat(survey.crs))


def _flat(crs: str) -> str:
    """Return the code of the horizontal part of a CRS."""
    own = known_crs(crs) if crs and crs != BODY_FIXED else None
    return f"EPSG:{own.sub_crs_list[0].to_epsg()}" if own is not None and own.is_compound else crs


def on_found_grid(survey: Survey) -> Survey:
    """Convert a survey to ellipsoidal heights with a grid of another name, if PROJ does not find the grid of its CRS.

    Otherwise the survey is unchanged. A note is added if its CRS does not state that heights are ellipsoidal.
    """
    if not survey.crs or not survey.located.any() or crs_kind(survey.crs) == "geocentric":
        return survey
    name = vertical_reference(survey.crs)[0]
    if not name:
        stated = len(known_crs(survey.crs).axis_info) == 3
        return survey if stated else _noted(survey, finding("heights.ellipsoidal", crs=survey.crs))
    error = lacking_operation(survey)
    grid = None if error is None else found_grid(error)
    if grid is None:
        return survey  # the transformation to ECEF refuses it
    return _by_geoid(_noted(survey, finding("heights.found", name=name, grid=grid.path.name)), grid)


def lacking_operation(survey: Survey) -> InputError | None:
    """Return the error if PROJ cannot transform the CRS to ECEF without the grid of its heights; else None."""
    try:
        operation_to_ecef(survey.crs, spatial_crs(survey.crs), _places(survey)[0])
    except InputError as error:
        return error
    return None


def _noted(survey: Survey, *notes: Finding) -> Survey:
    return replace(survey, notes=(*survey.notes, *notes))


def _places(survey: Survey) -> tuple[Array, Index]:
    """Return WGS84 longitude and latitude (n, 2), degrees, and the rows (n,) of all points that have coordinates."""
    rows = np.flatnonzero(survey.located)
    return _lonlat(survey.crs, survey.coordinates[rows]), rows


def _lonlat(crs: str, coordinates: Array) -> Array:
    """Transform coordinates to WGS84 longitude and latitude (n, 2), degrees."""
    if not crs or not len(coordinates):
        return np.empty((0, 2))
    if crs_kind(crs) == "geocentric":
        return longitude_latitude(crs, spatial_crs(crs), "geocentric", coordinates, None)
    return np.stack(to_geographic(_flat(crs), *coordinates[:, :2].T), axis=1)


def _by_geoid(survey: Survey, grid: GeoidFile) -> Survey:
    """Add the undulations of a geoid file to the heights of a survey."""
    lonlat, rows = _places(survey)
    if not len(rows):
        return without_vertical(survey)
    undulation = grid.undulation_m(*lonlat.T)
    note = finding("heights.geoid", grid=grid.path.name, least=float(undulation.min()), most=float(undulation.max()))
    return _raised(survey, rows, lonlat, undulation, (note,))


def _raised(survey: Survey, rows: Index, lonlat: Array, undulation: Array, notes: Sequence[Finding]) -> Survey:
    """Add undulations (n,) to the heights of some rows of a survey.

    Undulations refer to the WGS84 ellipsoid. If the CRS has another ellipsoid, the points
    are transformed to ECEF, and the heights above that ellipsoid are computed from their
    positions in space.
    """
    survey = _noted(without_vertical(survey), *notes)
    coordinates = survey.coordinates.copy()
    coordinates[rows, 2] += undulation
    own = known_crs(survey.crs).ellipsoid
    if own and (abs(own.semi_major_metre - _WGS84[0]) > 1e-4 or abs(1.0 / own.inverse_flattening - _WGS84[1]) > 1e-9):
        xyz = geodetic_to_ecef(lonlat[:, 0], lonlat[:, 1], coordinates[rows, 2])
        coordinates[rows] = from_ecef(survey.crs, xyz)[0]
    return replace(survey, coordinates=coordinates)


def _odd_constant(constant: float, lonlat: Array) -> tuple[Finding, ...]:
    """Return a warning if a constant undulation differs much from the Earth's geoid at the points."""
    apart = constant - float(np.median(world_undulation_m(*lonlat.T))) if len(lonlat) else 0.0
    if abs(apart) <= LIMIT_M:
        return ()
    opposite = abs(apart - 2.0 * constant) <= LIMIT_M / 2.0
    text = "; with the opposite sign it would fit" if opposite else ""
    return (finding("heights.odd_constant", undulation_m=constant, apart_m=apart, opposite=text),)
