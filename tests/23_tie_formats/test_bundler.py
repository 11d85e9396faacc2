"""Bundler and BAL: pixels follow Snavely's printed formula, models survive a round trip, faults name their line."""

from __future__ import annotations

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fg_orient.formats.exchange.bal import BalData, bal_data_of, frame_model_of, read_bal, read_bal_data, write_bal
from fg_orient.formats.exchange.bundler import read_bundler, write_bundler
from fg_orient.model.errors import InputError
from tests.support.changed_text import changed
from tests.support.frame_models import frame_model

MATRIX = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
T, POINT, F, K1, K2 = np.array([0.1, -0.2, -6.0]), np.array([0.3, -0.5, 0.7]), 900.0, -0.04, 0.01
BUNDLE = """# Bundle file v0.3
2 1
0 0 0
0 0 0
0 0 0
0 0 0
0 0 0
900 -0.04 0.01
0.36 0.48 -0.8
-0.8 0.6 0.0
0.48 0.64 0.6
0.1 -0.2 -6.0
0.3 -0.5 0.7
10 20 30
1 1 17 {x!r} {y!r}
"""


def snavely() -> tuple[float, float]:
    """Return x (right) and y (up from the middle) by the printed formulas.

    P = R X + t, p = -P / P_z, p' = f (1 + k1 |p|^2 + k2 |p|^4) p.
    """
    p = MATRIX @ POINT + T
    x, y = -p[:2] / p[2]
    r2 = x * x + y * y
    scale = F * (1.0 + K1 * r2 + K2 * r2 * r2)
    return float(scale * x), float(scale * y)


def written(folder: Path, old: str = "", new: str = "") -> Path:
    x, y = snavely()
    path = folder / "bundle.out"
    path.write_text(changed(BUNDLE.format(x=x, y=y), (old, new)))
    return path


@pytest.mark.oracle
def test_pixels_are_those_of_the_printed_formula_and_images_without_orientation_are_left_out(tmp_path: Path) -> None:
    data, images, notes = read_bundler(written(tmp_path))
    assert (images, *map(str, notes)) == ((1,), "left out: 1 image without orientation")
    model = frame_model_of(data, ["b.jpg"], [(601, 800)])
    assert np.abs(model.residuals_px()).max() < 1e-9
    x, y = snavely()
    # the middle of 601 x 800 pixels is line 300, half-way between samples 399 and 400
    assert (model.line[0], model.sample[0]) == (300.0 - y, 399.5 + x)
    assert model.cameras["b.jpg"].principal_px.tolist() == [300.0, 399.5]


def printed_pixels(data: BalData) -> np.ndarray:
    """Compute the same formula for all image points: x, y from the middle of each image."""
    cameras = data.cameras[data.camera]
    q = Rotation.from_rotvec(cameras[:, :3]).apply(data.points[data.point]) + cameras[:, 3:6]
    p = -q[:, :2] / q[:, 2:]
    r2 = np.sum(p**2, axis=1, keepdims=True)
    return cameras[:, 6:7] * (1.0 + cameras[:, 7:8] * r2 + cameras[:, 8:9] * r2**2) * p


def model_numbers(data: BalData) -> list[np.ndarray]:
    return [data.camera, data.point, data.xy, data.cameras, data.points]


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["bundle.txt", "bundle.txt.gz", "bundle.txt.bz2"])
def test_bal_is_written_and_read_again(name: str, tmp_path: Path) -> None:
    """A BAL file has the published order and is read unchanged.

    The order is counts, image points, nine numbers of each camera, points.
    """
    data, lost = bal_data_of(frame_model(("none", "k1", "radial")))
    assert lost == ("names of images, points and cameras; sizes of images; principal points",)
    write_bal(tmp_path / name, data)
    opened = {".txt": open, ".gz": gzip.open, ".bz2": bz2.open}[Path(name).suffix]
    with opened(tmp_path / name, "rt") as stream:
        numbers = np.array(stream.read().split(), float)
    m, n, rows = len(data.cameras), len(data.points), len(data.xy)
    assert numbers[:3].tolist() == [m, n, rows]
    table = np.column_stack([data.camera, data.point, data.xy])
    assert np.array_equal(numbers[3:], np.concatenate([table.ravel(), data.cameras.ravel(), data.points.ravel()]))
    for ours, again in zip(model_numbers(data), model_numbers(read_bal_data(tmp_path / name)), strict=True):
        assert np.array_equal(ours, again)
    assert len(read_bal(tmp_path / name).images) == 4
    with pytest.raises(InputError, match="exists already"):
        write_bal(tmp_path / name, data)


