"""Progress of an adjustment on the terminal: stages, iterations, image points per second, time left.

How many iterations are to come nobody knows; the time left is what they would take if the steps went on shrinking as
the last one did, or if graduated non-convexity took all its stages. Where neither can be said, none is shown.
"""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from fg_orient.adjustment.loop import IterationRecord

#: A step that is not below this part of the one before says nothing about the end.
SHRINKING = 0.9


class Watch(Protocol):
    """Who is told of the progress."""

    def stage(self, name: str, image_points: int) -> None:
        """A stage of the work begins."""
        ...

    def iteration(self, record: IterationRecord) -> None:
        """An iteration is done."""
        ...


class Silence:
    """Tells nobody."""

    def stage(self, name: str, image_points: int) -> None:
        """See :class:`Watch`."""

    def iteration(self, record: IterationRecord) -> None:
        """See :class:`Watch`."""


def iterations_left(log: Sequence[IterationRecord]) -> int | None:
    """Iterations to come at the present rate of convergence; None where that cannot be said."""
    from fg_orient.adjustment.gnc import stages_left
    from fg_orient.adjustment.loop import STEP_TOLERANCE

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
    """Iteration, step, rate and, where it can be said, the time left."""
    last, words = log[-1], [f"iteration {log[-1].iteration}", f"step {log[-1].step:.1e}"]
    if last.seconds > 0.0:
        words.append(f"{image_points * last.iteration / last.seconds:,.0f} image points/s")
    left = iterations_left(log)
    if left is not None:
        words.append(f"about {left * last.seconds / last.iteration:.0f} s left")
    return ", ".join(words)


@contextlib.contextmanager
def progress(silent: bool) -> Iterator[Watch]:
    """Show a bar on the terminal, if standard error is one."""
    if silent or not sys.stderr.isatty():
        yield Silence()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}", markup=False), BarColumn(bar_width=20), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield _Bar(bar)


class _Bar:
    """Watch on a bar of rich."""

    def __init__(self, bar: object) -> None:
        from rich.progress import Progress

        assert isinstance(bar, Progress)
        self._bar, self._task = bar, bar.add_task("starting", total=None)
        self._log: list[IterationRecord] = []
        self._image_points = 0

    def stage(self, name: str, image_points: int) -> None:
        """See :class:`Watch`."""
        self._image_points = image_points
        self._bar.update(self._task, description=name, total=None)

    def iteration(self, record: IterationRecord) -> None:
        """See :class:`Watch`."""
        self._log.append(record)
        left, done = iterations_left(self._log), len(self._log)
        self._bar.update(
            self._task, description=describe(self._log, self._image_points), completed=done,
            total=None if left is None else done + left,
        )  # fmt: skip
