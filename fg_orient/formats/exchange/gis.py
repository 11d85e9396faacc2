"""GeoJSON and GeoPackage files with the columns of our tables, for geographic information systems (GIS).

A GeoJSON file (RFC 7946) is a FeatureCollection. A position is longitude, latitude,
height above the WGS84 ellipsoid, always in this order. The properties are ``id, role,
sigma_east_m, sigma_north_m, sigma_up_m`` and ``fixed``; other properties are ignored.

A GeoPackage has a layer ``ground_points`` and a table ``image_points``. It needs pyogrio
and shapely (extra ``geo``). Its geometries are points with Z in the CRS of the survey;
longitude or easting is first. Pixel (0, 0) is the centre of the first pixel, as in our
tables. Tie points have no geometry in either format.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from factors.arrays import Array
from fg_orient.formats.atomic import staged_file, write_text
from fg_orient.formats.exchange.survey import UNKNOWN, Gathering, Survey
from fg_orient.formats.gdal import plain_case, require_layers
from fg_orient.formats.load import foreign_bytes, load_json, open_sqlite
from fg_orient.formats.points import COLUMNS, SIGMA_COLUMNS
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.geodesy.crs import WGS84, same_horizontal
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

#: Members of a feature that may contain the id of the point; the first existing one is used.
_NAMES: Final = ("id", "name", "label", "Name", "Label", "ID")


def read_geojson(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read a FeatureCollection; the user may give a vertical CRS, for example EPSG:4326+5773."""
    path = paths[0]
    content = _content(path)
    if settings.crs and not same_horizontal(settings.crs, WGS84):
        raise InputError.of("interchange.crs_differs", file=path, place="CRS", value=WGS84, given=settings.crs)
    gathered = Gathering(path, settings.crs or WGS84)
    for k, feature in enumerate(content["features"], start=1):
        _take(gathered, feature if isinstance(feature, dict) else {}, k)
    return gathered.finished()


def _content(path: Path) -> dict[str, Any]:
    """Return the collection of a file.

    Refuse nan, infinity and any content other than a collection in WGS84.
    """
    content = load_json(path, "interchange.json")
    if not isinstance(content, dict) or not isinstance(content.get("features"), list):
        what = "it has no list of features"
        raise InputError.of("interchange.geojson", file=path, value=type(content).__name__, what=what)
    named = content.get("crs")  # GeoJSON before 2016 had this member
    if named is not None and "CRS84" not in str(named) and "4326" not in str(named):
        what = "coordinates have to be WGS84 (RFC 7946)"
        raise InputError.of("interchange.geojson", file=path, place="crs", value=named, what=what)
    return content


def _take(gathered: Gathering, feature: dict[str, Any], k: int) -> None:
    """Add one feature to the survey."""
    properties = feature.get("properties") or {}
    members = [properties.get(name) for name in _NAMES] + [feature.get("id")]
    name = next((str(member) for member in members if member not in (None, "")), "")
    geometry = feature.get("geometry")
    if geometry is None:
        gathered.point(name, Role.TIE, UNKNOWN, line=k)
        return
    place, faults = f"feature {k}", gathered.faults
    position = geometry.get("coordinates") if isinstance(geometry, dict) else None
    if not isinstance(position, list) or geometry.get("type") != "Point" or len(position) not in (2, 3):
        faults.add("interchange.geojson", place=place, value=name, what="a geometry is no point")
        return
    sigmas = [properties.get(column) for column in SIGMA_COLUMNS]
    values = [float(v) if _is_number(v) else np.nan for v in (*position, *[None] * (3 - len(position)), *sigmas)]
    if np.isnan(values[: len(position)]).any() or any(v is not None and not _is_number(v) for v in sigmas):
        faults.add("interchange.geojson", place=place, value=name, what="a coordinate or sigma is no number")
        return
    role, fixed = str(properties.get("role") or Role.CONTROL), properties.get("fixed") is True
    gathered.feature(name, role, values[:3], values[3:], number=k, fixed=fixed)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bool(np.isfinite(value))


