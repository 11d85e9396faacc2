"""The tests follow a project file to the block: roles, sealed coordinates, options, provenance and notes."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import pyproj
import pytest

from fg_orient import geodesy
from fg_orient.formats.faults import Faults
from fg_orient.formats.points import read_points
from fg_orient.formats.points_write import write_points
from fg_orient.formats.project import checked_project, read_project
from fg_orient.formats.schema import Adjustment, Orientation
from fg_orient.model.block import Options
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from tests.support.pleiades_project import pleiades_project


@pytest.mark.behaviour
def test_block_of_a_small_project(folder):
    block = read_project(folder.project)
    assert block.name == "small" and [image.id for image in block.images] == ["left", "right"]
    assert block.points.ids == ("01", "1", "c3", "c4", "k1", "k2", "t1")  # 01 and 1 are two points
    assert block.points.roles == (Role.CONTROL,) * 4 + (Role.CHECK,) * 2 + (Role.TIE,)
    assert len(block.observations) == 14
    o = block.observations
    row = int(np.flatnonzero((o.image == 1) & (o.point == 3))[0])
    assert (o.line[row], o.sample[row], o.sigma_line_px[row]) == (9200.0, 11000.25, 0.3)


@pytest.mark.behaviour
def test_only_control_is_known_and_fixed_means_no_sigma(folder):
    known = read_project(folder.project).points.known
    expected = geodesy.geodetic_to_ecef(
        [31.60, 32.05, 31.62, 32.00], [41.20, 41.22, 41.45, 41.44], [12.5, 250, 830, 1500]
    )
    np.testing.assert_array_equal(known.ecef_m[:4], expected)
    assert np.isnan(known.ecef_m[4:]).all() and np.isnan(known.sigma_enu_m[4:]).all()
    assert known.fixed.tolist() == [False, False, True, False, False, False, False]
    assert np.isnan(known.sigma_enu_m[2]).all()
    np.testing.assert_array_equal(known.sigma_enu_m[1], [0.06, 0.07, 1.0])


@pytest.mark.behaviour
def test_check_coordinates_come_out_only_when_opened(folder):
    block = read_project(folder.project)
    assert block.withheld.ids == ("k1", "k2")
    opened = block.withheld.open()
    np.testing.assert_array_equal(opened.ecef_m, geodesy.geodetic_to_ecef([31.80, 31.85], [41.30, 41.35], [640, 700]))
    np.testing.assert_array_equal(opened.sigma_enu_m, [[0.1, 0.1, 0.5]] * 2)


@pytest.mark.behaviour
def test_check_coordinates_change_nothing_else_in_the_block(folder):
    before = read_project(folder.project)
    there = before.withheld.open().ecef_m
    folder.change("points.csv", "k1,check,31.80,41.30,640.0", "k1,check,31.81,41.31,1640.0")
    after = read_project(folder.project)
    np.testing.assert_array_equal(before.points.known.ecef_m, after.points.known.ecef_m)
    np.testing.assert_array_equal(before.observations.line, after.observations.line)
    moved = np.linalg.norm(after.withheld.open().ecef_m - there, axis=1)
    assert moved[0] > 1000.0 and moved[1] == 0.0


@pytest.mark.behaviour
def test_opening_after_the_file_changed_is_refused(folder):
    block = read_project(folder.project)
    folder.change("points.csv", "640.0", "641.0")
    with pytest.raises(InputError) as caught:
        block.withheld.open()
    assert caught.value.problems[0].code == "points.changed"


@pytest.mark.behaviour
def test_sources_carry_the_digests_of_all_files(folder):
    block = read_project(folder.project)
    files = [
        folder.project,
        folder.folder / "left.DIM",
        folder.folder / "right.DIM",
        folder.points,
        folder.observations,
    ]
    assert [s.path for s in block.sources] == [str(f) for f in files]
    assert [s.sha256 for s in block.sources] == [hashlib.sha256(f.read_bytes()).hexdigest() for f in files]


@pytest.mark.behaviour
def test_defaults_of_the_file_are_those_of_the_options():
    options = Options()
    stated = {**dict(Orientation()), **dict(Adjustment())}
    reading = {"points_seen_once": "error", "extrapolate_attitude_s": 0.0, "light": ()}
    assert {name: stated.pop(name) for name in reading} == reading
    assert stated == dataclasses.asdict(options)


@pytest.mark.behaviour
def test_options_of_the_file_and_overrides(folder):
    folder.change(
        "project.toml", "eop_set = 15", 'eop_set = "A0"\nlook_polynomial = 2\nlook_sigma_rad = 1\npriors = false'
    )
    block = read_project(folder.project)
    assert (block.options.eop_set, block.options.look_polynomial, block.options.priors) == (10, 2, False)
    assert block.options.look_sigma_rad == 1.0
    other = read_project(folder.project, eop_set=1, check_points="exclude", max_iterations=None)
    assert (other.options.eop_set, other.options.check_points, other.options.max_iterations) == (1, "exclude", 50)
    with pytest.raises(TypeError, match="eopset"):
        read_project(folder.project, eopset=1)
    for name, value in (("eop_set", 21), ("look_polynomial", 6), ("position_sigma_m", (1.0, -1.0, 1.0))):
        with pytest.raises(InputError) as caught:
            read_project(folder.project, **{name: value})
        (found,) = caught.value.problems
        assert found.file == "" and found.option == name, "the option is to blame, not the file"


@pytest.mark.behaviour
def test_paths_are_relative_to_the_project_file(folder, monkeypatch, tmp_path_factory):
    """Check coordinates are also found after a change of the folder."""
    monkeypatch.chdir(folder.project.parent)
    block = read_project(folder.project.name)
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert block.withheld.open().ecef_m.shape == (2, 3)
    assert len(read_project(folder.project).images) == 2


@pytest.mark.behaviour
def test_unmeasured_points_are_left_out_with_a_remark(folder):
    folder.change("points.csv", "k2,check", "x9,check,31.9,41.3,5,1,1,1\nx8,control,31.9,41.3,5,1,1,1\nk2,check")
    block = read_project(folder.project)
    assert "x9" not in block.points.ids and "x8" not in block.points.ids
    assert block.withheld.ids == ("k1", "k2") and block.withheld.open().ecef_m.shape == (2, 3)
    assert any("x9, x8" in str(note) for note in block.notes)


@pytest.mark.behaviour
def test_points_seen_once_are_dropped_on_request(folder):
    folder.change("observations.csv", "right,t1,7000,2100,0.3,0.3\n", "")
    folder.change("observations.csv", "left,01,1000,1200,0.3,0.3\n", "")  # control may have a single ray
    folder.change("project.toml", "max_iterations", 'points_seen_once = "drop"\nmax_iterations')
    block = read_project(folder.project)
    assert block.points.ids == ("01", "1", "c3", "c4", "k1", "k2") and len(block.observations) == 11
    assert block.points.ids[block.observations.point[-1]] == "k2"
    assert any("single ray" in str(note) and "t1" in str(note) for note in block.notes)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("crs", "names", "kind"),
    [
        ("EPSG:32636", "easting_m,northing_m,height_m", "projected"),
        ("EPSG:4978", "x_m,y_m,z_m", "geocentric"),
    ],
)
def test_the_same_points_in_another_crs(folder, crs, names, kind):
    """Points of a project in a projected or geocentric CRS have the ECEF coordinates of PROJ within 1 um.

    The block notes CRS and accuracy.
    """
    degrees = np.array([[31.60, 41.20, 12.5], [32.05, 41.22, 250.0], [31.62, 41.45, 830.0], [32.00, 41.44, 1500.0]])
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    expected = np.stack(to_ecef.transform(*degrees.T), axis=1)
    values = expected
    if kind == "projected":
        to_plane = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
        values = np.stack([*to_plane.transform(*degrees[:, :2].T), degrees[:, 2]], axis=1)
    header = f"id,role,{names},sigma_east_m,sigma_north_m,sigma_up_m\n"
    rows = [
        f"{n},control,{','.join(map(repr, map(float, v)))},1,1,1\n"
        for n, v in zip(("01", "1", "c3", "c4"), values, strict=True)
    ]
    folder.points.write_text(header + "".join(rows) + "k1,tie,,,,,,\nk2,tie,,,,,,\nt1,tie,,,,,,\n", encoding="utf-8")
    folder.change("project.toml", "EPSG:4979", crs)
    block = read_project(folder.project)
    # 1 um: PROJ's transverse Mercator, there and back
    np.testing.assert_allclose(block.points.known.ecef_m[:4], expected, rtol=0, atol=1e-6)
    assert any(crs in str(note) and "accuracy" in str(note) for note in block.notes)


# --- validation ----------------------------------------------------------------------------------


def codes(folder) -> list[str]:
    found = checked_project(folder.project)[1]
    assert all(p.severity == "note" for p in found)
    return [p.code for p in found]


@pytest.mark.behaviour
def test_remarks_on_a_small_block(folder):
    assert codes(folder) == ["remark.few_control", "remark.few_check"]
    notes = read_project(folder.project).notes
    assert any("only 4 control" in str(note) for note in notes)
    assert not any("check points" in str(note) for note in notes), "the adjustment warns of that itself"


@pytest.mark.behaviour
def test_remark_on_control_along_a_line(folder):
    """Four control points within 300 m of a line give a remark that states their number."""
    text = folder.points.read_text()
    for old, new in (("31.60,41.20", "31.60,41.20"), ("32.05,41.22", "31.70,41.28"), ("31.62,41.45", "31.80,41.36"),
                     ("32.00,41.44", "31.90,41.443")):  # fmt: skip
        text = text.replace(old, new)
    folder.points.write_text(text)
    found = {p.code: p for p in checked_project(folder.project)[1]}
    assert "remark.control_line" in found and "4 control" in found["remark.control_line"].value


@pytest.mark.behaviour
def test_remark_on_clustered_control_and_on_one_image(folder):
    text = folder.observations.read_text()
    rows = [line for line in text.splitlines() if not line.startswith(("right,01", "right,1", "right,c3", "right,c4"))]
    pixels = {"9000.5,900": "1500,900", "1100,10800": "1100,1800", "9200,11000.25": "1200,1000.25"}
    text = "\n".join(rows)
    for old, new in pixels.items():
        text = text.replace(old, new)
    folder.observations.write_text(text)
    assert {"remark.control_one_image", "remark.control_clustered"} <= set(codes(folder))


@pytest.mark.behaviour
def test_remarks_on_odd_units_of_sigmas(folder):
    folder.change("points.csv", "0.06,0.07,1.0", "1e-7,0.07,1.0")
    folder.change("observations.csv", "left,01,1000,1200,0.3,0.3", "left,01,1000,1200,1e5,0.3")
    found = {p.code: p for p in checked_project(folder.project)[1]}
    assert "line 4" in found["remark.sigma_ground"].place and "1e-07" in found["remark.sigma_ground"].value
    assert "line 2" in found["remark.sigma_image"].place and "100000" in found["remark.sigma_image"].value


@pytest.mark.behaviour
def test_remark_on_a_better_grid(tmp_path):
    """A remark names the missing grid if PROJ uses a coarser operation.

    OSGB36 has a grid (OSTN15) that does not come with PROJ.
    """
    if not geodesy.to_ecef_with_operation("EPSG:27700", 4e5, 4e5, 10.0)[1].missing_grids:
        pytest.skip("the grid is installed here")
    path = tmp_path / "points.csv"
    write_points(path, ["a"], [Role.CONTROL], np.array([[4e5, 4e5, 10.0]]), np.ones((1, 3)), kind="projected")
    read = read_points(path, "EPSG:27700", Faults(str(path)))
    assert read is not None
    assumed, found = read.remarks
    assert assumed.code == "heights.ellipsoidal"
    assert found.code == "remark.grid_missing" and "OSTN15" in found.remedy and found.value == "EPSG:27700"


@pytest.mark.truth
@pytest.mark.real_data
def test_the_real_pair_is_read_with_its_real_sensors(real_data, tmp_path):
    """The project of the Pléiades pair has 86 points in both images, and their ECEF coordinates are unchanged."""
    project, ecef = pleiades_project(real_data, tmp_path)
    block = read_project(project)
    assert len(block.points.ids) == 86 and len(block.observations) == 172 and len(block.withheld.ids) == 75
    control = block.points.where(Role.CONTROL)
    np.testing.assert_array_equal(block.points.known.ecef_m[control], ecef[control])
    np.testing.assert_array_equal(block.withheld.open().ecef_m, ecef[block.points.where(Role.CHECK)])
    assert block.images[0].sensor.n_samples == 40000


@pytest.mark.behaviour
def test_the_documented_example_is_a_valid_project(folder, repository):
    """The first listings of project, points and image points in docs/file-formats.md form a valid project."""
    listings = (repository / "docs" / "file-formats.md").read_text(encoding="utf-8").split("```")[1::2]
    project, (points, observations) = listings[0], [text for text in listings if text.startswith("text")]
    project, points, observations = (text.partition("\n")[2] for text in (project, points, observations))
    folder.project.write_text(project, encoding="utf-8")
    folder.points.write_text(points, encoding="utf-8")
    rows = "".join(f"{image},{name},10,20,0.3,0.3\n" for name in ("P2", "P3", "T1") for image in ("left", "right"))
    folder.observations.write_text(observations + rows, encoding="utf-8")
    block = read_project(folder.project)
    assert block.points.ids == ("P1", "P2", "P3", "T1") and block.options.look_polynomial == 2


# --- tie points alone, wrong names ---------------------------------------------------------------


@pytest.mark.consistency
@pytest.mark.parametrize("entry", ["", "[points]\n"])
def test_a_project_without_points_has_tie_points_alone(folder, entry):
    """A project without a table of points has the tie points, order and pixels of one with such a table."""
    folder.change("project.toml", "max_iterations = 50", 'max_iterations = 50\ndatum = "priors"')
    header, rows = folder.points.read_text().splitlines()[1], ("01", "1", "c3", "c4", "k1", "k2", "t1")
    folder.points.write_text(f"{header}\n" + "".join(f"{name},tie,,,,,,\n" for name in rows), encoding="utf-8")
    with_table = read_project(folder.project)
    folder.change("project.toml", '[points]\nfile = "points.csv"\ncrs = "EPSG:4979"\n', entry)
    folder.points.unlink()
    alone = read_project(folder.project)
    assert (alone.points.ids, set(alone.points.roles)) == (with_table.points.ids, {Role.TIE})
    assert np.array_equal(alone.observations.point, with_table.observations.point)
    assert np.array_equal(alone.observations.line, with_table.observations.line)
    assert [Path(source.path).name for source in alone.sources].count("observations.csv") == 1


@pytest.mark.behaviour
def test_a_point_table_without_file_or_records(folder):
    folder.change("project.toml", 'file = "points.csv"\n', "")
    assert [(p.code, p.place) for p in checked_project(folder.project)[1]] == [("project.missing", "points.file")]
    folder.change("project.toml", 'crs = "EPSG:4979"', 'crs = "EPSG:4979"\nfile = "points.csv"')
    folder.points.write_text(folder.points.read_text().split("\n01,")[0] + "\n", encoding="utf-8")
    assert [p.code for p in checked_project(folder.project)[1]] == ["table.no_records"]


@pytest.mark.behaviour
def test_a_wrong_name_is_one_error(folder):
    """A wrong image name in seven rows is one error that counts the lines and suggests the right name."""
    text = folder.observations.read_text().replace("right,", "rigth,").replace("left,k2,", "left,k3,")
    folder.observations.write_text(text, encoding="utf-8")
    wrong = {p.value: str(p) for p in checked_project(folder.project)[1]}
    assert set(wrong) == {"'rigth'", "'k3'"}
    assert "no image with this id in 7 lines" in wrong["'rigth'"] and "did you mean right?" in wrong["'rigth'"]
    assert "no point with this id (found" in wrong["'k3'"]
