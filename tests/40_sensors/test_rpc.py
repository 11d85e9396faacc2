"""The RPC model and its sensor are tested on a synthetic scene: both directions, DEM, rays, validity, poles."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
from typer.testing import CliRunner

from factors.cameras import rfm_equation
from fg_orient.cli import app
from fg_orient.formats.rpc import write_rpc
from fg_orient.geodesy import geodetic_to_ecef
from fg_orient.model.errors import InputError, OutOfImage
from fg_orient.sensors.rpc import RpcModel, RpcValidity
from fg_orient.sensors.rpc_sensor import RpcSensor
from tests.support.rpc_model import ground_points, reference_project, synthetic_model

GEODETIC = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
COMPENSATION = np.array([3.0, -2.0, 0.5, 0.25, -0.125, 1.0])


@pytest.fixture(scope="module")
def sensor() -> RpcSensor:
    return RpcSensor(synthetic_model())


def grid(sensor: RpcSensor, n: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels over the whole image."""
    ends = (sensor.first_line, sensor.last_line), (sensor.first_sample, sensor.last_sample)
    line, sample = np.meshgrid(*(np.linspace(a, b, n) for a, b in ends))
    return line.ravel(), sample.ravel()


def seen(sensor: RpcSensor, lon: np.ndarray, lat: np.ndarray, height_m: Any, terms: np.ndarray | None) -> np.ndarray:
    """Return lines and samples by a separate evaluation, plus an affine compensation in normalised pixels."""
    plain = np.array(reference_project(sensor.model, lon, lat, np.broadcast_to(height_m, lon.shape)), float)
    if terms is None:
        return plain
    l, s = (plain - sensor.model.offsets[:2, None]) / sensor.model.scales[:2, None]  # noqa: E741
    shift, by_line, by_sample = terms.reshape(3, 2, 1)
    return plain + shift + by_line * l + by_sample * s


