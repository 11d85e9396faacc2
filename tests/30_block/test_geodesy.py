"""Geodesy is compared with closed formulas written out here; the checks around PROJ are tested."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fg_orient import geodesy
from fg_orient.geodesy.crs import known_shifts
from fg_orient.model.errors import InputError

A, F = 6378137.0, 1.0 / 298.257223563
E2 = F * (2.0 - F)
#: One unit in the last place of an ECEF coordinate is 9.3e-10 m; ten of them for the few operations.
ROUNDING_M = 1e-8

lons = st.floats(-180.0, 180.0)
lats = st.floats(-90.0, 90.0)
heights = st.floats(-500.0, 9000.0)


def closed_ecef(lon_deg, lat_deg, height):
    """Give (N, 3) ECEF by the textbook formula (docs/equations.md 5)."""
    lon, lat, height = np.broadcast_arrays(*np.atleast_1d(np.radians(lon_deg), np.radians(lat_deg), height))
    n = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (n + height) * np.cos(lat) * np.cos(lon),
            (n + height) * np.cos(lat) * np.sin(lon),
            (n * (1.0 - E2) + height) * np.sin(lat),
        ],
        axis=-1,
    )


def closed_utm(lon_deg, lat_deg, meridian_deg):
    """Return UTM coordinates (northern hemisphere) by Krüger's series to n^4 (Karney 2011, equations 8-10, 35)."""
    n = F / (2.0 - F)
    alpha = (
        n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16 + 41 * n**4 / 180,
        13 * n**2 / 48 - 3 * n**3 / 5 + 557 * n**4 / 1440,
        61 * n**3 / 240 - 103 * n**4 / 140,
        49561 * n**4 / 161280,
    )
    radius = A / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    lat, dlon = np.radians(lat_deg), np.radians(lon_deg - meridian_deg)
    e = np.sqrt(E2)
    tau = np.tan(lat)
    sigma = np.sinh(e * np.arctanh(e * tau / np.sqrt(1 + tau**2)))
    conformal = tau * np.sqrt(1 + sigma**2) - sigma * np.sqrt(1 + tau**2)
    xi = np.arctan2(conformal, np.cos(dlon))
    eta = np.arcsinh(np.sin(dlon) / np.sqrt(conformal**2 + np.cos(dlon) ** 2))
    north, east = xi.copy(), eta.copy()
    for j, a in enumerate(alpha, start=1):
        north = north + a * np.sin(2 * j * xi) * np.cosh(2 * j * eta)
        east = east + a * np.cos(2 * j * xi) * np.sinh(2 * j * eta)
    return 500_000.0 + 0.9996 * radius * east, 0.9996 * radius * north


@pytest.mark.oracle
@given(lons, lats, heights)
def test_geographic_to_ecef_is_the_closed_formula(lon, lat, height):
    ours = geodesy.to_ecef("EPSG:4979", lon, lat, height)
    np.testing.assert_allclose(ours, closed_ecef(lon, lat, height), rtol=0, atol=ROUNDING_M)


@pytest.mark.oracle
@given(lons, lats, heights)
def test_ecef_to_geodetic_inverts_the_closed_formula(lon, lat, height):
    back = np.stack(geodesy.ecef_to_geodetic(closed_ecef(lon, lat, height)), axis=-1)
    again = closed_ecef(back[:, 0], back[:, 1], back[:, 2])
    np.testing.assert_allclose(again, closed_ecef(lon, lat, height), rtol=0, atol=ROUNDING_M)
    assert abs(back[0, 2] - height) < ROUNDING_M


@pytest.mark.oracle
def test_satellite_positions_convert_as_well():
    """The inverse conversion at a height of 832 km is exact to rounding.

    PROJ's own inverse has an error of 7 mm there.
    """
    lat = np.linspace(-90.0, 90.0, 181)
    _, back, height = geodesy.ecef_to_geodetic(closed_ecef(31.8, lat, 832e3))
    np.testing.assert_allclose(height, 832e3, rtol=0, atol=ROUNDING_M)
    np.testing.assert_allclose(back, lat, rtol=0, atol=1e-13)  # a few units in the last place of 90 degrees


@pytest.mark.oracle
def test_heights_without_a_vertical_crs_are_ellipsoidal():
    flat = geodesy.to_ecef("EPSG:4326", 31.8, 41.3, 1000.0)
    np.testing.assert_allclose(flat, closed_ecef(31.8, 41.3, 1000.0), rtol=0, atol=ROUNDING_M)


@pytest.mark.oracle
def test_projected_coordinates_are_the_kruger_series():
    lon, lat, height = np.array([31.8, 33.0, 35.2]), np.array([41.3, 1.0, 75.0]), np.array([0.0, 800.0, 1800.0])
    east, north = closed_utm(lon, lat, 33.0)
    ours = geodesy.to_ecef("EPSG:32636", east, north, height)
    # the series ends at n^4; the next term is below 1e-7 m (n^5 times the radius)
    np.testing.assert_allclose(ours, closed_ecef(lon, lat, height), rtol=0, atol=1e-6)


