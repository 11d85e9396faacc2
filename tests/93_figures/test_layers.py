"""pyogrio reads the layers for a geographic information system with the data of the tables."""

from __future__ import annotations

import csv
import json
import math
import re
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import shapely
from lxml import etree
from pyproj import Geod

from fg_orient.model.errors import InputError
from fg_orient.report import geofiles
from fg_orient.result.plain import Table
from fg_orient.result.record import Result
from tests.support.pleiades_project import pleiades_project
from tests.support.results import sealed

RESIDUALS = ("v_line_px", "v_sample_px", "sigma_line_px", "sigma_sample_px")
NAMES = ("points", "error_vectors", "footprints")


def read(path: Path, layer: str | None = None) -> tuple[Any, dict[str, Any]]:
    """Return the geometries and columns of a layer; missing values as the driver gives them."""
    meta, _, wkb, fields = pyogrio.raw.read(path, layer=layer)
    assert meta["crs"] == "EPSG:4326"
    return shapely.from_wkb(wkb), dict(zip(meta["fields"], fields, strict=True))


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def package(adjusted: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("layers") / "result.gpkg"
    assert geofiles.export(adjusted, out, vector_scale=1000.0) == {"points": 47, "error_vectors": 47, "footprints": 2}
    return out


@pytest.mark.consistency
def test_points_are_those_of_the_table(package: Path, adjusted: Path) -> None:
    geometry, columns = read(package, "points")
    wanted = table(adjusted / "points.csv")
    assert np.array_equal(
        shapely.get_coordinates(geometry), [[float(r["lon_deg"]), float(r["lat_deg"])] for r in wanted]
    )
    assert columns["id"].tolist() == [r["id"] for r in wanted] and columns["role"].tolist()[0] == "control"
    for name in ("height_m", "sigma_up_m", "difference_east_m", "mdb_up_m"):
        numbers = [float(r[name]) if r[name] else math.nan for r in wanted]
        assert np.array_equal(columns[name], numbers, equal_nan=True), name
    assert columns["n_rays"].dtype.kind == "i" and set(columns["n_rays"]) == {2}
    assert "mdb_up_m" in columns and np.isnan(columns["mdb_up_m"]).sum() == 10  # of check points there is none


@pytest.mark.oracle
def test_vectors_have_azimuth_and_length_of_the_differences(package: Path, adjusted: Path) -> None:
    """Error vectors have azimuth and enlarged length of the differences, by pyproj's geodesics."""
    geometry, columns = read(package, "error_vectors")
    wanted = {r["id"]: r for r in table(adjusted / "points.csv")}
    start, end = (shapely.get_coordinates(shapely.get_point(geometry, k)) for k in (0, 1))
    azimuth, _, length = Geod(ellps="WGS84").inv(*start.T, *end.T)
    east, north = (np.array([float(wanted[i][f"difference_{a}_m"]) for i in columns["id"]]) for a in ("east", "north"))
    assert np.allclose(length, 1000.0 * np.hypot(east, north), rtol=1e-5)
    assert np.abs((azimuth - np.degrees(np.arctan2(east, north)) + 180.0) % 360.0 - 180.0).max() < 1e-3
    assert np.allclose(columns["azimuth_deg"], azimuth % 360.0, atol=1e-3)
    assert set(columns["enlarged"]) == {1000.0}
    assert np.allclose(columns["length_m"], np.hypot(east, north))


@pytest.mark.behaviour
def test_footprints_hold_their_points(package: Path) -> None:
    geometry, columns = read(package, "footprints")
    points, _ = read(package, "points")
    assert columns["image"].tolist() == ["left", "right"] and columns["n_image_points"].tolist() == [47, 47]
    assert all(shapely.contains(polygon, points).all() for polygon in geometry)
    assert (columns["rms_line_px"] > 0.0).all() and columns["n_lines"].tolist() == [12000, 12000]


@pytest.mark.behaviour
def test_files_are_those_of_an_older_standard(package: Path) -> None:
    """The GeoPackage has version 1.2 and times in UTC. QGIS 3.22 warns of version 1.4 and of a time without UTC."""
    with sqlite3.connect(package) as base:
        assert base.execute("pragma user_version").fetchone() == (10200,)
        times = base.execute("select distinct cast(update_time as text) from layer_styles").fetchall()
    assert len(times) == 1 and re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", times[0][0])


@pytest.mark.behaviour
def test_styles_lie_where_qgis_looks(package: Path) -> None:
    """Each layer has one default style, which is well-formed and uses only fields of the layer."""
    with sqlite3.connect(package) as base:
        rows = base.execute(
            "select f_table_name, f_geometry_column, useAsDefault, styleQML from layer_styles where f_table_schema = ''"
            " and update_time is not null"
        ).fetchall()
    assert [row[:3] for row in rows] == [(name, "geom", 1) for name in NAMES]
    for name, _, _, style in rows:
        root = etree.fromstring(style.encode())
        _, columns = read(package, name)
        used = root.xpath("//renderer-v2/@attr | //text-style/@fieldName")
        assert root.tag == "qgis" and used and set(used) <= set(columns)
        symbols = set(root.xpath("//category/@symbol")) or {"0"}
        assert symbols == set(root.xpath("//symbols/symbol/@name"))


@pytest.mark.behaviour
def test_files_repeat(adjusted: Path, package: Path, tmp_path: Path) -> None:
    geofiles.export(adjusted, tmp_path / "again.gpkg", vector_scale=1000.0)
    assert (tmp_path / "again.gpkg").read_bytes() == package.read_bytes()
    assert pyogrio.get_gdal_config_option("OGR_CURRENT_DATE") is None


@pytest.mark.behaviour
def test_geojson(run: Any, result: Path, adjusted: Path, tmp_path: Path) -> None:
    """The GeoJSON export follows RFC 7946 and has the points of the table.

    Longitude is first, there is no crs, and rings turn left.
    """
    out = tmp_path / "result.geojson"
    ended = run("report", result, "--export", out, "--json")
    assert ended.code == 0, ended.stderr
    assert ended.json["export"] == {"file": str(out), "features": {"points": 47, "error_vectors": 47, "footprints": 2}}
    collection = json.loads(out.read_text("utf-8"))
    assert set(collection) == {"type", "features"}
    kinds = {f["properties"]["layer"]: f["geometry"]["type"] for f in collection["features"]}
    assert kinds == {"points": "Point", "error_vectors": "LineString", "footprints": "Polygon"}
    rings = [f["geometry"]["coordinates"][0] for f in collection["features"] if f["geometry"]["type"] == "Polygon"]
    assert all(shapely.LinearRing(ring).is_ccw and ring[0] == ring[-1] for ring in rings)
    scale = next(f["properties"]["enlarged"] for f in collection["features"] if "enlarged" in f["properties"])
    assert float(f"{scale:.0e}") == scale and f"{scale:e}"[0] in "125"
    geometry, columns = read(out)
    wanted = [[float(r["lon_deg"]), float(r["lat_deg"])] for r in table(adjusted / "points.csv")]
    found = shapely.get_coordinates(geometry[columns["layer"] == "points"])
    assert np.abs(found - wanted).max() <= 0.5e-9 * 1.001
    properties = [f["properties"] for f in collection["features"] if f["properties"].get("role") == "check"]
    assert properties[0]["mdb_up_m"] is None  # nan is no JSON


@pytest.mark.behaviour
def test_across_the_180th_meridian() -> None:
    """At the 180th meridian a vector stays beside its point, and a footprint is cut."""
    numbers = {"lon_deg": 179.9999, "lat_deg": 10.0, "difference_east_m": 1.0, "difference_north_m": 0.0,
               "difference_up_m": 0.0}  # fmt: skip
    points = Table({"id": ["a"], "role": ["check"], **{k: np.array([v]) for k, v in numbers.items()}})
    (line,) = geofiles.error_vectors(points, 1000.0).geometries
    (start, end) = line["coordinates"]
    assert 0.009 < end[0] - start[0] < 0.0095
    image = {"id": "a", "file": "", "footprint_lon_lat_deg": [[179.5, 1.0], [-179.5, 1.0], [-179.5, 0.0], [179.5, 0.0]]}
    empty = Table({"image": [], "id": [], **{k: np.zeros(0) for k in RESIDUALS}})
    result = Result({"images": [image]}, {"points": points, "residuals": empty, "eop": empty})
    (foot,) = geofiles.footprints(result).geometries
    assert foot["type"] == "MultiPolygon" and shapely.geometry.shape(foot).area == pytest.approx(1.0)


@pytest.mark.behaviour
def test_refusals(run: Any, result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def code(*words: object) -> tuple[int, str]:
        ended = run("report", result, "--json", *words)
        return ended.code, ended.json["errors"][0]["code"]

    (tmp_path / "there.gpkg").write_text("mine", encoding="utf-8")
    assert code("--export", tmp_path / "there.gpkg") == (2, "output.exists")
    assert (tmp_path / "there.gpkg").read_text("utf-8") == "mine"
    assert code("--export", tmp_path / "a.gpkg", "--vector-scale", "-2") == (2, "options.value")
    with pytest.raises(InputError, match="neither GeoPackage nor GeoJSON"):
        geofiles.export(result, tmp_path / "a.shp")
    for name in ("a.gpkg", "a.geojson"):
        with pytest.raises(InputError, match="cannot be written"):
            geofiles.export(result, tmp_path / "no" / name)
    monkeypatch.setattr(geofiles, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"fg-orient\[geo\]"):
        geofiles.export(result, tmp_path / "a.gpkg")
    rows = table(result / "points.csv")
    with (result / "points.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows({**row, "lon_deg": "", "lat_deg": ""} for row in rows)
    with pytest.raises(InputError, match="no geographic coordinates"):
        geofiles.export(sealed(result), tmp_path / "a.geojson")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["result", "there.gpkg"]


@pytest.mark.truth
@pytest.mark.real_data
def test_the_real_pair(run: Any, real_data: Path, tmp_path: Path) -> None:
    """The 86 points of the Pléiades pair are within 1 cm of where their differences place them.

    Both footprints contain them.
    """
    project, _ = pleiades_project(real_data, tmp_path)
    assert run("adjust", project, "--eop-set", "10", "--out", tmp_path / "result").code == 0
    ended = run("report", tmp_path / "result", "--export", tmp_path / "pair.gpkg", "--json")
    assert ended.json["export"]["features"] == {"points": 86, "error_vectors": 86, "footprints": 2}
    geometry, columns = read(tmp_path / "pair.gpkg", "points")
    with (real_data / "geoetrim-pleiades" / "points_img1_llh.csv").open(encoding="utf-8") as stream:
        surveyed = {r["point_id"]: (float(r["lon_deg"]), float(r["lat_deg"])) for r in csv.DictReader(stream)}
    lon, lat = np.array([surveyed[i] for i in columns["id"]]).T
    _, _, distance = Geod(ellps="WGS84").inv(lon, lat, *shapely.get_coordinates(geometry).T)
    stated = np.hypot(columns["difference_east_m"], columns["difference_north_m"])
    assert np.abs(distance - stated).max() < 0.01 and stated.max() < 3.0
    feet, _ = read(tmp_path / "pair.gpkg", "footprints")
    assert all(shapely.contains(polygon, geometry).all() for polygon in feet)
