"""A raster of 60 000 x 60 000 heights uses memory and time only for the squares that are read."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.geodesy import ecef_to_geodetic, geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.sensors import dem as dem_module
from fg_orient.sensors.dem import EDGE, RasterDem
from fg_orient.sensors.surface import on_surface
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak, zonguldak_block
from tests.support.rendered_pair import Scene, View, write_pair

rasterio = pytest.importorskip("rasterio")

SIZE, STEP = 60_000, 1e-4
UTM = "EPSG:32636"
#: Corner of the large raster, in which the twin is.
WEST, NORTH = 29.0, 44.4


def write(path: Path, rows: slice, columns: slice, *, size: int = SIZE, **options: Any) -> Path:
    """Write a sparse GeoTIFF with heights in a part of it.

    The heights are a plane, 100 m in the west and 1 m higher every 40 cells.
    """
    place = rasterio.Affine(STEP, 0.0, WEST, 0.0, -STEP, NORTH)
    settings = {"driver": "GTiff", "count": 1, "dtype": "int16", "crs": "EPSG:4326", "nodata": -9999} | options
    with rasterio.open(
        path, "w", width=size, height=size, transform=place, tiled=True, blockxsize=256, blockysize=256,
        compress="deflate", SPARSE_OK=True, **settings,
    ) as sink:  # fmt: skip
        line = (100 + (np.arange(columns.start, columns.stop) // 40)).astype("int16")
        for top in range(rows.start, rows.stop, 256):
            n = min(256, rows.stop - top)
            window = rasterio.windows.Window(columns.start, top, len(line), n)
            sink.write(np.tile(line, (n, 1)), 1, window=window)
    return path


def plane(lon: np.ndarray) -> np.ndarray:
    """Return the heights between the centres of cells."""
    column = (lon - WEST) / STEP - 0.5
    low = np.floor(column)
    a, b = 100.0 + low // 40, 100.0 + (low + 1) // 40
    return a + (column - low) * (b - a)


@pytest.mark.oracle
def test_heights_of_far_points_equal_the_formula(tmp_path: Path, rng: np.random.Generator) -> None:
    """Heights at opposite ends of a large raster equal the formula, and only the squares in use are read."""
    path = write(tmp_path / "dem.tif", slice(0, 512), slice(0, 512))
    with rasterio.open(path, "r+") as sink:
        line = (100 + (np.arange(SIZE - 512, SIZE) // 40)).astype("int16")
        sink.write(np.tile(line, (512, 1)), 1, window=rasterio.windows.Window(SIZE - 512, SIZE - 512, 512, 512))
    dem = RasterDem(path)
    near = rng.uniform(1.0, 500.0, (100, 2))
    rows, columns = np.vstack([near, near + SIZE - 512]).T
    lon, lat = WEST + (columns + 0.5) * STEP, NORTH - (rows + 0.5) * STEP
    np.testing.assert_allclose(dem.height_m(lon, lat), plane(lon), atol=1e-6)
    assert len(dem._ranges) == 4 + 9
    assert dem.range_over(lon[:100], lat[:100]) == (100.0, 112.0)
    low, high = dem.range_along(np.array([[10.0, 10.0], [10.0, 30_000.0], [np.nan, 0.0]]), np.full((3, 2), 20.0))
    assert high[0] == 106.0 and low[0] == 100.0 and high[1] == 112.0 and np.isnan(low[2])


@pytest.mark.consistency
@pytest.mark.parametrize("blocks", [{"tiled": True, "blockxsize": 64, "blockysize": 64}, {"blockysize": 3}])
def test_values_do_not_depend_on_blocks_or_on_the_cache(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, blocks: dict[str, Any]
) -> None:
    """Heights are the same bits for any block size, with four cached squares or the whole array."""
    heights = rng.uniform(0.0, 900.0, (700, 1100)).astype("float32")
    heights[300:310, 400:420] = np.nan
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=1100, height=700, count=1, dtype="float32", crs="EPSG:4326",
        transform=rasterio.Affine(STEP, 0.0, WEST, 0.0, -STEP, NORTH), **blocks,
    ) as sink:  # fmt: skip
        sink.write(heights, 1)
    row, column = rng.uniform(0.0, 699.0, 2000), rng.uniform(0.0, 1099.0, 2000)
    lon, lat = WEST + (column + 0.5) * STEP, NORTH - (row + 0.5) * STEP
    whole = RasterDem(tmp_path / "dem.tif")
    np.testing.assert_array_equal(whole.heights_m, heights.astype(float))
    expected = whole.height_m(lon, lat)
    assert np.isnan(expected).any() and np.isfinite(expected).sum() > 1800
    monkeypatch.setattr(dem_module, "KEPT_BYTES", 4 * 8 * EDGE**2)
    monkeypatch.setattr(dem_module, "PART_CELLS", EDGE**2)
    few = RasterDem(tmp_path / "dem.tif")
    np.testing.assert_array_equal(few.height_m(lon, lat), expected)
    assert len(few._kept) <= 4
    np.testing.assert_array_equal(few.window(250, 200, 300, 700), heights[250:550, 200:900].astype(float))
    assert few.range_m == (float(np.nanmin(heights)), float(np.nanmax(heights)))


@pytest.mark.consistency
def test_a_ray_does_not_depend_on_the_others(tmp_path: Path, rng: np.random.Generator) -> None:
    """A pixel located on a DEM alone and among others is the same point within 1 mm."""
    sensor = zonguldak_block(ZonguldakOptions(seed=1))[0].images[0].sensor
    rows, columns = slice(27_000, 35_000), slice(23_000, 34_000)
    dem = RasterDem(write(tmp_path / "dem.tif", rows, columns))
    line, sample = rng.uniform(200.0, 11_800.0, 40), rng.uniform(200.0, 11_800.0, 40)
    together = sensor.locate(line, sample, dem=dem)
    alone = np.vstack([sensor.locate([a], [b], dem=dem) for a, b in zip(line[:5], sample[:5], strict=True)])
    assert np.linalg.norm(together[:5] - alone, axis=1).max() <= 1e-3
    lon, _, height = ecef_to_geodetic(together)
    assert np.abs(height - plane(lon)).max() <= 2e-4


@pytest.mark.oracle
def test_a_camera_in_a_valley_sees_the_ground(tmp_path: Path) -> None:
    """A camera below the highest cell of the DEM sees the ground below it within 1 mm."""
    heights = np.full((100, 100), 200.0, "float32")
    heights[:, 60:] = 3000.0
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=100, height=100, count=1, dtype="float32", crs="EPSG:4326",
        transform=rasterio.Affine(1e-3, 0.0, WEST, 0.0, -1e-3, NORTH),
    ) as sink:  # fmt: skip
        sink.write(heights, 1)
    lon, lat = np.array([WEST + 0.02]), np.array([NORTH - 0.05])
    camera, ground = geodetic_to_ecef(lon, lat, np.array([900.0])), geodetic_to_ecef(lon, lat, np.array([200.0]))
    direction = (ground - camera) / np.linalg.norm(ground - camera)
    found = on_surface(camera, direction, RasterDem(tmp_path / "dem.tif"), "camera")
    assert np.linalg.norm(found - ground) <= 1e-3


@pytest.mark.behaviour
def test_values_of_a_file_with_scale_offset_and_holes_of_all_kinds(tmp_path: Path) -> None:
    """Heights are scaled by the file; nodata, NaN, infinity and impossible heights are holes, which a note counts."""
    path, values = tmp_path / "dem.tif", np.full((8, 8), 1234, "float32")
    values[0, :5] = [-1, np.nan, np.inf, -np.inf, 1e30]
    with rasterio.open(
        path, "w", driver="GTiff", width=8, height=8, count=1, dtype="float32", crs="EPSG:4326", nodata=-1,
        transform=rasterio.Affine(1e-3, 0.0, WEST, 0.0, -1e-3, NORTH),
    ) as sink:  # fmt: skip
        sink.write(values, 1)
        sink.scales, sink.offsets = (0.1,), (500.0,)
    dem = RasterDem(path)
    assert np.isnan(dem.heights_m[0, :5]).all() and np.allclose(dem.heights_m[1:], 623.4)
    assert dem.range_m == pytest.approx((623.4, 623.4))
    (note,) = dem.notes
    assert note.code == "dem.implausible" and note.data["count"] == 3


@pytest.mark.behaviour
@pytest.mark.parametrize(("value", "cell", "told"), [(0.0, 1e-3, True), (0.0, 1e-2, False), (850.0, 1e-3, False)])
def test_cliffs_of_one_value_are_named(tmp_path: Path, value: float, cell: float, told: bool) -> None:
    """Cells of 0 m among 900 m are named if the step is within 100 m of ground, but not within 1 km."""
    rng = np.random.default_rng(3)
    heights = rng.uniform(880.0, 920.0, (40, 40)).astype("float32")
    heights[10:14, 20:26] = value
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=40, height=40, count=1, dtype="float32", crs="EPSG:4326",
        transform=rasterio.Affine(cell, 0.0, WEST, 0.0, -cell, NORTH),
    ) as sink:  # fmt: skip
        sink.write(heights, 1)
    found: list[Any] = []
    dem = RasterDem(tmp_path / "dem.tif", warn=found.append)
    assert dem.range_m[0] == pytest.approx(value, abs=35.0)
    assert [one.code for one in found] == [one.code for one in dem.notes] == (["dem.cliffs"] if told else [])
    if told:
        assert "cells of 0 m" in found[0].message and "row 1" in found[0].message


@pytest.mark.behaviour
def test_unusable_rasters_are_refused_in_one_line(tmp_path: Path) -> None:
    settings: dict[str, Any] = {"driver": "GTiff", "width": 8, "height": 8, "count": 1, "crs": "EPSG:4326"}
    path = tmp_path / "complex.tif"
    with rasterio.open(path, "w", dtype="complex64", transform=rasterio.Affine(1, 0, 29, 0, -1, 44), **settings):
        pass
    with pytest.raises(InputError, match=r"cannot be read.*complex64"):
        RasterDem(path)
    path = write(tmp_path / "cut.tif", slice(0, 1024), slice(0, 1024), size=1024)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match="cannot be read"):
        assert RasterDem(path).range_m


# --- the size of a run -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Used:
    """How a command of its own process ended, its processor time, s, and its largest memory, MB."""

    code: int
    stderr: str
    seconds: float
    megabytes: float


#: Runs a command and writes the largest size of its process into a file: the usage that the system tells the parent
#: includes the parent's own size.
PROGRAM = """
import atexit, pathlib, re, sys
status = pathlib.Path("/proc/self/status")
out = pathlib.Path(sys.argv[1])
atexit.register(lambda: out.write_text(re.search(r"VmHWM:\\s+(\\d+) kB", status.read_text())[1]))
sys.argv[:2] = ["fg-orient"]
from fg_orient.cli import main
main()
"""


def command(size: Path, *words: object) -> Used:
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, size, *map(str, words)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    assert process.stderr is not None
    with process.stderr as stream:
        text = stream.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return Used(process.returncode, text, usage.ru_utime + usage.ru_stime, int(size.read_text()) / 1000.0)


def sparse_image(path: Path, size: int) -> Path:
    """Return the sparse image with pixels in a square of 2048."""
    with rasterio.open(
        path, "w", driver="GTiff", width=size, height=size, count=1, dtype="uint8", tiled=True, blockxsize=256,
        blockysize=256, compress="deflate", SPARSE_OK=True,
    ) as sink:  # fmt: skip
        grey = np.random.default_rng(1).integers(1, 255, (2048, 2048)).astype("uint8")
        sink.write(grey, 1, window=rasterio.windows.Window(512, 512, 2048, 2048))
    return path


@pytest.mark.behaviour
@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the size of a process is in kB on Linux only")
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_an_image_of_60000_lines_costs_what_is_used(tmp_path: Path, rng: np.random.Generator) -> None:
    """``rectify ortho`` of a part of a 60 000-line image needs below 400 MB, and at most 3 s more than a small one."""
    pixels = rng.uniform(0.0, 4000.0, (20, 2))
    rows = [f"{k},{a!r},{b!r},{300_000 + 10 * b!r},{4_600_000 - 10 * a!r}" for k, (a, b) in enumerate(pixels.tolist())]
    table = tmp_path / "points.csv"
    table.write_text("\n".join(["id,line,sample,easting_m,northing_m", *rows, ""]), "utf-8")
    fit = tmp_path / "fit"
    assert command(tmp_path / "size", "rectify", "fit", table, "--direction", "map-to-image", "--crs", UTM, "--out",
                   fit).code == 0  # fmt: skip
    used = [
        command(tmp_path / "size", "rectify", "ortho", sparse_image(tmp_path / f"{size}.tif", size), fit, "--crs", UTM,
                "--bounds", "305120,4570000,325000,4594880", "--resolution", 10, "--height", 0, "--out",
                tmp_path / f"map{size}.tif") for size in (4096, SIZE)
    ]  # fmt: skip
    print(used)
    assert [one.code for one in used] == [0, 0], used
    assert used[1].megabytes < 400.0 and used[1].seconds < used[0].seconds + 3.0
    assert (tmp_path / "map4096.tif").read_bytes() == (tmp_path / f"map{SIZE}.tif").read_bytes()


@pytest.mark.behaviour
@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the size of a process is in kB on Linux only")
def test_matching_with_a_raster_of_60000_lines_costs_what_is_used(tmp_path: Path) -> None:
    """``match --dem`` with a 60 000-line raster finds the same points with at most 50 MB and 3 s more.

    The small raster has the same heights.
    """
    pytest.importorskip("cv2")
    scene = Scene(85.0, 3, relief_m=5.0, walls=3)
    write_pair(tmp_path, scene, (View("a", (0.25, -0.05), 180), View("b", (-0.25, 0.1), 180)), snr=50.0)
    small, large = tmp_path / "small.tif", tmp_path / "large.tif"
    scene.write_dem(small, 5.0)
    with rasterio.open(small) as source:
        heights, place, settings = source.read(1), source.transform, source.profile
    at = SIZE // 2
    settings |= {"width": SIZE, "height": SIZE, "tiled": True, "blockxsize": 256, "blockysize": 256, "SPARSE_OK": True,
                 "compress": "deflate", "nodata": -9999, "transform": place @ place.translation(-at, -at)}  # fmt: skip
    with rasterio.open(large, "w", **settings) as sink:
        window = rasterio.windows.Window(at, at, heights.shape[1], heights.shape[0])
        sink.write(heights, 1, window=window)
    used, found = [], []
    for dem in (small, large, small, large):  # the first run may compile
        used.append(command(tmp_path / "size", "match", tmp_path / "project.toml", "--dem", dem, "--dem-sigma", 5,
                            "--overwrite"))  # fmt: skip
        found.append((tmp_path / "observations.csv").read_bytes())
    print(used)
    assert [one.code for one in used] == [used[0].code] * 4 and used[0].code in (0, 4), used
    assert found[2] == found[3]
    assert used[3].megabytes < used[2].megabytes + 50.0 and used[3].seconds < used[2].seconds + 3.0


@pytest.mark.behaviour
@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the size of a process is in kB on Linux only")
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_raster_of_60000_lines_costs_what_is_used(tmp_path: Path) -> None:
    """Each command that reads a DEM takes below 400 MB for 60 000 lines, and 3 s more than for a small raster at most.

    The commands are ``locate``, ``accuracy``, ``adjust --dem-control``, ``rectify ortho`` and ``rpc check``.
    """
    project = simulate_zonguldak(tmp_path / "twin", ZonguldakOptions(seed=1))
    assert command(tmp_path / "size", "adjust", project, "--out", tmp_path / "result", "--quiet").code == 0
    table = tmp_path / "twin/points.csv"
    lines = [line.split(",") for line in table.read_text("utf-8").splitlines()]
    made = [f"{line[0]},tie,,,,,," if line[1:2] == ["check"] else ",".join(line) for line in lines]
    table.write_text("\n".join([*made, ""]), "utf-8")
    rows, columns = slice(27_000, 35_000), slice(23_000, 34_000)
    large = write(tmp_path / "large.tif", rows, columns)
    with rasterio.open(
        tmp_path / "small.tif", "w", driver="GTiff", width=110, height=80, count=1, dtype="int16", crs="EPSG:4326",
        transform=rasterio.Affine(100 * STEP, 0.0, WEST + 2.3, 0.0, -100 * STEP, NORTH - 2.7),
    ) as sink:  # fmt: skip
        sink.write(np.tile(np.arange(850, 960, dtype="int16"), (80, 1)), 1)
    pixels = tmp_path / "pixels.csv"
    rng = np.random.default_rng(1)
    lines = [f"{k},{a:.2f},{b:.2f}" for k, (a, b) in enumerate(rng.uniform(200.0, 11_800.0, (500, 2)))]
    pixels.write_text("\n".join(["id,line,sample", *lines, ""]), "utf-8")
    image = sparse_image(tmp_path / "image.tif", 12_000)
    rpc = tmp_path / "scene_RPC.TXT"
    fit = command(tmp_path / "size", "rpc", "fit", tmp_path / "twin/left.DIM", "--heights", 0, 1500, "--out", rpc)
    assert fit.code == 0, fit.stderr
    words = {
        "rectify ortho": ("rectify", "ortho", image, tmp_path / "twin/left.DIM", "--crs", "EPSG:4326", "--out",
                          tmp_path / "map.tif", "--resolution", 3e-4, "--overwrite", "--allow-holes", "--dem"),
        "rpc check": ("rpc", "check", rpc, "--dem"),
        "locate": ("locate", tmp_path / "twin/left.DIM", "--points", pixels, "--dem"),
        "accuracy": ("accuracy", tmp_path / "result", "--dem"),
        "adjust": ("adjust", project, "--overwrite", "--out", tmp_path / "controlled", "--dem-sigma", 300,
                   "--dem-control"),
    }  # fmt: skip
    for name, given in words.items():
        few, many = (command(tmp_path / "size", *given, dem) for dem in (tmp_path / "small.tif", large))
        print(name, few, many)
        assert few.code in (0, 4) and many.code == few.code, (few.stderr, many.stderr)
        assert many.megabytes < 400.0
        assert many.seconds < few.seconds + 3.0