@pytest.mark.truth
def test_easting_comes_first_even_where_the_crs_says_north_first():
    """The easting is the first coordinate also for a CRS that defines x as north (EPSG:5254, TUREF / TM30)."""
    lon, lat, _ = geodesy.ecef_to_geodetic(geodesy.to_ecef("EPSG:5254", 580_000.0, 4_570_000.0, 0.0))
    # 80 km east of 30 E is 0.95 degrees at latitude 41
    assert lon[0] == pytest.approx(30.95, abs=0.02) and lat[0] == pytest.approx(41.25, abs=0.05)


@pytest.mark.behaviour
def test_geocentric_coordinates_pass_unchanged():
    xyz = closed_ecef(np.array([31.8, 10.0]), np.array([41.3, -20.0]), np.array([10.0, 20.0]))
    np.testing.assert_array_equal(geodesy.to_ecef("EPSG:4978", *xyz.T), xyz)


@pytest.mark.behaviour
def test_the_operation_and_its_accuracy_are_recorded():
    _, utm = geodesy.to_ecef_with_operation("EPSG:32636", 4e5, 4.57e6, 0.0)
    assert "UTM zone 36N" in utm.name and utm.accuracy_m == 0.0 and not utm.missing_grids
    _, old = geodesy.to_ecef_with_operation("EPSG:4230", 31.8, 41.3, 0.0)
    assert "ED50" in old.name and old.accuracy_m > 0.5
    assert "accuracy" in str(old) and "EPSG:4230" in str(old)


@pytest.mark.behaviour
def test_one_operation_serves_all_points_and_only_the_deciding_ones_choose_it():
    """The deciding points choose one operation of PROJ for all points.

    ED50 has other shifts in Turkey than in Norway, so both choices differ.
    """
    lon, lat = [31.8, 10.0], [41.3, 60.0]
    chosen = [
        geodesy.to_ecef_with_operation("EPSG:4230", lon, lat, [0.0, 0.0], deciding=np.array(mask))
        for mask in ([True, False], [False, True])
    ]
    assert chosen[0][1].name != chosen[1][1].name
    assert np.linalg.norm(chosen[0][0] - chosen[1][0], axis=1).min() > 0.1
    alone, _ = geodesy.to_ecef_with_operation("EPSG:4230", 31.8, 41.3, 0.0)
    np.testing.assert_array_equal(chosen[0][0][0], alone[0])


@pytest.mark.oracle
@given(lons, lats)
def test_enu_rotation_holds_the_derivatives_of_the_closed_formula(lon, lat):
    r = geodesy.enu_from_ecef(lon, lat)[0]
    # entries are products of two rounded sines: 1.5 eps each, squared and summed
    np.testing.assert_allclose(r @ r.T, np.eye(3), rtol=0, atol=4.5 * np.finfo(float).eps)
    assert np.linalg.det(r) == pytest.approx(1.0, abs=1e-15)
    sl, cl, sp, cp = (f(np.radians(v)) for v in (lon, lat) for f in (np.sin, np.cos))
    # d(ECEF)/d lon ~ East, d/d lat ~ North, d/d h = Up
    np.testing.assert_allclose(r, [[-sl, cl, 0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]], atol=1e-16)
    up = closed_ecef(lon, lat, 1000.0) - closed_ecef(lon, lat, 0.0)
    np.testing.assert_allclose(r @ up[0], [0, 0, 1000.0], rtol=0, atol=ROUNDING_M)


@pytest.mark.oracle
def test_north_is_where_latitude_grows_and_east_where_longitude_grows():
    base, step = closed_ecef(31.8, 41.3, 0.0), 1e-5
    r = geodesy.enu_from_ecef(31.8, 41.3)[0]
    east = r @ (closed_ecef(31.8 + step, 41.3, 0.0) - base)[0]
    north = r @ (closed_ecef(31.8, 41.3 + step, 0.0) - base)[0]
    # a step of about 1 m; the sagitta of a metre on the Earth is 1e-7 m
    assert east[0] > 0.8 and abs(east[1]) < 1e-6 and north[1] > 1.1 and abs(north[0]) < 1e-6


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("crs", "code", "named"),
    [
        ("EPSG:999999", "geodesy.unknown_crs", "EPSG:999999"),
        ("+proj=utm +zone=36", "geodesy.not_epsg", "+proj=utm"),
        ("WGS84", "geodesy.not_epsg", "WGS84"),
        ("EPSG:5773", "geodesy.not_spatial", "EGM96"),
        ("EPSG:2053", "geodesy.axes", "west"),
        ("EPSG:2225", "geodesy.axes", "foot"),
        ("EPSG:4807", "geodesy.axes", "grad"),
        ("EPSG:9518", "geodesy.no_operation", "egm08"),  # without its grid no unchanged height
    ],
)
def test_unusable_crs_are_refused(crs, code, named):
    at = (31.8, 41.3, 1000.0) if crs == "EPSG:9518" else (400_000.0, 4_570_000.0, 0.0)
    with pytest.raises(InputError) as caught:
        geodesy.to_ecef(crs, *at)
    (found,) = caught.value.problems
    assert found.code == code and named in f"{found.value} {found.message}" and found.remedy


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("ask", "code", "place", "value"),
    [
        (lambda: geodesy.to_ecef_with_operation(
            "EPSG:32636", [4e5, 1e30], [4.5e6, 4.5e6], [0.0, 0.0], labels=["line 2", "line 3"]),
         "geodesy.outside", "line 3", "1e+30"),
        *((lambda bad=bad: geodesy.to_ecef("EPSG:4979", 31.8, bad, 0.0), "", "", "") for bad in (np.nan, np.inf)),
        *((lambda bad=bad: geodesy.ecef_to_geodetic([[4e6, bad, 4e6]]), "", "", "") for bad in (np.nan, np.inf)),
    ],
)  # fmt: skip
def test_coordinates_outside_the_projection_and_no_numbers_are_refused(ask, code, place, value):
    with pytest.raises(InputError) as caught:
        ask()
    (found,) = caught.value.problems
    assert found.code.endswith(code) and place in found.place and value in found.value


