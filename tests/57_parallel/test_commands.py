"""The commands ``adjust`` in parts and ``compare`` with workers are run."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from fg_orient.adjustment.checkpoint import Checkpoint
from fg_orient.adjustment.loop import Carried
from fg_orient.adjustment.parts import execution, pool
from fg_orient.adjustment.problem import Problem
from fg_orient.adjustment.schur_reduced import Singular
from fg_orient.model.errors import InputError, NoSolutionError
from fg_orient.orientation.run import checkpoint_path, run_project
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import in_process as run

from .conftest import certificate_of


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the project file of the twin; not to be changed."""
    folder = tmp_path_factory.mktemp("twin") / "zonguldak"
    simulate_zonguldak(folder, ZonguldakOptions())
    return folder / "project.toml"


def table(path: Path, name: str) -> list[dict[str, str]]:
    """Return the rows of a table of a folder."""
    with (path / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.consistency
def test_adjust_in_parts_writes_the_same_result(project: Path, tmp_path: Path) -> None:
    records = []
    for name, words in (("whole", ("--backend", "schur")), ("parts", ("--parts", 3, "--work-dir", tmp_path))):
        ended = run("adjust", project, "--out", tmp_path / name, "--json", *words)
        assert ended.code == 0, ended.stderr
        records.append(ended.json)
    assert records[1]["backend"] == "schur"
    assert records[1]["sigma0"] == pytest.approx(records[0]["sigma0"], rel=1e-10)
    assert records[1]["accuracy"]["check"]["rmse_up_m"] == pytest.approx(records[0]["accuracy"]["check"]["rmse_up_m"])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["parts", "whole"]


@pytest.mark.consistency
@pytest.mark.slow
def test_adjust_on_a_scheduler(project: Path, client: Any, tmp_path: Path) -> None:
    bits = []
    with certificate_of(client) as address:
        for words in (("--workers", 1), ("--scheduler", address)):
            ended = run("adjust", project, "--out", tmp_path / words[0].strip("-"), "--json", "--parts", 4, *words)
            assert ended.code == 0, ended.stderr
            bits.append((tmp_path / words[0].strip("-") / "points.csv").read_bytes())
    assert bits[0] == bits[1]


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("words", "code", "place"),
    [
        (("--parts", 1000), "parallel.parts", "--parts"),
        (("--scheduler", "nonsense"), "parallel.unreachable", "--scheduler"),
    ],
)
def test_adjust_names_what_is_wrong(project: Path, tmp_path: Path, words: Any, code: str, place: str) -> None:
    ended = run("adjust", project, "--out", tmp_path / "out", "--json", *words)
    (problem,) = ended.json["errors"]
    assert (ended.code, problem["code"], problem["place"]) == (2, code, place)


@pytest.mark.behaviour
@pytest.mark.parametrize("command", ["adjust", "compare"])
def test_a_scheduler_without_certificates_is_warned_of(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setattr(execution, "CONNECT_S", 0.3)
    for scheme, warned in (("tcp", True), ("tls", False)):
        ended = run(command, project, "--out", tmp_path / "out", "--scheduler", f"{scheme}://127.0.0.1:9")
        assert ended.code == 2
        assert ("can run code there" in ended.stderr) == warned


@pytest.mark.consistency
@pytest.mark.slow
def test_compare_shares_the_sets(project: Path, client: Any, tmp_path: Path) -> None:
    words = ("--eop-sets", "1,9", "--solvers", "qr", "--backends", "dense,graph", "--json")
    with certificate_of(client) as address:
        for name, more in (("alone", ()), ("shared", ("--scheduler", address))):
            ended = run("compare", project, "--out", tmp_path / name, *words, *more)
            assert ended.code == 0, ended.stderr
    alone, shared = (
        [
            {k: v for k, v in row.items() if k not in ("processor_s", "peak_bytes")}
            for row in table(tmp_path / name, "compare.csv")
        ]
        for name in ("alone", "shared")
    )
    assert alone == shared
    assert len(alone) == 2 * (1 + 3)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["alone", "shared"]
    assert json.loads((tmp_path / "shared" / "result.json").read_text("utf-8"))["eop_sets"] == [1, 9]


@pytest.mark.behaviour
@pytest.mark.parametrize(
    ("code", "kept"), [("parallel.lost", True), ("parallel.killed", True), ("adjust.broken_down", False)]
)
def test_a_lost_cluster_leaves_the_checkpoint(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, kept: bool
) -> None:
    """If the workers fail, the checkpoint is kept; if the equations fail, it is removed."""

    def lost(problem: Problem, execution: object, callback: object, checkpoint: Checkpoint, begin: object) -> None:
        checkpoint.keep(problem, "schur", Carried(problem.start))
        raise NoSolutionError.of(code, place="here", value="x", why="x")

    monkeypatch.setattr("fg_orient.adjustment.parts.solve.solve_in_parts", lost)
    with pytest.raises(NoSolutionError):
        run_project(project, tmp_path / "out", execution={"parts": 2}, checkpoint_every_s=1e9)
    assert checkpoint_path(tmp_path / "out").exists() == kept


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "fault", [OSError("Timed out trying to connect"), RuntimeError("ConnectionPool is closed"), TimeoutError()]
)
def test_what_dask_says_of_a_lost_scheduler_is_one_message(fault: Exception) -> None:
    with pytest.raises(NoSolutionError, match="no longer answers"), pool._failures():
        raise fault


@pytest.mark.behaviour
@pytest.mark.parametrize("fault", [FileNotFoundError(2, "no file"), RuntimeError("another"), Singular("point")])
def test_other_faults_pass(fault: Exception) -> None:
    with pytest.raises(type(fault)) as caught, pool._failures():
        raise fault
    assert caught.value is fault


@pytest.mark.behaviour
@pytest.mark.parametrize(
    "wrong", [{"parts": 2.5}, {"parts": "3"}, {"parts": True}, {"workers": "2"}, {"work_dir": 5}, {"cluster": 7}]
)
def test_wrong_kinds_are_refused_in_words(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="this kind of value is not possible") as caught:
        execution.Execution(**wrong)
    assert caught.value.problems[0].option == next(iter(wrong))
