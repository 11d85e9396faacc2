"""Runs of a command in forked processes, of which one writing call fails, or which are killed.

The calls are counted by the system (``calls.c``), so that calls of GDAL and SQLite are met. The process that forks
has loaded all modules and kernels: a run costs what the command itself costs.
"""

from __future__ import annotations

import ctypes
import errno
import functools
import hashlib
import mmap
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SOURCE = Path(__file__).with_name("calls.c")
#: Calls that are kept by their number and path, and bytes of one.
MOST, CALL = 20_000, 244
KILL = -1
#: Errors that a call may have, and the end of its process.
ERRORS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "EROFS": errno.EROFS, "KILL": KILL}
#: Seconds after which a run hangs.
HANGS_S = 120.0


def unavailable() -> str:
    """Return the reason why calls cannot be counted here; "" if they can."""
    if not sys.platform.startswith("linux"):
        return "system calls are counted on Linux only"
    if shutil.which("cc") is None:
        return "no C compiler"
    probe = "import sys; from tests.faults.harness import probe; sys.exit(probe())"
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True)
    return "" if done.returncode == 0 else f"the system does not report calls (seccomp): {done.stderr[-300:]}"


def probe() -> int:
    """Return 0 if a call of a child is counted."""
    library()
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        root = Path(name).resolve()
        ended = run(lambda: (root / "file").write_text("text", "utf-8") and 0, root)
    return 0 if [path for _, path in ended.calls] == ["file", "file"] else 1


@functools.cache
def library() -> Any:
    """Compile the library, once in a process."""
    import tempfile

    folder = Path(tempfile.mkdtemp(prefix="faults-"))
    try:
        words = ["cc", "-O1", "-shared", "-fPIC", "-o", str(folder / "calls.so"), str(SOURCE)]
        subprocess.run(words, check=True, capture_output=True)
        return ctypes.CDLL(str(folder / "calls.so"))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@dataclass(frozen=True)
class Ended:
    """How a run ended: exit code (negative: signal; None: it was stopped, because it hung), outputs, writing calls."""

    code: int | None
    stdout: str
    stderr: str
    calls: tuple[tuple[int, str], ...]
    count: int


def run(
    function: Callable[[], int], root: Path, *, nth: int = 0, error: int = errno.EIO, sticky: bool = False,
    count: bool = True, kill_after_s: float | None = None,
) -> Ended:  # fmt: skip
    """Run a function in a forked process.

    Parameters
    ----------
    function : callable
        Returns an exit code.
    root : Path
        Folder in which calls are counted.
    nth : int
        Number of the call that fails, from 1; 0: none.
    error : int
        Its error; KILL: the process is killed before it.
    sticky : bool
        All later calls fail, too: a disk that stays full.
    count : bool
        Count calls.
    kill_after_s : float, optional
        Time after which the process is killed.
    """
    counting = library() if count else None  # compiled before the process is forked
    shared = mmap.mmap(-1, 8 + CALL * MOST)
    shared[4:8] = MOST.to_bytes(4, sys.byteorder)
    outputs = [os.memfd_create(name) for name in ("out", "err")]
    process = os.fork()
    if not process:
        code = 99
        try:
            for number, descriptor in enumerate(outputs, start=1):
                os.dup2(descriptor, number)
            if counting is not None:
                address = ctypes.addressof(ctypes.c_char.from_buffer(shared))
                place = os.fsencode(f"{root}/")
                failed = counting.arm(place, nth, error, int(sticky), ctypes.c_void_p(address))
                if failed:
                    raise OSError(failed, os.strerror(failed))
            code = function()
        except BaseException:
            import traceback

            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    status = _wait(process, HANGS_S if kill_after_s is None else kill_after_s)
    texts = []
    for descriptor in outputs:
        with os.fdopen(descriptor, "rb") as stream:
            stream.seek(0)
            texts.append(stream.read().decode("utf-8", "replace"))
    n = int.from_bytes(shared[:4], sys.byteorder)
    calls = []
    for k in range(min(n, MOST)):
        at = 8 + CALL * k
        path = shared[at + 4 : at + CALL].split(b"\0")[0]
        calls.append((int.from_bytes(shared[at : at + 4], sys.byteorder), path.decode("utf-8", "replace")))
    code_ = None if status is None else os.waitstatus_to_exitcode(status)
    return Ended(-signal.SIGKILL if code_ is None and kill_after_s is not None else code_, *texts, tuple(calls), n)


def _wait(process: int, seconds: float) -> int | None:
    """Wait for a process; None if it was killed after some seconds."""
    end, pause = time.monotonic() + seconds, 0.001
    while True:
        done, status = os.waitpid(process, os.WNOHANG)
        if done:
            return status
        left = end - time.monotonic()
        if left <= 0.0:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            return None
        time.sleep(min(pause, left))
        pause = min(1.5 * pause, 0.02)


def command(*words: object) -> Callable[[], int]:
    """Command of ``fg-orient`` for :func:`run`."""

    def call() -> int:
        sys.argv = ["fg-orient", *map(str, words)]
        sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)
        from fg_orient.cli import main
        from fg_orient.formats.staging import sweep_once

        sweep_once.cache_clear()  # of the process that was forked
        try:
            main()
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else int(end.code is not None)

    return call