class Slope:
    """The DEM is a tilted plane: 300 m in the middle, 2 % to the north-east."""

    path = "slope"
    range_m = (100.0, 500.0)

    def cell(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (41.5 - lat_deg) / 2e-4, (lon_deg - 31.7) / 2e-4

    def height_m(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
        return np.asarray(300.0 + 800.0 * (lon_deg - 31.8) + 900.0 * (lat_deg - 41.4))


@pytest.mark.oracle
@pytest.mark.parametrize("compensation", [None, COMPENSATION])
@pytest.mark.parametrize("height_m", [0.0, 480.0, 1000.0])
def test_locate_and_project_return_the_pixel(
    sensor: RpcSensor, height_m: float, compensation: np.ndarray | None
) -> None:
    """An RPC pixel that is located and projected returns within 1e-7 px, and within 1e-9 px in geodetic coordinates."""
    line, sample = grid(sensor)
    lon, lat = sensor.model.locate(line, sample, height_m, compensation)
    assert np.abs(seen(sensor, lon, lat, height_m, compensation) - [line, sample]).max() < 1e-9
    ground = sensor.locate(line, sample, height_m=height_m, correction=compensation)
    lon, lat, height = GEODETIC.transform(*ground.T)
    assert np.abs(seen(sensor, lon, lat, height, compensation) - [line, sample]).max() < 1e-7
    assert np.abs(height - height_m).max() < 1e-8
    l_back, s_back = sensor.project(ground, compensation)
    assert max(np.abs(l_back - line).max(), np.abs(s_back - sample).max()) < 1e-7


@pytest.mark.oracle
def test_projection_of_ecef_points_equals_an_independent_one(sensor: RpcSensor) -> None:
    lon, lat, h = ground_points(sensor.model)
    line, sample = sensor.project(geodetic_to_ecef(lon, lat, h))
    l_ref, s_ref = reference_project(sensor.model, lon, lat, h)
    assert max(np.abs(line - l_ref).max(), np.abs(sample - s_ref).max()) < 1e-7


@pytest.mark.oracle
def test_vendor_inverse_serves_as_a_guess_and_is_given_on_request() -> None:
    """The vendor's inverse, good or useless, does not change the located point, and ``locate_directly`` uses it."""
    model = synthetic_model()
    line, sample = np.array([10.0, 15000.0]), np.array([20.0, 3000.0])
    direct = np.zeros((4, 20))
    direct[1::2, 0], direct[0, 1], direct[2, 2] = 1.0, 1.0, -1.0  # longitude from sample, latitude from -line
    bad = direct.copy()
    bad[1, :3] = 1.0, 1e3, -1e3
    plain = np.stack(model.locate(line, sample, 200.0))
    assert np.abs(np.array(reference_project(model, *plain, np.full(2, 200.0)), float) - [line, sample]).max() < 1e-7
    for given in (direct, bad):
        found = np.stack(replace(model, direct=given).locate(line, sample, 200.0))
        assert np.abs(found - plain).max() < 1e-13
    lon, lat = replace(model, direct=direct).locate_directly(line, sample, 200.0)
    assert lon == pytest.approx(31.8 + 0.072 * (sample - 12000.0) / 12000.0)
    assert lat == pytest.approx(41.4 - 0.045 * (line - 10000.0) / 10000.0)


@pytest.mark.oracle
def test_location_across_the_date_line() -> None:
    model = synthetic_model(offsets=[10000.0, 12000.0, 179.99, 10.0, 500.0])
    lon, lat = model.locate(10000.0, 23000.0, 500.0)
    assert -180.0 <= lon[0] < -179.9
    line, sample = model.project(lon, lat, 500.0)
    assert (line[0], sample[0]) == pytest.approx((10000.0, 23000.0), abs=1e-6)
    expected = reference_project(model, lon + 360.0, lat, np.array([500.0]))
    assert (float(expected[0][0]), float(expected[1][0])) == pytest.approx((10000.0, 23000.0), abs=1e-6)
    assert model.inside(lon, lat, 500.0).all()
    assert RpcSensor(model).records(line, sample, geodetic_to_ecef(lon, lat, [500.0]))[0, 10] == pytest.approx(
        0.92, abs=0.1
    )


@pytest.mark.oracle
def test_located_on_a_dem(sensor: RpcSensor) -> None:
    """A pixel located on a DEM keeps its image coordinates within 1e-7 px and meets the DEM within 0.2 mm."""
    line, sample = grid(sensor, 7)
    dem = Slope()
    ground = sensor.locate(line, sample, dem=dem)
    lon, lat, h = GEODETIC.transform(*ground.T)
    assert np.abs(h - dem.height_m(lon, lat)).max() < 2e-4
    assert np.abs(seen(sensor, lon, lat, h, None) - [line, sample]).max() < 1e-7


@pytest.mark.oracle
def test_rays_pass_through_the_located_points(sensor: RpcSensor) -> None:
    """The ray of a pixel passes within 1e-6 m of its points at the lowest and the highest valid height.

    Between them lines of sight are bent.
    """
    line, sample = grid(sensor, 5)
    position, direction = sensor.rays(line, sample)
    assert np.abs(np.linalg.norm(direction, axis=1) - 1.0).max() < 1e-15
    for h in (0.0, 1000.0):
        ground = sensor.locate(line, sample, height_m=h)
        assert np.abs(seen(sensor, *GEODETIC.transform(*ground.T), None) - [line, sample]).max() < 1e-7
        to = ground - position
        along = np.einsum("ij,ij->i", to, direction)
        assert along.min() > 4e5
        assert np.linalg.norm(to - along[:, None] * direction, axis=1).max() < 1e-6


@pytest.mark.oracle
def test_footprint_and_centre(sensor: RpcSensor) -> None:
    corners = sensor.footprint()
    line = [sensor.first_line, sensor.first_line, sensor.last_line, sensor.last_line]
    sample = [sensor.first_sample, sensor.last_sample, sensor.last_sample, sensor.first_sample]
    assert np.abs(seen(sensor, *corners.T, 500.0, None) - [line, sample]).max() < 1e-6
    twice_area = np.sum(corners[:, 0] * np.roll(corners[:, 1], -1) - np.roll(corners[:, 0], -1) * corners[:, 1])
    assert twice_area < 0.0  # clockwise
    lon, lat, h = (np.atleast_1d(v) for v in GEODETIC.transform(*np.ravel(sensor.centre_m)))
    assert seen(sensor, lon, lat, h, None).ravel() == pytest.approx([10000.0, 12000.0], abs=1e-6)


@pytest.mark.behaviour
def test_size_of_the_image() -> None:
    """The image size of an RPC is that of the file, of its validity, or of offset and scale."""
    assert (RpcSensor(synthetic_model()).n_lines, RpcSensor(synthetic_model()).n_samples) == (20001, 24001)
    sized = RpcSensor(synthetic_model(n_lines=100, n_samples=200))
    assert (sized.n_lines, sized.last_line, sized.last_sample) == (100, 99.0, 199.0)
    stated = RpcValidity((-27.0, 500.0), (0.0, 600.0), (31.7, 31.9), (41.3, 41.5), (0.0, 1e3))
    partial = RpcSensor(synthetic_model(stated_validity=stated))
    assert (partial.n_lines, partial.n_samples, partial.first_line) == (501, 601, -27.0)
    assert partial.is_inside(np.array([-27.5, -27.6]), np.zeros(2)).tolist() == [True, False]


@pytest.mark.behaviour
def test_pixels_outside_are_refused(sensor: RpcSensor) -> None:
    with pytest.raises(
        OutOfImage, match=r"synthetic, line 20000\.6, sample 0: the pixel is outside.*lines run from -0\.5 to 20000\.5"
    ):
        sensor.locate([0.0, 20000.6], [0.0, 0.0], height_m=0.0)


@pytest.mark.behaviour
def test_ground_points_outside_the_validity_are_flagged_and_refused(sensor: RpcSensor) -> None:
    lon, lat, h = [31.8, 31.8, 41.4], [41.4, 41.4, 31.8], [500.0, 1000.5, 500.0]
    assert sensor.model.inside(lon, lat, h).tolist() == [True, False, False]
    sensor.model.require_valid(31.8, 41.4, 500.0)
    with pytest.raises(InputError, match=r"synthetic, point 2: .*height 1000\.5; 2 such.*order of the coordinates"):
        sensor.model.require_valid(lon, lat, h)


@pytest.mark.behaviour
def test_a_pixel_without_ground_is_refused() -> None:
    """A pixel that meets no ground at a height is refused with pixel and valid heights."""
    c = np.zeros((4, 20))
    c[1::2, 0], c[0, 7], c[0, 3], c[2, 2] = 1.0, 1.0, 1.0, 1.0
    model = RpcModel(np.array([10.0, 10.0, 30.0, 40.0, 0.0]), np.array([10.0, 10.0, 0.1, 0.1, 100.0]), c)
    with pytest.raises(InputError, match=r"line 2, sample 5: the pixel has no ground point.*-100 \.\. 100 m"):
        RpcSensor(model).locate(2.0, 5.0, height_m=90.0)


# --- soundness -------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_arrays_are_read_only_copies() -> None:
    given = synthetic_model().coefficients.copy()
    model = synthetic_model(coefficients=given)
    given[0, 0] = 7.0
    assert model.coefficients[0, 0] != 7.0
    with pytest.raises(ValueError, match="read-only"):
        model.offsets[0] = 1.0


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"coefficients": np.ones((4, 19))}, r"coefficients: .*the shape \(4, 20\) \(found shape \(4, 19"),
        ({"coefficients": np.ones((4, 21))}, r"found shape \(4, 21\)"),
        ({"offsets": [1.0, 2.0, 3.0]}, r"offsets.*shape \(5,\)"),
        ({"scales": [1.0, 1.0, np.nan, 1.0, 1.0]}, "scales: a value is not finite"),
        ({"scales": [1.0, 0.0, 1.0, 1.0, 1.0]}, "scale of sample: the scale is zero"),
        ({"coefficients": np.full((4, 20), 0.5)}, r"line denominator, coefficient 1: .*must be 1 \(found 0\.5\)"),
    ],
)  # fmt: skip
def test_unsound_models_are_refused(fields: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        synthetic_model(**fields)


@pytest.mark.behaviour
@pytest.mark.parametrize("compensation", [[1.0, 2.0], [0.0, 0.0, 0.0, 0.0, 0.0, np.nan]])
def test_wrong_compensation_is_refused(sensor: RpcSensor, compensation: list[float]) -> None:
    with pytest.raises(InputError, match="6 finite numbers"):
        sensor.project(sensor.centre_m, compensation)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("seed", "row", "term", "value"),
    [(1, 3, 1, -2.0), (51, 1, 2, -1.1), (50, 3, 1, 1.7), (53, 3, 1, 1.1)],
    ids=["inside the image", "before a corner", "before another", "before a third"],
)
def test_a_pole_is_refused_unless_taken(seed: int, row: int, term: int, value: float) -> None:
    """A denominator that is not positive in the image is refused, unless the caller passes ``poles=True``.

    Before a corner Newton's method steps over the pole and finds corners 20 to 130 times the model's range away.
    """
    c = synthetic_model(seed).coefficients.copy()
    c[row, term] = value
    model = synthetic_model(coefficients=c)
    inside = r"sample denominator: .*not positive everywhere.*RpcSensor\(model, poles=True\)"
    with pytest.raises(InputError, match=inside if seed == 1 else "not positive everywhere"):
        RpcSensor(model)
    if seed == 1:
        line, sample = RpcSensor(model, poles=True).model.project(31.8, 41.4, 500.0)
        assert np.isfinite([line[0], sample[0]]).all()


