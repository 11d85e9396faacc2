"""If a block is nearly equal to a compiled one, the unchanged arrays are reused and the problem is the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fg_orient.adjustment import problem as module
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.rows import held, unchanged_rows
from fg_orient.model.block import Block, Coordinates, GroundPoints
from fg_orient.model.names import Role
from fg_orient.simulate.block import BlockOptions, grid_block

pytestmark = pytest.mark.consistency


@pytest.fixture(scope="module")
def block() -> Block:
    return grid_block(BlockOptions(rows=1, columns=3, points=40, seed=3))[0]


@pytest.fixture(scope="module")
def full(block: Block) -> Problem:
    return held(compile_problem(block), "records")


def without(block: Block, row: int) -> Block:
    """Return the block without an image point."""
    return replace(block, observations=block.observations.take(np.arange(len(block.observations)) != row))


def assert_equal(found: Problem, expected: Problem) -> None:
    """Assert that two problems are equal, with start values to 1e-8 m.

    Start values are intersected with other rays in one call. The whitening is a numerical derivative over a pixel: 1e-9
    m changes a difference of look angles of 1e-6 rad from 8e5 m by 1e-9 of it.
    """
    np.testing.assert_allclose(found.start.ground, expected.start.ground, rtol=0, atol=1e-8)
    whitening = slice(22, 26)
    scale = np.abs(expected.records[:, whitening]).max()
    np.testing.assert_allclose(found.records[:, whitening], expected.records[:, whitening], rtol=0, atol=1e-9 * scale)
    others = np.delete(np.arange(expected.records.shape[1]), np.r_[whitening])
    away, size = np.abs(found.records - expected.records)[:, others], np.abs(expected.records[:, others])
    assert (away <= 1e-12 * size + 1e-8 * np.minimum(size.max(axis=0), 1.0)).all()  # metres, radians, and their slopes
    np.testing.assert_allclose(found.control_records, expected.control_records, rtol=1e-12, atol=1e-8)
    assert np.array_equal(found.active, expected.active)
    assert np.array_equal(found.observed, expected.observed)


@pytest.mark.parametrize("role", [Role.TIE, Role.CONTROL, Role.CHECK])
def test_one_image_point_less_and_back(
    block: Block, full: Problem, role: Role, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If an image point is removed or returned, only the rows of its ground point are computed again."""
    o, rays = block.observations, np.bincount(block.observations.point)
    point = next(int(j) for j in block.points.where(role) if rays[j] > 2)
    smaller, made = without(block, int(np.flatnonzero(o.point == point)[0])), []
    expected, genuine = held(compile_problem(smaller), "records"), module.whitened_records
    monkeypatch.setattr(module, "whitened_records", lambda m, own, *rest: made.append(own) or genuine(m, own, *rest))
    found = compile_problem(smaller, full)
    assert_equal(found, expected)
    assert_equal(compile_problem(block, found), full)
    assert [set(own.point.tolist()) for own in made] == [{point}] * 2
    assert [len(own) for own in made] == [rays[point] - 1, rays[point]]


def test_a_control_point_that_becomes_a_tie_point_is_intersected(block: Block, full: Problem) -> None:
    known, j = block.points.known, int(block.points.where(Role.CONTROL)[0])
    gone = np.arange(len(known.ecef_m)) == j
    roles = tuple(Role.TIE if away else role for away, role in zip(gone, block.points.roles, strict=True))
    points = GroundPoints(block.points.ids, roles, Coordinates(
        np.where(gone[:, None], np.nan, known.ecef_m), np.where(gone[:, None], np.nan, known.sigma_enu_m), known.fixed,
    ))  # fmt: skip
    changed = replace(block, points=points)
    assert_equal(compile_problem(changed, full), compile_problem(changed))
    assert np.linalg.norm(compile_problem(changed, full).start.ground[j] - full.start.ground[j]) > 0.1


def test_other_pixels_sigmas_and_options_are_not_taken_for_the_same(block: Block, full: Problem) -> None:
    o = block.observations
    hit = np.arange(len(o)) == 5
    for other in (replace(o, line=o.line + hit), replace(o, sigma_sample_px=o.sigma_sample_px * (1.0 + hit))):
        changed = replace(block, observations=other)
        assert (unchanged_rows(full, changed, other) < 0).tolist() == (o.point == o.point[5]).tolist()
        assert_equal(compile_problem(changed, full), compile_problem(changed))
    eop = replace(block, options=replace(block.options, eop_set=1))
    codes = compile_problem(eop).parameters[0].codes
    assert compile_problem(eop, full).parameters[0].codes == codes != full.parameters[0].codes


def test_a_point_measured_twice_alike(block: Block) -> None:
    """If one of two equal image points is removed, the rows of its ground point count as changed."""
    o = block.observations
    twice = replace(block, observations=o.take(np.r_[np.arange(len(o)), 0]))
    once = unchanged_rows(compile_problem(twice), block, o)
    assert (once < 0).tolist() == (o.point == o.point[0]).tolist()
