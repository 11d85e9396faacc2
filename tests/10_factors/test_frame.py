"""The frame camera is compared with scipy's rotations and the printed formulas, the batch with the equation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from factors.cameras import frame, frame_camera, frame_corrections
from factors.cameras.frame_camera import CAMERA
from fg_orient.kernels.batch import batch
from tests.support.equation_examples import frame_collinearity


def camera_of(rng: np.random.Generator, distortion: np.ndarray) -> np.ndarray:
    """Return a camera that looks up the Z axis of the ground."""
    out = np.zeros(CAMERA.size)
    frame_camera.turned(rng.normal(scale=0.1, size=3), np.eye(3).ravel(), out)
    out[CAMERA.centre], out[CAMERA.focal] = rng.normal(size=3), 1200.0
    out[CAMERA.principal], out[CAMERA.distortion] = (30.0, -20.0), distortion
    return out


@pytest.mark.oracle
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 9.9e-3, 1.01e-2, 0.5, 3.1, 6.0])
def test_rotation_equals_scipy(angle: float) -> None:
    """Rotation and derivative of a frame camera equal scipy's on both sides of the limit of the series, 0.01 rad."""
    rng = np.random.default_rng(1)
    axis, start = rng.normal(size=3), Rotation.random(random_state=2)
    w = angle * axis / np.linalg.norm(axis)
    out = np.zeros(CAMERA.size)
    frame_camera.turned(w, start.as_matrix().ravel(), out)
    assert np.abs(out[CAMERA.rotation].reshape(3, 3) - (Rotation.from_rotvec(w) * start).as_matrix()).max() < 1e-15
    step = 1e-6
    ends = []
    for k in range(3):
        a, b = (Rotation.from_rotvec(w + sign * step * np.eye(3)[k]) for sign in (1.0, -1.0))
        ends.append((a * b.inv()).as_rotvec() / (2.0 * step))
    assert np.abs(out[CAMERA.jacobian].reshape(3, 3) - np.stack(ends, axis=1)).max() < 1e-8


