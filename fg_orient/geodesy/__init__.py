"""Transformations between coordinate reference systems by PROJ, with checks of operation and result.

Inside the package a ground point is Earth-fixed Cartesian (ECEF, WGS84, EPSG:4978) in metres. Files may use
any EPSG code. Four properties of PROJ that cause silent errors are avoided. The axis order is always easting
or longitude first. Results must be finite. The network is off. A "ballpark" transformation, which returns
heights unchanged if a geoid grid is missing, is never used. Grids are also searched for in the folders of
PROJ_DATA, which the wheel of pyproj ignores. Heights are above the ellipsoid of the named CRS, unless a
compound code such as ``EPSG:4326+5773`` names a vertical CRS (:mod:`fg_orient.geodesy.heights`). All points
of a call use one operation, the best for their area; the record contains its name and accuracy.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.model.errors import InputError, finding
from fg_orient.model.limits import within

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

__all__ = ["ecef_to_geodetic", "enu_from_ecef", "from_geographic", "geodetic_to_ecef", "to_ecef", "to_geographic"]

Kind = Literal["geographic", "projected", "geocentric"]

ECEF: Final = "EPSG:4978"
#: Word used instead of an EPSG code for Cartesian coordinates, m, in the axes of the body that the images show.
BODY_FIXED: Final = "body-fixed"
#: WGS84 as defined by PROJ and EPSG.
_A_M: Final = 6378137.0
_E2: Final = (2.0 - 1.0 / 298.257223563) / 298.257223563
#: Columns of a point table, for each kind of CRS.
COORDINATE_COLUMNS: Final[dict[Kind, tuple[str, str, str]]] = {
    "geographic": ("lon_deg", "lat_deg", "height_m"),
    "projected": ("easting_m", "northing_m", "height_m"),
    "geocentric": ("x_m", "y_m", "z_m"),
}
_CODE = re.compile(r"EPSG:[0-9]{1,6}(\+[0-9]{1,6})?", re.IGNORECASE)
#: Codes of the International Astronomical Union, for bodies other than the Earth.
_IAU = re.compile(r"IAU_2015:[0-9]{3,10}", re.IGNORECASE)
#: Margin of the area of interest around the points, degrees.
_AREA_MARGIN_DEG: Final = 0.01


@dataclass(frozen=True)
class Operation:
    """Coordinate operation of PROJ, for the provenance record.

    Parameters
    ----------
    crs : str
        Source CRS, such as ``EPSG:32636``.
    name : str
        PROJ's name of the operation.
    accuracy_m : float
        Accuracy stated by PROJ; nan if there is none.
    missing_grids : tuple of str
        Grid files that a more accurate operation would need; empty if the best one was used.
    height : str
        "ellipsoidal height" or the name of the vertical CRS; "" if the CRS is geocentric.
    """

    crs: str
    name: str
    accuracy_m: float
    missing_grids: tuple[str, ...] = ()
    height: str = ""

    def __str__(self) -> str:
        accuracy = "unknown accuracy" if np.isnan(self.accuracy_m) else f"accuracy {self.accuracy_m:g} m"
        better = f"; a better one needs {', '.join(self.missing_grids)}" if self.missing_grids else ""
        height = f" ({self.height})" if self.height else ""
        return f"{self.crs}{height} to {ECEF} by {self.name} ({accuracy}){better}"


def crs_kind(crs: str) -> Kind:
    """Return the kind of the coordinates in ``crs``: geographic, projected or geocentric.

    Raise InputError if the code is unknown, or if the axes are not degrees or metres towards east, north, up.
    """
    if crs == BODY_FIXED:
        return "geocentric"
    if is_of_body(crs):
        return _kind_on_body(crs)
    source = spatial_crs(crs)
    tests: dict[Kind, bool] = {
        "geocentric": source.is_geocentric,
        "projected": source.is_projected,
        "geographic": source.is_geographic,
    }
    kind = next((name for name, fits in tests.items() if fits), None)
    if kind is None or len(source.axis_info) != 3:
        raise InputError.of("geodesy.not_spatial", place="crs", value=f"{crs}, {source.name}")
    horizontal = "degree" if kind == "geographic" else "metre"
    units = [axis.unit_name for axis in source.axis_info]
    backwards = {axis.direction for axis in source.axis_info} & {"west", "down"}
    if units != [horizontal, horizontal, "metre"] or backwards:
        axes = ", ".join(f"{axis.direction} {axis.unit_name}" for axis in source.axis_info)
        raise InputError.of("geodesy.axes", place="crs", value=f"{crs}: {axes}", unit=horizontal)
    return kind


def is_of_body(crs: str) -> bool:
    """Return whether a CRS is a code of a body other than the Earth, such as ``IAU_2015:30100``."""
    return _IAU.fullmatch(crs.strip()) is not None


def _kind_on_body(crs: str) -> Kind:
    """Kind of a code of the IAU: longitude and latitude, or a map of a sphere; InputError if it is another one."""
    own = known_crs(crs.strip().upper())
    if any(axis.direction not in ("north", "east") for axis in own.axis_info) or len(own.axis_info) != 2:
        axes = ", ".join(f"{axis.direction} {axis.unit_name}" for axis in own.axis_info)
        raise InputError.of("geodesy.body_axes", place="crs", value=f"{crs}: {axes}")
    if not own.is_projected:
        return "geographic"
    shape = own.ellipsoid
    if shape is None or shape.semi_minor_metre not in (0.0, shape.semi_major_metre):
        raise InputError.of("geodesy.body_axes", place="crs", value=f"{crs}: {own.name}")
    return "projected"


def to_ecef(
    crs: str,
    east_or_lon: npt.ArrayLike,
    north_or_lat: npt.ArrayLike,
    height: npt.ArrayLike,
) -> Array:
    """Transform N points of any EPSG CRS to ECEF.

    Parameters
    ----------
    crs : str
        ``EPSG:n``, or ``EPSG:n+m`` with a vertical CRS.
    east_or_lon, north_or_lat, height : (N,) array_like
        Easting and northing (m) or longitude and latitude (degrees), and height (m); x, y, z (m) if the CRS is
        geocentric. This order holds for any definition of the CRS.

    Returns
    -------
    (N, 3) array
        ECEF coordinates in m.

    Raises
    ------
    InputError
        The CRS is unknown, there is no exact operation (a grid is missing), or a point lies outside the domain.
    """
    return to_ecef_with_operation(crs, east_or_lon, north_or_lat, height)[0]


def to_ecef_with_operation(
    crs: str,
    east_or_lon: npt.ArrayLike,
    north_or_lat: npt.ArrayLike,
    height: npt.ArrayLike,
    *,
    labels: Sequence[str] | None = None,
    deciding: npt.NDArray[np.bool_] | None = None,
) -> tuple[Array, Operation]:
    """Return the ECEF coordinates as in :func:`to_ecef`, and the operation.

    Messages contain the places ``labels`` of the points. The operation is the best for the area of the points
    ``deciding`` (N,), or of all points if there are none.
    """
    first, second, third = (np.atleast_1d(np.asarray(a, float)) for a in (east_or_lon, north_or_lat, height))
    source, kind = spatial_crs(crs), crs_kind(crs)
    given = np.stack([first, second, third], axis=1)
    require_finite(crs, given, given, labels)
    lonlat = longitude_latitude(crs, source, kind, given, labels)
    some = deciding is not None and bool(deciding.any())
    transformer, operation = operation_to_ecef(crs, source, lonlat[deciding] if some else lonlat)
    xyz = np.stack(transformer.transform(first, second, third), axis=1)
    require_finite(crs, xyz, given, labels)
    return np.ascontiguousarray(xyz), operation


def geodetic_to_ecef(lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike, height_m: npt.ArrayLike) -> Array:
    """Transform WGS84 geodetic coordinates to ECEF.

    Parameters
    ----------
    lon_deg, lat_deg, height_m : (N,) array_like
        Longitude, latitude, ellipsoidal height.

    Returns
    -------
    (N, 3) array
        ECEF coordinates in m.

    Raises
    ------
    InputError
        A coordinate is not finite.
    """
    given = np.stack([np.atleast_1d(np.asarray(a, float)) for a in (lon_deg, lat_deg, height_m)], axis=1)
    require_finite("EPSG:4979", given, given, None)
    # one operation for all places, so that PROJ does not search each time
    xyz = np.stack(_transformer("EPSG:4979", ECEF).transform(*given.T), axis=1)
    require_finite("EPSG:4979", xyz, given, None)
    return np.ascontiguousarray(xyz)


def ecef_to_geodetic(xyz_m: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Transform (N, 3) ECEF m to WGS84 longitude, latitude (degrees) and ellipsoidal height (m), each (N,).

    The latitude is iterated (docs/equations.md 5); each step multiplies the error by e^2 = 0.0067. PROJ is not used,
    because its single step has errors of 1e-6 m at 9 km height and 7 mm at the height of a satellite.

    Raises
    ------
    InputError
        A coordinate is not finite.
    """
    xyz = np.atleast_2d(np.asarray(xyz_m, float))
    require_finite(ECEF, xyz, xyz, None)
    x, y, z = xyz.T
    p = np.hypot(x, y)
    lat = np.arctan2(z, p * (1.0 - _E2))
    for _ in range(9):
        sine = np.sin(lat)
        lat = np.arctan2(z + _E2 * _A_M / np.sqrt(1.0 - _E2 * sine * sine) * sine, p)
    sine = np.sin(lat)
    height = p * np.cos(lat) + z * sine - _A_M * np.sqrt(1.0 - _E2 * sine * sine)
    return np.degrees(np.arctan2(y, x)), np.degrees(lat), height


