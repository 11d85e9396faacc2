"""Bodies other than the Earth: coordinates, local axes, and rays that meet a sphere or triaxial ellipsoid.

Ground points are body-fixed metres. Latitude and longitude are planetocentric and positive to the north and east;
heights are radii minus the radius of the ellipsoid in the same direction. The axes East, North, Up of a
point have the directions in which longitude, latitude and radius increase, for any shape of the body.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from factors.arrays import Array
from factors.geometry import ellipsoid
from fg_orient.geodesy import (
    crs_kind,
    ecef_to_geodetic,
    enu_from_ecef,
    geodetic_to_ecef,
    known_crs,
    longitude_latitude,
    offline_pyproj,
)
from fg_orient.geodesy.crs import crs_names
from fg_orient.model.errors import InputError

#: A body is the Earth if its semi-axes differ from the Earth's ellipsoid by at most this, m.
SAME_AXIS_M: Final = 1.0
#: Radii that differ by this share are equal.
EQUAL: Final = 1e-9
#: Pattern of the names of ocentric CRS of the International Astronomical Union in PROJ.
_OCENTRIC: Final = re.compile(r"(?P<name>.+) \(2015\)(?P<sphere> - Sphere)? / Ocentric")
_STEPS: Final = 20


@dataclass(frozen=True)
class Body:
    """A planet or moon.

    Parameters
    ----------
    name : str
    radii_m : (3,) tuple of float
        Semi-axes along x, y, z.

    Raises
    ------
    InputError
        A radius is not above zero.
    """

    name: str
    radii_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        if len(self.radii_m) != 3 or not all(np.isfinite(r) and r > 0.0 for r in self.radii_m):
            raise InputError.of("body.radii", place="radii", value=self.radii_m)

    @property
    def mean_radius_m(self) -> float:
        """Mean of the three semi-axes."""
        return sum(self.radii_m) / 3.0

    def same(self, other: Body) -> bool:
        """Return whether two bodies have the same shape."""
        return bool(np.allclose(self.radii_m, other.radii_m, rtol=EQUAL, atol=0.0))

    def radius_m(self, direction: Array) -> Array:
        """Return the radii (n,) of the ellipsoid in directions (n, 3) of any length."""
        length = np.linalg.norm(direction, axis=1)
        return np.asarray(length / np.linalg.norm(direction / np.array(self.radii_m), axis=1))

    def coordinates(self, xyz_m: Array) -> Array:
        """Return longitude, latitude (degrees) and height (m) of body-fixed points (n, 3): (n, 3)."""
        x, y, z = xyz_m.T
        lon, lat = np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))
        return np.stack([lon, lat, np.linalg.norm(xyz_m, axis=1) - self.radius_m(xyz_m)], axis=1)

    def body_fixed(self, lon_lat_height: Array) -> Array:
        """Inverse of :meth:`coordinates`."""
        lon, lat = np.radians(lon_lat_height[:, :2]).T
        direction = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
        return np.asarray(direction * (self.radius_m(direction) + lon_lat_height[:, 2])[:, None])

    def axes(self, xyz_m: Array) -> Array:
        """Return the rotations (n, 3, 3) to East, North, Up at body-fixed points (n, 3)."""
        lon, lat, _ = self.coordinates(xyz_m).T
        return enu_from_ecef(lon, lat)

    def nearest(self, position_m: Array, direction: Array) -> Array:
        """Return the points (n, 3) where rays meet the surface.

        A ray that misses the body gives a point on its limb.
        """
        out = self.intersect(position_m, direction, np.zeros(len(position_m)))
        foot = position_m - np.sum(position_m * direction, axis=1)[:, None] * direction
        limb = foot * (self.radius_m(foot) / np.linalg.norm(foot, axis=1))[:, None]
        return np.where(np.isfinite(out), out, limb)

    def intersect(self, position_m: Array, direction: Array, height_m: Array) -> Array:
        """Return the nearest points (n, 3) of rays at heights (n,); nan if a ray misses the surface."""
        out, aim = np.full_like(position_m, np.nan), np.array(height_m, float)
        for _ in range(_STEPS):
            semi = np.array(self.radii_m) + aim[:, None]
            p, u = position_m / semi, direction / semi
            a, b, c = np.sum(u * u, axis=1), np.sum(p * u, axis=1), np.sum(p * p, axis=1) - 1.0
            with np.errstate(invalid="ignore"):
                root = np.sqrt(b * b - a * c)
                way = np.where(b < 0.0, c / (root - b), np.nan)  # the nearest root, computed without cancellation
            way[c < 0.0] = np.nan
            out = position_m + way[:, None] * direction
            error = height_m - (np.linalg.norm(out, axis=1) - self.radius_m(out))
            if not np.abs(error[np.isfinite(error)]).max(initial=0.0) > 1e-6:
                break
            aim += np.nan_to_num(error)
        return out


def is_earth(major_m: float, minor_m: float) -> bool:
    """Return whether two semi-axes belong to the Earth's ellipsoid."""
    return max(abs(major_m - ellipsoid.A_M), abs(minor_m - ellipsoid.B_M)) <= SAME_AXIS_M


