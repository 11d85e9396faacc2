"""In the rectified twin every target has its true position if orientation and terrain are right."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio

from fg_orient.geodesy import ecef_to_geodetic, from_geographic
from fg_orient.rectification.ortho import orthorectify
from fg_orient.rectification.ortho_models import SensorModel, read_orientation
from fg_orient.sensors.surface import RasterDem
from fg_orient.simulate.render import Renderer, terrain_through
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate
from tests.support.command import in_process as run
from tests.support.published_rays import misses_m

from .conftest import CRS, DEM_STEP_M, RESOLUTION_M, Twin, find_target, true_positions

Array = np.ndarray

RMS_PX, LARGEST_PX = 0.5, 1.0
#: Half the edge of the map raster about a target, and of the square in which it is searched for, m.
HALF_M, SEARCH_M = 200.0, 190.0


def misses(twin: Twin, image: str, tmp: Path, *, adjusted: bool, dem: RasterDem | None = None, every: int = 1) -> Array:
    """Return found minus true positions (n, 2) of targets in map pixels, east and north."""
    surface, sensor = dem or twin.dem, twin.sensors[image]
    correction = read_orientation(twin.result, sensor).correction if adjusted else None
    model = SensorModel(sensor, correction, CRS, surface.range_m[1])
    out, found = tmp / "ortho.tif", []
    for x, y in twin.targets[::every]:
        # the corners differ from the target by a different amount for each target
        left, bottom = (RESOLUTION_M * math.floor((v - HALF_M) / RESOLUTION_M) for v in (x, y))
        record = orthorectify(
            twin.folder / f"{image}.tif", model, surface, out, crs=CRS, resolution=RESOLUTION_M,
            bounds=(left, bottom, left + 2 * HALF_M, bottom + 2 * HALF_M), overwrite=True,
        )  # fmt: skip
        assert record["error_px"] <= 0.01
        found.append(targets_in(out, np.array([[x, y]]))[0])
    return np.array(found)


def passes(found: Array) -> bool:
    distance = np.hypot(*found.T)
    return bool(np.sqrt(np.mean(distance**2)) <= RMS_PX and distance.max() <= LARGEST_PX)


@pytest.mark.oracle
@pytest.mark.parametrize(("image", "every", "count"), [("left", 4, 12), ("right", 1, 47)])
def test_every_target_lies_where_it_should_with_the_adjusted_orientation(
    twin: Twin, tmp_path: Path, image: str, every: int, count: int
) -> None:
    found = misses(twin, image, tmp_path, adjusted=True, every=every)
    assert len(found) == count
    assert passes(found), found


@pytest.mark.oracle
def test_the_unadjusted_model_is_off_by_the_simulated_bias(twin: Twin, tmp_path: Path) -> None:
    """Without adjustment the targets are off by the bias of the metadata within 0.25 px, and fail.

    The bias is that of the true pixels located on the same terrain.
    """
    found = misses(twin, "right", tmp_path, adjusted=False, every=6)
    truth = simulate(ZonguldakOptions()).truth
    pixels = truth.pixels[len(truth.pixels) // 2 :][::6]  # the second image
    lon, lat, _ = ecef_to_geodetic(twin.sensors["right"].locate(*pixels.T, dem=twin.dem))
    bias = (np.stack(from_geographic(CRS, lon, lat), axis=1) - twin.targets[::6]) / RESOLUTION_M
    assert np.hypot(*bias.T).min() > 4.0
    assert np.abs(found - bias).max() < 0.25
    assert not passes(found)


@pytest.mark.oracle
def test_a_terrain_shifted_by_50_m_fails(twin: Twin, tmp_path: Path) -> None:
    shifted = tmp_path / "shifted.tif"
    with rasterio.open(twin.folder / "dem.tif") as source:
        profile, heights = source.profile, source.read()
    place = profile["transform"]
    profile["transform"] = rasterio.Affine(place.a, place.b, place.c + 50.0, place.d, place.e, place.f)
    with rasterio.open(shifted, "w", **profile) as sink:
        sink.write(heights)
    assert passes(misses(twin, "right", tmp_path, adjusted=True, every=3))
    assert not passes(misses(twin, "right", tmp_path, adjusted=True, dem=RasterDem(shifted), every=3))
    profile["transform"] = place
    with rasterio.open(shifted, "w", **profile) as sink:
        sink.write(heights + np.float32(50.0))
    for image in ("left", "right"):  # shifted east the left image, seen more from above, still passes
        assert not passes(misses(twin, image, tmp_path, adjusted=True, dem=RasterDem(shifted), every=4))


@pytest.mark.oracle
def test_rendered_rays_meet_the_terrain_on_rays_written_apart(twin: Twin) -> None:
    """Rendered pixels lie on independent rays and where ``locate`` meets the terrain, within 2 cm."""
    simulation = simulate(ZonguldakOptions())
    terrain = terrain_through(simulation.truth.lon_lat_height, step_m=DEM_STEP_M)
    sensor, correction = twin.sensors["left"], simulation.truth.corrections[0]
    renderer = Renderer(sensor, correction, terrain)
    rng = np.random.default_rng(5)
    corner = rng.integers(1, 11999, (40, 2))
    cells = np.stack([renderer.cells(line, sample, 0, 0)[0, 0] for line, sample in corner])
    left_top, step = np.array([terrain.left_m, terrain.top_m]), terrain.step_m
    ours = left_top + (cells[:, ::-1] + 0.5) * [step, -step]
    ground = sensor.locate(*(corner - 0.5).T, dem=twin.dem, correction=correction)
    degrees = np.stack(pyproj.Transformer.from_crs(CRS, "EPSG:4326", always_xy=True).transform(*ours.T))
    heights = twin.dem.height_m(*degrees)
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    rendered = np.stack(to_ecef.transform(*degrees, heights), axis=1)
    assert misses_m(sensor.metadata, *(corner - 0.5).T, rendered, correction).max() < 0.02
    lon, lat, _ = ecef_to_geodetic(ground)
    assert np.abs(ours - np.stack(from_geographic(CRS, lon, lat), axis=1)).max() < 0.02


@pytest.mark.consistency
def test_points_lie_on_the_terrain(twin: Twin) -> None:
    truth = simulate(ZonguldakOptions()).truth
    heights = twin.dem.height_m(truth.lon_lat_height[:, 0], truth.lon_lat_height[:, 1])
    assert np.abs(heights - truth.lon_lat_height[:, 2]).max() < 1e-3


@pytest.mark.oracle
@pytest.mark.slow
def test_whole_images_rectified_in_one_run(tmp_path: Path) -> None:
    """All targets of both whole images are found in their maps. The images have 12000 x 12000 pixels."""
    folder, result = tmp_path / "twin", tmp_path / "result"
    for words in (("simulate", "zonguldak", "--raster", "--out", folder),
                  ("adjust", folder / "project.toml", "--out", result)):  # fmt: skip
        done = run(*words)
        assert done.code == 0, done.stderr
    for image in ("left", "right"):
        out = tmp_path / f"{image}_map.tif"
        done = run(
            "rectify", "ortho", folder / f"{image}.tif", folder / f"{image}.DIM", "--dem", folder / "dem.tif",
            "--result", result, "--resolution", RESOLUTION_M, "--out", out,
        )  # fmt: skip
        assert done.code == 0, done.stderr
        found = targets_in(out, true_positions(folder))
        assert len(found) == 47
        assert passes(found), found


def targets_in(raster: Path, targets: Array) -> Array:
    """Return found minus true positions (n, 2) of targets in one map raster, in its pixels."""
    found, reach = [], int(SEARCH_M / RESOLUTION_M)
    with rasterio.open(raster) as source:
        place = source.transform
        for x, y in targets:
            first_row = int((y - place.f) / place.e) - reach
            first_column = int((x - place.c) / place.a) - reach
            window = rasterio.windows.Window(first_column, first_row, 2 * reach, 2 * reach)
            row, column = find_target(source.read(1, window=window))
            found.append((first_column + column + 0.5 - (x - place.c) / place.a,
                          (y - place.f) / place.e - first_row - row - 0.5))  # fmt: skip
    return np.array(found)
