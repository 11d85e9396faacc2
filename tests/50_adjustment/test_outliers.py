"""Tests for gross errors and the snooping loop are compared with removals, planted errors and false alarms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import f as fisher

import fg_orient as fg
from fg_orient.geodesy import ecef_to_geodetic, enu_from_ecef
from fg_orient.model.block import Block, Coordinates
from fg_orient.model.names import Role
from fg_orient.quality.outlier_records import GroupTest
from fg_orient.quality.residuals import ResidualCofactors
from tests.support.rpc_block import rpc_twin


def all_control(seed: int = 1, kind: str = "shift") -> Block:
    """Return a twin whose points are all control: truth plus noise of 0.06/0.06/1 m East, North, Up."""
    twin = rpc_twin(kind, seed=seed)
    n = len(twin.ecef_m)
    sigma = np.tile([0.06, 0.06, 1.0], (n, 1))
    lon, lat, _ = ecef_to_geodetic(twin.ecef_m)
    noise = np.random.default_rng(seed).normal(size=(n, 3)) * sigma
    ecef = twin.ecef_m + np.einsum("nji,nj->ni", enu_from_ecef(lon, lat), noise)
    points = replace(twin.block.points, roles=(Role.CONTROL,) * n, known=Coordinates(ecef, sigma, np.zeros(n, bool)))
    return replace(twin.block, points=points, withheld=replace(twin.block.withheld, ids=()))


def with_error(block: Block, point: str, image: str = "", error: tuple[float, ...] = ()) -> Block:
    """Add line and sample (px) in one image, or East, North, Up (m) to the coordinates of a point."""
    j, o, known = block.points.ids.index(point), block.observations, block.points.known
    if image:
        row = (o.point == j) & (o.image == block.image_index(image))
        o = replace(o, line=o.line + error[0] * row, sample=o.sample + error[1] * row)
        return replace(block, observations=o)
    ecef = known.ecef_m.copy()
    lon, lat, _ = ecef_to_geodetic(ecef[j])
    ecef[j] += enu_from_ecef(lon, lat)[0].T @ np.array(error)
    return replace(block, points=replace(block.points, known=replace(known, ecef_m=ecef)))


def without(block: Block, test: GroupTest) -> Block:
    """Leave a tested image point out."""
    j, o = block.points.ids.index(test.point), block.observations
    return replace(block, observations=o.take(~((o.point == j) & (o.image == block.image_index(test.image)))))


@pytest.mark.oracle
@pytest.mark.parametrize("backend", ["graph", "dense", "schur"])
def test_statistic_is_what_the_removal_of_the_observation_gains(backend: str) -> None:
    """The statistic of an image point follows from chi2 before minus after its removal, with the right F limits."""
    block = all_control()
    solution = fg.adjust(block, backend=backend)
    tests = [t for t in solution.outlier_tests() if t.part == "image"]
    f = solution.redundancy
    for test in tests[:3] + tests[-3:]:
        rest = fg.adjust(without(block, test), backend=backend)
        d = solution.redundancy - rest.redundancy
        assert d == test.dimension == 2
        t = solution.chi2 - rest.chi2
        assert test.statistic == pytest.approx(t / d / (rest.chi2 / (f - d)), rel=1e-3, abs=1e-6)
        assert test.probability == pytest.approx(fisher.sf(test.statistic, d, f - d), rel=1e-9)
        assert test.critical == pytest.approx(fisher.isf(test.level, d, f - d), rel=1e-9)
        assert test.level == pytest.approx(1.0 - 0.95 ** (1.0 / len(solution.outlier_tests())), rel=1e-9, abs=0.0)


@pytest.mark.oracle
def test_error_of_coordinates_is_what_moves_the_point_back() -> None:
    """If the estimated error of coordinates is subtracted, chi2 decreases by T and the test finds nothing."""
    block = all_control()
    solution = fg.adjust(block)
    height = next(t for t in solution.outlier_tests() if t.part == "height")
    position = next(t for t in solution.outlier_tests() if t.part == "position")
    for test, error in ((height, (0.0, 0.0, -height.error[0])), (position, (*-position.error, 0.0))):
        mended = fg.adjust(with_error(block, test.point, error=error))
        t = (solution.chi2 - mended.chi2) / test.dimension
        statistic = t / (mended.chi2 / (solution.redundancy - test.dimension))
        assert test.statistic == pytest.approx(statistic ** (1.0 / (3 - test.dimension)), rel=1e-3)  # F or t
        again = next(g for g in mended.outlier_tests() if g.part == test.part and g.point == test.point)
        assert again.statistic < 1e-2


@pytest.mark.oracle
def test_redundancy_numbers_add_up() -> None:
    """Redundancy numbers of image points, control points and priors add up to the redundancy."""
    solution = fg.adjust(all_control())
    assert solution.cofactors is not None
    found = ResidualCofactors(solution.problem, solution.state, solution.cofactors)
    observed = float(np.einsum("nii->", found.image) + np.einsum("nii->", found.control))
    priors = sum(float(np.trace(np.eye(2) - solution.cofactors.image(k))) for k in (0, 1))
    assert observed + priors == pytest.approx(solution.redundancy, rel=1e-8)


@pytest.mark.oracle
def test_planted_errors_are_found_named_and_measured() -> None:
    """Errors of an image point, a height and a position are found, named and removed, and nothing else is."""
    block = all_control(seed=2)
    ids = block.points.ids
    wrong = with_error(block, ids[7], "right", (0.0, 6.0))
    wrong = with_error(with_error(wrong, ids[20], error=(0.0, 0.0, 15.0)), ids[33], error=(-8.0, 2.0, 0.0))
    found = fg.adjust(wrong, snoop=True, outlier_level=1e-4, multiple_testing="none")
    assert found.snooping.complete
    assert {test.point for test in found.snooping.tests} == {ids[7], ids[20], ids[33]}
    assert len(found.snooping.tests) == 3
    by_point = {test.point: test for test in found.snooping.tests}
    assert [by_point[ids[k]].part for k in (7, 20, 33)] == ["image", "height", "position"]
    for k, planted in ((7, [0.0, 6.0]), (20, [15.0]), (33, [-8.0, 2.0])):
        test = by_point[ids[k]]
        ratio = test.statistic if test.symbol == "t" else np.sqrt(test.statistic * test.dimension)
        sigma = np.linalg.norm(test.error) / ratio  # along the error found
        assert np.abs(test.error - planted).max() < 2.0 * sigma < 0.6 * np.linalg.norm(planted), k
    image = by_point[ids[7]]
    assert (image.name, image.image) == (f"point {ids[7]} in image right", "right")
    assert "px line, sample" in image.sentence()
    assert len(wrong.observations) - len(found.problem.observations) == 1
    assert np.flatnonzero(~found.problem.observed).tolist() == [20, 33]
    assert found.sigma0 < 1.2 < fg.adjust(wrong).sigma0


@pytest.mark.oracle
def test_false_alarms_are_as_rare_as_the_level_says() -> None:
    """In twenty correct blocks at a level of 2 % the rate of alarms is between 1.2 and 2.8 %."""
    alarms, total = 0, 0
    for seed in range(20):
        tests = fg.adjust(all_control(seed=200 + seed)).outlier_tests(level=0.02, control="none")
        alarms, total = alarms + sum(t.suspicious for t in tests), total + len(tests)
    assert total == 20 * (94 + 2 * 47)
    assert 0.012 * total < alarms < 0.028 * total  # 5 sigma of a count of independent alarms


@pytest.mark.oracle
def test_single_ray_names_both_places_of_the_error() -> None:
    """An error at a control point with one ray names image point and position as inseparable."""
    block = all_control()
    j = block.points.ids[12]
    o = block.observations
    block = replace(block, observations=o.take(~((o.point == 12) & (o.image == 1))))
    found = fg.adjust(
        with_error(block, j, "left", (30.0, -40.0)), snoop=True, outlier_level=1e-5, multiple_testing="none"
    )
    assert [test.name for test in found.snooping.tests] == [f"point {j} in image left"]
    assert found.snooping.tests[0].inseparable == (f"position of point {j}",)
    assert "not to be told apart" in found.snooping.tests[0].sentence()
    assert found.snooping.tests[0].error == pytest.approx([30.0, -40.0], abs=1.5)


@pytest.mark.behaviour
def test_what_nothing_checks_is_never_suspected() -> None:
    """A tie point of two rays is tested in one dimension only, with equal statistics of both rays.

    Nothing checks it along the epipolar line.
    """
    solution = fg.adjust(rpc_twin("shift").block)
    tests = {(t.point, t.image): t for t in solution.outlier_tests()}
    check = solution.block.points.ids[int(solution.block.points.where(Role.CHECK)[0])]
    assert tests[check, "left"].dimension == 1
    assert tests[check, "left"].statistic == pytest.approx(tests[check, "right"].statistic, rel=1e-6)


@pytest.mark.behaviour
def test_more_suspects_than_gross_errors_can_be_end_the_search() -> None:
    """With thirty errors among 94 image points the search ends after a quarter and is not complete."""
    block = all_control()
    o = block.observations
    error = np.zeros(len(o))
    error[np.arange(30) * 3] = 5.0 * 1.3 ** np.arange(30)
    found = fg.adjust(replace(block, observations=replace(o, line=o.line + error)), snoop=True)
    assert not found.snooping.complete
    assert len(found.snooping.tests) == len(o) // 4
    assert found.suspicious()
