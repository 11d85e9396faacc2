"""Points, error vectors and footprints of a result as layers of a geographic information system.

Geometries are GeoJSON objects (RFC 7946) in longitude, latitude (degrees, WGS 84, EPSG:4326), without heights: these
are attributes. Attributes are the columns of the result's tables, so that a unit stands in every name.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.report.chart import round_down
from fg_orient.report.maps import KM_PER_DEGREE
from fg_orient.result.plain import Table
from fg_orient.result.record import Result, read_result
from fg_orient.sensors.viewing import polygon_geometry

Array = npt.NDArray[np.float64]
Column = list[str] | Array

ENU: Final = ("east_m", "north_m", "up_m")
#: Attributes of the points: those that the table holds.
POINT_FIELDS: Final = (
    "id", "role", "n_rays", "height_m", "sigma_scale", *(f"sigma_{a}" for a in ENU),
    *(f"difference_{a}" for a in ENU), *(f"own_sigma_{a}" for a in ENU), *(f"mdb_{a}" for a in ENU), "external_m",
    "weight",
)  # fmt: skip
#: Length of a large error (90 % quantile) as a share of the extent of everything.
SHARE: Final = 0.07


@dataclass(frozen=True)
class Layer:
    """One layer: n features of one kind.

    Parameters
    ----------
    name : str
    kind : str
        Kind of geometry: Point, LineString, MultiPolygon.
    geometries : list of dict
        GeoJSON objects; those of a MultiPolygon layer may be Polygons.
    columns : dict
        Attribute to its n values: words, or numbers with nan for none.
    """

    name: str
    kind: str
    geometries: list[dict[str, Any]]
    columns: dict[str, Column]


def read_layers(folder: Path, vector_scale: float | None = None) -> tuple[Layer, ...]:
    """Read a result folder as layers ``points``, ``error_vectors``, ``footprints``.

    Parameters
    ----------
    folder : Path
        Result folder of ``adjust``.
    vector_scale : float, optional
        Enlargement of the error vectors; by default a round number with which a large error is well seen.

    Raises
    ------
    InputError
        No result, a damaged one, one without geographic coordinates, or a scale that is not positive.
    """
    if vector_scale is not None and not (math.isfinite(vector_scale) and vector_scale > 0.0):
        raise InputError.of("options.value", option="vector_scale", value=vector_scale, expected="a positive number")
    result = read_result(folder)
    table = result.points
    place = table.numbers("lon_deg", "lat_deg")
    rows = np.flatnonzero(np.isfinite(place).all(axis=1))
    if not len(rows):
        raise InputError.of("report.no_map", file=folder, option="export")
    points = Layer("points", "Point", [_point(p) for p in place[rows].tolist()], _columns(table, rows))
    return points, error_vectors(table, vector_scale or default_scale(table)), footprints(result)


def _point(lon_lat: list[float]) -> dict[str, Any]:
    return {"type": "Point", "coordinates": lon_lat}


def _columns(table: Table, rows: npt.NDArray[np.intp]) -> dict[str, Column]:
    """The fields of the points that the table holds, of some rows."""
    given = {name: table.values[name] for name in POINT_FIELDS if name in table.values}
    return {n: [v[k] for k in rows.tolist()] if isinstance(v, list) else v[rows] for n, v in given.items()}


def _with_errors(table: Table) -> npt.NDArray[np.intp]:
    known = table.numbers("lon_deg", "lat_deg", "difference_east_m", "difference_north_m")
    return np.flatnonzero(np.isfinite(known).all(axis=1))


def default_scale(table: Table) -> float:
    """Round enlargement with which a large error has a good length on a map of all points; 1 without errors."""
    rows = _with_errors(table)
    lengths = np.hypot(*table.numbers("difference_east_m", "difference_north_m")[rows].T)
    lengths = lengths[lengths > 0.0]
    place = table.numbers("lon_deg", "lat_deg")
    place = place[np.isfinite(place).all(axis=1)]
    lon = np.unwrap(place[:, 0], period=360.0)
    shrink = math.cos(math.radians(float(place[:, 1].mean())))
    extent_m = 1000.0 * KM_PER_DEGREE * max(float(np.ptp(lon)) * shrink, float(np.ptp(place[:, 1])))
    if not len(lengths) or extent_m <= 0.0:
        return 1.0
    return max(round_down(SHARE * extent_m / float(np.quantile(lengths, 0.9))), 1.0)


def error_vectors(table: Table, scale: float) -> Layer:
    """Horizontal differences adjusted minus measured, enlarged, from the adjusted point on.

    The end of a vector lies in the tangent plane of the point and is put down on the ellipsoid: its azimuth is
    that of the difference; the length is true to 1e-5 up to 30 km.
    """
    rows = _with_errors(table)
    place, enu = table.numbers("lon_deg", "lat_deg")[rows], table.numbers(*(f"difference_{a}" for a in ENU))[rows]
    flat = np.column_stack([enu[:, :2] * scale, np.zeros(len(rows))])
    start = geodetic_to_ecef(place[:, 0], place[:, 1], np.zeros(len(rows)))
    ends = start + np.einsum("nij,ni->nj", enu_from_ecef(place[:, 0], place[:, 1]), flat)
    lon, lat, _ = ecef_to_geodetic(ends)
    lon = place[:, 0] + (lon - place[:, 0] + 180.0) % 360.0 - 180.0  # beside its point, over the 180th meridian too
    lines = [
        {"type": "LineString", "coordinates": [a, b]}
        for a, b in zip(place.tolist(), np.stack([lon, lat], axis=1).tolist(), strict=True)
    ]
    words: dict[str, Column] = {name: [table.words[name][k] for k in rows.tolist()] for name in ("id", "role")}
    numbers: dict[str, Column] = {f"difference_{a}": enu[:, k] for k, a in enumerate(ENU)}
    return Layer("error_vectors", "LineString", lines, words | numbers | {
        "length_m": np.hypot(enu[:, 0], enu[:, 1]),
        "azimuth_deg": np.degrees(np.arctan2(enu[:, 0], enu[:, 1])) % 360.0,
        "enlarged": np.full(len(rows), scale),
    })  # fmt: skip


def footprints(result: Result) -> Layer:
    """Footprints of the images by their metadata, at height 0 or the mean height of an RPC; corners joined."""
    images = [i for i in result.record["images"] if len(i["footprint_lon_lat_deg"])]
    found = {row["image"]: row for row in result.residual_summary()}
    rings = [np.array(i["footprint_lon_lat_deg"], float) for i in images]
    geometries = [polygon_geometry(np.column_stack([np.unwrap(r[:, 0], period=360.0), r[:, 1]])) for r in rings]
    words: dict[str, Column] = {
        "image": [str(i["id"]) for i in images],
        "file": [str(i["file"]) for i in images],
        "sensor": [f"{i.get('mission', '')} {i.get('instrument', '')}".strip() for i in images],
    }
    numbers: dict[str, Column] = {name: _numbers(i.get(name) for i in images) for name in ("n_lines", "n_samples")}
    rows = [found.get(i["id"], {}) for i in images]
    numbers["n_image_points"] = _numbers(row.get("n", 0) for row in rows)
    for name in ("rms_line_px", "rms_sample_px", "max_px"):
        numbers[name] = _numbers(row.get(name) for row in rows)
    return Layer("footprints", "MultiPolygon", geometries, words | numbers)


def _numbers(values: Any) -> Array:
    return np.array([math.nan if value is None else float(value) for value in values])
