"""Faults in points, observations and project files give one line with file, place, value, remedy.

Every case spoils one thing in a valid project. The error must hold exactly one problem,
with the expected code, place and value; nothing but the valid project may pass.
"""

from __future__ import annotations

from pathlib import Path

import pyproj
import pytest

from fg_orient.formats.faults import did_you_mean
from fg_orient.formats.project import checked_project, read_project
from fg_orient.model.errors import Finding, InputError
from tests.support.command import in_process
from tests.support.project_folder import ProjectFolder, install_stand_in

pytestmark = pytest.mark.behaviour

HEADER = "id,role,lon_deg,lat_deg,height_m,sigma_east_m,sigma_north_m,sigma_up_m"
P1 = "01,control,31.60,41.20,12.5,0.06,0.06,1.0"
TIE = "t1,tie,,,,,,"
O1 = "left,01,1000,1200,0.3,0.3\n"
P, OBS, T = "points.csv", "observations.csv", "project.toml"

# name: (file, old, new, code, part of the place, part of the value)
CASES = {
    # points: cells
    "nan coordinate": (P, "12.5", "nan", "table.not_a_number", "line 3, column height_m", "'nan'"),
    "inf coordinate": (P, "12.5", "inf", "table.not_a_number", "line 3, column height_m", "'inf'"),
    "1e400": (P, "12.5", "1e400", "table.number_too_large", "line 3, column height_m", "1e400"),
    "decimal comma in quotes": (P, "12.5", '"12,5"', "table.decimal_comma", "line 3, column height_m", "12,5"),
    "decimal comma": (P, "12.5", "12,5", "table.cell_count", "line 3", "9 cells"),
    "text": (P, "12.5", "high", "table.not_a_number", "line 3, column height_m", "high"),
    "empty coordinate": (P, "12.5", "", "table.cell_empty", "line 3, column height_m", "''"),
    "no coordinates": (P, "31.60,41.20,12.5", ",,", "points.no_coordinates", "line 3", "01"),
    "short line": (P, P1, "01,control,31.60", "table.cell_count", "line 3", "3 cells"),
    "sigma zero": (P, "0.06,0.07", "0.06,0", "points.sigma_not_positive", "line 4, column sigma_north_m", "0"),
    "sigma negative": (P, "0.06,0.07", "0.06,-1", "points.sigma_not_positive", "line 4, column sigma_north_m", "-1"),
    "sigma nan": (P, "0.06,0.07", "0.06,NaN", "table.not_a_number", "line 4, column sigma_north_m", "NaN"),
    "sigma empty": (P, "0.06,0.07", "0.06,", "table.cell_empty", "line 4, column sigma_north_m", "''"),
    "sigma inf": (P, "0.06,0.07", "0.06,inf", "table.not_a_number", "line 4, column sigma_north_m", "inf"),
    "fixed in part": (P, "fixed,fixed,fixed", "fixed,fixed,1", "points.fixed_partly", "line 5, column sigma_up_m", "1"),
    "fixed check point": (
        P, "640.0,0.10,0.10,0.5", "640.0,fixed,fixed,fixed", "points.fixed_check", "line 7", "k1"),
    "duplicate id": (P, "c4,control", "c3,control", "points.id_twice", "line 6, column id", "c3"),
    "empty id": (P, TIE, TIE + "\n,tie,,,,,,", "points.id_missing", "line 10, column id", ""),
    "unknown role": (P, "c4,control", "c4,gcp", "points.role", "line 6, column role", "gcp"),
    "tie with coordinates": (P, TIE, "t1,tie,31.7,41.3,5,,,", "points.tie_coordinates", "line 9", "31.7"),
    "latitude": (P, "31.60,41.20", "131.60,91.20", "points.latitude", "line 3, column lat_deg", "91.20"),
    "longitude": (P, "31.60,41.20", "191.60,41.20", "points.longitude", "line 3, column lon_deg", "191.60"),
    "swapped, by range": (P, "31.60,41.20", "41.20,131.60", "points.swapped_range", "line 3, column lat_deg", "131.60"),
    "swapped, by footprint": (P, "31.60,41.20", "41.20,31.60", "points.swapped", "line 3", "41.2 31.6"),
    "far away": (P, "31.60,41.20", "-31.60,41.20", "points.far", "line 3", "-31.6 41.2 12.5"),
    # points: table
    "semicolons": (P, HEADER, HEADER.replace(",", ";"), "table.delimiter", "line 2", "id;role"),
    "misspelt column": (P, "height_m", "heigth_m", "table.column_unknown", "line 2", "heigth_m"),
    "column twice": (P, HEADER, HEADER + ",id", "table.column_twice", "line 2", "id"),
    "foreign column": (P, HEADER, HEADER + ",x_m", "table.column_foreign", "line 2", "x_m"),
    "columns of another crs": (
        P, "lon_deg,lat_deg", "easting_m,northing_m", "points.crs_columns", "header", "easting_m, northing_m"),
    "quotes": (P, "k1,check", '"k1,check', "table.quotes", "line 7", ""),
    "sigma along x y z": (
        P, HEADER, "id,role,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m", "points.crs_columns", "header", "x_m"),
    # observations
    "unknown image": (OBS, O1, O1.replace("left", "lft"), "observations.image_unknown", "line 2, column image", "lft"),
    "unknown point": (OBS, O1, O1.replace("01", "001"), "observations.point_unknown", "line 2, column id", "001"),
    "measured twice": (OBS, O1, O1 + O1, "observations.twice", "line 3", "01 in left"),
    "line outside": (OBS, O1, O1.replace("1000", "11999.6"), "observations.outside", "line 2, column line", "11999.6"),
    "sample outside": (OBS, O1, O1.replace("1200", "-0.51"), "observations.outside", "line 2, column sample", "-0.51"),
    "pixel nan": (OBS, O1, O1.replace("1000", "nan"), "table.not_a_number", "line 2, column line", "nan"),
    "pixel sigma zero": (
        OBS, "left,01,1000,1200,0.3,0.3", "left,01,1000,1200,0.3,0",
        "observations.sigma_not_positive", "line 2, column sigma_sample_px", "0"),
    "pixel sigma negative": (
        OBS, "left,01,1000,1200,0.3,0.3", "left,01,1000,1200,-1,1",
        "observations.sigma_not_positive", "line 2, column sigma_line_px", "-1"),
    "seen once, tie": (
        OBS, "right,t1,7000,2100,0.3,0.3\n", "", "observations.seen_once", "column id", "t1 (image left)"),
    "seen once, check": (
        OBS, "left,k2,6000,6300,0.3,0.3\n", "", "observations.seen_once", "column id", "k2 (image right)"),
    # project
    "syntax": (T, 'name = "small"', "name = small", "project.syntax", "line 2", ""),
    "schema": (T, "schema = 1", "schema = 2", "project.schema", "schema", "2"),
    "schema missing": (T, "schema = 1", "", "project.missing", "schema", ""),
    "metadata missing": (T, 'metadata = "left.DIM"', "", "project.missing", "images[1].metadata", ""),
    "no such metadata": (T, "right.DIM", "wrong.DIM", "project.missing_file", "images[2].metadata", "wrong.DIM"),
    "image twice": (T, 'id = "right"', 'id = "left"', "project.image_twice", "images[2].id", "left"),
    "unknown key": (T, "eop_set = 15", "eopset = 15", "project.unknown_key", "orientation.eopset", "15"),
    "unknown table": (T, "[adjustment]", "[adjustments]", "project.unknown_key", "adjustments", "max_iterations"),
    "unknown crs": (T, "EPSG:4979", "EPSG:499979", "geodesy.unknown_crs", "points.crs", "EPSG:499979"),
    "crs by name": (T, "EPSG:4979", "WGS84", "geodesy.not_epsg", "points.crs", "WGS84"),
    "crs without position": (T, "EPSG:4979", "EPSG:5773", "geodesy.not_spatial", "points.crs", "EGM96"),
    "geoid without grid": (T, "EPSG:4979", "EPSG:9518", "geodesy.no_operation", "crs", "EPSG:9518"),
    "eop set": (T, "eop_set = 15", "eop_set = 21", "parameters.eop_set", "orientation.eop_set", "21"),
    "eop set name": (T, "eop_set = 15", 'eop_set = "PUB"', "parameters.eop_set", "orientation.eop_set", "PUB"),
    "eop set type": (T, "eop_set = 15", "eop_set = true", "project.value", "orientation.eop_set", "True"),
    "iterations": (T, "max_iterations = 50", "max_iterations = 0", "project.value", "adjustment.max_iterations", "0"),
    "fraction": (T, "max_iterations = 50", "max_iterations = 2.5", "project.value", "adjustment.max_iterations", "2.5"),
    "prior nan": (T, "eop_set = 15", "look_sigma_rad = nan", "project.value", "orientation.look_sigma_rad", "nan"),
    "prior zero": (
        T, "eop_set = 15", "position_sigma_m = [10, 0, 1]", "project.value", "orientation.position_sigma_m[2]", "0"),
    "two sigmas": (
        T, "eop_set = 15", "position_sigma_m = [1, 2]", "project.missing", "orientation.position_sigma_m", ""),
    "no such backend": (T, "[adjustment]", '[adjustment]\nbackend = "x"', "project.value", "adjustment.backend", "x"),
    "text for a switch": (T, "eop_set = 15", 'priors = "no"', "project.value", "orientation.priors", "no"),
    "points file missing": (T, "points.csv", "pts.csv", "table.missing_file", "", ""),
}  # fmt: skip


