"""The benchmark measures wide networks: time to the same chi2 as Ceres C++, and iterations of grids and strips.

    python -m benchmarks.wide [--sizes "340 mixed" ...] [--threads 1 2] [--repeats N] [--limit S]

adds the runs that results/wide.json does not contain. ``python -m benchmarks.page`` makes a
section of docs/performance.md from the file. Each solution is a process of its own, and all
solvers run once in each round. The time of a solver ends when its chi2 exceeds the lowest of
all by at most 1e-9, according to the log of its iterations. The time includes the preparation
once per problem. Processor seconds are counted for a whole solution; the processor time of an
iteration of Ceres is computed from its share of the wall-clock time.
"""

from __future__ import annotations

import os
import sys

if __name__ == "__main__" and {os.environ.get(f"{name}_NUM_THREADS") for name in ("OPENBLAS", "OMP")} != {"1"}:
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    os.execv(sys.executable, [sys.executable, "-m", "benchmarks.wide", *sys.argv[1:]])

import argparse
import itertools
import json
import re
import subprocess
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any, Final

import fg_orient as fg
from benchmarks import frames, pinhole
from benchmarks.cases import note
from benchmarks.hardware import this_machine
from fg_orient.adjustment.loop import levenberg_marquardt
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.adjustment.schur import SchurBackend
from fg_orient.adjustment.solve import solve
from fg_orient.formats.atomic import write_bytes
from fg_orient.model import machine
from fg_orient.model.machine import calm_memory
from tests.support.pinhole import pinhole_block

RESULTS: Final = Path(__file__).parent / "results" / "wide.json"
#: The chi2 at the end of a solution may exceed the lowest chi2 by this share.
SAME: Final = 1e-9
#: Linear solver of Ceres, and relative accuracy of an iterative solver: Ceres' default and a tenth of it.
CERES: Final = {
    "ceres-dense": ("DENSE_SCHUR", 0.1), "ceres-sparse": ("SPARSE_SCHUR", 0.1),
    "ceres-iterative": ("ITERATIVE_SCHUR", 0.1), "ceres-iterative-0.01": ("ITERATIVE_SCHUR", 0.01),
}  # fmt: skip
OURS: Final = "fg_orient"
#: For each size, the time of the best solver of Ceres divided by that of fg_orient must be at least this.
LEAST: Final = {"340 mixed": 1.5, "1000 mixed": 1.2, "3000 mixed": 1.0}
#: Ceres factorises up to this number of cameras: at 3000 a full factor takes 6e12 operations
#: and 6 GB in each iteration.
FACTORISED: Final = 1000
#: Solvers that took more than this times the time of the best in the first round are not repeated.
SLOW: Final = 2.0
MOST: Final = 100
#: Line of Ceres' log: iteration, cost, change of the cost, ..., seconds.
LINE: Final = re.compile(r"^\s*\d+\s+\S+\s+(\S+)\s.*\s(\S+)\s*$")
#: The iterations of these networks are timed, with the limit of an iteration in seconds.
ITERATIONS: Final = {"2500 in a grid": 2.0, "2000 in a strip": 0.2, "500 images, 37 points": 0.1}

Row = list[str]


def network(name: str) -> Problem:
    """Return a problem of :data:`ITERATIONS`.

    Grids and strips have 40 or 25 points for each camera with four rays each. The free
    network has 37 points in all images, and scale bars.
    """
    if name == "500 images, 37 points":
        block, _ = frames.network(frames.SIZES["500 photos, 37 points"])
        return fg.adjust(block).problem
    block, _ = pinhole_block(2500, 100_000) if "grid" in name else pinhole_block(2000, 50_000, columns=2000)
    return compile_problem(block)


def iterations(name: str) -> dict[str, Any]:
    """Return the processor seconds of an iteration after the first one, with default options, in the second run."""
    problem, marks = network(name), list[float]()
    solve(problem)
    machine.release()
    before = machine.status_bytes("VmRSS")
    machine.reset_peak()
    estimate = solve(problem, lambda _: marks.append(time.process_time()))
    choice = getattr(estimate.linear, "choice", None)
    return {
        "iteration_s": median(b - a for a, b in itertools.pairwise(marks)), "iterations": len(marks),
        "backend": estimate.backend, "reduced": "" if choice is None else choice.kind,
        "image_points": len(problem.observations), "unknowns": problem.n_image_unknowns,
        "memory": machine.status_bytes("VmHWM") - before,
    }  # fmt: skip


