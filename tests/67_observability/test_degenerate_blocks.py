"""Each degenerate block ends in a sentence with images, points, free motions and a remedy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fg_orient as fg
from factors.conditions.control import CONTROL_POINT
from fg_orient.adjustment.problem import compile_problem
from fg_orient.adjustment.rows import linearised
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.model.names import Role
from fg_orient.quality.elimination import reduced_rows
from fg_orient.quality.motions import free_motions
from fg_orient.quality.observability import analyse_block
from fg_orient.result.summary import deficient_summary
from tests.support.degenerate_blocks import (
    OFF_LINE,
    ON_LINE,
    options,
    pinhole,
    pushbroom,
    rpc,
    seen_once,
    two_pinhole_blocks,
    with_control,
)


def refused(block: Block, **changes: object) -> fg.RankDeficientError:
    with pytest.raises(fg.RankDeficientError) as caught:
        fg.adjust(block, priors=False, **changes)
    assert caught.value.exit_code == 3
    return caught.value


def motions(error: fg.FgOrientError) -> list[tuple[str, str]]:
    return [(p.place, p.remedy) for p in error.problems if p.code == "statistics.motions"]


# --- no control -----------------------------------------------------------------------------------


@pytest.mark.truth
@pytest.mark.parametrize(("kind", "count"), [("shift", 3), ("shift_drift", 4), ("affine", 7)])
def test_no_control_in_an_rpc_block(kind: str, count: int) -> None:
    """Without control an RPC block is refused with its three, four or seven free motions.

    Images that can only be shifted cannot follow a rotation; therefore three motions are free, not seven. With the
    datum ``priors`` a warning names the motions.
    """
    block = with_control(rpc(kind), ())
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(block, priors=False)
    assert caught.value.exit_code == 2
    assert [p.code for p in caught.value.problems] == ["block.no_control", "statistics.motions"]
    ((place, remedy),) = motions(caught.value)
    assert place.startswith(f"images left, right, no control point: {count} motions are free (shifted together East")
    expected = "measure a control point in images" if kind == "shift" else "measure three control points or more"
    assert remedy.startswith(expected) and "images left, right" in remedy
    held = fg.adjust(block, datum="priors")
    assert held.block_view.n_free_motions == count
    told = f"images left, right, no control point: {count} motions are held by the priors alone"
    assert any(text.startswith(told) and remedy in text for text in held.warnings)


@pytest.mark.truth
@pytest.mark.parametrize(("eop_set", "count"), [(2, 3), (15, 7)])
def test_no_control_in_a_pushbroom_block(eop_set: int, count: int) -> None:
    """Without control a pushbroom block has three free motions for positions only, seven with polynomials."""
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(with_control(pushbroom(), ()), priors=False, eop_set=eop_set)
    ((place, _),) = motions(caught.value)
    assert f"images left, right, no control point: {count} motions are free" in place


@pytest.mark.truth
def test_no_control_in_a_frame_block() -> None:
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(options(pinhole(), datum="control"), priors=False)
    ((place, remedy),) = motions(caught.value)
    assert "images 1, 2, 3, 4, no control point: 7 motions are free" in place
    assert remedy == "measure three control points or more, not on one line, in images 1, 2, 3, 4"


# --- one control point, control points on a line ---------------------------------------------------


@pytest.mark.truth
def test_one_control_point_in_a_frame_block() -> None:
    block = pinhole((6,))
    ((place, remedy),) = motions(refused(block))
    assert place.startswith("images 1, 2, 3, 4, 1 control point only, 7: 4 motions are free")
    assert "turned about X through control point 7" in place and "scaled from control point 7" in place
    assert remedy == "measure at least two more control points, not on a line with 7, in images 1, 2, 3, 4"
    held = fg.adjust(block)
    assert held.status is fg.Status.CONVERGED
    assert sum("may be turned about" in text for text in held.unobservable) == 3
    assert any("4 motions are held by the priors alone" in text and remedy in text for text in held.warnings)
    assert not any("no control point determines the position" in text for text in held.warnings)


@pytest.mark.truth
def test_one_control_point_in_a_pushbroom_block() -> None:
    block = with_control(pushbroom(), pushbroom().points.where(Role.CONTROL)[:1])
    error = refused(block, eop_set=15)
    ((place, _),) = motions(error)
    assert "images left, right, 1 control point only, 01: 4 motions are free" in place
    held = fg.adjust(block, eop_set=15)
    assert any("4 motions are held by the priors alone" in text for text in held.warnings)


@pytest.mark.truth
def test_control_points_on_a_line_in_a_frame_block() -> None:
    block = pinhole(ON_LINE, on_line=True)
    ((place, remedy),) = motions(refused(block))
    assert place.endswith(
        "images 1, 2, 3, 4, 3 control points only, 4, 9, 14: 1 motion is free (turned about the line through "
        "control points 4, 9, 14)"
    )
    assert remedy == "measure at least one control point off the line of 4, 9, 14, in images 1, 2, 3, 4"
    held = fg.adjust(block)
    assert any("1 motion is held by the priors alone" in text and remedy in text for text in held.warnings)
    cured = fg.adjust(pinhole((*ON_LINE, OFF_LINE), on_line=True))
    assert cured.block_view.n_free_motions == 0
    assert cured.unobservable == ()


@pytest.mark.truth
def test_two_control_points_in_pushbroom_and_rpc_blocks() -> None:
    """With two control points the rotation about their line is free, or in an RPC block held by the priors alone.

    An affine compensation resists this motion a little.
    """
    first = pushbroom().points.where(Role.CONTROL)[:2]
    error = refused(with_control(pushbroom(), first), eop_set=15)
    ((place, _),) = motions(error)
    assert "2 control points only, 01, 02: 1 motion is free (turned about the line through" in place
    others = [p.place for p in error.problems if p.code == "adjust.rank_deficient"]
    assert len(others) == 10, "the line's motion is not counted again among the other directions"
    held = fg.adjust(with_control(rpc(), first))
    assert any("1 motion is held by the priors alone (turned about the line" in text for text in held.warnings)


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("make", "parts"),
    [(pushbroom, 1), (rpc, 1), (lambda: pinhole((0, 7, 12, 20)), 1),
     (lambda: two_pinhole_blocks((0, 7, 12, 20, 25, 32, 37, 45)), 2)],
    ids=["pushbroom", "rpc", "pinhole", "two blocks"],
)  # fmt: skip
def test_well_spread_control_leaves_no_motion(make, parts: int) -> None:
    solution = fg.adjust(make())
    assert solution.block_view.n_free_motions == 0
    assert solution.block_view.structure.n_parts == parts
    assert not any("parts" in text or "motion" in text for text in solution.warnings)


# --- two blocks ---------------------------------------------------------------------------------------


@pytest.mark.behaviour
def test_two_blocks_one_of_them_without_control() -> None:
    block = two_pinhole_blocks((0, 7, 12, 20))
    ((place, remedy),) = motions(refused(block))
    assert "images 5, 6, 7, 8, no control point: 7 motions are free" in place
    assert remedy.endswith("in images 5, 6, 7, 8")
    held = fg.adjust(block)
    (parts,) = [text for text in held.warnings if "falls into 2 parts" in text]
    assert "images 1, 2, 3, 4 (25 points, control points 1, 8, 13, 21)" in parts
    assert "images 5, 6, 7, 8 (25 points, no control point)" in parts
    assert all(text.startswith("block: images 5, 6, 7, 8 may be") for text in held.unobservable)
    assert len(held.unobservable) == 7


@pytest.mark.behaviour
def test_images_of_a_pushbroom_pair_that_no_point_links() -> None:
    """Images that no point links are two parts, and an image without image points is refused with its unknowns."""
    block = pushbroom()
    control = block.points.where(Role.CONTROL)
    o = block.observations
    alone = replace(block, observations=o.take(np.isin(o.point, control[:20]) & (o.image == 0)))
    both = analyse_block(compile_problem(options(alone, eop_set=10)))
    assert both.structure.n_parts == 2
    error = refused(alone, eop_set=10)
    assert [p.place for p in error.problems] == ["image right: in no observation, its 3 unknowns are free"]


# --- points seen once ---------------------------------------------------------------------------------


@pytest.mark.behaviour
@pytest.mark.parametrize("make", [pushbroom, rpc])
def test_points_seen_once_without_coordinates_have_no_start_value(make) -> None:
    block = make()
    check = block.points.where(Role.CHECK)[:2]
    once = seen_once(block, check)
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(once)
    assert [p.code for p in caught.value.problems] == ["initial.seen_once"] * 2
    o = once.observations
    only = [block.images[int(o.image[o.point == j][0])].id for j in check]
    rest = "only and has no control coordinates: it can move along its ray"
    told = [f"the point is seen in image {image} {rest}" for image in only]
    assert [p.message for p in caught.value.problems] == told
    assert [p.place for p in caught.value.problems] == [f"point {block.points.ids[j]}" for j in check]


# --- what the sentences rest on -----------------------------------------------------------------------


@pytest.mark.truth
def test_motions_of_pinhole_images_are_exact() -> None:
    """A pinhole block without datum has seven motions with singular values at rounding, and a sentence for each.

    A similarity of cameras and ground changes no pixel.
    """
    view = analyse_block(compile_problem(pinhole()))
    assert view.counts == {"unobservable": 7, "held_by_the_prior": 9, "determined": 20}
    assert view.motions[0].strength.max() < 1e-11
    assert view.unexplained == 0 and len(view.sentences) == 7


@pytest.mark.oracle
def test_counts_are_those_of_the_full_jacobian() -> None:
    """The block's singular values are those of the dense Jacobian with the points eliminated by numpy."""
    from fg_orient.adjustment.dense import assemble

    for block, changes in ((pushbroom(), {"eop_set": 16}), (pinhole((0, 9)), {})):
        problem = compile_problem(options(block, priors=False, **changes))
        design, u = assemble(problem, problem.start)[1], problem.n_image_unknowns
        a, b = design[:, :u], design[:, u:]
        left = a - b @ np.linalg.lstsq(b, a, rcond=None)[0]
        s = np.linalg.svd(left, compute_uv=False)
        found = analyse_block(problem).singular_values
        assert found == pytest.approx(s, rel=1e-6, abs=1e-9 * s[0])


