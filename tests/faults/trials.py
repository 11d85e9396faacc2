"""A trial runs a command on a copy of a folder: calls fail, processes are killed, or two commands write."""

from __future__ import annotations

import random
import re
import shutil
import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.harness import ERRORS, PAUSE, Ended, Running, command, library, run, warm
from tests.faults.same import contents


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
    again : sequence of str
        Options that replace an existing output.
    kept : sequence of str
        Beginnings of names that a failed run may leave or write: whole outputs, and files from which the next run
        continues.
    resume : sequence of str
        Options of the run after a killed one.
    tolerated : sequence of int
        Exit codes of a run that wrote its output.
    other : sequence of str
        Options of a second writer whose output differs.
    """

    name: str
    template: Path
    words: Callable[[Path], Sequence[object]]
    again: Sequence[str] = ()
    kept: Sequence[str] = ()
    resume: Sequence[str] = ()
    tolerated: Sequence[int] = (0, 4)
    other: Sequence[str] = ()


@dataclass
class Report:
    """Result of the trials of a scenario."""

    name: str
    calls: int = 0
    tried: int = 0
    runs: int = 0
    failures: list[str] = field(default_factory=list)
    ends: dict[str, int] = field(default_factory=dict)

    def count(self, end: str) -> None:
        self.ends[end] = self.ends.get(end, 0) + 1


class Faults:
    """Trials of one scenario.

    Parameters
    ----------
    scenario : Scenario
    work : Path
        Folder for the copies.
    """

    def __init__(self, scenario: Scenario, work: Path) -> None:
        self.scenario, self.root = scenario, work / "copy"
        self.report = Report(scenario.name)
        self._copy()
        self.before = contents(self.root)
        warm(command(*scenario.words(self.root)))
        self.good, self.after = self._alone()
        again, after = self._alone()
        assert after == self.after and again.count == self.good.count, f"{scenario.name}: two runs differ"
        self.report.calls = self.good.count

    def _copy(self) -> None:
        shutil.rmtree(self.root, ignore_errors=True)
        shutil.copytree(self.scenario.template, self.root)

    def _alone(self, *more: str) -> tuple[Ended, dict[str, str]]:
        """Return the undisturbed run on a new copy, and the files after it."""
        self._copy()
        ended = run(command(*self.scenario.words(self.root), *more), self.root)
        assert ended.code in self.scenario.tolerated, ended
        return ended, contents(self.root)

    def fail(self, nth: int, name: str, *, sticky: bool = False) -> None:
        """Make a call fail once, or from then on; check the files and the message."""
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
        removal = any(library().removes(number) for number, _ in ended.calls[nth - 1 : None if sticky else nth])
        files = contents(self.root)
        if ended.code in self.scenario.tolerated:
            self.report.count("output whole")
            self._compare(where, ended, files, self.after, hidden=removal)
        elif ended.code in (2, 3):
            self.report.count(f"exit {ended.code}")
            self._compare(where, ended, files, self.before, hidden=removal)
            self._message(where, ended)
        else:
            self._note(f"{where}: code {ended.code}: {ended.stderr[-600:]}")
        if removal and not sticky:  # the next run removes what this one could not
            self._next_run(where)

    def _compare(
        self, where: str, ended: Ended, files: dict[str, str], expected: dict[str, str], *, hidden: bool
    ) -> None:
        kept = (*self.scenario.kept, *((".",) if hidden else ()))
        changed = sorted(
            name for name, _ in files.items() ^ expected.items()
            if not name.startswith(tuple(kept)) and not (hidden and "/." in name)
        )  # fmt: skip
        if changed:
            self._note(f"{where}: code {ended.code}, but left or changed {changed[:8]} {ended.stderr[-300:]}")

    def _message(self, where: str, ended: Ended) -> None:
        lines = [line for line in ended.stderr.splitlines() if line.startswith("error:")]
        if len(lines) != 1 or "Traceback" in ended.stderr:
            self._note(f"{where}: message {ended.stderr[-600:]}")

    def kill_after(self, seconds: float) -> bool:
        """Kill the command after some time; check the next run; return False if it had ended before."""
        self._copy()
        ended = run(command(*self.scenario.words(self.root)), self.root, count=False, kill_after_s=seconds)
        self.report.runs += 1
        if ended.code != -signal.SIGKILL:
            return False
        self._next_run(f"{self.scenario.name}: killed after {seconds:.3f} s")
        return True

    def kill_at_random_times(self, kills: int, seed: int) -> None:
        """Kill the command at random times of its usual duration."""
        self._copy()
        begin = time.monotonic()
        run(command(*self.scenario.words(self.root)), self.root, count=False)
        duration, rng, done = time.monotonic() - begin, random.Random(seed), 0
        while done < kills:
            done += self.kill_after(rng.uniform(0.0, duration))

    def _next_run(self, where: str) -> None:
        """Repeat the command after a killed one; check for the bits of a run without the kill and no further files."""
        words = (*self.scenario.words(self.root), *self.scenario.resume)
        ended, end = run(command(*words), self.root, count=False), "next run writes the output"
        if ended.code == 2 and ("--overwrite" in ended.stderr or "exists already" in ended.stderr):
            there = {name: digest for name, digest in contents(self.root).items() if not name.startswith(".")}
            whole = there.items() >= {(n, d) for n, d in self.after.items() if not n.startswith(".")}
            end = "output was whole" if whole else "some files of the output were whole: --overwrite"
            ended = run(command(*words, *self.scenario.again), self.root, count=False)
        elif "to resume" not in ended.stderr and self.scenario.resume:
            end = "next run resumes"
        self.report.count(end)
        files = contents(self.root)
        if ended.code != self.good.code or files != self.after:
            names = sorted({name for name, _ in files.items() ^ self.after.items()})
            self._note(f"{where}: next run {ended.code}, differs in {names[:8]}, {ended.stderr[-300:]}")

    def two_writers(self, chosen: Sequence[int], *, overwrite: bool) -> None:
        """Run a second command while the first one waits before some of its calls.

        One output is then whole, and there are no other files.
        """
        more = self.scenario.again if overwrite else ()
        seconds = (*more, *self.scenario.other)
        first, second = self._alone(*more)[1], self._alone(*seconds)[1]
        for nth in chosen:
            self._copy()
            words = self.scenario.words(self.root)
            waiting = Running(command(*words, *more), self.root, nth=nth, error=PAUSE)
            reached = waiting.paused()
            inside = run(command(*words, *seconds), self.root, count=False)
            waiting.go_on()
            outside = waiting.ended()
            self.report.runs += 1
            call = outside.calls[nth - 1] if reached else "not reached"
            where = f"{self.scenario.name} {' '.join(more)}: second writer before call {nth} {call}"
            files = contents(self.root)
            written = [
                expected for ended, expected in ((outside, first), (inside, second))
                if ended.code in self.scenario.tolerated
            ]  # fmt: skip
            self.report.count(f"{' '.join(more) or 'new'}: first {outside.code}, second {inside.code}")
            for ended in (outside, inside):
                if ended.code not in self.scenario.tolerated:
                    self._message(where, ended)
                    if ended.code not in (2, 3):
                        self._note(f"{where}: code {ended.code} {ended.stderr[-600:]}")
            if self.scenario.again and not overwrite and len(written) != 1:
                self._note(f"{where}: codes {outside.code}, {inside.code}: an output was replaced, or there is none")
            if files not in written:
                names = [sorted({n for n, _ in files.items() ^ one.items()})[:6] for one in (first, second)]
                self._note(f"{where}: codes {outside.code}, {inside.code}, differs from both in {names}")

    def _note(self, text: str) -> None:
        self.report.failures.append(text)


def sample(ended: Ended, most: int | None, seed: int, *, alike: int | None = None) -> list[int]:
    """Return numbers of calls: all of them, or some at random with the first and the last.

    ``alike``: of the calls of one kind for one file, all up to this number, and every fifth after it.
    """
    numbers, seen = list[int](), Counter[tuple[int, str]]()
    for nth, (kind, path) in enumerate(ended.calls, start=1):
        key = kind, re.sub(r"[0-9a-f]{12}", "", path)
        if alike is None or seen[key] < alike or (seen[key] - alike) % 5 == 4:
            numbers.append(nth)
        seen[key] += 1
    if most is None or most >= len(numbers):
        return numbers
    chosen = random.Random(seed).sample(numbers, max(most - 2, 0))
    return sorted({numbers[0], numbers[-1], *chosen})
