"""Files of a result for a geographic information system.

Files: GeoPackage with default styles for QGIS, or GeoJSON (RFC 7946). Layers: ``fg_orient.report.layers``.
"""

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
from fg_orient.report.layers import Layer, error_vectors, footprints, points
from fg_orient.result.plain import plain
from fg_orient.result.record import read_result

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
    if not np.isfinite(result.points.numbers("lon_deg", "lat_deg")).all(axis=1).any():
        raise InputError.of("report.no_map", file=folder, option="export")
    layers = (points(result.points), error_vectors(result.points, vector_scale), footprints(result))
    if package:
        write_geopackage(target, layers, str(result.record["provenance"]["date_time_utc"]))
    else:
        write_text(target, geojson(layers))
    return {layer.name: len(layer.geometries) for layer in layers}


def geojson(layers: tuple[Layer, ...]) -> str:
    """One FeatureCollection of all layers; property ``layer``: name of the layer."""
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
    """Write a GeoPackage with one table per layer and the table of styles that QGIS looks for.

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
    """Table ``layer_styles``: the default style of each layer in the words of QGIS."""
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
