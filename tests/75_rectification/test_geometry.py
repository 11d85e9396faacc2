"""Scanner geometry, projections and areas agree with the figures of the description and other computations."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, optimize

from fg_orient.model.errors import InputError
from fg_orient.rectification.projections import (
    count_pixels,
    ellipsoidal_area,
    gauss_krueger,
    lambert_cylindrical,
    lambert_polar,
    mean_spacing_m,
    perimeter_m,
    pixel_area_m2,
    planar_area_m2,
    project,
    scale_factors,
    space_oblique_mercator,
    unproject,
    utm,
)
from fg_orient.rectification.scanner import Scanner, error_budget, relief_shift_m, swath_m, total_angle_rad
from tests.support.coasts import synthetic_outline

Array = np.ndarray
R = 6_370_000.0
#: Hayford's ellipsoid.
A_M, F = 6_378_388.0, 1.0 / 297.0


@pytest.mark.truth
def test_figures_of_the_scanner() -> None:
    tm = Scanner(705e3, 42.5e-6, 42.5e-6)
    theta = math.radians(7.5)
    assert round(float(tm.panoramic_shift_m(theta))) == 531
    assert round(float(relief_shift_m(100.0, theta)), 1) == 13.2
    assert round(tm.strip_m, 2) == 29.96
    assert math.degrees(total_angle_rad(185e3, 915e3)) == pytest.approx(11.545, abs=5e-4)
    assert swath_m(math.radians(4.13), 832e3) == pytest.approx(60.0e3, abs=50)
    assert swath_m(math.radians(4.13), 832e3, math.radians(27), 6_378_137.0) == pytest.approx(79.9e3, abs=50)
    assert math.isnan(swath_m(1.0, 832e3, 1.2, 6_378_137.0))
    assert error_budget(15.0, 5.0, 2.0) == pytest.approx(math.sqrt(254.0))


@pytest.mark.oracle
def test_element_sizes_are_derivatives_of_the_ground_coordinates() -> None:
    scanner = Scanner(900e3, 86e-6, 80e-6, focal_length_m=0.8, speed_m_s=6.5e3, overlap=0.02, rotation_s=0.07)
    theta, h, step = np.array([-0.1, 0.0, 0.1]), 500.0, 1e-6
    y = 0.8 * theta
    ends = [scanner.ground(0.0, y + sign * 0.8 * step, h)[:, 1] for sign in (0.5, -0.5)]
    sizes = scanner.element_m(theta, h)
    assert sizes[:, 1] == pytest.approx((ends[0] - ends[1]) / step * 80e-6, rel=1e-6)
    slant = np.hypot(scanner.ground(0.0, y, h)[:, 1], 900e3 - h)
    assert sizes[:, 0] == pytest.approx(slant * 86e-6, rel=1e-12)
    one = scanner.ground(scanner.image_element_m, 0.0)
    assert one == pytest.approx([scanner.line_time_s * 6.5e3, 0.0])
    plane = 900e3 * theta
    assert scanner.panoramic_shift_m(theta) == pytest.approx(scanner.ground(0.0, y)[:, 1] - plane)
    assert relief_shift_m(h, theta) == pytest.approx(scanner.ground(0.0, y)[:, 1] - scanner.ground(0.0, y, h)[:, 1])
    assert float(scanner.mirror_shift_m(2.0 * math.pi)) == pytest.approx(0.07 * 6.5e3)


SCANNER = {"height_m": 9e5, "ifov_along_rad": 1e-5, "ifov_across_rad": 1e-5}


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("ask", "code"),
    [
        *((lambda c=change: Scanner(**(SCANNER | c)), "")
          for change in ({"height_m": 0.0}, {"focal_length_m": math.nan}, {"overlap": 1.0})),
        *((lambda p=path: space_oblique_mercator(*p), "") for path in ((5, 0), (5, 234), (1, 252), (6, 1))),
        (lambda: project("+proj=nonsense", 0.0, 0.0), "rectify.projection"),
        (lambda: project(gauss_krueger(27.0), 27.0, 95.0), "rectify.outside"),
        (lambda: ellipsoidal_area([29.0, 29.1, 29.0], [41.0, 41.0, 41.1], "nonsense"), "rectify.ellipsoid"),
    ],
)  # fmt: skip
def test_geometry_that_cannot_be_is_refused(ask: Callable[[], object], code: str) -> None:
    """Impossible scanners, satellite paths, projections, points and ellipsoids are refused with their code."""
    with pytest.raises(InputError) as caught:
        ask()
    assert caught.value.problems[0].code.endswith(code)


def krueger(lat: float, dlon: float, k0: float) -> tuple[float, float]:
    """Return easting and northing of radians by Krueger's series to n^4 on Hayford's ellipsoid."""
    n, e = F / (2.0 - F), math.sqrt(F * (2.0 - F))
    radius = A_M / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    alpha = (
        n / 2 - 2 / 3 * n**2 + 5 / 16 * n**3 + 41 / 180 * n**4, 13 / 48 * n**2 - 3 / 5 * n**3 + 557 / 1440 * n**4,
        61 / 240 * n**3 - 103 / 140 * n**4, 49561 / 161280 * n**4,
    )  # fmt: skip
    t = math.sinh(math.atanh(math.sin(lat)) - e * math.atanh(e * math.sin(lat)))
    xi, eta = math.atan2(t, math.cos(dlon)), math.atanh(math.sin(dlon) / math.sqrt(1 + t * t))
    north = xi + sum(a * math.sin(2 * j * xi) * math.cosh(2 * j * eta) for j, a in enumerate(alpha, 1))
    east = eta + sum(a * math.cos(2 * j * xi) * math.sinh(2 * j * eta) for j, a in enumerate(alpha, 1))
    return k0 * radius * east, k0 * radius * north


@pytest.mark.oracle
@pytest.mark.parametrize("k0", [1.0, 0.9996])
@pytest.mark.parametrize(("lat", "lon"), [(40.858, 29.121), (0.0, 30.0), (55.0, 33.0), (10.0, 21.0)])
def test_proj_equals_kruegers_series(lat: float, lon: float, k0: float) -> None:
    """Gauss-Krueger coordinates equal Krueger's series within 5e-7 m, up to 55 degrees north and 6 degrees off."""
    found = project(gauss_krueger(27.0, scale=k0), lon, lat)[0]
    assert found == pytest.approx(krueger(math.radians(lat), math.radians(lon - 27.0), k0), abs=5e-7)
    assert unproject(gauss_krueger(27.0, scale=k0), found)[0] == pytest.approx([lon, lat], abs=1e-10)


