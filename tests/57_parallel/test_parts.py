"""A block in parts gives the steps, solutions, cofactors and files of the block in one part."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fg_orient as fg
from fg_orient.adjustment import memory
from fg_orient.adjustment.dense import assemble
from fg_orient.adjustment.irls import find_loss
from fg_orient.adjustment.loop import OPTIMIZERS
from fg_orient.adjustment.parts import parts as parts_module
from fg_orient.adjustment.parts import tasks
from fg_orient.adjustment.parts.backend import PartedBackend
from fg_orient.adjustment.parts.execution import Execution
from fg_orient.adjustment.parts.parts import divide, part_file, read_part, rows_of
from fg_orient.adjustment.parts.pool import Pool
from fg_orient.adjustment.parts.solve import solve_in_parts
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.robust import scaled, weighted_problem
from fg_orient.adjustment.rows import release
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.solve import solve
from fg_orient.adjustment.stages import EXACT, PLAIN, Graduated
from fg_orient.model.block import Block, ExtraObservation
from fg_orient.quality.covariance import cofactors_of
from tests.support.full_statistics import after_numpy, step_of_numpy
from tests.support.parallel_block import block
from tests.support.rpc_block import rpc_twin
from tests.support.states import largest, moved

#: Agreement asked of a partitioned run, prior sigmas; points within the same in units of 100 m.
SIGMAS, METRES = 1e-9, 1e-7


def with_options(problem: Problem, **options: object) -> Problem:
    return compile_problem(replace(problem.block, options=replace(problem.block.options, **options)))


@pytest.mark.behaviour
@pytest.mark.parametrize("count", [1, 2, 7, 60])
def test_parts_hold_every_point_and_ray_once(problem: Problem, count: int) -> None:
    points = divide(problem, count)
    rows = rows_of(problem, points)
    assert [len(p) > 0 for p in points] == [True] * count
    seen = np.unique(problem.observations.point)
    np.testing.assert_array_equal(np.sort(np.concatenate(points)), seen)
    np.testing.assert_array_equal(np.sort(np.concatenate(rows)), np.arange(len(problem.observations)))
    for p, r in zip(points, rows, strict=True):
        assert set(problem.observations.point[r]) == set(p)
    rays = np.bincount(problem.observations.point)
    work = [int((rays[p] * (rays[p] + 1) // 2).sum()) for p in points]
    heaviest = int((rays * (rays + 1) // 2).max())
    assert max(work) <= sum(work) / count + heaviest


@pytest.mark.behaviour
def test_the_number_of_parts_follows_from_the_block(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    n = len(problem.observations)
    for size, expected in ((n, 1), (n - 1, 2), (1, n)):
        monkeypatch.setattr(memory, "PART_SIZE", size)
        assert memory.default_parts(n) == min(expected, memory.MAX_PARTS)


@pytest.mark.oracle
@settings(max_examples=6, deadline=None, derandomize=True)
@given(st.data())
def test_a_step_in_parts_is_the_step_in_one_piece_and_of_numpy(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """For any options and number of parts the step equals that in one part and numpy's.

    Error, length, norm, predicted error and next state are compared.
    """
    problem = with_options(
        compile_problem(block()), eop_set=data.draw(st.integers(1, 20), label="set"),
        look_polynomial=data.draw(st.sampled_from([None, 1]), label="look"),
        check_points=data.draw(st.sampled_from(["use", "exclude"]), label="check"),
    )  # fmt: skip
    damping, state = data.draw(st.sampled_from([0.0, 1e-2, 10.0]), label="damping"), moved(problem, 1)
    count = data.draw(st.integers(1, 12), label="parts")
    one = SchurBackend(problem)
    parted = PartedBackend(problem, Pool(), tmp_path_factory.mktemp("work"), count)
    a, b = one.linearise(state), parted.linearise(state)
    assert b.error == pytest.approx(a.error, rel=1e-12)
    step, ours = a.solve(damping), b.solve(damping)
    size = max(1.0, step.length)
    image, ground = largest(problem, one.retract(state, step), parted.retract(state, ours))
    assert image <= SIGMAS * size and ground <= METRES * size
    assert ours.length == pytest.approx(step.length, rel=1e-7)
    assert ours.norm == pytest.approx(step.norm, rel=1e-7)
    assert ours.predicted_error == pytest.approx(step.predicted_error, rel=1e-9)
    newton = a.solve(0.0).norm
    image, ground = largest(problem, after_numpy(problem, state), parted.retract(state, b.solve(0.0)))
    assert max(image, ground) <= 1e-7 * max(1.0, newton)
    for radius in (1e-3 * newton, 0.5 * newton):
        step, ours = a.dogleg(radius), b.dogleg(radius)
        assert ours.norm == pytest.approx(min(radius, newton), rel=1e-7)
        image, ground = largest(problem, one.retract(state, step), parted.retract(state, ours))
        assert max(image, ground) <= 1e-7 * max(1.0, newton)
        assert ours.predicted_error == pytest.approx(step.predicted_error, rel=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize(("optimizer", "loss"), [*((name, "none") for name in OPTIMIZERS), ("dogleg", "huber")])
def test_solution_and_cofactors_in_parts(problem: Problem, optimizer: str, loss: str) -> None:
    chosen = with_options(problem, optimizer=optimizer, loss=loss)
    whole, parted = solve(chosen), solve_in_parts(chosen, Execution(parts=5))
    assert whole.converged and parted.converged
    image, ground = largest(chosen, whole.state, parted.state)
    assert image <= SIGMAS and ground <= METRES
    assert parted.chi2 == pytest.approx(whole.chi2, rel=1e-12)
    weighting = None if loss == "none" else scaled(find_loss(loss))
    image, ground = step_of_numpy(chosen, parted.state, weighting)
    assert image <= 1e-6 and ground <= 1e-4  # reweighted steps shrink by a tenth each
    theirs, ours = (
        cofactors_of(chosen if e.weights is None else weighted_problem(chosen, e.weights), e) for e in (whole, parted)
    )
    tie, control = int(np.flatnonzero(~chosen.observed & chosen.active)[0]), int(np.flatnonzero(chosen.observed)[0])
    for a, b in (
        (theirs.image(3), ours.image(3)), (theirs.point(tie), ours.point(tie)),
        (theirs.joint((4, 1), (control, tie)), ours.joint((4, 1), (control, tie))),
    ):  # fmt: skip
        scale = np.sqrt(np.outer(np.diag(a), np.diag(a)))
        np.testing.assert_allclose(b / scale, a / scale, rtol=0.0, atol=1e-9)


@pytest.mark.consistency
@pytest.mark.parametrize(
    ("optimizer", "loss"), [("gauss-newton", "none"), pytest.param("dogleg", "huber", marks=pytest.mark.slow)]
)
def test_parts_that_are_opened_again_give_the_same_bits(problem: Problem, optimizer: str, loss: str) -> None:
    """With one or three of five parts open at once the solution has the same bits as with all.

    Records are computed part by part.
    """
    chosen = with_options(problem, optimizer=optimizer, loss=loss)
    release(chosen, "records")
    every = solve_in_parts(chosen, Execution(parts=5))
    for kept in (1, 3):
        some = solve_in_parts(chosen, Execution(parts=5, kept=kept))
        assert some.state.image.tobytes() == every.state.image.tobytes() and some.chi2 == every.chi2
        np.testing.assert_array_equal(some.state.ground, every.state.ground)
    assert "records" not in vars(chosen)
    held = solve_in_parts(with_options(problem, optimizer=optimizer, loss=loss), Execution(parts=5))
    assert held.state.image.tobytes() == every.state.image.tobytes()


@pytest.mark.behaviour
def test_no_more_parts_are_open_than_allowed(problem: Problem, tmp_path: Path) -> None:
    parted = PartedBackend(problem, Pool(), tmp_path, 5, kept=2)
    for _ in range(3):
        parted.error(problem.start)
        assert sum(folder == str(tmp_path) for folder, _ in tasks._PARTS) == 2
    tasks.forget(str(tmp_path))


@pytest.mark.oracle
def test_losses_that_change_reach_the_parts(problem: Problem, tmp_path: Path) -> None:
    plan, state = Graduated.of(replace(problem.block.options, loss="tls", gnc=True)), moved(problem, 2)
    one, parted = SchurBackend(problem), PartedBackend(problem, Pool(), tmp_path, 4)
    for a, b in zip(one.squares(state), parted.squares(state), strict=True):
        np.testing.assert_allclose(np.sort(b), np.sort(a), rtol=1e-12)
    errors = []
    for mu in (PLAIN, 1e-4, 1e-2, EXACT):
        one.robust = parted.robust = plan.robust(mu)
        errors.append(one.error(state))
        assert parted.error(state) == pytest.approx(errors[-1], rel=1e-12)
        a, b = one.linearise(state).solve(0.0), parted.linearise(state).solve(0.0)
        np.testing.assert_allclose(b.image, a.image, rtol=0.0, atol=1e-9 * max(1.0, a.length))
        numpys = after_numpy(problem, state, plan.robust(mu)).image - state.image
        after = parted.retract(state, b).image - state.image
        np.testing.assert_allclose(after, numpys, rtol=0.0, atol=1e-6 * max(1.0, float(np.abs(numpys).max())))
    assert len(set(errors)) == 4


@pytest.mark.oracle
@pytest.mark.slow
def test_graduated_non_convexity_in_parts(problem: Problem) -> None:
    """Graduated non-convexity in parts ends at the solution of one part, a minimum of the loss by numpy.

    Its stages change the losses and use all residuals.
    """
    line = problem.block.observations.line.copy()
    line[::17] += 40.0
    spoilt = replace(problem.block, observations=replace(problem.block.observations, line=line))
    chosen = with_options(replace(problem, block=spoilt), loss="tls", gnc=True)
    whole, parted = solve(chosen), solve_in_parts(chosen, Execution(parts=4))
    assert whole.converged and parted.converged
    image, ground = largest(chosen, whole.state, parted.state)
    assert image <= SIGMAS and ground <= METRES
    last = Graduated.of(chosen.block.options).robust(EXACT)
    image, ground = step_of_numpy(chosen, parted.state, last)
    assert image <= SIGMAS and ground <= METRES


@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["shift", "affine"])
def test_images_with_rational_functions_in_parts(kind: str) -> None:
    twin = rpc_twin(kind).block
    problem = compile_problem(replace(twin, options=replace(twin.options, backend="schur")))
    image, ground = step_of_numpy(problem, solve_in_parts(problem, Execution(parts=3)).state)
    assert image <= SIGMAS and ground <= METRES


@pytest.mark.oracle
def test_adjust_takes_parts(small: Block) -> None:
    whole, parted = fg.adjust(small), fg.adjust(small, parts=3)
    assert parted.status == whole.status and parted.backend == "schur"
    assert parted.sigma0 == pytest.approx(whole.sigma0, rel=1e-12)
    image, ground = step_of_numpy(parted.problem, parted.state)
    assert image <= SIGMAS and ground <= METRES
    np.testing.assert_allclose(parted.ground_m, whole.ground_m, rtol=0.0, atol=METRES)
    for role in ("control", "check"):
        a, b = (getattr(s.accuracy, role).statistics() for s in (whole, parted))
        assert b == pytest.approx(a, rel=1e-6, abs=1e-9)


@pytest.mark.oracle
def test_a_state_from_elsewhere_is_written_for_the_parts(problem: Problem, tmp_path: Path) -> None:
    backend, state = PartedBackend(problem, Pool(), tmp_path, 4), moved(problem, 3)
    for error, at in ((backend.error(state), state), (backend.error(backend.initial()), problem.start)):
        residual, _ = assemble(problem, at)
        assert error == pytest.approx(0.5 * residual @ residual, rel=1e-12)
    step = backend.linearise(state).solve(0.0)
    with pytest.raises(ValueError, match="another state"):
        backend.retract(problem.start, step)
    np.testing.assert_array_equal(backend.initial().ground, problem.start.ground)


@pytest.mark.behaviour
def test_the_work_folder_does_not_grow_and_is_removed(problem: Problem, tmp_path: Path) -> None:
    counts = Counter[int]()

    def count(_: object) -> None:
        (folder,) = tmp_path.glob(".*.tmp")
        counts[len(list(folder.glob("ground-*")))] += 1

    chosen = with_options(problem, optimizer="levenberg-marquardt")
    assert solve_in_parts(chosen, Execution(parts=3, work_dir=tmp_path), count).iterations > 3
    assert max(counts) <= 3 * 4
    assert list(tmp_path.iterdir()) == []


@pytest.mark.behaviour
def test_parts_that_cannot_be_read_are_named(problem: Problem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part of another version, incomplete or missing is refused with the folder's option as remedy."""
    PartedBackend(problem, Pool(), tmp_path, 2)
    path = part_file(tmp_path, 1)

    def refusal(number: int) -> Any:
        with pytest.raises(fg.InputError) as caught:
            read_part(str(tmp_path), number)
        return caught.value.problems[0]

    with monkeypatch.context() as patch:
        patch.setattr(parts_module, "__version__", "9.9.9")
        assert refusal(1).code == "parallel.version"
    path.write_bytes(path.read_bytes()[:1000])
    for number in (1, 2):
        assert refusal(number).code == "parallel.folder"
        assert "option work_dir" in refusal(number).remedy


