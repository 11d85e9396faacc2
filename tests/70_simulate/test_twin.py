"""The tests check files, truth, geometry and independent random streams of the Zonguldak twin."""

from __future__ import annotations

import csv
import json
import math
import shutil
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from fg_orient.formats.project import read_project
from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role, Status
from fg_orient.orientation.orient import adjust
from fg_orient.sensors import initial
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.projection import pixel_derivative
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.scene import N_LINES, N_SAMPLES, find_pass
from fg_orient.simulate.simulation import Truth
from fg_orient.simulate.zonguldak import MARGIN_PX, N_POINTS, ZonguldakOptions, simulate_zonguldak, zonguldak_block
from tests.support.published_rays import misses_m, rays

OPTIONS = ZonguldakOptions(
    seed=3, errors="prior", distortion_rad=3e-6, radial_velocity_m_s=8.0, attitude_rad=(-1.6e-4, -7.2e-4, 9e-4)
)
EXACT = ZonguldakOptions(seed=5, image_noise_px=0.0, errors="none", ground_noise_m=(0.0, 0.0, 0.0))
#: Times are seconds of the day: at 31000 s one unit in the last place is 3.6e-12 s, 5e-9 lines.
TIME_ROUNDING_PX = 1e-8
GSD_M = 5.0


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the twin with every option away from its default."""
    return simulate_zonguldak(tmp_path_factory.mktemp("twin") / "zonguldak", OPTIONS).parent


@pytest.fixture(scope="module")
def default() -> tuple[Block, Truth]:
    return zonguldak_block()


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def assert_same(a: object, b: object, place: str = "") -> None:
    """Assert that two objects are equal to the last bit, with arrays and dataclasses inside."""
    if is_dataclass(a) and not isinstance(a, type):
        assert type(a) is type(b), place
        for field in fields(a):
            if field.name not in ("file", "joint"):  # the path, and objects that compute when they are asked
                assert_same(getattr(a, field.name), getattr(b, field.name), f"{place}.{field.name}")
    elif isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b, err_msg=place)
    elif isinstance(a, tuple):
        assert len(a) == len(b), place
        for k, pair in enumerate(zip(a, b, strict=True)):
            assert_same(*pair, f"{place}[{k}]")
    else:
        assert a == b, place


# --- files -----------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_files(written: Path) -> None:
    assert set(contents(written)) == {
        "left.DIM", "right.DIM", "points.csv", "observations.csv", "project.toml",
        "truth/points.csv", "truth/eop.csv", "truth/options.json",
    }  # fmt: skip
    assert not [p for p in written.parent.iterdir() if p != written], "no temporary folder is left"


@pytest.mark.behaviour
def test_no_file_holds_a_path(written: Path) -> None:
    for name, content in contents(written).items():
        assert str(written.parent).encode() not in content, name
        assert b"/tmp" not in content and b"/home" not in content, name


@pytest.mark.consistency
def test_the_block_in_memory_is_the_block_of_the_files(written: Path) -> None:
    block, _ = zonguldak_block(OPTIONS)
    read = read_project(written / "project.toml")
    assert read.name == block.name
    for mine, theirs in zip(block.images, read.images, strict=True):
        assert mine.id == theirs.id
        assert_same(mine.sensor.metadata, theirs.sensor.metadata, mine.id)
    assert_same(block.points, read.points, "points")
    assert_same(block.observations, read.observations, "observations")
    assert block.withheld.ids == read.withheld.ids
    assert_same(block.withheld.open(), read.withheld.open(), "withheld")
    assert_same(block.options, read.options, "options")


@pytest.mark.behaviour
def test_the_metadata_are_as_defined(written: Path) -> None:
    for image in read_project(written / "project.toml").images:
        m = image.sensor.metadata
        ends = image.sensor._line_time(np.array([0.0, N_LINES - 1.0]))
        t = m.ephemeris.time_s
        assert len(t) == 9 and (t < ends[0]).sum() >= 4 and (t > ends[1]).sum() >= 4
        np.testing.assert_array_equal(np.diff(t), 30.0)
        a = m.attitude.time_s
        assert len(a) == 233 and a[0] <= ends[0] - 0.5 and a[-1] >= ends[1] + 0.5
        np.testing.assert_array_equal(np.diff(a), 0.125)
        assert len(m.look.sample) == 12000 and (m.n_lines, m.n_samples) == (12000, 12000)
        assert m.timing.line_period_s == 0.7521e-3 and m.timing.reference_line == 6000.0
        corners = np.array([[p.line, p.sample] for p in m.frame_points])
        np.testing.assert_array_equal(corners, [[0, 0], [0, 11999], [11999, 11999], [11999, 0], [6000, 6000]])
        for p in m.frame_points:
            seen = image.sensor.locate(p.line, p.sample, height_m=0.0)
            assert np.linalg.norm(geodetic_to_ecef(p.lon_deg, p.lat_deg, 0.0) - seen) < 1e-3  # height solved to 1e-5 m


@pytest.mark.consistency
def test_truth_files(written: Path) -> None:
    _, truth = zonguldak_block(OPTIONS)
    with (written / "truth" / "eop.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 2 * (27 + 6)
    for row in rows:
        correction = truth.corrections[truth.image_ids.index(row["image"])]
        degree, value = int(row["degree"]), float(row["value_per_tau"])
        if row["component"].startswith("psi"):
            assert value == correction.look["xy".index(row["component"][-1]), degree] == (3e-6 if degree == 2 else 0.0)
            assert row["unit"] == "rad"
        else:
            component = "x y z vx vy vz roll pitch yaw".split().index(row["component"])
            assert value == correction.eop[component, degree] != 0.0
            assert row["unit"] == ("m", "m/s", "rad")[component // 3]
    with (written / "truth" / "points.csv").open(newline="") as stream:
        points = list(csv.DictReader(stream))
    assert tuple(p["id"] for p in points) == truth.point_ids
    np.testing.assert_array_equal([[float(p[f"{c}_m"]) for c in "xyz"] for p in points], truth.ecef_m)
    options = json.loads((written / "truth" / "options.json").read_text())
    assert options["seed"] == 3 and options["errors"] == "prior" and options["command"] == "simulate zonguldak"


@pytest.mark.behaviour
def test_the_same_seed_gives_the_same_bytes(written: Path, tmp_path: Path) -> None:
    again = simulate_zonguldak(tmp_path / "again", OPTIONS).parent
    assert contents(again) == contents(written)
    other = simulate_zonguldak(tmp_path / "other", replace(OPTIONS, seed=4)).parent
    changed = {name for name, content in contents(other).items() if content != contents(written)[name]}
    assert changed == set(contents(written)), "every file depends on the seed"


@pytest.mark.behaviour
def test_an_existing_folder_is_kept(written: Path, tmp_path: Path) -> None:
    target = tmp_path / "twin"
    shutil.copytree(written, target)
    before = contents(target)
    with pytest.raises(InputError) as caught:
        simulate_zonguldak(target, ZonguldakOptions(seed=9))
    assert caught.value.problems[0].code == "output.exists"
    assert contents(target) == before
    simulate_zonguldak(target, ZonguldakOptions(seed=9), overwrite=True)
    assert json.loads((target / "truth" / "options.json").read_text())["seed"] == 9
    (target / "result").mkdir()
    (target / "result" / "result.json").write_text("{}")
    with pytest.raises(InputError) as caught:
        simulate_zonguldak(target, overwrite=True)
    assert (caught.value.problems[0].code, caught.value.problems[0].value) == ("output.foreign", "result")
    assert (target / "result" / "result.json").read_text() == "{}"
    foreign = tmp_path / "mine"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError) as caught:
        simulate_zonguldak(foreign, overwrite=True)
    assert caught.value.problems[0].code == "output.foreign"
    assert [p.name for p in foreign.iterdir()] == ["thesis.txt"]


@pytest.mark.behaviour
def test_a_failure_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import fg_orient.simulate.files as files

    def broken(*args: object, **kwargs: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(files, "write_project", broken)
    with pytest.raises(KeyboardInterrupt):
        simulate_zonguldak(tmp_path / "twin")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.behaviour
def test_truth_is_not_needed(written: Path, tmp_path: Path) -> None:
    target = tmp_path / "twin"
    shutil.copytree(written, target)
    with_truth = adjust(read_project(target / "project.toml"))
    shutil.rmtree(target / "truth")
    without = adjust(read_project(target / "project.toml"))
    assert without.chi2 == with_truth.chi2
    np.testing.assert_array_equal(without.state.image, with_truth.state.image)
    np.testing.assert_array_equal(without.ground_m, with_truth.ground_m)
    assert_same(without.accuracy, with_truth.accuracy, "accuracy")


# --- truth -----------------------------------------------------------------------------------


@pytest.mark.oracle
def test_true_unknowns_give_the_noise_free_pixels(written: Path) -> None:
    block, truth = read_project(written / "project.toml"), zonguldak_block(OPTIONS)[1]
    for k, (image, correction) in enumerate(zip(block.images, truth.corrections, strict=True)):
        rows = block.observations.image == k
        seen = np.stack(image.sensor.project(truth.ecef_m[block.observations.point[rows]], correction), axis=1)
        np.testing.assert_allclose(seen, truth.pixels[rows], rtol=0.0, atol=TIME_ROUNDING_PX)
        ground = truth.ecef_m[block.observations.point[rows]]
        assert misses_m(image.sensor.metadata, *truth.pixels[rows].T, ground, correction).max() < 1e-6
        found = image.sensor.locate(*truth.pixels[rows].T, height_m=truth.lon_lat_height[:, 2], correction=correction)
        # locate solves the height to 1e-5 m; seen at 24 degrees at most
        assert np.linalg.norm(found - truth.ecef_m, axis=1).max() < 3e-5


@pytest.mark.oracle
def test_metadata_are_true_minus_error() -> None:
    """The sensor with errors and the true correction has the rays of the sensor without errors.

    This includes changing attitudes.
    """
    wrong, truth = zonguldak_block(replace(OPTIONS, distortion_rad=0.0))
    right, _ = zonguldak_block(replace(OPTIONS, distortion_rad=0.0, errors="none"))
    line = sample = np.linspace(0.0, N_LINES - 1.0, 50)
    for a, b, correction in zip(wrong.images, right.images, truth.corrections, strict=True):
        assert np.abs(correction.eop).min() > 0.0
        p, u = a.sensor.rays(line, sample, correction)
        q, v = rays(b.sensor.metadata, line, sample)
        # ephemeris: polynomials of degree 2 are interpolated exactly, rounding of 7e6 m amplified by weights below 10
        assert np.abs(p - q).max() < 1e-7
        # attitude: chord of c2 tau^2 over 0.125 s, |c2| (0.0139)^2 = 1e-9 rad for 3 sigma, c2 = 6e-6 rad
        assert np.abs(u - v).max() < 2e-9


@pytest.mark.consistency
@pytest.mark.parametrize("eop_set", [1, 6, 10, 12, 15, 20])
def test_without_errors_nothing_is_corrected(eop_set: int) -> None:
    """Without noise and errors, corrections and residuals are rounding errors (claim C2)."""
    block, truth = zonguldak_block(EXACT)
    solution = adjust(block, eop_set=eop_set)
    assert solution.status is Status.CONVERGED
    # rounding of the pixels: 5e-9 px against sigma 0.3 px; directions weaker than 1e-3 of their prior do not move
    assert np.abs(solution.state.image).max() < 1e-5
    assert np.abs(solution.residuals_px).max() < 10 * TIME_ROUNDING_PX
    assert np.linalg.norm(solution.ground_m - truth.ecef_m, axis=1).max() < 1e-6


@pytest.mark.oracle
def test_intersection_is_exact() -> None:
    """Rays without noise meet in the true points within 1e-6 m, from pixels alone (claim C2)."""
    block, truth = zonguldak_block(replace(EXACT, point_set="H-40"))
    nothing = np.full_like(truth.ecef_m, np.nan)
    found = initial.ground_points(block.images, block.observations, block.points.ids, nothing)
    assert np.linalg.norm(found - truth.ecef_m, axis=1).max() < 1e-6
    for k, image in enumerate(block.images):
        o, rows = block.observations, block.observations.image == k
        assert misses_m(image.sensor.metadata, o.line[rows], o.sample[rows], found[o.point[rows]]).max() < 1e-6


@pytest.mark.truth
def test_noise_is_what_was_asked_for() -> None:
    block, truth = zonguldak_block(ZonguldakOptions(seed=1, image_noise_px=0.5))
    noise = np.stack([block.observations.line, block.observations.sample], axis=1) - truth.pixels
    # 94 values per coordinate: standard deviation known to 7.3 %, so 4 of these
    np.testing.assert_allclose(noise.std(axis=0), 0.5, rtol=0.3)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 4.0 / math.sqrt(94.0)
    assert set(block.observations.sigma_line_px) == set(block.observations.sigma_sample_px) == {0.5}
    nominal, _ = zonguldak_block(replace(EXACT, seed=1))
    assert set(nominal.observations.sigma_line_px) == {0.3}


@pytest.mark.truth
def test_control_and_check_coordinates_are_measured() -> None:
    """Control and check coordinates have the noise 0.06 / 0.06 / 1.0 m; check coordinates are withheld."""
    normalised = []
    for seed in range(1, 5):
        block, truth = zonguldak_block(ZonguldakOptions(seed=seed, point_set="H-20"))
        opened = block.withheld.open()
        check = [truth.point_ids.index(name) for name in block.withheld.ids]
        assert len(check) == 20 and np.isnan(block.points.known.ecef_m[check]).all()
        measured = block.points.known.ecef_m.copy()
        measured[check] = opened.ecef_m
        lon, lat = np.radians(truth.lon_lat_height[:, :2]).T
        east = np.stack([-np.sin(lon), np.cos(lon), 0 * lon], axis=1)
        up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
        axes = np.stack([east, np.cross(up, east), up], axis=1)
        normalised.append(np.einsum("nij,nj->ni", axes, measured - truth.ecef_m) / [0.06, 0.06, 1.0])
        np.testing.assert_array_equal(opened.sigma_enu_m, [[0.06, 0.06, 1.0]] * 20)
    # 188 values per axis: standard deviation known to 5.2 %, so 4 of these
    np.testing.assert_allclose(np.vstack(normalised).std(axis=0), 1.0, rtol=0.21)


@pytest.mark.truth
@pytest.mark.parametrize("seed", [1, 2])
def test_constant_errors(seed: int) -> None:
    _, truth = zonguldak_block(ZonguldakOptions(seed=seed))
    size = np.zeros((9, 3))
    size[0:3, 0], size[6:9, 0] = 5.0, 20e-6
    for correction in truth.corrections:
        np.testing.assert_array_equal(np.abs(correction.eop), size)
    signs = np.sign([c.eop[[0, 1, 2, 6, 7, 8], 0] for c in truth.corrections])
    assert not np.array_equal(*signs), "drawn per image"


@pytest.mark.behaviour
def test_one_stream_does_not_disturb_the_others(default: tuple[Block, Truth]) -> None:
    block, truth = default
    noise = np.stack([block.observations.line, block.observations.sample], axis=1) - truth.pixels
    for change in ({"point_set": "G-B"}, {"errors": "none"}, {"distortion_rad": 3e-6}, {"errors": "prior"}):
        other, other_truth = zonguldak_block(replace(ZonguldakOptions(), **change))
        np.testing.assert_array_equal(other_truth.ecef_m, truth.ecef_m, err_msg=str(change))
        same = np.stack([other.observations.line, other.observations.sample], axis=1) - other_truth.pixels
        np.testing.assert_allclose(same, noise, rtol=0.0, atol=1e-11, err_msg=str(change))  # eps of 12000 px
        if "point_set" not in change:
            assert other.points.roles == block.points.roles
        else:
            assert other.points.roles != block.points.roles
            for a, b in zip(truth.corrections, other_truth.corrections, strict=True):
                np.testing.assert_array_equal(a.eop, b.eop)


# --- geometry --------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_points_lie_well_inside_both_images(default: tuple[Block, Truth]) -> None:
    block, truth = default
    assert len(truth.point_ids) == N_POINTS == 47
    assert len(block.points.where(Role.CHECK)) == 10 and len(block.observations) == 94
    # the metadata's errors do not move true pixels; only noise and distortion (0.5 px) do
    assert truth.pixels.min() > MARGIN_PX - 1.0 and truth.pixels.max() < N_SAMPLES - MARGIN_PX
    height = truth.lon_lat_height[:, 2]
    assert height.min() >= 0.0 and height.max() <= 1800.0 and np.ptp(height) > 1200.0
    assert np.ptp(truth.pixels, axis=0).min() > 9000.0, "spread over the images"


@pytest.mark.truth
def test_the_views_come_from_opposite_sides(default: tuple[Block, Truth]) -> None:
    block, _ = default
    target = geodetic_to_ecef(31.85, 41.3, 0.0)[0]
    places = []
    for image, side in zip(block.images, (1.0, -1.0), strict=True):
        position = image.sensor.states(6000.0).position_m[0]
        lon, _, height = ecef_to_geodetic(position)
        assert side * (lon[0] - 31.85) > 2.0, "left image: looks right (west) from a track in the east"
        assert height[0] == pytest.approx(834e3, abs=1e3)  # 7203 km minus the Earth's radius at 41 degrees
        places.append(position)
        # errors of 5 m and 20 microrad shift the view by at most a few times 20 m
        assert np.linalg.norm(image.sensor.locate(6000.0, 5999.5, height_m=0.0) - target) < 60.0
    base = np.linalg.norm(places[0] - places[1])
    assert 0.75 < base / 834e3 < 0.80


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("roll_deg", "low_km", "high_km"), [(-19.0, 280, 330), (21.0, 280, 330), (-18.0, 268, 278), (20.0, 300, 311)]
)
def test_ground_tracks(roll_deg: float, low_km: float, high_km: float) -> None:
    """The ground tracks have the distance of the closed formula on a sphere within 1 m.

    The specified 280 to 330 km belong to 19 and 21 degrees; the twin's 18 and 20 see 273 and 306 km. On a sphere
    through the point: sin(incidence) = r sin(roll) / R, distance = R (incidence - roll).
    """
    target = geodetic_to_ecef(31.85, 41.3, 0.0)[0]
    position = find_pass(target, math.radians(roll_deg)).states(0.0)[0][0]
    cosine = position @ target / np.linalg.norm(position) / np.linalg.norm(target)
    distance_km = math.acos(cosine) * np.linalg.norm(target) / 1e3
    assert low_km < distance_km < high_km
    roll, ratio = math.radians(abs(roll_deg)), np.linalg.norm(position) / np.linalg.norm(target)
    expected = (math.asin(ratio * math.sin(roll)) - roll) * np.linalg.norm(target) / 1e3
    assert distance_km == pytest.approx(expected, abs=1e-3)


def forward_axes(sensor: PushbroomSensor, line: np.ndarray) -> np.ndarray:
    """Return the Y axes of the orbital frame, Z x X, at N lines."""
    states = sensor.states(line)
    right = np.cross(states.velocity_m_s, states.position_m)
    forward = np.cross(states.position_m, right)
    return forward / np.linalg.norm(forward, axis=1, keepdims=True)


@pytest.mark.oracle
def test_angles_of_a_pixel(default: tuple[Block, Truth]) -> None:
    """Derivatives by pixels are the detector's angle across track and the motion over a line along track.

    Across track it is p/f / cos^2 psi_y; along track the rotation of the orbital frame is subtracted.
    """
    for image in default[0].images:
        sensor = image.sensor
        line = sample = np.linspace(1.0, N_LINES - 2.0, 9)
        ground = sensor.locate(line, sample, height_m=0.0)
        j = pixel_derivative(sensor, line, sample, ground, Correction())
        _, psi_y = sensor.look_angles(sample)
        mirror = sensor.look_angles(5999.5)[1]
        chord = 6.5e-6 / 1.082 * np.cos(psi_y - mirror) ** 2 / np.cos(psi_y) ** 2
        np.testing.assert_allclose(-j[:, 0, 1], chord, rtol=1e-4)
        states = sensor.states(line)
        radial = states.position_m / np.linalg.norm(states.position_m, axis=1, keepdims=True)
        depth = np.einsum("ij,ij->i", states.position_m - ground, radial)
        right = np.cross(states.velocity_m_s, radial)
        speed = np.linalg.norm(right, axis=1)
        turn = (
            np.einsum("ij,ij->i", forward_axes(sensor, line + 1.0) - forward_axes(sensor, line - 1.0), right)
            / speed
            / 2
        )
        fall = 0.7521e-3 * speed * (1.0 / depth - 1.0 / np.linalg.norm(states.position_m, axis=1))
        # half a pixel of curvature and the attitude error of 20 microrad: 1e-5 relative
        np.testing.assert_allclose(j[:, 1, 0], fall + np.tan(psi_y) * turn, rtol=1e-4)
        assert 6.4e-6 < chord.min() and chord.max() < 7.0e-6
        assert 5.9e-6 < j[:, 1, 0].min() and j[:, 1, 0].max() < 6.0e-6