@pytest.mark.oracle
def test_utm_is_secant_with_false_origins() -> None:
    east, north = project(utm(35, ellipsoid="intl"), 29.121, 40.858)[0]
    x, y = krueger(math.radians(40.858), math.radians(2.121), 0.9996)
    assert (east, north) == pytest.approx((500_000.0 + x, y), abs=1e-6)
    assert project(utm(35, south=True), 27.0, -1e-9)[0] == pytest.approx([500_000.0, 10_000_000.0], abs=1e-3)
    with pytest.raises(InputError):
        utm(61)


@pytest.mark.truth
def test_scale_of_the_islands_by_the_series_of_the_description() -> None:
    """Scale factors equal the series of the description: area 1.00078 with scale 1, 0.99998 with 0.9996."""
    e2 = F * (2.0 - F)
    lat, lon = math.radians(40.87), math.radians(29.1 - 27.0)
    second = e2 / (1 - e2)
    c, t, a = second * math.cos(lat) ** 2, math.tan(lat) ** 2, lon * math.cos(lat)
    k = 1 + a**2 * (1 + c) / 2 + a**4 * (5 - 4 * t + 42 * c + 13 * c**2 - 28 * second) / 24
    for k0, printed in ((1.0, 1.00078), (0.9996, 0.99998)):
        along, across, area = scale_factors(gauss_krueger(27.0, scale=k0), 29.1, 40.87)[0]
        assert (along, across) == pytest.approx((k0 * k, k0 * k), abs=1e-9)
        assert area == pytest.approx(printed, abs=1e-5)  # the place is given to 0.1 degrees only


