"""Files of Bundle Adjustment in the Large: numbers, the cost by the printed model, faults that name their line."""

from __future__ import annotations

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.solve import solve
from fg_orient.formats.exchange.bal import read_bal, read_bal_data
from fg_orient.model.errors import InputError


def snavely(cameras: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the model as printed on the web page of the data: p = -P/P_z, p' = f (1 + k1 |p|^2 + k2 |p|^4) p."""
    q = Rotation.from_rotvec(cameras[:, :3]).apply(points) + cameras[:, 3:6]
    p = -q[:, :2] / q[:, 2:]
    r = np.sum(p**2, axis=1, keepdims=True)
    return cameras[:, 6:7] * (1.0 + cameras[:, 7:8] * r + cameras[:, 8:9] * r**2) * p


def numbers() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the cameras around the origin that look at it along -Z; observations with 0.3 px of noise."""
    rng = np.random.default_rng(7)
    points = rng.uniform(-1.0, 1.0, (12, 3))
    cameras = np.column_stack([
        rng.normal(scale=0.2, size=(3, 3)), rng.normal(scale=0.2, size=(3, 2)), np.full(3, -5.0),
        rng.uniform(400.0, 500.0, 3), rng.normal(scale=0.02, size=(3, 2)),
    ])  # fmt: skip
    index = np.array([(c, p) for p in range(12) for c in range(3)])
    xy = snavely(cameras[index[:, 0]], points[index[:, 1]]) + rng.normal(scale=0.3, size=(36, 2))
    return index, xy, cameras, points + rng.normal(scale=0.01, size=points.shape)


def text() -> str:
    index, xy, cameras, points = numbers()
    lines = [f"{len(cameras)} {len(points)} {len(index)}"]
    lines += [f"{c} {p}     {x!r} {y!r}" for (c, p), (x, y) in zip(index.tolist(), xy.tolist(), strict=True)]
    lines += [repr(v) for v in (*cameras.ravel().tolist(), *points.ravel().tolist())]
    return "\n".join(lines) + "\n"


@pytest.mark.behaviour
@pytest.mark.parametrize("name", ["plain.txt", "packed.gz", "packed.bz2"])
def test_file_is_read_as_it_stands(tmp_path: Path, name: str) -> None:
    pack = {"gz": gzip.compress, "bz2": bz2.compress}.get(name.rpartition(".")[2], lambda raw: raw)
    path = tmp_path / name
    path.write_bytes(pack(text().encode()))
    data, (index, xy, cameras, points) = read_bal_data(path), numbers()
    assert np.array_equal(np.stack([data.camera, data.point], axis=1), index)
    for ours, theirs in ((data.xy, xy), (data.cameras, cameras), (data.points, points)):
        assert np.array_equal(ours, theirs)


@pytest.mark.oracle
def test_residuals_are_those_of_the_printed_model_and_the_cost_falls_without_control(tmp_path: Path) -> None:
    path = tmp_path / "bundle.txt"
    path.write_text(text())
    index, xy, cameras, points = numbers()
    problem = compile_problem(read_bal(path))
    found = problem.pixel_residuals(problem.start)
    expected = snavely(cameras[index[:, 0]], points[index[:, 1]]) - xy
    assert np.abs(found[:, 1] - expected[:, 0]).max() < 1e-10
    assert np.abs(found[:, 0] + expected[:, 1]).max() < 1e-10
    estimate = solve(problem)
    assert estimate.converged
    assert estimate.chi2 < 0.1 * float(np.sum(expected**2))
    assert 0.5 < np.sqrt(estimate.chi2 / (problem.redundancy + 7)) / 0.3 < 1.5


@pytest.mark.behaviour
def test_points_seen_once_and_points_behind_are_told(tmp_path: Path) -> None:
    lines = text().splitlines()
    del lines[1]
    lines[0] = "3 12 35"
    lines[1:3] = [lines[1].replace("1 0 ", "1 1 "), lines[2]]  # point 0 keeps one ray
    lines[-1] = "40.0"  # the last point goes behind all three
    path = tmp_path / "bundle.txt"
    path.write_text("\n".join(lines))
    kept, dropped = read_bal(path), read_bal(path, keep_behind=False)
    assert tuple(map(str, kept.notes)) == (
        "left out: 1 point measured in one image only",
        "1 point lies behind a camera",
    )
    assert len(kept.observations) == 34
    assert len(dropped.observations) == 31
    assert not np.isin(dropped.observations.point, [0, 11]).any()


@pytest.mark.behaviour
def test_two_measurements_in_one_image_do_not_make_a_second(tmp_path: Path) -> None:
    """A point measured twice in one image only is excluded, and a note counts it."""
    lines = text().splitlines()
    lines[2:4] = [line.replace(old, "0 0 ", 1) for line, old in zip(lines[2:4], ("1 0 ", "2 0 "), strict=True)]
    path = tmp_path / "bundle.txt"
    path.write_text("\n".join(lines))
    block = read_bal(path)
    assert tuple(map(str, block.notes)) == ("left out: 1 point measured in one image only",)
    assert len(block.observations) == 33 and not (block.observations.point == 0).any()


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "expected", "place"),
    [
        (lambda t: "", "bal.header", "line 1"),
        (lambda t: t.replace("3 12 36", "3 twelve 36", 1), "bal.header", "line 1"),
        (lambda t: t.replace("3 12 36", "3 0 36", 1), "bal.header", "line 1"),
        (lambda t: t.replace("3 12 36", "3 12 35", 1), "bal.count", "line 101"),
        (lambda t: t[: len(t) // 2], "bal.count", "line 33"),
        (lambda t: t + "1.0\n", "bal.count", "line 102"),
        (lambda t: t.replace("\n2 4 ", "\n2 x ", 1), "bal.number", "line 16"),
        (lambda t: t.replace("\n2 4 ", "\n2 nan ", 1), "bal.number", "line 16"),
        (lambda t: t.replace("\n2 4 ", "\n2 0_4 ", 1), "bal.number", "line 16"),
        (lambda t: t.replace("3 12 36", "3 1_2 36", 1), "bal.header", "line 1"),
        (lambda t: t.replace("\n2 4 ", "\n3 4 ", 1), "bal.index", "line 16"),
        (lambda t: t.replace("\n2 4 ", "\n2 12 ", 1), "bal.index", "line 16"),
        (lambda t: t.replace("\n2 4 ", "\n2 1.5 ", 1), "bal.index", "line 16"),
        (lambda t: "\n".join([*t.split("\n")[:43], "-400.0", *t.split("\n")[44:]]), "bal.focal", "line 44"),
    ],
)
def test_faults_name_their_line(tmp_path: Path, change: object, expected: str, place: str) -> None:
    path = tmp_path / "bundle.txt"
    path.write_text(change(text()))  # type: ignore[operator]
    with pytest.raises(InputError) as caught:
        read_bal(path)
    problem = caught.value.problems[0]
    assert problem.code == expected
    assert problem.file == "bundle.txt"
    assert problem.place == place


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "raw", [gzip.compress(b"3 12 36", mtime=0)[:-9], b"BZh9damaged", None], ids=["cut", "damaged", "missing"]
)
def test_unreadable_files_are_refused(tmp_path: Path, raw: bytes | None) -> None:
    path = tmp_path / "bundle.gz"
    if raw is not None:
        path.write_bytes(raw)
    with pytest.raises(InputError) as caught:
        read_bal(path)
    assert caught.value.problems[0].code == "bal.unreadable"


@pytest.mark.oracle
@pytest.mark.real_data
def test_ladybug_begins_at_the_cost_of_the_printed_model(real_data: Path) -> None:
    path = real_data / "bal" / "problem-49-7776-pre.txt.gz"
    data, problem = read_bal_data(path), compile_problem(read_bal(path))
    theirs = snavely(data.cameras[data.camera], data.points[data.point]) - data.xy
    found = problem.pixel_residuals(problem.start)
    assert len(found) == 31843
    assert float(np.sum(found**2)) == pytest.approx(float(np.sum(theirs**2)), rel=1e-12)
    assert [*map(str, read_bal(path).notes)] == ["10 points lie behind a camera"]
    assert len(read_bal(path, keep_behind=False).observations) == 31843 - 31
