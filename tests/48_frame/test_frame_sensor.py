"""Frame cameras on the Earth and in a local system: the tests check projection, rays and refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyproj
import pytest

from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.rows import image_models
from fg_orient.geodesy import enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import Image, Options
from fg_orient.model.errors import InputError, OutOfImage
from fg_orient.sensors.frame import HALF_TURN, FrameCamera, FrameSensor
from tests.support.pinhole import pinhole_block

LON, LAT, HEIGHT = 31.8, 41.4, 2500.0
SIGMA = {"rotation_x": 1e-4, "centre_z": 0.1}


def aerial(**changes: object) -> FrameSensor:
    """Return a camera 2500 m above the ellipsoid: samples run East, lines South, looking down."""
    rotation = HALF_TURN @ enu_from_ecef(LON, LAT)[0]
    values: dict[str, object] = {
        "rotation": rotation, "centre_m": geodetic_to_ecef(LON, LAT, HEIGHT)[0], "focal_px": 8000.0,
        "principal_px": np.array([4010.0, 2990.0]), "distortion": np.array([-0.05, 0.01, 0.0, 1e-4, -2e-4]),
        "sigma": SIGMA,
    }  # fmt: skip
    return FrameSensor(FrameCamera(**(values | changes)), 8000, 6000, file="camera.toml")  # type: ignore[arg-type]


def printed_pixels(sensor: FrameSensor, ground_m: np.ndarray) -> np.ndarray:
    """Return Brown's model as printed: lines and samples (2, n)."""
    x, y, z = sensor.camera.rotation @ (ground_m - sensor.camera.centre_m).T
    x, y = x / z, y / z
    r2, (k1, k2, k3, p1, p2) = x**2 + y**2, sensor.camera.distortion
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    column = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2)
    row = y * radial + p1 * (r2 + 2.0 * y**2) + 2.0 * p2 * x * y
    return sensor.camera.principal_px[:, None] + 8000.0 * np.stack([row, column])


@pytest.mark.oracle
def test_located_points_project_back_and_lie_at_their_height() -> None:
    sensor, rng = aerial(), np.random.default_rng(1)
    line, sample, h = rng.uniform(0, 7999, 30), rng.uniform(0, 5999, 30), rng.uniform(0.0, 800.0, 30)
    ground = sensor.locate(line, sample, height_m=h)
    geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    assert np.abs(geodetic.transform(*ground.T)[2] - h).max() < 1e-4
    assert np.abs(printed_pixels(sensor, ground) - [line, sample]).max() < 1e-7
    again = sensor.project(ground)
    assert np.abs(np.stack(again) - np.stack([line, sample])).max() < 1e-7
    centre, direction = sensor.rays(line, sample)
    feet = centre + np.einsum("ni,ni->n", ground - centre, direction)[:, None] * direction
    assert np.abs(feet - ground).max() < 1e-6


@pytest.mark.truth
def test_axes_point_as_the_documentation_says() -> None:
    """A point east of nadir has the larger sample, and a point south of it the larger line."""
    sensor = aerial()
    lon, lat = np.array([LON, LON + 0.002, LON]), np.array([LAT, LAT, LAT - 0.002])
    line, sample = sensor.project(geodetic_to_ecef(lon, lat, np.zeros(3)))
    assert (line[0], sample[0]) == pytest.approx((4010.0, 2990.0), abs=1e-6)
    assert sample[1] > sample[0] + 400.0
    assert line[2] > line[0] + 400.0
    corners = sensor.footprint()
    assert corners[0, 0] < LON < corners[1, 0]
    assert corners[3, 1] < LAT < corners[0, 1]


