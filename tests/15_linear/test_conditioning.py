"""Determinant, rank, condition numbers, conditions of usability, agreement of solvers, well-posedness."""

from __future__ import annotations

from itertools import pairwise
from math import lgamma, log

import numpy as np
import pytest
from scipy.linalg import hilbert

from fg_orient.adjustment.linear.conditioning import condition_text, cross_solver_spread, diagnose, numerical_rank
from fg_orient.adjustment.linear.ls_conditions import ls_conditions, well_posedness
from fg_orient.adjustment.linear.registry import attempt, solve, solvers
from fg_orient.adjustment.linear.system import Array, LinearSolution, LinearSystem, column_lengths, scaled, unit_columns
from tests.support.systems import design_system, positive_definite


def normal_system(normal: Array) -> LinearSystem:
    return LinearSystem(normal, np.zeros(len(normal)))


def hilbert_log10_det(n: int) -> float:
    """Closed form c_n^4/c_2n with c_n = prod_{i<n} i! (Hilbert 1894)."""

    def log_c(m: int) -> float:
        return sum(lgamma(i + 1) for i in range(1, m))

    return (4.0 * log_c(n) - log_c(2 * n)) / log(10.0)


@pytest.mark.truth
def test_hilbert_matrix_of_order_six() -> None:
    found = diagnose(normal_system(hilbert(6)))
    assert found.cond_norm == pytest.approx(1.4951e7, rel=1e-4)
    # lambda_min is off by up to eps lambda_max: cond eps = 3e-9, a few times
    assert found.cond_spectral == pytest.approx(found.cond_norm, rel=1e-7)
    assert (found.order, found.rank, found.defect) == (6, 6, 0)
    assert found.det_sign == 1.0
    assert found.log10_det == pytest.approx(hilbert_log10_det(6), rel=1e-10)
    assert (found.verdict_norm, found.verdict_spectral, found.verdict_hadamard) == ("stable", "unstable", "unstable")


@pytest.mark.truth
def test_identity_is_perfect() -> None:
    found = diagnose(normal_system(np.eye(4)))
    assert found.cond_norm == found.cond_spectral == found.cond_hadamard == 1.0
    assert found.log10_det == 0.0
    assert (found.verdict_norm, found.verdict_spectral, found.verdict_hadamard) == ("stable", "stable", "stable")


@pytest.mark.oracle
def test_hadamard_number_is_its_formula_and_at_most_one(rng: np.random.Generator) -> None:
    for u in (2, 5, 9):
        normal = positive_definite(rng, u, 2.0)
        expected = np.linalg.det(normal) / np.prod(np.linalg.norm(normal, axis=1))
        found = diagnose(normal_system(normal)).cond_hadamard
        assert found == pytest.approx(expected, rel=1e-10)
        assert 0.0 < found <= 1.0


@pytest.mark.truth
def test_spectral_number_of_positive_definite_matrices_is_the_norm_number(rng: np.random.Generator) -> None:
    found = diagnose(normal_system(positive_definite(rng, 7, 4.0)))
    assert found.cond_norm == pytest.approx(1e4, rel=1e-9)
    assert found.cond_spectral == pytest.approx(found.cond_norm, rel=1e-9)


@pytest.mark.truth
def test_rank_defect_of_a_diagonal() -> None:
    found = diagnose(normal_system(np.diag([1.0, 1.0, 0.0])))
    assert (found.rank, found.defect, found.defect_scaled) == (2, 1, 1)
    assert (found.det_sign, found.log10_det) == (0.0, -np.inf)
    assert found.cond_norm == np.inf and found.cond_hadamard == 0.0
    assert found.verdict_norm == found.verdict_spectral == found.verdict_hadamard == "unstable"


@pytest.mark.truth
def test_rank_tolerance_is_that_of_matlab() -> None:
    limit = 3.0 * np.spacing(2.0)
    assert numerical_rank(np.array([2.0, 1.0, 0.99 * limit]), 3) == 2
    assert numerical_rank(np.array([2.0, 1.0, 1.01 * limit]), 3) == 3


