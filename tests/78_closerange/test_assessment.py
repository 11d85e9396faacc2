"""Doubts on results of close range reach the first line and the exit code, and good data raise few."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from fg_orient.closerange import assessment
from fg_orient.closerange.dlt import fit_dlt
from fg_orient.closerange.orientation import absolute_orientation
from fg_orient.closerange.photo import Photo, PhotoInterior, rotation_from_ayhan
from fg_orient.closerange.resection import resect
from tests.support import page_files
from tests.support.command import in_process as run

SIGMA = 0.002
CAMERA = PhotoInterior(60.0)
PHOTO = Photo.of("left", CAMERA, rotation_from_ayhan(0.01, 0.02, 0.03), [10.0, 20.0, 2.0])
#: Largest probability of a doubt on a result without mistakes: m0 above its interval, and the residuals by two
#: standard deviations.
SHARE = 0.5 * assessment.LEVEL + 2.0 * assessment.LEVEL


def changed(path: Path, row: int, column: int, error: float) -> None:
    """Add an error to a number of a table; row 1 is the first below the heading."""
    lines = path.read_text("utf-8").splitlines()
    cells = lines[row].split(",")
    cells[column] = repr(float(cells[column]) + error)
    path.write_text("\n".join([*lines[:row], ",".join(cells), *lines[row + 1 :]]) + "\n", "utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return tables of two photos; four of the twelve known points are check points."""
    page_files.photos_and_control(tmp_path)
    rows = (tmp_path / "ground.csv").read_text("utf-8").splitlines()
    (tmp_path / "ground.csv").write_text("\n".join(rows[:9]) + "\n", "utf-8")
    (tmp_path / "check.csv").write_text("\n".join([rows[0], *rows[9:]]) + "\n", "utf-8")
    return tmp_path


def bundle(folder: Path, *more: object) -> Any:
    return run("closerange", "bundle", folder / "image.csv", folder / "cameras.toml", "--control",
               folder / "ground.csv", *more)  # fmt: skip


@pytest.mark.truth
def test_a_wrong_check_point_is_the_first_line(folder: Path) -> None:
    words = ("--sigma", "0.001", "--check", folder / "check.csv")
    assert bundle(folder, *words).code == 0
    changed(folder / "check.csv", 2, 3, 0.05)
    done = bundle(folder, *words)
    assert done.code == 4
    first, last = done.stderr.splitlines()[0], done.stdout.splitlines()[-1]
    assert first.startswith("doubt: check points contradict the adjusted points: p9; the largest difference is")
    assert last.startswith("not trustworthy: check points contradict the adjusted points: p9;")
    assert bundle(folder, *words, "--accept", "check_far").code == 0


@pytest.mark.truth
def test_relative_weights_do_not_hide_a_gross_error(folder: Path) -> None:
    assert bundle(folder).code == 0
    changed(folder / "image.csv", 4, 2, 0.05)
    done = bundle(folder, "--json")
    codes = [one["code"] for one in done.json["findings"]]
    assert done.code == 4 and done.json["findings"][0]["place"] == "x of point p3 in photo left"
    assert set(codes) == {"closerange.large_residual"}


@pytest.mark.truth
@pytest.mark.parametrize("sigma", [(), ("--sigma", "0.002")])
def test_a_wrong_control_point_of_an_absolute_orientation(tmp_path: Path, sigma: tuple[str, ...]) -> None:
    rng = np.random.default_rng(3)
    model = rng.uniform(-1.0, 1.0, (8, 3))
    ground = 1.7 * model + 0.3 + rng.normal(0.0, SIGMA, model.shape)
    for name, heading, rows in (("model.csv", "id,x,y,z", model), ("control.csv", "id,x_m,y_m,z_m", ground)):
        lines = [f"p{k},{','.join(map(repr, row))}" for k, row in enumerate(rows.tolist())]
        (tmp_path / name).write_text("\n".join([heading, *lines]) + "\n", "utf-8")
    words = ("closerange", "absolute", tmp_path / "model.csv", tmp_path / "control.csv", *sigma)
    assert run(*words).code == 0
    changed(tmp_path / "control.csv", 6, 2, 0.05)
    done = run(*words)
    assert done.code == 4 and done.stderr.splitlines()[0].startswith("doubt: Y of control point p5: its residual, ")


