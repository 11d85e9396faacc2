"""COLMAP text models: pixels follow COLMAP's formulas, models survive a round trip, faults name their line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.exchange.colmap_text import (
    FILES,
    MODELS,
    interior_of,
    parameters_of,
    read_colmap_text,
    write_colmap_text,
)
from fg_orient.formats.frame_model import FrameModel
from fg_orient.model.errors import InputError
from fg_orient.sensors.frame import MEASURED_TO_IDEAL
from fg_orient.sensors.interior import Interior
from tests.support.changed_text import change_file
from tests.support.frame_models import frame_model

CAMERAS = """# cameras
1 SIMPLE_PINHOLE 1500 1000 1200 750 500
2 PINHOLE 1500 1000 1200 1200 749 501
3 SIMPLE_RADIAL 1500 1000 1200 750 500 -0.05
4 RADIAL 1500 1000 1200 750 500 -0.05 0.02
5 OPENCV 1500 1000 1200 1200 750 500 -0.05 0.02 0.0003 -0.0002
6 FULL_OPENCV 1500 1000 1200 1200 750 500 -0.05 0.02 0.0003 -0.0002 -0.004 0 0 0
7 OPENCV_FISHEYE 1500 1000 1200 1210 750 500 0.05 -0.01 0.003 -0.0004
"""
POSE = "0.7 0.1 -0.5 0.5 0.2 -0.3 4.0"  # quaternion of length 1, translation
POINT = (0.3, -0.4, 0.5)


def rotated(q: tuple[float, ...], v: tuple[float, ...]) -> np.ndarray:
    """Return v turned by a Hamilton quaternion w x y z: v + 2 u x (u x v + w v)."""
    u, w = np.array(q[1:]), q[0]
    return np.array(v) + 2.0 * np.cross(u, np.cross(u, v) + w * np.array(v))


def colmap_pixel(
    line: str, pose: Sequence[float] = tuple(map(float, POSE.split())), point: tuple[float, ...] = POINT
) -> tuple[float, float]:
    """Return x, y of a point by COLMAP's documented models, written out for each, from a line of cameras.txt."""
    _, model, _, _, *numbers = line.split()
    p = [float(n) for n in numbers]
    x, y, z = rotated(tuple(pose[:4]), point) + pose[4:]
    u, v = x / z, y / z
    r2 = u * u + v * v
    if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        f, cx, cy, *k = [*p, 0.0, 0.0]
        radial = 1.0 + k[0] * r2 + k[1] * r2 * r2
        return f * u * radial + cx, f * v * radial + cy
    if model == "OPENCV_FISHEYE":
        fx, fy, cx, cy, *k = p
        theta = np.arctan(np.sqrt(r2))
        bent = theta * (1.0 + sum(c * theta ** (2 * n) for n, c in enumerate(k, start=1))) / np.sqrt(r2)
        return fx * u * bent + cx, fy * v * bent + cy
    fx, fy, cx, cy, k1, k2, p1, p2, k3, *_ = [*p, *[0.0] * 8]
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    du, dv = 2 * p1 * u * v + p2 * (r2 + 2 * u * u), 2 * p2 * u * v + p1 * (r2 + 2 * v * v)
    return fx * (u * radial + du) + cx, fy * (v * radial + dv) + cy


def model_of(camera: str, folder: Path) -> FrameModel:
    x, y = map(float, colmap_pixel(camera))
    (folder / FILES[0]).write_text(camera + "\n")
    (folder / FILES[1]).write_text(f"4 {POSE} {camera.split()[0]} a b.jpg\n1 2 -1 {x!r} {y!r} 9\n")
    (folder / FILES[2]).write_text(f"9 {' '.join(map(repr, POINT))} 0 0 0 0.5 4 1\n")
    return read_colmap_text(folder)


@pytest.mark.oracle
@pytest.mark.parametrize("camera", CAMERAS.splitlines()[1:], ids=lambda line: line.split()[1])
def test_pixels_are_those_of_colmaps_formulas(camera: str, tmp_path: Path) -> None:
    model = model_of(camera, tmp_path)
    assert np.abs(model.residuals_px()).max() < 1e-9
    assert (model.poses[0].name, model.point_ids) == ("a b.jpg", ("9",))
    assert tuple(map(str, model.notes)) == ("left out: 1 keypoint without a point",)
    x, y = colmap_pixel(camera)
    assert (model.line[0], model.sample[0]) == (y - 0.5, x - 0.5)


