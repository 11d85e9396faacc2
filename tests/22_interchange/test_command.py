"""The tests run ``fg-orient convert``: exit codes, files, messages, and the same points in several formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.command import in_process

POINTS = """\
# crs: EPSG:32636
id,role,easting_m,northing_m,height_m,sigma_east_m,sigma_north_m,sigma_up_m
01,control,400000.5,4580000.25,120.5,0.02,0.02,0.05
k1,check,401000.0,4581000.0,99.0,0.1,0.2,0.3
t1,tie,,,,,,
"""
OBSERVATIONS = """\
image,id,line,sample,sigma_line_px,sigma_sample_px
left.tif,01,1034.25,512.0,0.3,0.3
left.tif,t1,10.0,20.0,0.3,0.3
right.tif,t1,30.0,40.0,0.3,0.3
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "points.csv").write_text(POINTS, encoding="utf-8")
    (tmp_path / "observations.csv").write_text(OBSERVATIONS, encoding="utf-8")
    return tmp_path


def convert(folder: Path, *words: object):  # type: ignore[no-untyped-def]
    return in_process("convert", folder / "points.csv", folder / "observations.csv", "--from", "csv", *words)


@pytest.mark.behaviour
def test_files_written_and_information_lost_are_said(folder: Path) -> None:
    ended = convert(folder, "--to", "pix4d", "--out", folder / "gcp.csv", "--json")
    assert ended.code == 0
    record = ended.json
    assert record["out"] == [str(folder / "gcp.csv"), str(folder / "gcp_marks.csv")]
    assert {p["code"] for p in record["lost"]} == {
        "lost.crs",
        "lost.roles",
        "lost.sigma_east_north",
        "lost.sigma_image",
    }
    assert (folder / "gcp.csv").read_text().splitlines()[0] == "01,400000.5,4580000.25,120.5,0.02,0.05"
    assert (folder / "gcp_marks.csv").read_text().splitlines()[0] == "left.tif,01,512.5,1034.75"
    said = convert(folder, "--to", "pix4d", "--out", folder / "b.csv", "--out", folder / "c.csv")
    assert said.code == 0 and said.stderr.count("lost: ") == 4 and (folder / "c.csv").exists()
    assert said.stdout.count("written: ") == 2


@pytest.mark.behaviour
def test_nothing_is_overwritten_unless_asked(folder: Path) -> None:
    out = folder / "a.gpkg"
    assert convert(folder, "--out", out).code == 0
    ended = convert(folder, "--out", out)
    assert ended.code == 2 and "--overwrite" in ended.stderr
    assert convert(folder, "--out", out, "--overwrite").code == 0
    # the second file of a pair is looked at, too
    (folder / "x_images.txt").write_text("mine", encoding="utf-8")
    ended = convert(folder, "--to", "micmac", "--out", folder / "x.txt")
    assert ended.code == 2 and not (folder / "x.txt").exists()


@pytest.mark.behaviour
def test_unverified_formats_are_read_on_request_only(folder: Path) -> None:
    assert convert(folder, "--out", folder / "a.xml", "--to", "metashape-xml").code == 0
    words = ["convert", folder / "a.xml", "--from", "metashape-xml", "--to", "csv", "--out", folder / "b.csv",
             "--sigma-image", 0.3, 0.3]  # fmt: skip
    refused = in_process(*words)
    assert refused.code == 2 and "--accept-unverified" in refused.stderr
    ended = in_process(*words, "--accept-unverified")
    assert ended.code == 0 and "remark: " in ended.stderr
    assert (folder / "b.csv").read_text() == POINTS
    assert (folder / "b_observations.csv").read_text() == OBSERVATIONS


@pytest.mark.oracle
def test_points_in_another_crs(folder: Path) -> None:
    ended = convert(folder, "--to-crs", "EPSG:4979", "--to", "csv", "--out", folder / "a.csv")
    assert ended.code == 0 and "coordinates: EPSG:32636 (ellipsoidal height) to EPSG:4978" in ended.stderr
    line = (folder / "a.csv").read_text().splitlines()[2].split(",")
    from pyproj import Transformer  # independent of the package's guards

    lon, lat = Transformer.from_crs(32636, 4326, always_xy=True).transform(400000.5, 4580000.25)
    np.testing.assert_allclose([float(v) for v in line[2:5]], [lon, lat, 120.5], rtol=0, atol=2e-6)
    assert abs(float(line[2]) - lon) < 1e-11 and abs(float(line[3]) - lat) < 1e-11


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "pix5d", "--out", "x"], "did you mean pix4d"),
        (["--to", "pix4d"], "Give IN"),
        (["--out", "x.csv"], "give the format: one of csv, metashape-csv, pix4d"),
        (["--to", "csv", "--out", "x", "--sigma-axes", "xyz"], "ecef or enu"),
        (["--to", "csv", "--out", "x", "--image-size", "left"], "NAME=LINES,SAMPLES"),
        (["--to", "csv", "--out", "x", "--crs", "EPSG:32635"], "not the one given"),
        (["--to", "csv", "--out", "x", "--check", "nobody"], "no point with coordinates"),
        (["--to", "geojson", "--out", "x", "--out", "y"], "not the files of format"),
        (["--to", "dbat", "--out", "x"], "only be read"),
        (["--to", "odm", "--out", "no/such/folder/x"], "cannot be written"),
    ],
)
def test_bad_options_end_with_two(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], message: str
) -> None:
    monkeypatch.chdir(folder)
    ended = convert(folder, *words)
    assert ended.code == 2 and message in ended.stderr, ended.stderr
    assert sorted(p.name for p in folder.iterdir()) == ["observations.csv", "points.csv"]