def refused(folder: ProjectFolder) -> tuple[Finding, ...]:
    """Return the problems of the project; the same from reading and from validating, one printable line each."""
    with pytest.raises(InputError) as caught:
        read_project(folder.project)
    found = caught.value.problems
    assert caught.value.exit_code == 2
    assert checked_project(folder.project)[1] == list(found)
    assert len(str(caught.value).splitlines()) == len(found)
    for p in found:
        assert p.file and p.message and p.remedy and p.remedy in str(p).replace("  ", " ")
        assert "{" not in p.message + p.remedy
        assert Path(p.file).parent == folder.folder
    return found


def test_the_unspoilt_project_is_fine(folder):
    assert len(read_project(folder.project).observations) == 14


@pytest.mark.parametrize("name", CASES)
def test_one_fault_gives_one_line(folder, name):
    file, old, new, code, place, value = CASES[name]
    folder.change(file, old, new)
    found = refused(folder)
    assert [p.code for p in found] == [code], [str(p) for p in found]
    assert place in found[0].place and value in found[0].value, str(found[0])
    expected = {"points file missing": "pts.csv"}.get(name, file)
    assert Path(found[0].file).name == expected or code == "geodesy.no_operation"


def swap_all(folder):
    lines = folder.points.read_text().splitlines()
    for k, line in enumerate(lines[2:-1], start=2):
        cells = line.split(",")
        cells[2], cells[3] = cells[3], cells[2]
        lines[k] = ",".join(cells)
    folder.points.write_text("\n".join(lines))


