"""The benchmark compares the backends of fg_orient with other software in one run.

It writes records as JSON and prints a table.

    python -m benchmarks.fast_path [--full] [--sizes 94 1e3 ...] [--pinhole 1e3 ...] [--repeats N] [--no-peers]
                                   [--budget S] [--json FILE] [--page]

Without --full a run takes some minutes: sizes up to 1e5, three repeats, and only the other
programs that end within seconds. With --full it takes hours: all sizes, seven repeats and all
other programs. It then writes benchmarks/results/fast_path.json and docs/performance.md. All
entries run once in each round, and BLAS has one thread. Functions that compile are called
before; their time is reported separately. ``FG_ORIENT_REAL_DATA`` names the folder with
bal/problem-49-7776-pre.txt.gz, which --full also times.
"""

from __future__ import annotations

import os
import sys

if os.environ.get("OPENBLAS_NUM_THREADS") != "1" or os.environ.get("OMP_NUM_THREADS") != "1":
    # numpy reads the variable when it is loaded; therefore it cannot be set here for this process
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    os.execv(sys.executable, [sys.executable, "-m", "benchmarks.fast_path", *sys.argv[1:]])

import argparse
import importlib.metadata
import json
import platform
import shutil
import tempfile
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from benchmarks import cases, memory, own, peers_ceres, peers_pinhole, peers_scipy, pinhole
from benchmarks.entries import Entry, Outcome, run_rounds
from benchmarks.flat import FlatProblem
from benchmarks.hardware import Meter, this_machine
from benchmarks.page import write_page
from benchmarks.table import print_table
from fg_orient.adjustment.optimisers import GTSAM_OPTIMIZERS
from fg_orient.adjustment.problem import Problem, compile_problem
from fg_orient.formats.project import read_project
from fg_orient.simulate.block import BlockOptions, simulate_block

RESULTS: Final = Path(__file__).parent / "results" / "fast_path.json"
PACKAGES: Final = ("fg-orient", "gtsam", "numpy", "scipy", "numba", "pyceres", "pycolmap")
#: Above the first number of image points the graph does not run, because it needs 12 kB for
#: each. Above the second number other programs run only with --full.
GRAPH_LIMIT, PEER_LIMIT = 200_000, 20_000
FULL_PEER_LIMIT: Final = 200_000
#: The backends of fg_orient run with their default number of threads, with one and with two.
THREADS: Final = {"schur": None, "schur-1": 1, "schur-2": 2}
#: In a full run the repeats of one entry may take this time, s.
FULL_BUDGET_S, BUDGET_S = 900.0, 60.0


def spot_entries(size: str, given: argparse.Namespace, folder: Path) -> list[Entry]:
    """Return the entries of all solvers on the synthetic block of a size."""
    cases.note(f"simulating {size}")
    block = cases.spot_block(size)
    problem = compile_problem(block)
    counts = cases.counts(problem)
    n, peers = counts.n_image_points, not given.no_peers
    limit = FULL_PEER_LIMIT if given.full else 0
    runs: dict[str, Callable[[], Outcome]] = {
        "compile": own.compilation(block), **{name: own.schur(problem, t) for name, t in THREADS.items()}
    }  # fmt: skip
    runs |= {f"schur-2-{way}": own.schur(problem, 2, reduced=way) for way in given.reduced}
    if given.full:
        runs["read"] = reading(size, folder)
    runs["schur-levenberg-marquardt"] = own.schur(problem, None, optimizer="levenberg-marquardt")
    runs |= {f"graph-{optimizer}": own.eliminated(problem, optimizer) for optimizer in GTSAM_OPTIMIZERS}
    if n <= GRAPH_LIMIT:
        runs["graph"] = own.graph(problem)
    if peers and n <= max(PEER_LIMIT, limit):
        flat = FlatProblem(problem)
        runs["trf-2-point"] = peers_scipy.trf(flat, analytic=False)
        runs["trf-analytic"] = peers_scipy.trf(flat, analytic=True)
        runs["pyceres"] = peers_ceres.sparse_schur(flat)
    if given.full and size == "1e4":
        runs["gtsam-native-iterate"] = own.native_iteration(problem)
    return [Entry("spot", size, name, counts, run, given.repeats) for name, run in runs.items()]


def reading(size: str, folder: Path) -> Callable[[], Outcome]:
    """Return the seconds that ``read_project`` takes for the files of the block: metadata, tables, project."""
    s = cases.SIZES[size]
    options = BlockOptions(rows=s.rows, columns=s.columns, points=s.points, check_share=0.0)
    project = simulate_block(folder / size, options)

    def once() -> Outcome:
        start = time.perf_counter()
        read_project(project)
        return Outcome(time.perf_counter() - start, 0.0, 0, 0, None, "read")

    return once


