"""The commands read tables and write folder and figures; refusals are one line."""

from __future__ import annotations

import csv
import json
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pyproj
import pytest

from fg_orient.rectification.transformation import read_transformation
from tests.support.command import in_process as run
from tests.support.page import structure

from .conftest import scene, write_points

FILES = [
    "coefficients.csv", "manifest.json", "points.csv", "report.html", "residuals.svg", "result.json",
    "transformation.json",
]  # fmt: skip


@pytest.fixture
def points(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Return a scene of 30 control and 10 check points with heights."""
    image, plane, heights = scene(rng, 40)
    return write_points(tmp_path / "points.csv", image, plane, check=10, heights=heights)


@pytest.mark.oracle
def test_fit_writes_a_folder_that_says_what_the_json_says(points: Path, tmp_path: Path) -> None:
    out = tmp_path / "fit"
    done = run(
        "rectify", "fit", points, "--degree", "2", "--pixel-size", "28.7", "--crs", "EPSG:32635", "--out", out, "--json"
    )
    assert done.code == 0, done.stderr
    record = done.json
    assert sorted(path.name for path in out.iterdir()) == FILES
    with (out / "points.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["role"] for row in rows] == ["control"] * 30 + ["check"] * 10
    v = np.array([[float(row[f"residual_{axis}_m"]) for axis in ("easting", "northing")] for row in rows])
    assert record["m0"] == pytest.approx(math.sqrt(np.sum(v[:30] ** 2) / (60 - 12)), rel=1e-12)
    assert record["check_rmse"]["radial"] == pytest.approx(math.sqrt(np.mean(np.sum(v[30:] ** 2, axis=1))), rel=1e-12)
    assert record["pair_distances"]["pairs"] == 30 * 29 // 2
    assert json.loads((out / "result.json").read_text("utf-8"))["points"] == record["points"]
    assert "Fitted, nothing stands out" in (out / "report.html").read_text("utf-8")
    t = read_transformation(out)
    assert t.crs == "EPSG:32635"
    with points.open(encoding="utf-8") as stream:
        table = list(csv.DictReader(stream))
    image = np.array([[float(row["sample"]), float(row["line"])] for row in table])
    given = np.array([[float(row["easting_m"]), float(row["northing_m"])] for row in table])
    assert t.apply(image) - given == pytest.approx(v, abs=1e-8)


@pytest.mark.behaviour
def test_figure_and_report_are_well_formed_and_escaped(tmp_path: Path, rng: np.random.Generator) -> None:
    image, plane, _ = scene(rng, 12)
    plane[3] += (400.0, 0.0)
    path = write_points(tmp_path / "p.csv", image, plane)
    path.write_text(path.read_text("utf-8").replace("P4", "<b>&"), "utf-8")
    out = tmp_path / "fit"
    done = run("rectify", "fit", path, "--out", out)
    assert done.code == 4
    assert done.stderr.startswith("doubt: point <b>&: gross error suspected, of about +")
    assert done.stdout.splitlines()[-1].startswith("not trustworthy: point <b>&: gross error suspected")
    drawing = ElementTree.parse(out / "residuals.svg").getroot()
    symbols = [e.get("class") for e in drawing.iter() if e.get("class") in ("control", "check", "ring")]
    assert len(symbols) == 12 + 1 + 2  # points, a ring about the bad one, the legend of both
    html = (out / "report.html").read_text("utf-8")
    assert "<b>&" not in html and "&lt;b&gt;&amp;" in html
    first = html.partition('id="verdict"')[2].partition("</p>")[0]  # the reader learns first what to correct
    assert "Fitted, not trustworthy" in first and "point &lt;b&gt;&amp;. Correct or remove" in first
    found = structure(out / "report.html")
    assert found.tags.count("script") == 1 and not {"img", "link", "b"} & set(found.tags)
    assert len(set(found.ids)) == len(found.ids) and {"problems", "points", "coefficients"} <= set(found.ids)
    assert "Content-Security-Policy" in html and html.count('class="sortable"') == 2
    assert not [value for name, value in found.attributes if value.startswith("http") and name != "xmlns"]


@pytest.mark.behaviour
@pytest.mark.parametrize("model", ["affine", "helmert", "projective", "affine-3d", "parallel", "dlt"])
def test_every_model_by_its_name(model: str, points: Path) -> None:
    record = run("rectify", "fit", points, "--model", model, "--json").json
    assert record["model"] == model
    assert record["unit"] == ("px" if model in {"affine-3d", "parallel", "dlt"} else "m")
    assert record["redundancy"] == 60 - record["n_unknowns"]


@pytest.mark.oracle
def test_map_to_image_is_the_other_way(points: Path) -> None:
    """``rectify fit --direction map-to-image`` has the residuals of numpy's least squares of sample and line."""
    record = run("rectify", "fit", points, "--model", "affine", "--direction", "map-to-image", "--json").json
    assert (record["unit"], record["axes"]) == ("px", ["sample", "line"])
    with points.open(encoding="utf-8") as stream:
        table = [row for row in csv.DictReader(stream) if row["role"] == "control"]
    image = np.array([[float(row["sample"]), float(row["line"])] for row in table])
    plane = np.array([[float(row["easting_m"]), float(row["northing_m"])] for row in table])
    design = np.column_stack([np.ones(len(table)), plane - plane.mean(axis=0)])
    left = image - design @ np.linalg.lstsq(design, image, rcond=None)[0]
    assert record["rmse"]["radial"] == pytest.approx(math.sqrt(np.mean(np.sum(left**2, axis=1))), rel=1e-9)


@pytest.mark.behaviour
def test_pruning_from_the_command(tmp_path: Path, rng: np.random.Generator) -> None:
    image, plane, _ = scene(rng, 20)
    plane[6] += (300.0, 0.0)
    path = write_points(tmp_path / "p.csv", image, plane)
    record = run("rectify", "fit", path, "--prune-to", "30", "--json").json
    assert record["pruning"]["dropped"] == ["P7"]
    assert record["n_control"] == 19
    assert "rectify.rmse_after_pruning" in {one["code"] for one in record["findings"]}
    failed = run("rectify", "fit", path, "--prune-to", "0.001")
    assert failed.code == 3 and "target is not reached" in failed.stderr


@pytest.mark.oracle
def test_longitudes_are_projected(tmp_path: Path, rng: np.random.Generator) -> None:
    image, plane, _ = scene(rng, 12)
    to_degrees = pyproj.Transformer.from_crs("EPSG:32635", "EPSG:4326", always_xy=True)
    lonlat = np.stack(to_degrees.transform(*plane.T), axis=1)
    path = write_points(tmp_path / "p.csv", image, lonlat)
    path.write_text(path.read_text("utf-8").replace("easting_m,northing_m", "lon_deg,lat_deg"), "utf-8")
    metres = run("rectify", "fit", write_points(tmp_path / "m.csv", image, plane), "--json").json
    degrees = run("rectify", "fit", path, "--crs", "EPSG:32635", "--json").json
    assert degrees["m0"] == pytest.approx(metres["m0"], rel=1e-6)
    refused = run("rectify", "fit", path)
    assert refused.code == 2 and "none is given" in refused.stderr
    refused = run("rectify", "fit", path, "--crs", "EPSG:4326")
    assert refused.code == 2 and "not a map projection" in refused.stderr


@pytest.mark.behaviour
def test_sigmas_weight_and_are_refused_on_the_other_side(tmp_path: Path, rng: np.random.Generator) -> None:
    image, plane, _ = scene(rng, 12)
    path = write_points(tmp_path / "p.csv", image, plane, sigma="sigma_easting_m,sigma_northing_m")
    record = run("rectify", "fit", path, "--json").json
    assert record["weighted"] and 0.3 < record["m0"] < 3.0
    refused = run("rectify", "fit", path, "--direction", "map-to-image")
    assert refused.code == 2 and "sigma_line_px" in refused.stderr


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("P2,", "P1,", "used twice"),
        ("control", "tie", "unknown role"),
        ("line,", "row,", "row"),
        ("P1,", "P1,x", "line 2"),
    ],
)
def test_faults_of_the_table(old: str, new: str, text: str, tmp_path: Path, rng: np.random.Generator) -> None:
    image, plane, _ = scene(rng, 6)
    path = write_points(tmp_path / "p.csv", image, plane)
    path.write_text(path.read_text("utf-8").replace(old, new, 1), "utf-8")
    done = run("rectify", "fit", path, "--out", tmp_path / "out")
    assert done.code == 2 and text in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("words", "text"),
    [(("--degree", "9"), "degree"), (("--model", "spline"), "unknown transformation"),
     (("--model", "dlt", "--direction", "image-to-map"), "unknown direction"), (("--pixel-size", "0"), "--pixel-size"),
     (("--degree", "5"), "no redundancy"), (("--model", "polynomial"), "degree")],
)  # fmt: skip
def test_refusals_of_fit(words: tuple[str, ...], text: str, tmp_path: Path, rng: np.random.Generator) -> None:
    image, plane, heights = scene(rng, 12)
    done = run("rectify", "fit", write_points(tmp_path / "p.csv", image, plane, heights=heights), *words)
    assert done.code == 2 and text in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.mark.behaviour
