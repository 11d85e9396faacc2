"""The first hit of a ray on a DEM is compared with a march in small steps; unusable DEMs are refused."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pyproj
import pytest

from factors.geometry import ellipsoid
from fg_orient.model.errors import Finding, InputError
from fg_orient.sensors.pushbroom import PushbroomSensor
from fg_orient.sensors.surface import RasterDem, on_surface
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

rasterio = pytest.importorskip("rasterio")

Grid = tuple[np.ndarray, np.ndarray]
#: CRS, cell size and centre of a raster under the middle of the left twin image.
GRIDS = {"EPSG:4326": (0.0005, 0.0004), "EPSG:32636": (40.0, 40.0)}
SIZE = 321


@pytest.fixture(scope="module")
def sensor() -> PushbroomSensor:
    return zonguldak_block(ZonguldakOptions(seed=1))[0].images[0].sensor


def write(path: Path, heights: np.ndarray, crs: str, corner: tuple[float, float], **options: object) -> Path:
    step_x, step_y = GRIDS.get(crs, GRIDS["EPSG:4326"])
    transform = rasterio.Affine(step_x, 0.0, corner[0], 0.0, -step_y, corner[1])
    with rasterio.open(
        path, "w", driver="GTiff", width=heights.shape[1], height=heights.shape[0], count=1, dtype="float64",
        crs=crs, transform=transform, nodata=-9999.0, **options,
    ) as raster:  # fmt: skip
        raster.write(np.where(np.isnan(heights), -9999.0, heights)[None])
    return path


def terrain(shape: str) -> np.ndarray:
    """Return the heights (SIZE, SIZE): ridges along the columns, 2 km high, or slopes with waves in both axes."""
    row, column = np.mgrid[:SIZE, :SIZE] - SIZE // 2.0
    if shape == "ridge":  # flanks of 2 km over 8 cells of 40 m: steeper than any ray
        return np.maximum(0.0, 2000.0 * (1.0 - np.abs(column) / 8.0))
    return 600.0 + 1.5 * column + 300.0 * np.sin(column / 9.0) * np.cos(row / 13.0)


def below_centre(sensor: PushbroomSensor, crs: str) -> tuple[float, float]:
    """Return the corner of a raster whose middle lies under the image centre."""
    lon, lat, _ = np.degrees(ellipsoid.geodetic_array(sensor.centre_m[None]))[0]
    x, y = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    step_x, step_y = GRIDS[crs]
    return x - 0.5 * SIZE * step_x, y + 0.5 * SIZE * step_y


def rays(sensor: PushbroomSensor, n: int = 400) -> Grid:
    """Return the rays across the middle 1600 samples (8 km of ground) of the image, lines at random."""
    rng = np.random.default_rng(8)
    return sensor.rays(rng.uniform(5600.0, 6400.0, n), np.linspace(5200.0, 6800.0, n))


@functools.cache
def transformer(source: str, target: str) -> pyproj.Transformer:
    return pyproj.Transformer.from_crs(source, target, always_xy=True)


def fine_march(p: np.ndarray, u: np.ndarray, heights: np.ndarray, crs: str, corner: tuple[float, float]) -> Grid:
    """Return the first crossing of one ray in steps of 0.5 m, and the number of crossings.

    No code of the package's intersection is used.
    """
    from scipy.interpolate import RegularGridInterpolator

    step_x, step_y = GRIDS[crs]
    x = corner[0] + step_x * (np.arange(SIZE) + 0.5)
    y = corner[1] - step_y * (np.arange(SIZE) + 0.5)
    surface = RegularGridInterpolator((y[::-1], x), heights[::-1])
    near = ellipsoid.distance_to_height(p, u, 2001.0)
    s = near + np.arange(0.0, 2600.0, 0.5)
    lon, lat, h = transformer("EPSG:4978", "EPSG:4979").transform(*(p[:, None] + u[:, None] * s))
    gx, gy = transformer("EPSG:4326", crs).transform(lon, lat)
    depth = surface(np.stack([gy, gx], axis=1)) - h
    below = depth >= 0.0
    changes = np.flatnonzero(below[1:] != below[:-1])
    k = changes[0]
    first = s[k] - depth[k] * (s[k + 1] - s[k]) / (depth[k + 1] - depth[k])
    return p + u * first, np.array(len(changes))


@pytest.mark.oracle
@pytest.mark.parametrize("shape", ["ridge", "slopes"])
@pytest.mark.parametrize("crs", sorted(GRIDS))
def test_first_hit_equals_a_fine_march(sensor: PushbroomSensor, tmp_path: Path, shape: str, crs: str) -> None:
    """The first hit of a ray on a DEM equals that of a march in small steps within 5 mm."""
    heights, corner = terrain(shape), below_centre(sensor, crs)
    dem = RasterDem(write(tmp_path / "dem.tif", heights, crs, corner))
    p, u = rays(sensor)
    found = on_surface(p, u, dem, "left.DIM")
    expected = [fine_march(p[i], u[i], heights, crs, corner) for i in range(len(p))]
    assert np.linalg.norm(found - np.array([e[0] for e in expected]), axis=1).max() < 5e-3
    several = sum(e[1] > 1 for e in expected)
    # otherwise the ridge hides nothing, and the test could not fail
    assert several >= 10 if shape == "ridge" else several == 0


@pytest.mark.oracle
def test_holes_matter_only_before_the_first_hit(sensor: PushbroomSensor, tmp_path: Path) -> None:
    """A ray that crosses a hole before its hit is refused; the same hole behind the ridge changes no bit."""
    crs, heights = "EPSG:32636", terrain("ridge")
    corner = below_centre(sensor, crs)
    p, u = sensor.rays(np.full(200, 6000.0), np.linspace(5200.0, 6800.0, 200))
    free = on_surface(p, u, RasterDem(write(tmp_path / "a.tif", heights, crs, corner)), "left.DIM")
    x = pyproj.Transformer.from_crs("EPSG:4978", crs, always_xy=True).transform(*free.T)[0]
    column = (x - corner[0]) / 40.0 - 0.5 - SIZE // 2
    low, high = ellipsoid.intersect(p, u, np.zeros(200)), ellipsoid.intersect(p, u, np.full(200, 2000.0))
    towards = np.sign(np.diff(pyproj.Transformer.from_crs("EPSG:4978", crs).transform(
        *np.stack([high[0], low[0]]).T)[0])[0])  # fmt: skip
    # rays low on the flank facing the sensor (higher ones pass above 2 km); a hole in the flat on either side
    facing = np.flatnonzero((np.abs(column) < 6.0) & (column * towards < -3.5))
    assert len(facing) >= 3
    for side, refused in ((towards, False), (-towards, True)):
        holed = heights.copy()
        middle = SIZE // 2 + int(side * 14)
        holed[:, middle - 5 : middle + 6] = np.nan
        dem = RasterDem(write(tmp_path / f"hole{refused}.tif", holed, crs, corner))
        if refused:
            with pytest.raises(
                InputError, match=rf"ray 1 of left\.DIM.*meets nodata.*found {len(facing)} of {len(facing)}"
            ):
                on_surface(p[facing], u[facing], dem, "left.DIM")
        else:
            assert np.array_equal(on_surface(p[facing], u[facing], dem, "left.DIM"), free[facing])


@pytest.mark.behaviour
def test_rays_beside_the_dem_are_refused(sensor: PushbroomSensor, tmp_path: Path) -> None:
    dem = RasterDem(write(tmp_path / "dem.tif", terrain("slopes"), "EPSG:4326", below_centre(sensor, "EPSG:4326")))
    with pytest.raises(InputError, match="comes from outside"):
        sensor.locate([6000.0, 100.0], [6000.0, 100.0], dem=dem)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("crs", "unit", "message"),
    [
        ("EPSG:4326", None, None),
        ("EPSG:4326", "metre", None),
        ("EPSG:4979", None, None),
        ("EPSG:32636", None, None),
        ("EPSG:4326+5773", None, "cannot be transformed to ellipsoidal heights.*us_nga_egm96_15.tif.*EGM96 height"),
        ("EPSG:32636+5773", None, "us_nga_egm96_15.tif"),
        ("EPSG:4326", "US survey foot", "not in metres .found US survey foot"),
    ],
)
def test_heights_are_ellipsoidal_metres(tmp_path: Path, crs: str, unit: str | None, message: str | None) -> None:
    path = write(tmp_path / "dem.tif", np.full((4, 4), 512.0), crs, (31.0, 42.0))
    if unit:
        with rasterio.open(path, "r+") as raster:
            raster.units = (unit,)
    if message is None:
        assert RasterDem(path).range_m == (512.0, 512.0)
    else:
        with pytest.raises(InputError, match=message) as refused:
            RasterDem(path)
        assert refused.value.problems[0].code == ("dem.vertical_unit" if unit else "dem.geoid")


@pytest.mark.behaviour
def test_heights_that_no_land_has_are_nodata_and_told(sensor: PushbroomSensor, tmp_path: Path) -> None:
    """Heights outside -500 to 9000 m are nodata, and a warning counts the cells.

    Files may not declare their nodata value.
    """
    corner = below_centre(sensor, "EPSG:4326")
    heights = np.full((SIZE, SIZE), 300.0)
    heights[:3] = -32767.0
    heights[-1, -2:] = 9001.0
    told_at_once: list[Finding] = []
    dem = RasterDem(write(tmp_path / "dem.tif", heights, "EPSG:4326", corner), warn=told_at_once.append)
    assert dem.notes == (), "nothing is read yet"
    assert dem.range_m == (300.0, 300.0) and int(np.isnan(dem.heights_m).sum()) == 3 * SIZE + 2
    (told,) = dem.notes
    assert told.code == "dem.implausible" and f"{3 * SIZE + 2} cells" in told.message
    assert [one.code for one in told_at_once] == ["dem.implausible"]
    heights[:3], heights[-1, -2:] = -500.0, 9000.0
    plausible = RasterDem(write(tmp_path / "plausible.tif", heights, "EPSG:4326", corner))
    assert plausible.range_m == (-500.0, 9000.0)
    assert [one.code for one in plausible.notes] == ["dem.cliffs"]
