"""Find the EPSG codes that the coordinates of a table may have, and their transformations to ECEF."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.formats.scenes import REACH
from fg_orient.geodesy import (
    crs_kind,
    ecef_to_geodetic,
    from_geographic,
    offline_pyproj,
    operation_to_ecef,
    spatial_crs,
    to_ecef,
)
from fg_orient.geodesy.crs import WGS84
from fg_orient.model.errors import InputError

#: Margin of the area of use of a CRS, degrees.
_MARGIN_DEG: Final = 1.0
#: A CRS is left out if its points lie farther than this from the images, m.
_MARGIN_M: Final = 20_000.0
#: Maximum width of the area of a national datum, degrees.
WIDEST_DEG: Final = 70.0
#: Two datums agree if their coordinates differ by less than this, degrees.
_AGREES_DEG: Final = 1e-9
#: CRS with these words in their names are left out. They are older global datums, or
#: realisations of systems for which offices use the names WGS84 or ETRS89.
_LEFT_OUT: Final = ("WGS 72", "WGS 66", "NSWC", "PZ-90", "ITRF", "ETRF", "IGS", "IGb", "WGS 84 (", "NSIDC", "ETRS89/",
                    "Hughes")  # fmt: skip


def scene_box(sensors: Mapping[str, Any]) -> tuple[float, float, float, float]:
    """Return west, south, east, north (degrees) of all images."""
    corners = np.vstack([s.footprint() for s in sensors.values()])
    return (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())


def possible_crs(kind: str, coordinates: Array, box: tuple[float, float, float, float] | None) -> list[str]:
    """List the EPSG codes in which the coordinates may lie in the box; usual CRS are first.

    Parameters
    ----------
    kind : str
        "geocentric", "geographic" or "projected".
    coordinates : (n, 3) array
        Coordinates of the table, easting or longitude first. Empty cells are nan.
    box : four floats or None
        West, south, east, north of all images, degrees; None if there are no images.

    Returns
    -------
    list of str
        Codes such as "EPSG:32636". Without images, the list is empty, except for geocentric coordinates.
    """
    if kind == "geocentric":
        return ["EPSG:4978"]
    if box is None:
        return []
    west, south, east, north = box
    middle = np.array([0.5 * (west + east), 0.5 * (south + north)])
    known = coordinates[np.isfinite(coordinates[:, :2]).all(axis=1), :2]
    if not len(known):
        return []
    median = np.median(known, axis=0)
    if kind == "geographic":
        if (np.abs(median - middle) > 1.0 + np.array([east - west, north - south])).any():
            return []
        return [WGS84, *_geographic(tuple(np.round(box, 1)))]
    size_m = 1.2e5 * max(east - west, north - south)
    found = []
    for code, place in _projected(tuple(np.round(box, 1))):
        if np.linalg.norm(np.array(place(*middle)) - median) < REACH * size_m + _MARGIN_M:
            found.append(code)
    return sorted(found, key=usual_first)


def usual_first(crs: str) -> tuple[bool, int]:
    """Sort key of CRS that give the same places: WGS84 is first, then they are sorted by number."""
    number = int(crs.partition(":")[2].partition("+")[0])
    return not (number in (4979, 3857) or 32600 < number <= 32660 or 32700 < number <= 32760), number


def _query(kind: str, box: tuple[float, ...]) -> list[Any]:
    proj = offline_pyproj()

    area = proj.aoi.AreaOfInterest(max(box[0] - _MARGIN_DEG, -180.0), max(box[1] - _MARGIN_DEG, -90.0),
                                     min(box[2] + _MARGIN_DEG, 180.0), min(box[3] + _MARGIN_DEG, 90.0))  # fmt: skip
    infos = proj.database.query_crs_info("EPSG", getattr(proj.enums.PJType, kind), area_of_interest=area)
    return [info for info in infos if not any(info.name.startswith(name) for name in _LEFT_OUT)]


@cache
def _projected(box: tuple[float, ...]) -> list[tuple[str, Any]]:
    """Return the projected CRS of a box, and their projections of longitude and latitude on their own datum."""
    proj = offline_pyproj()
    out = []
    for info in {one.code: one for one in _query("PROJECTED_CRS", box)}.values():
        try:
            crs_kind(f"EPSG:{info.code}")
            out.append((f"EPSG:{info.code}", proj.Proj(f"EPSG:{info.code}")))
        except (InputError, proj.exceptions.CRSError, proj.exceptions.ProjError):
            continue
    return out


@cache
def _geographic(box: tuple[float, ...]) -> list[str]:
    """Return geographic CRS of the countries in a box.

    Only CRS that also have projected CRS, and that do not agree with WGS84, are returned.
    """
    mapped = {info.name.partition(" / ")[0] for info in _query("PROJECTED_CRS", box)}
    out = []
    for info in (one for one in _query("GEOGRAPHIC_2D_CRS", box) if one.name in mapped):
        area, code = info.area_of_use, f"EPSG:{info.code}"
        if area is None or (area.east - area.west + 360.0 * (area.east < area.west)) > WIDEST_DEG:
            continue
        with suppress(InputError):
            there = from_geographic(code, box[0], box[1])
            if not np.allclose(np.ravel(there), box[:2], rtol=0.0, atol=_AGREES_DEG):
                out.append(code)
    return sorted(out, key=usual_first)


def in_ecef(crs: str, coordinates: Array, sensors: Mapping[str, Any]) -> Array | None:
    """Transform coordinates of a table to ECEF.

    Parameters
    ----------
    crs : str
        EPSG code of the coordinates.
    coordinates : (n, 3) array
        Coordinates of the table. The mean height of the scenes replaces a missing height.
    sensors : mapping of str to Sensor
        Georeferenced images; they limit the area of the transformation.

    Returns
    -------
    (n, 3) array or None
        ECEF coordinates, m; nan if a horizontal coordinate is missing. None if the
        coordinates are impossible in the CRS.
    """
    heights = [s.mean_height_m for s in sensors.values()] or [0.0]
    whole = np.isfinite(coordinates[:, :2]).all(axis=1)
    out = np.full((len(coordinates), 3), np.nan)
    if not whole.any():
        return out
    given = np.where(np.isfinite(coordinates), coordinates, float(np.mean(heights)))[whole]
    try:
        if not sensors:
            xyz = to_ecef(crs, *given.T)
        elif (operation := _transformer(crs, scene_box(sensors))) is not None:
            xyz = np.stack(operation.transform(*given.T), axis=1)
        else:
            return None
    except InputError:
        return None
    if not np.isfinite(xyz).all():
        return None
    out[whole] = xyz
    return out


@cache
def _transformer(crs: str, box: tuple[float, float, float, float]) -> Any:
    """Find the operation from a CRS to ECEF for a box in degrees; None if it does not exist.

    The result is kept, because many interpretations of a table need it.
    """
    try:
        return operation_to_ecef(crs, spatial_crs(crs), np.array(box).reshape(2, 2))[0]
    except InputError:
        return None


def lonlat(ecef: Array) -> Array:
    """Return longitude and latitude (n, 2), degrees."""
    lon, lat, _ = ecef_to_geodetic(ecef)
    return np.stack([lon, lat], axis=1)
