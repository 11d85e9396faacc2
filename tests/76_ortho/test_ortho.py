"""Map rasters are tested: georeferencing, windows, comparison with GDAL, refusals, the command."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.rpc import RPC
from rasterio.warp import Resampling, reproject

from fg_orient.model.errors import InputError
from fg_orient.rectification.grid import ERROR_PX, FIRST_STEP, LevelSurface, MapGrid, lattice
from fg_orient.rectification.options import OrthoOptions
from fg_orient.rectification.ortho import RESAMPLING, orthorectify, rectify_image
from fg_orient.rectification.ortho_models import PointModel, SensorModel, read_orientation
from fg_orient.rectification.transformation import Scaling, Transformation, find_model
from fg_orient.rpc.fitting import fit_image
from fg_orient.rpc.options import FitOptions
from fg_orient.sensors.rpc_sensor import RpcSensor
from fg_orient.sensors.surface import RasterDem
from fg_orient.simulate.render import RasterOptions
from tests.support.command import in_process as run

from .conftest import CRS, Twin

Array = np.ndarray


def bounds_about(twin: Twin, k: int, half: float = 200.0) -> tuple[float, float, float, float]:
    x, y = (5.0 * np.round(v / 5.0) for v in twin.targets[k])
    return float(x - half), float(y - half), float(x + half), float(y + half)


def ortho(twin: Twin, out: Path, dem: RasterDem | None = None, **options: object) -> Array:
    bounds = options.pop("bounds", bounds_about(twin, 0))
    orthorectify(twin.folder / "left.tif", twin.left, dem or twin.dem, out, crs=CRS, resolution=5.0, bounds=bounds,
                 overwrite=True, options=OrthoOptions(**options))  # fmt: skip
    with rasterio.open(out) as source:
        return source.read(1)


def plain(east: float, north: float, size: float, *, forward: bool) -> Transformation:
    """Return a transformation between pixels and a map, in one direction.

    The centre of the first pixel is at (east, north), pixels are square, north is up.
    """
    plane, unit = Scaling(np.array([east, north]), np.ones(2)), Scaling(np.zeros(2), np.ones(2))
    slope = size if forward else 1.0 / size
    rows = np.array([[0.0, slope, 0.0], [0.0, 0.0, -slope]])
    order = [tuple(power) for power in find_model("affine", None).setup.T.astype(int)]
    by_power = {(0, 0): 0, (1, 0): 1, (0, 1): 2}
    values = np.array([rows[axis, by_power[power]] for axis in (0, 1) for power in order], float)
    ground, image = ("easting", "northing"), ("sample", "line")
    sides = (unit, plane, image, ground) if forward else (plane, unit, ground, image)
    return Transformation(find_model("affine", None), values, *sides, CRS)


@pytest.fixture
def picture(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Return an image of 40 x 60 pixels, two bands, without georeferencing."""
    path = tmp_path / "picture.tif"
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        with rasterio.open(path, "w", driver="GTiff", width=60, height=40, count=2, dtype="uint16") as sink:
            sink.write(rng.integers(1, 5000, (2, 40, 60), dtype=np.uint16))
    return path


@pytest.mark.truth
@pytest.mark.parametrize("forward", [True, False])
@pytest.mark.parametrize("name", list(RESAMPLING))
def test_a_map_on_the_pixels_of_the_image_is_the_image(picture: Path, forward: bool, name: str) -> None:
    """A map on the pixels of the image has its values and the right corner.

    The centre of the first pixel is at (1005, 5025), its corner at (990, 5040).
    """
    out = picture.with_name("map.tif")
    record = orthorectify(
        picture, PointModel(plain(1005.0, 5025.0, 30.0, forward=forward)), LevelSurface(0.0), out, crs=CRS,
        resolution=30.0, options=OrthoOptions(name, window=32),
    )  # fmt: skip
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(picture) as source:
        given = source.read()
    with rasterio.open(out) as found:
        assert found.transform == rasterio.Affine(30.0, 0.0, 990.0, 0.0, -30.0, 5040.0)
        assert found.crs.to_epsg() == 32636 and found.nodata == 0
        assert np.array_equal(found.read(), given)
    assert record["filled"] == 1.0


@pytest.mark.consistency
@pytest.mark.parametrize(("name", "window"), [("nearest", 33), ("bilinear", 17), ("cubic", 48), ("cubic-sharp", 79)])
def test_pixels_do_not_depend_on_the_windows(twin: Twin, tmp_path: Path, name: str, window: int) -> None:
    whole = ortho(twin, tmp_path / "a.tif", resampling=name)
    assert (whole > 0).any()
    assert np.array_equal(whole, ortho(twin, tmp_path / "b.tif", resampling=name, window=window))