def test_points_that_do_not_do_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    """Points on a line, check points only, or a study without check points are refused with exit code 2."""
    line = np.column_stack([np.arange(10.0), 2.0 * np.arange(10.0)])
    image, plane, _ = scene(rng, 8)
    for command, table, words in (
        (("fit",), write_points(tmp_path / "p.csv", line, 30.0 * line + 5.0), "straight line"),
        (("fit",), write_points(tmp_path / "q.csv", line, line, check=10), "0 control points"),
        (("study", "--counts", "5"), write_points(tmp_path / "r.csv", image, plane), "needs check points"),
    ):
        done = run("rectify", command[0], table, *command[1:])
        assert done.code == 2 and words in done.stderr


@pytest.mark.behaviour
def test_an_existing_folder_is_kept(points: Path, tmp_path: Path) -> None:
    out = tmp_path / "fit"
    assert run("rectify", "fit", points, "--out", out).code == 0
    again = run("rectify", "fit", points, "--out", out)
    assert again.code == 2 and "exists already" in again.stderr
    assert run("rectify", "fit", points, "--out", out, "--overwrite").code == 0
    (out / "mine.txt").write_text("", "utf-8")
    assert run("rectify", "fit", points, "--out", out, "--overwrite").code == 2


@pytest.mark.behaviour
def test_study_tells_why_a_cell_is_empty(points: Path) -> None:
    done = run("rectify", "study", points, "--counts", "5,30", "--degrees", "1,2", "--layouts", "4", "--json")
    cells = {(c["n_points"], c["degree"]): c for c in done.json["cells"]}
    assert cells[5, 2]["median"] is None and "no redundancy" in cells[5, 2]["reason"]
    assert 10.0 < cells[30, 1]["median"] < 60.0
    people = run("rectify", "study", points, "--counts", "5,30", "--degrees", "1,2", "--layouts", "4")
    assert "radial RMSE" in people.stdout and "5 points, degree 2" in people.stderr
    for words in (
        ("--counts", "31"),
        ("--counts", "a"),
        ("--counts", "5", "--layouts", "0"),
        ("--counts", "5", "--degrees", "7"),
    ):
        assert run("rectify", "study", points, *words).code == 2


