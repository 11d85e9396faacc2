"""Elementary maps are compared with closed forms, scipy and pyproj; derivatives with the complex step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from factors.cameras import look, pushbroom
from factors.geometry import differences, ellipsoid, interpolation, light, orbital, polynomials, rotations
from factors.geometry.rotations import sine_cosine
from fg_orient.sensors.projection import residuals
from tests.support.equation_examples import look_angle_collinearity


def state(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    p = rng.normal(size=3)
    p *= 7.2e6 / np.linalg.norm(p)
    v = np.cross(p, rng.normal(size=3))
    return p, 7400.0 * v / np.linalg.norm(v) + 10.0 * p / 7.2e6


@pytest.mark.oracle
def test_orbital_frame_is_convention_b(rng: np.random.Generator) -> None:
    """The columns of the orbital frame are X = V x Z, right of flight, Y forward and Z outward, with determinant +1."""
    for _ in range(20):
        p, v = state(rng)
        r = rotations.orbital_frames(p[None], v[None])[0]
        assert np.abs(r.T @ r - np.eye(3)).max() < 1e-15
        assert np.linalg.det(r) == pytest.approx(1.0, abs=1e-15)
        z = p / np.linalg.norm(p)
        assert np.abs(r[:, 2] - z).max() < 1e-15
        assert r[:, 0] @ v == pytest.approx(0.0, abs=1e-9)
        assert r[:, 1] @ v > 7000.0


@pytest.mark.oracle
def test_attitude_equals_scipy(rng: np.random.Generator) -> None:
    """The attitude matrix Rx(pitch) Ry(roll) Rz(yaw) equals scipy's intrinsic XYZ sequence."""
    for roll, pitch, yaw in rng.uniform(-1.0, 1.0, (20, 3)):
        ours = rotations.attitude_matrices(np.array([[roll, pitch, yaw]]), False)[0]
        theirs = Rotation.from_euler("XYZ", [pitch, roll, yaw]).as_matrix()
        assert np.abs(ours - theirs).max() < 1e-15


@pytest.mark.truth
def test_small_angle_form_is_the_printed_one_and_agrees_to_first_order() -> None:
    a = np.array([[3e-5, -2e-5, 4e-5]])
    full, small = (rotations.attitude_matrices(a, s)[0] for s in (False, True))
    roll, pitch, yaw = a[0]
    np.testing.assert_array_equal(small, [[1.0, -yaw, roll], [yaw, 1.0, -pitch], [-roll, pitch, 1.0]])
    assert np.abs(full - small).max() < 2e-9  # second order: a^2 = 1.6e-9
    assert np.abs(full - small).max() > 1e-11


@pytest.mark.oracle
def test_quaternions_equal_scipy_and_ignore_the_sign(rng: np.random.Generator) -> None:
    q = rng.normal(size=(20, 4))
    ours = rotations.quaternion_matrices(q)
    theirs = Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()
    assert np.abs(ours - theirs).max() < 2e-15
    assert np.array_equal(ours, rotations.quaternion_matrices(-q))


@pytest.mark.oracle
def test_sign_flips_are_aligned_before_interpolation() -> None:
    t = np.linspace(0.0, 1.0, 5)
    q = Rotation.from_euler("XYZ", np.stack([0.1 * t, 0.2 * t, 0.3 * t], axis=1)).as_quat()[:, [3, 0, 1, 2]]
    flipped = q * np.array([1, -1, -1, 1, -1])[:, None]
    times = np.linspace(0.0, 1.0, 33)
    a, b, raw = (
        rotations.quaternion_matrices(interpolation.quaternion_linear(t, samples, times))
        for samples in (q, interpolation.sign_aligned(flipped), flipped)
    )
    between = np.stack([np.interp(times, t, q[:, k]) for k in (1, 2, 3, 0)], axis=1)  # scipy has w last, normalises
    expected = Rotation.from_quat(between).as_matrix()
    assert np.abs(a - expected).max() < 1e-15
    assert np.abs(b - expected).max() < 1e-15
    assert np.abs(raw - expected).max() > 0.1  # without it any curve could pass through the samples