@pytest.mark.oracle
def test_residual_equals_the_printed_formulas() -> None:
    """The frame residual equals OpenCV's formulas or Brown's correction, written with numpy, within 1e-11."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        e = frame_collinearity(rng)
        (observed, weight), start = e.record[:4].reshape(2, 2), e.record[frame.RECORD.rotation].reshape(3, 3)
        interior = e.record[frame.RECORD.centre.start :]
        d = np.zeros(frame.N_UNKNOWNS + 3)  # in some draws no pixel depends on an unknown
        d[e.setup[0].astype(int)] = e.setup[1] * e.unknowns[0]
        centre, (f, cx, cy, k1, k2, k3, p1, p2, aspect) = interior[:3] + d[3:6], interior[3:12] + d[6:15]
        q = Rotation.from_rotvec(d[:3]).apply(start @ (e.unknowns[1] - centre))
        ideal, unit = q[:2] / q[2], interior[12]
        away = (observed[1] - cx) * (1.0 + aspect), observed[0] - cy
        x, y = np.array(away) / unit if unit else ideal
        r2 = x**2 + y**2
        radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        sample = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2)
        line = y * radial + p1 * (r2 + 2.0 * y**2) + 2.0 * p2 * x * y
        computed = f * ideal[::-1] if unit else f * np.array([line, sample]) + [cy, cx]
        given = unit * np.array([line, sample]) if unit else observed
        found = frame.residual(e.record, e.setup, *e.unknowns)
        expected = weight * (computed - given)
        assert np.abs(found - expected).max() < 1e-11 * max(1.0, float(np.abs(computed).max() * weight.max()))


def with_nothing_more(camera: np.ndarray) -> np.ndarray:
    """Return the camera of ``frame_corrections`` whose further corrections are all neutral."""
    further = np.zeros(frame_corrections.CAMERA.size - CAMERA.size)
    further[-3:] = 1.0  # sign, nominal principal distance, radius
    return np.append(camera, further)


@pytest.mark.oracle
def test_ideal_directions_invert_the_distortion_and_stop_at_its_fold() -> None:
    rng = np.random.default_rng(4)
    camera = camera_of(rng, np.array([-0.2, 0.05, -0.01, 1e-3, -2e-3]))
    ideal = rng.uniform(-0.6, 0.6, (50, 2))
    (x, y), (k1, k2, k3, p1, p2) = ideal.T, camera[15:20]  # as printed
    r2 = x**2 + y**2
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    sample = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2)
    line = y * radial + p1 * (r2 + 2.0 * y**2) + 2.0 * p2 * x * y
    pixels = 1200.0 * np.stack([line, sample], axis=1) + camera[14:12:-1]
    ours = np.array([frame_camera.pixel(camera, *direction) for direction in ideal])
    assert np.abs(ours - pixels).max() < 1e-11
    found = frame_corrections.directions(with_nothing_more(camera), *pixels.T)
    assert np.abs(found - ideal).max() < 1e-12
    camera[CAMERA.distortion] = -0.3, 0.0, 0.0, 0.0, 0.0  # x (1 - 0.3 x^2) is largest at 1.054: 0.703
    samples = camera[CAMERA.sample] + 1200.0 * np.array([0.70, 0.71])
    beyond = frame_corrections.directions(with_nothing_more(camera), np.full(2, camera[CAMERA.line]), samples)
    assert beyond[0, 0] == pytest.approx(1.0, abs=0.1)
    assert np.isnan(beyond[1]).all()


def rows_of(parts: list[tuple[int, int]], corrects: bool = False, spoil: bool = False) -> tuple[np.ndarray, list[int]]:
    """Return values and Jacobians of 30 rays of 3 images, computed in parts, and what each part returns."""
    rng = np.random.default_rng(5)
    e = frame_collinearity(rng)
    while e.setup.shape[1] != 9:
        e = frame_collinearity(rng)
    n, (k, point) = 30, (9, e.unknowns[1])
    records = np.tile(e.record, (n, 1))
    records[:, frame.RECORD.unit] = 900.0 if corrects else 0.0
    records[:, [frame.RECORD.line, frame.RECORD.sample]] += rng.normal(size=(n, 2))
    ground = point + rng.normal(size=(10, 3))
    image, places = np.tile(np.arange(3), 10), np.repeat(np.arange(10), 3)
    for i in range(3):
        records[image == i, frame.RECORD.centre] += rng.normal(size=3)
    wide = rng.normal(size=(3, k))
    if spoil:
        ground[4] = np.nan
    rows, columns = batch(frame.FRAME_COLLINEARITY, e.setup, records)
    value, d_image, d_ground = np.full((n, 2), 7.0), np.full((n, 2, k), 7.0), np.full((n, 2, 3), 7.0)
    order, found = np.arange(n), []
    scaled = wide * columns.scale
    for lo, hi in parts:
        found.append(rows(
            lo, hi, order, records, order, image, places, columns.setup, 1, np.ones((n, 1)), scaled, ground, value,
            d_image, d_ground, True,
        ))  # fmt: skip
    if not spoil:
        for a in range(n):
            ours = frame.FRAME_COLLINEARITY.kernel(records[a], e.setup, wide[image[a]], ground[places[a]], True)
            # products and sums may fuse in the batch: some roundings
            for mine, batched in zip(ours, (value[a], d_image[a], d_ground[a]), strict=True):
                assert np.abs(mine - batched).max() <= 1e-13 * max(1.0, float(np.abs(mine).max()) * 10.0)
    return np.concatenate([value, d_image.reshape(n, -1), d_ground.reshape(n, -1)], axis=1), found


@pytest.mark.consistency
@pytest.mark.parametrize("corrects", [False, True])
def test_batch_rows_equal_the_equation_and_do_not_depend_on_the_parts(corrects: bool) -> None:
    whole, found = rows_of([(0, 30)], corrects)
    assert found == [-1]
    parts, found = rows_of([(17, 30), (0, 5), (5, 17)], corrects)
    assert found == [-1] * 3
    assert np.array_equal(whole, parts)


@pytest.mark.behaviour
def test_batch_rows_report_the_first_ray_that_is_not_finite() -> None:
    assert rows_of([(0, 13), (13, 30)], spoil=True)[1] == [12, 13]
