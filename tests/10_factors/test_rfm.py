"""The tests check term orders, values, derivatives, projection and location of the rational function."""

from __future__ import annotations

import numpy as np
import pytest

from factors.cameras import rfm, rfm_equation, rfm_ground, rfm_project
from factors.cameras.rfm import EXPONENTS, permutation, terms
from factors.geometry import ellipsoid
from tests.support.equation_examples import rational_function
from tests.support.rpc_model import TERMS, ground_points, reference_project, synthetic_model

#: Published position k -> RPC00B position, both from 1 (X = longitude, Y = latitude).
PUBLISHED_TO_B = [1, 2, 3, 4, 5, 7, 6, 8, 9, 10, 11, 16, 15, 17, 13, 12, 14, 19, 18, 20]


@pytest.mark.truth
def test_term_orders() -> None:
    """Each term order contains the 20 monomials of degree <= 3, and permutations of orders invert each other.

    RPC00A has the product term in position 8.
    """
    monomials = {(i, j, k) for i in range(4) for j in range(4) for k in range(4) if i + j + k <= 3}
    for order in EXPONENTS.values():
        assert len(order) == 20
        assert set(order) == monomials
    assert (permutation("RPC00B", "T2.54") + 1).tolist() == PUBLISHED_TO_B
    assert EXPONENTS["RPC00A"][7] == (1, 1, 1)
    for name in EXPONENTS:
        back = permutation("RPC00B", name)[permutation(name, "RPC00B")]
        assert back.tolist() == list(range(20))


@pytest.mark.oracle
def test_reordered_coefficients_give_the_same_polynomial(rng: np.random.Generator) -> None:
    ground, c = rng.uniform(-1, 1, (30, 3)), rng.normal(size=20)
    expected = terms(ground) @ c
    for name, exponents in EXPONENTS.items():
        monomials = np.prod(ground[:, None, :] ** np.array(exponents), axis=2)
        assert np.abs(monomials @ c[permutation("RPC00B", name)] - expected).max() < 1e-13


@pytest.mark.oracle
def test_values_and_denominators_equal_the_sum_of_terms(rng: np.random.Generator) -> None:
    model, ground = synthetic_model(), rng.uniform(-1, 1, (200, 3))
    f = terms(ground) @ model.coefficients.T
    assert np.abs(rfm.values(model.coefficients, ground) - f[:, 0::2] / f[:, 1::2]).max() < 4e-15
    assert np.abs(rfm.denominators(model.coefficients, ground) - f[:, 1::2]).max() < 1e-15