@pytest.mark.consistency
def test_another_raster_over_the_same_ground_agrees(twin: Twin, tmp_path: Path) -> None:
    """A map with another raster has the same grey values within one. Its knots are at other places."""
    left, bottom, right, top = bounds_about(twin, 0)
    whole = ortho(twin, tmp_path / "a.tif").astype(int)
    part = ortho(twin, tmp_path / "b.tif", bounds=(left + 55.0, bottom, right, top - 35.0)).astype(int)
    both = (whole[7:, 11:] > 0) & (part > 0)
    assert both.sum() > 1000
    assert np.abs(whole[7:, 11:] - part)[both].max() <= 1


@pytest.mark.oracle
def test_gdal_makes_the_same_map_of_the_same_rpc(twin: Twin, tmp_path: Path) -> None:
    """GDAL's warper with the same RPC and terrain gives the same grey values within two, 90 % of them equal.

    Kernel and grid are the same.
    """
    model, _ = fit_image(twin.sensors["left"], (-50.0, 1850.0), FitOptions())
    image, dem = tmp_path / "left.tif", twin.dem
    shutil.copy(twin.folder / "left.tif", image)
    values = {"err_bias": None, "err_rand": None}
    for k, axis in enumerate(("line", "samp", "long", "lat", "height")):
        values |= {f"{axis}_off": float(model.offsets[k]), f"{axis}_scale": float(model.scales[k])}
    for name, row in zip(("line_num", "line_den", "samp_num", "samp_den"), model.coefficients, strict=True):
        values[f"{name}_coeff"] = row.tolist()
    left, bottom, right, top = bounds_about(twin, 0)
    theirs = np.zeros((80, 80), np.uint8)
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(image, "r+") as source:
        source.rpcs = RPC(**values)
    with rasterio.open(image) as source:
        reproject(
            rasterio.band(source, 1), theirs, rpcs=source.rpcs, dst_crs=CRS, dst_nodata=0,
            dst_transform=rasterio.Affine(5.0, 0.0, left, 0.0, -5.0, top), resampling=Resampling.bilinear,
            XSCALE=1, YSCALE=1, RPC_DEM=str(twin.folder / "dem.tif"),
        )  # fmt: skip
    out = tmp_path / "ours.tif"
    orthorectify(image, SensorModel(RpcSensor(model), None, CRS, dem.range_m[1]), dem, out, crs=CRS, resolution=5.0,
                 bounds=(left, bottom, right, top))  # fmt: skip
    with rasterio.open(out) as found:
        ours = found.read(1)
    both = (ours > 0) & (theirs > 0)
    assert both.sum() > 3000
    assert np.abs(ours.astype(int) - theirs)[both].max() <= 2
    assert np.mean(ours[both] != theirs[both]) < 0.1


@pytest.mark.truth
def test_a_transformation_with_heights_takes_them(picture: Path, tmp_path: Path) -> None:
    """A fitted transformation with heights needs ``--height``, and a map at 100 m is moved by whole pixels.

    100 m move a point by a line and two samples.
    """
    rng, points = np.random.default_rng(3), ["id,line,sample,easting_m,northing_m,height_m"]
    for k in range(12):
        line, sample, height = (float(v) for v in rng.uniform(0.0, (60.0, 60.0, 300.0)))
        east, north = 1005.0 + 30.0 * (sample + 0.02 * height), 5025.0 - 30.0 * (line - 0.01 * height)
        points.append(f"{k},{line!r},{sample!r},{east!r},{north!r},{height!r}")
    (tmp_path / "points.csv").write_text("\n".join(points) + "\n", encoding="utf-8")
    fitted = run(
        "rectify", "fit", tmp_path / "points.csv", "--model", "affine-3d", "--crs", CRS, "--out", tmp_path / "fit"
    )
    assert fitted.code == 0, fitted.stderr
    words = ("rectify", "ortho", picture, tmp_path / "fit", "--out", tmp_path / "map.tif", "--resampling", "nearest")
    assert "needs heights" in run(*words).stderr
    done = run(*words, "--height", 100, "--resolution", 30)
    assert done.code == 0, done.stderr
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(picture) as source:
        given = source.read()
    with rasterio.open(tmp_path / "map.tif") as found:
        assert (found.bounds.left, found.bounds.top) == (990.0 + 60.0, 5040.0 + 30.0)
        assert np.array_equal(found.read(), given)


