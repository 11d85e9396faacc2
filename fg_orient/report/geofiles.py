"""Layers of a result for a geographic information system, and their files.

Layers: points, error vectors and footprints. Geometries are GeoJSON objects in longitude, latitude (degrees, WGS 84,
EPSG:4326), without heights: these are attributes. Attributes are the columns of the result's tables, so that every name
contains a unit. Files: GeoPackage with default styles for QGIS, or GeoJSON (RFC 7946).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.formats.atomic import outputs, require_free_files, staged_file, write_text
from fg_orient.formats.exchange.gis import GPKG_OPTIONS
from fg_orient.formats.gdal import plain_case, require_layers
from fg_orient.formats.load import foreign_bytes
from fg_orient.formats.table_write import WORDS
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.report.chart import round_down
from fg_orient.report.maps import KM_PER_DEGREE, shrink_at
from fg_orient.result.plain import Table, plain
from fg_orient.result.record import Result, read_result, require_earth
from fg_orient.sensors.viewing import polygon_geometry

__all__ = ["export"]
CRS: Final = "EPSG:4326"
SUFFIXES: Final = (".gpkg", ".geojson")
#: Digits of a degree in GeoJSON: 0.1 mm.
DIGITS: Final = 9
#: Code of UTC in GDAL; times of a GeoPackage are UTC.
UTC_OF_GDAL: Final = 100


def export(
    folder: str | Path, out: str | Path, *, vector_scale: float | None = None, overwrite: bool = False
) -> dict[str, int]:
    """Write points, error vectors and footprints of a result for a geographic information system.

    Parameters
    ----------
    folder : path
        Result folder of ``adjust``.
    out : path
        File to write; its suffix chooses GeoPackage (``.gpkg``) or GeoJSON (``.geojson``).
    vector_scale : float, optional
        Enlargement of the error vectors; default: a round number with which a large error is well visible.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    dict
        Number of features by layer.

    Raises
    ------
    InputError
        No result, one without geographic coordinates, a scale that is not positive, an unknown suffix, a missing
        library, or a file that may not be written.
    """
    target = Path(out)
    if target.suffix.lower() not in SUFFIXES:
        raise InputError.of("report.export_suffix", file=out, option="export", value=target.suffix or "none")
    package = target.suffix.lower() == ".gpkg"
    if package and None in (find_spec("pyogrio"), find_spec("shapely")):
        raise InputError.of("report.no_pyogrio", file=out, option="export")
    require_free_files(target, overwrite=overwrite and target.is_file(), option="export")
    if vector_scale is not None and not (math.isfinite(vector_scale) and vector_scale > 0.0):
        raise InputError.of("options.value", option="vector_scale", value=vector_scale, expected="a positive number")
    result = read_result(folder)
    require_earth(result, folder, option="export")
    if not np.isfinite(result.points.numbers("lon_deg", "lat_deg")).all(axis=1).any():
        raise InputError.of("report.no_map", file=folder, option="export")
    with foreign_bytes("report.damaged", folder):
        layers = (points(result.points), error_vectors(result.points, vector_scale), footprints(result))
        text = "" if package else geojson(layers)
    with outputs(target, overwrite=overwrite and not target.is_dir(), option="export"):
        if package:
            write_geopackage(target, layers, str(result.record["provenance"]["date_time_utc"]))
        else:
            write_text(target, text)
    return {layer.name: len(layer.geometries) for layer in layers}


def geojson(layers: tuple[Layer, ...]) -> str:
    """Return one FeatureCollection of all layers; the property ``layer`` contains the name of the layer."""
    features = [
        {"type": "Feature", "geometry": {"type": geometry["type"], "coordinates": _rounded(geometry["coordinates"])},
         "properties": plain({"layer": layer.name, **dict(zip(layer.columns, row, strict=True))})}
        for layer in layers
        for geometry, *row in zip(layer.geometries, *layer.columns.values(), strict=True)
    ]  # fmt: skip
    lines = ",\n".join(json.dumps(feature, allow_nan=False, ensure_ascii=False) for feature in features)
    return f'{{"type": "FeatureCollection", "features": [\n{lines}\n]}}\n'


def _rounded(value: Any) -> Any:
    return [_rounded(v) for v in value] if isinstance(value, list) else round(value, DIGITS)


def write_geopackage(path: Path, layers: tuple[Layer, ...], made: str) -> None:
    """Write a GeoPackage with one table per layer and the table of styles that QGIS reads.

    Parameters
    ----------
    path : Path
    layers : tuple of Layer
    made : str
        Date and time (ISO 8601, UTC) in the file; equal results give equal bytes.
    """
    with plain_case():
        import pyogrio

    with staged_file(path, place="<export>", suffix=".gpkg") as temporary, plain_case():
        before = pyogrio.get_gdal_config_option("OGR_CURRENT_DATE")
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": f"{made[:19]}.000Z"})
        try:
            for layer in layers:
                _write_layer(temporary, layer)
            _write_styles(temporary, layers, made)
            sizes = {layer.name: (len(layer.geometries), len(layer.geometries)) for layer in layers}
            require_layers(temporary, sizes | {"layer_styles": (len(layers), 0)})
        except pyogrio.errors.DataSourceError as error:
            raise OSError(str(error)) from error
        finally:
            pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": before})


def _write_layer(path: Path, layer: Layer) -> None:
    import shapely
    from pyogrio.raw import write
    from shapely.geometry import shape

    write(
        path, np.asarray(shapely.to_wkb([shape(g) for g in layer.geometries]), object), list(layer.columns.values()),
        list(layer.columns), layer=layer.name, driver="GPKG", geometry_type=layer.kind, crs=CRS,
        promote_to_multi=layer.kind[:5] == "Multi", nan_as_null=True,
        dataset_options=None if path.exists() else GPKG_OPTIONS,
    )  # fmt: skip


def _write_styles(path: Path, layers: tuple[Layer, ...], made: str) -> None:
    """Write the table ``layer_styles``: the default style of each layer in the format of QGIS."""
    from pyogrio.raw import write

    n, templates = len(layers), resources.files("fg_orient.report").joinpath("styles")
    fields: dict[str, Any] = {
        **dict.fromkeys(("f_table_catalog", "f_table_schema"), [""] * n), "f_table_name": [one.name for one in layers],
        "f_geometry_column": ["geom"] * n, "styleName": ["fg_orient"] * n,
        "styleQML": [templates.joinpath(f"{one.name}.qml").read_text("utf-8") for one in layers], "styleSLD": [""] * n,
        "useAsDefault": [True] * n, "description": ["default style"] * n, "owner": [""] * n, "ui": [""] * n,
    }  # fmt: skip
    data = [np.array(values, bool if name == "useAsDefault" else object) for name, values in fields.items()]
    data.append(np.array([made[:19]] * n, "datetime64[ms]"))
    write(path, None, data, [*fields, "update_time"], layer="layer_styles", driver="GPKG", geometry_type=None,
          layer_options={"FID": "id"}, gdal_tz_offsets={"update_time": np.full(n, UTC_OF_GDAL)})  # fmt: skip


# --- layers ---------------------------------------------------------------------------------------------
ENU: Final = ("east_m", "north_m", "up_m")
#: Attributes of the points, if the table has them.
POINT_FIELDS: Final = (
    "id", "role", "n_rays", "height_m", "sigma_scale", *(f"sigma_{a}" for a in ENU),
    *(f"difference_{a}" for a in ENU), *(f"own_sigma_{a}" for a in ENU), *(f"mdb_{a}" for a in ENU), "external_m",
    *(f"unseen_{a}" for a in ENU), "weight",
)  # fmt: skip
#: Texts and whole numbers among the attributes.
TEXT: Final = WORDS | {"file", "sensor"}
WHOLE: Final = frozenset(("n_rays", "n_lines", "n_samples", "n_image_points"))
#: Length of a large error (90 % quantile) as a share of the extent of all points.
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
        GeoJSON objects; a MultiPolygon layer may also contain Polygons.
    columns : dict
        Attribute to an array of its n values: text, whole numbers, or numbers with nan for none.
    """

    name: str
    kind: str
    geometries: list[dict[str, Any]]
    columns: dict[str, npt.NDArray[Any]]

    @classmethod
    def typed(cls, name: str, kind: str, geometries: list[dict[str, Any]], columns: dict[str, Any]) -> Layer:
        """Return the layer with its columns as arrays of their types; None becomes nan in a column of numbers."""
        typed: dict[str, npt.NDArray[Any]] = {}
        for column, values in columns.items():
            if column in TEXT:
                typed[column] = np.array(values, object)
                continue
            numbers = np.array(values, float)
            typed[column] = numbers.astype(np.int64) if column in WHOLE and np.isfinite(numbers).all() else numbers
        return cls(name, kind, geometries, typed)