def complex_value(c: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return the (l, s) of one point by plain sums; arguments may be complex."""
    monomials = np.array([np.prod(ground ** np.array(e)) for e in EXPONENTS["RPC00B"]])
    f = c @ monomials
    return np.array([f[0] / f[1], f[2] / f[3]])


@pytest.mark.oracle
def test_jacobians_equal_complex_step(rng: np.random.Generator) -> None:
    """Derivatives with respect to normalised ground coordinates equal complex steps within 1e-13."""
    c = synthetic_model().coefficients
    for point in rng.uniform(-1, 1, (10, 3)):
        by_ground = np.array(rfm.ground_derivatives(c, *point, *rfm.value(c, *point)))
        for k in range(3):
            z = point.astype(complex)
            z[k] += 1e-30j
            assert np.abs(complex_value(c, z).imag / 1e-30 - by_ground[:, k]).max() < 1e-13


@pytest.mark.oracle
@pytest.mark.parametrize("turn", [0.0, 360.0, -360.0])
def test_projection_equals_an_independent_one(turn: float) -> None:
    """The projection equals extended precision within 1e-10 px; a full turn of longitude costs three digits or so."""
    model = synthetic_model()
    lon, lat, h = ground_points(model, 700)
    line, sample = rfm_project.project(model.coefficients, model.offsets, model.scales, np.zeros(6), lon + turn, lat, h)
    l_ref, s_ref = reference_project(model, lon, lat, h)
    limit = 1e-10 if turn == 0.0 else 2.0 * np.spacing(400.0) / 0.045 * 12000.0
    assert np.abs(line - l_ref).max() < limit
    assert np.abs(sample - s_ref).max() < limit


@pytest.mark.oracle
def test_compensation_acts_on_normalised_pixels() -> None:
    model = synthetic_model()
    lon, lat, h = ground_points(model)
    b = np.array([3.0, -2.0, 0.5, 0.25, -0.125, 1.0])
    plain, bent = (
        np.stack(rfm_project.project(model.coefficients, model.offsets, model.scales, c, lon, lat, h))
        for c in (np.zeros(6), b)
    )
    l, s = (plain - model.offsets[:2, None]) / model.scales[:2, None]  # noqa: E741
    assert np.abs(bent - plain - [b[0] + b[2] * l + b[4] * s, b[1] + b[3] * l + b[5] * s]).max() < 1e-10


@pytest.mark.truth
def test_a_pole_gives_nan_and_its_neighbours_a_value() -> None:
    c = np.zeros((4, 20))
    c[1::2, 0], c[1, 1], c[0, 2], c[2, 1] = 1.0, -2.0, 1.0, 1.0  # line denominator 1 - 2 x
    lon = np.array([0.25, 0.5, 0.75])
    line, sample = rfm_project.project(c, np.zeros(5), np.ones(5), np.zeros(6), lon, np.ones(3), np.zeros(3))
    assert np.array_equal(np.isnan(line), [False, True, False])
    assert np.array_equal(np.isnan(sample), np.isnan(line))
    assert line[0] == 2.0
    assert line[2] == -2.0


@pytest.mark.oracle
def test_location_inverts_projection(rng: np.random.Generator) -> None:
    """Location from the centre returns the ground point within 1e-13, and nan for a pixel without a ground point."""
    model, ground = synthetic_model(), rng.uniform(-1, 1, (300, 3))
    axes = dict(zip("LPH", ground.T, strict=True))
    terms = np.array([np.prod([axes[f] for f in term if f != "1"] + [np.ones(300)], axis=0) for term in TERMS])
    line, line_below, sample, sample_below = model.coefficients @ terms  # polynomials as the order of terms prints them
    image = np.stack([line / line_below, sample / sample_below], axis=1)
    found = rfm_project.locate(model.coefficients, model.scales, image, ground[:, 2].copy(), np.zeros((300, 2)))
    assert np.abs(found - ground[:, :2]).max() < 1e-13
    c = np.zeros((4, 20))
    c[1::2, 0], c[0, 7], c[2, 2] = 1.0, 1.0, 1.0  # l = x^2 has no negative values
    lost = rfm_project.locate(c, np.ones(5), np.array([[-1.0, 0.0]]), np.zeros(1), np.array([[0.5, 0.0]]))
    assert np.isnan(lost).all()


@pytest.mark.oracle
def test_geodetic_differences_are_exact(rng: np.random.Generator) -> None:
    """Geodetic differences lead back to the point within 1e-8 m, and those of 1e-6 m are accurate to 9 digits.

    The closed formula of the test rounds to 2e-9 m.
    """
    for _ in range(40):
        reference = rng.normal(size=3)
        reference *= (6.37e6 + rng.uniform(-1e3, 5e3)) / np.linalg.norm(reference)
        lon, lat, h = ellipsoid.geodetic(*reference)
        frame = np.array([np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat), h])
        far = rng.normal(scale=3e4, size=3)
        turn, b, height = np.array([lon, lat, h]) + rfm_ground.differences(frame, *far)
        e2 = 0.00669437999014132  # of WGS 84; the closed formula from ellipsoid to space
        n = 6378137.0 / np.sqrt(1.0 - e2 * np.sin(b) ** 2)
        radius = (n + height) * np.cos(b)
        back = np.array([radius * np.cos(turn), radius * np.sin(turn), (n * (1.0 - e2) + height) * np.sin(b)])
        assert np.abs(back - reference - far).max() < 1e-8
        step = rng.normal(size=3) * 1e-6
        linear = np.array(rfm_ground.derivatives(frame, 0.0, 0.0, 0.0)) @ step
        small = np.array(rfm_ground.differences(frame, *step))
        assert np.abs(small - linear).max() <= 1e-9 * np.abs(linear).max()


@pytest.mark.behaviour
def test_beyond_the_axis_there_is_no_difference() -> None:
    frame = np.array([0.0, 1.0, 0.0, 1.0, 0.0])
    assert np.isnan(rfm_ground.differences(frame, -1.3e7, 0.0, 0.0)).all()


@pytest.mark.oracle
def test_residuals_follow_moves_of_a_tenth_of_a_micrometre() -> None:
    """If the ground point moves by 1e-7 m, the residual changes by its derivative within 5e-11 px.

    The residual of 20 000 px is rounded to 4e-12 px. Earth-fixed coordinates, rounded to 1e-9 m, would give 3e-9 px.
    """
    e = rational_function(np.random.default_rng(3))
    x, ground = e.unknowns
    r0, _, j = rfm_equation.RATIONAL_FUNCTION.kernel(e.record, e.setup, x, ground, True)
    for k in range(3):
        moved = ground.copy()
        moved[k] += 1e-7
        taken = moved[k] - ground[k]
        assert np.abs(rfm_equation.residual(e.record, e.setup, x, moved) - r0 - j[:, k] * taken).max() < 5e-11
