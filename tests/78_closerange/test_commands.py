"""``closerange`` commands are tested: a stereo pair up to intersected points, surfaces, bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fg_orient.closerange.photo import Photo, PhotoInterior, corrections_of, rotation_from_ayhan
from fg_orient.closerange.surface_fit import fit_surface
from tests.support.command import in_process as run

from .conftest import Array

CAMERAS = """schema = 1

[[photos]]
name = "left"
focal = 60.0
k1 = 1e-5

[[photos]]
name = "right"
focal = 61.0
principal = [0.1, -0.2]
"""


def photos(k1: float) -> list[Photo]:
    left = PhotoInterior(60.0, corrections=corrections_of(("k1",), [k1]))
    right = PhotoInterior(61.0, np.array([0.1, -0.2]))
    return [Photo.of("left", left, rotation_from_ayhan(0.01, 0.02, 0.03), [10.0, 20.0, 2.0]),
            Photo.of("right", right, rotation_from_ayhan(0.0, -0.1, 0.01), [11.2, 20.1, 2.1])]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> tuple[Path, Array]:
    """Return the tables and cameras of a stereo pair without noise; 12 control and 3 check points."""
    points = np.array([10.6, 25.0, 2.0]) + np.random.default_rng(1).uniform(-1.0, 1.0, (15, 3))
    for ending, k1 in (("", 1e-5), ("_plain", 0.0)):
        control, image = ["id,photo,role,x,y,x_m,y_m,z_m"], ["id,photo,x,y"]
        for photo in photos(k1):
            for k, (p, xy) in enumerate(zip(points, photo.project(points), strict=True)):
                role = "check" if k >= 12 else "control"
                at = f"{float(xy[0])!r},{float(xy[1])!r}"
                control.append(f"p{k},{photo.name},{role},{at},{','.join(repr(float(v)) for v in p)}")
                image.append(f"p{k},{photo.name},{at}")
        (tmp_path / f"control{ending}.csv").write_text("\n".join(control) + "\n", "utf-8")
        (tmp_path / f"image{ending}.csv").write_text("\n".join(image) + "\n", "utf-8")
    (tmp_path / "cameras.toml").write_text(CAMERAS, "utf-8")
    return tmp_path, points


@pytest.mark.oracle
def test_resect_then_intersect(folder: tuple[Path, Array]) -> None:
    path, points = folder
    done = run("closerange", "resect", path / "control.csv", path / "cameras.toml", "--out", path / "out", "--json")
    assert done.code == 0
    left = done.json["photos"][0]
    assert left["exterior"]["centre_m"] == pytest.approx([10.0, 20.0, 2.0], abs=1e-8)
    assert (left["redundancy"], len(left["points"])) == (18, 15)
    assert max(left["check_rms"]) <= 1e-8
    assert sorted(p.name for p in (path / "out").iterdir()) == [
        "closerange.json", "manifest.json", "photos.toml", "points.csv", "report.html",
    ]  # fmt: skip
    again = run("closerange", "intersect", path / "image.csv", path / "out" / "photos.toml", "--json")
    found = np.array([[p["x_m"], p["y_m"], p["z_m"]] for p in again.json["points"]])
    assert np.abs(found - points).max() <= 1e-7
    assert again.json["redundancy"] == 15
    assert json.loads((path / "out" / "closerange.json").read_text("utf-8"))["kind"] == "resection"


@pytest.mark.oracle
def test_dlt_then_intersect(folder: tuple[Path, Array]) -> None:
    path, points = folder
    done = run("closerange", "dlt", path / "control_plain.csv", "--out", path / "out")
    assert done.code == 0, done.stderr
    assert "photo left: 15 points, redundancy 13" in done.stdout
    again = run("closerange", "intersect", path / "image_plain.csv", path / "out" / "photos.toml")
    assert again.code == 0 and "15 points, redundancy 15" in again.stdout
    record = run("closerange", "intersect", path / "image_plain.csv", path / "out" / "photos.toml", "--json").json
    found = np.array([[p["x_m"], p["y_m"], p["z_m"]] for p in record["points"]])
    assert np.abs(found - points).max() <= 1e-7
    distorted = run("closerange", "dlt", path / "control.csv", "--distortion", "k1", "--json").json["photos"][0]
    assert distorted["redundancy"] == 12
    assert distorted["parameters"][11]["value"] == pytest.approx(1e-5, rel=1e-6)
    refused = run("closerange", "dlt", path / "control.csv", "--out", path / "out")
    assert refused.code == 2 and "exists" in refused.stderr


def surface_table(path: Path, points: Array) -> Path:
    rows = [f"{k},{','.join(repr(float(v)) for v in p)}" for k, p in enumerate(points)]
    path.write_text("\n".join(["id,x_m,y_m,z_m", *rows]) + "\n", "utf-8")
    return path


@pytest.mark.consistency
def test_surface(tmp_path: Path, land: Array) -> None:
    table = surface_table(tmp_path / "points.csv", land)
    done = run("closerange", "surface", table, "--kind", "spheroid", "--sigma", "0.001", "--json")
    fit = fit_surface(land, "spheroid", sigma_m=0.001)
    assert {p["name"]: p["value"] for p in done.json["parameters"]} == fit.parameters
    assert (done.code, done.json["m0"], done.json["status"]) == (4, fit.m0, "not_trustworthy")
    (doubt,) = done.json["findings"]  # the points scatter more than 1 mm
    assert (doubt["code"], doubt["data"]["size"]) == ("closerange.m0_large", fit.m0)
    assert run("closerange", "surface", table, "--kind", "spheroid", "--sigma", "0.0015", "--json").code == 0
    assert done.json["weights"] == "absolute" and "weights are relative" not in done.stderr
    ended = run("closerange", "surface", table, "--kind", "sphere")
    text = ended.stdout
    assert "weights are relative, and m0 is the sigma of an observation" in ended.stderr
    assert "sphere: 49 points, redundancy 45" in text and "normal distances: rms 8.53 mm" in text


@pytest.mark.behaviour
def test_statistics_that_do_not_exist_are_null_with_a_reason(tmp_path: Path) -> None:
    table = surface_table(tmp_path / "four.csv", np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    record = run("closerange", "surface", table, "--kind", "sphere", "--json").json
    assert record["m0"] is None and record["parameters"][0]["sigma"] is None
    assert record["warnings"] == ["there is no redundancy, so there are no standard deviations"]


@pytest.mark.behaviour
def test_two_levels_end_with_2_and_a_prior_helps(tmp_path: Path, land: Array) -> None:
    table = surface_table(tmp_path / "six.csv", land[np.array([1, 4, 7, 10, 13, 49]) - 1])
    words = ("closerange", "surface", table, "--kind", "spheroid", "--sigma", "0.001")
    done = run(*words)
    assert done.code == 2
    assert done.stderr.count("\n") == 1 and "b and y0 are inseparable (dy0 = -1.00 db)" in done.stderr
    assert run(*words, "--prior", "b=0.845:0.002").code == 0


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("dlt", "missing.csv"), "missing.csv"),
        (("dlt", "control.csv", "--distortion", "k9"), "this distortion of a DLT is unknown"),
        (("dlt", "control.csv", "--sigma", "0"), "--sigma"),
        (("resect", "control.csv", "one.toml"), "no photo of this name (found left)"),
        (("resect", "control.csv", "bad.toml"), "photos[1].focal"),
        (("resect", "control.csv", "extra.toml"), "did you mean focal?"),
        (("resect", "control.csv", "twice.toml"), "used twice"),
        (("resect", "control.csv", "bare.toml"), "the photo has no camera"),
        (("intersect", "image.csv", "cameras.toml"), "the photo is not oriented"),
        (("intersect", "image.csv", "skew.toml"), "skew.toml, photos[1].rotation of left: this value of the camera is"),
        (("resect", "line.csv", "cameras.toml"), "photo left, resection: the points lie on a line or at one place"),
        (("dlt", "large.csv"), "large.csv, line 2, column x: the number is too large"),
        (("surface", "large.csv", "--kind", "sphere"), "large.csv, line 1: unknown column (found photo)"),
        (("surface", "far.csv", "--kind", "sphere"), "far.csv, line 2, column z_m: the number is too large"),
        (("surface", "points.csv", "--kind", "spheroid", "--sigma", "1", "--prior", "b=-1:1"), "(lengths are above 0)"),
        (("resect", "control.csv", "large.toml"), "large.toml, photos[1].focal: the value is not allowed"),
        (("intersect", "alone.csv", "flat.toml"), "the matrix of a central projection"),
        (("intersect", "control.csv", "cameras.toml"), "control.csv, line 1: unknown column (found role)"),
        (("surface", "image.csv", "--kind", "sphere"), "image.csv, line 1: unknown column (found photo)"),
        (("surface", "points.csv", "--kind", "sphere", "--prior", "a"), "name=value:sigma"),
        (("surface", "points.csv", "--kind", "sphere", "--prior", "a=1:1"), "error: --prior a: a standard deviation"),
    ],
)
def test_bad_input_ends_with_2_and_one_line_for_each_error(
    folder: tuple[Path, Array], words: tuple[str, ...], text: str
) -> None:
    path, points = folder
    surface_table(path / "points.csv", points)
    entry = 'schema = 1\n[[photos]]\nname = "left"\n'
    for name, more in (("bare", ""), ("bad", "focal = -1.0\n"), ("extra", "focl = 60.0\n"),
                       ("twice", f"focal = 60.0\n{entry[11:]}focal = 60.0\n"),
                       ("large", "focal = 1e300\n"),
                       ("skew", "focal = 60.0\ncentre_m = [0.0, 0.0, 0.0]\nrotation = [[1.0, 0.0, 0.0], "
                        "[0.1, 1.0, 0.0], [0.0, 0.0, 1.0]]\n"),
                       ("flat", "matrix = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 1.0, 0.0, 1.0]]\n"),
                       ):  # fmt: skip
        (path / f"{name}.toml").write_text(entry + more, "utf-8")
    (path / "one.toml").write_text(CAMERAS.replace('"left"', '"middle"'), "utf-8")
    head, first, *_ = (path / "control.csv").read_text("utf-8").splitlines()
    cells = first.split(",")
    (path / "large.csv").write_text(f"{head}\n{','.join([*cells[:3], '1e300', *cells[4:]])}\n", "utf-8")
    (path / "far.csv").write_text("id,x_m,y_m,z_m\n1,0.0,0.0,-1e150\n", "utf-8")
    along = np.array([10.6, 25.0, 2.0]) + np.linspace(-1.0, 1.0, 6)[:, None] * [0.7, 0.3, 0.2]
    image = photos(1e-5)[0].project(along) + np.random.default_rng(3).normal(scale=0.005, size=(6, 2))
    rows = [f"{k},left,control,{','.join(repr(float(v)) for v in (*xy, *p))}"
            for k, (p, xy) in enumerate(zip(along, image, strict=True))]  # fmt: skip
    (path / "line.csv").write_text("\n".join([head, *rows, ""]), "utf-8")
    (path / "alone.csv").write_text("id,photo,x,y\n1,left,1.0,2.0\n", "utf-8")
    given = [path / w if "." in w and not w.startswith("-") and w[0].isalpha() else w for w in words]
    done = run("closerange", *given)
    assert done.code == 2
    lines = done.stderr.splitlines()
    assert all(line.startswith("error: ") for line in lines) and text in lines[0]
    assert len(lines) == 1 or "line 1: unknown column" in text  # each wrong column is an error
    if text == "--sigma":  # one printer of errors for all commands
        as_json = run("closerange", *given, "--json")
        assert as_json.code == 2 and as_json.json["errors"]