def require_on_earth(crs: str, file: object) -> None:
    """Raise InputError if the CRS of a DEM is local, or its ellipsoid differs by more than 1 % from the Earth's."""
    known = known_crs(crs)
    if known.ellipsoid is None:
        raise InputError.of("dem.local_crs", file=file, value=known.name)
    if abs(known.ellipsoid.semi_major_metre / ellipsoid.A_M - 1.0) > 0.01:
        raise InputError.of("body.dem", file=file, value=known.ellipsoid.name)


def spheroid(name: str, major_m: float, minor_m: float, *, file: object, place: str) -> Body:
    """Return the body with two semi-axes of a file; InputError, with file and place, if they are impossible."""
    try:
        return Body(name, (major_m, major_m, minor_m))
    except InputError as error:
        raise InputError.of("body.radii", file=file, place=place, value=error.problems[0].value) from None


def coordinates_on(body: Body | None, xyz_m: Array) -> tuple[Array, Array, Array]:
    """Return longitude, latitude (degrees) and height (m), each (n,), of points (n, 3) on a body; None is the Earth."""
    if body is None:
        return ecef_to_geodetic(xyz_m)
    lon, lat, height = body.coordinates(np.atleast_2d(xyz_m)).T
    return lon, lat, height


def ground_on(body: Body | None, lon_deg: Array, lat_deg: Array, height_m: Array) -> Array:
    """Inverse of :func:`coordinates_on`: (n, 3) m."""
    if body is None:
        return geodetic_to_ecef(lon_deg, lat_deg, height_m)
    return body.body_fixed(np.column_stack([lon_deg, lat_deg, height_m]))


@cache
def known_bodies() -> dict[str, str]:
    """Return the codes of PROJ's ocentric CRS by body name in lower case: of ellipsoids, otherwise of spheres."""
    found = [(_OCENTRIC.fullmatch(name), code) for name, code in crs_names("IAU_2015")]
    known = sorted(((m, code) for m, code in found if m), key=lambda one: one[0]["sphere"] is None)
    return {match["name"].lower(): f"IAU_2015:{code}" for match, code in known}


def points_on(crs: str, coordinates: Array) -> Array:
    """Return body-fixed points (n, 3), m, of coordinates (n, 3) in a CRS of the IAU, such as ``IAU_2015:30100``.

    Coordinates are longitude, latitude (degrees) and height (m), or easting, northing and height of a map of a sphere.
    Heights are above the ellipsoid of the CRS: along its normal for planetographic latitudes, along the radius for
    planetocentric ones. nan stays nan.
    """
    kind, own = crs_kind(crs), known_crs(crs.strip().upper())
    given = np.array(coordinates, float)
    if kind == "projected":
        given[:, :2] = longitude_latitude(crs, own, kind, given, None)
    if own.is_projected or "Planetocentric" in own.axis_info[0].name:
        return body_named(crs).body_fixed(given)
    major, _, minor = body_named(crs).radii_m
    axes = f"+proj=geocent +a={major} +b={minor} +type=crs"
    to_axes = offline_pyproj().Transformer.from_crs(own.to_3d(), axes, always_xy=True)
    ok = np.isfinite(given).all(axis=1)
    given[ok] = np.stack(to_axes.transform(*given[ok].T), axis=1)
    given[~ok] = np.nan
    return given


def body_named(name: str) -> Body:
    """Return a body by its name, or by the code of a CRS on it such as ``IAU_2015:30100``.

    Raises
    ------
    InputError
        PROJ has no such body.
    """
    code = known_bodies().get(name.strip().lower(), name.strip())
    proj = offline_pyproj()
    try:
        crs = proj.CRS.from_user_input(code)
    except proj.exceptions.CRSError:
        crs = None
    if crs is None or crs.ellipsoid is None:
        raise InputError.of("body.unknown", place="body", value=name)
    shape, match = crs.ellipsoid, re.match(r"(.+?) \(", crs.name)
    minor = shape.semi_minor_metre or shape.semi_major_metre
    return Body(match[1] if match else crs.name, (shape.semi_major_metre, shape.semi_major_metre, minor))