@pytest.mark.behaviour
def test_the_first_pixel_is_at_one_half(tmp_path: Path) -> None:
    camera = interior_of("SIMPLE_PINHOLE", (1500, 1000), (1200.0, 0.5, 0.5), "1")
    assert camera.principal_px.tolist() == [0.0, 0.0]
    assert (camera.n_lines, camera.n_samples) == (1000, 1500)
    assert parameters_of(camera) == ("SIMPLE_PINHOLE", (1200.0, 0.5, 0.5), 0.0)


@pytest.mark.oracle
def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    """A COLMAP model is read unchanged, and COLMAP's formulas applied to its three files give the model's residuals."""
    model = frame_model()
    assert write_colmap_text(tmp_path / "new" / "model", model) == ()
    again = read_colmap_text(tmp_path / "new" / "model")
    kinds = [line.split()[1] for line in (tmp_path / "new/model/cameras.txt").read_text().splitlines()[1:]]
    assert kinds == ["SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"]
    for name, camera in model.cameras.items():
        other = again.cameras[name]
        assert np.array_equal(camera.distortion, other.distortion)
        assert np.array_equal(camera.principal_px, other.principal_px)
        assert (camera.focal_px, camera.n_lines, camera.n_samples) == (other.focal_px, other.n_lines, other.n_samples)
    assert np.array_equal(again.points_m, model.points_m)
    for pose, other in zip(model.poses, again.poses, strict=True):
        assert (pose.name, pose.camera) == (other.name, other.camera)
        assert np.abs(pose.rotation - other.rotation).max() < 1e-15
        assert np.abs(pose.centre_m - other.centre_m).max() < 1e-14
    order = np.lexsort((model.point, model.image))
    cameras, images, points = ((tmp_path / "new/model" / name).read_text().splitlines() for name in FILES)
    camera_of = {line.split()[0]: line for line in cameras[1:] if line}
    ground = {line.split()[0]: tuple(map(float, line.split()[1:4])) for line in points[1:] if line}
    left = []
    for head, keypoints in zip(images[2::2], images[3::2], strict=True):
        words, cells = head.split(), keypoints.split()
        pose = [float(n) for n in words[1:8]]
        for x, y, name in zip(cells[::3], cells[1::3], cells[2::3], strict=True):
            expected = colmap_pixel(camera_of[words[8]], pose, ground[name])
            left.append(np.hypot(float(x) - expected[0], float(y) - expected[1]))
    assert left == pytest.approx(np.linalg.norm(model.residuals_px()[order], axis=1), abs=1e-9)
    assert np.array_equal(again.image, model.image[order])
    assert np.array_equal(again.point, model.point[order])
    # half a pixel is added and taken away again: one rounding at most
    assert np.abs(again.line - model.line[order]).max() < 1e-12
    assert np.abs(again.sample - model.sample[order]).max() < 1e-12


@pytest.mark.consistency
def test_a_polynomial_of_the_other_direction_is_fitted_and_its_error_told(tmp_path: Path) -> None:
    model = frame_model(("none",))
    camera = Interior(
        1000, 1500, 1200.0, np.array([500.0, 750.0]), np.array([-0.05, 0.02, 0.0, 3e-4, -2e-4]), MEASURED_TO_IDEAL
    )  # fmt: skip
    model.cameras["1"] = camera  # type: ignore[index]
    (told,) = write_colmap_text(tmp_path, model)
    assert told.startswith("camera 1: distortion fitted the other way round, up to ")
    found = read_colmap_text(tmp_path).cameras["1"]
    line, sample = (g.ravel() for g in np.meshgrid(np.linspace(0, 999, 7), np.linspace(0, 1499, 7)))
    apart = np.linalg.norm(found.ideal(line, sample) - camera.ideal(line, sample), axis=1).max() * 1200.0
    assert apart <= float(told.split()[-5]) * 1.05


