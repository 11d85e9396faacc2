"""Figures of the accuracy report against numpy and simulation; prediction and bias tests and their distributions."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import binom, chi2, ttest_1samp

import fg_orient as fg
from fg_orient.model.distributions import binomial_limit
from fg_orient.model.errors import NoSolutionError
from fg_orient.orientation.solution import Solution
from fg_orient.quality.accuracy import BEYOND, CHANCE, PointDifferences, PredictionTest, bias_test, prediction_test
from fg_orient.quality.verdict import of_check_points
from fg_orient.simulate.block import BlockOptions, grid_block


def points(enu: np.ndarray, predicted: float = 1.0, own: float = 0.5) -> PointDifferences:
    n = len(enu)
    return PointDifferences(
        tuple(f"c{k}" for k in range(n)), np.arange(n), enu, enu, np.full((n, 3), predicted), np.full((n, 3), own)
    )


@pytest.mark.oracle
def test_radial_figures(rng: np.random.Generator) -> None:
    d = rng.normal([0.1, -0.2, 0.5], [1.0, 1.2, 2.0], (40, 3))
    found = points(d).statistics()
    assert found["rmse_horizontal_m"] == pytest.approx(np.sqrt(np.mean(d[:, 0] ** 2 + d[:, 1] ** 2)))
    assert found["rmse_3d_m"] == pytest.approx(np.sqrt(np.mean((d**2).sum(axis=1))))
    assert found["max_horizontal_m"] == pytest.approx(np.hypot(d[:, 0], d[:, 1]).max())
    assert found["max_3d_m"] == pytest.approx(np.linalg.norm(d, axis=1).max())


@pytest.mark.oracle
def test_factors_of_rmse_hold_90_and_95_percent(rng: np.random.Generator) -> None:
    """200 000 normal errors: shares inside the radii; with the factors of the other axis count they are missed."""
    d = rng.normal(0.0, 1.0, (200_000, 3))
    found = points(d).statistics()
    radius = np.hypot(d[:, 0], d[:, 1])
    for key, size, share in (
        ("ce90_rmse_m", radius, 0.90), ("ce95_rmse_m", radius, 0.95),
        ("le90_rmse_m", np.abs(d[:, 2]), 0.90), ("le95_rmse_m", np.abs(d[:, 2]), 0.95),
    ):  # fmt: skip
        low, high = binom.ppf([0.0005, 0.9995], len(d), share) / len(d)
        assert low < np.mean(size <= found[key]) < high, key
        assert not low < np.mean(size <= 1.02 * found[key]) < high
    assert found["ce90_m"] == pytest.approx(found["ce90_rmse_m"], rel=0.01)


@pytest.mark.behaviour
def test_circular_factors_are_absent_where_they_do_not_hold() -> None:
    d = np.random.default_rng(1).normal(0.0, [1.0, 0.5, 1.0], (5000, 3))
    found = points(d).statistics()
    assert "ce90_rmse_m" not in found and "ce95_rmse_m" not in found
    assert "ce90_m" in found and "le95_rmse_m" in found
    assert not {"ce90_m", "le90_m", "le90_rmse_m"} & set(points(d[:1]).statistics())


@pytest.mark.oracle
def test_binomial_limit_is_the_quantile() -> None:
    for n in (0, 1, 3, 30, 90, 300, 9360, 1_000_000):
        assert binomial_limit(n, BEYOND, CHANCE) == binom.ppf(1.0 - CHANCE, n, BEYOND), n
    assert [binomial_limit(7, p, CHANCE) for p in (0.0, 1.0)] == [0, 7]
    assert pytest.approx(chi2.sf(9.0, 1)) == BEYOND


@pytest.mark.behaviour
def test_as_many_differences_beyond_three_as_chance_gives_are_no_warning() -> None:
    """3120 good points have some 25 coordinates beyond; half as many again, or one far off, are a warning."""
    d = np.random.default_rng(4).normal(0.0, np.hypot(1.0, 0.5), (3120, 3))
    found = points(d).beyond()
    assert (found.n, found.limit, found.far) == (9360, 42, ()) and found.expected == pytest.approx(25.27, abs=0.01)
    assert 10 < found.count <= 42 and found.by_chance and of_check_points(points(d)) == []
    assert found.sentence.startswith(f"{found.count} of 9360 check coordinates lie beyond 3 standard deviations")
    assert "as many as chance gives (25.3 expected" in found.sentence

    many = points(1.15 * d)
    (told,) = map(str, of_check_points(many))
    assert many.beyond().count > 42 and "of 9360 check coordinates, 25.3 expected by chance, up to 42" in told
    assert told.startswith(f"check points beyond 3 standard deviations of the difference: {many.suspicious()[0][0]}, ")

    far = d.copy()
    far[70, 1] = 6.0 * np.hypot(1.0, 0.5)
    (told,) = map(str, of_check_points(points(far)))
    assert told.endswith("standard deviations of the difference, which chance hardly gives among 9360 coordinates: c70")
    assert "beyond 5.3 " in told


@pytest.mark.behaviour
def test_few_check_points_are_named_by_number_or_size() -> None:
    """Of ten points two coordinates beyond three are not unusual, three are, and one at five is."""
    d = np.zeros((10, 3))
    scale = np.hypot(1.0, 0.5)
    d[[1, 4], [0, 2]] = 3.1 * scale
    assert points(d).beyond().by_chance and of_check_points(points(d)) == []
    d[6, 1] = -3.2 * scale
    (told,) = map(str, of_check_points(points(d)))
    assert told.startswith("check points beyond 3 standard deviations of the difference: c6, c1, c4; 3 of 30 check")
    d[[1, 4]] = 0.0
    d[6, 1] = -5.0 * scale
    assert "4.1 standard deviations" in str(of_check_points(points(d))[0])
    unavailable = replace(points(d), predicted_sigma_enu_m=np.full((10, 3), np.nan)).beyond()
    assert (unavailable.n, unavailable.by_chance, unavailable.sentence) == (0, True, "")


@pytest.mark.oracle
def test_bias_test_is_students(rng: np.random.Generator) -> None:
    d = rng.normal(0.0, 1.0, (20, 3)) + np.array([0.0, 0.0, 2.0])
    found = bias_test(points(d))
    for axis, column in zip(("east", "north", "up"), d.T, strict=True):
        expected = ttest_1samp(column, 0.0)
        assert found[axis]["t"] == pytest.approx(expected.statistic)
        assert found[axis]["biased"] == (expected.pvalue < 1.0 - 0.95 ** (1.0 / 3.0))
    assert found["up"]["biased"]
    assert bias_test(points(d[:1])) == {} and bias_test(points(np.ones((5, 3)))) == {}


@pytest.mark.oracle
def test_bias_test_has_its_size() -> None:
    """1000 samples without a bias (seed 3); judged by normal instead of Student limits it would fail."""
    d = np.random.default_rng(3).normal(size=(1000, 6, 3))
    rejected = sum(any(axis["biased"] for axis in bias_test(points(sample)).values()) for sample in d)
    low, high = binom.ppf([0.0005, 0.9995], 1000, 0.05)
    assert low <= rejected <= high
    assert sum(any(abs(axis["t"]) > 2.388 for axis in bias_test(points(sample)).values()) for sample in d) > high


@lru_cache
def solved(seed: int) -> Solution:
    block, _ = grid_block(BlockOptions(rows=1, columns=2, points=60, seed=seed, check_share=0.2))
    return fg.adjust(block, eop_set=20)


@pytest.mark.oracle
def test_statistic_is_that_of_the_joint_covariance() -> None:
    """Against the inverse of the dense normal matrix."""
    from fg_orient.adjustment.dense import assemble

    solution = solved(1)
    problem, check = solution.problem, solution.accuracy.check
    _, design = assemble(problem, solution.state)
    rows = np.concatenate([np.r_[problem.point_slice(int(j))] for j in check.index])
    turn = problem.axes(solution.ground_m[check.index])
    whole = np.zeros((len(rows), len(rows)))
    for k, t in enumerate(turn):
        whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = t
    q = whole @ np.linalg.inv(design.T @ design)[np.ix_(rows, rows)] @ whole.T
    e = check.enu_m.ravel()
    expected = e @ np.linalg.solve(q + np.diag(check.own_sigma_enu_m.ravel() ** 2), e)
    found = solution.prediction_test()
    assert found.n == found.n_joint == len(check)
    assert found.statistic == pytest.approx(expected, rel=1e-6)
    assert found.within[:, 2].max() <= found.n
    assert np.array_equal(found.within[:, 0], (check.ratio <= 1.0).sum(axis=0))


@pytest.mark.oracle
def test_honest_predictions_are_believed_and_others_not() -> None:
    """Sum of T over five seeds in its 99.9 % interval; with sigmas halved or doubled outside, and named."""
    total = {1.0: 0.0, 0.5: 0.0, 2.0: 0.0}
    degrees = 0
    for seed in range(1, 6):
        solution = solved(seed)
        degrees += solution.prediction_test().degrees
        for scale in total:
            total[scale] += scaled(solution, scale).statistic
    low, high = chi2.ppf([0.0005, 0.9995], degrees)
    assert low < total[1.0] < high
    assert total[0.5] > high and total[2.0] < low
    assert "too optimistic" in scaled(solved(1), 0.5).sentence()
    assert "too pessimistic" in scaled(solved(1), 2.0).sentence()
    assert solved(1).prediction_test().honest


def scaled(solution: Solution, scale: float) -> PredictionTest:
    """The test with all standard deviations multiplied."""

    class Scaled:
        def joint(self, images: tuple[int, ...], index: tuple[int, ...]) -> np.ndarray:
            return solution.cofactors.joint(images, index) * scale**2

    check = replace(solution.accuracy.check, own_sigma_enu_m=solution.accuracy.check.own_sigma_enu_m * scale)
    return prediction_test(solution.problem, solution.state, Scaled(), check)


@pytest.mark.behaviour
def test_reasons_instead_of_figures() -> None:
    block, _ = grid_block(BlockOptions(rows=1, columns=2, points=60, seed=1, check_share=0.2))
    with pytest.raises(NoSolutionError, match="located afterwards"):
        fg.adjust(block, eop_set=20, check_points="exclude").prediction_test()
    empty = replace(solved(1), accuracy=replace(solved(1).accuracy, check=points(np.zeros((0, 3)))))
    with pytest.raises(NoSolutionError, match="no check points"):
        empty.prediction_test()


@pytest.mark.behaviour
def test_record_of_the_result() -> None:
    from fg_orient.result.summary import summary

    check = summary(solved(1))["accuracy"]["check"]
    assert check["prediction"]["honest"] is True
    assert check["prediction_withheld"] is None
    assert set(check["bias"]) == {"east", "north", "up"}
    assert check["prediction"]["east"]["within_3_sigma"] <= check["prediction"]["n"]
    assert check["prediction"]["expected_share"]["within_1_sigma"] == pytest.approx(0.6827, abs=1e-4)
