"""The tests check determinant, rank, condition numbers and column lengths."""

from __future__ import annotations

from math import lgamma, log

import numpy as np
import pytest
from scipy.linalg import hilbert

from fg_orient.adjustment.linear.system import (
    Array,
    LinearSystem,
    column_lengths,
    diagnose,
    numerical_rank,
    scaled,
    singular_values,
    unit_columns,
)
from tests.support.systems import design_system, positive_definite


def normal_system(normal: Array) -> LinearSystem:
    return LinearSystem(normal, np.zeros(len(normal)))


def hilbert_log10_det(n: int) -> float:
    """Return c_n^4/c_2n with c_n = prod_{i<n} i! (Hilbert 1894)."""

    def log_c(m: int) -> float:
        return sum(lgamma(i + 1) for i in range(1, m))

    return (4.0 * log_c(n) - log_c(2 * n)) / log(10.0)


@pytest.mark.truth
def test_hilbert_matrix_of_order_six() -> None:
    found = diagnose(normal_system(hilbert(6)))
    assert found.cond_norm == pytest.approx(1.4951e7, rel=1e-4)
    # lambda_min is off by up to eps lambda_max: cond eps = 3e-9, a few times
    assert found.cond_spectral == pytest.approx(found.cond_norm, rel=1e-7)
    assert (found.order, found.rank, found.rank_scaled) == (6, 6, 6)
    assert found.det_sign == 1.0
    assert found.log10_det == pytest.approx(hilbert_log10_det(6), rel=1e-10)


@pytest.mark.truth
def test_identity_is_perfect() -> None:
    found = diagnose(normal_system(np.eye(4)))
    assert found.cond_norm == found.cond_spectral == found.cond_hadamard == 1.0
    assert found.log10_det == 0.0


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
    assert (found.order, found.rank, found.rank_scaled) == (3, 2, 2)
    assert (found.det_sign, found.log10_det) == (0.0, -np.inf)
    assert found.cond_norm == np.inf and found.cond_hadamard == 0.0


@pytest.mark.truth
def test_rank_tolerance_is_that_of_matlab() -> None:
    limit = 3.0 * np.spacing(2.0)
    assert numerical_rank(np.array([2.0, 1.0, 0.99 * limit]), 3) == 2
    assert numerical_rank(np.array([2.0, 1.0, 1.01 * limit]), 3) == 3


@pytest.mark.truth
def test_negative_spectral_number_is_kept() -> None:
    found = diagnose(normal_system(np.diag([1.0, -1e-17])))
    assert found.cond_spectral == pytest.approx(-1e17)
    assert found.det_sign == -1.0


@pytest.mark.truth
def test_determinants_neither_over_nor_underflow() -> None:
    for exponent in (40, -40):
        found = diagnose(normal_system(10.0**exponent * np.eye(20)))
        assert found.log10_det == pytest.approx(20 * exponent, rel=1e-12)
        assert found.cond_hadamard == pytest.approx(1.0, rel=1e-9)


@pytest.mark.truth
def test_scaled_rank_does_not_depend_on_the_units(rng: np.random.Generator) -> None:
    design = rng.normal(size=(20, 5))
    units = np.array([1.0, 1e4, 1e8, 1e-3, 1e-9])
    plain, stretched = diagnose(design), diagnose(design * units)
    assert stretched.rank < plain.rank == 5
    assert stretched.rank_scaled == 5
    assert stretched.cond_norm > 1e15


@pytest.mark.truth
def test_scaled_rank_of_a_system_without_design(rng: np.random.Generator) -> None:
    system = design_system(rng, 9, 4, 3.0)
    assert diagnose(LinearSystem(system.normal, system.rhs)).rank_scaled == diagnose(system).rank_scaled == 4


@pytest.mark.truth
def test_fewer_observations_than_unknowns_are_singular(rng: np.random.Generator) -> None:
    """A system with fewer rows than columns gets zero singular values and the rank of its rows.

    N has these zero eigenvalues, which are not among the singular values of a wide A.
    """
    design = rng.normal(size=(3, 5))
    assert singular_values(design)[3:].tolist() == [0.0, 0.0]
    found = diagnose(design)
    assert (found.order, found.rank, found.rank_scaled) == (5, 3, 3)


@pytest.mark.oracle
def test_column_lengths(rng: np.random.Generator) -> None:
    design = rng.normal(size=(6, 3)) * [1.0, 1e3, 0.0]
    system = LinearSystem.from_design(design, np.ones(6))
    lengths = column_lengths(system)
    assert lengths[:2] == pytest.approx(np.linalg.norm(design[:, :2], axis=0), rel=1e-14, abs=0.0)
    assert lengths[2] == 1.0
    assert np.linalg.norm(unit_columns(design), axis=0) == pytest.approx([1.0, 1.0, 0.0], rel=1e-14, abs=0.0)
    unit, _ = scaled(LinearSystem(system.normal, system.rhs))
    assert unit.normal.diagonal() == pytest.approx([1.0, 1.0, 0.0], abs=1e-14)
