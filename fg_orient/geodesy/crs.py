"""Identification of coordinate reference systems in files, order of their axes, and transformation from ECEF.

Files of other programs name their CRS by WKT, PROJ string or words; this package uses EPSG codes. :func:`known_shifts`
returns the differences between coordinates in other datums and the WGS84 coordinates of the same place.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.geodesy import (
    BODY_FIXED,
    UNUSABLE,
    Operation,
    area_of_use,
    crs_kind,
    ecef_to_geodetic,
    enu_from_ecef,
    geodetic_to_ecef,
    known_crs,
    offline_pyproj,
    operation_to_ecef,
    require_finite,
    same_crs,
    spatial_crs,
    unprojected,
)
from fg_orient.geodesy.heights import with_vertical
from fg_orient.model.errors import InputError
from fg_orient.model.limits import within

if TYPE_CHECKING:
    from pyproj import CRS

#: WGS84 longitude, latitude, ellipsoidal height.
WGS84: Final = "EPSG:4979"
#: Smallest confidence, per cent, at which PROJ's EPSG code is used: everything except the names agrees.
_CONFIDENCE: Final = 70
#: Beginnings of names of an unspecified datum, as in a PROJ string that only has an ellipsoid.
_NO_DATUM: Final = ("unknown", "unspecified", "not specified")
_UTM = re.compile(r"WGS ?84[ /]+UTM(?: zone)?[ /]+([0-9]{1,2}) ?([NS])", re.IGNORECASE)
#: Number and hemisphere of a zone in the name of a projection.
_ZONE: Final = re.compile(r"\b[0-9]+ ?[NS]?\b")
_CODE = re.compile(r"EPSG:{1,2}([0-9]{1,6}(?:\+[0-9]{1,6})?)", re.IGNORECASE)


def epsg_code(text: str) -> str:
    """Return the EPSG code of a CRS that a file states as code, WKT, PROJ string or ``WGS84 UTM 32N``.

    The result is ``EPSG:n``, or ``EPSG:n+m`` with a vertical part; "" if EPSG does not contain the CRS.
    """
    words = text.strip()
    if words == BODY_FIXED:
        return words
    within("crs_characters", len(words), place="CRS", unit="characters")
    zone = _UTM.fullmatch(words)
    if zone:
        number = int(zone[1])
        return utm_code(number, north=zone[2] in "Nn") if 1 <= number <= 60 else ""
    proj = offline_pyproj()
    code = _CODE.fullmatch(words)
    try:
        crs = proj.CRS.from_user_input(f"EPSG:{code[1]}" if code else words)
        if code:
            return f"EPSG:{code[1]}"
        crs = _without_null_shift(crs)
        parts = crs.sub_crs_list or [crs if len(crs.axis_info) < 3 or crs.to_epsg() else crs.to_2d()]
        codes = [_code_of(_without_null_shift(part)) for part in parts]
    except (proj.exceptions.ProjError, *UNUSABLE):
        return ""
    return "" if None in codes else f"EPSG:{'+'.join(map(str, codes))}"


def utm_code(zone: int, *, north: bool) -> str:
    """Return the EPSG code of a UTM zone (1 to 60) on WGS84."""
    return f"EPSG:{(32600 if north else 32700) + zone}"


def other_zones(crs: str, box: tuple[float, float, float, float]) -> list[str]:
    """Return the codes of EPSG's projected CRS that differ from a CRS only in the zone, and whose area meets a box.

    Parameters
    ----------
    crs : str
        Code of a projected CRS; a vertical part is kept.
    box : four floats
        West, south, east, north, degrees.
    """
    proj = offline_pyproj()
    flat, plus, vertical = crs.partition("+")
    family = _zone_family(known_crs(flat).name)
    if family is None:
        return []
    found = proj.database.query_crs_info("EPSG", proj.enums.PJType.PROJECTED_CRS, proj.aoi.AreaOfInterest(*box))
    codes = [f"EPSG:{one.code}" for one in found if _zone_family(one.name) == family]
    return [f"{code}{plus}{vertical}" for code in codes if code != flat.upper()]


def on_own_datum(crs: str, first: Array, second: Array) -> Array:
    """Return longitude and latitude (n, 2), degrees, of horizontal coordinates on the datum of their CRS.

    No operation between datums is searched. Impossible coordinates are nan.
    """
    is_projected = crs_kind(crs) == "projected"
    lonlat = unprojected(known_crs(crs), first, second) if is_projected else np.stack([first, second], axis=1)
    possible = np.isfinite(lonlat).all(axis=1) & np.all(np.abs(lonlat) <= (360.0, 90.0), axis=1)
    return np.where(possible[:, None], lonlat, np.nan)


def _zone_family(name: str) -> tuple[str, str] | None:
    """Return datum and projection of a name such as "WGS 84 / UTM zone 33N" without the zone; None without a zone."""
    datum, _, projection = name.partition(" / ")
    family = _ZONE.sub("#", projection)
    return None if family == projection else (datum, family)


def with_codes(text: str) -> str:
    """Return ``EPSG:n`` or ``EPSG:n+m`` for a CRS whose vertical part may be a name, as in ``EPSG:32636+EGM96``.

    Other texts are returned unchanged; a name that EPSG does not contain raises InputError.
    """
    flat, plus, vertical = (part.strip() for part in text.partition("+"))
    if not _CODE.fullmatch(flat) or not vertical or vertical.isdecimal():
        return text
    return f"{flat}{plus}{vertical_code(vertical).removeprefix('EPSG:')}"


def vertical_code(text: str) -> str:
    """Return ``EPSG:n`` of a vertical CRS, given its code or name (with or without "height").

    Raise InputError if unknown.
    """
    if _CODE.fullmatch(text.strip()) or not text.strip():
        return text
    names = _vertical_names()
    codes = names.get(_plain(text)) or names.get(_plain(f"{text} height")) or ()
    if len(codes) == 1:
        return f"EPSG:{codes[0]}"
    close = difflib.get_close_matches(_plain(f"{text} height"), names, n=3, cutoff=0.5)
    known = codes or [names[name][0] for name in close]
    hint = ", ".join(f"{known_crs(f'EPSG:{code}').name} (EPSG:{code})" for code in known) or "EGM96 (EPSG:5773)"
    raise InputError.of("geodesy.vertical_name", place="crs", value=text, hint=hint)


def crs_names(authority: str) -> list[tuple[str, str]]:
    """Return the names and codes of all CRS of an authority in PROJ's database."""
    from pyproj.database import query_crs_info

    offline_pyproj()
    return [(one.name, one.code) for one in query_crs_info(auth_name=authority)]


