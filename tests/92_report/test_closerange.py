"""Drawings in the report of close range agree with the record; hostile names are only text."""

from __future__ import annotations

import copy
import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.closerange import report as plots
from fg_orient.closerange import report_maps as maps
from fg_orient.closerange import report_words as words
from fg_orient.closerange.assessment import suspects
from fg_orient.closerange.photo import NAMES, profile
from fg_orient.closerange.report import render
from fg_orient.closerange.report_verdict import problems, verdict, with_status
from fg_orient.closerange.surface import Surface
from fg_orient.model.errors import as_record, finding, findings_of
from fg_orient.report.chart import Chart
from fg_orient.report.page import script
from fg_orient.report.svg import svg
from tests.support import page_files
from tests.support.browser import Page
from tests.support.command import in_process as run
from tests.support.page import structure
from tests.support.repetitions import some_slow

from .conftest import HOSTILE

BUNDLE = ("closerange", "bundle", "image.csv", "cameras.toml", "--sigma", "0.001", "--control", "ground.csv",
          "--constraints", "constraints.toml", "--shared", "k1")  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the tables of two photos and of a surface, and the folder of a bundle with check points, ``out``."""
    folder = tmp_path_factory.mktemp("closerange")
    page_files.photos_and_control(folder)
    page_files.surface_points(folder)
    rows = (folder / "ground.csv").read_text("utf-8").splitlines()
    (folder / "ground.csv").write_text("\n".join(rows[:9]) + "\n", "utf-8")
    (folder / "check.csv").write_text("\n".join([rows[0], *rows[9:]]) + "\n", "utf-8")
    bundle(folder, "--check", "check.csv", "--out", folder / "out")
    return folder


def bundle(folder: Path, *more: object, code: int = 0) -> Any:
    """Run the bundle on the tables of a folder; its record. ``code``: expected exit code."""
    given = [folder / w if isinstance(w, str) and w.endswith((".csv", ".toml")) else w for w in (*BUNDLE, *more)]
    done = run(*given, "--json")
    assert done.code == code, done.stderr
    return done.json


@pytest.fixture
def record(made: Path) -> dict[str, Any]:
    return json.loads((made / "out" / "closerange.json").read_text("utf-8"))


@pytest.mark.behaviour
def test_the_page_asks_nobody_and_has_its_parts(made: Path) -> None:
    path = made / "out" / "report.html"
    text, found = path.read_text("utf-8"), structure(path)
    assert found.tags.count("script") == 1 and f"<script>{script()}</script>" in text
    assert not re.search(r"(?:src|href)=\"(?!#)|https?:|@import|url\(", text.replace(script(), ""))
    assert "default-src 'none'" in text and len(text) < 400_000
    parts = ["verdict", "accuracy", "map", "numbers", "camera", "residuals", "reliability", "orientation", "points",
             "observability", "iterations", "provenance"]  # fmt: skip
    assert [i for i in found.ids if i in parts] == parts
    links = [value.removeprefix("#") for name, value in found.attributes if name == "href"]
    assert links and set(links) <= set(found.ids)
    inputs = re.findall(r'<td class="id">([\w.]+)</td><td class="id sha text">\w{64}</td>', text)
    assert inputs == ["image.csv", "cameras.toml", "ground.csv", "check.csv", "constraints.toml"]
    columns = text[text.index("For a photo, X0, Y0, Z0 are") :].split("</p>")[0]
    named = set(re.findall(r"photo (?:left|right) (\w+)", text))
    assert {"X0", "turn_x"} <= named and named <= set(re.findall(r"\w+", columns))


@pytest.mark.behaviour
def test_hostile_names_are_words(made: Path, tmp_path: Path) -> None:
    page_files.photos_and_control(tmp_path)
    names = dict(zip(("p0", "p13", "left"), HOSTILE, strict=True))
    for name in ("image.csv", "ground.csv"):
        with (tmp_path / name).open(encoding="utf-8", newline="") as stream:
            rows = [[names.get(cell, cell) for cell in row] for row in csv.reader(stream)]
        with (tmp_path / name).open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows(rows)
    for name in ("cameras.toml", "constraints.toml"):
        text = (tmp_path / name).read_text("utf-8")
        for plain, hostile in names.items():
            text = text.replace(f'"{plain}"', json.dumps(hostile))
        (tmp_path / name).write_text(text, "utf-8")
    bundle(tmp_path, "--report", tmp_path / "page.html")
    found, text = structure(tmp_path / "page.html"), (tmp_path / "page.html").read_text("utf-8")
    assert found.tags.count("script") == 1 and "img" not in found.tags and "<img src=x" not in text
    assert sum("onerror" in part for part in found.text) > 2


@pytest.mark.behaviour
def test_first_page_says_the_accuracy_at_check_points(record: dict[str, Any]) -> None:
    text = render(record)
    first = text[: text.index('id="map"')]
    rms = [words.length(v / 1e3) for v in record["check"]["rms_mm"]]
    assert f"At 4 check points, whose coordinates were not used, the root mean square error is {rms[0]} X" in first
    unit, factor = words.unit_of([v / 1e3 for v in record["check"]["worst_mm"]])
    cells = "".join(f"<td>{words.significant(factor * v / 1e3)}</td>" for v in record["check"]["rms_mm"])
    assert unit == "mm" and f"<tr><th>root mean square</th>{cells}</tr>" in first
    new = [p["sigma_y_m"] for p in record["points"] if p["role"] == "new"]
    assert words.significant(1e3 * float(np.sqrt(np.mean(np.square(new))))) in first
    assert "There are no check points" in render(record | {"check": None})


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "kind", "said"),
    [
        ({"m0": 1.0}, "good", "within their standard deviations: m0 is 1.00, and chance leaves it between"),
        ({"m0": 2.5}, "bad", "m0 = 2.500 lies above"),
        ({"m0": 0.05}, "warn", "the given standard deviations are too large"),
        ({"m0": None}, "warn", "Without redundancy nothing was checked"),
        ({"m0": 0.02, "weights": "relative"}, "good", "standard deviation of one observation, is 0.0200, in the unit"),
        ({"m0": 1.0, **as_record([finding("closerange.no_redundancy")])}, "warn", "within their standard deviations"),
    ],
)  # fmt: skip
def test_verdict(record: dict[str, Any], change: dict[str, Any], kind: str, said: str) -> None:
    quiet = {"residuals": [row | {"w_x": 0.0, "w_y": 0.0} for row in record["residuals"]], "observations": []}
    given = {name: value for name, value in {**record, **quiet, **change}.items() if name != "status"}
    found = verdict(with_status(given))  # as for a record of an earlier version, which has no status
    assert found["kind"] == kind and said in found["text"][0]
    assert f'class="verdict {kind}"' in render(given)


@pytest.mark.behaviour
def test_a_gross_error_is_the_first_problem(made: Path, tmp_path: Path, record: dict[str, Any]) -> None:
    assert suspects(record) == [] and record["status"] == "good"
    page_files.photos_and_control(tmp_path)
    lines = (tmp_path / "image.csv").read_text("utf-8").splitlines()
    k = next(j for j, line in enumerate(lines) if line.startswith("p3,right,"))
    name, photo, x, y = lines[k].split(",")
    lines[k] = f"{name},{photo},{x},{float(y) + 0.05!r}"
    (tmp_path / "image.csv").write_text("\n".join(lines) + "\n", "utf-8")
    found = bundle(tmp_path, "--report", tmp_path / "page.html", code=4)
    text = (tmp_path / "page.html").read_text("utf-8")
    (shown,) = re.findall('<section class="verdict bad".*?</section>', text, re.DOTALL)
    stated = re.findall("<p>(.*?)</p>", shown)
    worst = max(found["residuals"], key=lambda row: abs(row["w_y"] or 0.0))
    assert (worst["id"], worst["photo"]) == ("p3", "right")
    assert found["m0"] > 2.0 and found["status"] == "not_trustworthy"
    said = "point p3 in image right: gross error suspected, of about +0.05"
    assert stated[0].startswith(said) and "; without this observation sigma0 is 0.7" in stated[0]
    assert stated[1].startswith(f"m0 = {found['m0']:.3f} lies above") and text.count(said) == 1
    tables = [tmp_path / w if w.endswith((".csv", ".toml")) else w for w in BUNDLE]
    done = run(*tables, "--quiet")
    assert done.code == 4 and done.stdout == ""
    first, second, last = done.stderr.splitlines()
    assert first.startswith(f"doubt: {said}") and '--accept "gross_error:point p3 in image right"' in first
    assert second.startswith(f"doubt: sigma0 = {found['m0']:.3f} lies above") and last == "not trustworthy"
    assert run(*tables).stdout.splitlines()[-1].startswith(f"not trustworthy: {said}")
    accepted = run(*tables, "--accept", "gross_error", "--accept", "sigma0", "--json")
    assert accepted.code == 0 and accepted.json["status"] == "good"
    assert accepted.json["findings"][-1]["data"]["names"] == ["gross_error:point p3 in image right", "sigma0"]
    part = text[text.index("<h3>Largest residuals</h3>") :]
    assert re.search(r'<tr><td class="id">(.*?)</td><td class="id text">(.*?)</td>', part).groups() == ("right", "p3")  # type: ignore[union-attr]


@pytest.mark.behaviour
def test_names_of_points_do_not_cover_each_other() -> None:
    """Names of points do not overlap, and a name without room is in the tip of its point.

    The object is small between stations far away.
    """
    rng = np.random.default_rng(1)
    at, none = rng.uniform(-1.0, 1.0, (12, 3)), np.full((12, 3), np.nan)
    ids = [f"P{k}" for k in range(11)] + ["a name that is far too long for any place " * 3]
    far = np.array([[9.0, 9.0, 0.0], [-9.0, -9.0, 0.0]])
    scene = maps.Scene(ids, ["control", "check"] * 6, at, np.zeros((12, 3, 3)), none, ["n", "s"], far, -far / 9.0, far)
    drawing = svg(maps.view(scene, "plan", 0, 1))
    found = re.findall(r'class="name" x="([\d.]+)" y="([\d.]+)" text-anchor="(\w+)">(\w+)<', drawing)
    boxes = [(float(x) - (8.0 * len(name) if anchor == "end" else 0.0), float(y), 8.0 * len(name))
             for x, y, anchor, name in found]  # fmt: skip
    assert 5 <= len(boxes) <= 11 and all(
        f"<title>{role} {ids[k][:20]}" in drawing for k, role in enumerate(scene.roles)
    )
    for j, (x, y, length) in enumerate(boxes):
        assert all(x + length < a or a + long < x or abs(y - b) > 13.9 for a, b, long in boxes[:j])


@pytest.mark.behaviour
@pytest.mark.parametrize("seed", range(5))
def test_names_of_stations_do_not_cover_those_of_points(seed: int) -> None:
    """Names of stations and points overlap neither each other nor the squares of the stations."""
    rng = np.random.default_rng(seed)
    at, none = rng.uniform(-1.0, 1.0, (12, 3)), np.full((12, 3), np.nan)
    centres = rng.uniform(-1.0, 1.0, (8, 3))
    names = [f"photo{k}" for k in range(8)]
    scene = maps.Scene([f"P{k}" for k in range(12)], ["control"] * 12, at, np.zeros((12, 3, 3)), none, names,
                       centres, np.full((8, 3), np.nan), centres)  # fmt: skip
    drawing = svg(maps.view(scene, "plan", 0, 1))
    boxes = []  # written to 0.1 units
    for kind, x, y, anchor, name in re.findall(
        r'class="(name|label)" x="([\d.]+)" y="([\d.]+)" text-anchor="(\w+)">(\w+)<', drawing
    ):
        size = (8.0 if kind == "name" else 9.2) * len(name)
        left = float(x) - {"start": 0.0, "end": size, "middle": 0.5 * size}[anchor]
        boxes.append((left, left + size, float(y) - 12.0, float(y) + 3.0))
    places = re.findall(r'class="station" d="M([\d.]+) ([\d.]+)h9', drawing)[:8]
    boxes += [(float(x), float(x) + 9.0, float(y), float(y) + 9.0) for x, y in places]
    assert len(boxes) > 20
    for j, (a, b, c, d) in enumerate(boxes[:-8]):
        assert all(b < e + 0.2 or a > f - 0.2 or d < g + 0.2 or c > h - 0.2 for e, f, g, h in boxes[j + 1 :])


@pytest.mark.oracle
def test_w_is_the_residual_over_its_own_sigma(record: dict[str, Any]) -> None:
    for row in record["residuals"]:
        for a in "xy":
            r = row[f"redundancy_{a}"]
            if row[f"w_{a}"] is None:
                assert r < 0.01
                continue
            assert row[f"w_{a}"] == pytest.approx(row[f"residual_{a}"] / (1e-3 * np.sqrt(r)))
            assert row[f"mdb_{a}"] == pytest.approx(np.sqrt(17.075 / r) * 1e-3, rel=1e-4)


@pytest.mark.behaviour
@pytest.mark.parametrize("command", ["dlt", "resect", "intersect", "bundle"])
def test_a_gross_error_is_named_and_its_residual_has_its_sign(command: str, made: Path, tmp_path: Path) -> None:
    """A coordinate too large by 0.05 has a negative residual, and the problem names it by each command.

    It is y of an intersection, since two rays do not check x along their base. Eleven unknowns of a DLT take too much
    of the error for a ratio without redundancy numbers: there m0 alone tells of it.
    """
    axis = "y" if command == "intersect" else "x"
    shutil.copytree(made, tmp_path / "made")
    folder = tmp_path / "made"
    name = "control.csv" if command in ("dlt", "resect") else "image.csv"
    lines = (folder / name).read_text("utf-8").splitlines()
    columns = lines[0].split(",")
    cells = lines[4].split(",")
    cells[columns.index(axis)] = repr(float(cells[columns.index(axis)]) + 0.05)
    (folder / name).write_text("\n".join([*lines[:4], ",".join(cells), *lines[5:]]) + "\n", "utf-8")
    point, photo = cells[columns.index("id")], cells[columns.index("photo")]
    others = {"dlt": [], "resect": ["cameras.toml"], "intersect": [Path("out", "photos.toml")]}
    words_ = ["closerange", command, folder / name, *(folder / w for w in others.get(command, []))]
    ended = run(*words_, "--sigma", "0.001", "--json")
    record = bundle(folder, code=4) if command == "bundle" else ended.json
    rows = record.get("residuals") or [{"photo": p["photo"]} | r for p in record["photos"] for r in p["points"]]
    (row,) = (r for r in rows if (r["photo"], r["id"]) == (photo, point))
    assert row[f"residual_{axis}"] < -0.005
    assert record["status"] == "not_trustworthy"
    told = " ".join(str(one) for one in findings_of(record) if one.severity == "doubt")
    named = {"dlt": "m0 = ", "intersect": f"point {point}: the misfit of its rays", "bundle": f"point {point} in image"}
    assert named.get(command, f"{axis} of point {point} in photo {photo}") in told


@pytest.mark.behaviour
def test_an_unknown_camera_parameter_is_told_with_the_known_ones(made: Path) -> None:
    tables = [made / w if w.endswith((".csv", ".toml")) else w for w in BUNDLE[:-1]]
    done = run(*tables, "q9")
    assert done.code == 2 and "not the name of a camera parameter" in done.stderr
    assert "choose one of c, x0, y0, k1" in done.stderr


@pytest.mark.behaviour
@pytest.mark.parametrize("sigma", some_slow([0.001, None]))
def test_a_point_off_a_surface_is_a_problem(sigma: float | None, tmp_path: Path) -> None:
    """A point 17 mm off a surface with 1 mm of noise is the only problem, and without it there is none."""
    page_files.surface_points(tmp_path)
    path = tmp_path / "points.csv"
    given = [] if sigma is None else ["--sigma", sigma]
    fitted = ["closerange", "surface", path, "--kind", "spheroid", *given, "--json"]
    assert problems(run(*fitted).json) == []
    lines = path.read_text("utf-8").splitlines()
    name, *at = lines[8].split(",")
    moved = np.array(at, float) + 0.017 * np.array([float(at[0]), 0.0, float(at[2])]) / np.hypot(
        *np.array(at, float)[::2]
    )
    path.write_text("\n".join([*lines[:8], ",".join([name, *map(repr, moved.tolist())]), *lines[9:]]) + "\n", "utf-8")
    done = run(*fitted)
    told, *_ = verdict(done.json)["text"]
    assert done.code == 4 and problems(done.json) == []
    found = re.fullmatch(
        rf"point {name}: its normal distance, (.*) mm, is (.*) times (?:its|the) standard deviation.*: a gross .*", told
    )
    assert found is not None and float(found[1]) > 10.0 and 8.0 < float(found[2]) < 25.0


@pytest.mark.consistency
def test_points_and_ellipses_stand_where_the_record_says(record: dict[str, Any]) -> None:
    scene = maps.scene_of(record)
    chart = maps.view(scene, "plan", 0, 1)
    drawing = svg(chart)
    new = [k for k, role in enumerate(scene.roles) if role == "new"]
    dots = re.findall(r'<path class="tie" d="M([\d.]+) ([\d.]+)a[^"]*"/></g>', drawing)
    drawn = [(float(x) + 1.8, float(y)) for x, y in dots]
    np.testing.assert_allclose(drawn, chart.place(*scene.at[new, :2].T), atol=0.051)
    order = np.argsort(scene.at[new, 1])
    assert (np.diff(np.array(drawn)[order, 1]) < 0.0).all()  # Y grows upwards
    ellipses = re.findall(r'class="ellipse" d="M([^"]*)z"', drawing)
    outlines = [np.array([[float(v) for v in pair.split()] for pair in e.split("L")]) for e in ellipses]
    assert len(outlines) == sum(role != "control" for role in scene.roles)
    loose = [k for k, role in enumerate(scene.roles) if role != "control"]
    ratio = [np.ptp(o[:, 0]) / np.sqrt(scene.covariance[k, 0, 0]) for o, k in zip(outlines, loose, strict=True)]
    up = [np.ptp(o[:, 1]) / np.sqrt(scene.covariance[k, 1, 1]) for o, k in zip(outlines, loose, strict=True)]
    assert np.median(up) == pytest.approx(np.median(ratio), rel=0.1)  # one enlargement for both axes
    for outline, k in zip(outlines, loose, strict=True):
        tilt = float(np.cov(outline[:, 0], -outline[:, 1])[0, 1])
        assert np.sign(tilt) == np.sign(scene.covariance[k, 0, 1])
    said = re.search(r"enlarged ([\d,]+) times", drawing)
    assert said is not None
    units = chart.inner[0] / np.ptp(chart.x.limits)
    assert np.median(up) / (2.0 * units) == pytest.approx(float(said[1].replace(",", "")), rel=0.06)
    assert drawing.count('class="station"') == 3  # two and the legend


@pytest.mark.behaviour
def test_errors_of_check_points_are_vectors(record: dict[str, Any]) -> None:
    moved = copy.deepcopy(record)
    for point in moved["points"]:
        point["difference_x_m"], point["difference_y_m"] = (3e-4, 4e-4) if point["role"] == "check" else (None, None)
    drawing = svg(maps.view(maps.scene_of(moved), "plan", 0, 1))
    lines = re.findall(r'class="vector check" d="M[\d.]+ [\d.]+l([-\d.]+) ([-\d.]+)"', drawing)
    assert len(lines) == 4
    run_, fall = np.array(lines, float).T
    assert (run_ > 0.0).all() and np.median(-fall / run_) == pytest.approx(4.0 / 3.0, rel=0.1)


@pytest.mark.oracle
def test_distortion_is_the_polynomial_and_its_band_the_propagated_sigma() -> None:
    lens = {"k1": 2e-5, "k2": -1e-9, "p1": 1e-5}
    camera = np.array([{"c": 50.0, **lens}.get(name, 0.0) for name in NAMES])
    covariance = np.array([[4e-14, -1e-18], [-1e-18, 1e-22]])
    found = profile(camera, 20.0, ("k1", "k2"), covariance)
    r = np.array(found["radius"])
    np.testing.assert_allclose(found["radial"], 2e-5 * r**3 - 1e-9 * r**5, atol=1e-12)
    np.testing.assert_allclose(found["across"], 1e-5 * r**2, atol=1e-12)
    rows = np.stack([r**3, r**5], axis=1)
    np.testing.assert_allclose(found["sigma"], np.sqrt(np.einsum("ri,ij,rj->r", rows, covariance, rows)), atol=1e-12)
    drawing = svg(plots.distortion(found, "left"))
    assert 'class="band"' in drawing and "± " in drawing and 'class="across"' in drawing


@pytest.mark.consistency
def test_camera_section_is_the_record(record: dict[str, Any]) -> None:
    text = render(record)
    (k1,) = record["cameras"][0]["parameters"]
    cells = f"<th>k1</th><td>{words.significant(k1['value'], 8)}</td><td>{words.significant(k1['sigma'])}</td>"
    assert cells in text
    (curve,) = record["distortion"]
    assert curve["photos"] == ["left", "right"] and curve["determined"] == ["k1"]
    assert curve["sigma"][-1] == pytest.approx(k1["sigma"] * curve["radius"][-1] ** 3)
    assert 'id="camera"' not in render(record | {"cameras": [], "distortion": []})


@pytest.mark.behaviour
def test_photos_are_drawn_as_they_are_seen() -> None:
    rows = [{"x": x, "y": y, "residual_x": 0.0, "residual_y": 0.01} for x in (0.0, 10.0) for y in (0.0, 8.0)]
    for down, sign in ((False, "-"), (True, "")):
        drawing = svg(plots.photo_vectors("left", rows, down))
        path = re.search(r'class="vector residual" d="([^"]*)"', drawing)
        assert path is not None and re.fullmatch(rf"(M[\d.]+ [\d.]+l-?0\.0 {sign}\d+\.\d)+", path[1])


@pytest.fixture(scope="module")
def fitted(made: Path) -> dict[str, Any]:
    done = run("closerange", "surface", made / "points.csv", "--kind", "spheroid", "--sigma", "0.001", "--out",
               made / "surface", "--json")  # fmt: skip
    assert done.code == 0, done.stderr
    return done.json


@pytest.mark.behaviour
def test_surface_deviations(made: Path, fitted: dict[str, Any]) -> None:
    text = (made / "surface" / "report.html").read_text("utf-8")
    structure(made / "surface" / "report.html")
    assert "value / σ" not in text  # the centre of a surface is not tested against 0
    (_, plan), *_ = [(words_, svg(chart)) for words_, chart in maps.deviation_views(fitted)]
    above = sum(p["distance_m"] >= 0.0 for p in fitted["points"])
    assert len(re.findall(r'<g><title>[^<]*</title><path class="deviation p\d"', plan)) == above
    assert plan in text and plan.count("<g>") == 40
    worst = max(fitted["points"], key=lambda p: abs(p["distance_m"]))
    assert f"largest {words.length(worst['distance_m'])} at point {worst['id']}" in text
    outline = maps.outline(fitted["surface"], [0, 1])
    centre, semi = np.array(fitted["surface"]["centre_m"]), np.array(fitted["surface"]["semi_axes_m"])
    np.testing.assert_allclose((((outline - centre[:2]) / semi[:2]) ** 2).sum(axis=1), 1.0, atol=1e-9)
    for name, value in (("X", 0), ("Y", 1), ("Z", 2)):
        assert f"<td>{words.significant(1e3 * fitted['rms_deviation_m'][value])}</td>" in text, name


@pytest.mark.oracle
def test_outlines_touch_their_surface() -> None:
    """The outline of an ellipsoid, or of its quadric, touches the surface; an open quadric has none."""
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn[0] *= np.linalg.det(turn)
    form, centre, away = (
        turn.T @ np.diag([1.0, 0.25, 4.0]) @ turn,
        np.array([1.0, 2.0, 3.0]),
        np.array([0.3, -0.2, 0.1]),
    )
    u = -form @ away
    ten = np.array([*np.diag(form), form[0, 1], form[0, 2], form[1, 2], *u, away @ form @ away - 1.0])
    seen = np.linalg.inv(np.linalg.inv(form)[np.ix_([0, 2], [0, 2])])
    for one in (
        Surface("ellipsoid", centre, np.array([1.0, 2.0, 0.5]), turn),
        Surface("quadric", centre - away, np.ones(3), coefficients=ten),
        Surface("quadric", centre - away, np.ones(3), coefficients=-ten),
    ):
        rim = maps.outline(one.as_dict(), [0, 2]) - centre[[0, 2]]
        assert len(rim) > 20
        np.testing.assert_allclose(np.einsum("ni,ij,nj->n", rim, seen, rim), 1.0)
    for square in ([1.0, -1.0, -1.0], [1.0, 1.0, 0.0], [-1.0, -1.0, -1.0]):
        open_ = Surface("quadric", centre, np.ones(3), coefficients=np.array([*square, *[0.0] * 6, -1.0]))
        assert maps.outline(open_.as_dict(), [0, 2]).shape == (0, 2)


@pytest.mark.behaviour
@pytest.mark.parametrize("command", ["dlt", "resect", "intersect"])
def test_the_other_commands_have_a_page(made: Path, tmp_path: Path, command: str) -> None:
    oriented = made / "out" / "photos.toml"
    given = {"dlt": ["control.csv"], "resect": ["control.csv", "cameras.toml"], "intersect": ["image.csv", oriented]}
    done = run("closerange", command, *(made / w for w in given[command]), "--report", tmp_path / "page.html", "--json")
    assert done.code == 0, done.stderr
    found = structure(tmp_path / "page.html")
    assert {"verdict", "map", "residuals", "provenance"} <= set(found.ids)
    assert not {"reliability", "observability", "iterations"} & set(found.ids)
    assert done.json["page"] == str(tmp_path / "page.html") and done.json["out"] is None
    again = run("closerange", command, *(made / w for w in given[command]), "--report", tmp_path / "page.html")
    assert again.code == 2 and "page.html, --report: the output exists already" in again.stderr
    assert "; give another --report or add --overwrite" in again.stderr
    away = run("closerange", command, *(made / w for w in given[command]), "--report", tmp_path / "no" / "page.html")
    assert away.code == 2 and "no such folder" in away.stderr


@pytest.mark.behaviour
def test_the_report_is_written_again_from_the_folder(made: Path) -> None:
    path = made / "out" / "report.html"
    before = path.read_bytes()
    path.unlink()
    done = run("report", made / "out", "--json")
    assert done.code == 0 and done.json["report"] == str(path)
    assert path.read_bytes() == before
    for option in ("--truth", "--export"):
        done = run("report", made / "out", option, made / "x.gpkg")
        assert done.code == 2 and "neither" not in done.stderr and "no true values and no geographic" in done.stderr
    (made / "old").mkdir()
    (made / "old" / "closerange.json").write_text('{"schema": 1}', "utf-8")
    done = run("report", made / "old")
    assert done.code == 2 and "written by an earlier version" in done.stderr


@pytest.mark.behaviour
def test_figures_for_papers(made: Path, fitted: dict[str, Any]) -> None:
    pytest.importorskip("matplotlib")
    done = run("report", made / "surface", "--figures", "--json")
    assert done.code == 0, done.stderr
    assert done.json["figures"]["files"] == ["captions.md", "deviations.pdf", "deviations.svg"]


@pytest.mark.behaviour
@pytest.mark.slow
def test_figures_of_a_bundle(made: Path) -> None:
    pytest.importorskip("matplotlib")
    done = run("report", made / "out", "--figures-out", made / "figures", "--json")
    assert [n for n in done.json["figures"]["files"] if n.endswith("svg")] == [
        "distortion.svg", "map.svg", "residuals.svg",
    ]  # fmt: skip


@pytest.mark.behaviour
@pytest.mark.browser
@pytest.mark.parametrize("name", ["out", "surface"])
def test_narrow_and_dark(tab: Page, made: Path, fitted: dict[str, Any], name: str) -> None:
    tab.size(400, 800, dark=True)
    tab.open(made / name / "report.html")
    assert tab.value("document.documentElement.scrollWidth") <= 400
    assert tab.value("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
    assert tab.value("document.querySelectorAll('table.sortable thead button').length") > 3
    assert tab.troubles == []


@pytest.mark.behaviour
@pytest.mark.parametrize("up", [0.2, -0.2])
def test_the_name_of_a_station_does_not_cover_its_view(up: float) -> None:
    chart = Chart("plan")
    chart.add("line", "look", [0.5, 0.5], [0.5, 0.5 + up])
    chart.add("dots", "station", [0.5], [0.5])
    chart.add("names", "label", [0.5], [0.5], tips=["left"])
    (at,) = re.findall(r'<text class="label" x="[\d.]+" y="([\d.]+)"', svg(chart))
    assert (float(at) - chart.place(0.5, 0.5)[1]) * up > 0.0  # y of a drawing goes down: the other side of the view
