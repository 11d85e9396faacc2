"""The scale from the median of the residuals agrees with chi-square and with exact cofactors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

import fg_orient as fg
from fg_orient.adjustment.robust import A_PRIORI, LEAST, LOWEST, robust_scale
from fg_orient.adjustment.rows import residuals
from fg_orient.model.distributions import chi_square_median
from tests.support.full_statistics import Full

from .conftest import adjusted, grid, problem_of, spoiled, twin, with_sigmas


@pytest.mark.oracle
def test_factors_are_medians_of_chi_square() -> None:
    for d in (1, 2, 3):
        assert float(chi_square_median(d)) == pytest.approx(chi2.median(d), rel=1e-12)
    factors = 1.0 / np.sqrt(chi_square_median(np.array([1, 2, 3])))
    assert factors == pytest.approx([1.4826, 0.8493, 0.6501], abs=5e-5)


def exact_image_scale(solution: fg.Solution) -> float:
    """Return the same median with the cofactors of the residuals from the full matrix, by numpy."""
    whole = Full.of(solution.problem, solution.state).residuals
    q = np.array([whole[k : k + 2, k : k + 2] for k in range(0, 2 * len(solution.problem.observations), 2)])
    v = residuals(solution.problem, solution.state)
    size, axes = np.linalg.eigh(q)
    part = np.einsum("nij,ni->nj", axes, v)
    checked = size > 0.1
    t = np.where(checked, part**2 / np.where(checked, size, 1.0), 0.0).sum(axis=1)
    d = checked.sum(axis=1)
    return float(np.sqrt(np.median(t[d > 0] / chi2.median(d[d > 0]))))


@pytest.mark.oracle
@pytest.mark.parametrize("block", [twin(), grid()], ids=["twin", "grid"])
def test_as_with_exact_cofactors(block: fg.Block) -> None:
    """The robust scale equals that with exact cofactors within 5 %, and is 1 within 25 %.

    It uses cofactors of points and images one at a time.
    """
    solution = fg.adjust(block)
    image, _ = robust_scale(solution.problem, solution.state)
    assert image == pytest.approx(exact_image_scale(solution), rel=0.05)
    assert image == pytest.approx(1.0, abs=0.25)


@pytest.mark.oracle
def test_residuals_taken_as_errors_are_found_out() -> None:
    """Without the share that the unknowns absorb the scale would be below 0.75 of the exact one."""
    solution = fg.adjust(grid())
    v = residuals(solution.problem, solution.state)
    plain = float(np.sqrt(np.median(np.sum(v**2, axis=1)) / chi2.median(2)))
    assert plain < 0.75 * exact_image_scale(solution)


@pytest.mark.oracle
def test_wrong_sigmas_are_seen() -> None:
    """If the sigmas are a third as large, both scales are three times as large within 10 %."""
    right, wrong = (fg.adjust(with_sigmas(grid(), f)) for f in (1.0, 1.0 / 3.0))
    scales = [robust_scale(s.problem, s.state) for s in (right, wrong)]
    assert np.divide(*scales[::-1]) == pytest.approx([3.0, 3.0], rel=0.1)


@pytest.mark.behaviour
def test_few_control_points_and_vanishing_residuals() -> None:
    block = grid(40, 0.15)
    problem = problem_of(block)
    assert int(problem.observed.sum()) < LEAST
    assert robust_scale(problem, problem.start)[1] == A_PRIORI[1]
    hardly_checked = problem_of(twin())  # sigmas of centimetres against rays good to metres
    assert robust_scale(hardly_checked, hardly_checked.start)[1] == A_PRIORI[1]
    exact = problem_of(grid())
    assert robust_scale(exact, exact.start)[1] == LOWEST  # control points start at their measured coordinates


@pytest.mark.oracle
def test_gross_errors_hardly_move_it() -> None:
    """With 30 % wrong rays the final scale is between 0.8 and 1.6, while sigma0 is above 10.

    Rays of control points are wrong by 10 to 100 sigmas.
    """
    block, bad = spoiled(twin(), 0.3, 3)
    end = adjusted(block, loss="tukey", robust_scale="mad")
    assert end.converged
    assert end.weights is not None
    assert 0.8 <= end.weights.scale[0] <= 1.6
    assert (end.weights.image[bad] < 0.5).all()
    assert np.sqrt(adjusted(block).chi2 / problem_of(block).redundancy) > 10.0


@pytest.mark.oracle
def test_wrong_sigmas_without_and_with_the_scale() -> None:
    """With sigmas a tenth as large the measured scale keeps 90 % of the rays; without it 40 % are down-weighted."""
    block = with_sigmas(grid(), 0.1)
    plain, measured = (adjusted(block, loss="tukey", robust_scale=s) for s in ("prior", "mad"))
    assert plain.weights is not None and measured.weights is not None
    assert np.mean(plain.weights.image < 0.5) > 0.4
    assert np.mean(measured.weights.image < 0.5) < 0.1
    assert measured.weights.scale[0] == pytest.approx(10.0, rel=0.25)
