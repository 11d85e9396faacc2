"""A mirror image and residuals that follow the heights are named; good tables cause no warning."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from fg_orient.quality.doubts import BUDGET
from fg_orient.rectification.mistakes import mistakes_in, relief
from fg_orient.rectification.points import MapPoints, PointFit, fit_points, read_map_points
from fg_orient.rectification.record import WORSE, record_of
from fg_orient.rectification.transformation import find_model
from tests.support.command import in_process as run

MODELS = [
    ("polynomial", 1),
    ("polynomial", 2),
    ("projective", None),
    ("affine-3d", None),
    ("dlt", None),
]


def table(
    folder: Path, *, relief_px: float = 0.0, noise_px: float = 0.3, turn_deg: float = 14.0, exchanged: bool = False
) -> tuple[Path, np.ndarray]:
    """Write 40 points of an image turned by an angle and return the file and the columns.

    Heights of 100 m move the sample by ``relief_px``.
    """
    rng = np.random.default_rng(4)
    plan, height = rng.uniform(0.0, 8000.0, (40, 2)), rng.uniform(0.0, 400.0, 40)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    sample = (c * plan[:, 0] + s * plan[:, 1]) / 2.0 + relief_px * height / 100.0
    line = 5000.0 - (c * plan[:, 1] - s * plan[:, 0]) / 2.0
    pixels = np.stack([line, sample], axis=1) + rng.normal(0.0, noise_px, (40, 2))
    pixels = pixels[:, ::-1] if exchanged else pixels
    columns = np.round(np.column_stack([pixels, 4e5 + plan[:, 0], 4.5e6 + plan[:, 1], height]), 4)
    rows = "".join(f"{k},{','.join(f'{v:.4f}' for v in row)}\n" for k, row in enumerate(columns))
    path = folder / "points.csv"
    path.write_text("id,line,sample,easting_m,northing_m,height_m\n" + rows, "utf-8")
    return path, columns


def fitted(path: Path, model: str, degree: int | None, direction: str | None = None) -> PointFit:
    return fit_points(read_map_points(path), find_model(model, degree), direction)


def codes(found: PointFit) -> list[str]:
    return [one["code"] for one in record_of(found)["findings"]]


@pytest.mark.oracle
@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 200.0])
@pytest.mark.parametrize(("model", "degree"), MODELS)
def test_exchange_of_line_and_sample_is_a_mirror_image(
    tmp_path: Path, model: str, degree: int | None, turn_deg: float
) -> None:
    """A turned image is not mirrored."""
    assert "rectify.mirrored" not in codes(fitted(table(tmp_path, turn_deg=turn_deg)[0], model, degree))
    wrong = table(tmp_path, turn_deg=turn_deg, exchanged=True)[0]
    assert "rectify.mirrored" in codes(fitted(wrong, model, degree))
    assert "rectify.mirrored" not in codes(fitted(wrong, "helmert", None))


@pytest.mark.oracle
@pytest.mark.parametrize("direction", ["image-to-map", "map-to-image"])
@pytest.mark.parametrize("degree", [1, 2])
def test_relief_is_told_with_the_figures_of_numpy(tmp_path: Path, degree: int, direction: str) -> None:
    """The statistic and m0 are those of least squares by numpy with the height as another column."""
    path, columns = table(tmp_path, relief_px=20.0)
    line, sample, east, north, height = columns.T
    found = fitted(path, "polynomial", degree, direction)
    assert codes(found)[0] == "rectify.relief"
    image, ground = np.stack([sample, line], axis=1), np.stack([east - 4e5, north - 4.5e6], axis=1)
    source, target = (image, ground) if direction == "image-to-map" else (ground, image)
    x, y = (source / 4000.0).T
    plane = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)
    squares = [
        float(np.sum((target - design @ np.linalg.lstsq(design, target, rcond=None)[0]) ** 2))
        for design in (plane, np.column_stack([plane, height]))
    ]
    freedom = 2 * (len(x) - plane.shape[1] - 1)
    statistic, m0 = relief(found.fit, height)
    assert m0 == pytest.approx(np.sqrt(squares[1] / freedom), rel=1e-6)
    assert statistic == pytest.approx(0.5 * (squares[0] - squares[1]) / (squares[1] / freedom), rel=1e-6)


@pytest.mark.oracle
def test_heights_without_influence_cause_no_warning(tmp_path: Path) -> None:
    flat = fitted(table(tmp_path)[0], "polynomial", 1)
    assert flat.heights is not None
    assert "rectify.relief" not in codes(flat)
    spatial = fitted(table(tmp_path, relief_px=20.0)[0], "affine-3d", None)
    assert spatial.heights is None
    assert "rectify.relief" not in codes(spatial)
    # 2000 tables of heights without influence: as many warnings as the level of the test allows, 2 on average
    rng = np.random.default_rng(1)
    warned = [mistakes_in(flat.fit, rng.uniform(0.0, 400.0, 40)) for _ in range(2000)]
    assert sum(map(bool, warned)) <= 9  # more have a probability below 1e-4


@pytest.mark.behaviour
def test_heights_that_the_table_plane_gives_are_not_tested(tmp_path: Path) -> None:
    path, columns = table(tmp_path, relief_px=20.0)
    found = fitted(path, "polynomial", 1, "map-to-image")
    assert relief(found.fit, 0.01 * columns[:, 2] - 0.02 * columns[:, 3]) == (0.0, found.fit.m0)


@pytest.mark.truth
def test_check_points_that_contradict_the_control_points_decide(tmp_path: Path) -> None:
    path, _ = table(tmp_path)
    lines = path.read_text("utf-8").splitlines()
    roles = [f"{lines[0]},role", *(f"{row},{'check' if k % 2 else 'control'}" for k, row in enumerate(lines[1:]))]
    path.write_text("\n".join(roles) + "\n", "utf-8")
    assert run("rectify", "fit", path).code == 0
    cells = [row.split(",") for row in roles]
    for row in cells[2::2]:  # each check point lies 2 m farther east: three times m0
        row[3] = repr(float(row[3]) + 2.0)
    path.write_text("\n".join(map(",".join, cells)) + "\n", "utf-8")
    done = run("rectify", "fit", path)
    assert done.code == 4
    assert sum(line.startswith("doubt: the errors at check points are ") for line in done.stderr.splitlines()) == 1


@pytest.mark.truth
@pytest.mark.slow
def test_good_points_are_rarely_doubted() -> None:
    """The number of false alarms in 1000 fits is below its 99.99 % limit, if each has at most the stated share.

    The shares are those of gross errors of control points and of check points, and of all check points together. The
    test of single points alone finds one of 1000 points.
    """
    rng = np.random.default_rng(6)
    doubted = named = 0
    for _ in range(1000):
        plane = rng.uniform(0.0, 8000.0, (60, 2))
        image = np.array([5000.0, 0.0]) + plane[:, ::-1] * [-0.5, 0.5] + rng.normal(0.0, 0.3, (60, 2))
        ids, check = tuple(map(str, range(60))), np.arange(60) % 3 == 0
        points = MapPoints(ids, check, image, plane, None, None, "", "")
        found = record_of(fit_points(points, find_model("polynomial", 2)))
        doubted += found["status"] == "not_trustworthy"
        named += any(one["code"] == "rectify.suspicious_point" for one in found["findings"])
    assert doubted <= binom.ppf(0.9999, 1000, 2 * BUDGET["gross_error"] + WORSE)
    assert named > 20