def swap_easting_and_northing(folder):
    """Exchange easting and northing, in a table of a CRS that puts easting first."""
    to_plane = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32636", always_xy=True)
    east, north = to_plane.transform([31.60, 32.05], [41.20, 41.22])
    rows = [f"{n},control,{b},{a},100,1,1,1\n" for n, a, b in zip(("01", "1"), east, north, strict=True)]
    rest = "".join(f"{n},tie,,,,,,\n" for n in ("c3", "c4", "k1", "k2", "t1"))
    folder.points.write_text(HEADER.replace("lon_deg,lat_deg", "easting_m,northing_m") + "\n" + "".join(rows) + rest)
    folder.change(T, "EPSG:4979", "EPSG:32636")


def in_zone(folder, coordinates, stated):
    """Write the points with known coordinates in a CRS, and state a CRS in the project file."""
    to_plane = pyproj.Transformer.from_crs("EPSG:4326", coordinates, always_xy=True)
    lines = [line.split(",") for line in folder.points.read_text().splitlines()[2:]]
    rows = []
    for cells in lines:
        if cells[2]:
            cells[2:4] = [f"{one:.3f}" for one in to_plane.transform(float(cells[2]), float(cells[3]))]
        rows.append(",".join(cells))
    folder.points.write_text("\n".join([HEADER.replace("lon_deg,lat_deg", "easting_m,northing_m"), *rows]) + "\n")
    folder.change(T, "EPSG:4979", stated)


def wrong_zone(folder):
    in_zone(folder, "EPSG:32636", "EPSG:32635")


def wrong_zone_on_another_datum(folder):
    in_zone(folder, "EPSG:23036", "EPSG:23037")


def no_zone_fits(folder):
    text = folder.points.read_text()
    for lon in ("31.60", "32.05", "31.62", "32.00", "31.80", "31.85"):
        text = text.replace(f"{lon},41", f"{lon},51")
    folder.points.write_text(text)


def heights_above_a_geoid_without_grid(folder):
    folder.change(T, "EPSG:4979", "EPSG:4326+EGM96")


def sigmas_along_the_axes(folder):
    rows = "01,control,4078323.8,2515180.6,4195881.4,1,1,1\n"
    folder.points.write_text("id,role,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n" + rows)
    folder.change(T, "EPSG:4979", "EPSG:4978")


def outside_the_projection(folder):
    header = HEADER.replace("lon_deg,lat_deg", "easting_m,northing_m")
    folder.points.write_text(header + "\n01,control,1e11,1,1,1,1,1\n")
    folder.observations.write_text("image,id,line,sample,sigma_line_px,sigma_sample_px\nleft,01,1,1,1,1\n")
    folder.change(T, "EPSG:4979", "EPSG:32636")


