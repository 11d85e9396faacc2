"""The tests check rounds, predictions, re-admission and end of the search for gross errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.loop import IterationRecord
from fg_orient.adjustment.problem import compile_problem
from fg_orient.model.block import Block
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.model.names import Role
from fg_orient.orientation import outlier_search
from fg_orient.quality.outlier_records import OutlierTests
from fg_orient.quality.successive import Exclusion
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block
from tests.support.full_statistics import Dense, turned_rows


def twin(seed: int = 1) -> Block:
    block = zonguldak_block(ZonguldakOptions(seed=seed))[0]
    return replace(block, options=replace(block.options, backend="schur"))


def with_error(block: Block, row: int, line: float, sample: float) -> Block:
    """Add pixels to one image point."""
    o = block.observations
    hit = np.arange(len(o)) == row
    return replace(block, observations=replace(o, line=o.line + line * hit, sample=o.sample + sample * hit))


def row_of(block: Block, role: Role, place: int = 0, image: int = 0) -> int:
    """Return the row of an image point of the place-th point of a role."""
    j = block.points.where(role)[place]
    o = block.observations
    return int(np.flatnonzero((o.point == j) & (o.image == image))[0])


def name_of(block: Block, row: int) -> str:
    o = block.observations
    return f"point {block.points.ids[o.point[row]]} in image {block.images[o.image[row]].id}"


@pytest.mark.oracle
@pytest.mark.parametrize(("backend", "test"), [("graph", "t"), ("dense", "pope"), ("schur", "baarda")])
def test_planted_errors_are_found_in_order(backend: str, test: str) -> None:
    """Two wrong image points are found in one round, largest first, on each backend and with each test.

    They are 6 and 4 px off.
    """
    block = twin()
    first, second = row_of(block, Role.CONTROL, 3), row_of(block, Role.CONTROL, 20, image=1)
    wrong = with_error(with_error(block, first, 6.0, 0.0), second, 0.0, -4.0)
    found = fg.adjust(wrong, snoop=True, backend=backend, outlier_test=test, outlier_level=0.001)
    assert found.snooping.complete
    assert [f.name for f in found.snooping.tests] == [name_of(block, first), name_of(block, second)]
    assert [f.round for f in found.snooping.found] == [1, 1]
    assert [(r.left_out, r.n_suspicious > 0) for r in found.snooping.rounds] == [
        ("; ".join(name_of(block, row) for row in (first, second)), True), ("", False),
    ]  # fmt: skip
    assert found.snooping.tests[0].error == pytest.approx([6.0, 0.0], abs=1.5)
    assert found.snooping.rounds[-1].sigma0 == found.sigma0
    assert found.snooping.rounds[-1].redundancy == found.snooping.rounds[0].redundancy - 4
    assert len(wrong.observations) == len(found.problem.observations) + 2  # the given block stays whole
    assert any("snooping left out 2 observations in 2 rounds" in text for text in found.warnings)


@pytest.mark.oracle
@pytest.mark.parametrize("test", ["t", *(pytest.param(name, marks=pytest.mark.slow) for name in ("pope", "baarda"))])
def test_several_in_a_round_are_those_of_single_rounds(test: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds with several suspects find the observations of single rounds, in at most four rounds.

    The statistics agree within 2 %. Ten blocks have ten errors of 5 to 50 px each. Rays that cannot be separated are
    one suspect.
    """
    for seed in range(10):
        block, rng = twin(seed), np.random.default_rng(seed)
        for row in rng.choice(len(block.observations), 10, replace=False):
            angle, size = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(5.0, 50.0)
            block = with_error(block, int(row), size * np.cos(angle), size * np.sin(angle))
        ends = []
        for most in (1, 50):
            monkeypatch.setattr(outlier_search, "ROUND", most)
            found = fg.adjust(block, snoop=True, outlier_test=test)
            ends.append((
                [{f.name, *f.inseparable} for f in found.snooping.tests], len(found.snooping.rounds),
                [f.statistic for f in found.snooping.tests],
            ))  # fmt: skip
        (single, n, one_by_one), (together, m, predicted) = ends
        assert all(any(a & b for b in together) for a in single)
        assert all(any(a & b for b in single) for a in together)
        assert n > 5 and m <= 4, (n, m)
        assert sorted(predicted) == pytest.approx(sorted(one_by_one), rel=0.02)


