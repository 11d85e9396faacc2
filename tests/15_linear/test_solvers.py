"""The published solvers are compared with LAPACK, their factors and breakdowns, and with modern solvers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import hilbert

from fg_orient.adjustment.linear.elimination import checked_cholesky
from fg_orient.adjustment.linear.inverses import invert_cramer, invert_gauss, invert_pivot, pseudo_inverse
from fg_orient.adjustment.linear.registry import attempt, solve, solvers
from fg_orient.adjustment.linear.system import Breakdown, LinearSystem
from fg_orient.adjustment.linear.triangular import cholesky_rows, lu_factors
from tests.support.systems import design_system, positive_definite

INVERSES = ("cramer_inverse", "pivot_inverse", "gauss_inverse", "moore_penrose_inverse", "cholesky_inverse")
ELIMINATIONS = ("gauss_elimination", "gauss_partial_pivot_elimination", "cholesky_elimination")
HAND_WRITTEN = (*INVERSES, *ELIMINATIONS)
MODERN = ("qr", "svd", "truncated_svd", "lapack_cholesky", "lapack_lu")
SCALED = ("qr_scaled", "svd_scaled", "truncated_svd_scaled", "lapack_cholesky_scaled", "moore_penrose_scaled")
#: Relative norm: cond(N) <= 1e4 times a few hundred roundings is 1e-10.
AGREEMENT = 1e-10

#: Singular as stored, so that no method can miss it.
SINGULAR = {
    "zero": np.zeros((2, 2)),
    "zero column": np.diag([1.0, 0.0, 2.0]),
    "equal rows": np.ones((3, 3)),
    "dependence without rounding": np.array([[1.0, 1.0, 0.0], [1.0, 2.0, 1.0], [0.0, 1.0, 1.0]]),
}
EXAMPLES = settings(max_examples=15)


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


@pytest.mark.oracle
@pytest.mark.parametrize("name", HAND_WRITTEN)
@EXAMPLES
@given(seed=st.integers(0, 2**32 - 1), u=st.integers(1, 15), log_cond=st.floats(0.0, 4.0))
def test_hand_written_solver_equals_lapack(name: str, seed: int, u: int, log_cond: float) -> None:
    rng = np.random.default_rng(seed)
    system = LinearSystem(positive_definite(rng, u, log_cond), rng.normal(size=u))
    found = solve(name, system)
    assert relative(found.x, np.linalg.solve(system.normal, system.rhs)) <= AGREEMENT
    assert found.notes == ()
    if name in INVERSES:
        assert found.inverse is not None
        assert relative(found.inverse, np.linalg.inv(system.normal)) <= AGREEMENT
        assert np.array_equal(found.x, found.inverse @ system.rhs)  # formed, then multiplied


@pytest.mark.oracle
@pytest.mark.parametrize("name", [n for n in HAND_WRITTEN if n != "cramer_inverse"])
def test_hand_written_solver_equals_lapack_at_the_size_of_a_bundle(name: str) -> None:
    rng = np.random.default_rng(5)
    system = LinearSystem(positive_definite(rng, 84, 4.0), rng.normal(size=84))
    assert relative(solve(name, system).x, np.linalg.solve(system.normal, system.rhs)) <= AGREEMENT


@pytest.mark.oracle
@pytest.mark.parametrize("name", (*MODERN, *SCALED))
@EXAMPLES
@given(seed=st.integers(0, 2**32 - 1), u=st.integers(1, 12), log_cond=st.floats(0.0, 4.0))
def test_modern_solver_equals_lstsq(name: str, seed: int, u: int, log_cond: float) -> None:
    rng = np.random.default_rng(seed)
    system = design_system(rng, u + 4, u, log_cond)
    design, observed = system.require_design("lstsq")
    expected = np.linalg.lstsq(design, observed, rcond=None)[0]
    assert relative(solve(name, system).x, expected) <= AGREEMENT


@pytest.mark.truth
def test_column_scaling_rescues_what_units_break() -> None:
    """Solvers that scale columns are exact to 1e-12 for units of 1, 1e8 and 1e16; the pseudo-inverse fails.

    N has cond 1e32 in these units, and that of the random design with columns of unit length.
    """
    rng = np.random.default_rng(2)
    design = rng.normal(size=(12, 3)) * [1.0, 1e8, 1e16]
    truth = np.array([3.0, 2e-8, -1e-16])
    system = LinearSystem.from_design(design, design @ truth)
    assert relative(solve("moore_penrose_inverse", system).x, truth) > 0.1
    for name in SCALED:
        found = solve(name, system)
        assert np.abs(found.x / truth - 1.0).max() <= 1e-12, name
        assert found.rank in (None, 3)


@pytest.mark.oracle
def test_scaled_inverse_is_the_inverse_in_given_units() -> None:
    rng = np.random.default_rng(3)
    normal = positive_definite(rng, 4, 2.0) * np.outer([1.0, 10.0, 100.0, 1e3], [1.0, 10.0, 100.0, 1e3])
    found = solve("moore_penrose_scaled", LinearSystem(normal, np.ones(4)))
    assert found.inverse is not None
    assert np.abs(found.inverse @ normal - np.eye(4)).max() <= 1e-9


@pytest.mark.behaviour
@pytest.mark.parametrize("kind", SINGULAR)
@pytest.mark.parametrize("name", HAND_WRITTEN)
@pytest.mark.parametrize("as_run", [False, True])
def test_singular_systems_are_reported(name: str, kind: str, as_run: bool) -> None:
    system = LinearSystem(SINGULAR[kind], np.ones(len(SINGULAR[kind])))
    found = attempt(name, system, as_run=as_run)
    if name == "moore_penrose_inverse":
        assert found.rank == np.linalg.matrix_rank(system.normal)
        assert np.isfinite(found.x).all()
        assert "set to zero" in found.notes[0]
        return
    assert np.isnan(found.x).all()
    assert name in found.failure
    with pytest.raises(Breakdown) as caught:
        solve(name, system, as_run=as_run)
    assert str(caught.value) == found.failure


@pytest.mark.behaviour
@pytest.mark.parametrize("name", HAND_WRITTEN)
@EXAMPLES
@given(seed=st.integers(0, 2**32 - 1), u=st.integers(2, 12))
def test_numerically_singular_systems_are_never_silent(name: str, seed: int, u: int) -> None:
    """A solver breaks down or adds a note if rounding hides a rank defect, and returns nan only with a failure.

    The last unknown depends on the others, which are well determined, so its pivot is a few roundings.
    """
    rng = np.random.default_rng(seed)
    others = np.linalg.qr(rng.normal(size=(u - 1, u - 1)))[0]
    half = np.vstack([others, rng.normal(size=u - 1)])
    found = attempt(name, LinearSystem(half @ half.T, np.ones(u)))
    assert np.isnan(found.x).all() if found.failure else np.isfinite(found.x).all()
    assert found.failure or found.notes


@pytest.mark.behaviour
def test_failures_say_where_and_with_which_value() -> None:
    system = LinearSystem(np.array([[1.0, 2.0], [2.0, 1.0]]), np.ones(2))
    for name in ("cholesky_inverse", "cholesky_elimination"):
        assert f"{name}, row 2 of 2" in attempt(name, system).failure
        assert "-3" in attempt(name, system).failure
    assert (
        "gauss_elimination, step 2 of 3"
        in attempt("gauss_elimination", LinearSystem(np.ones((3, 3)), np.ones(3))).failure
    )


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("name", "design"),
    [*((name, [[1.0, 0.0]] * 3) for name in ("qr", "qr_scaled", "lapack_cholesky", "lapack_lu")),
     ("qr", [[1.0, 1.0]])],  # fewer rows than unknowns
)  # fmt: skip
def test_modern_solvers_without_truncation_report_a_defect(name: str, design: list[list[float]]) -> None:
    found = attempt(name, LinearSystem.from_design(np.array(design), np.ones(len(design))))
    assert np.isnan(found.x).all()
    assert ("column 2 of 2" if name == "qr" else "2 of 2") in found.failure


@pytest.mark.truth
@pytest.mark.parametrize("name", ["svd", "svd_scaled", "truncated_svd", "truncated_svd_scaled"])
def test_truncating_solvers_give_the_minimum_norm_solution(name: str) -> None:
    design = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    found = solve(name, LinearSystem.from_design(design, np.array([2.0, 4.0, 6.0])))
    assert np.abs(found.x - 1.0).max() <= 1e-14
    assert found.rank == 1
    assert found.notes == ("1 of 2 singular values set to zero",)


@pytest.mark.truth
def test_zero_leading_pivot() -> None:
    """Solvers that exchange rows solve a system whose first pivot is zero; plain elimination names the step."""
    system = LinearSystem(np.array([[0.0, 2.0], [2.0, 3.0]]), np.array([2.0, 5.0]))
    for name in ("gauss_partial_pivot_elimination", "pivot_inverse", "cramer_inverse", "moore_penrose_inverse"):
        assert np.abs(solve(name, system).x - 1.0).max() <= 1e-14, name
    for name in ("gauss_elimination", "gauss_inverse"):
        assert "step 1 of 2" in attempt(name, system).failure


@pytest.mark.oracle
@EXAMPLES
@given(seed=st.integers(0, 2**32 - 1), u=st.integers(1, 12))
def test_exchange_step_and_gauss_also_invert_non_symmetric_matrices(seed: int, u: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(u, u)) + 2.0 * u * np.eye(u)  # diagonally dominant: Gauss needs no pivoting
    shuffled = matrix[rng.permutation(u)]
    assert relative(invert_pivot(shuffled), np.linalg.inv(shuffled)) <= AGREEMENT
    assert relative(invert_gauss(matrix), np.linalg.inv(matrix)) <= AGREEMENT
    assert relative(invert_cramer(matrix), np.linalg.inv(matrix)) <= AGREEMENT


@pytest.mark.oracle
def test_doolittle_factors_give_the_matrix() -> None:
    normal = positive_definite(np.random.default_rng(1), 8, 3.0)
    lower, upper = lu_factors(normal)
    assert np.array_equal(np.triu(lower, 1), np.zeros((8, 8)))
    assert np.array_equal(lower.diagonal(), np.ones(8))
    assert np.array_equal(np.tril(upper, -1), np.zeros((8, 8)))
    assert np.abs(lower @ upper - normal).max() <= 1e-14 * np.abs(normal).max()


@pytest.mark.oracle
def test_cholesky_factor_gives_the_matrix_also_where_it_is_complex() -> None:
    normal = positive_definite(np.random.default_rng(1), 8, 3.0)
    factor, notes = cholesky_rows(normal, "test")
    assert np.isrealobj(factor) and notes == ()
    assert np.abs(factor.T @ factor - normal).max() <= 1e-14 * np.abs(normal).max()
    shifted = normal - 30.0 * np.eye(8)  # some eigenvalues of 1 ... 1000 turn negative
    factor, notes = cholesky_rows(shifted, "test", as_run=True)
    assert np.iscomplexobj(factor) and any("negative radicand" in note for note in notes)
    assert np.abs(factor.T @ factor - shifted).max() <= 1e-12 * np.abs(shifted).max()


@pytest.mark.oracle
@pytest.mark.parametrize("rank", [1, 3, 5])
def test_four_penrose_conditions(rank: int) -> None:
    half = np.random.default_rng(rank).normal(size=(6, rank))
    normal = half @ half.T
    plus, kept = pseudo_inverse(normal)
    assert kept == rank
    assert relative(normal @ plus @ normal, normal) <= 1e-12
    assert relative(plus @ normal @ plus, plus) <= 1e-12
    assert np.abs(normal @ plus - (normal @ plus).T).max() <= 1e-12
    assert np.abs(plus @ normal - (plus @ normal).T).max() <= 1e-12


@pytest.mark.truth
def test_tolerance_of_the_pseudo_inverse() -> None:
    """The pseudo-inverse counts a singular value above u eps(d_1), which is three spacings of the largest at u = 3."""
    limit = 3 * np.spacing(1.0)
    assert pseudo_inverse(np.diag([1.0, 0.5, 0.9 * limit]))[1] == 2
    assert pseudo_inverse(np.diag([1.0, 0.5, 1.1 * limit]))[1] == 3


@pytest.mark.truth
def test_cramer_does_not_overflow() -> None:
    """Cramer's inverse is exact to 1e-12 if determinants are outside the range of doubles, 1e-600 or 1e600."""
    for unit in (1e-100, 1e100):
        normal = unit * np.diag([1.0, 2.0, 4.0, 5.0, 8.0, 10.0])
        assert relative(invert_cramer(normal) * unit, np.diag([1.0, 0.5, 0.25, 0.2, 0.125, 0.1])) <= 1e-12