@pytest.mark.behaviour
def test_a_value_that_is_not_finite_names_its_point(problem: Problem) -> None:
    records = problem.records.copy()
    records[7] = np.nan
    with pytest.raises(fg.NoSolutionError) as caught:
        solve_in_parts(replace(problem, records=records), Execution(parts=3))
    assert problem.label(7) in str(caught.value)


@pytest.mark.behaviour
def test_refusals(small: Block, tmp_path: Path) -> None:
    def code(block: Block, **execution: object) -> str:
        with pytest.raises(fg.InputError) as caught:
            fg.adjust(block, **execution)
        return caught.value.problems[0].code

    assert code(small, parts=10_000) == "parallel.parts"
    assert code(small, parts=0) == code(small, workers=-1) == code(small, workers=100_000) == "parallel.number"
    assert code(replace(small, options=replace(small.options, backend="dense")), parts=2) == "parallel.backend"
    assert code(small, parts=2, work_dir=tmp_path / "missing") == "output.unwritable"
    assert code(small, work_dir=tmp_path) == "parallel.no_parts"


@pytest.mark.behaviour
def test_own_observations_are_refused(small: Block) -> None:
    from factors.conditions.control import CONTROL_POINT

    name = f"point:{small.points.ids[0]}"
    record = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
    extra = ExtraObservation(CONTROL_POINT, (name,), record, np.zeros((2, 0)), 3, "own")
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(replace(small, extra=(extra,)), parts=2)
    assert caught.value.problems[0].code == "adjust.schur"