@pytest.mark.behaviour
def test_a_pole_outside_the_image_does_no_harm() -> None:
    """A pole inside the cube of normalised coordinates but outside the image is accepted."""
    c = np.zeros((4, 20))
    c[1::2, 0], c[0, 2], c[2, 1], c[3, 1] = 1.0, -100.0, 100.0, -1.5  # the image is 2 % of the cube
    model = RpcModel(np.array([100.0, 100.0, 31.8, 41.4, 0.0]), np.array([100.0, 100.0, 1.0, 1.0, 100.0]), c)
    assert RpcSensor(model).n_lines == 201


# --- the equation ----------------------------------------------------------------------------


@pytest.mark.oracle
def test_the_equation_gives_the_projection(sensor: RpcSensor, rng: np.random.Generator) -> None:
    """The RPC residual is projected + compensation - observed within 1e-7 px, from references up to 300 m off."""
    lon, lat, h = ground_points(sensor.model, 50)
    ground = geodetic_to_ecef(lon, lat, h)
    origin = ground.mean(axis=0)
    observed = rng.uniform(0.0, 2e4, (2, 50))
    records = sensor.records(*observed, ground + rng.normal(scale=300.0, size=ground.shape), origin)
    codes = np.array(rfm_equation.COMPENSATIONS["affine"], float)
    setup = np.stack([codes, np.full(6, 2.0)])
    residuals = np.array(
        [rfm_equation.residual(r, setup, COMPENSATION / 2.0, g) for r, g in zip(records, ground - origin, strict=True)]
    )
    expected = seen(sensor, lon, lat, h, COMPENSATION) - observed
    assert np.abs(residuals.T - expected).max() < 1e-7


def run(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, [str(word) for word in words])
    return done.exit_code, done.stdout


@pytest.mark.behaviour
def test_commands_take_rpc_files(tmp_path: Path) -> None:
    path = tmp_path / "scene_RPC.TXT"
    write_rpc(path, synthetic_model())
    code, out = run("locate", path, "--line", 5000, "--sample", 700, "--height", 250, "--json")
    assert code == 0, out
    point = json.loads(out)["points"][0]
    place = ("--lon", point["lon_deg"], "--lat", point["lat_deg"], "--height", point["height_m"])
    code, out = run("project", path, *place, "--json")
    assert code == 0, out
    pixel = json.loads(out)["points"][0]
    assert (pixel["line"], pixel["sample"], pixel["inside"]) == (pytest.approx(5000), pytest.approx(700), True)
    assert run("locate", path, "--frame")[0] == 2
