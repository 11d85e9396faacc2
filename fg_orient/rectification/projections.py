"""Map projections by their PROJ definition, and areas on the ellipsoid.

Unlike ``fg_orient.geodesy`` no datum is changed: longitude and latitude refer to the ellipsoid or
sphere of the projection. Several definitions of İpbüker 1994 have no EPSG code, for example a
geodetic latitude used as a spherical one.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.model.errors import InputError
from fg_orient.rectification.areas import outline
from fg_orient.rectification.arguments import finite, number, positive, whole

if TYPE_CHECKING:
    from pyproj import Proj

#: International ellipsoid (Hayford 1909) of the maps of İpbüker 1994.
HAYFORD: Final = "intl"
#: Orbits (paths) per cycle of each Landsat.
SOM_LANDSAT: Final = {1: 251, 2: 251, 3: 251, 4: 233, 5: 233}


def utm(zone: int, *, south: bool = False, ellipsoid: str = "WGS84") -> str:
    """Definition of a UTM zone, 1 to 60; InputError for other zones."""
    if not 1 <= whole("UTM zone", zone, 1) <= 60:
        raise InputError.of("options.value", place="UTM zone", value=zone, expected="1 to 60")
    return f"+proj=utm +zone={zone} +ellps={ellipsoid}" + (" +south" if south else "")


def gauss_krueger(central_meridian_deg: float, *, scale: float = 1.0) -> str:
    """Transverse Mercator projection of Hayford's ellipsoid, no false easting; InputError for invalid numbers."""
    number("central meridian", central_meridian_deg, "degrees")
    positive("scale on the meridian", scale, "units of 1")
    return f"+proj=tmerc +lat_0=0 +lon_0={central_meridian_deg!r} +k={scale!r} +ellps={HAYFORD}"


def lambert_cylindrical(radius_m: float) -> str:
    """Definition of the equal-area cylinder of a sphere, ``R lambda, R sin phi``; InputError for a radius of 0."""
    positive("radius", radius_m, "m")
    return f"+proj=cea +lon_0=0 +lat_ts=0 +R={radius_m!r}"


def lambert_polar(radius_m: float) -> str:
    """Definition of the polar equal-area azimuthal projection of a sphere: ``rho = 2R sin(45 deg - phi/2)``.

    Raises InputError if the radius is not above 0.
    """
    positive("radius", radius_m, "m")
    return f"+proj=laea +lat_0=90 +lon_0=0 +R={radius_m!r}"


def space_oblique_mercator(satellite: int, path: int, *, ellipsoid: str = "clrk66") -> str:
    """Definition of the Space Oblique Mercator of Landsat 1 to 5 (Snyder 1981); InputError for other orbits."""
    paths = SOM_LANDSAT.get(satellite, 0)
    if not 1 <= path <= paths:
        raise InputError.of("options.value", place="Landsat, path", value=f"{satellite}, {path}",
                            expected="Landsat 1 to 3 and path 1 to 251, or 4 and 5 and path 1 to 233")  # fmt: skip
    return f"+proj=lsat +lsat={satellite} +path={path} +ellps={ellipsoid}"


def project(definition: str, lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike) -> Array:
    """Plane coordinates (n, 2), m, of longitudes and latitudes.

    Raises
    ------
    InputError
        An invalid definition, or a point outside its domain.
    """
    lon, lat = _lon_lat(lon_deg, lat_deg)
    return _required(np.column_stack(_proj(definition)(lon, lat)), np.column_stack([lon, lat]), definition)


def unproject(definition: str, plane_m: npt.ArrayLike) -> Array:
    """Longitude and latitude (n, 2), degrees, of plane coordinates (n, 2).

    Raises
    ------
    InputError
        See :func:`project`.
    """
    plane = np.atleast_2d(finite("plane coordinates", plane_m))
    if plane.ndim > 2 or plane.shape[1] != 2:
        raise InputError.of("rectify.numbers", place="plane coordinates", value=f"shape {plane.shape}")
    return _required(np.column_stack(_proj(definition)(plane[:, 0], plane[:, 1], inverse=True)), plane, definition)


def scale_factors(definition: str, lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike) -> Array:
    """Scale along the meridian, along the parallel, and of areas (n, 3).

    Raises
    ------
    InputError
        See :func:`project`.
    """
    lon, lat = _lon_lat(lon_deg, lat_deg)
    factors = _proj(definition).get_factors(lon, lat)
    scales = np.column_stack([factors.meridional_scale, factors.parallel_scale, factors.areal_scale])
    return _required(scales, np.column_stack([lon, lat]), definition)


def _lon_lat(lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike) -> tuple[Array, Array]:
    """Checked longitudes and latitudes (n,)."""
    lon, lat = (np.atleast_1d(finite(name, a)) for name, a in (("longitude", lon_deg), ("latitude", lat_deg)))
    if lon.ndim > 1 or lon.shape != lat.shape:
        raise InputError.of("rectify.numbers", place="longitude, latitude", value=f"{lon.shape}, {lat.shape}")
    return lon, lat


def ellipsoidal_area(lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike, ellipsoid: str = "WGS84") -> tuple[float, float]:
    """Area (m2) and perimeter (m) of a polygon whose edges are geodesics (Karney 2013).

    Parameters
    ----------
    lon_deg, lat_deg : (n,) array_like
        Vertices of the closed polygon.
    ellipsoid : str
        Name in PROJ.

    Raises
    ------
    InputError
        Fewer than three vertices, values that are not finite, or no such ellipsoid.
    """
    from pyproj import Geod

    vertices = outline(np.column_stack(_lon_lat(lon_deg, lat_deg)))
    try:
        geodesics = Geod(ellps=ellipsoid)
    except KeyError:
        raise InputError.of("rectify.ellipsoid", value=ellipsoid) from None
    area, perimeter = geodesics.polygon_area_perimeter(*vertices.T)
    return abs(float(area)), float(perimeter)


@cache
def _proj(definition: str) -> Proj:
    import pyproj

    try:
        return pyproj.Proj(definition)
    except pyproj.exceptions.ProjError:
        raise InputError.of("rectify.projection", value=definition) from None


def _required(values: Array, given: Array, definition: str) -> Array:
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        row = given[int(np.argmax(bad))]
        raise InputError.of("rectify.outside", place=definition, value=" ".join(f"{v:.10g}" for v in row))
    return np.asarray(values, float)