@pytest.mark.behaviour
def test_results_that_overflow_are_breakdowns() -> None:
    """If 1/1e-310 overflows, a solver breaks down; the pseudo-inverse counts 1e-310 as zero, with a note."""
    tiny = LinearSystem(np.diag([1.0, 1e-310]), np.ones(2))
    for name in HAND_WRITTEN:
        found = attempt(name, tiny)
        if name == "moore_penrose_inverse":
            assert found.x.tolist() == [1.0, 0.0] and "1 of 2 singular values set to zero" in found.notes
        else:
            assert "not finite" in found.failure and np.isnan(found.x).all(), name


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["cholesky_inverse", "cholesky_elimination"])
def test_as_run_takes_complex_roots_and_the_real_part(name: str) -> None:
    """With ``as_run`` Cholesky solves an indefinite N by complex roots, with a note, as LAPACK does.

    C^T C = N holds without conjugation, so the exact result is that of any other method.
    """
    rng = np.random.default_rng(4)
    system = LinearSystem(positive_definite(rng, 6, 2.0) - 10.0 * np.eye(6), rng.normal(size=6))
    with pytest.raises(Breakdown):
        solve(name, system)
    found = solve(name, system, as_run=True)
    assert np.isrealobj(found.x)
    assert any("complex root taken" in note for note in found.notes)
    assert relative(found.x, np.linalg.solve(system.normal, system.rhs)) <= 1e-10


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["cholesky_inverse", "cholesky_elimination"])
def test_as_run_changes_nothing_on_a_positive_definite_matrix(name: str) -> None:
    """For a positive definite N the switch ``as_run`` changes no bit of the solution, which is LAPACK's."""
    rng = np.random.default_rng(6)
    system = LinearSystem(positive_definite(rng, 6, 3.0), rng.normal(size=6))
    found = solve(name, system, as_run=True).x
    assert relative(found, np.linalg.solve(system.normal, system.rhs)) <= AGREEMENT
    assert np.array_equal(solve(name, system).x, found)


