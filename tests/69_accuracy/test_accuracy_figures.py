"""Figures of the accuracy report agree with numpy and simulation; its tests have the right distributions."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import binom, chi2, ttest_1samp

import fg_orient as fg
from fg_orient.model.block import Block, Coordinates, WithheldCoordinates
from fg_orient.model.errors import NoSolutionError
from fg_orient.model.names import Role
from fg_orient.orientation.solution import Solution
from fg_orient.quality.accuracy import (
    BEYOND,
    CHANCE,
    Joint,
    PointDifferences,
    PredictionTest,
    prediction_test,
    trend_tests,
)
from fg_orient.quality.check_tests import (
    TRENDS,
    number_statistic,
    numbers_by_chance,
    probability_of_number,
    trend_squares,
)
from fg_orient.quality.doubts import of_check_points
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block


def points(enu: np.ndarray, predicted: float = 1.0, own: float = 0.5) -> PointDifferences:
    n = len(enu)
    return PointDifferences(
        tuple(f"c{k}" for k in range(n)),
        np.arange(n),
        enu,
        enu,
        np.tile(np.eye(3) * predicted**2, (n, 1, 1)),
        np.full((n, 3), own),
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
    """CE90, CE95, LE90 and LE95 from the RMSE contain their share of 200 000 normal errors, and 2 % more do not."""
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
@pytest.mark.parametrize("control", [4, 8, 37])
def test_tests_of_check_points_have_their_size(control: int) -> None:
    """Tests of trend and number of check points have their level for draws from the joint covariance.

    Student's test has not. 4000 draws of the trend, 20 000 of the number (a thousandth of 4000 is 4).
    """
    check = fg.adjust(with_control(control), eop_set=15).accuracy.check
    c, place = check.covariance_m2, check.joint.place_km[check.selected]
    rng = np.random.default_rng(control)
    e = np.linalg.cholesky(c) @ rng.normal(size=(len(c), 20_000))
    squares, degrees = trend_squares(c, place, e[:, :4000])
    assert degrees == (3, 4, 2)
    p = np.array([chi2.sf(square, d) for square, d in zip(squares, degrees, strict=True)])
    for name, one in zip(TRENDS, p, strict=True):
        assert 0.03 <= np.mean(one <= 0.05) <= 0.07, name
    assert 0.03 <= np.mean(p.min(axis=0) <= 1.0 - 0.95 ** (1.0 / 3.0)) <= 0.07
    ratio = np.abs(e / np.sqrt(np.diag(c))[:, None]).T
    number = probability_of_number(number_statistic(ratio), numbers_by_chance(c))
    assert 0.0002 <= np.mean(number <= CHANCE) <= 0.003
    draws = e[:, :4000].T.reshape(4000, -1, 3)
    assert (ttest_1samp(draws, 0.0, axis=1).pvalue.min(axis=1) <= 1.0 - 0.95 ** (1.0 / 3.0)).mean() > 0.07
    limit = binom.ppf(1.0 - CHANCE, len(c), BEYOND)
    if control == 4:
        assert np.mean((ratio > 3.0).sum(axis=1) > limit) > 0.003


def with_control(count: int) -> Block:
    """Return the synthetic pair with this many control points; all others are check points."""
    block = zonguldak_block(ZonguldakOptions(seed=1))[0]
    opened, points = block.withheld.open(), block.points
    ecef, sigma, fixed = (
        values.copy() for values in (points.known.ecef_m, points.known.sigma_enu_m, points.known.fixed)
    )
    rows = [points.ids.index(name) for name in block.withheld.ids]
    ecef[rows], sigma[rows], fixed[rows] = opened.ecef_m, opened.sigma_enu_m, opened.fixed
    chosen = np.linspace(0, len(ecef) - 1, count).astype(int)
    check = np.setdiff1d(np.arange(len(ecef)), chosen)
    sealed = Coordinates(ecef[check], sigma[check], fixed[check])
    whole = replace(points, known=Coordinates(ecef, sigma, fixed), roles=(Role.CONTROL,) * len(ecef))
    names = tuple(points.ids[j] for j in check)
    return replace(block, points=whole.without_coordinates(~np.isin(np.arange(len(ecef)), chosen), Role.CHECK),
                   withheld=WithheldCoordinates(names, lambda: sealed))  # fmt: skip


@pytest.mark.oracle
def test_trend_is_that_of_generalised_least_squares() -> None:
    """The test of each trend is the decrease of the weighted squares by least squares with whitened rows."""
    check = solved(1).accuracy.check
    c, e = check.covariance_m2, check.enu_m.ravel()
    place = check.joint.place_km
    found = trend_tests(check)
    root = np.linalg.inv(np.linalg.cholesky(c))
    columns = np.column_stack([np.kron(v[:, None], np.eye(3)) for v in (np.ones(len(place)), *place.T)])
    before = float(e @ np.linalg.solve(c, e))
    taken: list[int] = []
    for name, group in (("bias", [0, 1, 2]), ("drift", [3, 4, 6, 7]), ("tilt", [5, 8])):
        taken += group
        after = float(np.linalg.lstsq(root @ columns[:, taken], root @ e)[1][0])
        assert found[name]["chi2"] == pytest.approx(before - after, rel=1e-6, abs=1e-8)
        assert found[name]["degrees"] == len(group)
        before = after
    ones, weight = columns[:, :3], np.linalg.inv(c)
    q = np.linalg.inv(ones.T @ weight @ ones)
    assert found["bias"]["mean_enu_m"] == pytest.approx(q @ ones.T @ weight @ e, rel=1e-6)
    assert found["bias"]["sd_enu_m"] == pytest.approx(np.sqrt(np.diag(q)), rel=1e-6)
    moved = replace(check, enu_m=check.enu_m + 6.0 * np.sqrt(np.diag(q)))
    assert trend_tests(moved)["bias"]["significant"]
    assert trend_tests(moved)["tilt"]["chi2"] == pytest.approx(found["tilt"]["chi2"], rel=1e-6)
    assert set(trend_tests(one_point(check))) == {"bias"}


def one_point(check: PointDifferences) -> PointDifferences:
    joint = replace(check.joint, index=check.joint.index[:1], axes=check.joint.axes[:1],
                    place_km=check.joint.place_km[:1])  # fmt: skip
    return replace(check, ids=check.ids[:1], index=check.index[:1], enu_m=check.enu_m[:1],
                   own_sigma_enu_m=check.own_sigma_enu_m[:1], joint=joint)  # fmt: skip


class Independent:
    """Cofactors of independent points with standard deviations of 1 m."""

    def joint(self, images: tuple[int, ...], index: tuple[int, ...]) -> np.ndarray:
        return np.eye(3 * len(index))


def with_joint(d: np.ndarray) -> PointDifferences:
    n = len(d)
    return replace(points(d), joint=Joint(Independent(), np.arange(n), np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 2))))


@pytest.mark.behaviour
def test_differences_that_chance_does_not_give_are_doubts() -> None:
    """One of 30 check coordinates beyond three sigmas is chance; four of them, or one at five, are a doubt."""
    d = np.zeros((10, 3))
    scale = np.hypot(1.0, 0.5)
    d[1, 0] = 3.1 * scale
    found = with_joint(d).beyond
    assert found.by_chance and of_check_points(with_joint(d)) == []
    assert found.probability == pytest.approx(1.0 - (1.0 - BEYOND) ** 30, abs=0.03)
    assert found.sentence.startswith("1 of 30 check coordinates lies beyond 3 standard deviations")
    d[[4, 6, 8], [2, 1, 0]] = [3.2 * scale, -3.3 * scale, 3.1 * scale]
    (told,) = of_check_points(with_joint(d))
    assert (told.code, told.severity, told.data["size"]) == ("verdict.check_beyond", "doubt", 4)
    assert "4 of 30 check coordinates" in str(told) and "c6, c4, " in str(told)
    d[:] = 0.0
    d[6, 1] = -5.0 * scale
    (told,) = (f for f in of_check_points(with_joint(d)) if f.code == "verdict.check_far")
    assert told.data["size"] == pytest.approx(5.0) and "is 4.1" in str(told) and "c6" in str(told)
    assert points(d).beyond.probability is None  # no joint covariance: the number is not tested
    unavailable = replace(points(d), cofactors_enu_m2=np.full((10, 3, 3), np.nan)).beyond
    assert (unavailable.n, unavailable.by_chance, unavailable.sentence) == (0, True, "")


@lru_cache
def solved(seed: int) -> Solution:
    block, _ = grid_block(BlockOptions(rows=1, columns=2, points=60, seed=seed, check_share=0.2))
    return fg.adjust(block, eop_set=20)


@pytest.mark.oracle
def test_statistic_is_that_of_the_joint_covariance() -> None:
    """The statistic of the predictions is that of the joint covariance from the dense normal matrix."""
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
    """Predictions pass their test over five seeds; with sigmas halved or doubled they fail and are named."""
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
    """Return the test with all standard deviations multiplied."""

    class Scaled:
        def joint(self, images: tuple[int, ...], index: tuple[int, ...]) -> np.ndarray:
            return solution.cofactors.joint(images, index) * scale**2

    check = solution.accuracy.check
    joint = replace(check.joint, cofactors=Scaled())
    return prediction_test(replace(check, own_sigma_enu_m=check.own_sigma_enu_m * scale, joint=joint))


@pytest.mark.behaviour
def test_reasons_instead_of_figures() -> None:
    block, _ = grid_block(BlockOptions(rows=1, columns=2, points=60, seed=1, check_share=0.2))
    with pytest.raises(NoSolutionError, match="located after the adjustment"):
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
    assert set(check["trend"]) == {"bias", "drift", "tilt"}
    assert check["prediction"]["east"]["within_3_sigma"] <= check["prediction"]["n"]
    assert check["prediction"]["expected_share"]["within_1_sigma"] == pytest.approx(0.6827, abs=1e-4)
