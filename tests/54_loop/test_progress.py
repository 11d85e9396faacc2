"""Progress shows iterations and remaining time to people, and nothing to programs."""

from __future__ import annotations

import io
import math
import sys
import time
from dataclasses import replace

import pytest
from rich.progress import Progress

from fg_orient.adjustment.loop import IterationRecord
from fg_orient.adjustment.stages import EXACT, PLAIN
from fg_orient.cli.log import opened
from fg_orient.cli.progress import describe, iterations_left, progress

pytestmark = pytest.mark.behaviour


def log(*steps: float, mus: tuple[float, ...] = (), accepted: bool = True) -> list[IterationRecord]:
    """Return the iterations of half a second each."""
    return [
        IterationRecord(k + 1, 1.0, 1.0, 0.0, 1.0, step, 0.0, accepted, 0.5 * (k + 1), mus[k] if mus else math.nan)
        for k, step in enumerate(steps)
    ]


def test_time_left_follows_the_rate_of_convergence() -> None:
    assert iterations_left([]) is None
    assert iterations_left(log(1.0)) is None
    assert iterations_left(log(1.0, 1e-2)) == 3  # 1e-4, 1e-6, 1e-8
    assert iterations_left(log(1.0, 0.5)) == math.ceil(math.log(1e-8 / 0.5) / math.log(0.5))
    assert iterations_left(log(1e-7, 1e-9)) == 0
    assert iterations_left(log(1.0, 0.95)) is None, "steps that do not shrink say nothing"
    assert iterations_left(log(1.0, 1e-2, accepted=False)) is None
    assert iterations_left(log(math.inf, 1.0)) is None


def test_time_left_of_stages() -> None:
    two = log(1.0, 0.1, 0.1, 0.1, mus=(PLAIN, PLAIN, 8.0, 4.0))
    stages = math.ceil(math.log(4.0) / math.log(1.4))
    assert iterations_left(two) == math.ceil(stages * 4 / 3)
    assert iterations_left(two[:3]) is None
    last = log(1.0, 1e-2, 1e-3, 1e-5, mus=(PLAIN, 8.0, EXACT, EXACT))
    assert iterations_left(last) == 2  # 1e-7, 1e-9


def test_description() -> None:
    assert describe(log(1.0), 1000) == "iteration 1, step 1.0e+00, 2,000 image points/s"
    assert describe(log(1.0, 1e-2), 1000) == "iteration 2, step 1.0e-02, 2,000 image points/s, about 2 s left"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_bar_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    for stream, quiet in ((io.StringIO(), False), (Terminal(), True)):
        monkeypatch.setattr(sys, "stderr", stream)
        with opened(None, as_json=False, quiet=quiet), progress() as watch:
            watch.stage("reading", 0)
            watch.iteration(log(1.0)[0])
        assert stream.getvalue() == ""
    terminal, update = Terminal(), Progress.update
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(Progress, "update", lambda *given, **more: update(*given, **more, refresh=True))  # at once
    with progress() as watch:
        watch.stage("reading", 0)
        watch.stage("iterations", 1000)
        for record in log(1.0, 1e-2):
            watch.iteration(record)
        assert "iteration 2, step 1.0e-02, 2,000 image points/s, about 2 s left" in terminal.getvalue()
        for step in (1e-6, 1e-12):  # the last: nothing is left to do
            watch.iteration(replace(log(1.0)[0], step=step))
        begin = time.perf_counter()
        monkeypatch.setattr(time, "perf_counter", lambda: begin + 3700.0)
        watch.stage("statistics", 1000)
    last = terminal.getvalue().rpartition("statistics")[2]
    assert "1:0" in last  # the clock goes on in the work after the iterations
