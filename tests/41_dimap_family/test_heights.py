"""The tests cover a DEM above a geoid, the covariance of intersections, and a DEM as control."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyproj
import pytest
from scipy.interpolate import RegularGridInterpolator

from factors.conditions.control import HEIGHT_CONTROL
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef, geodetic_to_ecef
from fg_orient.model.block import Block, Coordinates, GroundPoints, ImagePoints, Options, WithheldCoordinates
from fg_orient.model.errors import InputError
from fg_orient.model.names import Role
from fg_orient.orientation.dem_control import adjust_with_dem
from fg_orient.sensors import initial
from fg_orient.sensors.correction import Correction
from fg_orient.sensors.surface import RasterDem
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.equation_examples import EXAMPLES

Array = np.ndarray

# --- geoid ---------------------------------------------------------------------------------------

LON, LAT = np.arange(30.0, 34.01, 0.25), np.arange(44.0, 39.99, -0.25)
UNDULATION = (20.0 + 3.0 * np.sin(LON[None] / 1.3) + 2.0 * np.cos(LAT[:, None])).astype("float32")


@pytest.fixture
def geoid(tmp_path: Path) -> Iterator[None]:
    """Put a grid with the name of EGM96 into a folder where PROJ finds it."""
    rasterio = pytest.importorskip("rasterio")
    folder = tmp_path / "grids"
    folder.mkdir()
    with rasterio.open(
        folder / "us_nga_egm96_15.tif", "w", driver="GTiff", width=len(LON), height=len(LAT), count=1, dtype="float32",
        crs="EPSG:4326", transform=rasterio.Affine(0.25, 0, 29.875, 0, -0.25, 44.125),
    ) as grid:  # fmt: skip
        grid.write(UNDULATION[None])
        grid.update_tags(TYPE="VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL", AREA_OR_POINT="Point")
        grid.set_band_description(1, "geoid_undulation")
        grid.units = ("metre",)
    usual = pyproj.datadir.get_data_dir()
    pyproj.datadir.append_data_dir(str(folder))
    yield
    pyproj.datadir.set_data_dir(usual)


def write_dem(path: Path, crs: str, place: tuple[float, ...], shape: tuple[int, int], height_m: float = 500.0) -> Path:
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(
        path, "w", driver="GTiff", width=shape[1], height=shape[0], count=1, dtype="float64", crs=crs,
        transform=rasterio.Affine(*place),
    ) as raster:  # fmt: skip
        raster.write(np.full((1, *shape), height_m))
    return path


def expected_undulation(lon: Array, lat: Array) -> Array:
    """Interpolate bilinearly between the nodes of the grid."""
    found = RegularGridInterpolator((LAT[::-1], LON), UNDULATION[::-1].astype(float))(np.stack([lat, lon], axis=-1))
    return np.asarray(found)


@pytest.mark.oracle
def test_heights_above_a_geoid_come_down_to_the_ellipsoid(geoid: None, tmp_path: Path) -> None:
    """Cells above a geoid become ellipsoidal within 1 mm, whether file or caller names the vertical CRS."""
    row, column = np.mgrid[:300, :400]
    expected = 500.0 + expected_undulation(31.6 + 0.001 * (column + 0.5), 42.0 - 0.001 * (row + 0.5))
    place = (0.001, 0.0, 31.6, 0.0, -0.001, 42.0)
    stated = RasterDem(write_dem(tmp_path / "a.tif", "EPSG:4326+5773", place, row.shape))
    given = RasterDem(write_dem(tmp_path / "b.tif", "EPSG:4326", place, row.shape), vertical_crs="EPSG:5773")
    for dem in (stated, given):
        assert np.abs(dem.heights_m - expected).max() <= 1e-3
        assert pyproj.CRS(dem.crs) == pyproj.CRS("EPSG:4326")
    assert expected.max() - expected.min() > 1.0
    twice = RasterDem(tmp_path / "a.tif", vertical_crs="EPSG:5773")
    assert np.array_equal(twice.heights_m, stated.heights_m)
    with pytest.raises(InputError, match=r"another vertical CRS .*EGM96 height, not EPSG:3855"):
        RasterDem(tmp_path / "a.tif", vertical_crs="EPSG:3855")


@pytest.mark.oracle
def test_a_projected_dem_above_a_geoid(geoid: None, tmp_path: Path) -> None:
    """A projected DEM above a geoid has ellipsoidal heights within 1e-6 m.

    It has few cells, so that nothing is interpolated.
    """
    dem = RasterDem(write_dem(tmp_path / "a.tif", "EPSG:32636+5773", (9e3, 0, 410e3, 0, -7e3, 4600e3), (5, 7)))
    row, column = np.mgrid[:5, :7]
    to_lonlat = pyproj.Transformer.from_crs("EPSG:32636", "EPSG:4326", always_xy=True)
    lon, lat = to_lonlat.transform(410e3 + 9e3 * (column + 0.5), 4600e3 - 7e3 * (row + 0.5))
    assert np.abs(dem.heights_m - 500.0 - expected_undulation(lon, lat)).max() < 1e-6
    inner = np.s_[1:-1, 1:-1]  # rounding puts cells of the border outside
    assert np.allclose(dem.height_m(lon[inner], lat[inner]), dem.heights_m[inner], atol=1e-6)


@pytest.mark.behaviour
def test_what_the_geoid_cannot_do(geoid: None, tmp_path: Path) -> None:
    place = (0.001, 0.0, 37.6, 0.0, -0.001, 42.0)
    with pytest.raises(InputError, match=r"cannot be transformed to ellipsoidal heights.*outside the domain"):
        RasterDem(write_dem(tmp_path / "beside.tif", "EPSG:4326+5773", place, (4, 4)))
    plain = write_dem(tmp_path / "plain.tif", "EPSG:4326", place, (4, 4))
    with pytest.raises(InputError, match="not a vertical CRS"):
        RasterDem(plain, vertical_crs="EPSG:4326")
    with pytest.raises(InputError, match="unknown EPSG code"):
        RasterDem(plain, vertical_crs="EPSG:999999")


# --- intersections -------------------------------------------------------------------------------


@pytest.mark.oracle
def test_covariance_of_an_intersection_by_simulation() -> None:
    """The covariance of an intersection equals that of 4000 draws within 5 standard errors of each element."""
    block, truth = zonguldak_block(ZonguldakOptions(seed=1, errors="none"))
    sensors = [image.sensor for image in block.images]
    sigma = np.array([[0.4, 0.7], [1.1, 0.3]])
    at = np.array([s.project(truth.ecef_m[:1]) for s in sensors])[:, :, 0]
    n, rng = 4000, np.random.default_rng(5)
    noise = rng.normal(size=(2, 2, n)) * sigma[:, :, None]
    line, sample = (at[:, k, None] + noise[:, k] for k in (0, 1))
    found = initial.intersect(sensors, line, sample) - truth.ecef_m[0]
    points = ImagePoints(np.arange(2), np.zeros(2, int), at[:, 0], at[:, 1], sigma[:, 0], sigma[:, 1])
    (c,) = initial.intersection_covariances(block.images, points, truth.ecef_m[:1])
    error = np.sqrt((np.outer(np.diag(c), np.diag(c)) + c**2) / n)
    assert (np.abs(np.cov(found.T) - c) < 5.0 * error).all()
    assert np.sqrt(np.diag(c)).min() > 0.5


@pytest.mark.behaviour
def test_covariance_at_the_border_of_an_image() -> None:
    """A point at the image border has a finite covariance; a point on one ray has none.

    The difference quotient is taken inside the image.
    """
    block, _ = zonguldak_block(ZonguldakOptions(seed=1))
    sensor = block.images[0].sensor
    points = ImagePoints([0, 1, 0], [0, 0, 1], [-0.5, 50.0, 9.0], [11999.5, 60.0, 9.0], *np.ones((2, 3)))
    ground = sensor.locate([-0.5, 9.0], [11999.5, 9.0], height_m=0.0)
    first, second = initial.intersection_covariances(block.images, points, ground)
    assert np.isfinite(first).all() and np.isnan(second).all()


# --- a DEM as control ----------------------------------------------------------------------------


class Hills:
    """Slopes of 10 % to the East with waves of 40 m: analytic, so that the reference is exact."""

    path = "hills"
    lon0, lat0 = 31.5, 41.3

    def height_m(self, lon: Array, lat: Array) -> Array:
        """Return the heights of N points."""
        east, north = (lon - self.lon0) * 83.6e3, (lat - self.lat0) * 111.1e3
        return 600.0 + 0.1 * east + 40.0 * np.sin(east / 3e3) * np.cos(north / 4e3)

    @property
    def range_m(self) -> tuple[float, float]:
        """Return the lowest and highest height."""
        return -5e3, 6e3

    def cell(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        """Return the cells of 0.001 degrees."""
        return lat * 1e3, lon * 1e3


def tie_block(n: int = 12, noise_px: float = 0.3) -> tuple[Block, Array]:
    """Return the tie points on the hills in both twin images of wrong orientation.

    Nothing is measured on the ground.
    """
    base, truth = zonguldak_block(ZonguldakOptions(seed=3))
    rng = np.random.default_rng(4)
    lon0, lat0 = (float(a[0]) for a in ecef_to_geodetic(base.images[0].sensor.centre_m)[:2])
    Hills.lon0, Hills.lat0 = lon0, lat0
    lon, lat = lon0 + rng.uniform(-0.15, 0.15, n), lat0 + rng.uniform(-0.15, 0.15, n)
    ground = geodetic_to_ecef(lon, lat, Hills().height_m(lon, lat))
    rows = []
    for k, image in enumerate(base.images):
        line, sample = image.sensor.project(ground, truth.corrections[k])
        noise = rng.normal(0.0, noise_px, (2, n)) if noise_px else np.zeros((2, n))
        rows.append(
            (np.full(n, k), np.arange(n), line + noise[0], sample + noise[1], *np.full((2, n), noise_px or 0.3))
        )
    observations = ImagePoints(*(np.concatenate(c) for c in zip(*rows, strict=True)))
    empty = Coordinates(np.full((n, 3), np.nan), np.full((n, 3), np.nan), np.zeros(n, bool))
    points = GroundPoints(tuple(f"t{k}" for k in range(n)), (Role.TIE,) * n, empty)
    none = WithheldCoordinates((), lambda: Coordinates(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool)))
    options = Options(eop_set=10, datum="priors", backend="dense")
    return Block("hills", base.images, points, observations, none, options), ground


def up_errors(found: Array, truth: Array) -> Array:
    lon, lat, _ = ecef_to_geodetic(truth)
    return np.asarray(np.einsum("nij,nj->ni", enu_from_ecef(lon, lat), found - truth)[:, 2])


@pytest.mark.oracle
def test_height_control_is_registered_with_its_jacobian() -> None:
    e = EXAMPLES["height_control"](np.random.default_rng(1))
    value, jacobian = HEIGHT_CONTROL.kernel(e.record, e.setup, *e.unknowns, True)
    for c in range(3):
        z = e.unknowns[0].astype(complex)
        z[c] += 1e-30j
        step = HEIGHT_CONTROL.residual(e.record, e.setup, z).imag[0] / 1e-30
        assert jacobian[0, c] == pytest.approx(step, rel=1e-14, abs=0.0)
    assert HEIGHT_CONTROL.kernel(e.record, e.setup, *e.unknowns, False)[0] == value


@pytest.mark.oracle
def test_a_dem_holds_the_heights_of_tie_points() -> None:
    """A DEM reduces the height errors of tie points from over 6 m to below 3 m, and its residuals are exact."""
    import fg_orient as fg

    block, truth = tie_block()
    before = fg.adjust(block)
    found = adjust_with_dem(block, Hills(), 1.0)
    assert found.at_rest and 3 <= found.rounds <= 6
    assert (found.ids, found.outside) == (block.points.ids, ())
    free, held = (np.sqrt(np.mean(up_errors(s.ground_m, truth) ** 2)) for s in (before, found.solution))
    # a slope of 10 % and 20 m of the orientation leave 2 m; the points lie on the model all the same
    assert held < 3.0 < 6.0 < free
    assert np.sqrt(np.mean(found.height_m**2)) < 0.5
    assert found.solution.redundancy == before.redundancy + len(truth)
    lon, lat, h = ecef_to_geodetic(found.solution.ground_m)
    assert np.abs(found.height_m - (h - Hills().height_m(lon, lat))).max() < 1e-6
    # at rest the planes are those of the adjusted places, and the residual is the height above the model
    extra = found.solution.problem.block.extra[0]
    residual = extra.equation.residual(extra.record, extra.setup, found.solution.state.ground[0])
    # they were read at most 1 mm away, on slopes whose curvature is 40 / 3000^2 per m
    assert residual[0] == pytest.approx(found.height_m[0], abs=1e-6)
    for backend in ("graph", "schur"):
        again = adjust_with_dem(block, Hills(), 1.0, backend=backend)
        assert np.abs(again.solution.ground_m - found.solution.ground_m).max() < 1e-3  # at rest within 1 mm


@pytest.mark.oracle
def test_the_adjustment_with_a_dem_is_the_minimum() -> None:
    """The adjustment with a DEM is the minimum of the cost written out: no step of 0.01 sigma is left."""
    block, _ = tie_block(n=6)
    found = adjust_with_dem(block, Hills(), 2.0)
    problem, o, state = found.solution.problem, block.observations, found.solution.state
    sigmas = [model.parameters.setup[1] for model in problem.models]
    codes = [model.parameters.setup[0].astype(int) for model in problem.models]
    sizes = [len(s) for s in sigmas]

    def residuals(x: Array) -> Array:
        scaled = np.split(x[: sum(sizes)], np.cumsum(sizes)[:-1])
        ground = x[sum(sizes) :].reshape(-1, 3) + problem.origin_m
        out = list(scaled)
        for k, image in enumerate(block.images):
            eop = np.zeros(27)
            eop[codes[k]] = scaled[k] * sigmas[k]
            rows = o.image == k
            line, sample = image.sensor.project(ground[o.point[rows]], Correction(eop.reshape(9, 3)))
            out += [(line - o.line[rows]) / 0.3, (sample - o.sample[rows]) / 0.3]
        lon, lat, h = ecef_to_geodetic(ground)
        return np.concatenate([*out, (h - Hills().height_m(lon, lat)) / 2.0])

    x = np.concatenate([*(state.image[k, :n] for k, n in enumerate(sizes)), state.ground.ravel()])
    steps = np.where(np.arange(len(x)) < sum(sizes), 1e-3, 0.1)
    jacobian = np.stack([(residuals(x + h * e) - residuals(x - h * e)) / (2 * h)
                         for h, e in zip(steps, np.eye(len(x)), strict=True)], axis=1)  # fmt: skip
    r = residuals(x)
    # pixels are whitened with their derivative at the start, which changes by 1e-3 over 20 m
    assert r @ r == pytest.approx(found.solution.chi2, rel=5e-3)
    step = np.linalg.lstsq(jacobian, -r, rcond=None)[0]
    sd = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    assert np.abs(step / sd).max() < 0.01


@pytest.mark.behaviour
def test_points_beside_the_dem_are_left_out() -> None:
    block, _ = tie_block()

    class Half(Hills):
        def height_m(self, lon: Array, lat: Array) -> Array:
            return np.where(lon > self.lon0, super().height_m(lon, lat), np.nan)

    found = adjust_with_dem(block, Half(), 1.0)
    assert found.at_rest and found.outside and found.ids
    assert sorted(found.ids + found.outside) == sorted(block.points.ids)
    assert np.isfinite(found.height_m).all()


@pytest.mark.behaviour
@pytest.mark.parametrize("sigma", [0.0, -1.0, float("nan")])
def test_what_dem_control_refuses(sigma: float) -> None:
    block, _ = tie_block(n=5)
    with pytest.raises(InputError, match="not a positive number"):
        adjust_with_dem(block, Hills(), sigma)
    with pytest.raises(InputError, match="none of the points that need a height"):
        adjust_with_dem(block, Hills(), 1.0, roles=(Role.CONTROL,))