@pytest.mark.oracle
def test_lambert_by_the_formulas() -> None:
    lon, lat = np.array([29.1, -60.0]), np.array([40.87, 10.0])
    lam, phi = np.radians(lon), np.radians(lat)
    assert project(lambert_cylindrical(R), lon, lat) == pytest.approx(np.stack([R * lam, R * np.sin(phi)], axis=1))
    rho = 2.0 * R * np.sin(np.pi / 4 - phi / 2)
    found = project(lambert_polar(R), lon, lat)
    assert np.hypot(*found.T) == pytest.approx(rho)
    # the source has x along the meridian of Greenwich, PROJ has it along 90 degrees east
    assert np.stack([-found[:, 1], found[:, 0]], axis=1) == pytest.approx(
        np.stack([rho * np.cos(lam), rho * np.sin(lam)], axis=1)
    )


def som(lon: float, lat: float, lon0: float, inclination: float, p: float) -> tuple[float, float]:
    """Return the Space Oblique Mercator of a circular orbit, ellipsoid (Snyder), by quadrature and a root finder."""
    a, e2, si, ci = 6_378_206.4, 0.00676866, math.sin(inclination), math.cos(inclination)
    j, q = (1 - e2) ** 3, e2 * si**2 / (1 - e2)
    w, t = ((1 - e2 * ci**2) / (1 - e2)) ** 2 - 1, e2 * si**2 * (2 - e2) / (1 - e2) ** 2

    def h_and_s(u: float) -> tuple[float, float]:
        s2 = math.sin(u) ** 2
        h = math.sqrt((1 + q * s2) / (1 + w * s2)) * ((1 + w * s2) / (1 + q * s2) ** 2 - p * ci)
        return h, p * si * math.cos(u) * math.sqrt((1 + t * s2) / ((1 + w * s2) * (1 + q * s2)))

    def coefficient(kind: str, n: int) -> float:
        def density(u: float) -> float:
            h, s = h_and_s(u)
            top = h * j - s * s if kind == "F" else s * (h + j)
            return top / math.hypot(j, s) * math.cos(n * u)

        return float(integrate.quad(density, 0.0, math.pi / 2, epsabs=1e-14)[0]) * (
            4 / (math.pi * n) if n else 2 / math.pi
        )

    def miss(u: float) -> float:
        lt = lon - lon0 + p * u
        return ci * math.sin(lt) + (1 - e2) * si * math.tan(lat) - math.tan(u) * math.cos(lt)

    grid = np.linspace(0.1, math.pi - 0.1, 2000)
    grid = grid[np.abs(grid - math.pi / 2) > 1e-3]
    values = np.array([miss(float(u)) for u in grid])
    k = next(i for i in range(len(grid) - 1) if values[i] * values[i + 1] < 0 and abs(values[i] - values[i + 1]) < 1.0)
    u = float(optimize.brentq(miss, grid[k], grid[k + 1], xtol=1e-15))
    lt = lon - lon0 + p * u
    phi2 = math.asin(
        ((1 - e2) * ci * math.sin(lat) - si * math.cos(lat) * math.sin(lt)) / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    )
    s, log = h_and_s(u)[1], math.log(math.tan(math.pi / 4 + phi2 / 2))
    x = (
        coefficient("F", 0) * u
        + sum(coefficient("F", n) * math.sin(n * u) for n in (2, 4))
        - s / math.hypot(j, s) * log
    )
    y = sum(coefficient("G", n) * math.sin(n * u) for n in (1, 3)) + j / math.hypot(j, s) * log
    return a * x, a * y


