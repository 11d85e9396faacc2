"""A note states that distortion terms fit better in the other direction of the polynomial."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.closerange.bundle import BundlePhoto, adjust_bundle
from fg_orient.closerange.photo import PhotoInterior
from fg_orient.orientation.camera_direction import turned_block, turned_camera
from fg_orient.sensors.frame import IDEAL_TO_MEASURED, MEASURED_TO_IDEAL, FrameCamera, FrameSensor
from tests.support.calibration import FOCAL_PX, MIDDLE, NOISE_PX, calibration_block

DIRECTIONS = (IDEAL_TO_MEASURED, MEASURED_TO_IDEAL)
WORDS = {IDEAL_TO_MEASURED: "ideal to measured", MEASURED_TO_IDEAL: "measured to ideal"}


def notes(solution: fg.Solution) -> list[str]:
    return [str(found) for found in solution.findings if found.code == "camera.direction"]


@pytest.mark.truth
@pytest.mark.parametrize("priors", [True, False])
@pytest.mark.parametrize("k1", [-0.1, 0.1])
@pytest.mark.parametrize("true", DIRECTIONS)
def test_the_true_direction_is_named(true: str, k1: float, priors: bool) -> None:
    (other,) = (model for model in DIRECTIONS if model != true)
    solution = fg.adjust(calibration_block((k1, 0, 0, 0, 0), true, other, priors=priors))
    right = fg.adjust(calibration_block((k1, 0, 0, 0, 0), true, true, priors=priors))
    (note,) = notes(solution)
    assert f"fit significantly better from {WORDS[true]} coordinates: sigma0 is {right.sigma0:.4g}" in note
    assert f"from {WORDS[other]} {solution.sigma0:.4g}" in note
    assert not notes(right)


@pytest.mark.truth
@pytest.mark.parametrize("true", DIRECTIONS)
def test_no_false_alarm_on_clean_data(true: str) -> None:
    """Ten blocks adjusted in their true direction give no note, although their sigmas are three times too small."""
    for seed in range(5):
        for k1 in (-0.05, 0.0):
            solution = fg.adjust(calibration_block((k1, 0, 0, 0, 0), true, true, seed=seed, sigma_px=NOISE_PX / 3.0))
            assert not solution.global_test().accepted  # type: ignore[union-attr]
            assert not notes(solution)


@pytest.mark.truth
@pytest.mark.parametrize("k1", [-0.08, 0.08])
@pytest.mark.parametrize("true", DIRECTIONS)
def test_the_scale_of_the_corrected_image_decides_nothing(true: str, k1: float) -> None:
    """With noise of 5 px there is no note, although residuals of corrected coordinates differ by a quarter.

    Such noise hides the direction.
    """
    for seed in range(3):
        block = calibration_block((k1, 0, 0, 0, 0), true, true, seed=seed, sigma_px=1.0, noise_px=5.0)
        assert not notes(fg.adjust(block))


@pytest.mark.truth
@pytest.mark.parametrize("true", DIRECTIONS)
def test_no_note_without_a_difference(true: str) -> None:
    """A weak distortion, which fits equally well in both directions, gives no note."""
    (other,) = (model for model in DIRECTIONS if model != true)
    for seed in range(3):
        block = calibration_block((-0.002, 0, 0, 0, 0), true, other, seed=seed, sigma_px=NOISE_PX / 3.0)
        assert not notes(fg.adjust(block))


@pytest.mark.consistency
@pytest.mark.parametrize("how", [{"snoop": True}, {"backend": "graph"}])
def test_with_a_search_and_with_the_graph(how: dict[str, Any]) -> None:
    block = calibration_block((-0.1, 0, 0, 0, 0), IDEAL_TO_MEASURED, MEASURED_TO_IDEAL)
    assert len(notes(fg.adjust(block, **how))) == 1
    assert not notes(fg.adjust(block, loss="huber"))


@pytest.mark.oracle
@pytest.mark.parametrize("model", DIRECTIONS)
def test_the_turned_camera_is_the_same_to_the_first_order(model: str) -> None:
    """A camera in the other direction moves image points equally, up to the square of the distortion."""
    ground = np.random.default_rng(2).uniform(-1.0, 1.0, (50, 3)) * [4.0, 4.0, 1.0] + [0.0, 0.0, 10.0]
    plain = FrameCamera(np.eye(3), np.zeros(3), FOCAL_PX, MIDDLE, np.zeros(5), {}, model, 800.0)
    apart = []
    for size in (1e-4, 1e-5):
        camera = replace(plain, distortion=size * np.array([1.0, -0.5, 0.3, 0.2, -0.4]))
        one, other = (np.array(FrameSensor(c, 1, 1, georeferenced=False).project(ground))
                      for c in (camera, turned_camera(camera)))  # fmt: skip
        assert np.abs(one - np.array(FrameSensor(plain, 1, 1, georeferenced=False).project(ground))).max() > 5 * size
        apart.append(np.abs(one - other).max())
    assert apart[0] / apart[1] == pytest.approx(100.0, rel=0.05)


@pytest.mark.behaviour
def test_cameras_without_another_direction() -> None:
    block = calibration_block((0, 0, 0, 0, 0))
    assert turned_block(block) is not None

    def cameras(**change: Any) -> fg.Block:
        return replace(block, images=tuple(
            replace(i, sensor=i.sensor.with_camera(replace(i.sensor.camera, **change), i.id)) for i in block.images
        ))  # fmt: skip

    block = calibration_block((-0.1, 0, 0, 0, 0), IDEAL_TO_MEASURED, MEASURED_TO_IDEAL)
    earlier = fg.adjust(block)
    assert len(notes(earlier)) == 1
    assert not notes(fg.adjust(block, start=earlier, start_prior=True))  # a prior of terms of this direction
    for change in ({"sigma": {"focal": 1.0}, "shared": {}}, {"further": {"shear": 1e-4}}, {"is_fisheye": True},
                   {"aspect": 1e-4}):  # fmt: skip
        assert turned_block(cameras(**change)) is None


@pytest.mark.truth
@pytest.mark.parametrize(("true", "expected"), [(IDEAL_TO_MEASURED, 1), (MEASURED_TO_IDEAL, 0)])
def test_in_a_bundle_of_close_range(true: str, expected: int) -> None:
    """A close-range bundle gives the note only if the distortion is not from measured to ideal coordinates."""
    block = calibration_block((-0.1, 0, 0, 0, 0), true)
    photos = [BundlePhoto(i.id, PhotoInterior(FOCAL_PX, MIDDLE[::-1], np.zeros(7), "down"), i.sensor.camera.rotation,
                          i.sensor.camera.centre_m, (), "camera", ("k1",)) for i in block.images]  # fmt: skip
    o, known = block.observations, block.points.known
    control = {name: (known.ecef_m[j], 0.002) for j, name in enumerate(block.points.ids[:10])}
    result = adjust_bundle(photos, block.points.ids, known.ecef_m, o.image, o.point,
                           np.column_stack([o.sample, o.line]), sigma=NOISE_PX, control=control)  # fmt: skip
    assert len(notes(result.solution)) == expected
