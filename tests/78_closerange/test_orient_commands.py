"""``closerange relative`` and ``absolute`` lead from image points of two photos to ground coordinates."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from fg_orient.closerange.orientation import absolute_orientation, relative_orientation
from fg_orient.closerange.photo import Photo, PhotoInterior, rotation_from_ayhan
from tests.support.command import in_process as run

from .conftest import Array

CAMERA = PhotoInterior(60.0)
SIGMA = 0.002


@pytest.fixture
def folder(tmp_path: Path) -> tuple[Path, Array, list[Array]]:
    """Write image points of two photos with cameras and control; return folder, true points and image coordinates.

    Each photo has points that the other one lacks. The first six points are control.
    """
    rng = np.random.default_rng(4)
    points = np.array([10.6, 25.0, 2.0]) + rng.uniform(-1.0, 1.0, (12, 3))
    photos = [Photo.of("left", CAMERA, rotation_from_ayhan(0.01, 0.02, 0.03), [10.0, 20.0, 2.0]),
              Photo.of("right", CAMERA, rotation_from_ayhan(0.0, -0.1, 0.01), [11.2, 20.1, 2.1])]  # fmt: skip
    images = [photo.project(points) + rng.normal(scale=SIGMA, size=(12, 2)) for photo in photos]
    rows = [f"p{k},{photo.name},{xy[0]!r},{xy[1]!r}" for photo, image, mine in
            zip(photos, images, (range(11), range(10, -1, -1)), strict=True) for k in mine
            for xy in [image[k].tolist()]]  # fmt: skip
    rows += [f"alone,left,{images[0][11][0]},{images[0][11][1]}"]
    (tmp_path / "image.csv").write_text("id,photo,x,y\n" + "\n".join(rows) + "\n", "utf-8")
    (tmp_path / "cameras.toml").write_text(
        "schema = 1\n" + "".join(f'\n[[photos]]\nname = "{p.name}"\nfocal = 60.0\n' for p in photos), "utf-8"
    )
    control = "".join(f"p{k},{','.join(map(repr, points[k].tolist()))}\n" for k in range(6))
    (tmp_path / "control.csv").write_text(f"id,x_m,y_m,z_m\n{control}unknown,1,2,3\n", "utf-8")
    return tmp_path, points, images


@pytest.mark.oracle
def test_model_to_ground(folder: tuple[Path, Array, list[Array]]) -> None:
    path, points, images = folder
    done = run("closerange", "relative", path / "image.csv", path / "cameras.toml", "--sigma", SIGMA, "--out",
               path / "model.csv", "--photos-out", path / "photos.toml", "--json")  # fmt: skip
    assert done.code == 0, done.stderr
    record = done.json
    assert record["left_out"] == ["alone"] and record["redundancy"] == 11 - 5
    fit = relative_orientation(CAMERA, CAMERA, images[0][:11], images[1][:11], sigma=SIGMA)
    assert record["exterior"]["centre_m"] == pytest.approx(fit.base.tolist(), abs=1e-9)
    across = fit.base_axes.T @ (fit.m0**2 * fit.cofactors[3:, 3:]) @ fit.base_axes
    assert record["exterior"]["sigma_centre_m"] == pytest.approx(np.sqrt(np.diag(across)).tolist(), rel=1e-6)
    ground = path / "ground.csv"
    done = run("closerange", "absolute", path / "model.csv", path / "control.csv", "--out", ground, "--json")
    assert done.code == 0, done.stderr
    assert done.json["left_out"] == ["unknown"] and done.json["redundancy"] == 18 - 7
    expected = absolute_orientation(fit.model[:6], points[:6])
    assert done.json["scale"] == pytest.approx(expected.scale, rel=1e-9)
    with ground.open(encoding="utf-8") as stream:
        places = np.array([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in csv.DictReader(stream)])
    assert np.abs(places - points[:11]).max() < 0.01  # 5 m away, base 1.2 m: 0.7 mm in depth for each sigma
    intersected = run("closerange", "intersect", path / "image.csv", path / "photos.toml", "--json")
    assert intersected.code == 2 and "alone" in intersected.stderr  # the file is one of oriented photos


@pytest.mark.behaviour
def test_words_of_both_commands(folder: tuple[Path, Array, list[Array]]) -> None:
    path, _, _ = folder
    done = run("closerange", "relative", path / "image.csv", path / "cameras.toml", "--out", path / "model.csv")
    assert done.code == 0 and "base X" in done.stdout and "note: not in both: alone" in done.stderr
    assert "weights are relative" in done.stderr
    again = run("closerange", "relative", path / "image.csv", path / "cameras.toml", "--out", path / "model.csv")
    assert again.code == 2 and "exists" in again.stderr
    done = run("closerange", "absolute", path / "model.csv", path / "control.csv")
    assert done.code == 0 and "scale" in done.stdout and "residuals, m" in done.stdout


@pytest.mark.behaviour
def test_pages_of_both_commands(folder: tuple[Path, Array, list[Array]]) -> None:
    """``relative`` and ``absolute`` write one page each with the record, residuals and inputs, and no second time."""
    path, _, _ = folder
    page, model = path / "page.html", path / "model.csv"
    first = ("closerange", "relative", path / "image.csv", path / "cameras.toml", "--sigma", SIGMA, "--out", model)
    done = run(*first, "--report", page, "--json")
    assert done.code == 0 and done.json["page"] == str(page), done.stderr
    text = page.read_text("utf-8")
    assert f"<b>{done.json['redundancy']}</b>" in text and "Relative orientation" in text and "http:" not in text
    assert all(f'<td class="id">{point["id"]}</td>' in text for point in done.json["points"])
    assert "image.csv" in text and "cameras.toml" in text and f"{done.json['exterior']['centre_m'][1]:.6f}"[-6:] in text
    second = ("closerange", "absolute", model, path / "control.csv", "--report", page)
    done = run(*second)
    assert done.code == 2 and "--overwrite" in done.stderr and page.read_text("utf-8") == text
    done = run(*second, "--overwrite")
    assert done.code == 0 and f"report: {page}" in done.stdout
    text = page.read_text("utf-8")
    assert "Absolute orientation" in text and "control.csv" in text and "standard deviation of one observation" in text
    done = run("closerange", "absolute", model, path / "control.csv", "--report", path / "none" / "page.html")
    assert done.code == 2 and "no such folder" in done.stderr


@pytest.mark.behaviour
def test_refusals(folder: tuple[Path, Array, list[Array]]) -> None:
    path, _, _ = folder
    lines = (path / "image.csv").read_text("utf-8").splitlines()
    (path / "one.csv").write_text("\n".join(line for line in lines if "right" not in line) + "\n", "utf-8")
    done = run("closerange", "relative", path / "one.csv", path / "cameras.toml")
    assert done.code == 2 and "exactly two photos" in done.stderr
    unequal = [f"{line},{0.001 * (k + 1)},0.001" for k, line in enumerate(lines[1:])]
    (path / "unequal.csv").write_text("\n".join([f"{lines[0]},sigma_x,sigma_y", *unequal]) + "\n", "utf-8")
    done = run("closerange", "relative", path / "unequal.csv", path / "cameras.toml")
    assert done.code == 2 and "equal standard deviations" in done.stderr
    (path / "few.csv").write_text("id,x,y,z\np0,1,2,3\np1,2,3,4\n", "utf-8")
    done = run("closerange", "absolute", path / "few.csv", path / "control.csv")
    assert done.code == 2 and "too few points" in done.stderr
