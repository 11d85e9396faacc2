"""The tests check what the sensor refuses; each changes the metadata of the twin by one fault."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from factors.geometry import interpolation
from fg_orient.model.errors import InputError, OutOfImage, OutOfTimeRange
from fg_orient.sensors import initial, projection
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.metadata import LineTiming, LookAnglePolynomial, PushbroomMetadata, QuaternionList
from fg_orient.sensors.pushbroom import MAX_EXTRAPOLATION_S, PushbroomSensor
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.published_rays import misses_m, rays


@pytest.fixture(scope="module")
def metadata() -> PushbroomMetadata:
    return zonguldak_block(ZonguldakOptions(seed=1))[0].images[0].sensor.metadata


def shifted(metadata: PushbroomMetadata, seconds: float) -> PushbroomMetadata:
    timing = metadata.timing
    later = LineTiming(timing.reference_line, timing.reference_time_s + seconds, timing.line_period_s)
    return replace(metadata, timing=later)


FLAT = LookAnglePolynomial(0.0, np.array([0.0]), np.array([0.1, 0.0]))


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "seconds", "error", "words"),
    [(lambda m: shifted(m, 150.0), 0.0, OutOfTimeRange, "never extrapolated"),
     (lambda m: open_end(m, 12.0), 0.0, OutOfTimeRange, "attitudes cover"),
     *((lambda m: m, s, InputError, "0 to 5 s only") for s in (-0.1, float("nan"), MAX_EXTRAPOLATION_S + 1e-9)),
     (lambda m: replace(m, look=FLAT), 0.0, InputError, "same viewing direction")],
    ids=["orbit too short", "no line with attitude", "negative", "no number", "too long", "one direction"],
)  # fmt: skip
def test_metadata_that_make_no_sensor_are_refused(
    metadata: PushbroomMetadata, change: Callable[[PushbroomMetadata], PushbroomMetadata], seconds: float,
    error: type[Exception], words: str,
) -> None:  # fmt: skip
    with pytest.raises(error, match=words):
        PushbroomSensor(change(metadata), extrapolate_attitude_s=seconds)


def open_end(metadata: PushbroomMetadata, seconds: float) -> PushbroomMetadata:
    """Let the image end this many seconds after its attitudes.

    If negative, it starts before them.
    """
    timing, listed = metadata.timing, metadata.attitude.time_s
    ends = timing.reference_time_s + timing.line_period_s * (
        np.array([0, metadata.n_lines - 1]) - timing.reference_line
    )
    return shifted(metadata, listed[-1] - ends[1] + seconds if seconds > 0.0 else listed[0] - ends[0] + seconds)


@pytest.mark.behaviour
def test_lines_without_attitude_are_refused_one_by_one(metadata: PushbroomMetadata) -> None:
    """Lines whose centre is after the last attitude are refused, all others are usable, and a note names them.

    For the 0.15 s of this test they are 200 lines of 0.7521 ms.
    """
    period = metadata.timing.line_period_s
    assert PushbroomSensor(open_end(metadata, 1e-9)).notes == metadata.notes
    sensor = PushbroomSensor(open_end(metadata, 0.15))
    refused = int(np.ceil(0.15 / period))
    assert (sensor.first_line, sensor.last_line) == (0.0, 11999.0 - refused)
    assert (
        str(sensor.notes[-1])
        == f"the attitudes do not cover lines {12000 - refused} to 11999, so these lines cannot be used"
    )
    last = sensor.last_line
    assert np.isfinite(sensor.locate([0.0, last + 0.5], [0.0, 11999.0], height_m=0.0)).all()
    for call in (lambda n: sensor.locate(n, 5.0), sensor.states, lambda n: sensor.rays(n, 5.0)):
        with pytest.raises(
            OutOfTimeRange, match=rf"attitudes cover .*lines 0 to {last:.0f}.*option extrapolate_attitude"
        ):
            call(last + 1.0)
    with pytest.raises(OutOfImage):
        sensor.locate(12000.0, 5.0)
    assert sensor.is_inside(np.array([last, last + 1.0]), np.zeros(2)).tolist() == [True, False]
    assert sensor.corners()[0].tolist() == [0.0, 0.0, last, last]


@pytest.mark.behaviour
def test_lines_before_the_attitudes(metadata: PushbroomMetadata) -> None:
    sensor = PushbroomSensor(open_end(metadata, -0.055))
    refused = int(np.ceil(0.055 / metadata.timing.line_period_s))
    assert (sensor.first_line, sensor.last_line) == (float(refused), 11999.0)
    assert (
        str(sensor.notes[-1]) == f"the attitudes do not cover lines 0 to {refused - 1}, so these lines cannot be used"
    )


@pytest.mark.consistency
def test_a_projection_beyond_the_attitudes_goes_on_straight(metadata: PushbroomMetadata) -> None:
    sensor = PushbroomSensor(open_end(metadata, 0.15))
    last = sensor.last_line
    inside = sensor.locate([last, last - 1000.0], [5.0, 5.0], height_m=0.0)
    beyond = inside[0] + 0.5 * (inside[0] - inside[1])
    found, _ = sensor.project(beyond[None])
    assert found[0] == pytest.approx(last + 500.0, abs=5.0)  # linear to 1 %
    back = sensor.project(sensor.locate([last + 0.5, 100.0], [0.0, 9000.0], height_m=500.0))
    assert np.abs(np.array(back) - [[last + 0.5, 100.0], [0.0, 9000.0]]).max() <= 1e-6


@pytest.mark.oracle
@pytest.mark.parametrize(("end_s", "state"), [(0.15, -1), (-0.15, 0)])
def test_extrapolation_holds_the_last_rate(metadata: PushbroomMetadata, end_s: float, state: int) -> None:
    """Attitudes beyond the list are extrapolated with the last rate; inside the list no bit changes."""
    held = PushbroomSensor(open_end(metadata, end_s), extrapolate_attitude_s=0.2)
    assert (held.first_line, held.last_line) == (0.0, 11999.0)
    assert "extrapolated by 0.150 s with the last rate" in str(held.notes[-1])
    source, k = held.metadata.attitude, (-1 if end_s > 0 else 0)
    neighbour = k - 1 if k else 1
    rate = (source.angles_rad[k] - source.angles_rad[neighbour]) / (source.time_s[k] - source.time_s[neighbour])
    line = 11999.0 if k else 0.0
    expected = source.angles_rad[k] + rate * end_s
    # times of the day have 1e-11 s, rates are below 1e-4 rad/s
    np.testing.assert_allclose(held.states(line).angles_rad[0], expected, rtol=0, atol=1e-14)
    middle = np.array([500.0, 6000.0])
    plain = PushbroomSensor(open_end(metadata, end_s))
    assert np.array_equal(held.states(middle).angles_rad, plain.states(middle).angles_rad)


@pytest.mark.behaviour
def test_extrapolation_stops_at_its_seconds(metadata: PushbroomMetadata) -> None:
    part = PushbroomSensor(open_end(metadata, 0.15), extrapolate_attitude_s=0.1)
    refused = int(np.ceil(0.05 / metadata.timing.line_period_s))
    assert part.last_line == 11999.0 - refused
    assert len(part.notes) == len(metadata.notes) + 2
    with pytest.raises(OutOfTimeRange):
        part.states(part.last_line + 1.0)


@pytest.mark.truth
def test_extrapolated_quaternions_keep_their_rate(metadata: PushbroomMetadata) -> None:
    """Extrapolated quaternions keep a constant rate within 2e-12, the cube of the small rotation."""
    image = open_end(metadata, 0.15)
    listed = metadata.attitude.time_s
    half = 5e-4 * (listed - listed[0])  # 1e-3 rad/s
    q = np.stack([np.cos(half), 0.6 * np.sin(half), 0.8 * np.sin(half), np.zeros(len(half))], axis=1)
    times, samples = interpolation.extended(listed, q, 0.0, 0.15)
    assert times[-1] == listed[-1] + 0.15
    found = interpolation.quaternion_linear(times, samples, times[-1:])[0]
    half = 5e-4 * (times[-1] - listed[0])
    # chord against arc: the turn of 7.5e-5 rad cubed, and rounding
    np.testing.assert_allclose(found, [np.cos(half), 0.6 * np.sin(half), 0.8 * np.sin(half), 0.0], rtol=0, atol=2e-12)
    sensor = PushbroomSensor(replace(image, attitude=QuaternionList(listed, q)), extrapolate_attitude_s=0.2)
    assert isinstance(sensor.attitude, QuaternionList) and len(sensor.attitude.time_s) == len(listed) + 1


@pytest.mark.behaviour
def test_a_projection_that_does_not_end_is_nan(metadata: PushbroomMetadata, monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = PushbroomSensor(metadata)
    ground = sensor.locate([10.0, 9000.0], [10.0, 9000.0], height_m=0.0)
    assert np.isfinite(sensor.project(ground)).all()
    monkeypatch.setattr(projection, "MAX_STEPS", 1)
    assert np.isnan(sensor.project(ground)).all()


@pytest.mark.behaviour
def test_pixels_outside_and_surfaces_that_cannot_be_seen(metadata: PushbroomMetadata) -> None:
    sensor = PushbroomSensor(metadata)
    with pytest.raises(OutOfImage, match="12000"):
        sensor.locate([5.0, 12000.0], [5.0, 5.0], height_m=0.0)
    with pytest.raises(OutOfImage):
        sensor.locate(5.0, np.nan, height_m=0.0)
    sensor.locate(-0.5, 11999.5, height_m=0.0)  # the border of the outermost pixels is inside
    with pytest.raises(InputError, match="does not meet the Earth"):
        sensor.locate(5.0, 5.0, height_m=2e6)


@pytest.mark.behaviour
def test_points_outside_or_behind(metadata: PushbroomMetadata) -> None:
    """A point outside the image projects linearly and is not inside; one behind the Earth projects to nan."""
    sensor = PushbroomSensor(metadata)
    inside = sensor.locate([0.0, 6000.0], [0.0, 6000.0], height_m=0.0)
    beyond = inside[0] + (inside[0] - inside[1]) * 0.01  # a hundredth of the half diagonal further out
    line, sample = sensor.project(np.stack([beyond, -inside[1]]))
    assert -80.0 < line[0] < -40.0
    assert -80.0 < sample[0] < -40.0
    assert not sensor.is_inside(line, sample).any()
    assert np.isnan([line[1], sample[1]]).all()


@pytest.mark.oracle
def test_intersection_of_two_images(metadata: PushbroomMetadata) -> None:
    """Rays of two images intersect in the true point within 1e-6 m; parallel rays and wrong shapes are refused."""
    block, truth = zonguldak_block(ZonguldakOptions(seed=1))
    sensors = [image.sensor for image in block.images]
    pixels = [s.project(truth.ecef_m, c) for s, c in zip(sensors, truth.corrections, strict=True)]
    line, sample = (np.array([p[k] for p in pixels]) for k in (0, 1))
    found = fg.intersect(sensors, line, sample, truth.corrections)
    assert np.abs(found - truth.ecef_m).max() < 1e-6
    for image, pixel, correction in zip(block.images, pixels, truth.corrections, strict=True):
        assert misses_m(image.sensor.metadata, *pixel, found, correction).max() < 1e-6
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


@pytest.mark.behaviour
def test_rays_that_meet_behind_a_sensor(metadata: PushbroomMetadata) -> None:
    """Rays that meet behind a sensor are refused.

    Both images are rolled outwards by 60 degrees, so that their rays diverge.
    """
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


@pytest.mark.truth
def test_convergence_is_the_largest_angle_of_any_two_rays() -> None:
    """The convergence of a point is the largest angle between any two of its rays, for none to four rays."""
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


@pytest.mark.oracle
def test_one_line_and_many_samples(metadata: PushbroomMetadata) -> None:
    sensor = PushbroomSensor(metadata)
    row = sensor.locate(100.0, [5.0, 6.0, 7.0], height_m=0.0)
    assert np.array_equal(row[1], sensor.locate(100.0, 6.0, height_m=0.0)[0])
    centre, direction = sensor.rays(100.0, [5.0, 6.0, 7.0])
    assert centre.shape == direction.shape == (3, 3)
    at, seen = rays(metadata, np.full(3, 100.0), np.array([5.0, 6.0, 7.0]))
    assert np.abs(centre - at).max() < 1e-7
    assert np.abs(direction - seen).max() < 1e-13
