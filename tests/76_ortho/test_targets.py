"""The rendered twin rectified: every target is found where it truly lies, if orientation and terrain are right."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import rasterio

from fg_orient.geodesy import ecef_to_geodetic, from_geographic
from fg_orient.io.sensor import read_sensor
from fg_orient.raster.adjusted import read_correction
from fg_orient.raster.models import SensorModel
from fg_orient.raster.ortho import orthorectify
from fg_orient.sensors.surface import RasterDem
from fg_orient.simulate.render import Renderer
from fg_orient.simulate.terrain import terrain_through
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate

from .conftest import CRS, DEM_STEP_M, RESOLUTION_M, Twin, find_target

Array = np.ndarray

RMS_PX, LARGEST_PX = 0.5, 1.0
#: Half the edge of the map raster about a target, m: the search knows no better.
HALF_M = 200.0


def misses(twin: Twin, image: str, tmp: Path, *, adjusted: bool, dem: Path | None = None, every: int = 1) -> Array:
    """Found minus true position (n, 2) of targets in map pixels, east and north."""
    surface = RasterDem(dem or twin.folder / "dem.tif")
    sensor = read_sensor(twin.folder / f"{image}.DIM")
    correction = read_correction(twin.result, sensor) if adjusted else None
    model = SensorModel(sensor, correction, CRS, surface.range_m[1])
    out, found = tmp / "ortho.tif", []
    for x, y in twin.targets[::every]:
        # corners off the target by an amount that differs from target to target
        left, bottom = (RESOLUTION_M * math.floor((v - HALF_M) / RESOLUTION_M) for v in (x, y))
        record = orthorectify(
            twin.folder / f"{image}.tif", model, surface, out, crs=CRS, resolution=RESOLUTION_M,
            bounds=(left, bottom, left + 2 * HALF_M, bottom + 2 * HALF_M), overwrite=True,
        )  # fmt: skip
        assert record["error_px"] <= 0.01
        with rasterio.open(out) as source:
            row, column = find_target(source.read(1))
            place = source.transform
        east, north = place.c + (column + 0.5) * place.a, place.f + (row + 0.5) * place.e
        found.append(((east - x) / RESOLUTION_M, (north - y) / RESOLUTION_M))
    return np.array(found)


def passes(found: Array) -> bool:
    distance = np.hypot(*found.T)
    return bool(np.sqrt(np.mean(distance**2)) <= RMS_PX and distance.max() <= LARGEST_PX)


@pytest.mark.parametrize("image", ["left", "right"])
def test_every_target_lies_where_it_should_with_the_adjusted_orientation(
    twin: Twin, tmp_path: Path, image: str
) -> None:
    found = misses(twin, image, tmp_path, adjusted=True)
    assert len(found) == 47
    assert passes(found), found


def test_the_unadjusted_model_is_off_by_the_simulated_bias(twin: Twin, tmp_path: Path) -> None:
    """The bias on the map: where the metadata put the true pixels, on the same terrain."""
    found = misses(twin, "right", tmp_path, adjusted=False, every=6)
    truth = simulate(ZonguldakOptions()).truth
    pixels = truth.pixels[len(truth.pixels) // 2 :][::6]  # the second image
    sensor, dem = read_sensor(twin.folder / "right.DIM"), RasterDem(twin.folder / "dem.tif")
    lon, lat, _ = ecef_to_geodetic(sensor.locate(*pixels.T, dem=dem))
    bias = (np.stack(from_geographic(CRS, lon, lat), axis=1) - twin.targets[::6]) / RESOLUTION_M
    assert np.hypot(*bias.T).min() > 4.0
    assert np.abs(found - bias).max() < 0.25
    assert not passes(found)


def test_a_terrain_shifted_by_50_m_fails(twin: Twin, tmp_path: Path) -> None:
    shifted = tmp_path / "shifted.tif"
    with rasterio.open(twin.folder / "dem.tif") as source:
        profile, heights = source.profile, source.read()
    place = profile["transform"]
    profile["transform"] = rasterio.Affine(place.a, place.b, place.c + 50.0, place.d, place.e, place.f)
    with rasterio.open(shifted, "w", **profile) as sink:
        sink.write(heights)
    assert passes(misses(twin, "right", tmp_path, adjusted=True, every=3))
    assert not passes(misses(twin, "right", tmp_path, adjusted=True, dem=shifted, every=3))


def test_rendered_rays_meet_the_terrain_where_the_sensor_says(twin: Twin) -> None:
    """Corners by the kernel against rays by ``locate``: other code for march, intersection and interpolation."""
    simulation = simulate(ZonguldakOptions())
    terrain = terrain_through(simulation.truth.lon_lat_height, step_m=DEM_STEP_M)
    sensor, correction = read_sensor(twin.folder / "left.DIM"), simulation.truth.corrections[0]
    renderer = Renderer(sensor, correction, terrain)
    rng = np.random.default_rng(5)
    corner = rng.integers(1, 11999, (40, 2))
    ours = np.stack([renderer.corners(line, sample, 0, 0)[0, 0] for line, sample in corner])
    ground = sensor.locate(*(corner - 0.5).T, dem=RasterDem(twin.folder / "dem.tif"), correction=correction)
    lon, lat, _ = ecef_to_geodetic(ground)
    assert np.abs(ours - np.stack(from_geographic(CRS, lon, lat), axis=1)).max() < 0.02


def test_points_lie_on_the_terrain(twin: Twin) -> None:
    truth = simulate(ZonguldakOptions()).truth
    dem = RasterDem(twin.folder / "dem.tif")
    heights = dem.height_m(truth.lon_lat_height[:, 0], truth.lon_lat_height[:, 1])
    assert np.abs(heights - truth.lon_lat_height[:, 2]).max() < 1e-3
