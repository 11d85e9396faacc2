"""Unseen errors: the stated shift of a point is that of an adjustment with such an error, which no residual shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.model.names import Role
from fg_orient.result import statistics
from fg_orient.simulate.block import BlockOptions, grid_block


@pytest.mark.oracle
def test_shift_is_that_of_an_adjustment_with_the_error() -> None:
    """One ray of a tie point with two is moved by 0.5 px along its unchecked direction: chi2 stays, the point moves."""
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
    record = statistics.reliability_record(solution)
    assert record is not None and record["unseen"]["n"] >= len(two)
    assert record["unseen"]["largest_m"] == pytest.approx(np.nanmax(np.linalg.norm(table, axis=1)))