def no_control(folder):
    text = folder.points.read_text().replace("control", "check").replace("fixed,fixed,fixed", "1,1,1")
    folder.points.write_text(text)


def unmeasured_control(folder):
    text = folder.observations.read_text().splitlines(keepends=True)
    names = (",01,", ",1,", ",c3,", ",c4,")
    folder.observations.write_text("".join(line for line in text if not any(n in line for n in names)))


def image_without_points(folder):
    folder.change(T, "[points]", '[[images]]\nid = "third"\nmetadata = "left.DIM"\n\n[points]')


def seen_once(folder):
    rows = [line for line in folder.observations.read_text().splitlines() if not line.startswith(("right,t", "left,k"))]
    folder.observations.write_text("\n".join(rows))


def folder_in_place_of_a_file(folder):
    folder.points.unlink()
    folder.points.mkdir()


#: Faults of several lines: code, and parts of place, value, message and remedy.
SPOILT = [
    (swap_all, "points.swapped", {"message": "6 of 6", "remedy": "exchange"}),
    (swap_easting_and_northing, "points.swapped", {"message": "easting_m and northing_m"}),
    (wrong_zone, "points.other_zone", {
        "value": "EPSG:32635", "message": "EPSG:32636 (WGS 84 / UTM zone 36N) 6 of 6", "remedy": "EPSG:32636"}),
    (wrong_zone_on_another_datum, "points.other_zone", {"message": "EPSG:23036 (ED50 / UTM zone 36N) 6 of 6"}),
    (no_zone_fits, "points.far_most", {"place": "line 3", "message": "6 of 6 points are far from all images"}),
    (heights_above_a_geoid_without_grid, "geodesy.no_operation", {"remedy": "give geoid under [points] a file"}),
    (sigmas_along_the_axes, "points.sigma_axes", {"remedy": "sigma_east_m"}),
    (outside_the_projection, "geodesy.outside", {"place": "line 2", "value": "1e+11 1 1"}),
    (no_control, "block.no_control", {"file": P}),
    (unmeasured_control, "block.no_control", {"value": "4 control points in the file, 0 measured"}),
    (image_without_points, "observations.image_unused", {"value": "third"}),
    (seen_once, "observations.seen_once", {
        "value": "k1 (image right), k2 (image right), t1 (image left)", "remedy": "points_seen_once",
        "message": "3 check or tie"}),
    (folder_in_place_of_a_file, "table.unreadable", {}),
]  # fmt: skip


@pytest.mark.parametrize(("spoil", "code", "said"), SPOILT, ids=[spoil.__name__ for spoil, _, _ in SPOILT])
def test_what_is_spoilt_in_many_lines_is_one_fault(folder, spoil, code, said):
    spoil(folder)
    (found,) = refused(folder)
    assert found.code == code
    for name, part in said.items():
        assert part in getattr(found, name), name


def test_the_right_zone_is_not_refused(folder):
    in_zone(folder, "EPSG:32636", "EPSG:32636")
    assert len(read_project(folder.project).observations) == 14


def images_of_size(monkeypatch, n_lines, n_samples):
    install_stand_in(monkeypatch, n_lines=n_lines, n_samples=n_samples)


def test_exchange_of_line_and_sample_is_one_fault_for_all_pixels_outside(folder, monkeypatch):
    images_of_size(monkeypatch, 12000, 10000)  # two samples of each image are above 10000; all lines are below
    (found,) = refused(folder)
    assert found.code == "observations.exchanged"
    assert found.place == "line 4" and "4 of 14 image points are outside left, right" in found.message
    assert "exchange line and sample" in found.remedy


def test_pixels_outside_that_an_exchange_does_not_put_inside_are_listed(folder, monkeypatch):
    images_of_size(monkeypatch, 11000, 10000)  # sample 11000.25 is outside as a line, too
    assert {p.code for p in refused(folder)} == {"observations.outside"}
    images_of_size(monkeypatch, 12000, 10900)  # one pixel of each image is outside, which may be a wrong digit
    assert [p.code for p in refused(folder)] == ["observations.outside"] * 2


@pytest.mark.parametrize(("name", "code"), [("", "project.folder"), ("nowhere.toml", "project.missing_file")])
def test_project_file_that_is_none(tmp_path, name, code):
    with pytest.raises(InputError) as caught:
        read_project(tmp_path / name)
    (found,) = caught.value.problems
    assert found.code == code and found.file.endswith(name) and found.remedy


