"""The harness runs one case within its limits, or many cases with a record of what was found."""

from __future__ import annotations

import random
import shutil
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from fg_orient.model.errors import FgOrientError
from tests.fuzz.mutate import mutated
from tests.fuzz.readers import Reader

#: Contract: processor time and memory of a file.
SECONDS, SECONDS_PER_BYTE = 10.0, 2e-6
MEMORY, MEMORY_PER_BYTE = 200e6, 20.0
_STATUS: Final = Path("/proc/self/status")
_CLEAR: Final = Path("/proc/self/clear_refs")
#: Files that reached new code and are changed further, at most.
KEPT: Final = 300


class TooSlow(BaseException):
    """The time of a case is over. The class is no Exception, so that no reader catches it."""


def _memory(name: str) -> float:
    """Return the memory of this process, bytes: VmRSS now, VmHWM at most since :func:`_reset`.

    0 on other systems than Linux.
    """
    with suppress(OSError, StopIteration):
        line = next(line for line in _STATUS.read_text("ascii").splitlines() if line.startswith(f"{name}:"))
        return 1024.0 * int(line.split()[1])
    return 0.0


def _reset() -> None:
    with suppress(OSError):
        _CLEAR.write_text("5", "ascii")


@contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    """Raise TooSlow after seconds of processor time, which do not depend on what else the machine does."""

    def ring(*_: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@dataclass(frozen=True)
class Broken:
    """The result of a reader that neither returned nor raised an FgOrientError."""

    kind: str
    text: str

    @property
    def key(self) -> str:
        """Return the kind and the innermost line of this program: one for each fault."""
        own = [line.strip() for line in self.text.splitlines() if "/fg_orient/" in line or "/factors/" in line]
        return f"{self.kind} {own[-1] if own else ''}"


def outcome(read: Callable[[], object], size: int, *, limits: bool = True) -> Broken | str:
    """Call a reader; return "" if it returned, the code of the error if it refused, else the failure.

    ``limits``: measure time and memory, too.
    """
    before = _memory("VmRSS") if limits else 0.0
    if limits:
        _reset()
    begin, result = time.perf_counter(), ""
    seconds = SECONDS + SECONDS_PER_BYTE * size
    try:
        with warnings.catch_warnings(), _alarm(seconds):
            warnings.simplefilter("ignore")
            read()
    except TooSlow:
        return Broken("time", f"more than {seconds:.1f} s for {size} bytes\n{traceback.format_exc()}")
    except FgOrientError as error:
        lines = [one.text() for one in error.problems]
        if not lines or any(len(line.splitlines()) != 1 or not _printable(line) for line in lines):
            return Broken("message", ascii(lines)[:2000])
        result = error.problems[0].code
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return Broken(type(error).__name__, traceback.format_exc())
    if limits:
        more = _memory("VmHWM") - before
        if more > MEMORY + MEMORY_PER_BYTE * size:
            return Broken("memory", f"{more / 1e6:.0f} MB for {size} bytes, after {time.perf_counter() - begin:.1f} s")
    return result


def _printable(text: str) -> bool:
    """Return whether a terminal shows a text as it is: no lone surrogates, no control characters."""
    return not any(c < " " or "\x7f" <= c <= "\x9f" or "\ud800" <= c <= "\udfff" for c in text)


@dataclass
class Tally:
    """Figures of a run."""

    cases: int = 0
    read: int = 0
    codes: dict[str, int] = field(default_factory=dict)
    broken: dict[str, Broken] = field(default_factory=dict)
    broken_cases: int = 0
    grown: int = 0


class Coverage:
    """New lines of the program, by sys.monitoring (Python 3.12): each line reports once, then costs nothing."""

    def __init__(self, wanted: bool) -> None:
        self.new = 0
        monitoring: Any = getattr(sys, "monitoring", None) if wanted else None
        if monitoring is None or monitoring.get_tool(monitoring.COVERAGE_ID) is not None:
            return
        monitoring.use_tool_id(monitoring.COVERAGE_ID, "tests.fuzz")

        def line(code: Any, _number: int) -> Any:
            if "fg_orient" in code.co_filename:
                self.new += 1
            return monitoring.DISABLE

        monitoring.register_callback(monitoring.COVERAGE_ID, monitoring.events.LINE, line)
        monitoring.set_events(monitoring.COVERAGE_ID, monitoring.events.LINE)

    def close(self) -> None:
        """End the observation."""
        monitoring: Any = getattr(sys, "monitoring", None)
        if monitoring is not None and monitoring.get_tool(monitoring.COVERAGE_ID) == "tests.fuzz":
            monitoring.set_events(monitoring.COVERAGE_ID, 0)
            monitoring.free_tool_id(monitoring.COVERAGE_ID)


class Session:
    """Cases of one reader: seeds, and changed files that reached new lines.

    Parameters
    ----------
    reader : Reader
    folder : Path
        Empty folder for its files.
    seed : int
        The same seed gives the same cases; guided, up to what earlier cases of the process have covered.
    keep : Path, optional
        Folder for what is found, and for the present case.
    guided : bool
        Change files that reached new lines further (Python 3.12).
    """

    def __init__(
        self, reader: Reader, folder: Path, seed: int, keep: Path | None = None, *, guided: bool = False
    ) -> None:  # fmt: skip
        self.reader, self.folder, self.keep = reader, folder, keep
        self.rng = random.Random(f"{reader.name} {seed}")
        folder.mkdir(parents=True, exist_ok=True)
        reader.make(folder)
        paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and reader.changes(path.name)]
        self.seeds = {path: path.read_bytes() for path in paths}
        self.pool: dict[Path, list[bytes]] = {path: [data] for path, data in self.seeds.items()}
        self.tally = Tally()
        self.coverage = Coverage(guided)

    def begin(self) -> Broken | str:
        """Read the seeds themselves; "" if they are read. A reader that refuses them is not tested beyond that."""
        found = outcome(lambda: self.reader.read(self.folder), sum(map(len, self.seeds.values())), limits=False)
        return found

    def case(self, *, limits: bool = True) -> Broken | str:
        """Change a file, read, and put it back."""
        path = self.rng.choice(list(self.seeds))
        pool = self.pool[path]
        base = pool[0] if self.rng.random() < 0.5 else self.rng.choice(pool)
        data = mutated(base, self.rng, list(self.seeds.values()))
        path.write_bytes(data)
        if self.keep is not None:
            (self.keep / f"{self.reader.name}.now").write_bytes(data)
        lines = self.coverage.new
        size = len(data) + sum(len(one) for other, one in self.seeds.items() if other != path)
        found = outcome(lambda: self.reader.read(self.folder), size, limits=limits)
        self.tally.cases += 1
        if isinstance(found, Broken):
            self._record(found, path, data)
        elif found:
            self.tally.codes[found] = self.tally.codes.get(found, 0) + 1
        else:
            self.tally.read += 1
        if self.coverage.new > lines and len(pool) < KEPT and len(data) < 200_000:
            pool.append(data)
            self.tally.grown += 1
        path.write_bytes(self.seeds[path])
        return found

    def _record(self, found: Broken, path: Path, data: bytes) -> None:
        self.tally.broken_cases += 1
        if found.key in self.tally.broken:
            return
        self.tally.broken[found.key] = found
        if self.keep is not None:
            name = f"{self.reader.name}-{found.kind}-{len(self.tally.broken)}"
            (self.keep / f"{name}.{path.name}").write_bytes(data)
            (self.keep / f"{name}.log").write_text(
                f"{path.relative_to(self.folder)}\n{found.text}\n", "utf-8", "replace"
            )

    def close(self) -> None:
        """Remove the files."""
        self.coverage.close()
        shutil.rmtree(self.folder, ignore_errors=True)
