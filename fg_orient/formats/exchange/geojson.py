"""GeoJSON (RFC 7946): a FeatureCollection of points with the properties of our tables.

Positions are longitude, latitude, height above the WGS84 ellipsoid, always in this order. Tie points are features
without geometry. Properties: ``id, role, sigma_east_m, sigma_north_m, sigma_up_m``, ``fixed``; others are ignored.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from fg_orient.formats.atomic import write_text
from fg_orient.formats.exchange.survey import UNKNOWN, Gathering, Survey
from fg_orient.formats.points import SIGMA_COLUMNS
from fg_orient.formats.registry import Format, Holds, Settings
from fg_orient.formats.tables import Faults, read_text
from fg_orient.geodesy.crs import WGS84, same_horizontal
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

#: Members that may name a point, in order of preference.
_NAMES: Final = ("id", "name", "label", "Name", "Label", "ID")


def read(paths: tuple[Path, ...], settings: Settings) -> Survey:
    """Read a FeatureCollection; a vertical CRS may be given, as EPSG:4326+5773."""
    path = paths[0]
    content = _content(path)
    if settings.crs and not same_horizontal(settings.crs, WGS84):
        raise InputError.of("interchange.crs_differs", file=path, place="CRS", value=WGS84, given=settings.crs)
    gathered = Gathering(path, settings.crs or WGS84)
    for k, feature in enumerate(content["features"], start=1):
        _take(gathered, feature if isinstance(feature, dict) else {}, k)
    return gathered.finished()


def _content(path: Path) -> dict[str, Any]:
    """The collection; nan, infinity and other content than a collection in WGS84 are refused."""
    faults = Faults(str(path))
    text = read_text(path, faults)
    faults.raise_if_any()

    def refuse(word: str) -> NoReturn:
        raise InputError.of("interchange.json", file=path, value=word)

    try:
        content = json.loads(text or "", parse_constant=refuse)
    except (json.JSONDecodeError, RecursionError) as error:
        raise InputError.of("interchange.json", file=path, value=error) from None
    if not isinstance(content, dict) or not isinstance(content.get("features"), list):
        what = "it has no list of features"
        raise InputError.of("interchange.geojson", file=path, value=type(content).__name__, what=what)
    named = content.get("crs")  # of GeoJSON before 2016
    if named is not None and "CRS84" not in str(named) and "4326" not in str(named):
        what = "coordinates have to be WGS84 (RFC 7946)"
        raise InputError.of("interchange.geojson", file=path, place="crs", value=named, what=what)
    return content


def _take(gathered: Gathering, feature: dict[str, Any], k: int) -> None:
    """Take one feature."""
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


def write(survey: Survey, paths: tuple[Path, ...], settings: Settings) -> None:
    """Write all points."""
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


FORMAT = Format(
    name="geojson",
    title="GeoJSON (RFC 7946)",
    suffixes=(".geojson", ".json"),
    ground_axes="longitude, latitude (degrees), height (m), WGS84",
    holds=frozenset(Holds) - {Holds.IMAGE, Holds.IMAGES, Holds.SIGMA_IMAGE, Holds.VERTICAL_CRS},
    read=read,
    write=write,
    evidence="GDAL reads what we write, and we read what GDAL writes (tests)",
    crs=WGS84,
)
