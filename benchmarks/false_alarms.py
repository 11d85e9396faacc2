"""The study counts false alarms: perfect blocks of ten kinds with exit code 4, and each doubt against its share.

    python -m benchmarks.false_alarms [--runs N] [--workers N] [--kinds ...] [--minutes N]

writes results/false_alarms.json. ``python -m benchmarks.detection_page`` writes the counts to
docs/detection.md. Blocks are drawn from the sigmas of the adjustment (``benchmarks.drawn``)
and adjusted with default options and the options of the kind. Runs in the file are not
repeated.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import fg_orient as fg
from benchmarks.drawn import Source
from benchmarks.mistakes import base
from fg_orient.formats.atomic import write_bytes
from fg_orient.model.block import Block
from fg_orient.model.errors import DECISIVE, FgOrientError
from fg_orient.model.names import Role
from fg_orient.orientation.confirmation import CAUSES
from fg_orient.simulate.block import BlockOptions, grid_block
from fg_orient.simulate.mixed import MixedOptions, mixed_block
from fg_orient.simulate.strips import StripOptions, strip_block

Array = npt.NDArray[np.float64]
RESULTS: Final = Path(__file__).parent / "results" / "false_alarms.json"
RUNS: Final = 1000
#: The file is written after this number of runs of a kind.
STEP: Final = 25


@dataclass(frozen=True)
class Kind:
    """A kind of block has a description, a block with its truth, and options of the block and of the adjustment."""

    what: str
    made: Callable[[], tuple[Block, Array]]
    options: dict[str, Any] = field(default_factory=dict)
    drawn_with: dict[str, Any] = field(default_factory=dict)


def with_control(block: Block, count: int) -> Block:
    """Return the block with this number of control points; the other points have no coordinates."""
    gone = np.zeros(len(block.points.ids), bool)
    gone[block.points.where(Role.CONTROL)[count:]] = True
    return replace(block, points=block.points.without_coordinates(gone, Role.TIE))


def pair(count: int) -> Callable[[], tuple[Block, Array]]:
    def made() -> tuple[Block, Array]:
        block, truth = base("pair")
        return with_control(block, count), truth

    return made


def grid(**options: Any) -> Callable[[], tuple[Block, Array]]:
    def made() -> tuple[Block, Array]:
        block, truth = grid_block(BlockOptions(errors="none", **options))
        return block, truth.ecef_m

    return made


def rpc_alone() -> tuple[Block, Array]:
    """Return a block of RPC images without control and check points."""
    block, truth = base("rpc")
    points = block.points.without_coordinates(np.ones(len(block.points.ids), bool), Role.TIE)
    return replace(block, points=points, withheld=replace(block.withheld, ids=())), truth


def mixed() -> tuple[Block, Array]:
    block, truth = mixed_block(MixedOptions(errors="none"))
    return block, truth.ecef_m


def frames(control: int) -> Callable[[], tuple[Block, Array]]:
    def made() -> tuple[Block, Array]:
        block, truth = strip_block(StripOptions(control=control, navigation=False))
        return block, truth.ground_m

    return made


KINDS: Final = {
    "pair, set 1": Kind("SPOT-5 pair, 37 control points, set 1", pair(37), {"eop_set": 1}),
    "pair, set 15": Kind("SPOT-5 pair, 3 control points, set 15", pair(3), {"eop_set": 15}),
    "pair, set 20": Kind("SPOT-5 pair, 10 control points, set 20", pair(10), {"eop_set": 20}),
    "triplet": Kind("three SPOT-5 images, 8 control points, set 15",
                    grid(rows=1, columns=3, points=40, control_share=0.2, check_share=0.2), {"eop_set": 15}),
    "strip": Kind("five SPOT-5 images in a row, 12 control points",
                  grid(rows=1, columns=5, points=60, control_share=0.2, check_share=0.2)),
    "block": Kind("four SPOT-5 images, 100 control points, set 15",
                  grid(points=150, control_share=0.667, check_share=0.2), {"eop_set": 15}),
    "rpc": Kind("RPC pair, 12 control points", lambda: base("rpc")),
    "rpc alone": Kind("RPC pair without control points, datum of the vendor", rpc_alone, {"datum": "vendor"},
                      {"datum": "priors"}),
    "mixed": Kind("two SPOT-5, two RPC and four frame images", mixed),
    "free network": Kind("ten frame images without control points, inner constraints", frames(0),
                         {"datum": "inner", "priors": False}, {"datum": "priors", "priors": True}),
}  # fmt: skip


@lru_cache(maxsize=1)
def source(kind: str) -> Source:
    """Return the source of the draws of a kind."""
    block, truth = KINDS[kind].made()
    options = KINDS[kind].options | KINDS[kind].drawn_with
    return Source(replace(block, options=replace(block.options, **options)), truth)


def run_of(kind: str, run: int) -> list[str]:
    """Return the codes of the doubts and causes of a run; a refusal also has a code."""
    block = source(kind).draw(np.random.default_rng([list(KINDS).index(kind), run])).block
    try:
        solution = fg.adjust(replace(block, options=replace(block.options, **KINDS[kind].options)))
    except FgOrientError as error:
        return [error.problems[0].code]
    found = [f.code for f in solution.findings if f.severity in DECISIVE or f.code in CAUSES]
    return found if str(solution.status) != "converged" else []


def some_runs(kind: str, first: int, count: int) -> list[list[str]]:
    """Return the codes of some runs."""
    return [run_of(kind, run) for run in range(first, first + count)]


def loaded() -> dict[str, Any]:
    """Return the kinds of the file of results."""
    return json.loads(RESULTS.read_text("utf-8"))["kinds"] if RESULTS.exists() else {}  # type: ignore[no-any-return]


def main() -> None:
    """Make the runs that are missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after this time")
    given = parser.parse_args()
    records, start = loaded(), time.perf_counter()
    for runs in range(STEP, given.runs + STEP, STEP):
        for kind in given.kinds:
            record = records.setdefault(kind, {"runs": 0, "alarms": {}, "seconds": 0.0})
            if record["runs"] >= min(runs, given.runs):
                continue
            if time.perf_counter() - start > 60.0 * given.minutes:
                return
            begin, first = time.perf_counter(), record["runs"]
            for run, codes in enumerate(_all(kind, first, min(runs, given.runs) - first, given.workers), first):
                if codes:
                    record["alarms"][str(run)] = codes
            record["runs"] = min(runs, given.runs)
            record["seconds"] = round(record["seconds"] + time.perf_counter() - begin, 1)
            write_bytes(RESULTS, (json.dumps({"kinds": records}, indent=1) + "\n").encode())
        sys.stdout.write(f"{runs} runs, {time.perf_counter() - start:.0f} s\n")
        sys.stdout.flush()


def _all(kind: str, first: int, count: int, workers: int) -> list[list[str]]:
    if workers == 1:
        return some_runs(kind, first, count)
    parts = np.array_split(np.arange(first, first + count), workers)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        done = [pool.submit(some_runs, kind, int(part[0]), len(part)) for part in parts if len(part)]
        return [codes for one in done for codes in one.result()]


if __name__ == "__main__":
    main()