def from_geographic(crs: str, lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike) -> tuple[Array, Array]:
    """Transform WGS84 longitude and latitude to horizontal coordinates of a raster's CRS.

    Parameters
    ----------
    crs : str
        WKT or EPSG code; its vertical part is ignored.
    lon_deg, lat_deg : (N,) array_like

    Returns
    -------
    x, y : (N,) arrays
        In the units of the CRS; nan outside its domain.

    Raises
    ------
    InputError
        The CRS is unknown, or there is no exact operation to it.
    """
    return _horizontal("EPSG:4326", crs, lon_deg, lat_deg)


def to_geographic(crs: str, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Array, Array]:
    """Transform horizontal coordinates (N,) of a raster's CRS to WGS84 longitude, latitude (N,) degrees.

    This is the inverse of :func:`from_geographic` and raises the same errors; nan outside the domain of the CRS.
    """
    return _horizontal(crs, "EPSG:4326", x, y)


def _horizontal(source: str, target: str, first: npt.ArrayLike, second: npt.ArrayLike) -> tuple[Array, Array]:
    """Return the horizontal coordinates of N points in another CRS; nan outside its domain."""
    first, second = np.atleast_1d(np.asarray(first, float)), np.atleast_1d(np.asarray(second, float))
    x, y = (np.asarray(a) for a in _transformer(source, target, horizontal=True).transform(first, second))
    inside = np.isfinite(x) & np.isfinite(y)
    return np.where(inside, x, np.nan), np.where(inside, y, np.nan)


