"""SPOT-5, RPC and frame images form one block with the same commands and equations; it is well calibrated."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyproj
import pytest
from scipy import stats

import fg_orient as fg
from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError
from fg_orient.model.names import Status
from fg_orient.sensors.frame import FrameSensor
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.sensors.rpc_sensor import RpcSensor
from fg_orient.simulate.mixed import MixedOptions, mixed_block, rpc_models, simulate, simulate_mixed
from fg_orient.simulate.simulation import Truth
from fg_orient.simulate.zonguldak import CENTRE_LON_LAT_DEG
from tests.support.command import in_process
from tests.support.full_statistics import step_of_numpy
from tests.support.mixed_study import SENSORS, run, uniform, weighted
from tests.support.published_rays import misses_m
from tests.support.rpc_model import reference_project

FAST, ALL = range(1, 4), range(1, 201)


@lru_cache
def small() -> tuple[Block, Truth]:
    return mixed_block(MixedOptions(seed=3, points=40))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_mixed(tmp_path_factory.mktemp("mixed") / "block", MixedOptions(seed=3, points=40)).parent


@pytest.mark.behaviour
def test_three_kinds_of_sensors_and_their_pixels() -> None:
    """The three sensors have pixels of 5, 0.7 and 0.2 m at the middle of the window, within -10 and +25 %.

    Obliquity and relief enlarge them.
    """
    block, _ = small()
    kinds = [type(image.sensor) for image in block.images]
    assert kinds == [PushbroomSensor] * 2 + [RpcSensor] * 2 + [FrameSensor] * 4
    centre = geodetic_to_ecef(*CENTRE_LON_LAT_DEG, 250.0)
    for image, pixel_m in zip(block.images, [5.0] * 2 + [0.7] * 2 + [0.2] * 4, strict=True):
        line, sample = image.sensor.project(centre)
        at = line + np.array([0.0, 1.0, 0.0]), sample + np.array([0.0, 0.0, 1.0])
        ground = image.sensor.locate(*at, height_m=np.full(3, 250.0))
        sizes = np.linalg.norm(ground[1:] - ground[0], axis=1)
        assert np.all((sizes > 0.9 * pixel_m) & (sizes < 1.25 * pixel_m)), (image.id, sizes)


@pytest.mark.behaviour
def test_every_point_is_in_the_satellite_images_and_some_in_all_frames() -> None:
    o = small()[0].observations
    assert np.bincount(o.image)[:4].tolist() == [40] * 4
    assert np.bincount(o.point).max() == 8


@pytest.mark.behaviour
def test_rpc_look_ahead_and_back() -> None:
    """The two RPC images see the ground at a convergence of 26 to 31 degrees.

    Pitch of -12 and 14 degrees at the satellite is more at the ground, by the curvature of the Earth.
    """
    rays = [RpcSensor(m).rays(np.array([7000.0]), np.array([7000.0]))[1][0] for m in rpc_models()]
    assert 26.0 < np.degrees(np.arccos(rays[0] @ rays[1])) < 31.0


@pytest.mark.oracle
def test_without_errors_and_noise_the_files_are_the_truth() -> None:
    none = MixedOptions(seed=2, points=20, control=4, check=4, errors="none", spot_noise_px=0.0, rpc_noise_px=0.0,
                        frame_noise_px=0.0)  # fmt: skip
    simulation = simulate(none)
    block, truth = simulation.block(), simulation.truth
    assert np.array_equal(simulation.observed, truth.pixels)
    for k, image in enumerate(block.images):
        rows = simulation.image == k
        pixels = np.stack(image.sensor.project(truth.ecef_m[simulation.point[rows]]), axis=1)
        np.testing.assert_allclose(pixels, truth.pixels[rows], atol=1e-9)
        ground = truth.ecef_m[simulation.point[rows]]
        if isinstance(image.sensor, PushbroomSensor):
            assert misses_m(image.sensor.metadata, *truth.pixels[rows].T, ground).max() < 1e-6
        elif isinstance(image.sensor, RpcSensor):
            geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*ground.T)
            expected = np.stack(reference_project(image.sensor.model, *geodetic), axis=1).astype(float)
            np.testing.assert_allclose(truth.pixels[rows], expected, atol=1e-6)
    assert set(simulation.sigma_px.ravel()) == {0.3}


@pytest.mark.behaviour
@pytest.mark.parametrize("wrong", [{"seed": -1}, {"control": 2}, {"points": 15}, {"rpc_noise_px": -0.1},
                                   {"errors": "some"}, {"ground_noise_m": (0.1, 0.1, np.inf)}])  # fmt: skip
def test_options_out_of_range_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError) as caught:
        MixedOptions(**wrong)  # type: ignore[arg-type]
    (name,) = wrong
    (problem,) = caught.value.problems  # 15 points are fewer than the default numbers of control and check points
    assert (problem.code, problem.option) == ("options.value", "control, check" if name == "points" else name)


@pytest.mark.consistency
def test_files_give_the_same_block(folder: Path) -> None:
    """The written files of the mixed block are read as the same block, with projections within 1e-8 px."""
    read, drawn = fg.read_project(folder / "project.toml"), small()[0]
    assert read.options == drawn.options
    for name in ("image", "point", "line", "sample", "sigma_line_px", "sigma_sample_px"):
        assert np.array_equal(getattr(read.observations, name), getattr(drawn.observations, name))
    ground = small()[1].ecef_m
    for a, b in zip(read.images, drawn.images, strict=True):
        assert (a.id, type(a.sensor)) == (b.id, type(b.sensor))
        np.testing.assert_allclose(a.sensor.project(ground), b.sensor.project(ground), rtol=0.0, atol=1e-8)
        if isinstance(b.sensor, FrameSensor):
            assert (a.sensor.camera.sigma, a.sensor.camera.shared) == (b.sensor.camera.sigma, b.sensor.camera.shared)


@pytest.mark.oracle
def test_backends_end_where_numpy_has_no_step_left() -> None:
    """All three backends end where numpy's least squares has no step left, with equal unknowns and sigmas."""
    block, _ = small()
    graph, *others = (fg.adjust(block, backend=backend) for backend in ("graph", "schur", "dense"))
    for found in (graph, *others):
        image, ground = step_of_numpy(found.problem, found.state)
        assert image < 1e-7 and ground < 1e-6
    for other in others:
        np.testing.assert_allclose(other.state.image, graph.state.image, atol=1e-7)
        np.testing.assert_allclose(other.ground_m, graph.ground_m, atol=1e-6)
        assert other.chi2 == pytest.approx(graph.chi2, rel=1e-10)
        assert other.redundancy == graph.redundancy
        for image in ("spot1", "pleiades2", "frame4"):
            sigmas = [np.diag(s.covariance(f"image:{image}").values) for s in (other, graph)]
            np.testing.assert_allclose(*sigmas, rtol=1e-6)