@pytest.mark.behaviour
def test_the_network_stays_off(monkeypatch):
    import pyproj.network

    pyproj.network.set_network_enabled(active=True)
    geodesy.to_ecef("EPSG:4979", 31.8, 41.3, 0.0)
    assert not pyproj.network.is_network_enabled()


@pytest.mark.oracle
def test_raster_coordinates_follow_the_kruger_series_and_end_at_the_domain():
    lon, lat = np.array([31.8, 35.2]), np.array([41.3, 75.0])
    x, y = geodesy.from_geographic("EPSG:32636", lon, lat)
    east, north = closed_utm(lon, lat, 33.0)
    np.testing.assert_allclose([x, y], [east, north], rtol=0, atol=1e-6)  # as above: the series ends at n^4
    x, y = geodesy.from_geographic("EPSG:3857", [31.8, 31.8], [41.3, 90.1])
    assert np.isfinite([x[0], y[0]]).all() and np.isnan(y[1])


@pytest.mark.truth
@pytest.mark.real_data
def test_real_survey_points_agree_in_both_representations(real_data):
    """The 86 points of Zonguldak agree as ECEF and as latitude, longitude, height within the rounding of both files."""
    folder = real_data / "geoetrim-pleiades"
    xyz = np.genfromtxt(folder / "points_img1.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    llh = np.genfromtxt(folder / "points_img1_llh.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert len(xyz) == 86
    lon, lat, height = geodesy.ecef_to_geodetic(np.stack([xyz["X_ecef_m"], xyz["Y_ecef_m"], xyz["Z_ecef_m"]], axis=1))
    # printed to 1e-8 degree (half of it: 0.6 mm) and 0.1 mm; ECEF to 0.1 mm
    assert np.abs(lat - llh["lat_deg"]).max() < 0.7e-8 and np.abs(lon - llh["lon_deg"]).max() < 0.7e-8
    assert np.abs(height - llh["h_ell_m"]).max() < 2e-4
    assert np.abs(geodesy.to_ecef("EPSG:4979", lon, lat, height)[:, 0] - xyz["X_ecef_m"]).max() < ROUNDING_M


@pytest.mark.truth
@pytest.mark.parametrize(("lon", "lat"), [(10.0, 50.0), (-5.0, 40.0), (25.0, 62.0)])
def test_shifts_of_a_plate_fixed_system_follow_the_plate(lon: float, lat: float) -> None:
    """The shift of ETRS89 between 2000 and 2020 is the motion of the Eurasian plate within 0.028 m.

    Rotation of Eurasia in ITRF2014: -0.085, -0.531, 0.770 mas a year (Altamimi et al. 2017, table 1). ETRF2000 keeps
    the rotation of ITRF2000 (-0.081, -0.490, 0.792), which differs by up to 1.4 mm a year (0.046 mas).
    """
    turn = np.radians(np.array([-0.085, -0.531, 0.770]) / 3.6e6)
    velocity = geodesy.enu_from_ecef(lon, lat)[0] @ np.cross(turn, geodesy.geodetic_to_ecef(lon, lat, 0.0)[0])
    found = {one.name: np.array([one.east_m, one.north_m]) for one in known_shifts(lon, lat)}
    moved = found["ETRS89 for ITRF at epoch 2020"] - found["ETRS89 for ITRF at epoch 2000"]
    assert moved == pytest.approx(-20.0 * velocity[:2], abs=0.028)


@pytest.mark.truth
def test_shifts_of_known_datums() -> None:
    """The shift of ED50 in Germany equals Molodensky's formula within 15 m, and in the open sea there is no shift.

    The formula has the parameters for Europe (EPSG:1133).
    """
    east, north, _ = geodesy.enu_from_ecef(10.0, 50.0)[0] @ np.array([-87.0, -98.0, -121.0])
    north += (6378388.0 * (F - 1.0 / 297.0) + F * (A - 6378388.0)) * np.sin(np.radians(100.0))
    found = {one.name: one for one in known_shifts(10.0, 50.0)}
    assert [found["ED50"].east_m, found["ED50"].north_m] == pytest.approx([-east, -north], abs=15.0)
    assert known_shifts(-150.0, -40.0) == ()