def same_crs(one: str, other: str) -> bool:
    """Return whether two CRS (WKT or EPSG codes) differ only in axis order; raise InputError if one is unknown."""
    return bool(known_crs(one).equals(known_crs(other), ignore_axis_order=True))


def area_of_use(crs: str) -> tuple[float, float, float, float] | None:
    """Return west, south, east, north (degrees) of the area of use of a CRS; None if it states none."""
    area = known_crs(crs).area_of_use
    return None if area is None else (area.west, area.south, area.east, area.north)


def enu_from_ecef(lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike) -> Array:
    """Return the rotations from ECEF to East, North, Up.

    Parameters
    ----------
    lon_deg, lat_deg : (N,) array_like

    Returns
    -------
    (N, 3, 3) array
        The rows are the unit vectors of East, North and Up in ECEF; Up is the ellipsoid normal.
    """
    lon, lat = np.broadcast_arrays(*(np.radians(np.atleast_1d(np.asarray(a, float))) for a in (lon_deg, lat_deg)))
    sl, cl, sp, cp = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat)
    rows = [[-sl, cl, np.zeros_like(sl)], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def data_folder() -> str:
    """Return the folders from which PROJ reads its database and grids."""
    proj = offline_pyproj()
    return str(proj.datadir.get_data_dir())


def grid_folders() -> tuple[str, ...]:
    """Return the folders in which PROJ searches for grids."""
    proj = offline_pyproj()
    return (*data_folder().split(os.pathsep), str(proj.datadir.get_user_data_dir()))


# --- PROJ, guarded -------------------------------------------------------------------------------


def offline_pyproj() -> Any:
    """Import pyproj without network access, on which results must not depend, and with PROJ_DATA searched last."""
    import pyproj
    import pyproj.network

    pyproj.network.set_network_enabled(active=False)  # type: ignore[attr-defined]
    known = pyproj.datadir.get_data_dir().split(os.pathsep)
    for folder in os.environ.get("PROJ_DATA", "").split(os.pathsep):
        if folder and folder not in known and os.path.isdir(folder):
            pyproj.datadir.append_data_dir(folder)
    return pyproj


#: Exceptions that pyproj raises, in addition to its own, for texts that do not describe a CRS.
UNUSABLE: Final = (ValueError, TypeError, KeyError, AttributeError, RecursionError)


@cache
def _transformer(source: str, target: str, *, horizontal: bool = False) -> Transformer:
    """Return the cached transformer between two CRS: easting or longitude first, never a ballpark."""
    proj = offline_pyproj()
    try:
        goal = proj.CRS.from_user_input(target)
        goal = horizontal_part(goal) if horizontal else goal
        made: Transformer = proj.Transformer.from_crs(source, goal, always_xy=True, allow_ballpark=False)
    except proj.exceptions.CRSError:
        raise InputError.of("geodesy.unknown_crs", place="crs", value=target) from None
    except proj.exceptions.ProjError:
        raise InputError.of("geodesy.no_operation", place="crs", value=target, grids="a grid or datum shift") from None
    return made


def spatial_crs(crs: str) -> CRS:
    """Return the CRS of the code; add an ellipsoidal height axis if it has no height axis."""
    text = str(crs).strip()
    if not _CODE.fullmatch(text):
        raise InputError.of("geodesy.not_epsg", place="crs", value=crs)
    return _spatial(text.upper())


@cache
def _spatial(crs: str) -> CRS:
    own = known_crs(crs)
    return own if own.is_compound or own.is_geocentric or own.is_vertical else own.to_3d()


@cache
def known_crs(crs: str) -> CRS:
    """Return the CRS of a code, WKT or PROJ string; raise InputError if it is unknown."""
    proj = offline_pyproj()
    within("crs_characters", len(crs), place="crs", unit="characters")
    try:
        known: CRS = proj.CRS.from_user_input(crs)
        known.to_json_dict()  # a damaged definition fails only here
    except (proj.exceptions.ProjError, *UNUSABLE):
        raise InputError.of("geodesy.unknown_crs", place="crs", value=crs) from None
    return known


def horizontal_part(crs: CRS) -> CRS:
    """Return the horizontal part of a CRS."""
    return crs.sub_crs_list[0] if crs.is_compound else crs.to_2d()


def unprojected(source: CRS, first: Array, second: Array) -> Array:
    """Return longitude, latitude (n, 2), degrees, of coordinates of a projected CRS on its own datum."""
    flat = horizontal_part(source).to_2d()
    back = offline_pyproj().Transformer.from_crs(flat, flat.geodetic_crs, always_xy=True)
    return np.stack(back.transform(first, second), axis=1)


def longitude_latitude(crs: str, source: CRS, kind: Kind, given: Array, labels: Sequence[str] | None) -> Array:
    """Return longitude, latitude (N, 2) degrees on the datum of the CRS itself, to choose an operation."""
    if kind == "geographic":
        return np.asarray(given[:, :2])
    if kind == "geocentric":
        p = np.hypot(given[:, 0], given[:, 1])
        angles = np.stack([np.arctan2(given[:, 1], given[:, 0]), np.arctan2(given[:, 2], p)], axis=1)
        return np.asarray(np.degrees(angles))
    lonlat = unprojected(source, given[:, 0], given[:, 1])
    require_finite(crs, lonlat, given, labels)
    return np.asarray(lonlat, float)


def operation_to_ecef(crs: str, source: CRS, lonlat: Array) -> tuple[Transformer, Operation]:
    """Return the best operation to ECEF for the area of points (N, 2) in degrees, never a ballpark; and its record.

    Raise InputError if there is no such operation.
    """
    proj = offline_pyproj()
    from pyproj.transformer import AreaOfInterest, TransformerGroup

    low, high = lonlat.min(axis=0) - _AREA_MARGIN_DEG, lonlat.max(axis=0) + _AREA_MARGIN_DEG
    low, high = np.clip(low, [-180.0, -90.0], [180.0, 90.0]), np.clip(high, [-180.0, -90.0], [180.0, 90.0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # Operation records that the best operation is not available
        group = TransformerGroup(
            source,
            proj.CRS.from_user_input(ECEF),
            always_xy=True,
            allow_ballpark=False,
            area_of_interest=AreaOfInterest(low[0], low[1], high[0], high[1]),
        )
    if not group.transformers:
        needed = sorted({g.short_name for o in group.unavailable_operations for g in o.grids})
        raise InputError.of(
            "geodesy.no_operation", place="crs", value=crs, grids=", ".join(needed) or "an operation PROJ does not have"
        )
    chosen = group.transformers[0]
    accuracy = chosen.accuracy if chosen.accuracy >= 0.0 else np.nan
    grids = {grid.short_name for better in group.unavailable_operations[:1] for grid in better.grids}
    missing = () if group.best_available else tuple(sorted(grids))
    vertical = next((part.name for part in source.sub_crs_list if part.is_vertical), "ellipsoidal height")
    height = "" if source.is_geocentric else vertical
    return chosen, Operation(crs, chosen.description, float(accuracy), missing, height)


def require_finite(crs: str, values: Array, given: Array, labels: Sequence[str] | None) -> None:
    """Raise InputError for points whose ``values`` are not finite; messages show ``given`` and ``labels``."""
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise InputError(
            *(
                finding(
                    "geodesy.outside",
                    place=labels[i] if labels else f"point {i}",
                    value=" ".join(f"{v:.10g}" for v in given[i]),
                    crs=crs,
                )
                for i in bad[:20]
            )
        )