@cache
def _vertical_names() -> dict[str, list[str]]:
    """Return the codes of EPSG's vertical CRS by name."""
    from pyproj.database import query_crs_info

    names: dict[str, list[str]] = {}
    for one in query_crs_info(auth_name="EPSG", pj_types=[offline_pyproj().enums.PJType.VERTICAL_CRS]):
        names.setdefault(_plain(one.name), []).append(one.code)
    return names


def _plain(name: str) -> str:
    """Return only the letters and digits of a name."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _without_null_shift(crs: CRS) -> CRS:
    """Return a CRS without a shift of zero to WGS84 (``TOWGS84[0,0,0,0,0,0,0]``); other CRS are unchanged."""
    if not crs.is_bound or crs.source_crs is None or crs.coordinate_operation is None:
        return crs
    shift = crs.coordinate_operation.towgs84  # the list is empty if the shift is a grid
    return crs.source_crs if shift and not any(shift) else crs


def _code_of(crs: CRS) -> int | None:
    """Return the EPSG number of a horizontal CRS: the stated number, otherwise the number of an equal CRS in PROJ."""
    stated = crs.to_json_dict().get("id", {})
    if stated.get("authority") == "EPSG":
        return int(stated["code"])
    datum = crs.datum
    if datum is not None and datum.name.lower().startswith(_NO_DATUM):
        # PROJ treats all datums of this ellipsoid as equal, although they differ by up to several hundred metres
        return None
    number: int | None = crs.to_epsg(min_confidence=_CONFIDENCE)
    return number


def same_horizontal(one: str, other: str) -> bool:
    """Return whether the horizontal parts of two CRS are the same; raise InputError if one is unknown."""
    return same_crs(with_vertical(one, "")[0], with_vertical(other, "")[0])


def north_first(crs: str) -> bool:
    """Return whether the definition of a CRS puts latitude or northing first; raise InputError if it is unknown."""
    return bool(spatial_crs(crs).axis_info[0].direction == "north")


def wkt(crs: str) -> str:
    """Return the definition of a CRS as one line of WKT 1, which most programs read.

    Raise InputError if it is unknown, or if WKT 1 has no words for it.
    """
    own = known_crs(crs)
    flat = own if own.is_compound or len(own.axis_info) == 2 or own.is_geocentric else own.to_2d()
    try:
        return str(flat.to_wkt("WKT1_GDAL"))
    except offline_pyproj().exceptions.CRSError:
        raise InputError.of("geodesy.no_wkt", place="crs", value=crs) from None


def from_ecef(crs: str, xyz_m: npt.ArrayLike, labels: Sequence[str] | None = None) -> tuple[Array, Operation]:
    """Transform ECEF coordinates (n, 3), m, to a CRS; inverse of :func:`fg_orient.geodesy.to_ecef_with_operation`.

    Returns
    -------
    tuple
        Easting, northing, height or longitude, latitude, height (or x, y, z), (n, 3); and the operation, named in the
        direction to ECEF.

    Raises
    ------
    InputError
        The CRS is unknown, there is no exact operation, or a point lies outside the domain.
    """
    xyz = np.atleast_2d(np.asarray(xyz_m, float))
    lon, lat, height = ecef_to_geodetic(xyz)
    crs_kind(crs)
    source = spatial_crs(crs)
    transformer, operation = operation_to_ecef(crs, source, np.stack([lon, lat], axis=1))
    if same_crs(crs, WGS84):
        return np.stack([lon, lat, height], axis=1), operation
    x, y, z = xyz.T
    out = np.stack(transformer.transform(x, y, z, direction="INVERSE"), axis=1)
    require_finite(crs, out, xyz, labels)
    return np.ascontiguousarray(out), operation


#: Geographic reference systems of older maps and control points.
DATUMS: Final = {
    "ED50": "EPSG:4230", "NAD27": "EPSG:4267", "Pulkovo 1942": "EPSG:4284", "DHDN": "EPSG:4314",
    "MGI": "EPSG:4312", "NTF": "EPSG:4275", "OSGB36": "EPSG:4277", "Tokyo": "EPSG:4301", "SAD69": "EPSG:4618",
    "S-JTSK": "EPSG:4156", "Monte Mario": "EPSG:4265", "Indian 1975": "EPSG:4240", "Arc 1950": "EPSG:4209",
    "Cape": "EPSG:4222", "AGD66": "EPSG:4202", "Beijing 1954": "EPSG:4214",
}  # fmt: skip
#: Reference systems that move with a tectonic plate: area, geocentric codes of ITRF and of the system, epochs
#: of ITRF, and accuracy in m.
ETRS89: Final = ("EPSG:4258", "EPSG:7789", "EPSG:7930", (1995.0, 2000.0, 2005.0, 2010.0, 2015.0, 2020.0, 2025.0), 0.05)
#: Assumed accuracy, m, of an operation that states none.
UNSTATED_M: Final = 10.0


class DatumShift(NamedTuple):
    """A datum, and the East and North differences (m) of its coordinates from WGS84 coordinates of the same place."""

    name: str
    east_m: float
    north_m: float
    accuracy_m: float


@cache
def known_shifts(lon_deg: float, lat_deg: float) -> tuple[DatumShift, ...]:
    """Return the shifts of the datums used at a place, from the operations that PROJ has without further grids.

    Parameters
    ----------
    lon_deg, lat_deg : float
    """
    lonlat = np.array([[lon_deg, lat_deg]])
    place, axes = geodetic_to_ecef(lon_deg, lat_deg, 0.0)[0], enu_from_ecef(lon_deg, lat_deg)[0]
    out = []
    for name, crs in DATUMS.items():
        if not _is_used(crs, lon_deg, lat_deg):
            continue
        try:
            transformer, operation = operation_to_ecef(crs, spatial_crs(crs), lonlat)
        except InputError:  # the operation needs a grid
            continue
        true = np.array(transformer.transform(lon_deg, lat_deg, 0.0))
        east, north, _ = axes @ (place - true)
        stated = operation.accuracy_m
        out.append(DatumShift(name, float(east), float(north), UNSTATED_M if np.isnan(stated) else stated))
    area, itrf, etrf, epochs, accuracy = ETRS89
    if _is_used(area, lon_deg, lat_deg):
        turn = offline_pyproj().Transformer.from_crs(itrf, etrf)
        for epoch in epochs:
            east, north, _ = axes @ (np.array(turn.transform(*place, epoch)[:3]) - place)
            out.append(DatumShift(f"ETRS89 for ITRF at epoch {epoch:.0f}", float(east), float(north), accuracy))
    return tuple(out)


def _is_used(crs: str, lon_deg: float, lat_deg: float) -> bool:
    """Return whether the area of use of a CRS contains a place."""
    area = area_of_use(crs)
    if area is None:
        return False
    west, south, east, north = area
    inside = west <= lon_deg <= east if west <= east else lon_deg >= west or lon_deg <= east
    return inside and south <= lat_deg <= north
