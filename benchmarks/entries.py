"""An entry is one solver on one problem; each repeat of it is timed and gives one record."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from benchmarks.cases import Counts, note
from fg_orient.model.machine import keep_freed_memory

#: If another program has not reached the common cost after this time, its time is a lower bound.
LIMIT_S: Final = 1200.0
MAX_EVALUATIONS: Final = 300
#: On the pinhole problems all programs end when the cost decreases by less than this share.
FUNCTION_TOLERANCE: Final = 1e-8


@dataclass
class Outcome:
    """The outcome of one run of an entry contains its seconds and its cost.

    Parameters
    ----------
    solve : float
        Seconds from the start values to the end.
    structure : float
        Seconds of the preparation once per problem: arrays, ordering, sparsity, the objects
        of another program.
    iterations, evaluations : int
    cost : float or None
        Half the weighted sum of squares; None if the run has only one iteration.
    ended : str
        Reason for the end of the run.
    stages : dict
        Seconds of parts, by name.
    inner : int
        Number of solutions that ran one after the other; the seconds belong to the solution
        with the median duration.
    """

    solve: float
    structure: float
    iterations: int
    evaluations: int
    cost: float | None
    ended: str
    stages: dict[str, float] = field(default_factory=dict)
    inner: int = 1


@dataclass
class Entry:
    """An entry is a solver on a problem.

    Parameters
    ----------
    problem, size, solver : str
        Names; ``problem`` and ``size`` say together which records may be compared.
    counts : Counts
    run : callable
        Function that solves the problem once.
    repeats : int
        Largest number of runs.
    """

    problem: str
    size: str
    solver: str
    counts: Counts
    run: Callable[[], Outcome]
    repeats: int
    records: list[dict[str, Any]] = field(default_factory=list)

    @property
    def label(self) -> str:
        """Return the name for lines of progress."""
        return f"{self.problem} {self.size} {self.solver}"

    def record(self, outcome: Outcome) -> dict[str, Any]:
        """Return one JSON record."""
        return {
            "problem": self.problem, "size": self.size, "solver": self.solver, "repeat": len(self.records),
            "repeats": self.repeats, **asdict(self.counts), **asdict(outcome),
        }  # fmt: skip


@contextmanager
def quiet_memory() -> Iterator[None]:
    """Keep freed memory and exclude existing objects from the garbage collection.

    The adjustment does the same while it solves. All programs run in this context.
    """
    keep_freed_memory()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


def run_rounds(entries: list[Entry], budget_s: float, between: Callable[[], None]) -> None:
    """Run all entries in each round, so that other work on the machine delays all entries alike.

    Parameters
    ----------
    entries : list of Entry
        The records are appended to their ``records``.
    budget_s : float
        Seconds for all repeats of one entry; entries with a long first run are repeated less
        often.
    between : callable
        Function that is called once in each round; it measures the machine.
    """
    for turn in range(max(e.repeats for e in entries)):
        between()
        for entry in entries:
            if turn >= entry.repeats:
                continue
            note(f"round {turn + 1}: {entry.label}")
            with quiet_memory():
                outcome = entry.run()
            if turn == 0:
                whole = (outcome.solve + outcome.structure) * outcome.inner
                entry.repeats = max(1, min(entry.repeats, int(budget_s / max(whole, 1e-9))))
            entry.records.append(entry.record(outcome))
            note(f"    {outcome.solve:.4g} s, {outcome.iterations} iterations, cost {outcome.cost}: {outcome.ended}")


def ceres_outcome(summary: Any, structure_s: float, seconds: float, used: str, scale: float = 1.0) -> Outcome:
    """Return the outcome of a Ceres summary.

    The preprocessor orders the unknowns; its time belongs to the structure. ``scale``
    converts the cost of Ceres to the cost of fg_orient.
    """
    ordering, n = summary.preprocessor_time_in_seconds, int(summary.num_linear_solves)
    stages = {
        "linear_solver": summary.linear_solver_time_in_seconds,
        "residuals": summary.residual_evaluation_time_in_seconds,
        "jacobians": summary.jacobian_evaluation_time_in_seconds,
        "preprocessor": ordering,
        "minimizer": summary.minimizer_time_in_seconds,
        "linear_solves": float(n),
    }
    return Outcome(
        seconds - ordering, structure_s + ordering, n, int(summary.num_residual_evaluations),
        scale * float(summary.final_cost), f"{summary.termination_type.name}, {used}: {summary.message}", stages,
    )  # fmt: skip