def points(table: Table) -> Layer:
    """Return the layer of points with geographic coordinates and their fields in the table."""
    place = table.numbers("lon_deg", "lat_deg")
    rows = np.flatnonzero(np.isfinite(place).all(axis=1)).tolist()
    geometries = [{"type": "Point", "coordinates": lon_lat} for lon_lat in place[rows].tolist()]
    given = {name: [table.values[name][k] for k in rows] for name in POINT_FIELDS if name in table.values}
    return Layer.typed("points", "Point", geometries, given)


def error_vectors(table: Table, scale: float | None) -> Layer:
    """Return the layer of horizontal differences adjusted minus measured, enlarged, starting at the adjusted point.

    The end of a vector is in the tangent plane of the point, projected onto the ellipsoid. The azimuth
    is the azimuth of the difference, and the relative error of the length is 1e-5 up to 30 km. Default
    scale: a large error is well visible.
    """
    place, enu = table.numbers("lon_deg", "lat_deg"), table.numbers(*(f"difference_{a}" for a in ENU))
    rows = np.flatnonzero(np.isfinite(np.hstack([place, enu[:, :2]])).all(axis=1))
    scale = scale or _default_scale(place[np.isfinite(place).all(axis=1)], enu[rows])
    place, enu, flat = place[rows], enu[rows], np.zeros((len(rows), 3))
    flat[:, :2] = enu[:, :2] * scale
    start = geodetic_to_ecef(place[:, 0], place[:, 1], np.zeros(len(rows)))
    ends = start + np.einsum("nij,ni->nj", enu_from_ecef(place[:, 0], place[:, 1]), flat)
    lon, lat, _ = ecef_to_geodetic(ends)
    # keep the end of the vector near its point, also at the 180th meridian
    lon = place[:, 0] + (lon - place[:, 0] + 180.0) % 360.0 - 180.0
    lines = np.stack([place, np.stack([lon, lat], axis=1)], axis=1).tolist()
    return Layer.typed("error_vectors", "LineString", [{"type": "LineString", "coordinates": line} for line in lines], {
        **{name: [table.words[name][k] for k in rows.tolist()] for name in ("id", "role")},
        **{f"difference_{a}": enu[:, k] for k, a in enumerate(ENU)},
        "length_m": np.hypot(enu[:, 0], enu[:, 1]),
        "azimuth_deg": np.degrees(np.arctan2(enu[:, 0], enu[:, 1])) % 360.0,
        "enlarged": np.full(len(rows), scale),
    })  # fmt: skip


