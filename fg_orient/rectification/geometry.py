"""Areas of outlines, map projections, and the geometry of line scanners (İpbüker 1994).

Areas (section 7.2): a pixel belongs to an outline if its centre lies inside. Over random positions and orientations of
the grid the mean of the count is the area; its standard deviation is about ``sqrt(0.0728 L h^3)`` for a perimeter L and
pixels of size h (Kendall's problem of lattice points, for outlines without preferred direction).

Projections are PROJ definitions. Unlike ``fg_orient.geodesy`` no datum is changed: longitude and latitude refer to the
ellipsoid or sphere of the projection. Several definitions of İpbüker 1994 have no EPSG code, for example a geodetic
latitude used as a spherical one.

Optical-mechanical line scanner (MSS, TM) over flat ground (section 3.3.1): angles are in rad, lengths in m; the scan
angle theta is 0 at nadir. Some printed equations have misprints; this module contains the corrected forms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from fg_orient.model.errors import InputError
from fg_orient.rectification.arguments import finite, number, positive, whole

if TYPE_CHECKING:
    from pyproj import Proj

Array = npt.NDArray[np.float64]

#: Variance of a pixel-count area, divided by the perimeter and the cube of the pixel size.
PIXEL_VARIANCE = 0.0728


def outline(vertices: npt.ArrayLike) -> Array:
    """Checked vertices (n, 2) of a closed outline, without a last vertex equal to the first.

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
    """Area of a polygon in a plane, ``|sum (x_i y_i+1 - x_i+1 y_i)|/2`` about its centre.

    Parameters
    ----------
    vertices : (n, 2) array_like
        Corners in order, m; the last one may repeat the first.
    """
    given = outline(vertices)
    x, y = (given - given.mean(axis=0)).T
    return float(abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0)


def perimeter_m(vertices: npt.ArrayLike) -> float:
    """Sum of the chords of a closed outline, m.

    Parameters
    ----------
    vertices : (n, 2) array_like
        Corners in order, m; the last one may repeat the first.
    """
    given = outline(vertices)
    return float(np.hypot(*(np.roll(given, -1, axis=0) - given).T).sum())


def mean_spacing_m(length_m: float, n_vertices: float) -> float:
    """Mean distance of the vertices of a closed outline, m; InputError if an argument is not above 0."""
    return positive("length", length_m, "m") / positive("number of vertices", n_vertices, "vertices")


def pixel_area_m2(n_pixels: float, pixel_m: float) -> float:
    """Area of a number (0 or more) of square pixels of a size above 0; InputError for other arguments."""
    return number("number of pixels", n_pixels, "pixels", least=0.0) * positive("pixel size", pixel_m, "m") ** 2


def pixel_area_sigma_m2(perimeter: float, pixel_m: float) -> float:
    """Standard deviation of a pixel-count area over random positions and orientations of the grid, m2.

    Raises InputError if an argument is not above 0.
    """
    length, size = positive("perimeter", perimeter, "m"), positive("pixel size", pixel_m, "m")
    return float(np.sqrt(PIXEL_VARIANCE * length * size**3))


