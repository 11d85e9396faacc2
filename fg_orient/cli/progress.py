"""Show the progress of a command on the terminal and in the log.

For an adjustment, the display shows stages, iterations, image points per second and the
remaining time. For other work, it shows the steps, their rate and the remaining time;
without steps, it shows the elapsed time. The number of further iterations is estimated
from the last reduction of the step, or from the stages of graduated non-convexity. If
both are unknown, no remaining time is shown.
"""

from __future__ import annotations

import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from factors._preparation import on_compilation
from fg_orient.cli.log import session

if TYPE_CHECKING:
    from fg_orient.adjustment.loop import IterationRecord

#: Note when the first kernels are compiled and can be saved.
COMPILING: Final = "compiling the kernels of this command, once per machine: up to about 15 s"
#: The same note if the kernels cannot be saved.
COMPILING_IN_VAIN: Final = (
    "compiling the kernels of this command, up to about 15 s in this run and every later run: no folder for compiled "
    "code can be written; set NUMBA_CACHE_DIR to a folder that you can write"
)
#: Function that receives a text, the number of finished steps, and the number of all steps (None: unknown).
Show = Callable[[str, int, int | None], None]

#: If steps follow each other fast, the log gets a line only after this time, s.
LOG_EVERY_S: Final = 1.0
#: The end is estimated only if the ratio of successive steps is below this value.
SHRINKING = 0.9


def iterations_left(log: Sequence[IterationRecord]) -> int | None:
    """Estimate the number of further iterations from the current rate of convergence; None if it is unknown."""
    from fg_orient.adjustment.loop import STEP_TOLERANCE
    from fg_orient.adjustment.stages import stages_left

    mu = log[-1].mu if log else math.nan
    if math.isfinite(mu):
        stages = len(dict.fromkeys(record.mu for record in log))
        left = stages_left([record.mu for record in log])
        return None if left is None else math.ceil(left * len(log) / stages)
    steps = [record.step for record in log if record.accepted and _same(record.mu, mu)][-2:]
    if len(steps) < 2 or not 0.0 < steps[1] < SHRINKING * steps[0] < math.inf:
        return None
    rate = math.log(steps[1] / steps[0])
    return max(math.ceil(math.log(STEP_TOLERANCE / steps[1]) / rate), 0)


def _same(one: float, other: float) -> bool:
    return one == other or (math.isnan(one) and math.isnan(other))


def describe(log: Sequence[IterationRecord], image_points: int) -> str:
    """Describe an iteration: number, step, rate and, if known, the remaining time."""
    last, words = log[-1], [f"iteration {log[-1].iteration}", f"step {log[-1].step:.1e}"]
    if last.seconds > 0.0:
        words.append(f"{image_points * last.iteration / last.seconds:,.0f} image points/s")
    left = iterations_left(log)
    if left is not None:
        words.append(f"about {duration(left * last.seconds / last.iteration)} left")
    return ", ".join(words)


def duration(seconds: float) -> str:
    """Format a time, rounded to seconds, minutes or tenths of an hour."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{seconds / 3600.0:.1f} h"


def describe_steps(text: str, done: int, total: int, seconds: float) -> str:
    """Describe work in steps: its name, the finished steps, their rate and the remaining time."""
    words = [f"{text} {done} of {total}".strip()]
    if done > 0 and seconds > 0.0:
        rate = done / seconds
        words.append(f"{rate:,.1f}/s" if rate >= 1.0 else f"{duration(1.0 / rate)} each")
        words.append(f"about {duration((total - done) / rate)} left")
    return ", ".join(words)


@contextlib.contextmanager
def progress() -> Iterator[Watch]:
    """Show the progress of an adjustment in the log; also on standard error if it is a terminal."""
    with _bar("starting") as show:
        yield Watch(show)


@contextlib.contextmanager
def progress_bar(first: str) -> Iterator[Callable[[int, int, str], None] | None]:
    """Show the progress of work in steps, or in one long step; ``first`` is the text until the first step ends."""
    session().tell("stage", stage=first)
    with _bar(first) as show:
        yield None if show is None and session().log is None else _Steps(show)


@contextlib.contextmanager
def _bar(first: str) -> Iterator[Show | None]:
    """Return a function that shows a text, finished steps and all steps on a terminal; None without a terminal."""
    if session().as_json or session().quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    # TimeElapsedColumn stops when all steps are done for the first time, although other work follows
    clock = TextColumn("{task.fields[begin]}")
    columns = TextColumn("{task.description}", markup=False), BarColumn(bar_width=20), clock
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(first, total=None, begin=_Clock())

        def show(text: str, done: int, total: int | None) -> None:
            bar.tasks[0].total = total  # update() ignores None
            bar.update(task, description=text, completed=done)

        with on_compilation(lambda kernel: bar.update(task, description=COMPILING)):
            yield show


class _Clock:
    """Clock that gives the time since its creation as text."""

    def __init__(self) -> None:
        self._begin = time.perf_counter()

    def __str__(self) -> str:
        seconds = int(time.perf_counter() - self._begin)
        return f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}"


class Watch:
    """Progress of an adjustment, on the terminal and in the log."""

    def __init__(self, show: Show | None) -> None:
        self._show, self._session = show, session()
        self._log: list[IterationRecord] = []
        self._image_points = 0

    def stage(self, name: str, image_points: int) -> None:
        """Show that a stage of the work begins."""
        self._image_points = image_points
        self._session.tell("stage", stage=name, image_points=image_points)
        if self._show is not None:
            self._show(name, 0, None)

    def iteration(self, record: IterationRecord) -> None:
        """Show an iteration."""
        self._log.append(record)
        self._session.tell("iteration", **asdict(record))
        if self._show is not None:
            left, done = iterations_left(self._log), len(self._log)
            self._show(describe(self._log, self._image_points), done, None if left is None else done + left)


class _Steps:
    """Callback that shows work in steps on the terminal and in the log."""

    def __init__(self, show: Show | None) -> None:
        self._show, self._session = show, session()
        self._begin, self._logged = time.perf_counter(), -math.inf
        self._done, self._text = 0, ""

    def __call__(self, done: int, total: int, text: str = "") -> None:
        if done < self._done or (done == 0 and text != self._text):  # other work has begun, which has another rate
            self._begin, self._logged = time.perf_counter(), -math.inf
        self._done, self._text = done, text
        seconds = time.perf_counter() - self._begin
        if done >= total or seconds - self._logged >= LOG_EVERY_S:
            self._logged = seconds
            self._session.tell("progress", done=done, total=total, text=text, seconds=round(seconds, 3))
        if self._show is not None:
            self._show(describe_steps(text, done, total, seconds), done, total)
