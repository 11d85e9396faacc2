"""Layers of a result as files: GeoPackage with default styles for QGIS, or GeoJSON (RFC 7946)."""

from __future__ import annotations

import json
import math
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np

from fg_orient.formats.atomic import require_free_files, staged_file, write_text
from fg_orient.formats.exchange.gis import GPKG_OPTIONS
from fg_orient.formats.gdal import plain_case
from fg_orient.model.errors import InputError
from fg_orient.report.layers import Layer, read_layers
from fg_orient.result.record import read_record

__all__ = ["export"]

CRS: Final = "EPSG:4326"
SUFFIXES: Final = (".gpkg", ".geojson")
#: Digits of a degree in GeoJSON: 0.1 mm.
DIGITS: Final = 9
#: How GDAL writes UTC: GeoPackage knows times of no other zone.
UTC_OF_GDAL: Final = 100
#: Whole numbers among the attributes.
WHOLE: Final = frozenset(("n_rays", "n_lines", "n_samples", "n_image_points"))


def export(
    folder: str | Path, out: str | Path, *, vector_scale: float | None = None, overwrite: bool = False
) -> dict[str, int]:
    """Write points, error vectors and footprints of a result for a geographic information system.

    Parameters
    ----------
    folder : path
        Result folder of ``adjust``.
    out : path
        File to come; its suffix chooses GeoPackage (``.gpkg``) or GeoJSON (``.geojson``).
    vector_scale : float, optional
        Enlargement of the error vectors; see :func:`fg_orient.report.layers.read_layers`.
    overwrite : bool
        Replace an existing file.

    Returns
    -------
    dict
        Number of features by layer.

    Raises
    ------
    InputError
        No result, one without geographic coordinates, an unknown suffix, a missing library, or a file that may not be
        written.
    """
    target = Path(out)
    if target.suffix.lower() not in SUFFIXES:
        raise InputError.of("report.export_suffix", file=out, option="export", value=target.suffix or "none")
    package = target.suffix.lower() == ".gpkg"
    if package and None in (find_spec("pyogrio"), find_spec("shapely")):
        raise InputError.of("report.no_pyogrio", file=out, option="export")
    require_free_files(target, overwrite=overwrite and target.is_file(), option="export")
    layers = read_layers(Path(folder), vector_scale)
    if package:
        made = read_record(Path(folder))["provenance"]["date_time_utc"]
        write_geopackage(target, layers, str(made))
    else:
        write_text(target, geojson(layers))
    return {layer.name: len(layer.geometries) for layer in layers}


def geojson(layers: tuple[Layer, ...]) -> str:
    """One FeatureCollection of all layers; the property ``layer`` tells them apart."""
    features = [
        {"type": "Feature", "geometry": _rounded(geometry), "properties": {"layer": layer.name, **properties}}
        for layer in layers
        for geometry, properties in zip(layer.geometries, _records(layer), strict=True)
    ]
    lines = ",\n".join(json.dumps(feature, allow_nan=False, ensure_ascii=False) for feature in features)
    return f'{{"type": "FeatureCollection", "features": [\n{lines}\n]}}\n'


def _rounded(geometry: dict[str, Any]) -> dict[str, Any]:
    def shorter(value: Any) -> Any:
        return [shorter(v) for v in value] if isinstance(value, list) else round(value, DIGITS)

    return {"type": geometry["type"], "coordinates": shorter(geometry["coordinates"])}


def _records(layer: Layer) -> list[dict[str, Any]]:
    """Properties of each feature; None for nan."""

    def plain(name: str, value: Any) -> Any:
        if isinstance(value, str):
            return value
        return None if math.isnan(value) else int(value) if name in WHOLE else float(value)

    rows = zip(*layer.columns.values(), strict=True)
    return [{n: plain(n, v) for n, v in zip(layer.columns, row, strict=True)} for row in rows]


def write_geopackage(path: Path, layers: tuple[Layer, ...], made: str) -> None:
    """Write a GeoPackage with one table per layer and the table of styles that QGIS looks for.

    Parameters
    ----------
    path : Path
    layers : tuple of Layer
    made : str
        Date and time (ISO 8601, UTC) to stand in the file, so that it repeats.
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
        except pyogrio.errors.DataSourceError as error:
            raise OSError(str(error)) from error
        finally:
            pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": before})


def _write_layer(path: Path, layer: Layer) -> None:
    import shapely
    from pyogrio.raw import write
    from shapely.geometry import shape

    columns = [_field(name, values) for name, values in layer.columns.items()]
    write(
        path, np.asarray(shapely.to_wkb([shape(g) for g in layer.geometries]), object), columns, list(layer.columns),
        layer=layer.name, driver="GPKG", geometry_type=layer.kind, crs=CRS, promote_to_multi=layer.kind[:5] == "Multi",
        nan_as_null=True, dataset_options=None if path.exists() else GPKG_OPTIONS,
    )  # fmt: skip


def _field(name: str, values: Any) -> Any:
    if isinstance(values, list):
        return np.array(values, object)
    return values.astype(np.int64) if name in WHOLE and np.isfinite(values).all() else np.asarray(values, float)


def _write_styles(path: Path, layers: tuple[Layer, ...], made: str) -> None:
    """Table ``layer_styles``: the default style of each layer in the words of QGIS."""
    from pyogrio.raw import write

    names = [layer.name for layer in layers]
    templates = resources.files("fg_orient.report").joinpath("styles")
    styles = [templates.joinpath(f"{name}.qml").read_text("utf-8") for name in names]
    n = len(names)
    fields: dict[str, Any] = {
        "f_table_catalog": [""] * n, "f_table_schema": [""] * n, "f_table_name": names,
        "f_geometry_column": ["geom"] * n, "styleName": ["fg_orient"] * n, "styleQML": styles, "styleSLD": [""] * n,
        "useAsDefault": [True] * n, "description": ["default style"] * n, "owner": [""] * n, "ui": [""] * n,
    }  # fmt: skip
    data = [np.array(values, bool if name == "useAsDefault" else object) for name, values in fields.items()]
    data.append(np.array([made[:19]] * n, "datetime64[ms]"))
    write(path, None, data, [*fields, "update_time"], layer="layer_styles", driver="GPKG", geometry_type=None,
          layer_options={"FID": "id"}, gdal_tz_offsets={"update_time": np.full(n, UTC_OF_GDAL)})  # fmt: skip
