"""The commands handle observed stations, check points, imported projects and redundancy numbers."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from factors.cameras.image_corrections import ideal_points
from fg_orient.closerange.bundle import adjust_bundle
from fg_orient.closerange.bundle_record import directions
from fg_orient.closerange.photo import aerial_from_rotation
from fg_orient.model.constraint import Constraint
from tests.support import photomodeler
from tests.support.command import Ended
from tests.support.command import in_process as run

from .conftest import SIGMA, Array, Scene, make

HEAD = "photo,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m"
TURNED = ",omega_deg,phi_deg,kappa_deg,sigma_x_deg,sigma_y_deg,sigma_z_deg"


def written(folder: Path, scene: Scene, n_control: int) -> list[object]:
    """Write the tables of a scene; return the words of the command."""
    seen = zip(scene.image.tolist(), scene.which.tolist(), scene.of.tolist(), strict=True)
    rows = [f"p{k},ph{p},{x!r},{y!r}" for (x, y), p, k in seen]
    (folder / "image.csv").write_text("\n".join(["id,photo,x,y", *rows, ""]), "utf-8")
    ground = [f"p{k},{','.join(map(repr, at))}" for k, at in enumerate(scene.points.tolist())]
    for name, part in (("control", ground[:n_control]), ("check", ground[n_control:]), ("start", ground)):
        (folder / f"{name}.csv").write_text("\n".join(["id,x_m,y_m,z_m", *part, ""]), "utf-8")
    inner = "focal = 60.0\nprincipal = [0.3, -0.2]\nk1 = 2e-5\np1 = 1e-5\n"
    photos = [f'[[photos]]\nname = "ph{k}"\n{inner}rotation = {r.tolist()}\ncentre_m = {(c + 0.02).tolist()}\n'
              for k, (r, c) in enumerate(zip(scene.rotations, scene.centres, strict=True))]  # fmt: skip
    (folder / "cameras.toml").write_text("schema = 1\n" + "".join(photos), "utf-8")
    return ["closerange", "bundle", folder / "image.csv", folder / "cameras.toml", "--sigma", SIGMA, "--json"]


def stations(folder: Path, rows: list[list[object]], more: str = "") -> Path:
    path = folder / "stations.csv"
    path.write_text("\n".join([HEAD + more, *(",".join(map(str, row)) for row in rows), ""]), "utf-8")
    return path


def observed(scene: Scene, sigma: float) -> list[list[object]]:
    """Return the rows of all stations with their exact coordinates."""
    return [[f"ph{k}", *map(repr, c.tolist()), sigma, sigma, sigma] for k, c in enumerate(scene.centres)]


@pytest.mark.oracle
def test_stations_are_the_datum_and_do_not_begin_as_observed(tmp_path: Path) -> None:
    """Three observed centres are the datum without control, although the photos begin 2 cm away in each axis."""
    scene = make(5, 16)
    done = run(*written(tmp_path, scene, 0), "--start", tmp_path / "start.csv", "--stations",
               stations(tmp_path, observed(scene, 1e-4)))  # fmt: skip
    assert done.code == 0, done.stderr
    record = done.json
    assert (record["unknowns"], record["redundancy"]) == (18 + 48, 96 + 9 - 66)
    for photo, true in zip(record["photos"], scene.centres, strict=True):
        assert np.abs(np.array(photo["exterior"]["centre_m"]) - true).max() < 4e-4
        assert photo["observed"]["centre_m"] == true.tolist()
        residual = np.array(photo["exterior"]["centre_m"]) - true
        assert photo["observed"]["residual_m"] == pytest.approx(residual.tolist(), abs=1e-12)
    far = max(abs(p["x_m"] - at[0]) for p, at in zip(record["points"], scene.points, strict=True))
    assert far < 0.02


@pytest.mark.oracle
def test_the_weight_of_a_station_is_its_sigma(tmp_path: Path) -> None:
    """A centre observed 5 mm off moves by (N + P)^-1 P d, from explicit normal equations."""
    scene = make(9, 14, noise=0.0)
    words = [*written(tmp_path, scene, 6), "--control", tmp_path / "control.csv"]
    free = run(*words).json["photos"][1]["exterior"]
    rows = observed(scene, 1.0)[1:2]
    moved = scene.centres[1] + np.array([5e-3, 0.0, 0.0])
    rows[0][1:] = [*map(repr, moved.tolist()), 1e-3, 10.0, 10.0]
    held = run(*words, "--stations", stations(tmp_path, rows)).json
    # m0 of exact observations is rounding: cofactors are those of a run with noise of the same geometry
    noisy = make(9, 14)
    scale = run(*written(tmp_path, noisy, 6), "--control", tmp_path / "control.csv").json
    q = (scale["photos"][1]["exterior"]["sigma_centre_m"][0] / scale["m0"]) ** 2
    pull = held["photos"][1]["exterior"]["centre_m"][0] - free["centre_m"][0]
    assert pull == pytest.approx(5e-3 * q / (q + 1e-6), rel=2e-2)
    assert held["photos"][0]["observed"] is None


@pytest.mark.oracle
def test_an_observed_attitude_orients_a_photo(tmp_path: Path) -> None:
    """Observed attitudes and centres orient photos without poses and control. They replace a resection."""
    scene = make(11, 12)
    rows = [[*row, *map(repr, np.degrees(aerial_from_rotation(r)).tolist()), 0.002, 0.002, 0.003]
            for row, r in zip(observed(scene, 1e-3), scene.rotations, strict=True)]  # fmt: skip
    words = written(tmp_path, scene, 0)
    text = (tmp_path / "cameras.toml").read_text("utf-8").splitlines()
    (tmp_path / "cameras.toml").write_text(
        "\n".join(line for line in text if not line.startswith(("rotation", "centre_m"))) + "\n", "utf-8"
    )
    done = run(*words, "--stations", stations(tmp_path, rows, TURNED))
    assert done.code == 0, done.stderr
    assert done.json["redundancy"] == 72 + 18 - 18 - 36
    turns = [n["what"] for n in done.json["observations"] if "attitude" in n["what"]]
    assert len(turns) == 9
    for photo in done.json["photos"]:  # no worse than observed
        assert max(photo["exterior"]["sigma_turns_rad"]) < done.json["m0"] * np.radians(0.003)
    assert max(abs(p["z_m"] - at[2]) for p, at in zip(done.json["points"], scene.points, strict=True)) < 0.02


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("rows", "words", "text"),
    [
        ([["ph0", 1, 2, 3, 0.1, 0.1, 0.0]], (), "line 2, column sigma_z_m: this value is too small"),
        ([["ph0", 1, 2, "x", 0.1, 0.1, 1]], (), "line 2, column z_m"),
        ([["ph0", 1, 2, 3, 0.1, 0.1, 1]] * 2, (), "line 3, column photo: the photo has two rows of stations"),
        ([["ph0", 1e13, 2, 3, 0.1, 0.1, 1]], (), "column x_m: the number is too large"),
        ([["ph0", 1, 2, 3, 0.1, 0.1, 1]], ("relative",), "stations.csv, photo ph0: a standard deviation in metres"),
        ([["ph0", 1, 2, 3, 0.1, 0.1, 1]], ("--check", "control.csv"), "control.csv, point p0: a point cannot be both"),
    ],
)  # fmt: skip
def test_bad_stations_end_with_2_and_one_sentence(
    tmp_path: Path, rows: list[list[object]], words: tuple[str, ...], text: str
) -> None:
    given = [*written(tmp_path, make(3, 8), 5), "--control", tmp_path / "control.csv"]
    if words == ("relative",):
        at = given.index("--sigma")
        del given[at : at + 2]
        words = ()
    more = [tmp_path / w if w.endswith(".csv") else w for w in words]
    done = run(*given, "--stations", stations(tmp_path, rows), *more)
    assert done.code == 2 and text in done.stderr and done.stderr.count("\n") == 1, done.stderr


@pytest.mark.behaviour
def test_check_points_take_no_part(tmp_path: Path) -> None:
    scene = make(21, 16)
    words = [*written(tmp_path, scene, 8), "--control", tmp_path / "control.csv"]
    plain, judged = run(*words).json, run(*words, "--check", tmp_path / "check.csv").json
    assert plain["check"] is None and plain["m0"] == judged["m0"]
    for before, after in zip(plain["points"], judged["points"], strict=True):
        assert [before[f"{a}_m"] for a in "xyz"] == [after[f"{a}_m"] for a in "xyz"]
    assert [p["id"] for p in judged["points"] if p["role"] == "check"] == [f"p{k}" for k in range(8, 16)]
    check = judged["check"]
    ours = {p["id"]: np.array([p["x_m"], p["y_m"], p["z_m"]]) for p in judged["points"]}
    difference = np.array([ours[f"p{k}"] - scene.points[k] for k in range(8, 16)])
    assert check["n"] == 8
    assert check["rms_mm"] == pytest.approx((1e3 * np.sqrt(np.mean(difference**2, axis=0))).tolist())
    assert check["mean_mm"] == pytest.approx((1e3 * difference.mean(axis=0)).tolist())
    assert (
        "8 check points: rms along X, Y, Z" in run(*words[:-3], *words[-2:], "--check", tmp_path / "check.csv").stdout
    )


@pytest.mark.oracle
@pytest.mark.parametrize("hard", [False, True])
def test_redundancy_numbers_are_those_of_difference_quotients(hard: bool) -> None:
    """Redundancy numbers are those of the Jacobian by differences, also with a hard condition.

    They are the diagonal of I - J Z (J Z)^+, Z the null space of a hard condition, which is redundancy of the others.
    """
    scene = make(13, 12)
    control = {f"p{k}": (scene.points[k], 1e-3) for k in range(5)}
    size = float(np.linalg.norm(scene.points[6] - scene.points[8]))
    bound = [Constraint("distance", ("p6", "p8"), value_m=size, sigma=None if hard else 1e-3)]
    photos = scene.photos(shared=("k1",), camera="all")
    found = adjust_bundle(photos, scene.ids, scene.points + 0.01, scene.which, scene.of, scene.image, sigma=SIGMA,
                          control=control, constraints=bound)  # fmt: skip
    numbers = [*found.redundancy_numbers.ravel(), *found.others_redundancy]
    assert sum(numbers) == pytest.approx(found.redundancy, abs=1e-6)
    lens = scene.interior.corrections.copy()

    def residuals(x: Array) -> Array:
        """Return residuals of image points, control points and the distance, divided by their sigmas.

        x are small changes.
        """
        places, out = found.points_m + x[19:].reshape(-1, 3), []
        lens[0] = found.cameras[0]["k1"][0] + 1e-4 * x[18]
        ideal = ideal_points(lens, scene.image - scene.interior.principal).reshape(3, -1, 2)
        for (turn, shift), r, c, seen in zip(
            x[:18].reshape(3, 2, 3), found.rotations, found.centres_m, ideal, strict=True
        ):
            q = (places - c - shift) @ (Rotation.from_rotvec(turn).as_matrix() @ r).T
            out.append((seen - 60.0 * q[:, :2] / q[:, 2:] * [1.0, -1.0]).ravel() / SIGMA)
        return np.concatenate([*out, (places[:5] - scene.points[:5]).ravel() / 1e-3,
                               [np.linalg.norm(places[6] - places[8]) / 1e-3]])  # fmt: skip

    h = 1e-5
    j = np.stack([(residuals(h * e) - residuals(-h * e)) / (2.0 * h) for e in np.eye(55)], axis=1)
    if hard:
        j = j[:-1] @ null_space(j[-1:])
    basis = np.linalg.qr(j / np.linalg.norm(j, axis=0)).Q
    assert numbers == pytest.approx(1.0 - (basis**2).sum(axis=1), abs=1e-7)
    assert len(found.others) == 15 + (not hard)
    assert found.others[:2] == ("point p0: control, X", "point p0: control, Y")
    roots = np.sqrt(np.diagonal(found.point_cofactors, axis1=1, axis2=2))
    assert found.sigma_m is not None and found.m0 is not None
    np.testing.assert_allclose(found.m0 * roots, found.sigma_m, rtol=1e-9)
    values, units = directions(found)["singular_values"], found.orientation_units
    largest = np.linalg.norm(found.orientation / np.outer(units, units), 2)
    assert values[0] == pytest.approx(1.0 / np.sqrt(largest)) and (np.diff(values) >= 0.0).all()


@pytest.mark.oracle
def test_angles_have_the_deviations_of_small_turns() -> None:
    """Sigmas of omega, phi and kappa follow from those of small rotations by central differences."""
    from fg_orient.sensors.frame import opk_of_rotation

    scene = make(17, 12)
    control = {f"p{k}": (scene.points[k], 0.0) for k in range(6)}
    found = adjust_bundle(scene.photos(), scene.ids, scene.points, scene.which, scene.of, scene.image, sigma=SIGMA,
                          control=control)  # fmt: skip
    rows = np.flatnonzero(["turn" in label for label in found.orientation_labels])[3:6]
    of_turns = found.orientation[np.ix_(rows, rows)]
    step, by = 1e-6, np.zeros((3, 3))
    for j in range(3):
        cross = np.cross(np.eye(3), step * np.eye(3)[j])
        ends = [np.array(opk_of_rotation((np.eye(3) + sign * cross) @ found.rotations[1])[0]) for sign in (1.0, -1.0)]
        by[:, j] = np.degrees(ends[0] - ends[1]) / (2.0 * step)
    expected = by @ of_turns @ by.T
    np.testing.assert_allclose(np.diag(found.angle_cofactors[1]), np.diag(expected), rtol=1e-5)


# --- projects of other programs ---------------------------------------------------------------------


@pytest.fixture
def project(tmp_path: Path) -> Path:
    photomodeler.write_projects(tmp_path)
    return tmp_path


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def imported(project: Path, *words: object) -> Ended:
    return run("closerange", "import", project / "pmexport.txt", "--control", project / "ctrlpts.txt", "--out",
               project / "tables", *words)  # fmt: skip


@pytest.mark.oracle
def test_a_project_becomes_tables_that_the_bundle_takes(project: Path) -> None:
    done = imported(project, "--stations", project / "positions.txt", "--sigma-image", 0.1, "--json")
    assert done.code == 0, done.stderr
    assert done.json["unit"] == "mm" and done.json["control"] == 4 and done.json["stations"] == 4
    assert done.json["shift_m"] == pytest.approx(photomodeler.SHIFT.tolist(), abs=1e-3)
    folder = project / "tables"
    assert {float(row["sigma_x"]) for row in table(folder / "image.csv")} == {0.1 * 8.0 / 1000.0}
    assert table(folder / "control.csv")[0]["sigma_z_m"] == "0.003" and len(table(folder / "start.csv")) == 24
    words = ("closerange", "bundle", folder / "image.csv", folder / "photos.toml", "--control", folder / "control.csv",
             "--start", folder / "start.csv", "--stations", folder / "stations.csv", "--json")  # fmt: skip
    record = run(*words).json
    assert 0.8 < record["m0"] < 1.2
    for photo, place in zip(record["photos"], photomodeler.PLACES, strict=True):
        assert np.abs(np.array(photo["exterior"]["centre_m"]) - photomodeler.SHIFT - place).max() < 3e-3
    # the camera is right, its decentring with its signs too: what is found besides is nothing
    more = run(*words, "--shared", "p1,p2,k1").json["cameras"][0]["parameters"]
    truth = {"p1": 1e-4, "p2": 5e-5, "k1": 1e-3}
    assert all(abs(n["value"] - truth[n["name"]]) < 4.0 * n["sigma"] < 5e-5 for n in more), more


@pytest.mark.oracle
def test_a_project_as_it_comes_has_the_tables_of_the_complete_one(project: Path) -> None:
    """An export without image size, in Latin-1 and with two foreign points gives the same tables and three notes."""
    names = [f"{n}.jpg" for n in (8811, 8936, 8937, 8938, 9111)]
    photomodeler.write_project(project / "pmexport.txt", project / "ctrlpts.txt", [317, 375, 403, 410, *range(24)], 6,
                               names, off_m=0.0)  # fmt: skip
    complete = imported(project, "--json").json
    tables = {path.name: path.read_text("utf-8") for path in (project / "tables").iterdir()}
    text = (project / "pmexport.txt").read_text("utf-8")
    assert " 0.000500 20 1000 1000\n" in text
    text = text.replace(" 20 1000 1000\n", " 20\n").replace("photos/8811", "Büro/8811")
    (project / "pmexport.txt").write_bytes(text.encode("latin-1"))
    with (project / "ctrlpts.txt").open("a", encoding="utf-8") as control:
        control.write("318, CP318, 1, 2, 3, 0.1\n319, CP319, 1, 2, 4, 0.1\n")
    done = imported(project, "--overwrite", "--json")
    assert done.code == 0, done.stderr
    assert {path.name: path.read_text("utf-8") for path in (project / "tables").iterdir()} == tables
    assert (complete["warnings"], complete["shift_m"]) == ([], done.json["shift_m"])
    latin, size, control_points = done.json["warnings"]
    assert latin == "pmexport.txt, line 6: the file is not UTF-8: it is read as Latin-1"
    assert size.startswith("pmexport.txt: the export contains no image size. Its marks fit best with")
    assert control_points.endswith(
        "ctrlpts.txt: 2 control points that the project does not have are left out: 318, 319"
    )
    stated = imported(project, "--overwrite", "--image-size", "8936.jpg=1000,1000")
    assert stated.code == 0 and "fit best with" not in stated.stdout + stated.stderr


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"control": "317, CP, 1, 2, 3\n375, CP, 1, 2, 3, 0.1\n"}, "point 317: this control point has no"),
        ({"control": "318, CP, 1, 2, 3\n"}, "the control points (found 318); points in the project: 0"),
        ({"control": "317, CP, 1, 2\n"}, "line 1"),
        ({"stations": "a.jpg, 1, 2, 3\n"}, "sigmaX"),
        ({"stations": "a.jpg, 1, 2, 3, 0\n"}, "sigmaX"),
        ({"stations": "a.jpg,1,2,3,1\na.jpg,1,2,3,1\n"}, "a.jpg"),
        ({"from": "csv"}, "--from: the format contains no cameras and poses"),
        ({"out": ""}, "exists"),
    ],
)  # fmt: skip
def test_a_bad_project_ends_with_2_and_one_sentence(project: Path, change: dict[str, Any], text: str) -> None:
    words: list[object] = []
    if "control" in change:
        (project / "ctrlpts.txt").write_text(change["control"], "utf-8")
    if "stations" in change:
        (project / "positions.txt").write_text(change["stations"], "utf-8")
        words += ["--stations", project / "positions.txt"]
    if "from" in change:
        words += ["--from", change["from"]]
    if "out" in change:
        (project / "tables").mkdir()
        (project / "tables" / "mine.txt").touch()
    done = imported(project, *words)
    assert done.code == 2 and text in done.stderr and done.stderr.count("\n") == 1, done.stderr
