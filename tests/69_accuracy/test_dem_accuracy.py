"""Heights are compared with an elevation model: the tests check figures, a planted shift and its significance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2, median_abs_deviation

import fg_orient as fg
from fg_orient.geodesy import enu_from_ecef, geodetic_to_ecef
from fg_orient.model.errors import InputError
from fg_orient.quality.dem_accuracy import compare_dem, nmad
from fg_orient.simulate.block import BlockOptions, grid_block

LON, LAT = 31.8, 41.4
EAST_M, NORTH_M = 83_600.0, 111_100.0  # metres of a degree there, near enough for a terrain


@dataclass
class Hills:
    """Waves have a length of 1.5 km in two directions and a height of 120 m; flat, tilted or absent on request."""

    height: float = 120.0
    tilt: float = 0.0
    path: str = "hills"

    @property
    def range_m(self) -> tuple[float, float]:
        return -500.0, 500.0

    def cell(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return lat_deg, lon_deg

    def height_m(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
        e, n = (lon_deg - LON) * EAST_M, (lat_deg - LAT) * NORTH_M
        out = self.height * (np.sin(e / 240.0) + np.cos(n / 240.0)) + self.tilt * (e + n)
        return np.where(lon_deg > LON + 0.09, np.nan, out)


def on_the_hills(hills: Hills, seed: int, shift: tuple[float, float, float], noise: float, n: int = 200) -> np.ndarray:
    """Return the points of the surface (n, 3), moved by a shift in East, North, Up, with noise in height."""
    rng = np.random.default_rng(seed)
    lon, lat = LON + rng.uniform(-0.08, 0.08, n), LAT + rng.uniform(-0.08, 0.08, n)
    ground = geodetic_to_ecef(lon, lat, hills.height_m(lon, lat) + noise * rng.standard_normal(n))
    return ground + np.einsum("k,nkj->nj", np.array(shift), enu_from_ecef(lon, lat))


@pytest.mark.oracle
def test_figures(rng: np.random.Generator) -> None:
    lon, lat = LON + rng.uniform(-0.08, 0.1, 300), LAT + rng.uniform(-0.08, 0.08, 300)
    error = rng.normal(0.5, 2.0, 300)
    flat = Hills(height=0.0)
    found = compare_dem(geodetic_to_ecef(lon, lat, error), flat)
    over = error[lon <= LON + 0.09]
    figures = found.statistics()
    assert figures["n"] == len(over) and figures["n_outside"] == 300 - len(over) > 0
    expected = {
        "mean_m": over.mean(), "rmse_m": np.sqrt(np.mean(over**2)), "sd_m": over.std(ddof=1), "max_m": abs(over).max(),
        "median_m": np.median(over), "nmad_m": median_abs_deviation(over, scale="normal"),
        "q68_3_m": np.quantile(abs(over), 0.683), "q95_m": np.quantile(abs(over), 0.95),
    }  # fmt: skip
    for key, value in expected.items():
        assert figures[key] == pytest.approx(value, rel=1e-4, abs=1e-6), key


@pytest.mark.truth
def test_a_shift_of_the_points_shows_in_every_figure_of_its_kind() -> None:
    """A shift of 3 m upwards changes mean, median, RMSE and quantiles of heights, but no deviation from the mean."""
    lon, lat = LON + 0.01 * np.arange(-7, 8), LAT + 0.01 * np.arange(-7, 8)
    error, flat = np.random.default_rng(8).normal(0.0, 0.5, 15), Hills(height=0.0)
    plain, up = (
        compare_dem(geodetic_to_ecef(lon, lat, error + shift), flat).statistics() for shift in (0.0, 3.0)
    )  # fmt: skip
    for key in ("mean_m", "median_m"):
        assert up[key] - plain[key] == pytest.approx(3.0, abs=1e-4), key
    for key in ("rmse_m", "max_m", "q68_3_m", "q95_m"):
        assert up[key] > plain[key] + 1.0, key
    for key in ("sd_m", "nmad_m"):
        assert up[key] == pytest.approx(plain[key], abs=1e-4), key


@pytest.mark.truth
def test_nmad_is_the_standard_deviation_and_stands_blunders() -> None:
    d = np.random.default_rng(2).normal(3.0, 2.0, 100_000)
    assert nmad(d) == pytest.approx(2.0, rel=0.02)
    d[:10_000] = 1e4
    assert nmad(d) == pytest.approx(2.0, rel=0.2)


@pytest.mark.truth
def test_shift_is_found_through_blunders() -> None:
    put_in = np.array([12.0, -7.0, 3.0])
    ground = on_the_hills(Hills(), 4, tuple(put_in), 0.5)
    ground[:10] *= 1.0 + 60.0 / 6.37e6
    found = compare_dem(ground, Hills())
    assert found.shift is not None
    assert 175 <= found.shift.n <= 190
    assert np.all(np.abs(found.shift.enu_m - put_in) < 4.0 * found.shift.sigma_m)
    assert found.shift.significant.all()
    assert found.shift.rmse_after_m == pytest.approx(0.5, rel=0.2)
    assert found.shift.rmse_before_m > 4.0
    assert found.as_dict()["shift"]["significant"] == ["east", "north", "up"]


@pytest.mark.oracle
def test_sigmas_of_the_shift_are_calibrated() -> None:
    """The errors of the shift against a DEM lie in the 99.9 % interval of 30 seeds, with sigmas halved outside."""
    put_in, total = np.array([2.0, 1.0, -1.0]), np.zeros(3)
    for seed in range(30):
        shift = compare_dem(on_the_hills(Hills(), seed, tuple(put_in), 1.0, 80), Hills()).shift
        assert shift is not None
        total += ((shift.enu_m - put_in) / shift.sigma_m) ** 2
    low, high = chi2.ppf([0.0005, 0.9995], 30)
    assert np.all((low < total) & (total < high)), total
    assert np.all(4.0 * total > high)


@pytest.mark.behaviour
@pytest.mark.parametrize(("hills", "word"), [(Hills(height=0.0), "slopes"), (Hills(height=0.0, tilt=0.05), "slopes")])
def test_no_shift_without_slopes_of_different_aspect(hills: Hills, word: str) -> None:
    found = compare_dem(on_the_hills(hills, 1, (5.0, 0.0, 2.0), 0.1), hills)
    assert found.shift is None and word in str(found.unavailable)
    assert found.as_dict()["shift"] is None and found.as_dict()["warnings"]
    few = compare_dem(on_the_hills(Hills(), 1, (0.0, 0.0, 0.0), 0.1, 8), Hills())
    assert few.shift is None and "10 are needed" in str(few.unavailable)


@pytest.mark.behaviour
def test_solution_and_refusals() -> None:
    block, _ = grid_block(BlockOptions(rows=1, columns=2, points=60, seed=1))
    solution = fg.adjust(block, eop_set=2)

    class Plane(Hills):
        def height_m(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
            return np.full(np.shape(lon_deg), 100.0)

    class Nothing(Hills):
        def height_m(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
            return np.full(np.shape(lon_deg), np.nan)

    found = solution.compare_dem(Plane(), role="check")
    assert found.statistics()["n"] == len(solution.accuracy.check)
    with pytest.raises(InputError, match="no points with this role"):
        solution.compare_dem(Plane(), role="pass")
    with pytest.raises(InputError, match="no point is inside"):
        solution.compare_dem(Nothing())
