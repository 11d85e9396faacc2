"""Every location of Rugged's replay files is computed again: inertial states, Earth, light and DEM."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.metadata.pushbroom import read_earth_orientation
from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.sensors.earth_rotation import EarthRotation
from fg_orient.sensors.general import GeneralPushbroom
from fg_orient.sensors.metadata import LightEffects
from tests.support.rugged_replay import Location, Replay, Transform, read_replay, sensor_metadata

pytestmark = pytest.mark.real_data

#: Locations of each file. Bounds of the issue: 1 cm from the ray, 5 cm from the hit, 1e-3 px.
DIRECT = {"direct-loc-01": 5, "direct-loc-02": 1, "direct-loc-03": 1, "direct-loc-Issue376-01": 1,
          "direct-loc-Issue376-03": 121}  # fmt: skip
INVERSE = {"inverse-loc-01": 1, "inverse-loc-02": 3}


def replay(real_data: Path, name: str) -> Replay:
    return read_replay(real_data / "rugged" / f"replay-{name}.txt")


def points(located: list[Location]) -> np.ndarray:
    lon, lat, height = np.array([x.result for x in located]).T
    return geodetic_to_ecef(np.degrees(lon), np.degrees(lat), height)


def by_line(found: Replay) -> list[list[Location]]:
    """Return the locations in groups of the same time and effects: each is a line of a sensor."""
    keys = dict.fromkeys((x.time_s, x.effects) for x in found.locations)
    return [[x for x in found.locations if (x.time_s, x.effects) == key] for key in keys]


def line_sensor(found: Replay, located: list[Location]) -> GeneralPushbroom:
    """Return a sensor whose samples are the locations; one line of sight more, as an image has two samples."""
    los = np.array([*(x.los for x in located), located[-1].los + np.array([0.0, 1e-3, 0.0])])
    one, t = located[0], found.transform_of(located[0].time_s)
    metadata = sensor_metadata(
        found, t, np.array([one.time_s]), los, np.arange(len(los)), one.effects, one.position, 1e-3
    )
    return GeneralPushbroom(metadata)


def from_rays(sensor: GeneralPushbroom, ground: np.ndarray) -> np.ndarray:
    """Return the distances of points from the rays of samples 0, 1, ... of line 0."""
    sample = np.arange(len(ground), dtype=float)
    p, u = sensor.rays(0.0, sample, None, ground - sensor.states(0.0).position_m)
    return np.linalg.norm(np.cross(ground - p, u), axis=1)


@pytest.mark.truth
@pytest.mark.parametrize(("name", "count"), DIRECT.items())
def test_direct_locations(real_data: Path, name: str, count: int) -> None:
    """Rays meet the points of Rugged's replays within 1 mm, and hits on the DEM within 5 mm.

    The measured differences are 0.14 mm and 1.7 mm.
    """
    found, seen = replay(real_data, name), 0
    for located in by_line(found):
        sensor, ground = line_sensor(found, located), points(located)
        assert from_rays(sensor, ground).max() <= 1e-3
        assert hits(sensor, found, ground).max() <= 5e-3
        seen += len(located)
    assert seen == count == len(found.locations)


def hits(sensor: GeneralPushbroom, found: Replay, ground: np.ndarray) -> np.ndarray:
    """Return the distances of ground points from our hits, on the nearest of several tiles."""
    sample = np.arange(len(ground), dtype=float)
    if len(found.tiles) == 1:
        return np.linalg.norm(sensor.locate(0.0, sample, dem=found.tiles[0]) - ground, axis=1)
    misses = np.full((len(found.tiles), len(ground)), np.inf)
    for k, tile in enumerate(found.tiles):
        for j in range(len(ground)):
            try:
                misses[k, j] = np.linalg.norm(sensor.locate(0.0, sample[j], dem=tile)[0] - ground[j])
            except InputError as error:
                assert error.problems[0].code == "dem.not_covered"
    return misses.min(axis=0)


@pytest.mark.truth
@pytest.mark.parametrize(("effect", "least_m"), [("light_time", 0.5), ("aberration", 10.0)])
def test_without_an_effect_the_point_is_missed(real_data: Path, effect: str, least_m: float) -> None:
    """Without light time or aberration the ray misses Rugged's point by more than the stated distance."""
    found = replay(real_data, "direct-loc-01")
    located = by_line(found)[0]
    sensor = line_sensor(found, located)
    less = replace(sensor.metadata, effects=replace(located[0].effects, **{effect: False}))
    assert from_rays(GeneralPushbroom(less), points(located)).min() > least_m


