"""What is timed: an entry is one solver on one problem, and gives one record per repeat."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from benchmarks.cases import Counts, note
from fg_orient.model.machine import keep_freed_memory

#: A peer that has not reached the common cost after this is a lower bound.
LIMIT_S: Final = 1200.0
MAX_EVALUATIONS: Final = 300
#: All programs end on the pinhole problems when the cost falls by less than this share.
FUNCTION_TOLERANCE: Final = 1e-8


@dataclass
class Outcome:
    """One run of an entry: seconds and what it reached.

    Parameters
    ----------
    solve : float
        Seconds from the start values to the end.
    structure : float
        Seconds of what is made once per problem: arrays, ordering, sparsity, the peer's own objects.
    iterations, evaluations : int
    cost : float or None
        Half the weighted sum of squares; None if the run is no whole solution (one iteration only).
    ended : str
        Why it ended.
    stages : dict
        Seconds of parts, by name.
    inner : int
        Solutions that ran one after the other; the seconds are of the one of median duration.
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
    """A solver on a problem.

    Parameters
    ----------
    problem, size, solver : str
        Names; ``problem`` and ``size`` say together which records may be compared.
    counts : Counts
    run : callable
        Solve once.
    repeats : int
        Runs of it at most.
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
        """Name for progress lines."""
        return f"{self.problem} {self.size} {self.solver}"

    def record(self, outcome: Outcome) -> dict[str, Any]:
        """One JSON record."""
        return {
            "problem": self.problem, "size": self.size, "solver": self.solver, "repeat": len(self.records),
            "repeats": self.repeats, **asdict(self.counts), **asdict(outcome),
        }  # fmt: skip


@contextmanager
def quiet_memory() -> Iterator[None]:
    """As the adjustment does while it solves: what exists is not searched for garbage, freed memory is kept.

    All programs run in it.
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
    """Run all entries in each round, so that a busy moment of the machine meets all alike.

    Parameters
    ----------
    entries : list of Entry
        Their ``records`` grow.
    budget_s : float
        Seconds for all repeats of one entry: those whose first run was long are repeated less often.
    between : callable
        Called once a round: measures the machine.
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
    """Give what a Ceres summary tells; its preprocessor orders the unknowns: structure, not solution.

    ``scale`` turns its cost into ours.
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
