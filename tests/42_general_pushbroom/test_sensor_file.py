"""The twin, written as a sensor description, has the same rays and the same adjustment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fg_orient as fg
from factors.geometry import light, orbital
from fg_orient.formats.sensor import read_sensor
from fg_orient.model.block import Block, Image
from fg_orient.sensors import projection
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.general import GeneralPushbroom
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.published_rays import misses_m
from tests.support.sensor_description import describe

ALL_LIGHT = "[light]\nlight_time = true\naberration = true\nrefraction = true\n"


@pytest.fixture(scope="module")
def block() -> Block:
    return zonguldak_block(ZonguldakOptions(seed=1))[0]


def pixels(sensor: PushbroomSensor, n: int = 9) -> tuple[np.ndarray, np.ndarray]:
    line, sample = np.linspace(0.0, sensor.n_lines - 1.0, n), np.linspace(0.0, sensor.n_samples - 1.0, n)
    grid = np.meshgrid(line, sample)
    return grid[0].ravel(), grid[1].ravel()


@pytest.mark.oracle
@pytest.mark.parametrize(("orbit", "attitude"), [
    ("ITRF", "orbital"), ("ITRF", "ITRF"), ("GCRS", "orbital"), ("EME2000", "EME2000"), ("ITRF", "GCRS"),
])  # fmt: skip
def test_every_frame_gives_the_rays_of_the_dimap_sensor(
    block: Block, tmp_path: Path, orbit: str, attitude: str
) -> None:
    """A description in any frame locates pixels as the DIMAP sensor within 1 mm, and notes missing UT1.

    Angles of another convention are linear between samples, too.
    """
    sensor = block.images[0].sensor
    ours = read_sensor(describe(sensor, tmp_path, orbit=orbit, attitude=attitude))
    assert isinstance(ours, GeneralPushbroom)
    at = pixels(sensor)
    ground = ours.locate(*at, height_m=500.0)
    assert misses_m(sensor.metadata, *at, ground).max() < 1e-3
    assert np.linalg.norm(ground - sensor.locate(*at, height_m=500.0), axis=1).max() < 1e-3
    said = any("UT1 = UTC" in str(note) and " m east-west" in str(note) for note in ours.notes)
    assert said == (orbit != "ITRF" or attitude not in ("orbital", "ITRF"))


@pytest.mark.consistency
def test_kepler_and_inertial_velocity_are_one_frame(block: Block, tmp_path: Path) -> None:
    """The frames ``kepler`` and ``inertial velocity`` are equal, unlike that of the Earth-fixed velocity.

    The difference is the Earth's rotation across the track, degrees of yaw.
    """
    sensor, at = block.images[0].sensor, ([10.0], [20.0])
    found = {}
    for k, kind in enumerate(("kepler", "inertial velocity", "earth-fixed velocity")):
        path = describe(sensor, tmp_path / str(k))
        text = path.read_text("utf-8").replace('frame = "orbital"', f'frame = "orbital"\norbital_frame = "{kind}"')
        path.write_text(text, encoding="utf-8")
        found[kind] = read_sensor(path).locate(*at)[0]
    assert np.linalg.norm(found["kepler"] - found["inertial velocity"]) < 1e-6
    assert np.linalg.norm(found["kepler"] - found["earth-fixed velocity"]) > 1000.0


@pytest.mark.consistency
def test_round_trips_with_light(block: Block, tmp_path: Path) -> None:
    """With all effects on light pixels return within 1e-6 px, and each effect has its documented size.

    The heights are 0 and 5000 m.
    """
    sensor = block.images[0].sensor
    bent = read_sensor(describe(sensor, tmp_path, extra=ALL_LIGHT))
    at = pixels(sensor, 5)
    for height in (0.0, 5000.0):
        line, sample = bent.project(bent.locate(*at, height_m=height))
        assert max(np.abs(line - at[0]).max(), np.abs(sample - at[1]).max()) < 1e-6
    plain = bent.metadata
    moved = {}
    for name in ("light_time", "aberration", "refraction"):
        one = GeneralPushbroom(replace(plain, effects=replace(plain.effects, **dict.fromkeys(
            {"light_time", "aberration", "refraction"} - {name}, False))))  # fmt: skip
        shift = one.locate(*at) - sensor.locate(*at)
        moved[name] = np.linalg.norm(shift, axis=1)
    assert 0.7 < moved["light_time"].min() < moved["light_time"].max() < 1.5
    assert 15.0 < moved["aberration"].min() < moved["aberration"].max() < 30.0
    assert moved["refraction"].max() < 3.0


@pytest.mark.oracle
@pytest.mark.parametrize("effects", ["", ALL_LIGHT], ids=["no effects", "light"])
def test_pixel_derivatives_are_differences_of_the_conditions(block: Block, tmp_path: Path, effects: str) -> None:
    """Derivatives by pixels are differences of the conditions over half a pixel to both sides, inside the image."""
    sensor = read_sensor(describe(block.images[0].sensor, tmp_path, extra=effects))
    assert isinstance(sensor, GeneralPushbroom) and sensor.bends_light == bool(effects)
    line, sample = pixels(sensor)
    rng = np.random.default_rng(3)
    eop = rng.normal(0.0, 1.0, (9, 3)) * np.repeat([10.0, 0.01, 1e-5], 3)[:, None]
    correction = Correction(eop, rng.normal(0.0, 1e-5, (2, 3)))
    ground = sensor.locate(line, sample, height_m=700.0) + rng.normal(0.0, 20.0, (len(line), 3))

    def values(line: np.ndarray, sample: np.ndarray) -> np.ndarray:
        return projection.conditions(sensor, line, sample, ground, correction)

    last = sensor.n_lines - 0.5, sensor.n_samples - 0.5
    before, after = (np.clip(line + s, -0.5, last[0]) for s in (-0.5, 0.5))
    low, high = (np.clip(sample + s, -0.5, last[1]) for s in (-0.5, 0.5))
    expected = np.stack([
        (values(after, sample) - values(before, sample)) / (after - before)[:, None],
        (values(line, high) - values(line, low)) / (high - low)[:, None],
    ], axis=2)  # fmt: skip
    got = projection.linearised(sensor, line, sample, ground, correction)
    assert np.abs(got.slope - expected).max() < 1e-10 * np.abs(expected).max()
    assert np.array_equal(got.records, sensor.records(line, sample, ground))


@pytest.mark.oracle
def test_offset_and_mounting(block: Block, tmp_path: Path) -> None:
    """An offset moves the projection centre, and a mounting rotates the camera before the attitude does."""
    sensor = block.images[0].sensor
    plain = read_sensor(describe(sensor, tmp_path / "a"))
    moved = read_sensor(describe(sensor, tmp_path / "b", extra="[mounting]\noffset_m = [3.0, 4.0, 0.0]\n"))
    (p, u), (q, v) = plain.rays(100.0, 50.0), moved.rays(100.0, 50.0)
    assert np.linalg.norm(q - p) == pytest.approx(5.0, abs=1e-6)
    assert np.abs((q - p) @ p[0]).max() < 1e-3 * np.linalg.norm(p)  # roll is small: the offset is horizontal
    assert np.abs(u - v).max() < 1e-14
    turned = read_sensor(describe(sensor, tmp_path / "c", extra="[mounting]\nangles_deg = [0.0, 0.0, 90.0]\n"))
    assert np.abs(turned.metadata.mounting @ [1.0, 0.0, 0.0] - [0.0, 1.0, 0.0]).max() < 1e-15
    rows = "[mounting]\nmatrix = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\n"
    same = read_sensor(describe(sensor, tmp_path / "d", extra=rows))
    for turn in (turned, same):
        expected = plain.states(100.0).mount @ orbital.B_FROM_A @ turn.metadata.mounting @ orbital.B_FROM_A.T
        assert np.abs(turn.states(100.0).mount - expected).max() < 1e-14


@pytest.mark.oracle
def test_a_lens_is_the_table_of_its_directions(block: Block, tmp_path: Path) -> None:
    """A lens has the look angles of p = (0, y, 0) - (x_s, y_s, c) + delta, with the numbers written out here."""
    path = describe(block.images[0].sensor, tmp_path)
    lens = "focal_length_m = 2.0\npitch_m = -1e-5\nprincipal_sample = 100.5\nforward_m = 0.02\n"
    lens += "delta_forward_m = [0.0, 0.0, 3e-6]\ndelta_left_m = [1e-6, 2e-6]\n"
    path.write_text(path.read_text("utf-8").replace('directions = "directions.csv"\n', lens), encoding="utf-8")
    sensor = read_sensor(path)
    psi_x, psi_y = sensor.look_angles([0.0, 40.0, sensor.n_samples - 1.0])
    s = np.array([-1.0, 80.0 / (sensor.n_samples - 1.0) - 1.0, 1.0])
    y = np.array([0.0, 40.0, sensor.n_samples - 1.0])
    assert np.tan(psi_x) == pytest.approx((0.02 + 3e-6 * s**2) / 2.0, rel=1e-12)
    assert np.tan(psi_y) == pytest.approx((-1e-5 * (y - 100.5) + 1e-6 + 2e-6 * s) / 2.0, rel=1e-12)


@pytest.mark.consistency
def test_the_adjustment_is_that_of_the_dimap_sensors(block: Block, tmp_path: Path) -> None:
    """The block of described sensors has the ground points and sigma0 of the block of DIMAP sensors."""
    images = tuple(Image(i.id, read_sensor(describe(i.sensor, tmp_path / i.id))) for i in block.images)
    ours = replace(block, images=images)
    expected = fg.adjust(block)
    found = fg.adjust(replace(ours, options=replace(block.options, backend="schur")))
    assert found.sigma0 == pytest.approx(expected.sigma0, rel=1e-5)
    assert np.nanmax(np.abs(found.ground_m - expected.ground_m)) < 1e-3


@pytest.mark.consistency
def test_a_block_with_light_is_adjusted(block: Block, tmp_path: Path) -> None:
    """A block projected with all effects on light has residuals of zero, and large residuals without the effects."""
    images = tuple(Image(i.id, read_sensor(describe(i.sensor, tmp_path / i.id, extra=ALL_LIGHT))) for i in block.images)
    known = block.points.known.ecef_m
    o = block.observations
    keep = np.isfinite(known[o.point]).all(axis=1)
    o = o.take(keep)
    line, sample = o.line.copy(), o.sample.copy()
    for k, image in enumerate(images):
        rows = o.image == k
        line[rows], sample[rows] = image.sensor.project(known[o.point[rows]])
    exact = replace(block, images=images, observations=replace(o, line=line, sample=sample),
                    withheld=replace(block.withheld, ids=()))  # fmt: skip
    assert fg.adjust(exact).sigma0 < 1e-4
    assert fg.adjust(replace(exact, images=block.images)).sigma0 > 1e-2


@pytest.mark.truth
def test_the_rate_of_the_earth_is_one(block: Block) -> None:
    from fg_orient.sensors.earth_rotation import EarthRotation

    rate = EarthRotation(np.datetime64("2012-01-01"), (0.0, 10.0)).rate_rad_s(5.0)
    assert rate == pytest.approx(7.292115e-5, rel=1e-7)  # IERS conventions, GRS 80
    assert pytest.approx(7.292115e-5, rel=1e-7) == light.EARTH_RATE_RAD_S
