"""Commands run in forked processes, in which one writing call fails or the process is killed.

The calls are counted by the system (``calls.c``), so that calls of GDAL and SQLite are met. The process that forks
has loaded all modules and kernels: a run costs what the command itself costs.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import functools
import mmap
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SOURCE = Path(__file__).with_name("calls.c")
#: Calls that are kept by their number and path, and bytes of one.
MOST, CALL = 20_000, 244
KILL, PAUSE = -1, -2
#: Errors that a call may have, and the end of its process.
ERRORS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "EROFS": errno.EROFS, "KILL": KILL}
#: Integers before the calls: number of calls, calls that are kept, "waits", "may go on".
COUNT, KEPT, WAITS, GO, CALLS = 0, 4, 8, 12, 16
#: Seconds after which a run hangs.
HANGS_S = 600.0


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
    calls: tuple[tuple[int, str], ...] = ()
    count: int = 0


class Running:
    """Function in a forked process.

    Parameters
    ----------
    function : callable
        Returns an exit code.
    root : Path
        Folder in which calls are counted.
    nth : int
        Number of the call that fails, from 1; 0: none.
    error : int
        Its error; KILL: the process is killed before it; PAUSE: it waits before it.
    sticky : bool
        All later calls fail, too: a disk that stays full.
    count : bool
        Count calls.
    """

    def __init__(
        self, function: Callable[[], int], root: Path, *, nth: int = 0, error: int = errno.EIO, sticky: bool = False,
        count: bool = True,
    ) -> None:  # fmt: skip
        counting = library() if count else None  # compiled before the process is forked
        self._shared = shared = mmap.mmap(-1, CALLS + CALL * MOST)
        shared[KEPT : KEPT + 4] = MOST.to_bytes(4, sys.byteorder)
        self._outputs = [os.memfd_create(name) for name in ("out", "err")]
        self.process = os.fork()
        if not self.process:
            code = 99
            try:
                os.setpgid(0, 0)
                for number, descriptor in enumerate(self._outputs, start=1):
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

    def _number(self, place: int) -> int:
        return int.from_bytes(self._shared[place : place + 4], sys.byteorder)

    def paused(self) -> bool:
        """Wait until the process waits before its call; return False if it has ended."""
        end = time.monotonic() + HANGS_S
        while not self._number(WAITS):
            if os.waitid(os.P_PID, self.process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
                return False
            assert time.monotonic() < end, "neither waits nor ends"
            time.sleep(0.001)
        return True

    def go_on(self) -> None:
        """Resume a process that waits."""
        self._shared[GO : GO + 4] = (1).to_bytes(4, sys.byteorder)

    def ended(self, kill_after_s: float | None = None) -> Ended:
        """Wait for the end; kill the process and those that it started after some time."""
        status = self._wait(HANGS_S if kill_after_s is None else kill_after_s)
        texts = []
        for descriptor in self._outputs:
            with os.fdopen(descriptor, "rb") as stream:
                stream.seek(0)
                texts.append(stream.read().decode("utf-8", "replace"))
        calls, n = [], self._number(COUNT)
        for k in range(min(n, MOST)):
            at = CALLS + CALL * k
            path = self._shared[at + 4 : at + CALL].split(b"\0")[0]
            calls.append((self._number(at), path.decode("utf-8", "replace")))
        code = None if status is None else os.waitstatus_to_exitcode(status)
        return Ended(-signal.SIGKILL if code is None and kill_after_s is not None else code, *texts, tuple(calls), n)

    def _wait(self, seconds: float) -> int | None:
        """Wait for the process; return None if it was killed after some seconds."""
        end, pause = time.monotonic() + seconds, 0.001
        while True:
            done, status = os.waitpid(self.process, os.WNOHANG)
            if done:
                return status
            left = end - time.monotonic()
            if left <= 0.0:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self.process, signal.SIGKILL)
                with contextlib.suppress(ProcessLookupError):  # it is not yet the first of its group
                    os.kill(self.process, signal.SIGKILL)
                os.waitpid(self.process, 0)
                return None
            time.sleep(min(pause, left))
            pause = min(1.5 * pause, 0.02)


def run(
    function: Callable[[], int], root: Path, *, nth: int = 0, error: int = errno.EIO, sticky: bool = False,
    count: bool = True, kill_after_s: float | None = None,
) -> Ended:  # fmt: skip
    """Run a function in a forked process to its end; see :class:`Running`."""
    return Running(function, root, nth=nth, error=error, sticky=sticky, count=count).ended(kill_after_s)


def command(*words: object) -> Callable[[], int]:
    """Return the command of ``fg-orient`` for :func:`run`."""

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