def _default_scale(place: Array, enu: Array) -> float:
    """Return a round enlargement of differences (k, 3) on a map of points (n, 2); 1 without differences."""
    lengths = np.hypot(enu[:, 0], enu[:, 1])
    lengths, lon = lengths[lengths > 0.0], np.unwrap(place[:, 0], period=360.0)
    width = float(np.ptp(lon)) * shrink_at(float(place[:, 1].mean()))
    extent_m = 1000.0 * KM_PER_DEGREE * max(width, float(np.ptp(place[:, 1])))
    if not len(lengths) or extent_m <= 0.0:
        return 1.0
    return max(round_down(SHARE * extent_m / float(np.quantile(lengths, 0.9))), 1.0)


def footprints(result: Result) -> Layer:
    """Return the layer of footprints by the metadata, at height 0 or the mean height of an RPC."""
    images = [i for i in result.record["images"] if len(i["footprint_lon_lat_deg"])]
    summaries = {row["image"]: row for row in result.residual_summary()}
    rings = [np.array(i["footprint_lon_lat_deg"], float) for i in images]
    geometries = [polygon_geometry(np.column_stack([np.unwrap(r[:, 0], period=360.0), r[:, 1]])) for r in rings]
    rows = [summaries.get(i["id"], {}) for i in images]
    return Layer.typed("footprints", "MultiPolygon", geometries, {
        "image": [str(i["id"]) for i in images],
        "file": [str(i["file"]) for i in images],
        "sensor": [f"{i.get('mission', '')} {i.get('instrument', '')}".strip() for i in images],
        **{name: [i.get(name) for i in images] for name in ("n_lines", "n_samples")},
        "n_image_points": [row.get("n", 0) for row in rows],
        **{name: [row.get(name) for row in rows] for name in ("rms_line_px", "rms_sample_px", "max_px")},
    })  # fmt: skip
