"""Frame images with shear, aspect, fisheye lenses and further terms agree with OpenCV and pycolmap."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fg_orient as fg
from benchmarks.frames import Size, network
from fg_orient.formats.exchange.colmap_text import FIRST_PIXEL, interior_of, parameters_of
from fg_orient.formats.metadata.frame import read_camera, write_camera
from fg_orient.sensors.frame import MEASURED_TO_IDEAL, FrameCamera, FrameSensor
from fg_orient.sensors.frame_unknowns import NAMES
from fg_orient.sensors.interior import Interior

ROTATION = Rotation.from_euler("xyz", [0.2, -0.1, 0.4]).as_matrix()
CENTRE = np.array([3.0, -2.0, 1.0])
LENS = {"fisheye_1": 0.05, "fisheye_2": -0.01, "fisheye_3": 3e-3, "fisheye_4": -4e-4}


def points(wide: float, n: int = 200) -> np.ndarray:
    """Return the ground points in front of the camera, up to ``wide`` in X/Z and Y/Z."""
    rng = np.random.default_rng(4)
    seen = np.column_stack([rng.uniform(-wide, wide, (n, 2)), np.ones(n)]) * rng.uniform(2.0, 9.0, (n, 1))
    return np.asarray(seen @ ROTATION + CENTRE)


@pytest.mark.oracle
def test_fisheye_is_that_of_opencv() -> None:
    """The fisheye camera projects by OpenCV's formula within 1e-6 px, and its rays return to the points.

    The formula is theta_d = theta (1 + k1 theta^2 + ...), x' = theta_d/r x.
    """
    camera = FrameCamera(ROTATION, CENTRE, 800.0, np.array([500.0, 700.0]), aspect=0.02, is_fisheye=True, further=LENS)
    sensor, ground = FrameSensor(camera, 1000, 1400, georeferenced=False), points(3.0)
    q = (ground - CENTRE) @ ROTATION.T
    x = q[:, :2] / q[:, 2:]
    r = np.linalg.norm(x, axis=1, keepdims=True)
    theta = np.arctan(r)
    k1, k2, k3, k4 = LENS.values()
    bent = theta * (1.0 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8) / r * x
    expected = np.array([700.0, 500.0]) + np.array([800.0 * 1.02, 800.0]) * bent
    line, sample = sensor.project(ground)
    assert np.column_stack([sample, line]) == pytest.approx(expected, abs=1e-6)
    start, direction = sensor.rays(line, sample)
    depth = np.einsum("ni,ni->n", ground - start, direction)
    assert start + depth[:, None] * direction == pytest.approx(ground, abs=1e-9)


@pytest.mark.oracle
def test_two_focal_lengths_are_those_of_opencv() -> None:
    """A camera with an aspect projects by OpenCV's formula for fx and fy within 1e-6 px.

    The formula is x'' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), u = fx x'' + cx.
    """
    distortion = np.array([-0.1, 0.02, 1e-3, 5e-4, -3e-4])  # k1 k2 k3 p1 p2
    camera = FrameCamera(ROTATION, CENTRE, 800.0, np.array([500.0, 700.0]), distortion, aspect=-0.01)
    ground = points(0.6)
    q = (ground - CENTRE) @ ROTATION.T
    x, y = (q[:, :2] / q[:, 2:]).T
    k1, k2, k3, p1, p2 = distortion
    r = x * x + y * y
    radial = 1.0 + k1 * r + k2 * r**2 + k3 * r**3
    expected = np.column_stack([
        792.0 * (x * radial + 2.0 * p1 * x * y + p2 * (r + 2.0 * x * x)) + 700.0,
        800.0 * (y * radial + p1 * (r + 2.0 * y * y) + 2.0 * p2 * x * y) + 500.0,
    ])  # fmt: skip
    line, sample = FrameSensor(camera, 1000, 1400, georeferenced=False).project(ground)
    assert np.column_stack([sample, line]) == pytest.approx(expected, abs=1e-6)


@pytest.mark.oracle
@pytest.mark.parametrize(("model", "values"), [
    ("PINHOLE", (900.0, 910.0, 700.0, 500.0)), ("OPENCV", (900.0, 910.0, 700.0, 500.0, -0.1, 0.02, 1e-3, -5e-4)),
    ("OPENCV_FISHEYE", (900.0, 910.0, 700.0, 500.0, 0.05, -0.01, 3e-3, -4e-4)),
])  # fmt: skip
def test_cameras_of_colmap(model: str, values: tuple[float, ...]) -> None:
    """Each COLMAP model projects as pycolmap within 1e-6 px, and is written with the same numbers."""
    pycolmap = pytest.importorskip("pycolmap")
    interior = interior_of(model, (1400, 1000), values, "a")
    sensor = FrameSensor(interior.camera(ROTATION, CENTRE), 1000, 1400, georeferenced=False)
    ground = points(0.6)
    line, sample = sensor.project(ground)
    camera = pycolmap.Camera(model=model, width=1400, height=1000, params=list(values))
    expected = camera.img_from_cam((ground - CENTRE) @ ROTATION.T)
    assert np.column_stack([sample, line]) + FIRST_PIXEL == pytest.approx(expected, abs=1e-6)
    kind, numbers, error = parameters_of(interior)
    assert kind == model and numbers == pytest.approx(values, rel=1e-14, abs=0.0) and error == 0.0


@pytest.mark.truth
@pytest.mark.parametrize("corrects", [False, True])
def test_further_coefficients_are_recovered(corrects: bool) -> None:
    """An adjustment without noise returns shear, affinity and a4 within 1e-9, in both directions of distortion."""
    block, _ = network(Size(12, 60, 8, 8, 2, 0.0))
    true, wrong = {"shear": 2e-3, "affinity_a": -1e-3, "a4": 4e-3}, []
    o, images, (line, sample) = block.observations, [], np.empty((2, len(block.observations)))
    rng = np.random.default_rng(9)
    ground = block.points.known.ecef_m
    for k, image in enumerate(block.images):
        own = image.sensor.camera  # type: ignore[attr-defined]
        own = replace(own, model=MEASURED_TO_IDEAL if corrects else own.model, unit_px=None, further=true,
                      sigma={name: s for name, s in own.sigma.items() if name[0] in "rc"} | dict.fromkeys(true, 1e-3),
                      shared=dict.fromkeys(true, "camera 1"), nominal_px=1.0)  # fmt: skip
        seen = o.image == k
        line[seen], sample[seen] = FrameSensor(own, 2000, 3000, georeferenced=False).project(ground[o.point[seen]])
        away = Rotation.from_rotvec(rng.normal(scale=1e-3, size=3)).as_matrix()
        start = replace(own, further=dict.fromkeys(true, 0.0), rotation=away @ own.rotation)
        images.append(fg.Image(image.id, FrameSensor(start, 2000, 3000, georeferenced=False)))
    solution = fg.adjust(replace(
        block, images=tuple(images), observations=replace(o, line=line, sample=sample), extra=(),
    ))  # fmt: skip
    assert solution.chi2 < 1e-12
    for name, value in true.items():
        found = solution.correction("p0")[list(NAMES).index(name)]
        wrong.append(found - value)
    assert np.abs(wrong).max() < 1e-9


@pytest.mark.behaviour
def test_camera_files_hold_every_term(tmp_path: Path) -> None:
    interior = Interior(1000, 1400, 800.0, np.array([500.0, 700.0]), np.array([0.1, 0, 0, 0, 0]), aspect=0.01, name="a",
                        further={**LENS, "shear": 1e-3}, is_fisheye=True)  # fmt: skip
    write_camera(tmp_path / "camera.toml", interior)
    again = read_camera(tmp_path / "camera.toml")
    assert again.further == interior.further and again.is_fisheye and again.aspect == 0.01
    text = (tmp_path / "camera.toml").read_text("utf-8").replace("shear", "sheer")
    (tmp_path / "camera.toml").write_text(text, "utf-8")
    with pytest.raises(fg.InputError, match="sheer") as error:
        read_camera(tmp_path / "camera.toml")
    assert len(error.value.problems) == 1
