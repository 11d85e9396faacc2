"""Worker processes that end are replaced up to a limit; the tests kill them at the start and at random."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fg_orient.adjustment.parts import execution, watch
from fg_orient.adjustment.parts.pool import _failures
from fg_orient.adjustment.parts.watch import REPLACED, Watch
from fg_orient.model.errors import NoSolutionError

pytestmark = pytest.mark.behaviour


class Processes:
    """A cluster without processes: numbers of processes by worker, and their states."""

    def __init__(self, count: int) -> None:
        self.workers = {k: self.one(100 + k) for k in range(count)}
        self.scaled: list[int] = []

    @staticmethod
    def one(pid: int, status: str = "running") -> Any:
        return SimpleNamespace(pid=pid, status=SimpleNamespace(name=status))

    def scale(self, count: int) -> None:
        self.scaled.append(count)
        for k in range(count):
            self.workers.setdefault(k, self.one(200 + k))


class Client:
    """A client that can be closed."""

    closed = False

    def close(self, timeout: float) -> None:
        self.closed = True


def test_a_process_that_dask_has_given_up_is_started_again() -> None:
    cluster = Processes(4)
    seen = Watch(cluster, Client(), 4)
    seen._look()
    assert (seen.ended, cluster.scaled) == (0, [])
    cluster.workers[2].status.name = "closed"
    del cluster.workers[3]
    seen._look()
    assert cluster.scaled == [4] and {k: one.pid for k, one in cluster.workers.items()} == {
        0: 100,
        1: 101,
        2: 202,
        3: 203,
    }
    seen._look()
    assert seen.ended == 2 and not seen.exhausted


def test_too_many_ends_close_the_client(monkeypatch: pytest.MonkeyPatch) -> None:
    """If workers end too often, the client closes, and the error states the number of processes and the remedy."""
    monkeypatch.setattr(watch, "PAUSE_S", 0.0)
    cluster, client = Processes(2), Client()
    with Watch(cluster, client, 2) as seen:
        pid = 1000
        while not client.closed:
            pid += 1
            cluster.workers[1].pid = pid
        seen._thread.join()
    assert seen.exhausted and seen.ended > 2 * REPLACED
    pytest.importorskip("distributed")
    with pytest.raises(NoSolutionError) as caught, _failures(seen):
        raise RuntimeError("whatever a closed client says")
    (problem,) = caught.value.problems
    assert problem.code == "parallel.replaced" and problem.value == f"{seen.ended} processes"
    assert "resume" in problem.remedy


@pytest.mark.parametrize(("failing", "code"), [(2, ""), (99, "parallel.start")])
def test_processes_that_end_while_they_start_are_started_again(failing: int, code: str, tmp_path: Path) -> None:
    tried: list[str] = []

    def cluster(**how: Any) -> str:
        tried.append(how["local_directory"])
        if len(tried) <= failing:
            raise RuntimeError("Nanny failed to start.")
        return "cluster"

    distributed = SimpleNamespace(LocalCluster=cluster, Security=SimpleNamespace(temporary=lambda: None))
    if not code:
        assert execution._started(distributed, 2, tmp_path) == "cluster"
        assert len(tried) == failing + 1
        return
    with pytest.raises(NoSolutionError, match="ended while they started, 5 times") as caught:
        execution._started(distributed, 2, tmp_path)
    assert caught.value.problems[0].code == code and len(tried) == execution.STARTS


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are found in /proc")
def test_workers_killed_at_random_times_change_nothing() -> None:
    """Ten workers killed at random times and one at its start do not change the result.

    A run of ``tests.faults.workers`` has 200 kills.
    """
    pytest.importorskip("distributed")
    words = [sys.executable, "-m", "tests.faults.workers", "--kills", "10", "--starts", "1", "--longest", "2"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert json.loads(done.stdout)["while working"]["kills"] == 10
