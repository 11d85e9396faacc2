"""The covariance of located points agrees with differences, Monte Carlo, and closed forms of circle and sphere."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

import fg_orient as fg
from fg_orient.adjustment import resection
from fg_orient.adjustment.problem import State
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.orientation.solution import Solution
from fg_orient.quality import located_point
from fg_orient.quality.located_point import LocatedPoint, error_ellipse, radius
from tests.support.rpc_block import rpc_twin


@dataclass(frozen=True)
class Plane:
    """A tilted plane of ellipsoidal heights."""

    rise: float = 0.0
    path: str = "plane"
    range_m: tuple[float, float] = (0.0, 3000.0)

    def cell(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return lat_deg / 1e-4, lon_deg / 1e-4

    def height_m(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
        return 900.0 + self.rise + 9000.0 * (lon_deg - 31.85) + 4000.0 * (lat_deg - 41.3)


@pytest.fixture(scope="module")
def solution(twin: Block) -> Solution:
    return fg.adjust(twin, eop_set=10)


def moved(solution: Solution, step: np.ndarray) -> Solution:
    """Return the solution with other orientation unknowns (prior sigmas)."""
    problem = solution.problem
    image = problem.image_matrix(problem.image_vector(solution.state) + step)
    return replace(solution, state=State(image, solution.state.ground))


def differenced(solution: Solution, locate: object, sigma: np.ndarray) -> np.ndarray:
    """Return the covariance of a function (solution, errors of the measurements) -> point by central differences."""
    u = solution.problem.n_image_unknowns
    everything = tuple(range(solution.problem.n_images))
    c = np.zeros((u + len(sigma),) * 2)
    c[:u, :u] = solution.cofactors.joint(everything, ()) * solution.scale**2
    c[u:, u:] = np.diag(sigma**2)
    columns = []
    for k in range(u + len(sigma)):
        ends = []
        for sign in (1.0, -1.0):
            step = np.zeros(u + len(sigma))
            step[k] = sign * 0.2
            ends.append(locate(moved(solution, step[:u]), step[u:]))
        columns.append((ends[0] - ends[1]) / 0.4)
    d = np.stack(columns, axis=1)
    return np.asarray(d @ c @ d.T)


def assert_same(found: np.ndarray, wanted: np.ndarray) -> None:
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.abs((found - wanted) / scale).max() < 1e-4


@pytest.mark.oracle
@pytest.mark.parametrize("height_sigma_m", [0.0, 2.5])
def test_one_image_at_a_height(solution: Solution, height_sigma_m: float) -> None:
    def locate(changed: Solution, e: np.ndarray) -> np.ndarray:
        point = changed.locate("left", 3100.0 + e[0], 4200.0 + e[1], height_m=700.0 + e[2])
        return point.ground_m

    found = solution.locate("left", 3100.0, 4200.0, height_m=700.0, height_sigma_m=height_sigma_m, sigma_px=(0.2, 0.4))
    assert_same(found.covariance_m2, differenced(solution, locate, np.array([0.2, 0.4, height_sigma_m])))
    assert found.sigma_enu_m[2] == pytest.approx(height_sigma_m, abs=1e-6)
    assert found.lon_lat_height[2] == pytest.approx(700.0, abs=1e-6)


@pytest.mark.oracle
def test_one_image_on_a_slope(solution: Solution) -> None:
    def locate(changed: Solution, e: np.ndarray) -> np.ndarray:
        return changed.locate("right", 2900.0 + e[0], 4000.0 + e[1], dem=Plane(e[2])).ground_m

    found = solution.locate("right", 2900.0, 4000.0, dem=Plane(), height_sigma_m=3.0, sigma_px=(0.3, 0.3))
    assert_same(found.covariance_m2, differenced(solution, locate, np.array([0.3, 0.3, 3.0])))
    flat = solution.locate("right", 2900.0, 4000.0, height_m=found.lon_lat_height[2], height_sigma_m=3.0,
                           sigma_px=(0.3, 0.3))  # fmt: skip
    assert abs(found.sigma_enu_m[2] - flat.sigma_enu_m[2]) > 0.05


@pytest.mark.oracle
def test_two_images(solution: Solution) -> None:
    pixels = pixels_of(solution, 3)

    def locate(changed: Solution, e: np.ndarray) -> np.ndarray:
        shifted = {name: (p[0] + e[2 * k], p[1] + e[2 * k + 1]) for k, (name, p) in enumerate(pixels.items())}
        return changed.intersect(shifted, sigma_px=(0.3, 0.3)).ground_m

    found = solution.intersect(pixels, sigma_px=(0.3, 0.3))
    assert_same(found.covariance_m2, differenced(solution, locate, np.full(4, 0.3)))


def pixels_of(solution: Solution, j: int) -> dict[str, tuple[float, float]]:
    o = solution.block.observations
    return {solution.block.images[o.image[r]].id: (float(o.line[r]), float(o.sample[r]))
            for r in np.flatnonzero(o.point == j)}  # fmt: skip


@pytest.mark.consistency
def test_many_images_are_those_of_excluded_check_points(twin: Block) -> None:
    """``intersect`` has the place and sigmas of an excluded check point.

    Other code locates check points; default sigmas are the block's times sigma0.
    """
    solution = fg.adjust(twin, eop_set=10, check_points="exclude")
    check = solution.accuracy.check
    for k, j in enumerate(check.index[:3]):
        found = solution.intersect(pixels_of(solution, int(j)))
        assert found.ground_m == pytest.approx(solution.ground_m[j], abs=1e-4)
        assert found.sigma_enu_m == pytest.approx(solution.scale * check.predicted_sigma_enu_m[k], rel=1e-6)


@pytest.mark.oracle
def test_images_with_rpc() -> None:
    solution = fg.adjust(rpc_twin().block)
    left = solution.locate("left", 3100.0, 4200.0, height_m=500.0, sigma_px=(0.3, 0.3))
    sensor, adjusted = solution.block.images[0].sensor, np.asarray(solution.correction("left"))

    def ground(x: np.ndarray) -> np.ndarray:
        """Return the ground point by changes of line, sample and the two shifts."""
        place = adjusted + np.append(x[2:], np.zeros(4))
        return sensor.locate(np.array([3100.0 + x[0]]), np.array([4200.0 + x[1]]), height_m=500.0,
                             correction=place)[0]  # fmt: skip

    step = 0.5
    slope = np.stack([(ground(step * e) - ground(-step * e)) / (2.0 * step) for e in np.eye(4)], axis=1)
    c = np.zeros((4, 4))
    c[:2, :2], c[2:, 2:] = 0.09 * np.eye(2), solution.covariance("image:left").values
    assert left.ground_m == pytest.approx(ground(np.zeros(4)), abs=1e-6)
    np.testing.assert_allclose(left.covariance_m2, slope @ c @ slope.T, rtol=1e-3, atol=1e-4)
    point = solution.intersect(pixels_of(solution, 3))
    # there the control has an influence, too
    assert np.linalg.norm(point.ground_m - solution.ground_m[3]) < 2.0 * point.se90_m
    assert point.se90_m > max(point.ce90_m, point.le90_m)


@pytest.mark.behaviour
def test_an_intersection_that_does_not_settle_is_refused(twin: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    solution = fg.adjust(twin, eop_set=10)
    monkeypatch.setattr(located_point, "MAX_STEPS", 1)
    with pytest.raises(fg.NoSolutionError, match="does not converge"):
        solution.intersect(pixels_of(solution, 3))


@pytest.mark.behaviour
def test_excluded_check_points_that_do_not_settle_have_no_coordinates(
    twin: Block, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resection, "MAX_STEPS", 1)
    solution = fg.adjust(twin, eop_set=10, check_points="exclude")
    check = twin.points.where(Role.CHECK)
    gone = check[np.isnan(solution.ground_m[check]).any(axis=1)]
    assert len(gone) == len(check) - len(solution.accuracy.check) > 0
    assert any(text.startswith(f"{len(gone)} excluded check point") for text in solution.warnings)


def coverage(point: LocatedPoint, factor: float = 1.0, n: int = 40_000) -> list[bool]:
    """Return whether the shares of simulated errors inside CE90, LE90 and SE90 lie in the 99.9 % interval of 90 %."""
    rng = np.random.default_rng(9)
    e = rng.multivariate_normal(np.zeros(3), factor**2 * point.covariance_enu_m2, n, method="eigh")
    low, high = stats.binom.interval(0.999, n, 0.9)
    inside = ((np.hypot(e[:, 0], e[:, 1]), point.ce90_m), (np.abs(e[:, 2]), point.le90_m),
              (np.linalg.norm(e, axis=1), point.se90_m))  # fmt: skip
    return [bool(low <= np.sum(length < limit) <= high) for length, limit in inside]


@pytest.mark.oracle
def test_radii_hold_ninety_percent(solution: Solution) -> None:
    point = solution.intersect(pixels_of(solution, 3))
    assert coverage(point) == [True] * 3
    assert coverage(point, 1.2) == [False] * 3  # the check sees sigmas that are 20 % off


@pytest.mark.oracle
def test_radii_of_circle_sphere_and_line() -> None:
    for d in (1, 2, 3):
        for probability in (0.5, 0.9, 0.99):
            closed = np.sqrt(stats.chi2.ppf(probability, d))
            assert radius(4.0 * np.eye(d), probability) == pytest.approx(2.0 * closed, rel=1e-10)
    line = stats.norm.ppf(0.95)
    for small in (0.0, 1e-8, 1e-4, 1e-3):
        assert radius(np.diag([1.0, small**2])) == pytest.approx(line, rel=1e-6)
        assert radius(np.diag([small**2, 1.0, small**2])) == pytest.approx(line, rel=1e-6)
        assert radius(np.diag([1.0, small**2, 1.0])) == pytest.approx(np.sqrt(stats.chi2.ppf(0.9, 2)), rel=1e-6)
    assert radius(np.zeros((3, 3))) == 0.0


@pytest.mark.oracle
@pytest.mark.parametrize("ratio", [0.8, 0.3, 0.1, 0.02, 0.004])
def test_radii_of_ellipses_hold_their_share(ratio: float) -> None:
    """The radius of an ellipse contains 90 % of the probability, by an integral over angles, for any axis ratio."""
    r = radius(np.diag([ratio**2, 1.0]))
    angle = np.linspace(0.0, 2.0 * np.pi, 200_001)[:-1]
    a = np.cos(angle) ** 2 / ratio**2 + np.sin(angle) ** 2
    share = np.mean((1.0 - np.exp(-0.5 * r**2 * a)) / a) / ratio
    assert share == pytest.approx(0.9, abs=1e-9)


@pytest.mark.truth
def test_error_ellipse() -> None:
    for azimuth in (0.0, 30.0, 90.0, 135.0):
        a = np.radians(azimuth)
        axis = np.array([np.sin(a), np.cos(a)])
        across = np.array([axis[1], -axis[0]])
        found = error_ellipse(9.0 * np.outer(axis, axis) + 4.0 * np.outer(across, across))
        assert (found.semi_major_m, found.semi_minor_m) == pytest.approx((3.0, 2.0))
        assert found.azimuth_deg == pytest.approx(azimuth, abs=1e-9)


@pytest.mark.behaviour
def test_refusals(solution: Solution) -> None:
    class Gap(Plane):
        """The surface has no height beside the point, and therefore no slope."""

        def height_m(self, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
            found = super().height_m(lon_deg, lat_deg)
            return np.full_like(found, np.nan) if len(found) == 4 else found  # four neighbours are asked at once

    refused = (
        ("statistics.dem_border", lambda: solution.locate("left", 3100.0, 4200.0, dem=Gap())),
        ("statistics.one_height", lambda: solution.locate("left", 1.0, 1.0)),
        ("statistics.one_height", lambda: solution.locate("left", 1.0, 1.0, height_m=0.0, dem=Plane())),
        ("statistics.height_sigma", lambda: solution.locate("left", 1.0, 1.0, height_m=0.0, height_sigma_m=-1.0)),
        ("statistics.sigma_px", lambda: solution.locate("left", 1.0, 1.0, height_m=0.0, sigma_px=(0.0, 1.0))),
        ("statistics.one_image", lambda: solution.intersect({"left": (1.0, 1.0)})),
        ("covariance.no_such", lambda: solution.locate("middle", 1.0, 1.0, height_m=0.0)),
    )
    for code, ask in refused:
        with pytest.raises(fg.InputError) as caught:
            ask()
        assert caught.value.problems[0].code == code