def code(error: pytest.ExceptionInfo[InputError]) -> str:
    return error.value.problems[0].code


def altered_dem(twin: Twin, path: Path, *, hole: bool = False, crs: str | None = CRS, east: float = 0.0) -> Path:
    with rasterio.open(twin.folder / "dem.tif") as source:
        heights, place = source.read(1), source.transform
    if hole:
        x, y = twin.targets[0]
        row, column = int((place.f - y) / place.a), int((x - place.c) / place.a)
        heights[row + 1, column + 1] = -9999.0
    rows, columns = heights.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype="float32", nodata=-9999.0, crs=crs,
        transform=rasterio.Affine(place.a, place.b, place.c + east, place.d, place.e, place.f),
    ) as sink:  # fmt: skip
        sink.write(heights, 1)
    return path


def refused(call: Callable[..., object], *words: object, **options: object) -> str:
    with pytest.raises(InputError) as error:
        call(*words, **options)
    return code(error)


@pytest.mark.behaviour
def test_refusals(twin: Twin, tmp_path: Path, picture: Path) -> None:
    image, out = twin.folder / "left.tif", tmp_path / "no.tif"

    def rectified(dem: RasterDem = twin.dem, picture: Path = image, **options: object) -> None:
        orthorectify(picture, twin.left, dem, out, crs=CRS, resolution=5.0, **options)

    far = RasterDem(altered_dem(twin, tmp_path / "far.tif", east=3e5))
    assert refused(rectified, far) == "ortho.no_overlap"
    assert refused(rectified, bounds=(5e5, 4.4e6, 5.01e5, 4.401e6)) == "ortho.no_overlap"
    assert refused(rectified, bounds=(4e5, 4.57e6, 3e5, 4.58e6)) == "ortho.grid"
    assert refused(rectified, picture=picture) == "ortho.size"
    assert refused(rectified, picture=tmp_path / "missing.tif") == "ortho.image"
    assert refused(RasterDem, altered_dem(twin, tmp_path / "none.tif", crs=None)) == "dem.no_crs"
    assert refused(OrthoOptions, "sinc") == "options.value"
    metadata = twin.folder / "left.DIM"
    assert refused(rectify_image, image, metadata, out) == "ortho.no_heights"
    assert refused(rectify_image, image, metadata, out, height_m=0.0) == "ortho.no_crs"
    assert refused(rectify_image, image, metadata, out, height_m=0.0, crs="EPSG:99999") == "geodesy.unknown_crs"
    assert refused(read_orientation, tmp_path, twin.sensors["left"]) == "report.no_result"
    assert refused(read_orientation, twin.result, twin.sensors["left"], "third") == "ortho.result"
    assert not list(tmp_path.glob("*no.tif*")), "nothing is left behind"


@pytest.mark.behaviour
def test_holes_are_refused_or_left_empty(twin: Twin, tmp_path: Path) -> None:
    dem = RasterDem(altered_dem(twin, tmp_path / "hole.tif", hole=True))
    with pytest.raises(InputError) as error:
        ortho(twin, tmp_path / "no.tif", dem)
    assert code(error) == "ortho.hole"
    assert not list(tmp_path.glob("*no.tif*"))
    whole = ortho(twin, tmp_path / "whole.tif")
    part = ortho(twin, tmp_path / "part.tif", dem, allow_holes=True)
    lost = (part == 0) & (whole > 0)
    assert 500 <= lost.sum() <= 36 * 36  # 180 m about the cell, in pixels of 5 m, cut by the window
    assert np.array_equal(part[~lost], whole[~lost])


@pytest.mark.behaviour
def test_grid_keeps_whole_multiples() -> None:
    grid = MapGrid.over((400_002.0, 4_570_000.0, 400_098.0, 4_570_101.0), 5.0, CRS)
    assert grid.bounds == (400_000.0, 4_570_000.0, 400_100.0, 4_570_105.0)
    assert (grid.rows, grid.columns) == (21, 20)
    assert [float(v) for v in grid.centres(0, 0)] == [400_002.5, 4_570_102.5]


