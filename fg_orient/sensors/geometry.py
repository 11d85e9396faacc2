"""Image geometry for commands and files: located, projected and intersected points, footprints, viewing angles.

Angles are in degrees, lengths in metres, heights are ellipsoidal above WGS84; pixels (line, sample) with (0, 0) =
centre of the first pixel. All values are computed from rays of the sensor, in the same way for rigorous models, RPC and
frame images, with or without a correction. The *lean* of a ray at a ground point is its horizontal displacement (East,
North) in metres per metre of height. The ratio of base and height of two rays is the length of the difference of their
leans. It needs no projection centre (an RPC has none) and is ``tan a + tan b`` for rays in one vertical plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from factors._contract import Array
from factors.geometry import ellipsoid
from fg_orient.geodesy import enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import Image
from fg_orient.model.errors import InputError
from fg_orient.sensors import initial
from fg_orient.sensors.correction import HeightSurface

if TYPE_CHECKING:
    from fg_orient.model.block import Image, ImagePoints
    from fg_orient.sensors.correction import HeightSurface
    from fg_orient.sensors.metadata import FramePoint

Records = list[dict[str, Any]]

#: Smallest slope of a ray, horizontal metres per metre of height, that determines the height of a frame point.
LEAST_SLOPE = 0.01
#: Largest number of steps to these heights, and length of the last step.
MAX_STEPS, STEP_M = 20, 1e-4


def ground_records(ids: Sequence[str], line: Array, sample: Array, ecef_m: Array) -> Records:
    """One record per point: id, line, sample, geodetic and ECEF coordinates.

    Parameters
    ----------
    ids : sequence of n str
    line, sample : (n,) arrays
    ecef_m : (n, 3) array
    """
    lon, lat, height = ellipsoid.geodetic_array(np.ascontiguousarray(ecef_m)).T
    return [
        {"id": ids[k], "line": float(line[k]), "sample": float(sample[k]),
         "lon_deg": float(np.degrees(lon[k])), "lat_deg": float(np.degrees(lat[k])), "height_m": float(height[k]),
         "x_m": float(ecef_m[k, 0]), "y_m": float(ecef_m[k, 1]), "z_m": float(ecef_m[k, 2])}
        for k in range(len(ids))
    ]  # fmt: skip


def frame_records(sensor: Any, height_m: float | None = None, dem: HeightSurface | None = None) -> Records:
    """Locate the frame points of a file and compare them with their coordinates in the file.

    Points are located at the height in the file, unless a height or a DEM is given. If the file has no height, the
    height is computed at which the ray is closest to the position in the file; the remaining misfit is perpendicular to
    the vertical plane of the ray. Rays steeper than 1 : 100 do not determine a height and are located at height 0.

    Parameters
    ----------
    sensor : PushbroomSensor, RpcSensor or OrientedSensor
    height_m : float, optional
        Ellipsoidal height for all points.
    dem : HeightSurface, optional

    Returns
    -------
    list of dict
        Beside the keys of :func:`ground_records`: ``file_lon_deg``, ``file_lat_deg``,
        ``misfit_m`` (horizontal, model minus file), ``misfit_east_m``, ``misfit_north_m``,
        ``height_from`` ("file", "given", "dem", "solved" or "none") and ``note`` (None, or the reason why the
        points of the file may disagree with the model).

    Raises
    ------
    InputError
        The file has no frame points.
    """
    points = sensor.frame_points
    if not points:
        raise InputError.of("cli.no_frame", file=sensor.file, option="frame")
    line, sample = (np.array([getattr(p, axis) for p in points]) for axis in ("line", "sample"))
    lon, lat = (np.array([getattr(p, axis) for p in points]) for axis in ("lon_deg", "lat_deg"))
    heights, sources = _frame_heights(sensor, points, (line, sample), (lon, lat), height_m)
    if dem is not None:
        sources = ["dem"] * len(points)
    ecef = sensor.locate(line, sample, dem=dem) if dem else sensor.locate(line, sample, height_m=heights)
    records = ground_records([p.id for p in points], line, sample, ecef)
    east, north = _horizontal(ecef, lon, lat, np.array([r["height_m"] for r in records])).T
    note = None if sensor.frame_note is None else str(sensor.frame_note)
    for k, record in enumerate(records):
        record |= {
            "file_lon_deg": float(lon[k]), "file_lat_deg": float(lat[k]),
            "misfit_m": float(np.hypot(east[k], north[k])),
            "misfit_east_m": float(east[k]), "misfit_north_m": float(north[k]),
            "height_from": sources[k], "note": note,
        }  # fmt: skip
    return records


def _horizontal(ecef_m: Array, lon_deg: Array, lat_deg: Array, height_m: Array) -> Array:
    """East and North (n, 2) m of points relative to positions at the same heights."""
    apart = ecef_m - geodetic_to_ecef(lon_deg, lat_deg, height_m)
    return np.asarray(np.einsum("nij,nj->ni", enu_from_ecef(lon_deg, lat_deg)[:, :2], apart))


def _frame_heights(
    sensor: Any, points: Sequence[FramePoint], pixel: tuple[Array, Array], place: tuple[Array, Array],
    height_m: float | None,
) -> tuple[Array, list[str]]:  # fmt: skip
    """Heights (n,) of the frame points, and the source of each; missing heights are solved for."""
    stated = [p.height_m for p in points]
    if height_m is not None:
        return np.full(len(stated), height_m), ["given"] * len(stated)
    h = np.array([0.0 if value is None else value for value in stated])
    enu = enu_from_ecef(*place)
    up = np.einsum("nij,nj->ni", enu, sensor.rays(*pixel)[1])
    slope = up[:, :2] / up[:, 2:]  # metres per metre of height
    flat = np.linalg.norm(slope, axis=1)
    open_ = np.array([value is None for value in stated]) & (flat >= LEAST_SLOPE)
    for _ in range(MAX_STEPS if open_.any() else 0):
        missed = _horizontal(sensor.locate(*pixel, height_m=h), *place, h)
        step = np.where(open_, -np.einsum("ni,ni->n", slope, missed) / np.maximum(flat, LEAST_SLOPE) ** 2, 0.0)
        h = h + step
        if np.abs(step).max() < STEP_M:
            break
    sources = ["solved" if new else "none" if value is None else "file"
               for new, value in zip(open_, stated, strict=True)]  # fmt: skip
    return h, sources


def pixel_records(sensor: Any, ids: Sequence[str], ecef_m: Array) -> Records:
    """Project ground points (n, 3) ECEF m: id, line, sample and ``inside``.

    Outside the image, line and sample are the linear continuation from its border; nan if the point is invisible from
    the satellite or the iteration does not converge.
    """
    line, sample = sensor.project(ecef_m)
    inside = sensor.is_inside(line, sample)
    return [
        {"id": ids[k], "line": float(line[k]), "sample": float(sample[k]), "inside": bool(inside[k])}
        for k in range(len(ids))
    ]


def intersection_records(images: tuple[Image, ...], observations: ImagePoints, ids: Sequence[str]) -> Records:
    """Intersect all points seen in two images or more, with the metadata orientation.

    Parameters
    ----------
    images : tuple of Image
    observations : ImagePoints
    ids : sequence of str
        Ids of the ground points.

    Returns
    -------
    list of dict
        Beside the keys of :func:`ground_records` (line and sample in the first image):
        ``miss_m``, the largest distance between the foot points on two of its rays; ``convergence_deg``;
        ``sigma_east_m``, ``sigma_north_m``, ``sigma_up_m`` and ``covariance_enu_m2`` from the sigmas of the image
        points, the orientation being free of error; ``pixels``, all image points.

    Raises
    ------
    InputError
        Rays are parallel or meet behind a sensor.
    """
    count = np.bincount(observations.point, minlength=len(ids))
    wanted = np.zeros((len(ids), 3))
    wanted[count >= 2] = np.nan
    ground = initial.ground_points(images, observations, tuple(ids), wanted)
    centre, direction = initial.all_rays(images, observations)
    _, convergence = initial.nearest_points(centre, direction, observations.point, len(ids))
    covariance = initial.intersection_covariances(images, observations, ground)
    foot_points = initial.foot_points(centre, direction, ground[observations.point])
    used = [int(j) for j in np.flatnonzero(count >= 2)]
    rows = [np.flatnonzero(observations.point == j) for j in used]
    first = [int(r[0]) for r in rows]
    records = ground_records([ids[j] for j in used], observations.line[first], observations.sample[first], ground[used])
    for record, j, seen in zip(records, used, rows, strict=True):
        apart = foot_points[seen][:, None] - foot_points[seen][None]
        axes = enu_from_ecef(record["lon_deg"], record["lat_deg"])[0]
        enu = axes @ covariance[j] @ axes.T
        sigma = np.sqrt(np.diag(enu))
        record |= {
            "sigma_east_m": float(sigma[0]), "sigma_north_m": float(sigma[1]), "sigma_up_m": float(sigma[2]),
            "covariance_enu_m2": enu.tolist(),
            "miss_m": float(np.linalg.norm(apart, axis=-1).max()), "convergence_deg": float(convergence[j]),
            "pixels": [{"image": images[observations.image[r]].id, "line": float(observations.line[r]),
                        "sample": float(observations.sample[r])} for r in seen],
        }  # fmt: skip
    return records


#: Points per side of a footprint, and of the grid for ranges and common ground.
SIDE: Final = 17
GRID: Final = 9


class View:
    """One image and its ground surface; with adjusted orientation its sensor is an ``OrientedSensor``.

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

    def ground(self, line: Array, sample: Array) -> Array:
        """Ground points (n, 3) ECEF m of n pixels."""
        how: dict[str, Any] = {"height_m": self._height} if self._dem is None else {"dem": self._dem}
        return np.asarray(self.sensor.locate(line, sample, **how))

    def to_image(self, line: Array, sample: Array, ground_m: Array) -> Array:
        """Unit vectors (n, 3) East, North, Up from ground points towards the sensor, through their pixels."""
        _, direction = self.sensor.rays(line, sample)
        lon, lat = _degrees(ground_m)
        return np.asarray(-np.einsum("nij,nj->ni", enu_from_ecef(lon, lat), direction))

    def grid(self, count: int) -> tuple[Array, Array]:
        """Lines and samples of a grid over the image."""
        s = self.sensor
        axes = np.linspace(s.first_line, s.last_line, count), np.linspace(s.first_sample, s.last_sample, count)
        line, sample = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
        return line, sample


