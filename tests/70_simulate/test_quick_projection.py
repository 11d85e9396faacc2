"""The projection of large blocks agrees with the projection of the sensor."""

from __future__ import annotations

import numpy as np
import pytest

from fg_orient.sensors.correction import Correction
from fg_orient.simulate import block as block_module
from fg_orient.simulate.block import MARGIN_PX, BlockOptions, grid_block
from fg_orient.simulate.scene import N_LINES, N_SAMPLES, Scene, as_read, find_pass
from fg_orient.simulate.simulation import QuickProjection, draw_errors
from tests.support.published_rays import misses_m, published_pixels

ROUNDING_PX = 1e-8  # one digit of a time of day is 5e-9 px


@pytest.fixture(scope="module")
def sensor():
    centre = block_module._centres(BlockOptions(rows=1, columns=2))[0]
    orbit = find_pass(centre, 0.2)
    return as_read(Scene("image", orbit, 0.2, block_module.FIRST_DAY, 1041, full_look_table=False).metadata())


@pytest.mark.oracle
@pytest.mark.parametrize("top_m", [0.0, 500.0, 8000.0])
@pytest.mark.parametrize("errors", ["none", "prior"])
def test_it_is_the_projection_of_the_sensor(sensor, top_m: float, errors: str) -> None:
    rng = np.random.default_rng(3)
    correction = Correction(draw_errors(errors, rng, 1)[0], np.zeros((2, 0)))
    camera = QuickProjection(sensor, correction, top_m)
    line, sample = rng.uniform(-0.4, 11999.4, (2, 400))
    height = rng.uniform(-50.0, top_m + 200.0, 400)  # some outside the heights of the fit
    ground = sensor.locate(line, sample, height_m=height, correction=correction)
    expected = np.stack(sensor.project(ground, correction), axis=1)
    found = camera.project(ground, height)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=ROUNDING_PX)
    assert misses_m(sensor.metadata, *found.T, ground, correction).max() < 1e-6
    inside = (height >= 0.0) & (height <= top_m)
    assert np.abs(camera.estimate(ground, height) - expected)[inside].max(initial=0.0) < 2.0 * camera.error_px + 1e-3
    assert len(camera.near(ground)) == 400


@pytest.mark.consistency
def test_points_outside_the_image_are_projected_as_well(sensor) -> None:
    ground = sensor.locate([5.0, 11990.0], [5.0, 11990.0], height_m=100.0) + np.array(
        [[3e3, 0.0, 0.0], [0.0, 9e3, 0.0]]
    )
    camera = QuickProjection(sensor, Correction(), 500.0)
    expected = np.stack(sensor.project(ground), axis=1)
    assert not sensor.is_inside(*expected.T).any()
    np.testing.assert_array_equal(camera.project(ground, np.full(2, 100.0)), expected)


@pytest.mark.oracle
def test_each_point_is_measured_where_the_sensor_sees_it() -> None:
    """A simulated image measures the points whose published pixel is inside its margin, and no others."""
    block, truth = grid_block(BlockOptions(rows=2, columns=2, points=800, seed=3, errors="none"))
    size = np.array([N_LINES, N_SAMPLES])
    for k, image in enumerate(block.images):
        pixels = published_pixels(image.sensor.metadata, truth.ecef_m)
        expected = ((pixels >= MARGIN_PX) & (pixels <= size - 1 - MARGIN_PX)).all(axis=1)
        seen = np.zeros(len(expected), bool)
        seen[block.observations.point[block.observations.image == k]] = True
        np.testing.assert_array_equal(seen, expected)