@pytest.mark.behaviour
def test_the_command_writes_a_cloud_optimised_file(twin: Twin, tmp_path: Path) -> None:
    out = tmp_path / "map.tif"
    words = ("rectify", "ortho", twin.folder / "left.tif", twin.folder / "left.DIM", "--dem", twin.folder / "dem.tif",
             "--result", twin.result, "--resolution", "5", "--bounds",
             ",".join(str(v) for v in bounds_about(twin, 0)), "--cog", "--out", out)  # fmt: skip
    done = run(*words, "--json")
    assert done.code == 0, done.stderr
    assert done.json["error_px"] <= 0.01 and done.json["rows"] == 80
    with rasterio.open(out) as source:
        assert source.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert source.res == (5.0, 5.0)
    assert [path.name for path in tmp_path.iterdir()] == ["map.tif"]
    again = run(*words)
    assert again.code == 2 and "exists already" in again.stderr


@pytest.mark.truth
def test_a_fit_by_points_is_taken(picture: Path, tmp_path: Path) -> None:
    points = ["id,line,sample,easting_m,northing_m"]
    for k, (line, sample) in enumerate([(0, 0), (0, 59), (39, 0), (39, 59), (20, 30)]):
        points.append(f"{k},{line},{sample},{1005 + 30 * sample},{5025 - 30 * line}")
    (tmp_path / "points.csv").write_text("\n".join(points) + "\n", encoding="utf-8")
    fitted = run("rectify", "fit", tmp_path / "points.csv", "--crs", CRS, "--out", tmp_path / "fit")
    assert fitted.code == 0, fitted.stderr
    done = run("rectify", "ortho", picture, tmp_path / "fit", "--out", tmp_path / "map.tif", "--resampling", "nearest")
    assert done.code == 0, done.stderr
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(picture) as source:
        given = source.read()
    with rasterio.open(tmp_path / "map.tif") as found:
        assert found.bounds == (990.0, 3840.0, 2790.0, 5040.0)
        assert np.array_equal(found.read(), given)
    other = run("rectify", "ortho", picture, tmp_path / "fit", "--crs", "EPSG:32635", "--out", tmp_path / "no.tif")
    assert other.code == 2 and "was fitted in" in other.stderr


@pytest.mark.consistency
def test_knots_come_closer_until_the_bound_is_kept(twin: Twin) -> None:
    """The distance of knots shrinks until the error is below its bound, and random places confirm this error."""
    grid = MapGrid.over((395_000.0, 4_565_000.0, 410_000.0, 4_580_000.0), 30.0, CRS)
    limits = np.array([-0.5, 11999.5, -0.5, 11999.5])
    found = lattice(grid, twin.left, twin.dem, limits, twin.dem.range_m)
    assert found is not None and found.step < FIRST_STEP and found.error_px <= ERROR_PX
    rng = np.random.default_rng(11)
    row, column = rng.uniform(0, grid.rows - 1, 300), rng.uniform(0, grid.columns - 1, 300)
    t = rng.uniform(-1.0, 1.0, 300)
    (i, u), (j, v) = ((np.floor(a / found.step).astype(int), a / found.step % 1.0) for a in (row, column))
    corners = (((1 - u) * (1 - v), 0, 0), (u * (1 - v), 1, 0), ((1 - u) * v, 0, 1), (u * v, 1, 1))
    k = sum(w[:, None] * found.knots[i + a, j + b] for w, a, b in corners)
    ours = np.stack([k[:, m] + t * (k[:, m + 1] + t * k[:, m + 2]) for m in (2, 5)], axis=1)
    exact = twin.left.pixels(*grid.centres(row, column), found.scaling[0] + t * found.scaling[1])
    assert np.abs(ours - exact).max() < 1.2 * found.error_px


@pytest.mark.behaviour
def test_rasters_of_the_twin_that_cannot_be() -> None:
    for options in ({"window_px": -1}, {"window_px": 12001}, {"dem_step_m": 1.0}, {"dem_step_m": 500.0}):
        assert refused(RasterOptions, **options) == "options.value"


@pytest.mark.behaviour
def test_progress_ends_at_the_number_of_windows(picture: Path) -> None:
    told: list[tuple[int, int]] = []
    model = PointModel(plain(1005.0, 5025.0, 30.0, forward=True))
    orthorectify(
        picture, model, LevelSurface(0.0), picture.with_name("map.tif"), crs=CRS, resolution=30.0,
        options=OrthoOptions(window=32), progress=lambda done, total, text: told.append((done, total)),
    )  # fmt: skip
    assert told == [(k, 4) for k in range(5)]


@pytest.mark.behaviour
def test_knots_far_from_the_image_are_none(twin: Twin) -> None:
    grid = MapGrid.over((495_000.0, 4_565_000.0, 500_000.0, 4_580_000.0), 30.0, CRS)
    assert lattice(grid, twin.left, twin.dem, np.array([-0.5, 11999.5, -0.5, 11999.5]), twin.dem.range_m) is None