@pytest.mark.truth
def test_images_that_do_not_follow_have_no_motion() -> None:
    """An RPC pair with shifts has three motions; without the test whether images follow it would have seven."""
    from fg_orient.quality import motions as module

    problem = compile_problem(options(with_control(rpc("shift"), ()), datum="priors"))
    rows = linearised(problem, problem.start)
    reduced = reduced_rows(problem, rows)

    def rest(moves: np.ndarray, _: np.ndarray) -> np.ndarray:
        return np.asarray(reduced @ moves)

    assert len(free_motions(problem, rows, rest, np.arange(2))) == 3
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "FOLLOWED", np.inf)
        assert len(free_motions(problem, rows, rest, np.arange(2))) == 7


@pytest.mark.consistency
def test_large_blocks_are_judged_without_elimination() -> None:
    """The motions found without elimination of the points are the same as with it."""
    for block in (pinhole((6,)), pinhole(ON_LINE, on_line=True), two_pinhole_blocks((0, 7, 12, 20))):
        problem = compile_problem(block)
        a, b = analyse_block(problem), analyse_block(problem, whole=False)
        assert [m.words for m in a.motions] == [m.words for m in b.motions]
        assert b.counts is None and a.counts is not None


@pytest.mark.consistency
def test_some_points_tell_the_motions_of_large_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    from fg_orient.quality import deficiency

    monkeypatch.setattr(deficiency, "affordable", lambda problem: False)
    monkeypatch.setattr(deficiency, "ENOUGH", 40)
    solution = fg.adjust(pinhole((6,)))
    assert solution.block_view.n_free_motions == 4
    assert solution.block_view.as_dict()["determined"] is None
    assert any("1 control point only, 7: 4 motions are held" in text for text in solution.warnings)


@pytest.mark.behaviour
def test_own_observations_hold_what_they_see() -> None:
    """One control point and extra observations of two more points leave no motion free."""
    block = pinhole((6,))
    start = compile_problem(block).start.ground
    own = tuple(
        ExtraObservation(
            CONTROL_POINT, (f"point:{block.points.ids[j]}",), np.concatenate([20.0 * np.eye(3).ravel(), start[j]]),
            np.zeros((2, 0)), 3, f"own observation of point {j}",
        )
        for j in (0, 20)
    )  # fmt: skip
    assert motions(refused(block))
    solution = fg.adjust(replace(block, extra=own), priors=False)
    assert solution.block_view.n_free_motions == 0
    assert solution.unobservable == ()


@pytest.mark.behaviour
def test_record_of_a_refused_block_has_every_sentence() -> None:
    error = refused(pinhole((6,)))
    record = deficient_summary(error, pinhole((6,)))
    assert record["status"] == "rank_deficient"
    assert record["unobservable"] == [p.place for p in error.problems]
    assert [e["remedy"] for e in record["errors"]] == [p.remedy for p in error.problems]
