"""The module makes the tables of a run as rows of text, both for the terminal and for the page."""

from __future__ import annotations

from typing import Any, Final

from benchmarks.goals import MUST, WISHED, Goal, shown
from benchmarks.summary import Summary, Value, iteration_seconds, steady_seconds, whole_seconds

NAMES: Final = {
    "schur": "fg_orient (Schur)",
    "schur-1": "fg_orient (Schur), 1 thread",
    "schur-2": "fg_orient (Schur), 2 threads",
    "graph-gauss-newton": "fg_orient (graph, Gauss-Newton)",
    "graph-levenberg-marquardt": "fg_orient (graph, Levenberg-Marquardt)",
    "graph-dogleg": "fg_orient (graph, Dogleg)",
    "schur-levenberg-marquardt": "fg_orient (Schur), Levenberg-Marquardt",
    "graph": "fg_orient (explicit graph)",
    "adjust": "fg_orient (choice of `adjust`)",
    "trf-2-point": "scipy trf, 2-point",
    "trf-analytic": "scipy trf, Jacobian of fg_orient",
    "pyceres": "pyceres, function of fg_orient",
    "ceres-1": "Ceres C++ (pycolmap), 1 thread",
    "ceres-2": "Ceres C++ (pycolmap), 2 threads",
    "gtsam": "GTSAM C++",
    "gtsam-native": "GTSAM's optimiser, factors of fg_orient",
    "gtsam-native-iterate": "GTSAM's optimiser, factors of fg_orient",
    "compile": "compile",
    "read": "read",
}
#: Other programs are compared with this solver of fg_orient.
OWN: Final = {"spot": "schur", "pinhole": "schur", "resection": "adjust"}
NO_SOLUTION: Final = ("compile", "read")

Rows = list[list[str]]


def number(value: Value | None, digits: int = 3) -> str:
    """Return the median with quartiles, and ">=" before a lower bound."""
    if value is None:
        return "-"
    sign = ">= " if value.bound else ""
    middle, low, high = (f"{v:.{digits}g}" for v in (value.median, value.low, value.high))
    return f"{sign}{middle}" if value.repeats == 1 or low == high else f"{sign}{middle} ({low}..{high})"


def solver_rows(s: Summary) -> Rows:
    """Return seconds, iterations, cost and ratio to fg_orient for every solver on every problem."""
    out = [[
        "problem", "solver", "image points", "repeats", "structure s", "solve s", "iterations",
        "µs/point/iteration", "steady", "cost excess", "whole / fg_orient", "iteration / fg_orient",
    ]]  # fmt: skip
    for problem in ("spot", "resection", "pinhole"):
        for size in s.sizes(problem):
            out += [_solver_row(s, problem, size, name) for name in s.solvers(problem, size) if name not in NO_SOLUTION]
    return out


def _solver_row(s: Summary, problem: str, size: str, name: str) -> list[str]:
    records, ours = s.records(problem, size, name), OWN[problem]
    steady = s.per_point_us(problem, size, name, steady_seconds) if "retract" in records[0]["stages"] else None
    whole = None if records[0]["cost"] is None else s.ratio(problem, size, name, ours, whole_seconds)
    iteration = s.per_point_us(problem, size, name, iteration_seconds) if records[0]["iterations"] else None
    against = s.ratio(problem, size, name, ours, iteration_seconds) if records[0]["iterations"] else None
    excess = max(s.excess(r) for r in records)
    return [
        f"{problem} {size}", NAMES.get(name, name), str(records[0]["n_image_points"]), str(len(records)),
        number(s.value(problem, size, name, lambda r: float(r["structure"]))).removeprefix(">= "),
        number(s.value(problem, size, name, lambda r: float(r["solve"]))), str(records[-1]["iterations"]),
        number(iteration).removeprefix(">= "), number(steady), "-" if excess != excess else f"{excess:.0e}",
        number(whole), number(against).removeprefix(">= "),
    ]  # fmt: skip


