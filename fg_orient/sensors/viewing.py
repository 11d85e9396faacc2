"""Compute viewing geometry: footprints, ground sampling distance, incidence, convergence, base to height.

Angles are in degrees, lengths are in metres, and heights are above the WGS84 ellipsoid.
All values are computed from rays of the sensor. The method is the same for rigorous
models, RPC and frame images, with or without a correction. The *lean* of a ray at a
ground point is its horizontal displacement (East, North) in metres per metre of height.
The ratio of base to height of two rays is the length of the difference of their leans. It
needs no projection centre, which an RPC does not have. For rays in one vertical plane, it
is ``tan a + tan b``.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from factors.geometry import ellipsoid
from fg_orient.geodesy import enu_from_ecef
from fg_orient.geodesy.bodies import Body, coordinates_on
from fg_orient.model.block import Image
from fg_orient.sensors.correction import HeightSurface

#: Number of points per side of a footprint, and of the grid for ranges and common ground.
SIDE: Final = 17
GRID: Final = 9


class View:
    """Image with its ground surface. If its orientation is adjusted, its sensor is an ``OrientedSensor``.

    Parameters
    ----------
    image : Image
    height_m : float
        Ellipsoidal height of the ground, unless a DEM is given.
    dem : HeightSurface, optional
    """

    def __init__(self, image: Image, height_m: float = 0.0, dem: HeightSurface | None = None) -> None:
        self.image = image
        self.sensor: Any = image.sensor
        self._height, self._dem = height_m, dem
        self.body = image.sensor.body

    def ground(self, line: Array, sample: Array) -> Array:
        """Return the ground points (n, 3), ECEF m, of n pixels."""
        how: dict[str, Any] = {"height_m": self._height} if self._dem is None else {"dem": self._dem}
        return np.asarray(self.sensor.locate(line, sample, **how))

    def to_image(self, line: Array, sample: Array, ground_m: Array) -> Array:
        """Return unit vectors (n, 3), East, North, Up, from the ground points of pixels towards the sensor."""
        _, direction = self.sensor.rays(line, sample)
        lon, lat, _ = coordinates_on(self.body, ground_m)
        return np.asarray(-np.einsum("nij,nj->ni", enu_from_ecef(lon, lat), direction))


def footprint(view: View) -> Array:
    """Return the border of the image on the ground as a ring that is not closed, clockwise in the image.

    The array (4 (SIDE - 1), 2) contains longitude and latitude, degrees. Longitudes are
    continuous if the border crosses the 180th meridian.
    """
    s = view.sensor
    low, high = np.array([s.first_line - 0.5, s.first_sample - 0.5]), np.array([s.last_line + 0.5, s.last_sample + 0.5])
    corners = [low, [low[0], high[1]], high, [high[0], low[1]], low]
    ways = [np.linspace(a, b, SIDE)[:-1] for a, b in pairwise(np.array(corners))]
    line, sample = np.concatenate(ways).T
    lon, lat, _ = coordinates_on(view.body, view.ground(line, sample))
    return np.stack([np.degrees(np.unwrap(np.radians(lon))), lat], axis=1)


def image_record(view: View) -> dict[str, Any]:
    """Return the viewing geometry of one image.

    Returns
    -------
    dict
        ``image``, ``file``, ``lon_deg``, ``lat_deg``, ``height_m`` of the ground point of
        the central pixel; at this pixel ``gsd_line_m``, ``gsd_sample_m`` (distance of
        ground points half a pixel before and after it), ``incidence_deg`` (ray against
        the ellipsoid normal), ``azimuth_deg`` (of the sensor seen from the ground,
        clockwise from North); ``gsd_range_m`` and ``incidence_range_deg`` over the image;
        ``area_km2``.

    Raises
    ------
    InputError
        A ray misses the surface.
    """
    line, sample = (np.append(a, (a.min() + a.max()) / 2.0) for a in view.sensor.grid(GRID))
    ground = view.ground(line, sample)
    up = view.to_image(line, sample, ground)
    incidence = np.degrees(np.arccos(np.clip(up[:, 2], -1.0, 1.0)))
    along, across = _sampling(view, line, sample)
    lon, lat, height = coordinates_on(view.body, ground[-1:])
    both = np.concatenate([along, across])
    return {
        "image": view.image.id, "file": view.sensor.file, "lon_deg": float(lon[0]), "lat_deg": float(lat[0]),
        "height_m": float(height[0]),
        "gsd_line_m": float(along[-1]), "gsd_sample_m": float(across[-1]),
        "gsd_range_m": [float(both.min()), float(both.max())],
        "incidence_deg": float(incidence[-1]), "incidence_range_deg": [float(incidence.min()), float(incidence.max())],
        "azimuth_deg": float(np.degrees(np.arctan2(up[-1, 0], up[-1, 1])) % 360.0),
        "area_km2": _area_m2(footprint(view), view.body) / 1e6,
    }  # fmt: skip


def _sampling(view: View, line: Array, sample: Array) -> tuple[Array, Array]:
    """Return ground distances (n,) over one pixel, half a pixel to either side, along lines and along samples."""
    out = []
    for dl, ds in ((0.5, 0.0), (0.0, 0.5)):
        low, high = (view.ground(line + sign * dl, sample + sign * ds) for sign in (-1.0, 1.0))
        out.append(np.linalg.norm(high - low, axis=1))
    return out[0], out[1]


def _area_m2(ring_deg: Array, body: Body | None) -> float:
    """Return the area of a polygon on the ellipsoid, m^2; on another body, on its mean sphere.

    The edges are straight in Lambert's cylindrical equal-area projection. The authalic
    latitude is from Snyder 1987, Map Projections, eq. 3-12.
    """
    e, s = np.sqrt(ellipsoid.E2), np.sin(np.radians(ring_deg[:, 1]))
    q = (1.0 - ellipsoid.E2) * (s / (1.0 - ellipsoid.E2 * s**2) + np.arctanh(e * s) / e)
    radius = ellipsoid.A_M
    if body is not None:
        radius, q = body.mean_radius_m, 2.0 * s
    x, y = radius * np.radians(ring_deg[:, 0] - ring_deg[0, 0]), 0.5 * radius * q
    return float(0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))


def pair_record(first: View, second: View) -> dict[str, Any]:
    """Return the viewing geometry of two images on their common ground.

    Returns
    -------
    dict
        ``images``; at the middle of the common ground ``lon_deg``, ``lat_deg``,
        ``convergence_deg`` (angle of the rays), ``base_to_height`` (length of the
        difference of their leans), ``bisector_elevation_deg`` (90: symmetric rays),
        ``asymmetry_deg`` (angle of the bisector and the projection of the vertical on the
        plane of the rays); ``overlap``: part of the first image that the second image
        shows. Without common ground, overlap is 0, and all other values are None.

    Raises
    ------
    InputError
        A ray misses the surface.
    """
    line, sample = first.sensor.grid(GRID)
    ground = first.ground(line, sample)
    seen = second.sensor.is_inside(*(np.nan_to_num(a, nan=np.inf) for a in second.sensor.project(ground)))
    names = {"images": [first.image.id, second.image.id]}
    if not seen.any():
        none = dict.fromkeys(("lon_deg", "lat_deg", "convergence_deg", "base_to_height", "bisector_elevation_deg",
                              "asymmetry_deg"))  # fmt: skip
        return {**names, **none, "overlap": 0.0}
    inside = np.flatnonzero(seen)
    middle = ground[inside].mean(axis=0)
    chosen = inside[[int(np.linalg.norm(ground[inside] - middle, axis=1).argmin())]]
    point = ground[chosen]
    there = second.sensor.project(point)
    a = first.to_image(line[chosen], sample[chosen], point)[0]
    b = second.to_image(there[0], there[1], point)[0]
    lon, lat, _ = coordinates_on(first.body, point)
    lean = a[:2] / a[2] - b[:2] / b[2]
    bisector, normal = (a + b) / np.linalg.norm(a + b), np.cross(a, b)
    across, asymmetry = float(np.linalg.norm(normal)), np.nan
    if across > 0.0:
        vertical = np.array([0.0, 0.0, 1.0]) - normal[2] / across * (normal / across)
        length = float(np.linalg.norm(vertical))
        if length > 0.0:
            asymmetry = float(np.degrees(np.arccos(np.clip(bisector @ vertical / length, -1.0, 1.0))))
    return {
        **names, "lon_deg": float(lon[0]), "lat_deg": float(lat[0]),
        "convergence_deg": float(np.degrees(np.arctan2(across, a @ b))),
        "base_to_height": float(np.linalg.norm(lean)),
        "bisector_elevation_deg": float(np.degrees(np.arcsin(min(1.0, bisector[2])))),
        "asymmetry_deg": asymmetry, "overlap": float(seen.mean()),
    }  # fmt: skip


def viewing_records(views: Sequence[View]) -> dict[str, list[dict[str, Any]]]:
    """Return the records of all images (``images``) and of all their pairs (``pairs``)."""
    return {
        "images": [image_record(view) for view in views],
        "pairs": [pair_record(a, b) for a, b in combinations(views, 2)],
    }


# --- footprints as GeoJSON --------------------------------------------------------------------------


def feature_collection(views: Sequence[View], records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the footprints as a GeoJSON FeatureCollection (RFC 7946) in WGS84 degrees; records are properties.

    Rings are counter-clockwise. A ring that crosses the 180th meridian is divided there into a MultiPolygon.
    """
    features = [
        {"type": "Feature", "id": view.image.id, "geometry": polygon_geometry(footprint(view)), "properties": record}
        for view, record in zip(views, records, strict=True)
    ]
    return {"type": "FeatureCollection", "features": features}