@pytest.mark.behaviour
def test_formats_are_listed() -> None:
    record = in_process("convert", "--formats", "--json").json
    names = {f["name"]: f["verified"] for f in record["formats"]}
    assert names["csv"] and not names["pix4d"] and not names["qgis-points"]
    assert "metashape-xml" in in_process("convert", "--formats").stdout


@pytest.mark.behaviour
def test_validate_marks_unverified_formats(folder: Path) -> None:
    (folder / "gcp.csv").write_text("01,400000.5,4580000.25,120.5\n", encoding="utf-8")
    words = ["validate", folder / "gcp.csv", "--format", "pix4d"]
    record = in_process(*words, "--crs", "EPSG:32636", "--json").json
    assert [p["code"] for p in record["remarks"]] == ["remark.unverified"] and record["points"] == 1
    ended = in_process(*words, "--crs", "EPSG:32636")
    assert ended.code == 0 and "never tested" in ended.stdout
    assert in_process(*words).code == 2
    own = in_process("validate", folder / "points.csv", "--format", "csv", "--json")
    assert own.json["remarks"] == [] and own.json["crs"] == "EPSG:32636"


@pytest.mark.behaviour
def test_validate_takes_the_files_of_one_survey_together(folder: Path) -> None:
    words = ("validate", folder / "points.csv", folder / "observations.csv", "--format", "csv")
    record = in_process(*words, "--json").json
    alone = in_process(*words[:2], *words[3:], "--json").json
    (both,) = record["files"]
    assert both["image_points"] > 0 == alone["files"][0]["image_points"] and record["points"] == alone["points"]
    assert in_process(*words).stdout == f"{both['points']} points, {both['image_points']} image points, no errors\n"


@pytest.mark.behaviour
def test_validate_takes_several_files_each_for_itself(folder: Path) -> None:
    """``validate`` checks each of several files by itself: a faulty one is named and does not hide the others."""
    for name in ("one", "two"):
        out = folder / f"{name}.geojson"
        assert (
            in_process("convert", folder / "points.csv", "--from", "csv", "--to-crs", "EPSG:4979", "--out", out).code
            == 0
        )
    (folder / "bad.geojson").write_text("{", encoding="utf-8")
    good = [folder / "one.geojson", folder / "two.geojson"]
    ended = in_process("validate", *good, "--format", "geojson", "--json")
    assert ended.code == 0, ended.stderr
    assert [f["files"] for f in ended.json["files"]] == [[str(p)] for p in good]
    assert ended.json["points"] == 2 * ended.json["files"][0]["points"] > 0
    words = ("validate", good[0], folder / "bad.geojson", good[1], "--format", "geojson")
    ended = in_process(*words)
    assert ended.code == 2 and "bad.geojson" in ended.stderr and ended.stderr.count("\n") == 1
    assert [line.split(": ")[0] for line in ended.stdout.splitlines() if "no errors" in line] == [str(p) for p in good]
    assert [f["n_errors"] for f in in_process(*words, "--json").json["files"]] == [0, 1, 0]


@pytest.mark.behaviour
def test_validate_takes_one_project(folder: Path) -> None:
    ended = in_process("validate", folder / "a.toml", folder / "b.toml")
    assert (
        ended.code == 2
        and "b.toml" in ended.stderr
        and "only one project file can be checked at a time" in ended.stderr
    )


@pytest.mark.behaviour
@pytest.mark.parametrize("option", ["--crs", "--to-crs"])
def test_a_crs_that_is_none_is_refused_by_its_option(tmp_path: Path, option: str) -> None:
    words = ("convert", tmp_path / "points.csv", "--from", "csv", option, "WGS84", "--out", tmp_path / "points.geojson")
    (error,) = in_process(*words, "--json").json["errors"]
    assert (error["code"], error["place"], error["value"]) == ("geodesy.not_epsg", option, "WGS84")


@pytest.mark.truth
def test_missing_roles_heights_and_sigmas_are_filled(tmp_path: Path) -> None:
    """``convert`` fills missing columns and cells by options, and names them if the options are missing.

    Values that exist do not change.
    """
    (tmp_path / "points.csv").write_text(
        "# crs: EPSG:32636\nid,easting_m,northing_m,height_m\na,400000,4580000,100\nb,400100,4580000,\nt,,,\n", "utf-8"
    )
    (tmp_path / "observations.csv").write_text("image,id,line,sample\nleft,a,1,2\nleft,t,3,4\n", "utf-8")
    files = (tmp_path / "points.csv", tmp_path / "observations.csv", "--from", "csv", "--to", "csv")
    out = (tmp_path / "a.csv", "--out", tmp_path / "b.csv")
    refused = in_process("convert", *files, "--out", *out)
    assert refused.code == 2 and "--height" in refused.stderr and refused.stderr.count("\n") == 1
    given = ("--sigma-ground", 0.1, 0.2, 0.3, "--sigma-image", 0.5, 0.6, "--height", 12)
    assert in_process("convert", *files, *given, "--out", *out).code == 0
    assert (tmp_path / "a.csv").read_text("utf-8").splitlines()[2:] == [
        "a,control,400000.0,4580000.0,100.0,0.1,0.2,0.3",
        "b,control,400100.0,4580000.0,12.0,0.1,0.2,0.3",
        "t,tie,,,,,,",
    ]
    assert (tmp_path / "b.csv").read_text("utf-8").splitlines()[1:] == [
        "left,a,1.0,2.0,0.5,0.6",
        "left,t,3.0,4.0,0.5,0.6",
    ]
    told = in_process("validate", tmp_path / "points.csv", "--format", "csv")
    assert told.code == 2 and "column role is missing" in told.stderr