@pytest.mark.oracle
def test_the_frames_share_one_camera() -> None:
    """The frames share one camera: its unknowns count once in unknowns and redundancy, and its focal length is found.

    Unknowns: 18 + 18 EOP, 4 + 4 of the RPC, 4 x 6 exterior, 3 of the camera once; each prior is one observation.
    """
    block, truth = small()
    solution = fg.adjust(block)
    assert solution.problem.n_free_unknowns == 36 + 8 + 24 + 3
    assert solution.redundancy == 2 * len(block.observations) + 3 * 8 - 3 * 40
    assert len({solution.correction(f"frame{k}")[6] for k in range(1, 5)}) == 1
    sigma = np.sqrt(solution.covariance("image:frame1").values[6, 6])
    assert abs(solution.correction("frame1")[6] - truth.corrections[4][6]) < 4.0 * sigma
    assert sigma < 1.0  # the prior sigma is 2 px


@pytest.mark.behaviour
def test_commands_take_the_block(folder: Path, tmp_path: Path) -> None:
    """``adjust`` and ``report --truth`` adjust the mixed block without special options."""
    out = tmp_path / "result"
    assert in_process("adjust", folder / "project.toml", "--out", out).code == 0
    assert json.loads((out / "result.json").read_text())["status"] == "converged"
    ended = in_process("report", out, "--truth", folder / "truth")
    assert ended.code == 0
    for image in ("spot1", "pleiades1", "frame1"):
        row = next(line for line in ended.stdout.splitlines() if f"orientation of image {image}" in line)
        assert float(row.split()[-1]) < 5.0