def _degrees(ground_m: Array) -> tuple[Array, Array]:
    lon, lat, _ = np.degrees(ellipsoid.geodetic_array(np.ascontiguousarray(ground_m))).T
    return lon, lat


def footprint(view: View) -> Array:
    """Border of the image on the ground, clockwise in the image, not closed: (4 (SIDE - 1), 2) degrees.

    Longitudes are continuous where the border crosses the 180th meridian.
    """
    s = view.sensor
    low, high = np.array([s.first_line - 0.5, s.first_sample - 0.5]), np.array([s.last_line + 0.5, s.last_sample + 0.5])
    corners = [low, [low[0], high[1]], high, [high[0], low[1]], low]
    ways = [np.linspace(a, b, SIDE)[:-1] for a, b in pairwise(np.array(corners))]
    line, sample = np.concatenate(ways).T
    lon, lat = _degrees(view.ground(line, sample))
    return np.stack([np.degrees(np.unwrap(np.radians(lon))), lat], axis=1)


def image_record(view: View) -> dict[str, Any]:
    """Viewing geometry of one image.

    Returns
    -------
    dict
        ``image``, ``file``, ``lon_deg``, ``lat_deg``, ``height_m`` of the ground point of the central pixel; at this
        pixel ``gsd_line_m``, ``gsd_sample_m`` (distance of ground points half a pixel before and after it),
        ``incidence_deg`` (ray against the ellipsoid normal), ``azimuth_deg`` (of the sensor seen from the ground,
        clockwise from North); ``gsd_range_m`` and ``incidence_range_deg`` over the image; ``area_km2``.

    Raises
    ------
    InputError
        A ray misses the surface.
    """
    line, sample = (np.append(a, (a.min() + a.max()) / 2.0) for a in view.grid(GRID))
    ground = view.ground(line, sample)
    up = view.to_image(line, sample, ground)
    incidence = np.degrees(np.arccos(np.clip(up[:, 2], -1.0, 1.0)))
    along, across = _sampling(view, line, sample)
    lon, lat = _degrees(ground[-1:])
    both = np.concatenate([along, across])
    return {
        "image": view.image.id, "file": view.sensor.file, "lon_deg": float(lon[0]), "lat_deg": float(lat[0]),
        "height_m": float(ellipsoid.geodetic_array(np.ascontiguousarray(ground[-1:]))[0, 2]),
        "gsd_line_m": float(along[-1]), "gsd_sample_m": float(across[-1]),
        "gsd_range_m": [float(both.min()), float(both.max())],
        "incidence_deg": float(incidence[-1]), "incidence_range_deg": [float(incidence.min()), float(incidence.max())],
        "azimuth_deg": float(np.degrees(np.arctan2(up[-1, 0], up[-1, 1])) % 360.0),
        "area_km2": _area_m2(footprint(view)) / 1e6,
    }  # fmt: skip


