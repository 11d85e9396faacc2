"""Constraints in a project file are adjusted as in Python; faults name their place."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import fg_orient as fg
from fg_orient.formats.metadata.frame import write_camera, write_frame_file
from fg_orient.formats.points_write import write_observations, write_points, write_project
from fg_orient.formats.schema import read_constraints
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import MEASURED_TO_IDEAL, FrameSensor, rotation_of_opk
from fg_orient.sensors.interior import Interior
from tests.support.command import in_process

Array = npt.NDArray[np.float64]

LON, LAT, NOISE_PX, N_FLAT = 31.8, 41.4, 0.3, 8
POSE = {"rotation_x": 3e-4, "rotation_y": 3e-4, "rotation_z": 3e-4, "centre_x": 0.5, "centre_y": 0.5, "centre_z": 0.5}
#: Constraints of a project and of Python.
FLAT = tuple(f"T{j}" for j in range(N_FLAT))
STATED = (
    fg.Constraint("plane", FLAT),
    fg.Constraint("distance", ("T0", "T1"), 60.0, 0.001),
    fg.Constraint("base", ("IMG_0", "IMG_1"), 300.0, 0.01),
)
TEXT = f"""
[[constraints]]
kind = "plane"
members = {json.dumps(FLAT)}

[[constraints]]
kind = "distance"
members = ["T0", "T1"]
value_m = 60.0
sigma = 0.001