def polygon_geometry(ring_deg: Array) -> dict[str, Any]:
    """Return a polygon; if it crosses the 180th meridian, return its parts on both sides."""
    x, y = ring_deg.T
    if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0.0:
        ring_deg = ring_deg[::-1]
    turn = 360.0 * np.floor((ring_deg[:, 0].min() + 180.0) / 360.0)
    ring = ring_deg - [turn, 0.0]
    if ring[:, 0].max() <= 180.0:
        return {"type": "Polygon", "coordinates": [_closed(ring)]}
    west, east = _clipped(ring, -1.0), _clipped(ring, 1.0) - [360.0, 0.0]
    return {"type": "MultiPolygon", "coordinates": [[_closed(west)], [_closed(east)]]}


def _clipped(ring: Array, side: float) -> Array:
    """Return the part of a ring with ``side * (longitude - 180) >= 0`` (Sutherland & Hodgman 1974)."""
    out = []
    depth = side * (ring[:, 0] - 180.0)
    for k in range(len(ring)):
        n = (k + 1) % len(ring)
        if depth[k] >= 0.0:
            out.append(ring[k])
        if (depth[k] > 0.0) != (depth[n] > 0.0) and depth[k] != depth[n]:
            t = depth[k] / (depth[k] - depth[n])
            out.append(np.array([180.0, ring[k, 1] + t * (ring[n, 1] - ring[k, 1])]))
    return np.array(out)


def _closed(ring: Array) -> list[list[float]]:
    return [[float(x), float(y)] for x, y in np.vstack([ring, ring[:1]])]