def ours(size: str, threads: int) -> dict[str, Any]:
    """Run Levenberg-Marquardt on the Schur backend."""
    problem, log = pinhole.pinhole_problem(size), list[tuple[float, float, float]]()
    with calm_memory():
        for reduced in ("auto", "implicit"):  # the time of the first calls, which load the kernels, is not counted
            small = SchurBackend(pinhole.pinhole_problem("1e4"), threads, reduced)
            levenberg_marquardt(small, small.initial(), MOST)
        machine.release()
        before = machine.status_bytes("VmRSS")
        machine.reset_peak()
        start, processor = time.perf_counter(), time.process_time()
        backend = SchurBackend(problem, threads)

        def add(record: Any) -> None:
            chi2 = record.chi2_after if record.accepted else record.chi2
            log.append((time.perf_counter() - start, time.process_time() - processor, chi2))

        result = levenberg_marquardt(backend, backend.initial(), MOST, add)
    return {
        "log": log, "kind": backend.reduced.kind, "ended": result.reason,
        "memory": machine.status_bytes("VmHWM") - before,
    }  # fmt: skip


def theirs(size: str, threads: int, solver: str, limit_s: float) -> dict[str, Any]:
    """Run Ceres through COLMAP, whose objects are made before."""
    from benchmarks import peers_pinhole

    p = pinhole.as_pinhole(pinhole.pinhole_problem(size))
    scene, (linear_solver, eta) = peers_pinhole.reconstruction(p), CERES[solver]
    machine.release()
    before = machine.status_bytes("VmRSS")
    machine.reset_peak()
    adjuster = peers_pinhole.adjuster(p, scene, threads, limit_s, linear_solver, eta)
    start, processor = time.perf_counter(), time.process_time()
    with tempfile.TemporaryFile() as file:
        kept = os.dup(1)
        os.dup2(file.fileno(), 1)
        summary = adjuster.solve().ceres_summary
        os.dup2(kept, 1)
        file.seek(0)
        lines = [found.groups() for found in map(LINE.match, file.read().decode().splitlines()) if found]
    share = (time.process_time() - processor) / (time.perf_counter() - start)
    # the text has seven digits of the cost and only three of its changes, which are added from the end
    scale, cost, log = 2.0 / p.sigma**2, float(summary.final_cost), list[tuple[float, float, float]]()
    for change, seconds in reversed(lines[1:]):
        log.append((float(seconds), share * float(seconds), scale * cost))
        cost += max(float(change), 0.0)
    return {
        "log": log[::-1], "kind": linear_solver, "ended": f"{summary.termination_type.name}: {summary.message}",
        "memory": machine.status_bytes("VmHWM") - before,
    }  # fmt: skip