@pytest.mark.behaviour
def test_check_judges_tables_and_result_folders(points: Path, tmp_path: Path) -> None:
    out = tmp_path / "fit"
    fitted = run("rectify", "fit", points, "--degree", "2", "--out", out, "--json").json
    good = run("rectify", "check", out, "--scale", "100000", "--standard", "NMAS,CMAS", "--json")
    assert good.code == 0
    assert (good.json["points"], good.json["n"]) == ("check points", 10)
    assert good.json["rmse_m"] == pytest.approx(fitted["check_rmse"])
    bad = run("rectify", "check", out, "--scale", "24000")
    assert bad.code == 4 and "failed" in bad.stdout
    d = np.array(
        [[r["residual_easting_m"], r["residual_northing_m"]] for r in fitted["points"] if r["role"] == "check"]
    )
    table = tmp_path / "d.csv"
    lines = [f"Q{k},{x!r},{y!r}" for k, (x, y) in enumerate(d.tolist())]
    table.write_text("id,residual_easting_m,residual_northing_m\n" + "\n".join(lines) + "\n", "utf-8")
    same = run("rectify", "check", table, "--scale", "100000", "--standard", "NMAS,CMAS", "--json").json
    assert same["standards"] == good.json["standards"]
    lines = [f"Q{k},{5e5 + x!r},{4e6 + y!r},500000,4000000" for k, (x, y) in enumerate(d.tolist())]
    table.write_text("id,easting_m,northing_m,true_easting_m,true_northing_m\n" + "\n".join(lines) + "\n", "utf-8")
    same = run("rectify", "check", table, "--scale", "100000", "--standard", "NMAS,CMAS", "--json").json
    assert same["rmse_m"] == pytest.approx(good.json["rmse_m"], abs=1e-8)