def write_geojson(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write all points as a FeatureCollection."""
    features = [_feature(survey, k) for k in range(len(survey.ids))]
    content = {"type": "FeatureCollection", "features": features}
    write_text(paths[0], json.dumps(content, ensure_ascii=False, allow_nan=False, indent=1) + "\n")


def _feature(survey: Survey, k: int) -> dict[str, Any]:
    sigmas = survey.sigma_enu_m[k].tolist()
    properties: dict[str, Any] = {"id": survey.ids[k], "role": str(survey.roles[k])}
    if np.isfinite(sigmas).all():
        properties |= dict(zip(SIGMA_COLUMNS, sigmas, strict=True))
    if survey.fixed[k]:
        properties["fixed"] = True
    position = [v for v in survey.coordinates[k].tolist() if np.isfinite(v)]
    geometry = {"type": "Point", "coordinates": position} if survey.located[k] else None
    return {"type": "Feature", "geometry": geometry, "properties": properties}


GEOJSON = Format(
    name="geojson",
    title="GeoJSON (RFC 7946)",
    suffixes=(".geojson", ".json"),
    ground_axes="longitude, latitude (degrees), height (m), WGS84",
    holds=frozenset(Holds) - {Holds.IMAGE, Holds.IMAGES, Holds.SIGMA_IMAGE, Holds.VERTICAL_CRS},
    read=read_geojson,
    write=write_geojson,
    evidence="GDAL reads what we write, and we read what GDAL writes (tests)",
    crs=WGS84,
)


# --- GeoPackage ----------------------------------------------------------------------------------

GROUND: Final = "ground_points"
IMAGE: Final = "image_points"
#: Version 1.2 is sufficient. QGIS before 3.28 gives warnings for later versions.
GPKG_OPTIONS: Final = {"VERSION": "1.2"}


def libraries(file: Path) -> tuple[Any, Any]:
    """Import pyogrio and shapely."""
    try:
        with plain_case():
            import pyogrio
        import shapely
    except ImportError as error:
        raise InputError.of("interchange.no_pyogrio", file=file) from error
    return pyogrio, shapely


def _layer(pyogrio: Any, path: Path, layer: str) -> tuple[dict[str, Any], Any, dict[str, Any]]:
    """Return the description, the geometries (WKB) and the columns of a layer."""
    meta, _, geometry, columns = pyogrio.raw.read(path, layer=layer)
    return meta, geometry, dict(zip(meta["fields"], columns, strict=True))


def read_geopackage(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read both layers of a GeoPackage; the second one may be missing."""
    path = paths[0]
    pyogrio, shapely = libraries(path)
    require_plain_layers(path, (GROUND, IMAGE), "interchange.gpkg")
    with foreign_bytes("interchange.gpkg", path), plain_case():
        layers = [str(name) for name, _ in pyogrio.list_layers(path)]
        ground = _layer(pyogrio, path, GROUND) if GROUND in layers else None
        image = _layer(pyogrio, path, IMAGE) if IMAGE in layers else None
    if ground is None or "id" not in ground[2] or ground[1] is None:
        raise InputError.of("interchange.layer", file=path, value=", ".join(layers), layer=GROUND)
    gathered = Gathering(path, settings.crs, ground[0]["crs"] or "")
    with foreign_bytes("interchange.gpkg", path):
        _take_ground(gathered, shapely.from_wkb(ground[1]), ground[2])
        if image is not None:
            _take_image(gathered, image[2], path)
    return gathered.finished()


def require_plain_layers(path: Path, layers: Sequence[str], code: str) -> None:
    """Refuse a GeoPackage that is not a database, or that has views as layers.

    GDAL would run the code of a view. GDAL also ignores the name of a file and uses its
    content to find the format. Other formats may refer to other files and to network
    addresses.
    """
    if not path.is_file():
        raise InputError.of("table.missing_file", file=path)
    with open_sqlite(path, layers, code):
        pass


def _take_ground(gathered: Gathering, geometry: Any, columns: dict[str, Any]) -> None:
    n = len(geometry)
    sigmas = np.stack([np.asarray(columns.get(name, np.full(n, np.nan)), float) for name in SIGMA_COLUMNS], axis=1)
    roles, fixed = columns.get("role", [Role.CONTROL] * n), columns.get("fixed", np.zeros(n, bool))
    for k, point in enumerate(geometry):
        name = "" if columns["id"][k] is None else str(columns["id"][k])
        if point is None or point.is_empty:
            gathered.point(name, Role.TIE, UNKNOWN, line=k + 1)
        elif point.geom_type != "Point":
            gathered.faults.add("interchange.layer", place=f"feature {k + 1}", value=point.geom_type, layer=GROUND)
        else:
            xyz = (point.x, point.y, point.z if point.has_z else np.nan)
            gathered.feature(name, roles[k], xyz, sigmas[k].tolist(), number=k + 1, fixed=bool(fixed[k]))


def _take_image(gathered: Gathering, columns: dict[str, Any], path: Path) -> None:
    for column in COLUMNS:
        if column not in columns:
            raise InputError.of("interchange.columns", file=path, place=f"layer {IMAGE}", column=column)
    for k, (image, name, line, sample, *sigma) in enumerate(zip(*(columns[c] for c in COLUMNS), strict=True), start=1):
        if not np.isfinite([line, sample]).all():
            gathered.faults.add("table.not_a_number", place=f"layer {IMAGE}, feature {k}", value=f"{line} {sample}")
        gathered.measure(str(image or ""), str(name or ""), float(line), float(sample), sigma, line=k)


def write_geopackage(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write a GeoPackage with both layers.

    The second one is written only if there are image points.
    """
    with staged_file(paths[0], suffix=".gpkg") as temporary:
        text = [np.array(survey.ids, object), np.array([str(role) for role in survey.roles], object)]
        columns = dict(zip(("id", "role", *SIGMA_COLUMNS), (*text, *survey.sigma_enu_m.T), strict=True))
        _write_points(temporary, GROUND, survey.coordinates, {**columns, "fixed": survey.fixed}, survey.crs)
        layers = {GROUND: (len(survey.ids), int(survey.located.sum()))}
        if len(o := survey.observed):
            names = [np.array(survey.images, object)[o.image], np.array(survey.ids, object)[o.point]]
            data = [*names, o.line, o.sample, o.sigma_line_px, o.sigma_sample_px]
            with plain_case():
                libraries(paths[0])[0].raw.write(temporary, None, data, list(COLUMNS), layer=IMAGE, driver="GPKG",
                                                 append=True)  # fmt: skip
            layers[IMAGE] = (len(o), 0)
        require_layers(temporary, layers)


def write_point_layer(
    path: Path, layer: str, coordinates: Array, columns: dict[str, npt.NDArray[Any]], crs: str | None, text: str
) -> None:
    """Write a GeoPackage with one layer of points (n, 3); ``text`` describes the layer."""
    with staged_file(path, suffix=".gpkg") as temporary:
        _write_points(temporary, layer, coordinates, columns, crs, DESCRIPTION=text)
        located = int(np.isfinite(coordinates[:, :2]).all(axis=1).sum())
        require_layers(temporary, {layer: (len(coordinates), located)})


def _write_points(
    path: Path, layer: str, coordinates: Array, columns: dict[str, npt.NDArray[Any]], crs: str | None, **options: str
) -> None:
    """Write points with Z.

    A point without coordinates has no geometry; a point without a height has no Z.
    """
    pyogrio, shapely = libraries(path)
    geometry: npt.NDArray[np.object_] = shapely.to_wkb(shapely.points(np.nan_to_num(coordinates)))
    located = np.isfinite(coordinates[:, :2]).all(axis=1)
    geometry[~located] = None
    flat = located & np.isnan(coordinates[:, 2])
    geometry[flat] = shapely.to_wkb(shapely.points(coordinates[flat, :2]))
    with plain_case(), warnings.catch_warnings():
        if not crs:
            warnings.filterwarnings("ignore", "'crs' was not provided")  # local coordinates have no CRS
        pyogrio.raw.write(
            path, geometry, list(columns.values()), list(columns), layer=layer, driver="GPKG", geometry_type="Point Z",
            crs=crs, dataset_options=GPKG_OPTIONS, layer_options=options, nan_as_null=True,
        )  # fmt: skip


GEOPACKAGE = Format(
    name="gpkg",
    title="GeoPackage",
    suffixes=(".gpkg",),
    first_pixel=(0.0, 0.0),
    pixel_axes="line, sample (pixels)",
    ground_axes="longitude or easting, latitude or northing, height (m)",
    holds=frozenset(Holds),
    read=read_geopackage,
    write=write_geopackage,
    evidence="written and read by GDAL (tests)",
)