@pytest.mark.truth
@pytest.mark.parametrize("sigma", [(), ("--sigma", "0.001")])
def test_a_wrong_point_of_a_relative_orientation(folder: Path, sigma: tuple[str, ...]) -> None:
    words = ("closerange", "relative", folder / "image.csv", folder / "cameras.toml", *sigma)
    assert run(*words).code == 0
    changed(folder / "image.csv", 4, 3, 0.05)
    done = run(*words)
    assert done.code == 4 and done.stderr.splitlines()[0].startswith("doubt: point p3: the distance of its rays from ")


def named(name: str, values: Any) -> dict[str, float]:
    """Return numbers along x, y, z as fields of a record."""
    return dict(zip(map(name.format, "xyz"), values.tolist(), strict=False))


def of_absolute(n: int, rng: np.random.Generator, stated: bool) -> dict[str, Any]:
    model = rng.uniform(-1.0, 1.0, (n, 3))
    ground = 1.7 * model + 0.3 + rng.normal(0.0, SIGMA, model.shape)
    fit = absolute_orientation(model, ground, sigma_m=SIGMA if stated else 1.0)
    sigma = {f"sigma_{a}_m": SIGMA for a in "xyz"} if stated else {}
    free = fit.redundancy_numbers.reshape(-1, 3)
    rows = [{"id": str(k), **named("residual_{}_m", r), **named("redundancy_{}", f), **sigma}
            for k, (r, f) in enumerate(zip(fit.residuals_m, free, strict=True))]  # fmt: skip
    return {"kind": "absolute", "m0": fit.m0, "redundancy": fit.redundancy, "control": rows}


def of_photo(n: int, rng: np.random.Generator, stated: bool, kind: str = "dlt") -> dict[str, Any]:
    points = np.array([10.6, 25.0, 2.0]) + rng.uniform(-1.0, 1.0, (n, 3))
    image = PHOTO.project(points) + rng.normal(0.0, SIGMA, (n, 2))
    fit: Any = (fit_dlt(points, image, sigma=np.full((n, 2), SIGMA) if stated else None) if kind == "dlt" else
                resect(CAMERA, points, image, sigma=SIGMA if stated else 1.0))  # fmt: skip
    sigma = {"sigma_x": SIGMA, "sigma_y": SIGMA} if stated else {}
    residuals, free = fit.photo.project(points) - image, fit.redundancy_numbers.reshape(-1, 2)
    rows = [{"id": str(k), "role": "control", **named("residual_{}", r), **named("redundancy_{}", f), **sigma}
            for k, (r, f) in enumerate(zip(residuals, free, strict=True))]  # fmt: skip
    return {"kind": kind, "photos": [{"photo": "p", "m0": fit.m0, "redundancy": fit.redundancy, "points": rows}]}


def of_resection(n: int, rng: np.random.Generator, stated: bool) -> dict[str, Any]:
    return of_photo(n, rng, stated, "resection")


@pytest.mark.slow
@pytest.mark.truth
@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize(("draw", "n"), [(of_absolute, 4), (of_absolute, 8), (of_resection, 5), (of_resection, 12),
                                         (of_dlt := of_photo, 10), (of_dlt, 20)])  # fmt: skip
def test_good_data_are_rarely_doubted(draw: Callable[..., dict[str, Any]], n: int, stated: bool) -> None:
    """The number of false alarms in 400 results is below its 99.99 % limit, if each has at most the stated share."""
    rng = np.random.default_rng(n)
    weights = {"weights": "absolute" if stated else "relative"}
    alarms = sum(
        any(one.severity == "doubt" for one in assessment.tests_of(draw(n, rng, stated) | weights)) for _ in range(400)
    )
    assert alarms <= binom.ppf(0.9999, 400, SHARE)