def count_pixels(vertices: npt.ArrayLike, pixel_m: float, offset_m: npt.ArrayLike = (0.0, 0.0)) -> int:
    """Number of pixels whose centres lie inside an outline.

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
    p = (outline(vertices) - offset) / size  # centres are whole numbers
    q = np.roll(p, -1, axis=0)
    q, p = np.where(q[:, 1:] < p[:, 1:], p, q), np.where(q[:, 1:] < p[:, 1:], q, p)  # every edge upwards
    first, last = np.ceil(p[:, 1]).astype(int), np.ceil(q[:, 1]).astype(int)  # rows crossed: first <= row < last
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


@dataclass(frozen=True)
class Scanner:
    """Scanner on a level flight line.

    Parameters
    ----------
    height_m : float
        Above the datum, Z_c.
    ifov_along_rad, ifov_across_rad : float
        Angular resolution beta and gamma.
    focal_length_m : float
    speed_m_s : float
        Of the ground track.
    overlap : float
        Overlap S of a strip with the next one, as a share.
    rotation_s : float
        Period t_r of the mirror: 2 pi of scan angle.

    Raises
    ------
    InputError
        A value that is not above 0, or an overlap outside 0 .. 1.
    """

    height_m: float
    ifov_along_rad: float
    ifov_across_rad: float
    focal_length_m: float = 1.0
    speed_m_s: float = 1.0
    overlap: float = 0.0
    rotation_s: float = 1.0

    def __post_init__(self) -> None:
        units = {"height_m": "m", "ifov_along_rad": "rad", "ifov_across_rad": "rad", "focal_length_m": "m",
                 "speed_m_s": "m/s", "rotation_s": "s"}  # fmt: skip
        for name, unit in units.items():
            positive(name, getattr(self, name), unit)
        if not 0.0 <= self.overlap < 1.0:
            raise InputError.of("options.value", place="overlap", value=self.overlap, expected="0 to below 1")

    @property
    def strip_m(self) -> float:
        """Width of the ground strip at nadir, dX = Z_c beta."""
        return self.height_m * self.ifov_along_rad

    @property
    def image_element_m(self) -> float:
        """Size of an element in the image, dx = f beta."""
        return self.focal_length_m * self.ifov_along_rad

    @property
    def line_time_s(self) -> float:
        """Time from strip to strip: V dt = (1 - S) dX."""
        return (1.0 - self.overlap) * self.strip_m / self.speed_m_s

    def scan_angle_rad(self, image_y_m: npt.ArrayLike) -> Array:
        """Scan angle theta = y/f of a distance along the scan line in the image."""
        return np.asarray(finite("image y", image_y_m) / self.focal_length_m)

    def ground(self, image_x_m: npt.ArrayLike, image_y_m: npt.ArrayLike, height_m: npt.ArrayLike = 0.0) -> Array:
        """Ground X, Y (n, 2) from the first strip and the track: ``(1 - S)(Z_c/f) x`` and ``(Z_c - Z_j) tan theta``.

        The time of the mirror adds :meth:`mirror_shift_m` to X.
        """
        theta = self.scan_angle_rad(image_y_m)
        x = (1.0 - self.overlap) * self.height_m / self.focal_length_m * finite("image x", image_x_m)
        y = (self.height_m - finite("height", height_m)) * np.tan(theta)
        return np.stack(np.broadcast_arrays(x, y), axis=-1)

    def element_m(self, theta_rad: npt.ArrayLike, height_m: npt.ArrayLike = 0.0) -> Array:
        """Size of an element on the ground (n, 2): along ``beta h sec theta``, across ``gamma h sec^2 theta``."""
        secant = 1.0 / np.cos(_angle(theta_rad))
        above = self.height_m - finite("height", height_m)
        sizes = self.ifov_along_rad * above * secant, self.ifov_across_rad * above * secant**2
        return np.stack(np.broadcast_arrays(*sizes), axis=-1)

    def panoramic_shift_m(self, theta_rad: npt.ArrayLike) -> Array:
        """Displacement on the ground if the scan is used as a plane image: ``Z_c (tan theta - theta)``."""
        theta = _angle(theta_rad)
        return np.asarray(self.height_m * (np.tan(theta) - theta))

    def mirror_shift_m(self, theta_rad: npt.ArrayLike) -> Array:
        """Advance of the platform while the mirror turns to theta: ``theta/(2 pi) t_r V``."""
        return np.asarray(finite("scan angle", theta_rad) / (2.0 * math.pi) * self.rotation_s * self.speed_m_s)


def relief_shift_m(height_m: npt.ArrayLike, theta_rad: npt.ArrayLike) -> Array:
    """Outward displacement of a point above the datum: ``Z_j tan theta``, m; InputError for invalid numbers."""
    return np.asarray(finite("height", height_m) * np.tan(_angle(theta_rad)))


def _angle(theta_rad: npt.ArrayLike) -> Array:
    """Checked scan angles, below the horizontal on both sides."""
    angle = finite("scan angle", theta_rad)
    if (np.abs(angle) >= 0.5 * math.pi).any():
        raise InputError.of("options.value", place="scan angle", value=float(np.abs(angle).max()),
                            expected="an angle from nadir, rad, between -pi/2 and pi/2")  # fmt: skip
    return angle


def total_angle_rad(swath_m: float, height_m: float) -> float:
    """Total scan angle over flat ground, ``2 arctan(W/(2H))``; InputError if an argument is not above 0."""
    return 2.0 * math.atan2(positive("swath", swath_m, "m"), 2.0 * positive("height", height_m, "m"))


def swath_m(angle_rad: float, height_m: float, off_nadir_rad: float = 0.0, radius_m: float | None = None) -> float:
    """Swath of a field of view, off nadir or at nadir.

    Parameters
    ----------
    angle_rad : float
        Total field of view.
    height_m : float
    off_nadir_rad : float
        Angle of its middle from nadir.
    radius_m : float, optional
        Radius of the Earth; default: flat ground.

    Returns
    -------
    float
        Length on the ground, m; nan where a ray misses the Earth.

    Raises
    ------
    InputError
        A field of view, a height or a radius that is not above 0; over flat ground, a ray beyond the horizontal.
    """
    positive("field of view", angle_rad, "rad")
    positive("height", height_m, "m")
    number("off nadir", off_nadir_rad, "rad")
    edges = (off_nadir_rad - 0.5 * angle_rad, off_nadir_rad + 0.5 * angle_rad)
    if radius_m is None:
        first, last = np.tan(_angle(edges))
        return float(height_m * (last - first))
    positive("radius", radius_m, "m")
    sines = [math.sin(edge) * (radius_m + height_m) / radius_m for edge in edges]
    if max(map(abs, sines)) > 1.0:
        return math.nan
    centre = [math.asin(sine) - edge for sine, edge in zip(sines, edges, strict=True)]
    return radius_m * (centre[1] - centre[0])


def error_budget(*parts: float) -> float:
    """Root of the sum of squares of independent errors: pointing, digitising, relief (İpbüker 1994, conclusions).

    Raises InputError without errors, or if one is below 0 or not finite.
    """
    finite("errors", parts)
    return math.sqrt(sum(number("error", part, "its unit", least=0.0) ** 2 for part in parts))