@pytest.mark.truth
@pytest.mark.parametrize(("name", "count"), INVERSE.items())
def test_inverse_locations(real_data: Path, name: str, count: int) -> None:
    """Points of Rugged's replays project to Rugged's pixels within 1e-6 px; 7e-8 px are measured."""
    found = replay(real_data, name)
    assert len(found.inverse) == count
    samples = np.array(sorted(found.pixels))
    los = np.array([found.pixels[k] for k in samples])
    t = found.transforms[max(found.transforms)]
    line, time_s = found.datation[0]
    first = np.floor(line + (t.time_s - time_s) * found.rate) - 150.0
    for (lon, lat, height), effects, result in found.inverse:
        sensor = GeneralPushbroom(sensor_metadata(
            found, t, np.array([time_s]), los, samples, effects, found.position, 1.0 / found.rate, line - first, 301
        ))  # fmt: skip
        ground = geodetic_to_ecef(np.degrees([lon]), np.degrees([lat]), np.array([height]))
        got = np.stack(sensor.project(ground))[:, 0] + [first, 0.0]
        assert np.abs(got - result).max() <= 1e-6  # measured 7e-8


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    d = a @ b.T
    return 0.5 * float(np.linalg.norm([d[2, 1] - d[1, 2], d[0, 2] - d[2, 0], d[1, 0] - d[0, 1]]))


def body(found: Replay) -> tuple[Transform, np.ndarray]:
    t = next(iter(found.transforms.values()))
    return t, t.matrices(np.array([t.time_s]))[0]


@pytest.mark.truth
def test_earth_rotation_equals_the_one_of_the_files(real_data: Path) -> None:
    """The Earth rotation equals Orekit's within 1e-11 rad with the C04 file of 2012, and in 2013 without a file.

    Without the file the rotation of 2012 is off by over 1e-5 rad. 1e-10 rad are 0.6 mm. A file that starts on the day
    itself leaves both programs the same four days.
    """
    found = replay(real_data, "direct-loc-01")
    t, expected = body(found)
    c04 = read_earth_orientation(real_data / "rugged/orekit-data/eopc04_08_IAU2000.12")
    span = (t.time_s, t.time_s + 10.0)
    ours = EarthRotation(found.epoch, span, "EME2000", c04)
    assert angle_between(ours.matrices(np.array([t.time_s]))[0], expected) < 1e-11
    assert abs(ours.rate_rad_s(t.time_s) - np.linalg.norm(t.earth.rate)) < 2e-12  # Orekit's rate has no precession
    without = EarthRotation(found.epoch, span, "EME2000")
    assert angle_between(without.matrices(np.array([t.time_s]))[0], expected) > 1e-5
    found = replay(real_data, "direct-loc-02")
    t, expected = body(found)
    ours = EarthRotation(found.epoch, (t.time_s, t.time_s + 1.0), "EME2000")
    assert angle_between(ours.matrices(np.array([t.time_s]))[0], expected) < 1e-11


@pytest.mark.behaviour
def test_pole_offsets_against_the_old_theory_are_left_out(real_data: Path) -> None:
    old = read_earth_orientation(real_data / "rugged/orekit-data/eopc04_08.12")
    new = read_earth_orientation(real_data / "rugged/orekit-data/eopc04_08_IAU2000.12")
    assert not old.offset_rad.any() and old.notes and new.offset_rad.any() and not new.notes
    assert np.array_equal(old.mjd, new.mjd) and np.abs(old.pole_rad - new.pole_rad).max() < 1e-12


@pytest.mark.behaviour
def test_no_effects_asked_for(real_data: Path) -> None:
    found = replay(real_data, "direct-loc-02")
    assert found.locations[0].effects == LightEffects() and not found.locations[0].effects
