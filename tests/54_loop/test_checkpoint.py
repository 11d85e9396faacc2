"""A run that is stopped and resumed ends with the same bits; a file of another problem is refused."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fg_orient.adjustment import checkpoint as module
from fg_orient.adjustment.checkpoint import Checkpoint, fingerprint
from fg_orient.adjustment.loop import OPTIMIZERS, Carried, IterationRecord
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.solve import Estimate, solve
from fg_orient.model.errors import InputError
from fg_orient.orientation.run import checkpoint_path, run_project
from fg_orient.simulate.block import BlockOptions, simulate_block
from tests.support.command import in_process as run

from .conftest import spoiled_block, with_options

#: Runs a project as the command does and kills itself, hard, when an iteration has been told of.
KILLED = """
import os, signal, sys
from fg_orient.orientation.run import run_project
def stop(record):
    if record.iteration == int(sys.argv[3]):
        os.kill(os.getpid(), signal.SIGKILL)
run_project(sys.argv[1], sys.argv[2], options=eval(sys.argv[4]), callback=stop, checkpoint_every_s=0.0)
"""


def spoiled(**options: Any) -> Problem:
    block, _ = spoiled_block((3.0, 6.0), 2, 2, 40)
    return compile_problem(with_options(block, **options))


class Stopped(Exception):
    """The exception stands for the end of the process."""


def solve_in_two(problem: Problem, path: Path, after: int, monkeypatch: pytest.MonkeyPatch) -> Estimate:
    """Stop after an iteration has been written, then go on in a new run."""

    def keep(self: Checkpoint, problem: Problem, backend: str, carried: Carried[Any]) -> None:
        original(self, problem, backend, carried)
        if len(carried.log) >= after:
            raise Stopped

    original = Checkpoint.keep
    with monkeypatch.context() as patch, pytest.raises(Stopped):
        patch.setattr(Checkpoint, "keep", keep)
        solve(problem, checkpoint=Checkpoint(path, every_s=0.0))
    told: list[IterationRecord] = []
    found = solve(problem, told.append, checkpoint=Checkpoint(path, every_s=0.0, resume=True))
    assert [r.iteration for r in told] == list(range(1, len(found.log) + 1))
    assert found.resumed_at >= after
    return found


def assert_same_bits(a: Estimate, b: Estimate) -> None:
    assert np.array_equal(a.state.image, b.state.image)
    assert np.array_equal(a.state.ground, b.state.ground, equal_nan=True)
    assert a.chi2 == b.chi2
    assert (a.converged, a.reason, a.iterations) == (b.converged, b.reason, b.iterations)
    for one, other in zip(a.log, b.log, strict=True):
        assert repr(replace(one, seconds=0.0)) == repr(replace(other, seconds=0.0))


@pytest.mark.consistency
@pytest.mark.parametrize(("backend", "optimizer"), [*(("schur", o) for o in OPTIMIZERS), ("graph", "dogleg")])
def test_resumed_run_has_the_same_bits(
    backend: str, optimizer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that stops after the third of seven iterations and resumes has the bits of an uninterrupted one."""
    problem = spoiled(optimizer=optimizer, backend=backend, loss="cauchy", max_iterations=7)
    assert_same_bits(solve_in_two(problem, tmp_path / "file", 3, monkeypatch), solve(problem))


@pytest.mark.consistency
def test_resumed_stages_have_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = spoiled(optimizer="levenberg-marquardt", backend="schur", loss="tls", gnc=True)
    whole = solve(problem)
    assert whole.converged
    assert len(dict.fromkeys(r.mu for r in whole.log)) > 5
    for after in (2, len(whole.log) - 1):
        assert_same_bits(solve_in_two(problem, tmp_path / "file", after, monkeypatch), whole)


