"""Every writing call of a command fails once, and the process is killed before each call (``tests.faults``)."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.faults.harness import unavailable
from tests.faults.scenarios import SCENARIOS

pytestmark = pytest.mark.behaviour


@functools.cache
def reason() -> str:
    return unavailable()


def reports(*words: str) -> list[dict[str, Any]]:
    """Run the harness in a separate process, in which no test has started threads."""
    if reason():
        pytest.skip(reason())
    done = subprocess.run([sys.executable, "-m", "tests.faults", *words], capture_output=True, text=True, timeout=3600)
    assert done.stdout, done.stderr[-3000:]
    found: list[dict[str, Any]] = json.loads(done.stdout)
    return found


def test_a_sample_of_failing_calls() -> None:
    """A failing or killed call of ``rectify fit`` leaves a whole output or none, one message and no hidden file."""
    (report,) = reports("--command", "rectify", "--most", "2", "--errors", "ENOSPC,KILL")
    assert report["failures"] == [] and report["calls"] > 15 and report["runs"] == 4


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_failing_calls(name: str) -> None:
    """A failing call of each command leaves a whole output or none; calls are a random sample.

    ``python -m tests.faults`` tries all of them.
    """
    (report,) = reports("--command", name, "--most", "12", "--in-turn")
    assert report["failures"] == [] and report["runs"] == report["tried"] >= 8


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rectify", "adjust"])
def test_killed_at_random_times(name: str) -> None:
    (report,) = reports("--command", name, "--kills", "10")
    assert report["failures"] == [] and report["runs"] >= 10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rectify", "pair", "match"])
def test_two_writers(name: str) -> None:
    """Two runs that write the same outputs never mix them. Outputs are a folder, tables, or tables and a folder."""
    (report,) = reports("--command", name, "--writers", "--most", "20")
    assert report["failures"] == [] and report["runs"] == 2 * report["tried"] >= 30


@pytest.mark.slow
def test_a_disk_that_stays_full() -> None:
    for report in reports("--command", "rectify", "--command", "convert", "--errors", "ENOSPC", "--sticky"):
        assert report["failures"] == []


def test_the_harness_sees_a_fault(tmp_path: Path) -> None:
    """The harness finds the half file of a writer that fails or is killed between two calls."""
    if reason():
        pytest.skip(reason())
    from tests.faults.harness import ERRORS, run

    def careless() -> int:
        descriptor = os.open(tmp_path / "file", os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
        for text in (b"half", b" and whole"):
            os.write(descriptor, text)
        return 0

    root = tmp_path.resolve()
    good = run(careless, root)
    assert good.code == 0 and [path for _, path in good.calls] == ["file"] * 3
    assert run(careless, root, nth=3, error=ERRORS["ENOSPC"]).code == 99
    assert (tmp_path / "file").read_bytes() == b"half"
    assert run(careless, root, nth=2, error=ERRORS["KILL"]).code == -9
    assert (tmp_path / "file").read_bytes() == b""