@pytest.mark.oracle
def test_lagrange_is_exact_for_degree_seven(rng: np.random.Generator) -> None:
    t = np.linspace(-120.0, 120.0, 9)
    c = rng.normal(size=(8, 3))
    at = rng.uniform(-120.0, 120.0, 200)
    poly = np.polynomial.polynomial.polyval
    found = interpolation.lagrange(t, poly(t / 120.0, c).T.copy(), at)
    assert np.abs(found - poly(at / 120.0, c).T).max() < 1e-12
    nodes = interpolation.lagrange(t, poly(t / 120.0, c).T.copy(), t)
    assert np.abs(nodes - poly(t / 120.0, c).T).max() < 1e-14


@pytest.mark.consistency
@pytest.mark.parametrize("n", [3, 9])
def test_lagrange_of_many_times_gives_the_bits_of_few(rng: np.random.Generator, n: int) -> None:
    t, samples = np.sort(rng.uniform(-100.0, 100.0, n)), rng.normal(size=(n, 6))
    at = rng.uniform(t[0], t[-1], interpolation.MANY + 500)
    few = [interpolation.lagrange(t, samples, part) for part in np.array_split(at, 7)]
    assert np.array_equal(interpolation.lagrange(t, samples, at), np.concatenate(few))


@pytest.mark.oracle
def test_polynomials_fit_and_transformation_to_lines(rng: np.random.Generator) -> None:
    n_lines = 12000
    line = np.linspace(0, n_lines - 1, 50)
    tau = polynomials.normalised(line, n_lines)
    assert tau[0] == -1.0
    assert tau[-1] == 1.0
    c = rng.normal(size=(9, 3))
    values = np.polynomial.polynomial.polyval(tau, c.T).T
    assert np.abs(polynomials.evaluate(c, tau) - values).max() < 1e-13
    values += rng.normal(size=values.shape)
    fitted, residual = polynomials.fit(tau, values, 2)
    expected = np.polynomial.polynomial.polyfit(tau, values, 2)
    assert np.abs(fitted - expected.T).max() < 1e-13
    left = values.T - np.polynomial.polynomial.polyval(tau, expected)
    assert np.abs(np.abs(residual) - np.abs(left.T)).max() < 1e-12
    per_line = c * polynomials.per_line_from_tau(n_lines)
    distance = line - (n_lines - 1) / 2
    assert np.abs(polynomials.evaluate(per_line, distance) - polynomials.evaluate(c, tau)).max() < 1e-12


@pytest.mark.oracle
def test_geodetic_equals_proj(rng: np.random.Generator) -> None:
    to_geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    lon, lat, h = rng.uniform(-180, 180, 200), rng.uniform(-89, 89, 200), rng.uniform(-400, 9000, 200)
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    xyz = np.stack(to_ecef.transform(lon, lat, h), axis=1)
    ours = ellipsoid.geodetic_array(xyz)
    theirs = np.stack(to_geodetic.transform(*xyz.T), axis=1)
    # our b has four decimals as in the sources, PROJ has 1/f: 5e-5 m in b
    assert np.abs(ours[:, 2] - theirs[:, 2]).max() < 1e-4
    assert np.abs(np.degrees(ours[:, :2]) - theirs[:, :2]).max() < 1e-9


@pytest.mark.oracle
def test_intersection_lies_at_the_height_and_is_the_nearest() -> None:
    p = np.array([[7.2e6, 0.0, 0.0]])
    u = np.array([[-1.0, 0.05, 0.1]])
    u /= np.linalg.norm(u)
    geodetic = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    for h in (-100.0, 0.0, 1800.0, 8000.0):
        g = ellipsoid.intersect(p, u, np.array([h]))
        assert geodetic.transform(*g[0])[2] == pytest.approx(h, abs=2e-5)
        assert np.linalg.norm(np.cross(g[0] - p[0], u[0])) < 1e-6  # it lies on the ray
        assert g[0, 0] > 6.0e6  # the near side
    assert np.isnan(ellipsoid.intersect(p, u, np.array([1e6]))).all()  # a surface above the sensor
    assert np.isnan(ellipsoid.intersect(p, -u, np.array([0.0]))).all()  # behind the sensor
    assert np.isnan(ellipsoid.intersect(p, np.array([[0.0, 1.0, 0.0]]), np.array([0.0]))).all()  # misses


