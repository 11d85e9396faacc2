"""Released records of image points are computed again, all or some of them, with the same bits."""

from __future__ import annotations

import numpy as np
import pytest

from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.rows import linearised, release
from fg_orient.orientation.orient import adjust
from fg_orient.quality import doubts
from fg_orient.simulate.block import BlockOptions, grid_block


@pytest.mark.consistency
def test_released_records_are_computed_again() -> None:
    problem = compile_problem(grid_block(BlockOptions(points=300))[0])
    before, rows = problem.records.copy(), np.arange(5, 200, 7)
    release(problem, "records")
    assert "records" not in vars(problem)
    some = linearised(problem, problem.start, rows)
    assert "records" not in vars(problem), "only the rows were computed"
    again = linearised(problem, problem.start)
    assert np.array_equal(problem.records, before)
    for one, every in zip(some, again, strict=True):
        assert np.array_equal(one, every[rows])


@pytest.mark.behaviour
def test_statistics_of_a_large_block_do_not_compute_the_records_again(monkeypatch: pytest.MonkeyPatch) -> None:
    block = grid_block(BlockOptions(points=1300))[0]
    expected = adjust(block)
    monkeypatch.setattr(doubts, "MANY_ROWS", 100)
    solution = adjust(block)
    assert "records" not in vars(solution.problem)
    record = solution.result.record
    assert "records" not in vars(solution.problem)
    assert record["reliability"] == expected.result.record["reliability"]
