"""What the sensor refuses, on the twin's metadata with one fault each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.errors import InputError, OutOfImage, OutOfTimeRange
from fg_orient.sensors.metadata import LineTiming, LookAnglePolynomial, PushbroomMetadata
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block


@pytest.fixture(scope="module")
def metadata() -> PushbroomMetadata:
    return zonguldak_block(ZonguldakOptions(seed=1))[0].images[0].sensor.metadata


def shifted(metadata: PushbroomMetadata, seconds: float) -> PushbroomMetadata:
    timing = metadata.timing
    later = LineTiming(timing.reference_line, timing.reference_time_s + seconds, timing.line_period_s)
    return replace(metadata, timing=later)


def test_ephemeris_is_never_extrapolated(metadata: PushbroomMetadata) -> None:
    with pytest.raises(OutOfTimeRange, match="never extrapolated"):
        PushbroomSensor(shifted(metadata, 150.0))


def test_attitudes_are_held_for_a_fifth_of_a_second_only(metadata: PushbroomMetadata) -> None:
    last_line_s = metadata.timing.reference_time_s + metadata.timing.line_period_s * (
        metadata.n_lines - 1 - metadata.timing.reference_line
    )
    to_end = metadata.attitude.time_s[-1] - last_line_s
    assert PushbroomSensor(shifted(metadata, to_end - 0.01)).notes == metadata.notes
    held = PushbroomSensor(shifted(metadata, to_end + 0.15))
    assert "the last one is held" in held.notes[-1]
    held.locate([0.0, 11999.0], [0.0, 11999.0], height_m=0.0)
    with pytest.raises(OutOfTimeRange, match=r"at most 0\.2 s are held"):
        PushbroomSensor(shifted(metadata, to_end + 0.25))


def test_samples_that_all_look_the_same_way(metadata: PushbroomMetadata) -> None:
    flat = LookAnglePolynomial(0.0, np.array([0.0]), np.array([0.1, 0.0]))
    with pytest.raises(InputError, match="same direction"):
        PushbroomSensor(replace(metadata, look=flat))


def test_pixels_outside_and_surfaces_that_cannot_be_seen(metadata: PushbroomMetadata) -> None:
    sensor = PushbroomSensor(metadata)
    with pytest.raises(OutOfImage, match="12000"):
        sensor.locate([5.0, 12000.0], [5.0, 5.0], height_m=0.0)
    with pytest.raises(OutOfImage):
        sensor.locate(5.0, np.nan, height_m=0.0)
    sensor.locate(-0.5, 11999.5, height_m=0.0)  # the border of the outermost pixels is inside
    with pytest.raises(InputError, match="does not meet the Earth"):
        sensor.locate(5.0, 5.0, height_m=2e6)


def test_points_outside_or_behind(metadata: PushbroomMetadata) -> None:
    """Outside: the linear continuation, flagged by ``is_inside``; on the far side of the Earth: nan."""
    sensor = PushbroomSensor(metadata)
    inside = sensor.locate([0.0, 6000.0], [0.0, 6000.0], height_m=0.0)
    beyond = inside[0] + (inside[0] - inside[1]) * 0.01  # a hundredth of the half diagonal further out
    line, sample = sensor.project(np.stack([beyond, -inside[1]]))
    assert -80.0 < line[0] < -40.0
    assert -80.0 < sample[0] < -40.0
    assert not sensor.is_inside(line, sample).any()
    assert np.isnan([line[1], sample[1]]).all()


def test_intersection_of_two_images(metadata: PushbroomMetadata) -> None:
    """Noise-free pixels of a ground point meet in it: 1e-6 m; a single direction is refused."""
    block, truth = zonguldak_block(ZonguldakOptions(seed=1))
    sensors = [image.sensor for image in block.images]
    pixels = [s.project(truth.ecef_m, c) for s, c in zip(sensors, truth.corrections, strict=True)]
    line, sample = (np.array([p[k] for p in pixels]) for k in (0, 1))
    found = fg.intersect(sensors, line, sample, truth.corrections)
    assert np.abs(found - truth.ecef_m).max() < 1e-6
    uncorrected = fg.intersect(sensors, line, sample)
    assert 1.0 < np.linalg.norm(uncorrected - truth.ecef_m, axis=1).max() < 100.0
    with pytest.raises(InputError, match="parallel"):
        fg.intersect([sensors[0], sensors[0]], [5.0, 5.0], [5.0, 5.0])
    with pytest.raises(OutOfImage):
        fg.intersect(sensors, [5.0, -5.0], [5.0, 5.0])