@pytest.mark.truth
def test_negative_spectral_number_is_kept_and_read_as_too_large() -> None:
    found = diagnose(normal_system(np.diag([1.0, -1e-17])))
    assert found.cond_spectral == pytest.approx(-1e17)
    assert found.det_sign == -1.0
    assert found.verdict_spectral == "unstable"
    assert [condition_text(v) for v in (found.cond_spectral, 3e17, np.inf, 2.5e4)] == [">= 1e16"] * 3 + ["2.5e+04"]


@pytest.mark.truth
def test_determinants_neither_over_nor_underflow() -> None:
    for exponent in (40, -40):
        found = diagnose(normal_system(10.0**exponent * np.eye(20)))
        assert found.log10_det == pytest.approx(20 * exponent, rel=1e-12)
        assert found.cond_hadamard == pytest.approx(1.0, rel=1e-9)


@pytest.mark.oracle
def test_scale_free_numbers_do_not_see_the_units(rng: np.random.Generator) -> None:
    design = rng.normal(size=(20, 5))
    units = np.array([1.0, 1e4, 1e8, 1e-3, 1e-9])
    plain, stretched = diagnose(design), diagnose(design * units)
    assert stretched.rank < plain.rank == 5
    assert stretched.verdict_norm == "unstable"
    assert stretched.rank_scaled == 5
    assert stretched.cond_design > 1e15
    values = np.linalg.svd(design / np.linalg.norm(design, axis=0), compute_uv=False)
    for found in (plain, stretched):
        assert found.singular_values_scaled == pytest.approx(values, rel=1e-9)
        assert found.cond_design_scaled == pytest.approx(values[0] / values[-1], rel=1e-9)
        assert found.cond_norm_scaled == pytest.approx((values[0] / values[-1]) ** 2, rel=1e-9)
    assert stretched.cond_hadamard_scaled == pytest.approx(plain.cond_hadamard_scaled, rel=1e-9)


@pytest.mark.oracle
def test_system_without_design_gives_roots_of_the_singular_values_of_n(rng: np.random.Generator) -> None:
    system = design_system(rng, 9, 4, 3.0)
    design, _ = system.require_design("test")
    plain, unit = (np.linalg.svd(a, compute_uv=False) for a in (design, design / np.linalg.norm(design, axis=0)))
    for found in (diagnose(system), diagnose(LinearSystem(system.normal, system.rhs))):
        assert found.singular_values == pytest.approx(plain, rel=1e-9)
        assert found.cond_design_scaled == pytest.approx(unit[0] / unit[-1], rel=1e-9)
        assert found.rank_scaled == 4


@pytest.mark.truth
def test_fewer_observations_than_unknowns_are_singular(rng: np.random.Generator) -> None:
    """N has zero eigenvalues that the singular values of a wide A, taken alone, do not show."""
    found = diagnose(rng.normal(size=(3, 5)))
    assert found.singular_values.shape == found.singular_values_scaled.shape == (5,)
    assert (found.rank, found.rank_scaled, found.defect, found.defect_scaled) == (3, 3, 2, 2)
    assert found.cond_design == found.cond_design_scaled == np.inf


@pytest.mark.oracle
def test_column_lengths(rng: np.random.Generator) -> None:
    design = rng.normal(size=(6, 3)) * [1.0, 1e3, 0.0]
    system = LinearSystem.from_design(design, np.ones(6))
    lengths = column_lengths(system)
    assert lengths[:2] == pytest.approx(np.linalg.norm(design[:, :2], axis=0), rel=1e-14)
    assert lengths[2] == 1.0
    assert np.linalg.norm(unit_columns(design), axis=0) == pytest.approx([1.0, 1.0, 0.0], rel=1e-14)
    unit, _ = scaled(LinearSystem(system.normal, system.rhs))
    assert unit.normal.diagonal() == pytest.approx([1.0, 1.0, 0.0], abs=1e-14)