def _sampling(view: View, line: Array, sample: Array) -> tuple[Array, Array]:
    """Ground distances (n,) over a pixel, half a pixel to either side, along lines and samples."""
    out = []
    for dl, ds in ((0.5, 0.0), (0.0, 0.5)):
        low, high = (view.ground(line + sign * dl, sample + sign * ds) for sign in (-1.0, 1.0))
        out.append(np.linalg.norm(high - low, axis=1))
    return out[0], out[1]


def _area_m2(ring_deg: Array) -> float:
    """Area of a polygon on the ellipsoid (Lambert's cylindrical equal-area projection, with straight edges).

    Authalic latitude: Snyder 1987, Map Projections, eq. 3-12.
    """
    e, s = np.sqrt(ellipsoid.E2), np.sin(np.radians(ring_deg[:, 1]))
    q = (1.0 - ellipsoid.E2) * (s / (1.0 - ellipsoid.E2 * s**2) + np.arctanh(e * s) / e)
    x, y = ellipsoid.A_M * np.radians(ring_deg[:, 0] - ring_deg[0, 0]), 0.5 * ellipsoid.A_M * q
    return float(0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))


def pair_record(first: View, second: View) -> dict[str, Any]:
    """Viewing geometry of two images on their common ground.

    Returns
    -------
    dict
        ``images``; at the middle of the common ground ``lon_deg``, ``lat_deg``, ``convergence_deg`` (angle of
        the rays), ``base_to_height`` (length of the difference of their leans), ``bisector_elevation_deg``
        (90: symmetric rays), ``asymmetry_deg`` (angle of the bisector and the projection of the vertical on the plane
        of the rays); ``overlap``: part of the first image that the second image shows. Without common ground, overlap
        is 0 and all others are None.

    Raises
    ------
    InputError
        A ray misses the surface.
    """
    line, sample = first.grid(GRID)
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
    lon, lat = _degrees(point)
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
    """Records of all images (``images``) and of all their pairs (``pairs``)."""
    return {
        "images": [image_record(view) for view in views],
        "pairs": [pair_record(a, b) for a, b in combinations(views, 2)],
    }


# --- GeoJSON -------------------------------------------------------------------------------------


def feature_collection(views: Sequence[View], records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Footprints as a GeoJSON FeatureCollection (RFC 7946): WGS84 degrees, records as properties.

    Rings are counter-clockwise; one that crosses the 180th meridian is cut there into a MultiPolygon.
    """
    features = [
        {"type": "Feature", "id": view.image.id, "geometry": polygon_geometry(footprint(view)), "properties": record}
        for view, record in zip(views, records, strict=True)
    ]
    return {"type": "FeatureCollection", "features": features}


def polygon_geometry(ring_deg: Array) -> dict[str, Any]:
    """Polygon, or the parts of one on both sides of the 180th meridian."""
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
    """Part of a ring with ``side * (longitude - 180) >= 0`` (Sutherland & Hodgman 1974)."""
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