def test_faults_of_all_files_come_together(folder):
    folder.change(T, "right.DIM", "wrong.DIM")
    folder.change(T, "eop_set = 15", "eop_set = 99")
    folder.change(P, "12.5", "nan")
    folder.change(P, "250.0", "high")
    folder.change(OBS, O1, O1.replace("1000", "99999"))
    assert [p.code for p in refused(folder)] == [
        "parameters.eop_set",
        "project.missing_file",
        "table.not_a_number",
        "table.not_a_number",
        "observations.outside",
    ]


@pytest.mark.parametrize(("word", "known", "meant"), [
    ("1", ("41", "01", "11"), "01"), ("p-007", ("P7", "P70", "p_7a"), "P7"), ("010", ("10", "100"), "10"),
    ("G31", ("G13", "G32"), "G32"), ("0", ("00", "10"), "00"),
])  # fmt: skip
def test_an_id_in_another_form_is_suggested_first(word, known, meant):
    assert did_you_mean(word, known) == f"did you mean {meant}?"


def test_a_missing_column_is_named_with_those_found(folder):
    text = folder.points.read_text().replace(",sigma_up_m", "").replace(",1.0\n", "\n")
    folder.points.write_text(
        text.replace(",fixed\n", "\n").replace(",0.5\n", "\n").replace("t1,tie,,,,,,", "t1,tie,,,,,")
    )
    (found,) = refused(folder)
    assert found.message == "column sigma_up_m is missing"
    assert found.value == HEADER.removesuffix(",sigma_up_m").replace(",", ", ")


def test_suggestions(folder):
    folder.change(OBS, O1, O1.replace("left", "lft"))
    folder.change(P, "height_m", "hight_m")
    folder.change(T, "eop_set = 15", "eopset = 15")
    with pytest.raises(InputError) as caught:
        read_project(folder.project)
    assert "did you mean eop_set?" in str(caught.value)
    folder.change(T, "eopset = 15", "eop_set = 15")
    with pytest.raises(InputError) as caught:
        read_project(folder.project)
    assert "did you mean left?" in str(caught.value) and "did you mean height_m?" in str(caught.value)


@pytest.mark.parametrize(
    ("file", "data", "code", "place"),
    [
        (P, "id,role\n".encode("utf-16"), "table.utf16", "line 1"),
        (P, f"{HEADER}\nGözen,tie,,,,,,\n".encode("latin-1"), "table.not_utf8", "line 2"),
        (P, f"{HEADER}\na,tie,\0,,,,,\n".encode(), "table.nul", "line 2"),
        (P, b"", "table.empty", "line 1"),
        (P, b"# nothing\n\n", "table.empty", "line 1"),
        (OBS, b"image,id,line,sample,sigma_line_px,sigma_sample_px\n", "table.no_records", "line 1"),
        (P, b"<html><body>404 Not Found</body></html>", "table.column_unknown", "line 1"),
        (P, (HEADER + "\n" + "a" * 200_000).encode(), "table.long_line", "line 2"),
        (T, b"name = \"\xe7\"", "project.encoding", "line 1"),
        (T, b"", "project.missing", "schema"),
    ],
)  # fmt: skip
def test_files_that_are_not_tables(folder, file, data, code, place):
    (folder.folder / file).write_bytes(data)
    found = refused(folder)
    assert found[0].code == code and found[0].place == place


@pytest.mark.parametrize("command", ["adjust", "validate", "compare", "reduce"])
def test_folder_in_place_of_the_project_file_names_the_file_in_it(command, tmp_path):
    ended = in_process(command, tmp_path)
    assert (ended.code, ended.stderr.count("\n")) == (2, 1)
    assert f"{tmp_path}: this is a folder" in ended.stderr and "project.toml" in ended.stderr
    (tmp_path / "block.toml").write_text("")
    assert f"such as {tmp_path / 'block.toml'}" in in_process(command, tmp_path).stderr


def test_bad_metadata_is_reported_with_the_other_faults(folder, monkeypatch):
    import fg_orient.formats.sensor

    def refuse(path, **options):
        raise InputError.of("xml.missing_file", file=path, base="x")

    monkeypatch.setattr(fg_orient.formats.sensor, "read_sensor", refuse)
    folder.change(P, "12.5", "nan")
    assert [p.code for p in refused(folder)] == ["xml.missing_file", "xml.missing_file", "table.not_a_number"]


def test_nothing_is_left_behind(folder):
    """Reading a project that is refused writes no file."""
    before = sorted(p.name for p in folder.folder.iterdir())
    folder.change(P, "12.5", "nan")
    refused(folder)
    assert sorted(p.name for p in folder.folder.iterdir()) == before
