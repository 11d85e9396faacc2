"""Map projections by their PROJ definition; areas and lengths of outlines in the plane and on the ellipsoid.

In contrast to ``fg_orient.geodesy``, the datum is never changed: longitude and latitude
refer to the ellipsoid or sphere of the projection. Several definitions of İpbüker 1994
have no EPSG code. For example, a geodetic latitude is used as a spherical latitude.

Areas are also counted in pixels (İpbüker 1994, section 7.2). A pixel belongs to an
outline if its centre lies inside. Over random positions and orientations of the grid, the mean of the
count is the area. The standard deviation of the count is about ``sqrt(0.0728 L h^3)`` for a perimeter L
and pixels of size h (Kendall's problem of lattice points, for outlines without preferred direction).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite, number, positive, whole

if TYPE_CHECKING:
    from pyproj import Proj

#: Variance of a pixel-count area, divided by the perimeter and the cube of the pixel size.
PIXEL_VARIANCE = 0.0728


def outline(vertices: npt.ArrayLike) -> Array:
    """Return the checked vertices (n, 2) of a closed outline, without a last vertex equal to the first.

    Raises
    ------
    InputError
        Fewer than three vertices, or values that are not finite.
    """
    given = finite("vertices", vertices)
    if given.ndim == 2 and len(given) > 1 and np.array_equal(given[0], given[-1]):
        given = given[:-1]
    if given.ndim != 2 or given.shape[1] != 2 or len(given) < 3:
        raise InputError.of("rectify.outline", value=f"shape {given.shape}")
    return given


def planar_area_m2(vertices: npt.ArrayLike) -> float:
    """Return the area of a polygon in a plane, ``|sum (x_i y_i+1 - x_i+1 y_i)|/2`` about its centre.

    Parameters
    ----------
    vertices : (n, 2) array_like
        Corners in order, m; the last one may repeat the first.
    """
    given = outline(vertices)
    x, y = (given - given.mean(axis=0)).T
    return float(abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0)


def perimeter_m(vertices: npt.ArrayLike) -> float:
    """Return the sum of the chords of a closed outline, m.

    Parameters
    ----------
    vertices : (n, 2) array_like
        Corners in order, m; the last one may repeat the first.
    """
    given = outline(vertices)
    return float(np.hypot(*(np.roll(given, -1, axis=0) - given).T).sum())


def mean_spacing_m(length_m: float, n_vertices: float) -> float:
    """Return the mean distance of the vertices of a closed outline, m.

    Raise InputError if an argument is not above 0.
    """
    return positive("length", length_m, "m") / positive("number of vertices", n_vertices, "vertices")


def pixel_area_m2(n_pixels: float, pixel_m: float) -> float:
    """Return the area of a number (0 or more) of square pixels of a size above 0.

    Raise InputError for other arguments.
    """
    return number("number of pixels", n_pixels, "pixels", least=0.0) * positive("pixel size", pixel_m, "m") ** 2


def pixel_area_sigma_m2(perimeter: float, pixel_m: float) -> float:
    """Return the standard deviation of a pixel-count area over random positions and orientations of the grid, m2.

    Raise InputError if an argument is not above 0.
    """
    length, size = positive("perimeter", perimeter, "m"), positive("pixel size", pixel_m, "m")
    return float(np.sqrt(PIXEL_VARIANCE * length * size**3))


def count_pixels(vertices: npt.ArrayLike, pixel_m: float, offset_m: npt.ArrayLike = (0.0, 0.0)) -> int:
    """Return the number of pixels whose centres lie inside an outline.

    Parameters
    ----------
    vertices : (n, 2) array_like
        m.
    pixel_m : float
    offset_m : (2,) array_like
        Centre of any pixel.

    Raises
    ------
    InputError
        No outline, or a pixel size that is not above 0.
    """
    size, offset = positive("pixel size", pixel_m, "m"), finite("offset", offset_m)
    if offset.shape != (2,):
        raise InputError.of("rectify.numbers", place="offset", value=f"shape {offset.shape}")
    p = (outline(vertices) - offset) / size  # in these units the pixel centres are whole numbers
    q = np.roll(p, -1, axis=0)
    # exchange end points, so that every edge leads upwards
    q, p = np.where(q[:, 1:] < p[:, 1:], p, q), np.where(q[:, 1:] < p[:, 1:], q, p)
    # an edge crosses the rows first <= row < last
    first, last = np.ceil(p[:, 1]).astype(int), np.ceil(q[:, 1]).astype(int)
    edge = np.repeat(np.arange(len(p)), last - first)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(last - first) - (last - first), last - first) + first[edge]
    slope = (q[edge, 0] - p[edge, 0]) / (q[edge, 1] - p[edge, 1])
    crossing = p[edge, 0] + (row - p[edge, 1]) * slope
    order = np.lexsort((crossing, row))
    columns = np.ceil(crossing[order]).astype(int)
    return int(np.sum(columns[1::2] - columns[::2]))


#: International ellipsoid (Hayford 1909) of the maps of İpbüker 1994.
HAYFORD: Final = "intl"
#: Orbits (paths) per cycle of each Landsat.
SOM_LANDSAT: Final = {1: 251, 2: 251, 3: 251, 4: 233, 5: 233}


def utm(zone: int, *, south: bool = False, ellipsoid: str = "WGS84") -> str:
    """Return the definition of a UTM zone, 1 to 60; InputError for other zones."""
    if not 1 <= whole("UTM zone", zone, 1) <= 60:
        raise InputError.of("options.value", place="UTM zone", value=zone, expected="1 to 60")
    return f"+proj=utm +zone={zone} +ellps={ellipsoid}" + (" +south" if south else "")


def gauss_krueger(central_meridian_deg: float, *, scale: float = 1.0) -> str:
    """Return the definition of a transverse Mercator projection of Hayford's ellipsoid without false easting.

    InputError: a number is invalid.
    """
    number("central meridian", central_meridian_deg, "degrees")
    positive("scale on the meridian", scale, "units of 1")
    return f"+proj=tmerc +lat_0=0 +lon_0={central_meridian_deg!r} +k={scale!r} +ellps={HAYFORD}"


def lambert_cylindrical(radius_m: float) -> str:
    """Return the definition of the equal-area cylindrical projection of a sphere, ``R lambda, R sin phi``."""
    positive("radius", radius_m, "m")
    return f"+proj=cea +lon_0=0 +lat_ts=0 +R={radius_m!r}"


def lambert_polar(radius_m: float) -> str:
    """Return the definition of the polar equal-area azimuthal projection of a sphere: ``rho = 2R sin(45 deg - phi/2)``.

    Raise InputError if the radius is not above 0.
    """
    positive("radius", radius_m, "m")
    return f"+proj=laea +lat_0=90 +lon_0=0 +R={radius_m!r}"


def space_oblique_mercator(satellite: int, path: int, *, ellipsoid: str = "clrk66") -> str:
    """Return the definition of the Space Oblique Mercator of Landsat 1 to 5 (Snyder 1981)."""
    paths = SOM_LANDSAT.get(satellite, 0)
    if not 1 <= path <= paths:
        raise InputError.of(
            "options.value",
            place="Landsat, path",
            value=f"{satellite}, {path}",
            expected="Landsat 1 to 3 and path 1 to 251, or 4 and 5 and path 1 to 233",
        )
    return f"+proj=lsat +lsat={satellite} +path={path} +ellps={ellipsoid}"


def find_projection(text: str) -> str:
    """Return the definition of a projection by its short name, or a definition of PROJ or EPSG unchanged.

    Short names are ``utm:36``, ``utm:36S``, ``gauss-krueger:30`` (central meridian),
    ``lambert-cylindrical:R`` and ``lambert-polar:R`` (radius, m) and ``som:5,180``
    (Landsat, path). InputError for anything else.
    """
    name, colon, rest = text.partition(":")
    south = rest[-1:] in ("S", "s")
    makers: dict[str, Callable[[], str]] = {
        "utm": lambda: utm(int(rest[:-1] if south else rest), south=south),
        "gauss-krueger": lambda: gauss_krueger(float(rest)),
        "lambert-cylindrical": lambda: lambert_cylindrical(float(rest)),
        "lambert-polar": lambda: lambert_polar(float(rest)),
        "som": lambda: space_oblique_mercator(*map(int, rest.split(","))),
    }  # fmt: skip
    if colon and name in makers:
        try:
            return makers[name]()
        except (TypeError, ValueError):
            raise InputError.of("rectify.projection", value=text) from None
    _proj(text)
    return text


def project(definition: str, lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike) -> Array:
    """Return the plane coordinates (n, 2), m, of longitudes and latitudes.

    Raises
    ------
    InputError
        The definition is invalid, or a point is outside its domain.
    """
    lon, lat = _lon_lat(lon_deg, lat_deg)
    return _required(np.column_stack(_proj(definition)(lon, lat)), np.column_stack([lon, lat]), definition)


def unproject(definition: str, plane_m: npt.ArrayLike) -> Array:
    """Return longitude and latitude (n, 2), degrees, of plane coordinates (n, 2).

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
    """Return the scale along the meridian, along the parallel, and of areas (n, 3).

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
    """Return the checked longitudes and latitudes (n,)."""
    lon, lat = (np.atleast_1d(finite(name, a)) for name, a in (("longitude", lon_deg), ("latitude", lat_deg)))
    if lon.ndim > 1 or lon.shape != lat.shape:
        raise InputError.of("rectify.numbers", place="longitude, latitude", value=f"{lon.shape}, {lat.shape}")
    return lon, lat


def ellipsoidal_area(lon_deg: npt.ArrayLike, lat_deg: npt.ArrayLike, ellipsoid: str = "WGS84") -> tuple[float, float]:
    """Return the area (m2) and perimeter (m) of a polygon whose edges are geodesics (Karney 2013).

    Parameters
    ----------
    lon_deg, lat_deg : (n,) array_like
        Vertices of the closed polygon.
    ellipsoid : str
        Name in PROJ.

    Raises
    ------
    InputError
        There are fewer than three vertices, values are not finite, or the ellipsoid is unknown.
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
