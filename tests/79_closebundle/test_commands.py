"""``closerange bundle`` leads from control points to calibrated photos; bad input is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.command import in_process as run

from .conftest import SIGMA, Scene, make


def written(tmp_path: Path) -> Scene:
    scene = make(7, 14, 2)
    rows = [
        f"p{k},ph{p},{float(x)!r},{float(y)!r}" for (x, y), p, k in zip(scene.image, scene.which, scene.of, strict=True)
    ]
    (tmp_path / "image.csv").write_text("\n".join(["id,photo,x,y", *rows]) + "\n", "utf-8")
    rows = [f"p{k},{','.join(repr(float(v)) for v in at)}" for k, at in enumerate(scene.points[:8])]
    (tmp_path / "control.csv").write_text("\n".join(["id,x_m,y_m,z_m", *rows]) + "\n", "utf-8")
    entry = '[[photos]]\nname = "ph{}"\nfocal = 60.0\nprincipal = [0.3, -0.2]\nk1 = 1e-5\np1 = 1e-5\n'
    (tmp_path / "cameras.toml").write_text("schema = 1\n" + entry.format(0) + entry.format(1), "utf-8")
    size = float(np.linalg.norm(scene.points[10] - scene.points[12]))
    (tmp_path / "constraints.toml").write_text(
        f'[[constraints]]\nkind = "distance"\nmembers = ["p10", "p12"]\nvalue_m = {size!r}\n', "utf-8"
    )
    return scene


@pytest.mark.oracle
def test_bundle_from_tables(tmp_path: Path) -> None:
    scene = written(tmp_path)
    words = ("closerange", "bundle", tmp_path / "image.csv", tmp_path / "cameras.toml", "--control",
             tmp_path / "control.csv", "--constraints", tmp_path / "constraints.toml", "--shared", "k1", "--sigma",
             str(SIGMA))  # fmt: skip
    done = run(*words, "--out", tmp_path / "out", "--json", "--log", tmp_path / "run.log")
    assert done.code == 0, done.stderr
    record = done.json
    log = [json.loads(line) for line in (tmp_path / "run.log").read_text("utf-8").splitlines()]
    stages = [(e["stage"], e["image_points"]) for e in log if e["event"] == "stage"]
    assert stages == [("reading", 0), ("start values", 28), ("iterations", 28)]
    assert [e["iteration"] for e in log if e["event"] == "iteration"][-1] == record["iterations"]
    assert (record["redundancy"], record["unknowns"]) == (56 + 1 - 13 - 18, 31)
    assert 0.6 <= record["m0"] <= 1.4 and record["weights"] == "absolute"
    k1 = record["cameras"][0]["parameters"][0]
    assert abs(k1["value"] - 2e-5) <= 4.0 * k1["sigma"]
    points = {p["id"]: np.array([p["x_m"], p["y_m"], p["z_m"]]) for p in record["points"]}
    assert np.linalg.norm(points["p10"] - points["p12"]) == pytest.approx(
        float(np.linalg.norm(scene.points[10] - scene.points[12])), abs=1e-9
    )
    assert max(np.abs(points[f"p{k}"] - scene.points[k]).max() for k in range(14)) <= 5e-3
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "closerange.json", "manifest.json", "photos.toml", "points.csv", "report.html",
    ]  # fmt: skip
    again = run("closerange", "intersect", tmp_path / "image.csv", tmp_path / "out" / "photos.toml", "--json")
    assert again.code == 0
    text = run(*words, "--backend", "graph").stdout
    assert "2 photos, 14 points, 31 unknowns" in text


@pytest.mark.behaviour
def test_what_cannot_be_written_or_was_not_measured_is_said(tmp_path: Path) -> None:
    written(tmp_path)
    with (tmp_path / "control.csv").open("a", encoding="utf-8") as file:
        file.write("far,1000.0,2000.0,50.0\n")
    done = run("closerange", "bundle", tmp_path / "image.csv", tmp_path / "cameras.toml", "--control",
               tmp_path / "control.csv", "--shared", "k1,film-scales", "--out", tmp_path / "out", "--json")  # fmt: skip
    assert done.code == 0, done.stderr
    assert done.json["weights"] == "relative"
    assert done.json["warnings"] == [
        "these control points are not measured in any photo: far",
        "photos.toml is not written, because it cannot contain film_xx",
    ]  # fmt: skip
    assert [n["name"] for n in done.json["cameras"][0]["parameters"]] == ["k1", "film_xx", "affinity_b"]
    assert not (tmp_path / "out" / "photos.toml").exists() and (tmp_path / "out" / "points.csv").exists()


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--shared", "k9"), "k9"),
        (("--unknown", "radial-9"), "radial-orthogonal"),
        (("--constraints", "kind.toml"), "one of distance, parallel"),
        (("--constraints", "field.toml"), "did you mean value_m?"),
        (("--constraints", "member.toml"), "does not exist (found p99)"),
        (("--sigma-control", "-1"), "--sigma-control"),
        (
            ("--sigma-control", "0.01"),
            "error: --sigma-control: a standard deviation in metres or radians cannot be used",
        ),
        (
            ("--control", "sigmas.csv"),
            "sigmas.csv, control p0: a standard deviation in metres or radians cannot be used",
        ),
        (("--constraints", "soft.toml"), "soft.toml, constraints[2].sigma: a standard deviation in metres or radians"),
        (("--constraints", "seen.toml"), "seen.toml, constraints[1].observed.radius: a standard deviation in metres"),
        ((), "the photo is not oriented"),
        (("--constraints", "twice.toml"), "distance of p10, p12: 0.5 m; distance of p12, p10: 0.6 m"),
        (
            ("--constraints", "far.toml"),
            "contradict each other: distance of p1, p10; distance of p2, p10 (found 24.4 l",
        ),
        (("--constraints", "held.toml"), "distance of p1, p2, members: this constraint is not possible"),
        (("--constraints", "value.toml"), "value.toml, constraints[1].value_m: the value is not allowed (found -1.0)"),
        (("--constraints", "minus.toml"), "minus.toml, constraints[1].observed: the value is not allowed"),
        (("--control", "large.csv"), "large.csv, line 2, column x_m: the number is too large"),
        (("--sigma", "1e300"), "--sigma: the value of this option is not allowed (found 1e+300)"),
        (("--sigma-control", "1e-300"), "--sigma-control: the value of this option is not allowed (found 1e-300)"),
    ],
)
def test_bad_input_ends_with_2_and_one_sentence(tmp_path: Path, words: tuple[str, ...], text: str) -> None:
    written(tmp_path)
    entry = '[[constraints]]\nmembers = ["p10", "p12"]\n'
    (tmp_path / "kind.toml").write_text(entry + 'kind = "knot"\n', "utf-8")
    (tmp_path / "field.toml").write_text(entry + 'kind = "distance"\nvalue = 1.0\n', "utf-8")
    (tmp_path / "member.toml").write_text(entry.replace("p10", "p99") + 'kind = "distance"\nvalue_m = 1.0\n', "utf-8")
    fixed = '[[constraints]]\nkind = "distance"\nmembers = ["{}", "{}"]\nvalue_m = {}\n'
    for name, stated in (("twice", (("p10", "p12", 0.5), ("p12", "p10", 0.6))), ("held", (("p1", "p2", 1.0),)),
                         ("far", (("p1", "p10", 0.5), ("p2", "p10", 50.0))),
                         ("value", (("p10", "p12", -1.0),))):  # fmt: skip
        (tmp_path / f"{name}.toml").write_text("".join(fixed.format(*one) for one in stated), "utf-8")
    other = '[[constraints]]\nmembers = ["p10", "p11", "p12", "p13"]\n'
    (tmp_path / "soft.toml").write_text(
        f'{other}kind = "plane"\n{entry}kind = "distance"\nvalue_m = 1.0\nsigma = 0.001\n', "utf-8"
    )
    (tmp_path / "minus.toml").write_text(other + 'kind = "sphere"\nobserved = { radius = [-0.8, 0.001] }\n', "utf-8")
    (tmp_path / "large.csv").write_text("id,x_m,y_m,z_m\np0,1e300,1.0,1.0\n", "utf-8")
    (tmp_path / "seen.toml").write_text(other + 'kind = "sphere"\nobserved = { radius = [0.8, 0.001] }\n', "utf-8")
    rows = (tmp_path / "control.csv").read_text("utf-8").splitlines()
    names = ",sigma_x_m,sigma_y_m,sigma_z_m"
    table = [rows[0] + names, *(f"{row},0.001,0.001,0.001" for row in rows[1:])]
    (tmp_path / "sigmas.csv").write_text("\n".join([*table, ""]), "utf-8")
    given = [tmp_path / w if w.endswith((".toml", ".csv")) else w for w in words]
    control = ["--control", tmp_path / "control.csv"] if words else []
    done = run("closerange", "bundle", tmp_path / "image.csv", tmp_path / "cameras.toml", *control, *given)
    assert done.code == 2
    assert done.stderr.startswith("error: ") and text in done.stderr
    if words:
        assert done.stderr.count("\n") == 1


@pytest.mark.behaviour
def test_a_hard_constraint_that_the_images_contradict_is_named(tmp_path: Path) -> None:
    """A hard constraint that the images contradict ends with exit code 3 and its name and misclosure.

    It can be met only far from the images, so that the loop does not converge.
    """
    written(tmp_path)
    entry = '[[constraints]]\nkind = "base"\nmembers = ["ph0", "ph1"]\nvalue_m = 300.0\n'
    (tmp_path / "base.toml").write_text(entry, "utf-8")
    done = run("closerange", "bundle", tmp_path / "image.csv", tmp_path / "cameras.toml", "--control",
               tmp_path / "control.csv", "--constraints", tmp_path / "base.toml")  # fmt: skip
    assert done.code == 3 and "--max-iterations" not in done.stderr
    assert "(the start misses the hard constraint base of ph0, ph1 by 29" in done.stderr
