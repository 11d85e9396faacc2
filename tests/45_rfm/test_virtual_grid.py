"""A rational function is fitted to a sensor: to that of the twin and to the real SPOT-5 scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest

from fg_orient.formats.sensor import read_sensor
from fg_orient.model.errors import InputError
from fg_orient.rpc.fit import rms
from fg_orient.rpc.virtual_grid import SensorRfm, fit_sensor
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.published_rays import misses_m
from tests.support.rpc_model import reference_project

SHAPE = (12, 12, 5)


@pytest.fixture(scope="module")
def sensor() -> PushbroomSensor:
    """Return the sensor of the left image of the twin."""
    found = zonguldak_block(ZonguldakOptions(errors="none"))[0].images[0].sensor
    assert isinstance(found, PushbroomSensor)
    return found


@pytest.fixture(scope="module")
def fitted(sensor: PushbroomSensor) -> SensorRfm:
    return fit_sensor(sensor, (0.0, 2000.0), shape=SHAPE)


@pytest.mark.oracle
def test_stated_errors_are_those_against_rays_written_apart(sensor: PushbroomSensor, fitted: SensorRfm) -> None:
    assert rms(fitted.check_px).max() < 1e-3, "a smooth orbit and no attitude: a cubic rational function is enough"
    assert len(fitted.check_px) == np.prod(SHAPE)
    rng = np.random.default_rng(8)
    pixels, height = rng.uniform(0.0, 11999.0, (2, 500)), rng.uniform(0.0, 2000.0, 500)
    ground = sensor.locate(*pixels, height_m=height)
    assert misses_m(sensor.metadata, *pixels, ground).max() < 1e-6
    geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*ground.T)
    assert np.abs(geodetic[2] - height).max() < 1e-4
    found = np.array(reference_project(fitted.model("twin"), *geodetic), float)
    error = np.abs(found - pixels).max(axis=1)
    largest = np.abs(fitted.check_px).max(axis=0)
    assert (error < 2.0 * largest + 1e-6).all()
    assert np.abs(fitted.fit_px).max() < 3.0 * largest.max() + 1e-6


@pytest.mark.oracle
def test_inverse_model_locates(sensor: PushbroomSensor, fitted: SensorRfm) -> None:
    inverse, largest_m = fitted.inverse, np.abs(fitted.inverse_m).max()
    lat, lon = inverse.project(np.array([[6000.0, 3000.0, 700.0]]))  # sample, line, height
    ground = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(lon[0], lat[0], 700.0)
    metres = misses_m(sensor.metadata, np.array([3000.0]), np.array([6000.0]), np.array([ground]))[0]
    assert metres < 2.0 * largest_m + 1e-3
    assert largest_m < 0.05
    model = fitted.model()
    assert model.direct is not None
    np.testing.assert_array_equal(model.direct, inverse.coefficients[[2, 3, 0, 1]])


@pytest.mark.behaviour
def test_validity_is_that_of_the_grid(fitted: SensorRfm) -> None:
    v = fitted.validity
    assert v.line == v.sample == (0.0, 11999.0)
    assert v.height_m == (0.0, 2000.0)
    assert v.lon_deg[0] < 31.85 < v.lon_deg[1]
    model = fitted.model()
    assert model.n_lines == model.n_samples == 12000
    assert not model.inside(31.85, 41.3, 2001.0)[0]
    assert "largest errors" in str(model.notes[0])


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("heights", "shape", "said"),
    [
        ((0.0, 0.0), SHAPE, "lowest height"),
        ((5.0, 0.0), SHAPE, "lowest height"),
        ((0.0, np.nan), SHAPE, "lowest height"),
        ((0.0, 9.0), (12, 12, 4), "virtual grid"),
    ],
)
def test_bad_grids_are_refused(
    sensor: PushbroomSensor, heights: tuple[float, float], shape: tuple[int, int, int], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        fit_sensor(sensor, heights, shape=shape)


@pytest.mark.oracle
@pytest.mark.real_data
def test_real_spot5_scene(real_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The RPC fitted to SPOT 5 has an RMS <= 0.035 px and errors <= 0.12 px per axis at independent points.

    The attitude of 8 Hz is not smooth enough for errors below 0.05 px.
    """
    sensor = read_sensor(real_data / "geocosicorr3d" / "SPOT5.DIM")
    found = fit_sensor(sensor, (0.0, 3000.0), shape=(15, 15, 5))
    root_mean_square, largest = rms(found.check_px), np.abs(found.check_px).max(axis=0)
    with capsys.disabled():
        print(f"\nSPOT-5 RFM, line and sample: RMS {root_mean_square} px, largest {largest} px")
    pixels, height = np.random.default_rng(4).uniform(9.0, 11990.0, (2, 400)), np.linspace(10.0, 2990.0, 400)
    ground = sensor.locate(*pixels, height_m=height)
    assert misses_m(sensor.metadata, *pixels, ground).max() < 1e-6
    geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True).transform(*ground.T)
    apart = np.array(reference_project(found.model("scene"), *geodetic), float) - pixels
    assert np.sqrt(np.mean(apart**2, axis=1)) == pytest.approx(root_mean_square, rel=0.5)
    assert (np.abs(apart) <= 0.12).all()
    assert (root_mean_square <= 0.035).all()
    assert (largest <= 0.12).all()