@pytest.mark.truth
def test_look_direction_points_to_the_earth(rng: np.random.Generator) -> None:
    """The look direction has the third component -1 and meets the ellipsoid; with +1 it meets no ground.

    Both sources print +1, which is an erratum.
    """
    d = look.direction(np.array([0.01]), np.array([0.3]))
    assert np.allclose(d, [[-np.tan(0.3), np.tan(0.01), -1.0]], rtol=1e-15, atol=0.0)
    p, v = state(rng)
    frame = rotations.orbital_frames(p[None], v[None])[0]
    sea_level = np.zeros(1)
    down = np.ascontiguousarray(d @ frame.T)
    ground = ellipsoid.intersect(p[None], down, sea_level)
    assert ellipsoid.geodetic_array(ground)[0, 2] == pytest.approx(0.0, abs=2e-5)  # the loop ends below 1e-5 m
    up = np.ascontiguousarray((d * [1.0, 1.0, -1.0]) @ frame.T)
    assert np.isnan(ellipsoid.intersect(p[None], up, sea_level)).all()
    assert np.isfinite(ellipsoid.intersect(p[None], -up, sea_level)).all()  # it meets the Earth, but behind


@pytest.mark.truth
def test_look_table_is_linear_in_the_tangent() -> None:
    grid, psi = np.array([0.0, 5999.0]), np.array([0.43, 0.50])
    _, psi_y = look.from_table(grid, np.zeros(2), np.tan(psi), np.array([0.0, 2999.5, 5999.0]))
    assert np.tan(psi_y[1]) == pytest.approx(0.5 * (np.tan(0.43) + np.tan(0.50)), abs=1e-15)
    assert psi_y[[0, 2]] == pytest.approx(psi, abs=1e-15)


@pytest.mark.oracle
def test_sines_equal_those_of_extended_precision(rng: np.random.Generator) -> None:
    """Sine and cosine - 1 are accurate to one rounding of 1 over many turns, and relatively for small angles."""
    for size in (1e-9, 1e-4, 0.5, 0.78, 2.0, 10.0, 1e6):
        x = rng.uniform(-size, size, 2000)
        sine, less = np.array([sine_cosine(v) for v in x]).T
        exact, exact_less = np.sin(x.astype(np.longdouble)), -2.0 * np.sin(0.5 * x.astype(np.longdouble)) ** 2
        assert np.abs(sine - exact).max() < 2.3e-16
        assert np.abs(less - exact_less).max() < 2.3e-16
        if size < 0.785:
            assert np.abs((sine - exact) / exact).max() < 3e-16
            assert np.abs((less - exact_less) / exact_less).max() < 6e-16


@pytest.mark.oracle
def test_sines_of_complex_angles_give_derivatives(rng: np.random.Generator) -> None:
    for x in rng.uniform(-7.0, 7.0, 50):
        sine, less = sine_cosine(complex(x, 1e-30))
        assert sine.imag / 1e-30 == pytest.approx(np.cos(x), abs=4e-16)
        assert less.imag / 1e-30 == pytest.approx(-np.sin(x), abs=4e-16)


@pytest.mark.oracle
def test_frame_difference_equals_the_plain_one_and_keeps_digits(rng: np.random.Generator) -> None:
    for size in (1e5, 10.0, 1e-6):
        p, v = state(rng)
        d = np.concatenate([rng.normal(size=3) * size, rng.normal(size=3) * 1e-3 * size])
        frame, lengths = orbital.reference(p, v)
        axes = np.array(frame).reshape(3, 3)
        dp, dv = axes.T @ d[:3], axes.T @ d[3:]
        local, scales = orbital.turned(lengths, tuple(dp), tuple(dv))
        ours = axes @ np.array(local).reshape(3, 3)
        z = (p + d[:3]) / np.linalg.norm(p + d[:3])
        x = np.cross(v + d[3:], z) / np.linalg.norm(np.cross(v + d[3:], z))
        after = np.stack([x, np.cross(z, x), z], axis=1)
        assert np.abs(axes + ours - after).max() < 1e-15
        assert np.abs(np.array(rotations.turned(frame, local)).reshape(3, 3) - after).max() < 1e-15
        p2, v2 = p + d[:3], v + d[3:]
        expected = [1.0 / np.linalg.norm(p2), 1.0 / (v2 @ after[:, 1]), v2 @ after[:, 2]]
        assert (
            np.abs(np.array(scales) / expected - 1.0).max() < 2e-13
        )  # v3 is a difference of products a thousand times it
        # directional derivative by complex step, plus the second-order remainder
        z = np.concatenate([p, v]) + 1e-30j * d
        linear = np.array(rotations.ecef_from_orbital(*z)).reshape(3, 3).imag / 1e-30
        assert np.abs(ours - linear).max() <= 2.0 * (size / 1e6) ** 2 + 2e-15 * np.abs(linear).max()


