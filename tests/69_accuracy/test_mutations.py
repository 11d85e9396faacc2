"""Each check of a statistic must fail with a wrong weight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.rows import image_rows, rows_by_image
from fg_orient.model.block import Block
from fg_orient.orientation.orient import judge_observability
from fg_orient.orientation.solution import Solution
from fg_orient.simulate.block import BlockOptions, grid_block

pytestmark = pytest.mark.oracle


@pytest.fixture(scope="module")
def block() -> Block:
    return grid_block(BlockOptions(rows=1, columns=2, points=60, seed=1, check_share=0.2))[0]


@pytest.fixture(scope="module")
def solution(block: Block) -> Solution:
    return fg.adjust(block, eop_set=15)


def wrong(block: Block) -> Block:
    """Halve the line sigma of one image point."""
    sigma = block.observations.sigma_line_px.copy()
    sigma[0] *= 0.5
    return replace(block, observations=replace(block.observations, sigma_line_px=sigma))


def far(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.max(np.abs(np.asarray(a) - b) / np.abs(b)))


def test_singular_values_of_the_images(block: Block, solution: Solution) -> None:
    problem = solution.problem

    def by_numpy(which: Problem) -> np.ndarray:
        _, jacobian, _ = image_rows(which, problem.start, 0, rows_by_image(which)[0], jacobian=True)
        return np.linalg.svd(jacobian.reshape(-1, len(which.parameters[0])), compute_uv=False)

    found = judge_observability(problem)[0].singular_values
    assert far(found, by_numpy(problem)) < 1e-9
    assert far(found, by_numpy(fg.adjust(wrong(block), eop_set=15).problem)) > 1e-6


def test_sigma0_and_ratio_of_check_points(block: Block, solution: Solution) -> None:
    """sigma0 and ratios of check points are those of the full Jacobian, and not those of a wrong weight."""
    other = fg.adjust(wrong(block), eop_set=15)
    check = solution.accuracy.check
    assert len(check) == len(other.accuracy.check) > 5

    def by_numpy(which: Solution) -> tuple[float, np.ndarray]:
        residual, design = assemble(which.problem, which.state)
        q = np.linalg.inv(design.T @ design)
        place = {int(j): k for k, j in enumerate(np.flatnonzero(which.problem.active))}
        first = which.problem.n_image_unknowns
        axes, sigmas = which.problem.axes(which.ground_m[check.index]), []
        for turn, j in zip(axes, check.index, strict=True):
            at = first + 3 * place[int(j)]
            sigmas.append(np.sqrt(np.diag(turn @ q[at : at + 3, at : at + 3] @ turn.T)))
        both = np.hypot(np.array(sigmas), check.own_sigma_enu_m)
        return float(np.sqrt(residual @ residual / which.redundancy)), np.abs(which.accuracy.check.enu_m) / both

    (sigma0, ratio), (other_sigma0, other_ratio) = by_numpy(solution), by_numpy(other)
    assert solution.sigma0 == pytest.approx(sigma0, rel=1e-9)
    assert far(check.ratio, ratio) < 1e-6
    assert solution.sigma0 != pytest.approx(other_sigma0, rel=1e-6)
    assert far(check.ratio, other_ratio) > 1e-4


def test_located_points_with_a_wrong_weight(block: Block, solution: Solution) -> None:
    """CE90 and LE90 of an intersection contain 90 % of drawn errors, and change with another weight."""
    o = block.observations
    point = int(o.point[np.bincount(o.point)[o.point] == 2][0])
    rows = np.flatnonzero(o.point == point)
    pixels = {block.images[o.image[r]].id: (float(o.line[r]), float(o.sample[r])) for r in rows}
    found = solution.intersect(pixels, sigma_px=(0.3, 0.3))
    draws = np.random.default_rng(5).standard_normal((200_000, 3)) @ np.linalg.cholesky(found.covariance_enu_m2).T
    for radius, length in ((found.ce90_m, np.hypot(draws[:, 0], draws[:, 1])), (found.le90_m, np.abs(draws[:, 2]))):
        assert np.mean(length <= radius) == pytest.approx(0.9, abs=4.0 * np.sqrt(0.09 / len(draws)))
        assert np.mean(length <= 1.02 * radius) > 0.9 + 4.0 * np.sqrt(0.09 / len(draws))
    small = replace(block, observations=replace(o, sigma_line_px=0.5 * o.sigma_line_px))
    other = fg.adjust(small, eop_set=15).intersect(pixels, sigma_px=(0.3, 0.3))
    assert abs(other.ce90_m / found.ce90_m - 1.0) > 1e-3
    assert abs(other.le90_m / found.le90_m - 1.0) > 1e-3