@pytest.mark.truth
def test_rays_that_could_both_be_wrong_both_go() -> None:
    """If either of two rays could be wrong, both are rejected, and the point is right within its covariance.

    Of four rays two are parallel; an error along the plane of the rays fits to either of the other rays. If only one of
    both is rejected by chance, the point has an error of 60 standard deviations. Seeds 9 and 28 have such points.
    """
    for seed in (9, 28):
        block, truth = grid_block(BlockOptions(points=200, control_share=0.1, check_share=0.0, seed=seed))
        o, rng = block.observations, np.random.default_rng(seed)
        bad = rng.random(len(o)) < 0.1
        size, angle = np.where(bad, rng.uniform(5.0, 50.0, len(o)), 0.0), rng.uniform(0.0, 2.0 * np.pi, len(o))
        moved = replace(o, line=o.line + size * np.cos(angle), sample=o.sample + size * np.sin(angle))
        found = fg.adjust(replace(block, observations=moved), snoop=True)
        rivals = [f for f in found.snooping.left_out if f.test.inseparable and f.test.part == "image"]
        assert rivals and found.snooping.complete
        kept = found.problem.observations
        rays = np.bincount(kept.point, minlength=len(found.problem.active))
        many = np.flatnonzero(found.problem.active & ~found.problem.observed & (rays >= 3))
        away = (found.ground_m - truth.ecef_m)[many]
        assert found.cofactors is not None
        q = found.cofactors.points(many)
        assert np.einsum("pi,pij,pj->p", away, np.linalg.inv(q), away).max() < 30.0


@pytest.mark.behaviour
def test_what_went_with_it_is_counted_and_named() -> None:
    """If one ray of two is rejected, the other ray and the check point are named, and the accuracy excludes it."""
    block = twin()
    row = row_of(block, Role.CHECK, 2)
    point = block.points.ids[block.observations.point[row]]
    found = fg.adjust(with_error(block, row, 5.0, 1.0), snoop=True, outlier_level=0.001)
    search, solution = found.snooping, found
    assert len(block.observations) - len(solution.problem.observations) == len(search.left_out) + len(search.went_with)
    assert search.went_with == (f"point {point} in image {block.images[1].id}",)
    assert search.check_points == (point,)
    assert len(solution.accuracy.check) == len(block.points.where(Role.CHECK)) - 1
    first, second = solution.warnings[:2]
    assert first.endswith(f"; also left out, as the only remaining rays of their points: {search.went_with[0]}")
    assert second == (
        f"1 check point is not used for the accuracy, because snooping left them fewer than two rays: {point}"
    )
    control = fg.adjust(with_error(block, row_of(block, Role.CONTROL, 2), 5.0, 1.0), snoop=True, outlier_level=0.001)
    assert (control.snooping.went_with, control.snooping.check_points) == ((), ())


def left_out_by_numpy(block: Block, rows: list[int]) -> tuple[int, float]:
    """Return the dimension, and root of F or F, of rows left out.

    They come from sums of squares of the linear problem with and without the rows.
    """
    all_of_it = Dense.of(compile_problem(block))
    v, design = turned_rows(all_of_it.problem, all_of_it.state)
    design = design / np.linalg.norm(design, axis=0)
    squares, freedom = [], []
    for kept in (np.ones(len(v), bool), ~np.isin(np.arange(len(v)), rows)):
        x, _, rank, _ = np.linalg.lstsq(design[kept], -v[kept], rcond=1e-10)
        squares.append(float(np.sum((design[kept] @ x + v[kept]) ** 2)))
        freedom.append(int(kept.sum()) - int(rank))
    d = freedom[0] - freedom[1]
    f = (squares[0] - squares[1]) / d / (squares[1] / freedom[1])
    return d, float(np.sqrt(f)) if d == 1 else f


@pytest.mark.oracle
@pytest.mark.parametrize("role", [Role.CONTROL, Role.CHECK])
def test_prediction_is_the_test_with_the_observation_inside(role: Role) -> None:
    """The test of a rejected ray from the rest equals that with it inside, both by numpy.

    Of a point seen twice without coordinates the other ray is rejected too; both are intersected and tested by what
    remains.
    """
    block = twin()
    row = row_of(block, role, 2)
    wrong = with_error(block, row, 5.0, 1.0)
    searched = fg.adjust(wrong, snoop=True, outlier_level=0.001)
    found, solution = searched.snooping.found, searched
    assert [f.test.name for f in found] == [name_of(block, row)]
    only, fit = found[0], found[0].fit
    assert fit is not None
    assert fit.dimension == only.test.dimension
    dimension, statistic = left_out_by_numpy(wrong, [2 * row, 2 * row + 1])
    assert fit.dimension == dimension
    assert only.test.statistic == pytest.approx(statistic, rel=1e-6)
    assert fit.statistic == pytest.approx(statistic, rel=1e-4)
    assert len(only.with_it) == (role is Role.CHECK)
    if role is Role.CHECK:
        assert fit.dimension == 1
        assert np.isnan(solution.ground_m[block.observations.point[row]]).all()  # no observation determines it any more
        assert only.test.inseparable == only.with_it