@pytest.mark.behaviour
def test_check_sums_hold_on_good_and_ill_conditioned_systems() -> None:
    rng = np.random.default_rng(8)
    for _ in range(100):
        u = int(rng.integers(1, 20))
        units = 10.0 ** rng.uniform(-8.0, 8.0, u)
        normal = positive_definite(rng, u, 6.0) * np.outer(units, units)
        done = checked_cholesky(normal, rng.normal(size=u) * units)
        assert done.violated == ()
    done = checked_cholesky(hilbert(9), np.ones(9))
    assert done.violated == ()
    assert done.checks.shape == (9,)


@pytest.mark.truth
@pytest.mark.parametrize("size", [1e-3, 1e-9])
def test_injected_error_is_found_by_the_check_sums(size: float) -> None:
    """The check sums name both rows of an element of N that was changed after the sums were formed.

    The element's mirror image is changed too.
    """
    rng = np.random.default_rng(9)
    normal, rhs = positive_definite(rng, 7, 2.0), rng.normal(size=7)
    sums = normal.sum(axis=1) + rhs
    assert checked_cholesky(normal, rhs, sums).violated == ()
    corrupted = normal.copy()
    corrupted[2, 4] += size
    corrupted[4, 2] += size
    done = checked_cholesky(corrupted, rhs, sums)
    assert done.violated == (2, 4)
    assert done.checks[2] > 0.0
    assert done.notes[-2:] == tuple(f"row {i + 1}: check sum off by {done.checks[i]:.3g}" for i in (2, 4))


@pytest.mark.truth
def test_wrong_right_hand_side_is_found_by_the_check_sums() -> None:
    rng = np.random.default_rng(10)
    normal, rhs = positive_definite(rng, 5, 2.0), rng.normal(size=5)
    sums = normal.sum(axis=1) + rhs
    rhs[3] += 1e-6
    assert checked_cholesky(normal, rhs, sums).violated == (3,)


@pytest.mark.behaviour
def test_published_names_in_the_order_of_the_publication() -> None:
    entries = solvers()
    published = [name for name, entry in entries.items() if entry.published]
    assert published == [*HAND_WRITTEN, "tikhonov_hkb", "tikhonov_lw", "tikhonov_od"]
    assert list(entries)[: len(published)] == published
    assert {*MODERN, *SCALED} <= set(entries)
    assert all(entry.source and entry.label for entry in entries.values())