@pytest.mark.behaviour
def test_simulate_mixed(tmp_path: Path) -> None:
    out, words = tmp_path / "m", ("simulate", "mixed", "--points", 30, "--seed", 4, "--out")
    assert in_process(*words, out).code == 0
    found = {p.name for p in out.iterdir()}
    assert {"camera.toml", "frame4.toml", "pleiades2_RPC.TXT", "spot1.DIM", "truth"} < found
    assert in_process(*words, out).code == 2
    assert in_process(*words, out, "--overwrite").code == 0


@pytest.mark.oracle
def test_global_test_of_a_few_seeds() -> None:
    """The chi2 over seeds lies in its 99.8 % interval, and outside it if one sensor has a wrong weight."""
    outcomes = [run(seed, components=False, points=40) for seed in FAST]
    low, high = stats.chi2(sum(o.redundancy for o in outcomes)).ppf([0.001, 0.999])
    assert low < sum(o.chi2 for o in outcomes) < high
    for sensor, factor in zip(SENSORS, (1.4, 1.4, 0.65), strict=True):
        wrong = [run(seed, {sensor: factor}, components=False, points=40) for seed in FAST]
        assert not low < sum(o.chi2 for o in wrong) < high, sensor


@pytest.mark.oracle
def test_components_find_wrong_weights() -> None:
    """Variance components correct wrong sigmas to the true ones, and the result does not depend on the start."""
    wrong = dict(zip(SENSORS, (2.0, 0.5, 3.0), strict=True))
    right, found = (run(5, weights, points=30) for weights in ({}, wrong))
    np.testing.assert_allclose(found.factors * list(wrong.values()), right.factors, rtol=1e-3)
    assert np.all(np.abs(right.factors - 1.0) < 4.0 * right.sds)


@pytest.mark.oracle
@pytest.mark.slow
def test_global_test_and_components_of_200_seeds() -> None:
    """Over 200 seeds p-values are uniform and factors of sigmas within 10 % of 1; with a wrong weight both fail."""
    outcomes = [run(seed) for seed in ALL]
    factors = np.array([o.factors for o in outcomes])
    scatter, sds = factors.std(axis=0, ddof=1), np.array([o.sds for o in outcomes])
    print(uniform(outcomes), factors.mean(axis=0), scatter, sds.mean(axis=0))
    assert np.all(np.abs(scatter / sds.mean(axis=0) - 1.0) < 0.2)  # four of its own sigmas, 1 / sqrt(400)
    assert uniform(outcomes) > 0.01
    assert sum(o.doubted for o in outcomes) <= 6  # a share of 0.8 % is allowed: one in a thousand such runs has more
    assert np.all(np.abs(factors.mean(axis=0) - 1.0) < 0.1)
    for k, sensor in enumerate(SENSORS):
        wrong = [run(seed, {sensor: 0.85}, components=seed <= 20) for seed in ALL]
        print(sensor, uniform(wrong), np.nanmean([o.factors[k] for o in wrong]))
        assert uniform(wrong) < 0.01, sensor
        assert np.nanmean([o.factors[k] for o in wrong]) > 1.1


@pytest.mark.behaviour
def test_wrong_weights_are_those_of_one_sensor() -> None:
    block, _ = small()
    other = weighted(block, {"image points of Rpc": 2.0})
    ratio = other.observations.sigma_line_px / block.observations.sigma_line_px
    assert np.array_equal(ratio == 2.0, np.isin(block.observations.image, (2, 3)))
    assert fg.adjust(other).status is Status.CONVERGED