@pytest.mark.oracle
@pytest.mark.parametrize("error", [(8.0, 0.0, 0.0), (0.0, 0.0, 30.0)])
def test_prediction_of_coordinates(error: tuple[float, float, float]) -> None:
    """A control point with wrong position or height becomes a tie point, and its test from the rest is numpy's."""
    block = twin()
    j, known = int(block.points.where(Role.CONTROL)[5]), block.points.known
    turn = fg.adjust(block).problem.axes(known.ecef_m[j][None])[0]
    ecef = known.ecef_m.copy()
    ecef[j] += turn.T @ np.array(error)
    wrong = replace(block, points=replace(block.points, known=replace(known, ecef_m=ecef)))
    found = fg.adjust(wrong, snoop=True, outlier_level=0.001)
    only = found.snooping.found[0]
    assert (only.test.point, only.test.part) == (block.points.ids[j], "height" if error[2] else "position")
    assert only.fit is not None
    first = 2 * len(wrong.observations) + 3 * 5
    dimension, statistic = left_out_by_numpy(wrong, [first + 2] if error[2] else [first, first + 1])
    assert only.fit.dimension == only.test.dimension == dimension
    assert only.test.statistic == pytest.approx(statistic, rel=1e-6)
    assert only.fit.statistic == pytest.approx(statistic, rel=1e-3)
    assert found.block.points.roles[j] is Role.TIE
    assert found.snooping.rounds[0].redundancy - found.snooping.rounds[1].redundancy == 3


@pytest.mark.oracle
def test_whole_points() -> None:
    """With ``snoop_kind="points"`` a control point that is wrong in both images is rejected as a whole."""
    block = twin()
    j = int(block.points.where(Role.CONTROL)[8])
    wrong = block
    for row in np.flatnonzero(block.observations.point == j):
        wrong = with_error(wrong, int(row), 6.0, 6.0)
    found = fg.adjust(wrong, snoop=True, outlier_level=0.001, snoop_kind="points")
    only = found.snooping.found[0]
    assert [f.name for f in found.snooping.tests] == [f"point {block.points.ids[j]} with all its observations"]
    assert only.test.dimension == 4
    assert only.fit is not None
    assert only.fit.statistic == pytest.approx(only.test.statistic, rel=1e-3)
    assert not (found.problem.observations.point == j).any()


