"""The module computes medians, quartiles, ratios and the bound from the JSON file of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmarks.hardware import Hardware, best, iteration_bound, pair_bound

#: A run counts if its cost exceeds the lowest cost found on the same problem by at most this share.
SAME_COST: Final = 1e-6
#: The exponent is fitted to sizes from this number of image points.
EXPONENT_FROM: Final = 800

Record = dict[str, Any]


@dataclass(frozen=True)
class Value:
    """Median and quartiles of the repeats.

    ``bound`` marks a lower bound, if the other program did not reach the cost.
    """

    median: float
    low: float
    high: float
    repeats: int
    bound: bool = False

    @classmethod
    def of(cls, values: Iterable[float], bound: bool = False) -> Value:
        """Return the value of all repeats."""
        all_of = list(values)
        low, median, high = np.percentile(all_of, [25.0, 50.0, 75.0])
        return cls(float(median), float(low), float(high), len(all_of), bound)

    def times(self, factor: float) -> Value:
        """Return the value in another unit."""
        return Value(self.median * factor, self.low * factor, self.high * factor, self.repeats, self.bound)


def whole_seconds(record: Record) -> float:
    """Return the seconds of structure and solution."""
    return float(record["structure"]) + float(record["solve"])


def iteration_seconds(record: Record) -> float:
    """Return the seconds of the solution divided by its iterations, for all solvers alike."""
    return float(record["solve"]) / max(int(record["iterations"]), 1)


def steady_seconds(record: Record) -> float:
    """Return the seconds of linearise, solve and retract of fg_orient in memory that was used before."""
    return float(sum(record["stages"][name] for name in ("linearise", "solve", "retract")))


class Summary:
    """The summary answers queries on one file of results.

    Parameters
    ----------
    results : dict
        Content of the file that ``benchmarks/fast_path.py`` wrote.
    """

    def __init__(self, results: dict[str, Any]) -> None:
        self.results = results
        self.hardware: Hardware = best(results["hardware"])

    def records(self, problem: str, size: str, solver: str) -> list[Record]:
        """Return the repeats of one entry in their order; none if it was not run."""
        return [r for r in self.results["records"] if (r["problem"], r["size"], r["solver"]) == (problem, size, solver)]

    def sizes(self, problem: str) -> list[str]:
        """Return the sizes that were run, smallest first."""
        found = {r["size"]: r["n_image_points"] for r in self.results["records"] if r["problem"] == problem}
        return sorted(found, key=lambda size: found[size])

    def solvers(self, problem: str, size: str) -> list[str]:
        """Return the solvers that were run, in the order of the run."""
        here = [r["solver"] for r in self.results["records"] if (r["problem"], r["size"]) == (problem, size)]
        return list(dict.fromkeys(here))

    def lowest_cost(self, problem: str, size: str) -> float:
        """Return the lowest cost that any solver found on a problem."""
        return float(
            min(
                r["cost"]
                for r in self.results["records"]
                if (r["problem"], r["size"]) == (problem, size) and r["cost"] is not None
            )
        )

    def excess(self, record: Record) -> float:
        """Return the relative excess of the cost over the lowest cost; nan if the run is no whole solution."""
        if record["cost"] is None:
            return float("nan")
        lowest = self.lowest_cost(record["problem"], record["size"])
        return (float(record["cost"]) - lowest) / lowest

    def reached(self, records: list[Record]) -> bool:
        """Return whether all repeats reached the common cost."""
        return all(not self.excess(r) > SAME_COST for r in records)

    def value(self, problem: str, size: str, solver: str, of: Callable[[Record], float]) -> Value | None:
        """Return a figure of one entry; None if it was not run."""
        records = self.records(problem, size, solver)
        return Value.of(map(of, records), not self.reached(records)) if records else None

    def ratio(
        self, problem: str, size: str, peer: str, own: str, of: Callable[[Record], float],
        own_of: Callable[[Record], float] | None = None,
    ) -> Value | None:  # fmt: skip
        """Return the ratio of another program to fg_orient in the rounds in which both ran: median and quartiles.

        The ratio is a lower bound if the other program did not reach the common cost. It is
        None if one of them was not run, or if fg_orient did not reach the common cost.
        """
        theirs, ours = self.records(problem, size, peer), self.records(problem, size, own)
        if not theirs or not ours or not self.reached(ours):
            return None
        ours_of = own_of or of
        pairs = [of(a) / ours_of(b) for a, b in zip(theirs, ours, strict=False)]
        return Value.of(pairs, not self.reached(theirs))

    def per_point_us(self, problem: str, size: str, solver: str, of: Callable[[Record], float]) -> Value | None:
        """Return the microseconds per image point."""
        found = self.value(problem, size, solver, of)
        return None if found is None else found.times(1e6 / self.records(problem, size, solver)[0]["n_image_points"])

    def bound_seconds(self, size: str, threads: int, *, banded: bool) -> float | None:
        """Return the least seconds of one iteration of the SPOT problem of a size on this machine."""
        records = self.records("spot", size, f"schur-{threads}")
        if not records:
            return None
        r = records[0]
        band = int(r["half_bandwidth"]) if banded else None
        return iteration_bound(
            self.hardware, threads, r["n_image_points"], r["n_pairs"], r["image_unknowns"], half_bandwidth=band
        )

    def over_bound(self, size: str, threads: int, *, banded: bool) -> Value | None:
        """Return the steady iteration of fg_orient divided by the bound."""
        bound, ours = (
            self.bound_seconds(size, threads, banded=banded),
            self.value("spot", size, f"schur-{threads}", steady_seconds),
        )
        return None if bound is None or ours is None else ours.times(1.0 / bound)

    def pairs_over_bound(self, size: str, threads: int) -> Value | None:
        """Return the seconds of the blocks of the reduced system divided by their bound."""
        records = self.records("spot", size, f"schur-{threads}")
        stage = "kernel:pair_blocks"
        if not records or stage not in records[0]["stages"]:
            return None
        bound = pair_bound(self.hardware, threads, records[0]["n_pairs"])
        return Value.of(r["stages"][stage] / bound for r in records)

    def exponent(self, solver: str, up_to: int) -> float | None:
        """Return the slope of log(seconds of an iteration) over log(image points) from 1e3 on.

        Return None if the largest block that was run has less than half of ``up_to`` image
        points.
        """
        points, seconds = [], []
        for size in self.sizes("spot"):
            found, records = self.value("spot", size, solver, steady_seconds), self.records("spot", size, solver)
            if found is not None and records[0]["n_image_points"] >= EXPONENT_FROM:
                points.append(records[0]["n_image_points"])
                seconds.append(found.median)
        if len(points) < 2 or 2 * max(points) < up_to:
            return None
        return float(np.polyfit(np.log(points), np.log(seconds), 1)[0])

    def working_set(
        self, size: str, threads: int, *, with_records: bool = False, backend: str = "schur"
    ) -> float | None:
        """Return the bytes per image point; ``with_records`` includes the records of the equations."""
        wanted = size, threads, backend
        found = [m for m in self.results["memory"] if (m["size"], m["threads"], m.get("backend", "schur")) == wanted]
        if not found:
            return None
        extra = found[0]["records"] if with_records else 0
        return float((found[0]["working_set"] + extra) / found[0]["n_image_points"])