def apart(*arguments: object) -> dict[str, Any]:
    """Run one of these functions in a new process."""
    command = [sys.executable, "-m", "benchmarks.wide", "--one", *map(str, arguments)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def arrival(record: dict[str, Any], target: float) -> tuple[float, float] | None:
    """Return the wall-clock and processor seconds until chi2 is at most the target; None if it never is."""
    return next(((wall, processor) for wall, processor, chi2 in record["log"] if chi2 <= target), None)


def of_size(results: dict[str, Any], size: str, threads: int) -> dict[str, list[dict[str, Any]]]:
    """Return the records of a size by solver."""
    out: dict[str, list[dict[str, Any]]] = {}
    for record in results["records"]:
        if (record["size"], record["threads"]) == (size, threads):
            out.setdefault(record["solver"], []).append(record)
    return out


def target_of(results: dict[str, Any], size: str) -> float:
    """Return the lowest chi2 of all solvers, increased by the permitted share."""
    return float((1.0 + SAME) * min(row[2] for r in results["records"] if r["size"] == size for row in r["log"]))


def medians(records: list[dict[str, Any]], target: float) -> tuple[float, float] | None:
    """Return the median wall-clock and processor seconds to the target; None if it was not reached."""
    found = [arrival(record, target) for record in records]
    if None in found:
        return None
    walls, processors = zip(*(one for one in found if one is not None), strict=True)
    return median(walls), median(processors)


def threads_of(results: dict[str, Any]) -> list[int]:
    """Return the numbers of threads of the records."""
    return sorted({record["threads"] for record in results["records"]})


def rows(results: dict[str, Any]) -> list[Row]:
    """Return the table of all solvers."""
    out = [["cameras", "threads", "solver", "method", "repeats", "processor s", "wall s", "iterations", "memory MB"]]
    for size in LEAST:
        for threads in threads_of(results):
            for solver, records in of_size(results, size, threads).items():
                target = target_of(results, size)
                found, log = medians(records, target), records[0]["log"]
                count = sum(chi2 > target for _, _, chi2 in log) + 1 if found else len(log)
                seconds = ["not reached"] * 2 if found is None else [f"{found[1]:.2f}", f"{found[0]:.2f}"]
                out.append([
                    size.split()[0], str(threads), solver, records[0]["kind"], str(len(records)), *seconds, str(count),
                    f"{median(r['memory'] for r in records) / 1e6:.0f}",
                ])  # fmt: skip
    return out


def goals(results: dict[str, Any]) -> list[Row]:
    """Return the ratios of the best solver of Ceres to fg_orient, and the iterations, with their limits."""
    out = [["goal", "measured", "limit", "verdict"]]
    for size, least in LEAST.items():
        for threads in threads_of(results):
            by_solver = of_size(results, size, threads)
            found = {name: medians(records, target_of(results, size)) for name, records in by_solver.items()}
            own, peers = found.get(OURS), {name: one for name, one in found.items() if name in CERES and one}
            if own is None or not peers:
                continue
            best = min(peers, key=lambda name: peers[name][1])
            ratio, wall = peers[best][1] / own[1], peers[best][0] / own[0]
            name = f"{size.split()[0]} cameras, {threads} thread{'s' * (threads > 1)}: {best} / fg_orient"
            used = [median(r["memory"] for r in by_solver[one]) / 1e6 for one in (best, OURS)]
            out.append([
                f"{name} (wall {wall:.1f}; {used[0]:.0f} and {used[1]:.0f} MB)", f"{ratio:.1f}", f">= {least:g}",
                "met" if ratio >= least else "missed",
            ])  # fmt: skip
    for name, limit in ITERATIONS.items():
        records = results["iterations"].get(name, [])
        if records:
            seconds, last = median(r["iteration_s"] for r in records), records[-1]
            method = " ".join(filter(None, (last["backend"], last["reduced"])))
            used = f"{last['image_points']} image points, {method}, {last['memory'] / 1e6:.0f} MB"
            verdict = "met" if seconds <= limit else "missed"
            out.append([f"{name}: processor s per iteration ({used})", f"{seconds:.3f}", f"<= {limit:g}", verdict])
    return out


def measure(given: argparse.Namespace) -> dict[str, Any]:
    """Add the runs that the file does not contain."""
    results: dict[str, Any] = {"machine": this_machine(), "records": [], "iterations": {}}
    if given.json.exists():
        results |= json.loads(given.json.read_text("utf-8"))
    for turn in range(given.repeats):
        for size in given.sizes:
            for threads in given.threads:
                known, kept = of_size(results, size, threads), [OURS, *CERES]
                if pinhole.WIDE_SIZES[size][0] > FACTORISED:
                    kept = [name for name in kept if CERES.get(name, ("ITERATIVE_SCHUR",))[0] == "ITERATIVE_SCHUR"]
                if turn:
                    times = {name: medians(known[name], target_of(results, size)) for name in kept}
                    best = min(one[1] for name, one in times.items() if one and name != OURS)
                    kept = [name for name, one in times.items() if name == OURS or (one and one[1] <= SLOW * best)]
                for solver in (name for name in kept if len(known.get(name, [])) <= turn):
                    record = apart("solver", solver, size, threads, given.limit)
                    results["records"].append({"size": size, "solver": solver, "threads": threads, **record})
                    note(f"round {turn + 1}: {size} {solver} {threads}: {record['log'][-1:]}, {record['memory']} B")
                    write_bytes(given.json, (json.dumps(results, indent=1) + "\n").encode())
        for name in (name for name in ITERATIONS if len(results["iterations"].get(name, [])) <= turn):
            results["iterations"].setdefault(name, []).append(found := apart("iterations", name))
            note(f"round {turn + 1}: {name}: {found}")
            write_bytes(given.json, (json.dumps(results, indent=1) + "\n").encode())
    return results


def main() -> int:
    """Print the tables. The exit code is always 0, because a benchmark only reports."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", choices=list(LEAST), default=list(LEAST))
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds for a solution of Ceres")
    parser.add_argument("--json", type=Path, default=RESULTS, help="where the records go")
    parser.add_argument("--one", nargs="+", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        kind, name, *rest = given.one
        if kind == "iterations":
            print(json.dumps(iterations(name)))
        elif name == OURS:
            print(json.dumps(ours(rest[0], int(rest[1]))))
        else:
            print(json.dumps(theirs(rest[0], int(rest[1]), name, float(rest[2]))))
        return 0
    results = measure(given)
    for table in (rows(results), goals(results)):
        print("\n".join(" | ".join(row) for row in table))
    return 0


if __name__ == "__main__":
    sys.exit(main())