@pytest.mark.oracle
@pytest.mark.parametrize(("lon", "lat"), [(29.0, 41.1), (30.0, 35.0)])
def test_space_oblique_mercator_equals_snyders_formulas(lon: float, lat: float) -> None:
    """Space oblique Mercator equals Snyder's formulas within 0.01 m.

    PROJ has the same series; 0.003 m of the description is its quadrature.
    """
    lon0 = math.radians(129.30 - 360.0 / 233.0 * 180.0)
    found = project(space_oblique_mercator(5, 180), lon, lat)[0]
    assert found == pytest.approx(
        som(math.radians(lon), math.radians(lat), lon0, math.radians(98.2), 98.8841202 / 1440), abs=0.01
    )


@pytest.mark.truth
def test_area_and_length_of_a_rectangle_and_a_circle() -> None:
    box = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]]) + np.array([6.7e5, 4.5e6])
    assert (planar_area_m2(box), perimeter_m(box)) == (600.0, 100.0)
    assert planar_area_m2(np.vstack([box, box[:1]])) == 600.0
    assert mean_spacing_m(100.0, 4) == 25.0 and pixel_area_m2(6021, 30.0) == 5_418_900.0
    for bad in (box[:2], box[:, 0], np.full((4, 2), np.nan)):
        with pytest.raises(InputError):
            planar_area_m2(bad)


@pytest.mark.oracle
def test_area_on_the_ellipsoid_equals_that_of_the_plane_by_its_scale() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    plane = project(gauss_krueger(27.0), 29.1, 40.87) + 1000.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    lon, lat = unproject(gauss_krueger(27.0), plane).T
    area, length = ellipsoidal_area(lon, lat, "intl")
    there, around = pyproj.Geod(ellps="intl").polygon_area_perimeter(lon, lat)
    assert (area, length) == pytest.approx((abs(there), around), rel=1e-9)
    scale = scale_factors(gauss_krueger(27.0), 29.1, 40.87)[0]
    assert area == pytest.approx(planar_area_m2(plane) / scale[2], rel=1e-7)
    assert length == pytest.approx(perimeter_m(plane) / scale[0], rel=1e-7)


def inside(outline: Array, point: Array) -> bool:
    """Return whether a point is inside by the even-odd rule, one edge at a time."""
    odd = False
    for (x1, y1), (x2, y2) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if (y1 > point[1]) != (y2 > point[1]) and point[0] < x1 + (point[1] - y1) * (x2 - x1) / (y2 - y1):
            odd = not odd
    return odd


@pytest.mark.oracle
@settings(max_examples=12)
@given(st.integers(0, 10_000), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_counted_pixels_are_those_whose_centres_lie_inside(seed: int, x: float, y: float) -> None:
    rng = np.random.default_rng(seed)
    outline = rng.uniform(-12.0, 12.0, (int(rng.integers(3, 9)), 2))
    centres = [(x + i * 3.0, y + j * 3.0) for i in range(-6, 7) for j in range(-6, 7)]
    assert count_pixels(outline, 3.0, (x, y)) == sum(inside(outline, np.array(c)) for c in centres)


@pytest.mark.truth
def test_pixels_of_whole_boxes_are_exact_and_sizes_are_checked() -> None:
    box = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [0.0, 4.0]])
    assert count_pixels(box, 1.0, (0.5, 0.5)) == 20
    assert count_pixels(box, 1.0) == 20  # centres on the left and lower edge count, on the others not
    with pytest.raises(InputError):
        count_pixels(box, 0.0)


@pytest.mark.oracle
def test_a_made_up_coast_has_its_area_and_length() -> None:
    coast = synthetic_outline(5e6, 12_000.0, 500, seed=4)
    x, y = coast.T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    length = np.hypot(x - np.roll(x, 1), y - np.roll(y, 1)).sum()
    assert (area, length) == pytest.approx((5e6, 12_000.0), rel=1e-9)
    assert (planar_area_m2(coast), perimeter_m(coast)) == pytest.approx((area, length), rel=1e-12)