@pytest.mark.oracle
def test_published_conditions_are_their_sums(rng: np.random.Generator) -> None:
    system = design_system(rng, 10, 3, 2.0)
    design, observed = system.require_design("test")
    x = solve("qr", system).x + 0.01
    v = design @ x - observed
    misfit = np.abs(design.T @ design @ x - design.T @ observed)
    found = ls_conditions(system, x)
    assert (found.n_observations, found.n_unknowns, found.rank, found.rank_scaled) == (10, 3, 3, 3)
    assert found.sum_v == pytest.approx(v.sum(), rel=1e-12)
    assert found.sum_vv == pytest.approx(v @ v, rel=1e-12)
    assert (found.normal_min, found.normal_max) == pytest.approx((misfit.min(), misfit.max()), rel=1e-10)
    other = ls_conditions(system, x, residuals=np.repeat([1.0, -3.0, 0.0], [1, 1, 8]))
    assert (other.sum_v, other.sum_vv) == (-2.0, 10.0)


@pytest.mark.truth
def test_least_squares_passes_and_a_perturbed_solution_fails(rng: np.random.Generator) -> None:
    system = design_system(rng, 10, 3, 2.0)
    x = solve("qr", system).x
    assert ls_conditions(system, x).holds == (True, True, True, True)
    assert ls_conditions(system, x * (1.0 + 1e-8)).holds == (False, False, False, True)


@pytest.mark.truth
def test_exact_system_passes(rng: np.random.Generator) -> None:
    """Its v is rounding, of which A^T v/(|A||v|) would say nothing."""
    design = rng.normal(size=(10, 3))
    system = LinearSystem.from_design(design, design @ np.ones(3))
    assert ls_conditions(system, np.ones(3)).holds == (True, True, True, True)
    assert ls_conditions(system, np.array([1.0, 1.0, 1.001])).holds == (False, False, False, True)


@pytest.mark.consistency
def test_scale_free_conditions_do_not_see_the_units(rng: np.random.Generator) -> None:
    design, observed, units = rng.normal(size=(10, 3)), rng.normal(size=10), np.array([1.0, 1e8, 1e-6])
    system = LinearSystem.from_design(design * units, observed)
    x = solve("qr", system).x
    found = ls_conditions(system, x)
    assert found.holds == (True, True, True, True)
    assert found.rank < 3
    x[2] *= 1.0 + 1e-6  # hidden in the raw units
    assert ls_conditions(system, x).holds == (False, False, False, True)


@pytest.mark.truth
def test_rank_deficient_design_fails_condition_four() -> None:
    design = np.column_stack([np.ones(5), np.arange(5.0), np.arange(5.0) + 1.0])
    system = LinearSystem.from_design(design, np.arange(5.0))
    assert ls_conditions(system, solve("svd", system).x).holds == (True, True, True, False)


@pytest.mark.consistency
def test_spread_of_solvers_grows_with_the_condition_number() -> None:
    names = [n for n, entry in solvers().items() if entry.published and entry.family != "tikhonov"]
    spreads = []
    for u in (3, 5, 7, 9):
        system = LinearSystem(hilbert(u), hilbert(u) @ np.ones(u))
        spreads.append(cross_solver_spread({n: attempt(n, system) for n in names}).largest_normwise)
    assert all(later > 10.0 * earlier for earlier, later in pairwise(spreads))
    assert spreads[0] < 1e-12