@pytest.mark.oracle
@pytest.mark.parametrize("follows", [0.0, 1.0])
def test_derivatives_of_orbital_coordinates(follows: float, rng: np.random.Generator) -> None:
    """The derivatives of orbital coordinates equal complex steps of the plain product within 1e-14."""
    for _ in range(10):
        p, v = state(rng)
        g, c = p * (6.371e6 / 7.2e6) + rng.normal(size=3) * 1e5, rng.normal(size=3)
        frame, (length, v2, v3) = orbital.reference(p, v)
        w = np.array(frame).reshape(3, 3).T @ (g - p)
        ours = np.concatenate(orbital.row_derivatives(tuple(c), tuple(w), frame, (1.0 / length, 1.0 / v2, v3), follows))
        for k in range(9):
            z = np.concatenate([p, v, g]).astype(complex)
            z[k] += 1e-30j
            turned = np.array(rotations.ecef_from_orbital(*z[:6])) if follows else np.array(frame)
            numeric = float((c @ (turned.reshape(3, 3).T @ (z[6:] - z[:3]))).imag / 1e-30)
            assert abs(ours[k] - numeric) <= 1e-14 * np.abs(ours).max()


@pytest.mark.oracle
def test_pair_rotation_sums_to_the_plain_product(rng: np.random.Generator) -> None:
    for form, pair in (
        (rotations.orbital_from_body, differences.body_from_orbital_pair),
        (rotations.orbital_from_body_small, differences.body_from_orbital_small_pair),
    ):
        angles, d = rng.normal(scale=0.1, size=3), rng.normal(scale=1e-3, size=3)
        w, dw = rng.normal(size=3), rng.normal(scale=1e-3, size=3)
        reference, difference, turn, d_f = pair(tuple(angles), tuple(d), tuple(w), tuple(dw))
        plain = np.array(form(*(angles + d))).reshape(3, 3).T @ (w + dw)
        base = np.array(form(*angles)).reshape(3, 3).T @ w
        assert np.abs(np.array(reference) - base).max() < 1e-15
        assert np.abs(np.array(reference) + np.array(difference) - plain).max() < 2e-15
        assert np.abs(np.array(turn) - np.array(form(*(angles + d)))).max() < 1e-15
        for k in range(3):
            z = (angles + d).astype(complex)
            z[k] += 1e-30j
            numeric = (np.array(form(*z)).reshape(3, 3).T @ (w + dw)).imag / 1e-30
            assert np.abs(np.array(d_f[3 * k : 3 * k + 3]) - numeric).max() < 2e-15


@pytest.mark.consistency
def test_few_rows_give_the_bits_of_many(rng: np.random.Generator) -> None:
    """A row has the same bits whether it is computed among few rows in Python or among many in compiled code."""

    def require_equal(function: Callable[..., np.ndarray], arrays: tuple[np.ndarray, ...], times: int) -> np.ndarray:
        few = function(*arrays)
        many = function(*(np.tile(a, (times, *[1] * (a.ndim - 1))) for a in arrays))
        assert np.array_equal(np.tile(few, (times, 1)), many, equal_nan=True)
        return few

    for small in (0.0, 1.0):
        cases = [look_angle_collinearity(rng) for _ in range(40)]
        setup, (x, _) = cases[0].setup, cases[0].unknowns
        records, ground = np.stack([c.record for c in cases]), np.stack([c.unknowns[1] for c in cases])
        records[:, 27] = small
        few = require_equal(lambda r, g: residuals(r, setup, x, g), (records, ground), 30)  # noqa: B023
        assert np.array_equal(few[7], pushbroom.residual(records[7], setup, x, ground[7]))
    p = 7.2e6 * light.unit(rng.normal(size=(40, 3)))
    u = light.unit(1e5 * rng.normal(size=(40, 3)) - p)
    u[3], p[4] = -u[3], np.nan  # a ray that points up, and a position that is nan
    met = require_equal(ellipsoid.intersect, (p, u, rng.normal(scale=100.0, size=40)), 5)
    assert np.isnan(met[3:5]).all() and np.isfinite(np.delete(met, [3, 4], axis=0)).all()
    require_equal(ellipsoid.geodetic_array, (met,), 5)
