"""Each reader reads a small file written by hand: columns, axes, pixel origin, roles and known numbers."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.survey import Survey, decided_crs
from fg_orient.formats.registry import Settings, formats
from fg_orient.geodesy.crs import wkt
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role

pytestmark = pytest.mark.behaviour

UTM = wkt("EPSG:32636")

METASHAPE_CSV = f"""\
# CoordinateSystem: {UTM}
#Label,Enable,X/Easting,Y/Northing,Z/Altitude,Accuracy_(m),Error_(m)
01,1,400000.5,4580000.25,120.5,0.02/0.05,0.1
k 1,0,401000,4581000,99,0.03,
t1,1,,,,,
# Total error,,,,,,0.1
"""
METASHAPE_XML = f"""\
<?xml version="1.0" encoding="UTF-8"?>
<document version="1.2.0"><chunk>
  <cameras><camera id="0" label="left.tif"/><group><camera id="4" label="right.tif"/></group></cameras>
  <markers>
    <marker id="7" label="01">
      <reference x="400000.5" y="4580000.25" z="120.5" sxy="0.02" sz="0.05" enabled="true"/>
    </marker>
    <marker id="3" label="k 1"><reference x="401000" y="4581000" z="99" sxyz="0.03" enabled="false"/></marker>
    <marker id="9" label="t1"/>
  </markers>
  <frames><frame id="0"><markers>
    <marker marker_id="7">
      <location camera_id="0" pinned="true" x="512.5" y="1034.75"/>
      <location camera_id="4" pinned="true" x="0.5" y="0.5"/>
    </marker>
    <marker marker_id="9"><location camera_id="4" valid="false" x="1" y="1"/></marker>
  </markers></frame></frames>
  <reference>{UTM}</reference>