@pytest.mark.oracle
def test_correction_moves_the_pixels() -> None:
    sensor = aerial()
    change = np.zeros(14)
    change[7] = 3.0
    ground = sensor.locate(4000.0, 3000.0)
    expected = printed_pixels(sensor, ground) + np.array([[0.0], [3.0]])  # the principal point 3 px to the right
    assert np.stack(sensor.project(ground, change)) == pytest.approx(expected, abs=1e-7)
    assert sensor.project(ground, change)[1][0] == pytest.approx(sensor.project(ground)[1][0] + 3.0, abs=1e-9)
    assert sensor.rays(4000.0, 3000.0, change)[1] == pytest.approx(sensor.rays(4000.0, 2997.0)[1], abs=1e-12)


@pytest.mark.behaviour
def test_points_behind_the_camera_have_no_pixel() -> None:
    sensor = aerial()
    line, sample = sensor.project(geodetic_to_ecef(LON, LAT, HEIGHT + 1000.0))
    assert np.isnan([line[0], sample[0]]).all()
    model = image_models([Image("a", sensor)], Options())[0]
    ends = geodetic_to_ecef(np.full(2, LON), np.full(2, LAT), np.array([HEIGHT + 1000.0, 0.0]))
    assert model.is_valid(ends).tolist() == [False, True]
    assert model.facts()["model"] == "frame"
    assert model.silent_directions() == []
    assert np.isnan(model.per_line()[0]).all()


@pytest.mark.behaviour
def test_centre_of_an_image_that_sees_no_ground_is_the_camera() -> None:
    up = aerial(rotation=enu_from_ecef(LON, LAT)[0])
    assert np.array_equal(up.centre_m, up.camera.centre_m)
    assert np.linalg.norm(aerial().centre_m - aerial().camera.centre_m) == pytest.approx(HEIGHT, rel=1e-3)


def code(caught: pytest.ExceptionInfo[InputError]) -> str:
    return caught.value.problems[0].code


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "frame.camera"),
        ({"rotation": 1.1 * np.eye(3)}, "frame.camera"),
        ({"rotation": np.eye(2)}, "frame.camera"),
        ({"centre_m": np.array([0.0, np.nan, 0.0])}, "frame.camera"),
        ({"focal_px": -1.0}, "frame.camera"),
        ({"distortion": np.zeros(3)}, "frame.camera"),
        ({"sigma": {"focus": 1.0}}, "frame.unknown"),
        ({"sigma": {"focal": 0.0}}, "frame.unknown"),
    ],
)
def test_impossible_cameras_are_refused(change: dict[str, object], expected: str) -> None:
    with pytest.raises(InputError) as caught:
        aerial(**change)
    assert code(caught) == expected


@pytest.mark.behaviour
def test_what_cannot_be_asked_is_refused() -> None:
    with pytest.raises(OutOfImage) as outside:
        aerial().locate(-3.0, 0.0)
    assert code(outside) == "sensor.pixel_outside"
    with pytest.raises(InputError) as missed:
        aerial(rotation=enu_from_ecef(LON, LAT)[0]).locate(10.0, 10.0)
    assert code(missed) == "sensor.ray_misses"
    with pytest.raises(InputError) as folded:
        aerial(distortion=np.array([-0.3, 0.0, 0.0, 0.0, 0.0]), focal_px=4000.0).rays(0.0, 12000.0)
    assert code(folded) == "frame.no_direction"
    block, _ = pinhole_block(3, 5, views=3)
    local = block.images[0].sensor
    with pytest.raises(InputError) as unplaced:
        local.locate(0.0, 0.0, height_m=0.0)
    assert code(unplaced) == "frame.local"
    assert local.footprint().shape == (0, 2)
    with pytest.raises(InputError) as mixed:
        compile_problem(replace(block, images=(Image("aerial", aerial()), *block.images[1:])))
    assert code(mixed) == "frame.mixed"
    with pytest.raises(InputError) as held:
        images = tuple(
            replace(i, sensor=FrameSensor(replace(i.sensor.camera, sigma={}), 10, 10, georeferenced=False))
            for i in block.images
        )
        compile_problem(replace(block, images=images))
    assert code(held) == "frame.nothing_unknown"