def warm(function: Callable[[], int]) -> None:
    """Run a command in this process, so that the forked ones have its modules and kernels; without its words."""
    kept, streams = [os.dup(number) for number in (1, 2)], (sys.stdout, sys.stderr, sys.argv)
    nothing = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        os.dup2(nothing, number)
    try:
        function()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, descriptor in zip((1, 2), kept, strict=True):
            os.dup2(descriptor, number)
            os.close(descriptor)
        os.close(nothing)
        sys.stdout, sys.stderr, sys.argv = streams
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def contents(folder: Path) -> dict[str, str]:
    """Return every file with its SHA-256, and every folder, below a folder."""
    return {
        path.relative_to(folder).as_posix(): "folder"
        if path.is_dir()
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
    }


# --- scenarios ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scenario:
    """A command on copies of a folder.

    Parameters
    ----------
    name : str
    template : Path
        Folder to copy.
    words : callable
        From a copy to the words of the command.
    outputs : callable
        From the files after a good run to those that the command writes or changes.
    again : sequence of str
        Options of the run after a killed one.
    kept : sequence of str
        Beginnings of names that a failed run may leave or write: whole outputs, and what the next run goes on from.
    """

    name: str
    template: Path
    words: Callable[[Path], Sequence[object]]
    again: Sequence[str] = ()
    kept: Sequence[str] = ()
    tolerated: Sequence[int] = (0, 4)


@dataclass
class Report:
    """Result of the faults of a scenario."""

    name: str
    calls: int = 0
    runs: int = 0
    failures: list[str] = field(default_factory=list)


class Faults:
    """Faults of one scenario.

    Parameters
    ----------
    scenario : Scenario
    work : Path
        Folder for the copies.
    """

    def __init__(self, scenario: Scenario, work: Path) -> None:
        self.scenario, self.work = scenario, work
        self.report = Report(scenario.name)
        self.root = work / "copy"
        self._copy()
        self.before = contents(self.root)
        warm(command(*scenario.words(self.root)))
        self._copy()
        self.good = run(command(*scenario.words(self.root)), self.root)
        assert self.good.code in scenario.tolerated, self.good
        self.after = contents(self.root)
        self.report.calls = self.good.count
        self._copy()
        run(command(*scenario.words(self.root)), self.root, count=False)
        again = contents(self.root)
        #: Files whose bytes do not depend on the time of a run.
        self.stable = {
            name for name, digest in self.after.items() if again.get(name) == digest and not name.endswith(".html")
        }

    def _copy(self) -> None:
        shutil.rmtree(self.root, ignore_errors=True)
        shutil.copytree(self.scenario.template, self.root)

    def fail(self, nth: int, name: str, *, sticky: bool = False) -> None:
        """Let a call fail once, or from then on; check what is left and what is said."""
        self._copy()
        words = self.scenario.words(self.root)
        ended = run(command(*words), self.root, nth=nth, error=ERRORS[name], sticky=sticky)
        self.report.runs += 1
        call = f"{ended.calls[nth - 1]}" if len(ended.calls) >= nth else "not reached"
        where = f"{self.scenario.name}: call {nth} {call} {name}{' and later' if sticky else ''}"
        if name == "KILL":
            if ended.code != -signal.SIGKILL and ended.count >= nth:
                self._note(f"{where}: not killed, {ended}")
            self._next_run(where)
            return
        files = contents(self.root)
        if ended.code in self.scenario.tolerated:
            differ = set(files) ^ set(self.after) | {n for n in self.stable if files.get(n) != self.after[n]}
            if differ:
                self._note(f"{where}: code {ended.code}, but files {sorted(differ)[:8]} {ended.stderr[-300:]}")
        elif ended.code not in (2, 3):
            self._note(f"{where}: code {ended.code}: {ended.stderr[-600:]}")
        elif changed := sorted(
            name for name, _ in files.items() ^ self.before.items() if not name.startswith(tuple(self.scenario.kept))
        ):
            self._note(f"{where}: code {ended.code}, but left or changed {changed[:8]}")
        elif sum(line.startswith("error:") for line in ended.stderr.splitlines()) != 1 or "Traceback" in ended.stderr:
            self._note(f"{where}: message {ended.stderr[-600:]}")

    def kill_after(self, seconds: float) -> bool:
        """Kill the command after some time; check the next run. False if it had ended before."""
        self._copy()
        ended = run(command(*self.scenario.words(self.root)), self.root, count=False, kill_after_s=seconds)
        self.report.runs += 1
        if ended.code != -signal.SIGKILL:
            return False
        self._next_run(f"{self.scenario.name}: killed after {seconds:.3f} s")
        return True

    def _next_run(self, where: str) -> None:
        words = self.scenario.words(self.root)
        ended = run(command(*words), self.root, count=False)
        if ended.code == 2 and ("--overwrite" in ended.stderr or "exists already" in ended.stderr):
            # the killed run had already written its output
            ended = run(command(*words, *self.scenario.again), self.root, count=False)
        files = contents(self.root)
        if ended.code != self.good.code or set(files) != set(self.after):
            self._note(
                f"{where}: next run {ended.code}, {sorted(set(files) ^ set(self.after))[:8]}, {ended.stderr[-300:]}"
            )

    def _note(self, text: str) -> None:
        self.report.failures.append(text)


def sample(count: int, most: int | None, seed: int) -> list[int]:
    """Return numbers of calls: all of them, or some at random with the first and the last."""
    every = list(range(1, count + 1))
    if most is None or most >= count:
        return every
    chosen = random.Random(seed).sample(every, max(most - 2, 0))
    return sorted({1, count, *chosen})