def bound_rows(s: Summary) -> Rows:
    """Return the steady iteration of fg_orient divided by the bound of the hardware, for each size."""
    out = [[
        "image points", "images", "pairs per image point", "threads", "µs/point/iteration", "bound µs", "x bound",
        "band bound µs", "x band bound", "pair blocks x bound",
    ]]  # fmt: skip
    for size in s.sizes("spot"):
        for threads in (1, 2):
            records = s.records("spot", size, f"schur-{threads}")
            if not records:
                continue
            r, n = records[0], records[0]["n_image_points"]
            bounds = [s.bound_seconds(size, threads, banded=b) or 0.0 for b in (False, True)]
            over = [number(s.over_bound(size, threads, banded=b)) for b in (False, True)]
            out.append([
                str(n), str(r["n_images"]), f"{r['n_pairs'] / n:.2f}", str(threads),
                number(s.per_point_us("spot", size, f"schur-{threads}", steady_seconds)),
                f"{bounds[0] / n * 1e6:.3f}", over[0], f"{bounds[1] / n * 1e6:.3f}", over[1],
                number(s.pairs_over_bound(size, threads)),
            ])  # fmt: skip
    return out


def stage_rows(s: Summary) -> Rows:
    """Return the nanoseconds per image point of the stages of one iteration with two threads."""
    records = {size: s.records("spot", size, "schur-2") for size in s.sizes("spot")}
    names = list(dict.fromkeys(name for found in records.values() for r in found for name in r["stages"]))
    out = [["ns per image point, 2 threads", *records]]
    for name in names:
        cells = []
        for found in records.values():
            have = [r["stages"][name] / r["n_image_points"] * 1e9 for r in found if name in r["stages"]]
            cells.append(f"{Value.of(have).median:.0f}" if have else "-")
        out.append([name.replace("kernel:", "kernel "), *cells])
    return out


def preparation_rows(s: Summary) -> Rows:
    """Return the seconds before the first iteration."""
    out = [["image points", "read s", "compile s", "structure s (1 thread)", "structure s (2 threads)"]]
    for size in s.sizes("spot"):
        n = next(r["n_image_points"] for r in s.results["records"] if (r["problem"], r["size"]) == ("spot", size))
        cells = [s.value("spot", size, "read", whole_seconds), s.value("spot", size, "compile", whole_seconds)]
        cells += [s.value("spot", size, f"schur-{t}", lambda r: float(r["structure"])) for t in (1, 2)]
        out.append([str(n), *map(number, cells)])
    return out


def memory_rows(s: Summary) -> Rows:
    """Return the working sets in bytes per image point."""
    out = [["image points", "threads", "backend", "working set", "with records", "solve only", "input arrays"]]
    for m in s.results["memory"]:
        n = m["n_image_points"]
        figures = (m["working_set"], m["working_set"] + m["records"], m["solve_only"], m["input"])
        out.append([str(n), str(m["threads"]), m.get("backend", "schur"), *(f"{v / n:.0f}" for v in figures)])
    return out


def goal_rows(s: Summary, goals: tuple[Goal, ...], *, must: bool) -> Rows:
    """Return the goals with the measured figures."""
    out = [["goal", "measured", *(["limit"] if must else ["target", "stretch"]), "verdict"]]
    for goal in goals:
        found, sign = goal.measure(s), ">=" if goal.more else "<="
        marks = [goal.limit] if must else [goal.target, goal.stretch]
        cells = ["-" if m is None else f"{sign} {shown(m, 0 if m >= 10 else 2)}" for m in marks]
        text = (
            "-" if found is None else f"{'>= ' if found.bound and goal.more else ''}{shown(found.median, goal.digits)}"
        )
        out.append([goal.name, text, *cells, goal.verdict(found)])
    return out


def all_tables(results: dict[str, Any]) -> dict[str, Rows]:
    """Return the tables by heading, in the order of the page."""
    s = Summary(results)
    return {
        "Limits": goal_rows(s, MUST, must=True),
        "Targets": goal_rows(s, WISHED, must=False),
        "All solvers": solver_rows(s),
        "Against the hardware": bound_rows(s),
        "Stages of an iteration": stage_rows(s),
        "Before the first iteration": preparation_rows(s),
        "Memory": memory_rows(s),
    }


def print_table(results: dict[str, Any]) -> None:
    """Print all tables in columns."""
    for heading, rows in all_tables(results).items():
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        print(f"\n{heading}")
        for row in rows:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
