"""DBAT's camera calibration runs through the command; three of its runs fail and name the cause."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.photomodeler import read_photomodeler
from fg_orient.model.digits import last_digit
from tests.support import dbat, photomodeler
from tests.support.command import Ended
from tests.support.command import in_process as run

pytestmark = pytest.mark.truth

SHARED = ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2")
PRINTED = ("Camera Constant", "px", "py", "K1", "K2", "K3", "P1", "P2")


def _rows(path: Path, head: str, rows: Iterable[Iterable[object]]) -> None:
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n", "utf-8")


@pytest.fixture(scope="module")
def camcal(tmp_path_factory: pytest.TempPathFactory, real_data: Path) -> Path:
    """Return the photos, points and marks of the export as tables; coordinates in mm, y down."""
    folder, data = tmp_path_factory.mktemp("camcal"), real_data / "dbat" / "dbat"
    export = read_photomodeler(data / "pmexports" / "camcal-pmexport.txt")
    control = photomodeler.read_control(data / "ref" / "camcal-fixed.txt")
    (camera,) = export.cameras.values()
    entry = '[[photos]]\nname = "{}"\nfocal = 7.5\nprincipal = {}\ny_axis = "down"\nrotation = {}\ncentre_m = {}\n'
    middle = [0.5 * camera.n_samples / camera.unit_px, 0.5 * camera.n_lines / camera.unit_px]
    photos = [entry.format(k, middle, p.rotation.tolist(), p.centre_m.tolist()) for k, p in enumerate(export.poses, 1)]
    (folder / "photos.toml").write_text("schema = 1\n" + "".join(photos), "utf-8")
    ids, photo = np.array(export.point_ids)[export.point], export.image + 1
    x, y = export.sample / camera.unit_px, export.line / camera.unit_px
    _rows(folder / "image.csv", "id,photo,x,y", zip(ids, photo.tolist(), x.tolist(), y.tolist(), strict=True))
    new = {i: at for i, at in photomodeler.points_of(export).items() if i not in control}
    for name, points in (("control", control), ("start", new)):
        _rows(folder / f"{name}.csv", "id,x_m,y_m,z_m", ((i, *at.tolist()) for i, at in points.items()))
    return folder


def calibrate(camcal: Path, image: Path, *more: object) -> Ended:
    return run("closerange", "bundle", image, camcal / "photos.toml", "--start", camcal / "start.csv",
               "--shared", ",".join(SHARED), "--sigma", 0.1 * 5.43764 / 1704, "--json", *more)  # fmt: skip


def without(camcal: Path, folder: Path, gone: dict[str, int]) -> tuple[Path, int]:
    """Return the table without image points of some points but for the first so many, and its number of coordinates."""
    head, *lines = (camcal / "image.csv").read_text("utf-8").splitlines()
    left, kept = dict(gone), []
    for line in lines:
        name = line.split(",")[0]
        left[name] = left.get(name, len(lines)) - 1
        if left[name] >= 0:
            kept.append(line)
    path = folder / "image.csv"
    path.write_text("\n".join([head, *kept]) + "\n", "utf-8")
    return path, 2 * len(kept)


@pytest.mark.real_data
@pytest.mark.slow
def test_camcal_through_the_command(camcal: Path, real_data: Path) -> None:
    """The calibration by the command has every figure of DBAT's report to its last digit.

    The report is camcal-dbatreport-model1.txt: the same polynomial, no aspect.
    """
    done = calibrate(camcal, camcal / "image.csv", "--control", camcal / "control.csv")
    assert (done.code, done.json["findings"][0]["code"]) == (4, "verdict.sigma0")  # 0.1 px stated, 0.17 px found
    figures, values = dbat.report(real_data / "dbat" / "dbat" / "dbatexports" / "camcal-dbatreport-model1.txt")
    theirs = (int(figures["Number of params"]), int(figures["Redundancy"]))
    assert (done.json["unknowns"], done.json["redundancy"]) == theirs == (422, 3726)
    assert abs(done.json["m0"] - float(figures["Sigma0"])) <= 0.5 * last_digit("1.68901")
    camera = {n["name"]: (n["value"], n["sigma"]) for n in done.json["cameras"][0]["parameters"]}
    camera["p2"] = (-camera["p2"][0], camera["p2"][1])  # their y points up
    for ours, name in zip(SHARED, PRINTED, strict=True):
        for found, text in zip(camera[ours], values["camera"][name], strict=True):
            assert abs(found - float(text)) <= last_digit(text), (ours, found, text)


@pytest.mark.real_data
def test_a_point_on_one_ray(camcal: Path, tmp_path: Path, real_data: Path) -> None:
    """A point on one ray is refused with its name, where DBAT reports sigma0 NaN.

    The report is camcal-dbatreport-1ray.txt: structural rank 422 of 423.
    """
    figures, _ = dbat.report(real_data / "dbat" / "dbat" / "dbatexports" / "camcal-dbatreport-1ray.txt")
    image, count = without(camcal, tmp_path, {"88": 1})
    assert count - 423 == int(figures["Redundancy"]) and np.isnan(float(figures["Sigma0"]))
    done = calibrate(camcal, image, "--control", camcal / "control.csv")
    assert done.code == 2
    assert done.stderr.startswith("error: point 88, photo 1: the point is seen in one photo only; measure it")


@pytest.mark.real_data
def test_points_without_observations(camcal: Path, tmp_path: Path, real_data: Path) -> None:
    """Points without observations are refused with their names, where DBAT reports sigma0 499.142.

    The report is camcal-dbatreport-missing-obs.txt: structural rank 417 of 423.
    """
    figures, _ = dbat.report(real_data / "dbat" / "dbat" / "dbatexports" / "camcal-dbatreport-missing-obs.txt")
    image, count = without(camcal, tmp_path, {"13": 0, "60": 0})
    assert count - 423 == int(figures["Redundancy"]) and figures["Sigma0"] == "499.142"
    done = calibrate(camcal, image, "--control", camcal / "control.csv")
    assert done.code == 2
    for name in ("13", "60"):
        assert f"error: point {name}: the point is seen in no photo; measure it in two photos" in done.stderr


@pytest.mark.real_data
def test_no_datum(camcal: Path, tmp_path: Path) -> None:
    """Without control points the calibration is refused with seven free motions and the remedy.

    The report is camcal-dbatreport-no-datum.txt: numerical rank 428, deficiency 7. All points are new, also those of
    control.
    """
    _, *control = (camcal / "control.csv").read_text("utf-8").splitlines()
    start = tmp_path / "start.csv"
    start.write_text((camcal / "start.csv").read_text("utf-8") + "\n".join(control) + "\n", "utf-8")
    done = calibrate(camcal, camcal / "image.csv", "--start", start)
    assert done.code == 2
    assert "7 motions are free (shifted together X, " in done.stderr
    assert "nothing ties these photos to the coordinate system" in done.stderr
    assert "give three control points or more" in done.stderr