[[constraints]]
kind = "base"
members = ["IMG_0", "IMG_1"]
value_m = 300.0
sigma = 0.01
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return four frame images, nine control points, eight tie points in a plane, T0 and T1 60 m apart."""
    folder, rng = tmp_path_factory.mktemp("frames"), np.random.default_rng(8)
    up, origin = enu_from_ecef(LON, LAT)[0], geodetic_to_ecef(LON, LAT, 0.0)[0]
    middle, sensors = np.array([1500.0, 2000.0]), {}
    inside = Interior(3000, 4000, 4000.0, middle, np.zeros(5), MEASURED_TO_IDEAL, unit_px=4000.0, name="a")
    for k in range(4):
        place = origin + np.array([300.0 * (k % 2), 250.0 * (k // 2), 1500.0]) @ up
        turn = rotation_of_opk(*rng.normal(0.0, 0.03, 2), 0.1 * k) @ up
        sensors[f"IMG_{k}"] = FrameSensor(inside.camera(turn, place, POSE), 3000, 4000)
        write_frame_file(folder / f"IMG_{k}.toml", sensors[f"IMG_{k}"], "camera.toml")
    write_camera(folder / "camera.toml", inside)
    flat = np.column_stack([rng.uniform(-100.0, 400.0, (N_FLAT, 2)), np.zeros(N_FLAT)])
    flat[1] = flat[0] + [36.0, 48.0, 0.0]
    flat[:, 2] = 40.0
    control = np.column_stack([rng.uniform(-100.0, 400.0, (9, 2)), rng.uniform(0.0, 120.0, 9)])
    ground = origin + np.vstack([control, flat]) @ up
    ids = [*(f"P{j}" for j in range(9)), *FLAT]
    coordinates, sigma = np.stack(ecef_to_geodetic(ground), axis=1), np.full((len(ids), 3), 0.02)
    coordinates[9:], sigma[9:] = np.nan, np.nan
    write_points(folder / "points.csv", ids, [fg.Role.CONTROL] * 9 + [fg.Role.TIE] * N_FLAT, coordinates, sigma)
    rows = [(name, ids[j], np.array(pixel) + rng.normal(0.0, NOISE_PX, 2))
            for name, sensor in sensors.items() for j, pixel in enumerate(zip(*sensor.project(ground), strict=True))
            if sensor.is_inside(*pixel)]  # fmt: skip
    pixels = np.array([row[2] for row in rows])
    write_observations(folder / "observations.csv", [r[0] for r in rows], [r[1] for r in rows], pixels,
                       np.full_like(pixels, NOISE_PX))  # fmt: skip
    write_project(folder / "project.toml", name="frames", images=[(i, f"{i}.toml") for i in sensors])
    return folder / "project.toml"


def with_text(project: Path, text: str, name: str = "stated.toml") -> Path:
    """Return the project with more text."""
    path = project.with_name(name)
    path.write_text(project.read_text() + text)
    return path


@pytest.mark.consistency
@pytest.mark.parametrize("backend", ["graph", "dense", "schur"])
def test_a_project_is_adjusted_as_in_python(project: Path, backend: str, tmp_path: Path) -> None:
    own = fg.adjust(replace(fg.read_project(project), extra=STATED), backend=backend)
    ended = in_process("adjust", with_text(project, TEXT), "--backend", backend, "--out", tmp_path / "out", "--json")
    assert ended.code == 0, ended.stderr
    record, page = ended.json, (tmp_path / "out" / "report.html").read_text()
    assert (record["redundancy"], record["chi2"]) == (own.redundancy, own.chi2)
    assert np.array_equal(_ground(tmp_path / "out"), own.ground_m)
    (flat,) = own.figures()
    (figure,) = record["figures"]
    assert figure["figure"] == flat.label == STATED[0].label
    assert [n["name"] for n in figure["numbers"]] == list(flat.names)
    assert [n["value"] for n in figure["numbers"]] == flat.values.tolist()
    assert [n["sigma"] ** 2 for n in figure["numbers"]] == pytest.approx(flat.covariance.diagonal(), rel=1e-12)
    assert figure["covariance"] == flat.covariance.tolist()
    assert [(c["constraint"], c["sigma"]) for c in record["constraints"]] == [(c.label, c.sigma) for c in STATED]
    assert '<section id="constraints"' in page
    assert "distance of T0, T1" in page


def _ground(folder: Path) -> Array:
    with (folder / "points.csv").open() as stream:
        return np.array([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in csv.DictReader(stream)])


@pytest.mark.truth
def test_constraints_hold_at_the_solution(project: Path, tmp_path: Path) -> None:
    """Hard plane and distance of a project hold within 1e-8 m, and record, redundancy and report show them."""
    out = tmp_path / "out"
    ended = in_process("adjust", with_text(project, TEXT.replace("sigma = 0.001\n", "")), "--out", out, "--json")
    flat = _ground(out)[-N_FLAT:]
    assert np.linalg.svd(flat - flat.mean(axis=0))[1][2] < 1e-8
    assert np.linalg.norm(flat[1] - flat[0]) == pytest.approx(60.0, abs=1e-8)
    plane, distance, base = ended.json["constraints"]
    assert max(plane["largest"], distance["largest"]) < 1e-8 < base["largest"]
    plain = in_process("adjust", project, "--out", tmp_path / "plain", "--json").json
    assert (plain["constraints"], plain["figures"]) == ([], [])
    assert ended.json["redundancy"] == plain["redundancy"] + (N_FLAT - 3) + 2
    assert '<section id="constraints"' not in (tmp_path / "plain" / "report.html").read_text()


@pytest.mark.truth
def test_a_fixed_point_that_no_image_shows(project: Path, tmp_path: Path) -> None:
    """A fixed point without rays serves a hard distance; without a constraint it is not in the block."""
    plain = fg.adjust(fg.read_project(project))
    at = plain.ground_m[-1] + [30.0, 40.0, 0.0]
    place = ",".join(repr(float(v[0])) for v in ecef_to_geodetic(at[None]))
    table = (project.parent / "points.csv").read_text().rstrip("\n") + f"\nFAR,control,{place},fixed,fixed,fixed\n"
    project.with_name("more.csv").write_text(table)
    text = project.read_text().replace("points.csv", "more.csv")
    entry = f'\n[[constraints]]\nkind = "distance"\nmembers = ["FAR", "{FLAT[-1]}"]\nvalue_m = 50.1\n'
    project.with_name("far.toml").write_text(text + entry)
    ended = in_process("adjust", project.with_name("far.toml"), "--out", tmp_path / "out", "--json")
    assert ended.code == 0, ended.stderr
    with (tmp_path / "out" / "points.csv").open() as stream:
        found = {row["id"]: row for row in csv.DictReader(stream)}
    tie = np.array([float(found[FLAT[-1]][f"{axis}_m"]) for axis in "xyz"])
    assert np.linalg.norm(tie - at) == pytest.approx(50.1, abs=1e-6)
    project.with_name("without.toml").write_text(text)
    assert "FAR" not in fg.read_project(project.with_name("without.toml")).points.ids


@pytest.mark.behaviour
def test_one_declaration_with_close_range(project: Path) -> None:
    """A file of constraints and the entries of a project give the same constraints."""
    path = project.with_name("constraints.toml")
    path.write_text(TEXT)
    for one, other in zip(read_constraints(path), fg.read_project(with_text(project, TEXT)).extra, strict=True):
        assert one.label == other.label
        assert (one.sigma, one.value_m) == (other.sigma, other.value_m)


FAULTS: dict[str, tuple[Callable[[str], str], str]] = {
    "kind": (lambda t: t.replace('plane', 'flat'), "constraints[1], constraint of T0, T1, T2, T3, T4, T5, ..., kind"),
    "member": (lambda t: t.replace('"T1"]', '"T99"]'), "constraints[2].members"),
    "image": (lambda t: t.replace('"IMG_1"', '"T1"'), "constraints[3].members"),
    "sigma": (lambda t: t.replace("0.001", "0.0"), "constraints[2].sigma"),
    "few": (lambda t: t.replace(", " + json.dumps(FLAT[3:])[1:], "]"), "constraints[1], plane of T0, T1, T2, members"),
    "value": (lambda t: t.replace("value_m = 60.0\n", ""), "constraints[2], distance of T0, T1, value_m"),
    "key": (lambda t: t.replace("sigma = 0.01\n", "sigma_m = 0.01\n"), "constraints[3].sigma_m"),
}  # fmt: skip


@pytest.mark.behaviour
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_name_file_entry_and_remedy(project: Path, fault: str) -> None:
    change, place = FAULTS[fault]
    path = with_text(project, change(TEXT), "wrong.toml")
    with pytest.raises(InputError) as caught:
        fg.read_project(path)
    (problem,) = caught.value.problems
    assert (problem.file, problem.place) == (str(path), place)
    assert problem.remedy
    assert "\n" not in str(problem)
