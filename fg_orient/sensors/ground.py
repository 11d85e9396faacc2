"""Make records of located, projected and intersected points for commands and files.

Angles are in degrees, and lengths are in metres. Heights are above the WGS84 ellipsoid. Pixels are (line, sample); (0,
0) is the centre of the first pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.arrays import Array
from fg_orient.geodesy import enu_from_ecef, geodetic_to_ecef
from fg_orient.geodesy.bodies import Body, coordinates_on
from fg_orient.model.block import Image
from fg_orient.model.errors import InputError
from fg_orient.sensors import initial
from fg_orient.sensors.correction import HeightSurface

if TYPE_CHECKING:
    from fg_orient.model.block import ImagePoints
    from fg_orient.sensors.metadata import FramePoint

Records = list[dict[str, Any]]

#: Minimum slope of a ray, horizontal metres per metre of height. A steeper ray does not
#: determine the height of a frame point.
LEAST_SLOPE = 0.01
#: Maximum number of iterations for these heights, and length of the last step, m.
MAX_STEPS, STEP_M = 20, 1e-4


def ground_records(ids: Sequence[str], line: Array, sample: Array, ecef_m: Array, body: Body | None = None) -> Records:
    """Return a record for each point: id, line, sample, geodetic and ECEF coordinates.

    On another body, coordinates of this body replace geodetic and ECEF coordinates.

    Parameters
    ----------
    ids : sequence of n str
    line, sample : (n,) arrays
    ecef_m : (n, 3) array
    """
    lon, lat, height = coordinates_on(body, ecef_m)
    return [
        {"id": ids[k], "line": float(line[k]), "sample": float(sample[k]),
         "lon_deg": float(lon[k]), "lat_deg": float(lat[k]), "height_m": float(height[k]),
         "x_m": float(ecef_m[k, 0]), "y_m": float(ecef_m[k, 1]), "z_m": float(ecef_m[k, 2])}
        for k in range(len(ids))
    ]  # fmt: skip


def frame_records(sensor: Any, height_m: float | None = None, dem: HeightSurface | None = None) -> Records:
    """Locate the frame points of a file and compare them with their coordinates in the file.

    Points are located at the height in the file, unless a height or a DEM is given. If the file has no height, the
    height is computed at which the ray is closest to the position in the file. The remaining misfit is then
    perpendicular to the vertical plane of the ray. Rays steeper than 1 : 100 do not determine a height and are located
    at height 0.

    Parameters
    ----------
    sensor : PushbroomSensor, RpcSensor or OrientedSensor
    height_m : float, optional
        Ellipsoidal height for all points.
    dem : HeightSurface, optional

    Returns
    -------
    list of dict
        The keys of :func:`ground_records`, and ``file_lon_deg``, ``file_lat_deg``, ``misfit_m`` (horizontal, model
        minus file), ``misfit_east_m``, ``misfit_north_m``, ``height_from`` ("file", "given", "dem", "solved" or
        "none") and ``note`` (None, or the reason why the points of the file may disagree with the model).

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
    """Return East and North (n, 2), m, of points relative to positions at the same heights."""
    apart = ecef_m - geodetic_to_ecef(lon_deg, lat_deg, height_m)
    return np.asarray(np.einsum("nij,nj->ni", enu_from_ecef(lon_deg, lat_deg)[:, :2], apart))


def _frame_heights(
    sensor: Any, points: Sequence[FramePoint], pixel: tuple[Array, Array], place: tuple[Array, Array],
    height_m: float | None,
) -> tuple[Array, list[str]]:  # fmt: skip
    """Return the heights (n,), m, of the frame points, and the source of each.

    Missing heights are computed.
    """
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
    """Project ground points (n, 3), ECEF m, and return records of id, line, sample and ``inside``.

    Outside the image, line and sample are extrapolated linearly from its border. They are nan if the satellite cannot
    see the point or if the iteration does not converge.
    """
    line, sample = sensor.project(ecef_m)
    inside = sensor.is_inside(line, sample)
    return [
        {"id": ids[k], "line": float(line[k]), "sample": float(sample[k]), "inside": bool(inside[k])}
        for k in range(len(ids))
    ]


def intersection_records(images: tuple[Image, ...], observations: ImagePoints, ids: Sequence[str]) -> Records:
    """Intersect the rays of all points that are measured in at least two images; use the metadata orientation.

    Parameters
    ----------
    images : tuple of Image
    observations : ImagePoints
    ids : sequence of str
        Ids of the ground points.

    Returns
    -------
    list of dict
        The keys of :func:`ground_records` (line and sample in the first image), and ``miss_m``, the largest distance
        between the foot points on two rays; ``convergence_deg``; ``sigma_east_m``, ``sigma_north_m``, ``sigma_up_m``
        and ``covariance_enu_m2`` from the standard deviations of the image points, if the orientation has no error;
        ``pixels``, all image points.

    Raises
    ------
    InputError
        Rays are parallel or intersect behind a sensor.
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
    line, sample = observations.line[first], observations.sample[first]
    records = ground_records([ids[j] for j in used], line, sample, ground[used], images[0].sensor.body)
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
