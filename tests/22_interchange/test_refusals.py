"""Errors in foreign files are refused: exchanged axes, positive rows, decimal commas, encodings, other CRS."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.convert import filled, read_survey, write_survey
from fg_orient.formats.exchange.survey import Survey
from fg_orient.formats.points_write import write_points
from fg_orient.formats.registry import Settings, formats
from fg_orient.formats.scenes import Scene
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

pytestmark = pytest.mark.behaviour

UTM = "EPSG:32636"
ZONGULDAK = Scene.from_footprint("left", np.array([[31.5, 41.6], [32.2, 41.6], [32.2, 41.0], [31.5, 41.0]], float))


def read(
    folder: Path, name: str, *texts: str | bytes, scenes: tuple[Scene, ...] = (), **settings: str
) -> tuple[Survey, list[str]]:
    paths = [folder / f"file{k}" for k in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    survey, remarks = read_survey(paths, formats()[name], Settings(**settings), accept_unverified=True, scenes=scenes)
    return survey, [p.code for p in remarks]


ROW = "P,400000.5,4580000.25,120.5\n"


@pytest.mark.parametrize(
    ("name", "text", "crs", "message"),
    [
        ("pix4d", "P,141.5,31.25,10\n", "EPSG:4979", "longitude and latitude look swapped"),
        ("pix4d", "P,4580000.25,400000.5,120.5\n", UTM, "easting and northing look swapped"),
        ("asp-gcp", "P 141.5 31.25 10 1 1 1\n", "EPSG:4979", "longitude and latitude look swapped"),
        ("geojson", '{"features": [{"id": 1, "geometry": {"type": "Point", "coordinates": [4, 99]}}]}', "", "swapped"),
        ("qgis-points", "#CRS: EPSG:32636\nmapX,mapY,sourceX,sourceY,enable\n4e5,4.58e6,10,20,1\n", "", "negative"),
        ("qgis-points", "#CRS: EPSG:32636\nmapX,mapY,sourceX,enable\n4e5,4.58e6,10,1\n", "", "column sourceY"),
        ("qgis-points", "", UTM, "lacks the column mapX"),
        ("pix4d", "P;400000,5;4580000,25;120,5\n", UTM, "decimal comma"),
        ("pix4d", "P,400000,5,4580000,25,120,5\n", UTM, "wrong number of cells"),
        ("odm", "EPSG:32636\n400000,5 4580000 120 1 2 a.tif p\n", "", "decimal comma"),
        ("odm", "400000.5 4580000 120 1 2 a.tif p\n", "", "does not state its CRS"),
        ("odm", "EPSG:32636\n4e5 4.58e6 9 1 2 a.tif p\n4e5 4.58e6 8 1 2 b.tif p\n", "", "coordinates on line 2"),
        ("odm", "EPSG:32636\n4e5 4.58e6 9 1 2\n", "", "wrong number of cells"),
        ("odm", "", "", "no points"),
        ("micmac", "P 4e5 4.58e6\n", UTM, "wrong number of cells"),
        ("micmac", "P 4e5 4.58e6 nan\n", UTM, "not a finite number"),
        ("metashape-csv", "a,b,c\n1,2,3\n", UTM, "lacks the column label"),
        ("metashape-csv", "label,x,y\nP,1,2\n", UTM, "lacks the column z"),
        ("metashape-csv", "label,x,y,z\nP,4e5,4.58e6,1\nP,4e5,4.58e6,1\n", UTM, "used twice, first on line 2"),
        ("metashape-csv", "label,x,y,z\n,4e5,4.58e6,1\n", UTM, "no id"),
        ("metashape-csv", 'label,x,y,z\n"P,4e5,4.58e6,1\n', UTM, "without a closing quote"),
        ("geojson", "[1", "", "not JSON"),
        ("geojson", '{"features": [{"geometry": {"type": "Point", "coordinates": [NaN, 1]}}]}', "", "not JSON"),
        ("geojson", "[" * 100000, "", "not JSON"),
        ("geojson", '{"type": "Point"}', "", "FeatureCollection"),
        ("geojson", '{"crs": {"name": "EPSG:32636"}, "features": []}', "", "WGS84"),
        ("geojson", '{"features": [{"id": 1, "geometry": {"type": "LineString", "coordinates": []}}]}', "", "no point"),
        ("geojson", '{"features": []}', UTM, "not the one given"),
        ("metashape-xml", "<document><chunk/></document>", "", "does not state its CRS"),
        ("metashape-xml", "<document><chunk/></document>", UTM, "no points"),
        ("metashape-xml", "<!DOCTYPE a []><document><chunk/></document>", UTM, "DOCTYPE"),
        ("gpkg", "no database", UTM, "GeoPackage"),
        ("pix4d", ROW, "", "does not state its CRS"),
        ("pix4d", ROW, "EPSG:1", "unknown EPSG code"),
        ("pix4d", ROW.encode("utf-16"), UTM, "UTF-16"),
        ("pix4d", "Çatı,400000.5,4580000.25,120.5\n".encode("iso8859-9"), UTM, "not UTF-8"),
        ("pix4d", b"P\0" + ROW.encode(), UTM, "NUL"),
    ],
)  # fmt: skip
def test_refused_with_a_reason(tmp_path: Path, name: str, text: str | bytes, crs: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, name, text, crs=crs)
    assert all(p.remedy for p in caught.value.problems)


@pytest.mark.parametrize("text", ["\ufeff" + ROW, ROW.replace("\n", "\r\n"), "\n" + ROW + "\n", ROW.replace(",", ";"),
                                  ROW.replace("\n", ",,\n"), "# remark\n" + ROW])  # fmt: skip
def test_byte_order_marks_line_ends_semicolons_and_blank_cells_change_nothing(tmp_path: Path, text: str) -> None:
    survey, _ = read(tmp_path, "pix4d", text, crs=UTM)
    assert survey.ids == ("P",)
    assert survey.coordinates.tolist() == [[400000.5, 4580000.25, 120.5]]


def test_the_file_states_one_crs_and_the_user_another(tmp_path: Path) -> None:
    text = "EPSG:32636\n4e5 4.58e6 9 1 2 a.tif p\n"
    with pytest.raises(InputError, match="not the one given"):
        read(tmp_path, "odm", text, crs="EPSG:32635")
    # a vertical CRS adds information and does not contradict
    assert read(tmp_path, "odm", text, crs="EPSG:32636+5773")[0].crs == "EPSG:32636+5773"


def test_footprints_find_exchanged_degrees_that_look_possible(tmp_path: Path) -> None:
    text = "P 31.8 41.4 10 1 1 1\n"  # longitude first: 31.8 is a latitude, too
    found, _ = read(tmp_path, "asp-gcp", text, crs="EPSG:4979")
    assert found.coordinates[0, :2].tolist() == [41.4, 31.8]
    with pytest.raises(InputError, match="lon_deg and lat_deg look swapped"):
        read(tmp_path, "asp-gcp", text, crs="EPSG:4979", scenes=(ZONGULDAK,))


def test_a_zone_that_is_wrong_is_remarked(tmp_path: Path) -> None:
    text = "P,1400000.5,4580000.25,120.5\n"  # 12 degrees east of the zone's meridian
    assert "remark.outside_area" in read(tmp_path, "pix4d", text, crs=UTM)[1]
    assert "remark.outside_area" not in read(tmp_path, "pix4d", ROW, crs=UTM)[1]


@pytest.mark.parametrize("name", ["pix4d", "metashape-csv", "csv"])
def test_cells_that_a_spreadsheet_would_run_are_text_in_own_tables(tmp_path: Path, name: str) -> None:
    names = ("=cmd|' /C calc'!A0", "@x", "-5")
    survey, _ = read(tmp_path, "pix4d", "".join(ROW.replace("P", one) for one in names), crs=UTM)
    assert survey.ids == names
    survey = filled(survey, sigma_ground_m=(1.0, 1.0, 1.0))
    write_survey(survey, [tmp_path / "a.csv"], formats()[name], Settings())
    lines = (tmp_path / "a.csv").read_text("utf-8").splitlines()[-3:]
    written = [next(csv.reader([line]))[0] for line in lines]
    # other programs take ids as they are; an apostrophe makes them text in our own tables, which read it away
    assert written == ([names[0], names[1], names[2]] if name != "csv" else ["'=cmd|' /C calc'!A0", "'@x", written[2]])
    assert written[2] in ("-5", "'-5")
    again, _ = read(tmp_path, name, (tmp_path / "a.csv").read_text("utf-8"), crs=UTM)
    assert again.ids == names


def test_roles_sigmas_and_heights_are_filled_where_nothing_is_said(tmp_path: Path) -> None:
    survey, _ = read(tmp_path, "pix4d", ROW + ROW.replace("P", "Q").replace("\n", ",0.1,0.2\n"), crs=UTM)
    found = filled(survey, sigma_ground_m=(1.0, 2.0, 3.0), sigma_image_px=(0.5, 0.25), height_m=7.0, check=("Q",))
    assert found.sigma_enu_m.tolist() == [[1.0, 2.0, 3.0], [0.1, 0.1, 0.2]]
    assert found.coordinates[:, 2].tolist() == [120.5, 120.5]
    assert found.roles == (Role.CONTROL, Role.CHECK)
    with pytest.raises(InputError, match="no point with coordinates"):
        filled(survey, check=("R",))


def test_what_a_format_needs_is_asked_for_by_option(tmp_path: Path) -> None:
    survey, _ = read(tmp_path, "pix4d", ROW, "a.tif,P,1,2\n", crs=UTM)
    out = [tmp_path / "a.csv"]
    for sigma, option in (
        (None, "option sigma_ground"), ((1.0, 1.0, 1.0), "option sigma_image"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=option):
            write_survey(filled(survey, sigma_ground_m=sigma), out, formats()["csv"], Settings())
    flat = "#CRS: EPSG:32636\nmapX,mapY,sourceX,sourceY\n4e5,4.58e6,10,-20\n"
    points, _ = read(tmp_path, "qgis-points", flat)
    with pytest.raises(InputError, match="option height"):
        write_survey(points, out, formats()["csv"], Settings())
    with pytest.raises(InputError, match="option height"):
        write_survey(points, out, formats()["csv"], Settings(crs="EPSG:4979"))
    assert not out[0].exists()


def _geojson(*ids: str) -> str:
    """Return the text of a GeoJSON file of points with these ids."""
    point = {"type": "Point", "coordinates": [31.5, 41.5, 100.0]}
    features = [{"type": "Feature", "geometry": point, "properties": {"id": one}} for one in ids]
    return json.dumps({"type": "FeatureCollection", "features": features})


@pytest.mark.parametrize(
    ("name", "code"),
    [("a\0b", "table.text"), ("a\nb", "table.text"), ("\0", "table.text"), (10_001 * "a", "table.text"),
     ("  ", "points.id_missing"), ("", "points.id_missing")],
)  # fmt: skip
def test_an_id_that_no_table_can_contain_is_refused_by_every_reader(name: str, code: str, tmp_path: Path) -> None:
    """A format cannot change such an id, or write a file that our readers refuse."""
    with pytest.raises(InputError) as caught:
        read(tmp_path, "geojson", _geojson("1", name))
    assert [(p.code, p.place.partition(",")[0]) for p in caught.value.problems] == [(code, "line 2")]


def test_outer_blanks_do_not_belong_to_an_id(tmp_path: Path) -> None:
    """An id of a layer is read as from a table, whose cells have no outer blanks."""
    survey, _ = read(tmp_path, "geojson", _geojson(" a", "b c\t", "d\u2028e"))
    assert survey.ids == ("a", "b c", "d\u2028e")
    table = tmp_path / "points.csv"
    write_points(table, survey.ids, survey.roles, survey.coordinates, np.ones((3, 3)))
    assert read(tmp_path, "csv", table.read_bytes(), crs="EPSG:4979")[0].ids == survey.ids
