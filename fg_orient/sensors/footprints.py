"""Footprints of images as GeoJSON: rings, cut at the 180th meridian."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from factors.arrays import Array
from fg_orient.sensors.viewing import View, footprint


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
