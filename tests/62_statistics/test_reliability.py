"""Redundancy numbers, minimal detectable biases and their effects agree with full matrices and planted errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq

import fg_orient as fg
from factors.conditions.control import POINT
from fg_orient.adjustment.dense import assemble
from fg_orient.model.block import Block
from fg_orient.model.names import Role
from fg_orient.orientation.solution import Solution
from fg_orient.quality.reliability import ALPHA, CHECKABLE, POWER, BlockReliability, noncentrality, reliability
from fg_orient.quality.residuals import ResidualCofactors
from tests.support.full_statistics import Full, fixed, measured_twice, options, own_observations


@pytest.fixture(scope="module")
def solution(grid: Block) -> Solution:
    return fg.adjust(fixed(options(grid, eop_set=16), 2))


@pytest.fixture(scope="module")
def found(solution: Solution) -> BlockReliability:
    return solution.reliability()


@pytest.mark.truth
def test_noncentrality_is_that_of_baarda() -> None:
    """The non-centrality is Baarda's 17.075, and that of scipy's distribution for other levels and dimensions."""
    assert round(noncentrality(), 3) == 17.075
    both_tails = (stats.norm.ppf(1.0 - ALPHA / 2.0) + stats.norm.ppf(POWER)) ** 2
    assert noncentrality() == pytest.approx(both_tails, rel=1e-9)
    for alpha, power, d in ((0.001, 0.8, 2), (0.05, 0.9, 3), (0.01, 0.5, 1)):
        limit = stats.chi2.isf(alpha, d)
        expected = brentq(lambda x, d=d, limit=limit, power=power: stats.ncx2.sf(limit, d, x) - power, 0.1, 100.0)
        assert noncentrality(alpha, power, d) == pytest.approx(expected, rel=1e-7)


@pytest.mark.oracle
def test_sums_are_the_trace_of_the_full_matrix(grid: Block, solution: Solution, found: BlockReliability) -> None:
    parts = [found.image.redundancy, found.control.redundancy, found.cofactors.prior]
    share, n, m = np.diag(Full.of(solution.problem, solution.state).residuals), *(2 * len(parts[0]), 3 * len(parts[1]))
    expected = [share[:n].sum(), share[n : n + m].sum(), share[n + m :].sum()]
    assert [float(p.sum()) for p in parts] == pytest.approx(expected, abs=1e-7)
    assert sum(expected) == pytest.approx(solution.redundancy, abs=1e-8)
    own = fg.adjust(own_observations(grid)).reliability()
    assert own.cofactors.redundancy_sum == pytest.approx(own_redundancy(own), abs=1e-8)
    numbers = np.concatenate([found.image.redundancy.ravel(), found.control.redundancy.ravel(), found.cofactors.prior])
    assert numbers.min() > -1e-9
    assert numbers.max() < 1.0 + 1e-9


def own_redundancy(own: BlockReliability) -> float:
    parts = [own.image.redundancy, own.control.redundancy, own.cofactors.prior, *own.cofactors.extra]
    return sum(float(p.sum()) for p in parts)


def biased(solution: Solution, whitened: np.ndarray) -> np.ndarray:
    """Return the change of all unknowns by an error of the observations: least squares by numpy, from the same rows."""
    _, design = assemble(solution.problem, solution.state)
    return np.linalg.lstsq(design, -whitened, rcond=None)[0]


@pytest.mark.oracle
def test_effects_of_a_bias_are_those_of_the_adjustment_with_it(solution: Solution, found: BlockReliability) -> None:
    """A bias of minimal detectable size moves ground point, image and test statistic as stated."""
    problem, full = solution.problem, Full.of(solution.problem, solution.state)
    o = problem.observations
    for row, axis in ((0, 0), (17, 1), (60, 0)):
        sigma = (o.sigma_line_px, o.sigma_sample_px)[axis][row]
        error = np.zeros(len(full.v))
        error[2 * row + axis] = found.image.minimal_detectable_bias[row, axis] / sigma
        step = biased(solution, error)
        at = full.problem.point_slice(int(o.point[row])) if problem.active[o.point[row]] else None
        if at is not None:
            assert np.linalg.norm(step[at]) == pytest.approx(found.image.ground_m[row, axis], rel=1e-6)
            own = np.linalg.solve(full.unknowns[at, at], step[at])
            assert np.sqrt(step[at] @ own) == pytest.approx(found.image.ground[row, axis], rel=1e-6)
        part = full.problem.image_slice(int(o.image[row]))
        own = np.linalg.solve(full.unknowns[part, part], step[part])
        assert np.sqrt(step[part] @ own) == pytest.approx(found.image.eop[row, axis], rel=1e-5)
        w = (full.residuals @ error)[2 * row + axis] / np.sqrt(found.image.redundancy[row, axis])
        assert w**2 == pytest.approx(noncentrality(), rel=1e-6)


@pytest.mark.oracle
def test_control_points_in_their_own_axes(solution: Solution, found: BlockReliability) -> None:
    """A minimal detectable bias along East, North or Up moves the control point as stated, with its redundancy."""
    problem, full = solution.problem, Full.of(solution.problem, solution.state)
    rows, n = np.flatnonzero(problem.observed), 2 * len(problem.observations)
    measured = problem.control_records[rows, POINT.place]
    turn = problem.axes(measured + problem.origin_m)
    for k, axis in ((0, 0), (2, 2), (3, 1)):
        j = int(rows[k])
        w = problem.control_records[j, POINT.whitening].reshape(3, 3)
        bias = turn[k].T[:, axis] * found.control.minimal_detectable_bias[k, axis]
        error = np.zeros(len(full.v))
        error[n + 3 * k : n + 3 * k + 3] = -w @ bias
        step = biased(solution, error)[full.problem.point_slice(j)]
        assert np.linalg.norm(step) == pytest.approx(found.control.ground_m[k, axis], rel=1e-6)
        assert np.sqrt(error @ full.residuals @ error) == pytest.approx(np.sqrt(noncentrality()), rel=1e-6)
        shift = turn[k] @ step
        seen = 1.0 - shift[axis] / found.control.minimal_detectable_bias[k, axis]
        assert seen == pytest.approx(found.control.redundancy[k, axis], abs=1e-7)


@pytest.mark.oracle
def test_normalised_residuals(solution: Solution, found: BlockReliability) -> None:
    problem, full = solution.problem, Full.of(solution.problem, solution.state)
    n = 2 * len(problem.observations)
    expected = full.v[:n] / np.sqrt(np.diag(full.residuals)[:n])
    given = found.image.normalised.ravel()
    known = ~np.isnan(given)
    assert known.sum() > 0.9 * n
    assert given[known] == pytest.approx(expected[known], abs=1e-5)
    assert np.sign(given[known]) == pytest.approx(np.sign(solution.residuals_px.ravel()[known]))


@pytest.mark.oracle
def test_smallest_and_largest_bias_of_an_image_point(solution: Solution, found: BlockReliability) -> None:
    """The smallest and largest minimal detectable bias are the extremes over all directions of the image plane."""
    o, q = solution.problem.observations, solution.residual_cofactors.image
    angles = np.linspace(0.0, np.pi, 20_001)
    for row in np.flatnonzero(~found.image.not_checkable)[:5]:
        b = np.stack([np.cos(angles) / o.sigma_line_px[row], np.sin(angles) / o.sigma_sample_px[row]])
        needed = np.sqrt(noncentrality(dimension=2) / np.einsum("in,ij,jn->n", b, q[row], b))
        assert needed.min() == pytest.approx(found.image.smallest[row], rel=1e-6)
        assert needed.max() == pytest.approx(found.image.largest[row], rel=1e-6)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("alpha", "power"), [(0.0, 0.8), (-0.1, 0.8), (0.8, 0.8), (0.9, 0.8), (0.001, 1.0), (np.nan, 0.8), (0.001, np.nan)]
)
def test_probabilities_that_are_none_are_refused(solution: Solution, alpha: float, power: float) -> None:
    with pytest.raises(fg.InputError) as caught:
        solution.reliability(alpha=alpha, power=power)
    assert [p.code for p in caught.value.problems] == ["statistics.power"]


@pytest.mark.oracle
def test_two_rays_do_not_check_the_epipolar_line(grid: Block, solution: Solution, found: BlockReliability) -> None:
    """For a point of two rays the direction of redundancy 0 is the epipolar line, and it is not checkable."""
    problem, o = solution.problem, solution.problem.observations
    rays = np.bincount(o.point, minlength=len(problem.active))
    tie = np.isin(np.arange(len(rays)), grid.points.where(Role.TIE))
    two = np.flatnonzero((rays == 2) & tie & problem.active)
    assert len(two) > 5
    for j in two[:5]:
        for row, other in (rows := np.flatnonzero(o.point == j)), rows[::-1]:
            assert found.image.least[row] == pytest.approx(0.0, abs=1e-9)
            assert np.isnan(found.image.largest[row])
            sensors = [grid.images[o.image[r]].sensor for r in (row, other)]
            corrections = [solution.problem.corrections(solution.state)[o.image[r]] for r in (row, other)]
            _, u = sensors[1].rays(o.line[other : other + 1], o.sample[other : other + 1], corrections[1])
            along = solution.ground_m[j] + np.array([[-10.0], [10.0]]) * u
            lines, samples = sensors[0].project(along, corrections[0])
            epipolar = np.array([np.diff(lines)[0], np.diff(samples)[0]])
            epipolar /= np.linalg.norm(epipolar)
            assert abs(epipolar @ found.image.direction[row]) == pytest.approx(1.0, abs=1e-5)
    assert found.image.not_checkable[np.isin(o.point, two)].all()


@pytest.mark.behaviour
def test_fixed_points_are_checked_in_full_but_for_the_image(grid: Block) -> None:
    solution = fg.adjust(fixed(grid, 100), eop_set=10)
    found = solution.reliability()
    rows = ~solution.problem.active[solution.problem.observations.point]
    assert not found.image.not_checkable[rows].any()
    assert np.isnan(found.image.ground[rows]).all()
    assert (found.image.ground_m[rows] == 0.0).all()
    assert len(found.control.redundancy) == 0


@pytest.mark.behaviour
def test_figures_that_do_not_exist_have_a_reason(grid: Block) -> None:
    with pytest.raises(fg.NoSolutionError) as caught:
        fg.adjust(grid, loss="huber").reliability()
    assert caught.value.problems[0].code == "statistics.reliability_weighted"
    with pytest.raises(fg.NoSolutionError) as caught:
        fg.adjust(grid, datum="free", priors=False, eop_set=2).reliability()
    assert caught.value.problems[0].code == "covariance.unavailable"


@pytest.mark.oracle
def test_second_measurement_checks_the_first(grid: Block, solution: Solution, found: BlockReliability) -> None:
    """A second measurement makes the least redundancy of a point of two rays larger than 0.1.

    Before and after it is the smallest eigenvalue of its part of the full matrix.
    """
    o = solution.problem.observations
    row = int(np.flatnonzero((found.image.least < 1e-9) & (np.bincount(o.point)[o.point] == 2))[0])
    twice = fg.adjust(measured_twice(fixed(options(grid, eop_set=16), 2), row + 1))
    least = twice.reliability().image.least[row]
    assert least > 0.1 > CHECKABLE > found.image.least[row]
    for solved, given in ((twice, least), (solution, found.image.least[row])):
        part = Full.of(solved.problem, solved.state).residuals[2 * row : 2 * row + 2, 2 * row : 2 * row + 2]
        assert given == pytest.approx(np.linalg.eigvalsh(part)[0], abs=1e-9)


@dataclass(frozen=True)
class Rates:
    single: float
    group: float
    low: float
    high: float

    @property
    def hold(self) -> bool:
        return self.low <= self.single <= self.high and self.low <= self.group <= self.high


def power_of_the_test(solution: Solution, runs: int, *, factor: float = 1.0, seed: int = 62) -> Rates:
    """Return the share of linear adjustments with noise and one bias of minimal detectable size whose test finds it.

    ``factor`` multiplies the bias. The bias of the group lies in the direction that is checked least.
    """
    full, found = Full.of(solution.problem, solution.state), solution.reliability()
    row = int(np.flatnonzero(~found.image.not_checkable)[0])
    o = solution.problem.observations
    noise = np.random.default_rng(seed).normal(size=(runs, len(full.v)))
    part = slice(2 * row, 2 * row + 2)
    q, sigma = full.residuals[part, part], np.array([o.sigma_line_px[row], o.sigma_sample_px[row]])
    before = noise @ full.residuals[:, part]
    bias = found.image.minimal_detectable_bias[row, 0] / sigma[0] * factor
    w = (before[:, 0] + q[0, 0] * bias) / np.sqrt(q[0, 0])
    single = np.mean(np.abs(w) > stats.norm.isf(ALPHA / 2.0))
    scaled = q / np.outer(sigma, sigma)
    worst = np.linalg.eigh(scaled)[1][:, 0] * found.image.largest[row] * factor / sigma
    v = before + q @ worst
    group = np.mean(np.einsum("ni,ij,nj->n", v, np.linalg.inv(q), v) > stats.chi2.isf(ALPHA, 2))
    low, high = stats.binom.interval(0.999, runs, POWER)
    return Rates(float(single), float(group), low / runs, high / runs)


@pytest.mark.oracle
def test_power_is_the_stated_one(solution: Solution) -> None:
    assert power_of_the_test(solution, 2000).hold


@pytest.mark.oracle
def test_power_of_another_bias_is_not(solution: Solution) -> None:
    """With weights wrong by 20 % the power of the test leaves its interval, so that the test above can fail."""
    for factor in (0.8, 1.2):
        rates = power_of_the_test(solution, 2000, factor=factor)
        assert not rates.low <= rates.single <= rates.high
        assert not rates.low <= rates.group <= rates.high


@pytest.mark.oracle
@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_power_in_ten_thousand_runs(solution: Solution, seed: int) -> None:
    rates = power_of_the_test(solution, 10_000, seed=seed)
    print(f"seed {seed}: {rates}")
    assert rates.hold


@pytest.mark.oracle
def test_wrong_weight_is_seen_in_the_test_statistic(solution: Solution) -> None:
    """With the right sigma the bias has Baarda's non-centrality, with a sigma 20 % too large it has not.

    The redundancy number is that of the full matrix, the non-centrality that of normal quantiles.
    """
    number = Full.of(solution.problem, solution.state).residuals[2 * 17, 2 * 17]
    asked = (stats.norm.ppf(1.0 - ALPHA / 2.0) + stats.norm.ppf(POWER)) ** 2
    o = solution.problem.observations
    sigma = o.sigma_line_px.copy()
    sigma[17] *= 1.2
    wrong = replace(solution.problem, observations=replace(o, sigma_line_px=sigma))
    for problem, right in ((solution.problem, True), (wrong, False)):
        found = reliability(ResidualCofactors(problem, solution.state, solution.required_cofactors()))
        bias = found.image.minimal_detectable_bias[17, 0] / o.sigma_line_px[17]
        assert bool(np.isclose(bias**2 * number, asked, rtol=1e-6)) is right