@pytest.mark.oracle
def test_spread_is_relative_to_the_reference_and_names_failures() -> None:
    results = {
        "reference": LinearSolution(np.array([1.0, 0.0, -2.0])),
        "same": LinearSolution(np.array([1.0, 0.0, -2.0])),
        "other": LinearSolution(np.array([1.5, 0.0, -2.0])),
        "worse": LinearSolution(np.array([1.0, 1e-9, -2.0])),
        "broken": LinearSolution(np.full(3, np.nan), failure="pivot"),
    }
    found = cross_solver_spread(results, "reference")
    assert set(found.elementwise) == {"same", "other", "worse"}
    assert found.elementwise["other"].tolist() == [0.5, 0.0, 0.0]
    assert found.elementwise["worse"].tolist() == [0.0, np.inf, 0.0]
    assert found.normwise["other"] == pytest.approx(0.5 / np.sqrt(5.0), rel=1e-15)
    assert found.normwise["same"] == 0.0
    assert found.failures == {"broken": "pivot"}
    assert (found.largest_elementwise, found.largest_normwise) == (np.inf, found.normwise["other"])


@pytest.mark.truth
def test_well_posedness_of_textbook_cases() -> None:
    good = well_posedness(np.eye(2), np.ones(2), 0.01)
    assert good.well_posed and str(good) == "well posed"
    singular = well_posedness(np.diag([1.0, 0.0]), np.array([1.0, 0.0]))
    assert (singular.existence, singular.uniqueness, singular.stability) == (True, False, True)
    assert str(singular) == "ill posed: not unique: rank 1 of 2"
    outside = well_posedness(np.diag([1.0, 0.0]), np.array([1.0, 1.0]))
    assert (outside.existence, outside.uniqueness) == (False, False)
    assert outside.residual == pytest.approx(1.0)
    smooth = well_posedness(hilbert(8), hilbert(8) @ np.ones(8), 1e-3)
    assert (smooth.existence, smooth.uniqueness, smooth.stability) == (True, True, False)
    assert "unstable" in str(smooth)
    exact = well_posedness(hilbert(4), hilbert(4) @ np.ones(4))
    assert exact.well_posed


@pytest.mark.truth
@pytest.mark.parametrize("u", [1, 2, 3, 5])
@pytest.mark.parametrize("more", [0, 3])
def test_exact_systems_have_a_solution_whatever_rounding_does(rng: np.random.Generator, u: int, more: int) -> None:
    """Square regular systems have one for every l; tall ones for l = A x rounded, also where A x cancels."""
    for _ in range(200):
        design = rng.normal(size=(u + more, u))
        observed = design @ (1e3 * rng.normal(size=u)) if more else rng.normal(size=u)
        assert well_posedness(design, observed).existence
    cancelling = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-9], [1.0, 1.0 - 1e-9]])
    assert well_posedness(cancelling, cancelling @ np.array([1.1e8, -1.1e8])).existence


@pytest.mark.oracle
def test_expected_error_of_the_verdict_is_that_of_many_noisy_solutions(rng: np.random.Generator) -> None:
    design, noise = rng.normal(size=(15, 4)) * [1.0, 0.1, 0.01, 1.0], 0.003
    truth = np.ones(4)
    verdict = well_posedness(design, design @ truth, noise)
    plus = np.linalg.pinv(design)
    errors = plus @ (noise * rng.normal(size=(15, 4000)))
    measured = np.sqrt(np.mean(np.sum(errors**2, axis=0))) / 2.0
    # rms of 4000 draws dominated by one direction: sigma 1/sqrt(2 * 4000) = 1.1 %
    assert verdict.relative_error == pytest.approx(measured, rel=0.05)


@pytest.mark.truth
def test_existence_allows_the_residual_that_noise_explains(rng: np.random.Generator) -> None:
    """At significance 0.1 % nearly all noisy systems pass; four times the noise never does."""
    design = rng.normal(size=(30, 3))
    verdicts = [well_posedness(design, rng.normal(size=30), 1.0).existence for _ in range(200)]
    assert sum(verdicts) >= 195
    assert not any(well_posedness(design, 4.0 * rng.normal(size=30), 1.0).existence for _ in range(50))
