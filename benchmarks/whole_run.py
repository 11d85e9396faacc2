"""The benchmark times whole commands: ``adjust`` from its start to the last file, and ``simulate block``.

    python -m benchmarks.whole_run [--sizes 1e4 1.3e5 1.35e6 1e7] [--repeats N] [--folder F]

writes results/whole_run.json, and ``python -m benchmarks.page`` makes a section of
docs/performance.md from it. Blocks have 16 SPOT-like images (4 x 4), 2 % control points and
10 % check points. Each run is a process of its own. The first run of the smallest block
compiles and is not counted. The operating system counts the processor seconds (user and
system) and the peak of the resident memory. The shares of the stages come from the wall-clock
seconds of the record. The time of a run without the solution is measured on one core, where
the wall-clock seconds of the solution are equal to its processor seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.hardware import this_machine
from fg_orient.formats.atomic import write_bytes
from fg_orient.formats.project import read_project
from fg_orient.orientation.orient import adjust

RESULTS: Final = Path(__file__).parent / "results" / "whole_run.json"
#: These blocks have this number of image points for each ground point.
RAYS: Final = 3.2
#: The covariances of this number of points are compared with joint covariances.
SAMPLED: Final = 200
LEAST_S: Final = 1e-9
#: The runs of this size are repeated on one core by this program.
SPLIT: Final = "1.35e6"
ONE_CORE: Final = (
    "import os, sys; os.sched_setaffinity(0, [min(os.sched_getaffinity(0))]); "
    "from fg_orient.cli import main; sys.argv[0] = 'fg-orient'; main()"
)


@dataclass(frozen=True)
class Size:
    """A size has ground points, limits of the whole run, and a switch for the statistics of all observations."""

    points: int
    limit_s: float
    limit_mb: float | None = None
    statistics: bool = True
    tables: str = "csv"


SIZES: Final = {
    "1e4": Size(3_100, 1.8),
    "1.3e5": Size(40_000, 4.5, 400.0),
    "1.35e6": Size(420_000, 30.0, 1400.0),
    "1.35e6-parquet": Size(420_000, 30.0, 1400.0, tables="parquet"),
    "1e7": Size(3_120_000, 300.0, 12_000.0, statistics=False),
}


def run(arguments: list[str], accepted: tuple[int, ...] = (0,), *, one_core: bool = False) -> dict[str, float]:
    """Run a command; return processor seconds, wall-clock seconds and megabytes of its process.

    Raises
    ------
    RuntimeError
        The exit code is not one of the accepted codes.
    """
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # otherwise all modules are compiled again in each run
    begin = time.perf_counter()
    program = ["-c", ONE_CORE] if one_core else ["-m", "fg_orient"]
    child = os.posix_spawn(sys.executable, [sys.executable, *program, *arguments], environment)
    _, status, used = os.wait4(child, 0)
    if os.waitstatus_to_exitcode(status) not in accepted:
        raise RuntimeError(" ".join(arguments))
    wall = time.perf_counter() - begin
    return {"processor_s": used.ru_utime + used.ru_stime, "wall_s": wall, "mb": used.ru_maxrss * 1024 / 1e6}


def measured(name: str, folder: Path, repeats: int) -> dict[str, Any]:
    """Simulate a block and adjust it this number of times; return the medians."""
    size, block, out = SIZES[name], folder / f"block-{name}", folder / f"result-{name}"
    tables = ["--tables", size.tables]
    grid = ["--rows", "4", "--columns", "4", "--points", str(size.points), "--seed", "1", *tables]
    made = [run(["simulate", "block", *grid, "--out", str(block), "--overwrite", "--quiet"]) for _ in range(repeats)]
    runs, records, rest = [], [], []
    command = ["adjust", str(block / "project.toml"), *tables, "--out", str(out), "--overwrite", "--quiet"]
    for _ in range(repeats if name == SPLIT else 0):
        whole = run(command, one_core=True)["processor_s"]
        rest.append(whole - json.loads((out / "result.json").read_text("utf-8"))["seconds"]["solve"])
    for _ in range(repeats):
        runs.append(run(command))
        records.append(json.loads((out / "result.json").read_text("utf-8")))
    record, seconds = records[-1], [r["seconds"] for r in records]
    return {
        "n_image_points": record["n_image_points"], "repeats": repeats,
        "simulate": {key: statistics.median(r[key] for r in made) for key in made[0]},
        "adjust": {key: statistics.median(r[key] for r in runs) for key in runs[0]},
        "stages_s": {key: statistics.median(s[key] for s in seconds) for key in seconds[0]},
        "statistics": record["reliability"] is not None, "report_mb": (out / "report.html").stat().st_size / 1e6,
        "rest_s": statistics.median(rest) if rest else None,
        "folder_mb": sum(f.stat().st_size for f in out.iterdir()) / 1e6,
    }  # fmt: skip


def covariances(project: Path) -> dict[str, float]:
    """Return the processor seconds for all covariances, and the largest difference from joint ones of 200 points.

    The difference is relative. The block has no statistics of each observation, so that only
    the solution is known before.
    """
    solution = adjust(read_project(project, statistics="basic"))
    assert solution.cofactors is not None
    index, begin = np.flatnonzero(solution.problem.active), time.process_time()
    found = solution.cofactors.points(index)
    seconds, apart = time.process_time() - begin, 0.0
    for k in np.random.default_rng(1).choice(len(index), SAMPLED, replace=False).tolist():
        joint = solution.cofactors.joint((), (int(index[k]),))
        apart = max(apart, float(np.abs(joint - found[k]).max() / np.abs(joint).max()))
    return {"n_points": len(index), "processor_s": seconds, "apart": apart}


def spaced(n: int) -> str:
    """Return a number with spaces between thousands."""
    return f"{n:,}".replace(",", " ")


def rows(results: dict[str, Any]) -> list[list[str]]:
    """Return the table of the runs with their limits as rows of text."""
    out = [[
        "image points", "tables", "processor s", "limit", "peak MB", "limit", "wall s", "all statistics", "report MB",
        "verdict",
    ]]  # fmt: skip
    for name, found in results["sizes"].items():
        size, whole = SIZES[name], found["adjust"]
        met = whole["processor_s"] <= size.limit_s and (size.limit_mb is None or whole["mb"] <= size.limit_mb)
        met &= found["statistics"] or not size.statistics
        out.append([
            spaced(found["n_image_points"]), size.tables, f"{whole['processor_s']:.2f}", f"{size.limit_s:g}",
            f"{whole['mb']:.0f}", "-" if size.limit_mb is None else f"{size.limit_mb:.0f}", f"{whole['wall_s']:.1f}",
            "yes" if found["statistics"] else "no", f"{found['report_mb']:.1f}", "met" if met else "missed",
        ])  # fmt: skip
    return out


def stage_rows(results: dict[str, Any]) -> list[list[str]]:
    """Return the shares of the stages in the wall-clock time, per cent."""
    names = ("read", "structure", "solve", "statistics", "record", "write", "report")
    out = [["image points", "tables", *names, "start and rest"]]
    for size, found in results["sizes"].items():
        whole, stages = max(found["adjust"]["wall_s"], LEAST_S), found["stages_s"]
        shares = [100.0 * stages.get(name, 0.0) / whole for name in names]
        of_points = spaced(found["n_image_points"])
        out.append(
            [of_points, SIZES[size].tables, *(f"{s:.0f}" for s in shares), f"{max(0.0, 100.0 - sum(shares)):.0f}"]
        )
    return out


def figures(results: dict[str, Any]) -> list[list[str]]:
    """Return the marginal cost, the cost without the solution, and the simulation, with their limits."""
    sizes, out = results["sizes"], [["figure", "measured", "limit"]]
    if {"1.3e5", "1.35e6"} <= sizes.keys():
        small, large = sizes["1.3e5"], sizes["1.35e6"]
        more_s = large["adjust"]["processor_s"] - small["adjust"]["processor_s"]
        cost = 1e6 * more_s / (large["n_image_points"] - small["n_image_points"])
        out.append(["marginal cost, 1.3e5 to 1.35e6, µs per image point", f"{cost:.1f}", "<= 22"])
        out.append(["whole run minus solve at 1.35e6, one core, s", f"{large['rest_s']:.1f}", "<= 24"])
        each = 1e6 * large["simulate"]["processor_s"] / large["n_image_points"]
        if found := results.get("covariances"):
            out.append(
                [f"covariances of all {spaced(found['n_points'])} points, s", f"{found['processor_s']:.1f}", "<= 10"]
            )
            apart = f"they differ from joint covariances of {SAMPLED} points by"
            out.append([apart, f"{found['apart']:.0e}", "<= 1e-09"])
        out.append(["`simulate block` at 1.35e6, µs per image point", f"{each:.1f}", "<= 25"])
    return out


def main() -> None:
    """Measure and write the file of results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", default=list(SIZES)[:-1], choices=list(SIZES))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="folder for blocks and results; default: a temporary one")
    given = parser.parse_args()
    results: dict[str, Any] = {"machine": this_machine(), "sizes": {}}
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        measured("1e4", Path(folder), 1)
        for name in given.sizes:
            results["sizes"][name] = measured(name, Path(folder), 1 if name == "1e7" else given.repeats)
            if name == "1.35e6":
                results["covariances"] = covariances(Path(folder) / f"block-{name}" / "project.toml")
            write_bytes(RESULTS, (json.dumps(results, indent=1) + "\n").encode())
            sys.stdout.write(" | ".join(rows(results)[-1]) + "\n")
            sys.stdout.flush()
    for table in (stage_rows(results), figures(results)):
        sys.stdout.write("\n".join(" | ".join(row) for row in table) + "\n")


if __name__ == "__main__":
    main()
