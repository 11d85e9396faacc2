"""If the memory is not sufficient at any point, the program prints one line and ends with exit code 3."""

from __future__ import annotations

import errno
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fg_orient.model import machine
from fg_orient.model.machine import is_out_of_memory
from fg_orient.orientation import run as runs
from fg_orient.simulate.zonguldak import ZonguldakOptions, simulate_zonguldak
from tests.support.command import in_process

pytestmark = pytest.mark.behaviour
PROGRAM = "import sys; sys.argv[0] = 'fg-orient'; from fg_orient.cli import main; main()"


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_zonguldak(tmp_path_factory.mktemp("twin") / "twin", ZonguldakOptions(seed=1))


@pytest.mark.parametrize(
    ("error", "is_memory"),
    [
        (MemoryError(), True), (OSError(12, "Cannot allocate memory"), True), (RuntimeError("std::bad_alloc"), True),
        (RuntimeError("can't start new thread"), True), (OSError(28, "No space left on device"), False),
        (ValueError("memory"), False),
    ],
)  # fmt: skip
def test_what_libraries_say_of_memory(error: Exception, is_memory: bool) -> None:
    assert is_out_of_memory(error) == is_memory
    around = RuntimeError("around")
    around.__cause__ = error
    assert is_out_of_memory(around) == is_memory


def test_a_command_without_memory_is_one_line(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise MemoryError("Unable to allocate 3.00 TiB")

    monkeypatch.setattr(runs, "adjust", full)
    ended = in_process("adjust", project, "--json")
    (error,) = ended.json["errors"]
    assert (ended.code, error["code"]) == (3, "program.memory") and "3.00 TiB" in error["value"]
    assert len(ended.stderr.splitlines()) == 1 and not (project.parent / "result").exists()


def test_linear_algebra_without_work_space_is_too_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    monkeypatch.setattr(machine, "_has_address_limit", lambda: True)
    machine.reserve_blas.__wrapped__()
    monkeypatch.setattr(machine.mmap, "mmap", full)
    with pytest.raises(MemoryError, match="linear algebra"):
        machine.reserve_blas.__wrapped__()


@pytest.mark.slow
@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="the system limits the addresses of a process on Linux"
)
def test_any_limit_of_memory_is_one_line_or_a_result(project: Path, tmp_path: Path) -> None:
    """Under any memory limit ``adjust`` ends with a result, or with one line, exit code 3 and no file.

    With 500 to 640 MB, OpenBLAS did not get its work space during the adjustment, and asked for it without end.
    """
    import resource

    codes = []
    for megabytes in (120, 200, 300, 400, *range(500, 641, 20), 4000):
        size = megabytes << 20
        words = [sys.executable, "-c", PROGRAM, "adjust", str(project), "--out", str(tmp_path / f"out{megabytes}")]
        done = subprocess.run(
            [*words, "--quiet"], capture_output=True, text=True, timeout=120,
            preexec_fn=lambda size=size: resource.setrlimit(resource.RLIMIT_AS, (size, size)),
        )  # fmt: skip
        codes.append(done.returncode)
        if done.returncode != 0:
            assert done.returncode == 3 and len(done.stderr.splitlines()) == 1, (megabytes, done.stderr[-500:])
            assert "memory" in done.stderr
            assert not (tmp_path / f"out{megabytes}").exists()
    assert codes[0] == 3 and codes[-1] == 0
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