@pytest.mark.behaviour
def test_nothing_is_overwritten_unless_allowed(tmp_path: Path) -> None:
    model = frame_model(("none",))
    write_colmap_text(tmp_path, model)
    with pytest.raises(InputError) as error:
        write_colmap_text(tmp_path, model)
    assert error.value.problems[0].code == "output.exists"
    write_colmap_text(tmp_path, model, overwrite=True)


@pytest.mark.behaviour
def test_names_that_colmap_would_cut_are_refused(tmp_path: Path) -> None:
    model = frame_model(("none",))
    model = replace(model, poses=(replace(model.poses[0], name="a b.jpg"), *model.poses[1:]))
    with pytest.raises(InputError, match=r"'a b\.jpg'.*a NAME without blanks"):
        write_colmap_text(tmp_path, model)
    assert not list(tmp_path.iterdir())


def edited(name: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        change_file(folder / name, (old, new))

    return edit


FAULTS = [
    (edited("cameras.txt", "OPENCV", "FOV"), "colmap.model", "line 1"),
    (edited("cameras.txt", "-0.0002", ""), "interchange.cells", "line 1"),
    (
        edited(
            "cameras.txt",
            "OPENCV 1500 1000 1200 1200 750 500 -0.05 0.02 0.0003 -0.0002",
            "FULL_OPENCV 1500 1000 1200 1200 750 500 -0.05 0.02 0.0003 -0.0002 0 1e-3 0 0",
        ),
        "colmap.camera",
        "line 1",
    ),
    (edited("cameras.txt", "0.02", "0,02"), "interchange.cells", "line 1"),
    (edited("cameras.txt", "1500", "1_500"), "interchange.cells", "line 1"),
    (edited("cameras.txt", "\n", "\n5 SIMPLE_PINHOLE 9 9 1 1 1\n"), "interchange.twice", "line 2"),
    (edited("images.txt", " 5 a b", " 7 a b"), "colmap.reference", "line 1"),
    (edited("images.txt", "4 0.7", "4 0.8"), "interchange.cells", "line 1"),
    (edited("images.txt", " a b.jpg", ""), "interchange.cells", "line 1"),
    (edited("images.txt", "1 2 -1", "1 nan -1"), "interchange.cells", "line 2"),
    (edited("images.txt", "1 2 -1", "1 -1"), "interchange.cells", "line 2"),
    (edited("images.txt", " 9\n", " 8\n"), "colmap.reference", ""),
    (edited("images.txt", " 9\n", " -1\n"), "colmap.track", ""),
    (edited("points3D.txt", "0.5 4 1", "0.5 4"), "interchange.cells", "line 1"),
    (edited("points3D.txt", "-0.4", "inf"), "interchange.cells", "line 1"),
    (edited("points3D.txt", "\n", "\n9 0 0 0 0 0 0 0\n"), "interchange.twice", ""),
    (lambda folder: (folder / "points3D.txt").unlink(), "table.missing_file", ""),
    (lambda folder: (folder / "images.txt").write_bytes(b"1 \xfc"), "table.not_utf8", "line 1"),
]


@pytest.mark.behaviour
@pytest.mark.parametrize(("edit", "code", "place"), FAULTS)
def test_faults_name_their_line(edit: Callable[[Path], None], code: str, place: str, tmp_path: Path) -> None:
    model_of(CAMERAS.splitlines()[5], tmp_path)
    edit(tmp_path)
    with pytest.raises(InputError) as error:
        read_colmap_text(tmp_path)
    (found,) = error.value.problems
    assert found.code == code
    assert place in found.place
    assert found.file in FILES


@pytest.mark.behaviour
def test_an_image_without_keypoints_has_an_empty_line_and_windows_ends_are_read(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("\ufeff" + CAMERAS, newline="\r\n")
    (tmp_path / "images.txt").write_text(f"1 {POSE} 1 a\n\n2 {POSE} 1 b\n18 19 18446744073709551615\n", newline="\r\n")
    (tmp_path / "points3D.txt").write_text("# none\n", newline="\r\n")
    model = read_colmap_text(tmp_path)
    assert [pose.name for pose in model.poses] == ["a", "b"]
    assert len(model.image) == 0
    assert set(MODELS) == {line.split()[1] for line in CAMERAS.splitlines()[1:]}
