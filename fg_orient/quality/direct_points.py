"""Doubts about points that are projected or intersected without an adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from factors.arrays import Array
from fg_orient.geodesy.bodies import ground_on
from fg_orient.model.block import Image, ImagePoints
from fg_orient.model.distributions import chi_square_limit, sidak
from fg_orient.model.errors import Finding, finding
from fg_orient.quality.accuracy import CHANCE
from fg_orient.sensors.ground import Records, pixel_records

#: Larger distances between the rays of a point cause a doubt, m. With the metadata orientation, tens of metres are
#: usual.
MAX_MISS_M: Final = 500.0
#: Heights, m, outside which an intersection is hardly on the ground.
LIKELY_HEIGHTS_M: Final = (-1e3, 10e3)


def points_outside(sensor: Any, records: Records, lon: Array, lat: Array, height_m: Array) -> list[Finding]:
    """Return one warning for all points outside the image; it states if an exchange of longitude and latitude helps.

    Parameters
    ----------
    sensor : Sensor
    records : list of dict
        Of :func:`fg_orient.sensors.ground.pixel_records`.
    lon, lat : (n,) arrays
        Degrees, as given.
    height_m : (n,) array
    """
    away = np.array([not record["inside"] for record in records])
    if not away.any():
        return []
    other, inside = away & (np.abs(lon) <= 90.0), 0  # a latitude is at most 90 degrees
    if other.any():
        ground = ground_on(sensor.body, lat[other], lon[other], height_m[other])
        inside = sum(record["inside"] for record in pixel_records(sensor, ["?"] * len(ground), ground))
    return [
        finding(
            "ground.points_outside (warning): {n} of {of} point(s) lie outside the image: {points:5} "
            "+ ; with longitude and latitude exchanged {inside} of these lie inside "
            "-> check that longitude and latitude are not exchanged, and that the image shows the point",
            n=int(away.sum()), of=len(records), inside=inside or None,
            points=[record["id"] for record in records if not record["inside"]],
        )
    ]  # fmt: skip


def impossible_rays(records: Records) -> list[Finding]:
    """Return a doubt for each intersection whose rays cannot belong to one point of the ground."""
    low, high = LIKELY_HEIGHTS_M
    return [_rays_miss(one) for one in records if not (one["miss_m"] <= MAX_MISS_M and low <= one["height_m"] <= high)]


def _rays_miss(record: dict[str, Any]) -> Finding:
    return finding(
        "ground.rays_miss (doubt): point {id}: the rays miss each other by {miss_m:.0f} m at a height of "
        "{height_m:.0f} m: probably not the same point in every image "
        "-> check the pixels and the order of the images",
        id=record["id"], miss_m=record["miss_m"], height_m=record["height_m"],
    )  # fmt: skip


def rays_beyond_pixels(
    records: Records, images: Sequence[Image], observations: ImagePoints, *, adjusted: bool
) -> list[Finding]:
    """Report the points whose rays miss each other by more than the sigmas of their pixels allow.

    A residual r_i in sigmas at the distance d_i of ray i from the point gives the sigma d_i/r_i of this distance. With
    equal distances of m rays, the miss in sigmas is ``m / sqrt(sum 1/r_i^2)``; its square has at most 2 m - 3 degrees
    of freedom. With the orientation of the metadata a larger miss is a note, with an adjusted orientation a doubt.

    Parameters
    ----------
    records : list of dict
        Of :func:`fg_orient.sensors.ground.intersection_records`.
    images : sequence of Image
    observations : ImagePoints
    adjusted : bool
        True if the orientation of the images was adjusted.
    """
    o, count = observations, np.bincount(observations.point)
    used = np.flatnonzero(count >= 2)
    ground = np.full((len(count), 3), np.nan)
    ground[used] = [[record[name] for name in ("x_m", "y_m", "z_m")] for record in records]
    square = np.zeros(len(o.point))
    for k, image in enumerate(images):
        rows = np.flatnonzero((o.image == k) & (count[o.point] >= 2))
        line, sample = image.sensor.project(ground[o.point[rows]]) if len(rows) else (o.line[rows], o.sample[rows])
        d = (line - o.line[rows]) / o.sigma_line_px[rows], (sample - o.sample[rows]) / o.sigma_sample_px[rows]
        square[rows] = d[0] ** 2 + d[1] ** 2
    with np.errstate(divide="ignore"):
        inverse = np.bincount(o.point, 1.0 / square)[used]
    size = count[used] / np.sqrt(inverse)
    limit = np.sqrt(chi_square_limit(2 * count[used] - 3, sidak(CHANCE, max(len(used), 1))))
    away = np.flatnonzero(size > limit)
    if not len(away):
        return []
    worst = int(away[np.argmax(size[away] / limit[away])])
    figures = {
        "n": len(away), "of": len(used), "worst": records[worst]["id"], "miss_m": records[worst]["miss_m"],
        "size": float(size[worst]), "limit": float(limit[worst]),
    }  # fmt: skip
    if not adjusted:
        return [
            finding(
                "ground.rays_beyond_metadata (note): {n} of {of} point(s) have rays that miss each other by more than "
                "the sigmas of the pixels allow, point {worst} by {miss_m:.1f} m, {size:.0f} standard deviations "
                "(limit {limit:.1f}). The orientation of metadata usually has such errors; so may the point -> adjust "
                "the images, and give <result>",
                **figures,
            )
        ]
    return [
        finding(
            "ground.rays_beyond (doubt): {n} of {of} point(s) have rays that miss each other by more than the sigmas "
            "of the pixels allow, point {worst} by {miss_m:.1f} m, {size:.0f} standard deviations (limit {limit:.1f}) "
            "-> check that the pixels show the same point in every image",
            **figures,
        )
    ]