def resection_entries(given: argparse.Namespace) -> list[Entry]:
    """Return the entries of the resection with 94 control points in one image."""
    problem = cases.resection_problem()
    flat = FlatProblem(problem)
    runs: dict[str, Callable[[], Outcome]] = {
        "adjust": own.public(problem), "schur-1": own.schur(problem, 1), "graph": own.graph(problem),
        "gtsam-native": own.native(problem),
    }  # fmt: skip
    if not given.no_peers:
        runs["trf-2-point"] = peers_scipy.trf(flat, analytic=False)
        runs["trf-analytic"] = peers_scipy.trf(flat, analytic=True)
    counts = cases.counts(problem)
    return [Entry("resection", "94", name, counts, run, given.repeats) for name, run in runs.items()]


def pinhole_entries(given: argparse.Namespace) -> list[Entry]:
    """Return the entries of the pinhole problems for fg_orient and the compiled programs."""
    problems: dict[str, Problem | None] = {size: pinhole.pinhole_problem(size) for size in given.pinhole}
    if given.full:
        problems["ladybug-49"] = pinhole.ladybug_problem()
    entries = []
    for size, problem in problems.items():
        if problem is None:
            cases.note("no Ladybug-49: FG_ORIENT_REAL_DATA is not set, or has no bal/")
            continue
        arrays, counts = pinhole.as_pinhole(problem), cases.counts(problem)
        runs: dict[str, Callable[[], Outcome]] = {name: own.damped(problem, t) for name, t in THREADS.items()}
        # the datum is free, so that the equations of Gauss-Newton are singular
        runs["graph-levenberg-marquardt"] = own.eliminated(problem, "levenberg-marquardt")
        if not given.no_peers:
            runs |= {f"ceres-{t}": peers_pinhole.ceres(arrays, t) for t in (1, 2)}
            runs["gtsam"] = peers_pinhole.gtsam_sfm(arrays)
        entries += [Entry("pinhole", size, name, counts, run, given.repeats) for name, run in runs.items()]
    return entries


def warm_up(given: argparse.Namespace) -> float:
    """Compile or load everything that the timed runs call; return the seconds."""
    start = time.perf_counter()
    small = compile_problem(cases.spot_block("94"))
    frames = pinhole.pinhole_problem("1e3")
    more = compile_problem(cases.spot_block("1e3"))  # with fewer points the first calls are plain Python
    for threads in (1, 2):
        own.schur(small, threads)()
        own.schur(more, threads)()
        own.eliminated(more, "dogleg")()
        own.damped(frames, threads)()
    if not given.no_peers:
        flat = FlatProblem(small)
        flat.warm_up()
        FlatProblem(cases.resection_problem()).warm_up()
        peers_ceres.sparse_schur(flat)()
        peers_pinhole.ceres(pinhole.as_pinhole(frames), 1)()
    return time.perf_counter() - start


def machine(given: argparse.Namespace) -> dict[str, Any]:
    """Return versions of the programs and properties of the machine."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = ""
    return {
        **this_machine(),
        "system": platform.platform(),
        "versions": versions,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "full": given.full,
        "repeats": given.repeats,
    }


def run(given: argparse.Namespace) -> dict[str, Any]:
    """Make the runs of all sizes and programs that are asked for."""
    results: dict[str, Any] = {"machine": machine(given), "jit_s": warm_up(given), "hardware": []}
    folder, meter = Path(tempfile.mkdtemp()), Meter()
    try:
        entries = [entry for size in given.sizes for entry in spot_entries(size, given, folder)]
        entries += resection_entries(given) + pinhole_entries(given)
        run_rounds(entries, given.budget, lambda: results["hardware"].append(meter.measure()))
    finally:
        shutil.rmtree(folder)
    results["records"] = [record for entry in entries for record in entry.records]
    results["memory"] = [
        memory.measure_apart(size, 2, backend) for backend in ("schur", "graph") for size in given.sizes
        if float(size) >= 1e4
    ]  # fmt: skip
    return results


def main() -> int:
    """Print the table. The exit code is always 0, because a benchmark only reports."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--full", action="store_true", help="all sizes and peers, seven repeats; writes the page")
    parser.add_argument("--sizes", nargs="+", choices=list(cases.SIZES))
    parser.add_argument("--pinhole", nargs="+", choices=list(pinhole.PINHOLE_SIZES))
    parser.add_argument("--repeats", type=int)
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--reduced", nargs="+", default=[], help="also these solvers of the reduced system")
    parser.add_argument("--json", type=Path, help="where the records go")
    parser.add_argument("--page", action="store_true", help="write docs/performance.md from this run")
    parser.add_argument("--budget", type=float, help="seconds for all repeats of one entry, after its first run")
    given = parser.parse_args()
    given.budget = given.budget or (FULL_BUDGET_S if given.full else BUDGET_S)
    given.repeats = given.repeats or (7 if given.full else 3)
    given.pinhole = given.pinhole or (list(pinhole.PINHOLE_SIZES) if given.full else ["1e4"])
    given.sizes = given.sizes or (list(cases.SIZES) if given.full else ["94", "1e3", "1e4", "1e5"])
    results = run(given)
    path = given.json or (RESULTS if given.full or given.page else None)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    print_table(results)
    if path == RESULTS:
        write_page()
    return 0


if __name__ == "__main__":
    sys.exit(main())