def leave_out_first(block: Block, rows: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the search begin with wrong choices: good observations, called suspicious."""
    genuine, names, rounds = outlier_search.successive, [name_of(block, row) for row in rows], []

    def chosen(known: object, tests: OutlierTests, *more: object) -> list[Exclusion]:
        rounds.append(tests)
        if len(rounds) > len(names):
            return genuine(known, tests, *more)
        k = next(i for i in range(len(tests)) if tests[i].name == names[len(rounds) - 1])
        return [Exclusion(k, tests[k])]

    monkeypatch.setattr(outlier_search, "successive", chosen)


@pytest.mark.behaviour
def test_what_was_left_out_in_vain_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """A good ray that was rejected first is restored, and only the wrong one stays rejected."""
    block = twin()
    bad, good = row_of(block, Role.CONTROL, 3), row_of(block, Role.CONTROL, 12, image=1)
    wrong = with_error(block, bad, 6.0, 0.0)
    leave_out_first(block, [good], monkeypatch)
    found = fg.adjust(wrong, snoop=True, outlier_level=0.001)
    names = [(f.test.name, f.round, f.readmitted) for f in found.snooping.found]
    assert names[0] == (name_of(block, good), 1, 2)
    assert names[1] == (name_of(block, bad), 3, None)
    assert [(r.left_out, r.put_back) for r in found.snooping.rounds] == [
        (name_of(block, good), ""), ("", name_of(block, good)), (name_of(block, bad), ""), ("", ""),
    ]  # fmt: skip
    assert [f.name for f in found.snooping.tests] == [name_of(block, bad)]
    assert found.chi2 == pytest.approx(fg.adjust(found.block).chi2, rel=1e-9)
    assert "put back after round 2" in found.snooping.found[0].sentence()


@pytest.mark.behaviour
def test_nothing_comes_back_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """An observation that is rejected again after it was restored stays rejected, so that the search ends."""
    block = twin()
    bad, good = row_of(block, Role.CONTROL, 3), row_of(block, Role.CONTROL, 12, image=1)
    leave_out_first(block, [good, good], monkeypatch)
    found = fg.adjust(with_error(block, bad, 6.0, 0.0), snoop=True, outlier_level=0.001)
    same = [f for f in found.snooping.found if f.test.name == name_of(block, good)]
    assert [f.readmitted for f in same] == [2, None]
    assert found.snooping.complete
    assert len(found.snooping.rounds) == 5


@pytest.mark.behaviour
def test_many_errors_end_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """If a fifth of the image points is wrong, the search ends at its limit and states the reason."""
    monkeypatch.setattr(outlier_search, "MOST", 0.05)
    block = twin()
    wrong = block
    rng = np.random.default_rng(4)
    for row in rng.choice(len(block.observations), 20, replace=False):
        wrong = with_error(wrong, int(row), *rng.normal(0.0, 30.0, 2))
    found = fg.adjust(wrong, snoop=True, multiple_testing="none", outlier_level=0.3)
    out, back = len(found.snooping.left_out), sum(f.readmitted is not None for f in found.snooping.found)
    assert not found.snooping.complete
    assert out == int(0.05 * len(block.observations))
    assert len(found.snooping.rounds) <= out + 2 * back + 1
    assert any("given up: 5 % of the image points" in text for text in found.warnings)


@pytest.mark.behaviour
def test_last_control_point_is_not_given_up() -> None:
    """The only control point is not rejected although it is wrong, and the reason is stated.

    Without it there is no datum.
    """
    block = twin()
    roles = [Role.TIE] * len(block.points.ids)
    j = int(block.points.where(Role.CONTROL)[0])
    roles[j] = Role.CONTROL
    points = replace(block.points, roles=tuple(roles))
    alone = replace(block, points=points, withheld=replace(block.withheld, ids=()))
    known = points.known
    ecef = known.ecef_m.copy()
    ecef[[k for k in range(len(roles)) if k != j]] = np.nan
    ecef[j] += 3000.0
    alone = replace(alone, points=replace(points, known=replace(known, ecef_m=ecef)))
    found = fg.adjust(alone, snoop=True, outlier_test="baarda")
    assert "the block cannot be adjusted: no control point" in str(found.snooping.given_up)
    assert block.points.ids[j] in str(found.snooping.given_up)
    assert found.snooping.rounds[-1].left_out == ""
    assert found.problem.observed[j]


@pytest.mark.oracle
@pytest.mark.parametrize(("rows", "columns", "points"), [(1, 4, 300)])
def test_block_of_several_images(rows: int, columns: int, points: int) -> None:
    """Eight wrong image points of checked points are found, and nothing else, also in parts."""
    block, _ = grid_block(BlockOptions(rows=rows, columns=columns, points=points, seed=2))
    rays = np.bincount(block.observations.point)[block.observations.point]
    rng, wrong = np.random.default_rng(5), block
    hit = rng.choice(np.flatnonzero(rays > 2), 8, replace=False)
    for row in hit:
        wrong = with_error(wrong, int(row), *(6.0 * rng.choice([-1.0, 1.0], 2)))
    found = fg.adjust(wrong, snoop=True)
    assert found.snooping.complete
    assert {f.name for f in found.snooping.tests} == {name_of(block, int(row)) for row in hit}
    assert all(r.n_tested <= found.snooping.rounds[0].n_tested for r in found.snooping.rounds)
    parted = fg.adjust(wrong, snoop=True, parts=2)
    assert parted.snooping is not None
    assert [f.test.name for f in parted.snooping.left_out] == [f.name for f in found.snooping.tests]
    assert parted.chi2 == pytest.approx(found.chi2, rel=1e-9)


@pytest.mark.consistency
def test_each_round_begins_where_the_last_one_ended() -> None:
    """The second round of a search begins near its end, and the result is that of a plain adjustment.

    The first round begins at the metadata.
    """
    block = twin()
    first: list[float] = []

    def note(record: IterationRecord) -> None:
        if record.iteration == 1:
            first.append(record.chi2)

    wrong = with_error(block, row_of(block, Role.CONTROL, 3), 6.0, 0.0)
    solution = fg.adjust(wrong, snoop=True, callback=note)
    assert len(first) == 2
    assert first[1] < 2.0 * solution.chi2 < 0.1 * first[0]
    again = fg.adjust(solution.block, snoop=False)
    assert again.snooping is None
    np.testing.assert_allclose(again.state.image, solution.state.image, atol=1e-8)


@pytest.mark.behaviour
def test_refusals() -> None:
    block = twin()
    with pytest.raises(InputError, match="needs least squares: a robust loss"):
        fg.adjust(block, snoop=True, loss="huber")
    with pytest.raises(InputError, match="not allowed"):
        fg.adjust(block, snoop=True, snoop_kind="coordinates")
    with pytest.raises(NoSolutionError, match="no covariance"):
        fg.adjust(block, snoop=True, datum="free", priors=False)