@pytest.mark.oracle
def test_bundler_is_written_and_read_again(tmp_path: Path) -> None:
    """A Bundler file has the published order and is read unchanged, with rotations to 1e-14.

    A camera has the focal length, k1, k2, the rotation row by row (as scipy's) and the translation; the points follow.
    """
    data, _ = bal_data_of(frame_model(("none", "k1", "radial")))
    write_bundler(tmp_path / "bundle.out", data)
    numbers = np.array((tmp_path / "bundle.out").read_text().split("\n", 1)[1].split(), float)
    m, n = len(data.cameras), len(data.points)
    assert numbers[:2].tolist() == [m, n]
    cameras, at = numbers[2 : 2 + 15 * m].reshape(m, 15), 2 + 15 * m
    assert np.array_equal(cameras[:, :3], data.cameras[:, 6:])
    turned = Rotation.from_rotvec(data.cameras[:, :3]).as_matrix().reshape(m, 9)
    assert np.abs(cameras[:, 3:12] - turned).max() < 1e-14
    assert np.array_equal(cameras[:, 12:], data.cameras[:, 3:6])
    for j, point in enumerate(data.points):
        own, count = data.point == j, int(numbers[at + 6])
        assert np.array_equal(numbers[at : at + 3], point)
        rays = numbers[at + 7 : at + 7 + 4 * count].reshape(count, 4)
        assert np.array_equal(rays[:, [0, 2, 3]], np.column_stack([data.camera, data.xy])[own])
        at += 7 + 4 * count
    assert at == len(numbers)
    again, images, notes = read_bundler(tmp_path / "bundle.out")
    assert (images, notes) == ((0, 1, 2, 3), ())
    order = np.argsort(data.point, kind="stable")
    for ours, theirs in ((data.camera, again.camera), (data.point, again.point), (data.xy, again.xy)):
        assert np.array_equal(ours[order], theirs)
    assert np.array_equal(data.points, again.points)
    assert np.abs(data.cameras - again.cameras).max() < 1e-14
    with pytest.raises(InputError, match="exists already"):
        write_bundler(tmp_path / "bundle.out", data)


@pytest.mark.oracle
def test_residuals_survive_the_way_there_and_back() -> None:
    model = frame_model(("none", "k1", "radial"))
    printed = np.linalg.norm(printed_pixels(bal_data_of(model)[0]) - bal_data_of(model)[0].xy, axis=1)
    assert np.sort(printed) == pytest.approx(np.sort(np.linalg.norm(model.residuals_px(), axis=1)), abs=1e-9)
    back = frame_model_of(bal_data_of(model)[0])
    assert np.abs(back.residuals_px() - model.residuals_px()).max() < 1e-9
    centred = frame_model(("k1",), principal=False)
    same = frame_model_of(bal_data_of(centred)[0], sizes=[(1000, 1500)] * 2)
    assert np.abs(same.line - centred.line).max() < 1e-12
    assert np.abs(same.sample - centred.sample).max() < 1e-12


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("camera", "value"), [("k3", "k3 -0.004 p1 0.0003 p2 -0.0002"), ("brown", "p1 0.0003 p2 -0.0002")]
)
def test_coefficients_that_these_files_do_not_have_are_refused(camera: str, value: str) -> None:
    with pytest.raises(InputError) as error:
        bal_data_of(frame_model((camera,)), "new.out")
    (found,) = error.value.problems
    assert (found.code, found.file, found.place, found.value) == ("bundle.camera", "new.out", "camera 1", value)


FAULTS = [
    ("v0.3", "v0.2", "interchange.cells", "line 1"),
    ("2 1\n", "2 1.5\n", "interchange.cells", "line 2"),
    ("2 1\n", "2 2\n", "bundle.lines", ""),
    ("2 1\n", "2000000000 1\n", "bundle.lines", ""),
    ("900 ", "900,0 ", "interchange.cells", "line 8"),
    ("0.36", "0.37", "interchange.cells", "line 9"),
    ("0.3 -0.5", "nan -0.5", "interchange.cells", "line 13"),
    ("1 1 17", "2 1 17", "interchange.cells", "line 15"),
    ("1 1 17", "1 2 17", "interchange.cells", "line 15"),
    ("1 1 17", "1 1", "interchange.cells", "line 15"),
    ("1 1 17", "1 0.5 17", "interchange.cells", "line 15"),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("old", "new", "code", "place"), FAULTS)
def test_faults_name_their_line(old: str, new: str, code: str, place: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        read_bundler(written(tmp_path, old, new))
    (found,) = error.value.problems
    assert (found.code, found.place, found.file) == (code, place, "bundle.out")


@pytest.mark.oracle
@pytest.mark.real_data
def test_ladybug_is_a_frame_model_and_comes_back(real_data: Path, tmp_path: Path) -> None:
    data = read_bal_data(real_data / "bal" / "problem-49-7776-pre.txt.gz")
    model = frame_model_of(data)
    squares = np.sum(model.residuals_px() ** 2, axis=1)
    behind = np.isin(model.point, model.point[np.isnan(squares)])
    apart = np.linalg.norm(printed_pixels(data) - data.xy, axis=1)[~behind]
    assert np.linalg.norm(model.residuals_px(), axis=1)[~behind] == pytest.approx(apart, abs=1e-8)
    # half the sum of squares without points that begin behind a camera, as the adjustment has it (tests/49)
    assert 0.5 * squares[~behind].sum() == pytest.approx(850802.09, abs=0.01)
    back, _ = bal_data_of(model)
    assert np.abs(back.xy - data.xy).max() < 1e-9
    assert np.abs(back.cameras - data.cameras).max() < 1e-12
    write_bundler(tmp_path / "bundle.out", data)
    again, _, _ = read_bundler(tmp_path / "bundle.out")
    assert np.abs(again.cameras - data.cameras).max() < 1e-12