@pytest.mark.behaviour
def test_check_refuses_what_it_cannot_judge(points: Path, tmp_path: Path) -> None:
    out = tmp_path / "fit"
    assert run("rectify", "fit", points, "--model", "dlt", "--out", out).code == 0
    pixels = run("rectify", "check", out)
    assert pixels.code == 2 and "residuals in pixels" in pixels.stderr
    (tmp_path / "empty").mkdir()
    empty = run("rectify", "check", tmp_path / "empty")
    assert empty.code == 2 and "not a result of rectify fit" in empty.stderr
    assert run("rectify", "check", tmp_path / "nowhere.csv").code == 2


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ["role", "residual_easting_m", "residual_northing_m"])
@pytest.mark.parametrize("value", [None, "x"], ids=["missing", "word"])
def test_check_refuses_an_edited_result(name: str, value: object, points: Path, tmp_path: Path) -> None:
    out = tmp_path / "fit"
    assert run("rectify", "fit", points, "--out", out).code == 0
    record = json.loads((out / "result.json").read_text("utf-8"))
    for row in record["points"]:
        if value is None:
            del row[name]
        else:
            row[name] = row["residual_easting_m"] = value
    del record["manifest"]  # as a folder of a version without manifest
    (out / "manifest.json").unlink()
    (out / "result.json").write_text(json.dumps(record), "utf-8")
    done = run("rectify", "check", out)
    assert done.code == 2 and "not a result of rectify fit" in done.stderr


@pytest.mark.behaviour
def test_check_does_not_judge_points_chosen_by_their_residuals(tmp_path: Path, rng: np.random.Generator) -> None:
    image, plane, _ = scene(rng, 20)
    plane[6] += (300.0, 0.0)
    codes = []
    for check in (0, 8):
        path, out = write_points(tmp_path / "p.csv", image, plane, check=check), tmp_path / f"fit{check}"
        record = run("rectify", "fit", path, "--prune-to", "30", "--out", out, "--json").json
        assert record["pruning"]["dropped"] == ["P7"]
        codes.append(run("rectify", "check", out, "--scale", "1000000"))
    assert codes[0].code == 2 and "do not measure the accuracy" in codes[0].stderr
    assert codes[1].code == 0 and "check points" in codes[1].stdout
