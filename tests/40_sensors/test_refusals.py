"""What the sensor refuses, on the twin's metadata with one fault each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient import initial
from fg_orient.errors import InputError, OutOfImage, OutOfTimeRange
from fg_orient.sensors import projection
from fg_orient.sensors.correction import Correction
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


def test_attitudes_that_start_late_are_noted_as_such(metadata: PushbroomMetadata) -> None:
    timing = metadata.timing
    first_line_s = timing.reference_time_s - timing.line_period_s * timing.reference_line
    to_start = metadata.attitude.time_s[0] - first_line_s
    late = PushbroomSensor(shifted(metadata, to_start - 0.055))
    assert late.notes[-1] == "attitudes start 0.055 s after the image does: the first one is held"


def test_attitudes_are_not_held_for_lines_far_outside(metadata: PushbroomMetadata) -> None:
    """0.2 s and half a line beyond the list, for rays as for the image; the projection stays inside."""
    timing, last = metadata.timing, metadata.attitude.time_s[-1]
    sensor = PushbroomSensor(metadata)
    line = timing.reference_line + (last - timing.reference_time_s) / timing.line_period_s
    hold = 0.2 / timing.line_period_s
    assert np.isfinite(sensor.rays(line + hold, 5.0)[1]).all()
    for call in (sensor.states, lambda number: sensor.rays(number, 5.0)):
        with pytest.raises(OutOfTimeRange, match=r"attitudes cover .* at most 0\.2 s are held"):
            call(line + hold + 1.0)
    to_end = last - (timing.reference_time_s + timing.line_period_s * (metadata.n_lines - 1 - timing.reference_line))
    held = PushbroomSensor(shifted(metadata, to_end + 0.2 - 1e-9))  # the border of the last line is still inside
    inside = held.locate([11999.5, 11000.0], [5.0, 5.0], height_m=0.0)
    beyond = inside[0] + 5.0 * (inside[0] - inside[1])
    found, _ = held.project(beyond[None])
    assert found[0] == pytest.approx(11999.5 + 5.0 * 499.75 * 2.0, abs=60.0)  # linear to 1 %


def test_a_projection_that_does_not_end_is_nan(metadata: PushbroomMetadata, monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = PushbroomSensor(metadata)
    ground = sensor.locate([10.0, 9000.0], [10.0, 9000.0], height_m=0.0)
    assert np.isfinite(sensor.project(ground)).all()
    monkeypatch.setattr(projection, "MAX_STEPS", 1)
    assert np.isnan(sensor.project(ground)).all()


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
    with pytest.raises(InputError, match="one correction for each of the 2 sensors"):
        fg.intersect(sensors, line, sample, truth.corrections[:1])
    with pytest.raises(InputError, match="one row for each of the 2 sensors"):
        fg.intersect(sensors, line.T, sample.T)


def test_rays_that_meet_behind_a_sensor(metadata: PushbroomMetadata) -> None:
    """Both images rolled outwards by 60 degrees diverge: the lines through the rays meet in space."""
    block, _ = zonguldak_block(ZonguldakOptions(seed=1))
    sensors = [image.sensor for image in block.images]
    apart = [Correction(), Correction()]
    east = [np.degrees(np.arctan2(*s.centre_position()[[1, 0]])) for s in sensors]
    for correction, other in zip(apart, east[::-1], strict=True):
        sign = 1.0 if other == min(east) else -1.0
        correction.eop[6, 0] = sign * np.radians(60.0)
    pixel = [[6000.0], [6000.0]]
    (p, u), (q, v) = (s.rays(6000.0, 6000.0, c) for s, c in zip(sensors, apart, strict=True))
    found, angle = initial.nearest_points(np.concatenate([p, q]), np.concatenate([u, v]), np.zeros(2, np.intp), 1)
    assert angle[0] > 10.0
    assert ((found - p) * u).sum() < 0.0
    with pytest.raises(InputError, match="meet behind a sensor"):
        fg.intersect(sensors, pixel, pixel, apart)


def test_convergence_is_the_largest_angle_of_any_two_rays() -> None:
    """Points with 4, 2, 3, 1 and no rays at known angles in one plane, in mixed order."""
    degrees = {0: [0.0, 1.0, 7.0, 3.0], 1: [0.0, 0.05], 2: [10.0, -20.0, 0.0], 3: [5.0]}
    point = np.array([k for k, angles in degrees.items() for _ in angles])
    angle = np.radians([a for angles in degrees.values() for a in angles])
    order = np.random.default_rng(2).permutation(len(point))
    u = np.stack([np.sin(angle), np.zeros(len(angle)), -np.cos(angle)], axis=1)
    target = np.array([7.0e6, 1.0e5, 2.0e5])
    found, spread = initial.nearest_points((target - 8e5 * u)[order], u[order], point[order], 5)
    assert spread == pytest.approx([7.0, 0.05, 30.0, 0.0, 0.0], abs=1e-12)
    assert np.isnan(found[[1, 3, 4]]).all()  # closer to parallel than 0.1 degrees, one ray, none
    assert np.abs(found[[0, 2]] - target).max() < 1e-6


def test_one_line_and_many_samples(metadata: PushbroomMetadata) -> None:
    sensor = PushbroomSensor(metadata)
    row = sensor.locate(100.0, [5.0, 6.0, 7.0], height_m=0.0)
    assert np.array_equal(row[1], sensor.locate(100.0, 6.0, height_m=0.0)[0])
    centre, direction = sensor.rays(100.0, [5.0, 6.0, 7.0])
    assert centre.shape == direction.shape == (3, 3)