</chunk></document>
"""
PIX4D = (
    "01,400000.5,4580000.25,120.5,0.02,0.05\nk 1,401000,4581000,99\n",
    "left.tif,01,512.5,1034.75,2\nright.tif,01,.5,.5\n",
)
MICMAC = (
    "# name X Y Z precXY precZ\n01 400000.5 4580000.25 120.5 0.02 0.05\nk_1\t401000  4581000 99\n",
    "01 left.tif 512 1034.25\n01 right.tif 0 0\n",
)
ODM = """\
{crs}
400000.5 4580000.25 120.5 512 1034.25 left.tif 01
400000.5\t4580000.25 120.5 0 0 right.tif 01 extra words
401000 4581000 NaN 10 20 left.tif
401000 4581000 NaN 30 40 right.tif
"""
QGIS = f"""\
#CRS: {UTM}
mapX,mapY,sourceX,sourceY,enable,dX,dY,residual
400000.5,4580000.25,512.5,-1034.75,1,0.1,0.2,0.3
401000,4581000,0.5,-0.5,0,0,0,0
"""
GEOJSON = """\
{"type": "FeatureCollection", "features": [
 {"type": "Feature", "geometry": {"type": "Point", "coordinates": [31.25, 41.5, 120.5]},
  "properties": {"id": "01", "role": "control", "sigma_east_m": 0.02, "sigma_north_m": 0.03, "sigma_up_m": 0.05}},
 {"type": "Feature", "id": 7, "geometry": {"type": "Point", "coordinates": [31.75, 41.6]}, "properties": null},
 {"type": "Feature", "geometry": null, "properties": {"name": "t1"}}
]}
"""


def read(folder: Path, name: str, *texts: str, **settings: str) -> Survey:
    paths = tuple(folder / f"{k}.points" for k in range(len(texts)))
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text, encoding="utf-8")
    reader = formats()[name].read
    assert reader is not None
    return reader(paths, Settings(**settings))


def assert_ground(found: Survey, ids: tuple[str, ...] = ("01", "k 1", "t1")) -> None:
    assert found.crs == "EPSG:32636" and found.ids == ids
    expected = [[400000.5, 4580000.25, 120.5], [401000.0, 4581000.0, 99.0], [np.nan] * 3]
    np.testing.assert_array_equal(found.coordinates, expected[: len(ids)])


def assert_pixels(found: Survey) -> None:
    """Assert the pixels of the first point.

    They are line 1034.25, sample 512 in one image, and the centre of the first pixel in the other.
    """
    assert found.images == ("left.tif", "right.tif")
    o = found.observed
    rows = o.point == found.ids.index("01")
    np.testing.assert_array_equal(np.stack([o.line, o.sample], axis=1)[rows], [[1034.25, 512.0], [0.0, 0.0]])


def test_metashape_csv(tmp_path: Path) -> None:
    found = read(tmp_path, "metashape-csv", METASHAPE_CSV)
    assert_ground(found)
    assert found.roles == (Role.CONTROL, Role.CHECK, Role.TIE)
    np.testing.assert_array_equal(found.sigma_enu_m, [[0.02, 0.02, 0.05], [0.03] * 3, [np.nan] * 3])
    assert tuple(map(str, found.notes)) == ("these columns are not read: Error_(m)",)


def test_a_crs_that_the_users_replaces_is_told(tmp_path: Path) -> None:
    """A note states that --crs replaces a CRS text without an EPSG code; an equal CRS gives no note."""
    grid = 'LOCAL_CS["Quarry grid",  UNIT["metre",1]]'
    local = re.sub("(?<=# CoordinateSystem: ).*", grid, METASHAPE_CSV, count=1)
    found = read(tmp_path, "metashape-csv", local, crs="EPSG:32636")
    told = 'the CRS of the file (LOCAL_CS["Quarry grid", UNIT["metre",1]]) has no EPSG code; EPSG:32636 is used instead'
    assert found.crs == "EPSG:32636" and [*map(str, found.notes)] == [told, "these columns are not read: Error_(m)"]
    assert read(tmp_path, "metashape-csv", METASHAPE_CSV, crs="EPSG:32636").notes == found.notes[1:]
    for stated in ("", "EPSG:32636", "EPSG:32636+5773"):
        assert decided_crs(stated, "EPSG:32636", "f")[1] == ()
    (long,) = decided_crs("x y " * 50, "EPSG:32636", "f")[1]
    assert "x y x..." in str(long) and len(str(long)) < 150


@pytest.mark.parametrize("mark", [";", "\t"])
def test_metashape_csv_with_other_separators_crlf_and_byte_order_mark(tmp_path: Path, mark: str) -> None:
    lines = [line if line.startswith("# Coord") else line.replace(",", mark) for line in METASHAPE_CSV.split("\n")]
    assert_ground(read(tmp_path, "metashape-csv", "\ufeff" + "\r\n".join(lines)))


@pytest.mark.parametrize(
    ("name", "texts", "crs", "ids"),
    [("metashape-xml", (METASHAPE_XML,), "", ("01", "k 1", "t1")), ("pix4d", PIX4D, "EPSG:32636", ("01", "k 1")),
     ("micmac", MICMAC, "EPSG:32636", ("01", "k_1"))],
)  # fmt: skip
def test_metashape_xml_pix4d_and_micmac(
    tmp_path: Path, name: str, texts: tuple[str, ...], crs: str, ids: tuple[str, ...]
) -> None:
    found = read(tmp_path, name, *texts, **({"crs": crs} if crs else {}))
    assert_ground(found, ids)
    assert_pixels(found)
    sigma = [[0.02, 0.02, 0.05], [np.nan] * 3]
    if name == "metashape-xml":
        assert len(found.observed) == 2  # the one that is not valid is none
        assert found.roles == (Role.CONTROL, Role.CHECK, Role.TIE)
        sigma = [[0.02, 0.02, 0.05], [0.03] * 3, [np.nan] * 3]
    np.testing.assert_array_equal(found.sigma_enu_m, sigma)


@pytest.mark.parametrize(("crs", "first"), [("EPSG:4326", "41.5,31.25"), ("EPSG:5254", "4580000.25,400000.5")])
def test_pix4d_takes_the_order_of_the_crs_definition(tmp_path: Path, crs: str, first: str) -> None:
    north, east = map(float, first.split(","))
    found = read(tmp_path, "pix4d", f"a,{first},10\n", crs=crs)
    np.testing.assert_array_equal(found.coordinates, [[east, north, 10.0]])


@pytest.mark.parametrize(
    "crs", ["EPSG:32636", "WGS84 UTM 36N", "+proj=utm +zone=36 +datum=WGS84 +units=m +no_defs", "epsg:32636"]
)
def test_odm_with_each_way_to_name_the_crs(tmp_path: Path, crs: str) -> None:
    found = read(tmp_path, "odm", ODM.format(crs=crs))
    assert found.crs == "EPSG:32636" and found.ids == ("01", "1")
    expected = [[400000.5, 4580000.25, 120.5], [401000.0, 4581000.0, np.nan]]
    np.testing.assert_array_equal(found.coordinates, expected)
    assert_pixels(found)
    o = found.observed
    assert np.stack([o.line, o.sample], axis=1)[o.point == 1].tolist() == [[20.0, 10.0], [40.0, 30.0]]


def test_odm_without_its_first_line_keeps_every_point_and_asks_for_the_crs(tmp_path: Path) -> None:
    headless = ODM.partition("\n")[2]
    whole, found = (
        read(tmp_path, "odm", ODM.format(crs="EPSG:32636")),
        read(tmp_path, "odm", headless, crs="EPSG:32636"),
    )
    assert found.ids == whole.ids
    np.testing.assert_array_equal(found.coordinates, whole.coordinates)
    np.testing.assert_array_equal(found.observed.line, whole.observed.line)
    with pytest.raises(InputError, match="does not state its CRS"):
        read(tmp_path, "odm", headless)


def bound(shift: str) -> str:
    """Return the UTM zone 36 as Metashape writes it: with a shift to WGS84, and its own name of the datum."""
    datum = f'DATUM["World Geodetic System 1984",SPHEROID["WGS 84",6378137,298.257223563],TOWGS84[{shift}]]'
    text = re.sub(r'DATUM\["WGS_1984",SPHEROID\[[^]]*\[[^]]*\]\],AUTHORITY\["EPSG","6326"\]\]', datum, UTM)
    assert "TOWGS84" in text
    return text


def test_crs_with_a_shift_of_zero_is_that_without_it_and_no_other_shift_is(tmp_path: Path) -> None:
    found = read(tmp_path, "metashape-csv", METASHAPE_CSV.replace(UTM, bound("0,0,0,0,0,0,0")))
    assert found.crs == "EPSG:32636"
    for shift in ("0,0,5,0,0,0,0", "0,0,0,0,0,0,2"):
        with pytest.raises(InputError, match="no EPSG code"):
            read(tmp_path, "metashape-csv", METASHAPE_CSV.replace(UTM, bound(shift)))
    with pytest.raises(InputError, match="not the one given"):
        read(tmp_path, "metashape-csv", METASHAPE_CSV.replace(UTM, bound("0,0,0,0,0,0,0")), crs="EPSG:32635")


@pytest.mark.parametrize("ellipsoid", ["intl", "GRS80", "WGS84"])
def test_ellipsoid_alone_is_no_datum(tmp_path: Path, ellipsoid: str) -> None:
    # PROJ finds Ain el Abd / UTM zone 36N, BGS2005 / UTM zone 36N, WGS 84 / TMzn36N equal, datum aside.
    with pytest.raises(InputError, match="no EPSG code"):
        read(tmp_path, "odm", ODM.format(crs=f"+proj=utm +zone=36 +ellps={ellipsoid} +units=m +no_defs"))


@pytest.mark.parametrize("older", [False, True])
def test_qgis_points(tmp_path: Path, older: bool) -> None:
    text = QGIS.replace("source", "pixel").replace(",dX,dY,residual", "") if older else QGIS
    text = text.replace(",0.1,0.2,0.3", "").replace(",0,0,0,0", ",0") if older else text
    found = read(tmp_path, "qgis-points", text, image="scene.tif")
    assert found.crs == "EPSG:32636" and found.ids == ("1", "2") and found.images == ("scene.tif",)
    assert found.roles == (Role.CONTROL, Role.CHECK)
    expected = [[400000.5, 4580000.25, np.nan], [401000.0, 4581000.0, np.nan]]
    np.testing.assert_array_equal(found.coordinates, expected)
    np.testing.assert_array_equal(found.observed.line, [1034.25, 0.0])
    np.testing.assert_array_equal(found.observed.sample, [512.0, 0.0])


def test_qgis_points_are_those_of_the_image_that_the_file_is_named_after(tmp_path: Path) -> None:
    assert read(tmp_path, "qgis-points", QGIS).images == ("0",)


def test_geojson(tmp_path: Path) -> None:
    found = read(tmp_path, "geojson", GEOJSON)
    assert found.crs == "EPSG:4979" and found.ids == ("01", "7", "t1")
    assert found.roles == (Role.CONTROL, Role.CONTROL, Role.TIE)
    expected = [[31.25, 41.5, 120.5], [31.75, 41.6, np.nan], [np.nan] * 3]
    np.testing.assert_array_equal(found.coordinates, expected)
    np.testing.assert_array_equal(found.sigma_enu_m[0], [0.02, 0.03, 0.05])
