"""The stated shift of a point is that of an adjustment with an error that no residual shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, ncx2

import fg_orient as fg
from fg_orient.adjustment.rows import linearised
from fg_orient.model.names import Role
from fg_orient.quality.reliability import UNSEEN, noncentrality, unseen_shifts
from fg_orient.result import statistics
from fg_orient.simulate.block import BlockOptions, grid_block


@pytest.mark.oracle
def test_shift_is_that_of_an_adjustment_with_the_error() -> None:
    """An error along the unchecked direction of a ray moves the point as the table states, and chi2 stays.

    Each ray of a point with two is moved by 0.5 px.
    """
    block, _ = grid_block(BlockOptions(points=80, seed=4))
    solution = fg.adjust(block)
    found = statistics.reliability_of(solution)
    assert found is not None
    o, problem = solution.problem.observations, solution.problem
    columns = statistics.point_columns(solution)
    table = np.column_stack([np.asarray(columns[f"unseen_{axis}_m"]) for axis in ("east", "north", "up")])
    rays = np.bincount(o.point, minlength=len(problem.active))
    tie = np.array([role is Role.TIE for role in block.points.roles])
    two = np.flatnonzero((rays == 2) & tie)
    assert np.isfinite(table[two]).all() and np.isnan(table[(rays > 3) & tie]).all()
    for j in two[:3].tolist():
        shifts = []
        for row in np.flatnonzero(o.point == j).tolist():
            line, sample = o.line.copy(), o.sample.copy()
            line[row] += 0.5 * found.image.direction[row, 0]
            sample[row] += 0.5 * found.image.direction[row, 1]
            moved = fg.adjust(replace(block, observations=replace(block.observations, line=line, sample=sample)))
            assert moved.chi2 == pytest.approx(solution.chi2, abs=1e-3)
            axes = problem.axes(solution.ground_m[j][None])[0]
            shifts.append(2.0 * axes @ (moved.ground_m[j] - solution.ground_m[j]))
        largest = max(shifts, key=lambda shift: float(np.linalg.norm(shift)))
        sign = np.sign(largest @ table[j])
        assert sign * largest == pytest.approx(table[j], rel=5e-3, abs=5e-3)
    record = statistics.unseen_record(solution)
    assert record is not None and record["n"] >= len(two)
    assert record["largest_m"] == pytest.approx(np.nanmax(np.linalg.norm(table, axis=1)))


@pytest.mark.oracle
def test_limit_is_delta_bar_of_three_rays_in_a_plane() -> None:
    """A point of three or more rays has an unseen shift only if its delta-bar exceeds the limit.

    delta-bar follows from the intersection of the other rays; two of three may be nearly parallel.
    """
    block, _ = grid_block(BlockOptions(points=80, seed=4, control_share=0.1))
    solution = fg.adjust(block)
    o, problem = solution.problem.observations, solution.problem
    shifts = unseen_shifts(solution.residual_cofactors)
    assert solution.cofactors is not None
    rays = np.bincount(o.point, minlength=len(problem.active))
    delta = noncentrality(dimension=2)
    assert ncx2.sf(chi2.isf(0.001, 2), 2, delta) == pytest.approx(0.8)
    for j in np.flatnonzero(problem.active & ~problem.observed & (rays >= 3)).tolist():
        own = np.flatnonzero(o.point == j)
        largest = 0.0
        ground = linearised(problem, solution.state, own).ground
        for k in range(len(own)):  # images held: slightly larger than with the cofactors of the images
            rest = np.delete(ground, k, axis=0).reshape(-1, 3)
            spread = ground[k] @ np.linalg.inv(rest.T @ rest) @ ground[k].T
            largest = max(largest, float(np.sqrt(delta * np.linalg.eigvalsh(spread)[-1])))
        assert (largest > UNSEEN) == np.isfinite(shifts[j, 0])
        assert largest > 2.0 * UNSEEN or largest < 0.5 * UNSEEN


@pytest.mark.consistency
def test_final_weights_of_a_loss_tell_the_same_points() -> None:
    """Under a loss that down-weights nothing the unseen shifts are those of least squares, with their record."""
    block, _ = grid_block(BlockOptions(points=80, seed=4))
    solution, robust = fg.adjust(block), fg.adjust(block, loss="tls", gnc=True, inlier_probability=1.0 - 1e-12)
    assert robust.weights is not None and robust.weights.image.min() > 1.0 - 1e-12
    expected = unseen_shifts(solution.residual_cofactors)
    assert unseen_shifts(robust.residual_cofactors) == pytest.approx(expected, rel=1e-4, nan_ok=True)
    columns = statistics.point_columns(robust)
    assert set(columns) == {f"unseen_{axis}_m" for axis in ("east", "north", "up")}
    record = statistics.unseen_record(robust)
    assert record is not None and record["n"] == np.isfinite(expected[:, 0]).sum()