@pytest.mark.consistency
def test_rejected_steps_are_carried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that stops among rejected steps resumes with the same bits.

    A start 30000 prior sigmas off makes Levenberg-Marquardt reject steps.
    """
    rng = np.random.default_rng(1)
    problem = spoiled(optimizer="levenberg-marquardt", backend="schur", max_iterations=12)
    ground = problem.start.ground + np.where(problem.active[:, None], rng.normal(scale=3e3, size=(40, 3)), 0.0)
    image = problem.image_matrix(rng.normal(scale=3e4, size=problem.n_image_unknowns))
    far = replace(problem, start=State(image, ground))
    whole = solve(far)
    refused = [r.iteration for r in whole.log if not r.accepted]
    assert refused, "no step was refused"
    assert refused[0] + 1 in refused, "the damping does not grow twice running"
    assert_same_bits(solve_in_two(far, tmp_path / "file", refused[0], monkeypatch), whole)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_block(tmp_path_factory.mktemp("block") / "project", BlockOptions(rows=1, columns=2, points=24))


@pytest.mark.consistency
@pytest.mark.parametrize(
    ("options", "after"),
    [
        ({"loss": "tls", "gnc": True, "inlier_probability": 0.8}, 6),
        pytest.param({"optimizer": "levenberg-marquardt"}, 3, marks=pytest.mark.slow),  # in process: the tests above
    ],
)
def test_killed_process_is_resumed_with_the_same_bits(
    project: Path, options: dict[str, Any], after: int, tmp_path: Path
) -> None:
    """A run that is killed and resumed writes the arrays and tables of an uninterrupted run, bit by bit."""
    resumed, whole = tmp_path / "resumed", tmp_path / "whole"
    command = [sys.executable, "-c", KILLED, str(project), str(resumed), str(after), repr(options)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert checkpoint_path(resumed).is_file()
    assert not resumed.exists()
    record = run_project(project, resumed, options=options, resume=True)
    assert record["resumed_at_iteration"] == after - 1
    assert not checkpoint_path(resumed).exists()
    assert run_project(project, whole, options=options)["resumed_at_iteration"] is None
    with np.load(resumed / "arrays.npz") as a, np.load(whole / "arrays.npz") as b:
        assert sorted(a) == sorted(b)
        for name in a:
            assert a[name].tobytes() == b[name].tobytes(), name
    for name in ("eop.csv", "points.csv", "residuals.csv"):
        assert (resumed / name).read_bytes() == (whole / name).read_bytes()
    lines = [(folder / "iterations.jsonl").read_text("utf-8").splitlines() for folder in (resumed, whole)]
    assert len(lines[0]) == len(lines[1]) == record["iterations"]


@pytest.mark.behaviour
def test_interrupt_leaves_a_checkpoint_and_says_so(project: Path, tmp_path: Path, monkeypatch: Any) -> None:
    out = tmp_path / "out"

    def stop(self: Checkpoint, *arguments: Any) -> None:
        original(self, *arguments)
        raise KeyboardInterrupt

    original = Checkpoint.keep
    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "keep", stop)
        stopped = run("adjust", project, "--out", out)
    assert stopped.code == 130
    assert (
        "interrupted after iteration 1; its values are saved in .out.checkpoint.npz; continue from there with --resume"
        in stopped.stderr
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == [".out.checkpoint.npz"]
    done = run("adjust", project, "--out", out, "--resume", "--json")
    assert done.code == 0
    assert '"resumed_at_iteration": 1' in done.stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]
    again = run("adjust", project, "--out", out, "--resume", "--overwrite")
    assert "no checkpoint .out.checkpoint.npz to resume: starting from the beginning" in again.stderr


@pytest.mark.behaviour
def test_files_of_others_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, problem = tmp_path / "file", spoiled(backend="schur")
    carried = Carried(problem.start)
    keeper = Checkpoint(path, every_s=1e9)
    assert keeper.write() is None
    keeper.keep(problem, "schur", carried)
    assert not path.exists(), "written before it is time"
    assert keeper.write() == 0
    assert Checkpoint(path).read(problem) is None, "read without being asked to resume"
    resumed = Checkpoint(path, resume=True)
    found = resumed.read(problem)
    assert found is not None
    assert found[0] == "schur"
    assert repr(found[1].control) == "nan"
    more = replace(problem, block=with_options(problem.block, max_iterations=77))
    assert resumed.read(more) is not None, "a higher limit goes on with the same iterations"
    for other in (spoiled(backend="schur", loss="huber"), replace(problem, records=problem.records + 1e-12)):
        with pytest.raises(InputError, match="belongs to other input files or options"):
            resumed.read(other)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match="not a checkpoint of this version"):
        resumed.read(problem)
    keeper.keep(problem, "schur", carried)
    monkeypatch.setattr(module, "FORMAT", 0)
    keeper.write()
    monkeypatch.undo()
    with pytest.raises(InputError, match="not a checkpoint of this version"):
        resumed.read(problem)
    with monkeypatch.context() as patched:  # a full or read-only disk after the result is complete
        patched.setattr(Path, "unlink", lambda *_, **__: (_ for _ in ()).throw(OSError(30, "Read-only file system")))
        resumed.remove()
    assert path.exists()
    resumed.remove()
    assert not path.exists()
    resumed.remove()
    with pytest.raises(InputError, match="checkpoint_every"):
        Checkpoint(path, every_s=-1.0)
    assert fingerprint(problem) == fingerprint(spoiled(backend="schur"))
    assert fingerprint(problem) != fingerprint(problem, "4 parts")


@pytest.mark.behaviour
@pytest.mark.parametrize("left_out", ["fingerprint", "backend", "numbers", "log", "all"])
def test_a_file_with_something_missing_is_no_checkpoint(tmp_path: Path, left_out: str) -> None:
    path, problem = tmp_path / "file", spoiled(backend="schur")
    keeper = Checkpoint(path)
    keeper.keep(problem, "schur", Carried(problem.start))
    keeper.write()
    with np.load(path) as content:
        arrays = {name: array for name, array in content.items() if name != left_out}
    with path.open("wb") as stream:
        np.save(stream, np.arange(3.0)) if left_out == "all" else np.savez(stream, **arrays)
    with pytest.raises(InputError, match="not a checkpoint of this version"):
        Checkpoint(path, resume=True).read(problem)


def _with_number(name: str, value: float) -> Any:
    """Return a function that changes one of the numbers of a checkpoint."""
    k = module._NUMBERS.index(name)
    return lambda numbers: np.concatenate([numbers[:k], [value], numbers[k + 1 :]])


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("array", "change", "part"),
    [
        ("image", lambda a: a[:, :-1], "image"), ("image", lambda a: a.astype(str), "image"),
        ("image", lambda a: a + np.nan, "image"), ("image", lambda a: a.astype(complex), "image"),
        ("ground", lambda a: a[:-1], "ground"), ("ground", lambda a: a.astype("f4"), "ground"),
        ("ground", lambda a: np.full_like(a, 1e308), "ground"), ("log", lambda a: np.full_like(a, 1e308), "log"),
        ("log", lambda a: np.full_like(a, np.inf), "OverflowError"), ("log", lambda a: a[::-1], "log"),
        ("numbers", lambda a: np.full_like(a, 1e308), "control"), ("numbers", _with_number("growth", np.inf), "growth"),
        ("numbers", _with_number("begun_at", 3.0), "begun_at"), ("numbers", _with_number("rejected", -1.0), "rejected"),
        ("numbers", _with_number("rising", np.inf), "OverflowError"),
        ("numbers", _with_number("image_scale", np.nan), "image_scale"),
        ("backend", lambda _: np.array("auto"), "backend"), ("backend", lambda _: np.array("x"), "backend"),
    ],
)  # fmt: skip
def test_a_changed_file_with_the_same_fingerprint_is_refused(
    array: str, change: Any, part: str, tmp_path: Path
) -> None:
    path, problem = tmp_path / "file", spoiled(backend="schur")
    log = tuple(IterationRecord(k, 9.0, 8.0, 1.0, 1.0, 1.0, np.inf, True, 0.1) for k in (1, 2))
    keeper, resumed = Checkpoint(path), Checkpoint(path, resume=True)
    keeper.keep(problem, "schur", Carried(problem.start, log=log))
    keeper.write()
    assert resumed.read(problem) is not None
    with np.load(path) as content:
        arrays = dict(content)
    with path.open("wb") as stream:
        np.savez(stream, **{**arrays, array: change(arrays[array])})
    with pytest.raises(InputError, match="not a checkpoint of this version") as caught:
        resumed.read(problem)
    assert caught.value.problems[0].value == part


@pytest.mark.behaviour
def test_a_checkpoint_used_for_two_problems_belongs_to_the_second(tmp_path: Path) -> None:
    path, first, second = tmp_path / "file", spoiled(backend="schur"), spoiled(backend="schur", eop_set=2)
    keeper = Checkpoint(path, every_s=0.0)
    keeper.keep(first, "schur", Carried(first.start))
    keeper.keep(second, "schur", Carried(second.start))
    resumed = Checkpoint(path, resume=True)
    assert resumed.read(second) is not None
    with pytest.raises(InputError, match="belongs to other input files or options"):
        resumed.read(first)
